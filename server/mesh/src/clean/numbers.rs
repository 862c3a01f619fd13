//! Positions of a mesh as a file stores them.

use crate::decimal::Decimals;
use crate::{Format, Mesh};

/// How a file stores positions, which decides whether triangles intersect.
#[derive(Clone, Copy)]
pub(super) enum Numbers {
    /// Exactly as in the mesh, or as 64-bit world positions.
    Exact,
    /// As 32-bit world positions.
    Rounded,
    /// As decimal text of world positions.
    WorldDecimals(Decimals),
    /// As decimal text, relative to the origin of the mesh.
    Decimals(Decimals),
    /// As decimal text, relative to the origin of the mesh, that readers convert to 32 bits.
    RoundedDecimals(Decimals),
}

impl Numbers {
    pub(super) fn new(mesh: &Mesh, format: Format) -> Self {
        match format {
            Format::Obj => Self::WorldDecimals(Decimals::of_spacing(mesh.smallest_spacing)),
            Format::ThreeMf => Self::Decimals(Decimals::of_spacing(mesh.smallest_spacing)),
            Format::Usdz => Self::RoundedDecimals(Decimals::of_spacing(mesh.smallest_spacing)),
            _ if format.rounds() => Self::Rounded,
            _ => Self::Exact,
        }
    }

    /// Returns a position of a mesh as its file stores it.
    pub(super) fn position(self, mesh: &Mesh, position: [f32; 3]) -> [f64; 3] {
        let position = position.map(f64::from);
        let world = [0, 1, 2].map(|axis| mesh.origin[axis] + position[axis]);
        match self {
            Self::Exact => position,
            // May be infinite here: the writer refuses a position beyond 32 bits.
            Self::Rounded => world.map(|component| f64::from(component as f32)),
            Self::WorldDecimals(decimals) => world.map(|component| decimals.rounded(component)),
            Self::Decimals(decimals) => position.map(|component| decimals.rounded(component)),
            Self::RoundedDecimals(decimals) => position.map(|component| f64::from(decimals.rounded(component) as f32)),
        }
    }

    pub(super) fn all(self, mesh: &Mesh) -> Vec<[f64; 3]> {
        let positions = mesh.positions.iter();
        positions.map(|&position| self.position(mesh, position)).collect()
    }
}
