//! GLB, the binary form of glTF 2.0.
//!
//! A file has a node, a mesh and a material for each surface. A mesh has only one primitive, because loaders do not share vertices between
//! primitives, so that several primitives would tear the surface at the borders between levels. Triangles are ordered by level, finest
//! first; `extras.levelTriangles` has the number of triangles of each level.
//!
//! Positions are relative to the origin of the mesh, along the axes of the volume's frame. The transform of the node converts them to
//! metres with Y up, as glTF requires, and adds the origin. A file of an empty surface has a scene without nodes.

pub mod packed;

use std::io::Write;

use isopeel_volumes::LengthUnit;
use serde_json::{Value, json};

use super::mesh::{FieldValues, Material, attribute_names, linear};
use super::rows::write_rows;
use super::{ExportError, Mesh, fits_u32};

const MAGIC: &[u8; 4] = b"glTF";
const VERSION: u32 = 2;
const JSON_CHUNK: &[u8; 4] = b"JSON";
const BINARY_CHUNK: &[u8; 4] = b"BIN\0";

/// Value of missing values of fields, because glTF does not allow NaN.
const MISSING: f32 = f32::MIN;

// Constants of the glTF specification (those of WebGL).
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const UNSIGNED_SHORT: u32 = 5123;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;
const TRIANGLES: u32 = 4;

/// Writes `meshes` with `extras` in `asset.extras`. The attributes are `POSITION`, `NORMAL`, `_SMOOTHNESS` and `_FEATURE` (0 to 1), one for
/// each field, such as `_TEMPERATURE`, and `COLOR_0` if the mesh has colours.
///
/// # Errors
/// The file would exceed the 4 GiB of a GLB, or `out` fails.
pub fn write(meshes: &[Mesh], extras: &Value, out: &mut dyn Write) -> Result<(), ExportError> {
    let mut buffer = Buffer::default();
    let primitives = (0..)
        .zip(non_empty(meshes))
        .map(|(i, mesh)| primitive(mesh, i, &mut buffer))
        .collect();
    let nodes = (0..)
        .zip(non_empty(meshes))
        .map(|(i, mesh)| node_at(mesh, i, mesh.origin, 1.0))
        .collect();
    let materials = non_empty(meshes).map(material).collect();
    let mut json = document(meshes, extras, primitives, nodes, materials);
    if buffer.bytes > 0 {
        json["accessors"] = buffer.accessors.into();
        json["bufferViews"] = buffer.views.into();
        json["buffers"] = json!([{ "byteLength": buffer.bytes }]);
    }
    write_chunks(&json, buffer.bytes, out)?;
    non_empty(meshes).try_for_each(|mesh| write_arrays(mesh, out))
}

/// Writes the header, the JSON chunk, and the header of a binary chunk with `binary_bytes` bytes.
fn write_chunks(json: &Value, binary_bytes: u64, out: &mut dyn Write) -> Result<(), ExportError> {
    let mut text = serde_json::to_vec(json).map_err(std::io::Error::from)?;
    text.resize(text.len().next_multiple_of(4), b' ');
    let binary_chunk = if binary_bytes > 0 { 8 + binary_bytes } else { 0 };
    let total = 12 + 8 + text.len() as u64 + binary_chunk;
    let total = fits_u32("file size in bytes", total, "GLB")?;

    out.write_all(MAGIC)?;
    out.write_all(&VERSION.to_le_bytes())?;
    out.write_all(&total.to_le_bytes())?;
    out.write_all(&(text.len() as u32).to_le_bytes())?;
    out.write_all(JSON_CHUNK)?;
    out.write_all(&text)?;
    if binary_bytes > 0 {
        out.write_all(&(binary_bytes as u32).to_le_bytes())?;
        out.write_all(BINARY_CHUNK)?;
    }
    Ok(())
}

/// Returns the meshes that have triangles.
fn non_empty(meshes: &[Mesh]) -> impl Iterator<Item = &Mesh> {
    meshes.iter().filter(|mesh| !mesh.triangles.is_empty())
}

