//! Writer of meshoptimizer's index codec, version 1 (`EXT_meshopt_compression`, mode TRIANGLES).
//!
//! **Format.** A payload is a header byte, a code byte for each triangle, the data that codes refer to, and a table of 16 code
//! bytes. Encoder and decoder keep two ring buffers, of the last 16 edges and the last 16 vertices. The high half of a code is the
//! age of the edge from which the triangle continues, or 15 if there is no such edge. The low half says which the third vertex is:
//!
//! | low half | third vertex |
//! |---|---|
//! | 0 | new: the next index |
//! | 1 to 12 | in the vertex buffer, of that age |
//! | 13, 14 | one before, or one after, the index written last |
//! | 15 | any: the difference to the index written last follows as data (variable-length, zigzag) |
//!
//! A triangle without such an edge has a special code if all three vertices are new. Otherwise it takes one data byte: one half for the
//! second vertex, and one for the third.
//!
//! **This writer.** meshoptimizer's encoder takes a list of indices and searches both buffers for each triangle. Here the traversal in
//! `order` knows the edge from which it continues. For each vertex, the writer stores when the vertex entered the buffer, from which the
//! age follows. So the common case, [`IndexWriter::attach`], searches nothing and selects the code without branches.
//!
//! Invariants: vertices get their final index in the order of their first use; a decoder's buffers hold the same edges and vertices
//! after each triangle.

use std::hint::select_unpredictable;

/// First byte of a payload: codec and version.
const HEADER: u8 = 0xe1;
/// Minimum age at which the codec cannot refer to an edge any more.
pub(super) const REACH: u32 = 15;
/// Maximum age of a vertex that has a code. Age 0 has no code, because code 0 means a new vertex.
const MAX_VERTEX_AGE: u32 = 12;
/// Code of a third vertex whose index is one before the index written last.
const BEFORE_LAST: u32 = 13;
/// Code of a third vertex whose index is one after the index written last.
const AFTER_LAST: u32 = 14;
/// Code of a third vertex whose index follows in the data.
const EXPLICIT: u32 = 15;
/// Code of a triangle without an edge whose vertices are all new.
const ALL_NEW: u8 = 0xf0;
/// Code of a triangle without an edge that has a data byte for its second and third vertex. Each half of the byte is 0 for a new vertex,
/// the age plus 1 for a vertex in the buffer, or [`EXPLICIT`]. The low bit of the code says whether the first vertex is explicit.
const SECOND_THIRD: u8 = 0xfe;
/// The data bytes that have a code, so that they need not be written as data. This writer uses only the first entry: all other combinations
/// are too rare to matter.
const CODE_TABLE: [u8; 16] = [0; 16];

/// State of a vertex in the decoder.
#[derive(Clone, Copy)]
struct VertexState {
    /// Index of the vertex in the payload, or [`NEW`].
    index: u32,
    /// Value of the vertex clock when the vertex last entered the buffer.
    entered: u32,
}

/// Index of a vertex that was not used yet.
const NEW: u32 = u32::MAX;

/// The codec's state, and its output.
#[derive(Default)]
pub(super) struct IndexWriter {
    /// Code of each triangle.
    codes: Vec<u8>,
    /// The data to which codes refer.
    data: Vec<u8>,
    /// State of each vertex, by its original number.
    vertices: Vec<VertexState>,
    /// Original vertex of each new index. One more entry is written to before it is known whether the vertex is new.
    order: Vec<u32>,
    /// The index that the next new vertex gets.
    next_index: u32,
    /// The index written last, as data or by a code relative to the index before.
    last_index: u32,
    /// Number of vertices that have entered the buffer.
    vertex_clock: u32,
    /// The edge buffer. Each edge is a pair of original vertices.
    edges: [[u32; 2]; 16],
    /// Number of edges that have entered the buffer.
    edge_clock: u32,
}

