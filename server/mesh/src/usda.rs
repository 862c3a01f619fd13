//! The text form of Universal Scene Description (<https://openusd.org>): the layer in a USDZ.
//!
//! The prim `/Surfaces` rotates its children so that Y is up, as in a GLB. It contains a mesh for each surface, and the scope `Materials`
//! with a material for each surface. `metersPerUnit` states the unit of the file. Positions of a mesh are relative to an origin, which a
//! translation of 64 bits adds.

use std::collections::BTreeMap;
use std::io::Write;

use isopeel_volumes::LengthUnit;

use super::decimal::{Decimals, push_whole};
use super::mesh::{distinct_names, linear, plain};
use super::rows::write_rows;
use super::{ExportError, Mesh};

/// Name of the scope that contains the materials.
const MATERIALS: &str = "Materials";
/// Digits after the decimal point of components of normals and colours.
const UNIT_DIGITS: usize = 5;

/// Primvar names that have a meaning for readers of USD: colours, texture coordinates, and attributes of UsdGeom that a primvar with the
/// same name overrides.
const TAKEN: [&str; 11] = [
    "displayColor",
    "displayOpacity",
    "points",
    "normals",
    "tangents",
    "bitangents",
    "velocities",
    "accelerations",
    "widths",
    "st",
    "uv",
];

/// Writes all `meshes` with triangles as a stage, in the unit of the first mesh.
///
/// # Errors
/// Errors of `out`.
pub fn write(meshes: &[Mesh], out: &mut dyn Write) -> Result<(), ExportError> {
    let non_empty: Vec<&Mesh> = meshes.iter().filter(|mesh| !mesh.triangles.is_empty()).collect();
    let stage_metres = meshes.first().map_or(1.0, metres);
    let names = identifiers(&non_empty);
    out.write_all(head(stage_metres).as_bytes())?;
    for (mesh, name) in non_empty.iter().zip(&names) {
        surface(mesh, name, metres(mesh) / stage_metres, out)?;
    }
    write!(out, "    def Scope \"{MATERIALS}\"\n    {{\n")?;
    for (mesh, name) in non_empty.iter().zip(&names) {
        out.write_all(material(mesh, name).as_bytes())?;
    }
    out.write_all(b"    }\n}\n")?;
    Ok(())
}

/// Returns the length of a mesh's unit in metres. Without a unit, this is 1, as in a GLB.
fn metres(mesh: &Mesh) -> f64 {
    mesh.unit.and_then(LengthUnit::metres).unwrap_or(1.0)
}

/// Returns the text before the meshes. USD states a matrix by rows, and multiplies row vectors from the left: (x, y, z) becomes (x, z, −y).
fn head(metres: f64) -> String {
    let version = env!("CARGO_PKG_VERSION");
    format!(
        "#usda 1.0\n(\n    defaultPrim = \"Surfaces\"\n    doc = \"isopeel {version}\"\n    metersPerUnit = {metres:?}\n    upAxis = \"Y\"\n)\n\n\
         def Xform \"Surfaces\" (\n    kind = \"component\"\n)\n{{\n    \
         matrix4d xformOp:transform = ( (1, 0, 0, 0), (0, 0, -1, 0), (0, 1, 0, 0), (0, 0, 0, 1) )\n    \
         uniform token[] xformOpOrder = [\"xformOp:transform\"]\n\n"
    )
}

/// Returns distinct prim names of the meshes, from their names.
fn identifiers(meshes: &[&Mesh]) -> Vec<String> {
    distinct_names(meshes.iter().map(|mesh| identifier(&mesh.name)), &[MATERIALS])
}

/// Converts a name to an identifier of USD, which begins with a letter or `_`.
fn identifier(name: &str) -> String {
    let name = plain(name);
    match name.starts_with(|c: char| c.is_ascii_alphabetic()) {
        true => name,
        false => format!("_{name}"),
    }
}

/// Returns a string in quotation marks, with escapes.
fn quoted(string: &str) -> String {
    let escaped = |c: char| match c {
        '"' | '\\' => format!("\\{c}"),
        '\n' => "\\n".to_owned(),
        c if c.is_control() => " ".to_owned(),
        c => c.to_string(),
    };
    format!("\"{}\"", string.chars().map(escaped).collect::<String>())
}

