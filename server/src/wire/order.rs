//! The order in which a region's triangles travel.
//!
//! The index codec writes one byte for a triangle that shares an edge with one of the last few and whose third vertex is
//! the next new one, a recent one, or a neighbour of the last it named in full; anything else costs more. Walking round
//! the part of the surface that is already covered keeps to that: the third vertex is new, or the next one on the rim,
//! which was numbered one turn earlier and therefore in a row (J. Rossignac, "Edgebreaker", 1999, walks so too). It also
//! keeps vertices that follow one another close. The walk is linear in the number of triangles; meshoptimizer's strips,
//! which are as small, look for the best next triangle among several.
//!
//! Neighbours are found by a table of edges, but for the halves of a quad, which follow one another. What comes next cannot
//! be foreseen, so the inner loops choose by arithmetic: a branch that is guessed wrong costs as much as the rest of a step.

use std::hint::select_unpredictable;

use super::chunk::MAX_INDICES;
use super::index_codec::{IndexWriter, REACH};

/// Side of a triangle: four times its place, counted from 1, plus the corner that the side leaves.
type Side = u32;
/// Where there is no triangle. Its place is there, is covered, and swallows what is written to it.
const NOWHERE: Side = 0;

/// The corner after one. Two bits for each are there sooner than an array's element.
fn after(corner: u32) -> u32 {
    0b00_10_01 >> (2 * corner) & 3
}

/// The corner before one.
fn before(corner: u32) -> u32 {
    0b01_00_10 >> (2 * corner) & 3
}

/// Buffers of the walk, kept so that nothing is allocated once they have grown.
#[derive(Default)]
pub(super) struct Walk {
    /// The other side of each side of a triangle.
    across: Vec<[Side; 4]>,
    /// Which triangles are still to be covered.
    open: Vec<bool>,
    edges: Edges,
    /// Sides whose triangle is perhaps still to be covered, and when the codec took them.
    pending: Vec<(Side, u32)>,
    /// Entries of `pending`, which is as long as it can become.
    waiting: usize,
}

impl Walk {
    /// Writes all triangles, those of each level among themselves. Every index is below `vertices`.
    pub fn write(&mut self, indices: &[u32], level_triangles: &[u32; 6], vertices: usize, writer: &mut IndexWriter) {
        let triangles = indices.as_chunks::<3>().0;
        self.connect(triangles, level_triangles, vertices);
        for (triangle, &corners) in (1..).zip(triangles) {
            if self.open[triangle as usize] {
                self.begin(triangle, corners, writer);
                self.cover(triangles, writer);
            }
        }
    }

    /// Covers a triangle that the walk does not come to along an edge.
    fn begin(&mut self, triangle: u32, corners: [u32; 3], writer: &mut IndexWriter) {
        if let Some((side, behind)) = writer.find(corners) {
            return self.wait(4 * triangle + side, writer.clock() - behind);
        }
        self.open[triangle as usize] = false;
        let first = writer.start(corners) as u32;
        let clock = writer.clock();
        let across = self.across[triangle as usize];
        for behind in 0..3 {
            self.wait(across[(first + 2 - behind) as usize % 3], clock - behind);
        }
    }

    fn wait(&mut self, side: Side, taken: u32) {
        self.pending[self.waiting] = (side, taken);
        self.waiting += 1;
    }

    /// Walks on from what is pending until there is no way.
    fn cover(&mut self, triangles: &[[u32; 3]], writer: &mut IndexWriter) {
        while self.waiting > 0 {
            self.waiting -= 1;
            let (mut gate, taken) = self.pending[self.waiting];
            if !self.is_open(gate) {
                continue;
            }
            let corners = triangles[gate as usize / 4 - 1];
            let mut behind = writer.clock() - taken;
            if behind >= REACH {
                self.begin(gate / 4, corners, writer);
                continue;
            }
            let side = gate % 4;
            let [mut a, mut b] = [side, after(side)].map(|corner| corners[corner as usize]);
            while gate != NOWHERE {
                let (triangle, side) = (gate as usize / 4, gate % 4);
                let [second, third] = [after(side), before(side)].map(|corner| corner as usize % 4);
                let c = triangles[triangle - 1][third];
                self.open[triangle] = false;
                writer.attach([a, b, c], behind);
                let across = &self.across[triangle];
                let [right, left] = [across[second], across[third]];
                let [to_right, to_left] = [right, left].map(|side| self.is_open(side));
                self.pending[self.waiting] = (left, writer.clock());
                self.waiting += usize::from(to_right & to_left);
                gate = select_unpredictable(to_right, right, select_unpredictable(to_left, left, NOWHERE));
                behind = u32::from(to_right);
                (a, b) = (
                    select_unpredictable(to_right, c, a),
                    select_unpredictable(to_right, b, c),
                );
            }
        }
    }

