//! The channel between the server and the process of its device: a socket for small messages, and shared memory for large ones.
//!
//! Each frame on the socket begins with the number of a slot of shared memory, the length of the message, and that of its arrays. Messages of
//! up to [`INLINE_BYTES`] without arrays follow on the socket (slot 0). Others are in their slot. The receiver gives the slot back by a flag in shared
//! memory, so receivers never write to the socket, and the two processes cannot wait for each other.

use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use bytes::Bytes;
use isopeel_extraction::WorkError;
use postcard::ser_flavors::Flavor;
use rayon::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::blocks::{Blocks, PARALLEL_BYTES};
use super::shared_memory::{End, SLOTS, SharedMemory};

/// Bytes at the start of a frame: slot and length of the message, and the length of its arrays.
const HEADER_BYTES: usize = 16;

/// Arrays begin at multiples of this.
pub(super) const ALIGNMENT: usize = 8;

/// Minimum number of arrays that one task copies into shared memory.
const ARRAYS_A_TASK: usize = 64;

/// Maximum bytes of a message on the socket.
const INLINE_BYTES: usize = 32 << 10;

/// How long a sender sleeps while all slots are in use.
const SLOT_WAIT: Duration = Duration::from_micros(50);

/// Interval at which a sender that waits for a slot checks whether the other process is gone.
const WAITS_PER_CHECK: u32 = 1000;

/// Sends messages. One thread sends at a time.
pub(super) struct Sender {
    socket: UnixStream,
    memory: Arc<SharedMemory>,
    end: End,
    /// The next small message.
    inline: Vec<u8>,
}

