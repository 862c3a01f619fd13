//! Files of formats that libraries decode, changed at random: an error or right-sized samples, in bounded time and memory.

use std::path::Path;

use proptest::prelude::*;
use proptest::sample::Index;

use crate::changed;
use crate::hostile::read;

/// Files of `tests/fixtures/volumes`, format by format.
const FILES: [&[&str]; 6] = [
    &[
        "hdf5_fiji.h5",
        "hdf5_filters.h5",
        "hdf5_half.h5",
        "hdf5_indexes.h5",
        "hdf5_plugins.h5",
        "hdf5_scales.h5",
        "named_axistags.h5",
        "named_labels.h5",
        "netcdf_grouped.nc4",
        "netcdf_unwritten.nc",
    ],
    &[
        "netcdf_classic.nc",
        "netcdf_data64.nc",
        "netcdf_offset64.nc",
        "rectilinear.nc",
        "uneven.nc",
        "named_pressure.nc",
    ],
    &[
        "convention_bdv.h5",
        "convention_cells.vtkhdf",
        "convention_imaris.ims",
        "convention_openpmd.h5",
        "convention_points.vtkhdf",
        "convention_steps.vtkhdf",
    ],
    &["slicer.seg.nrrd"],
    &[
        "rectilinear-ascii.vtk",
        "rectilinear-ascii.vtr",
        "rectilinear-base64-lz4.vtr",
        "rectilinear-binary.vtk",
        "rectilinear-inline-zlib.vtr",
        "rectilinear-raw.vtr",
        "uneven.vtr",
    ],
    &[
        "tiff_bigtiff_big.tif",
        "tiff_deflate_tiles.tif",
        "tiff_imagej.tif",
        "tiff_imagej_large.tif",
        "tiff_lzw_big.tif",
        "tiff_ome.ome.tif",
        "tiff_packbits.tif",
        "tiff_plain_tiles.tif",
        "tiff_rgb.tif",
        "tiff_samples_separate.tif",
        "tiff_white.tif",
    ],
];

fn bytes(name: &str) -> Vec<u8> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/volumes");
    std::fs::read(folder.join(name)).unwrap()
}

/// As much as the densest compression holds, in the widest type, twice.
fn reach(bytes: &[u8]) -> usize {
    bytes.len() * 1032 * 8
}

#[test]
fn what_is_cut_off_is_an_error_or_a_volume() {
    for &name in FILES.into_iter().flatten() {
        let whole = bytes(name);
        for cut in (0..whole.len()).step_by(whole.len() / 100) {
            let short = whole[..cut].to_vec();
            let _ = read(&[(name, short)], reach(&whole));
        }
    }
}

/// Changes that once took more memory or time than they may: file, offset, new byte.
const FAILED_ONCE: [(&str, usize, u8); 3] = [
    // A predictor for each of 524,288 samples.
    ("tiff_deflate_tiles.tif", 230, 8),
    ("tiff_rgb.tif", 184, 64),
    ("tiff_samples_separate.tif", 1208, 16),
];

#[test]
fn what_failed_once_is_refused() {
    for (name, at, value) in FAILED_ONCE {
        let mut bytes = bytes(name);
        bytes[at] = value;
        let reach = reach(&bytes);
        let error = read(&[(name, bytes)], reach).unwrap_err();
        assert!(error.why.contains("expected at most"), "{error}");
    }
}

/// Perhaps a part that is copied over another: its source, its destination, and its number of bytes.
fn splice(probability: f64) -> impl Strategy<Value = Option<(Index, Index, usize)>> {
    prop::option::weighted(probability, (any::<Index>(), any::<Index>(), 1..64usize))
}

fn copy_part(bytes: &mut [u8], splice: Option<(Index, Index, usize)>) {
    if let Some((from, to, length)) = splice {
        let (from, to) = (from.index(bytes.len()), to.index(bytes.len()));
        let length = length.min(bytes.len() - from.max(to));
        bytes.copy_within(from..from + length, to);
    }
}

/// Replaces bytes anywhere, mostly by extreme values that make counts and addresses wrong, or copies a part over another.
#[test]
fn changed_bytes_never_panic() {
    for files in FILES {
        let files: Vec<_> = files.iter().map(|&name| (name, bytes(name))).collect();
        let format = files[0].0;
        let strategy = (0..files.len(), changed::extreme_bytes(8), splice(0.2));
        changed::each(format, 6000, &strategy, |(which, changes, splice)| {
            let (name, mut bytes) = files[which].clone();
            let reach = reach(&bytes);
            changed::change(&mut bytes, changes);
            copy_part(&mut bytes, splice);
            let _ = read(&[(name, bytes)], reach);
        });
    }
}

/// DICOM files of other programs, one a kind of compression and of contents.
fn dicom_cases() -> Vec<Vec<u8>> {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/volumes/dicom");
    let names = [
        "frames",
        "enhanced",
        "rle-i16",
        "jpegls-i16",
        "jpeg-color",
        "jpeg2000-rgb",
        "dose",
        "segments",
    ];
    let read = |name| std::fs::read(folder.join(format!("{name}.dcm"))).unwrap();
    names.into_iter().map(read).collect()
}

/// Memory that DICOM may take beside the volume: a frame of the size that a compressed one may declare.
const DICOM_BYTES: usize = 12 << 20;

#[test]
fn dicom_that_is_cut_off_is_refused() {
    for file in dicom_cases() {
        read(&[("a.dcm", file.clone())], DICOM_BYTES).unwrap();
        for cut in (0..file.len()).step_by(5) {
            let error = read(&[("a.dcm", file[..cut].to_vec())], DICOM_BYTES).unwrap_err();
            assert_eq!(error.path, std::path::Path::new("a.dcm"));
        }
    }
}

#[test]
fn claims_of_dicom_are_not_allocated() {
    const COLUMNS: &[u8] = b"\x28\0\x11\0US\x02\0";
    for mut file in dicom_cases() {
        let at = file.windows(COLUMNS.len()).position(|w| w == COLUMNS).unwrap() + COLUMNS.len();
        file[at..at + 2].copy_from_slice(&[0xff, 0xff]);
        let error = read(&[("a.dcm", file)], 1 << 16).unwrap_err();
        assert!(
            error.why.contains("expected") || error.why.contains("cannot hold"),
            "{error}"
        );
    }
}

#[test]
fn changed_dicom_never_panics() {
    let cases = dicom_cases();
    // The header is the longest part of these files; sizes are at its end.
    let strategy = (0..cases.len(), changed::bytes(8), any::<bool>(), splice(0.3));
    changed::each("dicom", 1500, &strategy, |(which, changes, in_header, splice)| {
        let mut bytes = cases[which].clone();
        let part = if in_header {
            700..bytes.len().min(2600)
        } else {
            0..bytes.len()
        };
        changed::change(&mut bytes[part], changes);
        copy_part(&mut bytes, splice);
        let _ = read(&[("a.dcm", bytes)], DICOM_BYTES);
    });
}
