//! Truncated, changed and false files: they give an error or a volume, never a panic, and take no memory for data that only the header
//! claims.

use std::collections::BTreeMap;
use std::sync::Arc;

use isopeel_volumes::location::MemoryFolder;
use isopeel_volumes::{FileLocation, ReadError, Samples, read_file};
use proptest::prelude::*;

use crate::bounds::{load_within, within};
use crate::changed;
use crate::write::{self, Volume};
use crate::write_mrc::mrc;
use crate::write_vtk;

#[derive(Clone, Debug)]
struct Case {
    name: &'static str,
    /// The header's file first; its name says the format.
    files: Vec<(&'static str, Vec<u8>)>,
    /// Bytes at the end that the format may lack, or has after the samples; beside them a line end.
    needless: Option<usize>,
}

/// One small valid file of every kind.
fn cases() -> Vec<Case> {
    let v = Volume::new([4, 3, 5], 1, ('i', 2), true);
    let w = Volume::new([3, 4, 2], 3, ('f', 8), false);
    let case = |name, files: Vec<(&'static str, Vec<u8>)>| Case {
        name,
        files,
        needless: None,
    };
    let markup = |name, file, bytes, needless: usize| Case {
        needless: Some(needless),
        ..case(name, vec![(file, bytes)])
    };
    let u = Volume::new([4, 3, 5], 1, ('f', 4), true);
    let nifti_pair = write::nifti(&v, |h| {
        h.f32(108, 0.0);
        h.bytes[344..348].copy_from_slice(b"ni1\0");
    });
    // From the last number, or its last letter, to the end.
    let in_element = "</DataArray>\n</PointData></Piece></ImageData></VTKFile>\n".len();
    vec![
        case("nrrd raw", vec![("a.nrrd", write::nrrd(&v, "raw"))]),
        case("nrrd gzip", vec![("a.nrrd", write::nrrd(&w, "gzip"))]),
        case("nrrd bzip2", vec![("a.nrrd", write::nrrd(&v, "bzip2"))]),
        case("nrrd hex", vec![("a.nrrd", write::nrrd(&v, "hex"))]),
        case("nrrd text", vec![("a.nrrd", write::nrrd(&v, "text"))]),
        case(
            "nhdr",
            vec![
                ("a.nhdr", (write::nrrd_header(&v, "raw") + "data file: a.raw\n").into()),
                ("a.raw", v.bytes()),
            ],
        ),
        case("mha", vec![("a.mha", write::mha(&v, false))]),
        case("mha zlib", vec![("a.mha", write::mha(&w, true))]),
        case(
            "mhd",
            vec![
                ("a.mhd", write::meta_header(&v, false, "a.raw").into()),
                ("a.raw", v.bytes()),
            ],
        ),
        case("nii", vec![("a.nii", write::nifti(&v, |h| h.f32(112, 2.0)))]),
        case("nii.gz", vec![("a.nii.gz", write::gzip(&write::nifti(&w, |_| {})))]),
        case("nii 2", vec![("a.nii", write::nifti2(&v))]),
        case(
            "hdr",
            vec![
                ("a.hdr", nifti_pair[..348].to_vec()),
                ("a.img", nifti_pair[352..].to_vec()),
            ],
        ),
        case("analyze", vec![("a.hdr", write::analyze(&v)), ("a.img", v.bytes())]),
        case(
            "segmentation",
            vec![("a.seg.nrrd", {
                let header =
                    write::nrrd_header(&v, "raw") + "Segment0_ID:=a\nSegment0_Name:=b\nSegment0_Color:=1 0 0\n\n";
                [header.into_bytes(), v.bytes()].concat()
            })],
        ),
        // Tags may follow.
        markup("mgh", "a.mgh", write::mgh(&v), 0),
        markup("mgz", "a.mgz", write::gzip(&write::mgh(&v)), "checksum".len()),
        case("mrc", vec![("a.mrc", mrc(&v, |_| {}))]),
        case(
            "ccp4.gz",
            vec![(
                "a.ccp4.gz",
                write::gzip(&mrc(&u, |h| {
                    h.i32(18, 3);
                    h.i32(19, 2);
                })),
            )],
        ),
        case("nii.zst", vec![("a.nii.zst", write::zstd(&write::nifti2(&w)))]),
        case("nrrd.bz2", vec![("a.nrrd.bz2", write::bzip2(&write::nrrd(&v, "raw")))]),
        case(
            "nrrd.gz text",
            vec![("a.nrrd.gz", write::gzip(&write::nrrd(&v, "text")))],
        ),
        case("mha.gz zlib", vec![("a.mha.gz", write::gzip(&write::mha(&v, true)))]),
        case("npy", vec![("a.npy", write::npy(&w, false))]),
        case(
            "npy.zst fortran",
            vec![("a.npy.zst", write::zstd(&write::npy(&w, true)))],
        ),
        case("npy fortran", vec![("a.npy", write::npy(&w, true))]),
        case(
            "raw",
            vec![("a.json", write::sidecar(&v, "a.raw", "raw")), ("a.raw", v.bytes())],
        ),
        case(
            "raw gzip",
            vec![
                ("a.json", write::sidecar(&w, "a.z", "gzip")),
                ("a.z", write::gzip(&w.bytes())),
            ],
        ),
        markup("npz", "a.npz", write::npz(&v, false), 0),
        markup("npz deflated", "a.npz", write::npz(&w, true), 0),
        markup("vti raw", "a.vti", write_vtk::vti(&v, "raw"), write_vtk::VTI_END.len()),
        markup(
            "vti zlib",
            "a.vti",
            write_vtk::vti(&u, "zlib"),
            write_vtk::VTI_END.len(),
        ),
        markup("vti base64", "a.vti", write_vtk::vti(&v, "base64"), in_element),
        markup("vti text", "a.vti", write_vtk::vti(&v, "text"), in_element),
        Case {
            // Of its images.
            needless: Some(write_vtk::VTI_END.len()),
            ..case("pvd", write_vtk::pvd_files(&v))
        },
        Case {
            // Of its piece.
            needless: Some(write_vtk::VTI_END.len()),
            ..case("pvti", write_vtk::pvti_files(&v))
        },
        Case {
            needless: Some(in_element + "Rectilinear".len() - "Image".len()),
            ..case("pvtr", write_vtk::pvtr_files(&v))
        },
        markup(
            "vtr text",
            "a.vtr",
            write_vtk::vtr(&u),
            in_element + "Rectilinear".len() - "Image".len(),
        ),
        markup("vtk", "a.vtk", write_vtk::vtk(&v, false), 0),
        markup("vtk text", "a.vtk", write_vtk::vtk(&v, true), 0),
    ]
}

#[derive(Debug, PartialEq)]
pub struct Read {
    dims: [u32; 3],
    steps: Vec<Samples>,
}

impl Read {
    /// Whether all samples but the last one of each step are those of another.
    fn is_but_for_the_last(&self, other: &Self) -> bool {
        let same = |(a, b): (&Samples, &Samples)| a.len() == b.len() && (0..b.len() - 1).all(|i| a.get(i) == b.get(i));
        self.dims == other.dims && self.steps.iter().zip(&other.steps).all(same)
    }
}

/// Reads everything, within a second and with at most `limit` bytes of memory beyond the fixed buffers.
pub fn read(files: &[(&'static str, Vec<u8>)], limit: usize) -> Result<Read, ReadError> {
    let folder: MemoryFolder = files.iter().map(|(n, b)| ((*n).to_owned(), b.clone().into())).collect();
    let location = FileLocation::memory(Arc::new(folder), files[0].0);
    within(limit, || {
        let file = read_file(&location)?;
        // A few steps are enough.
        let file = &file;
        let load = |step| file.fields.iter().map(move |field| load_within(file, field, step));
        let steps = (0..file.steps.min(4)).flat_map(load).collect::<Result<Vec<_>, _>>()?;
        for samples in &steps {
            assert_eq!(samples.len() as u64, file.geometry.sample_count());
        }
        Ok(Read {
            dims: file.geometry.dims,
            steps,
        })
    })
}

/// Plain samples may become 8 times their size at most (u8 with a scale, twice), and a few steps are held at once.
fn fair(files: &[(&str, Vec<u8>)]) -> usize {
    files.iter().map(|(_, b)| b.len()).sum::<usize>() * 64
}

#[test]
fn every_truncation_is_an_error_or_the_same_volume() {
    for case in cases() {
        let whole = read(&case.files, fair(&case.files)).unwrap_or_else(|e| panic!("{}: {e}", case.name));
        for cut_file in 0..case.files.len() {
            let length = case.files[cut_file].1.len();
            let mut refused = 0;
            for cut in 0..length {
                let mut files = case.files.clone();
                files[cut_file].1.truncate(cut);
                match read(&files, fair(&case.files)) {
                    Ok(short) => assert!(
                        is_text(&case) && short.is_but_for_the_last(&whole) || short == whole,
                        "{} cut at {cut} of {length}",
                        case.name
                    ),
                    Err(error) => {
                        refused += 1;
                        assert!(error.path.to_string_lossy().starts_with("a."), "{}: {error}", case.name);
                        assert!(!error.field.is_empty() && !error.why.is_empty());
                    }
                }
            }
            // These bytes may be missing: a line end behind the last number or the last field, and digits of the number that ends a text.
            let digits = if is_text(&case) { 6 } else { 0 };
            assert!(
                refused + 2 + digits + case.needless.unwrap_or(0) >= length,
                "{}: {refused} of {length} cuts were refused",
                case.name
            );
        }
    }
}

/// Whether the file ends with a number as text, which is still a number if digits are cut off.
fn is_text(case: &Case) -> bool {
    case.name.contains("text")
}

/// Reads all samples of a volume, and returns its notice.
fn notice(files: &[(&'static str, Vec<u8>)]) -> String {
    let folder: MemoryFolder = files.iter().map(|(n, b)| ((*n).to_owned(), b.clone().into())).collect();
    let file = read_file(&FileLocation::memory(Arc::new(folder), files[0].0)).unwrap();
    let mut notices = file.notices;
    for field in file.fields {
        for step in 0..file.steps {
            field.source.load(step).unwrap();
        }
        notices.extend(field.source.notices());
    }
    notices.text().unwrap_or_default()
}

#[test]
fn what_follows_the_samples_is_an_error_or_said() {
    for case in cases().into_iter().filter(|case| case.needless.is_none()) {
        let whole = read(&case.files, fair(&case.files)).unwrap();
        let mut files = case.files.clone();
        files.last_mut().unwrap().1.extend(b" 77 ");
        let error = match read(&files, fair(&files)) {
            Ok(read) => {
                assert_eq!(read, whole, "{}", case.name);
                let notice = notice(&files);
                let is_said =
                    notice.contains("behind the last sample") || notice.contains("goes on after its last sample");
                assert!(is_said, "{}: {notice:?}", case.name);
                continue;
            }
            Err(error) => error,
        };
        assert!(
            ["data", "file", "CompressedDataSize"].contains(&error.field.as_str()),
            "{}: {error}",
            case.name
        );
    }
}

/// Headers that claim terabytes in files of a few hundred bytes: refused at once, with file, field and expectation.
#[test]
fn claims_are_not_allocated() {
    let v = Volume::new([2, 2, 2], 1, ('u', 1), false);
    let swap = |bytes: Vec<u8>, from: &str, to: &str| {
        let at = bytes.windows(from.len()).position(|w| w == from.as_bytes()).unwrap();
        [&bytes[..at], to.as_bytes(), &bytes[at + from.len()..]].concat()
    };
    let nifti = write::nifti(&v, |h| (0..3).for_each(|i| h.i16(42 + 2 * i, 32767)));
    let map = mrc(&Volume::new([2, 2, 2], 1, ('i', 1), false), |h| {
        (1..4).for_each(|word| h.i32(word, 32767));
    });
    for (name, bytes) in [
        (
            "a.nrrd",
            swap(write::nrrd(&v, "raw"), "sizes: 2 2 2", "sizes: 65535 65535 65535"),
        ),
        (
            "a.nrrd",
            swap(write::nrrd(&v, "gzip"), "sizes: 2 2 2", "sizes: 65535 65535 65535"),
        ),
        (
            "a.nrrd",
            swap(write::nrrd(&v, "gzip"), "sizes: 2 2 2", "sizes: 100 100 10"),
        ),
        (
            "a.nrrd",
            swap(write::nrrd(&v, "text"), "sizes: 2 2 2", "sizes: 65535 65535 65535"),
        ),
        (
            "a.nrrd",
            swap(
                write::nrrd(&v, "raw"),
                "sizes: 2 2 2",
                "sizes: 4294967295 4294967295 4294967295",
            ),
        ),
        (
            "a.mha",
            swap(write::mha(&v, false), "DimSize = 2 2 2", "DimSize = 9999 9999 9999"),
        ),
        (
            "a.mha",
            swap(write::mha(&v, true), "DimSize = 2 2 2", "DimSize = 9999 9999 9999"),
        ),
        ("a.nii", nifti.clone()),
        ("a.mrc", map.clone()),
        ("a.map.gz", write::gzip(&map)),
        ("a.nii.gz", write::gzip(&nifti)),
        ("a.npz", swap(write::npz(&v, false), "(2, 2, 2)", "(9, 9, 9)")),
        ("a.nii.bz2", write::bzip2(&nifti)),
        ("a.nii.zst", write::zstd(&nifti)),
        (
            "a.npy",
            swap(write::npy(&v, false), "(2, 2, 2)", "(65535, 65535, 65535)"),
        ),
        (
            "a.npy",
            swap(write::npy(&v, true), "(2, 2, 2)", "(2, 99999, 9999, 9999)"),
        ),
    ] {
        let error = read(&[(name, bytes)], 1 << 16)
            .err()
            .unwrap_or_else(|| panic!("{name}: was read"));
        let text = error.to_string();
        assert!(
            text.starts_with("a.") && (text.contains("expected") || text.contains("pass 64 bits")),
            "{text}"
        );
    }
}

/// A header within the ratio of deflate: memory follows what was decoded.
#[test]
fn compressed_claims_grow_with_the_data() {
    let mut state = 1u64;
    let noise: Vec<u8> = std::iter::repeat_with(|| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 56) as u8
    })
    .take(400_000)
    .collect();
    let mut file = b"NRRD0004\ntype: uchar\ndimension: 3\nsizes: 600 600 600\nencoding: gzip\n\n".to_vec();
    file.extend(write::gzip(&noise));
    let error = read(&[("a.nrrd", file)], 1_600_000).unwrap_err();
    assert!(
        error.why.contains("ends too early, expected 600 x 600 x 600"),
        "{error}"
    );
}

/// A stream that is longer than the header says: reading stops at the last sample.
#[test]
fn a_bomb_is_not_unpacked() {
    let mut file = b"NRRD0004\ntype: uchar\ndimension: 3\nsizes: 10 10 10\nencoding: gzip\n\n".to_vec();
    file.extend(write::gzip(&vec![0; 64 << 20]));
    let error = read(&[("a.nrrd", file)], 1 << 16).unwrap_err();
    assert!(error.why.contains("goes on after the last sample"), "{error}");
}

/// All cases, by the endings of their names: one list a format.
fn by_format() -> BTreeMap<&'static str, Vec<Case>> {
    let mut lists = BTreeMap::<_, Vec<Case>>::new();
    for case in cases() {
        let name = case.files[0].0;
        let ending = [
            "nrrd", "nhdr", "mha", "mhd", "nii", "hdr", "mgh", "mgz", "mrc", "ccp4", "npy", "npz", "vti", "vtr",
            "pvti", "pvtr", "pvd", "vtk", "json",
        ]
        .into_iter()
        .find(|ending| name.split('.').any(|part| part == *ending))
        .unwrap_or_else(|| panic!("{name}"));
        let format = match ending {
            "nhdr" => "nrrd",
            "mhd" => "mha",
            "hdr" => "nii",
            "mgz" => "mgh",
            "ccp4" => "mrc",
            other => other,
        };
        lists.entry(format).or_default().push(case);
    }
    lists
}

/// Bytes that a changed header may claim: as much as deflate can hold, in the widest type.
fn reach(files: &[(&'static str, Vec<u8>)]) -> usize {
    files.iter().map(|(_, bytes)| bytes.len() * 1032 * 8).sum()
}

/// Changed bytes anywhere, in any number, then perhaps a cut.
#[test]
fn changed_bytes_never_panic() {
    for (format, cases) in by_format() {
        let strategy = (
            prop::sample::select(cases),
            changed::bytes(12),
            changed::cut(),
            any::<bool>(),
        );
        changed::each(format, 700, &strategy, |(case, changes, cut, in_header)| {
            let mut files = case.files;
            let at = if in_header { 0 } else { files.len() - 1 };
            changed::change_and_cut(&mut files[at].1, changes, cut);
            let _ = read(&files, reach(&files));
        });
    }
}

/// Digits replaced by digits: well-formed headers with false values.
#[test]
fn changed_numbers_never_panic() {
    let header = |case: &Case| case.files[0].1.len().min(400);
    for (format, mut cases) in by_format() {
        // Compressed and binary files may have no digits.
        cases.retain(|case| case.files[0].1[..header(case)].iter().any(u8::is_ascii_digit));
        if cases.is_empty() {
            continue;
        }
        let strategy = (prop::sample::select(cases), changed::digits());
        changed::each(format, 700, &strategy, |(case, changes)| {
            let header = header(&case);
            let mut files = case.files;
            changed::change_digits(&mut files[0].1[..header], changes);
            let _ = read(&files, reach(&files));
        });
    }
}

/// Random bytes under the name of every format.
#[test]
fn noise_never_panics() {
    let names = [
        "a.nrrd", "a.mha", "a.nii", "a.mrc", "a.npy", "a.json", "a.raw", "a.npz", "a.vti", "a.vtr", "a.pvti", "a.pvtr",
        "a.pvd", "a.vtk",
    ];
    for name in names {
        let noise = prop::collection::vec(any::<u8>(), 0..600);
        changed::each(name, 650, &noise, |bytes| {
            assert!(read(&[(name, bytes)], 1 << 20).is_err());
        });
    }
}
