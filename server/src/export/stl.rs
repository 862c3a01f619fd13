//! Binary STL: triangles with their own normals, nothing shared.

use std::io::Write;

use super::{ExportError, Mesh, fits_u32};
use crate::math::{DVec3, triangle_normal};
use crate::volumes::LengthUnit;

/// Writes `mesh`. A triangle's normal is that of its plane; a degenerate triangle has the zero normal.
///
/// # Errors
/// More than 2³² − 1 triangles, or the errors of `out`.
pub fn write(mesh: &Mesh, out: &mut impl Write) -> Result<(), ExportError> {
    let triangles = fits_u32("triangles", mesh.triangles.len() as u64, "STL")?;
    // Must not begin with "solid", the mark of the text form.
    let mut header = [b' '; 80];
    let (frame, unit) = (mesh.frame.name(), mesh.unit.map_or("unknown", LengthUnit::symbol));
    // Too short for the notices themselves.
    let notices = if mesh.notices.is_empty() {
        ""
    } else {
        ", notices: isopeel info"
    };
    let title = format!(
        "isopeel {} binary STL, frame {frame}, unit {unit}{notices}",
        env!("CARGO_PKG_VERSION")
    );
    for (to, from) in header.iter_mut().zip(title.bytes()) {
        *to = from;
    }
    out.write_all(&header)?;
    out.write_all(&triangles.to_le_bytes())?;
    for triangle in &mesh.triangles {
        let corners = triangle.map(|i| mesh.positions[i as usize]);
        out.write_all(bytemuck::bytes_of(&plane_normal(corners)))?;
        out.write_all(bytemuck::bytes_of(&corners))?;
        out.write_all(&[0, 0])?;
    }
    Ok(())
}

fn plane_normal(corners: [[f32; 3]; 3]) -> [f32; 3] {
    let normal = triangle_normal(corners.map(|corner| DVec3::from(corner.map(f64::from))));
    let length = normal.length();
    if length > 0.0 {
        (normal / length).to_array().map(|component| component as f32)
    } else {
        [0.0; 3]
    }
}

#[cfg(test)]
mod tests {
    use super::super::mesh::tests::{geometry, surface, two_quads};
    use super::*;

    /// Normal and corners of every triangle.
    fn parse(bytes: &[u8]) -> Vec<[[f32; 3]; 4]> {
        assert!(!bytes.starts_with(b"solid"));
        let count = u32::from_le_bytes(bytes[80..84].try_into().unwrap()) as usize;
        assert_eq!(bytes.len(), 84 + 50 * count);
        let float = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        (0..count)
            .map(|t| std::array::from_fn(|p| std::array::from_fn(|i| float(84 + 50 * t + 12 * p + 4 * i))))
            .collect()
    }

    #[test]
    fn triangles_read_back_with_the_normal_of_their_plane() {
        let mut surface = two_quads();
        // The last triangle degenerates.
        surface.regions[1].indices.to_mut()[5] = 2;
        let mesh = Mesh::new(&surface, &geometry()).unwrap();
        let mut bytes = Vec::new();
        write(&mesh, &mut bytes).unwrap();
        let triangles = parse(&bytes);
        assert_eq!(triangles.len(), 4);
        assert_eq!(
            triangles[0],
            [[0.0, 0.0, 1.0], [30.0, 1.0, 0.5], [32.0, 1.0, 0.5], [32.0, 2.0, 0.5]]
        );
        assert_eq!(triangles[2][0], [0.0; 3]);
    }

    #[test]
    fn the_header_says_where_notices_are() {
        let mut mesh = Mesh::new(&two_quads(), &geometry()).unwrap();
        mesh.notices = vec!["spacing along z is assumed".to_owned()];
        let mut bytes = Vec::new();
        write(&mesh, &mut bytes).unwrap();
        let header = String::from_utf8_lossy(&bytes[..80]);
        assert!(header.trim_end().ends_with(", notices: isopeel info"), "{header}");
    }

    #[test]
    fn an_empty_surface_has_no_triangles() {
        let mesh = Mesh::new(&surface(Vec::new()), &geometry()).unwrap();
        let mut bytes = Vec::new();
        write(&mesh, &mut bytes).unwrap();
        assert!(parse(&bytes).is_empty());
    }
}
