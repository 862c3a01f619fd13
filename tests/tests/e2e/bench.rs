//! `isopeel bench --case stream` and `--case camera` on small volumes: every line is there, complete, and within its budget.

use serde_json::Value;

use crate::support::{command, server};

const SETTINGS: [&str; 4] = ["opening", "full", "25 %", "8 %"];

/// The timed edits, each with its settings.
const EDITS: [(&str, &[&str]); 13] = [
    ("isovalue", &SETTINGS),
    ("budget", &["25 %", "8 %"]),
    ("beta", &["opening", "full"]),
    ("small beta", &["opening"]),
    ("alpha", &SETTINGS),
    ("transfer function", &SETTINGS),
    ("budget, rested", &["25 %", "8 %"]),
    ("alpha, rested", &["opening", "25 %", "8 %"]),
    ("transfer function, rested", &["opening", "25 %", "8 %"]),
    ("feature on", &SETTINGS),
    ("feature off", &SETTINGS),
    ("new time step", &SETTINGS),
    ("resident time step", &SETTINGS),
];

fn bench(case: &str, arguments: &[&str]) -> Vec<Value> {
    let text = command::succeed(["bench", "--case", case].iter().chain(arguments));
    text.lines()
        .map(|line| serde_json::from_str(line).expect("a JSON object"))
        .collect()
}

fn number(line: &Value, name: &str) -> f64 {
    line[name]
        .as_f64()
        .unwrap_or_else(|| panic!("{name} is no number: {line}"))
}

fn best(line: &Value, name: &str) -> f64 {
    let [best, median] = ["best", "median"].map(|which| number(&line[name], which));
    assert!(best <= median, "{name}: {line}");
    best
}

#[test]
fn every_edit_is_timed_at_every_setting() {
    if !server::has_device() {
        return;
    }
    let small = ["--volume", "sin", "--size", "32", "--repeats", "2"];
    let lines = bench("stream", &[&small[..], &["--drag-seconds", "0.5"]].concat());
    assert!(lines[0]["device"].is_string(), "{}", lines[0]);
    for (edit, settings) in EDITS {
        for setting in SETTINGS {
            let of = |line: &&Value| line["case"] == "stream" && line["edit"] == edit && line["setting"] == setting;
            let found: Vec<&Value> = lines.iter().filter(of).collect();
            assert_eq!(
                found.len(),
                usize::from(settings.contains(&setting)),
                "{edit} at {setting}"
            );
            found.into_iter().for_each(check);
        }
    }
    for edit in ["isovalue", "beta"] {
        for hz in [20.0, 60.0] {
            let of = |line: &&Value| line["case"] == "drag" && line["edit"] == edit && line["hz"] == hz;
            let drag = lines.iter().find(of).unwrap_or_else(|| panic!("no {edit} at {hz} Hz"));
            assert_eq!(number(drag, "edits"), hz / 2.0, "{drag}");
            assert!(number(drag, "commits") > 0.0, "{drag}");
            assert!(number(drag, "settle_ms") > 0.0, "{drag}");
            assert!(number(drag, "longest_gap_ms") > 0.0, "{drag}");
        }
    }
}

fn check(line: &Value) {
    let done = best(line, "done_ms");
    let (wall, device) = (best(line, "wall_ms"), best(line, "device_ms"));
    assert!(done > wall && wall > 0.0 && device > 0.0, "{line}");
    assert_eq!(
        line["stages_ms"].as_object().map(|stages| !stages.is_empty()),
        Some(true)
    );
    let (triangles, full) = (number(line, "triangles"), number(line, "full_triangles"));
    let edit = as_text(&line["edit"]).trim_end_matches(", rested");
    // In a volume as small as this one, the next cut below a budget may be an empty one if the function is not monotonic.
    assert!(full > 0.0 && (triangles > 0.0 || edit == "transfer function"), "{line}");
    let is_small = edit == "small beta";
    // Importance decides nothing in a surface that is shown in full, and little in a volume as small as this one.
    let of_importance =
        ["alpha", "transfer function"].contains(&edit) || (edit == "beta" && line["setting"] == "opening");
    let may_change_nothing = is_small || of_importance;
    if !may_change_nothing {
        assert!(number(line, "chunks") >= 1.0, "{line}");
        assert!(number(line, "encoded_bytes") >= 96.0 * number(line, "chunks"), "{line}");
        assert!(best(line, "first_ms") <= done, "{line}");
    }
    assert_eq!(line["opened_ms"].is_object(), edit.ends_with("time step"), "{line}");
    if line["setting"] == "full" {
        // The dual surface has two triangles for each grid edge, marching cubes about as many.
        assert!((triangles / full - 1.0).abs() < 0.2, "{line}");
    }
    let budget = line.get("budget_triangles").and_then(Value::as_f64);
    assert_eq!(budget.is_some(), as_text(&line["setting"]).ends_with('%'), "{line}");
    if let Some(budget) = budget
        && !is_small
    {
        assert!(triangles <= budget, "{line}");
    }
}

fn as_text(value: &Value) -> &str {
    value.as_str().expect("text")
}

#[test]
fn every_motion_of_the_camera_is_timed() {
    if !server::has_device() {
        return;
    }
    const BUDGET: f64 = 5000.0;
    let arguments = [
        "--volume",
        "sin",
        "--size",
        "96",
        "--repeats",
        "2",
        "--triangles",
        "5000",
    ];
    let lines = bench("camera", &arguments);
    let find = |motion: &str, distance: Option<&str>| {
        let of = |line: &&Value| line["motion"] == motion && line.get("distance").and_then(Value::as_str) == distance;
        let found: Vec<&Value> = lines.iter().filter(of).collect();
        assert_eq!(found.len(), 1, "{motion} {distance:?}");
        assert_eq!(found[0]["case"], "camera");
        assert!(number(found[0], "triangles") <= BUDGET, "{}", found[0]);
        found[0]
    };
    for (motion, distance, cameras) in [
        ("rest", None, 2.0),
        ("rest, measuring", None, 2.0),
        ("orbit", Some("far"), 18.0),
        ("orbit", Some("near"), 18.0),
        ("dolly", None, 20.0),
    ] {
        let line = find(motion, distance);
        assert_eq!(number(line, "cameras"), cameras, "{line}");
        let (done, wall, device) = (best(line, "done_ms"), best(line, "wall_ms"), best(line, "device_ms"));
        assert!(done > wall && wall > 0.0 && device > 0.0, "{line}");
        let resent = number(line, "resent_fraction");
        assert!(0.0 < resent && resent <= 1.0, "{line}");
        assert!(number(line, "encoded_bytes") > 0.0, "{line}");
    }
    for distance in ["far", "near"] {
        let line = find("moving", Some(distance));
        assert!(number(line, "generations_per_second") > 0.0, "{line}");
        assert!(number(line, "longest_gap_ms") > 0.0, "{line}");
    }
}

#[test]
fn files_to_look_at_exist() {
    let message = command::fail(["bench", "--case", "camera", "--file", "none.nrrd"]);
    assert!(message.contains("none.nrrd"), "{message}");
}

#[test]
fn a_drag_has_a_length() {
    let message = command::fail(["bench", "--case", "stream", "--drag-seconds", "0"]);
    assert!(message.contains("expected a number from 0.1 to 60"), "{message}");
}
