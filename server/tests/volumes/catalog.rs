//! Folders, ids and the embedded demo.

use std::path::Path;

use isopeel_volumes::statistics::FieldStatistics;
use isopeel_volumes::{Catalog, Dataset, Samples, demo, open_dataset};

use crate::write::{self, Volume};

fn put(folder: &Path, name: &str, bytes: Vec<u8>) {
    std::fs::write(folder.join(name), bytes).unwrap();
}

fn names(dataset: &Dataset) -> Vec<&str> {
    dataset.fields.iter().map(|f| f.name.as_str()).collect()
}

fn small(kind: write::Kind) -> Volume {
    Volume::new([4, 3, 5], 1, kind, false)
}

#[test]
fn a_folder_with_one_grid_is_one_dataset() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let at_zero = |kind| Volume {
        origin: [0.0; 3],
        ..small(kind)
    };
    // Without `sform` and `qform` and without a unit, as the other files.
    let world = |h: &mut write::Nifti| {
        h.i16(254, 0);
        h.bytes[123] = 0;
    };
    put(at, "T1.nii.gz", write::gzip(&write::nifti(&at_zero(('u', 1)), world)));
    put(at, "pressure.nrrd", write::nrrd(&at_zero(('f', 4)), "gzip"));
    put(at, "heat.json", write::sidecar(&at_zero(('i', 2)), "heat.raw", "raw"));
    put(at, "heat.raw", small(('i', 2)).bytes());
    put(
        at,
        "T1.json",
        br#"{"EchoTime": 0.03, "note": "no sidecar of ours"}"#.to_vec(),
    );
    put(at, ".hidden.nrrd", b"nothing".to_vec());
    put(at, "README.txt", b"nothing".to_vec());
    let dataset = open_dataset(at).unwrap();
    assert_eq!(names(&dataset), ["T1", "heat", "pressure"]);
    assert_eq!(dataset.geometry.spacing, [0.5, 1.25, 2.0]);
    for field in &dataset.fields {
        assert_eq!(field.source.load(0).unwrap().len(), 60, "{}", field.name);
    }
    let catalog = Catalog::open(&[at.to_owned()], false).unwrap();
    assert_eq!(catalog.datasets().len(), 1);
    assert_eq!(names(&catalog.datasets()[0]), ["T1", "heat", "pressure"]);
}

#[test]
fn labels_of_a_folder_are_not_its_first_field() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    put(at, "aparc.nii", write::nifti(&small(('i', 2)), |h| h.i16(68, 1002)));
    put(at, "brain-mask.nii", write::nifti(&small(('u', 1)), |_| {}));
    put(at, "mask-weight.nii", write::nifti(&small(('f', 4)), |_| {}));
    put(at, "t1.nii", write::nifti(&small(('u', 1)), |_| {}));
    let dataset = open_dataset(at).unwrap();
    // Labels are recognized by what the header says, or by name if the values are whole numbers.
    assert_eq!(names(&dataset), ["mask-weight", "t1", "aparc", "brain-mask"]);
}

/// A volume all of whose samples are `value`.
fn level(value: u8) -> Vec<u8> {
    let mut volume = small(('u', 1));
    volume.values.fill(i64::from(value));
    write::nrrd(&volume, "raw")
}

#[test]
fn numbered_files_are_time_steps() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    // By number, not by name.
    for step in [8, 9, 10, 100] {
        put(at, &format!("heat_{step}.nrrd"), level(step));
        put(at, &format!("salt_{step}.nrrd"), level(step + 100));
    }
    let dataset = open_dataset(at).unwrap();
    assert_eq!((names(&dataset), dataset.steps), (vec!["heat", "salt"], 4));
    assert_eq!(dataset.layout, "numbered steps");
    for (field, plus) in dataset.fields.iter().zip([0.0, 100.0]) {
        for (step, value) in [8.0, 9.0, 10.0, 100.0].into_iter().enumerate() {
            assert_eq!(
                field.source.load(step as u32).unwrap().get(7),
                value + plus,
                "{} {step}",
                field.name
            );
        }
        assert!(field.source.load(4).is_err());
    }
    std::fs::remove_file(at.join("salt_9.nrrd")).unwrap();
    let error = open_dataset(at).unwrap_err().to_string();
    assert!(
        error.contains("heat_9.nrrd") && error.contains("no file 9 of \"salt\""),
        "{error}"
    );
}

