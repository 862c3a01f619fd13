//! MRC and CCP4 maps: round trips, axes and cells, and refused files.

use isopeel_volumes::{FileLocation, LengthUnit, OpenedFile, ReadError, Samples, open_dataset, read_file};

use crate::formats::assert_refused;
use crate::write::{self, KINDS, Volume};
use crate::write_mrc::{Header, has_mode, mrc};

fn open(name: &str, bytes: Vec<u8>) -> Result<OpenedFile, ReadError> {
    read_file(&FileLocation::bytes(name, bytes))
}

fn values(samples: &Samples) -> Vec<f32> {
    (0..samples.len()).map(|i| samples.get(i)).collect()
}

fn plain() -> Volume {
    Volume::new([4, 3, 5], 1, ('i', 2), false)
}

fn with(edit: &dyn Fn(&mut Header)) -> Result<OpenedFile, ReadError> {
    open("a.mrc", mrc(&plain(), |h| edit(h)))
}

#[test]
fn maps_round_trip() {
    for kind in KINDS {
        for (big, steps) in [(false, 1), (true, 1), (true, 3)] {
            let v = Volume::new([4, 3, 5], steps, kind, big);
            if !has_mode(&v) {
                continue;
            }
            let bytes = mrc(&v, |_| {});
            for (name, bytes) in [
                ("a.mrc", bytes.clone()),
                ("a.ccp4.gz", write::gzip(&bytes)),
                ("a.MAP", bytes),
            ] {
                let file = open(name, bytes).unwrap();
                assert_eq!((file.geometry.dims, file.steps), (v.dims, steps));
                assert_eq!((file.geometry.spacing, file.geometry.origin), (v.spacing, v.origin));
                assert_eq!(file.geometry.unit, Some(LengthUnit::Angstrom));
                for (step, written) in v.values.chunks(60).enumerate() {
                    let written: Vec<f32> = written.iter().map(|&v| v as f32).collect();
                    assert_eq!(
                        values(&file.fields[0].source.load(step as u32).unwrap()),
                        written,
                        "{kind:?}"
                    );
                }
            }
        }
    }
}

#[test]
fn half_floats_are_read_in_both_orders() {
    for big in [false, true] {
        let v = Volume::new([2, 2, 2], 1, ('u', 2), big);
        let mut bytes = mrc(&v, |h| h.i32(4, 12));
        let stored: [u16; 8] = [0x3c00, 0xc000, 0x7bff, 0x0001, 0x3555, 0x0000, 0xfc00, 0x7c00];
        let order = |v: u16| if big { v.to_be_bytes() } else { v.to_le_bytes() };
        bytes.splice(1024.., stored.into_iter().flat_map(order));
        let found = values(&open("a.mrc", bytes).unwrap().fields[0].source.load(0).unwrap());
        let tiny = 2f32.powi(-24);
        assert_eq!(
            found,
            [
                1.0,
                -2.0,
                65504.0,
                tiny,
                0.333_251_95,
                0.0,
                f32::NEG_INFINITY,
                f32::INFINITY
            ]
        );
    }
}

/// Samples along x, y, z are found wherever the file has them.
#[test]
fn columns_rows_and_sections_have_any_axes() {
    let v = plain();
    for axes in [[1, 2, 3], [1, 3, 2], [2, 1, 3], [2, 3, 1], [3, 1, 2], [3, 2, 1]] {
        let file = with(&|h| (0..3).for_each(|i| h.i32(17 + i, axes[i]))).unwrap();
        let mut dims = [0; 3];
        (0..3).for_each(|i| dims[axes[i] as usize - 1] = v.dims[i]);
        assert_eq!(file.geometry.dims, dims);
        let found = file.fields[0].source.load(0).unwrap();
        for (at, &written) in v.values.iter().enumerate() {
            let at = at as u32;
            let in_file = [at % 4, at / 4 % 3, at / 12];
            let mut p = [0; 3];
            (0..3).for_each(|i| p[axes[i] as usize - 1] = in_file[i]);
            let index = (p[2] * dims[1] + p[1]) * dims[0] + p[0];
            assert_eq!(found.get(index as usize), written as f32, "{axes:?} at {p:?}");
        }
    }
}

