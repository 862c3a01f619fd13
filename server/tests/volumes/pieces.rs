//! VTK images in pieces.

use std::sync::Arc;

use isopeel_kernels::Samples;
use isopeel_volumes::location::MemoryFolder;
use isopeel_volumes::{FileLocation, OpenedFile, ReadError, read_file};

/// A piece whose samples are their own numbers in the whole, of 5 × 3 × 2 samples.
fn piece([x0, x1]: [u32; 2], [y0, y1]: [u32; 2], data: &str) -> String {
    let (mut numbers, last) = (String::new(), u32::from(data == "CellData"));
    for z in 0..2 - last {
        for y in y0..=y1 - last {
            for x in x0..=x1 - last {
                numbers += &format!("{} ", (z * 3 + y) * 5 + x);
            }
        }
    }
    format!(
        r#"<VTKFile type="ImageData"><ImageData WholeExtent="{x0} {x1} {y0} {y1} 7 8" Origin="0 0 0" Spacing="1 1 1">
<Piece Extent="{x0} {x1} {y0} {y1} 7 8"><{data}><DataArray type="Int16" Name="a" format="ascii">{numbers}
</DataArray></{data}></Piece></ImageData></VTKFile>"#
    )
}

const WHOLE: &str = r#"<?xml version="1.0"?>
<VTKFile type="PImageData" version="0.1" byte_order="LittleEndian">
<PImageData WholeExtent="0 4 0 2 7 8" GhostLevel="0" Origin="1 2 3" Spacing="0.5 1 2">
<PPointData Scalars="a"><PDataArray type="Int16" Name="a"/></PPointData>
<Piece Extent="0 2 0 2 7 8" Source="run/left.vti"/>
<Piece Extent="2 4 0 2 7 8" Source="run/right.vti"/>
</PImageData></VTKFile>"#;

fn open(whole: &str, left: &str, right: &str) -> Result<OpenedFile, ReadError> {
    let files = [("a.pvti", whole), ("run/left.vti", left), ("run/right.vti", right)];
    let folder: MemoryFolder = files
        .into_iter()
        .map(|(name, text)| (name.to_owned(), text.as_bytes().to_vec().into()))
        .collect();
    read_file(&FileLocation::memory(Arc::new(folder), "a.pvti"))
}

fn refused(whole: &str, left: &str, right: &str) -> String {
    open(whole, left, right).unwrap_err().to_string()
}

fn halves(data: &str) -> [String; 2] {
    [piece([0, 2], [0, 2], data), piece([2, 4], [0, 2], data)]
}

#[test]
fn pieces_are_one_volume() {
    let [left, right] = halves("PointData");
    let file = open(WHOLE, &left, &right).unwrap();
    assert_eq!(file.geometry.dims, [5, 3, 2]);
    assert_eq!(file.geometry.spacing, [0.5, 1.0, 2.0]);
    assert_eq!(file.geometry.origin, [1.0, 2.0, 3.0 + 7.0 * 2.0]);
    let Samples::I16(values) = file.fields[0].source.load(0).unwrap() else {
        panic!("expected the type of the pieces");
    };
    assert_eq!(values, (0..30).collect::<Vec<i16>>());
}

#[test]
fn cell_data_of_pieces_are_at_the_centres() {
    let [left, right] = halves("CellData");
    let whole = WHOLE.replace("7 8\"", "7 9\"");
    let deep = |text: &str| {
        let text = text.replace("7 8\"", "7 9\"");
        let (head, tail) = text.split_once("ascii\">").unwrap();
        let (numbers, tail) = tail.split_once("\n</DataArray>").unwrap();
        // Another layer of cells.
        format!("{head}ascii\">{numbers}{numbers}\n</DataArray>{tail}")
    };
    let file = open(&whole, &deep(&left), &deep(&right)).unwrap();
    assert_eq!(file.geometry.dims, [4, 2, 2]);
    assert_eq!(file.geometry.origin, [1.25, 2.5, 3.0 + 7.0 * 2.0 + 1.0]);
    let Samples::I16(values) = file.fields[0].source.load(0).unwrap() else {
        panic!("expected the type of the pieces");
    };
    let layer = [0, 1, 2, 3, 5, 6, 7, 8];
    assert_eq!(values, [layer, layer].concat());
}

