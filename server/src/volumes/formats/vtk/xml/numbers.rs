//! Where the numbers of an array are in a VTI file.

use super::{FIELDS, Markup};
use crate::volumes::codec::VtkCoding;
use crate::volumes::formats::vtk::Array;
use crate::volumes::location::Blob;
use crate::volumes::stored::{Begin, Encoding, Endian, StoredSamples, StoredType};
use crate::volumes::{FileLocation, Geometry, ReadError};

/// Where the numbers of an array are.
#[derive(Clone, Debug)]
pub(super) enum Numbers {
    /// In the element, as text or base64: the first byte and the one behind the last.
    Inline { text: bool, begin: u64, end: u64 },
    /// In the appended data, behind so many bytes.
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

    /// Where the bytes of an array begin and end, and how they are written.
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
        // It was read there.
        let begin = begin + self.header_bytes as u64;
        Ok((
            begin,
            Some(begin.saturating_add(u64::from_le_bytes(bytes))),
            Encoding::Raw,
        ))
    }
}

/// The type of that name.
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
