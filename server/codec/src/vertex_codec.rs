//! Writer of meshoptimizer's vertex codec, version 1 (`EXT_meshopt_compression`, mode ATTRIBUTES), for vertices of 12 bytes.
//!
//! **Format.** A payload is a header byte, blocks of up to 256 vertices, and a tail. Each of the 12 bytes of a vertex gives a *plane*
//! of the block: the zigzag-coded differences of this byte from vertex to vertex. Differences are computed by byte or by 16-bit word. The
//! tail says which, once for each *channel* of four planes. A plane is all zero, verbatim, or in groups of 16 bytes. Each group has a width
//! of 0, 1, 2, 4 or 8 bits; the highest value of a width is a sentinel for a byte that follows the group in full. A block starts with two
//! control bits for each plane, and a plane in groups with two bits for the width of each group. The tail holds the channels' kinds and the
//! first vertex, from which the differences of the first block start.
//!
//! **This writer.** meshoptimizer's encoder takes vertices of any layout, and tries both kinds of differences for each channel of a mesh.
//! Here the layout is known: x and y use words, features use bytes, and only for the channel of z and the normal both kinds are tried, on
//! the first block. All sizes are computed before anything is written, and the buffer is large enough for any payload.

use super::chunk::{VERTEX_BYTES, WireVertex};

/// First byte of a payload: codec and version.
const HEADER: u8 = 0xa1;
/// Maximum vertices of a block. The format derives this number from the bytes of a vertex; it is at most 256.
const BLOCK: usize = 256;
const _: () = assert!(8192 / VERTEX_BYTES >= BLOCK);
/// Bytes of a group.
const GROUP: usize = 16;
/// Groups of a plane.
const GROUPS: usize = BLOCK / GROUP;
/// Widths of a group: bits per byte. A narrow plane uses the first four of these widths, a wide one the last four.
const WIDTHS: [usize; 5] = [0, 1, 2, 4, 8];
/// Control bits of a plane in groups of 0 to 4 bits.
const NARROW: u8 = 0;
/// Control bits of a plane in groups of 1 to 8 bits.
const WIDE: u8 = 1;
/// Control bits of a plane that is all zero.
const ZERO: u8 = 2;
/// Control bits of a plane that is stored verbatim.
const VERBATIM: u8 = 3;
/// Number of 16-bit words of a vertex: three coordinates, the normal, and two features.
const WORDS: usize = VERTEX_BYTES / 2;
/// Number of channels of a vertex. Each has two words, or four planes.
const CHANNELS: usize = VERTEX_BYTES / 4;
/// Kind of a channel with differences of bytes.
const BY_BYTES: u8 = 0;
/// Kind of a channel with differences of words.
const BY_WORDS: u8 = 1;
/// Bytes of the tail: padding, because decoders read past a plane's end, then the first vertex and the kinds.
const TAIL: usize = 24;

/// A plane: one byte for each vertex of a block.
type Plane = [u8; BLOCK];

/// Writes payloads to a buffer that is reused.
#[derive(Default)]
pub(super) struct VertexWriter {
    /// The payload, and unused bytes behind it. The buffer never shrinks, so that it need not be cleared.
    buffer: Vec<u8>,
    /// Bytes of the payload.
    written: usize,
}

impl VertexWriter {
    /// Returns the payload written last; empty if there are no vertices.
    pub fn payload(&self) -> &[u8] {
        &self.buffer[..self.written]
    }

    /// Replaces the payload by that of these vertices.
    pub fn write(&mut self, vertices: &[WireVertex]) {
        self.written = 0;
        let Some(first) = vertices.first() else { return };
        let max_block_bytes = CHANNELS + VERTEX_BYTES * (GROUPS / 4 + BLOCK);
        let max_bytes = 1 + vertices.len().div_ceil(BLOCK) * max_block_bytes + TAIL;
        if self.buffer.len() < max_bytes {
            self.buffer.resize(max_bytes, 0);
        }
        self.append(&[HEADER]);
        let mut last = first;
        let mut kinds = None;
        for block in vertices.chunks(BLOCK) {
            let words = Words::new(last, block);
            let kinds = kinds.get_or_insert_with(|| [BY_WORDS, words.kind_of_z_and_normal(), BY_BYTES]);
            self.write_block(&words, kinds);
            last = &block[block.len() - 1];
        }
        self.append(&[0; TAIL - VERTEX_BYTES - CHANNELS]);
        self.append(bytemuck::bytes_of(first));
        self.append(&kinds.unwrap_or_default());
    }

