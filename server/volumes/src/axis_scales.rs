//! Meaning of the positions along the axes of a volume, as its file states it: longitudes, depths.

use serde::{Deserialize, Serialize};

/// Kind of the positions along an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum AxisKind {
    /// Degrees east.
    Longitude,
    /// Degrees north.
    Latitude,
    /// Distance below a surface.
    Depth,
    /// Distance above a surface.
    Height,
    /// Decreases upwards.
    Pressure,
    /// Any other kind, or an unknown one.
    Other,
}

impl AxisKind {
    /// Name in descriptions.
    pub fn name(self) -> &'static str {
        match self {
            Self::Longitude => "longitude",
            Self::Latitude => "latitude",
            Self::Depth => "depth",
            Self::Height => "height",
            Self::Pressure => "pressure",
            Self::Other => "other",
        }
    }
}

/// Positions along one axis of a volume.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AxisScale {
    /// Its name in the file.
    pub name: String,
    /// Unit of the positions, as the file says it.
    pub unit: Option<String>,
    /// Kind of the positions.
    pub kind: AxisKind,
    /// Position of each sample. `None` if the world's coordinate along the axis is the position.
    pub positions: Option<Vec<f64>>,
    /// If there are no `positions`: whether the position is the world's coordinate times −1.
    pub points_down: bool,
}

/// Scales of the axes x, y and z; `None` for an axis that the file does not describe.
pub type AxisScales = [Option<AxisScale>; 3];
