//! GIFTI 1.0 (<https://www.nitrc.org/projects/gifti>), `.surf.gii`: a format for surfaces of brains. nibabel, Connectome Workbench and
//! FreeSurfer read these files.

use std::io::Write;

use base64::engine::general_purpose::STANDARD;
use base64::write::EncoderWriter;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use isopeel_volumes::Frame;

use super::xml::escaped;
use super::{ExportError, Mesh};

/// Compression level. The fastest one, because slower ones make files only a tenth smaller.
const LEVEL: Compression = Compression::fast();
/// Number of rows that are compressed at once.
const PIECE: usize = 1 << 12;

/// Writes `mesh`: positions and triangles as zlib in base64. Positions have 32 bits, and are in RAS if the frame is anatomical. Metadata
/// contain name, provenance and notices.
///
/// # Errors
/// Positions beyond 32 bits, or the errors of `out`.
pub fn write(mesh: &Mesh, out: &mut dyn Write) -> Result<(), ExportError> {
    let is_anatomical = mesh.frame.is_anatomical();
    let space = match is_anatomical {
        true => "NIFTI_XFORM_SCANNER_ANAT",
        false => "NIFTI_XFORM_UNKNOWN",
    };
    let frame = if is_anatomical { Frame::Ras } else { mesh.frame };
    let mut metadata = vec![("Name", mesh.name.clone()), ("frame", frame.name().to_owned())];
    if let Some(unit) = mesh.unit {
        metadata.push(("unit", unit.symbol().to_owned()));
    }
    metadata.extend(mesh.provenance.iter().cloned());
    if !mesh.notices.is_empty() {
        metadata.push(("notice", mesh.notices.join("\n")));
    }
    writeln!(
        out,
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\
         <!DOCTYPE GIFTI SYSTEM \"http://www.nitrc.org/frs/download.php/1594/gifti.dtd\">\n\
         <GIFTI Version=\"1.0\" NumberOfDataArrays=\"2\">\n{}<LabelTable/>",
        texts(&metadata)
    )?;
    begin(out, "NIFTI_INTENT_POINTSET", "NIFTI_TYPE_FLOAT32", mesh.positions.len())?;
    write!(
        out,
        "{}<CoordinateSystemTransformMatrix>\n<DataSpace>{space}</DataSpace>\n\
         <TransformedSpace>{space}</TransformedSpace>\n\
         <MatrixData>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</MatrixData>\n</CoordinateSystemTransformMatrix>\n<Data>",
        texts(&[("GeometricType", "Anatomical".to_owned())])
    )?;
    let is_lps = mesh.frame == Frame::Lps;
    let mut first_error = None;
    let positions = (0..mesh.positions.len()).map(|vertex| {
        let [x, y, z] = mesh.world_f32(vertex).unwrap_or_else(|error| {
            first_error.get_or_insert(error);
            [f32::NAN; 3]
        });
        // Converts LPS to RAS. `0.0 - x` instead of `-x`, which could be −0.
        if is_lps { [0.0 - x, 0.0 - y, z] } else { [x, y, z] }
    });
    compressed(out, positions)?;
    if let Some(error) = first_error {
        return Err(error);
    }
    end(out)?;
    begin(out, "NIFTI_INTENT_TRIANGLE", "NIFTI_TYPE_INT32", mesh.triangles.len())?;
    write!(
        out,
        "{}<Data>",
        texts(&[("TopologicalType", topology(mesh).to_owned())])
    )?;
    compressed(out, mesh.triangles.iter().copied())?;
    end(out)?;
    out.write_all(b"</GIFTI>\n")?;
    Ok(())
}

fn topology(mesh: &Mesh) -> &'static str {
    if mesh.is_closed { "Closed" } else { "Open" }
}

/// Writes the start tag of an array with `rows` rows of three numbers.
fn begin(out: &mut dyn Write, intent: &str, kind: &str, rows: usize) -> Result<(), ExportError> {
    writeln!(
        out,
        "<DataArray Intent=\"{intent}\" DataType=\"{kind}\" ArrayIndexingOrder=\"RowMajorOrder\" Dimensionality=\"2\" \
         Dim0=\"{rows}\" Dim1=\"3\" Encoding=\"GZipBase64Binary\" Endian=\"LittleEndian\" ExternalFileName=\"\" \
         ExternalFileOffset=\"0\">"
    )?;
    Ok(())
}