    /// Writes a block. `kinds`: the kind of each channel.
    fn write_block(&mut self, words: &Words, kinds: &[u8; CHANNELS]) {
        let control = self.written;
        self.append(&[0; CHANNELS]);
        for (channel, &kind) in kinds.iter().enumerate() {
            for (i, plane) in words.planes(channel, kind).iter().enumerate() {
                let layout = PlaneLayout::smallest(plane, words.vertices);
                self.buffer[control + channel] |= layout.control << (2 * i);
                match layout.control {
                    ZERO => {}
                    VERBATIM => self.append(&plane[..words.vertices]),
                    _ => self.write_plane(plane, &layout, words.vertices.div_ceil(GROUP)),
                }
            }
        }
    }

    /// Writes a plane of `groups` groups.
    fn write_plane(&mut self, plane: &Plane, layout: &PlaneLayout, groups: usize) {
        let mut header = [0; GROUPS / 4];
        for (group, width) in layout.widths[..groups].iter().enumerate() {
            header[group / 4] |= (width - layout.control) << (group % 4 * 2);
        }
        self.append(&header[..groups.div_ceil(4)]);
        for (group, &width) in plane.as_chunks().0.iter().zip(&layout.widths[..groups]) {
            self.write_group(group, WIDTHS[usize::from(width)]);
        }
    }

    /// Writes a group with this number of bits per byte.
    fn write_group(&mut self, group: &[u8; GROUP], bits: usize) {
        let sentinel = match bits {
            0 => return,
            8 => return self.append(group),
            bits => (1 << bits) - 1,
        };
        let small = group.map(|byte| byte.min(sentinel));
        match bits {
            // With one bit, the first value is in the lowest bit of a byte. With more bits, the first value is in the highest bits.
            1 => {
                let pack = |bits: &[u8; 8]| (0..8).fold(0, |byte, i| byte | bits[i] << i);
                self.append(&[0, 1].map(|i| pack(&small.as_chunks().0[i])));
            }
            2 => self
                .append(&[0, 4, 8, 12].map(|i| small[i] << 6 | small[i + 1] << 4 | small[i + 2] << 2 | small[i + 3])),
            _ => self.append(&[0, 2, 4, 6, 8, 10, 12, 14].map(|i| small[i] << 4 | small[i + 1])),
        }
        // Branch-free: every byte is written, but the position advances only past bytes for which the sentinel stands.
        let target = self.buffer[self.written..].first_chunk_mut::<GROUP>();
        let target = target.expect("the tail follows the last group");
        let mut full_bytes = 0;
        for &byte in group {
            target[full_bytes % GROUP] = byte;
            full_bytes += usize::from(byte >= sentinel);
        }
        self.written += full_bytes;
    }

    /// Appends bytes to the payload.
    fn append(&mut self, bytes: &[u8]) {
        self.buffer[self.written..][..bytes.len()].copy_from_slice(bytes);
        self.written += bytes.len();
    }
}

