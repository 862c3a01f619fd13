//! Transforms the vertices of a surface from the lattice to the world.

use isopeel_geometry::{DVec3, UnevenAxes};
use isopeel_kernels::Vertex;
use isopeel_view::quality::MesherName;
use isopeel_volumes::Geometry;

use super::ExportError;

/// Transformation from the lattice to the world.
pub(crate) struct Transform<'a> {
    /// Uneven axes, and the mesher that has made the surface.
    uneven: Option<(&'a UnevenAxes, MesherName)>,
    /// For uneven axes: lengths of the largest cells along each axis, for which the kernels compute normals.
    largest: DVec3,
    /// World position of the middle of the grid. Positions are relative to it, so that they are small enough for 32 bits even if the volume
    /// is far from the origin of the world.
    pub origin: DVec3,
    /// Lattice position of the middle of the grid.
    middle: DVec3,
    /// World length of one lattice unit along each axis.
    step: [DVec3; 3],
    /// Columns of the matrix for normals: the inverse transpose of `direction` up to a factor. This is equal to `direction` for rotations
    /// and reflections, and also correct for shears.
    normals: [DVec3; 3],
    /// Whether `direction` includes a reflection.
    pub mirrors: bool,
}

impl<'a> Transform<'a> {
    /// Returns the transformation of a geometry. `uneven` are axes whose samples are not evenly spaced, although they are in `geometry`,
    /// and the mesher that has made the surface.
    pub fn new(geometry: &Geometry, uneven: Option<(&'a UnevenAxes, MesherName)>) -> Self {
        let [x, y, z] = geometry.direction.map(DVec3::from);
        let cofactors = [y.cross(z), z.cross(x), x.cross(y)];
        let determinant = x.dot(cofactors[0]);
        let step = [(x, 0), (y, 1), (z, 2)]
            .map(|(direction, axis)| direction * geometry.spacing[axis] / f64::from(Vertex::LATTICE));
        let middle = geometry
            .dims
            .map(|n| f64::from((n - 1) / 2) * f64::from(Vertex::LATTICE));
        Self {
            uneven,
            largest: uneven.map_or(DVec3::ONE, |(uneven, _)| uneven.largest_steps().into()),
            origin: DVec3::from(geometry.origin) + combine(&step, middle),
            middle: middle.into(),
            step,
            normals: cofactors.map(|column| column * determinant.signum()),
            mirrors: determinant < 0.0,
        }
    }

    /// Converts a lattice position to a position relative to [`Transform::origin`].
    ///
    /// # Errors
    /// The position exceeds 32-bit floats.
    pub fn position(&self, lattice: [i64; 3]) -> Result<[f32; 3], ExportError> {
        let on_lattice = lattice.map(|p| p as f64);
        let even = match self.uneven {
            None => on_lattice,
            Some((uneven, _)) => (uneven.even_of(index_of(lattice)) * f64::from(Vertex::LATTICE)).to_array(),
        };
        let from_middle = combine(&self.step, (DVec3::from(even) - self.middle).to_array());
        let position = from_middle.to_array().map(|p| p as f32);
        let world = self.origin + from_middle;
        if position.iter().all(|p| p.is_finite()) && world.is_finite() {
            Ok(position)
        } else {
            Err(ExportError::OutOfRange(world.to_array()))
        }
    }

    /// Converts the normal of a vertex at a lattice position to a unit normal in the world.
    pub fn normal(&self, lattice: [i64; 3], normal: [f32; 3]) -> [f32; 3] {
        let normal = normal.map(f64::from);
        let normal = match self.uneven {
            None => normal,
            // The kernels have divided all differences by the largest cell. The gradient is larger if the real distance is shorter.
            Some((uneven, mesher)) => {
                let steps = gradient_steps(uneven, mesher, index_of(lattice));
                (DVec3::from(normal) * self.largest / steps).to_array()
            }
        };
        let world_normal = combine(&self.normals, normal);
        (world_normal / world_normal.length())
            .to_array()
            .map(|component| component as f32)
    }
}

/// Returns the distances, along each axis, over which a mesher has computed the gradient at a vertex. Marching cubes uses central
/// differences at the two samples of a grid edge. The dual mesher uses the trilinear interpolant in the cell of the vertex.
///
/// For the dual mesher, an error remains: normals were rounded to bytes for the largest cells, so that the error is larger in small cells.
fn gradient_steps(uneven: &UnevenAxes, mesher: MesherName, index: DVec3) -> DVec3 {
    match mesher {
        MesherName::MarchingCubes => uneven.difference_steps(index),
        MesherName::Dual => uneven.steps(index),
    }
}

/// Converts a position on the lattice to index space.
pub(crate) fn index_of(lattice: [i64; 3]) -> DVec3 {
    DVec3::from(lattice.map(|p| p as f64)) / f64::from(Vertex::LATTICE)
}

/// Returns the linear combination of three vectors.
fn combine([x, y, z]: &[DVec3; 3], weights: [f64; 3]) -> DVec3 {
    *x * weights[0] + *y * weights[1] + *z * weights[2]
}
