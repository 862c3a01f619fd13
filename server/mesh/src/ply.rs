//! Binary little-endian PLY 1.0.

use std::io::Write;

use isopeel_volumes::LengthUnit;

use super::mesh::{ascii, attribute_names, srgb_bytes};
use super::rows::write_rows;
use super::{ExportError, Mesh};

/// Writes `mesh`. A vertex has position, normal, `smoothness` and `feature` (0 to 1). Positions have 64 bits, so that they are exact even
/// far from the origin. A face has three corners. Faces are ordered by level, finest first, and a comment states their number at each
/// level, because some readers (meshio) reject faces with properties other than a list of corners.
///
/// # Errors
/// Errors of `out`.
pub fn write(mesh: &Mesh, out: &mut dyn Write) -> Result<(), ExportError> {
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\ncomment isopeel {}\ncomment frame {}, unit {}\n{}\
         comment faces of each level, finest first: {}\n{}\
         element vertex {}\n\
         property double x\nproperty double y\nproperty double z\n\
         property float nx\nproperty float ny\nproperty float nz\n\
         property float smoothness\nproperty float feature\n{}\
         element face {}\n\
         property list uchar uint vertex_indices\n\
         end_header\n",
        env!("CARGO_PKG_VERSION"),
        mesh.frame.name(),
        mesh.unit.map_or("unknown", LengthUnit::ascii_symbol),
        space(mesh),
        mesh.level_triangles.map(|count| count.to_string()).join(" "),
        comments(mesh),
        mesh.positions.len(),
        properties(mesh),
        mesh.triangles.len(),
    )?;
    write_rows(mesh.positions.len(), out, |i, bytes| {
        bytes.extend_from_slice(bytemuck::bytes_of(&mesh.world(i)));
        bytes.extend_from_slice(bytemuck::bytes_of(&mesh.normals[i]));
        bytes.extend_from_slice(bytemuck::bytes_of(&[mesh.smoothness[i], mesh.feature[i]]));
        for field in &mesh.fields {
            bytes.extend_from_slice(bytemuck::bytes_of(&field.values[i]));
        }
        if let Some(&color) = mesh.colors.get(i) {
            bytes.extend_from_slice(&srgb_bytes(color));
        }
    })?;
    write_rows(mesh.triangles.len(), out, |i, bytes| {
        bytes.push(3);
        bytes.extend_from_slice(bytemuck::bytes_of(&mesh.triangles[i]));
    })?;
    Ok(())
}

/// Returns a comment about the anatomical frame in the form that 3D Slicer reads; empty for other frames.
fn space(mesh: &Mesh) -> String {
    match mesh.frame.is_anatomical() {
        true => format!("comment SPACE={}\n", mesh.frame.name()),
        false => String::new(),
    }
}

/// Maximum bytes of the text of a comment. A longer text continues in another comment with the same name, because common readers refuse
/// lines of 1024 bytes.
const MAX_COMMENT: usize = 400;

/// Returns comments about provenance, fields and notices, in ASCII.
fn comments(mesh: &Mesh) -> String {
    let comment = |name: &str, text: &str| {
        let text = ascii(text);
        let lines = text.as_bytes().chunks(MAX_COMMENT).map(String::from_utf8_lossy);
        lines
            .map(|line| format!("comment {name}: {line}\n"))
            .collect::<String>()
    };
    let provenance = mesh.provenance.iter().map(|(name, text)| comment(name, text));
    let fields = mesh.fields.iter().zip(names(mesh)).map(|(field, property)| {
        let unit = field.unit.as_deref().unwrap_or("unknown");
        comment("field", &format!("{property} is {}, unit {unit}", field.name))
    });
    let notices = mesh.notices.iter().filter(|line| !line.is_empty());
    provenance
        .chain(fields)
        .chain(notices.map(|notice| comment("notice", notice)))
        .collect()
}

/// Returns the declarations of the optional vertex properties: values of fields, and colours.
fn properties(mesh: &Mesh) -> String {
    let fields = names(mesh).into_iter().map(|name| format!("property float {name}\n"));
    let colors = ["red", "green", "blue"].map(|name| format!("property uchar {name}\n"));
    let colors = colors.into_iter().filter(|_| !mesh.colors.is_empty());
    fields.chain(colors).collect()
}

/// Returns the property names of the fields: distinct words of ASCII.
fn names(mesh: &Mesh) -> Vec<String> {
    let taken = [
        "x",
        "y",
        "z",
        "nx",
        "ny",
        "nz",
        "smoothness",
        "feature",
        "red",
        "green",
        "blue",
    ];
    attribute_names(mesh, "", &taken)
}

#[cfg(test)]
mod tests {
    use super::super::mesh::FieldValues;
    use super::super::mesh::tests::{geometry, surface, two_quads};
    use super::*;

    /// Header, vertices as rows of 8 numbers, faces as corners.
    type Parsed = (String, Vec<[f64; 8]>, Vec<[u32; 3]>);