/// Why a message was not sent.
#[derive(Debug, thiserror::Error)]
pub(super) enum SendError {
    /// The message is larger than a slot of shared memory, or cannot be serialised.
    #[error("the message cannot be sent to another process: {0}")]
    Message(#[from] postcard::Error),
    /// The other process is gone.
    #[error(transparent)]
    Gone(#[from] io::Error),
}

impl SendError {
    /// Returns the error of the job whose message was not sent.
    pub(super) fn of_job(&self, slot_bytes: usize) -> WorkError {
        match self {
            Self::Message(postcard::Error::SerializeBufferFull) => WorkError::TooLargeToShare {
                limit_bytes: slot_bytes as u64,
            },
            _ => WorkError::Stopped,
        }
    }
}

impl Sender {
    pub(super) fn new(socket: UnixStream, memory: Arc<SharedMemory>, end: End) -> Self {
        Self {
            socket,
            memory,
            end,
            inline: Vec::with_capacity(INLINE_BYTES),
        }
    }

    /// Maximum bytes of a message.
    pub(super) fn slot_bytes(&self) -> usize {
        self.memory.slot_bytes
    }

    /// Sends a message. Waits while all slots of shared memory are in use.
    ///
    /// # Errors
    /// [`SendError`]. After [`SendError::Message`] nothing was sent, and other messages can be.
    pub(super) fn send(&mut self, message: &impl Serialize) -> Result<(), SendError> {
        self.send_with(message, &[])
    }

    /// As [`Sender::send`], with arrays behind the message, each at a multiple of [`ALIGNMENT`].
    ///
    /// # Errors
    /// As [`Sender::send`].
    pub(super) fn send_with(&mut self, message: &impl Serialize, arrays: &[&[u8]]) -> Result<(), SendError> {
        self.inline.clear();
        self.inline.extend_from_slice(&[0; HEADER_BYTES]);
        let mut slot = None;
        if !arrays.is_empty() {
            let taken = self.take_slot().ok_or(io::Error::from(io::ErrorKind::BrokenPipe))?;
            slot = Some((taken, 0));
        }
        let serialized = postcard::serialize_with_flavor(message, MessageWriter { sender: self, slot });
        let (slot, length) = match serialized {
            Err(_) if self.is_closed() => return Err(io::Error::from(io::ErrorKind::BrokenPipe).into()),
            serialized => serialized?,
        };
        let header = [
            ((slot as u64) << 56) | length as u64,
            self.write_arrays(slot, length, arrays)? as u64,
        ];
        self.inline[..HEADER_BYTES].copy_from_slice(bytemuck::bytes_of(&header));
        let sent = if slot == 0 { HEADER_BYTES + length } else { HEADER_BYTES };
        self.socket.write_all(&self.inline[..sent])?;
        Ok(())
    }

    /// Copies arrays behind a message of `length` bytes in a slot. Returns the bytes that they take.
    fn write_arrays(&self, slot: usize, length: usize, arrays: &[&[u8]]) -> Result<usize, SendError> {
        let Some(index) = slot.checked_sub(1) else { return Ok(0) };
        let begin = length.next_multiple_of(ALIGNMENT);
        let (mut offsets, mut end) = (Vec::with_capacity(arrays.len()), begin);
        for array in arrays {
            offsets.push(end);
            end = (end + array.len()).next_multiple_of(ALIGNMENT);
        }
        if end > self.memory.slot_bytes {
            self.memory.flag(index).store(0, Ordering::Release);
            return Err(postcard::Error::SerializeBufferFull.into());
        }
        let copy = |(array, offset): (&&[u8], &usize)| {
            // SAFETY: the slot is this sender's alone until the message is sent; the arrays end within it and do not overlap.
            unsafe { std::ptr::copy_nonoverlapping(array.as_ptr(), self.memory.slot(index).add(*offset), array.len()) }
        };
        if end - begin < PARALLEL_BYTES {
            arrays.iter().zip(&offsets).for_each(copy);
        } else {
            arrays
                .par_iter()
                .zip(&offsets)
                .with_min_len(ARRAYS_A_TASK)
                .for_each(copy);
        }
        Ok(end - begin)
    }

    /// Waits for a free slot and marks it as in use. `None` if the other process is gone.
    fn take_slot(&self) -> Option<usize> {
        for wait in 1u32.. {
            let free = (0..SLOTS)
                .map(|slot| SharedMemory::index(self.end, slot))
                .find(|&index| {
                    let flag = self.memory.flag(index);
                    flag.compare_exchange(0, 1, Ordering::Acquire, Ordering::Relaxed)
                        .is_ok()
                });
            if free.is_some() {
                return free;
            }
            if wait % WAITS_PER_CHECK == 0 && self.is_closed() {
                return None;
            }
            std::thread::sleep(SLOT_WAIT);
        }
        None
    }

    /// Whether the other process has closed its end of the socket.
    fn is_closed(&self) -> bool {
        use rustix::event::{PollFd, PollFlags, Timespec, poll};
        let mut polled = [PollFd::new(&self.socket, PollFlags::empty())];
        let now = Timespec { tv_sec: 0, tv_nsec: 0 };
        poll(&mut polled, Some(&now)).is_ok() && polled[0].revents().intersects(PollFlags::HUP | PollFlags::ERR)
    }
}

/// Writes one message: to the buffer of small messages, and to a slot once it is too large for that.
struct MessageWriter<'a> {
    sender: &'a mut Sender,
    /// The slot, and the bytes written to it.
    slot: Option<(usize, usize)>,
}

impl MessageWriter<'_> {
    fn write(&mut self, data: &[u8]) -> postcard::Result<()> {
        if self.slot.is_none() {
            if self.sender.inline.len() + data.len() <= INLINE_BYTES {
                self.sender.inline.extend_from_slice(data);
                return Ok(());
            }
            let index = self.sender.take_slot().ok_or(postcard::Error::SerializeBufferFull)?;
            self.slot = Some((index, 0));
            let begin = std::mem::take(&mut self.sender.inline);
            let copied = self.write(&begin[HEADER_BYTES..]);
            self.sender.inline = begin;
            copied?;
        }
        let Some((index, written)) = &mut self.slot else {
            return Err(postcard::Error::SerializeBufferFull);
        };
        if data.len() > self.sender.memory.slot_bytes - *written {
            return Err(postcard::Error::SerializeBufferFull);
        }
        // SAFETY: the slot is this sender's alone until the message is sent, and the data ends within it.
        unsafe {
            let target = self.sender.memory.slot(*index).add(*written);
            std::ptr::copy_nonoverlapping(data.as_ptr(), target, data.len());
        }
        *written += data.len();
        Ok(())
    }
}

impl Flavor for MessageWriter<'_> {
    /// Slot (0: none) and length of the message.
    type Output = (usize, usize);

    fn try_push(&mut self, data: u8) -> postcard::Result<()> {
        self.write(&[data])
    }

    fn try_extend(&mut self, data: &[u8]) -> postcard::Result<()> {
        self.write(data)
    }

    fn finalize(mut self) -> postcard::Result<Self::Output> {
        Ok(match self.slot.take() {
            Some((index, length)) => (index + 1, length),
            None => (0, self.sender.inline.len() - HEADER_BYTES),
        })
    }
}

