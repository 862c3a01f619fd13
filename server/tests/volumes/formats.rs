//! Round trips: every format, type and byte order.

use std::sync::Arc;

use isopeel::volumes::location::MemoryFolder;
use isopeel::volumes::{FileLocation, OpenedFile, ReadError, ReadProgress, Samples, open_dataset, read_file};
use isopeel_kernels::SampleType;

use crate::write::{self, KINDS, Volume};

const DIMS: [u32; 3] = [4, 3, 5];

fn memory(files: Vec<(&str, Vec<u8>)>) -> FileLocation {
    let first = files[0].0.to_owned();
    let folder: MemoryFolder = files.into_iter().map(|(n, b)| (n.to_owned(), b.into())).collect();
    FileLocation::memory(Arc::new(folder), first)
}

fn open(name: &str, bytes: Vec<u8>) -> Result<OpenedFile, ReadError> {
    read_file(&FileLocation::bytes(name, bytes))
}

fn values(samples: &Samples) -> Vec<f32> {
    (0..samples.len()).map(|i| samples.get(i)).collect()
}

/// Compares all that a reader returns with what was written.
fn same(file: &OpenedFile, v: &Volume, what: &str) {
    assert_eq!((file.geometry.dims, file.steps), (v.dims, v.steps), "{what}");
    let expected = match v.kind {
        ('u', 1) => SampleType::U8,
        ('i', 1) => SampleType::I8,
        ('u', 2) => SampleType::U16,
        ('i', 2) => SampleType::I16,
        _ => SampleType::F32,
    };
    assert_eq!(file.field.sample_type, expected, "{what}");
    let step_len = v.dims.iter().product::<u32>() as usize;
    for (step, written) in v.values.chunks(step_len).enumerate() {
        let (source, progress) = (&file.field.source, ReadProgress::default());
        let samples = source
            .read(step as u32, &progress)
            .unwrap_or_else(|e| panic!("{what}: {e}"));
        // The stream's first two bytes are read twice, to tell gzip from zlib.
        let read = progress.bytes();
        assert!(
            read > 0 && read <= source.stored_bytes() + 2,
            "{what}: {read} bytes read"
        );
        if step + 1 == v.steps as usize {
            assert!(
                read >= source.stored_bytes(),
                "{what}: {read} bytes read of the last step"
            );
        }
        assert_eq!(samples.sample_type(), expected, "{what}");
        let written: Vec<f32> = written.iter().map(|&v| v as f32).collect();
        assert_eq!(values(&samples), written, "{what}, step {step}");
    }
    assert_eq!(file.field.source.load(v.steps).unwrap_err().field, "step", "{what}");
}

fn same_placed(file: &OpenedFile, v: &Volume, what: &str) {
    same(file, v, what);
    assert_eq!(
        (file.geometry.spacing, file.geometry.origin),
        (v.spacing, v.origin),
        "{what}"
    );
    assert!(file.geometry.is_axis_aligned(), "{what}");
}

fn all() -> impl Iterator<Item = Volume> {
    KINDS.into_iter().flat_map(|kind| {
        [(false, 1), (true, 1), (true, 3)]
            .into_iter()
            .map(move |(big, steps)| Volume::new(DIMS, steps, kind, big))
    })
}

#[test]
fn nrrd_round_trips() {
    for v in all() {
        for encoding in ["raw", "gzip", "text"] {
            let what = format!("{encoding} {:?}", v.kind);
            same_placed(&open("a.nrrd", write::nrrd(&v, encoding)).unwrap(), &v, &what);
        }
        let header = write::nrrd_header(&v, "raw") + "data file: a.raw\n";
        let location = memory(vec![("a.nhdr", header.into()), ("a.raw", v.bytes())]);
        same_placed(&read_file(&location).unwrap(), &v, "detached");
    }
}

