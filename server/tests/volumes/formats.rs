//! Round trips: every format, type and byte order. Tests common to all formats are here, those of single formats in `nrrd`, `nifti` and
//! `vtk`.

use std::path::Path;
use std::sync::Arc;

use isopeel_kernels::SampleType;
use isopeel_volumes::location::MemoryFolder;
use isopeel_volumes::{FileLocation, OpenedFile, ReadError, ReadProgress, Samples, open_dataset, read_file};

use crate::write::{self, KINDS, Volume};
use crate::write_vtk;

/// Samples along each axis of the volumes of `all`.
pub const DIMS: [u32; 3] = [4, 3, 5];

/// These files in memory, of which the first is opened.
pub fn memory(files: Vec<(&str, Vec<u8>)>) -> FileLocation {
    let first = files[0].0.to_owned();
    let folder: MemoryFolder = files.into_iter().map(|(n, b)| (n.to_owned(), b.into())).collect();
    FileLocation::memory(Arc::new(folder), first)
}

/// A file alone.
pub fn open(name: &str, bytes: Vec<u8>) -> Result<OpenedFile, ReadError> {
    read_file(&FileLocation::bytes(name, bytes))
}

/// All samples.
pub fn values(samples: &Samples) -> Vec<f32> {
    (0..samples.len()).map(|i| samples.get(i)).collect()
}

