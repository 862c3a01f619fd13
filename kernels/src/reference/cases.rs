//! The marching-cubes table, generated: which triangles a cube of given corner signs emits.
//!
//! Corner `b = dx + 2·dy + 4·dz`; a case is the 8 bits "inside", corner 0 lowest. Edge `e = 4·axis + u + 2·v` runs along
//! `axis` from the corner at offset `u` along axis `(axis + 1) % 3` and `v` along `(axis + 2) % 3`. Face
//! `f = 2·axis + side` lies at the low (0) or high (1) end of `axis`; its corners are numbered `p + 2·q` with `p` along
//! `(axis + 1) % 3` and `q` along `(axis + 2) % 3`.
//!
//! Nothing is typed in. On each face the contour is traced so that inside corners are separated where the four signs
//! are ambiguous, which depends on the face alone, so two cubes always agree on the face they share. The segments join
//! to closed loops, one per surface sheet, and each loop is triangulated.

/// Marks an edge that no surface crosses, and the unused places of the tables.
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
fn edge_between(a: usize, b: usize) -> u8 {
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

/// The face's contour: up to two segments between cube edges, each directed so that the inside lies to its right seen
/// from outside the cube. That makes the loops they join to counter-clockwise seen from the side of lower values.
pub fn face_segments(face: usize, signs4: u8) -> Vec<[u8; 2]> {
    let corners = face_corners(face);
    // Counter-clockwise around the face, seen from the high end of its axis.
    let ring = [0, 1, 3, 2];
    let inside = |i: usize| signs4 >> ring[i % 4] & 1 == 1;
    let edge = |i: usize| edge_between(corners[ring[i % 4]], corners[ring[(i + 1) % 4]]);
    let mut segments = Vec::new();
    for enter in (0..4).filter(|&i| !inside(i) && inside(i + 1)) {
        // One run of inside corners: cut it off from the rest, whatever else is inside.
        let mut leave = enter + 1;
        while inside(leave + 1) {
            leave += 1;
        }
        let (from, to) = (edge(enter), edge(leave));
        segments.push(if face & 1 == 1 { [from, to] } else { [to, from] });
    }
    segments
}

/// [`face_segments`] as a table, `[face][signs]`: two segments of two edges, [`NONE`] where there is none.
pub fn face_segment_table() -> [[[u8; 4]; 16]; 6] {
    let mut table = [[[NONE; 4]; 16]; 6];
    for (face, row) in table.iter_mut().enumerate() {
        for (signs, entry) in row.iter_mut().enumerate() {
            for (i, segment) in face_segments(face, signs as u8).iter().enumerate() {
                entry[2 * i..2 * i + 2].copy_from_slice(segment);
            }
        }
    }
    table
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
        let mut ring = Vec::new();
        let mut edge = first;
        while !seen[edge] {
            seen[edge] = true;
            ring.push(edge as u8);
            edge = next[edge] as usize;
        }
        debug_assert_eq!(edge, first);
        loops.push(ring);
    }
    loops
}

/// For each case and edge the sheet (0 to 3, an index into [`loops`]) it belongs to, or [`NONE`]; and the number of
/// sheets of each case.
pub fn sheets() -> ([[u8; 12]; 256], [u8; 256]) {
    let mut edges = [[NONE; 12]; 256];
    let mut counts = [0; 256];
    for signs in 0..256 {
        for (sheet, ring) in loops(signs as u8).iter().enumerate() {
            for &edge in ring {
                edges[signs][edge as usize] = sheet as u8;
            }
            counts[signs] += 1;
        }
    }
    (edges, counts)
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

/// Every triangulation of the polygon `ring[first..=last]`, as index triples.
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
fn triangulate(ring: &[u8]) -> Vec<[u8; 3]> {
    let cost = |triangles: &Vec<[usize; 3]>| {
        let mut in_face = 0;
        let mut length = 0;
        for &[a, b, c] in triangles {
            for (i, j) in [(a, b), (b, c), (a, c)] {
                let side_of_loop = j - i == 1 || (i == 0 && j == ring.len() - 1);
                if !side_of_loop {
                    in_face += usize::from(share_face(ring[i], ring[j]));
                    length += squared_distance(ring[i], ring[j]);
                }
            }
        }
        (in_face, length)
    };
    let best = triangulations(0, ring.len() - 1).into_iter().min_by_key(cost);
    best.into_iter().flatten().map(|t| t.map(|i| ring[i])).collect()
}

/// For each case: how many triangles (at most 5), then their edges, three per triangle, counter-clockwise seen from the
/// side of lower values; [`NONE`] after them. Triangles of one sheet stand together, sheets in the order of [`loops`].
pub fn case_triangles() -> [[u8; 16]; 256] {
    let mut table = [[NONE; 16]; 256];
    for (signs, entry) in table.iter_mut().enumerate() {
        let triangles: Vec<[u8; 3]> = loops(signs as u8).iter().flat_map(|ring| triangulate(ring)).collect();
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
    fn edges_and_corners_follow_the_numbering() {
        for edge in 0..12 {
            let [low, high] = edge_corners(edge);
            assert_eq!(high - low, 1 << edge_axis(edge));
            assert_eq!(edge_between(low, high) as usize, edge);
            assert_eq!(edge_between(high, low) as usize, edge);
        }
        assert_eq!(edge_corners(5), [4, 6], "edge 5 runs along y, one step along z");
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
            let sorted = |s: u8, turn: bool| {
                let mut all: Vec<_> = (0..6).flat_map(|f| face_segments(f, face_signs(f, s))).collect();
                if turn {
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
    fn sheets_cover_the_loops() {
        let (edges, counts) = sheets();
        for signs in 0..256 {
            let crossed = edges[signs].iter().filter(|&&s| s != NONE).count();
            assert_eq!(crossed, loops(signs as u8).iter().map(Vec::len).sum::<usize>());
            let most = edges[signs].iter().filter(|&&s| s != NONE).max().map_or(0, |s| s + 1);
            assert_eq!(counts[signs], most);
            // Triangles never join two sheets.
            for t in triangles(&case_triangles()[signs]) {
                assert!(
                    t.iter()
                        .all(|&e| edges[signs][e as usize] == edges[signs][t[0] as usize])
                );
            }
        }
        assert_eq!(counts.iter().max(), Some(&4));
    }

    #[test]
    fn diagonals_stay_off_faces_where_the_loop_allows() {
        for signs in 0..=255u8 {
            for ring in loops(signs) {
                let in_face = |triangles: &[[u8; 3]]| {
                    let next = |e: u8, f: u8| (0..ring.len()).any(|i| ring[i] == e && ring[(i + 1) % ring.len()] == f);
                    let mut n = 0;
                    for t in triangles {
                        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                            n += usize::from(!next(a, b) && !next(b, a) && share_face(a, b));
                        }
                    }
                    n
                };
                let chosen = in_face(&triangulate(&ring));
                let least = triangulations(0, ring.len() - 1)
                    .iter()
                    .map(|t| in_face(&t.iter().map(|t| t.map(|i| ring[i])).collect::<Vec<_>>()))
                    .min();
                assert_eq!(Some(chosen), least, "case {signs}");
            }
        }
    }
}
