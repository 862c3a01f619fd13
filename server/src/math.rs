//! Vectors and affine maps in double precision, by glam.

pub use glam::{DAffine3, DVec3};
#[cfg(test)]
pub use glam::{DMat3, DQuat};

/// Normal of a triangle that is counter-clockwise seen from where it points; its length is twice the area.
pub fn triangle_normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}
