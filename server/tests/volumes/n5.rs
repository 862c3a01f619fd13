//! N5 folders and BigDataViewer's files: which volume is opened, and false ones.

use std::fs;
use std::path::Path;

use isopeel_volumes::open_dataset;

use crate::bounds::within;
use crate::changed;
use crate::hostile;
use crate::stores::{self, Changing, StoredFile, files, fixture};

/// A dataset of two blocks, of which the second one is smaller: 3 x 2 x 2 samples of one byte.
fn dataset(attributes: &str, second: &[u8]) -> tempfile::TempDir {
    let block = |sizes: [u8; 3], samples: &[u8]| {
        let header = sizes.map(|size| [0, 0, 0, size]).concat();
        [&[0, 0, 0, 3][..], &header, samples].concat()
    };
    let attributes = format!(
        r#"{{"dimensions":[3,2,2],"blockSize":[2,2,2],"dataType":"uint8","compression":{{"type":"raw"}}{attributes}}}"#
    );
    let files: Vec<StoredFile> = vec![
        ("attributes.json".into(), attributes.into()),
        ("0/0/0".into(), block([2, 2, 2], &[1, 2, 3, 4, 5, 6, 7, 8])),
        ("1/0/0".into(), block([1, 2, 2], second)),
    ];
    stores::write("a.n5", &files)
}

#[test]
fn blocks_at_the_end_are_smaller() {
    let folder = dataset("", &[11, 12, 13, 14]);
    let dataset = stores::read(&folder, "a.n5").unwrap();
    assert_eq!(dataset.geometry.dims, [3, 2, 2]);
    let samples = dataset.fields[0].source.load(0).unwrap();
    let values: Vec<f32> = (0..12).map(|i| samples.get(i)).collect();
    assert_eq!(values, [1.0, 2.0, 11.0, 3.0, 4.0, 12.0, 5.0, 6.0, 13.0, 7.0, 8.0, 14.0]);
}

#[test]
fn axes_and_lengths_are_those_of_the_attributes() {
    let second = [11, 12, 13, 14];
    let folder = dataset(
        r#","axes":["z","y","x"],"resolution":[4,2,1],"units":["nm","nm","nm"]"#,
        &second,
    );
    let geometry = stores::read(&folder, "a.n5").unwrap().geometry;
    assert_eq!((geometry.dims, geometry.spacing), ([2, 2, 3], [1.0, 2.0, 4.0]));
    let folder = dataset(r#","pixelResolution":{"unit":"um","dimensions":[0.5,0.5]}"#, &second);
    let dataset = stores::read(&folder, "a.n5").unwrap();
    assert_eq!(dataset.geometry.spacing, [0.5; 3]);
    let notice = dataset.notices.text().unwrap();
    assert!(notice.contains("no spacing along z: 0.5 was taken"), "{notice}");
}

#[test]
fn false_blocks_are_refused() {
    let refused = |folder: tempfile::TempDir, words: &str| {
        let error = within(1 << 20, || stores::read(&folder, "a.n5"))
            .unwrap_err()
            .to_string();
        assert!(error.contains(words), "expected {words:?} in: {error}");
    };
    refused(dataset("", &[1, 2, 3]), "3 bytes of samples, expected 4");
    let folder = dataset("", &[1; 4]);
    fs::write(folder.path().join("a.n5/1/0/0"), [0, 1, 0, 3]).unwrap();
    refused(folder, "shorter than its header");
    let folder = dataset("", &[1; 4]);
    fs::write(
        folder.path().join("a.n5/1/0/0"),
        [0, 0, 0, 3, 0, 0, 0, 9, 0, 0, 0, 2, 0, 0, 0, 2, 1],
    )
    .unwrap();
    refused(folder, "a block of [2, 2, 9] samples, expected [2, 2, 2] at most");
    let folder = dataset("", &[1; 4]);
    let attributes =
        r#"{"dimensions":[9,9,9],"blockSize":[4096,4096,4096],"dataType":"uint8","compression":{"type":"raw"}}"#;
    fs::write(folder.path().join("a.n5/attributes.json"), attributes).unwrap();
    refused(folder, "expected 1 GiB at most");
    let folder = dataset("", &[1; 4]);
    let attributes = r#"{"dimensions":[2,2,2],"blockSize":[2,2,2],"dataType":"uint8","compression":{"type":"xz"}}"#;
    fs::write(folder.path().join("a.n5/attributes.json"), attributes).unwrap();
    refused(folder, "compression \"xz\", expected raw, gzip");
}

#[test]
fn one_of_several_is_named() {
    let error = open_dataset(&fixture("convention.n5")).unwrap_err().to_string();
    assert!(error.contains("3 datasets") && error.contains("raw/plain"), "{error}");
    let error = open_dataset(&fixture("convention_bdv.h5")).unwrap_err().to_string();
    assert!(
        error.contains("2 views") && error.contains("0 (setup 0), 1 (setup 1)"),
        "{error}"
    );
    let error = open_dataset(&fixture("convention_bdv.h5:9")).unwrap_err().to_string();
    assert!(error.contains("no view \"9\""), "{error}");
    let error = open_dataset(&fixture("convention_imaris.ims:7"))
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("no such level") && error.contains("one of 0, 1"),
        "{error}"
    );
    let error = open_dataset(&fixture("convention_openpmd.h5:B"))
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("none is named \"B\"") && error.contains("E ([7, 5, 6])"),
        "{error}"
    );
}