/// Writes a mesh. `scale` is the unit of the mesh divided by the unit of the stage.
fn surface(mesh: &Mesh, name: &str, scale: f64, out: &mut dyn Write) -> Result<(), ExportError> {
    let decimals = Decimals::of_spacing(mesh.smallest_spacing);
    let [low, high] = [f32::min, f32::max].map(|choose| {
        let first = mesh.positions.first().copied().unwrap_or_default();
        let extend = |end: [f32; 3], position: &[f32; 3]| [0, 1, 2].map(|axis| choose(end[axis], position[axis]));
        mesh.positions.iter().fold(first, extend)
    });
    let mut extent = Vec::new();
    tuples(&[low, high], decimals, &mut extent)?;
    let [x, y, z] = mesh.origin.map(|component| component * scale);
    let is_scaled = scale != 1.0;
    write!(
        out,
        "    def Mesh \"{name}\" (\n        prepend apiSchemas = [\"MaterialBindingAPI\"]\n{}        displayName = {}\n    )\n    {{\n        \
             uniform bool doubleSided = 1\n        uniform token subdivisionScheme = \"none\"\n        \
             uniform token orientation = \"rightHanded\"\n        rel material:binding = </Surfaces/{MATERIALS}/{name}>\n        \
             double3 xformOp:translate = ({x:?}, {y:?}, {z:?})\n{}        \
             uniform token[] xformOpOrder = [\"xformOp:translate\"{}]\n        float3[] extent = [{}]\n",
        provenance(mesh),
        quoted(&mesh.name),
        if is_scaled {
            format!("        double3 xformOp:scale = ({scale:?}, {scale:?}, {scale:?})\n")
        } else {
            String::new()
        },
        if is_scaled { ", \"xformOp:scale\"" } else { "" },
        String::from_utf8_lossy(&extent),
    )?;
    topology(mesh, out)?;
    out.write_all(b"        point3f[] points = [")?;
    tuples(&mesh.positions, decimals, out)?;
    out.write_all(b"]\n        normal3f[] normals = [")?;
    tuples(&mesh.normals, Decimals::new(UNIT_DIGITS), out)?;
    out.write_all(b"] (\n            interpolation = \"vertex\"\n        )\n")?;
    colors(mesh, out)?;
    fields(mesh, out)?;
    out.write_all(b"    }\n\n")?;
    Ok(())
}

/// Returns the metadata of a mesh: provenance, frame, unit and notices, sorted by name as USD sorts dictionaries.
fn provenance(mesh: &Mesh) -> String {
    let mut pairs: BTreeMap<&str, String> = mesh
        .provenance
        .iter()
        .map(|(name, text)| (*name, text.clone()))
        .collect();
    pairs.insert("frame", mesh.frame.name().to_owned());
    pairs.insert("unit", mesh.unit.map_or("unknown", LengthUnit::ascii_symbol).to_owned());
    let notices: Vec<&str> = mesh
        .notices
        .iter()
        .map(String::as_str)
        .filter(|line| !line.is_empty())
        .collect();
    if !notices.is_empty() {
        pairs.insert("notice", notices.join("\n"));
    }
    let line = |(name, text): (&str, String)| format!("                string {name} = {}\n", quoted(&text));
    let lines: String = pairs.into_iter().map(line).collect();
    format!("        customData = {{\n            dictionary isopeel = {{\n{lines}            }}\n        }}\n")
}

fn topology(mesh: &Mesh, out: &mut dyn Write) -> Result<(), ExportError> {
    let corners = mesh.triangles.as_flattened();
    out.write_all(b"        int[] faceVertexCounts = [")?;
    list(mesh.triangles.len(), out, |_, text| text.push(b'3'))?;
    out.write_all(b"]\n        int[] faceVertexIndices = [")?;
    list(corners.len(), out, |i, text| push_whole(text, corners[i].into()))?;
    out.write_all(b"]\n")?;
    Ok(())
}

/// Writes items, separated by commas.
fn list(count: usize, out: &mut dyn Write, push: impl Fn(usize, &mut Vec<u8>) + Sync) -> Result<(), ExportError> {
    write_rows(count, out, |item, text| {
        if item > 0 {
            text.extend_from_slice(b", ");
        }
        push(item, text);
    })?;
    Ok(())
}

