//! VTK: round trips, and grids of other kinds.

use std::path::Path;

use isopeel_volumes::{open_dataset, read_file};

use crate::formats::{DIMS, all, memory, open, same_placed};
use crate::write::Volume;
use crate::write_vtk;

#[test]
fn vti_round_trips() {
    for v in all().filter(|v| v.steps == 1) {
        for form in ["raw", "zlib", "base64", "text"] {
            let what = format!("{form} {:?}", v.kind);
            same_placed(&open("a.vti", write_vtk::vti(&v, form)).unwrap(), &v, &what);
        }
    }
}

#[test]
fn vtr_round_trips() {
    for v in all().filter(|v| v.steps == 1) {
        let what = format!("{:?}", v.kind);
        same_placed(&open("a.vtr", write_vtk::vtr(&v)).unwrap(), &v, &what);
        same_placed(&read_file(&memory(write_vtk::pvtr_files(&v))).unwrap(), &v, &what);
    }
}

#[test]
fn vti_of_another_kind_is_refused_by_its_name() {
    let v = Volume::new(DIMS, 1, ('u', 1), false);
    let file = |from: &str, to: &str| {
        let text = String::from_utf8(write_vtk::vti(&v, "text")).unwrap();
        assert!(text.contains(from));
        open("a.vti", text.replace(from, to).into()).unwrap_err().to_string()
    };
    let why = file("type=\"ImageData\"", "type=\"PolyData\"");
    assert!(
        why.contains("\"PolyData\", expected ImageData or RectilinearGrid"),
        "{why}"
    );
    let why = file("type=\"ImageData\"", "type=\"RectilinearGrid\"");
    assert!(
        why.contains("Coordinates: 0 arrays, expected positions along x, y and z"),
        "{why}"
    );
    let why = file("<Piece", "<Piece Extent=\"0 1 0 1 0 1\"></Piece><Piece");
    assert!(why.contains("Piece: several of them, expected one"), "{why}");
    let lzma = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/volumes/vtk-lzma.vti");
    let why = open_dataset(&lzma).unwrap_err().to_string();
    assert!(
        why.contains("compressor: \"vtkLZMADataCompressor\", expected none"),
        "{why}"
    );
}

#[test]
fn vtk_round_trips() {
    for v in all().filter(|v| v.steps == 1) {
        same_placed(&open("a.vtk", write_vtk::vtk(&v, true)).unwrap(), &v, "text");
        if v.big || v.kind.1 == 1 {
            same_placed(&open("a.vtk", write_vtk::vtk(&v, false)).unwrap(), &v, "binary");
        }
    }
}

#[test]
fn vtk_of_another_kind_is_refused_by_its_name() {
    let v = Volume::new(DIMS, 1, ('u', 1), false);
    let text = String::from_utf8(write_vtk::vtk(&v, true)).unwrap();
    let why = open("a.vtk", text.replace("STRUCTURED_POINTS", "POLYDATA").into()).unwrap_err();
    assert!(
        why.to_string()
            .contains("DATASET: \"POLYDATA\", expected STRUCTURED_POINTS"),
        "{why}"
    );
}