#[test]
fn steps_that_differ_name_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    put(at, "p01.nrrd", level(1));
    for (volume, part) in [
        (Volume::new([4, 3, 6], 1, ('u', 1), false), "[4, 3, 6]"),
        (small(('f', 4)), "p02 (f32), expected those of the first step: p01 (u8)"),
        (Volume::new([4, 3, 5], 2, ('u', 1), false), "2, expected one in each"),
    ] {
        put(at, "p02.nrrd", write::nrrd(&volume, "raw"));
        let error = open_dataset(at).unwrap_err().to_string();
        assert!(error.contains("p02.nrrd") && error.contains(part), "{error}");
    }
}

#[test]
fn two_images_with_a_digit_are_fields() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["t1.nrrd", "t2.nrrd"] {
        put(folder.path(), name, level(1));
    }
    let dataset = open_dataset(folder.path()).unwrap();
    assert_eq!(
        (names(&dataset), dataset.steps, dataset.layout),
        (vec!["t1", "t2"], 1, "fields")
    );
}

#[test]
fn a_folder_with_two_grids_names_the_files() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    put(at, "a.nrrd", write::nrrd(&small(('u', 1)), "raw"));
    put(
        at,
        "b.nrrd",
        write::nrrd(&Volume::new([4, 3, 6], 1, ('u', 1), false), "raw"),
    );
    let error = open_dataset(at).unwrap_err().to_string();
    for part in ["a.nrrd", "b.nrrd", "dimensions", "[4, 3, 6]", "[4, 3, 5]"] {
        assert!(error.contains(part), "{part:?} in {error}");
    }
    let mut moved = small(('u', 1));
    moved.origin[2] += 0.01;
    put(at, "b.nrrd", write::nrrd(&moved, "raw"));
    let error = open_dataset(at).unwrap_err().to_string();
    assert!(error.contains("geometry") && error.contains("10.01"), "{error}");
    put(
        at,
        "b.nrrd",
        write::nrrd(&Volume::new([4, 3, 5], 2, ('u', 1), false), "raw"),
    );
    assert!(open_dataset(at).unwrap_err().to_string().contains("time steps"));
    // In a catalog each file is a dataset of its own; a broken one is skipped.
    put(at, "broken.nrrd", b"NRRD0004\n".to_vec());
    let catalog = Catalog::open(&[at.to_owned()], false).unwrap();
    let ids: Vec<&str> = catalog.datasets().iter().map(|d| d.id.as_str()).collect();
    assert_eq!(ids, ["a", "b"]);
    assert_eq!(catalog.get("b").unwrap().steps, 2);
    let notice = catalog.get("a").unwrap().notice().unwrap();
    assert!(notice.contains("passed over: broken.nrrd: type: missing"), "{notice}");
    // If it is named itself, it is an error; beside another one it is listed with its reason.
    let error = Catalog::open(&[at.join("broken.nrrd")], false).unwrap_err();
    assert_eq!(error.field, "type");
    let catalog = Catalog::open(&[at.join("broken.nrrd"), at.join("a.nrrd"), at.join("gone")], false).unwrap();
    assert_eq!(catalog.datasets().len(), 1);
    let unreadable: Vec<(&str, bool)> = catalog
        .unreadable()
        .iter()
        .map(|path| (path.name.as_str(), path.reason.contains(&at.display().to_string())))
        .collect();
    assert_eq!(unreadable, [("broken.nrrd", false), ("gone", false)], "without folders");
}

#[test]
fn two_files_with_one_stem_clash() {
    let folder = tempfile::tempdir().unwrap();
    put(folder.path(), "a.nrrd", write::nrrd(&small(('u', 1)), "raw"));
    put(folder.path(), "a.mha", write::mha(&small(('u', 1)), false));
    let error = open_dataset(folder.path()).unwrap_err().to_string();
    assert!(error.contains("a.mha") && error.contains("a.nrrd"), "{error}");
}

