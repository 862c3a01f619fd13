//! Samples of a time step that the library of a format decodes piece by piece: slices of a stack, rows of chunks.

use std::path::{Path, PathBuf};

use half::f16;
use isopeel_kernels::{SampleType, Samples};

use super::conversion::Conversion;
use super::scalar::Scalar;
use super::stored::{Endian, StoredType};
use super::{ReadError, Sink};

/// Joins pieces in the order of the samples, x fastest, in the device's type. Memory grows with the decoded samples, whatever a header
/// claims.
pub(super) struct Pieces<'a> {
    path: PathBuf,
    expected: u64,
    /// Number of samples that were handed over.
    given: u64,
    samples: Samples,
    conversion: &'a Conversion,
}

fn none_of(sample_type: SampleType) -> Samples {
    match sample_type {
        SampleType::U8 => Samples::U8(Vec::new()),
        SampleType::I8 => Samples::I8(Vec::new()),
        SampleType::U16 => Samples::U16(Vec::new()),
        SampleType::I16 => Samples::I16(Vec::new()),
        SampleType::F32 => Samples::F32(Vec::new()),
    }
}

impl<'a> Pieces<'a> {
    /// Expects `expected` samples. Errors name `path`.
    pub(super) fn new(path: &Path, sample_type: SampleType, expected: u64, conversion: &'a Conversion) -> Self {
        Self {
            path: path.to_owned(),
            expected,
            given: 0,
            samples: none_of(sample_type),
            conversion,
        }
    }

    /// Appends samples as they are stored; value = `scale[0]` · stored + `scale[1]`. If the type on the device is an integer type, the
    /// stored type must be the same, without a scale.
    ///
    /// # Errors
    /// More samples than expected, an incomplete sample, another type, or no memory.
    pub(super) fn push(
        &mut self,
        bytes: &[u8],
        stored: StoredType,
        endian: Endian,
        scale: Option<[f64; 2]>,
    ) -> Result<(), ReadError> {
        let width = stored.bytes() as usize;
        let (more, have) = (bytes.len() / width, self.have());
        if !bytes.len().is_multiple_of(width) || more as u64 > self.expected.saturating_sub(have) {
            let why = format!(
                "{} bytes after sample {have}, expected {} samples of {} in all",
                bytes.len(),
                self.expected,
                stored.name()
            );
            return Err(ReadError::new(&self.path, "data", why));
        }
        let swap = !endian.is_native();
        let fits = match (&mut self.samples, stored, scale) {
            (Samples::U8(to), StoredType::U8, None) => append::<u8, _>(to, bytes, swap, |v| v),
            (Samples::I8(to), StoredType::I8, None) => append::<i8, _>(to, bytes, swap, |v| v),
            (Samples::U16(to), StoredType::U16, None) => append::<u16, _>(to, bytes, swap, |v| v),
            (Samples::I16(to), StoredType::I16, None) => append::<i16, _>(to, bytes, swap, |v| v),
            (Samples::F32(to), ..) => Floats {
                to,
                swap,
                scale,
                conversion: self.conversion,
            }
            .append(bytes, stored),
            (samples, ..) => {
                let device = samples.sample_type();
                let why = format!("a piece of {}, expected all of one type: {device:?}", stored.name());
                return Err(ReadError::new(&self.path, "data", why));
            }
        };
        fits.map_err(|_| ReadError::new(&self.path, "data", format!("no memory for {} samples", self.expected)))
    }

    fn have(&self) -> u64 {
        self.given + self.samples.len() as u64
    }

    /// Hands over the samples so far, if there are at least `piece`.
    ///
    /// # Errors
    /// Errors of the sink.
    pub(super) fn hand_over(&mut self, piece: usize, sink: &mut Sink<'_>) -> Result<(), ReadError> {
        if self.samples.len() < piece {
            return Ok(());
        }
        self.given += self.samples.len() as u64;
        let empty = none_of(self.samples.sample_type());
        sink(std::mem::replace(&mut self.samples, empty))
    }

    /// Hands over the last samples.
    ///
    /// # Errors
    /// Fewer samples than expected, or errors of the sink.
    pub(super) fn finish(&mut self, sink: &mut Sink<'_>) -> Result<(), ReadError> {
        let have = self.have();
        if have == self.expected {
            return self.hand_over(1, sink);
        }
        let why = format!("{have} samples, expected {}", self.expected);
        Err(ReadError::new(&self.path, "data", why))
    }
}

type NoMemory = std::collections::TryReserveError;