#[test]
fn nrrd_skips_lines_and_bytes() {
    let v = Volume::new(DIMS, 1, ('i', 2), true);
    let with = |lines: &str, data: Vec<u8>, encoding| {
        let header = write::nrrd_header(&v, encoding) + lines + "data file: a.dat\n";
        read_file(&memory(vec![("a.nhdr", header.into()), ("a.dat", data)]))
    };
    let before = |head: &[u8], tail: Vec<u8>| [head, &tail].concat();
    same(
        &with("byte skip: 3\n", before(b"abc", v.bytes()), "raw").unwrap(),
        &v,
        "byte skip",
    );
    same(
        &with("byteskip: -1\n", before(b"abcdef", v.bytes()), "raw").unwrap(),
        &v,
        "byte skip -1",
    );
    same(
        &with("line skip: 2\n", before(b"one\ntwo\n", v.bytes()), "raw").unwrap(),
        &v,
        "line skip",
    );
    let both = before(b"one\n", write::gzip(&before(b"abc", v.bytes())));
    same(
        &with("lineskip: 1\nbyte skip: 3\n", both, "gzip").unwrap(),
        &v,
        "line, then bytes of the decoded stream",
    );
    let error = with("line skip: 9\n", b"one\ntwo\n".to_vec(), "raw").unwrap_err();
    assert_eq!(error.field, "line skip");
    let error = with("byte skip: -1\n", write::gzip(&v.bytes()), "gzip").unwrap_err();
    assert_eq!(error.field, "byte skip");
}

#[test]
fn nrrd_time_may_run_fastest() {
    let v = Volume::new([2, 3, 2], 2, ('u', 1), false);
    let mut file = b"NRRD0004\ntype: uchar\ndimension: 4\nsizes: 2 2 3 2\nkinds: list domain domain domain\n\
        spacings: nan 1 2 3\nencoding: raw\n\n"
        .to_vec();
    (0..12).for_each(|i| file.extend([v.values[i] as u8, v.values[12 + i] as u8]));
    let read = open("a.nrrd", file).unwrap();
    same(&read, &v, "interleaved");
    assert_eq!(read.geometry.spacing, [1.0, 2.0, 3.0]);
}

#[test]
fn nrrd_axes_and_missing_value() {
    let v = Volume::new(DIMS, 1, ('i', 2), false);
    let mut header = write::nrrd_header(&v, "raw");
    let at = header.find("space directions").unwrap();
    let end = at + header[at..].find('\n').unwrap();
    header.replace_range(at..end, "space directions: (0, 2, 0) (-0.5,0,0) (0,3,4)");
    header += "_FillValue:=-32768\nsample units: \"HU\"\n\n";
    let read = open("a.nrrd", [header.into_bytes(), v.bytes()].concat()).unwrap();
    assert_eq!(read.geometry.spacing, [2.0, 0.5, 5.0]);
    assert_eq!(
        read.geometry.direction,
        [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.6, 0.8]]
    );
    assert_eq!(
        (read.field.missing, read.field.unit.as_deref()),
        (Some(-32768.0), Some("HU"))
    );
}

#[test]
fn metaimage_round_trips() {
    for v in all() {
        for compressed in [false, true] {
            let what = format!("compressed {compressed} {:?}", v.kind);
            same_placed(&open("a.mha", write::mha(&v, compressed)).unwrap(), &v, &what);
        }
        let header = write::meta_header(&v, false, "sub/a.raw");
        let location = memory(vec![("a.mhd", header.clone().into()), ("sub/a.raw", v.bytes())]);
        same_placed(&read_file(&location).unwrap(), &v, "detached");
        let header = format!("HeaderSize = -1\n{header}");
        let location = memory(vec![
            ("a.mhd", header.into()),
            ("sub/a.raw", [b"any head".to_vec(), v.bytes()].concat()),
        ]);
        same_placed(&read_file(&location).unwrap(), &v, "header size -1");
    }
}