/// Writes triples of numbers, separated by commas.
fn tuples(rows: &[[f32; 3]], decimals: Decimals, out: &mut dyn Write) -> Result<(), ExportError> {
    list(rows.len(), out, |row, text| {
        text.push(b'(');
        for (axis, component) in rows[row].into_iter().enumerate() {
            if axis > 0 {
                text.extend_from_slice(b", ");
            }
            decimals.push(text, component.into());
        }
        text.push(b')');
    })
}

/// Writes the colours of the vertices, or else the colour of the surface. Colours are linear, as USD defines them.
fn colors(mesh: &Mesh, out: &mut dyn Write) -> Result<(), ExportError> {
    let decimals = Decimals::new(UNIT_DIGITS);
    let vertex_colors: Vec<[f32; 3]> = (mesh.colors.iter())
        .map(|color| color.map(|component| f32::from(component) / 65535.0))
        .collect();
    let (colors, interpolation) = match vertex_colors.is_empty() {
        true => (vec![color(mesh)], "constant"),
        false => (vertex_colors, "vertex"),
    };
    out.write_all(b"        color3f[] primvars:displayColor = [")?;
    tuples(&colors, decimals, out)?;
    let opacity = mesh.material.opacity;
    write!(
        out,
        "] (\n            interpolation = \"{interpolation}\"\n        )\n        \
         float[] primvars:displayOpacity = [{opacity:?}] (\n            interpolation = \"constant\"\n        )\n"
    )?;
    Ok(())
}

/// Returns the colour of the whole surface, linear.
fn color(mesh: &Mesh) -> [f32; 3] {
    mesh.material
        .color
        .unwrap_or([255; 3])
        .map(|byte| linear(f32::from(byte) / 255.0))
}

/// Writes the values of fields at the vertices. A missing value is NaN.
fn fields(mesh: &Mesh, out: &mut dyn Write) -> Result<(), ExportError> {
    let names = distinct_names(mesh.fields.iter().map(|field| identifier(&field.name)), &TAKEN);
    for (field, name) in mesh.fields.iter().zip(names) {
        write!(out, "        float[] primvars:{name} = [")?;
        list(field.values.len(), out, |vertex, text| {
            let value = field.values[vertex];
            if value.is_nan() {
                text.extend_from_slice(b"nan");
            } else {
                // Cannot fail, because the target is a vector.
                let _ = write!(text, "{value:?}");
            }
        })?;
        let unit = field.unit.as_ref();
        let unit = unit.map_or(String::new(), |unit| {
            format!("                string unit = {}\n", quoted(unit))
        });
        write!(
            out,
            "] (\n            customData = {{\n                string field = {}\n{unit}            }}\n            \
             interpolation = \"vertex\"\n        )\n",
            quoted(&field.name)
        )?;
    }
    Ok(())
}

/// Returns the material of a mesh. If the vertices have colours, the material uses these.
fn material(mesh: &Mesh, name: &str) -> String {
    let path = format!("/Surfaces/{MATERIALS}/{name}");
    let ([red, green, blue], opacity) = (color(mesh), mesh.material.opacity);
    let (diffuse, reader) = match mesh.colors.is_empty() {
        true => (format!(" = ({red:?}, {green:?}, {blue:?})"), String::new()),
        false => (
            format!(".connect = <{path}/Colors.outputs:result>"),
            "\n            def Shader \"Colors\"\n            {\n                \
             uniform token info:id = \"UsdPrimvarReader_float3\"\n                \
             string inputs:varname = \"displayColor\"\n                float3 outputs:result\n            }\n"
                .to_owned(),
        ),
    };
    format!(
        "        def Material \"{name}\"\n        {{\n            token outputs:surface.connect = <{path}/Surface.outputs:surface>\n\n            \
         def Shader \"Surface\"\n            {{\n                uniform token info:id = \"UsdPreviewSurface\"\n                \
         color3f inputs:diffuseColor{diffuse}\n                float inputs:metallic = 0\n                \
         float inputs:opacity = {opacity:?}\n                float inputs:roughness = 0.8\n                \
         token outputs:surface\n            }}\n{reader}        }}\n"
    )
}

#[cfg(test)]
mod tests {
    use super::super::mesh::FieldValues;
    use super::super::mesh::tests::{geometry, two_quads};
    use super::*;

    fn mesh(name: &str, unit: LengthUnit) -> Mesh {
        let mut mesh = Mesh::new(&two_quads(), &geometry()).unwrap();
        (mesh.name, mesh.unit) = (name.to_owned(), Some(unit));
        mesh
    }

