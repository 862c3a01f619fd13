//! GLB for pages on the web: arrays are quantized (KHR_mesh_quantization) and compressed by meshoptimizer's codecs (EXT_meshopt_compression).

use std::io::Write;

use serde_json::{Value, json};

use super::{
    ARRAY_BUFFER, Attributes, ELEMENT_ARRAY_BUFFER, FLOAT, MISSING, TRIANGLES, UNSIGNED_INT, UNSIGNED_SHORT, bounds,
    document, material, node_at, non_empty, write_chunks,
};
use crate::mesh::attribute_names;
use crate::{ExportError, Mesh};

const EXTENSION: &str = "EXT_meshopt_compression";
const QUANTIZED: &str = "KHR_mesh_quantization";
const BYTE: u32 = 5120;
/// Bits of each of the two octahedral coordinates of a normal.
const NORMAL_BITS: i32 = 8;
/// Number of lattice steps along the longest side of the surface: the maximum of 16 bits.
const STEPS: f32 = 65535.0;
/// Version of the vertex codec that the extension requires.
const VERTEX_VERSION: i32 = 0;
/// Level of the vertex codec with the highest compression.
const VERTEX_LEVEL: i32 = 2;

/// Writes `meshes` as [`super::write`] does, but with fewer bits: positions have 16 bits along the longest side, normals have two numbers
/// of 8 bits, and smoothness and feature have 16 bits. Values of fields are exact.
///
/// # Errors
/// The file would exceed the 4 GiB of a GLB, or `out` fails.
pub(crate) fn write(meshes: &[Mesh], extras: &Value, out: &mut dyn Write) -> Result<(), ExportError> {
    let mut buffer = PackedBuffer::default();
    let (mut primitives, mut nodes) = (Vec::new(), Vec::new());
    for (number, mesh) in (0..).zip(non_empty(meshes)) {
        let lattice = Lattice::of(mesh);
        primitives.push(primitive(mesh, &lattice, number, &mut buffer)?);
        nodes.push(node_at(mesh, number, lattice.origin(mesh), lattice.step.into()));
    }
    let materials = non_empty(meshes).map(material).collect();
    let mut json = document(meshes, extras, primitives, nodes, materials);
    if !buffer.bytes.is_empty() {
        json["extensionsUsed"] = json!([EXTENSION, QUANTIZED]);
        json["extensionsRequired"] = json!([EXTENSION, QUANTIZED]);
        json["accessors"] = buffer.accessors.into();
        json["bufferViews"] = buffer.views.into();
        json["buffers"] = json!([
            { "byteLength": buffer.bytes.len() },
            // The buffer after decoding. It has no bytes in the file.
            { "byteLength": buffer.decoded_bytes, "extensions": { EXTENSION: { "fallback": true } } },
        ]);
    }
    write_chunks(&json, buffer.bytes.len() as u64, out)?;
    out.write_all(&buffer.bytes)?;
    Ok(())
}

/// Returns the maximum rounding error of positions, in the unit of the mesh.
pub fn rounding(mesh: &Mesh) -> f64 {
    f64::from(Lattice::of(mesh).step) / 2.0
}

/// Lattice to whose points positions are rounded.
struct Lattice {
    low: [f32; 3],
    step: f32,
}

impl Lattice {
    fn of(mesh: &Mesh) -> Self {
        let (low, high) = bounds(&mesh.positions);
        let longest = (0..3).map(|axis| high[axis] - low[axis]).fold(0.0, f32::max);
        let step = longest / STEPS;
        let is_usable = step.is_finite() && step > 0.0;
        Self {
            low: if low.iter().all(|low| low.is_finite()) {
                low
            } else {
                [0.0; 3]
            },
            step: if is_usable { step } else { 1.0 },
        }
    }

    /// Returns the world position of the origin of the lattice.
    fn origin(&self, mesh: &Mesh) -> [f64; 3] {
        [0, 1, 2].map(|axis| mesh.origin[axis] + f64::from(self.low[axis]))
    }

    fn quantized(&self, position: [f32; 3]) -> [u16; 4] {
        let [x, y, z] = [0, 1, 2].map(|axis| ((position[axis] - self.low[axis]) / self.step).round() as u16);
        [x, y, z, 0]
    }
}