    fn parse(bytes: &[u8]) -> Parsed {
        let end = b"end_header\n";
        let body = bytes.windows(end.len()).position(|w| w == end).unwrap() + end.len();
        let header = String::from_utf8(bytes[..body].to_vec()).unwrap();
        let count = |element: &str| -> usize {
            let line = header.lines().find_map(|l| l.strip_prefix(element)).unwrap();
            line.trim().parse().unwrap()
        };
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        let double = |at: usize| f64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
        let number = |row: usize, i: usize| match i {
            0..3 => double(row + 8 * i),
            _ => f64::from(f32::from_bits(word(row + 24 + 4 * (i - 3)))),
        };
        let vertices = (0..count("element vertex"))
            .map(|v| std::array::from_fn(|i| number(body + 44 * v, i)))
            .collect::<Vec<_>>();
        let faces = body + 44 * vertices.len();
        let rows = (0..count("element face"))
            .map(|f| {
                let row = faces + 13 * f;
                assert_eq!(bytes[row], 3);
                std::array::from_fn(|i| word(row + 1 + 4 * i))
            })
            .collect::<Vec<_>>();
        assert_eq!(bytes.len(), faces + 13 * rows.len());
        (header, vertices, rows)
    }

    #[test]
    fn a_mesh_reads_back() {
        let mesh = Mesh::new(&two_quads(), &geometry()).unwrap();
        let mut bytes = Vec::new();
        write(&mesh, &mut bytes).unwrap();
        let (header, vertices, faces) = parse(&bytes);
        assert!(header.starts_with("ply\nformat binary_little_endian 1.0\n"));
        assert_eq!(vertices.len(), 6);
        assert_eq!(vertices[4], [35.25, 1.0, 0.5, 0.0, 0.0, 1.0, 0.0, 1.0]);
        assert_eq!(faces[3], [0, 2, 3]);
        for comment in [
            "frame world, unit unknown",
            "faces of each level, finest first: 3 0 1 0 0 0",
        ] {
            assert!(header.lines().any(|l| l == format!("comment {comment}")), "{header}");
        }
    }

    #[test]
    fn notices_are_comments_of_one_line() {
        let mut mesh = Mesh::new(&two_quads(), &geometry()).unwrap();
        mesh.notices = vec!["0.2 \u{b5}m".to_owned(), String::new(), "as\rassumed".to_owned()];
        let mut bytes = Vec::new();
        write(&mesh, &mut bytes).unwrap();
        let (header, vertices, _) = parse(&bytes);
        let comments: Vec<&str> = header
            .lines()
            .filter_map(|line| line.strip_prefix("comment notice: "))
            .collect();
        assert_eq!(comments, ["0.2 \\u{b5}m", "as\\rassumed"]);
        assert_eq!(vertices.len(), 6);
    }

    #[test]
    fn long_texts_are_comments_that_readers_take() {
        let mut mesh = Mesh::new(&two_quads(), &geometry()).unwrap();
        let view = "0123456789".repeat(150);
        mesh.provenance = vec![("view", view.clone())];
        let mut bytes = Vec::new();
        write(&mesh, &mut bytes).unwrap();
        let (header, ..) = parse(&bytes);
        assert!(header.lines().all(|line| line.len() < 500), "{header}");
        let parts = header.lines().filter_map(|line| line.strip_prefix("comment view: "));
        assert_eq!(parts.collect::<String>(), view);
    }

    #[test]
    fn values_and_colours_stand_behind_what_all_vertices_have() {
        let mut mesh = Mesh::new(&two_quads(), &geometry()).unwrap();
        let field = |name: &str| FieldValues {
            name: name.to_owned(),
            unit: Some("K".to_owned()),
            values: vec![7.5; 6],
        };
        mesh.fields = vec![field("T (air)"), field("feature")];
        mesh.colors = vec![[65535, 0, 0]; 6];
        let mut bytes = Vec::new();
        write(&mesh, &mut bytes).unwrap();
        let header = String::from_utf8_lossy(&bytes);
        for line in [
            "property float T__air_",
            "property float feature_2",
            "property uchar blue",
            "comment field: T__air_ is T (air), unit K",
        ] {
            assert!(header.contains(&format!("{line}\n")), "{line}");
        }
        let end = b"end_header\n";
        let body = bytes.windows(end.len()).position(|w| w == end).unwrap() + end.len();
        let expected = [7.5f32.to_le_bytes(), 7.5f32.to_le_bytes()].concat();
        assert_eq!(bytes[body + 44..body + 55], [&expected[..], &[255, 0, 0]].concat());
        assert_eq!(bytes.len(), body + 6 * 55 + 4 * 13);
    }

    #[test]
    fn an_empty_surface_has_elements_without_rows() {
        let mesh = Mesh::new(&surface(Vec::new()), &geometry()).unwrap();
        let mut bytes = Vec::new();
        write(&mesh, &mut bytes).unwrap();
        let (_, vertices, faces) = parse(&bytes);
        assert!(vertices.is_empty() && faces.is_empty());
    }
}
