//! What a user asks for, as JSON, in REST and WebSocket alike. Field names are normative in `PROTOCOL.md`.

use serde::{Deserialize, Serialize};

/// Any subset of what can be edited; what is absent stays as it was.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Edit {
    /// Isovalue, in the field's units.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub iso: Option<f32>,
    /// Field whose isosurface is shown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub field: Option<String>,
    /// Feature that matters to the user: a field's name, `gradient-magnitude`, or `none`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feature: Option<String>,
    /// Feature values that become 0 and 1, in the feature's units; the feature's own range when `null` was never replaced.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feature_range: Option<[f32; 2]>,
    /// Weight of the feature against smoothness, 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alpha: Option<f32>,
    /// Importance up to which a cube is decimated; below 0 gives the full surface.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub beta: Option<f32>,
    /// Coarsest level, 0 to 5.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_level: Option<u8>,
    /// Importance and colour over the blended feature.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub transfer_function: Option<TransferFunctionJson>,
}

/// A transfer function as it travels; the kernels know importance alone, colour is the viewer's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct TransferFunctionJson {
    /// Control points, 1 to 64.
    pub points: Vec<PointJson>,
}

/// One control point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct PointJson {
    /// Where on the blended feature, 0 to 1.
    pub x: f32,
    /// Importance there, 0 to 1.
    pub importance: f32,
    /// Colour there, `#rrggbb`.
    pub color: String,
}
