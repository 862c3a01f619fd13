//! The marching-cubes table, generated: which triangles a cube of given corner signs emits.
//!
//! The table is computed, not typed in. On each face the contour is traced; if the four signs are ambiguous, inside corners are
//! separated. This depends on the face alone, so two cubes always agree on the face they share. The segments join to closed loops,
//! one per surface sheet, and each loop is triangulated.

use super::cube::{NONE, corner_offset, edge_between, edge_corners, face_corners, face_signs};

/// The face's contour: up to two segments between cube edges, each directed so that the inside lies to its right seen
/// from outside the cube. That makes the loops they join to counter-clockwise seen from the side of lower values.
pub fn face_segments(face: usize, signs4: u8) -> Vec<[u8; 2]> {
    let corners = face_corners(face);
    // Counter-clockwise around the face, seen from the high end of its axis.
    let cycle = [0, 1, 3, 2];
    let inside = |i: usize| signs4 >> cycle[i % 4] & 1 == 1;
    let edge = |i: usize| edge_between(corners[cycle[i % 4]], corners[cycle[(i + 1) % 4]]);
    let mut segments = Vec::new();
    for enter in (0..4).filter(|&i| !inside(i) && inside(i + 1)) {
        // One run of inside corners: cut it off from the other corners, even if another one is inside.
        let mut leave = enter + 1;
        while inside(leave + 1) {
            leave += 1;
        }
        let (from, to) = (edge(enter), edge(leave));
        segments.push(if face & 1 == 1 { [from, to] } else { [to, from] });
    }
    segments
}

/// The closed loops of a case, one per surface sheet, each a list of edges; ordered by their lowest edge, which comes
/// first.
pub fn loops(signs: u8) -> Vec<Vec<u8>> {
    // Every crossed edge ends one segment and begins another, on the two faces that share it.
    let mut next = [NONE; 12];
    for face in 0..6 {
        for [from, to] in face_segments(face, face_signs(face, signs)) {
            debug_assert_eq!(next[from as usize], NONE);
            next[from as usize] = to;
        }
    }
    let mut seen = [false; 12];
    let mut loops = Vec::new();
    for first in 0..12 {
        if next[first] == NONE || seen[first] {
            continue;
        }
        let mut polygon = Vec::new();
        let mut edge = first;
        while !seen[edge] {
            seen[edge] = true;
            polygon.push(edge as u8);
            edge = next[edge] as usize;
        }
        debug_assert_eq!(edge, first);
        loops.push(polygon);
    }
    loops
}

/// Whether two edges of the cube lie on one of its faces together.
fn share_face(a: u8, b: u8) -> bool {
    let corners = |e: u8| edge_corners(e as usize);
    (0..6).any(|face| {
        let on_face = face_corners(face);
        corners(a).iter().chain(&corners(b)).all(|c| on_face.contains(c))
    })
}

/// Squared distance between the midpoints of two edges, in quarter cells squared.
fn squared_distance(a: u8, b: u8) -> usize {
    let middle = |e: u8| {
        let [low, high] = edge_corners(e as usize).map(corner_offset);
        [0, 1, 2].map(|i| low[i] + high[i])
    };
    let (p, q) = (middle(a), middle(b));
    (0..3).map(|i| p[i].abs_diff(q[i]).pow(2)).sum()
}

/// Every triangulation of the polygon `polygon[first..=last]`, as index triples.
fn triangulations(first: usize, last: usize) -> Vec<Vec<[usize; 3]>> {
    if last - first < 2 {
        return vec![Vec::new()];
    }
    let mut all = Vec::new();
    for apex in first + 1..last {
        for left in &triangulations(first, apex) {
            for right in &triangulations(apex, last) {
                let mut triangles = vec![[first, apex, last]];
                triangles.extend(left);
                triangles.extend(right);
                all.push(triangles);
            }
        }
    }
    all
}