#[test]
fn metaimage_rows_of_the_matrix_are_axes() {
    let v = Volume::new(DIMS, 1, ('u', 1), false);
    let file = [
        b"TransformMatrix = 0 1 0 -1 0 0 0 0 1\n".to_vec(),
        write::mha(&v, false),
    ]
    .concat();
    let read = open("a.mha", file).unwrap();
    assert_eq!(
        read.geometry.direction,
        [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    );
}

#[test]
fn nifti_round_trips() {
    for v in all() {
        let plain = write::nifti(&v, |_| {});
        let what = format!("{:?} big {}", v.kind, v.big);
        same_placed(&open("a.nii", plain.clone()).unwrap(), &v, &what);
        same_placed(&open("a.nii.gz", write::gzip(&plain)).unwrap(), &v, &what);
    }
}

#[test]
fn nifti_scale_makes_f32() {
    for kind in KINDS {
        let v = Volume::new(DIMS, 1, kind, true);
        let file = write::nifti(&v, |h| {
            h.f32(112, 0.5);
            h.f32(116, -10.0);
        });
        let samples = open("a.nii", file).unwrap().field.source.load(0).unwrap();
        let expected: Vec<f32> = v.values.iter().map(|&v| v as f32 * 0.5 - 10.0).collect();
        assert_eq!(samples, Samples::F32(expected), "{kind:?}");
    }
    // No scale: a slope of 0, and the identity.
    for (slope, inter) in [(0.0, 5.0), (1.0, 0.0), (f32::NAN, 1.0)] {
        let v = Volume::new(DIMS, 1, ('u', 1), false);
        let file = write::nifti(&v, |h| {
            h.f32(112, slope);
            h.f32(116, inter);
        });
        same(&open("a.nii", file).unwrap(), &v, "no scale");
    }
}

#[test]
fn nifti_affines() {
    let v = Volume::new(DIMS, 1, ('u', 1), false);
    let with = |edit: &dyn Fn(&mut write::Nifti)| open("a.nii", write::nifti(&v, |h| edit(h))).unwrap().geometry;
    // sform that mirrors x: stays mirrored.
    let g = with(&|h| h.f32(280, -0.5));
    assert_eq!((g.spacing, g.direction[0]), ([0.5, 1.25, 2.0], [-1.0, 0.0, 0.0]));
    // qform: a quarter turn about z, with and without the mirrored third axis.
    let half = std::f32::consts::FRAC_1_SQRT_2;
    for (handed, z) in [(1.0, 1.0), (-1.0, -1.0)] {
        let g = with(&|h| {
            h.i16(252, 1);
            h.i16(254, 0);
            h.f32(76, handed);
            h.f32(264, half);
            h.f32(268, 7.0);
        });
        assert_eq!((g.spacing, g.origin), ([0.5, 1.25, 2.0], [7.0, 0.0, 0.0]));
        let expected = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, z]];
        for (axis, expected) in g.direction.iter().flatten().zip(expected.iter().flatten()) {
            assert!((axis - expected).abs() < 1e-6, "{:?}", g.direction);
        }
    }
    // Neither: pixdim alone.
    let g = with(&|h| h.i16(254, 0));
    assert_eq!((g.spacing, g.origin, g.is_axis_aligned()), (v.spacing, [0.0; 3], true));
}

#[test]
fn npy_round_trips() {
    for v in all() {
        for fortran in [false, true] {
            let what = format!("fortran {fortran} {:?}", v.kind);
            same(&open("a.npy", write::npy(&v, fortran)).unwrap(), &v, &what);
        }
    }
}

#[test]
fn raw_round_trips() {
    for v in all() {
        let location = memory(vec![
            ("a.json", write::sidecar(&v, "a.raw", "raw")),
            ("a.raw", v.bytes()),
        ]);
        same_placed(&read_file(&location).unwrap(), &v, "raw");
        for packed in [write::gzip(&v.bytes()), write::zlib(&v.bytes())] {
            let location = memory(vec![("a.json", write::sidecar(&v, "a.z", "gzip")), ("a.z", packed)]);
            same_placed(&read_file(&location).unwrap(), &v, "packed");
        }
    }
    let v = Volume::new(DIMS, 1, ('f', 8), false);
    let mut json: serde_json::Value = serde_json::from_slice(&write::sidecar(&v, "a.raw", "raw")).unwrap();
    json["missing"] = (-32768.0).into();
    json["offset"] = 4.into();
    let location = memory(vec![
        ("a.json", json.to_string().into()),
        ("a.raw", [vec![0; 4], v.bytes()].concat()),
    ]);
    let read = read_file(&location).unwrap();
    same(&read, &v, "offset");
    assert_eq!(read.field.missing, Some(-32768.0));
    json["colour"] = "red".into();
    let error = open("a.json", json.to_string().into()).unwrap_err();
    assert!(error.to_string().contains("colour"), "{error}");
}

