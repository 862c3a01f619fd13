//! Mesh chunks: section 4 of the protocol.

mod predictive;

use std::ops::Range;

/// Length of the header.
pub(crate) const HEADER: usize = 96;
/// Lattice units per cell.
pub const LATTICE: i32 = 64;
/// Cells per axis of a region.
const REGION: i32 = 32;
/// Bytes of a vertex before encoding.
const VERTEX: usize = 12;
/// Maximum size of a region.
const MAX_SIZE: u8 = 2;
/// Maximum number of vertices and of indices.
const MAX_COUNT: usize = 627_264;
/// Limit of a region's coordinates, so that lattice positions fit in 32 bits. The protocol has no such limit.
const MAX_REGION: u32 = 1 << 19;

/// Why a frame is no chunk.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ChunkError {
    /// The frame is shorter than a header.
    #[error("{0} bytes, a header has {HEADER}")]
    Short(usize),
    /// A field has a wrong value.
    #[error("{field}: {found}, expected {expected}")]
    Field {
        /// Name of the field.
        field: &'static str,
        /// Value in the frame.
        found: String,
        /// Expected value.
        expected: String,
    },
    /// A payload cannot be decoded.
    #[error("payload: {0}")]
    Payload(String),
}

/// Names a region: an aligned cube of 32·2^`size` cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct RegionKey {
    /// Low corner in units of 32 cells, multiples of 2^`size`.
    pub coords: [u32; 3],
    /// 0 to 2.
    pub size: u8,
}

impl RegionKey {
    /// Returns the regions that contain a region of 32³ cells, the smallest first.
    pub(crate) fn around(coords: [u32; 3]) -> impl Iterator<Item = Self> {
        (0..=MAX_SIZE).map(move |size| Self {
            coords: coords.map(|c| c >> size << size),
            size,
        })
    }

    /// Returns the larger regions that contain this one.
    pub(crate) fn larger(self) -> impl Iterator<Item = Self> {
        Self::around(self.coords).filter(move |region| region.size > self.size)
    }
}

/// A decoded chunk of kind `cut`: the mesh of one region.
#[derive(Clone, Debug)]
pub struct Chunk {
    /// Number of the surface.
    pub surface: u8,
    /// Generation of the surface.
    pub generation: u32,
    /// Level of the prefix.
    pub prefix_level: u8,
    /// The region.
    pub region: RegionKey,
    /// Index space: min x, y, z, max x, y, z.
    pub bounds: [f32; 6],
    /// Vertices; empty if the region has no surface.
    pub vertices: Vec<Vertex>,
    /// Corners of the triangles, finest level first.
    pub triangles: Vec<[u32; 3]>,
    /// Triangles of each level, 0 first.
    pub level_triangles: [u32; 6],
    /// Bytes of the frame without values.
    pub frame_bytes: usize,
    /// Whether its coding is `predictive`.
    pub is_predictive: bool,
    /// The value of a field at each vertex, NaN if it is missing; `None` if the chunk has no values.
    pub values: Option<Vec<f32>>,
}

/// A vertex with the bits of its value, if the chunk has values.
type Corner = (Vertex, Option<u32>);

/// A decoded vertex.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Vertex {
    /// Lattice units from the region's low corner.
    pub position: [i16; 3],
    /// Octahedral, over 127.
    pub normal: [i8; 2],
    /// `s` over 65535.
    pub smoothness: u16,
    /// `f̂` over 65535.
    pub feature: u16,
}

impl Vertex {
    /// Returns the unit normal towards lower values.
    pub fn unit_normal(&self) -> [f64; 3] {
        let [x, y] = self.normal.map(|v| f64::from(v) / 127.0);
        let z = 1.0 - x.abs() - y.abs();
        let sign = |v: f64| if v < 0.0 { -1.0 } else { 1.0 };
        let (x, y) = if z < 0.0 {
            ((1.0 - y.abs()) * sign(x), (1.0 - x.abs()) * sign(y))
        } else {
            (x, y)
        };
        let length = (x * x + y * y + z * z).sqrt();
        [x / length, y / length, z / length]
    }
}

