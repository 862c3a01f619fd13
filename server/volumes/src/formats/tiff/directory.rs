//! The directories of a TIFF or BigTIFF file, one for each page, in the order of their chain.

use std::collections::HashSet;

use super::super::super::location::Blob;
use super::super::super::stored::Endian;

/// Tags that are read, by their numbers in the specification.
pub mod tag {
    pub const NEW_SUBFILE_TYPE: u16 = 254;
    pub const IMAGE_WIDTH: u16 = 256;
    pub const IMAGE_LENGTH: u16 = 257;
    pub const BITS_PER_SAMPLE: u16 = 258;
    pub const COMPRESSION: u16 = 259;
    pub const PHOTOMETRIC: u16 = 262;
    pub const IMAGE_DESCRIPTION: u16 = 270;
    pub const STRIP_OFFSETS: u16 = 273;
    pub const ORIENTATION: u16 = 274;
    pub const SAMPLES_PER_PIXEL: u16 = 277;
    pub const ROWS_PER_STRIP: u16 = 278;
    pub const STRIP_BYTE_COUNTS: u16 = 279;
    pub const X_RESOLUTION: u16 = 282;
    pub const Y_RESOLUTION: u16 = 283;
    pub const PLANAR_CONFIGURATION: u16 = 284;
    pub const RESOLUTION_UNIT: u16 = 296;
    pub const PREDICTOR: u16 = 317;
    pub const TILE_WIDTH: u16 = 322;
    pub const TILE_LENGTH: u16 = 323;
    pub const TILE_OFFSETS: u16 = 324;
    pub const TILE_BYTE_COUNTS: u16 = 325;
    pub const EXTRA_SAMPLES: u16 = 338;
    pub const SAMPLE_FORMAT: u16 = 339;
    pub const CHROMA_SUBSAMPLING: u16 = 530;
    /// Of GDAL: the value of pixels without a measurement, as text.
    pub const NO_DATA: u16 = 42113;
}

/// Byte order and version of a file, from its first bytes.
#[derive(Clone, Copy, Debug)]
pub struct Header {
    pub endian: Endian,
    /// Whether offsets have 8 bytes (BigTIFF), not 4.
    pub is_big: bool,
    first: u64,
}

/// One directory.
pub struct Directory<'a> {
    /// Offset of the directory in the file.
    pub offset: u64,
    file: &'a Chain<'a>,
    entries: Vec<Entry>,
    next: u64,
}

struct Entry {
    tag: u16,
    kind: u16,
    count: u64,
    /// Bytes of the values, if they fit into the entry; else the offset of the values.
    value: Vec<u8>,
}

/// Bytes of a directory's count of entries, of an entry, and of a count or offset in it.
fn sizes(is_big: bool) -> (u64, u64, u64) {
    if is_big { (8, 20, 8) } else { (2, 12, 4) }
}

/// The chain of directories of a file.
pub struct Chain<'a> {
    blob: &'a Blob<'a>,
    pub header: Header,
    /// Bytes that values may still take. In a valid file, values do not overlap, so all together are at most as long as the file.
    left: std::cell::Cell<u64>,
}

impl<'a> Chain<'a> {
    /// Reads the header of the file.
    pub fn open(blob: &'a Blob<'a>) -> Result<Self, String> {
        let head = blob.head(16).map_err(|e| e.to_string())?;
        let endian = match head.get(..2) {
            Some(b"II") => Endian::Little,
            Some(b"MM") => Endian::Big,
            _ => return Err("no TIFF, expected a file that begins with II or MM".into()),
        };
        let number = |from: usize, to: usize| head.get(from..to).map_or(0, |bytes| unsigned(bytes, endian));
        let header = |is_big, first| Header { endian, is_big, first };
        let header = match number(2, 4) {
            42 => header(false, number(4, 8)),
            43 if number(4, 6) == 8 => header(true, number(8, 16)),
            version => return Err(format!("version {version}, expected 42 (TIFF) or 43 (BigTIFF)")),
        };
        let left = std::cell::Cell::new(blob.len());
        Ok(Self { blob, header, left })
    }

    /// Calls `page` with every directory of the chain, but not with subdirectories: reduced copies, thumbnails.
    pub fn for_each(&self, mut page: impl FnMut(Directory<'_>) -> Result<(), String>) -> Result<(), String> {
        let (mut offset, mut seen) = (self.header.first, HashSet::new());
        while offset != 0 {
            if !seen.insert(offset) {
                return Err(format!("directory {} is followed by an earlier one", seen.len()));
            }
            let directory = self.directory(offset)?;
            offset = directory.next;
            page(directory)?;
        }
        Ok(())
    }

    fn read(&self, offset: u64, length: u64) -> Result<Vec<u8>, String> {
        let Some(left) = self.left.get().checked_sub(length) else {
            return Err(format!(
                "its directories have more bytes than the file, which has {}",
                self.blob.len()
            ));
        };
        self.left.set(left);
        let mut bytes = vec![0; length as usize];
        let read = self.blob.read_exact_at(&mut bytes, offset);
        read.map_err(|_| format!("{length} bytes at {offset} lie behind the end of the file"))?;
        Ok(bytes)
    }

    fn directory(&self, offset: u64) -> Result<Directory<'_>, String> {
        let Header { endian, is_big, .. } = self.header;
        let (count_bytes, entry_bytes, word) = sizes(is_big);
        let count = unsigned(&self.read(offset, count_bytes)?, endian);
        let length = count.checked_mul(entry_bytes).and_then(|n| n.checked_add(word));
        let length = length.ok_or_else(|| format!("a directory of {count} entries, expected fewer"))?;
        let bytes = self.read(offset + count_bytes, length)?;
        let (entries, next) = bytes.split_at(bytes.len() - word as usize);
        let entry = |entry: &[u8]| {
            let (count, value) = entry[4..].split_at(word as usize);
            Entry {
                tag: unsigned(&entry[..2], endian) as u16,
                kind: unsigned(&entry[2..4], endian) as u16,
                count: unsigned(count, endian),
                value: value.to_vec(),
            }
        };
        Ok(Directory {
            offset,
            file: self,
            entries: entries.chunks_exact(entry_bytes as usize).map(entry).collect(),
            next: unsigned(next, endian),
        })
    }
}

