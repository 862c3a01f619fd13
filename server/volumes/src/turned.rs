//! Brings samples that are stored with another axis than x fastest into the order of the grid.

use std::path::{Path, PathBuf};

use isopeel_kernels::{SampleType, Samples};

use super::ReadError;

/// The samples of a time step, which are read in slices across the axis that is stored slowest.
pub(super) struct Turned {
    path: PathBuf,
    /// In the order of the grid.
    pub(super) samples: Samples,
    dims: [u32; 3],
    /// x, y and z as 0, 1, 2, the one that is stored fastest first.
    order: [usize; 3],
}

impl Turned {
    /// Creates the samples, all 0.
    ///
    /// # Errors
    /// There is not enough memory.
    pub(super) fn new(path: &Path, kind: SampleType, dims: [u32; 3], order: [usize; 3]) -> Result<Self, ReadError> {
        let count = dims.iter().map(|&n| n as usize).product();
        let samples = match kind {
            SampleType::U8 => zeroed(count).map(Samples::U8),
            SampleType::I8 => zeroed(count).map(Samples::I8),
            SampleType::U16 => zeroed(count).map(Samples::U16),
            SampleType::I16 => zeroed(count).map(Samples::I16),
            SampleType::F32 => zeroed(count).map(Samples::F32),
        };
        let samples = samples.ok_or_else(|| ReadError::new(path, "data", format!("no memory for {dims:?} samples")))?;
        Ok(Self {
            path: path.to_owned(),
            samples,
            dims,
            order,
        })
    }

    /// Copies whole slices from `first` on, in the order in which they are stored, to their places in the grid.
    ///
    /// # Errors
    /// The slices have another sample type.
    pub(super) fn put(&mut self, first: u64, slices: &Samples) -> Result<(), ReadError> {
        let (dims, order, first) = (self.dims, self.order, first as usize);
        match (&mut self.samples, slices) {
            (Samples::U8(to), Samples::U8(from)) => put(to, from, dims, order, first),
            (Samples::I8(to), Samples::I8(from)) => put(to, from, dims, order, first),
            (Samples::U16(to), Samples::U16(from)) => put(to, from, dims, order, first),
            (Samples::I16(to), Samples::I16(from)) => put(to, from, dims, order, first),
            (Samples::F32(to), Samples::F32(from)) => put(to, from, dims, order, first),
            _ => {
                return Err(ReadError::new(
                    &self.path,
                    "data",
                    "slices of several types, expected one",
                ));
            }
        }
        Ok(())
    }
}

fn zeroed<T: bytemuck::Zeroable>(count: usize) -> Option<Vec<T>> {
    bytemuck::allocation::try_zeroed_vec(count).ok()
}

fn put<T: Copy>(to: &mut [T], from: &[T], dims: [u32; 3], order: [usize; 3], first: usize) {
    let [nx, ny, nz] = dims.map(|n| n as usize);
    let strides = order.map(|axis| [1, nx, nx * ny][axis]);
    let sizes = order.map(|axis| [nx, ny, nz][axis]);
    for (row, samples) in from.chunks_exact(sizes[0]).enumerate() {
        let start = row % sizes[1] * strides[1] + (first + row / sizes[1]) * strides[2];
        for (i, &sample) in samples.iter().enumerate() {
            to[start + i * strides[0]] = sample;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_put_where_they_belong() {
        let dims = [2u32, 3, 4];
        let value = |x: usize, y: usize, z: usize| (x + 10 * y + 100 * z) as u16;
        for order in [[0, 1, 2], [2, 1, 0], [1, 0, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1]] {
            let sizes = order.map(|axis: usize| dims[axis] as usize);
            let mut turned = Turned::new(Path::new("a"), SampleType::U16, dims, order).expect("memory");
            for slice in 0..sizes[2] {
                let mut from = Vec::new();
                for b in 0..sizes[1] {
                    for a in 0..sizes[0] {
                        let mut at = [0; 3];
                        (at[order[0]], at[order[1]], at[order[2]]) = (a, b, slice);
                        from.push(value(at[0], at[1], at[2]));
                    }
                }
                turned.put(slice as u64, &Samples::U16(from)).expect("one type");
            }
            let Samples::U16(found) = turned.samples else {
                panic!("of one type")
            };
            let at = |i: usize| value(i % 2, i / 2 % 3, i / 6);
            assert!(found.iter().enumerate().all(|(i, &v)| v == at(i)), "{order:?}");
        }
    }
}
