//! Positions to which a vertex may move.

use isopeel_geometry::DVec3;
use rustc_hash::FxHashMap;

use super::{Repair, Scope};

/// Maximum move of a vertex of a capped surface, as a fraction of the mean length of its edges, so that the vertex stays close to its
/// surface.
const REACH_FRACTION: f64 = 0.25;

/// Minimum of this limit, in smallest spacings.
const MIN_REACH: f64 = 2.0;

/// Half sides of the cubes around a vertex in which random candidate positions are chosen, in mean lengths of its edges.
const RANDOM_RADII: [f64; 6] = [0.03, 0.1, 0.2, 0.3, 0.5, 0.8];

/// Candidate positions between a vertex and the mean of its neighbours, as fractions of the way.
const MEAN_FRACTIONS: [f64; 4] = [0.1, 0.25, 0.5, 1.0];

/// Deterministic pseudo-random number generator.
pub(super) struct Random(pub(super) u64);

impl Random {
    /// Returns the next number.
    pub(super) fn next(&mut self) -> u64 {
        // The linear congruential generator of Knuth's MMIX.
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

/// The border of the surface at a vertex.
pub(super) enum Border {
    /// The vertex is inside the surface.
    None,
    /// The vertex is on a border, between these vertices.
    Along([u32; 2]),
}

impl Repair<'_> {
    /// Returns candidate positions of a vertex, the nearest to its `current` position first.
    pub(super) fn candidates(&mut self, vertex: u32, current: DVec3) -> Vec<DVec3> {
        let neighbours = self.neighbours(vertex);
        let mut candidates = match self.border(vertex) {
            Some(Border::Along(ends)) => self.candidates_along(ends, current),
            _ => self.candidates_among(&neighbours, current),
        };
        let original = self.originals.contains_key(&vertex).then(|| self.original(vertex));
        candidates.extend(original);
        if let Some(&to_caps) = self.mesh.caps.get(vertex as usize) {
            let (original, reach) = (self.original(vertex), self.reach(vertex, &neighbours));
            candidates = (candidates.iter())
                .filter_map(|&candidate| self.faces.constrained(current, candidate, to_caps))
                .filter(|candidate| candidate.distance(original) <= reach)
                .collect();
        }
        candidates.sort_by(|a, b| a.distance(current).total_cmp(&b.distance(current)));
        candidates
    }

    fn position(&self, vertex: u32) -> DVec3 {
        DVec3::from(self.mesh.positions[vertex as usize].map(f64::from))
    }

    /// Returns candidate positions between a vertex and its neighbours, and around it.
    fn candidates_among(&mut self, neighbours: &[u32], current: DVec3) -> Vec<DVec3> {
        let count = neighbours.len().max(1) as f64;
        let positions = || neighbours.iter().map(|&neighbour| self.position(neighbour));
        let mean = positions().sum::<DVec3>() / count;
        let mean_length = positions().map(|position| position.distance(current)).sum::<f64>() / count;
        let mut candidates: Vec<DVec3> = MEAN_FRACTIONS
            .iter()
            .map(|&fraction| current.lerp(mean, fraction))
            .collect();
        candidates.extend(
            RANDOM_RADII
                .iter()
                .map(|&radius| current + radius * mean_length * self.random.vector()),
        );
        candidates
    }

    /// Returns candidate positions of a vertex on a border in the triangle of the vertex and both neighbours on the border. If all three are
    /// on a face of the volume, so are these.
    fn candidates_along(&mut self, ends: [u32; 2], current: DVec3) -> Vec<DVec3> {
        let [first, second] = ends.map(|end| self.position(end));
        let mut candidates: Vec<DVec3> = MEAN_FRACTIONS
            .iter()
            .flat_map(|&fraction| [first, second, first.midpoint(second)].map(|to| current.lerp(to, fraction / 2.0)))
            .collect();
        candidates.extend(RANDOM_RADII.iter().map(|_| {
            let [along, across, _] = self.random.vector().to_array().map(|component| component.abs() / 2.0);
            current + along * (first - current) + across * (second - current)
        }));
        candidates
    }

    /// Returns the original position of a vertex.
    fn original(&self, vertex: u32) -> DVec3 {
        let current = &self.mesh.positions[vertex as usize];
        DVec3::from(self.originals.get(&vertex).unwrap_or(current).map(f64::from))
    }

    /// Returns the maximum distance of a vertex from its original position. It is infinite if the scope is the whole mesh.
    fn reach(&self, vertex: u32, neighbours: &[u32]) -> f64 {
        if matches!(self.scope, Scope::All) {
            return f64::INFINITY;
        }
        let original = self.original(vertex);
        let lengths = neighbours
            .iter()
            .map(|&neighbour| self.original(neighbour).distance(original));
        let mean_length = lengths.sum::<f64>() / neighbours.len().max(1) as f64;
        (REACH_FRACTION * mean_length).max(MIN_REACH * self.mesh.smallest_spacing)
    }

    /// Returns the other corners of the triangles of a vertex, each once.
    pub(super) fn neighbours(&self, vertex: u32) -> Vec<u32> {
        let triangles = self.triangles_of.vertex(vertex).iter();
        let mut corners: Vec<u32> = triangles
            .flat_map(|&triangle| self.mesh.triangles[triangle as usize])
            .collect();
        corners.retain(|&corner| corner != vertex);
        corners.sort_unstable();
        corners.dedup();
        corners
    }

    /// Returns how a vertex may move. `None` if it must not: at an edge of more than two triangles, or where several borders meet.
    pub(super) fn border(&self, vertex: u32) -> Option<Border> {
        let mut triangles_with: FxHashMap<u32, usize> = FxHashMap::default();
        let triangles = self.triangles_of.vertex(vertex).iter();
        for corner in triangles.flat_map(|&triangle| self.mesh.triangles[triangle as usize]) {
            if corner != vertex {
                *triangles_with.entry(corner).or_default() += 1;
            }
        }
        if triangles_with.values().any(|&count| count > 2) {
            return None;
        }
        let mut ends: Vec<u32> = (triangles_with.iter())
            .filter_map(|(&corner, &count)| (count == 1).then_some(corner))
            .collect();
        ends.sort_unstable();
        match ends[..] {
            [] => Some(Border::None),
            [first, second] => Some(Border::Along([first, second])),
            _ => None,
        }
    }
}
