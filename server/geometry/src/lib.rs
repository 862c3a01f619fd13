//! Geometry in double precision: vectors and affine maps, by glam; axes with uneven positions; triangles of a mesh that intersect.

mod intersections;
mod uneven;

pub use glam::{DAffine3, DMat3, DQuat, DVec3};
pub use intersections::{Bounds, Corners, TriangleSoup, TriangleTree, has_area, intersect};
pub use uneven::{IndexSpace, UnevenAxes};

/// Returns the normal of a triangle whose corners are counter-clockwise if seen from the side to which it points; its length is twice the
/// area.
pub fn triangle_normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}
