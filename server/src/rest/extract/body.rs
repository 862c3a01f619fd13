//! The body of an export: written on a blocking thread, as fast as the client reads. What a slow client has not read yet goes to a temporary file,
//! so that the mesh and the permit are free for others.

use std::fs::File;
use std::io::{self, Read, Seek, Write};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use axum::body::{Body, Bytes};
use tokio::runtime::Handle;
use tokio::sync::mpsc;

use crate::export::{ExportError, MadeFile};
use crate::rest::content_encoding::ContentEncoding;

/// Bytes of a chunk of the body.
const CHUNK_BYTES: usize = 256 * 1024;
/// Chunks between writer and socket, 1 MiB: on a fast line neither waits for the other.
const QUEUED_CHUNKS: usize = 4;
/// Time after which a client that reads no chunk is disconnected, as on the WebSocket: its mesh takes memory.
const CHUNK_DEADLINE: Duration = Duration::from_secs(20);

/// Time that a client may let the writer wait altogether before the rest is spooled.
const SPOOL_AFTER: Duration = Duration::from_secs(2);
/// Bytes of all temporary files together. A client that finds no space there is waited for, as long as it reads.
const SPOOL_BYTES: u64 = 8 << 30;

/// Bytes that are spooled.
static SPOOLED: AtomicU64 = AtomicU64::new(0);

/// What of a file is sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Part {
    /// All of it, in an encoding.
    Whole(ContentEncoding),
    /// From the first of these bytes to the one before the last.
    Range([u64; 2]),
}

/// Sends a part of a file. The permit is held until the mesh is released: when all is sent, or spooled.
pub(super) fn send(file: MadeFile, part: Part, permit: impl Send + 'static) -> Body {
    send_within(file, part, permit, CHUNK_DEADLINE, SPOOL_AFTER)
}

fn send_within(
    file: MadeFile,
    part: Part,
    permit: impl Send + 'static,
    deadline: Duration,
    patience: Duration,
) -> Body {
    let (chunks, mut queue) = mpsc::channel(QUEUED_CHUNKS);
    let runtime = Handle::current();
    tokio::task::spawn_blocking(move || {
        let mut chunks = ChunkWriter {
            chunks,
            runtime,
            deadline,
            patience,
            spool: None,
            failed: None,
        };
        let written = write(&file, part, io::BufWriter::with_capacity(CHUNK_BYTES, &mut chunks));
        drop((file, permit));
        let sent = written.and_then(|()| Ok(chunks.send_spooled()?));
        if let Err(error) = sent {
            tracing::debug!(
                cause = crate::error::chain(&error),
                "an export was not taken to its end"
            );
        }
    });
    let chunks = futures_util::stream::poll_fn(move |context| {
        queue.poll_recv(context).map(|chunk| chunk.map(Ok::<_, io::Error>))
    });
    Body::from_stream(chunks)
}

fn write(file: &MadeFile, part: Part, out: impl Write) -> Result<(), ExportError> {
    match part {
        Part::Whole(encoding) => encoding.write(out, |mut out| file.write(&mut out)),
        Part::Range([from, to]) => {
            let mut window = Window {
                out,
                skip: from,
                left: to - from,
            };
            match file.write(&mut window) {
                Err(_) if window.left == 0 => {}
                other => other?,
            }
            Ok(window.out.flush()?)
        }
    }
}

/// Passes on some of the bytes that are written, and fails behind the last one of them.
struct Window<W> {
    out: W,
    /// Bytes before the first one.
    skip: u64,
    /// Bytes that are still to be passed on.
    left: u64,
}

