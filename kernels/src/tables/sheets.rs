//! Surface sheets of a cell: groups of its crossed edges. The dual mesher gives each sheet one vertex.

use super::cube::{NONE, edge_corners, face_corners};

/// Crossed edges of a cell by sheet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sheets {
    /// The sheet of each edge, 0 to 3, numbered by their lowest edge; [`NONE`] if no surface crosses it.
    pub of_edge: [u8; 12],
    /// Number of sheets.
    pub count: u8,
}

impl Sheets {
    /// Crossed edges joined along the contours of the faces: on ambiguous faces inside corners are separated, on those
    /// of `flipped` (one bit a face) outside corners.
    pub fn trace(signs: u8, flipped: u8) -> Self {
        let crossed = |edge: usize| {
            let [low, high] = edge_corners(edge);
            (signs >> low ^ signs >> high) & 1 == 1
        };
        let mut root: [usize; 12] = std::array::from_fn(|edge| edge);
        let mut join = |a: usize, b: usize| {
            let (low, high) = (root[a].min(root[b]), root[a].max(root[b]));
            root.iter_mut().filter(|r| **r == high).for_each(|r| *r = low);
        };
        for face in 0..6 {
            let corners = face_corners(face);
            let edges: Vec<usize> = (0..12)
                .filter(|&e| crossed(e) && edge_corners(e).iter().all(|c| corners.contains(c)))
                .collect();
            match edges[..] {
                [] => {}
                [a, b] => join(a, b),
                _ => {
                    // A segment cuts off each corner of one sign: it joins the two edges that meet there.
                    let cut_off = flipped >> face & 1 == 0;
                    for corner in corners.into_iter().filter(|c| (signs >> c & 1 == 1) == cut_off) {
                        let at: Vec<_> = edges.iter().filter(|&&e| edge_corners(e).contains(&corner)).collect();
                        join(*at[0], *at[1]);
                    }
                }
            }
        }
        let mut sheets = Self {
            of_edge: [NONE; 12],
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

    /// Chooses which of the faces `candidates` to flip in addition to `forced`: the set that leaves the fewest of them joined, on a tie the
    /// one with the largest bits. Returns none if flipping gains nothing.
    pub fn choose_flips(signs: u8, forced: u8, candidates: u8) -> u8 {
        let left = |flips: u8| (Self::trace(signs, forced | flips).joined_faces() & candidates).count_ones();
        let ways = (0..=candidates).rev().filter(|flips| flips & !candidates == 0);
        let best = ways.min_by_key(|&flips| left(flips)).unwrap_or(0);
        if left(best) < left(0) { best } else { 0 }
    }

    /// Packs the sheet of each edge into two bits; the number of sheets is from bit 24 on.
    pub fn packed(&self) -> u32 {
        let of_edge = (0..12).filter(|&e| self.of_edge[e] != NONE);
        of_edge.fold(u32::from(self.count) << 24, |bits, e| {
            bits | u32::from(self.of_edge[e]) << (2 * e)
        })
    }

    /// Faces, one bit each, with four crossings that all lie in one sheet.
    pub fn joined_faces(&self) -> u8 {
        let joined = |face: usize| {
            let corners = face_corners(face);
            let on_face = (0..12).filter(|&e| edge_corners(e).iter().all(|c| corners.contains(c)));
            let sheets: Vec<u8> = on_face.map(|e| self.of_edge[e]).collect();
            sheets[0] != NONE && sheets.iter().all(|&s| s == sheets[0])
        };
        (0..6).filter(|&f| joined(f)).fold(0, |bits, f| bits | 1 << f)
    }
}

#[cfg(test)]
mod tests {
    use super::super::cases::{case_triangles, loops};
    use super::super::cube::{corner_offset, face_signs};
    use super::*;

    fn is_ambiguous(face: usize, signs: u8) -> bool {
        matches!(face_signs(face, signs), 0b0110 | 0b1001)
    }

    /// Counts the groups into which `joined` connects the corners in `members` (one bit per corner).
    fn components(members: u8, joined: impl Fn(usize, usize) -> bool) -> u32 {
        let (mut left, mut count) = (members, 0);
        while left != 0 {
            let mut group = 1u8 << left.trailing_zeros();
            loop {
                let reached = |c: usize| (0..8).any(|from| group >> from & 1 == 1 && joined(from, c));
                let grown = (0..8).filter(|&c| members >> c & 1 == 1 && reached(c));
                let grown = grown.fold(group, |bits, c| bits | 1 << c);
                if grown == group {
                    break;
                }
                group = grown;
            }
            left &= !group;
            count += 1;
        }
        count
    }

    /// The cube's 48 symmetries: the image of each corner.
    fn symmetries() -> Vec<[usize; 8]> {
        let axes = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
        let of = |axes: [usize; 3], mirrored: usize| {
            std::array::from_fn(|corner| {
                let at = corner_offset(corner ^ mirrored);
                (0..3).map(|i| at[axes[i]] << i).sum()
            })
        };
        axes.iter().flat_map(|&a| (0..8).map(move |m| of(a, m))).collect()
    }

    fn edge_with_ends(ends: [usize; 2]) -> usize {
        let found = (0..12).find(|&e| edge_corners(e).iter().all(|c| ends.contains(c)));
        found.expect("two corners of one edge")
    }

    /// Pairs of edges in one sheet: the partition, whatever its parts are numbered.
    fn pairs(sheets: &Sheets) -> Vec<[usize; 2]> {
        let together = |a: usize, b: usize| sheets.of_edge[a] != NONE && sheets.of_edge[a] == sheets.of_edge[b];
        let all = (0..12).flat_map(|a| (0..12).map(move |b| [a, b]));
        all.filter(|&[a, b]| together(a, b)).collect()
    }

    #[test]
    fn sheets_partition_the_crossed_edges_in_the_order_of_their_lowest() {
        let mut maximum = 0;
        for signs in 0..=255u8 {
            for flipped in 0..64 {
                let sheets = Sheets::trace(signs, flipped);
                let mut next = 0;
                for edge in 0..12 {
                    let [low, high] = edge_corners(edge);
                    let is_crossed = (signs >> low ^ signs >> high) & 1 == 1;
                    let sheet = sheets.of_edge[edge];
                    assert_eq!(sheet != NONE, is_crossed, "case {signs}, edge {edge}");
                    if is_crossed {
                        assert!(sheet <= next, "case {signs}: sheet {sheet} before sheet {next}");
                        next = next.max(sheet + 1);
                    }
                }
                assert_eq!(sheets.count, next, "case {signs}");
                maximum = maximum.max(next);
            }
        }
        assert_eq!(maximum, 4);
    }

    /// Closed contours on the cube's surface, which is a sphere, divide it into one part more than there are contours. The
    /// parts are the groups of inside corners, which edges join, and of outside corners, which ambiguous faces join as well.
    #[test]
    fn as_many_sheets_as_contours_between_groups_of_corners() {
        for signs in 1..255u8 {
            let on_edge = |a: usize, b: usize| (a ^ b).is_power_of_two();
            let across = |a: usize, b: usize| {
                let on_face = |f: usize| face_corners(f).contains(&a) && face_corners(f).contains(&b);
                (0..6).any(|f| is_ambiguous(f, signs) && on_face(f))
            };
            let inside = components(signs, on_edge);
            let outside = components(!signs, |a, b| on_edge(a, b) || across(a, b));
            let sheets = Sheets::trace(signs, 0);
            assert_eq!(u32::from(sheets.count), inside + outside - 1, "case {signs}");
        }
    }

    #[test]
    fn triangles_and_contours_keep_to_the_sheets() {
        for (signs, entry) in case_triangles().iter().enumerate() {
            let sheets = Sheets::trace(signs as u8, 0);
            let loops = loops(signs as u8);
            assert_eq!(loops.len(), usize::from(sheets.count), "case {signs}");
            for (sheet, edges) in loops.iter().enumerate() {
                assert!(
                    edges
                        .iter()
                        .all(|&e| usize::from(sheets.of_edge[usize::from(e)]) == sheet)
                );
            }
            for triangle in entry[1..1 + 3 * usize::from(entry[0])].chunks_exact(3) {
                let [a, b, c] = [0, 1, 2].map(|i| sheets.of_edge[usize::from(triangle[i])]);
                assert!(a == b && b == c && a != NONE, "case {signs}: a triangle of two sheets");
            }
        }
    }

    #[test]
    fn rotated_and_mirrored_cases_have_the_same_sheets_and_triangles() {
        let table = case_triangles();
        let symmetries = symmetries();
        assert_eq!(symmetries.len(), 48);
        for moved in symmetries {
            for signs in 0..=255u8 {
                let image = (0..8).fold(0u8, |bits, c| bits | (signs >> c & 1) << moved[c]);
                assert_eq!(table[usize::from(signs)][0], table[usize::from(image)][0]);
                let to = |edge: usize| edge_with_ends(edge_corners(edge).map(|c| moved[c]));
                let mut expected: Vec<_> = pairs(&Sheets::trace(signs, 0)).iter().map(|p| p.map(to)).collect();
                expected.sort_unstable();
                assert_eq!(
                    pairs(&Sheets::trace(image, 0)),
                    expected,
                    "case {signs} and its image {image}"
                );
            }
        }
    }

    #[test]
    fn complement_has_the_same_sheets_with_every_face_flipped() {
        for signs in 0..=255u8 {
            assert_eq!(
                Sheets::trace(signs, 0b11_1111),
                Sheets::trace(!signs, 0),
                "case {signs}"
            );
            if !(0..6).any(|f| is_ambiguous(f, signs)) {
                assert_eq!(Sheets::trace(signs, 0), Sheets::trace(!signs, 0), "case {signs}");
            }
        }
    }

    #[test]
    fn flipping_joins_fewest_faces_and_only_where_it_gains() {
        for signs in 0..=255u8 {
            let plain = Sheets::trace(signs, 0);
            let joined = plain.joined_faces();
            for face in 0..6 {
                assert!(
                    joined >> face & 1 == 0 || is_ambiguous(face, signs),
                    "case {signs}, face {face}"
                );
            }
            let subsets = |of: u8| (0..64u8).filter(move |set| set & !of == 0);
            for forced in subsets(joined) {
                for candidates in subsets(joined & !forced) {
                    let left =
                        |flips: u8| (Sheets::trace(signs, forced | flips).joined_faces() & candidates).count_ones();
                    let chosen = Sheets::choose_flips(signs, forced, candidates);
                    let at = format!("case {signs}, forced {forced:06b}, candidates {candidates:06b}");
                    assert_eq!(chosen & !candidates, 0, "{at}");
                    assert_eq!(Some(left(chosen)), subsets(candidates).map(left).min(), "{at}");
                    assert!(chosen == 0 || left(chosen) < left(0), "{at}");
                }
            }
        }
    }

    /// Faces that are flipped join no sheets, and no face's segments that were not joined before.
    #[test]
    fn flipping_divides_sheets() {
        for signs in 0..=255u8 {
            let plain = Sheets::trace(signs, 0);
            for flips in (0..64u8).filter(|set| set & !plain.joined_faces() == 0) {
                let sheets = Sheets::trace(signs, flips);
                for [a, b] in pairs(&sheets) {
                    assert_eq!(plain.of_edge[a], plain.of_edge[b], "case {signs}, flips {flips:06b}");
                }
                assert_eq!(sheets.joined_faces() & !plain.joined_faces(), 0, "case {signs}");
            }
        }
    }

    #[test]
    fn packed_sheets_hold_two_bits_an_edge_and_the_count() {
        for signs in 0..=255u8 {
            let sheets = Sheets::trace(signs, 0);
            let packed = sheets.packed();
            assert_eq!(packed >> 24, u32::from(sheets.count));
            for (edge, &sheet) in sheets.of_edge.iter().enumerate() {
                let expected = if sheet == NONE { 0 } else { sheet };
                assert_eq!(
                    packed >> (2 * edge) & 3,
                    u32::from(expected),
                    "case {signs}, edge {edge}"
                );
            }
        }
    }
}
