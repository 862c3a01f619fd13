//! Flips edges between nearly coplanar triangles, and finds those that cannot be flipped.
//!
//! Mesh generators merge nearly coplanar triangles into facets, and triangulate each facet again so that it is Delaunay. TetGen does it
//! across edges at which the surface turns by up to 5.1° if a triangle there has a corner below 15°. It does not check whether the edge that
//! a flip makes exists already, as it does where the surface has a thin neck, and then ends with an error. In a mesh whose nearly flat edges
//! are locally Delaunay, nothing is left to flip.

use isopeel_geometry::{DVec3, has_area, triangle_normal};
use rustc_hash::{FxHashMap, FxHashSet};

/// Cosine of 5.15°. Triangles whose normals differ by a smaller angle are nearly coplanar.
const COPLANAR_COSINE: f64 = 0.995_963;

/// Four points count as cocircular up to this fraction of the radius, as in TetGen.
const COCIRCULAR: f64 = 1e-8;

/// Number of a triangle that stands for several: the same directed edge has more than one triangle.
const SEVERAL: u32 = u32::MAX;

/// Two triangles with a common edge: its ends, the opposite corner of the triangle in which the edge leads from the first end to the second,
/// and the opposite corner of the other triangle.
pub(super) type Quad = [[f64; 3]; 4];

/// Whether an edge is between nearly coplanar triangles, and not locally Delaunay.
fn is_flipped(&quad: &Quad) -> bool {
    let [a, b, c, d] = quad.map(DVec3::from);
    let (left, right) = (triangle_normal([a, b, c]), triangle_normal([b, a, d]));
    let (left_square, right_square) = (left.length_squared(), right.length_squared());
    if left.dot(right) < COPLANAR_COSINE * (left_square * right_square).sqrt() {
        return false;
    }
    // The circumscribed circle of the larger triangle, in its plane.
    let (normal, square, to_third, other) = match left_square > right_square {
        true => (left, left_square, c - a, d - a),
        false => (-right, right_square, d - a, c - a),
    };
    if square <= 0.0 {
        return false;
    }
    let to_end = b - a;
    let centre = (normal.cross(to_end) * to_third.length_squared() + to_third.cross(normal) * to_end.length_squared())
        / (2.0 * square);
    let radius = centre.length();
    centre.distance(other) < radius * (1.0 - COCIRCULAR)
}

/// Whether the two triangles that a flip makes have areas, and face the same side as those before.
fn flips_well(&[a, b, c, d]: &Quad) -> bool {
    let normal = |corners: [[f64; 3]; 3]| triangle_normal(corners.map(DVec3::from));
    let before = normal([a, b, c]) + normal([b, a, d]);
    [[a, d, c], [d, b, c]]
        .iter()
        .all(|corners| has_area(corners) && normal(*corners).dot(before) > 0.0)
}

/// Whether an edge would be flipped, but cannot be. `exists`: whether the edge that the flip makes exists already.
pub(super) fn is_blocked(quad: &Quad, exists: impl FnOnce() -> bool) -> bool {
    is_flipped(quad) && (exists() || !flips_well(quad))
}

/// Result of [`flip_flat_edges`].
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Flips {
    /// Number of edges that were flipped.
    pub(super) flipped: u64,
    /// Pairs of triangles whose common edge could not be flipped.
    pub(super) blocked: Vec<[u32; 2]>,
}

/// Flips edges between nearly coplanar triangles until they are locally Delaunay. Does not flip borders and edges of more than two
/// triangles. Each edge is removed at most once.
pub(super) fn flip_flat_edges(positions: &[[f64; 3]], triangles: &mut [[u32; 3]]) -> Flips {
    let mut edges = Edges::new(triangles);
    let mut flips = Flips::default();
    let mut blocked = Vec::new();
    let mut removed = FxHashSet::default();
    let mut stack: Vec<[u32; 2]> = (triangles.iter().rev())
        .flat_map(edges_of)
        .filter(|[from, to]| from < to)
        .collect();
    while let Some(edge) = stack.pop() {
        let Some(pair) = edges.pair(triangles, edge) else {
            continue;
        };
        let quad = pair.quad(positions);
        if !is_flipped(&quad) {
            continue;
        }
        let [a, b, c, d] = pair.corners;
        if edges.exist([c, d]) || !flips_well(&quad) {
            blocked.push(edge);
        } else if !removed.contains(&sorted([c, d])) {
            removed.insert(sorted([a, b]));
            edges.flip(triangles, &pair);
            flips.flipped += 1;
            stack.extend([[a, d], [d, b], [b, c], [c, a]]);
        }
    }
    // A flip nearby may have changed the triangles of an edge, or removed the edge that was in the way.
    for edge in blocked {
        let Some(pair) = edges.pair(triangles, edge) else {
            continue;
        };
        let [_, _, c, d] = pair.corners;
        if is_blocked(&pair.quad(positions), || edges.exist([c, d])) {
            let [first, second] = pair.triangles;
            flips.blocked.push([first.min(second), first.max(second)]);
        }
    }
    flips.blocked.sort_unstable();
    flips.blocked.dedup();
    flips
}

/// Counts the edges between nearly coplanar triangles that are not locally Delaunay.
pub(super) fn count(positions: &[[f64; 3]], triangles: &[[u32; 3]]) -> u64 {
    let edges = Edges::new(triangles);
    let all = triangles.iter().flat_map(edges_of).filter(|[from, to]| from < to);
    let pairs = all.filter_map(|edge| edges.pair(triangles, edge));
    pairs.filter(|pair| is_flipped(&pair.quad(positions))).count() as u64
}

