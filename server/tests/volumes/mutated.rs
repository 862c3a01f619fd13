//! Files of formats that libraries decode, changed at random: an error or right-sized samples, in bounded time and memory.

use std::path::Path;

use proptest::prelude::*;

use crate::hostile::{mutations, read};

/// Files of `tests/fixtures/volumes`, format by format.
const FILES: [&[&str]; 4] = [
    &[
        "hdf5_fiji.h5",
        "hdf5_filters.h5",
        "hdf5_half.h5",
        "hdf5_indexes.h5",
        "hdf5_scales.h5",
        "netcdf_grouped.nc4",
        "netcdf_unwritten.nc",
    ],
    &[
        "netcdf_classic.nc",
        "netcdf_data64.nc",
        "netcdf_offset64.nc",
        "rectilinear.nc",
        "uneven.nc",
    ],
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

proptest! {
    #![proptest_config(mutations(FILES.len(), 6000))]

    /// Bytes anywhere become others, mostly such as make counts and addresses false; or a part is copied over another.
    #[test]
    fn changed_bytes_never_panic(
        format in 0..FILES.len(),
        file in any::<prop::sample::Index>(),
        changes in prop::collection::vec(
            (any::<prop::sample::Index>(), prop_oneof![any::<u8>(), Just(0xff), Just(0)]),
            1..8,
        ),
        splice in prop::option::weighted(0.2, (any::<prop::sample::Index>(), any::<prop::sample::Index>(), 1..64usize)),
    ) {
        let name = *file.get(FILES[format]);
        let mut bytes = bytes(name);
        let reach = reach(&bytes);
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Some((from, to, length)) = splice {
            let (from, to) = (from.index(bytes.len()), to.index(bytes.len()));
            let length = length.min(bytes.len() - from.max(to));
            bytes.copy_within(from..from + length, to);
        }
        let _ = read(&[(name, bytes)], reach);
    }
}

/// DICOM files of other programs, one a kind of compression.
fn dicom_cases() -> Vec<Vec<u8>> {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/volumes/dicom");
    let names = [
        "frames",
        "enhanced",
        "rle-i16",
        "jpegls-i16",
        "jpeg-color",
        "jpeg2000-rgb",
    ];
    let read = |name| std::fs::read(folder.join(format!("{name}.dcm"))).unwrap();
    names.into_iter().map(read).collect()
}

/// What DICOM may take beside the volume: a frame that a compressed one may be said to be.
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
    let mut runner = proptest::test_runner::TestRunner::new(mutations(1, 1500));
    let place = any::<prop::sample::Index>;
    let strategy = (
        0..cases.len(),
        prop::collection::vec((place(), any::<u8>(), any::<bool>()), 1..8),
        prop::option::weighted(0.3, (place(), place(), 1..64usize)),
    );
    type Index = prop::sample::Index;
    type Change = (Index, u8, bool);
    type Splice = (Index, Index, usize);
    let test = |(which, changes, splice): (usize, Vec<Change>, Option<Splice>)| {
        let mut bytes = cases[which].clone();
        for (at, value, in_header) in changes {
            // Of these files the header is the longest part; its end is where sizes are.
            let at = if in_header {
                700 + at.index(bytes.len().min(2600) - 700)
            } else {
                at.index(bytes.len())
            };
            bytes[at] = value;
        }
        if let Some((from, to, length)) = splice {
            let from: usize = from.index(bytes.len() - length);
            let to: usize = to.index(bytes.len() - length);
            bytes.copy_within(from..from + length, to);
        }
        let _ = read(&[("a.dcm", bytes)], DICOM_BYTES);
        Ok(())
    };
    runner.run(&strategy, test).unwrap();
}
