//! Answers to questions about a surface, as they go to clients.

use isopeel_kernels::{Region, bulk};
use serde::ser::SerializeStruct;
use serde::{Deserialize, Serialize, Serializer};

use crate::statistics::in_world;

/// The answer to a [`Question`](super::Question).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Answer {
    /// Answer to [`Question::Probe`](super::Question::Probe).
    Probe(Probe),
    /// Answer to [`Question::Distribution`](super::Question::Distribution).
    Distribution(Distribution),
    /// Answer to [`Question::Curve`](super::Question::Curve).
    Curve(Curve),
    /// Answer to [`Question::VertexErrors`](super::Question::VertexErrors), one entry for each region of the surface.
    VertexErrors(Vec<VertexErrors>),
}

/// Distances of the vertices of a region to the isosurface, world units; infinite if it is not near.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VertexErrors {
    /// The region, as it was made.
    pub region: Region,
    /// Distance of each vertex of the region.
    #[serde(with = "bulk")]
    pub distances: Vec<f32>,
}

/// What the leaves of a surface are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
#[serde(rename_all = "kebab-case")]
pub enum LeafKind {
    /// Of the octree.
    Cubes,
    /// Of the vertex tree.
    Tree,
}

/// Why there is no value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
#[serde(rename_all = "kebab-case")]
pub enum NoValue {
    /// A sample that counts is missing, or it is not a finite number.
    Missing,
    /// The field is not on the device.
    NotResident,
}

/// A field at a position.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct FieldValue {
    /// Name of the field.
    pub field: String,
    /// Trilinearly interpolated value in the field's units; null if there is none.
    pub value: Option<f32>,
    /// Why there is no value.
    #[cfg_attr(feature = "typescript", ts(optional))]
    pub why: Option<NoValue>,
}

impl Serialize for FieldValue {
    /// Leaves out `why` in JSON if there is a value. Binary formats cannot read a struct that lacks a field.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let has_why = self.why.is_some() || !serializer.is_human_readable();
        let mut fields = serializer.serialize_struct("FieldValue", 2 + usize::from(has_why))?;
        fields.serialize_field("field", &self.field)?;
        fields.serialize_field("value", &self.value)?;
        if has_why {
            fields.serialize_field("why", &self.why)?;
        }
        fields.end()
    }
}

/// The leaf that stands for a part of the surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct NearestLeaf {
    /// Kind of the leaf.
    pub kind: LeafKind,
    /// Level of the leaf.
    pub level: u8,
    /// Estimated error of the leaf, root mean square in world units.
    pub error: f32,
}

/// The full surface's vertex that is nearest to a position.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct NearestSurface {
    /// Distance from the position to the vertex, in world units.
    pub distance: f32,
    /// Smoothness feature.
    pub smoothness: f32,
    /// User feature, in the feature's own units.
    pub feature: f32,
    /// Blend of both features: the input of the transfer function.
    pub blended: f32,
    /// Importance.
    pub importance: f32,
    /// The leaf that stands for it in the surface that is shown; null if that surface has none there, or if the leaf is not known.
    pub leaf: Option<NearestLeaf>,
    /// Number of its part in the full surface: the same at all places of one part, as long as isovalue, field and guards stay; null as
    /// `partArea`.
    pub part: Option<u32>,
    /// Area of its part in the full surface, world units; null if it belongs to no part, and if parts are not known: the surface is not a
    /// cut of the tree, or it is large and no part of it has been removed yet.
    pub part_area: Option<f32>,
}

/// What is at a position.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct Probe {
    /// The position, in the world.
    pub position: [f64; 3],
    /// Whether it is in the volume.
    pub inside: bool,
    /// Every field there; none outside.
    pub values: Vec<FieldValue>,
    /// The surface next to it; null if there is none within two cells.
    pub nearest: Option<NearestSurface>,
}

/// Distribution of the blended feature over a surface: each vertex of the full surface counts once, with the leaf that stands for it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct Distribution {
    /// Kind of the leaves.
    pub kind: LeafKind,
    /// Number of vertices in each of the equal bins from 0 to 1.
    pub bins: Vec<u32>,
    /// Number of those vertices whose leaf stands for several vertices, in each bin.
    pub coarse: Vec<u32>,
    /// Share of `coarse` in all vertices.
    pub coarse_share: f64,
}

/// A cut of a curve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct CurvePoint {
    /// Triangles of its surface.
    pub triangles: u64,
    /// Estimated error, root mean square in world units.
    pub rms: f32,
    /// Tolerance, world units, or β; below 0 for the full surface.
    pub threshold: f32,
}

/// How the estimated error grows as triangles get fewer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct Curve {
    /// Kind of the leaves of the cuts.
    pub kind: LeafKind,
    /// Whether thresholds are tolerances, or else β.
    pub by_error: bool,
    /// Cuts from the full surface to the coarsest.
    pub points: Vec<CurvePoint>,
}

impl CurvePoint {
    /// Converts a point to world units, from the device's multiples of the smallest spacing. β has no unit.
    pub(crate) fn in_world(point: isopeel_kernels::CurvePoint, by_error: bool, smallest: f64) -> Self {
        let threshold = match by_error {
            true => in_world(point.threshold, smallest),
            false => point.threshold,
        };
        Self {
            triangles: point.triangles,
            rms: in_world(point.rms, smallest),
            threshold,
        }
    }
}
