//! The order in which a region's triangles travel.
//!
//! The index codec writes one byte for a triangle that shares an edge with one of the last few and whose third vertex is
//! the next new one, a recent one, or a neighbour of the last it named in full; anything else costs more. Walking round
//! the part of the surface that is already covered keeps to that: the third vertex is new, or the next one on the rim,
//! which was numbered one turn earlier and therefore in a row (J. Rossignac, "Edgebreaker", 1999, walks so too). It also
//! keeps vertices that follow one another close. The walk is linear in the number of triangles; meshoptimizer's strips,
//! which are as small, look for the best next triangle among several.

use std::hint::select_unpredictable;

use super::chunk::MAX_INDICES;
use super::index_codec::{IndexWriter, REACH};

/// Side of a triangle: four times its place in its level, counted from 1, plus the corner that the side leaves.
type Side = u32;
/// Where there is no triangle. Its place is there, is covered, and swallows what is written to it.
const NOWHERE: Side = 0;
/// The corner after each.
const NEXT: [u32; 4] = [1, 2, 0, 0];

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
    /// Writes all triangles, those of each level among themselves.
    pub fn write(&mut self, indices: &[u32], level_triangles: &[u32; 6], writer: &mut IndexWriter) {
        let mut rest = indices.as_chunks::<3>().0;
        for &triangles in level_triangles {
            let (level, after) = rest.split_at(triangles as usize);
            self.connect(level);
            for (triangle, &corners) in (1..).zip(level) {
                if self.open[triangle as usize] {
                    self.begin(triangle, corners, writer);
                    self.cover(level, writer);
                }
            }
            rest = after;
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
    fn cover(&mut self, level: &[[u32; 3]], writer: &mut IndexWriter) {
        while self.waiting > 0 {
            self.waiting -= 1;
            let (mut gate, taken) = self.pending[self.waiting];
            if !self.is_open(gate) {
                continue;
            }
            let corners = level[gate as usize / 4 - 1];
            let mut behind = writer.clock() - taken;
            if behind >= REACH {
                self.begin(gate / 4, corners, writer);
                continue;
            }
            let side = gate % 4;
            let [mut a, mut b] = [side, NEXT[side as usize]].map(|corner| corners[corner as usize]);
            while gate != NOWHERE {
                let triangle = gate as usize / 4;
                let second = NEXT[gate as usize % 4];
                let third = NEXT[second as usize % 4] as usize;
                let c = level[triangle - 1][third];
                self.open[triangle] = false;
                writer.attach([a, b, c], behind);
                let across = &self.across[triangle];
                let [right, left] = [across[second as usize % 4], across[third % 4]];
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
    fn connect(&mut self, level: &[[u32; 3]]) {
        self.across.clear();
        self.across.resize(level.len() + 1, [NOWHERE; 4]);
        self.open.clear();
        self.open.resize(level.len() + 1, true);
        self.open[0] = false;
        self.edges.begin(level.len() * 5 / 4);
        let mut place = 0;
        while let Some(&first) = level.get(place) {
            let side = 4 * (place as Side + 1);
            match level.get(place + 1).and_then(|&second| diagonal(first, second)) {
                Some(diagonal) => {
                    let second = level[place + 1];
                    let other = 2 - diagonal;
                    self.link(side + diagonal, side + 4 + other);
                    self.meet(first, side, NEXT[diagonal as usize]);
                    self.meet(first, side, NEXT[NEXT[diagonal as usize] as usize]);
                    self.meet(second, side + 4, NEXT[other as usize]);
                    self.meet(second, side + 4, NEXT[NEXT[other as usize] as usize]);
                    place += 2;
                }
                None => {
                    (0..3).for_each(|corner| self.meet(first, side, corner));
                    place += 1;
                }
            }
        }
        // Each triangle leaves one side for later when it is covered, or all three.
        self.waiting = 0;
        self.pending.clear();
        self.pending.resize(3 * level.len() + 1, (NOWHERE, 0));
    }

    #[inline(always)]
    fn meet(&mut self, corners: [u32; 3], triangle: Side, corner: u32) {
        let [from, to] = [corner, NEXT[corner as usize]].map(|corner| corners[corner as usize]);
        let other = self.edges.other(from, to, triangle + corner);
        self.link(triangle + corner, other);
    }

    #[inline]
    fn link(&mut self, side: Side, other: Side) {
        self.across[side as usize / 4][side as usize % 4] = other;
        self.across[other as usize / 4][other as usize % 4] = side;
    }
}

/// The first triangle's side along which the second one follows as the other half of a quad: both begin at the same end of
/// the diagonal, so that it is one's first side and the other's last.
#[inline]
fn diagonal(first: [u32; 3], second: [u32; 3]) -> Option<u32> {
    let (last, start) = (first[2] == second[1], first[1] == second[2]);
    (first[0] == second[0] && (last | start)).then_some(select_unpredictable(last, 2, 0))
}

/// The last half-edge of each edge: a hash table with open addressing.
#[derive(Default)]
struct Edges {
    /// Lower and higher vertex, 20 bits each, whether the side leads up, and the side; 0 where there is none.
    slots: Vec<u64>,
    /// By which a product is shifted so that what remains is a slot.
    shift: u32,
}

const SIDE_BITS: u32 = 22;
const VERTEX_BITS: u32 = 20;
const _: () = assert!(MAX_INDICES < 1 << VERTEX_BITS && 4 * (MAX_INDICES / 3 + 1) < 1 << SIDE_BITS);

impl Edges {
    /// Empties the table and makes room.
    fn begin(&mut self, edges: usize) {
        let slots = (4 * edges + 2).next_power_of_two();
        self.slots.clear();
        self.slots.resize(slots, 0);
        self.shift = 64 - slots.trailing_zeros();
    }

    /// The side that was there before on this edge, if it leads the other way. Two sides on each edge are what most surfaces
    /// have; of more, any two are neighbours.
    #[inline]
    fn other(&mut self, from: u32, to: u32, side: Side) -> Side {
        let key = u64::from(from.min(to)) << VERTEX_BITS | u64::from(from.max(to));
        let entry = (key << 1 | u64::from(from < to)) << SIDE_BITS | u64::from(side);
        let mut slot = key.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> self.shift;
        let mask = self.slots.len() as u64 - 1;
        loop {
            let place = &mut self.slots[(slot & mask) as usize];
            let here = *place;
            // One branch for both: whether an edge was met before is a coin's throw, that its place is taken is rare.
            // Free, or this edge's. The least of both is 0 in either case, which takes one branch that is mostly the same;
            // whether an edge was here before is a coin's throw.
            if here.min(here >> (SIDE_BITS + 1) ^ key) == 0 {
                *place = entry;
                let turned = (here ^ entry) >> SIDE_BITS & 1 == 1;
                return select_unpredictable(turned, here as u32 & ((1 << SIDE_BITS) - 1), NOWHERE);
            }
            slot += 1;
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
        walk.write(indices, &level_triangles, &mut writer);
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
        assert_eq!(diagonal([a, b, c], [a, c, d]), Some(2));
        assert_eq!(diagonal([a, c, b], [a, d, c]), Some(0));
        assert_eq!(diagonal([a, b, c], [a, d, e]), None);
        assert_eq!(diagonal([a, b, c], [b, a, d]), None);
        // Along the diagonal the second half is the first one's neighbour, and found.
        for quad in [[a, b, c, a, c, d], [a, c, b, a, d, c]] {
            let mut walk = Walk::default();
            walk.connect(quad.as_chunks().0);
            let [first, second] = [4, 8].map(|side| side + diagonal_of(&quad, side));
            assert_eq!(walk.across[1][first as usize % 4], second);
            assert_eq!(walk.across[2][second as usize % 4], first);
            assert_eq!(
                walk.across[1..]
                    .iter()
                    .flatten()
                    .filter(|&&side| side != NOWHERE)
                    .count(),
                2
            );
        }
    }

    /// The side of a triangle between corners 4 and 2.
    fn diagonal_of(quad: &[u32; 6], triangle: Side) -> u32 {
        let corners = quad.as_chunks::<3>().0[triangle as usize / 4 - 1];
        (0..3)
            .find(|&k| {
                let ends = [corners[k as usize], corners[NEXT[k as usize] as usize]];
                ends == [4, 2] || ends == [2, 4]
            })
            .expect("one of three")
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
