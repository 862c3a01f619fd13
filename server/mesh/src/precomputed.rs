//! Single-resolution meshes in Neuroglancer's precomputed format
//! (<https://github.com/google/neuroglancer/blob/master/src/datasource/precomputed/meshes.md>), in a ZIP that Neuroglancer opens without
//! unpacking.

use std::io::{self, Write};

use serde_json::json;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::{ExportError, MAX_BYTES_WITHOUT_ZIP64, Mesh, fits_u32};

/// Number of positions that are written at once.
const PIECE: usize = 1 << 12;

/// Writes `meshes` as one segment each. For a segment 1, the file `1:0` names the file `1`, which has the mesh. Segment properties contain
/// the names of the surfaces. Positions are 32-bit floats in nanometres. Files are not compressed, so that readers can request ranges of
/// bytes.
///
/// # Errors
/// A position exceeds 32-bit floats, or `out` fails.
pub fn write(meshes: &[Mesh], out: &mut dyn Write) -> Result<(), ExportError> {
    let mut package = ZipWriter::new_stream(out);
    let info = json!({ "@type": "neuroglancer_legacy_mesh", "segment_properties": "segment_properties" });
    start(&mut package, "info", 0)?;
    package.write_all(info.to_string().as_bytes())?;
    start(&mut package, "segment_properties/info", 0)?;
    package.write_all(properties(meshes).to_string().as_bytes())?;
    for (segment, mesh) in (1..).zip(meshes) {
        start(&mut package, &format!("{segment}:0"), 0)?;
        package.write_all(json!({ "fragments": [segment.to_string()] }).to_string().as_bytes())?;
        let bytes = 4 + 12 * (mesh.positions.len() + mesh.triangles.len()) as u64;
        start(&mut package, &segment.to_string(), bytes)?;
        fragment(mesh, &mut package)?;
    }
    package.finish().map_err(io::Error::from)?;
    Ok(())
}

/// Begins a file of about `bytes` bytes in the ZIP.
fn start<W: Write + io::Seek>(package: &mut ZipWriter<W>, name: &str, bytes: u64) -> Result<(), ExportError> {
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Stored)
        .large_file(bytes > MAX_BYTES_WITHOUT_ZIP64);
    Ok(package.start_file(name, options).map_err(io::Error::from)?)
}

/// Returns the segment properties: the names of the surfaces, and descriptions with their provenance.
fn properties(meshes: &[Mesh]) -> serde_json::Value {
    let ids: Vec<String> = (1..=meshes.len()).map(|segment| segment.to_string()).collect();
    let names: Vec<&str> = meshes.iter().map(|mesh| mesh.name.as_str()).collect();
    let describe = |mesh: &Mesh| {
        let provenance = mesh.provenance.iter().map(|(name, text)| format!("{name}: {text}"));
        let notices = mesh.notices.iter().map(|notice| format!("notice: {notice}"));
        let frame = format!("frame: {}", mesh.frame.name());
        provenance.chain([frame]).chain(notices).collect::<Vec<_>>().join("\n")
    };
    let descriptions: Vec<String> = meshes.iter().map(describe).collect();
    json!({
        "@type": "neuroglancer_segment_properties",
        "inline": {
            "ids": ids,
            "properties": [
                { "id": "label", "type": "label", "values": names },
                { "id": "description", "type": "description", "values": descriptions },
            ],
        },
    })
}

/// Writes the mesh of a segment: number of vertices, positions, and corners of triangles.
fn fragment(mesh: &Mesh, out: &mut dyn Write) -> Result<(), ExportError> {
    let vertices = fits_u32("vertices", mesh.positions.len() as u64, "precomputed")?;
    out.write_all(&vertices.to_le_bytes())?;
    let mut piece: Vec<[f32; 3]> = Vec::with_capacity(PIECE);
    for first in (0..mesh.positions.len()).step_by(PIECE) {
        piece.clear();
        for vertex in first..mesh.positions.len().min(first + PIECE) {
            piece.push(mesh.world_f32(vertex)?);
        }
        out.write_all(bytemuck::cast_slice(&piece))?;
    }
    out.write_all(bytemuck::cast_slice(&mesh.triangles))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use serde_json::Value;
    use zip::ZipArchive;

    use super::super::mesh::tests::{geometry, two_quads};
    use super::*;

    #[test]
    fn segments_read_back() {
        let mut mesh = Mesh::new(&two_quads(), &geometry()).unwrap();
        mesh.name = "Hippocampus".to_owned();
        let mut bytes = Vec::new();
        write(&[Mesh::default(), mesh.clone()], &mut bytes).unwrap();
        let mut package = ZipArchive::new(io::Cursor::new(bytes)).unwrap();
        let mut part = |name: &str| {
            let mut bytes = Vec::new();
            package.by_name(name).unwrap().read_to_end(&mut bytes).unwrap();
            bytes
        };
        let json = |bytes: Vec<u8>| serde_json::from_slice::<Value>(&bytes).unwrap();
        assert_eq!(json(part("info"))["@type"], "neuroglancer_legacy_mesh");
        let properties = json(part("segment_properties/info"));
        assert_eq!(properties["inline"]["ids"], json!(["1", "2"]));
        assert_eq!(properties["inline"]["properties"][0]["values"][1], "Hippocampus");
        assert_eq!(json(part("2:0")), json!({ "fragments": ["2"] }));
        let fragment = part("2");
        assert_eq!(fragment[..4], 6u32.to_le_bytes());
        let positions: Vec<[f32; 3]> = bytemuck::pod_collect_to_vec(&fragment[4..76]);
        let expected = (0..6).map(|vertex| mesh.world(vertex).map(|component| component as f32));
        assert_eq!(positions, expected.collect::<Vec<_>>());
        let corners: Vec<[u32; 3]> = bytemuck::pod_collect_to_vec(&fragment[76..]);
        assert_eq!(corners, mesh.triangles);
        assert_eq!(part("1"), [0; 4]);
    }
}
