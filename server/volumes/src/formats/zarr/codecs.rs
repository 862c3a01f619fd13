//! Decodes the bytes of a chunk to its samples.
//!
//! Read: `bytes`, `transpose`, `gzip`, `zlib`, `zstd`, `bz2`, `lz4`, `blosc` (see `blosc` for its compressors), `crc32c`,
//! `sharding_indexed`, and [`Filter`]s. Whatever its input, no codec returns more bytes than a chunk should have.

use serde_json::Value;

use super::super::blosc;
use super::filters::Filter;
use crate::codec::{decoded, lz4_block};
use crate::stored::{Encoding, Endian, StoredType};

/// Maximum bytes beside the samples between two codecs: headers and checksums.
const OVERHEAD: usize = 1 << 12;

/// A codec from bytes to bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Bytes {
    Stream(Encoding),
    /// As numcodecs writes it: its decoded length comes first.
    Lz4,
    Blosc,
    Crc32c,
    Filter(Filter),
}

/// The codecs of a chunk.
#[derive(Clone, Debug)]
pub(super) struct Pipeline {
    /// Axes of the array in the order in which they are stored, the last of them fastest.
    order: Vec<usize>,
    pub(super) endian: Endian,
    /// Codecs from bytes to bytes, in the order of writing.
    bytes: Vec<Bytes>,
    pub(super) shard: Option<Box<Shard>>,
    /// For blocks of N5, which have a header and may be smaller at the end: samples of a whole block along each axis, and bytes of a
    /// sample.
    n5: Option<(Vec<u64>, usize)>,
}

/// A chunk that contains inner chunks.
#[derive(Clone, Debug)]
pub(super) struct Shard {
    /// Samples of an inner chunk along each axis.
    pub(super) chunks: Vec<u64>,
    pub(super) pipeline: Pipeline,
    /// Byte order of the index.
    index_endian: Endian,
    /// Whether the index ends with its checksum.
    checksum: bool,
    /// Whether the index follows the chunks.
    pub(super) at_end: bool,
}

impl Pipeline {
    /// Returns the pipeline of an array of version 2 with samples of a type, whose filters precede one compressor.
    pub(super) fn second(
        filters: &[Value],
        compressor: &Value,
        own: (StoredType, Endian),
        fortran: bool,
        axes: usize,
    ) -> Result<Self, String> {
        let mut order: Vec<usize> = (0..axes).collect();
        if fortran {
            order.reverse();
        }
        let id = |codec: &Value| codec.get("id").and_then(Value::as_str).map(str::to_owned);
        let mut bytes = Vec::new();
        for filter in filters {
            let id = id(filter).ok_or("a filter without an id, expected one")?;
            bytes.extend(Filter::parse(&id, filter, Some(own))?.map(Bytes::Filter));
        }
        match id(compressor).as_deref() {
            None if compressor.is_null() => {}
            None => return Err("a compressor without an id, expected one".to_owned()),
            Some("shuffle") => bytes.extend(Filter::parse("shuffle", compressor, None)?.map(Bytes::Filter)),
            Some(id) => bytes.push(Bytes::of(id)?),
        }
        let endian = own.1;
        Ok(Self {
            order,
            endian,
            bytes,
            shard: None,
            n5: None,
        })
    }

    /// Returns the pipeline of a dataset of N5, by its attributes.
    pub(super) fn of_n5(attributes: &Value, chunks: &[u64], width: u64) -> Result<Self, String> {
        let compression = attributes.get("compression");
        let name = compression.and_then(|own| own.get("type")).and_then(Value::as_str);
        let name = name
            .or_else(|| attributes.get("compressionType").and_then(Value::as_str))
            .unwrap_or("none");
        let bytes = match name {
            "raw" => Vec::new(),
            "gzip" => vec![Bytes::Stream(Encoding::Deflate)],
            "bzip2" => vec![Bytes::Stream(Encoding::Bzip2)],
            "zstd" => vec![Bytes::Stream(Encoding::Zstd)],
            "blosc" => vec![Bytes::Blosc],
            other => {
                return Err(format!(
                    "compression {other:?}, expected raw, gzip, bzip2, zstd or blosc"
                ));
            }
        };
        Ok(Self {
            order: (0..chunks.len()).collect(),
            endian: Endian::Big,
            bytes,
            shard: None,
            n5: Some((chunks.to_vec(), width as usize)),
        })
    }

