//! Position of each vertex of a capped surface relative to the caps, which lie on faces of the volume.

use isopeel_geometry::DVec3;
use isopeel_volumes::Geometry;

/// Position of a vertex relative to the caps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ToCaps {
    /// Bits of the faces on which the vertex lies. Bit 2·axis is the face at the low end of the axis; bit 2·axis + 1 is the face at the
    /// high end.
    faces: u8,
    /// Whether the vertex is so close to a face that the cap may have changed the surface there.
    pub is_near: bool,
}

impl ToCaps {
    /// Classifies a position in the index space of a capped volume. `dims` are the samples along each axis, including one sample of padding
    /// on each side. The position is near a face if their distance is less than `reach` cells.
    pub fn of(position: [f32; 3], dims: [u32; 3], reach: f32) -> Self {
        let mut to_caps = Self::default();
        for (axis, (coordinate, n)) in position.into_iter().zip(dims).enumerate() {
            let [first, last] = [1.0, n as f32 - 2.0];
            let faces = u8::from(coordinate == first) | u8::from(coordinate == last) << 1;
            to_caps.faces |= faces << (2 * axis);
            to_caps.is_near |= coordinate < first + reach || coordinate > last - reach;
        }
        to_caps
    }

    fn is_on(self, face: usize) -> bool {
        self.faces >> face & 1 == 1
    }

    /// Whether the vertex is on one of the two faces across an axis.
    fn is_on_axis(self, axis: usize) -> bool {
        self.is_on(2 * axis) || self.is_on(2 * axis + 1)
    }
}

/// The faces of a volume, as planes in the world.
#[derive(Clone, Copy, Debug)]
pub struct Faces {
    /// Unit normal of the two faces across each axis.
    normals: [DVec3; 3],
    /// Coordinate of each face along its normal, in the order of the bits of [`ToCaps`]; infinite for faces without a cap.
    ends: [f64; 6],
}

impl Faces {
    /// Returns the faces on which caps have vertices. `caps` has an entry for each vertex, or is empty for a surface without caps.
    pub fn new(geometry: &Geometry, positions: &[[f32; 3]], caps: &[ToCaps]) -> Self {
        let [x, y, z] = geometry.direction.map(DVec3::from);
        let turn = x.dot(y.cross(z)).signum();
        let normals = [y.cross(z), z.cross(x), x.cross(y)].map(|normal| normal * turn / normal.length());
        let ends = std::array::from_fn(|face| {
            let on_face = caps.iter().position(|to_caps| to_caps.is_on(face));
            match on_face {
                Some(vertex) => DVec3::from(positions[vertex].map(f64::from)).dot(normals[face / 2]),
                None if face % 2 == 0 => f64::NEG_INFINITY,
                None => f64::INFINITY,
            }
        });
        Self { normals, ends }
    }

    /// Returns the position of a vertex after a move from one position towards another, projected so that the vertex stays on its faces.
    /// Returns `None` if this position is outside the volume.
    pub fn constrained(&self, from: DVec3, to: DVec3, caps: ToCaps) -> Option<DVec3> {
        let along = self.along(to - from, caps);
        let is_inside = (0..3).filter(|&axis| !caps.is_on_axis(axis)).all(|axis| {
            let coordinate = (from + along).dot(self.normals[axis]);
            (self.ends[2 * axis]..=self.ends[2 * axis + 1]).contains(&coordinate)
        });
        is_inside.then_some(from + along)
    }

    /// Projects a move onto all faces on which the vertex lies.
    fn along(&self, move_by: DVec3, caps: ToCaps) -> DVec3 {
        let face_normals: Vec<DVec3> = (0..3)
            .filter(|&axis| caps.is_on_axis(axis))
            .map(|axis| self.normals[axis])
            .collect();
        match face_normals[..] {
            [] => move_by,
            [normal] => move_by - normal * move_by.dot(normal),
            [a, b] => {
                let edge = a.cross(b);
                edge * (move_by.dot(edge) / edge.dot(edge))
            }
            _ => DVec3::ZERO,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moves_stay_on_the_faces_and_in_the_volume() {
        // A turned and sheared volume.
        let mut geometry = Geometry::of_index([6, 7, 8]);
        geometry.direction = [[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.6, 0.8]];
        let [x, y, z] = geometry.direction.map(DVec3::from);
        let indices = [
            [2.5, 3.0, 3.5],
            [1.5, 3.0, 3.5],
            [1.0, 3.0, 3.5],
            [2.5, 5.0, 3.5],
            [1.0, 5.0, 3.5],
            [1.0, 5.0, 6.0],
        ];
        let world = indices.map(|index| {
            let [i, j, k] = index.map(f64::from);
            (x * i + y * j + z * k).to_array().map(|at| at as f32)
        });
        let caps = indices.map(|index| ToCaps::of(index, geometry.dims, 1.0));
        let faces = Faces::new(&geometry, &world, &caps);
        assert!(!ToCaps::of([2.5, 3.0, 3.5], geometry.dims, 1.5).is_near);
        assert!(ToCaps::of([2.5, 3.0, 3.5], geometry.dims, 1.6).is_near);
        assert_eq!(caps.map(|to| to.is_near), [false, true, true, true, true, true]);
        let at = |i: usize| DVec3::from(world[i].map(f64::from));
        let go = |i: usize, by: DVec3| faces.constrained(at(i), at(i) + by, caps[i]).map(|to| to - at(i));
        let by = DVec3::new(0.3, -0.2, 0.5);
        let is_near = |a: DVec3, b: DVec3| (a - b).length() < 1e-12;
        assert!(is_near(go(0, by).unwrap(), by));
        for (i, [a, b]) in [(2, [y, z]), (3, [x, z])] {
            let moved = go(i, by).unwrap();
            assert!(
                moved.length() > 0.1 && moved.dot(a.cross(b)).abs() < 1e-12,
                "{i}: {moved:?}"
            );
        }
        let edge = go(4, by).unwrap();
        assert!(is_near(edge, z * edge.dot(z)), "{edge:?}");
        assert!(is_near(go(5, by).unwrap(), DVec3::ZERO));
        // A move through a capped face is refused. If the face has no cap, a move of any length is allowed.
        assert_eq!(go(1, x * -0.6), None);
        assert!(go(1, x * -0.4).is_some() && go(0, x * 9.0).is_some());
    }
}