impl<W: Write> Write for Window<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.left == 0 {
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        let length = bytes.len() as u64;
        let begin = self.skip.min(length);
        let end = (begin + self.left).min(length);
        self.out.write_all(&bytes[begin as usize..end as usize])?;
        self.skip -= begin;
        self.left -= end - begin;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

/// Sends each write to the socket's task as one chunk, or to a temporary file.
struct ChunkWriter {
    chunks: mpsc::Sender<Bytes>,
    runtime: Handle,
    deadline: Duration,
    /// Time that it still waits before it spools.
    patience: Duration,
    spool: Option<Spool>,
    /// Why a write failed. Then all fail at once: an encoder or a buffer that is dropped writes what it has, and would wait once more.
    failed: Option<io::ErrorKind>,
}

impl ChunkWriter {
    /// Sends a chunk once the client has read enough of those before; false if it does not within the limit.
    fn send(&mut self, chunk: Bytes, limit: Duration) -> io::Result<bool> {
        match self.runtime.block_on(self.chunks.send_timeout(chunk, limit)) {
            Ok(()) => Ok(true),
            Err(mpsc::error::SendTimeoutError::Timeout(_)) => Ok(false),
            Err(mpsc::error::SendTimeoutError::Closed(_)) => Err(self.fail(io::ErrorKind::BrokenPipe)),
        }
    }

    /// As [`ChunkWriter::send`], and fails if the client does not read in time.
    fn send_or_fail(&mut self, chunk: Bytes) -> io::Result<()> {
        match self.send(chunk, self.deadline)? {
            true => Ok(()),
            false => Err(self.fail(io::ErrorKind::TimedOut)),
        }
    }

    fn fail(&mut self, kind: io::ErrorKind) -> io::Error {
        self.failed = Some(kind);
        kind.into()
    }

