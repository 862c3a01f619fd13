//! The transfer function `t`: importance and colour over a feature value in [0, 1] (paper, fig. 1 and eq. 3).

use crate::{Error, Result};

/// Most control points a transfer function may have; bounds the constant memory the cut stage needs.
pub const MAX_POINTS: usize = 64;

/// A control point. Between points importance is linear; beyond the ends it is constant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControlPoint {
    /// Position on the axis of the blended feature, in [0, 1].
    pub x: f32,
    /// Importance there, in [0, 1].
    pub importance: f32,
}

/// Piecewise linear importance; points sorted by `x`, at least one, at most [`MAX_POINTS`].
#[derive(Clone, Debug, PartialEq)]
pub struct TransferFunction {
    points: Vec<ControlPoint>,
}

impl TransferFunction {
    /// Sorts the points by `x` (stable: of two at one `x` the earlier is the left side of a step).
    ///
    /// # Errors
    /// No point, too many, or a coordinate that is not in [0, 1].
    pub fn new(mut points: Vec<ControlPoint>) -> Result<Self> {
        if points.is_empty() || points.len() > MAX_POINTS {
            return Err(Error::Invalid {
                what: "transfer function",
                why: format!("{} points, expected 1 to {MAX_POINTS}", points.len()),
            });
        }
        for (i, p) in points.iter().enumerate() {
            if !(0.0..=1.0).contains(&p.x) || !(0.0..=1.0).contains(&p.importance) {
                return Err(Error::Invalid {
                    what: "transfer function",
                    why: format!(
                        "point {i} is ({}, {}), expected x and importance in [0, 1]",
                        p.x, p.importance
                    ),
                });
            }
        }
        points.sort_by(|a, b| a.x.total_cmp(&b.x));
        Ok(Self { points })
    }

    /// The control points, sorted by `x`.
    pub fn points(&self) -> &[ControlPoint] {
        &self.points
    }

    /// Importance at `x`.
    pub fn importance(&self, x: f32) -> f32 {
        let points = &self.points;
        let right = points.partition_point(|p| p.x <= x);
        match right {
            0 => points[0].importance,
            n if n == points.len() => points[n - 1].importance,
            _ => {
                let (a, b) = (points[right - 1], points[right]);
                a.importance + (b.importance - a.importance) * ((x - a.x) / (b.x - a.x))
            }
        }
    }
}

impl Default for TransferFunction {
    /// The identity: importance equals the blended feature.
    fn default() -> Self {
        Self {
            points: vec![
                ControlPoint {
                    x: 0.0,
                    importance: 0.0,
                },
                ControlPoint {
                    x: 1.0,
                    importance: 1.0,
                },
            ],
        }
    }
}