/// Longer than one task of the parallel read and than one decoded piece, and no multiple of either.
#[test]
fn large_files_come_in_pieces() {
    let folder = tempfile::tempdir().unwrap();
    for (kind, big) in [(('u', 2), true), (('f', 8), true), (('f', 4), false)] {
        let v = Volume::new([131, 127, 67], 1, kind, big);
        for (name, bytes) in [
            ("a.nrrd", write::nrrd(&v, "raw")),
            ("b.nrrd", write::nrrd(&v, "gzip")),
            ("c.npy", write::npy(&v, true)),
        ] {
            let path = folder.path().join(name);
            std::fs::write(&path, bytes).unwrap();
            same(&read_file(&FileLocation::disk(path)).unwrap(), &v, name);
        }
    }
}

#[test]
fn what_is_no_volume_is_refused() {
    let v = Volume::new(DIMS, 1, ('u', 1), false);
    let nrrd = |from: &str, to: &str| {
        let header = write::nrrd_header(&v, "raw").replace(from, to) + "\n";
        open("a.nrrd", [header.into_bytes(), v.bytes()].concat())
    };
    let meta = |from: &str, to: &str| {
        let header = write::meta_header(&v, false, "LOCAL").replace(from, to);
        open("a.mha", [header.into_bytes(), v.bytes()].concat())
    };
    let nifti = |edit: &dyn Fn(&mut write::Nifti)| open("a.nii", write::nifti(&v, |h| edit(h)));
    let npy = |from: &str, to: &str| {
        let file = write::npy(&v, false);
        let text = String::from_utf8_lossy(&file[10..128]).replace(from, to);
        let head = [
            b"\x93NUMPY\x01\x00".to_vec(),
            (text.len() as u16).to_le_bytes().to_vec(),
        ]
        .concat();
        open("a.npy", [head, text.into_bytes(), v.bytes()].concat())
    };
    let cases: Vec<(&str, &str, Result<OpenedFile, ReadError>)> = vec![
        ("magic", "NRRD0001", nrrd("NRRD0005", "NRRD0009")),
        ("type", "block", nrrd("uint8", "block")),
        ("dimension", "2, expected 3", open("a.nrrd", b"NRRD0004\ntype: uchar\ndimension: 2\nsizes: 2 2\nencoding: raw\n\nabcd".to_vec())),
        ("sizes", "at least 2", nrrd("sizes: 4 3 5", "sizes: 1 12 5")),
        ("sizes", "expected 1 to", nrrd("sizes: 4 3 5", "sizes: 0 12 5")),
        ("sizes", "pass 64 bits", nrrd("sizes: 4 3 5", "sizes: 4000000000 4000000000 4000000000")),
        ("sizes", "expected a number", nrrd("sizes: 4 3 5", "sizes: 4 three 5")),
        ("sizes", "4 numbers, expected 3", nrrd("sizes: 4 3 5", "sizes: 4 3 5 1")),
        ("spacings", "above 0", nrrd("(0.5,0,0)", "(0,0,0)")),
        ("spacings", "above 0", nrrd("(0.5,0,0)", "(nan,0,0)")),
        ("space directions", "span space", nrrd("(0,1.25,0)", "(1,0,0)")),
        ("space origin", "finite", nrrd("(-3,", "(inf,")),
        ("kinds", "3 components", open("a.nrrd", b"NRRD0004\ntype: uchar\ndimension: 4\nsizes: 3 2 2 2\nkinds: RGB-color domain domain domain\nencoding: raw\n\n".to_vec())),
        ("kinds", "may be time", open("a.nrrd", b"NRRD0004\ntype: uchar\ndimension: 4\nsizes: 3 2 2 2\nencoding: raw\n\n".to_vec())),
        ("encoding", "bzip2", nrrd("encoding: raw", "encoding: bzip2")),
        ("endian", "missing", open("a.nrrd", b"NRRD0004\ntype: short\ndimension: 3\nsizes: 2 2 2\nencoding: raw\n\n0123456789abcdef".to_vec())),
        ("data file", "`..`", nrrd("encoding: raw\n", "encoding: raw\ndata file: ../a.raw\n")),
        ("data file", "not found", nrrd("encoding: raw\n", "encoding: raw\ndata file: b.raw\n")),
        ("encoding", "twice", nrrd("encoding: raw\n", "encoding: raw\nencoding: gzip\n")),
        ("NDims", "2, expected 3", meta("NDims = 3", "NDims = 2")),
        ("DimSize", "at least 2", meta("DimSize = 4 3 5", "DimSize = 60 1 1")),
        ("DimSize", "invalid digit", meta("DimSize = 4 3 5", "DimSize = -4 3 5")),
        ("ElementSpacing", "above 0", meta("ElementSpacing = 0.5", "ElementSpacing = -0.5")),
        ("ElementType", "MET_STRING", meta("MET_UCHAR", "MET_STRING")),
        ("ElementNumberOfChannels", "3 components", meta("NDims", "ElementNumberOfChannels = 3\nNDims")),
        ("ElementDataFile", "absolute", meta("LOCAL", "/dev/zero")),
        ("CompressedDataSize", "9 bytes", meta("CompressedData = False", "CompressedDataSize = 9\nCompressedData = True")),
        ("dim", "expected 3", nifti(&|h| h.i16(40, 2))),
        ("dim", "2 dimensions", nifti(&|h| h.i16(46, 1))),
        ("dim", "-4", nifti(&|h| h.i16(42, -4))),
        ("dim", "components", nifti(&|h| { h.i16(40, 5); h.i16(50, 3); })),
        ("datatype", "Rgb24", nifti(&|h| h.i16(70, 128))),
        ("datatype", "code 77", nifti(&|h| h.i16(70, 77))),
        ("bitpix", "16, expected 8", nifti(&|h| h.i16(72, 16))),
        ("vox_offset", "NaN", nifti(&|h| h.f32(108, f32::NAN))),
        ("vox_offset", "expected a whole number", nifti(&|h| h.f32(108, 0.0))),
        ("scl_slope", "inf", nifti(&|h| h.f32(112, f32::INFINITY))),
        ("srow_x, srow_y, srow_z", "above 0", nifti(&|h| h.f32(280, 0.0))),
        ("magic", ".img", nifti(&|h| h.bytes[344..348].copy_from_slice(b"ni1\0"))),
        ("sizeof_hdr", "NIfTI-2", nifti(&|h| h.i32(0, 540))),
        ("shape", "2 axes, expected 3", npy("(5, 3, 4)", "(15, 4)")),
        ("descr", "<c8", npy("|u1", "<c8")),
        ("descr", "[...]", npy("'|u1'", "[('a', '|u1')]")),
        ("header", "expected", npy("{'descr'", "{__import__('os')")),
        ("file", "unknown format", open("a.vti", v.bytes())),
        ("file", "sidecar", open("a.raw", v.bytes())),
    ];
    for (field, words, result) in cases {
        let error = result.err().unwrap_or_else(|| panic!("{field} {words:?}: was read"));
        let text = error.to_string();
        assert!(
            error.field == field && text.contains(words),
            "expected {field:?} and {words:?} in: {text}"
        );
        assert!(text.starts_with("a."), "names the file: {text}");
    }
}

#[test]
#[ignore = "its volume is not in the repository: make test-volumes"]
fn ct_head() {
    let folder = std::env::var_os("ISOPEEL_DATA").expect("ISOPEEL_DATA names a folder that holds ct-head.nrrd");
    let path = std::path::Path::new(&folder).join("ct-head.nrrd");
    let dataset = open_dataset(&path).unwrap();
    assert_eq!(
        (dataset.geometry.dims, dataset.geometry.spacing),
        ([256, 256, 108], [0.957031, 0.957031, 1.5])
    );
    assert_eq!(dataset.fields[0].sample_type, SampleType::I16);
    let samples = dataset.fields[0].source.load(0).unwrap();
    assert_eq!(samples.sample_type(), SampleType::I16);
    assert_eq!(samples.len(), 256 * 256 * 108);
    // The algorithm's check values, in Hounsfield units.
    assert_eq!(
        crate::catalog::active_cells(&samples, dataset.geometry.dims, 517.0),
        299_681
    );
    assert_eq!(
        crate::catalog::active_cells(&samples, dataset.geometry.dims, -300.0),
        229_079
    );
}