impl Directory<'_> {
    fn values(&self, tag: u16) -> Result<Option<(u16, Vec<u8>)>, String> {
        let Some(entry) = self.entries.iter().find(|entry| entry.tag == tag) else {
            return Ok(None);
        };
        let length = bytes_of(entry.kind).checked_mul(entry.count);
        let length = length.ok_or_else(|| format!("tag {tag} has {} values, expected fewer", entry.count))?;
        if let Some(value) = usize::try_from(length)
            .ok()
            .and_then(|length| entry.value.get(..length))
        {
            return Ok(Some((entry.kind, value.to_vec())));
        }
        let offset = unsigned(&entry.value, self.file.header.endian);
        let bytes = self
            .file
            .read(offset, length)
            .map_err(|why| format!("tag {tag}: {why}"))?;
        Ok(Some((entry.kind, bytes)))
    }

    /// Returns the unsigned numbers of a tag; none if the tag is absent.
    pub fn numbers(&self, tag: u16) -> Result<Vec<u64>, String> {
        match self.values(tag)? {
            None => Ok(Vec::new()),
            Some((kind @ (1 | 3 | 4 | 13 | 16 | 18), bytes)) => {
                let endian = self.file.header.endian;
                let values = bytes.chunks_exact(bytes_of(kind) as usize);
                Ok(values.map(|bytes| unsigned(bytes, endian)).collect())
            }
            Some((kind, _)) => Err(format!("tag {tag} is of type {kind}, expected whole numbers")),
        }
    }

    /// Refuses a tag with more than `max` values, before they are read.
    pub fn check_max_values(&self, tag: u16, max: u64) -> Result<(), String> {
        let mut entries = self.entries.iter().filter(|entry| entry.tag == tag);
        match entries.find(|entry| entry.count > max) {
            Some(Entry { count, .. }) => Err(format!("tag {tag} has {count} values, expected at most {max}")),
            None => Ok(()),
        }
    }

    /// Returns the first number of a tag.
    pub fn number(&self, tag: u16, default: u64) -> Result<u64, String> {
        Ok(self.numbers(tag)?.first().copied().unwrap_or(default))
    }

    /// Returns the offset in the file of the only number of a tag, if it is a SHORT or LONG, and its bytes. `None` for other tags.
    pub fn place_of(&self, tag: u16) -> Option<(u64, usize)> {
        let index = self.entries.iter().position(|entry| entry.tag == tag)?;
        let entry = &self.entries[index];
        let (count_bytes, entry_bytes, word) = sizes(self.file.header.is_big);
        let bytes = bytes_of(entry.kind) as usize;
        let is_there = entry.count == 1 && matches!(entry.kind, 3 | 4);
        // The value is the last word of an entry.
        let end = self.offset + count_bytes + entry_bytes * (index as u64 + 1);
        is_there.then_some((end - word, bytes))
    }

    /// Returns a quotient of two numbers.
    pub fn rational(&self, tag: u16) -> Result<Option<f64>, String> {
        let endian = self.file.header.endian;
        Ok(match self.values(tag)? {
            Some((5, bytes)) if bytes.len() >= 8 => {
                let (top, bottom) = (unsigned(&bytes[..4], endian), unsigned(&bytes[4..8], endian));
                Some(top as f64 / bottom as f64).filter(|value| value.is_finite() && *value > 0.0)
            }
            _ => None,
        })
    }

    /// Returns a text, up to its first 0.
    pub fn text(&self, tag: u16) -> Result<Option<String>, String> {
        let text = self.values(tag)?.map(|(_, bytes)| {
            let end = bytes.iter().position(|&b| b == 0).unwrap_or(bytes.len());
            String::from_utf8_lossy(&bytes[..end]).into_owned()
        });
        Ok(text)
    }
}

/// Returns the bytes of a value of this type.
fn bytes_of(kind: u16) -> u64 {
    match kind {
        1 | 2 | 6 | 7 => 1,
        3 | 8 => 2,
        4 | 9 | 11 | 13 => 4,
        5 | 10 | 12 | 16 | 17 | 18 => 8,
        // An unknown type: its values are not read.
        _ => 0,
    }
}

fn unsigned(bytes: &[u8], endian: Endian) -> u64 {
    let join = |number: u64, &byte: &u8| number << 8 | u64::from(byte);
    match endian {
        Endian::Little => bytes.iter().rev().fold(0, join),
        Endian::Big => bytes.iter().fold(0, join),
    }
}