/// Writes the arrays of a mesh in the order of their buffer views.
fn write_arrays(mesh: &Mesh, out: &mut dyn Write) -> Result<(), ExportError> {
    out.write_all(bytemuck::cast_slice(&mesh.positions))?;
    out.write_all(bytemuck::cast_slice(&mesh.normals))?;
    out.write_all(bytemuck::cast_slice(&mesh.smoothness))?;
    out.write_all(bytemuck::cast_slice(&mesh.feature))?;
    for field in &mesh.fields {
        write_rows(field.values.len(), out, |vertex, bytes| {
            let value = field.values[vertex];
            let value = if value.is_finite() { value } else { MISSING };
            bytes.extend_from_slice(&value.to_le_bytes());
        })?;
    }
    write_rows(mesh.colors.len(), out, |vertex, bytes| {
        let [r, g, b] = mesh.colors[vertex];
        // Adds an alpha of 1, because the size of an attribute must be a multiple of four bytes.
        bytes.extend_from_slice(bytemuck::bytes_of(&[r, g, b, u16::MAX]));
    })?;
    out.write_all(bytemuck::cast_slice(&mesh.triangles))?;
    Ok(())
}

/// Returns the JSON of a file without buffers, buffer views and accessors. Without primitives, the scene has no nodes.
fn document(
    meshes: &[Mesh],
    extras: &Value,
    primitives: Vec<Value>,
    nodes: Vec<Value>,
    materials: Vec<Value>,
) -> Value {
    let asset = json!({
        "version": "2.0",
        "generator": concat!("isopeel ", env!("CARGO_PKG_VERSION")),
        "extras": extras,
    });
    if primitives.is_empty() {
        return json!({ "asset": asset, "scene": 0, "scenes": [{ "name": "empty isosurface" }] });
    }
    let mesh_json = |(mesh, primitive): (&Mesh, Value)| json!({ "name": mesh.name, "primitives": [primitive] });
    json!({
        "asset": asset,
        "scene": 0,
        "scenes": [{ "nodes": (0..nodes.len()).collect::<Vec<_>>() }],
        "nodes": nodes,
        "meshes": non_empty(meshes).zip(primitives).map(mesh_json).collect::<Vec<_>>(),
        "materials": materials,
    })
}

/// Returns the primitive of a mesh, and adds the views and accessors of the mesh to the buffer.
fn primitive(mesh: &Mesh, material: usize, buffer: &mut Buffer) -> Value {
    let vertices = mesh.positions.len();
    let (min, max) = bounds(&mesh.positions);
    let mut attributes = serde_json::Map::new();
    let mut attribute = |name: &str, component: u32, shape: &str, bytes: usize, properties: Value| {
        let view = buffer.view(vertices * bytes, ARRAY_BUFFER);
        let accessor = buffer.accessor(view, component, shape, vertices, properties);
        attributes.insert(name.to_owned(), accessor.into());
    };
    attribute("POSITION", FLOAT, "VEC3", 12, json!({ "min": min, "max": max }));
    attribute("NORMAL", FLOAT, "VEC3", 12, json!({}));
    attribute("_SMOOTHNESS", FLOAT, "SCALAR", 4, json!({}));
    attribute("_FEATURE", FLOAT, "SCALAR", 4, json!({}));
    let names = Attributes::of(&attribute_names(mesh, "_", &["_SMOOTHNESS", "_FEATURE"]));
    for name in &names.0 {
        attribute(name, FLOAT, "SCALAR", 4, json!({}));
    }
    if !mesh.colors.is_empty() {
        attribute("COLOR_0", UNSIGNED_SHORT, "VEC4", 8, json!({ "normalized": true }));
    }
    let triangles = mesh.triangles.len();
    let indices = buffer.view(triangles * 12, ELEMENT_ARRAY_BUFFER);
    let indices = buffer.accessor(indices, UNSIGNED_INT, "SCALAR", triangles * 3, json!({}));
    json!({
        "attributes": attributes,
        "indices": indices,
        "material": material,
        "mode": TRIANGLES,
        "extras": { "levelTriangles": mesh.level_triangles, "fields": names.descriptions(mesh) },
    })
}

/// Returns the material of a mesh. States all properties, because glTF's default material is metallic and one-sided.
fn material(mesh: &Mesh) -> Value {
    let mut surface = json!({ "metallicFactor": 0.0, "roughnessFactor": 0.8 });
    let Material { color, opacity } = mesh.material;
    if color.is_some() || opacity < 1.0 {
        let [red, green, blue] = color.unwrap_or([255; 3]).map(|byte| linear(f32::from(byte) / 255.0));
        surface["baseColorFactor"] = json!([red, green, blue, opacity]);
    }
    let mut material = json!({ "name": mesh.name, "pbrMetallicRoughness": surface, "doubleSided": true });
    if opacity < 1.0 {
        material["alphaMode"] = "BLEND".into();
    }
    material
}

