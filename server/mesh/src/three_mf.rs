//! 3MF (<https://3mf.io/specification>) for 3D printing: the core specification, and colours of the materials extension.

use std::collections::HashMap;
use std::io::{self, Write};

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::decimal::{Decimals, push_whole};
use super::mesh::srgb_bytes;
use super::rows::write_rows;
use super::xml::escaped;
use super::{ExportError, MAX_BYTES_WITHOUT_ZIP64, Mesh};

/// Compression level of deflate. The fastest one, because higher ones take three times as long to save a tenth of the bytes.
const LEVEL: i64 = 1;
/// Upper bound of the bytes of text for a triangle, including its share of the vertices.
const TRIANGLE_BYTES: u64 = 200;
/// Id of the group of materials. The ids of colour groups and objects follow.
const MATERIALS: usize = 1;

const CONTENT_TYPES: &str = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\
     <Types xmlns=\"http://schemas.openxmlformats.org/package/2006/content-types\">\
     <Default Extension=\"rels\" ContentType=\"application/vnd.openxmlformats-package.relationships+xml\"/>\
     <Default Extension=\"model\" ContentType=\"application/vnd.ms-package.3dmanufacturing-3dmodel+xml\"/>\
     </Types>\n";

const RELATIONSHIPS: &str = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\
     <Relationships xmlns=\"http://schemas.openxmlformats.org/package/2006/relationships\">\
     <Relationship Target=\"/3D/3dmodel.model\" Id=\"rel0\" \
     Type=\"http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel\"/>\
     </Relationships>\n";

/// Writes `meshes` as one object each, in millimetres. An object of a closed surface has the type `model`, which means a solid; other
/// objects have the type `surface`. An object has the colours of its vertices, or else the colour of its material. Metadata contain the
/// provenance of the first mesh. If `compresses`, the files in the ZIP are deflated, which takes several times as long as writing them.
///
/// # Errors
/// Errors of `out`.
pub fn write(meshes: &[Mesh], compresses: bool, out: &mut dyn Write) -> Result<(), ExportError> {
    let triangles: u64 = meshes.iter().map(|mesh| mesh.triangles.len() as u64).sum();
    let (method, level) = match compresses {
        true => (CompressionMethod::Deflated, Some(LEVEL)),
        false => (CompressionMethod::Stored, None),
    };
    let options = SimpleFileOptions::default()
        .compression_method(method)
        .compression_level(level)
        .large_file(triangles.saturating_mul(TRIANGLE_BYTES) > MAX_BYTES_WITHOUT_ZIP64);
    let mut package = ZipWriter::new_stream(out);
    package
        .start_file("[Content_Types].xml", options)
        .map_err(io::Error::from)?;
    package.write_all(CONTENT_TYPES.as_bytes())?;
    package.start_file("_rels/.rels", options).map_err(io::Error::from)?;
    package.write_all(RELATIONSHIPS.as_bytes())?;
    package
        .start_file("3D/3dmodel.model", options)
        .map_err(io::Error::from)?;
    model(meshes, &mut package)?;
    package.finish().map_err(io::Error::from)?;
    Ok(())
}

fn model(meshes: &[Mesh], out: &mut dyn Write) -> Result<(), ExportError> {
    out.write_all(
        b"<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\
         <model unit=\"millimeter\" xml:lang=\"en-US\" \
         xmlns=\"http://schemas.microsoft.com/3dmanufacturing/core/2015/02\" \
         xmlns:m=\"http://schemas.microsoft.com/3dmanufacturing/material/2015/02\" \
         xmlns:isopeel=\"urn:isopeel:provenance\">\n",
    )?;
    write!(out, "{}<resources>\n{}", metadata(meshes), materials(meshes))?;
    let mut next = MATERIALS + 1;
    let mut items = String::new();
    // Skips empty meshes, because an object must have triangles.
    for (material, mesh) in meshes.iter().enumerate().filter(|(_, mesh)| !mesh.triangles.is_empty()) {
        let colors = (!mesh.colors.is_empty()).then(|| Colors::new(mesh, next));
        if let Some(colors) = &colors {
            out.write_all(colors.group.as_bytes())?;
            next += 1;
        }
        object(mesh, next, material, colors.as_ref(), out)?;
        let decimals = Decimals::of_spacing(mesh.smallest_spacing);
        let mut translation = Vec::new();
        for component in mesh.origin {
            translation.push(b' ');
            decimals.push(&mut translation, component);
        }
        items += &format!(
            "<item objectid=\"{next}\" transform=\"1 0 0 0 1 0 0 0 1{}\"/>\n",
            String::from_utf8_lossy(&translation)
        );
        next += 1;
    }
    write!(out, "</resources>\n<build>\n{items}</build>\n</model>\n")?;
    Ok(())
}