#[test]
fn positions_are_those_of_the_cell() {
    let v = plain();
    // Without an origin the first column, row and section have indices in the cell.
    let start = |h: &mut Header| {
        (50..53).for_each(|word| h.f32(word, 0.0));
        [2, -1, 3].into_iter().enumerate().for_each(|(i, n)| h.i32(5 + i, n));
    };
    let file = with(&start).unwrap();
    assert_eq!(file.geometry.origin, [1.0, -1.25, 6.0]);
    // They are numbered as the file's axes.
    let turned = with(&|h| {
        start(h);
        [3, 1, 2]
            .into_iter()
            .enumerate()
            .for_each(|(i, axis)| h.i32(17 + i, axis));
    })
    .unwrap();
    let spacing = turned.geometry.spacing;
    assert_eq!(
        turned.geometry.origin,
        [-spacing[0], 3.0 * spacing[1], 2.0 * spacing[2]]
    );
    // A hexagonal cell.
    let file = with(&|h| h.f32(16, 120.0)).unwrap();
    let [a, b, c] = file.geometry.direction;
    assert_eq!((a, c), ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]));
    assert!((b[0] + 0.5).abs() < 1e-12 && (b[1] - 0.75f64.sqrt()).abs() < 1e-12 && b[2] == 0.0);
    // No lengths: samples are counted.
    let file = with(&|h| (11..14).for_each(|word| h.f32(word, 0.0))).unwrap();
    assert_eq!((file.geometry.spacing, file.geometry.unit), ([1.0; 3], None));
    assert_eq!(file.geometry.origin, v.origin);
}

#[test]
fn bytes_have_a_sign_unless_imod_says_otherwise() {
    let v = Volume::new([4, 3, 5], 1, ('i', 1), false);
    let first = |flags: Option<i32>| {
        let bytes = mrc(&v, |h| {
            h.i32(39, flags.map_or(0, |_| 1_146_047_817));
            h.i32(40, flags.unwrap_or(0));
        });
        open("a.mrc", bytes).unwrap().fields[0].source.load(0).unwrap().get(0)
    };
    assert_eq!((first(None), first(Some(1)), first(Some(0))), (-128.0, -128.0, 128.0));
}

#[test]
fn what_is_repaired_is_said() {
    let v = plain();
    let expected = with(&|_| {}).unwrap();
    let repaired = |words: &str, edit: &dyn Fn(&mut Header)| {
        let file = open("a.mrc", mrc(&v, |h| edit(h))).unwrap();
        let notice = file.notices.text().unwrap_or_default();
        assert!(notice.contains(words), "{notice:?}, expected {words:?}");
        assert_eq!(
            file.fields[0].source.load(0).unwrap(),
            expected.fields[0].source.load(0).unwrap(),
            "{words}"
        );
        file.geometry
    };
    for stamp in [
        [0x44, 0x11],
        [0x44, 0],
        [0x44, 0x20],
        [0, 0],
        [0x22, 0x41],
        [0x11, 0x11],
    ] {
        let words = if stamp == [0x11, 0x11] {
            "0x11 0x11"
        } else {
            "the machine stamp"
        };
        repaired(words, &|h| h.bytes[212..214].copy_from_slice(&stamp));
    }
    repaired("the word MAP is missing", &|h| h.bytes[208..212].fill(0));
    let spacing = expected.geometry.spacing;
    let geometry = repaired("MY is 0: 3 intervals", &|h| h.i32(9, 0));
    assert_eq!(geometry.spacing, spacing);
    let geometry = repaired("CELLA has no length along Y", &|h| h.f32(12, 0.0));
    assert_eq!(geometry.spacing, [spacing[0], spacing[0], spacing[2]]);
    let bytes = Volume::new([4, 3, 5], 1, ('i', 1), false);
    for (low, high, first) in [
        (0.0, 255.0, 128.0),
        (0.0, 127.0, -128.0),
        (-128.0, 127.0, -128.0),
        (0.0, 0.0, -128.0),
    ] {
        let edit = |h: &mut Header| {
            h.f32(20, low);
            h.f32(21, high);
        };
        let file = open("a.mrc", mrc(&bytes, edit)).unwrap();
        assert_eq!(file.fields[0].source.load(0).unwrap().get(0), first, "{low} to {high}");
        assert_eq!(file.notices.is_empty(), first < 0.0);
    }
}

