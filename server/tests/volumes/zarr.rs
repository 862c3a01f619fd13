//! Zarr folders: which volume is opened, and false ones.

use std::fs;
use std::path::Path;

use isopeel_volumes::{Dataset, LengthUnit, ReadError, open_dataset};

use crate::bounds::within;
use crate::changed;
use crate::stores::{self, Changing, StoredFile, files, fixture};
use crate::write::gzip;

/// Writes a folder `a.zarr`.
fn write(files: &[StoredFile]) -> tempfile::TempDir {
    stores::write("a.zarr", files)
}

fn read(folder: &tempfile::TempDir) -> Result<Dataset, ReadError> {
    stores::read(folder, "a.zarr")
}

/// An array of version 3 with one chunk.
fn array(shape: &str, chunks: &str, codecs: &str, chunk: &[u8]) -> tempfile::TempDir {
    let metadata = format!(
        r#"{{"zarr_format":3,"node_type":"array","shape":{shape},"data_type":"uint8","fill_value":0,
        "chunk_grid":{{"name":"regular","configuration":{{"chunk_shape":{chunks}}}}},
        "chunk_key_encoding":{{"name":"default"}},"codecs":[{codecs}]}}"#
    );
    write(&[
        ("zarr.json".into(), metadata.into()),
        ("c/0/0/0".into(), chunk.to_vec()),
    ])
}

#[test]
fn half_floats_are_read() {
    let folder = array(
        "[2,2,2]",
        "[2,2,1]",
        r#"{"name":"bytes","configuration":{"endian":"big"}}"#,
        &[],
    );
    let path = folder.path().join("a.zarr");
    let metadata = fs::read_to_string(path.join("zarr.json")).unwrap();
    let metadata = metadata
        .replace("uint8", "float16")
        .replace(r#""fill_value":0"#, r#""fill_value":"0x4200""#);
    fs::write(path.join("zarr.json"), metadata).unwrap();
    // 1, -2, 0.5, 65504; the other chunk is not stored.
    let stored = [0x3c00u16, 0xc000, 0x3800, 0x7bff].map(u16::to_be_bytes);
    fs::write(path.join("c/0/0/0"), stored.concat()).unwrap();
    let dataset = read(&folder).unwrap();
    let samples = dataset.fields[0].source.load(0).unwrap();
    let values: Vec<f32> = (0..8).map(|i| samples.get(i)).collect();
    assert_eq!(values, [1.0, 3.0, -2.0, 3.0, 0.5, 3.0, 65504.0, 3.0]);
}

const GZIP: &str = r#"{"name":"bytes"},{"name":"gzip","configuration":{"level":5}}"#;

fn refused(folder: &tempfile::TempDir, words: &str) {
    let error = within(1 << 20, || read(folder)).expect_err(words).to_string();
    assert!(error.contains(words), "expected {words:?} in: {error}");
}

#[test]
fn claims_are_not_allocated() {
    let chunk = gzip(&[7; 8]);
    let large = "[30000,30000,30000]";
    refused(
        &array(large, "[1024,1024,1024]", GZIP, &chunk),
        "stored bytes cannot hold",
    );
    refused(&array(large, "[1,1,1]", GZIP, &chunk), "chunks along x, y and z");
    refused(&array("[2,2,2]", large, GZIP, &chunk), "expected 1 GiB at most");
    refused(&array("[2,2,2]", "[0,2,2]", GZIP, &chunk), "expected numbers above 0");
    refused(
        &array("[2,2,2]", "[4,2,2]", GZIP, &chunk),
        "8 bytes of samples, expected 16",
    );
    refused(&array("[9e9,2,2]", "[2,2,2]", GZIP, &chunk), "zarr.json");
    let shards = |inner: &str| {
        format!(
            r#"{{"name":"sharding_indexed","configuration":{{"chunk_shape":{inner},"codecs":[{{"name":"bytes"}}],
            "index_codecs":[{{"name":"bytes"}},{{"name":"crc32c"}}]}}}}"#
        )
    };
    refused(
        &array("[4,4,4]", "[4,4,4]", &shards("[3,4,4]"), &chunk),
        "expected a whole number",
    );
    refused(
        &array("[4,4,4]", "[4,4,4]", &shards("[2,2,2]"), &chunk),
        "expected an index of 132",
    );
}

#[test]
fn a_bomb_is_not_unpacked() {
    refused(
        &array("[2,2,2]", "[2,2,2]", GZIP, &gzip(&vec![0; 4 << 20])),
        "which a chunk does not have",
    );
}

