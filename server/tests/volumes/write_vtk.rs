//! Writes small valid files of VTK. The fuzz targets take their seeds from here too.

use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;

use crate::write::{Volume, text, zlib};

/// VTK's name of the samples' type.
fn kind_name(v: &Volume) -> String {
    match v.kind {
        ('f', n) => format!("Float{}", n * 8),
        ('u', n) => format!("UInt{}", n * 8),
        (_, n) => format!("Int{}", n * 8),
    }
}

/// VTI of one step: arrays as `text`, in `base64`, or appended `raw` or with `zlib`, in blocks of 32 bytes.
pub fn vti(v: &Volume, form: &str) -> Vec<u8> {
    let kind = kind_name(v);
    let number = |n: usize| {
        if v.big {
            (n as u64).to_be_bytes()
        } else {
            (n as u64).to_le_bytes()
        }
    };
    let [x, y, z] = v.dims.map(|n| n - 1);
    let ([sx, sy, sz], [ox, oy, oz]) = (v.spacing, v.origin);
    let compressor = if form == "zlib" {
        r#" compressor="vtkZLibDataCompressor""#
    } else {
        ""
    };
    let (format, content) = match form {
        "text" => ("ascii", String::from_utf8(text(v)).unwrap()),
        "base64" => (
            "binary",
            BASE64.encode([number(v.bytes().len()).to_vec(), v.bytes()].concat()),
        ),
        _ => ("appended", String::new()),
    };
    let mut out = format!(
        r#"<VTKFile type="ImageData" byte_order="{}Endian" header_type="UInt64"{compressor}>
<ImageData WholeExtent="0 {x} 0 {y} 0 {z}" Origin="{ox} {oy} {oz}" Spacing="{sx} {sy} {sz}">
<Piece Extent="0 {x} 0 {y} 0 {z}"><PointData>
<DataArray type="{kind}" Name="a" format="{format}" offset="0">{content}</DataArray>
</PointData></Piece></ImageData>"#,
        if v.big { "Big" } else { "Little" },
    )
    .into_bytes();
    if format == "appended" {
        out.extend(b"<AppendedData encoding=\"raw\">\n_");
        if form == "zlib" {
            let bytes = v.bytes();
            let blocks: Vec<Vec<u8>> = bytes.chunks(32).map(zlib).collect();
            let head = [blocks.len(), 32, bytes.len() % 32]
                .into_iter()
                .chain(blocks.iter().map(Vec::len));
            out.extend(head.flat_map(number));
            out.extend(blocks.concat());
        } else {
            out.extend(number(v.bytes().len()));
            out.extend(v.bytes());
        }
        out.extend(VTI_END);
    } else {
        out.extend(b"</VTKFile>\n");
    }
    out
}

/// Text behind the appended data.
pub const VTI_END: &[u8] = b"\n</AppendedData></VTKFile>\n";

/// Legacy VTK of one step, as text or big-endian.
pub fn vtk(v: &Volume, ascii: bool) -> Vec<u8> {
    let kind = match v.kind {
        ('f', 4) => "float",
        ('f', _) => "double",
        ('u', 1) => "unsigned_char",
        (_, 1) => "char",
        ('u', 2) => "unsigned_short",
        (_, 2) => "short",
        ('u', 4) => "unsigned_int",
        (_, 4) => "int",
        ('u', _) => "unsigned_long",
        _ => "long",
    };
    let mut out = format!(
        "# vtk DataFile Version 3.0\ntitle\n{}\nDATASET STRUCTURED_POINTS\nDIMENSIONS {}\nSPACING {}\nORIGIN {}\n\
         POINT_DATA {}\nSCALARS a {kind} 1\nLOOKUP_TABLE default\n",
        if ascii { "ASCII" } else { "BINARY" },
        v.list(&v.dims, ""),
        v.list(&v.spacing, ""),
        v.list(&v.origin, ""),
        v.values.len(),
    )
    .into_bytes();
    out.extend(if ascii { text(v) } else { v.bytes() });
    out
}

/// A collection with two images.
pub fn pvd_files(v: &Volume) -> Vec<(&'static str, Vec<u8>)> {
    let names = ["a.1.vti", "a.2.vti"];
    let images = names.map(|name| (name, vti(v, "raw")));
    [("a.pvd", pvd(&names).into_bytes())]
        .into_iter()
        .chain(images)
        .collect()
}

/// An image in one piece, which is another file.
pub fn pvti_files(v: &Volume) -> Vec<(&'static str, Vec<u8>)> {
    let [x, y, z] = v.dims.map(|n| n - 1);
    let ([sx, sy, sz], [ox, oy, oz]) = (v.spacing, v.origin);
    let whole = format!(
        r#"<VTKFile type="PImageData">
<PImageData WholeExtent="0 {x} 0 {y} 0 {z}" Origin="{ox} {oy} {oz}" Spacing="{sx} {sy} {sz}">
<Piece Extent="0 {x} 0 {y} 0 {z}" Source="a.1.vti"/>
</PImageData></VTKFile>"#
    );
    vec![("a.pvti", whole.into_bytes()), ("a.1.vti", vti(v, "raw"))]
}

/// A rectilinear grid in one piece, which is another file.
pub fn pvtr_files(v: &Volume) -> Vec<(&'static str, Vec<u8>)> {
    let [x, y, z] = v.dims.map(|n| n - 1);
    let whole = format!(
        r#"<VTKFile type="PRectilinearGrid">
<PRectilinearGrid WholeExtent="0 {x} 0 {y} 0 {z}">
<Piece Extent="0 {x} 0 {y} 0 {z}" Source="a.1.vtr"/>
</PRectilinearGrid></VTKFile>"#
    );
    vec![("a.pvtr", whole.into_bytes()), ("a.1.vtr", vtr(v))]
}

/// VTR of one step, as text. Its positions are even.
pub fn vtr(v: &Volume) -> Vec<u8> {
    let [x, y, z] = v.dims.map(|n| n - 1);
    let line = |axis: usize| {
        let at = |i: u32| format!("{}\n", v.origin[axis] + f64::from(i) * v.spacing[axis]);
        let positions: String = (0..v.dims[axis]).map(at).collect();
        format!("<DataArray type=\"Float64\" format=\"ascii\">{positions}</DataArray>\n")
    };
    let (coordinates, kind) = ([0, 1, 2].map(line).concat(), kind_name(v));
    let samples = String::from_utf8(text(v)).unwrap();
    format!(
        r#"<VTKFile type="RectilinearGrid">
<RectilinearGrid WholeExtent="0 {x} 0 {y} 0 {z}">
<Piece Extent="0 {x} 0 {y} 0 {z}"><Coordinates>
{coordinates}</Coordinates><PointData>
<DataArray type="{kind}" Name="a" format="ascii">{samples}</DataArray>
</PointData></Piece></RectilinearGrid></VTKFile>
"#
    )
    .into_bytes()
}

/// A collection of these files, a time unit apart.
pub fn pvd(files: &[&str]) -> String {
    let row = |(time, file): (usize, &&str)| format!("<DataSet timestep=\"{time}\" part=\"0\" file=\"{file}\"/>\n");
    let rows: String = files.iter().enumerate().map(row).collect();
    format!("<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\"><Collection>\n{rows}</Collection></VTKFile>")
}
