//! A device with its programs: loads volumes, builds pyramids, peels surfaces.

use crate::{CutParams, DeviceInfo, Error, Grid, Isovalue, Level, Result, Samples, Surface, Volume};

/// Asked between stages whether the work is still wanted.
pub trait Cancel {
    /// True when the caller has no more use for the result.
    fn cancelled(&self) -> bool;
}

/// Never cancels.
pub struct Never;

impl Cancel for Never {
    fn cancelled(&self) -> bool {
        false
    }
}

/// What the user's importance looks at, beside smoothness.
#[derive(Clone, Copy)]
pub enum Feature<'a> {
    /// Nothing: `f` is zero everywhere.
    None,
    /// Another field on the same grid.
    Field(&'a Volume),
    /// Magnitude of the field's own gradient, in its units per world unit.
    GradientMagnitude,
}

/// Range and distribution of a field or a derived feature.
#[derive(Clone, Debug, PartialEq)]
pub struct Histogram {
    /// Least and greatest finite value; `[0, 0]` when there is none.
    pub range: [f32; 2],
    /// Samples in 256 equal bins from `range[0]` to `range[1]`.
    pub bins: Vec<u64>,
}

/// What depends on the isovalue and the feature alone: active bricks and nodes of levels 0 to 5 (algorithm, sections
/// 2 and 3). Peel it as often as α, β or the transfer function change.
pub struct Pyramid {}

/// A device, its queue and its programs. Lives on one thread.
pub struct Engine {
    info: DeviceInfo,
}

impl Engine {
    /// Opens the preferred device, or the one that `selector` names by index or by a part of its name.
    ///
    /// # Errors
    /// As [`crate::device::list`]; [`Error::NoDevice`] when the selector matches none.
    pub fn open(selector: Option<&str>) -> Result<Self> {
        let _ = selector;
        Err(Error::NoDriver)
    }

    /// The device in use.
    pub fn device(&self) -> &DeviceInfo {
        &self.info
    }

    /// Puts a field on the device and makes its min/max table. `missing` samples count as NaN.
    ///
    /// # Errors
    /// Too few samples for the grid, or no device memory.
    pub fn upload(&self, grid: &Grid, samples: &Samples, missing: Option<f32>) -> Result<Volume> {
        let _ = (grid, samples, missing);
        Err(Error::NoDriver)
    }

    /// Bytes that [`Engine::upload`] will take for a field, min/max table included.
    pub fn upload_bytes(&self, grid: &Grid, sample_bytes: usize) -> u64 {
        let _ = (grid, sample_bytes);
        0
    }

    /// Range and 256-bin histogram of a field (`Feature::None` or `Field`) or of its gradient magnitude.
    pub fn histogram(&self, volume: &Volume, feature: Feature<'_>) -> Result<Histogram> {
        let _ = (volume, feature);
        Err(Error::NoDriver)
    }

    /// Finds the active bricks and builds the pyramid of one isovalue.
    ///
    /// # Errors
    /// [`Error::Cancelled`], or what the device says.
    pub fn build_pyramid(
        &self,
        volume: &Volume,
        feature: Feature<'_>,
        iso: Isovalue,
        cancel: &dyn Cancel,
    ) -> Result<Pyramid> {
        let _ = (volume, feature, iso, cancel);
        Err(Error::NoDriver)
    }

    /// Cuts the pyramid and meshes the cut. With `prefix` above 0, undecided cubes of that level count as leaves
    /// (algorithm, section 7). `volume` is the one the pyramid was built from.
    ///
    /// # Errors
    /// [`Error::Cancelled`], or what the device says.
    pub fn peel(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        params: &CutParams,
        prefix: Level,
        cancel: &dyn Cancel,
    ) -> Result<Surface> {
        let _ = (volume, pyramid, params, prefix, cancel);
        Err(Error::NoDriver)
    }
}
