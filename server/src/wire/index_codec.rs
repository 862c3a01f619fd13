//! Writer of meshoptimizer's index codec, version 1, for triangles that come along their edges.
//!
//! The format (`EXT_meshopt_compression`, mode TRIANGLES) names a triangle by one of the last edges and what its third
//! vertex is. meshoptimizer's encoder gets a list of indices and searches both anew for each triangle; a walk over the
//! surface knows the edge it comes across, and for a vertex it is enough to note when the codec last took it in.

use std::hint::select_unpredictable;

/// First byte of a payload: the codec and its version.
const HEADER: u8 = 0xe1;
/// Edges behind which the codec forgets one.
pub(super) const REACH: u32 = 15;
/// Ages of a vertex that have a code, but for 0: that code means a new vertex.
const RECENT: u32 = 12;
/// Codes of a third vertex: one before the vertex named last, one after it, a number by itself.
const BEFORE: u32 = 13;
const AFTER: u32 = 14;
const NAMED: u32 = 15;
/// A triangle without an edge whose vertices are all new, and one with a byte for its second and third vertex. There, a
/// vertex is new (0), recent (its age plus 1) or named.
const ALL_NEW: u8 = 0xf0;
const SECOND_THIRD: u8 = 0xfe;
/// Bytes for second and third vertices that can have a code of their own; all but the first are too rare to matter.
const TABLE: [u8; 16] = [0; 16];

/// What the decoder knows of a vertex.
#[derive(Clone, Copy)]
struct Known {
    /// Its new number, or [`NEW`].
    number: u32,
    /// When it last became the latest vertex.
    taken: u32,
}

const NEW: u32 = u32::MAX;

/// The codec's state and what it has written.
#[derive(Default)]
pub(super) struct IndexWriter {
    /// One for each triangle.
    codes: Vec<u8>,
    /// What the codes do not hold.
    data: Vec<u8>,
    known: Vec<Known>,
    /// Old number of each new vertex, and room for one more, so that it can be written before it is known to be new.
    order: Vec<u32>,
    /// New vertices.
    next: u32,
    /// The last vertex that was named.
    last: u32,
    /// Vertices taken, so to speak the time.
    vertices: u32,
    /// The latest edges, by old numbers.
    edges: [[u32; 2]; 16],
    /// Edges taken.
    clock: u32,
}

impl IndexWriter {
    /// Begins a payload; every vertex that follows is below `vertices`.
    pub fn begin(&mut self, vertices: usize, triangles: usize) {
        self.codes.clear();
        self.codes.reserve(triangles);
        self.data.clear();
        self.known.clear();
        self.known.resize(vertices, Known { number: NEW, taken: 0 });
        self.order.clear();
        self.order.resize(vertices + 1, 0);
        (self.next, self.last) = (0, 0);
        // No vertex was taken so lately that it has a code.
        self.vertices = 16;
        self.edges = [[NEW; 2]; 16];
        self.clock = 0;
    }

    /// Old numbers of the vertices, in the order of their first use.
    pub fn order(&self) -> &[u32] {
        &self.order[..self.next as usize]
    }

    /// Edges taken so far.
    pub fn clock(&self) -> u32 {
        self.clock
    }

    /// The payload, in parts that follow one another; nothing where there is no triangle.
    pub fn payload(&self) -> [&[u8]; 4] {
        if self.codes.is_empty() {
            return [&[]; 4];
        }
        [&[HEADER], &self.codes, &self.data, &TABLE]
    }

    /// A triangle along an edge that was taken `behind` edges before the latest one, there from `b` to `a`. Its own edges
    /// are taken: from `b` to `c`, then from `c` to `a`.
    #[inline]
    pub fn attach(&mut self, [a, b, c]: [u32; 3], behind: u32) {
        debug_assert!(behind < REACH);
        let known = &mut self.known[c as usize];
        let Known { number, taken } = *known;
        let age = self.vertices - 1 - taken;
        let (new, recent) = (number == NEW, age.wrapping_sub(1) < RECENT);
        // No branches: which of these it is, is what the codec would not need to say if it could be foreseen.
        let step = number.wrapping_sub(self.last);
        let named = select_unpredictable(step == 1, AFTER, select_unpredictable(step == NEW, BEFORE, NAMED));
        let code = select_unpredictable(new, 0, select_unpredictable(recent, age, named));
        let number = select_unpredictable(new, self.next, number);
        *known = Known {
            number,
            taken: select_unpredictable(recent, taken, self.vertices),
        };
        self.order[self.next as usize] = c;
        self.next += u32::from(new);
        self.vertices += u32::from(!recent);
        self.codes.push((behind << 4 | code) as u8);
        if code == NAMED {
            self.name(number);
        }
        self.last = select_unpredictable(new | recent, self.last, number);
        self.take([c, b]);
        self.take([a, c]);
    }

