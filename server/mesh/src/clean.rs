//! Counts the triangles of a file that intersect, and moves vertices until there are none.

use std::time::{Duration, Instant};

use isopeel_extraction::Cleaned;
use isopeel_geometry::DVec3;
use isopeel_geometry::{Bounds, Corners, TriangleSoup, TriangleTree, has_area, intersect};
use rustc_hash::FxHashMap;

use super::caps::Faces;
use super::decimal::Decimals;
use super::topology::Around;
use super::{Format, Mesh};

/// Maximum rounds over the groups of intersecting triangles before the repair is given up.
const MAX_ROUNDS: usize = 16;

/// The same for capped surfaces of which each vertex stands for a cell, because the cut near caps was refined before.
const CAP_ROUNDS: usize = 4;

/// Maximum move of a vertex of a capped surface, as a share of the mean length of its edges, so that it stays close to its own triangles.
const REACH_SHARE: f64 = 0.25;

/// Such a vertex may always be moved by this many smallest spacings.
const MIN_REACH: f64 = 2.0;

/// Rounds after which a group grows by the vertices around it.
const ROUNDS_BEFORE_GROWTH: usize = 3;

/// Sweeps over the vertices of a group in a round, in each of which a vertex may move once.
const SWEEPS: usize = 24;

/// Half sides of the cubes from which random positions of a vertex are tried, in mean lengths of its edges.
const RANDOM_RADII: [f64; 6] = [0.03, 0.1, 0.2, 0.3, 0.5, 0.8];

/// Shares of the way to the middle of a vertex' neighbours that are tried.
const MIDDLE_SHARES: [f64; 4] = [0.1, 0.25, 0.5, 1.0];

/// Of the moves that change nothing, one in this many is made, to leave a dead end.
const SIDEWAYS: u64 = 4;

/// Triangles of a file still intersect.
#[derive(Debug, thiserror::Error)]
#[error(
    "{pairs} {} after {MAX_ROUNDS} rounds of moving vertices there, and clean (--clean) allows none: ask for more triangles or a smaller error",
    if *pairs == 1 { "pair of triangles still intersects" } else { "pairs of triangles still intersect" }
)]
pub struct NotClean {
    /// Pairs of triangles that intersect.
    pairs: u64,
}

/// Result of a repair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Repaired {
    /// What was moved.
    pub cleaned: Cleaned,
    /// Pairs of triangles that intersect afterwards.
    pub intersections: u64,
}

