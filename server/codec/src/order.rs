//! The order in which a region's triangles are encoded: a traversal of the surface by half-edges.
//!
//! The index codec takes one byte for a triangle that continues from one of the last [`REACH`] edges, if the third vertex is new, was used
//! recently, or has an index next to the last one that was written in full. Other triangles take more bytes. The traversal grows the
//! covered part of the surface along its boundary, as Edgebreaker does (J. Rossignac, 1999). It enters each triangle through a *gate*, an
//! edge of the boundary, and leaves the triangle through the right edge, or else through the left one. Then the third vertex is new, or it
//! is the next vertex along the boundary. The index of that vertex follows the last one, because the vertex was numbered one round earlier.
//! The cost is linear in the number of triangles. meshoptimizer's strips are as small, but they search for the next triangle among several
//! candidates, and meshoptimizer's encoder takes a list of indices, in which it has to find the edges again.
//!
//! - `connect` finds the twin of every half-edge in an [`EdgeTable`]. The two triangles of a quad follow each other in the input, so their
//!   common edge needs no look-up.
//! - `write` starts at every triangle that is not covered yet, and `cover` traverses the triangles that can be reached from there. If both
//!   exits of a triangle are free, the left one is pushed on a stack with the codec's edge clock. From the clock a later step knows whether
//!   the codec's buffer still contains the edge.
//!
//! Invariants: each triangle is written once, after all triangles of finer levels. Twins are of the same level, so no traversal leaves a
//! level. Index 0 of all tables is a sentinel triangle that is always covered.
//!
//! The inner loops select by arithmetic instead of branching. On real surfaces it is unpredictable which of several cases applies, and a
//! mispredicted branch costs as much as the rest of a step.

use std::hint::select_unpredictable;
use std::ops::Range;

use super::chunk::MAX_INDICES;
use super::index_codec::{IndexWriter, REACH};

/// An edge of a triangle with its direction: four times the triangle's number, counted from 1, plus the corner at which the edge starts.
type HalfEdge = u32;
/// Half-edge of the sentinel triangle. That triangle is covered, and serves as target of writes that have no other target.
const NONE: HalfEdge = 0;

/// Returns the corner after another one. The results are packed in a constant, two bits each, which is faster than an array.
pub(super) fn after(corner: u32) -> u32 {
    0b00_10_01 >> (2 * corner) & 3
}

/// Returns the corner before another one.
pub(super) fn before(corner: u32) -> u32 {
    0b01_00_10 >> (2 * corner) & 3
}

/// A half-edge of a traversal's boundary whose triangle may be uncovered.
#[derive(Clone, Copy)]
struct Gate {
    half_edge: HalfEdge,
    /// The codec's clock just after the edge entered its buffer.
    clock: u32,
}

/// Buffers of the traversal. They are reused, so that nothing is allocated once they have grown.
#[derive(Default)]
pub(super) struct Traversal {
    /// The twin (opposite half-edge) of each half-edge, by triangle and corner; the fourth entry is padding.
    twins: Vec<[HalfEdge; 4]>,
    /// Whether each triangle is still to be written.
    uncovered: Vec<bool>,
    edges: EdgeTable,
    /// Gates to enter later. The vector has the maximum length; only its first `stack_len` gates are in use.
    stack: Vec<Gate>,
    stack_len: usize,
}

impl Traversal {
    /// Writes all triangles, level after level. Every index is below `vertices`.
    pub fn write(&mut self, indices: &[u32], level_triangles: &[u32; 6], vertices: usize, writer: &mut IndexWriter) {
        let triangles = indices.as_chunks::<3>().0;
        self.connect(triangles, level_triangles, vertices);
        for (triangle, &corners) in (1..).zip(triangles) {
            if self.uncovered[triangle as usize] {
                self.start(triangle, corners, writer);
                self.cover(triangles, writer);
            }
        }
    }

    /// Returns the twin of each half-edge, even if the twin is of another level. The result is indexed by the number of the triangle,
    /// counted from 1, and the corner at which the half-edge starts. 0 means that there is no twin.
    pub fn twins(&mut self, indices: &[u32], vertices: usize) -> &[[HalfEdge; 4]] {
        let triangles = indices.as_chunks::<3>().0;
        self.connect(triangles, &[triangles.len() as u32, 0, 0, 0, 0, 0], vertices);
        &self.twins
    }

    /// Writes a triangle to which no gate leads, or whose gate has left the codec's buffer.
    fn start(&mut self, triangle: u32, corners: [u32; 3], writer: &mut IndexWriter) {
        if let Some((corner, age)) = writer.find(corners) {
            return self.push(4 * triangle + corner, writer.clock() - age);
        }
        self.uncovered[triangle as usize] = false;
        let first = writer.start(corners) as u32;
        let clock = writer.clock();
        let twins = self.twins[triangle as usize];
        for age in 0..3 {
            self.push(twins[(first + 2 - age) as usize % 3], clock - age);
        }
    }

