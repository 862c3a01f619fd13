//! The body of an export: written on a blocking thread, as fast as the client reads.

use std::io::{self, Write};
use std::time::Duration;

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

/// What of a file is sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Part {
    /// All of it, in an encoding.
    Whole(ContentEncoding),
    /// From the first of these bytes to the one before the last.
    Range([u64; 2]),
}

/// Sends a part of a file. The permit is held until mesh and thread are released.
pub(super) fn send(file: MadeFile, part: Part, permit: impl Send + 'static) -> Body {
    send_within(file, part, permit, CHUNK_DEADLINE)
}

fn send_within(file: MadeFile, part: Part, permit: impl Send + 'static, deadline: Duration) -> Body {
    let (chunks, mut queue) = mpsc::channel(QUEUED_CHUNKS);
    let runtime = Handle::current();
    tokio::task::spawn_blocking(move || {
        let _permit = permit;
        let chunks = ChunkWriter {
            chunks,
            runtime,
            deadline,
            failed: None,
        };
        let out = io::BufWriter::with_capacity(CHUNK_BYTES, chunks);
        if let Err(error) = write(&file, part, out) {
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

/// Sends each write to the socket's task as one chunk.
struct ChunkWriter {
    chunks: mpsc::Sender<Bytes>,
    runtime: Handle,
    deadline: Duration,
    /// Why a write failed. Then all fail at once: an encoder or a buffer that is dropped writes what it has, and would wait once more.
    failed: Option<io::ErrorKind>,
}

impl Write for ChunkWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if let Some(kind) = self.failed {
            return Err(kind.into());
        }
        let part = &bytes[..bytes.len().min(CHUNK_BYTES)];
        let send = self.chunks.send_timeout(Bytes::copy_from_slice(part), self.deadline);
        let kind = match self.runtime.block_on(send) {
            Ok(()) => return Ok(part.len()),
            Err(mpsc::error::SendTimeoutError::Timeout(_)) => io::ErrorKind::TimedOut,
            Err(mpsc::error::SendTimeoutError::Closed(_)) => io::ErrorKind::BrokenPipe,
        };
        self.failed = Some(kind);
        Err(kind.into())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
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
            let body = send_within(file, Part::Whole(encoding), permit, deadline);
            drop(permit_of(&semaphore).await);
            let mut stream = body.into_data_stream();
            let mut chunks = 0;
            while stream.next().await.is_some() {
                chunks += 1;
            }
            assert!(chunks <= QUEUED_CHUNKS, "{encoding:?}: {chunks}");
        }
    }
}
