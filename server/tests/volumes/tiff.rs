//! TIFF: refused files, notices, and folders of slices.

use std::path::{Path, PathBuf};

use isopeel_volumes::location::MemoryFolder;
use isopeel_volumes::{FileLocation, open_dataset, read_file};

fn fixtures() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/volumes")
}

fn bytes(name: &str) -> Vec<u8> {
    std::fs::read(fixtures().join(name)).unwrap()
}

/// The message about a file of these bytes.
fn refused(name: &str, bytes: Vec<u8>) -> String {
    let folder = MemoryFolder::from([(name.to_owned(), bytes.into())]);
    let location = FileLocation::memory(folder.into(), name);
    match read_file(&location) {
        Ok(_) => panic!("{name} was read"),
        Err(e) => e.to_string(),
    }
}

fn replaced(mut bytes: Vec<u8>, from: &[u8], to: &[u8]) -> Vec<u8> {
    let at = bytes.windows(from.len()).position(|part| part == from).unwrap();
    bytes.splice(at..at + from.len(), to.iter().copied());
    bytes
}

/// A folder with some of the numbered slices, and other files.
fn slices(numbers: &[u32], others: &[&str]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for number in numbers {
        let name = format!("scan2_z{number}.tif");
        std::fs::copy(fixtures().join("tiff_slices").join(&name), folder.path().join(name)).unwrap();
    }
    for name in others {
        std::fs::copy(fixtures().join(name), folder.path().join(name)).unwrap();
    }
    folder
}

#[test]
fn a_missing_slice_is_named() {
    let folder = slices(&[8, 9, 11], &[]);
    let error = open_dataset(folder.path()).unwrap_err().to_string();
    assert!(
        error.contains("no slice 10 after") && error.contains("scan2_z9.tif"),
        "{error}"
    );
}

#[test]
fn slices_of_another_size_are_refused() {
    let folder = slices(&[8, 9], &[]);
    std::fs::copy(fixtures().join("tiff_two.ome.tif"), folder.path().join("scan2_z10.tif")).unwrap();
    let error = open_dataset(folder.path()).unwrap_err().to_string();
    assert!(error.contains("9 pages, expected one, as the other slices"), "{error}");
}

#[test]
fn a_folder_of_stacks_is_no_series() {
    let folder = slices(&[], &[]);
    for number in [1, 2] {
        let to = folder.path().join(format!("time{number}.tif"));
        std::fs::copy(fixtures().join("tiff_lzw.tif"), to).unwrap();
    }
    let dataset = open_dataset(folder.path()).unwrap();
    assert_eq!(dataset.field_names(), ["time1", "time2"]);
}

#[test]
fn one_slice_is_no_volume() {
    let error = refused("a.tif", bytes("tiff_slices/scan2_z8.tif"));
    assert!(error.contains("7 x 5 x 1 samples, expected a volume"), "{error}");
}

#[test]
fn files_of_a_set_are_named_and_stay_in_their_folder() {
    let set = bytes("tiff_set_a.ome.tif");
    // A file in memory has no folder, so that its own name decides.
    let name = "tiff_set_a.ome.tif";
    let error = refused(name, set.clone());
    assert!(error.contains("\"tiff_set_b.ome.tif\": not found"), "{error}");
    let outside = replaced(set, b"\"tiff_set_b.ome.tif\"", b"\"../ecret/b.ome.tif\"");
    assert!(refused(name, outside).contains("expected a file in the header's own folder"));
}

#[test]
fn several_volumes_are_listed() {
    let error = refused("a.tif", bytes("tiff_two.ome.tif"));
    assert!(
        error.contains("2 volumes, expected the name or number") && error.contains("2 \"second\" (3 slices)"),
        "{error}"
    );
}

/// Little-endian TIFF of one directory: entries of tag, type, count, value.
fn tiff(entries: &[[u32; 4]], next: u32) -> Vec<u8> {
    let mut bytes = b"II*\0\x08\0\0\0".to_vec();
    bytes.extend((entries.len() as u16).to_le_bytes());
    for [tag, kind, count, value] in entries {
        bytes.extend((*tag as u16).to_le_bytes());
        bytes.extend((*kind as u16).to_le_bytes());
        bytes.extend(count.to_le_bytes());
        bytes.extend(value.to_le_bytes());
    }
    bytes.extend(next.to_le_bytes());
    bytes.resize(256, 7);
    bytes
}

/// A page of `width` x `height` bytes, compressed in some way.
fn page(width: u32, height: u32, compression: u32) -> Vec<[u32; 4]> {
    vec![
        [256, 4, 1, width],
        [257, 4, 1, height],
        [258, 3, 1, 8],
        [259, 3, 1, compression],
        [262, 3, 1, 1],
        [273, 4, 1, 200],
        [278, 4, 1, height],
        [279, 4, 1, 16],
    ]
}

#[test]
fn false_claims_are_refused_before_anything_is_decoded() {
    for (what, entries, next, expected) in [
        (
            "a chain that goes round",
            page(4, 4, 1),
            8,
            "directory 1 is followed by an earlier one",
        ),
        (
            "plain",
            page(5, 4, 1),
            0,
            "16 bytes of samples, which cannot hold 5 x 4 pixels of 1 u8",
        ),
        ("deflate", page(60000, 60000, 8), 0, "cannot hold"),
        ("a size of 0", page(0, 4, 1), 0, "ImageWidth is 0"),
        (
            "a size past 31 bits",
            page(4, u32::MAX, 1),
            0,
            "ImageLength is 4294967295",
        ),
        (
            "JPEG",
            page(4, 4, 7),
            0,
            "compression 7 (JPEG), expected none, LZW, deflate or PackBits",
        ),
        (
            "a text past the end",
            [page(4, 4, 1), vec![[270, 2, 1 << 30, 100]]].concat(),
            0,
            "more bytes than the file",
        ),
        (
            "more formats than samples",
            [page(4, 4, 1), vec![[339, 4, 1 << 30, 100]]].concat(),
            0,
            "tag 339 has 1073741824 values, expected at most 1",
        ),
    ] {
        let error = refused("a.tif", tiff(&entries, next));
        assert!(error.contains(expected), "{what}: {error}");
    }
}

#[test]
fn tiles_as_large_as_no_file_are_refused() {
    let mut tiled = page(4, 4, 1);
    tiled.truncate(5);
    tiled.extend([
        [322, 4, 1, 1 << 30],
        [323, 4, 1, 1 << 30],
        [324, 4, 1, 200],
        [325, 4, 1, 16],
    ]);
    assert!(refused("a.tif", tiff(&tiled, 0)).contains("cannot hold"));
}

#[test]
fn images_of_imagej_that_are_not_there_are_refused() {
    let mut large = bytes("tiff_imagej_large.tif");
    large.truncate(1000);
    let error = refused("a.tif", large);
    assert!(error.contains("6 images of 140 bytes"), "{error}");
}
