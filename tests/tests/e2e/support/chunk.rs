//! Mesh chunks, read by `server/PROTOCOL.md` section 4 alone: nothing here uses the server's code.

use std::ops::Range;

use super::predictive;

/// Length of the header.
pub const HEADER: usize = 96;
/// Lattice units per cell.
pub const LATTICE: i32 = 64;
/// Cells per axis of a region.
pub const REGION: i32 = 32;
/// Bytes of a vertex before encoding.
const VERTEX: usize = 12;

/// A decoded chunk: the mesh of one region.
#[derive(Clone, Debug, PartialEq)]
pub struct Chunk {
    pub surface: u8,
    pub generation: u32,
    pub prefix_level: u8,
    pub region: [u32; 3],
    /// Index space: min x, y, z, max x, y, z.
    pub bounds: [f32; 6],
    pub vertices: Vec<Vertex>,
    pub triangles: Vec<[u32; 3]>,
    /// Triangles of each level, 0 first.
    pub level_triangles: [u32; 6],
    /// Bytes of the whole frame.
    pub frame_bytes: usize,
    /// Whether its coding is that for slow lines.
    pub is_predictive: bool,
}

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
    /// Unit normal towards lower values.
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
    /// Reads a frame. A violation of `server/PROTOCOL.md` is an error that names the field.
    pub fn decode(frame: &[u8]) -> Result<Self, String> {
        if frame.len() < HEADER {
            return Err(format!("frame: {} bytes, a header has {HEADER}", frame.len()));
        }
        let header = Header(frame);
        expect("magic", &frame[0..4], b"ISOP".as_slice())?;
        expect("version", header.u16(4), 2)?;
        expect("header length", usize::from(header.u16(6)), HEADER)?;
        expect("kind", frame[13], 0)?;
        if frame[14] > 3 {
            return Err(format!("surface: {}, expected 0 to 3", frame[14]));
        }
        if frame[15] > 1 {
            return Err(format!("flags: {}, expected 0 or 1", frame[15]));
        }
        let is_predictive = frame[15] == 1;
        expect("lattice units per cell", i32::from(header.u16(16)), LATTICE)?;
        expect("bytes 18 and 19", header.u16(18), 0)?;
        let prefix_level = frame[12];
        if prefix_level > 5 {
            return Err(format!("level of the prefix: {prefix_level}, expected 0 to 5"));
        }
        let (vertex_count, index_count) = (header.u32(56) as usize, header.u32(60) as usize);
        let (vertex_bytes, index_bytes) = (header.u32(64) as usize, header.u32(68) as usize);
        expect("frame length", frame.len(), HEADER + vertex_bytes + index_bytes)?;
        expect("index count modulo 3", index_count % 3, 0)?;
        let level_triangles: [u32; 6] = std::array::from_fn(|level| header.u32(72 + 4 * level));
        let sum = level_triangles.iter().map(|&n| n as usize).sum::<usize>();
        expect("sum of the triangles of each level", sum, index_count / 3)?;
        if vertex_count == 0 {
            expect(
                "payload of an empty chunk",
                (vertex_bytes, index_bytes, index_count),
                (0, 0, 0),
            )?;
        }

        let (vertex_payload, index_payload) = frame[HEADER..].split_at(vertex_bytes);
        let (vertices, triangles) = if is_predictive {
            expect("index payload of the coding predictive", index_bytes, 0)?;
            let mesh = predictive::decode(vertex_payload, vertex_count, index_count / 3)?;
            expect("levels", mesh.levels, level_triangles)?;
            (mesh.vertices, mesh.triangles)
        } else {
            let vertices = decode_vertices(vertex_payload, vertex_count)?;
            (vertices, decode_triangles(index_payload, index_count)?)
        };
        if let Some(index) = triangles
            .iter()
            .flatten()
            .find(|&&index| index as usize >= vertex_count)
        {
            return Err(format!("index {index} of {vertex_count} vertices"));
        }
        Ok(Self {
            surface: frame[14],
            generation: header.u32(8),
            prefix_level,
            region: std::array::from_fn(|axis| header.u32(20 + 4 * axis)),
            bounds: std::array::from_fn(|i| header.f32(32 + 4 * i)),
            vertices,
            triangles,
            level_triangles,
            frame_bytes: frame.len(),
            is_predictive,
        })
    }

    /// Position on the lattice of the whole volume: equal numbers are the same point in all regions.
    pub fn lattice(&self, vertex: u32) -> [i32; 3] {
        let position = self.vertices[vertex as usize].position;
        std::array::from_fn(|axis| self.region[axis] as i32 * REGION * LATTICE + i32::from(position[axis]))
    }

    /// Position in index space.
    pub fn position(&self, vertex: u32) -> [f64; 3] {
        self.lattice(vertex).map(|v| f64::from(v) / f64::from(LATTICE))
    }

    /// Which triangles belong to a level.
    pub fn triangles_of_level(&self, level: usize) -> Range<usize> {
        let start = self.level_triangles[..level].iter().sum::<u32>() as usize;
        start..start + self.level_triangles[level] as usize
    }

    /// Whether two chunks have the same mesh, regardless of generation, prefix and the order of triangles.
    pub fn same_mesh(&self, other: &Self) -> bool {
        self.sorted() == other.sorted()
    }

    /// Level and corners of all triangles, the lowest corner first.
    fn sorted(&self) -> Vec<(usize, [Vertex; 3])> {
        let of_level = |level| {
            self.triangles[self.triangles_of_level(level)]
                .iter()
                .map(move |t| (level, *t))
        };
        let mut sorted: Vec<_> = (0..6)
            .flat_map(of_level)
            .map(|(level, [a, b, c])| {
                let turned = [[a, b, c], [b, c, a], [c, a, b]];
                let corners = turned.map(|turned| turned.map(|index| self.vertices[index as usize]));
                (level, corners.into_iter().min().unwrap_or(corners[0]))
            })
            .collect();
        sorted.sort_unstable();
        sorted
    }
}