/// Returns the directed edges of a triangle.
fn edges_of(&[a, b, c]: &[u32; 3]) -> [[u32; 2]; 3] {
    [[a, b], [b, c], [c, a]]
}

fn sorted([a, b]: [u32; 2]) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

/// Returns the corner of a triangle that is not on an edge.
pub(super) fn opposite(triangle: [u32; 3], edge: [u32; 2]) -> Option<u32> {
    triangle.into_iter().find(|corner| !edge.contains(corner))
}

/// The two triangles of an edge.
struct Pair {
    /// The triangle in which the edge leads from the first end to the second, and the other one.
    triangles: [u32; 2],
    /// Both ends of the edge, and the opposite corners of both triangles.
    corners: [u32; 4],
}

impl Pair {
    fn quad(&self, positions: &[[f64; 3]]) -> Quad {
        self.corners.map(|corner| positions[corner as usize])
    }
}

/// Triangle of each directed edge.
struct Edges(FxHashMap<[u32; 2], u32>);

impl Edges {
    fn new(triangles: &[[u32; 3]]) -> Self {
        let mut edges = FxHashMap::with_capacity_and_hasher(3 * triangles.len(), rustc_hash::FxBuildHasher);
        for (triangle, corners) in (0u32..).zip(triangles) {
            for edge in edges_of(corners) {
                edges
                    .entry(edge)
                    .and_modify(|triangle| *triangle = SEVERAL)
                    .or_insert(triangle);
            }
        }
        Self(edges)
    }

    /// Whether two vertices have an edge.
    fn exist(&self, [a, b]: [u32; 2]) -> bool {
        self.0.contains_key(&[a, b]) || self.0.contains_key(&[b, a])
    }

    /// Returns the triangles of an edge, if there are exactly two, with consistent orientations.
    fn pair(&self, triangles: &[[u32; 3]], [a, b]: [u32; 2]) -> Option<Pair> {
        let [left, right] = [*self.0.get(&[a, b])?, *self.0.get(&[b, a])?];
        if left == SEVERAL || right == SEVERAL {
            return None;
        }
        let [c, d] = [left, right].map(|triangle| opposite(triangles[triangle as usize], [a, b]));
        Some(Pair {
            triangles: [left, right],
            corners: [a, b, c?, d?],
        })
    }

    /// Replaces the edge of a pair by the edge between the opposite corners.
    fn flip(&mut self, triangles: &mut [[u32; 3]], pair: &Pair) {
        let ([left, right], [a, b, c, d]) = (pair.triangles, pair.corners);
        triangles[left as usize] = [a, d, c];
        triangles[right as usize] = [d, b, c];
        self.0.remove(&[a, b]);
        self.0.remove(&[b, a]);
        for (edge, triangle) in [([d, c], left), ([c, d], right), ([a, d], left), ([b, c], right)] {
            // An edge of several triangles stays one.
            self.0
                .entry(edge)
                .and_modify(|other| {
                    if *other != SEVERAL {
                        *other = triangle;
                    }
                })
                .or_insert(triangle);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_of_nearly_coplanar_triangles_become_delaunay() {
        // The diagonal from 2 to 3 is the longer one of a kite.
        let kite = [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [-3.0, 0.0, 0.0], [3.0, 0.0, 0.02]];
        let mut triangles = [[2, 3, 0], [3, 2, 1]];
        let flips = flip_flat_edges(&kite, &mut triangles);
        assert_eq!((flips.flipped, flips.blocked.len()), (1, 0));
        assert!(
            triangles
                .iter()
                .all(|triangle| triangle.contains(&0) && triangle.contains(&1))
        );
        // Both face the same side as before.
        for triangle in triangles {
            let corners = triangle.map(|corner: u32| DVec3::from(kite[corner as usize]));
            assert!(triangle_normal(corners).z > 0.0, "{triangle:?}");
        }
        assert_eq!(flip_flat_edges(&kite, &mut triangles), Flips::default());
        assert_eq!(count(&kite, &triangles), 0);
    }

    #[test]
    fn edges_at_which_the_surface_turns_are_left() {
        let kite = [[0.0, 1.0, 0.0], [0.0, -1.0, 0.2], [-3.0, 0.0, 0.0], [3.0, 0.0, 0.0]];
        let mut triangles = [[2, 3, 0], [3, 2, 1]];
        assert_eq!(flip_flat_edges(&kite, &mut triangles), Flips::default());
        assert_eq!(triangles, [[2, 3, 0], [3, 2, 1]]);
    }

    #[test]
    fn a_flip_that_would_double_an_edge_is_blocked() {
        // A flat tetrahedron beside the kite has the edge from 0 to 1 already.
        let positions = [
            [0.0, 1.0, 0.0],
            [0.0, -1.0, 0.0],
            [-3.0, 0.0, 0.0],
            [3.0, 0.0, 0.0],
            [0.0, 0.0, -1.0],
        ];
        let mut triangles = [[2, 3, 0], [3, 2, 1], [0, 1, 4]];
        let before = triangles;
        let flips = flip_flat_edges(&positions, &mut triangles);
        assert_eq!((flips.flipped, flips.blocked), (0, vec![[0, 1]]));
        assert_eq!(count(&positions, &triangles), 1);
        assert_eq!(triangles, before);
    }

    #[test]
    fn borders_and_edges_of_three_triangles_are_left() {
        let positions = [
            [0.0, 1.0, 0.0],
            [0.0, -1.0, 0.0],
            [-3.0, 0.0, 0.0],
            [3.0, 0.0, 0.0],
            [0.0, 0.0, 1.0],
        ];
        let mut triangles = [[2, 3, 0], [3, 2, 1], [3, 2, 4]];
        assert_eq!(flip_flat_edges(&positions, &mut triangles), Flips::default());
    }
}
