//! Neuroglancer's precomputed volumes: which scale is opened, and false ones. Files of other programs are in `fixtures`.

use std::fs;
use std::path::Path;

use isopeel_volumes::{Dataset, ReadError, open_dataset};

use crate::bounds::within;
use crate::changed;
use crate::stores::{self, Changing, StoredFile};
use crate::write::gzip;

const FOLDERS: [&str; 7] = [
    "precomputed-raw",
    "precomputed-gzip",
    "precomputed-channels",
    "precomputed-jpeg",
    "precomputed-noise",
    "precomputed-labels",
    "precomputed-labels-shards",
];

/// Files of a fixture, `info` first.
fn files(name: &str) -> Vec<StoredFile> {
    let mut out = stores::files(&stores::fixture(name));
    let info = out.iter().position(|(path, _)| path == Path::new("info")).unwrap();
    out.swap(0, info);
    out
}

fn write(files: &[StoredFile]) -> tempfile::TempDir {
    stores::write("a", files)
}

fn read(folder: &tempfile::TempDir) -> Result<Dataset, ReadError> {
    stores::read(folder, "a")
}

/// A fixture whose `info` was changed.
fn with_info(name: &str, change: impl FnOnce(&mut serde_json::Value)) -> tempfile::TempDir {
    let mut files = files(name);
    let mut info = serde_json::from_slice(&files[0].1).unwrap();
    change(&mut info);
    files[0].1 = serde_json::to_vec(&info).unwrap();
    write(&files)
}

fn refused(folder: &tempfile::TempDir, field: &str, words: &str) {
    let error = within(2 << 20, || read(folder)).expect_err(words);
    let text = error.to_string();
    assert!(
        error.field == field && text.contains(words),
        "expected {field:?} and {words:?} in: {text}"
    );
}

#[test]
fn the_finest_scale_of_a_fair_size_is_opened() {
    let folder = with_info("precomputed-raw", |info| {
        info["scales"][0]["size"] = serde_json::json!([2048, 2048, 1024]);
        info["scales"][0]["chunk_sizes"][0] = serde_json::json!([64, 64, 64]);
    });
    assert_eq!(read(&folder).unwrap().geometry.dims, [4, 3, 3]);
    let named = |part: &str| open_dataset(&folder.path().join(format!("a:{part}")));
    assert_eq!(named("8_8_30").unwrap().geometry.dims, [2048, 2048, 1024]);
    let error = named("32_32_60").unwrap_err().to_string();
    assert!(error.contains("expected one of [\"8_8_30\", \"16_16_60\"]"), "{error}");
}

#[test]
fn chunks_that_are_not_stored_are_zero() {
    let mut files = files("precomputed-raw");
    files.retain(|(path, _)| !path.ends_with("3-7_4-7_5-8"));
    let folder = write(&files);
    let dataset = read(&folder).unwrap();
    let samples = dataset.fields[0].source.load(0).unwrap();
    assert_eq!((samples.get(0), samples.get(3)), (0.0, 0.0));
    assert!(samples.get(4) > 0.0);
}

#[test]
fn what_is_not_read_is_named() {
    let raw = |change: &dyn Fn(&mut serde_json::Value)| with_info("precomputed-raw", |info| change(info));
    let scale = |name: &'static str, value: serde_json::Value| raw(&|info| info["scales"][0][name] = value.clone());
    let json = |text: &str| serde_json::from_str::<serde_json::Value>(text).unwrap();
    refused(
        &raw(&|info| info["data_type"] = "complex64".into()),
        "data_type",
        "\"complex64\", expected uint8",
    );
    refused(
        &raw(&|info| info["num_channels"] = 0.into()),
        "num_channels",
        "0, expected 1 to",
    );
    refused(
        &raw(&|info| info["@type"] = "mesh".into()),
        "@type",
        "expected neuroglancer_multiscale_volume",
    );
    refused(
        &raw(&|info| info["scales"] = json("[]")),
        "scales",
        "expected one of 2^31 samples at most",
    );
    refused(
        &raw(&|info| info["scales"] = json("[{}]")),
        "info",
        "missing field `key`",
    );
    refused(
        &scale("encoding", "png".into()),
        "encoding",
        "\"png\", expected raw, jpeg or compressed_segmentation",
    );
    refused(
        &scale("encoding", "jpeg".into()),
        "encoding",
        "jpeg of 1 channels of uint16",
    );
    refused(
        &scale("encoding", "compressed_segmentation".into()),
        "encoding",
        "expected uint32 or uint64",
    );
    refused(&scale("chunk_sizes", json("[]")), "chunk_sizes", "none, expected one");
    refused(
        &scale("chunk_sizes", json("[[0,1,1]]")),
        "chunk_sizes",
        "expected numbers above 0",
    );
    refused(&scale("size", json("[1,5,6]")), "size", "at least 2");
    refused(&scale("resolution", json("[8,0,8]")), "resolution", "above 0");
    refused(&scale("voxel_offset", json("[0,0,0]")), "data", "no chunk is stored");
    refused(&scale("key", "../elsewhere".into()), "file", "not below the folder");
    refused(
        &raw(&|info| info["data_type"] = "uint8".into()),
        "data",
        "72 bytes of samples, expected 36",
    );
    let labels = |value: &str| {
        let value = json(value);
        with_info("precomputed-labels", |info| {
            info["scales"][0]["compressed_segmentation_block_size"] = value
        })
    };
    refused(&labels("null"), "encoding", "expected three numbers from 1 to 1024");
    refused(&labels("[1,1,1]"), "data", "has a false header, or ends too early");
    let shards = |name: &'static str, value: &str| {
        let value = json(value);
        with_info("precomputed-labels-shards", |info| {
            info["scales"][0]["sharding"][name] = value
        })
    };
    refused(
        &shards("hash", "\"md5\""),
        "sharding",
        "expected identity or murmurhash3_x86_128",
    );
    refused(&shards("minishard_bits", "60"), "sharding", "expected 40 at most");
    refused(&shards("data_encoding", "\"zstd\""), "sharding", "expected raw or gzip");
    refused(
        &shards("minishard_index_encoding", "\"raw\""),
        "data",
        "expected 24 for each chunk",
    );
}

