//! Finds the numbers of an array in a VTI file.

use std::io::Read;

use super::{FIELDS, Markup};
use crate::codec::{VtkCoding, decoder};
use crate::formats::header;
use crate::formats::vtk::Array;
use crate::location::Blob;
use crate::scalar;
use crate::stored::{Begin, Encoding, Endian, StoredSamples, StoredType};
use crate::{FileLocation, Geometry, ReadError};

/// Maximum bytes of positions along an axis: no volume has that many samples along one.
const MAX_POSITION_BYTES: u64 = 32 << 20;

/// Place of the numbers of an array in the file.
#[derive(Clone, Debug)]
pub(super) enum Numbers {
    /// In the element, as text or base64: offsets of the first byte and of the byte behind the last.
    Inline { text: bool, begin: u64, end: u64 },
    /// In the appended data, at this offset.
    Appended { offset: u64 },
}

impl Markup<'_> {
    pub(super) fn samples(
        &self,
        location: &FileLocation,
        blob: &Blob<'_>,
        array: &Array,
        place: &Numbers,
        geometry: &Geometry,
    ) -> Result<StoredSamples, ReadError> {
        let (begin, end, mut encoding) = self.find(blob, array, place)?;
        if let (Encoding::Vtk(coding), Some(compressor)) = (&mut encoding, self.compressor) {
            coding.compressor = Some(compressor);
        }
        let mut samples = StoredSamples::new(location, Begin::At(begin), array.stored, geometry, 1, FIELDS.dims)?;
        (samples.end, samples.encoding, samples.endian) = (end, encoding, self.endian);
        Ok(samples)
    }

    /// Reads the numbers of an array. An error unless there are `count`.
    pub(super) fn values(&self, array: &Array, place: &Numbers, count: u64) -> Result<Vec<f64>, ReadError> {
        let (begin, end, mut encoding) = self.find(self.blob, array, place)?;
        if let (Encoding::Vtk(coding), Some(compressor)) = (&mut encoding, self.compressor) {
            coding.compressor = Some(compressor);
        }
        let fail = |why: String| self.error("Coordinates", format!("{:?}: {why}", array.name));
        let limit = match encoding {
            Encoding::Text => u64::MAX,
            _ => count.saturating_mul(array.stored.bytes()),
        };
        let length = end.map_or(u64::MAX, |end| end.saturating_sub(begin));
        let stream = decoder(encoding, self.blob.reader(begin), length);
        let mut bytes = Vec::new();
        let read = stream.and_then(|stream| stream.take(limit.min(MAX_POSITION_BYTES)).read_to_end(&mut bytes));
        read.map_err(|e| fail(e.to_string()))?;
        let values = match encoding {
            Encoding::Text => {
                let text = String::from_utf8_lossy(&bytes);
                header::numbers(self.blob.path(), "Coordinates", &text, None)?
            }
            _ => scalar::numbers(&bytes, array.stored, self.endian),
        };
        if values.len() as u64 != count {
            return Err(fail(format!("{} positions, expected {count}", values.len())));
        }
        Ok(values)
    }

    /// Returns the offset at which the bytes of an array begin, the offset of their end if it is known, and their encoding.
    fn find(&self, blob: &Blob<'_>, array: &Array, place: &Numbers) -> Result<(u64, Option<u64>, Encoding), ReadError> {
        let coded = |base64: bool| {
            let (header_bytes, endian) = (self.header_bytes, self.endian);
            Encoding::Vtk(VtkCoding {
                base64,
                compressor: None,
                header_bytes,
                endian,
            })
        };
        let offset = match *place {
            Numbers::Inline { text: true, begin, end } => return Ok((begin, Some(end), Encoding::Text)),
            Numbers::Inline {
                text: false,
                begin,
                end,
            } => return Ok((begin, Some(end), coded(true))),
            Numbers::Appended { offset } => offset,
        };
        let (base, base64) = self
            .appended
            .ok_or_else(|| self.error("AppendedData", format!("missing, {:?} should be in them", array.name)))?;
        let begin = base
            .checked_add(offset)
            .ok_or_else(|| self.error("offset", format!("{offset} of {:?} passes 64 bits", array.name)))?;
        if base64 || self.compressor.is_some() {
            return Ok((begin, None, coded(base64)));
        }
        let mut bytes = [0; 8];
        let length = &mut bytes[..self.header_bytes];
        blob.read_exact_at(length, begin)
            .map_err(|e| ReadError::io(blob.path(), "AppendedData", "the file ends too early", e))?;
        if self.endian == Endian::Big {
            length.reverse();
        }
        // The length was read from there.
        let begin = begin + self.header_bytes as u64;
        Ok((
            begin,
            Some(begin.saturating_add(u64::from_le_bytes(bytes))),
            Encoding::Raw,
        ))
    }
}

/// Returns the sample type with this name.
pub(super) fn stored_type(name: &str) -> Option<StoredType> {
    Some(match name {
        "Int8" => StoredType::I8,
        "UInt8" => StoredType::U8,
        "Int16" => StoredType::I16,
        "UInt16" => StoredType::U16,
        "Int32" => StoredType::I32,
        "UInt32" => StoredType::U32,
        "Int64" => StoredType::I64,
        "UInt64" => StoredType::U64,
        "Float32" => StoredType::F32,
        "Float64" => StoredType::F64,
        _ => return None,
    })
}
