//! Writer of meshoptimizer's vertex codec, version 1, for the vertices of a chunk.
//!
//! The format (`EXT_meshopt_compression`, mode ATTRIBUTES): blocks of 256 vertices, in each of them the bytes of a vertex one
//! after another, as differences from the vertex before, 16 of them a group, which takes 0, 1, 2, 4 or 8 bits for each, and
//! whole bytes behind them for those that are too large. meshoptimizer's encoder takes vertices of any size as they lie;
//! here they are gathered into columns, whose loops know their length, so that a compiler does 16 bytes at once.

use super::chunk::{VERTEX_BYTES, WireVertex};

/// First byte of a payload: the codec and its version.
const HEADER: u8 = 0xa1;
const BLOCK: usize = 256;
const GROUP: usize = 16;
const GROUPS: usize = BLOCK / GROUP;
const WORDS: usize = VERTEX_BYTES / 2;
/// Four bytes of a vertex choose together whether their differences are of bytes or of 16-bit words.
const CHANNELS: usize = VERTEX_BYTES / 4;
/// The decoder reads so many bytes at once; the payload's end is at least as long.
const TAIL: usize = 24;
/// Most that a group takes, with room to write beyond it.
const REACH: usize = 32;

/// A 16-bit word of each vertex, behind the one of the last vertex of the block before.
type Column = [u16; BLOCK + 1];
/// A byte of each vertex's difference.
type Plane = [u8; BLOCK];

/// How one byte of all vertices of a block travels: the format's numbers.
#[derive(Clone, Copy, PartialEq)]
enum Control {
    /// Groups of 0, 1, 2 or 4 bits.
    Short = 0,
    /// Groups of 1, 2, 4 or 8 bits.
    Long = 1,
    /// Not at all: all are zero.
    Zero = 2,
    /// As they are.
    Literal = 3,
}

/// What the codec has written.
#[derive(Default)]
pub(super) struct VertexWriter {
    /// As long as one ever could become, so that nothing has to be cleared.
    payload: Vec<u8>,
    /// How much of it was written.
    written: usize,
    /// Least and greatest position.
    pub bounds: [[i16; 3]; 2],
}

impl VertexWriter {
    /// The payload; nothing where there is no vertex.
    pub fn payload(&self) -> &[u8] {
        &self.payload[..self.written]
    }

    /// Writes the vertices in the order given.
    pub fn write(&mut self, vertices: &[WireVertex], order: &[u32]) {
        self.written = 0;
        self.bounds = [[0; 3]; 2];
        let Some(&first) = order.first() else { return };
        let first = vertices[first as usize];
        let blocks = order.len().div_ceil(BLOCK);
        let most = 1 + blocks * (CHANNELS + VERTEX_BYTES * (BLOCK + GROUPS / 4)) + TAIL + REACH;
        if self.payload.len() < most {
            self.payload.resize(most, 0);
        }
        self.payload[0] = HEADER;
        let mut at = 1;
        self.bounds = [first.position; 2];

        let words: [u16; WORDS] = bytemuck::cast(first);
        let mut columns = words.map(|word| [word; BLOCK + 1]);
        let mut channels = None;
        for block in order.chunks(BLOCK) {
            gather(&mut columns, vertices, block);
            self.widen(&columns);
            // The first block speaks for the others.
            let wide = channels.get_or_insert_with(|| [0, 1, 2].map(|channel| is_wide(&columns, channel, block.len())));
            at = self.write_block(at, &columns, wide, block.len());
            columns.iter_mut().for_each(|column| column[0] = column[BLOCK]);
        }

        let mut tail = [0; TAIL];
        let (before, chosen) = tail.split_at_mut(TAIL - CHANNELS);
        before[TAIL - CHANNELS - VERTEX_BYTES..].copy_from_slice(bytemuck::bytes_of(&first));
        chosen.copy_from_slice(&channels.unwrap_or_default().map(u8::from));
        self.written = at + TAIL;
        self.payload[at..self.written].copy_from_slice(&tail);
    }