#[test]
fn false_pieces_are_refused() {
    let [left, right] = halves("PointData");
    let short = WHOLE.replace("WholeExtent=\"0 4", "WholeExtent=\"0 5");
    let why = refused(&short, &left, &right);
    assert!(why.contains("Piece: sample [5, 0, 0] is in no piece"), "{why}");
    let outside = WHOLE.replace("WholeExtent=\"0 4", "WholeExtent=\"0 3");
    let why = refused(&outside, &left, &right);
    assert!(why.contains("expected a part of [[0, 3]"), "{why}");
    let wide = WHOLE.replace("Extent=\"2 4", "Extent=\"1 4");
    let why = refused(&wide, &left, &right);
    assert!(
        why.contains("right.vti: Extent: [3, 3, 2] samples, expected [4, 3, 2]"),
        "{why}"
    );
    let why = refused(WHOLE, &left, &right.replace("Int16", "UInt8"));
    assert!(
        why.contains("right.vti: a: u8, expected i16, as in the first piece"),
        "{why}"
    );
    let why = refused(WHOLE, &left, &right.replace("Name=\"a\"", "Name=\"b\""));
    assert!(why.contains("a: missing, expected i16"), "{why}");
    let why = refused(&WHOLE.replace("run/right.vti", "../right.vti"), &left, &right);
    assert!(
        why.contains("Source: \"../right.vti\", expected a file in the header's own folder"),
        "{why}"
    );
    let why = refused(&WHOLE.replace("\"PImageData\"", "\"PPolyData\""), &left, &right);
    assert!(
        why.contains("\"PPolyData\", expected PImageData or PRectilinearGrid"),
        "{why}"
    );
    let why = refused(&WHOLE.replace("\"PImageData\"", "\"PRectilinearGrid\""), &left, &right);
    assert!(why.contains("\"ImageData\", expected RectilinearGrid"), "{why}");
    let why = refused("<svg/>", &left, &right);
    assert!(why.contains("PImageData: no such element"), "{why}");
    let whole = WHOLE.replace("<Piece ", "<Other ");
    let why = refused(&whole, &left, &right);
    assert!(why.contains("Piece: none, expected one at least"), "{why}");
}

/// A rectilinear grid of samples along x alone, two along y and z.
fn rectilinear(from: usize, x: &[f64]) -> String {
    let (to, n) = (from + x.len() - 1, 4 * x.len());
    let x: Vec<String> = x.iter().map(f64::to_string).collect();
    let values: Vec<String> = (0..n).map(|i| (from + i % x.len()).to_string()).collect();
    format!(
        r#"<VTKFile type="RectilinearGrid" version="0.1" byte_order="LittleEndian">
<RectilinearGrid WholeExtent="{from} {to} 0 1 0 1"><Piece Extent="{from} {to} 0 1 0 1">
<PointData><DataArray type="Int16" Name="a" format="ascii">{}</DataArray></PointData>
<Coordinates>
<DataArray type="Float64" Name="x" format="ascii">{}</DataArray>
<DataArray type="Float64" Name="y" format="ascii">0 2</DataArray>
<DataArray type="Float64" Name="z" format="ascii">5 6</DataArray>
</Coordinates></Piece></RectilinearGrid></VTKFile>"#,
        values.join(" "),
        x.join(" ")
    )
}

#[test]
fn rectilinear_pieces_are_one_volume() {
    const WHOLE: &str = r#"<VTKFile type="PRectilinearGrid"><PRectilinearGrid WholeExtent="0 4 0 1 0 1">
<Piece Extent="0 2 0 1 0 1" Source="run/left.vti"/><Piece Extent="2 4 0 1 0 1" Source="run/right.vti"/>
</PRectilinearGrid></VTKFile>"#;
    let left = rectilinear(0, &[1.0, 2.0, 4.0]);
    let read = open(WHOLE, &left, &rectilinear(2, &[4.0, 5.0, 101.0])).unwrap();
    assert_eq!(
        (read.geometry.dims, read.geometry.spacing),
        ([5, 2, 2], [25.0, 2.0, 1.0])
    );
    assert_eq!(read.geometry.origin, [1.0, 0.0, 5.0]);
    let notice = read.notices.text().unwrap();
    assert!(
        notice.contains("96 between samples 3 and 4, the largest deviation"),
        "{notice}"
    );
    let Samples::I16(values) = read.fields[0].source.load(0).unwrap() else {
        panic!("expected the type of the pieces");
    };
    assert_eq!(values, [0, 1, 2, 3, 4].repeat(4));
    // Even: as an image.
    let even = open(
        WHOLE,
        &rectilinear(0, &[1.0, 3.0, 5.0]),
        &rectilinear(2, &[5.0, 7.0, 9.0]),
    )
    .unwrap();
    assert_eq!(
        (even.geometry.spacing, even.uneven, even.notices.text()),
        ([2.0, 2.0, 1.0], None, None)
    );
    // A little uneven: interpolated as a whole.
    let read = open(
        WHOLE,
        &rectilinear(0, &[1.0, 2.0, 3.0]),
        &rectilinear(2, &[3.0, 4.0, 6.0]),
    )
    .unwrap();
    assert_eq!((read.geometry.dims, read.uneven), ([6, 2, 2], None));

    let why = refused(WHOLE, &left, &rectilinear(2, &[4.5, 5.0, 101.0]));
    assert!(
        why.contains("right.vti: Coordinates: sample 0 along axis 0 at 4.5, and in another piece at 4"),
        "{why}"
    );
    let why = refused(WHOLE, &left, &rectilinear(2, &[4.0, 3.0, 101.0]));
    assert!(why.contains("only increase, or only decrease"), "{why}");
    let why = refused(WHOLE, &left, &piece([2, 4], [0, 1], "PointData"));
    assert!(why.contains("\"ImageData\", expected RectilinearGrid"), "{why}");
}