fn append<S: Scalar, T>(to: &mut Vec<T>, bytes: &[u8], swap: bool, convert: impl Fn(S) -> T) -> Result<(), NoMemory> {
    let stored = bytes.chunks_exact(size_of::<S>());
    to.try_reserve(stored.len())?;
    to.extend(stored.map(|one| {
        let value: S = bytemuck::pod_read_unaligned(one);
        convert(if swap { value.swapped() } else { value })
    }));
    Ok(())
}

/// 32-bit floats that samples are converted to.
struct Floats<'a> {
    to: &'a mut Vec<f32>,
    swap: bool,
    scale: Option<[f64; 2]>,
    conversion: &'a Conversion,
}

impl Floats<'_> {
    fn append(self, bytes: &[u8], stored: StoredType) -> Result<(), NoMemory> {
        match stored {
            StoredType::U8 => self.append_as::<u8>(bytes),
            StoredType::I8 => self.append_as::<i8>(bytes),
            StoredType::U16 => self.append_as::<u16>(bytes),
            StoredType::I16 => self.append_as::<i16>(bytes),
            StoredType::U32 => self.append_as::<u32>(bytes),
            StoredType::I32 => self.append_as::<i32>(bytes),
            StoredType::U64 => self.append_as::<u64>(bytes),
            StoredType::I64 => self.append_as::<i64>(bytes),
            StoredType::F16 => self.append_as::<f16>(bytes),
            StoredType::F32 => self.append_as::<f32>(bytes),
            StoredType::F64 => self.append_as::<f64>(bytes),
        }
    }

    fn append_as<S: Scalar>(self, bytes: &[u8]) -> Result<(), NoMemory> {
        let (width, swap) = (size_of::<S>(), self.swap);
        let stored = |i: usize| {
            let value: S = bytemuck::pod_read_unaligned(&bytes[i * width..(i + 1) * width]);
            if swap { value.swapped() } else { value }
        };
        let (begin, count) = (self.to.len(), bytes.len() / width);
        self.to.try_reserve(count)?;
        self.to.resize(begin + count, 0.0);
        let values = &mut self.to[begin..];
        match self.scale {
            None => self.conversion.convert(stored, values),
            Some([slope, inter]) => {
                self.conversion
                    .convert_computed(|i| slope * stored(i).to_f64() + inter, values);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::only_piece;
    use super::*;

    fn finish(mut pieces: Pieces<'_>) -> Result<Samples, ReadError> {
        only_piece(|sink| pieces.finish(sink))
    }

    fn pieces(sample_type: SampleType, expected: u64) -> Pieces<'static> {
        let conversion = Box::leak(Box::default());
        Pieces::new(Path::new("stack"), sample_type, expected, conversion)
    }

    #[test]
    fn pieces_join_in_order_in_either_byte_order() {
        let mut whole = pieces(SampleType::I16, 3);
        whole
            .push(&[1, 0, 2, 0], StoredType::I16, Endian::Little, None)
            .unwrap();
        whole.push(&[0, 3], StoredType::I16, Endian::Big, None).unwrap();
        assert!(matches!(finish(whole).unwrap(), Samples::I16(v) if v == [1, 2, 3]));
    }

    #[test]
    fn each_piece_has_its_own_scale() {
        let mut whole = pieces(SampleType::F32, 3);
        whole
            .push(&[4], StoredType::U8, Endian::Little, Some([0.5, 1.0]))
            .unwrap();
        whole.push(&[4, 0xff], StoredType::I8, Endian::Little, None).unwrap();
        assert!(matches!(finish(whole).unwrap(), Samples::F32(v) if v == [3.0, 4.0, -1.0]));
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let mut whole = pieces(SampleType::U16, 2);
        for (bytes, stored) in [
            (&[0; 3][..], StoredType::U16),
            (&[0; 6], StoredType::U16),
            (&[0; 2], StoredType::U8),
        ] {
            assert!(whole.push(bytes, stored, Endian::Little, None).is_err());
        }
        assert!(finish(whole).is_err());
    }

    #[test]
    fn what_was_handed_over_counts() {
        let mut whole = pieces(SampleType::U8, 3);
        let mut got = Vec::new();
        let mut sink = |piece: Samples| {
            got.push(piece.len());
            Ok(())
        };
        whole.push(&[1], StoredType::U8, Endian::Little, None).unwrap();
        whole.hand_over(2, &mut sink).unwrap();
        whole.push(&[2], StoredType::U8, Endian::Little, None).unwrap();
        whole.hand_over(2, &mut sink).unwrap();
        assert!(whole.push(&[3, 4], StoredType::U8, Endian::Little, None).is_err());
        whole.push(&[3], StoredType::U8, Endian::Little, None).unwrap();
        whole.finish(&mut sink).unwrap();
        assert_eq!(got, [2, 1]);
    }
}
