//! Writer of meshoptimizer's vertex codec, version 1, for the vertices of the wire.
//!
//! The format (`EXT_meshopt_compression`, mode ATTRIBUTES) takes vertices in blocks. Of a block each byte of the vertices is a
//! *plane*, told by its differences from vertex to vertex, of bytes or of 16-bit words, and stored in groups of 16: so many bits
//! each, and a byte more for what is too large. meshoptimizer's encoder serves vertices of any shape, and tries for each four
//! bytes which differences are smaller, before it writes either. Here the shape is known: positions differ by words, features by
//! bytes, and only the third coordinate, which shares its four bytes with the normal, needs a trial.

use super::chunk::{VERTEX_BYTES, WireVertex};

/// First byte of a payload: the codec and its version.
const HEADER: u8 = 0xa1;
/// Vertices of a block, as the format has it for a vertex of this size.
const BLOCK: usize = 256;
const _: () = assert!(8192 / VERTEX_BYTES >= BLOCK);
/// Bytes of a group.
const GROUP: usize = 16;
const GROUPS: usize = BLOCK / GROUP;
/// Bits of a byte in a group. A plane says for each group which of four widths it has: the first four of these or the last four.
const WIDTHS: [usize; 5] = [0, 1, 2, 4, 8];
/// What stands for a plane in its block: widths from 0 to 4 bits, from 1 to 8, no byte but 0, or each byte as it is.
const NARROW: u8 = 0;
const WIDE: u8 = 1;
const ZERO: u8 = 2;
const LITERAL: u8 = 3;
/// 16-bit words of a vertex: three coordinates, the normal, two features.
const WORDS: usize = VERTEX_BYTES / 2;
/// Four bytes of a vertex, two planes a word, and how they differ.
const FOURS: usize = VERTEX_BYTES / 4;
const BY_BYTES: u8 = 0;
const BY_WORDS: u8 = 1;
/// The first vertex and the kinds of differences, behind zeros: decoders read some bytes further than they need.
const TAIL: usize = 24;

type Plane = [u8; BLOCK];

/// What was written, and room for more.
#[derive(Default)]
pub(super) struct VertexWriter {
    /// As long as a payload could become, so that nothing has to be cleared.
    room: Vec<u8>,
    written: usize,
}

impl VertexWriter {
    /// The payload; nothing where there are no vertices.
    pub fn payload(&self) -> &[u8] {
        &self.room[..self.written]
    }

    /// Writes a payload over the last one.
    pub fn write(&mut self, vertices: &[WireVertex]) {
        self.written = 0;
        let Some(first) = vertices.first() else { return };
        let block_bytes = FOURS + VERTEX_BYTES * (GROUPS / 4 + BLOCK);
        let bound = 1 + vertices.len().div_ceil(BLOCK) * block_bytes + TAIL;
        if self.room.len() < bound {
            self.room.resize(bound, 0);
        }
        self.put(&[HEADER]);
        let mut last = first;
        let mut kinds = None;
        for block in vertices.chunks(BLOCK) {
            let words = Words::new(last, block);
            let kinds = kinds.get_or_insert_with(|| [BY_WORDS, words.third_and_normal(), BY_BYTES]);
            self.write_block(&words, kinds);
            last = &block[block.len() - 1];
        }
        self.put(&[0; TAIL - VERTEX_BYTES - FOURS]);
        self.put(bytemuck::bytes_of(first));
        self.put(&kinds.unwrap_or_default());
    }

    fn write_block(&mut self, words: &Words, kinds: &[u8; FOURS]) {
        let control = self.written;
        self.put(&[0; FOURS]);
        for (four, &kind) in kinds.iter().enumerate() {
            for (place, plane) in words.planes(four, kind).iter().enumerate() {
                let measured = Measured::new(plane, words.vertices);
                self.room[control + four] |= measured.control << (2 * place);
                match measured.control {
                    ZERO => {}
                    LITERAL => self.put(&plane[..words.vertices]),
                    _ => self.write_plane(plane, &measured, words.vertices.div_ceil(GROUP)),
                }
            }
        }
    }

    fn write_plane(&mut self, plane: &Plane, measured: &Measured, groups: usize) {
        let mut header = [0; GROUPS / 4];
        for (group, width) in measured.widths[..groups].iter().enumerate() {
            header[group / 4] |= (width - measured.control) << (group % 4 * 2);
        }
        self.put(&header[..groups.div_ceil(4)]);
        for (group, &width) in plane.as_chunks().0.iter().zip(&measured.widths[..groups]) {
            self.write_group(group, WIDTHS[usize::from(width)]);
        }
    }

