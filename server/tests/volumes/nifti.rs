//! NIfTI: round trips, scales, affines.

use isopeel_volumes::{Frame, OpenedFile, Samples};

use crate::formats::{DIMS, all, open, same, same_placed};
use crate::write::{self, KINDS, Volume};

/// NIfTI's own frame, which is not the one that files are opened in.
fn ras(file: OpenedFile) -> OpenedFile {
    assert_eq!(file.geometry.frame, Frame::Lps);
    OpenedFile {
        geometry: file.geometry.in_frame(Frame::Ras),
        ..file
    }
}

#[test]
fn nifti_round_trips() {
    for v in all() {
        let plain = write::nifti(&v, |_| {});
        let what = format!("{:?} big {}", v.kind, v.big);
        same_placed(&ras(open("a.nii", plain.clone()).unwrap()), &v, &what);
        same_placed(&ras(open("a.nii.gz", write::gzip(&plain)).unwrap()), &v, &what);
        same_placed(
            &ras(open("a.nii", write::gzip(&plain)).unwrap()),
            &v,
            "gzip without its name",
        );
        let what = format!("NIfTI-2 {what}");
        same_placed(&ras(open("a.nii", write::nifti2(&v)).unwrap()), &v, &what);
    }
}

#[test]
fn half_a_turn_is_exact() {
    let v = Volume::new(DIMS, 1, ('u', 1), false);
    let half = 0.5f32.sqrt();
    let turned = write::nifti(&v, |h| {
        h.i16(252, 1);
        h.i16(254, 0);
        [half, half, 0.0]
            .iter()
            .enumerate()
            .for_each(|(i, q)| h.f32(256 + 4 * i, *q));
    });
    let axes = ras(open("a.nii", turned).unwrap()).geometry.direction;
    let expected = [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]];
    let differences = axes.iter().flatten().zip(expected.iter().flatten());
    assert!(
        differences
            .into_iter()
            .all(|(a, b): (&f64, &f64)| (a - b).abs() < 1e-12),
        "{axes:?}"
    );
}

/// Intent 1002 says that values are labels; nothing else in the header does.
#[test]
fn nifti_intent_declares_labels() {
    let v = Volume::new(DIMS, 1, ('u', 1), false);
    for (intent, is_label) in [(1002, true), (0, false), (1007, false)] {
        let file = open("a.nii", write::nifti(&v, |h| h.i16(68, intent))).unwrap();
        assert_eq!(file.fields[0].has_labels(), is_label, "intent {intent}");
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
        let samples = open("a.nii", file).unwrap().fields[0].source.load(0).unwrap();
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
    let opened = |edit: &dyn Fn(&mut write::Nifti)| open("a.nii", write::nifti(&v, |h| edit(h))).unwrap();
    let with = |edit: &dyn Fn(&mut write::Nifti)| ras(opened(edit)).geometry;
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
    // Neither: pixdim alone, with axes of unknown orientation.
    let g = opened(&|h| h.i16(254, 0)).geometry;
    assert_eq!(g.frame, Frame::World);
    assert_eq!((g.spacing, g.origin, g.is_axis_aligned()), (v.spacing, [0.0; 3], true));
}

#[test]
fn what_is_repaired_is_said() {
    let v = Volume::new(DIMS, 1, ('i', 2), false);
    let opened = |edit: &dyn Fn(&mut write::Nifti)| {
        let file = open("a.nii", write::nifti(&v, |h| edit(h))).unwrap();
        same(&file, &v, "repaired");
        (file.notices.text().unwrap_or_default(), file.geometry)
    };
    assert_eq!(opened(&|_| {}).0, "");
    // A zero `sform` beside a `qform`, and alone.
    let zero = |h: &mut write::Nifti| (0..12).for_each(|i| h.f32(280 + 4 * i, 0.0));
    let (notice, geometry) = opened(&|h| {
        zero(h);
        h.i16(252, 1);
        h.f32(268, 7.0);
    });
    assert!(notice.starts_with("sform describes no grid, qform"), "{notice}");
    assert_eq!((geometry.spacing, geometry.frame), (v.spacing, Frame::Lps));
    let (notice, geometry) = opened(&zero);
    assert!(notice.starts_with("sform describes no grid, pixdim"), "{notice}");
    assert_eq!((geometry.spacing, geometry.frame), (v.spacing, Frame::World));
    // Both, in one place and in two.
    let both = |x: f32| {
        move |h: &mut write::Nifti| {
            h.i16(252, 1);
            (0..3).for_each(|axis| h.f32(280 + 16 * axis + 12, 0.0));
            h.f32(268, x);
        }
    };
    assert_eq!(opened(&both(0.2)).0, "");
    let (notice, geometry) = opened(&both(7.0));
    assert_eq!(
        notice,
        "sform and qform put samples up to 7 apart, in the file's unit: sform is taken, check the orientation"
    );
    assert_eq!(geometry.origin, [0.0; 3]);
    // Distances below 0, and none.
    let (notice, geometry) = opened(&|h| {
        h.i16(254, 0);
        h.f32(80, -0.5);
        h.f32(84, 0.0);
    });
    assert_eq!(geometry.spacing, [0.5, 1.0, 2.0]);
    assert_eq!(
        notice,
        "pixdim[1] is -0.5: samples are taken to be 0.5 apart\npixdim[2] is 0: samples are taken to be 1 apart"
    );
    assert!(opened(&|h| h.i16(72, 0)).0.starts_with("bitpix is 0, expected 16"));
    assert!(opened(&|h| h.f32(108, 0.0)).0.starts_with("vox_offset is 0"));
}

#[test]
fn a_pair_is_named_by_either_file() {
    use std::sync::Arc;

    use isopeel_volumes::location::MemoryFolder;
    use isopeel_volumes::{FileLocation, read_file};

    let v = Volume::new(DIMS, 1, ('i', 2), true);
    for header in [write::analyze(&v), {
        let nifti = write::nifti(&v, |h| {
            h.f32(108, 0.0);
            h.bytes[344..348].copy_from_slice(b"ni1\0");
        });
        nifti[..348].to_vec()
    }] {
        let folder = MemoryFolder::from([("a.hdr".into(), header.into()), ("a.img".into(), v.bytes().into())]);
        let folder = Arc::new(folder);
        for name in ["a.hdr", "a.img"] {
            let file = read_file(&FileLocation::memory(Arc::clone(&folder), name)).unwrap();
            same(&file, &v, name);
            assert_eq!(file.geometry.spacing, v.spacing);
        }
    }
    let error = open("a.img", v.bytes()).unwrap_err();
    assert!(error.why.contains("no file \"a.hdr\" beside it"), "{error}");
}
