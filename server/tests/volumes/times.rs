//! Times of steps, and collections of files: accepted and refused ones.

use std::path::Path;

use isopeel_volumes::{Dataset, TimeAxis, open_dataset};

use crate::write::{self, Volume};
use crate::write_vtk;

fn put(folder: &Path, name: &str, bytes: impl AsRef<[u8]>) {
    std::fs::write(folder.join(name), bytes).unwrap();
}

/// A volume all of whose samples are `value`.
fn level(value: i64) -> Volume {
    let mut volume = Volume::new([4, 3, 5], 1, ('i', 2), false);
    volume.values.fill(value);
    volume
}

fn labels(dataset: &Dataset) -> Vec<String> {
    dataset.times.as_ref().and_then(TimeAxis::labels).unwrap_or_default()
}

/// A collection of these files, each with its attributes.
fn collection(files: &[&str]) -> String {
    let rows = files.iter().map(|attributes| format!("<DataSet {attributes}/>\n"));
    let rows: String = rows.collect();
    format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"0.1\"><Collection>\n{rows}</Collection></VTKFile>"
    )
}

#[test]
fn files_of_a_collection_are_steps_in_the_order_of_their_times() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for step in 0..3 {
        put(at, &format!("c_{step}.vti"), write_vtk::vti(&level(step), "raw"));
    }
    let files = [
        r#"timestep="0.5" part="0" file="c_1.vti""#,
        r#"timestep="0" file="c_0.vti""#,
        r#"timestep="2" file="c_2.vti""#,
    ];
    put(at, "c.pvd", collection(&files));
    let dataset = open_dataset(&at.join("c.pvd")).unwrap();
    assert_eq!(
        (dataset.steps, labels(&dataset)),
        (3, vec!["t = 0".into(), "t = 0.5".into(), "t = 2".into()])
    );
    for step in 0..3 {
        assert_eq!(dataset.fields[0].source.load(step).unwrap().get(7), step as f32);
    }
    // The folder has one volume: its other files are that volume's steps.
    let whole = open_dataset(at).unwrap();
    assert_eq!((whole.steps, whole.fields.len()), (3, 1));
}

#[test]
fn steps_of_uneven_files_are_as_uneven() {
    let folder = tempfile::tempdir().unwrap();
    let mut volume = Volume::new([2, 2, 4], 1, ('f', 4), false);
    (volume.origin, volume.spacing) = ([0.0; 3], [1.0; 3]);
    let even = String::from_utf8(write_vtk::vtr(&volume)).unwrap();
    let uneven = even.replace("0\n1\n2\n3\n", "0\n1\n2\n200\n");
    assert_ne!(uneven, even);
    for step in 0..2 {
        put(folder.path(), &format!("a_{step:03}.vtr"), &uneven);
    }
    let one = open_dataset(&folder.path().join("a_000.vtr")).unwrap();
    let series = open_dataset(folder.path()).unwrap();
    assert_eq!(series.steps, 2);
    assert!(one.uneven.is_some(), "{:?}", one.notices.text());
    assert_eq!(series.uneven, one.uneven);
    assert_eq!(series.axes, one.axes);
}

/// As `level`, but `samples` samples farther along x.
fn beside(samples: f64, value: i64) -> Volume {
    let mut volume = level(value);
    volume.origin[0] += samples * volume.spacing[0];
    volume
}

#[test]
fn files_of_one_time_are_parts_of_a_step() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    // Of the first time the later part takes the border that both have, of the second one the part below comes last.
    for (name, part) in [
        ("a0", beside(0.0, 1)),
        ("a1", beside(3.0, 2)),
        ("b0", beside(0.0, 4)),
        ("b1", beside(-3.0, 3)),
    ] {
        put(at, &format!("{name}.vti"), write_vtk::vti(&part, "raw"));
    }
    put(
        at,
        "a.pvd",
        collection(&[
            r#"timestep="0" part="0" file="a0.vti""#,
            r#"timestep="0" part="1" file="a1.vti""#,
        ]),
    );
    let dataset = open_dataset(&at.join("a.pvd")).unwrap();
    assert_eq!((dataset.geometry.dims, dataset.steps), ([7, 3, 5], 1));
    assert_eq!(dataset.geometry.origin, level(1).origin);
    let samples = dataset.fields[0].source.load(0).unwrap();
    let row: Vec<f32> = (0..7).map(|x| samples.get(x)).collect();
    assert_eq!(row, [1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0]);
    put(
        at,
        "b.pvd",
        collection(&[
            r#"timestep="0" part="0" file="b0.vti""#,
            r#"timestep="0" part="1" file="b1.vti""#,
        ]),
    );
    let dataset = open_dataset(&at.join("b.pvd")).unwrap();
    assert_eq!(dataset.geometry.origin, beside(-3.0, 3).origin);
    let samples = dataset.fields[0].source.load(0).unwrap();
    let row: Vec<f32> = (0..7).map(|x| samples.get(x)).collect();
    assert_eq!(row, [3.0, 3.0, 3.0, 3.0, 4.0, 4.0, 4.0]);
    // Steps have one grid.
    put(
        at,
        "both.pvd",
        collection(&[
            r#"timestep="0" file="a0.vti""#,
            r#"timestep="0" file="a1.vti""#,
            r#"timestep="1" file="b0.vti""#,
            r#"timestep="1" file="b1.vti""#,
        ]),
    );
    let error = open_dataset(&at.join("both.pvd")).unwrap_err().to_string();
    assert!(error.contains("expected that of the first step"), "{error}");
}

