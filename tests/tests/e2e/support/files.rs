//! Readers of the exported files, each by its format's own specification.

use std::collections::HashMap;

use serde_json::Value;

/// A mesh as a file holds it.
#[derive(Debug)]
pub struct FileMesh {
    /// As the file places them: world units; of GLB metres, the second axis up.
    pub positions: Vec<[f64; 3]>,
    pub triangles: Vec<[u32; 3]>,
}

impl FileMesh {
    /// Low and high corner.
    pub fn extent(&self) -> [[f64; 3]; 2] {
        let mut extent = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
        for position in &self.positions {
            for axis in 0..3 {
                extent[0][axis] = extent[0][axis].min(position[axis]);
                extent[1][axis] = extent[1][axis].max(position[axis]);
            }
        }
        extent
    }

    #[track_caller]
    fn checked(self) -> Self {
        let count = self.positions.len() as u32;
        assert!(
            self.triangles.iter().flatten().all(|&index| index < count),
            "an index past {count} vertices"
        );
        assert!(
            self.positions.iter().flatten().all(|v| v.is_finite()),
            "a position that is not finite"
        );
        self
    }
}

/// Reads a file by the ending of its name.
#[track_caller]
pub fn read(format: &str, bytes: &[u8]) -> FileMesh {
    match format {
        "glb" => glb(bytes),
        "ply" => ply(bytes),
        "stl" => stl(bytes),
        "vtp" => vtp(bytes),
        "obj" => obj(bytes),
        other => panic!("no reader for {other}"),
    }
    .checked()
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"))
}

fn f32_at(bytes: &[u8], at: usize) -> f64 {
    f32::from_bits(u32_at(bytes, at)).into()
}

fn f64_at(bytes: &[u8], at: usize) -> f64 {
    f64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight bytes"))
}

/// glTF 2.0 in its binary container. Every triangle of every mesh, placed by its only node.
fn glb(bytes: &[u8]) -> FileMesh {
    assert_eq!(
        (&bytes[..4], u32_at(bytes, 4)),
        (b"glTF".as_slice(), 2),
        "magic and version"
    );
    assert_eq!(u32_at(bytes, 8) as usize, bytes.len(), "length in the header");
    let json_bytes = u32_at(bytes, 12) as usize;
    assert_eq!(&bytes[16..20], b"JSON");
    let gltf: Value = serde_json::from_slice(&bytes[20..20 + json_bytes]).expect("the JSON chunk");
    let binary = &bytes[20 + json_bytes..];
    assert_eq!(&binary[4..8], b"BIN\0");
    let binary = &binary[8..8 + u32_at(binary, 0) as usize];

    let integer = |value: &Value| value.as_u64().expect("a count") as usize;
    let place = |accessor: usize| {
        let accessor = &gltf["accessors"][accessor];
        let view = &gltf["bufferViews"][integer(&accessor["bufferView"])];
        let offset = |value: &Value| value["byteOffset"].as_u64().unwrap_or(0) as usize;
        let stride = view["byteStride"].as_u64().map(|stride| stride as usize);
        (
            offset(view) + offset(accessor),
            stride,
            integer(&accessor["count"]),
            integer(&accessor["componentType"]),
        )
    };
    let mut mesh = FileMesh {
        positions: Vec::new(),
        triangles: Vec::new(),
    };
    // primitives may share their vertices
    let mut bases = HashMap::new();
    let nodes = gltf["nodes"].as_array().expect("nodes");
    assert_eq!(nodes.len(), 1, "nodes");
    for primitive in gltf["meshes"]
        .as_array()
        .expect("meshes")
        .iter()
        .flat_map(|m| m["primitives"].as_array().expect("primitives"))
    {
        assert_eq!(primitive["mode"].as_u64().unwrap_or(4), 4, "triangles");
        let accessor = integer(&primitive["attributes"]["POSITION"]);
        let base = *bases.entry(accessor).or_insert_with(|| {
            let base = mesh.positions.len() as u32;
            let (start, stride, count, component) = place(accessor);
            assert_eq!(component, 5126, "positions are floats");
            let stride = stride.unwrap_or(12);
            mesh.positions
                .extend((0..count).map(|i| [0, 4, 8].map(|part| f32_at(binary, start + i * stride + part))));
            base
        });
        let (start, _, count, component) = place(integer(&primitive["indices"]));
        let index = |i: usize| match component {
            5125 => u32_at(binary, start + 4 * i),
            5123 => u32::from(u16::from_le_bytes([binary[start + 2 * i], binary[start + 2 * i + 1]])),
            other => panic!("indices of component type {other}"),
        };
        mesh.triangles
            .extend((0..count / 3).map(|t| [0, 1, 2].map(|corner| base + index(3 * t + corner))));
    }
    for position in &mut mesh.positions {
        *position = placed(&nodes[0], *position);
    }
    mesh
}

