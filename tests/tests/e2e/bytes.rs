//! Bytes on the wire: the shares of prefixes before the final surface, and budgets of bytes.

use std::ffi::OsStr;
use std::time::Duration;

use isopeel::stream::{Deadlines, StepTimes};
use serde_json::{Value, json};

use crate::support::viewer::{Frame, Viewer};
use crate::support::{ball, command, demo, demo_file, server};

/// Bytes of each prefix that an edit sends, coarse first.
async fn prefixes(viewer: &mut Viewer, edit: Value) -> Vec<usize> {
    let before = viewer.log.len();
    viewer.edit(edit).await;
    let mut bytes = Vec::new();
    for frame in &viewer.log[before..] {
        match (frame, bytes.last_mut()) {
            (Frame::Prefix(_), _) => bytes.push(0),
            (Frame::Chunk { bytes: more, .. }, Some(sum)) => *sum += more,
            _ => {}
        }
    }
    bytes
}

fn final_bytes(viewer: &Viewer) -> usize {
    viewer.shown.values().map(|chunk| chunk.frame_bytes).sum()
}

/// Sends each edit by a viewer of its own, for which the prefixes are planned, and then all edits by one viewer, for which the first
/// prefixes are guessed from the previous plan.
#[tokio::test]
async fn the_first_prefix_is_under_3_percent_and_all_are_under_twice_the_surface() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("ball.npy");
    ball::write(&file);
    // As few steps as on a fast machine and line, even if these are slow.
    let deadlines = Deadlines {
        steps: StepTimes {
            first: Duration::MAX,
            next: Duration::MAX,
            line: Duration::MAX,
            ..StepTimes::default()
        },
        ..Deadlines::default()
    };
    let Some(own) = server::serve(&[file], deadlines) else {
        return;
    };
    let full = json!({"beta": -1});
    let cases: [(&str, Vec<Value>); 2] = [
        (
            demo::ID,
            vec![
                json!({"iso": 140, "beta": 0.4}),
                json!({"iso": 120, "beta": 0.4}),
                json!({"iso": 100, "beta": 0.4, "alpha": 0}),
                json!({"iso": 130, "beta": -1}),
            ],
        ),
        (
            "ball",
            vec![
                json!({"iso": 0, "beta": 0.02}),
                full,
                json!({"iso": 8}),
                json!({"iso": -10, "beta": 0.02}),
            ],
        ),
    ];
    let mut coarse_first = 0;
    for (volume, edits) in cases {
        let mut one = Viewer::open(own.address, volume).await;
        for edit in edits {
            let mut alone = Viewer::open(own.address, volume).await;
            // Planned, and guessed from the previous surface.
            for viewer in [&mut alone, &mut one] {
                let bytes = prefixes(viewer, edit.clone()).await;
                let whole = final_bytes(viewer);
                let Some((_, coarse)) = bytes.split_last() else {
                    panic!("no prefix")
                };
                // A change of the cut alone has a preview that looks like the final surface, or none.
                if let (Some(first), false) = (coarse.first(), edit["iso"].is_null()) {
                    coarse_first += 1;
                    assert!(
                        100 * first < 3 * whole,
                        "{volume}, {edit}: first {first} of {whole} bytes"
                    );
                }
                // A step may send regions that are final.
                let sent: usize = bytes.iter().sum();
                assert!(sent < 2 * whole, "{volume}, {edit}: {bytes:?} for {whole} bytes");
            }
        }
    }
    // The others are small enough to be sent in one step.
    assert!(coarse_first >= 8, "{coarse_first} of 14 began coarse");
}

/// The surface is within the budget and uses at least 85 % of it, unless the next smaller tolerance would exceed it.
#[tokio::test]
async fn a_budget_of_bytes_is_kept_and_filled() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    viewer.edit(json!({"maxError": null, "topology": "free"})).await;
    for budget in [20_000, 60_000, 150_000, 700_000, 1_500_000] {
        let statistics = viewer.edit(json!({ "bytes": budget })).await;
        let bytes = final_bytes(&viewer);
        assert!(bytes <= budget, "{bytes} bytes, {budget} allowed");
        if bytes * 100 < budget * 85 {
            let tolerance = statistics["tolerance"].as_f64().expect("a number");
            viewer.edit(json!({"error": tolerance * 0.995})).await;
            let finer = final_bytes(&viewer);
            assert!(
                finer > budget,
                "{bytes} bytes at a tolerance of {tolerance}, {finer} just below it, {budget} allowed"
            );
        }
    }
}

/// Headers alone are more than the budget: nothing is sent instead of too much.
#[tokio::test]
async fn a_budget_of_bytes_that_no_surface_keeps_is_refused() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    let (code, suggested) = viewer.refused(json!({"bytes": 50})).await;
    assert_eq!(code, "over-budget");
    assert!(suggested.is_some_and(|triangles| triangles > 0), "{suggested:?}");
}

/// A file has no bytes on the wire: the same budget on the stream has to give the same surface.
#[tokio::test]
async fn the_command_keeps_and_fills_a_budget_of_bytes() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    let identity = json!({"points": [{"x": 0, "importance": 0, "color": "#000000"}, {"x": 1, "importance": 1, "color": "#ffffff"}]});
    let (guarded, free) = (
        (json!("auto"), "auto", ""),
        (json!(null), "free", "--max-error none --topology free"),
    );
    for (budget, (max_error, topology, guards)) in [(1_000_000, guarded), (300_000, free)] {
        let file = demo_file();
        let options = format!("--iso 100 --no-measure --bytes {budget} {guards}");
        let words = options.split_whitespace().map(OsStr::new);
        let found = command::extract([file.as_os_str()].into_iter().chain(words));
        let cut = json!({"iso": demo::ISO, "field": "t1", "feature": "none", "alpha": 0, "bytes": budget,
            "maxError": max_error, "topology": topology, "transferFunction": identity});
        let sent = viewer.edit(cut).await;
        for count in ["leaves", "triangles", "vertices"] {
            assert_eq!(sent[count], found[count], "{count} on the stream and by the command");
        }
        let bytes = final_bytes(&viewer);
        assert!(bytes <= budget, "{bytes} bytes, {budget} allowed");
        assert!(bytes * 100 >= budget * 85, "only {bytes} bytes, {budget} allowed");
    }
}

/// The log has a line for each of them.
#[test]
fn two_surfaces_at_most_are_encoded_for_a_budget_of_bytes() {
    if !server::has_device() {
        return;
    }
    for budget in [60_000, 1_000_000] {
        let output = std::process::Command::new(command::binary())
            .arg("extract")
            .arg(demo_file())
            .args([
                "--iso",
                "100",
                "--stats",
                "--no-measure",
                "--bytes",
                &budget.to_string(),
            ])
            .env("RUST_LOG", "isopeel_extraction=debug")
            .output()
            .expect("the binary starts");
        let log = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{log}");
        let trials = log.matches("a surface was encoded for a budget of bytes").count();
        assert!((1..=2).contains(&trials), "{trials} trials for {budget} bytes:\n{log}");
    }
}
