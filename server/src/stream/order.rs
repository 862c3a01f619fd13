//! The order in which a region's triangles travel.
//!
//! The index codec writes one byte for a triangle that shares an edge with one of the last few and whose third vertex is
//! the next new one, a recent one, or a neighbour of the last it named in full; anything else costs more. Walking round
//! the part of the surface that is already covered keeps to that: the third vertex is new, or the next one on the rim,
//! which was numbered one turn earlier and therefore in a row (J. Rossignac, "Edgebreaker", 1999, walks so too). It also
//! keeps vertices that follow one another close. The walk is linear in the number of triangles; meshoptimizer's strips,
//! which are as small, look for the best next triangle among several.

const NONE: u32 = u32::MAX;

/// Buffers of the walk, kept so that nothing is allocated once they have grown.
#[derive(Default)]
pub(super) struct Walk {
    /// Where each vertex's half-edges begin in `half_edges`, one more than there are vertices.
    first: Vec<u32>,
    /// Half-edges by the vertex they leave: where they lead, and whose they are (3 triangle + corner).
    half_edges: Vec<[u32; 2]>,
    visited: Vec<bool>,
    /// Half-edges whose triangle is still to be visited.
    pending: Vec<u32>,
}

impl Walk {
    /// Appends `indices` to `ordered`, triangles of each level among themselves. Every index is below `vertices`.
    pub fn order(&mut self, indices: &[u32], level_triangles: &[u32; 6], vertices: usize, ordered: &mut Vec<u32>) {
        self.connect(indices, vertices);
        self.visited.clear();
        self.visited.resize(indices.len() / 3, false);
        let mut begin = 0;
        for &triangles in level_triangles {
            let end = begin + triangles;
            for seed in begin..end {
                self.pending.push(3 * seed);
                while let Some(gate) = self.pending.pop() {
                    self.cover(gate, begin..end, indices, ordered);
                }
            }
            begin = end;
        }
    }

    /// Walks from the triangle of half-edge `gate` on until there is no way.
    fn cover(&mut self, mut gate: u32, level: std::ops::Range<u32>, indices: &[u32], ordered: &mut Vec<u32>) {
        while !std::mem::replace(&mut self.visited[gate as usize / 3], true) {
            let base = gate / 3 * 3;
            let [second, third] = [base + (gate + 1 - base) % 3, base + (gate + 2 - base) % 3];
            let [a, b, c] = [gate, second, third].map(|h| indices[h as usize]);
            ordered.extend([a, b, c]);
            let right = self.across(b, c, &level);
            let left = self.across(c, a, &level);
            gate = match (right, left) {
                (NONE, NONE) => return,
                (NONE, only) | (only, NONE) => only,
                (right, left) => {
                    self.pending.push(left);
                    right
                }
            };
        }
    }

    /// The half-edge from `b` to `a` of a triangle of this level that was not visited yet.
    fn across(&self, a: u32, b: u32, level: &std::ops::Range<u32>) -> u32 {
        let bucket = self.first[b as usize] as usize..self.first[b as usize + 1] as usize;
        for &[to, half_edge] in &self.half_edges[bucket] {
            if to == a && level.contains(&(half_edge / 3)) && !self.visited[half_edge as usize / 3] {
                return half_edge;
            }
        }
        NONE
    }

    /// Sorts half-edges by the vertex they leave.
    fn connect(&mut self, indices: &[u32], vertices: usize) {
        self.first.clear();
        self.first.resize(vertices + 2, 0);
        for &index in indices {
            self.first[index as usize + 2] += 1;
        }
        for i in 2..self.first.len() {
            self.first[i] += self.first[i - 1];
        }
        self.half_edges.resize(indices.len(), [0; 2]);
        for (triangle, corners) in indices.as_chunks::<3>().0.iter().enumerate() {
            for corner in 0..3 {
                // While buckets fill, `first` of the next vertex is the end of this one's.
                let place = &mut self.first[corners[corner] as usize + 1];
                self.half_edges[*place as usize] = [corners[(corner + 1) % 3], (3 * triangle + corner) as u32];
                *place += 1;
            }
        }
        self.first.pop();
    }
}

#[cfg(test)]
mod tests {
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

    fn ordered(indices: &[u32], level_triangles: [u32; 6], vertices: usize) -> Vec<u32> {
        let mut out = Vec::new();
        Walk::default().order(indices, &level_triangles, vertices, &mut out);
        out
    }

    #[test]
    fn a_sheet_takes_little_more_than_a_byte_a_triangle() {
        let (indices, triangles) = (sheet(32), 2048);
        let mut walked = ordered(&indices, [triangles, 0, 0, 0, 0, 0], 33 * 33);
        let _: Vec<u32> = meshopt::optimize_vertex_fetch(&mut walked, &(0..33 * 33).collect::<Vec<u32>>());
        let bytes = meshopt::encode_index_buffer(&walked, 33 * 33).expect("encodes").len() as f64;
        assert!(
            bytes / f64::from(triangles) < 1.1,
            "{bytes} bytes for {triangles} triangles"
        );
    }

    #[test]
    fn triangles_stay_in_their_level() {
        let indices = sheet(4);
        let walked = ordered(&indices, [10, 0, 22, 0, 0, 0], 25);
        let triangles = |of: &[u32]| {
            let least_turn = |t: &[u32]| {
                [[t[0], t[1], t[2]], [t[1], t[2], t[0]], [t[2], t[0], t[1]]]
                    .into_iter()
                    .min()
            };
            let mut all: Vec<_> = of.chunks_exact(3).map(least_turn).collect();
            all.sort_unstable();
            all
        };
        assert_eq!(triangles(&walked[..30]), triangles(&indices[..30]));
        assert_eq!(triangles(&walked[30..]), triangles(&indices[30..]));
    }

    #[test]
    fn buffers_are_used_again() {
        let mut walk = Walk::default();
        for n in [8, 3, 5] {
            let (indices, mut out) = (sheet(n), Vec::new());
            walk.order(&indices, &[2 * n * n, 0, 0, 0, 0, 0], (n as usize + 1).pow(2), &mut out);
            assert_eq!(
                out,
                ordered(&indices, [2 * n * n, 0, 0, 0, 0, 0], (n as usize + 1).pow(2))
            );
        }
    }
}
