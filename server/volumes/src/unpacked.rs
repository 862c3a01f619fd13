//! Files that are compressed as a whole: `.gz`, `.bz2` and `.zst` around a file of any format.
//!
//! Plain samples are decoded as a stream, see `decode`. Everything else is read through [`Unpacked`], which decodes only as far as
//! requested and keeps the decoded bytes: small files in memory, others in a temporary file without a name.

use std::io::{self, ErrorKind, Read, Seek, SeekFrom, Write};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tempfile::SpooledTempFile;

use super::codec::{DEFLATE_RATIO, Encoding, decoder, invalid};
use crate::disk::free_bytes;

/// Decoded bytes that are held in memory.
const IN_MEMORY: usize = 1 << 20;
/// Bytes that are decoded at once.
const PIECE: u64 = 1 << 18;
/// Free space that is left on the disk of temporary files.
pub(super) const RESERVE_BYTES: u64 = 64 << 20;

/// Returns the limit of bytes that `stored` bytes are decoded to if no header states the decoded size: as much as deflate may
/// give, and 64 MiB.
const fn max_decoded(stored: u64) -> u64 {
    stored.saturating_mul(DEFLATE_RATIO).saturating_add(64 << 20)
}

/// Returns the compression that the ending of a file name states, and the name without that ending.
pub(super) fn packing(name: &str) -> Option<(Encoding, &str)> {
    let at = name.rfind('.')?;
    let encoding = match name[at..].to_ascii_lowercase().as_str() {
        ".gz" => Encoding::Deflate,
        ".bz2" => Encoding::Bzip2,
        ".zst" => Encoding::Zstd,
        _ => return None,
    };
    Some((encoding, &name[..at]))
}

/// A compressed file, read as the file inside it.
pub(super) struct Unpacked {
    stored_len: u64,
    stored_read: Arc<AtomicU64>,
    state: Mutex<State>,
}

struct State {
    /// `None` after its end was reached.
    stream: Option<Box<dyn Read + Send>>,
    kept: SpooledTempFile,
    decoded: u64,
    /// The error that ended the stream early.
    failure: Option<(ErrorKind, String)>,
    /// Free space that is left on the disk of temporary files.
    reserve: u64,
}

/// Fills a buffer from an offset of the compressed file.
pub(super) type ReadAt = Box<dyn Fn(&mut [u8], u64) -> io::Result<usize> + Send>;

/// The compressed bytes, counted.
struct Stored {
    read_at: ReadAt,
    offset: u64,
    read: Arc<AtomicU64>,
}

impl Read for Stored {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = (self.read_at)(buffer, self.offset)?;
        self.offset += n as u64;
        self.read.fetch_add(n as u64, Ordering::Relaxed);
        Ok(n)
    }
}

impl Unpacked {
    pub(super) fn new(read_at: ReadAt, stored_len: u64, encoding: Encoding) -> io::Result<Self> {
        let stored_read = Arc::<AtomicU64>::default();
        let read = stored_read.clone();
        let stream = decoder(
            encoding,
            Stored {
                read_at,
                offset: 0,
                read,
            },
            stored_len,
        )?;
        let kept = SpooledTempFile::new(IN_MEMORY);
        let (stream, decoded, failure) = (Some(stream), 0, None);
        let state = Mutex::new(State {
            stream,
            kept,
            decoded,
            failure,
            reserve: RESERVE_BYTES,
        });
        Ok(Self {
            stored_len,
            stored_read,
            state,
        })
    }

    /// Returns the number of bytes of the compressed file that were read.
    pub(super) fn stored_read(&self) -> u64 {
        self.stored_read.load(Ordering::Relaxed)
    }

    /// Returns the decoded length in bytes. Decodes the whole file, a broken file up to its error.
    pub(super) fn len(&self) -> u64 {
        self.decoded_up_to(u64::MAX).decoded
    }

    /// Reads decoded bytes from `offset` on; fewer than requested only at the end.
    pub(super) fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<usize> {
        let mut state = self.decoded_up_to(offset.saturating_add(buffer.len() as u64));
        let have = state.decoded.saturating_sub(offset).min(buffer.len() as u64) as usize;
        if have < buffer.len()
            && let Some((kind, why)) = &state.failure
        {
            return Err(io::Error::new(*kind, why.clone()));
        }
        state.kept.seek(SeekFrom::Start(offset))?;
        state.kept.read_exact(&mut buffer[..have])?;
        Ok(have)
    }

    fn decoded_up_to(&self, end: u64) -> MutexGuard<'_, State> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let limit = max_decoded(self.stored_len);
        while state.decoded < end && state.stream.is_some() {
            match state.decode(limit) {
                Ok(0) => state.stream = None,
                Ok(_) => {}
                Err(error) => {
                    state.failure = Some((error.kind(), error.to_string()));
                    state.stream = None;
                }
            }
        }
        state
    }
}