/// The words of a block as a structure of arrays: a row for each word. Each row begins with the word of the vertex before the block. The
/// last vertex is repeated to the end of its group, so that the differences there are 0.
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
        let vertices_with_padding = std::iter::once(before).chain(block).chain(last).take(1 + padded);
        for (i, vertex) in vertices_with_padding.enumerate() {
            let words: [u16; WORDS] = bytemuck::cast(*vertex);
            for (row, word) in rows.iter_mut().zip(words) {
                row[i] = word;
            }
        }
        Self { rows, vertices }
    }

    /// Returns the kind of differences with which the second channel, z and the normal, takes fewer bytes.
    fn kind_of_z_and_normal(&self) -> u8 {
        let bytes = [BY_BYTES, BY_WORDS].map(|kind| {
            let planes = self.planes(1, kind);
            let sizes = planes
                .iter()
                .map(|plane| PlaneLayout::smallest(plane, self.vertices).bytes);
            sizes.sum::<usize>()
        });
        if bytes[0] <= bytes[1] { BY_BYTES } else { BY_WORDS }
    }

    /// Returns the planes of a channel with this kind of differences.
    fn planes(&self, channel: usize, kind: u8) -> [Plane; 4] {
        let mut planes = [[0; BLOCK]; 4];
        let padded = self.vertices.next_multiple_of(GROUP);
        let (words, _) = planes.as_chunks_mut::<2>();
        for ([low, high], row) in words.iter_mut().zip(&self.rows[2 * channel..]) {
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

/// How a plane is stored.
struct PlaneLayout {
    /// The control bits.
    control: u8,
    /// Bytes of the stored plane.
    bytes: usize,
    /// Width of each group, as an index of [`WIDTHS`].
    widths: [u8; GROUPS],
}

impl PlaneLayout {
    /// Returns the layout with the fewest bytes.
    fn smallest(plane: &Plane, vertices: usize) -> Self {
        let groups = vertices.div_ceil(GROUP);
        let header = groups.div_ceil(4);
        // Bytes and widths of the groups as a narrow plane, and as a wide one.
        let (mut bytes, mut widths) = ([header; 2], [[0; GROUPS]; 2]);
        let mut any_nonzero = 0;
        for (i, group) in plane.as_chunks::<GROUP>().0[..groups].iter().enumerate() {
            let count_from = |low: u8| group.iter().map(|&byte| u8::from(byte >= low)).sum::<u8>();
            let nonzero = count_from(1);
            any_nonzero |= nonzero;
            let mut best = (2 + nonzero, 1);
            for candidate in [(4 + count_from(3), 2), (8 + count_from(15), 3)] {
                best = if candidate.0 < best.0 { candidate } else { best };
            }
            let narrow = if nonzero == 0 { (0, 0) } else { best };
            let wide = if best.0 < GROUP as u8 { best } else { (GROUP as u8, 4) };
            for (k, (size, width)) in [narrow, wide].into_iter().enumerate() {
                bytes[k] += usize::from(size);
                widths[k][i] = width;
            }
        }
        let control = if any_nonzero == 0 {
            ZERO
        } else if bytes[0].min(bytes[1]) >= vertices {
            VERBATIM
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
                VERBATIM => vertices,
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
        meshopt::decode_vertex_buffer(payload, vertices).expect("a valid payload")
    }

    fn written(vertices: &[WireVertex]) -> Vec<u8> {
        let mut writer = VertexWriter::default();
        // A buffer that another payload was written to.
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

    /// A random walk from vertex to vertex, with steps of up to `bits` bits in each word.
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
            prop_assert!(payload.len() <= 1 + blocks * CHANNELS + vertices.len() * VERTEX_BYTES + TAIL);
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
            let peer = meshopt::encode_vertex_buffer_level(&vertices, 2, Some(1)).expect("encodes");
            assert_eq!(decoded(&payload, vertices.len()), vertices);
            assert!(
                payload.len() <= peer.len(),
                "{} and {} bytes of {count}",
                payload.len(),
                peer.len()
            );
        }
    }

    #[test]
    fn no_vertices_take_no_bytes_and_equal_ones_nearly_none() {
        assert!(written(&[]).is_empty());
        let vertex = WireVertex {
            position: [5, -6, 7],
            normal: [8, -9],
            smoothness: 256,
            feature: 65535,
        };
        for count in [1, 15, 16, 17, 255, 256, 257, 1000] {
            let payload = written(&vec![vertex; count]);
            assert_eq!(payload.len(), 1 + count.div_ceil(BLOCK) * CHANNELS + TAIL);
            assert_eq!(decoded(&payload, count), vec![vertex; count]);
        }
    }
}
