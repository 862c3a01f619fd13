//! A field on the host, as the device sees it.

use isopeel_kernels::tables::cube;
use isopeel_kernels::{Grid, Samples};

/// A field on the host: samples as f32, x fastest; a missing sample is NaN.
#[derive(Clone, Debug)]
pub struct Field {
    /// Extent.
    pub grid: Grid,
    /// One per sample of the grid.
    pub values: Vec<f32>,
    /// Lengths of the cells along x, y and z if axes are uneven: only derived features depend on them.
    pub lengths: Option<[Vec<f32>; 3]>,
}

impl Field {
    /// Takes values whose missing samples already are NaN.
    ///
    /// # Panics
    /// As many values as samples are expected.
    pub fn new(grid: Grid, values: Vec<f32>) -> Self {
        assert_eq!(
            values.len() as u64,
            grid.sample_count(),
            "values for a grid of {:?}",
            grid.dims
        );
        Self {
            grid,
            values,
            lengths: None,
        }
    }

    /// The same samples with cells of other lengths.
    pub fn with_lengths(self, lengths: [Vec<f32>; 3]) -> Self {
        Self {
            lengths: Some(lengths),
            ..self
        }
    }

    /// Converts samples; those equal to `missing` become NaN.
    pub fn from_samples(grid: Grid, samples: &Samples, missing: Option<f32>) -> Self {
        let value = |i| Some(samples.get(i)).filter(|&v| Some(v) != missing).unwrap_or(f32::NAN);
        Self::new(grid, (0..samples.len()).map(value).collect())
    }

    /// Whether samples are missing anywhere.
    pub fn has_missing(&self) -> bool {
        self.values.iter().any(|value| value.is_nan())
    }

    /// The value at a sample.
    pub fn at(&self, [x, y, z]: [u32; 3]) -> f32 {
        let [nx, ny, _] = self.grid.dims.map(|n| n as usize);
        self.values[(z as usize * ny + y as usize) * nx + x as usize]
    }

    /// All samples, x fastest.
    pub fn samples(&self) -> impl Iterator<Item = [u32; 3]> + use<> {
        boxes([0; 3], self.grid.dims)
    }

    /// The 8 corner values of a cell.
    pub fn cell_corners(&self, cell: [u32; 3]) -> [f32; 8] {
        std::array::from_fn(|b| self.at(offset(cell, cube::corner_offset(b).map(|d| d as u32))))
    }

    /// Low and high sample of the cube of `level` at `cube`, the high one clamped at the volume's last sample.
    pub fn cube_samples(&self, level: usize, cube: [u32; 3]) -> [[u32; 3]; 2] {
        let low = cube.map(|c| c << level);
        let high = [0, 1, 2].map(|i| (low[i] + (1 << level)).min(self.grid.dims[i] - 1));
        [low, high]
    }

    /// Gradient at a sample, per world unit: central differences; one-sided at the volume's border and beside a missing
    /// sample; a component is 0 if neither neighbour is known.
    pub fn gradient(&self, p: [u32; 3]) -> [f32; 3] {
        std::array::from_fn(|axis| {
            let neighbour = |at: Option<u32>| match at {
                Some(at) if at < self.grid.dims[axis] => {
                    let mut q = p;
                    q[axis] = at;
                    self.at(q)
                }
                _ => f32::NAN,
            };
            let (here, h) = (self.at(p), self.grid.spacing[axis]);
            let (below, above) = (neighbour(p[axis].checked_sub(1)), neighbour(p[axis].checked_add(1)));
            let slope = match (below.is_nan(), above.is_nan()) {
                (false, false) => (above - below) / (2.0 * h),
                (true, false) => (above - here) / h,
                (false, true) => (here - below) / h,
                (true, true) => 0.0,
            };
            if slope.is_nan() { 0.0 } else { slope }
        })
    }

    /// Magnitude of the gradient, in the field's units per world unit; missing if the sample is.
    pub fn gradient_magnitude(&self) -> Self {
        let magnitude = |p| {
            let [x, y, z] = self.gradient(p);
            if self.at(p).is_nan() {
                f32::NAN
            } else {
                (x * x + y * y + z * z).sqrt()
            }
        };
        Self::new(self.grid, self.samples().map(magnitude).collect())
    }
}

/// All points from `low` up to but not including `high`, x fastest.
pub(crate) fn boxes(low: [u32; 3], high: [u32; 3]) -> impl Iterator<Item = [u32; 3]> {
    (low[2]..high[2]).flat_map(move |z| (low[1]..high[1]).flat_map(move |y| (low[0]..high[0]).map(move |x| [x, y, z])))
}

/// A point moved by an offset.
pub(crate) fn offset(p: [u32; 3], by: [u32; 3]) -> [u32; 3] {
    std::array::from_fn(|i| p[i] + by[i])
}
