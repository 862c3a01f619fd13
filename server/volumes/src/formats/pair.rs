//! Shared by NIfTI and Analyze 7.5: pairs of a header, `.hdr`, and samples, `.img`; numbers at fixed offsets of a header.

use super::super::stored::Endian;
use super::super::{FileLocation, ReadError};

/// Reads numbers of a header in its byte order.
pub(super) struct Bytes<'a> {
    pub(super) bytes: &'a [u8],
    pub(super) endian: Endian,
}

impl Bytes<'_> {
    pub(super) fn get<const N: usize>(&self, at: usize) -> [u8; N] {
        let mut bytes: [u8; N] = std::array::from_fn(|i| self.bytes[at + i]);
        if self.endian == Endian::Big {
            bytes.reverse();
        }
        bytes
    }

    pub(super) fn i16(&self, at: usize) -> i32 {
        i32::from(i16::from_le_bytes(self.get(at)))
    }

    pub(super) fn i32(&self, at: usize) -> i32 {
        i32::from_le_bytes(self.get(at))
    }

    pub(super) fn i64(&self, at: usize) -> i64 {
        i64::from_le_bytes(self.get(at))
    }

    pub(super) fn f32s<const N: usize>(&self, at: usize) -> [f64; N] {
        std::array::from_fn(|i| f64::from(f32::from_le_bytes(self.get(at + 4 * i))))
    }

    pub(super) fn f64s<const N: usize>(&self, at: usize) -> [f64; N] {
        std::array::from_fn(|i| f64::from_le_bytes(self.get(at + 8 * i)))
    }
}

/// Returns the file with the samples of a header, `.img`.
pub(super) fn image_of_pair(location: &FileLocation) -> Result<FileLocation, ReadError> {
    of_pair(location, "img").ok_or_else(|| {
        let name = format!("{}.img", location.stem());
        let why = format!("no file {name:?} beside it, expected the samples there: the header says that they are in a file of their own");
        ReadError::new(location.path(), "magic", why)
    })
}

/// Returns the header of a file with samples, `.hdr`.
pub(super) fn header_of_pair(location: &FileLocation) -> Result<FileLocation, ReadError> {
    of_pair(location, "hdr").ok_or_else(|| {
        let name = format!("{}.hdr", location.stem());
        let why = format!("no file {name:?} beside it, expected the header there: .img is the half of a NIfTI or Analyze pair with the samples");
        ReadError::new(location.path(), "file", why)
    })
}

/// Returns the other file of a pair, plain or compressed.
fn of_pair(location: &FileLocation, ending: &str) -> Option<FileLocation> {
    let stem = location.stem();
    let endings = [ending.to_owned(), ending.to_ascii_uppercase()];
    let names = endings
        .iter()
        .flat_map(|ending| ["", ".gz"].map(|packed| format!("{stem}.{ending}{packed}")));
    let others = names.filter_map(|name| location.sibling(&name, "magic").ok());
    others.map(|other| other.packed_by_name()).next()
}