    fn is_open(&self, side: Side) -> bool {
        self.open[side as usize / 4]
    }

    /// Finds each triangle's neighbours in its level.
    fn connect(&mut self, triangles: &[[u32; 3]], level_triangles: &[u32; 6], vertices: usize) {
        let places = triangles.len() + 1;
        // What is left of other regions is overwritten, side by side.
        if self.across.len() < places {
            self.across.resize(places, [NOWHERE; 4]);
            // Each triangle leaves one side for later when it is covered, or all three.
            self.pending.resize(3 * places, (NOWHERE, 0));
        }
        self.open.clear();
        self.open.resize(places, true);
        self.open[0] = false;
        self.edges.begin(vertices, 3 * triangles.len());
        let mut place = 0;
        let mut end = 0;
        for &level in level_triangles {
            let begin = 4 * (end + 1);
            end += level;
            while place < end as usize {
                let side = 4 * (place as Side + 1);
                let first = triangles[place];
                let second = triangles[place + 1..end as usize].first();
                if let Some((swapped, [a, b, c, d])) = second.and_then(|&second| quad(first, second)) {
                    let [one, other] = [0, 4].map(|half| side + (half ^ select_unpredictable(swapped, 4, 0)));
                    self.link(one + 2, other);
                    self.meet(a, b, one, begin);
                    self.meet(b, c, one + 1, begin);
                    self.meet(c, d, other + 1, begin);
                    self.meet(d, a, other + 2, begin);
                    place += 2;
                } else {
                    let [a, b, c] = first;
                    self.meet(a, b, side, begin);
                    self.meet(b, c, side + 1, begin);
                    self.meet(c, a, side + 2, begin);
                    place += 1;
                }
            }
        }
    }

    /// Whatever is across a side, in the level whose sides begin at `begin`.
    #[inline(always)]
    fn meet(&mut self, from: u32, to: u32, side: Side, begin: Side) {
        let other = self.edges.other(from, to, side);
        self.link(side, select_unpredictable(other < begin, NOWHERE, other));
    }

    #[inline]
    fn link(&mut self, side: Side, other: Side) {
        self.across[side as usize / 4][side as usize % 4] = other;
        self.across[other as usize / 4][other as usize % 4] = side;
    }
}

/// The quad that two triangles are halves of, if both begin at the same end of its diagonal, which is then one's third side
/// and the other's first: corners of the one and what the other adds. True if the one comes second.
#[inline]
fn quad(first: [u32; 3], second: [u32; 3]) -> Option<(bool, [u32; 4])> {
    let (ahead, swapped) = (first[2] == second[1], first[1] == second[2]);
    let pick = |i: usize, of: [u32; 3], or: [u32; 3]| select_unpredictable(ahead, of[i], or[i]);
    (first[0] == second[0] && (ahead | swapped)).then(|| {
        let corners = [
            first[0],
            pick(1, first, second),
            pick(2, first, second),
            pick(2, second, first),
        ];
        (!ahead, corners)
    })
}

/// The last side at each edge: a hash table with open addressing. Vertices that are close have numbers that are close, and
/// so have the places of their edges.
#[derive(Default)]
struct Edges {
    /// Lower and higher vertex, 20 bits each, whether the side leads up, and the side; 0 where there is none.
    slots: Vec<u64>,
    /// Slots for the edges of a lower vertex; they may take those behind.
    spread: u64,
}

const SIDE_BITS: u32 = 22;
const VERTEX_BITS: u32 = 20;
const _: () = assert!(MAX_INDICES < 1 << VERTEX_BITS && 4 * (MAX_INDICES / 3 + 1) < 1 << SIDE_BITS);