/// Compares everything that a reader returns with the written volume.
pub fn same(file: &OpenedFile, v: &Volume, what: &str) {
    assert_eq!((file.geometry.dims, file.steps), (v.dims, v.steps), "{what}");
    let expected = match v.kind {
        ('u', 1) => SampleType::U8,
        ('i', 1) => SampleType::I8,
        ('u', 2) => SampleType::U16,
        ('i', 2) => SampleType::I16,
        _ => SampleType::F32,
    };
    assert_eq!(file.fields[0].sample_type, expected, "{what}");
    let step_len = v.dims.iter().product::<u32>() as usize;
    for (step, written) in v.values.chunks(step_len).enumerate() {
        let (source, progress) = (&file.fields[0].source, ReadProgress::default());
        let samples = source
            .read(step as u32, &progress)
            .unwrap_or_else(|e| panic!("{what}: {e}"));
        let read = progress.bytes();
        assert!(read > 0 && read <= source.stored_bytes(), "{what}: {read} bytes read");
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
    assert_eq!(file.fields[0].source.load(v.steps).unwrap_err().field, "step", "{what}");
}

/// As `same`, with the place in the world.
pub fn same_placed(file: &OpenedFile, v: &Volume, what: &str) {
    same(file, v, what);
    assert_eq!(
        (file.geometry.spacing, file.geometry.origin),
        (v.spacing, v.origin),
        "{what}"
    );
    assert!(file.geometry.is_axis_aligned(), "{what}");
}

/// A volume of each type in both byte orders, also with steps.
pub fn all() -> impl Iterator<Item = Volume> {
    KINDS.into_iter().flat_map(|kind| {
        [(false, 1), (true, 1), (true, 3)]
            .into_iter()
            .map(move |(big, steps)| Volume::new(DIMS, steps, kind, big))
    })
}

#[test]
fn npz_round_trips() {
    for v in all() {
        for deflated in [false, true] {
            let what = format!("deflated {deflated} {:?}", v.kind);
            same(&open("b.npz", write::npz(&v, deflated)).unwrap(), &v, &what);
        }
    }
}

#[test]
fn npz_arrays_are_named_where_one_must_be_chosen() {
    let file = |name: &str| {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/volumes");
        open_dataset(&path.join(name)).unwrap_err().to_string()
    };
    let why = file("shapes.npz");
    assert!(why.contains("small [7, 5, 3] x 1, large [7, 5, 6] x 2"), "{why}");
    let why = file("shapes.npz:none");
    assert!(
        why.contains("no array \"none\" in it, expected one of [\"small\", \"large\"]"),
        "{why}"
    );
    let why = file("stored.npz:spacing");
    assert!(why.contains("spacing: shape: 1 axes"), "{why}");
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

/// `.npy` whose `descr` has another order character, or none.
fn npy_of_order(v: &Volume, order: &str) -> Vec<u8> {
    let file = write::npy(v, false);
    let begin = file.len() - v.bytes().len();
    let header = String::from_utf8_lossy(&file[10..begin]).replace(['<', '|'], order);
    let length = (header.len() as u16).to_le_bytes();
    [&file[..8], &length, header.as_bytes(), &v.bytes()].concat()
}

/// NumPy takes the order of the machine.
#[test]
fn npy_without_a_byte_order_is_little_endian() {
    for (kind, order) in KINDS.into_iter().flat_map(|kind| [(kind, ""), (kind, "=")]) {
        let (v, what) = (Volume::new(DIMS, 2, kind, false), format!("{order:?} {kind:?}"));
        let opened = open("a.npy", npy_of_order(&v, order)).unwrap_or_else(|e| panic!("{what}: {e}"));
        same(&opened, &v, &what);
        let is_noticed = opened
            .notices
            .lines()
            .any(|line| line.contains("does not state the byte order"));
        assert_eq!(is_noticed, kind.1 > 1, "{what}");
    }
}

/// Any format in any compression, the plain samples of which are decoded as a stream and all others from a temporary
/// file.
#[test]
fn compressed_files_are_read_as_the_files_in_them() {
    let v = Volume::new(DIMS, 3, ('i', 2), true);
    let w = Volume::new(DIMS, 1, ('f', 8), false);
    let files = [
        ("a.nrrd", write::nrrd(&v, "raw"), &v),
        ("a.nrrd", write::nrrd(&v, "gzip"), &v),
        ("a.nrrd", write::nrrd(&w, "text"), &w),
        ("a.mha", write::mha(&v, true), &v),
        ("a.npy", write::npy(&v, false), &v),
        ("a.npy", write::npy(&v, true), &v),
        ("a.vti", write_vtk::vti(&w, "raw"), &w),
        ("a.vti", write_vtk::vti(&w, "zlib"), &w),
        ("a.vti", write_vtk::vti(&w, "text"), &w),
        ("a.vtk", write_vtk::vtk(&w, true), &w),
    ];
    for (name, bytes, volume) in files {
        for (ending, packed) in [
            ("gz", write::gzip(&bytes)),
            ("bz2", write::bzip2(&bytes)),
            ("ZST", write::zstd(&bytes)),
        ] {
            let name = format!("{name}.{ending}");
            let file = open(&name, packed).unwrap_or_else(|e| panic!("{e}"));
            assert_eq!(file.fields[0].name, "a", "{name}");
            same(&file, volume, &name);
        }
    }
}

/// A broken stream is no error before it is read that far.
#[test]
fn headers_of_compressed_files_are_read_without_the_samples() {
    let v = Volume {
        values: (0..3_000_000i64)
            .map(|i| i.wrapping_mul(-7_046_029_254_386_353_131) >> 56)
            .collect(),
        ..Volume::new([300, 100, 100], 1, ('i', 1), false)
    };
    for (name, bytes) in [
        ("a.nrrd.gz", write::nrrd(&v, "raw")),
        ("a.mha.gz", write::mha(&v, false)),
        ("a.nii.gz", write::nifti(&v, |_| {})),
        ("a.npy.gz", write::npy(&v, false)),
        ("a.vti.gz", write_vtk::vti(&v, "raw")),
    ] {
        let mut packed = write::gzip(&bytes);
        packed.truncate(packed.len() * 2 / 3);
        let file = open(name, packed).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(file.geometry.dims, v.dims, "{name}");
        let error = file.fields[0].source.load(0).unwrap_err();
        assert!(error.why.contains("ends too early"), "{error}");
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
    assert_eq!(read.fields[0].missing, Some(-32768.0));
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
        ("kinds", "3 components", open("a.nrrd", b"NRRD0004\ntype: uchar\ndimension: 5\nsizes: 3 3 2 2 2\nkinds: vector RGB-color domain domain domain\nencoding: raw\n\n".to_vec())),
        ("kinds", "may be time", open("a.nrrd", b"NRRD0004\ntype: uchar\ndimension: 4\nsizes: 3 2 2 2\nencoding: raw\n\n".to_vec())),
        ("encoding", "lz4", nrrd("encoding: raw", "encoding: lz4")),
        ("endian", "missing", open("a.nrrd", b"NRRD0004\ntype: short\ndimension: 3\nsizes: 2 2 2\nencoding: raw\n\n0123456789abcdef".to_vec())),
        ("data file", "`..`", nrrd("encoding: raw\n", "encoding: raw\ndata file: ../a.raw\n")),
        ("data file", "not found", nrrd("encoding: raw\n", "encoding: raw\ndata file: b.raw\n")),
        ("encoding", "twice", nrrd("encoding: raw\n", "encoding: raw\nencoding: gzip\n")),
        ("NDims", "2, expected 3", meta("NDims = 3", "NDims = 2")),
        ("DimSize", "at least 2", meta("DimSize = 4 3 5", "DimSize = 60 1 1")),
        ("DimSize", "invalid digit", meta("DimSize = 4 3 5", "DimSize = -4 3 5")),
        ("ElementSpacing", "above 0", meta("ElementSpacing = 0.5", "ElementSpacing = 1e-60")),
        ("ElementType", "MET_STRING", meta("MET_UCHAR", "MET_STRING")),
        ("ElementNumberOfChannels", "expected 1 to", meta("NDims", "ElementNumberOfChannels = 0\nNDims")),
        ("data", "x 3 channels", meta("NDims", "ElementNumberOfChannels = 3\nNDims")),
        ("ElementDataFile", "absolute", meta("LOCAL", "/dev/zero")),
        ("CompressedDataSize", "9 bytes", meta("CompressedData = False", "CompressedDataSize = 9\nCompressedData = True")),
        ("dim", "expected 3", nifti(&|h| h.i16(40, 2))),
        ("dim", "2 dimensions", nifti(&|h| h.i16(46, 1))),
        ("dim", "-4", nifti(&|h| h.i16(42, -4))),
        ("dim", "sixth axis", nifti(&|h| { h.i16(40, 6); h.i16(52, 3); })),
        ("datatype", "32 (complex)", nifti(&|h| h.i16(70, 32))),
        ("datatype", "code 77", nifti(&|h| h.i16(70, 77))),
        ("vox_offset", "NaN", nifti(&|h| h.f32(108, f32::NAN))),
        ("vox_offset", "expected a whole number", nifti(&|h| h.f32(108, 8.0))),
        ("scl_slope", "inf", nifti(&|h| h.f32(112, f32::INFINITY))),
        ("srow_x, srow_y, srow_z", "above 0", nifti(&|h| h.f32(280, 0.0))),
        ("magic", "no file \"a.img\" beside it", nifti(&|h| h.bytes[344..348].copy_from_slice(b"ni1\0"))),
        ("magic", "no file \"a.img\" beside it", nifti(&|h| h.bytes[344..348].fill(0))),
        ("sizeof_hdr", "expected 348 (NIfTI-1) or 540 (NIfTI-2)", nifti(&|h| h.i32(0, 541))),
        ("shape", "2 axes, expected 3", npy("(5, 3, 4)", "(15, 4)")),
        ("descr", "<c8", npy("|u1", "<c8")),
        ("descr", "[...]", npy("'|u1'", "[('a', '|u1')]")),
        ("header", "expected", npy("{'descr'", "{__import__('os')")),
        ("file", "unknown format", open("a.xyz", v.bytes())),
        ("file", "sidecar", open("a.raw", v.bytes())),
        ("XML", "UTF-8", open("a.vti", v.bytes())),
        ("VTKFile", "no such element", open("a.vti", b"<svg></svg>".to_vec())),
        ("file", "a web page", open("a.vti", b"<html></html>".to_vec())),
        ("magic", "# vtk DataFile", open("a.vtk", v.bytes())),
    ];
    for (field, words, result) in cases {
        assert_refused(result, field, words, "a.");
    }
}

/// Asserts that a file whose name begins with `name` is refused, with an error of this field that contains these words.
pub fn assert_refused(result: Result<OpenedFile, ReadError>, field: &str, words: &str, name: &str) {
    let error = result.err().unwrap_or_else(|| panic!("{field} {words:?}: was read"));
    let text = error.to_string();
    assert!(
        error.field == field && text.contains(words),
        "expected {field:?} and {words:?} in: {text}"
    );
    assert!(text.starts_with(name), "names the file: {text}");
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