fn end(out: &mut dyn Write) -> Result<(), ExportError> {
    out.write_all(b"</Data>\n</DataArray>\n")?;
    Ok(())
}

/// Returns a `MetaData` element with pairs of names and texts.
fn texts(pairs: &[(&str, String)]) -> String {
    let pair = |(name, text): &(&str, String)| {
        format!(
            "<MD><Name>{}</Name><Value>{}</Value></MD>\n",
            escaped(name),
            escaped(text)
        )
    };
    format!(
        "<MetaData>\n{}</MetaData>\n",
        pairs.iter().map(pair).collect::<String>()
    )
}

/// Writes rows as zlib in base64.
fn compressed<T: bytemuck::Pod>(
    out: &mut dyn Write,
    mut rows: impl Iterator<Item = [T; 3]>,
) -> Result<(), ExportError> {
    let mut encoder = ZlibEncoder::new(EncoderWriter::new(out, &STANDARD), LEVEL);
    let mut piece = Vec::with_capacity(PIECE);
    loop {
        piece.extend(rows.by_ref().take(PIECE));
        if piece.is_empty() {
            break;
        }
        encoder.write_all(bytemuck::cast_slice(piece.as_slice()))?;
        piece.clear();
    }
    encoder.finish()?.finish()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use base64::Engine;

    use super::super::mesh::tests::{geometry, two_quads};
    use super::*;
    use isopeel_volumes::LengthUnit;

    /// The bytes of a data array.
    fn array(text: &str, intent: &str) -> Vec<u8> {
        let (_, array) = text.split_once(&format!("Intent=\"{intent}\"")).unwrap();
        let data = array.split_once("<Data>").unwrap().1.split_once("</Data>").unwrap().0;
        let packed = STANDARD.decode(data).unwrap();
        let mut bytes = Vec::new();
        flate2::read::ZlibDecoder::new(&packed[..])
            .read_to_end(&mut bytes)
            .unwrap();
        bytes
    }

    #[test]
    fn a_mesh_reads_back_in_ras() {
        let mut mesh = Mesh::new(&two_quads(), &geometry()).unwrap();
        mesh.name = "a < b & c".to_owned();
        mesh.provenance = vec![("view", r#"{"iso":1}"#.to_owned())];
        for (frame, space, sign) in [
            (Frame::Lps, "NIFTI_XFORM_SCANNER_ANAT", -1.0),
            (Frame::Ras, "NIFTI_XFORM_SCANNER_ANAT", 1.0),
            (Frame::World, "NIFTI_XFORM_UNKNOWN", 1.0),
        ] {
            (mesh.frame, mesh.unit) = (frame, Some(LengthUnit::Millimetre));
            let mut bytes = Vec::new();
            write(&mesh, &mut bytes).unwrap();
            let text = String::from_utf8(bytes).unwrap();
            assert!(text.contains(&format!("<DataSpace>{space}</DataSpace>")), "{text}");
            assert!(text.contains("<Value>a &lt; b &amp; c</Value>"), "{text}");
            assert!(text.contains("Dim0=\"6\" Dim1=\"3\"") && text.contains("Dim0=\"4\" Dim1=\"3\""));
            let points: Vec<[f32; 3]> = bytemuck::pod_collect_to_vec(&array(&text, "NIFTI_INTENT_POINTSET"));
            let expected = (0..6).map(|vertex| {
                let [x, y, z] = mesh.world(vertex).map(|component| component as f32);
                [sign * x, sign * y, z]
            });
            assert_eq!(points, expected.collect::<Vec<_>>());
            let corners: Vec<[u32; 3]> = bytemuck::pod_collect_to_vec(&array(&text, "NIFTI_INTENT_TRIANGLE"));
            assert_eq!(corners, mesh.triangles);
        }
    }
}
