//! Samples of a time step that a format's library decodes piece by piece: slices of a stack, rows of chunks.

use std::path::{Path, PathBuf};

use half::f16;
use isopeel_kernels::{SampleType, Samples};

use super::scalar::Scalar;
use super::stored::{Endian, StoredType};
use super::{ReadError, Sink};

/// Pieces in the order of the samples, x fastest, joined in the device's type. Memory grows with what was decoded, whatever a header
/// claims.
pub(super) struct Pieces {
    path: PathBuf,
    expected: u64,
    /// Samples that were handed over.
    given: u64,
    samples: Samples,
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

impl Pieces {
    /// None yet of `expected` samples. `path` is named in errors.
    pub(super) fn new(path: &Path, sample_type: SampleType, expected: u64) -> Self {
        Self {
            path: path.to_owned(),
            expected,
            given: 0,
            samples: none_of(sample_type),
        }
    }

    /// Appends samples as they are stored; value = `scale[0]` · stored + `scale[1]`. On a device in an integer type, the stored type
    /// must be that type, without a scale.
    ///
    /// # Errors
    /// More than was expected, no whole number of samples, another type, or no memory.
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
            (Samples::F32(to), _, None) => append_floats(to, bytes, stored, swap, None),
            (Samples::F32(to), _, Some(scale)) => append_floats(to, bytes, stored, swap, Some(scale)),
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

    /// Hands over what there is, once that is `piece` samples.
    ///
    /// # Errors
    /// The sink's.
    pub(super) fn hand_over(&mut self, piece: usize, sink: &mut Sink<'_>) -> Result<(), ReadError> {
        if self.samples.len() < piece {
            return Ok(());
        }
        self.given += self.samples.len() as u64;
        let empty = none_of(self.samples.sample_type());
        sink(std::mem::replace(&mut self.samples, empty))
    }

    /// Hands over the last ones.
    ///
    /// # Errors
    /// Fewer than expected, or the sink's.
    pub(super) fn finish(mut self, sink: &mut Sink<'_>) -> Result<(), ReadError> {
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

fn append_floats(
    to: &mut Vec<f32>,
    bytes: &[u8],
    stored: StoredType,
    swap: bool,
    scale: Option<[f64; 2]>,
) -> Result<(), NoMemory> {
    fn scaled<S: Scalar>(to: &mut Vec<f32>, bytes: &[u8], swap: bool, scale: Option<[f64; 2]>) -> Result<(), NoMemory> {
        match scale {
            None => append::<S, _>(to, bytes, swap, Scalar::to_f32),
            Some([slope, inter]) => append::<S, _>(to, bytes, swap, |v| (slope * v.to_f64() + inter) as f32),
        }
    }
    match stored {
        StoredType::U8 => scaled::<u8>(to, bytes, swap, scale),
        StoredType::I8 => scaled::<i8>(to, bytes, swap, scale),
        StoredType::U16 => scaled::<u16>(to, bytes, swap, scale),
        StoredType::I16 => scaled::<i16>(to, bytes, swap, scale),
        StoredType::U32 => scaled::<u32>(to, bytes, swap, scale),
        StoredType::I32 => scaled::<i32>(to, bytes, swap, scale),
        StoredType::U64 => scaled::<u64>(to, bytes, swap, scale),
        StoredType::I64 => scaled::<i64>(to, bytes, swap, scale),
        StoredType::F16 => scaled::<f16>(to, bytes, swap, scale),
        StoredType::F32 => scaled::<f32>(to, bytes, swap, scale),
        StoredType::F64 => scaled::<f64>(to, bytes, swap, scale),
    }
}

#[cfg(test)]
mod tests {
    use super::super::only_piece;
    use super::*;

    fn finish(pieces: Pieces) -> Result<Samples, ReadError> {
        only_piece(|sink| pieces.finish(sink))
    }

    fn pieces(sample_type: SampleType, expected: u64) -> Pieces {
        Pieces::new(Path::new("stack"), sample_type, expected)
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