impl Drop for MessageWriter<'_> {
    /// Frees the slot of a message that is not sent.
    fn drop(&mut self) {
        if let Some((index, _)) = self.slot {
            self.sender.memory.flag(index).store(0, Ordering::Release);
        }
    }
}

/// Receives messages.
pub(super) struct Receiver {
    socket: UnixStream,
    memory: Arc<SharedMemory>,
    end: End,
    inline: Vec<u8>,
    blocks: Blocks,
}

impl Receiver {
    pub(super) fn new(socket: UnixStream, memory: Arc<SharedMemory>, end: End) -> Self {
        Self {
            socket,
            memory,
            end,
            inline: Vec::new(),
            blocks: Blocks::default(),
        }
    }

    /// Waits for the next message.
    ///
    /// # Errors
    /// The other process is gone, or has sent something that is no message.
    pub(super) fn receive<M: DeserializeOwned>(&mut self) -> io::Result<M> {
        Ok(self.receive_with()?.0)
    }

    /// As [`Receiver::receive`], with the arrays behind the message.
    ///
    /// # Errors
    /// As [`Receiver::receive`].
    pub(super) fn receive_with<M: DeserializeOwned>(&mut self) -> io::Result<(M, Bytes)> {
        let mut header = [0u64; HEADER_BYTES / 8];
        self.socket.read_exact(bytemuck::bytes_of_mut(&mut header))?;
        let (slot, length) = ((header[0] >> 56) as usize, (header[0] & ((1 << 56) - 1)) as usize);
        let array_bytes = usize::try_from(header[1]).unwrap_or(usize::MAX);
        let invalid = |what: String| io::Error::new(io::ErrorKind::InvalidData, what);
        if slot == 0 {
            if length > INLINE_BYTES {
                return Err(invalid(format!("a message of {length} bytes on the socket")));
            }
            self.inline.resize(length, 0);
            self.socket.read_exact(&mut self.inline)?;
            let message = postcard::from_bytes(&self.inline).map_err(|error| invalid(error.to_string()))?;
            return Ok((message, Bytes::new()));
        }
        let index = slot - 1;
        let from_other = (0..SLOTS).any(|slot| SharedMemory::index(self.end.other(), slot) == index);
        let begin = length.checked_next_multiple_of(ALIGNMENT);
        let used = begin.and_then(|begin| begin.checked_add(array_bytes));
        let (Some(begin), Some(used), true) = (begin, used.filter(|&used| used <= self.memory.slot_bytes), from_other)
        else {
            return Err(invalid(format!(
                "a message of {length} and {array_bytes} bytes in slot {slot}"
            )));
        };
        // SAFETY: the message lies within the slot, which the sender does not change until the flag is cleared.
        let bytes = unsafe { std::slice::from_raw_parts(self.memory.slot(index), used) };
        let message = match self.end {
            // A process that is taken over may break that rule: what is checked must not change afterwards. Arrays are copied anyway.
            End::Server => postcard::from_bytes(&std::hint::black_box(bytes[..length].to_vec())),
            End::Device => postcard::from_bytes(&bytes[..length]),
        };
        let message = message.map_err(|error| invalid(error.to_string()));
        let arrays = self.blocks.copy(&bytes[begin..]);
        self.memory.trim(index, used);
        self.memory.flag(index).store(0, Ordering::Release);
        Ok((message?, arrays))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A channel in this process: the ends of the server, and those of the device.
    fn channel() -> ((Sender, Receiver), (Sender, Receiver)) {
        let (memory, file) = SharedMemory::create().expect("memory");
        channel_through(memory, SharedMemory::map(&file).expect("the same memory"))
    }

    /// A channel through memory that is mapped twice.
    fn channel_through(memory: SharedMemory, mapped: SharedMemory) -> ((Sender, Receiver), (Sender, Receiver)) {
        let (one, other) = UnixStream::pair().expect("sockets");
        let ends = |socket: UnixStream, memory: SharedMemory, end| {
            let (memory, copy) = (Arc::new(memory), socket.try_clone().expect("a socket"));
            (
                Sender::new(copy, Arc::clone(&memory), end),
                Receiver::new(socket, memory, end),
            )
        };
        (ends(one, memory, End::Server), ends(other, mapped, End::Device))
    }

    /// Messages of all sizes around that of small ones, and large ones.
    fn messages() -> Vec<Vec<u8>> {
        let sizes = (INLINE_BYTES - 20..INLINE_BYTES + 3).chain([0, 1, 20 << 20, 1 << 20, 17 << 20]);
        sizes
            .map(|size| (0..size).map(|i| (i * 31 + size) as u8).collect())
            .collect()
    }

    #[test]
    fn messages_of_any_size_arrive_in_order_both_ways_at_once() {
        let ((mut to_device, mut from_device), (mut to_server, mut from_server)) = channel();
        std::thread::scope(|scope| {
            scope.spawn(move || {
                messages()
                    .iter()
                    .for_each(|message| to_device.send(message).expect("sent"))
            });
            scope.spawn(move || {
                messages()
                    .iter()
                    .for_each(|message| to_server.send(message).expect("sent"))
            });
            scope.spawn(move || {
                for message in messages() {
                    assert!(from_server.receive::<Vec<u8>>().expect("a message") == message);
                }
            });
            for message in messages() {
                assert!(from_device.receive::<Vec<u8>>().expect("a message") == message);
            }
        });
    }

    #[test]
    fn arrays_arrive_behind_their_message() {
        let ((mut to_device, _from_device), (_to_server, mut from_server)) = channel();
        for count in [1, 3, 2000] {
            let arrays: Vec<Vec<u8>> = (0..count).map(|i| vec![i as u8; i * 7 % 4000]).collect();
            let slices: Vec<&[u8]> = arrays.iter().map(Vec::as_slice).collect();
            let text = "text".repeat(count * 20);
            to_device.send_with(&text, &slices).expect("sent");
            let (message, bytes): (String, Bytes) = from_server.receive_with().expect("a message");
            assert_eq!(message, text);
            let mut begin = 0;
            for array in &arrays {
                assert!(bytes[begin..begin + array.len()] == array[..]);
                begin = (begin + array.len()).next_multiple_of(ALIGNMENT);
            }
        }
    }

    #[test]
    fn what_is_too_large_to_share_is_an_error_with_the_limit_and_other_messages_arrive() {
        let small = || SharedMemory::create_below(100 << 20).expect("memory");
        let (memory, file) = small();
        let mapped = SharedMemory::map(&file).expect("the same memory");
        let slot_bytes = memory.slot_bytes;
        assert!(4 * slot_bytes <= 100 << 20, "{slot_bytes}");
        let ((mut sender, _receiver), (_sender, mut receiver)) = channel_through(memory, mapped);
        let large = vec![1u8; slot_bytes + 1];
        for arrays in [vec![], vec![&large[..]]] {
            let message: &[u8] = if arrays.is_empty() { &large } else { &[] };
            let error = sender.send_with(&message, &arrays).expect_err("too large");
            let error = error.of_job(sender.slot_bytes());
            assert!(
                matches!(error, WorkError::TooLargeToShare { limit_bytes } if limit_bytes == slot_bytes as u64),
                "{error}"
            );
        }
        for number in 0..2 * SLOTS {
            sender.send_with(&number, &[&large[..1 << 20]]).expect("sent");
            let (received, _) = receiver.receive_with::<usize>().expect("a message");
            assert_eq!(received, number);
        }
    }

    #[test]
    fn a_sender_does_not_wait_for_a_process_that_is_gone() {
        let ((mut to_device, from_device), (to_server, from_server)) = channel();
        let large = vec![1u8; 1 << 20];
        for _ in 0..SLOTS {
            to_device.send(&large).expect("a slot is free");
        }
        drop((to_server, from_server));
        assert!(
            to_device.send(&large).is_err(),
            "all slots are in use, and and no process reads them"
        );
        drop(from_device);
    }

    #[test]
    fn what_is_no_message_is_an_error() {
        let headers = [
            (INLINE_BYTES + 1) as u64,
            200 << 56 | 5,
            ((SLOTS as u64 + 1) << 56) | ((1 << 56) - 1),
            // A text that is cut off.
            2,
        ];
        for header in headers {
            let ((mut to_device, _from_device), (_to_server, mut from_server)) = channel();
            to_device.socket.write_all(&u64::to_le_bytes(header)).expect("written");
            to_device.socket.write_all(&[0; 8]).expect("written");
            to_device.socket.write_all(&[9, 9]).expect("written");
            let error = from_server.receive::<String>().expect_err("no message");
            assert_eq!(error.kind(), io::ErrorKind::InvalidData, "{header:x}");
        }
    }
}
