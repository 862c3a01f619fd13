//! Numbering of the corners, edges and faces of a cube.
//!
//! Corner `b = dx + 2·dy + 4·dz`; a case is the 8 bits "inside", corner 0 lowest. Edge `e = 4·axis + u + 2·v` runs along
//! `axis` from the corner at offset `u` along axis `(axis + 1) % 3` and `v` along `(axis + 2) % 3`. Face
//! `f = 2·axis + side` lies at the low (0) or high (1) end of `axis`; its corners are numbered `p + 2·q` with `p` along
//! `(axis + 1) % 3` and `q` along `(axis + 2) % 3`.

/// Marks an edge that the surface does not cross, and unused entries of the tables.
pub const NONE: u8 = 255;

/// Offsets of a corner along x, y, z.
pub fn corner_offset(corner: usize) -> [usize; 3] {
    [corner & 1, corner >> 1 & 1, corner >> 2 & 1]
}

/// Axis along which an edge runs.
pub fn edge_axis(edge: usize) -> usize {
    edge / 4
}

/// The low and the high corner of an edge.
pub fn edge_corners(edge: usize) -> [usize; 2] {
    let axis = edge_axis(edge);
    let low = (edge & 1) << ((axis + 1) % 3) | (edge >> 1 & 1) << ((axis + 2) % 3);
    [low, low | 1 << axis]
}

/// The edge between two corners that differ along one axis.
pub(super) fn edge_between(a: usize, b: usize) -> u8 {
    let axis = (a ^ b).trailing_zeros() as usize;
    debug_assert_eq!(a ^ b, 1 << axis);
    (4 * axis + (a >> ((axis + 1) % 3) & 1) + 2 * (a >> ((axis + 2) % 3) & 1)) as u8
}

/// The cube's corners that are corners 0 to 3 of a face.
pub fn face_corners(face: usize) -> [usize; 4] {
    let (axis, side) = (face / 2, face & 1);
    [0, 1, 2, 3].map(|c| side << axis | (c & 1) << ((axis + 1) % 3) | (c >> 1) << ((axis + 2) % 3))
}

/// The four signs of a face, out of a cube's eight.
pub fn face_signs(face: usize, signs: u8) -> u8 {
    let corners = face_corners(face);
    (0..4).fold(0, |bits, c| bits | (signs >> corners[c] & 1) << c)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_and_corners_follow_the_numbering() {
        for edge in 0..12 {
            let [low, high] = edge_corners(edge);
            assert_eq!(high - low, 1 << edge_axis(edge));
            assert_eq!(edge_between(low, high) as usize, edge);
            assert_eq!(edge_between(high, low) as usize, edge);
        }
        assert_eq!(edge_corners(5), [4, 6], "edge 5 runs along y, one step along z");
    }
}