    fn write_group(&mut self, group: &[u8; GROUP], bits: usize) {
        let sentinel = match bits {
            0 => return,
            8 => return self.put(group),
            bits => (1 << bits) - 1,
        };
        let small = group.map(|byte| byte.min(sentinel));
        match bits {
            // Eight bits a byte, the first one lowest; of wider ones the first one highest.
            1 => {
                let pack = |eight: &[u8; 8]| (0..8).fold(0, |byte, i| byte | eight[i] << i);
                self.put(&[0, 1].map(|i| pack(&small.as_chunks().0[i])));
            }
            2 => self.put(&[0, 4, 8, 12].map(|i| small[i] << 6 | small[i + 1] << 4 | small[i + 2] << 2 | small[i + 3])),
            _ => self.put(&[0, 2, 4, 6, 8, 10, 12, 14].map(|i| small[i] << 4 | small[i + 1])),
        }
        // Written in any case, and kept where it is too large for the bits.
        let room = self.room[self.written..].first_chunk_mut::<GROUP>();
        let room = room.expect("room for the tail behind the last group");
        let mut kept = 0;
        for &byte in group {
            room[kept % GROUP] = byte;
            kept += usize::from(byte >= sentinel);
        }
        self.written += kept;
    }

    fn put(&mut self, bytes: &[u8]) {
        self.room[self.written..][..bytes.len()].copy_from_slice(bytes);
        self.written += bytes.len();
    }
}

/// A block's words, each kind in a row of its own behind that of the vertex before the block. After the last vertex it is
/// repeated: no difference, so that groups are whole.
struct Words {
    rows: [[u16; BLOCK + 1]; WORDS],
    vertices: usize,
}

impl Words {
    fn new(before: &WireVertex, block: &[WireVertex]) -> Self {
        let mut rows = [[0; BLOCK + 1]; WORDS];
        let vertices = block.len();
        let padded = vertices.next_multiple_of(GROUP);
        let last = [&block[vertices - 1]; GROUP];
        let all = std::iter::once(before).chain(block).chain(last).take(1 + padded);
        for (i, vertex) in all.enumerate() {
            let words: [u16; WORDS] = bytemuck::cast(*vertex);
            for (row, word) in rows.iter_mut().zip(words) {
                row[i] = word;
            }
        }
        Self { rows, vertices }
    }

    /// How the third coordinate and the normal differ by less.
    fn third_and_normal(&self) -> u8 {
        let bytes = [BY_BYTES, BY_WORDS].map(|kind| {
            let planes = self.planes(1, kind);
            planes
                .iter()
                .map(|plane| Measured::new(plane, self.vertices).bytes)
                .sum::<usize>()
        });
        if bytes[0] <= bytes[1] { BY_BYTES } else { BY_WORDS }
    }

    /// Differences of four bytes.
    fn planes(&self, four: usize, kind: u8) -> [Plane; 4] {
        let mut planes = [[0; BLOCK]; 4];
        let padded = self.vertices.next_multiple_of(GROUP);
        let (halves, _) = planes.as_chunks_mut::<2>();
        for ([low, high], row) in halves.iter_mut().zip(&self.rows[2 * four..]) {
            let steps = row[..padded].iter().zip(&row[1..=padded]).zip(low).zip(high);
            if kind == BY_WORDS {
                steps.for_each(|(((before, here), low), high)| {
                    let step = here.wrapping_sub(*before) as i16;
                    [*low, *high] = (step << 1 ^ step >> 15).to_le_bytes();
                });
            } else {
                steps.for_each(|(((before, here), low), high)| {
                    let zigzag = |here: u16, before: u16| {
                        let step = (here as u8).wrapping_sub(before as u8) as i8;
                        (step << 1 ^ step >> 7) as u8
                    };
                    *low = zigzag(*here, *before);
                    *high = zigzag(here >> 8, before >> 8);
                });
            }
        }
        planes
    }
}

/// The least that a plane takes.
struct Measured {
    control: u8,
    bytes: usize,
    /// Of each group, as places in [`WIDTHS`].
    widths: [u8; GROUPS],
}