/// Returns the metadata elements: title, program, frame, provenance and notices. Names that the specification does not define have the
/// namespace `isopeel`.
fn metadata(meshes: &[Mesh]) -> String {
    let Some(first) = meshes.first() else {
        return String::new();
    };
    let title: Vec<&str> = meshes.iter().map(|mesh| mesh.name.as_str()).collect();
    let mut pairs = vec![
        ("Title".to_owned(), title.join("; ")),
        (
            "Application".to_owned(),
            concat!("isopeel ", env!("CARGO_PKG_VERSION")).to_owned(),
        ),
        ("isopeel:frame".to_owned(), first.frame.name().to_owned()),
    ];
    pairs.extend(
        first
            .provenance
            .iter()
            .map(|(name, text)| (format!("isopeel:{name}"), text.clone())),
    );
    if !first.notices.is_empty() {
        pairs.push(("Description".to_owned(), first.notices.join("\n")));
    }
    let line = |(name, text): &(String, String)| format!("<metadata name=\"{name}\">{}</metadata>\n", escaped(text));
    pairs.iter().map(line).collect()
}

/// Returns the group of materials, with one material for each mesh.
fn materials(meshes: &[Mesh]) -> String {
    let material = |mesh: &Mesh| {
        let [red, green, blue] = mesh.material.color.unwrap_or([255; 3]);
        let alpha = (255.0 * mesh.material.opacity).round() as u8;
        let name = escaped(&mesh.name);
        format!("<base name=\"{name}\" displaycolor=\"#{red:02X}{green:02X}{blue:02X}{alpha:02X}\"/>\n")
    };
    match meshes.is_empty() {
        true => String::new(),
        false => format!(
            "<basematerials id=\"{MATERIALS}\">\n{}</basematerials>\n",
            meshes.iter().map(material).collect::<String>()
        ),
    }
}

/// The colour group of a mesh: its distinct vertex colours.
struct Colors {
    id: usize,
    /// The XML element of the group.
    group: String,
    /// For each vertex, the index of its colour in the group.
    vertex_indices: Vec<u32>,
}

impl Colors {
    fn new(mesh: &Mesh, id: usize) -> Self {
        let (mut numbers, mut group) = (HashMap::new(), format!("<m:colorgroup id=\"{id}\">\n"));
        let vertex_indices = mesh.colors.iter().map(|&color| {
            let color @ [red, green, blue] = srgb_bytes(color);
            let next = numbers.len() as u32;
            *numbers.entry(color).or_insert_with(|| {
                group += &format!("<m:color color=\"#{red:02X}{green:02X}{blue:02X}\"/>\n");
                next
            })
        });
        let vertex_indices = vertex_indices.collect();
        group += "</m:colorgroup>\n";
        Self {
            id,
            group,
            vertex_indices,
        }
    }
}