fn primitive(mesh: &Mesh, lattice: &Lattice, number: usize, buffer: &mut PackedBuffer) -> Result<Value, ExportError> {
    let mut attributes = serde_json::Map::new();
    let mut attribute = |name: &str, accessor: usize| attributes.insert(name.to_owned(), accessor.into());
    let positions: Vec<[u16; 4]> = mesh
        .positions
        .iter()
        .map(|&position| lattice.quantized(position))
        .collect();
    let corners = positions.iter().map(|&[x, y, z, _]| [x, y, z].map(f32::from));
    let (min, max) = bounds(&corners.collect::<Vec<_>>());
    let properties = json!({ "min": min, "max": max });
    attribute(
        "POSITION",
        buffer.vertices(&positions, "NONE", UNSIGNED_SHORT, "VEC3", properties)?,
    );
    let normals: Vec<[f32; 4]> = mesh.normals.iter().map(|&[x, y, z]| [x, y, z, 0.0]).collect();
    let normals: Vec<[i8; 4]> = meshopt::encode_filter_oct(&normals, NORMAL_BITS);
    let normalized = || json!({ "normalized": true });
    attribute(
        "NORMAL",
        buffer.vertices(&normals, "OCTAHEDRAL", BYTE, "VEC3", normalized())?,
    );
    for (name, values) in [("_SMOOTHNESS", &mesh.smoothness), ("_FEATURE", &mesh.feature)] {
        let quantized: Vec<[u16; 2]> = values
            .iter()
            .map(|value| [(value * 65535.0).round() as u16, 0])
            .collect();
        attribute(
            name,
            buffer.vertices(&quantized, "NONE", UNSIGNED_SHORT, "SCALAR", normalized())?,
        );
    }
    let names = Attributes::of(&attribute_names(mesh, "_", &["_SMOOTHNESS", "_FEATURE"]));
    for (name, field) in names.0.iter().zip(&mesh.fields) {
        let without_nan = |value: &f32| if value.is_finite() { *value } else { MISSING };
        let values: Vec<f32> = field.values.iter().map(without_nan).collect();
        attribute(name, buffer.vertices(&values, "NONE", FLOAT, "SCALAR", json!({}))?);
    }
    if !mesh.colors.is_empty() {
        let colors: Vec<[u16; 4]> = mesh.colors.iter().map(|&[r, g, b]| [r, g, b, u16::MAX]).collect();
        attribute(
            "COLOR_0",
            buffer.vertices(&colors, "NONE", UNSIGNED_SHORT, "VEC4", normalized())?,
        );
    }
    Ok(json!({
        "attributes": attributes,
        "indices": buffer.triangles(mesh)?,
        "material": number,
        "mode": TRIANGLES,
        "extras": { "levelTriangles": mesh.level_triangles, "fields": names.descriptions(mesh) },
    }))
}

