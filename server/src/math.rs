//! Vectors and affine maps in double precision, by glam; axes with uneven positions.

mod uneven;

pub use glam::{DAffine3, DVec3};
#[cfg(test)]
pub use glam::{DMat3, DQuat};
pub use uneven::{IndexSpace, UnevenAxes};

/// Returns the normal of a triangle whose corners are counter-clockwise if seen from the side to which it points; its length is twice the
/// area.
pub fn triangle_normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}