    fn push(&mut self, half_edge: HalfEdge, clock: u32) {
        self.stack[self.stack_len] = Gate { half_edge, clock };
        self.stack_len += 1;
    }

    /// Writes triangles until the stack is empty.
    fn cover(&mut self, triangles: &[[u32; 3]], writer: &mut IndexWriter) {
        while self.stack_len > 0 {
            self.stack_len -= 1;
            let Gate { half_edge, clock } = self.stack[self.stack_len];
            if !self.is_uncovered(half_edge) {
                continue;
            }
            let age = writer.clock() - clock;
            if age >= REACH {
                let corners = triangles[half_edge as usize / 4 - 1];
                self.start(half_edge / 4, corners, writer);
                continue;
            }
            self.follow(half_edge, age, triangles, writer);
        }
    }

    /// Writes the triangle behind a gate whose edge entered the codec's buffer `age` edges ago. Continues while an exit is free.
    fn follow(&mut self, mut gate: HalfEdge, mut age: u32, triangles: &[[u32; 3]], writer: &mut IndexWriter) {
        let corners = triangles[gate as usize / 4 - 1];
        let [mut a, mut b] = [gate % 4, after(gate % 4)].map(|corner| corners[corner as usize]);
        while gate != NONE {
            let (triangle, corner) = (gate as usize / 4, gate % 4);
            let [second, third] = [after(corner), before(corner)].map(|corner| corner as usize % 4);
            let c = triangles[triangle - 1][third];
            self.uncovered[triangle] = false;
            writer.attach([a, b, c], age);
            let twins = &self.twins[triangle];
            let [right, left] = [twins[second], twins[third]];
            let [is_right_free, is_left_free] = [right, left].map(|half_edge| self.is_uncovered(half_edge));
            // The left edge, which entered the codec's buffer last, is always stored, but counted only if both exits are free.
            self.stack[self.stack_len] = Gate {
                half_edge: left,
                clock: writer.clock(),
            };
            self.stack_len += usize::from(is_right_free & is_left_free);
            gate = select_unpredictable(is_right_free, right, select_unpredictable(is_left_free, left, NONE));
            age = u32::from(is_right_free);
            (a, b) = (
                select_unpredictable(is_right_free, c, a),
                select_unpredictable(is_right_free, b, c),
            );
        }
    }

    fn is_uncovered(&self, half_edge: HalfEdge) -> bool {
        self.uncovered[half_edge as usize / 4]
    }

    /// Finds the twin of each half-edge among the half-edges of its level.
    fn connect(&mut self, triangles: &[[u32; 3]], level_triangles: &[u32; 6], vertices: usize) {
        let entries = triangles.len() + 1;
        // Twins of earlier regions need not be cleared, because all of them are overwritten.
        if self.twins.len() < entries {
            self.twins.resize(entries, [NONE; 4]);
            // A triangle pushes one gate if it is entered through a gate, and three otherwise.
            let unused = Gate {
                half_edge: NONE,
                clock: 0,
            };
            self.stack.resize(3 * entries, unused);
        }
        self.uncovered.clear();
        self.uncovered.resize(entries, true);
        self.uncovered[0] = false;
        self.edges.clear(vertices, 3 * triangles.len());
        let mut end = 0;
        for &level in level_triangles {
            let begin = end;
            end += level;
            self.connect_level(triangles, begin as usize..end as usize);
        }
    }

    /// Finds the twins of the half-edges of one level.
    fn connect_level(&mut self, triangles: &[[u32; 3]], level: Range<usize>) {
        let level_begin = 4 * (level.start as HalfEdge + 1);
        let mut triangle = level.start;
        while triangle < level.end {
            let half_edge = 4 * (triangle as HalfEdge + 1);
            let first = triangles[triangle];
            let second = triangles[triangle + 1..level.end].first();
            if let Some((is_swapped, [a, b, c, d])) = second.and_then(|&second| quad(first, second)) {
                let [one, other] = [0, 4].map(|half| half_edge + (half ^ select_unpredictable(is_swapped, 4, 0)));
                self.link(one + 2, other);
                self.match_twin(a, b, one, level_begin);
                self.match_twin(b, c, one + 1, level_begin);
                self.match_twin(c, d, other + 1, level_begin);
                self.match_twin(d, a, other + 2, level_begin);
                triangle += 2;
            } else {
                let [a, b, c] = first;
                self.match_twin(a, b, half_edge, level_begin);
                self.match_twin(b, c, half_edge + 1, level_begin);
                self.match_twin(c, a, half_edge + 2, level_begin);
                triangle += 1;
            }
        }
    }

