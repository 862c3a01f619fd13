//! Triangles of a mesh that intersect, by exact predicates (`robust`) on pairs that a tree of boxes finds.

use robust::{Coord, Coord3D, orient2d, orient3d};

/// Triangles of a leaf of the tree of boxes.
const LEAF_TRIANGLES: usize = 4;

/// Parts of the tree with fewer triangles are processed by one thread.
const PARALLEL_TRIANGLES: usize = 4096;

/// Corners of a triangle.
pub type Corners = [[f64; 3]; 3];

/// A mesh whose triangles may intersect.
pub struct TriangleSoup<'a> {
    /// Position of each vertex.
    pub positions: &'a [[f64; 3]],
    /// Corners of each triangle.
    pub triangles: &'a [[u32; 3]],
}

impl TriangleSoup<'_> {
    /// Returns the pairs of triangles that have more in common than corners and edges: corners at the same position are one. A triangle without
    /// area is a pair with itself. `None` if it is cancelled.
    pub fn intersections(&self, is_cancelled: &(dyn Fn() -> bool + Sync)) -> Option<Vec<[u32; 2]>> {
        TriangleTree::new(self).intersections(self, is_cancelled)
    }

    /// Corners of a triangle.
    pub fn corners(&self, triangle: u32) -> Corners {
        self.triangles[triangle as usize].map(|corner| self.positions[corner as usize])
    }
}

/// An axis-aligned box.
#[derive(Clone, Copy)]
pub struct Bounds {
    /// Its minimum.
    pub low: [f64; 3],
    /// Its maximum.
    pub high: [f64; 3],
}

impl Bounds {
    /// A box without a point.
    pub const EMPTY: Self = Self {
        low: [f64::INFINITY; 3],
        high: [f64::NEG_INFINITY; 3],
    };

    /// The box of points.
    pub fn around(corners: &[[f64; 3]]) -> Self {
        corners.iter().fold(Self::EMPTY, |all, &corner| {
            all.joined(&Self {
                low: corner,
                high: corner,
            })
        })
    }

    /// The smallest box around two.
    pub fn joined(&self, other: &Self) -> Self {
        Self {
            low: [0, 1, 2].map(|axis| self.low[axis].min(other.low[axis])),
            high: [0, 1, 2].map(|axis| self.high[axis].max(other.high[axis])),
        }
    }

    /// Whether two boxes have a point in common.
    pub fn meets(&self, other: &Self) -> bool {
        (0..3).all(|axis| self.low[axis] <= other.high[axis] && other.low[axis] <= self.high[axis])
    }

    /// Twice its centre along an axis.
    fn doubled_centre(&self, axis: usize) -> f64 {
        self.low[axis] + self.high[axis]
    }
}

/// Number of nodes of a tree over `triangles` triangles, by counting them: not for searches.
fn node_count(triangles: usize) -> usize {
    if triangles <= LEAF_TRIANGLES {
        return 1;
    }
    let half = triangles / 2;
    1 + node_count(half) + node_count(triangles - half)
}

/// A bounding volume hierarchy of the triangles of a mesh, as it was when the tree was built, with median splits. A node is followed by its first
/// half, then by its second one.
pub struct TriangleTree {
    /// Triangles in the order of the leaves.
    order: Vec<u32>,
    /// Boxes of the triangles in that order.
    boxes: Vec<Bounds>,
    nodes: Vec<Node>,
}

#[derive(Clone, Copy)]
struct Node {
    bounds: Bounds,
    /// From this node to its second half, in nodes; 0 of a leaf.
    to_second: usize,
}

impl TriangleTree {
    /// Builds the tree of a mesh.
    pub fn new(soup: &TriangleSoup<'_>) -> Self {
        let of = |triangle: u32| Bounds::around(&soup.corners(triangle));
        let mut boxed: Vec<(u32, Bounds)> = (0..soup.triangles.len() as u32)
            .map(|triangle| (triangle, of(triangle)))
            .collect();
        let empty = Node {
            bounds: Bounds::EMPTY,
            to_second: 0,
        };
        let mut nodes = vec![empty; node_count(boxed.len())];
        build(&mut boxed, &mut nodes);
        let (order, boxes) = boxed.into_iter().unzip();
        Self { order, boxes, nodes }
    }

