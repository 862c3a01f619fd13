//! A volume at a low resolution.

use crate::Field;

/// What stands for the samples of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Their mean.
    Mean,
    /// Their maximum.
    Maximum,
}

/// Samples of a block along an axis of `samples`, so that there are at most `side` blocks.
pub fn factor(samples: u32, side: u32) -> u32 {
    (1..).find(|n| samples.div_ceil(*n) <= side).unwrap_or(samples)
}

/// The value of each block of a field over its finite samples, x fastest; `None` for a block without any.
pub fn overview(field: &Field, mode: Mode, side: u32) -> Vec<Option<f64>> {
    let samples = field.grid.dims;
    let factors = samples.map(|n| factor(n, side));
    let [nx, ny, nz] = [0, 1, 2].map(|axis: usize| samples[axis].div_ceil(factors[axis]) as usize);
    let mut blocks: Vec<Vec<f64>> = vec![Vec::new(); nx * ny * nz];
    for at in field.samples() {
        let [x, y, z] = [0, 1, 2].map(|axis: usize| (at[axis] / factors[axis]) as usize);
        let value = field.at(at);
        if value.is_finite() {
            blocks[(z * ny + y) * nx + x].push(value.into());
        }
    }
    let value = |block: &Vec<f64>| match mode {
        _ if block.is_empty() => None,
        Mode::Mean => Some(block.iter().map(|v| v / block.len() as f64).sum()),
        Mode::Maximum => block.iter().copied().reduce(f64::max),
    };
    blocks.iter().map(value).collect()
}
