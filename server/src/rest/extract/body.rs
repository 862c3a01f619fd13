//! The body of an export. A blocking thread writes the file as fast as the client reads. For a slow client, the thread writes the rest to a
//! temporary file, so that memory, permit and thread are free for other requests.

use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use axum::body::{Body, Bytes};
use tokio::runtime::Handle;
use tokio::sync::mpsc;

use super::spool::{Spool, SpoolFolder};
use crate::export::{ExportError, FileContent};
use crate::rest::content_encoding::ContentEncoding;

/// Maximum bytes of a chunk of the body.
const CHUNK_BYTES: usize = 256 * 1024;
/// Maximum number of chunks that are queued between writer and socket: 1 MiB, enough that they do not wait for each other on a fast
/// connection.
const QUEUED_CHUNKS: usize = 4;
/// A client that reads no chunk for this long is disconnected, because its spooled file occupies space. The stream has the same limit.
const CHUNK_DEADLINE: Duration = Duration::from_secs(20);

/// Total time that the writer waits for a client before it spools the rest.
const SPOOL_AFTER: Duration = Duration::from_secs(2);

/// The part of a file that is sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Part {
    /// The whole file, in an encoding.
    Whole(ContentEncoding),
    /// The bytes from the first position up to but not including the second.
    Range([u64; 2]),
}

/// Returns a body that sends a part of a file. Drops the permit together with the mesh, when all bytes are sent or spooled.
pub(super) fn send(file: FileContent, part: Part, permit: impl Send + 'static, spool: SpoolFolder) -> Body {
    let patience = Patience {
        deadline: CHUNK_DEADLINE,
        spool_after: SPOOL_AFTER,
    };
    send_with(file, part, permit, spool, patience)
}

/// How long the writer waits for a client.
#[derive(Clone, Copy)]
struct Patience {
    /// Maximum wait for a single chunk.
    deadline: Duration,
    /// Maximum total wait; then the writer spools the rest.
    spool_after: Duration,
}

fn send_with(
    file: FileContent,
    part: Part,
    permit: impl Send + 'static,
    spool_folder: SpoolFolder,
    patience: Patience,
) -> Body {
    let (chunks, mut queue) = mpsc::channel(QUEUED_CHUNKS);
    let writer = ChunkWriter {
        chunks: chunks.clone(),
        runtime: Handle::current(),
        deadline: patience.deadline,
        patience: patience.spool_after,
        spool_folder,
        spool: None,
        failed: None,
    };
    let is_complete = Arc::new(AtomicBool::new(false));
    let all_sent = Arc::clone(&is_complete);
    tokio::spawn(async move {
        // This task drops the last sender after it has set `all_sent`, so that the receiver can distinguish a complete body from a
        // truncated one.
        match write_and_send((file, permit), part, writer, &chunks).await {
            Ok(()) => all_sent.store(true, Ordering::Release),
            Err(error) => tracing::debug!(
                cause = crate::error::chain(&error),
                "an export was not taken to its end"
            ),
        }
    });
    let mut has_ended = false;
    let chunks = futures_util::stream::poll_fn(move |context| {
        queue.poll_recv(context).map(|chunk| {
            let is_truncated = chunk.is_none() && !has_ended && !is_complete.load(Ordering::Acquire);
            has_ended = chunk.is_none();
            // Ends a truncated body with an error. Otherwise a compressed body, which has no declared length, would look complete.
            let error = is_truncated.then(|| Err(io::Error::from(io::ErrorKind::BrokenPipe)));
            chunk.map(Ok).or(error)
        })
    });
    Body::from_stream(chunks)
}