    /// As [`TriangleSoup::intersections`] of the same mesh.
    pub fn intersections(
        &self,
        soup: &TriangleSoup<'_>,
        is_cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Option<Vec<[u32; 2]>> {
        let search = Search {
            soup,
            tree: self,
            is_cancelled,
        };
        let mut pairs = search.inside(0, [0, self.order.len()])?;
        pairs.sort_unstable();
        Some(pairs)
    }

    /// Triangles whose boxes meet a box.
    pub fn near(&self, bounds: &Bounds) -> Vec<u32> {
        let mut found = Vec::new();
        let mut nodes = vec![(0, [0, self.order.len()])];
        while let Some((node, range)) = nodes.pop() {
            if !self.nodes[node].bounds.meets(bounds) {
                continue;
            }
            if is_leaf(range) {
                let met = (range[0]..range[1]).filter(|&i| self.boxes[i].meets(bounds));
                found.extend(met.map(|i| self.order[i]));
            } else {
                nodes.extend(self.halves(node, range));
            }
        }
        found
    }

    /// The halves of a node.
    fn halves(&self, node: usize, [from, to]: Range) -> [(usize, Range); 2] {
        let half = (to - from) / 2;
        [
            (node + 1, [from, from + half]),
            (node + self.nodes[node].to_second, [from + half, to]),
        ]
    }
}

fn build(boxed: &mut [(u32, Bounds)], nodes: &mut [Node]) {
    let all = boxed.iter().fold(Bounds::EMPTY, |all, (_, own)| all.joined(own));
    nodes[0].bounds = all;
    if boxed.len() <= LEAF_TRIANGLES {
        return;
    }
    let length = |axis: &usize| all.high[*axis] - all.low[*axis];
    let axis = (0..3).max_by(|a, b| length(a).total_cmp(&length(b))).unwrap_or(0);
    let half = boxed.len() / 2;
    boxed.select_nth_unstable_by(half, |a, b| {
        a.1.doubled_centre(axis).total_cmp(&b.1.doubled_centre(axis))
    });
    let is_large = boxed.len() > PARALLEL_TRIANGLES;
    let (first, second) = boxed.split_at_mut(half);
    let count = node_count(half);
    nodes[0].to_second = 1 + count;
    let (first_nodes, second_nodes) = nodes[1..].split_at_mut(count);
    if is_large {
        rayon::join(|| build(first, first_nodes), || build(second, second_nodes));
    } else {
        build(first, first_nodes);
        build(second, second_nodes);
    }
}

/// A walk over pairs of nodes whose boxes meet. A node is its number with its range of triangles.
struct Search<'a> {
    soup: &'a TriangleSoup<'a>,
    tree: &'a TriangleTree,
    is_cancelled: &'a (dyn Fn() -> bool + Sync),
}

type Range = [usize; 2];

fn is_leaf([from, to]: Range) -> bool {
    to - from <= LEAF_TRIANGLES
}