    /// A triangle without an edge that the codec remembers. All three are taken, first the one that leaves the corner
    /// returned.
    pub fn start(&mut self, mut corners: [u32; 3]) -> usize {
        // The format has no code for a second and third vertex that are new behind a first one that is not.
        let new = |corner: &u32| self.known[*corner as usize].number == NEW;
        let first = corners.iter().position(new).unwrap_or(0);
        corners.rotate_left(first);
        let ages = corners.map(|corner| self.vertices - 1 - self.known[corner as usize].taken);
        let [mut codes, mut numbers] = [[0; 3]; 2];
        for (place, &corner) in corners.iter().enumerate() {
            let known = &mut self.known[corner as usize];
            if known.number == NEW {
                known.number = self.next;
                self.order[self.next as usize] = corner;
                self.next += 1;
            } else if place > 0 && ages[place] < NAMED - 1 {
                codes[place] = ages[place] + 1;
                continue;
            } else {
                codes[place] = NAMED;
                numbers[place] = known.number;
            }
            known.taken = self.vertices;
            self.vertices += 1;
        }
        if codes == [0; 3] {
            self.codes.push(ALL_NEW);
        } else {
            self.codes.push(SECOND_THIRD | codes[0] as u8);
            self.data.push((codes[1] << 4 | codes[2]) as u8);
        }
        for (code, number) in codes.into_iter().zip(numbers) {
            if code == NAMED {
                self.name(number);
            }
        }
        let [a, b, c] = corners;
        self.take([b, a]);
        self.take([c, b]);
        self.take([a, c]);
        first
    }

    /// A triangle's side whose edge the codec remembers, and how many edges behind the latest one that is.
    pub fn find(&self, [a, b, c]: [u32; 3]) -> Option<(u32, u32)> {
        (0..REACH).find_map(|behind| {
            let edge = self.edges[self.clock.wrapping_sub(1 + behind) as usize % 16];
            let side = [[a, b], [b, c], [c, a]].iter().position(|&side| side == edge)?;
            Some((side as u32, behind))
        })
    }

    #[inline]
    fn take(&mut self, edge: [u32; 2]) {
        self.edges[self.clock as usize % 16] = edge;
        self.clock += 1;
    }

    /// A vertex by its distance from the last one named, seven bits a byte, sign in the lowest bit.
    fn name(&mut self, number: u32) {
        let step = number.wrapping_sub(self.last) as i32;
        let mut rest = (step << 1 ^ step >> 31) as u32;
        while rest > 127 {
            self.data.push(rest as u8 | 128);
            rest >>= 7;
        }
        self.data.push(rest as u8);
        self.last = number;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decoded(writer: &IndexWriter) -> Vec<[u32; 3]> {
        let payload = writer.payload().concat();
        let indices: Vec<u32> =
            meshopt::decode_index_buffer(&payload, 3 * writer.codes.len()).expect("what the codec wrote");
        // By old numbers.
        let triangles = indices.as_chunks::<3>().0.iter();
        triangles.map(|t| t.map(|v| writer.order()[v as usize])).collect()
    }

    #[test]
    fn each_way_to_name_a_vertex_comes_back() {
        let mut writer = IndexWriter::default();
        writer.begin(100, 40);
        let mut written = Vec::new();
        let mut start = |writer: &mut IndexWriter, mut corners: [u32; 3]| {
            let first = writer.start(corners);
            corners.rotate_left(first);
            written.push(corners);
        };
        // All new; two new behind an old one; far ones, which are named; recent ones.
        for first in (0..90).step_by(3) {
            start(&mut writer, [first, first + 1, first + 2]);
        }
        start(&mut writer, [3, 90, 91]);
        start(&mut writer, [0, 50, 7]);
        start(&mut writer, [0, 50, 7]);
        start(&mut writer, [92, 92, 92]);
        // A strip: new, recent, just before and just after the one named last, far away.
        let mut edge = [92, 92];
        for third in [93, 91, 49, 51, 52, 51, 1] {
            let triangle = [edge[0], edge[1], third];
            writer.attach(triangle, 0);
            written.push(triangle);
            edge = [edge[0], third];
        }
        assert_eq!(decoded(&writer), written);
    }

    #[test]
    fn an_edge_is_found_as_long_as_it_can_be_named() {
        let mut writer = IndexWriter::default();
        writer.begin(20, 10);
        assert_eq!(writer.find([0, 1, 2]), None);
        writer.start([0, 1, 2]);
        assert_eq!(writer.find([19, 2, 1]), Some((1, 1)), "from the other side");
        assert_eq!(writer.find([0, 1, 2]), None, "from the same side");
        for new in 3..9 {
            writer.attach([new - 1, new - 3, new], 0);
        }
        assert_eq!(writer.find([19, 2, 1]), Some((1, 13)));
        writer.attach([8, 6, 9], 0);
        assert_eq!(writer.find([19, 2, 1]), None);
    }
}