fn object(
    mesh: &Mesh,
    id: usize,
    material: usize,
    colors: Option<&Colors>,
    out: &mut dyn Write,
) -> Result<(), ExportError> {
    let kind = if mesh.is_closed { "model" } else { "surface" };
    write!(
        out,
        "<object id=\"{id}\" type=\"{kind}\" name=\"{}\" pid=\"{MATERIALS}\" pindex=\"{material}\">\n<mesh>\n<vertices>\n",
        escaped(&mesh.name)
    )?;
    let decimals = Decimals::of_spacing(mesh.smallest_spacing);
    write_rows(mesh.positions.len(), out, |vertex, text| {
        let names = ["<vertex x=\"", "\" y=\"", "\" z=\""];
        for (name, component) in names.into_iter().zip(mesh.positions[vertex]) {
            text.extend_from_slice(name.as_bytes());
            decimals.push(text, component.into());
        }
        text.extend_from_slice(b"\"/>\n");
    })?;
    out.write_all(b"</vertices>\n<triangles>\n")?;
    // Skips degenerate triangles, because the specification forbids equal corners.
    write_rows(mesh.triangles.len(), out, |triangle, text| {
        let corners @ [a, b, c] = mesh.triangles[triangle];
        if a == b || b == c || c == a {
            return;
        }
        for (name, corner) in ["<triangle v1=\"", "\" v2=\"", "\" v3=\""].into_iter().zip(corners) {
            text.extend_from_slice(name.as_bytes());
            push_whole(text, corner.into());
        }
        if let Some(colors) = colors {
            text.extend_from_slice(b"\" pid=\"");
            push_whole(text, colors.id as u64);
            for (name, corner) in ["\" p1=\"", "\" p2=\"", "\" p3=\""].into_iter().zip(corners) {
                text.extend_from_slice(name.as_bytes());
                push_whole(text, colors.vertex_indices[corner as usize].into());
            }
        }
        text.extend_from_slice(b"\"/>\n");
    })?;
    out.write_all(b"</triangles>\n</mesh>\n</object>\n")?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use quick_xml::Reader;
    use quick_xml::events::Event;
    use zip::ZipArchive;

    use super::super::mesh::tests::{geometry, two_quads};
    use super::*;

    fn package(meshes: &[Mesh], compresses: bool) -> Vec<u8> {
        let mut bytes = Vec::new();
        write(meshes, compresses, &mut bytes).unwrap();
        bytes
    }

    fn model_of(meshes: &[Mesh], compresses: bool) -> String {
        let mut package = ZipArchive::new(io::Cursor::new(package(meshes, compresses))).unwrap();
        for name in ["[Content_Types].xml", "_rels/.rels"] {
            assert!(package.by_name(name).is_ok(), "{name}");
        }
        io::read_to_string(package.by_name("3D/3dmodel.model").unwrap()).unwrap()
    }

    /// Elements of the model in their order, each with its attributes.
    fn elements(meshes: &[Mesh]) -> Vec<(String, HashMap<String, String>)> {
        let model = model_of(meshes, false);
        assert_eq!(model_of(meshes, true), model);
        let mut reader = Reader::from_str(&model);
        let mut elements = Vec::new();
        loop {
            match reader.read_event().unwrap() {
                Event::Eof => return elements,
                Event::Start(start) | Event::Empty(start) => {
                    let attributes = start.attributes().map(|attribute| {
                        let attribute = attribute.unwrap();
                        (attribute.key.as_ref().to_owned(), attribute.value.into_owned())
                    });
                    let attributes = attributes.collect();
                    elements.push((start.name().as_ref().to_owned(), attributes));
                }
                _ => {}
            }
        }
    }

    #[test]
    fn objects_read_back_in_their_places() {
        let mut mesh = Mesh::new(&two_quads(), &geometry()).unwrap();
        mesh.name = "a & b".to_owned();
        mesh.material.color = Some([1, 171, 255]);
        mesh.material.opacity = 0.5;
        let mut closed = mesh.clone();
        closed.is_closed = true;
        closed.colors = vec![[65535, 0, 0], [0; 3], [65535, 0, 0], [0; 3], [0; 3], [65535; 3]];
        let found = elements(&[mesh.clone(), closed]);
        let named = |name: &'static str| {
            found
                .iter()
                .filter(move |(found, _)| found == name)
                .map(|(_, attributes)| attributes)
        };
        assert_eq!(named("model").next().unwrap()["unit"], "millimeter");
        assert_eq!(named("base").next().unwrap()["displaycolor"], "#01ABFF80");
        let objects: Vec<_> = named("object")
            .map(|object| (object["type"].as_str(), object["name"].as_str()))
            .collect();
        assert_eq!(objects, [("surface", "a &amp; b"), ("model", "a &amp; b")]);
        let ids: Vec<_> = named("object").map(|object| object["id"].clone()).collect();
        let items: Vec<_> = named("item").map(|item| item["objectid"].clone()).collect();
        assert_eq!(items, ids);
        assert_eq!(
            named("item").next().unwrap()["transform"],
            "1 0 0 0 1 0 0 0 1 48.00000 16.00000 16.00000"
        );
        let vertices: Vec<[f32; 3]> = named("vertex")
            .map(|vertex| ["x", "y", "z"].map(|axis| vertex[axis].parse().unwrap()))
            .collect();
        assert_eq!(vertices[..6], mesh.positions);
        let triangles: Vec<[u32; 3]> = named("triangle")
            .map(|triangle| ["v1", "v2", "v3"].map(|corner| triangle[corner].parse().unwrap()))
            .collect();
        assert_eq!((triangles.len(), &triangles[..4]), (8, &mesh.triangles[..]));
        let colors: Vec<_> = named("m:color").map(|color| color["color"].as_str()).collect();
        assert_eq!(colors, ["#FF0000", "#000000", "#FFFFFF"]);
        let last = named("triangle").next_back().unwrap();
        assert_eq!(["p1", "p2", "p3"].map(|corner| last[corner].as_str()), ["0", "0", "1"]);
        assert!(named("triangle").next().unwrap().get("p1").is_none());
    }

    #[test]
    fn only_a_compressed_package_is_smaller_than_its_text() {
        let mesh = Mesh::new(&two_quads(), &geometry()).unwrap();
        let meshes = vec![mesh; 20];
        let (text, stored) = (model_of(&meshes, false).len(), package(&meshes, false).len());
        let deflated = package(&meshes, true).len();
        assert!(
            stored > text && deflated < text / 4,
            "{text} bytes of text, {stored} stored, {deflated} deflated"
        );
    }

    #[test]
    fn an_empty_surface_is_no_object() {
        let found = elements(&[Mesh::default()]);
        assert!(
            found.iter().all(|(name, _)| name != "object" && name != "item"),
            "{found:?}"
        );
        assert!(found.iter().any(|(name, _)| name == "build"));
    }
}