    /// Sends what was spooled, as the client reads it.
    fn send_spooled(&mut self) -> io::Result<()> {
        let Some(mut spool) = self.spool.take() else {
            return Ok(());
        };
        spool.file.rewind()?;
        let mut left = spool.written;
        while left > 0 {
            let mut chunk = vec![0; CHUNK_BYTES.min(usize::try_from(left).unwrap_or(CHUNK_BYTES))];
            spool.file.read_exact(&mut chunk)?;
            left -= chunk.len() as u64;
            self.send_or_fail(chunk.into())?;
        }
        Ok(())
    }
}

impl Write for ChunkWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if let Some(kind) = self.failed {
            return Err(kind.into());
        }
        let part = &bytes[..bytes.len().min(CHUNK_BYTES)];
        if self.spool.is_none() {
            let start = Instant::now();
            if self.send(Bytes::copy_from_slice(part), self.patience.min(self.deadline))? {
                self.patience = self.patience.saturating_sub(start.elapsed());
                return Ok(part.len());
            }
            // The whole deadline has passed.
            if self.patience >= self.deadline {
                return Err(self.fail(io::ErrorKind::TimedOut));
            }
            self.spool = Spool::begin();
        }
        if !self.spool.as_mut().is_some_and(|spool| spool.take(part)) {
            // Without space the client is waited for, from here on.
            self.send_spooled()?;
            self.send_or_fail(Bytes::copy_from_slice(part))?;
            self.patience = Duration::MAX;
        }
        Ok(part.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A temporary file without a name, whose bytes are counted.
struct Spool {
    file: File,
    written: u64,
    counted: u64,
}

impl Spool {
    /// `None`: no file can be made.
    fn begin() -> Option<Self> {
        let file = tempfile::tempfile().ok()?;
        Some(Self {
            file,
            written: 0,
            counted: 0,
        })
    }

    /// Appends bytes; false if there is no space for them.
    fn take(&mut self, bytes: &[u8]) -> bool {
        let length = bytes.len() as u64;
        self.counted += length;
        let has_space = SPOOLED.fetch_add(length, Ordering::Relaxed) + length <= SPOOL_BYTES;
        let is_taken = has_space && self.file.write_all(bytes).is_ok();
        self.written += if is_taken { length } else { 0 };
        is_taken
    }
}

impl Drop for Spool {
    fn drop(&mut self) {
        SPOOLED.fetch_sub(self.counted, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use futures_util::StreamExt;
    use tokio::sync::{OwnedSemaphorePermit, Semaphore};

    use super::*;
    use crate::export::{Format, Mesh};

    const WHOLE: Part = Part::Whole(ContentEncoding::Identity);

    /// A file of some megabytes: more than the queue of chunks holds.
    fn large_file(format: Format) -> MadeFile {
        MadeFile::of_mesh(large_mesh(), format)
    }

    fn large_mesh() -> Mesh {
        let vertices = 200_000;
        Mesh {
            positions: vec![[1.0; 3]; vertices],
            normals: vec![[0.0, 0.0, 1.0]; vertices],
            smoothness: vec![0.0; vertices],
            feature: vec![0.0; vertices],
            colors: Vec::new(),
            triangles: vec![[0, 1, 2]; vertices],
            level_triangles: [vertices as u64, 0, 0, 0, 0, 0],
            ..Mesh::default()
        }
    }

    async fn permit_of(semaphore: &Arc<Semaphore>) -> OwnedSemaphorePermit {
        Arc::clone(semaphore).acquire_owned().await.unwrap()
    }

    #[tokio::test]
    async fn the_body_is_the_file_and_as_long_as_was_said() {
        let semaphore = Arc::new(Semaphore::new(1));
        for format in [Format::Glb, Format::Ply, Format::Stl] {
            let (made, mut file) = (large_file(format), Vec::new());
            made.write(&mut file).unwrap();
            let digest = made.digest(&|| false).unwrap();
            assert_eq!(digest.bytes, file.len() as u64);
            assert_eq!(digest.hash, xxhash_rust::xxh3::xxh3_128(&file));
            assert!(made.digest(&|| true).is_err(), "cancelled");
            let length = file.len() as u64;
            for [from, to] in [[0, length], [0, 1], [length - 1, length], [77, 5_000_000]] {
                let mut part = Vec::new();
                write(&made, Part::Range([from, to]), &mut part).unwrap();
                assert!(part == file[from as usize..to as usize], "{format:?}: {from} to {to}");
            }
            let body = send(made, WHOLE, permit_of(&semaphore).await);
            let bytes = axum::body::to_bytes(body, usize::MAX).await.unwrap();
            assert!(bytes == file, "{format:?}");
        }
    }

    #[tokio::test]
    async fn a_client_that_leaves_frees_the_mesh_and_its_permit() {
        let semaphore = Arc::new(Semaphore::new(1));
        let body = send(large_file(Format::Stl), WHOLE, permit_of(&semaphore).await);
        let mut stream = body.into_data_stream();
        assert!(stream.next().await.unwrap().is_ok());
        drop(stream);
        // Comes back only when the writer has ended.
        drop(permit_of(&semaphore).await);
    }

    #[tokio::test]
    async fn a_client_that_does_not_read_is_given_up() {
        let semaphore = Arc::new(Semaphore::new(1));
        let deadline = Duration::from_millis(20);
        for encoding in [ContentEncoding::Identity, ContentEncoding::Gzip, ContentEncoding::Zstd] {
            let (file, permit) = (large_file(Format::Stl), permit_of(&semaphore).await);
            let body = send_within(file, Part::Whole(encoding), permit, deadline, Duration::MAX);
            drop(permit_of(&semaphore).await);
            let mut stream = body.into_data_stream();
            let mut chunks = 0;
            while stream.next().await.is_some() {
                chunks += 1;
            }
            assert!(chunks <= QUEUED_CHUNKS, "{encoding:?}: {chunks}");
        }
    }

    #[tokio::test]
    async fn a_slow_client_gets_its_file_and_holds_neither_mesh_nor_permit() {
        let semaphore = Arc::new(Semaphore::new(1));
        let (file, mut expected) = (large_file(Format::Stl), Vec::new());
        file.write(&mut expected).unwrap();
        let permit = permit_of(&semaphore).await;
        let body = send_within(file, WHOLE, permit, CHUNK_DEADLINE, Duration::from_millis(20));
        // It has read nothing yet.
        drop(permit_of(&semaphore).await);
        let bytes = axum::body::to_bytes(body, usize::MAX).await.unwrap();
        assert!(bytes == expected);
    }
}
