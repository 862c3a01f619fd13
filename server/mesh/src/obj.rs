//! Wavefront OBJ: a text format. Several surfaces are several objects.

use std::io::Write;

use isopeel_volumes::LengthUnit;

use super::decimal::{Decimals, push_whole};
use super::mesh::{ascii, srgb_bytes};
use super::rows::write_rows;
use super::{ExportError, Mesh};

/// Writes `meshes` as one object each: world positions, colours after the positions, which most readers accept, and normals. Positions are
/// rounded by less than a hundred-thousandth of the smallest spacing. Comments contain frame, unit, provenance and notices.
///
/// # Errors
/// Errors of `out`.
pub fn write(meshes: &[Mesh], out: &mut dyn Write) -> Result<(), ExportError> {
    writeln!(out, "# isopeel {}", env!("CARGO_PKG_VERSION"))?;
    // Vertices are numbered from 1 through all objects.
    let mut first = 1;
    for mesh in meshes {
        comments(mesh, out)?;
        writeln!(out, "o {}", ascii(&mesh.name))?;
        vertices(mesh, out)?;
        write_rows(mesh.triangles.len(), out, |triangle, text| {
            text.push(b'f');
            for corner in mesh.triangles[triangle] {
                text.push(b' ');
                let digits = text.len();
                push_whole(text, first + u64::from(corner));
                let end = text.len();
                text.extend_from_slice(b"//");
                text.extend_from_within(digits..end);
            }
            text.push(b'\n');
        })?;
        first += mesh.positions.len() as u64;
    }
    Ok(())
}

/// Writes positions with their colours, then normals.
fn vertices(mesh: &Mesh, out: &mut dyn Write) -> Result<(), ExportError> {
    let (decimals, unit_decimals) = (Decimals::of_spacing(mesh.smallest_spacing), Decimals::new(4));
    let surface_color = mesh
        .material
        .color
        .map(|color| color.map(|byte| f64::from(byte) / 255.0));
    write_rows(mesh.positions.len(), out, |vertex, text| {
        text.push(b'v');
        for component in mesh.world(vertex) {
            text.push(b' ');
            decimals.push(text, component);
        }
        let vertex_color = mesh.colors.get(vertex);
        let vertex_color = vertex_color.map(|&color| srgb_bytes(color).map(|byte| f64::from(byte) / 255.0));
        for component in vertex_color.or(surface_color).into_iter().flatten() {
            text.push(b' ');
            unit_decimals.push(text, component);
        }
        text.push(b'\n');
    })?;
    write_rows(mesh.normals.len(), out, |vertex, text| {
        text.extend_from_slice(b"vn");
        for component in mesh.normals[vertex] {
            text.push(b' ');
            unit_decimals.push(text, component.into());
        }
        text.push(b'\n');
    })?;
    Ok(())
}

fn comments(mesh: &Mesh, out: &mut dyn Write) -> Result<(), ExportError> {
    let unit = mesh.unit.map_or("unknown", LengthUnit::ascii_symbol);
    writeln!(out, "# frame {}, unit {unit}", mesh.frame.name())?;
    for (name, value) in &mesh.provenance {
        writeln!(out, "# {name}: {}", ascii(value))?;
    }
    for notice in mesh.notices.iter().filter(|line| !line.is_empty()) {
        writeln!(out, "# notice: {}", ascii(notice))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::mesh::tests::{geometry, two_quads};
    use super::*;
    use isopeel_volumes::Geometry;

    fn written(meshes: &[Mesh]) -> String {
        let mut bytes = Vec::new();
        write(meshes, &mut bytes).unwrap();
        String::from_utf8(bytes).unwrap()
    }

    /// The numbers of lines that begin with a word.
    fn numbers(text: &str, word: &str) -> Vec<Vec<f64>> {
        let lines = text
            .lines()
            .filter_map(|line| line.strip_prefix(word)?.strip_prefix(' '));
        let parse = |number: &str| number.split("//").next().unwrap().parse().unwrap();
        lines.map(|line| line.split(' ').map(parse).collect()).collect()
    }

    #[test]
    fn meshes_read_back_as_objects() {
        let mut mesh = Mesh::new(&two_quads(), &geometry()).unwrap();
        mesh.name = "head: t1 = 1\u{b5}".to_owned();
        mesh.material.color = Some([255, 0, 51]);
        mesh.notices = vec!["a\nb".to_owned()];
        let text = written(&[mesh.clone(), mesh.clone()]);
        assert!(text.is_ascii());
        assert_eq!(text.lines().filter(|line| *line == "o head: t1 = 1\\u{b5}").count(), 2);
        assert!(text.contains("# notice: a\\nb\n"), "{text}");
        let vertices = numbers(&text, "v");
        assert_eq!(vertices.len(), 12);
        for (number, vertex) in vertices.iter().enumerate() {
            assert_eq!(vertex[..3], mesh.world(number % 6));
            assert_eq!(vertex[3..], [1.0, 0.0, 0.2]);
        }
        assert_eq!(numbers(&text, "vn")[11], [0.0, 0.0, 1.0]);
        let faces = numbers(&text, "f");
        assert_eq!(
            (&faces[3][..], &faces[4][..]),
            (&[1.0, 3.0, 4.0][..], &[7.0, 8.0, 9.0][..])
        );
    }

    #[test]
    fn positions_far_from_the_origin_keep_their_digits() {
        let far = Geometry {
            spacing: [0.05; 3],
            origin: [500_000.0, 4.6e6, 120.0],
            ..geometry()
        };
        let mesh = Mesh::new(&two_quads(), &far).unwrap();
        for (vertex, read) in numbers(&written(std::slice::from_ref(&mesh)), "v").iter().enumerate() {
            for (read, expected) in read.iter().zip(mesh.world(vertex)) {
                assert!((read - expected).abs() < 1e-6, "{read}, expected {expected}");
            }
        }
    }
}