/// Applies a node's transform to a position: scaled, then turned by its quaternion, then moved.
fn placed(node: &Value, position: [f64; 3]) -> [f64; 3] {
    assert!(node.get("matrix").is_none());
    let numbers = |key: &str| -> Vec<f64> { serde_json::from_value(node[key].clone()).expect(key) };
    let (turn, scale, moved) = (numbers("rotation"), numbers("scale"), numbers("translation"));
    let [x, y, z] = [0, 1, 2].map(|i| position[i] * scale[i]);
    // v + 2 q × (q × v + w v)
    let (q, w, v) = ([turn[0], turn[1], turn[2]], turn[3], [x, y, z]);
    let cross =
        |a: [f64; 3], b: [f64; 3]| [0, 1, 2].map(|i| a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3]);
    let inner = cross(q, v);
    let outer = cross(q, [0, 1, 2].map(|i| inner[i] + w * v[i]));
    [0, 1, 2].map(|i| v[i] + 2.0 * outer[i] + moved[i])
}

/// VTK's XML `PolyData`: arrays appended as raw bytes behind their lengths of 64 bits; positions have 64 bits, indices 32.
fn vtp(bytes: &[u8]) -> FileMesh {
    let mark = b"<AppendedData encoding=\"raw\">\n_";
    let end = bytes
        .windows(mark.len())
        .position(|window| window == mark)
        .expect("appended data");
    let header = std::str::from_utf8(&bytes[..end]).expect("XML");
    let array = |name: &str| {
        let (_, tag) = header.split_once(&format!("Name=\"{name}\"")).expect(name);
        let (_, offset) = tag.split_once("offset=\"").expect("an offset");
        let offset: usize = offset.split('"').next().expect("a value").parse().expect("a number");
        let at = end + mark.len() + offset;
        let length = u64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight bytes")) as usize;
        &bytes[at + 8..at + 8 + length]
    };
    let corner = |part: &[u8]| u32_at(part, 0);
    let corners: Vec<u32> = array("connectivity").chunks_exact(4).map(corner).collect();
    let ends: Vec<u32> = array("offsets").chunks_exact(4).map(corner).collect();
    assert!(
        ends.iter().enumerate().all(|(i, &end)| end as usize == 3 * (i + 1)),
        "triangles"
    );
    FileMesh {
        positions: array("Points")
            .chunks_exact(24)
            .map(|point| [0, 8, 16].map(|part| f64_at(point, part)))
            .collect(),
        triangles: corners.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
    }
}

/// Wavefront OBJ: vertices and triangles, whose corners are numbered from 1.
fn obj(bytes: &[u8]) -> FileMesh {
    let text = std::str::from_utf8(bytes).expect("text");
    let rows = |word: &'static str| text.lines().filter_map(move |line| line.strip_prefix(word));
    let position = |row: &str| {
        let mut numbers = row.split_whitespace().map(|number| number.parse().expect("a number"));
        std::array::from_fn(|_| numbers.next().expect("three numbers"))
    };
    let corner = |text: &str| {
        text.split('/')
            .next()
            .expect("a number")
            .parse::<u32>()
            .expect("a number")
            - 1
    };
    let triangle = |row: &str| {
        let corners: Vec<u32> = row.split_whitespace().map(corner).collect();
        corners.try_into().expect("three corners")
    };
    FileMesh {
        positions: rows("v ").map(position).collect(),
        triangles: rows("f ").map(triangle).collect(),
    }
}

