//! Decodes a chunk to samples: x fastest, then y, z, channel.

use std::io::Read;
use std::panic::{AssertUnwindSafe, catch_unwind};

use jpeg_decoder::{CodingProcess, Decoder, PixelFormat};

use super::{Info, Scale};
use crate::codec::decoder;
use crate::formats::jpeg::{check_progressive, check_scans};
use crate::stored::{self, StoredType};

/// First bytes of gzip.
const GZIP: [u8; 2] = [0x1f, 0x8b];

/// Encoding of the samples of a chunk.
#[derive(Clone, Debug)]
pub(super) enum Encoding {
    Raw,
    Jpeg,
    /// Labels in blocks of this many voxels, each of which has a table.
    CompressedSegmentation([u64; 3]),
}

/// Size of a chunk in voxels, and the samples of a voxel.
#[derive(Clone, Copy)]
pub(super) struct Shape {
    pub(super) size: [u64; 3],
    pub(super) channels: u32,
    /// Bytes of a sample.
    pub(super) width: usize,
}

impl Shape {
    pub(super) fn voxels(&self) -> u64 {
        self.size.iter().product()
    }

    pub(super) fn bytes(&self) -> u64 {
        self.voxels() * u64::from(self.channels) * self.width as u64
    }
}

impl Encoding {
    pub(super) fn of(scale: &Scale, info: &Info, stored: StoredType) -> Result<Self, String> {
        match scale.encoding.to_ascii_lowercase().as_str() {
            "raw" => Ok(Self::Raw),
            "jpeg" if stored == StoredType::U8 && matches!(info.num_channels, 1 | 3) => Ok(Self::Jpeg),
            "jpeg" => Err(format!(
                "jpeg of {} channels of {}, expected 1 or 3 of uint8",
                info.num_channels, info.data_type
            )),
            "compressed_segmentation" if matches!(stored, StoredType::U32 | StoredType::U64) => {
                match scale.compressed_segmentation_block_size {
                    // The size of blocks is limited, so that their voxels can be counted in 64 bits.
                    Some(block) if block.iter().all(|n| (1..=1024).contains(n)) => {
                        Ok(Self::CompressedSegmentation(block))
                    }
                    other => Err(format!(
                        "compressed_segmentation_block_size {other:?}, expected three numbers from 1 to 1024"
                    )),
                }
            }
            "compressed_segmentation" => Err(format!(
                "compressed_segmentation of {}, expected uint32 or uint64",
                info.data_type
            )),
            other => Err(format!("{other:?}, expected raw, jpeg or compressed_segmentation")),
        }
    }

    /// Decodes the samples of a chunk, whose stored bytes may also be compressed as a whole.
    pub(super) fn decode(&self, stored: Vec<u8>, shape: Shape) -> Result<Vec<u8>, String> {
        let expected = shape.bytes() as usize;
        let is_raw = matches!(self, Self::Raw);
        let packed = stored.starts_with(&GZIP) && !(is_raw && stored.len() == expected);
        let stored = if packed {
            gunzip(&stored, max_stored(shape))?
        } else {
            stored
        };
        match self {
            Self::Raw if stored.len() == expected => Ok(stored),
            Self::Raw => Err(format!("{} bytes of samples, expected {expected}", stored.len())),
            Self::Jpeg => {
                // The library panics on some invalid images; no other state is involved.
                let decoded = catch_unwind(AssertUnwindSafe(|| jpeg(&stored, shape)));
                decoded.unwrap_or_else(|_| Err("a false JPEG, its decoder gave up".to_owned()))
            }
            Self::CompressedSegmentation(block) => labels(&stored, *block, shape),
        }
    }
}

/// Returns the maximum bytes of a stored chunk. Far more than the samples is invalid; for small chunks, tables of labels take more.
pub(super) fn max_stored(shape: Shape) -> u64 {
    shape.bytes().saturating_mul(4).saturating_add(1 << 16)
}

/// Decodes gzip to at most `limit` bytes.
pub(super) fn gunzip(packed: &[u8], limit: u64) -> Result<Vec<u8>, String> {
    let stream = decoder(stored::Encoding::Deflate, packed, packed.len() as u64);
    let mut bytes = Vec::new();
    let read = stream.and_then(|stream| stream.take(limit + 1).read_to_end(&mut bytes));
    read.map_err(|e| e.to_string())?;
    if bytes.len() as u64 > limit {
        return Err(format!("more than {limit} bytes in gzip"));
    }
    Ok(bytes)
}

