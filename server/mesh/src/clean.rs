//! Counts intersecting triangles of a mesh as its file stores it, and repairs it: moves vertices until no triangles intersect, and makes nearly
//! flat edges locally Delaunay.

mod candidates;
mod flat;
mod numbers;

use std::time::{Duration, Instant};

use isopeel_extraction::Cleaned;
use isopeel_geometry::DVec3;
use isopeel_geometry::{Bounds, Corners, TriangleSoup, TriangleTree, has_area, intersect};
use rustc_hash::FxHashMap;

use super::caps::Faces;
use super::topology::VertexTriangles;
use super::{Format, Mesh};
use candidates::Random;
use numbers::Numbers;

/// Maximum number of rounds. Each round finds the intersections of the mesh, and repairs all groups of intersecting triangles.
const MAX_ROUNDS: usize = 16;

/// Maximum number of rounds for capped surfaces whose vertices represent single cells. Fewer, because their cut near caps was already
/// refined.
const CAP_ROUNDS: usize = 4;

/// Maximum number of rounds in which nearly flat edges are flipped, and vertices are moved at those that cannot be flipped.
const FLAT_ROUNDS: usize = 10;

/// After each of this many rounds, groups grow by one ring of neighbouring vertices.
const ROUNDS_BEFORE_GROWTH: usize = 3;

/// Maximum number of sweeps over the vertices of a group in a round. In each sweep, a vertex may move once.
const SWEEPS: usize = 24;

/// One in this many moves that do not reduce the intersections is made nevertheless, to leave local minima.
const SIDEWAYS: u64 = 4;

/// Triangles of a file still intersect.
#[derive(Debug, thiserror::Error)]
#[error(
    "{pairs} {} after {MAX_ROUNDS} rounds of moving vertices there, and clean (--clean) allows none: ask for more triangles or a smaller error",
    if *pairs == 1 { "pair of triangles still intersects" } else { "pairs of triangles still intersect" }
)]
pub struct NotClean {
    /// Number of pairs of triangles that intersect.
    pairs: u64,
}

/// Result of a repair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Repaired {
    /// Statistics of the moved vertices.
    pub cleaned: Cleaned,
    /// Number of pairs of triangles that intersect after the repair, including those outside the scope.
    pub intersections: u64,
}