/// Names of the attributes of fields.
struct Attributes(Vec<String>);

impl Attributes {
    /// Converts names to upper case, as glTF requires.
    fn of(names: &[String]) -> Self {
        Self(names.iter().map(|name| name.to_ascii_uppercase()).collect())
    }

    /// Returns a description of each attribute for `extras`: field, unit, range and the value of missing ones.
    fn descriptions(&self, mesh: &Mesh) -> Vec<Value> {
        let field = |(field, attribute): (&FieldValues, &String)| {
            let present = field.values.iter().filter(|value| value.is_finite());
            let range = present.fold(None, |range: Option<[f32; 2]>, &value| {
                let [low, high] = range.unwrap_or([value; 2]);
                Some([low.min(value), high.max(value)])
            });
            json!({
                "attribute": attribute,
                "field": field.name,
                "unit": field.unit,
                "range": range,
                "missing": MISSING,
            })
        };
        mesh.fields.iter().zip(&self.0).map(field).collect()
    }
}

/// Returns the node of a mesh, whose transform converts positions to metres with Y up. In LPS, a patient's head is up and the face looks
/// along +Z, as glTF requires. A world unit is a metre if the mesh has no unit. Positions are multiples of `step`, relative to `origin`,
/// both in world units.
fn node_at(mesh: &Mesh, number: usize, origin: [f64; 3], step: f64) -> Value {
    use std::f64::consts::FRAC_1_SQRT_2;
    let metres = mesh.unit.and_then(LengthUnit::metres).unwrap_or(1.0);
    let [x, y, z] = origin.map(|component| component * metres);
    let scale = metres * step;
    json!({
        "name": mesh.name,
        "mesh": number,
        // A quarter turn about x: (x, y, z) becomes (x, z, −y).
        "rotation": [-FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2],
        "scale": [scale, scale, scale],
        "translation": [x, z, -y],
    })
}

/// Views of consecutive parts of the binary chunk, and their accessors.
#[derive(Default)]
struct Buffer {
    bytes: u64,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Buffer {
    /// Adds a view of the next `bytes` bytes, and returns its number.
    fn view(&mut self, bytes: usize, target: u32) -> usize {
        self.views.push(json!({
            "buffer": 0,
            "byteOffset": self.bytes,
            "byteLength": bytes,
            "target": target,
        }));
        self.bytes += bytes as u64;
        self.views.len() - 1
    }

    /// Adds an accessor with additional `properties`, and returns its number.
    fn accessor(&mut self, view: usize, component: u32, shape: &str, count: usize, properties: Value) -> usize {
        self.accessors.push(accessor(view, component, shape, count, properties));
        self.accessors.len() - 1
    }
}

fn accessor(view: usize, component: u32, shape: &str, count: usize, properties: Value) -> Value {
    let mut accessor = json!({
        "bufferView": view,
        "byteOffset": 0,
        "componentType": component,
        "type": shape,
        "count": count,
    });
    if let (Value::Object(accessor), Value::Object(properties)) = (&mut accessor, properties) {
        accessor.extend(properties);
    }
    accessor
}

/// Returns the minimum and maximum of each component.
fn bounds(positions: &[[f32; 3]]) -> ([f32; 3], [f32; 3]) {
    positions
        .iter()
        .fold(([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]), |(min, max), p| {
            ([0, 1, 2].map(|i| min[i].min(p[i])), [0, 1, 2].map(|i| max[i].max(p[i])))
        })
}

#[cfg(test)]
mod tests {
    use isopeel_kernels::Region;

    use super::super::mesh::tests::{geometry, surface, two_quads, vertex};
    use super::*;
    use isopeel_view::{PointJson, TransferFunctionJson};

    fn word(bytes: &[u8], at: usize) -> usize {
        u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize
    }