    /// Takes a block's positions into the bounds.
    fn widen(&mut self, columns: &[Column; WORDS]) {
        let [least, greatest] = &mut self.bounds;
        for (axis, column) in columns[..3].iter().enumerate() {
            let all = || column.iter().map(|&word| word as i16);
            least[axis] = all().fold(least[axis], i16::min);
            greatest[axis] = all().fold(greatest[axis], i16::max);
        }
    }

    fn write_block(
        &mut self,
        begin: usize,
        columns: &[Column; WORDS],
        wide: &[bool; CHANNELS],
        vertices: usize,
    ) -> usize {
        let groups = vertices.div_ceil(GROUP);
        let mut at = begin + CHANNELS;
        let mut controls = [0; CHANNELS];
        for (word, column) in columns.iter().enumerate() {
            for (byte, plane) in differences(column, wide[word / 2]).iter().enumerate() {
                let sizes = Sizes::of(plane, groups);
                let (control, _) = sizes.best(groups, vertices);
                controls[word / 2] |= (control as u8) << (2 * (2 * (word % 2) + byte));
                match control {
                    Control::Zero => {}
                    Control::Literal => {
                        self.payload[at..at + vertices].copy_from_slice(&plane[..vertices]);
                        at += vertices;
                    }
                    Control::Short | Control::Long => at = self.write_groups(at, plane, &sizes, control, groups),
                }
            }
        }
        self.payload[begin..begin + CHANNELS].copy_from_slice(&controls);
        at
    }

    fn write_groups(&mut self, begin: usize, plane: &Plane, sizes: &Sizes, control: Control, groups: usize) -> usize {
        let mut kinds = [0; GROUPS / 4];
        let mut at = begin + groups.div_ceil(4);
        for (place, group) in plane.as_chunks::<GROUP>().0[..groups].iter().enumerate() {
            let out = &mut self.payload[at..at + REACH];
            let (kind, written) = sizes.write_group(place, group, control, out);
            kinds[place / 4] |= kind << (2 * (place % 4));
            at += written;
        }
        let header = groups.div_ceil(4);
        self.payload[begin..begin + header].copy_from_slice(&kinds[..header]);
        at
    }
}

/// Puts a block's vertices into columns; the last one fills what is left, with differences of zero.
fn gather(columns: &mut [Column; WORDS], vertices: &[WireVertex], block: &[u32]) {
    for (place, &vertex) in (1..).zip(block) {
        let words: [u16; WORDS] = bytemuck::cast(vertices[vertex as usize]);
        for (column, word) in columns.iter_mut().zip(words) {
            column[place] = word;
        }
    }
    for column in columns {
        let last = column[block.len()];
        column[block.len() + 1..].fill(last);
    }
}

/// Low and high bytes of a column's differences, with the sign in the lowest bit.
fn differences(column: &Column, wide: bool) -> [Plane; 2] {
    let mut planes = [[0; BLOCK]; 2];
    let [low, high] = &mut planes;
    if wide {
        for place in 0..BLOCK {
            let step = column[place + 1].wrapping_sub(column[place]);
            let step = step << 1 ^ (step as i16 >> 15) as u16;
            low[place] = step as u8;
            high[place] = (step >> 8) as u8;
        }
    } else {
        let signed = |step: u8| step << 1 ^ (step as i8 >> 7) as u8;
        for place in 0..BLOCK {
            let [before, here] = [column[place], column[place + 1]];
            low[place] = signed((here as u8).wrapping_sub(before as u8));
            high[place] = signed(((here >> 8) as u8).wrapping_sub((before >> 8) as u8));
        }
    }
    planes
}