/// Writes a part of a file on a blocking thread, then sends the spooled bytes.
async fn write_and_send(
    (file, permit): (FileContent, impl Send + 'static),
    part: Part,
    mut writer: ChunkWriter,
    chunks: &mpsc::Sender<Bytes>,
) -> Result<(), ExportError> {
    let deadline = writer.deadline;
    let task = tokio::task::spawn_blocking(move || {
        let written = write(&file, part, io::BufWriter::with_capacity(CHUNK_BYTES, &mut writer));
        drop((file, permit));
        written.map(|()| writer.spool)
    });
    match task.await.map_err(io::Error::from)?? {
        Some(spool) => Ok(send_spooled(spool, chunks, deadline).await?),
        None => Ok(()),
    }
}

/// Sends spooled bytes as fast as the client reads. Occupies a blocking thread only while it reads a chunk from the file.
async fn send_spooled(mut spool: Spool, chunks: &mpsc::Sender<Bytes>, deadline: Duration) -> io::Result<()> {
    loop {
        let task = tokio::task::spawn_blocking(move || {
            let chunk = spool.next_chunk(CHUNK_BYTES);
            (spool, chunk)
        });
        let (returned_spool, chunk) = task.await?;
        let Some(chunk) = chunk? else { return Ok(()) };
        spool = returned_spool;
        let sent = chunks.send_timeout(chunk, deadline).await;
        sent.map_err(|error| match error {
            mpsc::error::SendTimeoutError::Timeout(_) => io::ErrorKind::TimedOut,
            mpsc::error::SendTimeoutError::Closed(_) => io::ErrorKind::BrokenPipe,
        })?;
    }
}

fn write(file: &FileContent, part: Part, out: impl Write) -> Result<(), ExportError> {
    match part {
        Part::Whole(encoding) => encoding.write(out, |mut out| file.write(&mut out)),
        Part::Range([from, to]) => {
            let mut window = Window {
                out,
                skip: from,
                left: to - from,
            };
            match file.write(&mut window) {
                // The window fails on purpose after the last byte of the range.
                Err(_) if window.left == 0 => {}
                other => other?,
            }
            Ok(window.out.flush()?)
        }
    }
}

/// Writer that forwards only a range of the bytes. Fails after the last byte of the range, so that the rest of the file is not made.
struct Window<W> {
    out: W,
    /// Bytes to skip before the range begins.
    skip: u64,
    /// Bytes of the range that were not forwarded yet.
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

/// Writer that sends each write as a chunk to the task of the socket, or appends it to a temporary file.
struct ChunkWriter {
    chunks: mpsc::Sender<Bytes>,
    runtime: Handle,
    /// Maximum wait for a single chunk.
    deadline: Duration,
    /// Rest of the total wait before the writer spools.
    patience: Duration,
    spool_folder: SpoolFolder,
    spool: Option<Spool>,
    /// Error of an earlier write. All later writes fail with this error at once. Otherwise an encoder or buffer, which flushes when it is
    /// dropped, would wait for the client once more.
    failed: Option<io::ErrorKind>,
}

impl ChunkWriter {
    /// Sends a chunk when the queue has space. Returns false if the queue has no space for `limit`.
    fn send(&mut self, chunk: Bytes, limit: Duration) -> io::Result<bool> {
        match self.runtime.block_on(self.chunks.send_timeout(chunk, limit)) {
            Ok(()) => Ok(true),
            Err(mpsc::error::SendTimeoutError::Timeout(_)) => Ok(false),
            Err(mpsc::error::SendTimeoutError::Closed(_)) => Err(self.fail(io::ErrorKind::BrokenPipe)),
        }
    }

    fn fail(&mut self, kind: io::ErrorKind) -> io::Error {
        self.failed = Some(kind);
        kind.into()
    }

    /// Appends bytes to the temporary file. If that fails, logs a warning, and the export ends.
    fn spool(&mut self, part: &[u8]) -> io::Result<()> {
        let spooled = match &mut self.spool {
            Some(spool) => spool.append(part),
            None => self.spool_folder.create_file().and_then(|mut spool| {
                spool.append(part)?;
                self.spool = Some(spool);
                Ok(())
            }),
        };
        spooled.map_err(|error| {
            tracing::warn!(
                "an export ends early, as its client reads it slowly and the rest cannot be spooled: {error}"
            );
            self.fail(error.kind())
        })
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
            // Here the wait was limited by the deadline for one chunk, not by the patience.
            if self.patience >= self.deadline {
                return Err(self.fail(io::ErrorKind::TimedOut));
            }
        }
        self.spool(part)?;
        Ok(part.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use futures_util::StreamExt;
    use tokio::sync::{OwnedSemaphorePermit, Semaphore};

    use super::*;
    use crate::export::{Format, Mesh};

    const WHOLE: Part = Part::Whole(ContentEncoding::Identity);

    /// A file of some megabytes: more than the queue of chunks holds.
    fn large_file(format: Format) -> FileContent {
        FileContent::of_mesh(large_mesh(), format)
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
            let (content, mut file) = (large_file(format), Vec::new());
            content.write(&mut file).unwrap();
            let digest = content.digest(&|| false).unwrap();
            assert_eq!(digest.bytes, file.len() as u64);
            assert_eq!(digest.hash, xxhash_rust::xxh3::xxh3_128(&file));
            assert!(content.digest(&|| true).is_err(), "cancelled");
            let length = file.len() as u64;
            for [from, to] in [[0, length], [0, 1], [length - 1, length], [77, 5_000_000]] {
                let mut part = Vec::new();
                write(&content, Part::Range([from, to]), &mut part).unwrap();
                assert!(part == file[from as usize..to as usize], "{format:?}: {from} to {to}");
            }
            let body = send(content, WHOLE, permit_of(&semaphore).await, SpoolFolder::default());
            let bytes = axum::body::to_bytes(body, usize::MAX).await.unwrap();
            assert!(bytes == file, "{format:?}");
        }
    }

    #[tokio::test]
    async fn a_client_that_leaves_frees_the_mesh_and_its_permit() {
        let semaphore = Arc::new(Semaphore::new(1));
        let permit = permit_of(&semaphore).await;
        let body = send(large_file(Format::Stl), WHOLE, permit, SpoolFolder::default());
        let mut stream = body.into_data_stream();
        assert!(stream.next().await.unwrap().is_ok());
        drop(stream);
        // Comes back only when the writer has ended.
        drop(permit_of(&semaphore).await);
    }

    #[tokio::test]
    async fn a_client_that_does_not_read_is_given_up() {
        let semaphore = Arc::new(Semaphore::new(1));
        let patience = Patience {
            deadline: Duration::from_millis(20),
            spool_after: Duration::MAX,
        };
        for encoding in [ContentEncoding::Identity, ContentEncoding::Gzip, ContentEncoding::Zstd] {
            let (file, permit) = (large_file(Format::Stl), permit_of(&semaphore).await);
            let body = send_with(file, Part::Whole(encoding), permit, SpoolFolder::default(), patience);
            drop(permit_of(&semaphore).await);
            let chunks: Vec<_> = body.into_data_stream().collect().await;
            let read = chunks.iter().filter(|chunk| chunk.is_ok()).count();
            assert!(read <= QUEUED_CHUNKS, "{encoding:?}: {read}");
            // Compressed, this file may fit into the queue.
            let is_cut_off = read == QUEUED_CHUNKS;
            assert!(is_cut_off || encoding != ContentEncoding::Identity);
            assert_eq!(chunks.last().unwrap().is_err(), is_cut_off, "{encoding:?}");
        }
    }

    const SLOW: Patience = Patience {
        deadline: CHUNK_DEADLINE,
        spool_after: Duration::from_millis(20),
    };

    #[tokio::test]
    async fn without_space_for_a_slow_client_its_export_ends_with_an_error() {
        let (semaphore, folder) = (Arc::new(Semaphore::new(1)), std::env::temp_dir());
        let space = SpoolFolder::limited(folder.clone(), 1 << 20);
        let (file, permit) = (large_file(Format::Stl), permit_of(&semaphore).await);
        let body = send_with(file, WHOLE, permit, space.clone(), SLOW);
        drop(permit_of(&semaphore).await);
        assert!(axum::body::to_bytes(body, usize::MAX).await.is_err());
        let all = vec![0; 1 << 20];
        assert!(
            space.create_file().unwrap().append(&all).is_ok(),
            "what it took is free again"
        );
        let mut spool = space.create_file().unwrap();
        spool.append(&all).unwrap();
        let error = spool.append(&[0]).unwrap_err().to_string();
        assert!(error.contains("take 1048576 of 1048576 bytes"), "{error}");
        let gone = SpoolFolder::new(folder.join("none-of-this-name"));
        let (file, permit) = (large_file(Format::Stl), permit_of(&semaphore).await);
        let body = send_with(file, WHOLE, permit, gone, SLOW);
        drop(permit_of(&semaphore).await);
        assert!(axum::body::to_bytes(body, usize::MAX).await.is_err());
    }

    #[tokio::test]
    async fn a_slow_client_gets_its_file_and_holds_neither_mesh_nor_permit() {
        let semaphore = Arc::new(Semaphore::new(1));
        let (file, mut expected) = (large_file(Format::Stl), Vec::new());
        file.write(&mut expected).unwrap();
        let permit = permit_of(&semaphore).await;
        let body = send_with(file, WHOLE, permit, SpoolFolder::default(), SLOW);
        // It has read nothing yet.
        drop(permit_of(&semaphore).await);
        let bytes = axum::body::to_bytes(body, usize::MAX).await.unwrap();
        assert!(bytes == expected);
    }
}
