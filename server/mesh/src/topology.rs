//! Topology of a mesh: splits vertices at which sheets touch, finds out whether the mesh is closed, and computes the volume that it
//! encloses.

use isopeel_geometry::DVec3;
use rayon::prelude::*;

use super::Mesh;

/// The triangles of each vertex.
pub(crate) struct VertexTriangles {
    /// Offset in `triangles` of the first triangle of each vertex, followed by the length of `triangles`.
    first: Vec<u32>,
    triangles: Vec<u32>,
}

impl VertexTriangles {
    pub(crate) fn new(mesh: &Mesh) -> Self {
        let mut first = vec![0u32; mesh.positions.len() + 1];
        for &corner in mesh.triangles.as_flattened() {
            first[corner as usize + 1] += 1;
        }
        for vertex in 1..first.len() {
            first[vertex] += first[vertex - 1];
        }
        let mut next = first.clone();
        let mut triangles = vec![0; 3 * mesh.triangles.len()];
        for (triangle, corners) in (0u32..).zip(&mesh.triangles) {
            for &corner in corners {
                triangles[next[corner as usize] as usize] = triangle;
                next[corner as usize] += 1;
            }
        }
        Self { first, triangles }
    }

    /// Returns the triangles of a vertex.
    pub(crate) fn vertex(&self, vertex: u32) -> &[u32] {
        let [from, to] = [0, 1].map(|i| self.first[vertex as usize + i] as usize);
        &self.triangles[from..to]
    }
}

/// A triangle as seen from one of its corners: its number, and its other corners in the order of the triangle.
#[derive(Clone, Copy)]
struct Wedge {
    triangle: u32,
    next: u32,
    previous: u32,
}

/// Result of [`split_pinched`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Topology {
    /// Number of vertices that were added.
    pub split: u64,
    /// Whether each edge of each sheet has two triangles, which have the edge in opposite directions.
    pub is_closed: bool,
}

/// Splits each vertex at which several sheets touch, so that each sheet has a separate vertex. Then the triangles of each vertex are one
/// fan, connected by edges. If sheets touch along an edge, the triangles that bound the same solid at this edge are one sheet.
pub fn split_pinched(mesh: &mut Mesh) -> Topology {
    let triangles_of = VertexTriangles::new(mesh);
    let vertices = mesh.positions.len() as u32;
    let Found { mut pinched, is_open } = pinched_vertices(mesh, &triangles_of);
    let mut topology = Topology {
        split: 0,
        is_closed: !mesh.triangles.is_empty() && !is_open,
    };
    // The vertices of which the new ones are copies.
    let mut originals = Vec::new();
    // Splitting one vertex may disconnect sheets at another vertex, so the vertices around it are looked at again. This terminates, because
    // each round adds vertices, and there are never more vertices than corners of triangles.
    while !pinched.is_empty() {
        let mut around = Vec::new();
        for vertex in pinched {
            let original = vertex
                .checked_sub(vertices)
                .map_or(vertex, |copy| originals[copy as usize]);
            let wedges: Vec<Wedge> = wedges(mesh, triangles_of.vertex(original), vertex).collect();
            if let Some(is_closed) = single_fan(&wedges) {
                topology.is_closed &= is_closed;
                continue;
            }
            let fans = fans(mesh, vertex, &wedges, &mut topology.is_closed);
            let split = split(mesh, vertex, &wedges, &fans);
            if split > 0 {
                topology.split += split;
                originals.resize(mesh.positions.len() - vertices as usize, original);
                around.extend(wedges.iter().flat_map(|wedge| mesh.triangles[wedge.triangle as usize]));
            }
        }
        around.sort_unstable();
        around.dedup();
        pinched = around;
    }
    topology
}

/// What a look at all vertices has found.
#[derive(Default)]
struct Found {
    /// Vertices whose triangles are not a single fan, in ascending order.
    pinched: Vec<u32>,
    /// Whether the fan of a vertex is not closed.
    is_open: bool,
}

