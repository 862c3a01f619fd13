//! Files of formats that libraries decode, changed at random: an error or right-sized samples, in bounded time and memory.

use std::path::Path;

use proptest::prelude::*;

use crate::hostile::{mutations, read};

/// Files of `tests/fixtures/volumes`.
const FILES: [&str; 20] = [
    "hdf5_fiji.h5",
    "hdf5_filters.h5",
    "hdf5_indexes.h5",
    "hdf5_scales.h5",
    "netcdf_classic.nc",
    "netcdf_data64.nc",
    "netcdf_grouped.nc4",
    "netcdf_offset64.nc",
    "netcdf_unwritten.nc",
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
    for name in FILES {
        let whole = bytes(name);
        for cut in (0..whole.len()).step_by(whole.len() / 100) {
            let short = whole[..cut].to_vec();
            let _ = read(&[(name, short)], reach(&whole));
        }
    }
}

proptest! {
    #![proptest_config(mutations(20_000))]

    /// Bytes anywhere become others, mostly such as make counts and addresses false; or a part is copied over another.
    #[test]
    fn changed_bytes_never_panic(
        which in 0..FILES.len(),
        changes in prop::collection::vec(
            (any::<prop::sample::Index>(), prop_oneof![any::<u8>(), Just(0xff), Just(0)]),
            1..8,
        ),
        splice in prop::option::weighted(0.2, (any::<prop::sample::Index>(), any::<prop::sample::Index>(), 1..64usize)),
    ) {
        let name = FILES[which];
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