    fn layer(meshes: &[Mesh]) -> String {
        let mut text = Vec::new();
        write(meshes, &mut text).unwrap();
        String::from_utf8(text).unwrap()
    }

    #[test]
    fn surfaces_have_their_names_and_their_place_in_the_unit_of_the_first() {
        let mut skin = mesh("head: t1 = 3", LengthUnit::Millimetre);
        skin.material.color = Some([0, 255, 0]);
        skin.material.opacity = 0.5;
        skin.provenance = vec![("volume", "a \"b\"\\".to_owned())];
        let text = layer(&[
            skin.clone(),
            Mesh::default(),
            skin,
            mesh("7 µm", LengthUnit::Micrometre),
        ]);
        for line in [
            "metersPerUnit = 0.001\n",
            "upAxis = \"Y\"\n",
            "def Mesh \"head__t1___3\" (\n",
            "def Mesh \"head__t1___3_2\" (\n",
            "def Mesh \"_7__m\" (\n",
            "displayName = \"7 µm\"\n",
            "string volume = \"a \\\"b\\\"\\\\\"\n",
            "double3 xformOp:translate = (48.0, 16.0, 16.0)\n",
            "double3 xformOp:translate = (0.048, 0.016, 0.016)\n",
            "double3 xformOp:scale = (0.001, 0.001, 0.001)\n",
            "int[] faceVertexIndices = [0, 1, 2, 1, 4, 5, 1, 5, 2, 0, 2, 3]\n",
            "color3f[] primvars:displayColor = [(0.00000, 1.00000, 0.00000)]",
            "float[] primvars:displayOpacity = [0.5]",
            "color3f inputs:diffuseColor = (0.0, 1.0, 0.0)\n",
            "rel material:binding = </Surfaces/Materials/head__t1___3_2>\n",
        ] {
            assert!(text.contains(line), "{line:?} in {text}");
        }
        assert_eq!(text.matches("def Mesh").count(), 3, "one without triangles is none");
        assert_eq!(text.matches("def Material ").count(), 3);
    }

    #[test]
    fn vertices_have_colours_and_values() {
        let mut mesh = mesh("a", LengthUnit::Millimetre);
        mesh.colors = vec![[65535, 0, 0]; 6];
        let values = vec![1.5, f32::NAN, -2e-10, 0.0, 1.0, 3e30];
        mesh.fields = vec![
            FieldValues {
                name: "t (2)".to_owned(),
                unit: Some("°C".to_owned()),
                values: values.clone(),
            },
            FieldValues {
                name: "t_[2]".to_owned(),
                unit: None,
                values,
            },
        ];
        let text = layer(std::slice::from_ref(&mesh));
        for line in [
            "float[] primvars:t__2_ = [1.5, nan, -2e-10, 0.0, 1.0, 3e30] (\n",
            "float[] primvars:t__2__2 = [",
            "string unit = \"°C\"\n",
            "color3f inputs:diffuseColor.connect = </Surfaces/Materials/a/Colors.outputs:result>\n",
            "string inputs:varname = \"displayColor\"\n",
        ] {
            assert!(text.contains(line), "{line:?} in {text}");
        }
        assert_eq!(text.matches("(1.00000, 0.00000, 0.00000)").count(), 6);
        assert!(layer(&[]).contains("def Xform \"Surfaces\""));
    }

    #[test]
    fn values_have_names_without_another_meaning() {
        let mut mesh = mesh("a", LengthUnit::Millimetre);
        let names = ["normals", "ST", "ball", "2*ball", "µ"];
        let values = |name: &str| FieldValues {
            name: name.to_owned(),
            unit: None,
            values: vec![0.0; 6],
        };
        mesh.fields = names.map(values).to_vec();
        let text = layer(&[mesh]);
        for name in ["normals_2", "ST_2", "ball", "_2_ball", "__"] {
            assert!(
                text.contains(&format!("float[] primvars:{name} = [")),
                "{name} in {text}"
            );
        }
    }

    #[test]
    fn an_empty_surface_has_its_unit() {
        let empty = Mesh {
            unit: Some(LengthUnit::Millimetre),
            ..Mesh::default()
        };
        assert!(layer(&[empty]).contains("metersPerUnit = 0.001\n"));
    }
}