/// Looks at all vertices, in parallel.
fn pinched_vertices(mesh: &Mesh, triangles_of: &VertexTriangles) -> Found {
    let vertices = (0..mesh.positions.len() as u32).into_par_iter();
    let each = vertices.fold(
        || (Vec::new(), Found::default()),
        |(mut at, mut found), vertex| {
            at.clear();
            at.extend(wedges(mesh, triangles_of.vertex(vertex), vertex));
            match single_fan(&at) {
                Some(is_closed) => found.is_open |= !is_closed,
                None => found.pinched.push(vertex),
            }
            (at, found)
        },
    );
    each.map(|(_, found)| found)
        .reduce(Found::default, |mut first, second| {
            first.pinched.extend(second.pinched);
            first.is_open |= second.is_open;
            first
        })
}

/// Returns those of `triangles` that have the vertex, as seen from it.
fn wedges(mesh: &Mesh, triangles: &[u32], vertex: u32) -> impl Iterator<Item = Wedge> {
    triangles
        .iter()
        .filter_map(move |&triangle| wedge(mesh, triangle, vertex))
}

/// Returns a triangle as seen from one of its corners; `None` if two of its corners are equal.
fn wedge(mesh: &Mesh, triangle: u32, vertex: u32) -> Option<Wedge> {
    let [a, b, c] = mesh.triangles[triangle as usize];
    let (next, previous) = match vertex {
        _ if vertex == a => (b, c),
        _ if vertex == b => (c, a),
        _ if vertex == c => (a, b),
        _ => return None,
    };
    let is_distinct = next != vertex && previous != vertex && next != previous;
    is_distinct.then_some(Wedge {
        triangle,
        next,
        previous,
    })
}

/// Returns whether the single fan of triangles at a vertex is closed; `None` if the triangles are not a single fan. Fast, because most
/// vertices have one fan.
fn single_fan(wedges: &[Wedge]) -> Option<bool> {
    let Some(first) = wedges.first() else {
        return Some(true);
    };
    if is_closed_fan(wedges, first) {
        return Some(true);
    }
    // Walks around the vertex in one direction, from wedge to wedge.
    let (mut seen, mut end) = (1, first.previous);
    while end != first.next {
        let mut following = wedges.iter().filter(|wedge| wedge.next == end);
        end = match (following.next(), following.next()) {
            (Some(wedge), None) => wedge.previous,
            // The walk has reached a border.
            (None, _) => break,
            (Some(_), Some(_)) => return None,
        };
        seen += 1;
        if seen > wedges.len() {
            return None;
        }
    }
    if end == first.next {
        return None;
    }
    // Walks from the first wedge in the other direction to the other border.
    let mut start = first.next;
    loop {
        let mut preceding = wedges.iter().filter(|wedge| wedge.previous == start);
        start = match (preceding.next(), preceding.next()) {
            (Some(wedge), None) => wedge.next,
            (None, _) => return (seen == wedges.len()).then_some(false),
            (Some(_), Some(_)) => return None,
        };
        seen += 1;
        if seen > wedges.len() {
            return None;
        }
    }
}

/// Whether the triangles at a vertex are one closed fan. A walk from wedge to wedge, each the first that fits, comes back after as many
/// wedges as there are only if each of them fits alone.
fn is_closed_fan(wedges: &[Wedge], first: &Wedge) -> bool {
    let mut end = first.previous;
    for _ in 1..wedges.len() {
        match wedges.iter().find(|wedge| wedge.next == end) {
            Some(wedge) if end != first.next => end = wedge.previous,
            _ => return false,
        }
    }
    end == first.next
}

