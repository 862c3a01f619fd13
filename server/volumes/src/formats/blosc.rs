//! Blosc 1 (<https://github.com/Blosc/c-blosc/blob/main/README_CHUNK_FORMAT.rst>): blocks, each shuffled and
//! compressed.
//!
//! Read: no compressor, BloscLZ, LZ4, zlib, Zstandard; bytes or bits shuffled. Its library is in C and trusts its
//! input.

use crate::codec::{decoded, lz4_block};
use crate::stored::Encoding;

const HEADER_BYTES: usize = 16;
/// Flags of the header.
const SHUFFLE_BYTES: u8 = 1;
const COPIED: u8 = 2;
const SHUFFLE_BITS: u8 = 4;
const WHOLE_BLOCKS: u8 = 16;
/// A whole block is compressed in as many parts as a sample has bytes, if these are at most `MAX_PARTS` and each part has at least
/// `MIN_PART_BYTES`; else in one part.
const MAX_PARTS: usize = 16;
const MIN_PART_BYTES: usize = 128;

/// Decodes a buffer of at most `limit` bytes.
pub fn decode(stored: &[u8], limit: usize) -> Result<Vec<u8>, String> {
    let header = stored.get(..HEADER_BYTES).ok_or("too short for a header of Blosc")?;
    let (flags, width) = (header[2], usize::from(header[3]).max(1));
    let [total, block, packed] = [4, 8, 12].map(|at| number(header, at));
    if header[0] != 2 {
        return Err(format!("version {} of Blosc's format, expected 2", header[0]));
    }
    if total > limit || packed > stored.len() {
        return Err(format!(
            "{total} bytes from {packed}, expected {limit} at most from {}",
            stored.len()
        ));
    }
    if flags & COPIED != 0 {
        let bytes = stored.get(HEADER_BYTES..HEADER_BYTES + total);
        return bytes.map(<[u8]>::to_vec).ok_or_else(|| "ends too early".to_owned());
    }
    if block == 0 && total > 0 {
        return Err("blocks of no bytes".to_owned());
    }
    let mut bytes = Vec::new();
    for i in 0..total.div_ceil(block.max(1)) {
        let begin = stored.get(HEADER_BYTES + 4 * i..).filter(|rest| rest.len() >= 4);
        let begin = number(begin.ok_or("ends in the list of blocks")?, 0);
        let size = block.min(total - bytes.len());
        let parts =
            if flags & WHOLE_BLOCKS == 0 && size == block && width <= MAX_PARTS && block / width >= MIN_PART_BYTES {
                width
            } else {
                1
            };
        let mut rest = stored.get(begin..).ok_or("a block begins behind the end")?;
        let mut plain = Vec::new();
        for _ in 0..parts {
            part(&mut rest, flags >> 5, size / parts, &mut plain)?;
        }
        if plain.len() != size {
            return Err(format!("a block of {} bytes, expected {size}", plain.len()));
        }
        bytes.extend(unshuffled(plain, flags, width));
    }
    Ok(bytes)
}

fn number(bytes: &[u8], at: usize) -> usize {
    u32::from_le_bytes(std::array::from_fn(|i| bytes[at + i])) as usize
}

/// Decodes one part of a block: its length, then that many bytes.
fn part(rest: &mut &[u8], compressor: u8, size: usize, plain: &mut Vec<u8>) -> Result<(), String> {
    let (length, after) = rest.split_first_chunk().ok_or("ends before a part of a block")?;
    let (packed, after) = after
        .split_at_checked(u32::from_le_bytes(*length) as usize)
        .ok_or("ends in a part of a block")?;
    *rest = after;
    if packed.len() == size {
        plain.extend(packed);
        return Ok(());
    }
    let bytes = match compressor {
        0 => blosclz(packed, size)?,
        1 => lz4_block(packed, size)?,
        3 => decoded(Encoding::Deflate, packed, size)?,
        4 => decoded(Encoding::Zstd, packed, size)?,
        2 => return Err("compressed by Snappy, expected BloscLZ, LZ4, zlib or Zstandard".to_owned()),
        other => return Err(format!("compressor {other}, expected BloscLZ, LZ4, zlib or Zstandard")),
    };
    if bytes.len() != size {
        return Err(format!("a part of {} bytes or more, expected {size}", bytes.len()));
    }
    plain.extend(bytes);
    Ok(())
}

