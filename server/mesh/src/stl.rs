//! Binary STL: each triangle has a normal and the positions of its corners.

use std::io::Write;

use isopeel_geometry::{DVec3, triangle_normal};
use isopeel_volumes::LengthUnit;

use super::rows::write_rows;
use super::{ExportError, Mesh, fits_u32};

/// Maximum rounding error without a notice, as a fraction of the smallest spacing.
const MAX_UNNOTICED: f64 = 1e-3;

/// Returns a notice about the rounding of positions in a format with 32-bit world positions; `None` if the rounding error is at most a
/// thousandth of the smallest spacing. `format` is the name of the format.
pub fn rounding(mesh: &Mesh, format: &str) -> Option<String> {
    let error_of = |vertex: usize| {
        let rounded = mesh.world(vertex).map(|x| (x - f64::from(x as f32)).abs());
        rounded.into_iter().fold(0.0, f64::max)
    };
    let largest = (0..mesh.positions.len()).map(error_of).fold(0.0, f64::max);
    let spacings = largest / mesh.smallest_spacing;
    let unit = mesh.unit.map_or("", LengthUnit::ascii_symbol);
    (spacings > MAX_UNNOTICED).then(|| {
        format!(
            "{format} holds numbers of 32 bits: so far from the origin positions are rounded by up to {largest:.1e} {unit}, {spacings:.2} of the \
             smallest spacing; GLB, PLY, VTP, OBJ, 3MF and USDZ keep them"
        )
    })
}

/// Writes `mesh`. The normal of a triangle is the unit normal of its plane, or zero for a degenerate triangle.
///
/// # Errors
/// The mesh has more than 2³² − 1 triangles, a position exceeds 32-bit floats, or `out` fails.
pub fn write(mesh: &Mesh, out: &mut dyn Write) -> Result<(), ExportError> {
    let triangles = fits_u32("triangles", mesh.triangles.len() as u64, "STL")?;
    // The header must not begin with `solid`, by which readers recognise the text form of STL.
    let mut header = [b' '; 80];
    let unit = mesh.unit.map_or("unknown", LengthUnit::ascii_symbol);
    // States an anatomical frame in the form that 3D Slicer reads.
    let space = if mesh.frame.is_anatomical() { "SPACE=" } else { "frame " };
    let frame = mesh.frame.name();
    // Refers to `isopeel info`, because the header is too short for the notices.
    let notices = if mesh.notices.is_empty() {
        ""
    } else {
        ", notices: isopeel info"
    };
    let title = format!(
        "isopeel {} binary STL, {space}{frame}, unit {unit}{notices}",
        env!("CARGO_PKG_VERSION")
    );
    for (to, from) in header.iter_mut().zip(title.bytes()) {
        *to = from;
    }
    out.write_all(&header)?;
    out.write_all(&triangles.to_le_bytes())?;
    // Converts each vertex only once, because a vertex has about six triangles.
    let vertices = 0..mesh.positions.len();
    let world_positions = vertices
        .map(|vertex| mesh.world_f32(vertex))
        .collect::<Result<Vec<_>, _>>()?;
    write_rows(mesh.triangles.len(), out, |triangle, bytes| {
        let corners = mesh.triangles[triangle];
        let normal = plane_normal(corners.map(|i| mesh.positions[i as usize]));
        bytes.extend_from_slice(bytemuck::bytes_of(&normal));
        bytes.extend_from_slice(bytemuck::bytes_of(&corners.map(|i| world_positions[i as usize])));
        bytes.extend_from_slice(&[0, 0]);
    })?;
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
    use isopeel_volumes::Geometry;

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
    fn what_rounding_takes_is_said_far_from_the_origin_alone() {
        let at = |x| Geometry {
            spacing: [0.05; 3],
            origin: [x, 4.6e6, 120.0],
            unit: Some(LengthUnit::Metre),
            ..geometry()
        };
        let far = rounding(&Mesh::new(&two_quads(), &at(500_000.0)).unwrap(), "STL").unwrap();
        assert!(
            far.contains("rounded by up to 1.0e-1 m, 2.00 of the smallest spacing"),
            "{far}"
        );
        assert_eq!(rounding(&Mesh::new(&two_quads(), &geometry()).unwrap(), "STL"), None);
        let beyond = Mesh::new(&two_quads(), &at(1e39)).unwrap();
        assert!(matches!(
            write(&beyond, &mut Vec::new()),
            Err(ExportError::OutOfRange(_))
        ));
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