impl IndexWriter {
    /// Begins a payload of `triangles` triangles. Every vertex that follows is below `vertices`.
    pub fn begin(&mut self, vertices: usize, triangles: usize) {
        self.codes.clear();
        self.codes.reserve(triangles);
        self.data.clear();
        self.vertices.clear();
        self.vertices.resize(vertices, VertexState { index: NEW, entered: 0 });
        self.order.clear();
        self.order.resize(vertices + 1, 0);
        (self.next_index, self.last_index) = (0, 0);
        // At the beginning, no vertex is so recent that its age has a code.
        self.vertex_clock = 16;
        self.edges = [[NEW; 2]; 16];
        self.edge_clock = 0;
    }

    /// Returns the original vertices in the order of their first use.
    pub fn order(&self) -> &[u32] {
        &self.order[..self.next_index as usize]
    }

    /// Returns the number of edges that have entered the buffer.
    pub fn clock(&self) -> u32 {
        self.edge_clock
    }

    /// Returns the payload in consecutive parts; empty if there is no triangle.
    pub fn payload(&self) -> [&[u8]; 4] {
        if self.codes.is_empty() {
            return [&[]; 4];
        }
        [&[HEADER], &self.codes, &self.data, &CODE_TABLE]
    }

    /// Writes a triangle that continues from an edge. The edge entered the buffer as `[a, b]`, `age` edges before the latest. Then two
    /// edges of the triangle enter the buffer: `[c, b]`, then `[a, c]`.
    #[inline]
    pub fn attach(&mut self, [a, b, c]: [u32; 3], age: u32) {
        debug_assert!(age < REACH);
        let vertex = &mut self.vertices[c as usize];
        let VertexState { index, entered } = *vertex;
        let vertex_age = self.vertex_clock - 1 - entered;
        let (is_new, is_recent) = (index == NEW, vertex_age.wrapping_sub(1) < MAX_VERTEX_AGE);
        // Branch-free, because it is unpredictable which case applies.
        let step = index.wrapping_sub(self.last_index);
        let relative = select_unpredictable(step == u32::MAX, BEFORE_LAST, EXPLICIT);
        let relative = select_unpredictable(step == 1, AFTER_LAST, relative);
        let code = select_unpredictable(is_new, 0, select_unpredictable(is_recent, vertex_age, relative));
        let index = select_unpredictable(is_new, self.next_index, index);
        *vertex = VertexState {
            index,
            entered: select_unpredictable(is_recent, entered, self.vertex_clock),
        };
        self.order[self.next_index as usize] = c;
        self.next_index += u32::from(is_new);
        self.vertex_clock += u32::from(!is_recent);
        self.codes.push((age << 4 | code) as u8);
        if code == EXPLICIT {
            self.write_index(index);
        }
        self.last_index = select_unpredictable(is_new | is_recent, self.last_index, index);
        self.enter_edge([c, b]);
        self.enter_edge([a, c]);
    }

    /// Writes a triangle without an edge in the buffer. Then all three edges of the triangle enter the buffer, the one that starts at the
    /// returned corner first.
    pub fn start(&mut self, mut corners: [u32; 3]) -> usize {
        // The format has no code for a second and third vertex that are new after a first one that is not.
        let is_new = |corner: &u32| self.vertices[*corner as usize].index == NEW;
        let first = corners.iter().position(is_new).unwrap_or(0);
        corners.rotate_left(first);
        let ages = corners.map(|corner| self.vertex_clock - 1 - self.vertices[corner as usize].entered);
        let [mut codes, mut indices] = [[0; 3]; 2];
        for (i, &corner) in corners.iter().enumerate() {
            let vertex = &mut self.vertices[corner as usize];
            if vertex.index == NEW {
                vertex.index = self.next_index;
                self.order[self.next_index as usize] = corner;
                self.next_index += 1;
            } else if i > 0 && ages[i] < EXPLICIT - 1 {
                codes[i] = ages[i] + 1;
                continue;
            } else {
                codes[i] = EXPLICIT;
                indices[i] = vertex.index;
            }
            vertex.entered = self.vertex_clock;
            self.vertex_clock += 1;
        }
        if codes == [0; 3] {
            self.codes.push(ALL_NEW);
        } else {
            self.codes.push(SECOND_THIRD | codes[0] as u8);
            self.data.push((codes[1] << 4 | codes[2]) as u8);
        }
        for (code, index) in codes.into_iter().zip(indices) {
            if code == EXPLICIT {
                self.write_index(index);
            }
        }
        let [a, b, c] = corners;
        self.enter_edge([b, a]);
        self.enter_edge([c, b]);
        self.enter_edge([a, c]);
        first
    }

