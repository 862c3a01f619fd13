//! [`Edit`] is any part of a view as JSON, in REST and WebSocket alike; field names are normative in `PROTOCOL.md`.

use serde::{Deserialize, Deserializer, Serialize};

use super::camera::{CameraJson, Detail};
use super::chosen_parts::ChosenPartsJson;
use super::interest::InterestJson;
use super::quality::{self, ErrorLimit, MaxError, MesherName, TopologyName, TriangleBudget};
use super::transfer_function::TransferFunctionJson;

/// Deserializes a field that is present: null is a value, an absent field no change.
fn present<'de, D: Deserializer<'de>, T: Deserialize<'de>>(deserializer: D) -> Result<Option<T>, D::Error> {
    T::deserialize(deserializer).map(Some)
}

/// Any subset of what can be edited; what is absent stays as it was.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS), ts(optional_fields))]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Edit {
    /// Isovalue, in the field's units.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub iso: Option<f32>,
    /// Field whose isosurface is shown, or an expression over fields such as `log(rho)`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub field: Option<String>,
    /// Restricts the surface to samples at which a field of the volume has certain values, `labels==3`; null: no restriction. Cells that
    /// touch other samples have no surface, as beside missing samples.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "present")]
    #[cfg_attr(feature = "openapi", schema(value_type = Option<String>))]
    #[cfg_attr(feature = "typescript", ts(type = "string | null"))]
    pub mask: Option<Option<String>>,
    /// Feature that matters to the user: a field's name, a feature of the shown field such as `gradient-magnitude`, a feature of three
    /// fields such as `divergence(u,v,w)`, an expression over fields such as `magnitude(u,v,w)`, the distance to the nearest sample at
    /// which a condition holds, such as `distance(labels==3)`, or `none`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feature: Option<String>,
    /// Feature values that become 0 and 1, in the feature's units; the feature's own range when never given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(min_items = 2, max_items = 2))]
    pub feature_range: Option<[f32; 2]>,
    /// Field whose values at the vertices are sent for colours, or an expression over fields; null: none. It changes no triangle. The field
    /// of `feature` needs no such values: chunks have it already. Files have no such values, but those of `fieldValues`.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "present")]
    #[cfg_attr(feature = "openapi", schema(value_type = Option<String>))]
    #[cfg_attr(feature = "typescript", ts(type = "string | null"))]
    pub color_field: Option<Option<String>>,
    /// Weight of the feature against smoothness, 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alpha: Option<f32>,
    /// Importance up to which a cube is decimated; below 0 gives the full surface. An export with it is exactly that cut:
    /// guards that it does not name are off. What decides is β, or an error and a budget: an edit that names one of `beta`,
    /// `error`, `triangles` and `bytes` takes the place of all four.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub beta: Option<f32>,
    /// How far the surface may be decimated, instead of `beta`: a part is merged up to this error over its weight, which falls
    /// with importance and grows with the distance to the camera. In pixels it is that within which nearly all of what the camera sees lies;
    /// without a camera, a pixel counts as a tenth of the smallest spacing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<ErrorLimit>,
    /// Maximum triangles, instead of `beta`: the smallest tolerance that keeps it is found. Beside `error`, the greater of both
    /// decides.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub triangles: Option<TriangleBudget>,
    /// Maximum bytes on the wire, as `triangles`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bytes: Option<u64>,
    /// Parts of the surface, those that nothing connects, with a smaller area are removed first; world units, 0 or more. 0 or null:
    /// none are. Beside `error`, `triangles` or `bytes`, with the dual mesher: an edit that lets β decide, or another mesher, ends it.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "quality::some_min_part"
    )]
    #[cfg_attr(feature = "typescript", ts(type = "number | null"))]
    pub min_part: Option<f64>,
    /// Parts that are chosen by positions: hidden, or kept while all others are removed; null: all are shown. As `minPart`, with which
    /// both combine.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "present")]
    #[cfg_attr(feature = "openapi", schema(value_type = Option<ChosenPartsJson>))]
    pub parts: Option<Option<ChosenPartsJson>>,
    /// Guard: largest distance of a decimated part to the surface it stands for.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "present")]
    pub max_error: Option<MaxError>,
    /// Guard: whether decimation may change the topology.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub topology: Option<TopologyName>,
    /// Mesher that turns the cut into triangles.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mesher: Option<MesherName>,
    /// Whether surfaces that leave the volume are closed on its faces. Exports only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cap: Option<bool>,
    /// Coarsest level, 0 to 5.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_level: Option<u8>,
    /// Importance and colour over the blended feature.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub transfer_function: Option<TransferFunctionJson>,
    /// Regions of interest, in which importance is raised, at most 64. They replace those set before.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(max_items = 64))]
    pub interest: Option<Vec<InterestJson>>,
    /// Whether what the camera sees from near is finer, or every part alike. Of a surface that an error or a budget decides, with the dual
    /// mesher.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub detail: Option<Detail>,
    /// Camera for which the surface is made. Requests only: in the stream, the message `camera` has it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<CameraJson>,
}

impl Edit {
    /// Fills in the default guards for a command line or an export, which has no earlier edits that could have set them. With β, guards
    /// that are not given are off, so that β means exactly the cut of eq. 4. With an error or a budget they are `auto`, which gives the
    /// best surface.
    #[must_use]
    pub fn with_default_guards(self) -> Self {
        let (max_error, topology) = if self.beta.is_some() {
            (MaxError::None, TopologyName::Free)
        } else if self.error.is_some() || self.triangles.is_some() || self.bytes.is_some() {
            (MaxError::Auto, TopologyName::Auto)
        } else {
            return self;
        };
        Self {
            max_error: self.max_error.or(Some(max_error)),
            topology: self.topology.or(Some(topology)),
            ..self
        }
    }
}
