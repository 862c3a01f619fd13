//! Zstandard, frame by frame.

use std::io::{self, BufRead, Read};

use ruzstd::decoding::errors::{FrameDecoderError, ReadFrameHeaderError};
use ruzstd::decoding::{BlockDecodingStrategy, DEFAULT_MAX_WINDOW_SIZE, FrameDecoder};

use super::invalid;

/// Window size that is allowed for every file: that of the compressor's level 19. A larger window must be in proportion to the
/// file's size.
const WINDOW: u64 = 8 << 20;
const WINDOW_RATIO: u64 = 64;

/// The frames of a file, one after the other.
pub(super) struct Frames<R> {
    stored: R,
    /// Decoder of the current frame.
    frame: Option<FrameDecoder>,
    max_window: u64,
}

impl<R: BufRead> Frames<R> {
    pub(super) fn new(stored: R, stored_bytes: u64) -> Self {
        let in_proportion = stored_bytes.saturating_mul(WINDOW_RATIO);
        Self {
            stored,
            frame: None,
            max_window: in_proportion.clamp(WINDOW, DEFAULT_MAX_WINDOW_SIZE),
        }
    }

    /// Reads the header of the next frame.
    fn begin(&mut self) -> io::Result<()> {
        let mut decoder = FrameDecoder::new();
        decoder.set_max_window_size(self.max_window);
        match decoder.init(&mut self.stored) {
            Ok(()) => self.frame = Some(decoder),
            Err(FrameDecoderError::ReadFrameHeaderError(ReadFrameHeaderError::SkipFrame { length, .. })) => {
                let length = u64::from(length);
                if io::copy(&mut (&mut self.stored).take(length), &mut io::sink())? < length {
                    return Err(io::ErrorKind::UnexpectedEof.into());
                }
            }
            Err(error) => return Err(broken(&error)),
        }
        Ok(())
    }
}

impl<R: BufRead> Read for Frames<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            let Some(frame) = &mut self.frame else {
                if self.stored.fill_buf()?.is_empty() {
                    return Ok(0);
                }
                self.begin()?;
                continue;
            };
            while frame.can_collect() == 0 && !frame.is_finished() {
                let one = BlockDecodingStrategy::UptoBlocks(1);
                frame.decode_blocks(&mut self.stored, one).map_err(|e| broken(&e))?;
            }
            let n = frame.read(buffer)?;
            if n > 0 || buffer.is_empty() {
                return Ok(n);
            }
            let stated = frame.get_checksum_from_data();
            if stated.is_some() && stated != frame.get_calculated_checksum() {
                return Err(invalid("the checksum of a Zstandard frame is wrong"));
            }
            self.frame = None;
        }
    }
}

fn broken(error: &FrameDecoderError) -> io::Error {
    invalid(error.to_string())
}