/// Why a mesh could not be repaired.
#[derive(Debug, thiserror::Error)]
pub enum RepairError {
    /// The caller has cancelled.
    #[error("cancelled")]
    Cancelled,
    /// Triangles still intersect.
    #[error(transparent)]
    NotClean(#[from] NotClean),
}

/// Counts the pairs of triangles that intersect in a file of this format. Returns `None` if the count is cancelled, or takes longer than
/// `limit`.
pub fn count(
    mesh: &Mesh,
    format: Format,
    limit: Option<Duration>,
    is_cancelled: &(dyn Fn() -> bool + Sync),
) -> Option<u64> {
    let start = Instant::now();
    let is_late = || limit.is_some_and(|limit| start.elapsed() > limit);
    let soup = TriangleSoup {
        positions: &Numbers::new(mesh, format).all(mesh),
        triangles: &mesh.triangles,
    };
    let pairs = soup.intersections(&|| is_cancelled() || is_late())?;
    (!is_late()).then_some(pairs.len() as u64)
}

/// The pairs of triangles that are repaired.
#[derive(Clone, Copy, Debug)]
pub enum Scope {
    /// All pairs. The repair fails if triangles still intersect.
    All,
    /// Pairs with a corner near a cap. Other intersections are not a fault of the caps: they also occur in surfaces without caps.
    AtCaps {
        /// Edge length, in cells, of the largest cube that a vertex represents.
        cells: f32,
    },
}

/// Moves vertices of intersecting triangles until no triangles in the scope intersect in a file of this format. In later rounds, also moves
/// neighbouring vertices. Vertices on caps stay on the faces of the volume. The repair is deterministic.
///
/// In the scope [`Scope::All`] it also flips edges between nearly coplanar triangles that are not locally Delaunay, because mesh generators
/// do this without checks, and moves vertices at edges that cannot be flipped. Counts the edges that remain.
///
/// # Errors
/// [`RepairError::NotClean`] if triangles in the scope [`Scope::All`] still intersect after [`MAX_ROUNDS`].
pub fn repair(
    mesh: &mut Mesh,
    format: Format,
    scope: Scope,
    faces: Faces,
    is_cancelled: &(dyn Fn() -> bool + Sync),
) -> Result<Repaired, RepairError> {
    let mut cleaned = Cleaned::default();
    let rounds = match scope {
        Scope::AtCaps { cells } if cells <= 1.0 => CAP_ROUNDS,
        Scope::All | Scope::AtCaps { .. } => MAX_ROUNDS,
    };
    let numbers = Numbers::new(mesh, format);
    let mut repair = Repair {
        positions: numbers.all(mesh),
        triangles_of: VertexTriangles::new(mesh),
        numbers,
        mesh,
        faces,
        scope,
        moved: Vec::new(),
        originals: FxHashMap::default(),
        random: Random(1),
    };
    for round in 0..=rounds {
        let is_last = round == rounds;
        // The first round counts the intersections of the mesh as it is.
        let flips_edges = matches!(scope, Scope::All) && (1..FLAT_ROUNDS).contains(&round);
        let blocked = if flips_edges {
            repair.flip_flat_edges(&mut cleaned)
        } else {
            Vec::new()
        };
        let soup = TriangleSoup {
            positions: &repair.positions,
            triangles: &repair.mesh.triangles,
        };
        let tree = TriangleTree::new(&soup);
        repair.moved.clear();
        let pairs = tree.intersections(&soup, is_cancelled);
        let mut pairs = pairs.ok_or(RepairError::Cancelled)?;
        let all_pairs = pairs.len() as u64;
        pairs.retain(|pair| repair.is_repaired(pair));
        if round == 0 {
            cleaned.intersections = pairs.len() as u64;
        }
        if let (true, Scope::All, pairs @ 1..) = (is_last, scope, pairs.len() as u64) {
            return Err(RepairError::NotClean(NotClean { pairs }));
        }
        let is_unflipped = matches!(scope, Scope::All) && round == 0;
        pairs.extend(blocked);
        if pairs.is_empty() && is_unflipped {
            continue;
        }
        if pairs.is_empty() || is_last {
            repair.count_moves(&mut cleaned);
            if matches!(scope, Scope::All) {
                cleaned.unflipped_edges = flat::count(&repair.positions, &repair.mesh.triangles);
            }
            return Ok(Repaired {
                cleaned,
                intersections: all_pairs,
            });
        }
        for group in groups(&repair.mesh.triangles, &pairs) {
            if is_cancelled() {
                return Err(RepairError::Cancelled);
            }
            repair.repair_group(group, round / ROUNDS_BEFORE_GROWTH, &tree);
        }
    }
    unreachable!("the last round returns")
}

/// Groups the vertices of intersecting triangles. Two pairs of triangles with a common vertex are in the same group.
fn groups(triangles: &[[u32; 3]], pairs: &[[u32; 2]]) -> Vec<Vec<u32>> {
    let mut group_of: FxHashMap<u32, usize> = FxHashMap::default();
    let mut groups: Vec<Vec<u32>> = Vec::new();
    for pair in pairs {
        let vertices = pair.map(|triangle| triangles[triangle as usize]);
        let mut joined = vertices.as_flattened().to_vec();
        for vertex in vertices.as_flattened() {
            if let Some(&group) = group_of.get(vertex) {
                joined.append(&mut groups[group]);
            }
        }
        joined.sort_unstable();
        joined.dedup();
        joined.iter().for_each(|&vertex| {
            group_of.insert(vertex, groups.len());
        });
        groups.push(joined);
    }
    groups.retain(|group| !group.is_empty());
    groups
}

/// State of a repair.
struct Repair<'a> {
    mesh: &'a mut Mesh,
    /// Positions as the file stores them.
    positions: Vec<[f64; 3]>,
    numbers: Numbers,
    faces: Faces,
    scope: Scope,
    triangles_of: VertexTriangles,
    /// Triangles that have moved since the tree of the round was built, sorted.
    moved: Vec<u32>,
    /// Original positions of all moved vertices.
    originals: FxHashMap<u32, [f32; 3]>,
    random: Random,
}