    /// Returns the pipeline of an array of version 3.
    pub(super) fn third(codecs: &[Value], axes: usize) -> Result<Self, String> {
        let mut pipeline = Self {
            order: (0..axes).collect(),
            endian: Endian::Little,
            bytes: Vec::new(),
            shard: None,
            n5: None,
        };
        let mut has_bytes = false;
        for codec in codecs {
            let (name, configuration) = match codec {
                Value::String(name) => (name.as_str(), &Value::Null),
                codec => {
                    let name = codec.get("name").and_then(Value::as_str);
                    (
                        name.ok_or("a codec without a name")?,
                        codec.get("configuration").unwrap_or(&Value::Null),
                    )
                }
            };
            match name {
                "transpose" if !has_bytes => pipeline.transpose(configuration)?,
                "bytes" if !has_bytes => {
                    pipeline.endian = endian(configuration.get("endian"))?;
                    has_bytes = true;
                }
                "sharding_indexed" if !has_bytes => {
                    pipeline.shard = Some(Box::new(Shard::parse(configuration, axes)?));
                    has_bytes = true;
                }
                "transpose" | "bytes" | "sharding_indexed" => {
                    return Err(format!("codec {name:?} after the bytes, expected it before them"));
                }
                "numcodecs.bitround" if !has_bytes => {}
                "numcodecs.shuffle" if has_bytes => {
                    let shuffle = Filter::parse(name, configuration, None)?;
                    pipeline.bytes.extend(shuffle.map(Bytes::Filter));
                }
                name if has_bytes => pipeline.bytes.push(Bytes::of(name)?),
                name => return Err(format!("codec {name:?} before the bytes, expected bytes first")),
            }
        }
        if !has_bytes {
            return Err("no codec `bytes`, expected one".to_owned());
        }
        if pipeline.shard.is_some() && (!pipeline.bytes.is_empty() || !pipeline.order.is_sorted()) {
            return Err("sharding_indexed among other codecs, expected it alone".to_owned());
        }
        Ok(pipeline)
    }

    fn transpose(&mut self, configuration: &Value) -> Result<(), String> {
        let order = integers(configuration.get("order")).unwrap_or_default();
        let mut sorted = order.clone();
        sorted.sort_unstable();
        if !sorted.into_iter().eq(0..self.order.len() as u64) {
            return Err(format!(
                "transpose to {order:?}, expected each of {} axes once",
                self.order.len()
            ));
        }
        self.order = order.iter().map(|&axis| self.order[axis as usize]).collect();
        Ok(())
    }

    /// Returns the distance in samples between neighbours along each axis of a chunk.
    pub(super) fn strides(&self, chunks: &[u64]) -> Vec<usize> {
        let mut strides = vec![0; chunks.len()];
        let mut next = 1;
        for &axis in self.order.iter().rev() {
            strides[axis] = next;
            next *= chunks[axis] as usize;
        }
        strides
    }

    /// Decodes the samples of a chunk, which must be `size` bytes.
    pub(super) fn decode(&self, stored: Vec<u8>, size: usize) -> Result<Vec<u8>, String> {
        let limit = size + size / 8 + OVERHEAD;
        let mut bytes = stored;
        if let Some((chunks, width)) = &self.n5 {
            let (sizes, begin) = n5_header(&bytes, chunks)?;
            let block = self.unpacked(bytes.split_off(begin), limit)?;
            return padded(&block, &sizes, chunks, *width);
        }
        bytes = self.unpacked(bytes, limit)?;
        if bytes.len() != size {
            return Err(format!("{} bytes of samples, expected {size}", bytes.len()));
        }
        Ok(bytes)
    }

    /// Applies the codecs. No codec may return more than `limit` bytes.
    fn unpacked(&self, mut bytes: Vec<u8>, limit: usize) -> Result<Vec<u8>, String> {
        for codec in self.bytes.iter().rev() {
            bytes = codec.decode(&bytes, limit)?;
        }
        Ok(bytes)
    }
}

/// Parses the header of a block: its mode, the number of axes, the samples along each of them. Returns the samples along each axis, the
/// slowest first, and the bytes of the header.
fn n5_header(stored: &[u8], chunks: &[u64]) -> Result<(Vec<u64>, usize), String> {
    let begin = 4 + 4 * chunks.len();
    let header = stored.get(..begin).ok_or("a block that is shorter than its header")?;
    let number = |at: &[u8]| at.iter().fold(0u64, |n, &byte| n << 8 | u64::from(byte));
    let (mode, axes) = (number(&header[..2]), number(&header[2..4]));
    if mode != 0 || axes != chunks.len() as u64 {
        return Err(format!(
            "a block of mode {mode} with {axes} axes, expected mode 0 and {} axes",
            chunks.len()
        ));
    }
    let mut sizes: Vec<u64> = header[4..].chunks_exact(4).map(number).collect();
    sizes.reverse();
    if sizes.iter().zip(chunks).any(|(size, whole)| size > whole) {
        return Err(format!("a block of {sizes:?} samples, expected {chunks:?} at most"));
    }
    Ok((sizes, begin))
}

/// Extends a block to the size of a whole one. The samples that it does not have are 0.
fn padded(block: &[u8], sizes: &[u64], chunks: &[u64], width: usize) -> Result<Vec<u8>, String> {
    let count = |sizes: &[u64]| sizes.iter().map(|&n| n as usize).product::<usize>() * width;
    if block.len() != count(sizes) {
        return Err(format!("{} bytes of samples, expected {}", block.len(), count(sizes)));
    }
    if sizes == chunks {
        return Ok(block.to_vec());
    }
    let mut whole = vec![0; count(chunks)];
    let Some(row) = sizes.last().map(|&n| n as usize * width).filter(|&row| row > 0) else {
        return Ok(whole);
    };
    for (number, from) in block.chunks_exact(row).enumerate() {
        let (mut rest, mut at, mut stride) = (number, 0, chunks[chunks.len() - 1] as usize * width);
        for axis in (0..sizes.len() - 1).rev() {
            at += rest % sizes[axis] as usize * stride;
            rest /= sizes[axis] as usize;
            stride *= chunks[axis] as usize;
        }
        whole[at..at + row].copy_from_slice(from);
    }
    Ok(whole)
}