#[test]
fn false_collections_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path().join("inside");
    std::fs::create_dir(&at).unwrap();
    put(&at, "a.vti", write_vtk::vti(&level(1), "raw"));
    put(
        &at,
        "other.vti",
        write_vtk::vti(&Volume::new([4, 3, 6], 1, ('i', 2), false), "raw"),
    );
    put(folder.path(), "outside.vti", write_vtk::vti(&level(1), "raw"));
    put(&at, "far.vti", write_vtk::vti(&beside(6.0, 1), "raw"));
    put(&at, "off.vti", write_vtk::vti(&beside(0.5, 1), "raw"));
    let (mut wide, mut typed) = (level(1), Volume::new([4, 3, 5], 1, ('f', 4), false));
    wide.spacing[1] *= 2.0;
    put(&at, "wide.vti", write_vtk::vti(&wide, "raw"));
    typed.origin = beside(4.0, 1).origin;
    put(&at, "typed.vti", write_vtk::vti(&typed, "raw"));
    put(&at, "a.pvti", "");
    let good = r#"timestep="0" file="a.vti""#;
    for (files, expected) in [
        (
            vec![r#"timestep="0" file="../outside.vti""#],
            "expected a file in the header's own folder",
        ),
        (
            vec![r#"timestep="0" file="/etc/passwd.vti""#],
            "expected a file in the header's own folder",
        ),
        (vec![good, r#"timestep="1" file="none.vti""#], "none.vti"),
        (
            vec![good, r#"timestep="1" file="a.vtu""#],
            "expected image data or a rectilinear grid, .vti",
        ),
        (
            vec![good, r#"timestep="0" part="1" file="far.vti""#],
            "sample [4, 0, 0] is in no part",
        ),
        (
            vec![good, r#"timestep="0" part="1" file="off.vti""#],
            "the first sample is [0.5, 0.0, 0.0] samples from the first part's, expected whole numbers",
        ),
        (
            vec![good, r#"timestep="0" part="1" file="wide.vti""#],
            "expected those of the first part",
        ),
        (
            vec![good, r#"timestep="0" part="1" file="typed.vti""#],
            "f32, expected i16, as in the first piece",
        ),
        (
            vec![good, r#"timestep="0" part="1" file="a.pvti""#],
            "expected .vti files there",
        ),
        (vec![good, r#"timestep="1" file="other.vti""#], "geometry"),
        (vec![r#"timestep="soon" file="a.vti""#], "\"soon\", expected a number"),
        (vec![r#"timestep="nan" file="a.vti""#], "expected a number"),
        (vec![r#"timestep="0""#], "file: missing"),
        (vec![], "none, expected one at least"),
    ] {
        put(&at, "bad.pvd", collection(&files));
        let error = open_dataset(&at.join("bad.pvd")).unwrap_err().to_string();
        assert!(error.contains(expected), "{files:?}: {error}");
    }
    for (text, expected) in [
        ("", "is empty"),
        ("<svg/>", "no such element"),
        ("<VTKFile type=\"PolyData\"></VTKFile>", "expected Collection"),
        (
            "<VTKFile type=\"Collection\"><Collection><DataSet file=\"a.vti\"/>",
            "ends too early",
        ),
    ] {
        put(&at, "bad.pvd", text);
        let error = open_dataset(&at.join("bad.pvd")).unwrap_err().to_string();
        assert!(error.contains(expected), "{text:?}: {error}");
    }
}

#[test]
fn a_collection_may_be_compressed_and_lies_in_memory_too() {
    let folder = tempfile::tempdir().unwrap();
    put(
        folder.path(),
        "a.vti.gz",
        write::gzip(&write_vtk::vti(&level(4), "raw")),
    );
    put(folder.path(), "a.vti", write_vtk::vti(&level(3), "raw"));
    put(
        folder.path(),
        "c.pvd.gz",
        write::gzip(collection(&[r#"timestep="3" file="a.vti""#]).as_bytes()),
    );
    let dataset = open_dataset(&folder.path().join("c.pvd.gz")).unwrap();
    assert_eq!(
        (dataset.steps, dataset.times.is_none(), dataset.title.as_str()),
        (1, true, "c")
    );
    assert_eq!(dataset.fields[0].source.load(0).unwrap().get(0), 3.0);
}

#[test]
fn numbered_files_keep_their_numbers() {
    let folder = tempfile::tempdir().unwrap();
    for number in [3, 4, 10] {
        put(
            folder.path(),
            &format!("heat_{number:03}.nrrd"),
            write::nrrd(&level(number), "raw"),
        );
    }
    let dataset = open_dataset(folder.path()).unwrap();
    assert_eq!(labels(&dataset), ["step 003", "step 004", "step 010"]);
    assert_eq!(dataset.times.unwrap().calendar(), None);
}

#[test]
fn times_that_a_header_claims_falsely_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let volume = Volume::new([4, 3, 5], 3, ('i', 2), false);
    for (name, unit, between) in [("spectrum", 32, 1.0), ("zero", 8, 0.0), ("nan", 8, f32::NAN)] {
        let bytes = write::nifti(&volume, |h| {
            h.bytes[123] = unit;
            h.f32(92, between);
        });
        put(folder.path(), "a.nii", bytes);
        let dataset = open_dataset(&folder.path().join("a.nii")).unwrap();
        assert_eq!((dataset.steps, dataset.times), (3, None), "{name}");
    }
}