    /// Finds an edge of a triangle in the buffer. Returns the corner at which the edge starts, and its age.
    pub fn find(&self, [a, b, c]: [u32; 3]) -> Option<(u32, u32)> {
        (0..REACH).find_map(|age| {
            let edge = self.edges[self.edge_clock.wrapping_sub(1 + age) as usize % 16];
            let corner = [[a, b], [b, c], [c, a]].iter().position(|&other| other == edge)?;
            Some((corner as u32, age))
        })
    }

    /// Adds an edge to the buffer.
    #[inline]
    fn enter_edge(&mut self, edge: [u32; 2]) {
        self.edges[self.edge_clock as usize % 16] = edge;
        self.edge_clock += 1;
    }

    /// Writes the difference to the index written last: seven bits a byte, the sign in the lowest bit.
    fn write_index(&mut self, index: u32) {
        let step = index.wrapping_sub(self.last_index) as i32;
        let mut remaining = (step << 1 ^ step >> 31) as u32;
        while remaining > 127 {
            self.data.push(remaining as u8 | 128);
            remaining >>= 7;
        }
        self.data.push(remaining as u8);
        self.last_index = index;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decoded(writer: &IndexWriter) -> Vec<[u32; 3]> {
        let payload = writer.payload().concat();
        let indices: Vec<u32> =
            meshopt::decode_index_buffer(&payload, 3 * writer.codes.len()).expect("a valid payload");
        // By original vertices.
        let triangles = indices.as_chunks::<3>().0.iter();
        triangles.map(|t| t.map(|v| writer.order()[v as usize])).collect()
    }

    #[test]
    fn each_code_of_a_vertex_comes_back() {
        let mut writer = IndexWriter::default();
        writer.begin(100, 40);
        let mut written = Vec::new();
        let mut start = |writer: &mut IndexWriter, mut corners: [u32; 3]| {
            let first = writer.start(corners);
            corners.rotate_left(first);
            written.push(corners);
        };
        // All new; two new after an old one; old ones, which are explicit; recent ones.
        for first in (0..90).step_by(3) {
            start(&mut writer, [first, first + 1, first + 2]);
        }
        start(&mut writer, [3, 90, 91]);
        start(&mut writer, [0, 50, 7]);
        start(&mut writer, [0, 50, 7]);
        start(&mut writer, [92, 92, 92]);
        // A strip: new, recent, one before and one after the index written last, explicit.
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
    fn an_edge_is_found_as_long_as_it_has_a_code() {
        let mut writer = IndexWriter::default();
        writer.begin(20, 10);
        assert_eq!(writer.find([0, 1, 2]), None);
        writer.start([0, 1, 2]);
        assert_eq!(writer.find([19, 2, 1]), Some((1, 1)), "in the opposite direction");
        assert_eq!(writer.find([0, 1, 2]), None, "in the same direction");
        for new in 3..9 {
            writer.attach([new - 1, new - 3, new], 0);
        }
        assert_eq!(writer.find([19, 2, 1]), Some((1, 13)));
        writer.attach([8, 6, 9], 0);
        assert_eq!(writer.find([19, 2, 1]), None);
    }
}