/// Undoes the shuffling: returns the bytes of each sample side by side.
fn unshuffled(mut plain: Vec<u8>, flags: u8, width: usize) -> Vec<u8> {
    let count = plain.len() / width;
    if flags & SHUFFLE_BYTES != 0 && width > 1 {
        return unshuffled_bytes(&plain, width);
    }
    if flags & SHUFFLE_BITS != 0 && count > 0 && count.is_multiple_of(8) {
        let bytes = unshuffled_bits(&plain[..count * width], width);
        plain[..count * width].copy_from_slice(&bytes);
    }
    plain
}

/// Undoes the shuffling of bytes: the first bytes of all samples, of `width` bytes, come first. Bytes after the last whole sample stay.
pub fn unshuffled_bytes(plain: &[u8], width: usize) -> Vec<u8> {
    let count = plain.len() / width;
    let mut bytes = plain.to_vec();
    for (byte, plane) in plain.chunks_exact(count.max(1)).take(width).enumerate() {
        for (i, &value) in plane.iter().enumerate() {
            bytes[i * width + byte] = value;
        }
    }
    bytes
}

/// Undoes the shuffling of bits: the first bits of all samples come first. The samples, of `width` bytes, are a multiple of 8.
pub fn unshuffled_bits(plain: &[u8], width: usize) -> Vec<u8> {
    let eighths = plain.len() / width / 8;
    let mut bytes = vec![0; plain.len()];
    for byte in 0..width {
        let planes = &plain[8 * byte * eighths..];
        for eighth in 0..eighths {
            let rows = std::array::from_fn(|bit| planes[bit * eighths + eighth]);
            let samples = transposed(u64::from_le_bytes(rows)).to_le_bytes();
            for (i, value) in samples.into_iter().enumerate() {
                bytes[(8 * eighth + i) * width + byte] = value;
            }
        }
    }
    bytes
}

/// Transposes 8 rows of 8 bits, by swapping ever larger squares across the diagonal.
fn transposed(mut bits: u64) -> u64 {
    for (distance, mask) in [
        (7, 0x00aa_00aa_00aa_00aa),
        (14, 0x0000_cccc_0000_cccc),
        (28, 0x0000_0000_f0f0_f0f0),
    ] {
        let swapped = (bits ^ bits >> distance) & mask;
        bits ^= swapped ^ swapped << distance;
    }
    bits
}

/// Distances from this one on are written in 16 bits.
const FAR: usize = 8191;

/// Decodes BloscLZ: runs of literal bytes, and copies of earlier bytes.
fn blosclz(packed: &[u8], size: usize) -> Result<Vec<u8>, String> {
    let mut stored = packed.iter().copied();
    let mut next = || stored.next().map(usize::from).ok_or("ends in a code of BloscLZ");
    let mut bytes: Vec<u8> = Vec::new();
    let mut code = next()? & 31;
    loop {
        if code < 32 {
            for _ in 0..=code {
                bytes.push(next()? as u8);
            }
        } else {
            let mut length = (code >> 5) + 2;
            if length == 9 {
                loop {
                    let more = next()?;
                    length += more;
                    if more < 255 {
                        break;
                    }
                }
            }
            let (high, low) = ((code & 31) << 8, next()?);
            let distance = if low == 255 && high == 31 << 8 {
                FAR + 1 + (next()? << 8 | next()?)
            } else {
                high + low + 1
            };
            let from = bytes
                .len()
                .checked_sub(distance)
                .ok_or("a copy from before the start")?;
            if bytes.len() + length > size {
                return Err(format!("more than {size} bytes of BloscLZ"));
            }
            for i in from..from + length {
                bytes.push(bytes[i]);
            }
        }
        if bytes.len() > size {
            return Err(format!("more than {size} bytes of BloscLZ"));
        }
        match next() {
            Ok(value) => code = value,
            Err(_) => return Ok(bytes),
        }
    }
}