impl State {
    /// Decodes one piece.
    fn decode(&mut self, limit: u64) -> io::Result<u64> {
        let Some(stream) = &mut self.stream else { return Ok(0) };
        let mut piece = Vec::new();
        let read = stream.take(PIECE).read_to_end(&mut piece);
        // Bytes that were decoded before an error are valid.
        self.keep(&piece).map_err(of_space)?;
        self.decoded += piece.len() as u64;
        read?;
        if self.decoded > limit {
            return Err(invalid(format!(
                "the compressed file holds more than {limit} bytes, which is not plausible"
            )));
        }
        Ok(piece.len() as u64)
    }

    fn keep(&mut self, piece: &[u8]) -> io::Result<()> {
        if self.decoded + piece.len() as u64 > IN_MEMORY as u64
            && free_bytes(&std::env::temp_dir())? < self.reserve.saturating_add(piece.len() as u64)
        {
            return Err(ErrorKind::StorageFull.into());
        }
        self.kept.seek(SeekFrom::Start(self.decoded))?;
        self.kept.write_all(piece)
    }
}

/// The error for a temporary file that cannot be written: it is no fault of the compressed file.
pub(super) fn of_space(error: io::Error) -> io::Error {
    let why = format!("the folder of temporary files, which TMPDIR names, has no space to decompress it ({error})");
    io::Error::new(ErrorKind::StorageFull, why)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::FileLocation;

    fn gzip(bytes: &[u8]) -> Vec<u8> {
        let mut out = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        out.write_all(bytes).unwrap();
        out.finish().unwrap()
    }

    fn location(bytes: Vec<u8>) -> FileLocation {
        FileLocation::bytes("a.tif.gz", bytes).packed(Encoding::Deflate)
    }

    #[test]
    fn what_the_disk_of_temporary_files_lacks_is_no_fault_of_the_file() {
        let packed = gzip(&vec![7; 3 << 20]);
        let len = packed.len() as u64;
        let read_at = move |buffer: &mut [u8], at: u64| (&packed[packed.len().min(at as usize)..]).read(buffer);
        let unpacked = Unpacked::new(Box::new(read_at), len, Encoding::Deflate).unwrap();
        unpacked.state.lock().unwrap().reserve = u64::MAX;
        let mut head = [0; 1000];
        assert_eq!(
            unpacked.read_at(&mut head, 0).unwrap(),
            1000,
            "small files are held in memory"
        );
        let full = unpacked.read_at(&mut head, 2 << 20).unwrap_err();
        assert_eq!(full.kind(), ErrorKind::StorageFull);
        assert!(full.to_string().contains("TMPDIR"), "{full}");
    }

    #[test]
    fn a_head_is_read_without_decoding_all() {
        let noise: Vec<u8> = (0..9_000_000u64)
            .map(|i| (i.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 56) as u8)
            .collect();
        let packed = location(gzip(&noise));
        let blob = packed.open().unwrap();
        assert_eq!(blob.head(1000).unwrap(), noise[..1000]);
        assert!(blob.stored_read() < 2 << 20, "{}", blob.stored_read());
        let mut middle = [0; 100];
        blob.read_exact_at(&mut middle, 5_000_000).unwrap();
        assert_eq!(middle, noise[5_000_000..5_000_100]);
        assert_eq!(blob.len(), noise.len() as u64);
    }

    #[test]
    fn a_broken_stream_says_so_where_it_breaks() {
        let noise: Vec<u8> = (0..9_000_000u64)
            .map(|i| (i.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 56) as u8)
            .collect();
        let mut bytes = gzip(&noise);
        bytes.truncate(bytes.len() / 2);
        let packed = location(bytes);
        let blob = packed.open().unwrap();
        assert!(blob.head(1000).is_ok());
        assert!(blob.read_exact_at(&mut [0; 9], 8_000_000).is_err());
    }

    #[test]
    fn a_bomb_stops() {
        // Zeros in gzip in gzip: 1 GiB would be 1 MiB, then a few kB.
        let mut bomb = Vec::new();
        for _ in 0..4 {
            bomb.extend(gzip(&vec![0; 32 << 20]));
        }
        let packed = location(bomb.clone());
        assert_eq!(packed.open().unwrap().len(), 128 << 20);
        assert!(max_decoded(bomb.len() as u64) > 128 << 20);
        let len = bomb.len() as u64;
        let read_at: ReadAt = Box::new(move |mut buffer, at| buffer.write(&bomb[at as usize..]));
        let state = Unpacked::new(read_at, len, Encoding::Deflate).unwrap();
        let mut state = state.state.into_inner().unwrap();
        assert!(state.decode(1 << 10).is_err());
    }
}