    /// JSON and binary chunk; the container's lengths are checked on the way.
    pub(crate) fn parse(bytes: &[u8]) -> (Value, &[u8]) {
        assert_eq!(&bytes[..4], MAGIC);
        assert_eq!((word(bytes, 4), word(bytes, 8)), (2, bytes.len()));
        let text = word(bytes, 12);
        assert_eq!(&bytes[16..20], JSON_CHUNK);
        assert_eq!(text % 4, 0);
        let json = serde_json::from_slice(&bytes[20..20 + text]).unwrap();
        let rest = &bytes[20 + text..];
        if rest.is_empty() {
            return (json, rest);
        }
        assert_eq!(&rest[4..8], BINARY_CHUNK);
        assert_eq!(word(rest, 0), rest.len() - 8);
        (json, &rest[8..])
    }

    fn written(mesh: &Mesh) -> Vec<u8> {
        let mut bytes = Vec::new();
        write(
            std::slice::from_ref(mesh),
            &json!({ "statistics": { "triangles": mesh.triangles.len() } }),
            &mut bytes,
        )
        .unwrap();
        bytes
    }

    /// The 4-byte words that accessor `index` reads, as they lie in the file.
    fn words(json: &Value, binary: &[u8], index: &Value) -> Vec<u32> {
        let accessor = &json["accessors"][index.as_u64().unwrap() as usize];
        let view = &json["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let start = view["byteOffset"].as_u64().unwrap() + accessor["byteOffset"].as_u64().unwrap();
        let width = if accessor["type"] == "VEC3" { 3 } else { 1 };
        let bytes = 4 * width * accessor["count"].as_u64().unwrap();
        assert!(start + bytes <= view["byteOffset"].as_u64().unwrap() + view["byteLength"].as_u64().unwrap());
        bytemuck::pod_collect_to_vec(&binary[start as usize..(start + bytes) as usize])
    }

    fn floats(words: Vec<u32>) -> Vec<f32> {
        words.into_iter().map(f32::from_bits).collect()
    }

    #[test]
    fn a_mesh_reads_back() {
        let mesh = Mesh::new(&two_quads(), &geometry()).unwrap();
        let bytes = written(&mesh);
        let (json, binary) = parse(&bytes);
        assert_eq!(json["asset"]["extras"]["statistics"]["triangles"], 4);
        assert_eq!(json["buffers"][0]["byteLength"], binary.len());
        let primitives = json["meshes"][0]["primitives"].as_array().unwrap();
        assert_eq!(primitives.len(), 1);
        let attributes = &primitives[0]["attributes"];
        assert_eq!(primitives[0]["extras"]["levelTriangles"], json!([3, 0, 1, 0, 0, 0]));
        assert_eq!(
            words(&json, binary, &primitives[0]["indices"]),
            [0, 1, 2, 1, 4, 5, 1, 5, 2, 0, 2, 3]
        );
        let positions = floats(words(&json, binary, &attributes["POSITION"]));
        assert_eq!(positions, bytemuck::cast_slice::<_, f32>(&mesh.positions));
        let normals = floats(words(&json, binary, &attributes["NORMAL"]));
        assert_eq!(normals, [0.0, 0.0, 1.0].repeat(6));
        assert_eq!(floats(words(&json, binary, &attributes["_SMOOTHNESS"])), [0.0; 6]);
        assert_eq!(floats(words(&json, binary, &attributes["_FEATURE"])), [1.0; 6]);
        let position = &json["accessors"][attributes["POSITION"].as_u64().unwrap() as usize];
        // From the middle of the grid, (48, 16, 16).
        assert_eq!(position["min"], json!([-18.0, -15.0, -15.5]));
        assert_eq!(position["max"], json!([-12.75, -14.0, -15.5]));
    }

    #[test]
    fn colours_stand_before_the_indices() {
        let mut mesh = Mesh::new(&two_quads(), &geometry()).unwrap();
        let point = PointJson {
            x: 0.0,
            importance: 1.0,
            color: "#ff0000".into(),
        };
        mesh.colorize(&TransferFunctionJson { points: vec![point] }, 0.5);
        let bytes = written(&mesh);
        let (json, binary) = parse(&bytes);
        let primitive = &json["meshes"][0]["primitives"][0];
        let color = primitive["attributes"]["COLOR_0"].as_u64().unwrap() as usize;
        let view = json["accessors"][color]["bufferView"].as_u64().unwrap() as usize;
        let start = json["bufferViews"][view]["byteOffset"].as_u64().unwrap() as usize;
        assert_eq!(binary[start..start + 8], [255, 255, 0, 0, 0, 0, 255, 255]);
        assert_eq!(words(&json, binary, &primitive["indices"])[9..], [0, 2, 3]);
    }

    #[test]
    fn the_node_turns_positions_into_metres_with_y_up() {
        let mut mesh = Mesh::new(&two_quads(), &geometry()).unwrap();
        let node = |mesh: &Mesh| parse(&written(mesh)).0["nodes"][0].clone();
        assert_eq!(node(&mesh)["scale"], json!([1.0, 1.0, 1.0]), "no unit is known");
        mesh.unit = Some(LengthUnit::Millimetre);
        let node = node(&mesh);
        assert_eq!(node["scale"], json!([1e-3, 1e-3, 1e-3]));
        assert_eq!(node["translation"], json!([0.048, 0.016, -0.016]));
        let turn: Vec<f64> = serde_json::from_value(node["rotation"].clone()).unwrap();
        let turn = isopeel_geometry::DQuat::from_slice(&turn);
        let up = turn * isopeel_geometry::DVec3::Z;
        assert!((up - isopeel_geometry::DVec3::Y).length() < 1e-12, "{up}");
        let front = turn * isopeel_geometry::DVec3::NEG_Y;
        assert!((front - isopeel_geometry::DVec3::Z).length() < 1e-12, "{front}");
    }

    #[test]
    fn surfaces_have_nodes_and_materials_of_their_own() {
        let mut bone = Mesh::new(&two_quads(), &geometry()).unwrap();
        let mut skin = bone.clone();
        (bone.name, skin.name) = ("bone".to_owned(), "skin".to_owned());
        skin.material = Material {
            color: Some([255, 188, 0]),
            opacity: 0.25,
        };
        let mut bytes = Vec::new();
        write(&[bone.clone(), Mesh::default(), skin], &json!({}), &mut bytes).unwrap();
        let (json, binary) = parse(&bytes);
        assert_eq!(json["scenes"][0]["nodes"], json!([0, 1]));
        for (number, name) in ["bone", "skin"].into_iter().enumerate() {
            assert_eq!(
                (&json["nodes"][number]["name"], &json["nodes"][number]["mesh"]),
                (&json!(name), &json!(number))
            );
            assert_eq!(json["materials"][number]["name"], name);
            let primitive = &json["meshes"][number]["primitives"][0];
            assert_eq!(primitive["material"], number);
            let positions = floats(words(&json, binary, &primitive["attributes"]["POSITION"]));
            assert_eq!(positions, bytemuck::cast_slice::<_, f32>(&bone.positions));
            assert_eq!(words(&json, binary, &primitive["indices"])[9..], [0, 2, 3]);
        }
        assert!(json["materials"][0].get("alphaMode").is_none());
        let skin = &json["materials"][1];
        assert_eq!(
            (&skin["alphaMode"], &skin["pbrMetallicRoughness"]["baseColorFactor"][3]),
            (&json!("BLEND"), &json!(0.25))
        );
        let green = skin["pbrMetallicRoughness"]["baseColorFactor"][1].as_f64().unwrap();
        assert!((green - 0.5029).abs() < 1e-3, "{green}");
    }

    #[test]
    fn one_triangle_is_a_mesh_and_none_is_a_scene_without_nodes() {
        let one = surface(vec![Region {
            coords: [0, 0, 0],
            size: 0,
            vertices: [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
                .map(vertex)
                .to_vec()
                .into(),
            indices: vec![0, 1, 2].into(),
            values: Vec::new().into(),
            level_triangles: [0, 0, 0, 0, 0, 1],
            error: None,
        }]);
        let bytes = written(&Mesh::new(&one, &geometry()).unwrap());
        let (json, binary) = parse(&bytes);
        assert_eq!(json["meshes"][0]["primitives"][0]["extras"]["levelTriangles"][5], 1);
        assert_eq!(binary.len(), 3 * 32 + 12);

        let bytes = written(&Mesh::new(&surface(Vec::new()), &geometry()).unwrap());
        let (json, binary) = parse(&bytes);
        assert!(binary.is_empty() && json.get("meshes").is_none() && json.get("buffers").is_none());
        assert_eq!(json["scenes"].as_array().unwrap().len(), 1);
    }
}
