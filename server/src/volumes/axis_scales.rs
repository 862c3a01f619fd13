//! What the positions along the axes of a volume are, as its file says it: longitudes, depths.

/// What positions along an axis are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AxisKind {
    /// Degrees east.
    Longitude,
    /// Degrees north.
    Latitude,
    /// Below a surface.
    Depth,
    /// Above one.
    Height,
    /// Decreases upwards.
    Pressure,
    /// What the file has no word for that is known here.
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
#[derive(Clone, Debug, PartialEq)]
pub struct AxisScale {
    /// Its name in the file.
    pub name: String,
    /// Unit of the positions, as the file says it.
    pub unit: Option<String>,
    /// What they are.
    pub kind: AxisKind,
    /// Position of each sample. `None`: the world's coordinate along the axis is the position.
    pub positions: Option<Vec<f64>>,
    /// Without `positions`: the position is the world's coordinate times −1.
    pub points_down: bool,
}

/// Those along x, y and z, where the file says them.
pub type AxisScales = [Option<AxisScale>; 3];