impl Edges {
    /// Empties the table and makes room for the edges of as many sides, even if no two were at one edge.
    fn begin(&mut self, vertices: usize, sides: usize) {
        let spread = sides * 3 / 2 / vertices.max(1) + 2;
        self.spread = spread as u64;
        self.slots.clear();
        self.slots.resize(spread * (vertices + 1), 0);
    }

    /// The side that was there before on this edge, if it leads the other way. Two sides on each edge are what most surfaces
    /// have; of more, any two are neighbours.
    #[inline]
    fn other(&mut self, from: u32, to: u32, side: Side) -> Side {
        let [low, high] = [u64::from(from.min(to)), u64::from(from.max(to))];
        let key = low << VERTEX_BITS | high;
        let entry = (key << 1 | u64::from(from < to)) << SIDE_BITS | u64::from(side);
        let spot = high.wrapping_mul(0x9e37_79b9) & u64::from(u32::MAX);
        let mut slot = (low * self.spread + ((spot * self.spread) >> 32)) as usize;
        loop {
            let place = &mut self.slots[slot];
            let here = *place;
            // Free or this edge's: the least of both is 0. One branch, which is mostly taken the same way; which of the two
            // it is, is a coin's throw.
            if here.min(here >> (SIDE_BITS + 1) ^ key) == 0 {
                *place = entry;
                let turned = (here ^ entry) >> SIDE_BITS & 1 == 1;
                return select_unpredictable(turned, here as u32 & ((1 << SIDE_BITS) - 1), NOWHERE);
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

    /// The payload, and the triangles that a decoder makes of it, by the numbers they had.
    fn written(walk: &mut Walk, indices: &[u32], level_triangles: [u32; 6], vertices: usize) -> (Vec<u8>, Vec<u32>) {
        let mut writer = IndexWriter::default();
        writer.begin(vertices, indices.len() / 3);
        walk.write(indices, &level_triangles, vertices, &mut writer);
        let payload = writer.payload().concat();
        let decoded: Vec<u32> = meshopt::decode_index_buffer(&payload, indices.len()).expect("decodes");
        let old = decoded.iter().map(|&v| writer.order()[v as usize]).collect();
        (payload, old)
    }

    /// Triangles, each turned to its least corner, sorted.
    fn triangles(of: &[u32]) -> Vec<[u32; 3]> {
        let least_turn = |&[a, b, c]: &[u32; 3]| [[a, b, c], [b, c, a], [c, a, b]].into_iter().min();
        let mut all: Vec<_> = of.as_chunks::<3>().0.iter().filter_map(least_turn).collect();
        all.sort_unstable();
        all
    }

    #[test]
    fn a_sheet_takes_little_more_than_a_byte_a_triangle() {
        let (indices, triangles) = (sheet(32), 2048);
        let (payload, _) = written(&mut Walk::default(), &indices, [triangles, 0, 0, 0, 0, 0], 33 * 33);
        let bytes = payload.len() as f64;
        assert!(
            bytes / f64::from(triangles) < 1.1,
            "{bytes} bytes for {triangles} triangles"
        );
    }

    #[test]
    fn triangles_stay_in_their_level() {
        let indices = sheet(4);
        let (_, walked) = written(&mut Walk::default(), &indices, [10, 0, 22, 0, 0, 0], 25);
        assert_eq!(triangles(&walked[..30]), triangles(&indices[..30]));
        assert_eq!(triangles(&walked[30..]), triangles(&indices[30..]));
    }

    #[test]
    fn buffers_are_used_again() {
        let mut walk = Walk::default();
        for n in [8, 3, 5] {
            let (indices, levels, vertices) = (sheet(n), [2 * n * n, 0, 0, 0, 0, 0], (n as usize + 1).pow(2));
            assert_eq!(
                written(&mut walk, &indices, levels, vertices),
                written(&mut Walk::default(), &indices, levels, vertices)
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
            let mut walk = Walk::default();
            walk.connect(&triangles, &[2, 0, 0, 0, 0, 0], 10);
            [walk.across[1], walk.across[2]].map(|[a, b, c, _]| [a, b, c])
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
            let (_, walked) = written(&mut Walk::default(), &indices, levels, 12);
            let middle = 3 * fine as usize;
            prop_assert_eq!(triangles(&walked[..middle]), triangles(&indices[..middle]));
            prop_assert_eq!(triangles(&walked[middle..]), triangles(&indices[middle..]));
        }
    }
}
