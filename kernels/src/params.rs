//! The user's parameters.

use crate::{Error, Interest, Result, TransferFunction, interest};

/// Level of a cube: it covers `2^level` cells per axis. 0 is the finest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(remote = "Self")
)]
pub struct Level(u8);

#[cfg(feature = "serde")]
crate::checked_serde!(Level, |level| Level::new(level.0));

/// The coarsest level there is: 32 cells per axis, one region.
pub const MAX_LEVEL: Level = Level(5);

impl Level {
    /// The finest level, single cells.
    pub const FINEST: Self = Self(0);

    /// # Errors
    /// A level above [`MAX_LEVEL`].
    pub fn new(level: u8) -> Result<Self> {
        if level > MAX_LEVEL.0 {
            return Err(Error::Invalid {
                what: "level",
                why: format!("{level}, expected 0 to {}", MAX_LEVEL.0),
            });
        }
        Ok(Self(level))
    }

    /// As a number, 0 to 5.
    pub const fn get(self) -> u8 {
        self.0
    }
}

/// An isovalue, in the file's own units; finite.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(remote = "Self")
)]
pub struct Isovalue(f32);

#[cfg(feature = "serde")]
crate::checked_serde!(Isovalue, |iso| Isovalue::new(iso.0));

impl Isovalue {
    /// # Errors
    /// Not a finite number.
    pub fn new(value: f32) -> Result<Self> {
        if !value.is_finite() {
            return Err(Error::Invalid {
                what: "isovalue",
                why: format!("{value}, expected a finite number"),
            });
        }
        Ok(Self(value))
    }

    /// In the file's own units.
    pub const fn get(self) -> f32 {
        self.0
    }
}

/// Which mesher turns the cut into triangles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Mesher {
    /// Dual contouring: watertight for any cut (`docs/algorithm.md#6-dual-contouring-mesher`).
    #[default]
    Dual,
    /// The paper's: marching cubes on every leaf, cracks patched (`docs/algorithm.md#5-marching-cubes-mesher`).
    MarchingCubes,
}

/// Whether decimation may change the surface's topology.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Topology {
    /// Only cubes that are safe to merge are decimated (`docs/algorithm.md#41-guards`): no part vanishes, no opening closes.
    #[default]
    Preserve,
    /// Small parts may vanish and openings close, as in the paper.
    Free,
}

/// Parameters of a cut: they decide how coarse the surface may be. Changing them never reads the volume again.
#[derive(Clone, Debug, PartialEq)]
pub struct CutParams {
    /// Weight of the user's feature against smoothness in eq. 3, in [0, 1].
    pub alpha: f32,
    /// A cube of importance up to this is decimated (eq. 4); below 0 gives the full surface.
    pub beta: f32,
    /// Instead of β: a cube is decimated if the error of its vertex over its weight is at most this; world units
    /// (`docs/algorithm.md#43-the-cut-by-error`).
    pub tolerance: Option<f32>,
    /// Feature values that become 0 and 1; `lo < hi`, both finite, in the feature's own units.
    pub feature_range: [f32; 2],
    /// Coarsest level a leaf may have.
    pub max_level: Level,
    /// Importance over the blended feature.
    pub transfer: TransferFunction,
    /// Regions in which importance is raised; at most [`interest::MAX_INTERESTS`].
    pub interest: Vec<Interest>,
    /// Maximum distance, root mean square in world units, of a decimated cube's vertex to the surface that it represents;
    /// `None`: no guard.
    pub max_error: Option<f32>,
    /// Whether decimation may change the surface's topology.
    pub topology: Topology,
    /// Which mesher turns the cut into triangles.
    pub mesher: Mesher,
    /// Measure the distance of the mesh from the full surface. Only the dual mesher supports this.
    pub state_error: bool,
    /// The volume was padded by one sample on every side: move vertices in the padding onto the volume's faces.
    pub cap: bool,
}

impl CutParams {
    /// The paper's cut and mesher: no guard, identity transfer function, smoothness alone.
    pub fn paper(beta: f32) -> Self {
        Self {
            alpha: 0.0,
            beta,
            tolerance: None,
            feature_range: [0.0, 1.0],
            max_level: MAX_LEVEL,
            transfer: TransferFunction::default(),
            interest: Vec::new(),
            max_error: None,
            topology: Topology::Free,
            mesher: Mesher::MarchingCubes,
            state_error: false,
            cap: false,
        }
    }

    /// Whether importance is above 0 anywhere, so that weights differ.
    pub fn has_importance(&self) -> bool {
        self.transfer.points().iter().any(|point| point.importance > 0.0)
            || self.interest.iter().any(|interest| interest.importance > 0.0)
    }

    /// Whether importance depends on the same values as in `other`.
    pub(crate) fn has_importance_of(&self, other: &Self) -> bool {
        self.alpha == other.alpha
            && self.feature_range == other.feature_range
            && self.transfer == other.transfer
            && self.interest == other.interest
    }

    /// Whether the cut is the full surface of the dual mesher, which needs no node above the cells.
    pub fn is_full(&self, prefix: Level) -> bool {
        self.beta < 0.0 && self.tolerance.is_none() && prefix == Level::FINEST && self.mesher == Mesher::Dual
    }

    /// # Errors
    /// A value outside the range its field states.
    pub fn check(&self) -> Result<()> {
        if !(0.0..=1.0).contains(&self.alpha) {
            return Err(Error::Invalid {
                what: "alpha",
                why: format!("{}, expected 0 to 1", self.alpha),
            });
        }
        if !self.beta.is_finite() {
            return Err(Error::Invalid {
                what: "beta",
                why: format!("{}, expected a finite number", self.beta),
            });
        }
        if let Some(e) = self.tolerance
            && (e.is_nan() || e < 0.0)
        {
            return Err(Error::Invalid {
                what: "tolerance",
                why: format!("{e}, expected world units, 0 or more"),
            });
        }
        if let Some(e) = self.max_error
            && !(e.is_finite() && e >= 0.0)
        {
            return Err(Error::Invalid {
                what: "max error",
                why: format!("{e}, expected a finite number of world units, 0 or more"),
            });
        }
        let [lo, hi] = self.feature_range;
        if !lo.is_finite() || !hi.is_finite() || lo >= hi {
            return Err(Error::Invalid {
                what: "feature range",
                why: format!("[{lo}, {hi}], expected two finite numbers, the first below the second"),
            });
        }
        interest::check(&self.interest)
    }
}