#[test]
fn what_is_not_read_is_named() {
    let chunk = [7; 8];
    let codec = |codecs: &str| array("[2,2,2]", "[2,2,2]", codecs, &chunk);
    refused(
        &codec(r#"{"name":"bytes"},{"name":"zfp"}"#),
        "codec \"zfp\", expected blosc",
    );
    refused(&codec(""), "no codec `bytes`");
    refused(&codec(r#"{"name":"bytes"},{"name":"crc32c"}"#), "its checksum is wrong");
    refused(
        &array("[4,4]", "[4,4]", r#"{"name":"bytes"}"#, &chunk),
        "expected 3 axes in space",
    );
    let folder = codec(r#"{"name":"bytes"}"#);
    assert!(read(&folder).is_ok());
    fs::remove_file(folder.path().join("a.zarr/c/0/0/0")).unwrap();
    refused(&folder, "no chunk of step 0 is stored");
}

#[test]
fn links_out_of_the_folder_are_not_followed() {
    let folder = array("[2,2,2]", "[2,2,2]", r#"{"name":"bytes"}"#, &[7; 8]);
    let (chunk, outside) = (folder.path().join("a.zarr/c/0/0/0"), folder.path().join("outside"));
    fs::rename(&chunk, &outside).unwrap();
    std::os::unix::fs::symlink(&outside, &chunk).unwrap();
    refused(&folder, "a link out of the folder");
    let inside = folder.path().join("a.zarr/inside");
    fs::rename(&outside, &inside).unwrap();
    fs::remove_file(&chunk).unwrap();
    std::os::unix::fs::symlink(&inside, &chunk).unwrap();
    assert!(read(&folder).is_ok());
    let parent = folder.path().join("a.zarr:../outside");
    let error = open_dataset(&parent).unwrap_err().to_string();
    assert!(error.contains("expected a plain relative path"), "{error}");
}

#[test]
fn one_of_several_is_named() {
    let error = open_dataset(&fixture("image-0.5.ome.zarr:7")).unwrap_err().to_string();
    assert!(error.contains("no array or group there"), "{error}");
    let error = open_dataset(&fixture("group.zarr:times")).unwrap_err().to_string();
    assert!(error.contains("expected 3 axes in space"), "{error}");
    let mut two = files(&fixture("v3-zstd.zarr"));
    for (path, _) in &mut two {
        *path = Path::new("one").join(&path);
    }
    let other = files(&fixture("v2-blosc.zarr")).into_iter().map(|(path, bytes)| {
        let text = String::from_utf8_lossy(&bytes)
            .replace("6,\n    5", "6,\n    4")
            .into_bytes();
        let is_metadata = path.ends_with(".zarray");
        (Path::new("two").join(path), if is_metadata { text } else { bytes })
    });
    two.extend(other);
    two.push((".zgroup".into(), br#"{"zarr_format":2}"#.to_vec()));
    let error = read(&write(&two)).unwrap_err().to_string();
    assert!(error.contains("one [6, 5, 7], two [6, 4, 7]"), "{error}");
}

#[test]
fn the_finest_level_of_a_fair_size_is_opened() {
    let mut image = files(&fixture("image-0.4.ome.zarr"));
    let metadata = image
        .iter_mut()
        .find(|(path, _)| path == Path::new("0/.zarray"))
        .unwrap();
    let text = String::from_utf8(metadata.1.clone()).unwrap();
    let large = text.replace("6,\n    5,\n    7\n  ]", "6000,\n    5000,\n    7000\n  ]");
    assert_ne!(text, large);
    metadata.1 = large.into_bytes();
    let dataset = read(&write(&image)).unwrap();
    assert_eq!(dataset.geometry.dims, [4, 3, 3]);
}

/// A copy of an image whose attributes were changed.
fn with_attributes(name: &str, file: &str, change: impl FnOnce(&mut serde_json::Value)) -> tempfile::TempDir {
    let mut files = files(&fixture(name));
    if !files.iter().any(|(path, _)| path == Path::new(file)) {
        files.push((file.into(), b"{}".to_vec()));
    }
    let (_, bytes) = files.iter_mut().find(|(path, _)| path == Path::new(file)).unwrap();
    let mut attributes = serde_json::from_slice(bytes).unwrap();
    change(&mut attributes);
    *bytes = serde_json::to_vec(&attributes).unwrap();
    write(&files)
}

#[test]
fn axes_of_earlier_versions_are_names_or_none() {
    for axes in [serde_json::json!(["t", "c", "z", "y", "x"]), serde_json::Value::Null] {
        let folder = with_attributes("image-0.4.ome.zarr", ".zattrs", |attributes| {
            attributes["multiscales"][0]["axes"] = axes;
        });
        let dataset = read(&folder).unwrap();
        assert_eq!(
            (dataset.geometry.dims, dataset.steps, dataset.fields.len()),
            ([7, 5, 6], 2, 2)
        );
        assert_eq!(dataset.geometry.unit, None);
    }
}

#[test]
fn lengths_are_in_the_unit_of_x() {
    let folder = with_attributes("image-0.4.ome.zarr", ".zattrs", |attributes| {
        attributes["multiscales"][0]["axes"][2]["unit"] = "nanometer".into();
    });
    let geometry = read(&folder).unwrap().geometry;
    assert_eq!(geometry.unit, Some(LengthUnit::Micrometre));
    assert!(
        (geometry.spacing[2] - 0.003).abs() < 1e-9 && geometry.spacing[0] == 0.5,
        "{:?}",
        geometry.spacing
    );
}

#[test]
fn scaled_values_and_missing_ones() {
    let folder = with_attributes("v2-blosc.zarr", ".zattrs", |attributes| {
        *attributes = serde_json::json!({"scale_factor": 0.5, "add_offset": 10, "_FillValue": 20, "units": "K"});
    });
    let dataset = read(&folder).unwrap();
    let plain = open_dataset(&fixture("v2-blosc.zarr")).unwrap();
    let (field, plain) = (&dataset.fields[0], plain.fields[0].source.load(0).unwrap());
    assert_eq!((field.missing, field.unit.as_deref()), (Some(20.0), Some("K")));
    let samples = field.source.load(0).unwrap();
    for i in 0..samples.len() {
        assert_eq!(samples.get(i), plain.get(i) * 0.5 + 10.0);
    }
}

/// Two chunks of 4 samples in a shard whose index says that they are there.
fn shard(index: [[u64; 2]; 2]) -> tempfile::TempDir {
    let codec = r#"{"name":"sharding_indexed","configuration":{"chunk_shape":[1,2,2],
        "codecs":[{"name":"bytes"}],"index_codecs":[{"name":"bytes"}]}}"#;
    let index = index.into_iter().flatten().flat_map(u64::to_le_bytes);
    array("[2,2,2]", "[2,2,2]", codec, &(1..9).chain(index).collect::<Vec<u8>>())
}

#[test]
fn false_indices_of_shards_are_refused() {
    let load = |index| within(1 << 20, || read(&shard(index))?.fields[0].source.load(0));
    let samples = load([[4, 4], [0, 4]]).unwrap();
    let values: Vec<f32> = (0..8).map(|i| samples.get(i)).collect();
    assert_eq!(values, [5.0, 6.0, 7.0, 8.0, 1.0, 2.0, 3.0, 4.0]);
    let samples = load([[u64::MAX; 2], [0, 4]]).unwrap();
    assert_eq!((samples.get(0), samples.get(4)), (0.0, 1.0));
    for (index, words) in [
        ([[0, 4], [38, 4]], "a chunk of 4 bytes at 38, the file has 40"),
        ([[0, 4], [1 << 60, 4]], "the file has 40"),
        ([[0, 4], [u64::MAX, 4]], "the file has 40"),
        ([[0, 1 << 60], [4, 4]], "the file has 40"),
        ([[0, 3], [4, 4]], "3 bytes of samples, expected 4"),
        ([[0, 4], [0, 0]], "0 bytes of samples, expected 4"),
        ([[0, 40], [0, 40]], "40 bytes of samples, expected 4"),
    ] {
        let error = load(index).unwrap_err().to_string();
        assert!(error.contains(words), "expected {words:?} in: {error}");
    }
}

/// In JSON a number with a decimal point has the type of the scale; whole ones may have that of the samples.
#[test]
fn bounds_with_a_decimal_point_are_unpacked() {
    let of = |range: serde_json::Value| {
        let folder = with_attributes("v2-blosc.zarr", ".zattrs", |attributes| {
            *attributes = serde_json::json!({"scale_factor": 0.5, "add_offset": 10.0, "valid_range": range});
        });
        let dataset = read(&folder).unwrap();
        let samples = dataset.fields[0].source.load(0).unwrap();
        let values = (0..samples.len())
            .map(|i| samples.get(i))
            .filter(|value| !value.is_nan());
        let (lowest, highest) = values.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), value| {
            (low.min(value), high.max(value))
        });
        (
            lowest,
            highest,
            dataset.notices.lines().any(|line| line.contains("unpacked")),
        )
    };
    assert_eq!(of(serde_json::json!([20.0, 30.0])), (20.0, 30.0, true));
    assert_eq!(of(serde_json::json!([20, 30])), (20.0, 25.0, false));
}

const FOLDERS: [&str; 9] = [
    "v2-blosc.zarr",
    "blosc-blosclz-bytes.zarr",
    "blosc-lz4-bits.zarr",
    "v3-shards.zarr",
    "v3-shards-start.zarr",
    "v3-transpose.zarr",
    "v2-lz4.zarr",
    "v2-delta.zarr",
    "image-0.5.ome.zarr",
];

/// Changed bytes in one file, then perhaps a cut.
#[test]
fn changed_bytes_never_panic() {
    let folders = FOLDERS.map(|folder| Changing::new("a.zarr", files(&fixture(folder))));
    stores::change_bytes("zarr", 150, &folders, changed::bytes(8), read);
}

/// Digits of metadata replaced by digits.
#[test]
fn changed_numbers_never_panic() {
    let folders = FOLDERS.map(|folder| Changing::new("a.zarr", files(&fixture(folder))));
    let metadata = |files: &[StoredFile]| {
        let found = files.iter().position(|(path, _)| {
            path.ends_with(".zarray") || path.ends_with("zarr.json") && path.parent() == Some(Path::new(""))
        });
        found.unwrap()
    };
    stores::change_digits("zarr", 150, &folders, metadata, read);
}