/// Whether four bytes of all vertices take less room as differences of words.
fn is_wide(columns: &[Column; WORDS], channel: usize, vertices: usize) -> bool {
    let [bytes, words] = [false, true].map(|wide| {
        let planes = columns[2 * channel..][..2]
            .iter()
            .flat_map(|column| differences(column, wide));
        let groups = vertices.div_ceil(GROUP);
        let sizes = planes.map(|plane| Sizes::of(&plane, groups).best(groups, vertices).1);
        sizes.sum::<usize>()
    });
    words < bytes
}

/// Bytes that each group of a plane takes.
struct Sizes {
    /// How many of each group are not zero.
    used: [u8; GROUPS],
    /// With 1, 2 or 4 bits for each.
    short: [[u8; GROUPS]; 3],
    /// The least of them.
    least: [u8; GROUPS],
}

impl Sizes {
    fn of(plane: &Plane, groups: usize) -> Self {
        let [mut used, mut more, mut most] = [[0; GROUPS]; 3];
        for (place, group) in plane.as_chunks::<GROUP>().0[..groups].iter().enumerate() {
            let halves: [u64; 2] = bytemuck::cast(*group);
            let above = |limit: u64| count_above(halves, limit);
            [used[place], more[place], most[place]] = [above(0), above(2), above(14)];
        }
        let short = [used.map(|n| 2 + n), more.map(|n| 4 + n), most.map(|n| 8 + n)];
        let mut least = short[0];
        for place in 0..GROUPS {
            least[place] = least[place].min(short[1][place]).min(short[2][place]);
        }
        Self { used, short, least }
    }

    /// The way that takes least, and what it takes.
    fn best(&self, groups: usize, vertices: usize) -> (Control, usize) {
        let (mut short, mut long) = (0, 0);
        for (&least, &used) in self.least.iter().zip(&self.used).take(groups) {
            short += if used > 0 { usize::from(least) } else { 0 };
            long += usize::from(least.min(GROUP as u8));
        }
        if self.used == [0; GROUPS] {
            return (Control::Zero, 0);
        }
        let header = groups.div_ceil(4);
        let shorter = short.min(long) + header;
        if shorter >= vertices {
            (Control::Literal, vertices)
        } else if short < long {
            (Control::Short, shorter)
        } else {
            (Control::Long, shorter)
        }
    }

    /// Writes a group; its kind in the plane's header, and its bytes.
    fn write_group(&self, place: usize, group: &[u8; GROUP], control: Control, out: &mut [u8]) -> (u8, usize) {
        let least = self.least[place];
        let long = u8::from(control == Control::Long);
        if control == Control::Short && self.used[place] == 0 {
            return (0, 0);
        }
        if control == Control::Long && least >= GROUP as u8 {
            out[..GROUP].copy_from_slice(group);
            return (3, GROUP);
        }
        let kind = if self.short[0][place] == least {
            let bits = (0..GROUP).fold(0, |bits, i| bits | u16::from(group[i] > 0) << i);
            out[..2].copy_from_slice(&bits.to_le_bytes());
            append(group, 1, out, 2);
            1
        } else if self.short[1][place] == least {
            let pairs: [u8; 8] = std::array::from_fn(|i| group[2 * i].min(3) << 2 | group[2 * i + 1].min(3));
            let fours: [u8; 4] = std::array::from_fn(|i| pairs[2 * i] << 4 | pairs[2 * i + 1]);
            out[..4].copy_from_slice(&fours);
            append(group, 3, out, 4);
            2
        } else {
            let pairs: [u8; 8] = std::array::from_fn(|i| group[2 * i].min(15) << 4 | group[2 * i + 1].min(15));
            out[..8].copy_from_slice(&pairs);
            append(group, 15, out, 8);
            3
        };
        (kind - long, usize::from(least))
    }
}

