//! Files written by independent programs, with the contents that these programs report: `tests/fixtures/volumes`, or the folder that
//! `FIXTURES` names, into which `make test-formats` has written them again.

use std::path::{Path, PathBuf};

use isopeel_volumes::{Dataset, Field, LengthUnit, TimeAxis, open_dataset};
use serde::Deserialize;

/// Expected contents of a volume: one entry of the list in a JSON file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Expected {
    /// Name to open: a file or folder beside the JSON file, with `:part` if it holds several volumes.
    open: String,
    /// The program that wrote it, with its version.
    #[serde(rename = "writer")]
    _writer: String,
    dims: [u32; 3],
    steps: u32,
    frame: String,
    unit: Option<String>,
    /// World positions of the samples at the corners, x fastest.
    corners: [[f64; 3]; 8],
    fields: Vec<ExpectedField>,
    /// Labels of the steps, if they are compared.
    #[serde(default)]
    times: Option<Vec<String>>,
    /// Words of the notice, of a file that is repaired.
    #[serde(default)]
    notice: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ExpectedField {
    name: String,
    unit: Option<String>,
    /// Index along x, y, z, and the step; the value there, `null` if it is missing.
    samples: Vec<([u32; 3], u32, Option<f32>)>,
    /// Value, name and colour of labels; a colour that is null is not compared.
    #[serde(default)]
    labels: Vec<(f32, String, Option<String>)>,
}

fn folder() -> PathBuf {
    let checked_in = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/volumes");
    std::env::var_os("FIXTURES").map_or_else(checked_in, PathBuf::from)
}

fn compare(dataset: &Dataset, expected: &Expected) {
    let (geometry, what) = (dataset.geometry, &expected.open);
    assert_eq!(
        (geometry.dims, dataset.steps),
        (expected.dims, expected.steps),
        "{what}"
    );
    assert_eq!(geometry.frame.name(), expected.frame, "{what}");
    let unit = geometry.unit.map(LengthUnit::symbol);
    assert_eq!(unit, expected.unit.as_deref(), "{what}");
    if let Some(times) = &expected.times {
        let found = dataset.times.as_ref().and_then(TimeAxis::labels);
        assert_eq!(found.as_ref(), Some(times), "{what}");
    }
    let longest = geometry.spacing.into_iter().fold(0.0, f64::max);
    for (i, corner) in expected.corners.iter().enumerate() {
        let along = |axis: usize| {
            let last = f64::from(geometry.dims[axis] - 1) * geometry.spacing[axis];
            if i >> axis & 1 == 1 { last } else { 0.0 }
        };
        let here: [f64; 3] = std::array::from_fn(|row| {
            geometry.origin[row]
                + (0..3)
                    .map(|axis| along(axis) * geometry.direction[axis][row])
                    .sum::<f64>()
        });
        let near = (0..3).all(|row| (here[row] - corner[row]).abs() < 1e-3 * longest);
        assert!(near, "{what}: corner {i} at {here:?}, expected {corner:?}");
    }
    let names = |names: Vec<&str>| names.join(", ");
    let expected_names = expected.fields.iter().map(|f| f.name.as_str()).collect();
    assert_eq!(names(dataset.field_names()), names(expected_names), "{what}");
    for (field, expected) in dataset.fields.iter().zip(&expected.fields) {
        let what = format!("{what}, {}", field.name);
        assert_eq!(field.unit, expected.unit, "{what}");
        assert!(!expected.samples.is_empty(), "{what}");
        compare_labels(field, &expected.labels, &what);
        for step in 0..dataset.steps {
            let samples = field.source.load(step).unwrap_or_else(|e| panic!("{what}: {e}"));
            for ([x, y, z], _, value) in expected.samples.iter().filter(|(_, at, _)| *at == step) {
                let found = samples.get(((z * geometry.dims[1] + y) * geometry.dims[0] + x) as usize);
                let is_missing = found.is_nan() || Some(found) == field.missing;
                match value {
                    None => assert!(
                        is_missing,
                        "{what}: {found} at {x}, {y}, {z}, step {step}, expected none"
                    ),
                    Some(value) => assert!(
                        !is_missing && (found - value).abs() <= 1e-5 * value.abs(),
                        "{what}: {found} at {x}, {y}, {z}, step {step}, expected {value}"
                    ),
                }
            }
        }
    }
}

fn compare_labels(field: &Field, expected: &[(f32, String, Option<String>)], what: &str) {
    let found = field.all_labels();
    assert_eq!(found.len(), expected.len(), "{what}: {found:?}");
    for ((sample, label), (value, name, color)) in found.iter().zip(expected) {
        assert_eq!((sample, label.name.as_ref()), (value, Some(name)), "{what}");
        let found = label.color.map(|[r, g, b]| format!("#{r:02x}{g:02x}{b:02x}"));
        assert!(
            color.is_none() || found == *color,
            "{what}: {label:?}, expected {color:?}"
        );
    }
}

#[test]
fn files_of_other_programs_are_read_as_they_read_them() {
    let mut lists: Vec<PathBuf> = std::fs::read_dir(folder())
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "json"))
        .collect();
    lists.sort();
    assert!(!lists.is_empty());
    for list in lists {
        let text = std::fs::read_to_string(&list).unwrap();
        let volumes: Vec<Expected> = serde_json::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}", list.display()));
        for expected in volumes {
            let dataset = open_dataset(&folder().join(&expected.open)).unwrap_or_else(|e| panic!("{e}"));
            compare(&dataset, &expected);
            let notice = dataset.notice().unwrap_or_default();
            if let Some(words) = &expected.notice {
                assert!(
                    notice.contains(words),
                    "{}: {notice:?}, expected {words:?}",
                    expected.open
                );
            }
        }
    }
}
