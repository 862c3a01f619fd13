//! Importance and colour over the blended feature, as JSON.

use isopeel_kernels::{ControlPoint, TransferFunction};
use serde::{Deserialize, Serialize};

use super::error::EditError;

/// A transfer function as it travels; the kernels know importance alone, colour is the viewer's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS), ts(rename = "TransferFunction"))]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct TransferFunctionJson {
    /// Control points, 1 to 64.
    #[cfg_attr(feature = "openapi", schema(min_items = 1, max_items = 64))]
    pub points: Vec<PointJson>,
}

/// One control point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS), ts(rename = "ControlPoint"))]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct PointJson {
    /// Position on the blended feature, 0 to 1.
    pub x: f32,
    /// Importance there, 0 to 1.
    pub importance: f32,
    /// Colour there, `#rrggbb`.
    pub color: String,
}

impl Default for TransferFunctionJson {
    /// Returns the function whose importance is the blended feature itself, coloured from blue to orange.
    fn default() -> Self {
        let point = |x: f32, color: &str| PointJson {
            x,
            importance: x,
            color: color.to_owned(),
        };
        Self {
            points: vec![point(0.0, "#3465a4"), point(1.0, "#f57900")],
        }
    }
}

impl TransferFunctionJson {
    /// Converts to the kernels' type, which has importance but no colours.
    ///
    /// # Errors
    /// There is no point, there are too many points, or a coordinate is not in [0, 1].
    pub fn to_kernel(&self) -> Result<TransferFunction, EditError> {
        let points = self.points.iter().map(|point| ControlPoint {
            x: point.x,
            importance: point.importance,
        });
        TransferFunction::new(points.collect()).map_err(|error| EditError {
            field: "transferFunction",
            why: match error {
                isopeel_kernels::Error::Invalid { why, .. } => why,
                other => other.to_string(),
            },
        })
    }

    /// Checks coordinates and colours.
    pub(super) fn check(&self) -> Result<(), EditError> {
        self.to_kernel()?;
        for (i, point) in self.points.iter().enumerate() {
            let digits = point.color.strip_prefix('#').unwrap_or_default();
            if digits.len() != 6 || !digits.bytes().all(|b| b.is_ascii_hexdigit()) {
                return Err(EditError {
                    field: "transferFunction",
                    why: format!("point {i} has color {:?}, expected #rrggbb", point.color),
                });
            }
        }
        Ok(())
    }
}