impl Measured {
    fn new(plane: &Plane, vertices: usize) -> Self {
        let groups = vertices.div_ceil(GROUP);
        let header = groups.div_ceil(4);
        // With the narrow widths, and with the wide ones.
        let (mut bytes, mut widths) = ([header; 2], [[0; GROUPS]; 2]);
        let mut any = 0;
        for (i, group) in plane.as_chunks::<GROUP>().0[..groups].iter().enumerate() {
            let least = |least: u8| group.iter().map(|&byte| u8::from(byte >= least)).sum::<u8>();
            let not_zero = least(1);
            any |= not_zero;
            let mut best = (2 + not_zero, 1);
            for sized in [(4 + least(3), 2), (8 + least(15), 3)] {
                best = if sized.0 < best.0 { sized } else { best };
            }
            let narrow = if not_zero == 0 { (0, 0) } else { best };
            let wide = if best.0 < GROUP as u8 { best } else { (GROUP as u8, 4) };
            for (k, (size, width)) in [narrow, wide].into_iter().enumerate() {
                bytes[k] += usize::from(size);
                widths[k][i] = width;
            }
        }
        let control = if any == 0 {
            ZERO
        } else if bytes[0].min(bytes[1]) >= vertices {
            LITERAL
        } else if bytes[0] < bytes[1] {
            NARROW
        } else {
            WIDE
        };
        let [narrow, wide] = widths;
        Self {
            control,
            bytes: match control {
                ZERO => 0,
                LITERAL => vertices,
                _ => bytes[0].min(bytes[1]),
            },
            widths: if control == NARROW { narrow } else { wide },
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn decoded(payload: &[u8], vertices: usize) -> Vec<WireVertex> {
        meshopt::decode_vertex_buffer(payload, vertices).expect("what the codec wrote")
    }

    fn written(vertices: &[WireVertex]) -> Vec<u8> {
        let mut writer = VertexWriter::default();
        // Over what another payload left.
        writer.write(
            &[WireVertex {
                position: [-1; 3],
                normal: [-1; 2],
                smoothness: 0x7f7f,
                feature: 1,
            }; 777],
        );
        writer.write(vertices);
        writer.payload().to_vec()
    }

    /// Steps of up to so many bits from vertex to vertex, for each word.
    fn walk(bits: [u32; WORDS], seeds: &[[u16; WORDS]]) -> Vec<WireVertex> {
        let mut words = [0u16; WORDS];
        let step = |seeds: &[u16; WORDS]| {
            for ((word, seed), bits) in words.iter_mut().zip(seeds).zip(bits) {
                let step = u32::from(*seed) & ((1 << bits) - 1);
                *word = word.wrapping_add(step as u16).wrapping_sub((1u32 << bits >> 1) as u16);
            }
            bytemuck::cast(words)
        };
        seeds.iter().map(step).collect()
    }

    proptest! {
        #[test]
        fn what_is_written_comes_back(
            bits in prop::array::uniform6(0u32..=16),
            seeds in prop::collection::vec(any::<[u16; WORDS]>(), 1..600),
        ) {
            let vertices = walk(bits, &seeds);
            let payload = written(&vertices);
            prop_assert_eq!(decoded(&payload, vertices.len()), vertices.clone());
            let blocks = vertices.len().div_ceil(BLOCK);
            prop_assert!(payload.len() <= 1 + blocks * FOURS + vertices.len() * VERTEX_BYTES + TAIL);
        }
    }

    #[test]
    fn vertices_of_a_surface_take_no_more_than_with_meshoptimizer() {
        let vertex = |i: u32| {
            let t = f64::from(i) * 0.02;
            let direction = [t.sin() * (7.0 * t).cos(), t.sin() * (7.0 * t).sin(), t.cos()];
            WireVertex {
                position: direction.map(|d| (1024.0 + 800.0 * d + 30.0 * (90.0 * t).sin()) as i16),
                normal: [0, 1].map(|axis| (127.0 * direction[axis]) as i8),
                smoothness: ((128.0 + 100.0 * (3.0 * t).sin()) as u16) << 8,
                feature: ((90.0 + 80.0 * t.cos()) as u16) << 8,
            }
        };
        for count in [40, 300, 4000] {
            let vertices: Vec<_> = (0..count).map(vertex).collect();
            let payload = written(&vertices);
            let theirs = meshopt::encode_vertex_buffer_level(&vertices, 2, Some(1)).expect("encodes");
            assert_eq!(decoded(&payload, vertices.len()), vertices);
            assert!(
                payload.len() <= theirs.len(),
                "{} and {} bytes of {count}",
                payload.len(),
                theirs.len()
            );
        }
    }

    #[test]
    fn no_vertices_are_no_bytes_and_equal_ones_nearly_none() {
        assert!(written(&[]).is_empty());
        let vertex = WireVertex {
            position: [5, -6, 7],
            normal: [8, -9],
            smoothness: 256,
            feature: 65535,
        };
        for count in [1, 15, 16, 17, 255, 256, 257, 1000] {
            let payload = written(&vec![vertex; count]);
            assert_eq!(payload.len(), 1 + count.div_ceil(BLOCK) * FOURS + TAIL);
            assert_eq!(decoded(&payload, count), vec![vertex; count]);
        }
    }
}