/// Why a mesh is not repaired.
#[derive(Debug, thiserror::Error)]
pub enum RepairError {
    /// The caller has cancelled.
    #[error("cancelled")]
    Cancelled,
    /// Triangles still intersect.
    #[error(transparent)]
    NotClean(#[from] NotClean),
}

/// Counts the pairs of triangles that intersect in a file of the format; `None` if that is cancelled, or takes longer than the limit.
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

/// Which triangles are repaired.
#[derive(Clone, Copy, Debug)]
pub enum Scope {
    /// All: it is an error if some still intersect.
    All,
    /// Only pairs with a corner near a cap, because other intersections also occur in surfaces without caps.
    AtCaps {
        /// Cells along the largest cube that a vertex stands for.
        cells: f32,
    },
}

/// Moves vertices of triangles that intersect, and if that does not suffice, those around them, until no triangles intersect in a file of
/// the format. Moves are tried in a fixed order, so that equal meshes are repaired equally. Vertices on caps stay on the faces of the
/// volume.
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
    let around = Around::new(mesh);
    let numbers = Numbers::new(mesh, format);
    let mut repair = Repair {
        positions: numbers.all(mesh),
        numbers,
        mesh,
        faces,
        scope,
        around: &around,
        moved: Vec::new(),
        originals: FxHashMap::default(),
        random: Random(1),
    };
    for round in 0..=rounds {
        let soup = TriangleSoup {
            positions: &repair.positions,
            triangles: &repair.mesh.triangles,
        };
        let tree = TriangleTree::new(&soup);
        repair.moved.clear();
        let pairs = tree.intersections(&soup, is_cancelled);
        let mut pairs = pairs.ok_or(RepairError::Cancelled)?;
        let all = pairs.len() as u64;
        pairs.retain(|pair| repair.is_repaired(pair));
        if round == 0 {
            cleaned.intersections = pairs.len() as u64;
        }
        let is_last = round == rounds;
        if let (true, Scope::All, pairs @ 1..) = (is_last, scope, pairs.len() as u64) {
            return Err(RepairError::NotClean(NotClean { pairs }));
        }
        if pairs.is_empty() || is_last {
            repair.state_moves(&mut cleaned);
            return Ok(Repaired {
                cleaned,
                intersections: all,
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

/// Representation of positions in a file of a format.
#[derive(Clone, Copy)]
enum Numbers {
    /// As in the mesh, or as 64-bit world positions.
    Exact,
    /// As 32-bit world positions.
    Rounded,
    /// As decimals of world positions.
    WorldDecimals(Decimals),
    /// As decimals, relative to the mesh's origin.
    Decimals(Decimals),
    /// As decimals that are read with 32 bits, relative to the mesh's origin.
    RoundedDecimals(Decimals),
}

impl Numbers {
    fn new(mesh: &Mesh, format: Format) -> Self {
        match format {
            Format::Obj => Self::WorldDecimals(Decimals::of_spacing(mesh.smallest_spacing)),
            Format::ThreeMf => Self::Decimals(Decimals::of_spacing(mesh.smallest_spacing)),
            Format::Usdz => Self::RoundedDecimals(Decimals::of_spacing(mesh.smallest_spacing)),
            _ if format.rounds() => Self::Rounded,
            _ => Self::Exact,
        }
    }

    /// Returns a position of a mesh as its file stores it.
    fn position(self, mesh: &Mesh, position: [f32; 3]) -> [f64; 3] {
        let position = position.map(f64::from);
        let world = [0, 1, 2].map(|axis| mesh.origin[axis] + position[axis]);
        match self {
            Self::Exact => position,
            // A position beyond 32 bits is refused when it is written.
            Self::Rounded => world.map(|component| f64::from(component as f32)),
            Self::WorldDecimals(decimals) => world.map(|component| decimals.rounded(component)),
            Self::Decimals(decimals) => position.map(|component| decimals.rounded(component)),
            Self::RoundedDecimals(decimals) => position.map(|component| f64::from(decimals.rounded(component) as f32)),
        }
    }

    fn all(self, mesh: &Mesh) -> Vec<[f64; 3]> {
        let positions = mesh.positions.iter();
        positions.map(|&position| self.position(mesh, position)).collect()
    }
}

/// Groups the vertices of triangles that intersect: those of one place are together.
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

/// Deterministic pseudo-random numbers.
struct Random(u64);

impl Random {
    /// Returns the next number.
    fn next(&mut self) -> u64 {
        // Linear congruential generator of Knuth's MMIX.
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        self.0 >> 33
    }

    /// Returns a vector with components from −1 to 1.
    fn vector(&mut self) -> DVec3 {
        let mut component = || self.next() as f64 / f64::from(1u32 << 30) - 1.0;
        DVec3::new(component(), component(), component())
    }
}

/// A mesh while its vertices are moved.
struct Repair<'a> {
    mesh: &'a mut Mesh,
    /// Positions as the file stores them.
    positions: Vec<[f64; 3]>,
    numbers: Numbers,
    faces: Faces,
    scope: Scope,
    around: &'a Around,
    /// Triangles that have moved since the tree was built.
    moved: Vec<u32>,
    /// Original positions of the vertices that have been moved.
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

    /// Moves vertices of a group, and those within `edges` edges of them, until no triangles intersect there or [`SWEEPS`] are done. Vertices on
    /// borders stay.
    fn repair_group(&mut self, mut vertices: Vec<u32>, edges: usize, tree: &TriangleTree) {
        for _ in 0..edges {
            let next: Vec<u32> = vertices.iter().flat_map(|&vertex| self.next_to(vertex)).collect();
            vertices.extend(next);
            vertices.sort_unstable();
            vertices.dedup();
        }
        vertices.retain(|&vertex| !self.is_on_border(vertex));
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

    /// Tries positions of a vertex, and moves it to the one at which its triangles intersect the fewest others; sometimes to one that is
    /// only as good as its present position. Returns true, and moves nothing, if they intersected none before.
    fn improve(&mut self, vertex: u32, tree: &TriangleTree) -> bool {
        let current = self.mesh.positions[vertex as usize];
        let near = self.near(tree, vertex, &[]);
        if self.faults(vertex, current, &near, usize::MAX) == 0 {
            return true;
        }
        let candidates = self.candidates(vertex, DVec3::from(current.map(f64::from)));
        let candidates: Vec<[f32; 3]> = candidates
            .iter()
            .map(|at| at.to_array().map(|component| component as f32))
            .collect();
        let near = self.near(tree, vertex, &candidates);
        let before = self.faults(vertex, current, &near, usize::MAX);
        let (mut best, mut fewest) = (current, before);
        for candidate in candidates {
            let faults = self.faults(vertex, candidate, &near, fewest + 1);
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
            self.place(vertex, best);
            self.moved.extend(self.around.of(vertex));
            self.moved.sort_unstable();
            self.moved.dedup();
        }
        false
    }

    /// Returns the triangles that those around a vertex may intersect, at its current position and at the tried ones.
    fn near(&self, tree: &TriangleTree, vertex: u32, tried: &[[f32; 3]]) -> Vec<u32> {
        let corners = self
            .around
            .of(vertex)
            .iter()
            .flat_map(|&triangle| self.mesh.triangles[triangle as usize]);
        let mut points: Vec<[f64; 3]> = corners.map(|corner| self.positions[corner as usize]).collect();
        points.extend(tried.iter().map(|&place| self.numbers.position(self.mesh, place)));
        let mut near = tree.near(&Bounds::around(&points));
        near.extend(&self.moved);
        near.sort_unstable();
        near.dedup();
        near
    }

    fn place(&mut self, vertex: u32, position: [f32; 3]) {
        self.mesh.positions[vertex as usize] = position;
        self.positions[vertex as usize] = self.numbers.position(self.mesh, position);
    }

    /// Returns the positions to try, near ones first.
    fn candidates(&mut self, vertex: u32, at: DVec3) -> Vec<DVec3> {
        let position = |vertex: u32| DVec3::from(self.mesh.positions[vertex as usize].map(f64::from));
        let next = self.next_to(vertex);
        let middle = next.iter().map(|&next| position(next)).sum::<DVec3>() / next.len().max(1) as f64;
        let length = next.iter().map(|&next| position(next).distance(at)).sum::<f64>() / next.len().max(1) as f64;
        let original = self.originals.contains_key(&vertex).then(|| self.original(vertex));
        let mut tried: Vec<DVec3> = MIDDLE_SHARES.iter().map(|&share| at.lerp(middle, share)).collect();
        tried.extend(
            RANDOM_RADII
                .iter()
                .map(|&radius| at + radius * length * self.random.vector()),
        );
        tried.extend(original);
        if let Some(&to) = self.mesh.caps.get(vertex as usize) {
            let (original, reach) = (self.original(vertex), self.reach(vertex, &next));
            tried = (tried.iter())
                .filter_map(|&place| self.faces.constrained(at, place, to))
                .filter(|place| place.distance(original) <= reach)
                .collect();
        }
        tried.sort_by(|a, b| a.distance(at).total_cmp(&b.distance(at)));
        tried
    }

    /// Returns the original position of a vertex.
    fn original(&self, vertex: u32) -> DVec3 {
        let current = &self.mesh.positions[vertex as usize];
        DVec3::from(self.originals.get(&vertex).unwrap_or(current).map(f64::from))
    }

    /// Maximum distance of a vertex of a capped surface from its original position, given the vertices next to it.
    fn reach(&self, vertex: u32, next: &[u32]) -> f64 {
        if matches!(self.scope, Scope::All) {
            return f64::INFINITY;
        }
        let at = self.original(vertex);
        let edges = next.iter().map(|&next| self.original(next).distance(at));
        let mean = edges.sum::<f64>() / next.len().max(1) as f64;
        (REACH_SHARE * mean).max(MIN_REACH * self.mesh.smallest_spacing)
    }

    /// Counts the faults with a vertex at a position: triangles around it without area, pairs of these that intersect, and intersecting
    /// pairs of one of these and one of `near`. May stop at `limit`.
    fn faults(&self, vertex: u32, position: [f32; 3], near: &[u32], limit: usize) -> usize {
        let position = self.numbers.position(self.mesh, position);
        let corners = |triangle: u32| -> Corners {
            self.mesh.triangles[triangle as usize].map(|corner| match corner == vertex {
                true => position,
                false => self.positions[corner as usize],
            })
        };
        let own: Vec<(u32, Corners, Bounds)> = (self.around.of(vertex).iter())
            .map(|&triangle| (triangle, corners(triangle)))
            .map(|(triangle, corners)| (triangle, corners, Bounds::around(&corners)))
            .collect();
        let all = own.iter().fold(Bounds::EMPTY, |all, (.., bounds)| all.joined(bounds));
        let mut faults = own.iter().filter(|(_, corners, _)| !has_area(corners)).count();
        for (i, (_, a, of_a)) in own.iter().enumerate() {
            let others = own[i + 1..].iter();
            faults += others
                .filter(|(_, b, of_b)| of_a.meets(of_b) && intersect(a, b))
                .count();
        }
        for &triangle in near {
            if faults >= limit {
                break;
            }
            let other = self.mesh.triangles[triangle as usize];
            if other.contains(&vertex) {
                continue;
            }
            let other = other.map(|corner| self.positions[corner as usize]);
            let bounds = Bounds::around(&other);
            if all.meets(&bounds) {
                let met = own
                    .iter()
                    .filter(|(_, own, of_own)| of_own.meets(&bounds) && intersect(own, &other));
                faults += met.count();
            }
        }
        faults
    }

    /// Returns the other corners of the triangles around a vertex, each once.
    fn next_to(&self, vertex: u32) -> Vec<u32> {
        let triangles = self.around.of(vertex).iter();
        let mut corners: Vec<u32> = triangles
            .flat_map(|&triangle| self.mesh.triangles[triangle as usize])
            .collect();
        corners.retain(|&corner| corner != vertex);
        corners.sort_unstable();
        corners.dedup();
        corners
    }

    /// Whether a vertex is on a border, or at an edge of more than two triangles. Any other vertex has as many neighbours as triangles.
    fn is_on_border(&self, vertex: u32) -> bool {
        self.next_to(vertex).len() != self.around.of(vertex).len()
    }

    fn state_moves(&self, cleaned: &mut Cleaned) {
        for (&vertex, original) in &self.originals {
            let [new, old] = [&self.mesh.positions[vertex as usize], original].map(|at| DVec3::from(at.map(f64::from)));
            if new != old {
                cleaned.moved_vertices += 1;
                cleaned.largest_move = cleaned.largest_move.max(new.distance(old));
            }
        }
    }
}

#[cfg(test)]
mod tests;
