//! VTP, the `PolyData` of VTK's XML formats (<https://docs.vtk.org/en/latest/design_documents/VTKFileFormats.html>), read by ParaView
//! and VTK. Arrays are appended as raw bytes, each behind its length.

use std::io::{self, Write};

use super::Mesh;
use super::mesh::{attribute_names, srgb_bytes};
use crate::volumes::LengthUnit;

/// Bytes of the length before each array.
const LENGTH_BYTES: u64 = 8;
/// Numbers that are widened at once.
const PIECE: usize = 1 << 12;

/// Writes `mesh`: a point has `normal`, `smoothness` and `feature` (0 to 1), a triangle the `level` of its leaf. `frame` and `unit` of the
/// points, which have 64 bits, are strings of the data set, as are the notices of the volume; without a unit or a notice these are missing.
///
/// # Errors
/// Those of `out`.
pub fn write(mesh: &Mesh, out: &mut impl Write) -> io::Result<()> {
    let (points, triangles) = (mesh.positions.len() as u64, mesh.triangles.len() as u64);
    let mut appended = Appended { next: 0 };
    let mut array = |kind: &str, name: &str, components: u32, bytes: u64| {
        let offset = appended.place(bytes);
        format!(
            "<DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{components}\" format=\"appended\" \
             offset=\"{offset}\"/>\n"
        )
    };
    let mut point_data = [
        array("Float32", "normal", 3, 12 * points),
        array("Float32", "smoothness", 1, 4 * points),
        array("Float32", "feature", 1, 4 * points),
    ]
    .concat();
    for name in names(mesh) {
        point_data += &array("Float32", &name, 1, 4 * points);
    }
    if !mesh.colors.is_empty() {
        point_data += &array("UInt8", "color", 3, 3 * points);
    }
    let cell_data = array("UInt8", "level", 1, triangles);
    let positions = array("Float64", "Points", 3, 24 * points);
    let polygons = [
        array("Int64", "connectivity", 1, 24 * triangles),
        array("Int64", "offsets", 1, 8 * triangles),
    ]
    .concat();
    let unit = mesh.unit.map(LengthUnit::symbol);
    let notice = (!mesh.notices.is_empty()).then(|| mesh.notices.join("\n"));
    let mut field_data = [
        text("frame", mesh.frame.name()),
        unit.map_or_else(String::new, |unit| text("unit", unit)),
        notice.map_or_else(String::new, |notice| text("notice", &notice)),
    ]
    .concat();
    if mesh.frame.is_anatomical() {
        // As 3D Slicer reads it.
        field_data += &text("SPACE", mesh.frame.name());
    }
    for (field, name) in mesh.fields.iter().zip(names(mesh)) {
        field_data += &text(&format!("field {name}"), &field.name);
        if let Some(unit) = &field.unit {
            field_data += &text(&format!("unit {name}"), unit);
        }
    }
    for (name, value) in &mesh.provenance {
        field_data += &text(name, value);
    }
    write!(
        out,
        "<?xml version=\"1.0\"?>\n\
         <!-- isopeel {} -->\n\
         <VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n<PolyData>\n\
         <FieldData>\n{field_data}</FieldData>\n\
         <Piece NumberOfPoints=\"{points}\" NumberOfVerts=\"0\" NumberOfLines=\"0\" NumberOfStrips=\"0\" \
         NumberOfPolys=\"{triangles}\">\n\
         <PointData Normals=\"normal\">\n{point_data}</PointData>\n\
         <CellData Scalars=\"level\">\n{cell_data}</CellData>\n\
         <Points>\n{positions}</Points>\n\
         <Polys>\n{polygons}</Polys>\n\
         </Piece>\n</PolyData>\n<AppendedData encoding=\"raw\">\n_",
        env!("CARGO_PKG_VERSION"),
    )?;
    // In the order of the offsets above.
    raw(out, bytemuck::cast_slice(&mesh.normals))?;
    raw(out, bytemuck::cast_slice(&mesh.smoothness))?;
    raw(out, bytemuck::cast_slice(&mesh.feature))?;
    for field in &mesh.fields {
        raw(out, bytemuck::cast_slice(&field.values))?;
    }
    if !mesh.colors.is_empty() {
        out.write_all(&(3 * points).to_le_bytes())?;
        widened(out, mesh.colors.iter().map(|&color| srgb_bytes(color)))?;
    }
    levels(mesh, out)?;
    out.write_all(&(24 * points).to_le_bytes())?;
    widened(out, (0..mesh.positions.len()).map(|vertex| mesh.world(vertex)))?;
    out.write_all(&(24 * triangles).to_le_bytes())?;
    widened(
        out,
        mesh.triangles.as_flattened().iter().map(|&corner| i64::from(corner)),
    )?;
    out.write_all(&(8 * triangles).to_le_bytes())?;
    widened(out, (1..=triangles).map(|end| 3 * end as i64))?;
    out.write_all(b"\n</AppendedData>\n</VTKFile>\n")
}

/// Names of arrays of the fields.
fn names(mesh: &Mesh) -> Vec<String> {
    attribute_names(mesh, "", &["normal", "smoothness", "feature", "color"])
}

/// Where the next array begins, in bytes behind the underscore.
struct Appended {
    next: u64,
}