#[test]
fn components_of_several_shapes_are_refused() {
    let error = open_dataset(&fixture("convention_refused.h5")).unwrap_err().to_string();
    assert!(
        error.contains("E/y: [5, 3, 2] samples, but /data/0/meshes/E/x has [4, 3, 2]"),
        "{error}"
    );
}

/// A view in an N5 folder, described by an XML beside it.
#[test]
fn views_in_n5_are_placed_by_their_xml() {
    let folder = tempfile::tempdir().unwrap();
    let source = dataset("", &[11, 12, 13, 14]);
    let to = folder.path().join("views.n5/setup0/timepoint0/s0");
    for (path, bytes) in files(&source.path().join("a.n5")) {
        fs::create_dir_all(to.join(&path).parent().unwrap()).unwrap();
        fs::write(to.join(path), bytes).unwrap();
    }
    fs::write(folder.path().join("views.n5/attributes.json"), r#"{"n5":"2.0.0"}"#).unwrap();
    let xml = |file: &str| {
        format!(
            r#"<SpimData version="0.2"><SequenceDescription><ImageLoader format="bdv.n5"><n5 type="relative">{file}</n5></ImageLoader>
            <ViewSetups><ViewSetup><id>0</id><name>left</name><voxelSize><unit>um</unit><size>2 2 4</size></voxelSize></ViewSetup></ViewSetups>
            </SequenceDescription><ViewRegistrations><ViewRegistration timepoint="0" setup="0"><ViewTransform type="affine">
            <affine>0 -1 0 5 1 0 0 0 0 0 2 0</affine></ViewTransform></ViewRegistration></ViewRegistrations></SpimData>"#
        )
    };
    fs::write(folder.path().join("views.xml"), xml("views.n5")).unwrap();
    for name in ["views.xml", "views.n5", "views.n5:left"] {
        let dataset = open_dataset(&folder.path().join(name)).unwrap();
        let geometry = dataset.geometry;
        assert_eq!(
            (geometry.spacing, geometry.origin),
            ([2.0, 2.0, 4.0], [10.0, 0.0, 0.0]),
            "{name}"
        );
        assert_eq!(geometry.direction[0], [0.0, 1.0, 0.0], "{name}");
        assert_eq!(dataset.field_names(), ["left"], "{name}");
    }
    fs::write(folder.path().join("views.xml"), xml("../views.n5")).unwrap();
    let error = open_dataset(&folder.path().join("views.xml")).unwrap_err().to_string();
    assert!(error.contains("expected a folder beside the file"), "{error}");
}

fn folders() -> Vec<Changing<'static>> {
    let parts = ["raw/zipped", "bloscs", "raw/plain"];
    parts
        .map(|part| Changing::new("a.n5", files(&fixture("convention.n5").join(part))))
        .into()
}

fn read(folder: &tempfile::TempDir) -> Result<isopeel_volumes::Dataset, isopeel_volumes::ReadError> {
    stores::read(folder, "a.n5")
}

#[test]
fn changed_bytes_never_panic() {
    stores::change_bytes("n5", 150, &folders(), changed::bytes(8), read);
}

/// Digits of metadata replaced by digits.
#[test]
fn changed_numbers_never_panic() {
    let metadata = |files: &[StoredFile]| {
        files
            .iter()
            .position(|(path, _)| path == Path::new("attributes.json"))
            .unwrap()
    };
    stores::change_digits("n5", 150, &folders(), metadata, read);
}

/// XML of BigDataViewer with other bytes.
#[test]
fn changed_descriptions_never_panic() {
    let [xml, samples] = ["convention_bdv.xml", "convention_bdv.h5"].map(|name| fs::read(fixture(name)).unwrap());
    let xml = String::from_utf8(xml)
        .unwrap()
        .replace("<id>1</id>", "<id>0</id>")
        .into_bytes();
    changed::each("spim_data", 300, &changed::bytes(8), |changes| {
        let mut xml = xml.clone();
        changed::change(&mut xml, changes);
        let _ = hostile::read(
            &[("convention_bdv.xml", xml), ("convention_bdv.h5", samples.clone())],
            64 << 20,
        );
    });
}