impl Repair<'_> {
    /// Whether a pair of triangles is in the scope.
    fn is_repaired(&self, pair: &[u32; 2]) -> bool {
        let mut corners = pair.iter().flat_map(|&triangle| self.mesh.triangles[triangle as usize]);
        match self.scope {
            Scope::All => true,
            Scope::AtCaps { .. } => corners.any(|corner| self.mesh.caps[corner as usize].is_near),
        }
    }

    /// Flips edges between nearly coplanar triangles until they are locally Delaunay. Returns the pairs of triangles whose common edge could
    /// not be flipped.
    fn flip_flat_edges(&mut self, cleaned: &mut Cleaned) -> Vec<[u32; 2]> {
        let flips = flat::flip_flat_edges(&self.positions, &mut self.mesh.triangles);
        if flips.flipped > 0 {
            self.triangles_of = VertexTriangles::new(self.mesh);
        }
        cleaned.flipped_edges += flips.flipped;
        flips.blocked
    }

    /// Moves the vertices of a group and `rings` rings of neighbours, until none of their triangles intersect, or for [`SWEEPS`]. Moves
    /// vertices on borders along these.
    fn repair_group(&mut self, mut vertices: Vec<u32>, rings: usize, tree: &TriangleTree) {
        for _ in 0..rings {
            let neighbours: Vec<u32> = vertices.iter().flat_map(|&vertex| self.neighbours(vertex)).collect();
            vertices.extend(neighbours);
            vertices.sort_unstable();
            vertices.dedup();
        }
        vertices.retain(|&vertex| self.border(vertex).is_some());
        for _ in 0..SWEEPS {
            let mut is_done = true;
            for &vertex in &vertices {
                is_done &= self.improve(vertex, tree);
            }
            if is_done {
                return;
            }
        }
    }

    /// Moves a vertex to the candidate position with the fewest faults. Sometimes moves it to a position with as many faults as before, to
    /// leave a local minimum. Returns true, without a move, if the vertex has no faults.
    fn improve(&mut self, vertex: u32, tree: &TriangleTree) -> bool {
        let current = self.mesh.positions[vertex as usize];
        let nearby = self.nearby_triangles(tree, vertex, &[]);
        if self.faults(vertex, current, &nearby, usize::MAX) == 0 {
            return true;
        }
        let candidates = self.candidates(vertex, DVec3::from(current.map(f64::from)));
        let candidates: Vec<[f32; 3]> = candidates
            .iter()
            .map(|position| position.to_array().map(|component| component as f32))
            .collect();
        let nearby = self.nearby_triangles(tree, vertex, &candidates);
        let before = self.faults(vertex, current, &nearby, usize::MAX);
        let (mut best, mut fewest) = (current, before);
        for candidate in candidates {
            let faults = self.faults(vertex, candidate, &nearby, fewest + 1);
            let is_sideways = faults == before && fewest == before && self.random.next().is_multiple_of(SIDEWAYS);
            if faults < fewest || is_sideways {
                (best, fewest) = (candidate, faults);
            }
            if fewest == 0 {
                break;
            }
        }
        if best != current {
            self.originals.entry(vertex).or_insert(current);
            self.set_position(vertex, best);
            self.moved.extend(self.triangles_of.vertex(vertex));
            self.moved.sort_unstable();
            self.moved.dedup();
        }
        false
    }

    /// Returns the triangles that the triangles of a vertex may intersect, if the vertex is at its current position or at a candidate.
    fn nearby_triangles(&self, tree: &TriangleTree, vertex: u32, candidates: &[[f32; 3]]) -> Vec<u32> {
        let corners = self
            .triangles_of
            .vertex(vertex)
            .iter()
            .flat_map(|&triangle| self.mesh.triangles[triangle as usize]);
        let mut points: Vec<[f64; 3]> = corners.map(|corner| self.positions[corner as usize]).collect();
        let stored = candidates
            .iter()
            .map(|&position| self.numbers.position(self.mesh, position));
        points.extend(stored);
        let mut nearby = tree.near(&Bounds::around(&points));
        // The tree has the old positions of these triangles.
        nearby.extend(&self.moved);
        nearby.sort_unstable();
        nearby.dedup();
        nearby
    }

    fn set_position(&mut self, vertex: u32, position: [f32; 3]) {
        self.mesh.positions[vertex as usize] = position;
        self.positions[vertex as usize] = self.numbers.position(self.mesh, position);
    }

    /// Counts the faults of the triangles of a vertex, if the vertex is at a position. A fault is a triangle without area, an intersection
    /// of two of these triangles, an intersection of one of them with a triangle in `nearby`, or a nearly flat edge that is not locally
    /// Delaunay and cannot be flipped. May stop at `limit`.
    fn faults(&self, vertex: u32, position: [f32; 3], nearby: &[u32], limit: usize) -> usize {
        let position = self.numbers.position(self.mesh, position);
        let corners = |triangle: u32| -> Corners {
            self.mesh.triangles[triangle as usize].map(|corner| match corner == vertex {
                true => position,
                false => self.positions[corner as usize],
            })
        };
        let adjacent: Vec<(u32, Corners, Bounds)> = (self.triangles_of.vertex(vertex).iter())
            .map(|&triangle| (triangle, corners(triangle)))
            .map(|(triangle, corners)| (triangle, corners, Bounds::around(&corners)))
            .collect();
        let all_bounds = adjacent
            .iter()
            .fold(Bounds::EMPTY, |all, (.., bounds)| all.joined(bounds));
        let mut faults = adjacent.iter().filter(|(_, corners, _)| !has_area(corners)).count();
        if matches!(self.scope, Scope::All) {
            faults += self.blocked_edges(vertex, position);
        }
        for (i, (_, a, bounds_a)) in adjacent.iter().enumerate() {
            let others = adjacent[i + 1..].iter();
            faults += others
                .filter(|(_, b, bounds_b)| bounds_a.meets(bounds_b) && intersect(a, b))
                .count();
        }
        for &triangle in nearby {
            if faults >= limit {
                break;
            }
            let other = self.mesh.triangles[triangle as usize];
            if other.contains(&vertex) {
                continue;
            }
            let other = other.map(|corner| self.positions[corner as usize]);
            let bounds = Bounds::around(&other);
            if all_bounds.meets(&bounds) {
                let intersecting = adjacent
                    .iter()
                    .filter(|(_, corners, own_bounds)| own_bounds.meets(&bounds) && intersect(corners, &other));
                faults += intersecting.count();
            }
        }
        faults
    }

    /// Counts the nearly flat edges of the triangles of a vertex that are not locally Delaunay and cannot be flipped, if the vertex is at a
    /// position as the file stores it.
    fn blocked_edges(&self, vertex: u32, position: [f64; 3]) -> usize {
        let at = |corner: u32| match corner == vertex {
            true => position,
            false => self.positions[corner as usize],
        };
        let corners = |triangle: &u32| self.mesh.triangles[*triangle as usize];
        let mut blocked = 0;
        for [a, b, c] in self.triangles_of.vertex(vertex).iter().map(corners) {
            for [a, b, c] in [[a, b, c], [b, c, a], [c, a, b]] {
                let mut opposites = (self.triangles_of.vertex(a).iter().map(corners))
                    .filter(|corners| corners.contains(&b))
                    .filter_map(|corners| flat::opposite(corners, [a, b]))
                    .filter(|&other| other != c);
                let (Some(d), None) = (opposites.next(), opposites.next()) else {
                    continue;
                };
                let quad = [a, b, c, d].map(at);
                let exists = || {
                    let mut of_c = self.triangles_of.vertex(c).iter().map(corners);
                    of_c.any(|corners| corners.contains(&d))
                };
                blocked += usize::from(flat::is_blocked(&quad, exists));
            }
        }
        blocked
    }

    /// Adds the number of moved vertices and the largest move to `cleaned`.
    fn count_moves(&self, cleaned: &mut Cleaned) {
        for (&vertex, original) in &self.originals {
            let current = &self.mesh.positions[vertex as usize];
            let [new, old] = [current, original].map(|position| DVec3::from(position.map(f64::from)));
            if new != old {
                cleaned.moved_vertices += 1;
                cleaned.largest_move = cleaned.largest_move.max(new.distance(old));
            }
        }
    }
}

#[cfg(test)]
mod tests;
