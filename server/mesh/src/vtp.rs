//! VTP, the `PolyData` of VTK's XML formats (<https://docs.vtk.org/en/latest/design_documents/VTKFileFormats.html>), for ParaView and VTK.
//!
//! Arrays follow the XML. An array is its length and raw bytes or, if it is compressed, the lengths of its blocks and blocks of zlib.

use std::io::{self, Write};

use flate2::Compression;
use flate2::write::ZlibEncoder;
use isopeel_volumes::LengthUnit;
use rayon::prelude::*;

use super::mesh::{attribute_names, srgb_bytes};
use super::rows::write_rows;
use super::{ExportError, Mesh};

/// Bytes of the length before each array.
const LENGTH_BYTES: u64 = 8;
/// Bytes of a block before compression. Blocks are compressed separately, in parallel.
const BLOCK_BYTES: usize = 1 << 20;
/// Compression level. The fastest one, because slower ones take three times as long to save a tenth of the bytes.
const LEVEL: Compression = Compression::fast();

/// Writes `mesh`. A point has `normal`, `smoothness` and `feature` (0 to 1), and a triangle has the `level` of its leaf. Positions have 64
/// bits, and indices 32 bits. Strings of the data set contain frame, unit and notices, if the mesh has them. If `compresses`, all arrays
/// are compressed in memory before the first one is written.
///
/// # Errors
/// The mesh has too many corners for 32-bit numbers, or `out` fails.
pub fn write(mesh: &Mesh, compresses: bool, out: &mut dyn Write) -> Result<(), ExportError> {
    let arrays = Arrays::new(mesh)?;
    let blocks: Vec<Option<Vec<u8>>> = match compresses {
        true => arrays
            .0
            .iter()
            .map(|array| compressed(mesh, array).map(Some))
            .collect::<Result<_, _>>()?,
        false => arrays.0.iter().map(|_| None).collect(),
    };
    let mut offset = 0;
    let mut elements = [const { String::new() }; 4];
    for (array, blocks) in arrays.0.iter().zip(&blocks) {
        let (kind, name, components) = (array.kind, &array.name, array.components);
        elements[array.section as usize] += &format!(
            "<DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{components}\" format=\"appended\" \
             offset=\"{offset}\"/>\n"
        );
        offset += blocks
            .as_ref()
            .map_or(LENGTH_BYTES + array.bytes, |blocks| blocks.len() as u64);
    }
    let [point_data, cell_data, points, polygons] = elements;
    let compressor = if compresses {
        " compressor=\"vtkZLibDataCompressor\""
    } else {
        ""
    };
    write!(
        out,
        "<?xml version=\"1.0\"?>\n\
         <!-- isopeel {} -->\n\
         <VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\"{compressor}>\n<PolyData>\n\
         <FieldData>\n{}</FieldData>\n\
         <Piece NumberOfPoints=\"{}\" NumberOfVerts=\"0\" NumberOfLines=\"0\" NumberOfStrips=\"0\" NumberOfPolys=\"{}\">\n\
         <PointData Normals=\"normal\">\n{point_data}</PointData>\n\
         <CellData Scalars=\"level\">\n{cell_data}</CellData>\n\
         <Points>\n{points}</Points>\n\
         <Polys>\n{polygons}</Polys>\n\
         </Piece>\n</PolyData>\n<AppendedData encoding=\"raw\">\n_",
        env!("CARGO_PKG_VERSION"),
        field_data(mesh),
        mesh.positions.len(),
        mesh.triangles.len(),
    )?;
    for (array, blocks) in arrays.0.iter().zip(blocks) {
        if let Some(blocks) = blocks {
            out.write_all(&blocks)?;
        } else {
            out.write_all(&array.bytes.to_le_bytes())?;
            array.content.write(mesh, out)?;
        }
    }
    out.write_all(b"\n</AppendedData>\n</VTKFile>\n")?;
    Ok(())
}

/// The XML element that contains an array.
#[derive(Clone, Copy)]
enum Section {
    PointData,
    CellData,
    Points,
    Polygons,
}

/// An array of the file.
struct Array {
    section: Section,
    kind: &'static str,
    name: String,
    components: u32,
    bytes: u64,
    content: Content,
}

/// Content of an array.
#[derive(Clone, Copy)]
enum Content {
    Normals,
    Smoothness,
    Feature,
    /// Values of the field with this number.
    Field(usize),
    Colors,
    Levels,
    Positions,
    Corners,
    /// For each triangle, the number of corners up to its end.
    Ends,
}

