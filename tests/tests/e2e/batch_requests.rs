//! `isopeel batch` of a request: a job without a server.

use serde_json::{Value, json};

use crate::jobs::{Setting, checksum, extracted, extraction, files_below, manifest};
use crate::support::{ball, command, server};

#[test]
fn a_batch_needs_no_server() {
    if !server::has_device() {
        return;
    }
    let setting = Setting::new();
    let extractions = [
        extraction(1.0, "ply"),
        extraction(2.0, "stl"),
        json!({"format": "stl", "iso": 400.0}),
    ];
    let file = setting.folder.path().join("request.json");
    std::fs::write(
        &file,
        json!({"volume": "ball.npy", "extractions": extractions}).to_string(),
    )
    .expect("written");
    let output = setting.folder.path().join("out");
    let arguments = || ["batch".as_ref(), file.as_os_str(), "-o".as_ref(), output.as_os_str()];
    command::succeed(arguments());
    let one = setting.folder.path().join("one.ply");
    command::extract_to(&setting.volume, "--iso 1 --error 0.1vx", &one);
    assert!(std::fs::read(output.join("00000.ply")).expect("a result") == std::fs::read(one).expect("a file"));
    assert!(output.join("00001.stl").is_file());
    // Nothing is at that isovalue.
    let manifest = manifest(&output);
    let states: Vec<&Value> = manifest.iter().map(|entry| &entry["state"]).collect();
    assert_eq!(states, ["done", "done", "empty"]);
    assert_eq!(manifest[1]["file"], "00001.stl");
    assert_eq!(
        manifest[1]["sha256"],
        checksum(&std::fs::read(output.join("00001.stl")).expect("a result"))
    );
    assert!(manifest[1]["triangles"].as_u64() > Some(0) && manifest[1]["error"]["rms"].as_f64() > Some(0.0));
    assert_eq!(manifest[2]["problem"]["code"], "empty-surface");
    assert_eq!(
        files_below(&output),
        3,
        "no state is left: two surfaces and the manifest"
    );
}

#[test]
fn the_same_words_make_the_same_surface_by_command_batch_and_rest() {
    check_same_surfaces(
        &Setting::new(),
        &[
            (json!({"iso": 1}), "--iso 1"),
            (json!({}), ""),
            (json!({"iso": 1, "beta": 0.02}), "--iso 1 --beta 0.02"),
            (
                json!({"iso": 1, "feature": "gradient-magnitude"}),
                "--iso 1 --feature gradient-magnitude",
            ),
            (
                json!({"iso": 1, "triangles": {"share": 0.1}}),
                "--iso 1 --triangles 10%",
            ),
            (
                json!({"iso": 1, "error": "0.1vx", "topology": "free"}),
                "--iso 1 --error 0.1vx --topology free",
            ),
            (
                json!({"iso": 1, "mesher": "marching-cubes"}),
                "--iso 1 --mesher marching-cubes",
            ),
            (
                json!({"iso": -9, "cap": true, "maxLevel": 3}),
                "--iso -9 --cap --max-level 3",
            ),
        ],
    );
}

#[test]
fn the_surface_of_a_label_is_the_same_by_command_batch_and_rest() {
    let setting = Setting::new();
    ball::write_field(&setting.volume, [24; 3], |at| {
        let distance = at.iter().map(|x| (x - 11.0).powi(2)).sum::<f32>().sqrt();
        if distance < 7.5 { 7.0 } else { 0.0 }
    });
    check_same_surfaces(
        &setting,
        &[
            (json!({"label": "7"}), "--label 7"),
            (
                json!({"label": "7", "labelSmoothing": 0.8}),
                "--label 7 --label-smoothing 0.8",
            ),
        ],
    );
}

/// Makes surfaces by names in JSON and by options in three ways: files must be equal.
fn check_same_surfaces(setting: &Setting, words: &[(Value, &str)]) {
    let Some(server) = setting.server() else { return };
    let folder = setting.folder.path();
    let extractions: Vec<Value> = (words.iter())
        .map(|(edit, _)| {
            let mut extraction = edit.clone();
            extraction["format"] = json!("ply");
            extraction
        })
        .collect();
    let file = folder.join("request.json");
    let job = json!({"volume": "ball.npy", "extractions": extractions});
    std::fs::write(&file, job.to_string()).expect("written");
    let output = folder.join("out");
    command::succeed(["batch".as_ref(), file.as_os_str(), "-o".as_ref(), output.as_os_str()]);
    for (n, (extraction, (_, options))) in extractions.iter().zip(words).enumerate() {
        let one = folder.join("one.ply");
        let by_command = command::extract_to(&setting.volume, options, &one);
        let bytes = std::fs::read(&one).expect("a file");
        assert!(by_command["triangles"].as_u64() > Some(100), "{options}: {by_command}");
        assert!(
            std::fs::read(output.join(format!("{n:05}.ply"))).expect("a result") == bytes,
            "batch: {options}"
        );
        assert!(extracted(server.address, extraction) == bytes, "REST: {options}");
    }
}