/// The binary chunk, and views and accessors of the buffer after decoding.
#[derive(Default)]
struct PackedBuffer {
    bytes: Vec<u8>,
    decoded_bytes: usize,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl PackedBuffer {
    /// Adds an attribute with a value for each vertex, and returns the number of its accessor.
    fn vertices<T>(
        &mut self,
        values: &[T],
        filter: &str,
        component: u32,
        shape: &str,
        properties: Value,
    ) -> Result<usize, ExportError> {
        let packed = meshopt::encode_vertex_buffer_level(values, VERTEX_LEVEL, Some(VERTEX_VERSION)).map_err(failed)?;
        let stride = size_of::<T>();
        let mut compression = json!({ "byteStride": stride, "count": values.len(), "mode": "ATTRIBUTES" });
        if filter != "NONE" {
            compression["filter"] = filter.into();
        }
        let view = self.view(&packed, size_of_val(values), compression);
        self.views[view]["byteStride"] = stride.into();
        self.views[view]["target"] = ARRAY_BUFFER.into();
        Ok(self.accessor(view, component, shape, values.len(), properties))
    }

    /// Adds the triangles of a mesh, and returns the number of their accessor.
    fn triangles(&mut self, mesh: &Mesh) -> Result<usize, ExportError> {
        let corners = mesh.triangles.as_flattened();
        let packed = meshopt::encode_index_buffer(corners, mesh.positions.len()).map_err(failed)?;
        let compression = json!({ "byteStride": 4, "count": corners.len(), "mode": "TRIANGLES" });
        let view = self.view(&packed, 4 * corners.len(), compression);
        self.views[view]["target"] = ELEMENT_ARRAY_BUFFER.into();
        Ok(self.accessor(view, UNSIGNED_INT, "SCALAR", corners.len(), json!({})))
    }

    /// Adds a view of `packed` bytes, which decode to `decoded_bytes`, and returns its number.
    fn view(&mut self, packed: &[u8], decoded_bytes: usize, mut compression: Value) -> usize {
        compression["buffer"] = 0.into();
        compression["byteOffset"] = self.bytes.len().into();
        compression["byteLength"] = packed.len().into();
        self.views.push(json!({
            "buffer": 1,
            "byteOffset": self.decoded_bytes,
            "byteLength": decoded_bytes,
            "extensions": { EXTENSION: compression },
        }));
        self.bytes.extend_from_slice(packed);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.decoded_bytes += decoded_bytes.next_multiple_of(4);
        self.views.len() - 1
    }

    fn accessor(&mut self, view: usize, component: u32, shape: &str, count: usize, properties: Value) -> usize {
        self.accessors
            .push(super::accessor(view, component, shape, count, properties));
        self.accessors.len() - 1
    }
}

/// Converts an error of the codec, which refuses a mesh only if an index is not below the number of vertices.
fn failed(error: meshopt::Error) -> ExportError {
    ExportError::Io(std::io::Error::other(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::super::tests::parse;
    use super::*;
    use crate::mesh::FieldValues;
    use crate::mesh::tests::{geometry, two_quads};

    #[test]
    fn arrays_decode_to_what_they_were() {
        let mut mesh = Mesh::new(&two_quads(), &geometry()).unwrap();
        let values = vec![1.5, f32::NAN, -3.0, 0.0, 7.25, 1e-9];
        mesh.fields = vec![FieldValues {
            name: "heat".to_owned(),
            unit: None,
            values: values.clone(),
        }];
        let mut bytes = Vec::new();
        write(std::slice::from_ref(&mesh), &json!({}), &mut bytes).unwrap();
        let (json, binary) = parse(&bytes);
        assert_eq!(json["extensionsRequired"], json!([EXTENSION, QUANTIZED]));
        let packed = |accessor: &Value| {
            let view = &json["accessors"][accessor.as_u64().unwrap() as usize]["bufferView"];
            let found = &json["bufferViews"][view.as_u64().unwrap() as usize]["extensions"][EXTENSION];
            let [from, length] = ["byteOffset", "byteLength"].map(|name| found[name].as_u64().unwrap() as usize);
            binary[from..from + length].to_vec()
        };
        let primitive = &json["meshes"][0]["primitives"][0];
        let attributes = &primitive["attributes"];
        let positions: Vec<[u16; 4]> = meshopt::decode_vertex_buffer(&packed(&attributes["POSITION"]), 6).unwrap();
        let node = &json["nodes"][0];
        let step = node["scale"][0].as_f64().unwrap();
        let translation: Vec<f64> = serde_json::from_value(node["translation"].clone()).unwrap();
        for (vertex, [x, y, z, _]) in positions.iter().enumerate() {
            // As the node turns them: x, z, −y.
            let [x, y, z] = [x, y, z].map(|&number| f64::from(number) * step);
            let placed = [translation[0] + x, y - translation[2], translation[1] + z];
            for (placed, expected) in placed.iter().zip(mesh.world(vertex)) {
                assert!(
                    (placed - expected).abs() <= rounding(&mesh) * 1.01,
                    "{placed}, expected {expected}"
                );
            }
        }
        let mut normals: Vec<[i8; 4]> = meshopt::decode_vertex_buffer(&packed(&attributes["NORMAL"]), 6).unwrap();
        meshopt::decode_filter_oct(&mut normals);
        assert!(normals.iter().all(|normal| normal[..3] == [0, 0, 127]), "{normals:?}");
        let heat: Vec<f32> = meshopt::decode_vertex_buffer(&packed(&attributes["_HEAT"]), 6).unwrap();
        let expected: Vec<f32> = values
            .iter()
            .map(|value| if value.is_nan() { MISSING } else { *value })
            .collect();
        assert_eq!(heat, expected);
        let corners: Vec<u32> = meshopt::decode_index_buffer(&packed(&primitive["indices"]), 12).unwrap();
        for (found, expected) in corners.chunks_exact(3).zip(&mesh.triangles) {
            // The codec turns triangles, and keeps their side.
            let turned = (0..3).map(|turn| [0, 1, 2].map(|i| expected[(i + turn) % 3]));
            assert!(
                turned.into_iter().any(|turned| turned == found),
                "{found:?}, expected {expected:?}"
            );
        }
    }

    #[test]
    fn an_empty_surface_asks_for_no_extension() {
        let mut bytes = Vec::new();
        write(&[Mesh::default()], &json!({}), &mut bytes).unwrap();
        let (json, binary) = parse(&bytes);
        assert!(json.get("extensionsRequired").is_none() && binary.is_empty(), "{json}");
    }
}