fn decode_vertices(payload: &[u8], count: usize) -> Result<Vec<Vertex>, String> {
    if count == 0 {
        return Ok(Vec::new());
    }
    expect(
        "version of the vertex codec",
        meshopt::decode_vertex_version(payload),
        Some(1),
    )?;
    let raw: Vec<[u8; VERTEX]> =
        meshopt::decode_vertex_buffer(payload, count).map_err(|e| format!("vertex payload: {e}"))?;
    let u16_at = |raw: &[u8; VERTEX], at: usize| u16::from_le_bytes([raw[at], raw[at + 1]]);
    let vertex = |raw: &[u8; VERTEX]| Vertex {
        position: [0, 2, 4].map(|at| u16_at(raw, at) as i16),
        normal: [raw[6] as i8, raw[7] as i8],
        smoothness: u16_at(raw, 8),
        feature: u16_at(raw, 10),
    };
    Ok(raw.iter().map(vertex).collect())
}

fn decode_triangles(payload: &[u8], index_count: usize) -> Result<Vec<[u32; 3]>, String> {
    if index_count == 0 {
        return Ok(Vec::new());
    }
    let indices: Vec<u32> =
        meshopt::decode_index_buffer(payload, index_count).map_err(|e| format!("index payload: {e}"))?;
    Ok(indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect())
}

fn expect<T: PartialEq + std::fmt::Debug>(field: &str, found: T, expected: T) -> Result<(), String> {
    if found == expected {
        Ok(())
    } else {
        Err(format!("{field}: {found:?}, expected {expected:?}"))
    }
}

/// Little-endian fields of a header that is long enough.
struct Header<'a>(&'a [u8]);

impl Header<'_> {
    fn u16(&self, at: usize) -> u16 {
        u16::from_le_bytes([self.0[at], self.0[at + 1]])
    }

    fn u32(&self, at: usize) -> u32 {
        u32::from_le_bytes([self.0[at], self.0[at + 1], self.0[at + 2], self.0[at + 3]])
    }

    fn f32(&self, at: usize) -> f32 {
        f32::from_bits(self.u32(at))
    }
}