/// All arrays, in the order of the file.
struct Arrays(Vec<Array>);

impl Arrays {
    fn new(mesh: &Mesh) -> Result<Self, ExportError> {
        let (points, triangles) = (mesh.positions.len() as u64, mesh.triangles.len() as u64);
        // The last of the ends is the number of all corners, as a signed 32-bit number.
        if 3 * triangles > i32::MAX as u64 {
            return Err(ExportError::TooLarge {
                what: "corners of triangles",
                found: 3 * triangles,
                limit: i32::MAX as u64,
                format: "VTP",
            });
        }
        let mut arrays = Vec::new();
        let mut add = |section, kind, name: &str, components: u32, width: u64, content| {
            let count = match section {
                Section::PointData | Section::Points => points,
                Section::CellData => triangles,
                Section::Polygons => triangles * if matches!(content, Content::Corners) { 3 } else { 1 },
            };
            arrays.push(Array {
                section,
                kind,
                name: name.to_owned(),
                components,
                bytes: count * u64::from(components) * width,
                content,
            });
        };
        add(Section::PointData, "Float32", "normal", 3, 4, Content::Normals);
        add(Section::PointData, "Float32", "smoothness", 1, 4, Content::Smoothness);
        add(Section::PointData, "Float32", "feature", 1, 4, Content::Feature);
        for (number, name) in names(mesh).iter().enumerate() {
            add(Section::PointData, "Float32", name, 1, 4, Content::Field(number));
        }
        if !mesh.colors.is_empty() {
            add(Section::PointData, "UInt8", "color", 3, 1, Content::Colors);
        }
        add(Section::CellData, "UInt8", "level", 1, 1, Content::Levels);
        add(Section::Points, "Float64", "Points", 3, 8, Content::Positions);
        add(Section::Polygons, "Int32", "connectivity", 1, 4, Content::Corners);
        add(Section::Polygons, "Int32", "offsets", 1, 4, Content::Ends);
        Ok(Self(arrays))
    }
}

impl Content {
    /// Writes the array.
    fn write(self, mesh: &Mesh, out: &mut dyn Write) -> Result<(), ExportError> {
        match self {
            Self::Normals => out.write_all(bytemuck::cast_slice(&mesh.normals))?,
            Self::Smoothness => out.write_all(bytemuck::cast_slice(&mesh.smoothness))?,
            Self::Feature => out.write_all(bytemuck::cast_slice(&mesh.feature))?,
            Self::Field(number) => out.write_all(bytemuck::cast_slice(&mesh.fields[number].values))?,
            Self::Corners => out.write_all(bytemuck::cast_slice(&mesh.triangles))?,
            Self::Colors => write_rows(mesh.colors.len(), out, |vertex, bytes| {
                bytes.extend_from_slice(&srgb_bytes(mesh.colors[vertex]));
            })?,
            Self::Positions => write_rows(mesh.positions.len(), out, |vertex, bytes| {
                bytes.extend_from_slice(bytemuck::bytes_of(&mesh.world(vertex)));
            })?,
            Self::Ends => write_rows(mesh.triangles.len(), out, |triangle, bytes| {
                bytes.extend_from_slice(&(3 * (triangle as u32 + 1)).to_le_bytes());
            })?,
            Self::Levels => {
                for (level, &count) in (0u8..).zip(&mesh.level_triangles) {
                    io::copy(&mut io::Read::take(io::repeat(level), count), out)?;
                }
            }
        }
        Ok(())
    }
}

/// Returns a compressed array: number of blocks, uncompressed bytes of a block, uncompressed bytes of the last block, compressed bytes of
/// each block, and the blocks.
fn compressed(mesh: &Mesh, array: &Array) -> Result<Vec<u8>, ExportError> {
    let mut bytes = Vec::with_capacity(array.bytes as usize);
    array.content.write(mesh, &mut bytes)?;
    let deflated = bytes.par_chunks(BLOCK_BYTES).map(|block| {
        let mut encoder = ZlibEncoder::new(Vec::new(), LEVEL);
        encoder.write_all(block)?;
        encoder.finish()
    });
    let blocks: Vec<Vec<u8>> = deflated.collect::<io::Result<_>>()?;
    // 0 if the last block is as long as the others, as the format requires.
    let last_bytes = bytes.len() % BLOCK_BYTES;
    let header = [blocks.len(), BLOCK_BYTES, last_bytes]
        .into_iter()
        .chain(blocks.iter().map(Vec::len));
    let header: Vec<u8> = header.flat_map(|number| (number as u64).to_le_bytes()).collect();
    Ok([header, blocks.concat()].concat())
}