/// Returns for each triangle at a vertex the number of its fan. Clears `is_closed` if a triangle has no partner at an edge.
fn fans(mesh: &Mesh, vertex: u32, wedges: &[Wedge], is_closed: &mut bool) -> Vec<usize> {
    let mut fan: Vec<usize> = (0..wedges.len()).collect();
    let mut join = |a: usize, b: usize| {
        let (from, to) = (fan[a].max(fan[b]), fan[a].min(fan[b]));
        fan.iter_mut().filter(|fan| **fan == from).for_each(|fan| *fan = to);
    };
    let mut ends: Vec<u32> = wedges.iter().flat_map(|wedge| [wedge.next, wedge.previous]).collect();
    ends.sort_unstable();
    ends.dedup();
    for end in ends {
        let wedges_where = |matches: fn(&Wedge, u32) -> bool| -> Vec<usize> {
            (0..wedges.len()).filter(|&i| matches(&wedges[i], end)).collect()
        };
        // Triangles with the edge from the vertex to `end`, and triangles with the edge from `end` to the vertex.
        let out = wedges_where(|wedge, end| wedge.next == end);
        let back = wedges_where(|wedge, end| wedge.previous == end);
        *is_closed &= out.len() == back.len();
        match (&out[..], &back[..]) {
            (&[a], &[b]) => join(a, b),
            (&[_], &[]) | (&[], &[_]) => {}
            _ => match partners(mesh, [vertex, end], wedges, &out, &back) {
                Some(pairs) => pairs.into_iter().for_each(|(a, b)| join(a, b)),
                // Joins all triangles at the edge, because their sheets cannot be distinguished.
                None => out
                    .iter()
                    .chain(&back)
                    .for_each(|&i| join(i, out.first().copied().unwrap_or(i))),
            },
        }
    }
    fan
}

/// Pairs the triangles at an edge with more than two triangles, so that partners bound the same solid. `out` are the triangles with the
/// edge in the given direction, and `back` those with the edge in the other direction.
///
/// Seen along the edge, the outside is on the counter-clockwise side of a triangle in `out`, and the solid is on the counter-clockwise side
/// of a triangle in `back`. Returns `None` if the directions do not alternate around the edge.
fn partners(
    mesh: &Mesh,
    [from, to]: [u32; 2],
    wedges: &[Wedge],
    out: &[usize],
    back: &[usize],
) -> Option<Vec<(usize, usize)>> {
    if out.len() != back.len() {
        return None;
    }
    let position = |vertex: u32| DVec3::from(mesh.positions[vertex as usize].map(f64::from));
    let axis = (position(to) - position(from)).normalize_or_zero();
    let u = axis.any_orthonormal_vector();
    let v = axis.cross(u);
    let angle = |vertex: u32| {
        let arm = position(vertex) - position(from);
        arm.dot(v).atan2(arm.dot(u))
    };
    let along = out.iter().map(|&i| (angle(wedges[i].previous), true, i));
    let against = back.iter().map(|&i| (angle(wedges[i].next), false, i));
    let mut sides: Vec<(f64, bool, usize)> = along.chain(against).collect();
    sides.sort_by(|a, b| a.0.total_cmp(&b.0));
    let count = sides.len();
    let pairs = (0..count).filter(|&i| !sides[i].1).map(|i| {
        let (_, is_along, partner) = sides[(i + 1) % count];
        is_along.then_some((sides[i].2, partner))
    });
    pairs.collect()
}

/// Gives each fan of a vertex except the first a new vertex. Returns the number of new vertices.
fn split(mesh: &mut Mesh, vertex: u32, wedges: &[Wedge], fans: &[usize]) -> u64 {
    let mut distinct: Vec<usize> = fans.to_vec();
    distinct.sort_unstable();
    distinct.dedup();
    for &fan in distinct.iter().skip(1) {
        let copy = mesh.copy_vertex(vertex as usize);
        for (wedge, _) in wedges
            .iter()
            .zip(fans)
            .filter(|(_, fan_of_wedge)| **fan_of_wedge == fan)
        {
            let corners = &mut mesh.triangles[wedge.triangle as usize];
            corners
                .iter_mut()
                .filter(|corner| **corner == vertex)
                .for_each(|corner| *corner = copy);
        }
    }
    distinct.len().saturating_sub(1) as u64
}

