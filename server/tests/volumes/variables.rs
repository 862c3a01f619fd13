//! HDF5 and NetCDF: refused files and notices.

use std::path::Path;

use isopeel_volumes::open_dataset;

use crate::bounds::within;
use crate::write;

fn open(name: &str) -> Result<isopeel_volumes::Dataset, String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/volumes");
    open_dataset(&folder.join(name)).map_err(|e| e.to_string())
}

#[test]
fn what_is_not_read_is_named() {
    for (part, expected) in [
        ("flat", "5 x 7 samples, expected 3 axes in space longer than 1"),
        (
            "five",
            "2 x 2 x 2 x 2 x 2 samples, expected 3 axes in space longer than 1, or 4",
        ),
        (
            "bfloat16",
            "floats in 16 bits with an exponent of 8 bits and a mantissa of 7, expected those of IEEE 754 (5 and 10) with their bias and byte order",
        ),
        ("records", "compound samples, expected one number a sample"),
        (
            "external",
            "its samples are in other files (external storage), which are not read",
        ),
        ("blosc2", "filter 32026"),
        ("assembled/virtual", "a virtual dataset, which is not read"),
        ("none", "expected one of /bfloat16 (floats in 16 bits"),
    ] {
        let error = open(&format!("hdf5_refused.h5:/{part}")).unwrap_err();
        assert!(
            error.contains(expected) && error.contains(&format!("/{part}: ")),
            "{part}: {error}"
        );
    }
}

#[test]
fn a_chunk_that_decodes_to_too_many_bytes_is_refused() {
    let dataset = open("hdf5_bomb.h5").unwrap();
    let error = within(1 << 20, || dataset.fields[0].source.load(0)).unwrap_err();
    assert!(error.to_string().contains("zstd: more than 4332 bytes"), "{error}");
}

#[test]
fn a_compressed_file_is_read_as_the_file_in_it() {
    let folder = tempfile::tempdir().unwrap();
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/volumes");
    for name in ["hdf5_fiji.h5", "netcdf_classic.nc"] {
        let packed = folder.path().join(format!("{name}.gz"));
        std::fs::write(&packed, write::gzip(&std::fs::read(source.join(name)).unwrap())).unwrap();
        let [a, b] = [open_dataset(&packed).unwrap(), open(name).unwrap()];
        assert_eq!((a.geometry, a.field_names()), (b.geometry, b.field_names()));
        for (a, b) in a.fields.iter().zip(&b.fields) {
            let [a, b] = [a, b].map(|field| field.source.load(0).unwrap());
            assert!(
                (0..a.len()).all(|i| a.get(i) == b.get(i) || a.get(i).is_nan()),
                "{name}"
            );
        }
    }
}

#[test]
fn a_file_without_a_volume_says_what_it_holds() {
    let error = open("hdf5_refused.h5").unwrap_err();
    for part in [
        "no variable is a volume",
        "/flat (5 x 7 i16)",
        "/bfloat16 (floats in 16 bits",
        "/assembled/ (",
    ] {
        assert!(error.contains(part), "{part}: {error}");
    }
}

#[test]
fn uneven_grids_say_so() {
    let notice = open("netcdf_offset64.nc").unwrap().notices.text().unwrap();
    assert!(
        notice.contains("coordinates are sample indices") && notice.contains("\"depth\" is not even"),
        "{notice}"
    );
    assert!(
        notice.contains("100 between samples 4 and 5, the largest deviation"),
        "{notice}"
    );
    assert!(open("netcdf_classic.nc").unwrap().notices.is_empty());
    let notice = open("rectilinear.nc").unwrap().notices.text().unwrap();
    assert!(
        notice.contains("samples are interpolated onto an even grid, 7 x 5 x 6 onto 7 x 5 x 7")
            && notice.contains("\"z\" is not even")
            && notice.contains("-4 between samples 3 and 4, the largest deviation, expected -2.4"),
        "{notice}"
    );
}

#[test]
fn what_is_guessed_or_repaired_is_said() {
    for (name, parts) in [
        (
            "hdf5_fiji.h5",
            &["does not say what its axes are: time, z, y, x were taken"][..],
        ),
        ("named_xyz.nc", &[]),
        ("named_zxy.nc", &[]),
        ("named_yzx.nc", &[]),
        (
            "named_labels.h5",
            &["does not say how far apart samples are: 1 was taken along each axis"],
        ),
        (
            "named_fill.ome.zarr",
            &[
                "the scale -1.5 along \"y\" is negative",
                "axis \"z\" has no unit: µm was taken",
            ],
        ),
        (
            "named_axistags.h5",
            &["no spacing along z: 0.25 was taken, as along another axis"],
        ),
        (
            "named_longitude.nc",
            &["\"lon\" crosses a full turn: its positions go on from 358 to 364"],
        ),
        ("named_pressure.nc", &["the units of lon, lat, plev differ"]),
    ] {
        let notices = open(name).unwrap().notices.text().unwrap_or_default();
        assert_eq!(parts.is_empty(), notices.is_empty(), "{name}: {notices}");
        for part in parts {
            assert!(notices.contains(part), "{name}: {notices}");
        }
    }
}