#[test]
fn claims_are_not_allocated() {
    let large = |size: &str, chunk: &str| {
        let (size, chunk): (serde_json::Value, serde_json::Value) = (
            serde_json::from_str(size).unwrap(),
            serde_json::from_str(chunk).unwrap(),
        );
        with_info("precomputed-raw", |info| {
            info["scales"].as_array_mut().unwrap().truncate(1);
            info["scales"][0]["size"] = size;
            info["scales"][0]["chunk_sizes"][0] = chunk;
        })
    };
    refused(
        &large("[1200,1200,1200]", "[4,3,3]"),
        "chunk_sizes",
        "expected 524288 at most",
    );
    refused(
        &large("[1200,1200,1200]", "[1200,1200,1200]"),
        "chunk_sizes",
        "expected 1 GiB at most",
    );
    refused(&large("[9e9,2,2]", "[4,3,3]"), "info", "invalid type");
    // A chunk that is there, of a volume that is not.
    let folder = large("[1200,1200,1200]", "[64,64,64]");
    fs::write(folder.path().join("a/8_8_30/3-67_4-68_5-69"), gzip(&[0; 1000])).unwrap();
    refused(&folder, "data", "stored bytes cannot hold");
    // A bomb.
    let folder = large("[7,5,6]", "[4,3,3]");
    fs::write(folder.path().join("a/8_8_30/3-7_4-7_5-8"), gzip(&vec![0; 4 << 20])).unwrap();
    refused(&folder, "data", "bytes in gzip");
}

/// Its second chunk is the first as a progressive image.
const NOISE: &str = "precomputed-noise";
const BASELINE: &str = "8_8_30/0-16_0-8_0-6";
const PROGRESSIVE: &str = "8_8_30/16-32_0-8_0-6";

#[test]
fn a_progressive_image_has_the_samples_of_a_baseline_one() {
    let dataset = open_dataset(&stores::fixture(NOISE)).unwrap();
    assert_eq!((dataset.geometry.dims, dataset.fields.len()), ([32, 8, 6], 3));
    for field in &dataset.fields {
        let samples = field.source.load(0).unwrap();
        let row = |row: usize, from: usize| -> Vec<f32> { (0..16).map(|x| samples.get(32 * row + from + x)).collect() };
        for y_z in 0..48 {
            let baseline = row(y_z, 0);
            assert!(baseline.iter().any(|&value| value != baseline[0]));
            assert_eq!(row(y_z, 16), baseline, "{}, row {y_z}", field.name);
        }
    }
}

/// Each scan takes as long as the whole image, and a few bytes.
#[test]
fn images_of_many_scans_are_refused() {
    for name in [BASELINE, PROGRESSIVE] {
        let folder = write(&files(NOISE));
        let path = folder.path().join("a").join(name);
        let image = fs::read(&path).unwrap();
        let last_scan = image.windows(2).rposition(|bytes| bytes == [0xff, 0xda]).unwrap();
        let (before, scan) = image[..image.len() - 2].split_at(last_scan);
        fs::write(&path, [before, &scan.repeat(101), &[0xff, 0xd9]].concat()).unwrap();
        refused(&folder, "data", "scans, expected 100 at most");
    }
}

#[test]
fn large_progressive_images_are_refused() {
    let mut files = files(NOISE);
    let mut info: serde_json::Value = serde_json::from_slice(&files[0].1).unwrap();
    info["scales"][0]["size"] = serde_json::json!([4096, 1536, 2]);
    info["scales"][0]["chunk_sizes"][0] = serde_json::json!([4096, 1536, 2]);
    files[0].1 = serde_json::to_vec(&info).unwrap();
    let image = files
        .iter_mut()
        .find(|(path, _)| path == Path::new(PROGRESSIVE))
        .unwrap();
    image.0 = "8_8_30/0-4096_0-1536_0-2".into();
    let size = image.1.windows(2).position(|bytes| bytes == [0xff, 0xc2]).unwrap() + 5;
    image.1[size..size + 4].copy_from_slice(&[0x0c, 0, 0x10, 0]);
    // At least as many bytes as the samples require.
    image.1.resize(4096, 0);
    refused(&write(&files), "data", "a progressive JPEG of 37748736 coefficients");
}

/// Changed bytes in one file, then perhaps a cut.
#[test]
fn changed_bytes_never_panic() {
    let folders = FOLDERS.map(|folder| Changing::new("a", files(folder)));
    stores::change_bytes("precomputed", 300, &folders, changed::extreme_bytes(8), read);
}

/// Digits of `info` replaced by digits.
#[test]
fn changed_numbers_never_panic() {
    let folders = FOLDERS.map(|folder| Changing::new("a", files(folder)));
    stores::change_digits("precomputed", 300, &folders, |_| 0, read);
}
