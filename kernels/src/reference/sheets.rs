//! Surface sheets of a cell: which of its crossed edges belong together, and so how many vertices the dual mesher gives it.

use super::{Field, cases, classify};

/// Crossed edges of a cell by sheet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sheets {
    /// The sheet of each edge, 0 to 3, numbered by their lowest edge; [`cases::NONE`] where no surface crosses.
    pub of_edge: [u8; 12],
    /// How many there are.
    pub count: u8,
}

impl Sheets {
    /// Crossed edges joined along the contours of the faces: on ambiguous faces inside corners are separated, on those
    /// of `flipped` (one bit a face) outside corners.
    pub fn trace(signs: u8, flipped: u8) -> Self {
        let crossed = |edge: usize| {
            let [low, high] = cases::edge_corners(edge);
            (signs >> low ^ signs >> high) & 1 == 1
        };
        let mut root: [usize; 12] = std::array::from_fn(|edge| edge);
        let mut join = |a: usize, b: usize| {
            let (low, high) = (root[a].min(root[b]), root[a].max(root[b]));
            root.iter_mut().filter(|r| **r == high).for_each(|r| *r = low);
        };
        for face in 0..6 {
            let corners = cases::face_corners(face);
            let edges: Vec<usize> = (0..12)
                .filter(|&e| crossed(e) && cases::edge_corners(e).iter().all(|c| corners.contains(c)))
                .collect();
            match edges[..] {
                [] => {}
                [a, b] => join(a, b),
                _ => {
                    // A segment cuts off each corner of one sign: it joins the two edges that meet there.
                    let cut_off = flipped >> face & 1 == 0;
                    for corner in corners.into_iter().filter(|c| (signs >> c & 1 == 1) == cut_off) {
                        let at: Vec<_> = edges
                            .iter()
                            .filter(|&&e| cases::edge_corners(e).contains(&corner))
                            .collect();
                        join(*at[0], *at[1]);
                    }
                }
            }
        }
        let mut sheets = Self {
            of_edge: [cases::NONE; 12],
            count: 0,
        };
        for edge in (0..12).filter(|&e| crossed(e)) {
            if root[edge] == edge {
                sheets.of_edge[edge] = sheets.count;
                sheets.count += 1;
            } else {
                sheets.of_edge[edge] = sheets.of_edge[root[edge]];
            }
        }
        sheets
    }

    /// Of all ways to flip some of the faces `candidates` the one that leaves the fewest of them joined, of equals the one
    /// with the greatest bits; none where that gains nothing.
    pub fn flipped(signs: u8, candidates: u8) -> Self {
        let plain = Self::trace(signs, 0);
        let left = |s: &Self| (s.joined_faces() & candidates).count_ones();
        let flips = (0..=candidates).rev().filter(|f| f & !candidates == 0);
        let best = flips.map(|f| Self::trace(signs, f)).min_by_key(left);
        best.filter(|best| left(best) < left(&plain)).unwrap_or(plain)
    }

    /// Two bits an edge, its sheet; from bit 24 how many there are.
    pub fn packed(&self) -> u32 {
        let of_edge = (0..12).filter(|&e| self.of_edge[e] != cases::NONE);
        of_edge.fold(u32::from(self.count) << 24, |bits, e| {
            bits | u32::from(self.of_edge[e]) << (2 * e)
        })
    }

    /// Faces, one bit each, with four crossings that all lie in one sheet.
    pub fn joined_faces(&self) -> u8 {
        let joined = |face: usize| {
            let corners = cases::face_corners(face);
            let on_face = (0..12).filter(|&e| cases::edge_corners(e).iter().all(|c| corners.contains(c)));
            let sheets: Vec<u8> = on_face.map(|e| self.of_edge[e]).collect();
            sheets[0] != cases::NONE && sheets.iter().all(|&s| s == sheets[0])
        };
        (0..6).filter(|&f| joined(f)).fold(0, |bits, f| bits | 1 << f)
    }
}

/// Sheets of an active cell. Where two cells join through the ambiguous face between them, the one whose coordinates sum
/// to an even number flips it; a face of the volume, behind which the surface is as if mirrored, any cell: of all choices of
/// such faces the one that leaves the fewest joined, of equals the one with the greatest bits.
pub fn cell_sheets(field: &Field, iso: f32, cell: [u32; 3], signs: u8) -> Sheets {
    let plain = Sheets::trace(signs, 0);
    let even = cell.iter().sum::<u32>() % 2 == 0;
    let shared = |face: u8| {
        let axis = usize::from(face / 2);
        let mut other = cell;
        let at = cell[axis].checked_add_signed(if face & 1 == 1 { 1 } else { -1 });
        let Some(at) = at.filter(|&at| at < field.grid.cells()[axis]) else {
            return true;
        };
        if !even {
            return false;
        }
        other[axis] = at;
        let corners = field.cell_corners(other);
        let there = Sheets::trace(classify::signs(corners, iso), 0);
        !corners.iter().any(|v| v.is_nan()) && there.joined_faces() >> (face ^ 1) & 1 == 1
    };
    let candidates = (0..6)
        .filter(|&f| plain.joined_faces() >> f & 1 == 1 && shared(f))
        .fold(0u8, |bits, f| bits | 1 << f);
    Sheets::flipped(signs, candidates)
}
