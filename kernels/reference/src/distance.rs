//! Distances of points to the isosurface, by brute force.

use crate::Field;
use crate::error::surface_points;

/// Returns the distances of points to the nearest of many points of the surface, in world units; infinite if there is none. The surface
/// itself may be nearer by a part of a cell's diagonal, which is returned too. `points` are in cells. `vertices`: of the active cells. They
/// count as points of the surface, although in noise the Newton steps do not move all of them onto it.
pub fn distances(field: &Field, iso: f32, vertices: &[[f32; 3]], points: &[[f32; 3]]) -> (Vec<f64>, f64) {
    let spacing = field.grid.spacing.map(f64::from);
    let world = |point: &[f32; 3]| -> [f64; 3] { std::array::from_fn(|i| f64::from(point[i]) * spacing[i]) };
    let mut surface = surface_points(field, iso, false, 2);
    surface.extend(vertices.iter().map(world));
    let of_point = |point: &[f32; 3]| {
        let at = world(point);
        let squares = surface
            .iter()
            .map(|p| (0..3).map(|i| (p[i] - at[i]).powi(2)).sum::<f64>());
        squares.fold(f64::INFINITY, f64::min).sqrt()
    };
    let diagonal = spacing.iter().map(|s| s * s).sum::<f64>().sqrt();
    (
        points.iter().map(of_point).collect(),
        crate::error::BETWEEN_POINTS * diagonal,
    )
}