impl Search<'_> {
    /// Pairs inside a node; `None` if it is cancelled.
    fn inside(&self, node: usize, range: Range) -> Option<Vec<[u32; 2]>> {
        let mut pairs = Vec::new();
        if range[1] - range[0] <= PARALLEL_TRIANGLES {
            self.inside_small(node, range, &mut pairs);
            return Some(pairs);
        }
        if (self.is_cancelled)() {
            return None;
        }
        let [first, second] = self.tree.halves(node, range);
        let ((of_first, of_second), ()) = rayon::join(
            || rayon::join(|| self.inside(first.0, first.1), || self.inside(second.0, second.1)),
            || self.across(first, second, &mut pairs),
        );
        pairs.extend(of_first?);
        pairs.extend(of_second?);
        Some(pairs)
    }

    fn inside_small(&self, node: usize, range: Range, pairs: &mut Vec<[u32; 2]>) {
        if is_leaf(range) {
            for i in range[0]..range[1] {
                (i..range[1]).for_each(|j| self.test(i, j, pairs));
            }
            return;
        }
        let [first, second] = self.tree.halves(node, range);
        self.inside_small(first.0, first.1, pairs);
        self.inside_small(second.0, second.1, pairs);
        self.across(first, second, pairs);
    }

    /// Pairs of two nodes.
    fn across(&self, a: (usize, Range), b: (usize, Range), pairs: &mut Vec<[u32; 2]>) {
        if !self.tree.nodes[a.0].bounds.meets(&self.tree.nodes[b.0].bounds) {
            return;
        }
        match (is_leaf(a.1), is_leaf(b.1)) {
            (true, true) => {
                for i in a.1[0]..a.1[1] {
                    (b.1[0]..b.1[1]).for_each(|j| self.test(i, j, pairs));
                }
            }
            (true, false) => self
                .tree
                .halves(b.0, b.1)
                .into_iter()
                .for_each(|half| self.across(a, half, pairs)),
            (false, _) => self
                .tree
                .halves(a.0, a.1)
                .into_iter()
                .for_each(|half| self.across(half, b, pairs)),
        }
    }

    fn test(&self, i: usize, j: usize, pairs: &mut Vec<[u32; 2]>) {
        if !self.tree.boxes[i].meets(&self.tree.boxes[j]) {
            return;
        }
        let [a, b] = [self.tree.order[i], self.tree.order[j]];
        let corners = self.soup.corners(a);
        let is_found = if a == b {
            !has_area(&corners)
        } else {
            intersect(&corners, &self.soup.corners(b))
        };
        if is_found {
            pairs.push([a.min(b), a.max(b)]);
        }
    }
}

fn side_of_plane([a, b, c]: &Corners, point: &[f64; 3]) -> f64 {
    let of = |[x, y, z]: [f64; 3]| Coord3D { x, y, z };
    orient3d(of(*a), of(*b), of(*c), of(*point))
}

/// A point, projected onto the plane of two axes.
fn flat(point: &[f64; 3], [u, v]: [usize; 2]) -> Coord<f64> {
    Coord {
        x: point[u],
        y: point[v],
    }
}

/// Two axes between which a triangle has an area; `None` if it has none.
fn plane_axes([a, b, c]: &Corners) -> Option<[usize; 2]> {
    let axes = [[0, 1], [1, 2], [2, 0]];
    axes.into_iter()
        .find(|axes| orient2d(flat(a, *axes), flat(b, *axes), flat(c, *axes)) != 0.0)
}

/// Whether a triangle has an area.
pub fn has_area(corners: &Corners) -> bool {
    plane_axes(corners).is_some()
}

/// Whether two triangles have more in common than the corners and the edge that they share. Triangles without area are not considered: see
/// [`has_area`].
pub fn intersect(a: &Corners, b: &Corners) -> bool {
    let (mut shared, mut count) = ([[0; 2]; 9], 0);
    for [i, j] in (0..9).map(|i| [i / 3, i % 3]) {
        if a[i] == b[j] {
            shared[count] = [i, j];
            count += 1;
        }
    }
    match shared[..count] {
        [] => !is_apart(a, b) && (edges(a).any(|edge| crosses(&edge, b)) || edges(b).any(|edge| crosses(&edge, a))),
        // If they have more in common, the intersection reaches the edge opposite to the shared corner in one of them.
        [[i, j]] => {
            let (of_a, of_b) = (opposite(a, i), opposite(b, j));
            !is_beside(b, &of_a) && !is_beside(a, &of_b) && (crosses(&of_a, b) || crosses(&of_b, a))
        }
        [[i, j], [k, l]] if i != k && j != l => folds(a, 3 - i - k, b, 3 - j - l),
        // All corners, or a triangle without area.
        _ => count == 3,
    }
}

