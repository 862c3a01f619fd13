//! What importance looks at beside smoothness, and how its values are distributed.

use crate::Volume;

/// The feature that the importance blends with smoothness (eq. 3).
#[derive(Clone, Copy)]
pub enum Feature<'a> {
    /// None: `f` is zero everywhere.
    None,
    /// Another field on the same grid.
    Field(&'a Volume),
    /// Magnitude of the field's own gradient, in its units per world unit.
    GradientMagnitude,
}

/// Range and distribution of a field or a derived feature.
#[derive(Clone, Debug, PartialEq)]
pub struct Histogram {
    /// Minimum and maximum finite value; `[0, 0]` when there is none.
    pub range: [f32; 2],
    /// Samples in 256 equal bins from `range[0]` to `range[1]`.
    pub bins: Vec<u64>,
}
