//! Bitshuffle (<https://github.com/kiyo-masui/bitshuffle>): blocks of samples whose bits are shuffled, each compressed by LZ4 or Zstandard, or
//! plain.

use super::super::blosc::unshuffled_bits;
use crate::codec::{decoded, lz4_block};
use crate::stored::Encoding;

/// Bytes of a plain block if the filter does not state its samples, and the minimum of samples in it.
const BLOCK_BYTES: usize = 8192;
const MIN_BLOCK: usize = 128;
/// Maximum bytes of a sample.
const MAX_WIDTH: usize = 64;
/// Numbers of the compressors.
const LZ4: u32 = 2;
const ZSTD: u32 = 3;

/// Decodes a chunk of at most `limit` bytes. `properties`: those of the filter, which are two versions, the bytes of a sample, the samples
/// in a block and the compressor.
pub fn decode(stored: &[u8], properties: &[u32], limit: usize) -> Result<Vec<u8>, String> {
    let property = |number: usize| properties.get(number).copied().unwrap_or(0);
    let (width, compressor) = (property(2) as usize, property(4));
    if !(1..=MAX_WIDTH).contains(&width) {
        return Err(format!("samples of {width} bytes, expected 1 to {MAX_WIDTH}"));
    }
    let mut rest = stored;
    let (total, block) = match (compressor, property(3) as usize) {
        (0, 0) => (
            stored.len(),
            (BLOCK_BYTES / width / 8 * 8).max(MIN_BLOCK).saturating_mul(width),
        ),
        (0, samples) => (stored.len(), samples.saturating_mul(width)),
        (LZ4 | ZSTD, _) => (number(&mut rest, 8)?, number(&mut rest, 4)?),
        (other, _) => return Err(format!("compressor {other}, expected none, 2 (LZ4) or 3 (Zstandard)")),
    };
    // Samples are shuffled 8 at a time.
    let eight = 8 * width;
    if total > limit || block == 0 || !block.is_multiple_of(eight) {
        return Err(format!(
            "{total} bytes in blocks of {block}, expected {limit} bytes at most in multiples of {eight}"
        ));
    }
    let shuffled = total - total % eight;
    let mut bytes = Vec::new();
    while bytes.len() < shuffled {
        let size = block.min(shuffled - bytes.len());
        let length = if compressor == 0 { size } else { number(&mut rest, 4)? };
        let packed = take(&mut rest, length)?;
        let plain = match compressor {
            LZ4 => lz4_block(packed, size)?,
            ZSTD => decoded(Encoding::Zstd, packed, size)?,
            _ => packed.to_vec(),
        };
        if plain.len() != size {
            return Err(format!("a block of {} bytes, expected {size}", plain.len()));
        }
        bytes.extend(unshuffled_bits(&plain, width));
    }
    bytes.extend(take(&mut rest, total - shuffled)?);
    Ok(bytes)
}

fn take<'a>(rest: &mut &'a [u8], length: usize) -> Result<&'a [u8], String> {
    let (bytes, after) = rest.split_at_checked(length).ok_or("ends too early")?;
    *rest = after;
    Ok(bytes)
}

/// Returns a big-endian number.
fn number(rest: &mut &[u8], length: usize) -> Result<usize, String> {
    let number = take(rest, length)?
        .iter()
        .fold(0u64, |n, &byte| n << 8 | u64::from(byte));
    Ok(usize::try_from(number).unwrap_or(usize::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 8 bytes, 0 to 7: their lowest bits first. Then one that is not shuffled.
    const SHUFFLED: [u8; 9] = [0b1010_1010, 0b1100_1100, 0b1111_0000, 0, 0, 0, 0, 0, 9];

    fn of(compressor: u32, stored: &[u8]) -> Result<Vec<u8>, String> {
        decode(stored, &[0, 5, 1, 8, compressor], 9)
    }

    /// A block of LZ4 of 8 literal bytes.
    fn lz4(total: u64, block: u32, length: u32) -> Vec<u8> {
        let header = [&total.to_be_bytes()[..], &block.to_be_bytes(), &length.to_be_bytes()].concat();
        [&header[..], &[0x80], &SHUFFLED].concat()
    }

    #[test]
    fn bits_are_put_side_by_side_again() {
        let plain = vec![0, 1, 2, 3, 4, 5, 6, 7, 9];
        assert_eq!(of(0, &SHUFFLED), Ok(plain.clone()));
        assert_eq!(of(LZ4, &lz4(9, 8, 9)), Ok(plain));
    }

    #[test]
    fn false_claims_are_refused() {
        for (what, stored) in [
            ("more than a chunk", lz4(1 << 60, 8, 9)),
            ("no block", lz4(9, 0, 9)),
            ("a block of no multiple of 8", lz4(9, 7, 9)),
            ("another length", lz4(8, 8, 4)),
            ("a length beyond the end", lz4(9, 8, u32::MAX)),
            ("no end", lz4(9, 8, 9)[..21].to_vec()),
            ("no header", vec![0; 11]),
        ] {
            assert!(of(LZ4, &stored).is_err(), "{what}");
        }
        assert!(of(1, &SHUFFLED).is_err());
        assert!(decode(&SHUFFLED, &[0, 5, 0, 8, 0], 9).is_err());
        assert!(decode(&SHUFFLED, &[], 9).is_err());
    }
}