/// Whether all corners of one are on one side of the plane of the other.
fn is_apart(a: &Corners, b: &Corners) -> bool {
    is_beside(a, b) || is_beside(b, a)
}

/// Whether all points are on one side of the plane of a triangle, and none in it.
fn is_beside(triangle: &Corners, points: &[[f64; 3]]) -> bool {
    let mut sides = points.iter().map(|point| side_of_plane(triangle, point));
    match sides.next() {
        Some(first) if first > 0.0 => sides.all(|side| side > 0.0),
        Some(first) if first < 0.0 => sides.all(|side| side < 0.0),
        _ => false,
    }
}

fn edges(corners: &Corners) -> impl Iterator<Item = [[f64; 3]; 2]> {
    let corners = *corners;
    (0..3).map(move |i| opposite(&corners, i))
}

/// The edge opposite to a corner.
fn opposite(corners: &Corners, corner: usize) -> [[f64; 3]; 2] {
    [corners[(corner + 1) % 3], corners[(corner + 2) % 3]]
}

/// Whether two triangles that share an edge lie on one another: their third corners are in one plane, on one side of the edge.
fn folds(a: &Corners, third_a: usize, b: &Corners, third_b: usize) -> bool {
    if side_of_plane(a, &b[third_b]) != 0.0 {
        return false;
    }
    let Some(axes) = plane_axes(a) else { return false };
    let [from, to] = opposite(a, third_a).map(|end| flat(&end, axes));
    let side = |point: &[f64; 3]| orient2d(from, to, flat(point, axes));
    side(&a[third_a]) * side(&b[third_b]) > 0.0
}

/// Whether a segment and a triangle have a point in common.
fn crosses([from, to]: &[[f64; 3]; 2], triangle: &Corners) -> bool {
    let sides = [from, to].map(|end| side_of_plane(triangle, end));
    match sides {
        [0.0, 0.0] => crosses_in_plane([from, to], triangle),
        [a, b] if (a > 0.0) == (b > 0.0) && a != 0.0 && b != 0.0 => false,
        _ => {
            let [a, b, c] = triangle;
            let turns = [[a, b], [b, c], [c, a]].map(|[p, q]| side_of_plane(&[*from, *to, *p], q));
            turns.iter().all(|turn| *turn >= 0.0) || turns.iter().all(|turn| *turn <= 0.0)
        }
    }
}

/// The same, of a segment in the triangle's plane.
fn crosses_in_plane([from, to]: [&[f64; 3]; 2], triangle: &Corners) -> bool {
    let Some(axes) = plane_axes(triangle) else { return false };
    let [from, to] = [from, to].map(|end| flat(end, axes));
    let [a, b, c] = [0, 1, 2].map(|i| flat(&triangle[i], axes));
    let is_inside = |point: Coord<f64>| {
        let turns = [[a, b], [b, c], [c, a]].map(|[p, q]| orient2d(p, q, point));
        turns.iter().all(|turn| *turn >= 0.0) || turns.iter().all(|turn| *turn <= 0.0)
    };
    is_inside(from)
        || is_inside(to)
        || [[a, b], [b, c], [c, a]]
            .into_iter()
            .any(|edge| have_common_point([from, to], edge))
}

/// Whether two segments of a plane have a point in common.
fn have_common_point([a, b]: [Coord<f64>; 2], [c, d]: [Coord<f64>; 2]) -> bool {
    let differ = |p: f64, q: f64| (p >= 0.0 && q <= 0.0) || (p <= 0.0 && q >= 0.0);
    let overlap = |p: f64, q: f64, r: f64, s: f64| p.min(q) <= r.max(s) && r.min(s) <= p.max(q);
    differ(orient2d(a, b, c), orient2d(a, b, d))
        && differ(orient2d(c, d, a), orient2d(c, d, b))
        // On one line both are 0.
        && overlap(a.x, b.x, c.x, d.x)
        && overlap(a.y, b.y, c.y, d.y)
}

#[cfg(test)]
mod tests {
    use super::*;