/// Returns the volume that a closed mesh encloses, in cubes of its unit. The volume is negative if the triangles face inwards.
pub fn volume(mesh: &Mesh) -> f64 {
    // The signed volume of the tetrahedron between a triangle and the origin.
    let tetrahedron = |corners: &[u32; 3]| {
        let [a, b, c] = corners.map(|i| DVec3::from(mesh.positions[i as usize].map(f64::from)));
        a.dot(b.cross(c)) / 6.0
    };
    mesh.triangles.iter().map(tetrahedron).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A mesh of these positions and triangles.
    fn mesh(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Mesh {
        let count = positions.len();
        Mesh {
            positions: positions.to_vec(),
            normals: vec![[0.0, 0.0, 1.0]; count],
            smoothness: vec![0.0; count],
            feature: vec![0.0; count],
            triangles: triangles.to_vec(),
            ..Mesh::default()
        }
    }

    /// Faces of a tetrahedron of these corners, seen from outside if the fourth is in front of none.
    fn tetrahedron([a, b, c, d]: [u32; 4]) -> [[u32; 3]; 4] {
        [[a, c, b], [a, b, d], [b, c, d], [c, a, d]]
    }

    const CORNERS: [[f32; 3]; 4] = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

    #[test]
    fn a_closed_mesh_stays_as_it_is() {
        let mut one = mesh(&CORNERS, &tetrahedron([0, 1, 2, 3]));
        let before = one.clone();
        let expected = Topology {
            split: 0,
            is_closed: true,
        };
        assert_eq!(split_pinched(&mut one), expected);
        assert_eq!(one, before);
        assert!((volume(&one) - 1.0 / 6.0).abs() < 1e-12);
        one.flip();
        assert!((volume(&one) + 1.0 / 6.0).abs() < 1e-12);
    }

    #[test]
    fn a_border_is_no_pinch_and_not_closed() {
        let mut open = mesh(&CORNERS, &tetrahedron([0, 1, 2, 3])[1..]);
        let expected = Topology {
            split: 0,
            is_closed: false,
        };
        assert_eq!(split_pinched(&mut open), expected);
    }

    #[test]
    fn solids_that_touch_at_a_vertex_get_one_each() {
        let mut positions = CORNERS.to_vec();
        positions.extend(CORNERS[1..].iter().map(|corner| corner.map(|x| -x)));
        let mut triangles = tetrahedron([0, 1, 2, 3]).to_vec();
        // Mirrored, so that it is seen from outside.
        triangles.extend(tetrahedron([0, 5, 4, 6]));
        let mut both = mesh(&positions, &triangles);
        let topology = split_pinched(&mut both);
        assert_eq!((topology.split, topology.is_closed), (1, true));
        assert_eq!(both.positions.len(), 8);
        assert_eq!(both.positions[7], both.positions[0]);
        assert_eq!(split_pinched(&mut both).split, 0, "nothing is left to split");
        let of_first = both.triangles[..4].iter().flatten().any(|&corner| corner == 0);
        let of_second = both.triangles[4..].iter().flatten().any(|&corner| corner == 0);
        assert!(of_first != of_second);
    }

    #[test]
    fn solids_that_touch_along_an_edge_get_one_each() {
        // Both have the edge from 0 to 3, one at positive x and y, the other at negative ones.
        let mut positions = CORNERS.to_vec();
        positions.extend([[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]);
        let mut triangles = tetrahedron([0, 1, 2, 3]).to_vec();
        triangles.extend(tetrahedron([0, 4, 5, 3]));
        // Whatever the unit, and wherever the edge points.
        for [scale, shear] in [[1.0, 0.0], [1.0, 5.0], [1e-3, 0.0], [1e6, -0.7], [1e6, 40.0]] {
            let placed = |[x, y, z]: &[f32; 3]| [scale * (x + shear * z), scale * (y - 2.0 * shear * z), scale * z];
            let placed: Vec<[f32; 3]> = positions.iter().map(placed).collect();
            let mut both = mesh(&placed, &triangles);
            let topology = split_pinched(&mut both);
            assert_eq!((topology.split, topology.is_closed), (2, true), "{scale} {shear}");
            let shared: Vec<u32> = (0..8)
                .filter(|vertex| both.triangles[..4].as_flattened().contains(vertex))
                .filter(|vertex| both.triangles[4..].as_flattened().contains(vertex))
                .collect();
            assert!(shared.is_empty(), "{scale} {shear}: {shared:?}");
            let share = volume(&both) / (2.0 / 6.0 * f64::from(scale).powi(3));
            assert!((share - 1.0).abs() < 1e-5, "{scale} {shear}: {share}");
        }
    }

    #[test]
    fn degenerate_triangles_are_left_alone() {
        let mut triangles = tetrahedron([0, 1, 2, 3]).to_vec();
        triangles.push([0, 0, 1]);
        let mut one = mesh(&CORNERS, &triangles);
        assert_eq!(split_pinched(&mut one).split, 0);
    }
}