impl Chunk {
    /// Decodes a frame.
    pub fn decode(frame: &[u8]) -> Result<Self, ChunkError> {
        let header = Header::new(frame)?;
        expect("kind", header.kind(), 0)?;
        check(frame[15] <= 3, "flags", frame[15], "0 to 3")?;
        check(header.level() <= 5, "level of the prefix", header.level(), "0 to 5")?;
        let (is_predictive, has_values) = (frame[15] & 1 == 1, frame[15] & 2 == 2);
        let (vertex_count, index_count) = (header.vertex_count(), header.index_count());
        let (vertex_bytes, index_bytes) = (header.u32(64) as usize, header.u32(68) as usize);
        let payloads_end = HEADER + vertex_bytes + index_bytes;
        match has_values {
            true => check(
                frame.len() >= payloads_end + 8,
                "frame length",
                frame.len(),
                "8 bytes behind the payloads",
            )?,
            false => expect("frame length", frame.len(), payloads_end)?,
        }
        expect("index count modulo 3", index_count % 3, 0)?;
        for (field, count) in [("vertex count", vertex_count), ("index count", index_count)] {
            check(count <= MAX_COUNT, field, count, "at most 627,264")?;
        }
        let level_triangles: [u32; 6] = std::array::from_fn(|level| header.u32(72 + 4 * level));
        let sum = level_triangles.iter().map(|&n| n as usize).sum::<usize>();
        expect("sum of the triangles of each level", sum, index_count / 3)?;
        if vertex_count == 0 {
            expect(
                "payload of an empty chunk",
                (vertex_bytes, index_bytes, index_count, has_values),
                (0, 0, 0, false),
            )?;
        }

        let (vertex_payload, index_payload) = frame[HEADER..payloads_end].split_at(vertex_bytes);
        let values = has_values
            .then(|| decode_values(&frame[payloads_end..], vertex_count))
            .transpose()?;
        let (vertices, triangles) = if is_predictive {
            expect("index payload of the coding predictive", index_bytes, 0)?;
            let mesh =
                predictive::decode(vertex_payload, vertex_count, index_count / 3).map_err(ChunkError::Payload)?;
            expect("levels", mesh.levels, level_triangles)?;
            (mesh.vertices, mesh.triangles)
        } else {
            let vertices = decode_vertices(vertex_payload, vertex_count)?;
            (vertices, decode_triangles(index_payload, index_count)?)
        };
        let vertices_used = triangles.iter().flatten().max().map_or(0, |&index| index as usize + 1);
        check(
            vertices_used <= vertex_count,
            "indices",
            vertices_used,
            "at most the vertex count",
        )?;
        let chunk = Self {
            surface: header.surface(),
            generation: header.generation(),
            prefix_level: header.level(),
            region: header.region(),
            bounds: std::array::from_fn(|i| f32::from_bits(header.u32(32 + 4 * i))),
            vertices,
            triangles,
            level_triangles,
            frame_bytes: payloads_end,
            is_predictive,
            values,
        };
        chunk.check_bounds()?;
        Ok(chunk)
    }

    /// Checks that the bounds are the bounding box of the vertices, within half a lattice unit of rounding.
    fn check_bounds(&self) -> Result<(), ChunkError> {
        let mut expected = [f64::INFINITY, f64::NEG_INFINITY].map(|end| [end; 3]);
        for vertex in 0..self.vertices.len() as u32 {
            for (axis, value) in self.position(vertex).into_iter().enumerate() {
                expected[0][axis] = expected[0][axis].min(value);
                expected[1][axis] = expected[1][axis].max(value);
            }
        }
        if self.vertices.is_empty() {
            expected = [[0.0; 3]; 2];
        }
        let mut ends = self.bounds.into_iter().zip(expected.as_flattened());
        let is_close =
            |(found, expected): (f32, &f64)| (f64::from(found) - expected).abs() <= 0.51 / f64::from(LATTICE);
        check(
            ends.all(is_close),
            "bounds",
            format!("{:?}", self.bounds),
            format!("{expected:?}"),
        )
    }

    /// Returns the position of a vertex on the lattice of the whole volume: equal numbers are the same point in all regions. Panics
    /// beyond the last vertex.
    pub fn lattice(&self, vertex: u32) -> [i32; 3] {
        let position = self.vertices[vertex as usize].position;
        std::array::from_fn(|axis| self.region.coords[axis] as i32 * REGION * LATTICE + i32::from(position[axis]))
    }

    /// Returns the position of a vertex in index space. Panics beyond the last vertex.
    pub fn position(&self, vertex: u32) -> [f64; 3] {
        self.lattice(vertex).map(|v| f64::from(v) / f64::from(LATTICE))
    }

    /// Returns the range of the triangles of a level, 0 to 5.
    pub fn triangles_of_level(&self, level: usize) -> Range<usize> {
        let start = self.level_triangles[..level].iter().sum::<u32>() as usize;
        start..start + self.level_triangles[level] as usize
    }

    /// Returns whether two chunks have the same mesh and the same values, regardless of generation, prefix and the order of triangles.
    pub fn same_mesh(&self, other: &Self) -> bool {
        self.sorted() == other.sorted()
    }