#[test]
fn the_error_of_an_empty_folder_names_the_formats() {
    let folder = tempfile::tempdir().unwrap();
    for result in [
        open_dataset(folder.path()).map(drop),
        Catalog::open(&[folder.path().into()], true).map(drop),
    ] {
        assert!(
            result
                .unwrap_err()
                .to_string()
                .contains("holds no volume, expected .nrrd")
        );
    }
}

#[test]
fn ids_fit_in_urls_and_are_unique() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["Größe_1 (fein).nrrd", "große-1---FEIN.nrrd", "...nrrd", "mni152.nrrd"] {
        put(folder.path(), name, write::nrrd(&small(('u', 1)), "raw"));
    }
    let path = |name: &str| folder.path().join(name);
    let paths = [
        path("Größe_1 (fein).nrrd"),
        path("große-1---FEIN.nrrd"),
        path("...nrrd"),
        path("mni152.nrrd"),
    ];
    let mut twice = paths.to_vec();
    twice.extend(paths);
    let catalog = Catalog::open(&twice, true).unwrap();
    let mut ids: Vec<&str> = catalog.datasets().iter().map(|d| d.id.as_str()).collect();
    for id in &ids {
        assert!(
            !id.is_empty() && id.chars().all(|c| matches!(c, 'a'..='z' | '0'..='9' | '-')),
            "{id:?}"
        );
        assert_eq!(catalog.get(id).unwrap().id, *id);
    }
    assert_eq!(
        (ids[0], ids[3], ids[7], ids[8]),
        ("gr-e-1-fein", "mni152", "mni152-2", "mni152-3")
    );
    ids.sort();
    ids.dedup();
    assert_eq!(ids.len(), 9);
    assert!(catalog.get("none").is_none());
}

#[test]
fn the_demo_is_the_mni152_head() {
    let demo = demo().unwrap();
    assert_eq!(
        (demo.id.as_str(), names(&demo), demo.steps),
        ("mni152", vec!["t1", "gm", "wm"], 1)
    );
    assert_eq!((demo.geometry.dims, demo.geometry.spacing), ([197, 233, 189], [1.0; 3]));
    assert_eq!(demo.geometry.origin, [98.0, 134.0, -72.0]);
    assert!(demo.notice().unwrap().contains("McConnell Brain Imaging Centre"));
    for field in &demo.fields {
        let samples = field.source.load(0).unwrap();
        assert!(matches!(samples, Samples::U8(_)), "{}", field.name);
        assert_eq!(
            FieldStatistics::of(&samples, None).range,
            Some([0.0, 255.0]),
            "{}",
            field.name
        );
    }
    // The check values of the algorithm hold for values as they are loaded: 187,940 cells at 100.
    let t1 = demo.field("t1").unwrap().source.load(0).unwrap();
    assert_eq!(active_cells(&t1, demo.geometry.dims, 100.0), 187_940);
}

/// Cells with corners on both sides.
pub fn active_cells(samples: &Samples, dims: [u32; 3], iso: f32) -> usize {
    let [nx, ny, nz] = dims.map(|n| n as usize);
    let inside: Vec<bool> = (0..samples.len()).map(|i| samples.get(i) >= iso).collect();
    let at = |x, y, z| usize::from(inside[x + nx * (y + ny * z)]);
    let cells = (1..nz).flat_map(|z| (1..ny).flat_map(move |y| (1..nx).map(move |x| (x, y, z))));
    cells
        .filter(|&(x, y, z)| {
            let corners: usize = (0..8).map(|c| at(x - (c & 1), y - (c >> 1 & 1), z - (c >> 2))).sum();
            corners != 0 && corners != 8
        })
        .count()
}

#[test]
fn a_file_that_changed_since_is_not_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.nrrd");
    std::fs::write(&path, write::nrrd(&small(('u', 1)), "raw")).unwrap();
    let dataset = open_dataset(&path).unwrap();
    std::fs::write(&path, b"NRRD").unwrap();
    let error = dataset.fields[0].source.load(0).unwrap_err().to_string();
    assert!(
        error.contains("magic") && error.contains("replaced or cut off since"),
        "{error}"
    );
}
