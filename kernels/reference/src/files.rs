//! Volumes of real scans, read from their files: just enough of NRRD (attached header, gzip) and NIfTI (`.nii.gz`, little
//! endian). On purpose, this module does not use the server's readers.

use flate2::read::MultiGzDecoder;
use isopeel_kernels::{Grid, Samples};
use std::io::Read;
use std::path::{Path, PathBuf};

/// Reads one of the test volumes.
///
/// # Panics
/// The file cannot be read, or it is not of the kind that this module knows.
pub fn read(path: &Path) -> (Grid, Samples) {
    let bytes = std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    if path.extension().is_some_and(|e| e == "nrrd") {
        nrrd(&bytes)
    } else {
        nifti(&gunzip(&bytes))
    }
}

/// Reads a volume that is not in the repository, from the folder that `ISOPEEL_DATA` names.
///
/// # Panics
/// As [`read`]; the variable is not set.
pub fn read_from_data_folder(name: &str) -> (Grid, Samples) {
    let folder = std::env::var_os("ISOPEEL_DATA");
    let folder = folder.unwrap_or_else(|| panic!("ISOPEEL_DATA must name a folder that holds {name}"));
    read(&Path::new(&folder).join(name))
}

/// Returns the path of a file of this repository. `ISOPEEL_REPOSITORY` names a folder that holds a copy of it, on machines
/// that have the tests without the source tree.
pub fn repository_file(path: &str) -> PathBuf {
    let copy = std::env::var_os("ISOPEEL_REPOSITORY").map(PathBuf::from);
    copy.unwrap_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../.."))
        .join(path)
}

fn gunzip(bytes: &[u8]) -> Vec<u8> {
    let mut plain = Vec::new();
    MultiGzDecoder::new(bytes)
        .read_to_end(&mut plain)
        .expect("a whole gzip stream");
    plain
}

fn samples_i16(bytes: &[u8]) -> Samples {
    Samples::I16(
        bytes
            .chunks_exact(2)
            .map(|b| i16::from_le_bytes([b[0], b[1]]))
            .collect(),
    )
}

fn nrrd(bytes: &[u8]) -> (Grid, Samples) {
    let end = bytes.windows(2).position(|w| w == b"\n\n");
    let end = end.expect("a blank line ends the header");
    let header = std::str::from_utf8(&bytes[..end]).expect("the header is text");
    let get = |key: &str| {
        let value = header.lines().find_map(|line| line.strip_prefix(key));
        value.unwrap_or_else(|| panic!("the header has no {key}")).trim()
    };
    let numbers = |key: &str| -> [f64; 3] {
        let numbers = get(key).split_whitespace().map(|n| n.parse().expect("a number"));
        numbers.collect::<Vec<_>>().try_into().expect("three numbers")
    };
    assert_eq!(get("encoding:"), "gzip");
    let dims = numbers("sizes:").map(|n| n as u32);
    let grid = Grid::new(dims, numbers("spacings:").map(|n| n as f32)).expect("a valid grid");
    let bytes = gunzip(&bytes[end + 2..]);
    let samples = match get("type:") {
        "uint8" => Samples::U8(bytes),
        "int16" => samples_i16(&bytes),
        other => panic!("samples of type {other}"),
    };
    (grid, samples)
}

fn nifti(bytes: &[u8]) -> (Grid, Samples) {
    let short = |at: usize| i16::from_le_bytes([bytes[at], bytes[at + 1]]);
    let float = |at: usize| f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
    let (slope, intercept) = (float(112), float(116));
    assert!(matches!(slope, 0.0 | 1.0) && intercept == 0.0, "samples are not scaled");
    let dims = [42, 44, 46].map(|at| short(at) as u32);
    let grid = Grid::new(dims, [80, 84, 88].map(float)).expect("a valid grid");
    let samples = &bytes[float(108) as usize..];
    let samples = match short(70) {
        2 => Samples::U8(samples.to_vec()),
        4 => samples_i16(samples),
        other => panic!("NIfTI data type {other}"),
    };
    (grid, samples)
}