    const FLAT: Corners = [[0.0; 3], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]];

    fn pairs(corners: &[Corners]) -> Vec<[u32; 2]> {
        let positions: Vec<[f64; 3]> = corners.iter().flatten().copied().collect();
        let triangles: Vec<[u32; 3]> = (0..corners.len() as u32)
            .map(|i| [3 * i, 3 * i + 1, 3 * i + 2])
            .collect();
        let soup = TriangleSoup {
            positions: &positions,
            triangles: &triangles,
        };
        soup.intersections(&|| false).unwrap()
    }

    #[test]
    fn pairs_are_found_exactly() {
        let e = f64::EPSILON;
        for (other, expected, why) in [
            (
                [[1.0, 1.0, -1.0], [1.0, 1.0, 1.0], [9.0, 9.0, 1.0]],
                true,
                "an edge pierces",
            ),
            (
                [[1.0, 1.0, 0.0], [1.0, 1.0, 1.0], [9.0, 9.0, 1.0]],
                true,
                "a corner touches",
            ),
            ([[1.0, 1.0, e], [1.0, 1.0, 1.0], [9.0, 9.0, 1.0]], false, "just above"),
            (
                [[1.0, 1.0, 0.0], [2.0, 1.0, 0.0], [1.0, 2.0, 0.0]],
                true,
                "inside, in its plane",
            ),
            (
                [[3.0, 3.0, 0.0], [4.0, 3.0, 0.0], [3.0, 4.0, 0.0]],
                false,
                "beside, in its plane",
            ),
            (
                [[2.0, 2.0, 0.0], [4.0, 3.0, 0.0], [3.0, 4.0, 0.0]],
                true,
                "touches an edge in its plane",
            ),
            (
                [[0.0; 3], [-1.0, 0.0, 0.0], [0.0, -1.0, 1.0]],
                false,
                "one corner in common",
            ),
            (
                [[0.0; 3], [1.0, 1.0, 0.0], [1.0, 1.0, 1.0]],
                true,
                "a corner in common and more",
            ),
            (
                [[0.0; 3], [4.0, 0.0, 0.0], [0.0, -4.0, 0.0]],
                false,
                "an edge in common, flat",
            ),
            (
                [[0.0; 3], [4.0, 0.0, 0.0], [0.0, 3.0, 0.0]],
                true,
                "folded over an edge",
            ),
            ([[0.0; 3], [4.0, 0.0, 0.0], [0.0, 3.0, e]], false, "almost folded"),
            ([FLAT[1], FLAT[0], FLAT[2]], true, "the same corners"),
        ] {
            assert_eq!(pairs(&[FLAT, other]) == [[0, 1]], expected, "{why}");
            assert_eq!(pairs(&[other, FLAT]) == [[0, 1]], expected, "{why}, the other way");
        }
        let no_area = [[0.0; 3], [1.0; 3], [2.0; 3]];
        assert_eq!(pairs(&[no_area]), [[0, 0]]);
    }

    #[test]
    fn the_tree_finds_what_all_pairs_have() {
        // A sequence without a library.
        let mut state = 1u64;
        let mut next = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64 / f64::from(1u32 << 24)
        };
        let corners: Vec<Corners> = (0..3 * PARALLEL_TRIANGLES)
            .map(|_| {
                let at = [0, 1, 2].map(|_| 40.0 * next());
                [0, 1, 2].map(|_| at.map(|x| x + next()))
            })
            .collect();
        let found = pairs(&corners);
        let mut expected = Vec::new();
        let boxes: Vec<Bounds> = corners.iter().map(|corners| Bounds::around(corners)).collect();
        for i in 0..corners.len() {
            for j in i + 1..corners.len() {
                if boxes[i].meets(&boxes[j]) && intersect(&corners[i], &corners[j]) {
                    expected.push([i as u32, j as u32]);
                }
            }
        }
        assert!(expected.len() > 100, "{}", expected.len());
        assert_eq!(found, expected);
    }
}