    /// Level and corners of all triangles, the lowest corner first. A corner has the bits of its value.
    fn sorted(&self) -> Vec<(usize, [Corner; 3])> {
        let value = |index: u32| self.values.as_ref().map(|values| values[index as usize].to_bits());
        let of_level = |level| {
            self.triangles[self.triangles_of_level(level)]
                .iter()
                .map(move |t| (level, *t))
        };
        let mut sorted: Vec<_> = (0..6)
            .flat_map(of_level)
            .map(|(level, [a, b, c])| {
                let turned = [[a, b, c], [b, c, a], [c, a, b]];
                let corners = turned.map(|turned| turned.map(|index| (self.vertices[index as usize], value(index))));
                (level, corners.into_iter().min().unwrap_or(corners[0]))
            })
            .collect();
        sorted.sort_unstable();
        sorted
    }
}

fn decode_vertices(payload: &[u8], count: usize) -> Result<Vec<Vertex>, ChunkError> {
    if count == 0 {
        return Ok(Vec::new());
    }
    let version = meshopt::decode_vertex_version(payload);
    expect("version of the vertex codec", version, Some(1))?;
    let raw: Vec<[u8; VERTEX]> =
        meshopt::decode_vertex_buffer(payload, count).map_err(|error| ChunkError::Payload(error.to_string()))?;
    let u16_at = |raw: &[u8; VERTEX], at: usize| u16::from_le_bytes([raw[at], raw[at + 1]]);
    let vertex = |raw: &[u8; VERTEX]| Vertex {
        position: [0, 2, 4].map(|at| u16_at(raw, at) as i16),
        normal: [raw[6] as i8, raw[7] as i8],
        smoothness: u16_at(raw, 8),
        feature: u16_at(raw, 10),
    };
    Ok(raw.iter().map(vertex).collect())
}

/// Decodes the values of a field at the vertices.
fn decode_values(bytes: &[u8], count: usize) -> Result<Vec<f32>, ChunkError> {
    let (range, payload) = bytes.split_at(8);
    let end = |at: usize| f32::from_le_bytes([0, 1, 2, 3].map(|i| range[at + i]));
    let (low, high) = (end(0), end(4));
    check(
        low.is_finite() && high.is_finite() && low <= high,
        "range of the values",
        format!("{low} to {high}"),
        "finite numbers in ascending order",
    )?;
    let words: Vec<[u8; 4]> =
        meshopt::decode_vertex_buffer(payload, count).map_err(|error| ChunkError::Payload(error.to_string()))?;
    let value = |word: &[u8; 4]| {
        expect("second half of a value", [word[2], word[3]], [0, 0])?;
        Ok(match u16::from_le_bytes([word[0], word[1]]) {
            u16::MAX => f32::NAN,
            step => (f64::from(low) + f64::from(step) * (f64::from(high) - f64::from(low)) / 65534.0) as f32,
        })
    };
    words.iter().map(value).collect()
}

fn decode_triangles(payload: &[u8], index_count: usize) -> Result<Vec<[u32; 3]>, ChunkError> {
    if index_count == 0 {
        return Ok(Vec::new());
    }
    let indices: Vec<u32> =
        meshopt::decode_index_buffer(payload, index_count).map_err(|error| ChunkError::Payload(error.to_string()))?;
    Ok(indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect())
}

fn check(
    condition: bool,
    field: &'static str,
    found: impl ToString,
    expected: impl ToString,
) -> Result<(), ChunkError> {
    if condition {
        return Ok(());
    }
    Err(ChunkError::Field {
        field,
        found: found.to_string(),
        expected: expected.to_string(),
    })
}

fn expect<T: PartialEq + std::fmt::Debug>(field: &'static str, found: T, expected: T) -> Result<(), ChunkError> {
    let is_equal = found == expected;
    check(is_equal, field, format!("{found:?}"), format!("{expected:?}"))
}

/// Header of a frame: the fields that chunks of both kinds have.
#[derive(Clone, Copy)]
pub(crate) struct Header<'a>(&'a [u8]);