/// PLY 1.0, binary little-endian: `x y z` in 64 bits first among a vertex' properties, lists of three indices.
fn ply(bytes: &[u8]) -> FileMesh {
    let end = b"end_header\n";
    let header_bytes = bytes
        .windows(end.len())
        .position(|window| window == end)
        .expect("a header")
        + end.len();
    let header = std::str::from_utf8(&bytes[..header_bytes]).expect("an ASCII header");
    let mut lines = header.lines();
    assert_eq!(
        (lines.next(), lines.next()),
        (Some("ply"), Some("format binary_little_endian 1.0"))
    );
    let (mut vertices, mut faces, mut element) = (0, 0, String::new());
    let mut vertex_properties: Vec<(usize, String)> = Vec::new();
    let mut list = None;
    let width = |kind: &str| match kind {
        "char" | "uchar" | "int8" | "uint8" => 1,
        "short" | "ushort" | "int16" | "uint16" => 2,
        "int" | "uint" | "float" | "int32" | "uint32" | "float32" => 4,
        "double" | "float64" => 8,
        other => panic!("property of type {other}"),
    };
    let mut face_bytes_after_list = 0;
    for line in lines {
        match line.split_whitespace().collect::<Vec<_>>()[..] {
            ["element", name, count] => {
                element = name.to_owned();
                let count = count.parse().expect("a count");
                match name {
                    "vertex" => vertices = count,
                    "face" => faces = count,
                    other => panic!("element {other}"),
                }
            }
            ["property", "list", length, kind, _] => list = Some((width(length), width(kind))),
            ["property", kind, name] if element == "vertex" => vertex_properties.push((width(kind), name.to_owned())),
            ["property", kind, _] => face_bytes_after_list += width(kind),
            _ => {}
        }
    }
    let names: Vec<&str> = vertex_properties
        .iter()
        .take(3)
        .map(|(_, name)| name.as_str())
        .collect();
    assert_eq!(names, ["x", "y", "z"]);
    assert!(
        vertex_properties.iter().take(3).all(|&(width, _)| width == 8),
        "positions are doubles"
    );
    assert_eq!(list, Some((1, 4)), "faces are lists of int, their length a uchar");
    let stride: usize = vertex_properties.iter().map(|(width, _)| width).sum();
    let body = &bytes[header_bytes..];
    let positions = (0..vertices)
        .map(|i| [0, 8, 16].map(|part| f64_at(body, i * stride + part)))
        .collect();
    let face = 1 + 12 + face_bytes_after_list;
    let body = &body[vertices * stride..];
    assert_eq!(body.len(), faces * face, "bytes of {faces} triangles");
    let triangle = |body: &[u8]| {
        assert_eq!(body[0], 3, "corners of a face");
        [1, 5, 9].map(|part| u32_at(body, part))
    };
    FileMesh {
        positions,
        triangles: body.chunks_exact(face).map(triangle).collect(),
    }
}

/// Binary STL: three corners a triangle, nothing shared.
fn stl(bytes: &[u8]) -> FileMesh {
    let count = u32_at(bytes, 80) as usize;
    assert_eq!(bytes.len(), 84 + 50 * count, "bytes of {count} triangles");
    assert!(!bytes.starts_with(b"solid"), "readers would take it for text");
    let corner = |i: usize| [0, 4, 8].map(|part| f32_at(bytes, 84 + 50 * (i / 3) + 12 * (1 + i % 3) + part));
    FileMesh {
        positions: (0..3 * count).map(corner).collect(),
        triangles: (0..count as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
    }
}