#[test]
fn an_extended_header_is_passed_over() {
    let v = plain();
    let mut bytes = mrc(&v, |h| h.i32(24, 160));
    bytes.splice(1024..1024, [7; 160]);
    let file = open("a.mrc", bytes).unwrap();
    assert_eq!(file.fields[0].source.load(0).unwrap().get(1), v.values[1] as f32);
}

#[test]
fn what_is_no_map_is_refused() {
    let cases: Vec<(&str, &str, Result<OpenedFile, ReadError>)> = vec![
        ("header", "1000 bytes, expected 1024", open("a.mrc", vec![0; 1000])),
        (
            "MAP",
            "\"MAQ \", expected \"MAP \"",
            with(&|h| {
                h.bytes[210] = b'Q';
                h.i32(4, 77);
            }),
        ),
        (
            "MACHST",
            "0x22 0x41, expected 0x44 0x44",
            with(&|h| {
                h.bytes[212..214].copy_from_slice(&[0x22, 0x41]);
                h.i32(4, 77);
            }),
        ),
        ("MODE", "4 (complex), expected 0", with(&|h| h.i32(4, 4))),
        ("MODE", "101 (4 bits)", with(&|h| h.i32(4, 101))),
        ("MODE", "5, expected", with(&|h| h.i32(4, 5))),
        ("NY", "0, expected at least 1", with(&|h| h.i32(2, 0))),
        ("NX", "-4, expected at least 1", with(&|h| h.i32(1, -4))),
        (
            "NX, NY, NZ",
            "at least 2",
            with(&|h| {
                h.i32(1, 1);
                h.i32(2, 12);
            }),
        ),
        (
            "NX, NY, NZ",
            "pass 64 bits",
            with(&|h| (1..4).for_each(|i| h.i32(i, i32::MAX))),
        ),
        ("data", "120 bytes, expected 240: NX, NY, NZ", with(&|h| h.i32(1, 8))),
        ("data", "120 bytes, 60 more than expected", with(&|h| h.i32(4, 0))),
        (
            "MAPC, MAPR, MAPS",
            "[1, 1, 3], expected 1, 2 and 3",
            with(&|h| h.i32(18, 1)),
        ),
        ("NSYMBT", "-80, expected the bytes", with(&|h| h.i32(24, -80))),
        ("data", "should begin at", with(&|h| h.i32(24, i32::MAX))),
        ("CELLA", "NaN", with(&|h| h.f32(12, f32::NAN))),
        ("CELLA", "-1", with(&|h| h.f32(12, -1.0))),
        ("CELLB", "expected angles of a cell", with(&|h| h.f32(14, 180.0))),
        (
            "CELLB",
            "expected angles of a cell",
            with(&|h| {
                h.f32(14, 20.0);
                h.f32(15, 30.0);
                h.f32(16, 80.0);
            }),
        ),
        ("ORIGIN", "finite", with(&|h| h.f32(50, f32::INFINITY))),
        (
            "MZ",
            "3 sections of each volume, expected a divisor of the 5",
            with(&|h| {
                h.i32(23, 401);
                h.i32(10, 3);
            }),
        ),
    ];
    for (field, words, result) in cases {
        assert_refused(result, field, words, "a.mrc");
    }
}

/// `.map` is also the name of other files, which are no volumes of their folder.
#[test]
fn other_files_of_the_name_are_passed_over() {
    let folder = tempfile::tempdir().unwrap();
    let put = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).unwrap();
    put("viewer.js.map", b"{\"version\":3}");
    put("density.map.gz", &write::gzip(&mrc(&plain(), |_| {})));
    let dataset = open_dataset(folder.path()).unwrap();
    assert_eq!(dataset.field_names(), ["density"]);
}