/// The triangulation of a loop with the fewest diagonals inside a face of the cube (such a diagonal would lie in the
/// neighbour's face too, and could be shared by four triangles), then the shortest diagonals, then the first.
fn triangulate(polygon: &[u8]) -> Vec<[u8; 3]> {
    let cost = |triangles: &Vec<[usize; 3]>| {
        let mut in_face = 0;
        let mut length = 0;
        for &[a, b, c] in triangles {
            for (i, j) in [(a, b), (b, c), (a, c)] {
                let is_side = j - i == 1 || (i == 0 && j == polygon.len() - 1);
                if !is_side {
                    in_face += usize::from(share_face(polygon[i], polygon[j]));
                    length += squared_distance(polygon[i], polygon[j]);
                }
            }
        }
        (in_face, length)
    };
    let best = triangulations(0, polygon.len() - 1).into_iter().min_by_key(cost);
    best.into_iter().flatten().map(|t| t.map(|i| polygon[i])).collect()
}

/// For each case: how many triangles (at most 5), then their edges, three per triangle, counter-clockwise seen from the
/// side of lower values; [`NONE`] after them. Triangles of one sheet stand together, sheets in the order of [`loops`].
pub fn case_triangles() -> [[u8; 16]; 256] {
    let mut table = [[NONE; 16]; 256];
    for (signs, entry) in table.iter_mut().enumerate() {
        let triangles: Vec<[u8; 3]> = loops(signs as u8)
            .iter()
            .flat_map(|polygon| triangulate(polygon))
            .collect();
        entry[0] = triangles.len() as u8;
        for (i, triangle) in triangles.iter().enumerate() {
            entry[1 + 3 * i..4 + 3 * i].copy_from_slice(triangle);
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    fn triangles(entry: &[u8; 16]) -> impl Iterator<Item = [u8; 3]> {
        entry[1..1 + 3 * entry[0] as usize]
            .chunks_exact(3)
            .map(|t| [t[0], t[1], t[2]])
    }

    /// Directed edges of a case's triangles that no other triangle of the case runs through the other way.
    fn border(entry: &[u8; 16]) -> Vec<[u8; 2]> {
        let mut balance: BTreeMap<[u8; 2], i32> = BTreeMap::new();
        for [a, b, c] in triangles(entry) {
            for [p, q] in [[a, b], [b, c], [c, a]] {
                *balance.entry([p.min(q), p.max(q)]).or_insert(0) += if p < q { 1 } else { -1 };
            }
        }
        balance.retain(|_, n| *n != 0);
        assert!(balance.values().all(|n| n.abs() == 1));
        balance
            .into_iter()
            .map(|([p, q], n)| if n > 0 { [p, q] } else { [q, p] })
            .collect()
    }

    #[test]
    fn table_has_820_triangles_over_exactly_the_crossed_edges() {
        let table = case_triangles();
        assert_eq!(table.iter().map(|e| u32::from(e[0])).sum::<u32>(), 820);
        for (signs, entry) in table.iter().enumerate() {
            let mut used = [false; 12];
            triangles(entry).flatten().for_each(|e| used[e as usize] = true);
            for (edge, used) in used.into_iter().enumerate() {
                let [low, high] = edge_corners(edge);
                assert_eq!(
                    used,
                    (signs >> low ^ signs >> high) & 1 == 1,
                    "case {signs}, edge {edge}"
                );
            }
        }
    }

    #[test]
    fn border_of_each_case_is_the_contour_of_its_faces() {
        for (signs, entry) in case_triangles().iter().enumerate() {
            let mut segments: Vec<_> = (0..6)
                .flat_map(|f| face_segments(f, face_signs(f, signs as u8)))
                .collect();
            let mut border = border(entry);
            segments.sort_unstable();
            border.sort_unstable();
            assert_eq!(border, segments, "case {signs}");
        }
    }

    #[test]
    fn neighbours_draw_the_same_contour_the_other_way() {
        for axis in 0..3 {
            // Edges of the low face are edges of the high face moved one step along the axis.
            let moved = |e: u8| {
                let [low, high] = edge_corners(e as usize);
                edge_between(low | 1 << axis, high | 1 << axis)
            };
            for signs in 0..16 {
                let mut high = face_segments(2 * axis + 1, signs);
                let mut low: Vec<_> = face_segments(2 * axis, signs)
                    .iter()
                    .map(|&[a, b]| [moved(b), moved(a)])
                    .collect();
                high.sort_unstable();
                low.sort_unstable();
                assert_eq!(high, low, "axis {axis}, signs {signs:04b}");
                let expected = match signs {
                    0 | 15 => 0,
                    0b0110 | 0b1001 => 2,
                    _ => 1,
                };
                assert_eq!(high.len(), expected);
            }
        }
    }

    #[test]
    fn ambiguous_faces_separate_their_inside_corners() {
        for face in 0..6 {
            for (signs, inside) in [(0b1001, [0, 3]), (0b0110, [1, 2])] {
                let corners = face_corners(face);
                for segment in face_segments(face, signs) {
                    let ends = segment.map(|e| edge_corners(e as usize));
                    let shared = ends[0].iter().find(|c| ends[1].contains(c));
                    assert!(shared.is_some_and(|c| inside.iter().any(|&i| corners[i] == *c)));
                }
            }
        }
    }

    #[test]
    fn normals_point_to_the_outside() {
        // One inside corner: the triangle's normal points away from it.
        let table = case_triangles();
        let middle = |e: u8| {
            let [low, high] = edge_corners(e as usize).map(corner_offset);
            [0, 1, 2].map(|i| (low[i] + high[i]) as i32)
        };
        for corner in 0..8 {
            for (signs, towards) in [(1 << corner, -1), (255 ^ 1 << corner, 1)] {
                let entry = &table[signs as usize];
                assert_eq!(entry[0], 1);
                let [a, b, c] = [1, 2, 3].map(|i| middle(entry[i]));
                let (p, q): ([i32; 3], [i32; 3]) = ([0, 1, 2].map(|i| b[i] - a[i]), [0, 1, 2].map(|i| c[i] - a[i]));
                let normal = [
                    p[1] * q[2] - p[2] * q[1],
                    p[2] * q[0] - p[0] * q[2],
                    p[0] * q[1] - p[1] * q[0],
                ];
                let at = corner_offset(corner);
                let dot: i32 = (0..3).map(|i| normal[i] * (2 * at[i] as i32 - a[i])).sum();
                assert_eq!(dot.signum(), towards, "corner {corner}");
            }
        }
    }

    #[test]
    fn complement_reverses_where_no_face_is_ambiguous() {
        let ambiguous = |s: u8| (0..6).any(|f| matches!(face_signs(f, s), 0b0110 | 0b1001));
        let mut compared = 0;
        for signs in (0..=255u8).filter(|&s| !ambiguous(s)) {
            let sorted = |s: u8, reversed: bool| {
                let mut all: Vec<_> = (0..6).flat_map(|f| face_segments(f, face_signs(f, s))).collect();
                if reversed {
                    all.iter_mut().for_each(|s| s.reverse());
                }
                all.sort_unstable();
                all
            };
            assert_eq!(sorted(signs, false), sorted(!signs, true), "case {signs}");
            compared += 1;
        }
        assert!(compared > 100);
    }

    #[test]
    fn diagonals_stay_off_faces_where_the_loop_allows() {
        for signs in 0..=255u8 {
            for polygon in loops(signs) {
                let in_face = |triangles: &[[u8; 3]]| {
                    let next = |e: u8, f: u8| {
                        (0..polygon.len()).any(|i| polygon[i] == e && polygon[(i + 1) % polygon.len()] == f)
                    };
                    let mut n = 0;
                    for t in triangles {
                        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                            n += usize::from(!next(a, b) && !next(b, a) && share_face(a, b));
                        }
                    }
                    n
                };
                let chosen = in_face(&triangulate(&polygon));
                let minimum = triangulations(0, polygon.len() - 1)
                    .iter()
                    .map(|t| in_face(&t.iter().map(|t| t.map(|i| polygon[i])).collect::<Vec<_>>()))
                    .min();
                assert_eq!(Some(chosen), minimum, "case {signs}");
            }
        }
    }
}