/// Returns the strings of the data set.
fn field_data(mesh: &Mesh) -> String {
    let unit = mesh.unit.map(LengthUnit::symbol);
    let notice = (!mesh.notices.is_empty()).then(|| mesh.notices.join("\n"));
    let mut field_data = [
        text("frame", mesh.frame.name()),
        unit.map_or_else(String::new, |unit| text("unit", unit)),
        notice.map_or_else(String::new, |notice| text("notice", &notice)),
    ]
    .concat();
    if mesh.frame.is_anatomical() {
        // States the frame in the form that 3D Slicer reads.
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
    field_data
}

/// Returns the array names of the fields.
fn names(mesh: &Mesh) -> Vec<String> {
    attribute_names(mesh, "", &["normal", "smoothness", "feature", "color"])
}

/// Returns the element of a string of the data set. The string is a list of its bytes as numbers, with a final 0.
fn text(name: &str, value: &str) -> String {
    let numbers: Vec<String> = value.bytes().chain([0]).map(|byte| byte.to_string()).collect();
    format!(
        "<Array type=\"String\" Name=\"{name}\" NumberOfTuples=\"1\" format=\"ascii\">{}</Array>\n",
        numbers.join(" ")
    )
}

#[cfg(test)]
mod tests {
    use super::super::mesh::tests::{geometry, surface, two_quads};
    use super::*;
    use isopeel_volumes::Frame;

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
        write(&mesh, false, &mut bytes).unwrap();
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
        let corners: Vec<i32> = bytemuck::pod_collect_to_vec(&array("connectivity"));
        assert_eq!(corners, [0, 1, 2, 1, 4, 5, 1, 5, 2, 0, 2, 3]);
        let offsets: Vec<i32> = bytemuck::pod_collect_to_vec(&array("offsets"));
        assert_eq!(offsets, [3, 6, 9, 12]);
    }

    #[test]
    fn compressed_arrays_are_blocks_behind_their_lengths() {
        let mut mesh = Mesh::new(&two_quads(), &geometry()).unwrap();
        // Two blocks of positions, of which the second is short.
        let far = BLOCK_BYTES / 24 + 5;
        for _ in mesh.positions.len()..far {
            mesh.copy_vertex(3);
        }
        let mut bytes = Vec::new();
        write(&mesh, true, &mut bytes).unwrap();
        let mark = b"<AppendedData encoding=\"raw\">\n_";
        let begin = bytes.windows(mark.len()).position(|w| w == mark).unwrap() + mark.len();
        let xml = std::str::from_utf8(&bytes[..begin]).unwrap();
        assert!(xml.contains("compressor=\"vtkZLibDataCompressor\""), "{xml}");
        let (_, element) = xml.split_once("Name=\"Points\"").unwrap();
        let offset = element.split_once("offset=\"").unwrap().1.split('"').next().unwrap();
        let mut at = begin + offset.parse::<usize>().unwrap();
        let mut number = || {
            at += 8;
            u64::from_le_bytes(bytes[at - 8..at].try_into().unwrap()) as usize
        };
        let [count, block, last] = [number(), number(), number()];
        assert_eq!((count, block, last), (2, BLOCK_BYTES, 24 * far - BLOCK_BYTES));
        let lengths = [number(), number()];
        let mut points = Vec::new();
        for length in lengths {
            let mut decoder = flate2::read::ZlibDecoder::new(&bytes[at..at + length]);
            io::Read::read_to_end(&mut decoder, &mut points).unwrap();
            at += length;
        }
        let points: Vec<[f64; 3]> = bytemuck::pod_collect_to_vec(&points);
        assert_eq!(points, (0..far).map(|vertex| mesh.world(vertex)).collect::<Vec<_>>());
    }

    #[test]
    fn an_empty_surface_has_empty_arrays() {
        let mesh = Mesh::new(&surface(Vec::new()), &geometry()).unwrap();
        let mut bytes = Vec::new();
        write(&mesh, false, &mut bytes).unwrap();
        let (xml, array) = parse(&bytes);
        assert!(
            xml.contains("NumberOfPolys=\"0\"") && !xml.contains("Name=\"unit\"") && !xml.contains("Name=\"notice\""),
            "{xml}"
        );
        assert!(array("Points").is_empty() && array("offsets").is_empty());
    }
}