    /// Links a half-edge with its twin, if the twin was seen before and is of the level whose half-edges begin at `level_begin`.
    #[inline(always)]
    fn match_twin(&mut self, from: u32, to: u32, half_edge: HalfEdge, level_begin: HalfEdge) {
        let twin = self.edges.replace(from, to, half_edge);
        self.link(half_edge, select_unpredictable(twin < level_begin, NONE, twin));
    }

    /// Makes two half-edges each other's twins.
    #[inline]
    fn link(&mut self, half_edge: HalfEdge, twin: HalfEdge) {
        self.twins[half_edge as usize / 4][half_edge as usize % 4] = twin;
        self.twins[twin as usize / 4][twin as usize % 4] = half_edge;
    }
}

/// Recognises two triangles that form a quad and start at the same end of its diagonal: `[a, b, c]` and `[a, c, d]`, in either order.
/// Returns the corners of the quad, and whether the triangles are swapped. The diagonal is the third edge of one triangle and the first
/// edge of the other.
#[inline]
fn quad(first: [u32; 3], second: [u32; 3]) -> Option<(bool, [u32; 4])> {
    let (is_in_order, is_swapped) = (first[2] == second[1], first[1] == second[2]);
    let pick =
        |i: usize, in_order: [u32; 3], swapped: [u32; 3]| select_unpredictable(is_in_order, in_order[i], swapped[i]);
    (first[0] == second[0] && (is_in_order | is_swapped)).then(|| {
        let corners = [
            first[0],
            pick(1, first, second),
            pick(2, first, second),
            pick(2, second, first),
        ];
        (!is_in_order, corners)
    })
}

/// The latest half-edge of each edge: a hash table with open addressing. Edges with the same lower vertex have neighbouring slots, and
/// neighbouring vertices have neighbouring indices, so that a traversal stays in the processor's cache.
#[derive(Default)]
struct EdgeTable {
    /// Entries, packed from the highest bit on: the lower and the higher vertex, [`VERTEX_BITS`] each; whether the half-edge leads from the
    /// lower to the higher one; and the half-edge, [`HALF_EDGE_BITS`]. 0: the slot is free.
    slots: Vec<u64>,
    /// Number of slots for the edges with the same lower vertex. Probing may continue in the slots of the next vertices.
    slots_per_vertex: u64,
}

const HALF_EDGE_BITS: u32 = 22;
const VERTEX_BITS: u32 = 20;
const _: () = assert!(MAX_INDICES < 1 << VERTEX_BITS && 4 * (MAX_INDICES / 3 + 1) < 1 << HALF_EDGE_BITS);

impl EdgeTable {
    /// Empties the table, and reserves space for `half_edges` half-edges, even if all belong to different edges.
    fn clear(&mut self, vertices: usize, half_edges: usize) {
        let slots_per_vertex = half_edges * 3 / 2 / vertices.max(1) + 2;
        self.slots_per_vertex = slots_per_vertex as u64;
        self.slots.clear();
        self.slots.resize(slots_per_vertex * (vertices + 1), 0);
    }