/// Decodes an image of any width whose rows, one after the other, are the voxels.
fn jpeg(encoded: &[u8], shape: Shape) -> Result<Vec<u8>, String> {
    check_scans(encoded)?;
    let failed = |e: jpeg_decoder::Error| format!("no JPEG that is read: {e}");
    let mut decoder = Decoder::new(encoded);
    decoder.set_max_decoding_buffer_size(2 * shape.bytes() as usize);
    decoder.read_info().map_err(failed)?;
    let info = decoder.info().ok_or("no JPEG")?;
    let pixels = u64::from(info.width) * u64::from(info.height);
    let channels = match info.pixel_format {
        PixelFormat::L8 => 1,
        PixelFormat::RGB24 => 3,
        other => return Err(format!("a JPEG of {other:?}, expected 8 bits of grey or colours")),
    };
    if (pixels, channels) != (shape.voxels(), shape.channels) {
        let expected = (shape.voxels(), shape.channels);
        return Err(format!(
            "a JPEG of {pixels} pixels in {channels} channels, expected {} in {}",
            expected.0, expected.1
        ));
    }
    if info.coding_process == CodingProcess::DctProgressive {
        check_progressive(info.width, info.height, channels)?;
    }
    let decoded = decoder.decode().map_err(failed)?;
    if decoded.len() as u64 != shape.bytes() {
        return Err(format!("{} decoded bytes, expected {}", decoded.len(), shape.bytes()));
    }
    let channels = channels as usize;
    let plane = |channel: usize| decoded.iter().skip(channel).step_by(channels).copied();
    Ok((0..channels).flat_map(plane).collect())
}

/// Decodes labels in blocks, channel by channel.
fn labels(stored: &[u8], block: [u64; 3], shape: Shape) -> Result<Vec<u8>, String> {
    let words: Vec<u32> = stored
        .chunks_exact(4)
        .map(|word| u32::from_le_bytes([word[0], word[1], word[2], word[3]]))
        .collect();
    let mut out = vec![0; shape.bytes() as usize];
    let channel_bytes = shape.voxels() as usize * shape.width;
    for (channel, out) in out.chunks_exact_mut(channel_bytes).enumerate() {
        let begin = words.get(channel).map(|&at| at as usize);
        let channel_words = begin.and_then(|begin| words.get(begin..));
        let channel_words = channel_words.ok_or_else(|| format!("no labels of channel {channel}"))?;
        let grid: [u64; 3] = std::array::from_fn(|axis| shape.size[axis].div_ceil(block[axis]));
        for index in 0..grid.iter().product::<u64>() {
            let at = [index % grid[0], index / grid[0] % grid[1], index / (grid[0] * grid[1])];
            let first = std::array::from_fn(|axis| at[axis] * block[axis]);
            decode_block(channel_words, index as usize, block, first, shape, out)
                .ok_or_else(|| format!("block {at:?} of channel {channel} has a false header, or ends too early"))?;
        }
    }
    Ok(out)
}

/// Decodes one block of labels, whose first voxel is `first`; `None` if its header is invalid or its data end too early.
fn decode_block(
    words: &[u32],
    index: usize,
    block: [u64; 3],
    first: [u64; 3],
    shape: Shape,
    out: &mut [u8],
) -> Option<()> {
    let (head, values) = (*words.get(2 * index)?, *words.get(2 * index + 1)? as usize);
    let (table, bits) = ((head & 0x00ff_ffff) as usize, head >> 24);
    if !matches!(bits, 0 | 1 | 2 | 4 | 8 | 16 | 32) {
        return None;
    }
    let per_label = shape.width / 4;
    let [bx, by, bz]: [u64; 3] = std::array::from_fn(|axis| block[axis].min(shape.size[axis] - first[axis]));
    for (z, y) in (0..bz).flat_map(|z| (0..by).map(move |y| (z, y))) {
        let row = ((first[2] + z) * shape.size[1] + first[1] + y) * shape.size[0] + first[0];
        for x in 0..bx {
            let bit = u64::from(bits) * (x + block[0] * (y + block[1] * z));
            let entry = match bits {
                0 => 0,
                32 => *words.get(values.checked_add((bit / 32) as usize)?)? as usize,
                bits => {
                    let word = *words.get(values.checked_add((bit / 32) as usize)?)?;
                    (word >> (bit % 32) & ((1 << bits) - 1)) as usize
                }
            };
            let at = table.checked_add(entry.checked_mul(per_label)?)?;
            let label = words.get(at..at.checked_add(per_label)?)?;
            let to = (row + x) as usize * shape.width;
            for (word, out) in label.iter().zip(out[to..to + shape.width].chunks_exact_mut(4)) {
                out.copy_from_slice(&word.to_le_bytes());
            }
        }
    }
    Some(())
}