/// How many of 16 bytes are greater than a limit below 128, eight at once: of these and of greater ones an addition or the
/// byte itself sets the highest bit.
fn count_above(halves: [u64; 2], limit: u64) -> u8 {
    const ONES: u64 = u64::MAX / 255;
    let [first, second] = halves.map(|bytes| ((((bytes & (127 * ONES)) + (127 - limit) * ONES) | bytes) >> 7) & ONES);
    // The highest byte of the product is the sum of all.
    ((first + second).wrapping_mul(ONES) >> 56) as u8
}

/// Writes those that the bits of a group are too few for.
fn append(group: &[u8; GROUP], least: u8, out: &mut [u8], mut at: usize) {
    for &byte in group {
        out[at] = byte;
        at += usize::from(byte >= least);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn decoded(payload: &[u8], count: usize) -> Vec<WireVertex> {
        meshopt::decode_vertex_buffer(payload, count).expect("what the codec wrote")
    }

    /// Differences of so many bits in each word, from none to noise.
    fn vertices(count: usize, bits: [u32; WORDS]) -> Vec<WireVertex> {
        let (mut state, mut words) = (1_u32, [0_u16; WORDS]);
        let mut next = || {
            for (word, bits) in words.iter_mut().zip(bits) {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                *word = word.wrapping_add((u64::from(state) << bits >> 32) as u16);
            }
            bytemuck::cast(words)
        };
        (0..count).map(|_| next()).collect()
    }

    #[test]
    fn blocks_and_groups_of_any_length_come_back() {
        let mut writer = VertexWriter::default();
        for count in [600, 1, 2, 15, 16, 17, 255, 256, 257, 512, 0] {
            let vertices = vertices(count, [0, 1, 3, 5, 9, 16]);
            let order: Vec<u32> = (0..count as u32).rev().collect();
            writer.write(&vertices, &order);
            let expected: Vec<_> = vertices.iter().rev().copied().collect();
            assert_eq!(writer.payload().is_empty(), count == 0);
            if count > 0 {
                assert_eq!(decoded(writer.payload(), count), expected, "{count} vertices");
            }
        }
    }

    #[test]
    fn it_takes_as_little_as_the_encoder_of_meshoptimizer() {
        for bits in [[6, 6, 6, 8, 0, 0], [9, 2, 4, 16, 7, 7], [0; WORDS], [16; WORDS]] {
            let vertices = vertices(1000, bits);
            let mut writer = VertexWriter::default();
            writer.write(&vertices, &(0..1000).collect::<Vec<_>>());
            let theirs = meshopt::encode_vertex_buffer_level(&vertices, 2, Some(1)).expect("encodes");
            let [ours, theirs] = [writer.payload().len(), theirs.len()];
            assert!(ours <= theirs + theirs / 100, "{ours} bytes, theirs {theirs}: {bits:?}");
        }
    }

    #[test]
    fn bounds_are_those_of_the_vertices_written() {
        let mut vertices = vertices(300, [7, 7, 7, 0, 0, 0]);
        vertices[299].position = [-3, 30_000, -30_000];
        let mut writer = VertexWriter::default();
        writer.write(&vertices, &(0..299).collect::<Vec<_>>());
        let axis = |axis: usize| vertices[..299].iter().map(move |v| v.position[axis]);
        let least = [0, 1, 2].map(|a| axis(a).min().expect("some"));
        let greatest = [0, 1, 2].map(|a| axis(a).max().expect("some"));
        assert_eq!(writer.bounds, [least, greatest]);
    }

    proptest! {
        #[test]
        fn any_vertices_come_back(words in prop::collection::vec(any::<[u16; WORDS]>(), 1..600), mask: u16) {
            let vertices: Vec<WireVertex> = words.iter().map(|w| bytemuck::cast(w.map(|word| word & mask))).collect();
            let mut writer = VertexWriter::default();
            writer.write(&vertices, &(0..vertices.len() as u32).collect::<Vec<_>>());
            prop_assert_eq!(decoded(writer.payload(), vertices.len()), vertices);
        }
    }
}