impl Appended {
    fn place(&mut self, bytes: u64) -> u64 {
        let offset = self.next;
        self.next += LENGTH_BYTES + bytes;
        offset
    }
}

/// A string of the data set: the numbers of its bytes, ended by a 0.
fn text(name: &str, value: &str) -> String {
    let numbers: Vec<String> = value.bytes().chain([0]).map(|byte| byte.to_string()).collect();
    format!(
        "<Array type=\"String\" Name=\"{name}\" NumberOfTuples=\"1\" format=\"ascii\">{}</Array>\n",
        numbers.join(" ")
    )
}

fn raw(out: &mut impl Write, bytes: &[u8]) -> io::Result<()> {
    out.write_all(&(bytes.len() as u64).to_le_bytes())?;
    out.write_all(bytes)
}

fn levels(mesh: &Mesh, out: &mut impl Write) -> io::Result<()> {
    out.write_all(&(mesh.triangles.len() as u64).to_le_bytes())?;
    for (level, &count) in (0u8..).zip(&mesh.level_triangles) {
        io::copy(&mut io::Read::take(io::repeat(level), count), out)?;
    }
    Ok(())
}

fn widened<T: bytemuck::NoUninit>(out: &mut impl Write, mut numbers: impl Iterator<Item = T>) -> io::Result<()> {
    let mut piece = Vec::with_capacity(PIECE);
    loop {
        piece.extend(numbers.by_ref().take(PIECE));
        if piece.is_empty() {
            return Ok(());
        }
        out.write_all(bytemuck::cast_slice(&piece))?;
        piece.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::super::mesh::tests::{geometry, surface, two_quads};
    use super::*;
    use crate::volumes::Frame;

    /// The XML, and the appended arrays by name.
    fn parse(bytes: &[u8]) -> (String, impl Fn(&str) -> Vec<u8>) {
        let mark = b"<AppendedData encoding=\"raw\">\n_";
        let begin = bytes.windows(mark.len()).position(|w| w == mark).unwrap() + mark.len();
        let xml = String::from_utf8(bytes[..begin].to_vec()).unwrap();
        let binary = bytes[begin..].to_vec();
        assert!(binary.ends_with(b"\n</AppendedData>\n</VTKFile>\n"));
        let header = xml.clone();
        (xml, move |name| {
            let line = header
                .lines()
                .find(|l| l.contains(&format!("Name=\"{name}\"")))
                .unwrap();
            let at: usize = line
                .split("offset=\"")
                .nth(1)
                .unwrap()
                .split('"')
                .next()
                .unwrap()
                .parse()
                .unwrap();
            let length = u64::from_le_bytes(binary[at..at + 8].try_into().unwrap()) as usize;
            binary[at + 8..at + 8 + length].to_vec()
        })
    }

    #[test]
    fn a_mesh_reads_back() {
        let mut mesh = Mesh::new(&two_quads(), &geometry()).unwrap();
        (mesh.frame, mesh.unit) = (Frame::Lps, Some(LengthUnit::Millimetre));
        mesh.notices = vec!["a".to_owned(), "b".to_owned()];
        let mut bytes = Vec::new();
        write(&mesh, &mut bytes).unwrap();
        let (xml, array) = parse(&bytes);
        assert!(
            xml.contains("NumberOfPoints=\"6\"") && xml.contains("NumberOfPolys=\"4\""),
            "{xml}"
        );
        assert!(
            xml.contains("Name=\"frame\" NumberOfTuples=\"1\" format=\"ascii\">76 80 83 0<"),
            "{xml}"
        );
        assert!(
            xml.contains("Name=\"unit\" NumberOfTuples=\"1\" format=\"ascii\">109 109 0<"),
            "{xml}"
        );
        assert!(
            xml.contains("Name=\"notice\" NumberOfTuples=\"1\" format=\"ascii\">97 10 98 0<"),
            "{xml}"
        );
        let points: Vec<[f64; 3]> = bytemuck::pod_collect_to_vec(&array("Points"));
        assert_eq!(points, (0..6).map(|vertex| mesh.world(vertex)).collect::<Vec<_>>());
        assert_eq!(array("normal"), bytemuck::cast_slice::<_, u8>(&mesh.normals));
        assert_eq!(array("feature"), bytemuck::cast_slice::<_, u8>(&[1.0f32; 6]));
        assert_eq!(array("level"), [0, 0, 0, 2]);
        let corners: Vec<i64> = bytemuck::pod_collect_to_vec(&array("connectivity"));
        assert_eq!(corners, [0, 1, 2, 1, 4, 5, 1, 5, 2, 0, 2, 3]);
        let offsets: Vec<i64> = bytemuck::pod_collect_to_vec(&array("offsets"));
        assert_eq!(offsets, [3, 6, 9, 12]);
    }

    #[test]
    fn an_empty_surface_has_empty_arrays() {
        let mesh = Mesh::new(&surface(Vec::new()), &geometry()).unwrap();
        let mut bytes = Vec::new();
        write(&mesh, &mut bytes).unwrap();
        let (xml, array) = parse(&bytes);
        assert!(
            xml.contains("NumberOfPolys=\"0\"") && !xml.contains("Name=\"unit\"") && !xml.contains("Name=\"notice\""),
            "{xml}"
        );
        assert!(array("Points").is_empty() && array("offsets").is_empty());
    }
}