    /// Stores a half-edge as the latest of its edge. Returns the previous half-edge of the edge, if it has the opposite direction. On an
    /// edge with more than two half-edges, any two consecutive ones may be twins.
    #[inline]
    fn replace(&mut self, from: u32, to: u32, half_edge: HalfEdge) -> HalfEdge {
        let [low, high] = [u64::from(from.min(to)), u64::from(from.max(to))];
        let key = low << VERTEX_BITS | high;
        let entry = (key << 1 | u64::from(from < to)) << HALF_EDGE_BITS | u64::from(half_edge);
        // Multiplicative hash of the higher vertex, scaled to the slots of the lower one.
        let hash = high.wrapping_mul(0x9e37_79b9) & u64::from(u32::MAX);
        let mut slot = (low * self.slots_per_vertex + ((hash * self.slots_per_vertex) >> 32)) as usize;
        loop {
            let stored = &mut self.slots[slot];
            let previous = *stored;
            // The minimum is 0 if the slot is free or holds this edge. One branch for both cases is mostly taken; a branch that
            // distinguished them would be unpredictable.
            if previous.min(previous >> (HALF_EDGE_BITS + 1) ^ key) == 0 {
                *stored = entry;
                let is_opposite = (previous ^ entry) >> HALF_EDGE_BITS & 1 == 1;
                return select_unpredictable(is_opposite, previous as u32 & ((1 << HALF_EDGE_BITS) - 1), NONE);
            }
            slot = if slot + 1 < self.slots.len() { slot + 1 } else { 0 };
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Triangles of an n by n sheet of quads, row by row, two a quad.
    fn sheet(n: u32) -> Vec<u32> {
        let mut indices = Vec::new();
        for y in 0..n {
            for x in 0..n {
                let [a, b] = [y * (n + 1) + x, y * (n + 1) + x + 1];
                let [c, d] = [a + n + 1, b + n + 1];
                indices.extend([a, b, d, a, d, c]);
            }
        }
        indices
    }

    /// The payload, and the indices that a decoder makes of it, by the original vertices.
    fn written(
        traversal: &mut Traversal,
        indices: &[u32],
        level_triangles: [u32; 6],
        vertices: usize,
    ) -> (Vec<u8>, Vec<u32>) {
        let mut writer = IndexWriter::default();
        writer.begin(vertices, indices.len() / 3);
        traversal.write(indices, &level_triangles, vertices, &mut writer);
        let payload = writer.payload().concat();
        let decoded: Vec<u32> = meshopt::decode_index_buffer(&payload, indices.len()).expect("decodes");
        let old = decoded.iter().map(|&v| writer.order()[v as usize]).collect();
        (payload, old)
    }

    /// Triangles, each rotated to start at its minimum corner, sorted.
    fn triangles(of: &[u32]) -> Vec<[u32; 3]> {
        let rotated = |&[a, b, c]: &[u32; 3]| [[a, b, c], [b, c, a], [c, a, b]].into_iter().min();
        let mut all: Vec<_> = of.as_chunks::<3>().0.iter().filter_map(rotated).collect();
        all.sort_unstable();
        all
    }

    #[test]
    fn a_sheet_takes_little_more_than_a_byte_a_triangle() {
        let (indices, triangles) = (sheet(32), 2048);
        let (payload, _) = written(&mut Traversal::default(), &indices, [triangles, 0, 0, 0, 0, 0], 33 * 33);
        let bytes = payload.len() as f64;
        assert!(
            bytes / f64::from(triangles) < 1.1,
            "{bytes} bytes for {triangles} triangles"
        );
    }

    #[test]
    fn triangles_stay_in_their_level() {
        let indices = sheet(4);
        let (_, traversed) = written(&mut Traversal::default(), &indices, [10, 0, 22, 0, 0, 0], 25);
        assert_eq!(triangles(&traversed[..30]), triangles(&indices[..30]));
        assert_eq!(triangles(&traversed[30..]), triangles(&indices[30..]));
    }

    #[test]
    fn buffers_are_reused() {
        let mut traversal = Traversal::default();
        for n in [8, 3, 5] {
            let (indices, levels, vertices) = (sheet(n), [2 * n * n, 0, 0, 0, 0, 0], (n as usize + 1).pow(2));
            assert_eq!(
                written(&mut traversal, &indices, levels, vertices),
                written(&mut Traversal::default(), &indices, levels, vertices)
            );
        }
    }

    #[test]
    fn halves_of_a_quad_are_neighbours_however_they_are_written() {
        let [a, b, c, d, e] = [4, 7, 2, 9, 5];
        assert_eq!(quad([a, b, c], [a, c, d]), Some((false, [a, b, c, d])));
        assert_eq!(quad([a, c, b], [a, d, c]), Some((true, [a, d, c, b])));
        assert_eq!(quad([a, b, c], [a, d, e]), None);
        assert_eq!(quad([a, b, c], [b, a, d]), None);
        // Across the diagonal, and nowhere else, is the other half.
        let across = |triangles: [[u32; 3]; 2]| {
            let mut traversal = Traversal::default();
            traversal.connect(&triangles, &[2, 0, 0, 0, 0, 0], 10);
            [traversal.twins[1], traversal.twins[2]].map(|[a, b, c, _]| [a, b, c])
        };
        assert_eq!(across([[a, b, c], [a, c, d]]), [[0, 0, 8], [6, 0, 0]]);
        assert_eq!(across([[a, c, b], [a, d, c]]), [[10, 0, 0], [0, 0, 4]]);
        // As by the table of edges.
        assert_eq!(across([[b, c, a], [a, c, d]]), [[0, 8, 0], [5, 0, 0]]);
    }

    proptest! {
        /// Edges of any number of triangles, triangles twice, corners twice.
        #[test]
        fn any_triangles_come_back(
            corners in prop::collection::vec([0..12_u32, 0..12_u32, 0..12_u32], 1..60),
            split in 0.0..1.0,
        ) {
            let fine = (corners.len() as f64 * split) as u32;
            let indices = corners.concat();
            let levels = [fine, 0, 0, corners.len() as u32 - fine, 0, 0];
            let (_, traversed) = written(&mut Traversal::default(), &indices, levels, 12);
            let middle = 3 * fine as usize;
            prop_assert_eq!(triangles(&traversed[..middle]), triangles(&indices[..middle]));
            prop_assert_eq!(triangles(&traversed[middle..]), triangles(&indices[middle..]));
        }
    }
}
