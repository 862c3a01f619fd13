//! Transforms a surface's vertices from the lattice to the world.

use isopeel_geometry::{DVec3, UnevenAxes};
use isopeel_kernels::Vertex;
use isopeel_view::quality::MesherName;
use isopeel_volumes::Geometry;

use super::ExportError;

/// Transformation from the lattice to the world.
pub(crate) struct Transform<'a> {
    uneven: Option<(&'a UnevenAxes, MesherName)>,
    /// For uneven axes: cell lengths for which the kernels compute normals. They are those of the largest cells.
    largest: DVec3,
    /// World position of the middle of the grid, to which positions are relative. So they are small numbers, which 32 bits hold, however
    /// far the volume is from the world's origin.
    pub origin: DVec3,
    /// The middle of the grid on the lattice.
    middle: DVec3,
    /// World length of one lattice unit along each axis.
    step: [DVec3; 3],
    /// Transforms normals: inverse transpose of `direction` up to a factor. Equal to `direction` if that is a rotation or a reflection, and
    /// correct for shears too.
    normals: [DVec3; 3],
    /// Whether `direction` includes a reflection.
    pub mirrors: bool,
}

impl<'a> Transform<'a> {
    /// `uneven`: the axes whose samples, unlike those in `geometry`, are not evenly spaced, and the mesher that made the surface.
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

    /// Position of a vertex, relative to [`Transform::origin`].
    ///
    /// # Errors
    /// Beyond 32-bit floats.
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

    /// Returns the normal in the world of a vertex at this position.
    pub fn normal(&self, lattice: [i64; 3], normal: [f32; 3]) -> [f32; 3] {
        let normal = normal.map(f64::from);
        let normal = match self.uneven {
            None => normal,
            // Over a shorter distance, the same difference of values is a larger gradient.
            Some((uneven, mesher)) => {
                let steps = gradient_steps(uneven, mesher, index_of(lattice));
                (DVec3::from(normal) * self.largest / steps).to_array()
            }
        };
        let turned = combine(&self.normals, normal);
        (turned / turned.length()).to_array().map(|component| component as f32)
    }
}

/// Returns the lengths over which the gradient at a vertex was taken. Marching cubes takes differences at the two samples of an edge of the
/// grid. The dual mesher takes the gradient of the trilinear interpolant in the vertex' own cell: the remaining error is the rounding to
/// bytes for the largest cells, which weighs more if a cell is small.
fn gradient_steps(uneven: &UnevenAxes, mesher: MesherName, index: DVec3) -> DVec3 {
    match mesher {
        MesherName::MarchingCubes => uneven.difference_steps(index),
        MesherName::Dual => uneven.steps(index),
    }
}

/// Converts a position on the lattice to index space.
fn index_of(lattice: [i64; 3]) -> DVec3 {
    DVec3::from(lattice.map(|p| p as f64)) / f64::from(Vertex::LATTICE)
}

fn combine([x, y, z]: &[DVec3; 3], weights: [f64; 3]) -> DVec3 {
    *x * weights[0] + *y * weights[1] + *z * weights[2]
}