impl Bytes {
    fn of(name: &str) -> Result<Self, String> {
        Ok(match name.strip_prefix("numcodecs.").unwrap_or(name) {
            "gzip" | "zlib" => Self::Stream(Encoding::Deflate),
            "zstd" => Self::Stream(Encoding::Zstd),
            "bz2" => Self::Stream(Encoding::Bzip2),
            "lz4" => Self::Lz4,
            "blosc" => Self::Blosc,
            "crc32c" => Self::Crc32c,
            other => {
                return Err(format!(
                    "codec {other:?}, expected blosc, gzip, zlib, zstd, bz2, lz4 or crc32c"
                ));
            }
        })
    }

    fn decode(self, stored: &[u8], limit: usize) -> Result<Vec<u8>, String> {
        match self {
            Self::Stream(encoding) => decoded(encoding, stored, limit),
            Self::Lz4 => {
                let (length, packed) = stored.split_first_chunk().ok_or("too short for LZ4")?;
                let length = u32::from_le_bytes(*length) as usize;
                if length > limit {
                    return Err(format!("{length} bytes of LZ4, expected {limit} at most"));
                }
                lz4_block(packed, length)
            }
            Self::Blosc => blosc::decode(stored, limit),
            Self::Crc32c => checked(stored).map(<[u8]>::to_vec),
            Self::Filter(filter) => filter.undo(stored),
        }
    }
}

/// Verifies the checksum at the end and returns the bytes before it.
fn checked(stored: &[u8]) -> Result<&[u8], String> {
    let (bytes, sum) = stored.split_last_chunk().ok_or("too short for its checksum")?;
    if crc32c::crc32c(bytes) != u32::from_le_bytes(*sum) {
        return Err("its checksum is wrong".to_owned());
    }
    Ok(bytes)
}

impl Shard {
    fn parse(configuration: &Value, axes: usize) -> Result<Self, String> {
        let list = |name: &str| {
            configuration
                .get(name)
                .and_then(Value::as_array)
                .cloned()
                .unwrap_or_default()
        };
        let pipeline = Pipeline::third(&list("codecs"), axes)?;
        if pipeline.shard.is_some() {
            return Err("shards in shards, expected chunks in them".to_owned());
        }
        let index = Pipeline::third(&list("index_codecs"), 1)?;
        let checksum = match index.bytes.as_slice() {
            [] => false,
            [Bytes::Crc32c] => true,
            _ => return Err("index_codecs, expected bytes and perhaps crc32c".to_owned()),
        };
        let at_end = match configuration.get("index_location").and_then(Value::as_str) {
            None | Some("end") => true,
            Some("start") => false,
            Some(other) => return Err(format!("index_location {other:?}, expected start or end")),
        };
        let chunks = integers(configuration.get("chunk_shape")).ok_or("no chunk_shape of sharding_indexed")?;
        Ok(Self {
            chunks,
            pipeline,
            index_endian: index.endian,
            checksum,
            at_end,
        })
    }

    /// Returns the bytes of the index for this many chunks.
    pub(super) fn index_bytes(&self, chunks: u64) -> u64 {
        16 * chunks + if self.checksum { 4 } else { 0 }
    }

    /// Parses the index: offset and length of each chunk; `None` for a chunk that is not stored.
    pub(super) fn index(&self, stored: &[u8]) -> Result<Vec<Option<[u64; 2]>>, String> {
        let bytes = if self.checksum { checked(stored)? } else { stored };
        let number = match self.index_endian {
            Endian::Little => u64::from_le_bytes,
            Endian::Big => u64::from_be_bytes,
        };
        let entry = |[offset, length]: &[[u8; 8]; 2]| match [number(*offset), number(*length)] {
            [u64::MAX, u64::MAX] => None,
            place => Some(place),
        };
        let numbers = bytes.as_chunks::<8>().0;
        Ok(numbers.as_chunks::<2>().0.iter().map(entry).collect())
    }
}

/// Parses a list of whole numbers.
pub(super) fn integers(value: Option<&Value>) -> Option<Vec<u64>> {
    value?.as_array()?.iter().map(Value::as_u64).collect()
}

/// Parses the byte order in the configuration of a codec.
fn endian(value: Option<&Value>) -> Result<Endian, String> {
    match value.and_then(Value::as_str) {
        None | Some("little") => Ok(Endian::Little),
        Some("big") => Ok(Endian::Big),
        Some(other) => Err(format!("endian {other:?}, expected little or big")),
    }
}