impl<'a> Header<'a> {
    /// Checks length, magic, version, surface, region with its size, and the constant fields.
    pub fn new(frame: &'a [u8]) -> Result<Self, ChunkError> {
        if frame.len() < HEADER {
            return Err(ChunkError::Short(frame.len()));
        }
        let header = Self(frame);
        expect("magic", &frame[0..4], b"ISOP".as_slice())?;
        expect("version", header.u16(4), 3)?;
        expect("header length", usize::from(header.u16(6)), HEADER)?;
        expect("lattice units per cell", i32::from(header.u16(16)), LATTICE)?;
        let size = header.u16(18);
        check(size <= u16::from(MAX_SIZE), "size of the region", size, "0 to 2")?;
        check(header.surface() <= 3, "surface", header.surface(), "0 to 3")?;
        let coords = header.region().coords;
        let is_near = coords.iter().all(|&c| c < MAX_REGION);
        check(is_near, "region", format!("{coords:?}"), "below 524,288")?;
        let is_aligned = coords.iter().all(|&c| c % (1 << size) == 0);
        check(
            is_aligned,
            "region",
            format!("{coords:?}"),
            format!("multiples of {}", 1 << size),
        )?;
        Ok(header)
    }

    pub fn generation(self) -> u32 {
        self.u32(8)
    }

    pub fn level(self) -> u8 {
        self.0[12]
    }

    /// 0 `cut`, 1 `error`.
    pub fn kind(self) -> u8 {
        self.0[13]
    }

    pub fn surface(self) -> u8 {
        self.0[14]
    }

    pub fn region(self) -> RegionKey {
        RegionKey {
            coords: [20, 24, 28].map(|at| self.u32(at)),
            size: self.0[18],
        }
    }

    pub fn vertex_count(self) -> usize {
        self.u32(56) as usize
    }

    pub fn index_count(self) -> usize {
        self.u32(60) as usize
    }

    fn u16(self, at: usize) -> u16 {
        u16::from_le_bytes([self.0[at], self.0[at + 1]])
    }

    pub fn u32(self, at: usize) -> u32 {
        u32::from_le_bytes([0, 1, 2, 3].map(|i| self.0[at + i]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A frame of `vertices` vertices and 12 triangles of level 0, with an arbitrary payload.
    fn frame(coding: u8, vertices: u32, payload: &[u8]) -> Vec<u8> {
        let mut frame = vec![0; HEADER];
        frame[..8].copy_from_slice(b"ISOP\x03\0\x60\0");
        frame[15] = coding;
        frame[16] = 64;
        let index_bytes = if coding == 1 { 0 } else { payload.len() / 2 };
        let counts = [(56, vertices), (60, 36), (72, 12)];
        let bytes = [(64, payload.len() - index_bytes), (68, index_bytes)];
        for (at, value) in counts.into_iter().chain(bytes.map(|(at, n)| (at, n as u32))) {
            frame[at..at + 4].copy_from_slice(&value.to_le_bytes());
        }
        [&frame, payload].concat()
    }

    #[test]
    fn a_region_has_a_size_and_is_aligned() {
        let mut gone = vec![0; HEADER];
        gone[..8].copy_from_slice(b"ISOP\x03\0\x60\0");
        gone[16] = 64;
        let mut decode = |bytes: [(usize, u8); 4]| {
            bytes.into_iter().for_each(|(at, value)| gone[at] = value);
            Chunk::decode(&gone)
        };
        let chunk = decode([(18, 2), (20, 4), (24, 0), (28, 8)]).expect("a chunk");
        let region = RegionKey {
            coords: [4, 0, 8],
            size: 2,
        };
        assert_eq!(chunk.region, region);
        let around: Vec<_> = RegionKey::around([5, 3, 8]).collect();
        assert_eq!(around[2], region);
        assert_eq!(around[1].larger().collect::<Vec<_>>(), [region]);
        let size = decode([(18, 3), (20, 4), (24, 0), (28, 8)])
            .expect_err("too large")
            .to_string();
        assert_eq!(size, "size of the region: 3, expected 0 to 2");
        let size = decode([(18, 0), (19, 1), (24, 0), (28, 8)])
            .expect_err("too large")
            .to_string();
        assert_eq!(size, "size of the region: 256, expected 0 to 2");
        let place = decode([(18, 2), (19, 0), (24, 2), (28, 8)])
            .expect_err("not aligned")
            .to_string();
        assert_eq!(place, "region: [4, 2, 8], expected multiples of 4");
    }

    #[test]
    fn arbitrary_payloads_are_errors_and_cause_no_panic() {
        let mut state = 1u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            state >> 24
        };
        for n in 0..20_000 {
            let payload: Vec<u8> = (0..random()).map(|_| random() as u8).collect();
            let frame = frame((n % 2) as u8, random(), &payload);
            let decoded = Chunk::decode(&frame);
            assert!(matches!(
                decoded,
                Err(ChunkError::Payload(_) | ChunkError::Field { .. })
            ));
            let cut = &frame[..frame.len() - payload.len() / 2 - 1];
            assert!(Chunk::decode(cut).is_err());
        }
    }
}
