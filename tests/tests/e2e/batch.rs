//! `isopeel batch` of many volumes and time steps: failures are recorded, and the same command continues.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::jobs::checksum;
use crate::support::{ball, command, server};

/// Longest wait for a first surface.
const LIMIT: Duration = Duration::from_secs(60);

/// A ball of that radius around the middle.
fn write_ball(path: &Path, radius: f32) {
    ball::write_field(path, [24, 22, 20], |at| {
        let [u, v, w] = [at[0] - 11.6, at[1] - 10.6, at[2] - 9.6];
        radius - (u * u + v * v + w * w).sqrt()
    });
}

/// NIfTI-1 with a time step for each radius.
fn write_steps(path: &Path, radii: &[f32]) {
    let mut bytes = vec![0u8; 352];
    let mut put = |at: usize, part: &[u8]| bytes[at..at + part.len()].copy_from_slice(part);
    put(0, &348i32.to_le_bytes());
    for (i, n) in [4, 20, 20, 20, radii.len() as i16, 1, 1, 1].into_iter().enumerate() {
        put(40 + 2 * i, &n.to_le_bytes());
    }
    put(70, &16i16.to_le_bytes());
    put(72, &32i16.to_le_bytes());
    for i in 0..8 {
        put(76 + 4 * i, &1f32.to_le_bytes());
    }
    put(108, &352f32.to_le_bytes());
    put(123, &[10]);
    put(344, b"n+1\0");
    for radius in radii {
        for i in 0..8000u16 {
            let at = [i % 20, i / 20 % 20, i / 400].map(|n| f32::from(n) - 9.6);
            let value = radius - at.iter().map(|x| x * x).sum::<f32>().sqrt();
            bytes.extend(value.to_le_bytes());
        }
    }
    std::fs::write(path, bytes).expect("written");
}

struct Setting {
    folder: tempfile::TempDir,
}

impl Setting {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        for sub in ["in", "in/a", "in/b"] {
            std::fs::create_dir(folder.path().join(sub)).expect("a folder");
        }
        Self { folder }
    }

    fn input(&self, name: &str) -> PathBuf {
        self.folder.path().join("in").join(name)
    }

    fn output(&self) -> PathBuf {
        self.folder.path().join("out")
    }

    fn command(&self, inputs: &[&str], options: &str) -> Command {
        let mut command = Command::new(command::binary());
        command.arg("batch").args(inputs.iter().map(|name| self.input(name)));
        command.args(options.split_whitespace()).arg("-o").arg(self.output());
        command.stdin(Stdio::null());
        command
    }

    /// Exit code, stderr and the manifest.
    #[track_caller]
    fn run(&self, inputs: &[&str], options: &str) -> (Option<i32>, String, Vec<Value>) {
        let Output { status, stderr, .. } = self.command(inputs, options).output().expect("the binary starts");
        let stderr = String::from_utf8(stderr).expect("UTF-8");
        assert!(!stderr.contains("panicked"), "{stderr}");
        (status.code(), stderr, self.manifest())
    }

    fn manifest(&self) -> Vec<Value> {
        let text = std::fs::read_to_string(self.output().join("manifest.jsonl")).unwrap_or_default();
        // If the process was killed, the last line may be cut off.
        text.lines().flat_map(serde_json::from_str).collect()
    }

    /// Which file it is, and when it was written.
    fn made(&self, name: &str) -> (u64, i64, i64) {
        let metadata = std::fs::metadata(self.output().join(name)).expect(name);
        (metadata.ino(), metadata.mtime(), metadata.mtime_nsec())
    }
}

fn column<'a>(manifest: &'a [Value], name: &str) -> Vec<&'a str> {
    manifest.iter().map(|line| line[name].as_str().unwrap_or("-")).collect()
}

#[test]
fn what_fails_is_noted_and_all_else_is_made_once() {
    if !server::has_device() {
        return;
    }
    let setting = Setting::new();
    write_ball(&setting.input("a/head.npy"), 8.0);
    write_ball(&setting.input("b/head.npy"), 7.0);
    write_ball(&setting.input("a/nothing.npy"), -50.0);
    write_steps(&setting.input("b/steps.nii"), &[4.0, 6.0, 8.0]);
    std::fs::write(setting.input("a/text.npy"), "no volume").expect("written");
    // Its header is right, and samples are missing.
    let whole = std::fs::read(setting.input("a/head.npy")).expect("written");
    std::fs::write(setting.input("b/short.npy"), &whole[..whole.len() / 2]).expect("written");

    let (inputs, options) = (["a", "b/*.n*"], "--iso 0 --error 0.1vx --format ply");
    let (code, stderr, manifest) = setting.run(&inputs, options);
    assert_eq!(code, Some(1), "{stderr}");
    assert!(stderr.contains("2 of 8 surfaces failed"), "{stderr}");
    assert!(stderr.contains("1 of 8 surfaces have no triangles"), "{stderr}");
    let expected = ["done", "empty", "failed", "done", "failed", "done", "done", "done"];
    assert_eq!(column(&manifest, "state"), expected, "{manifest:?}");
    let files = [
        "a-head.ply",
        "-",
        "-",
        "b-head.ply",
        "-",
        "steps-0.ply",
        "steps-1.ply",
        "steps-2.ply",
    ];
    assert_eq!(column(&manifest, "file"), files);
    assert_eq!(manifest[7]["step"], 2);
    for line in [&manifest[2], &manifest[4]] {
        assert_eq!(line["problem"]["code"], "unreadable-volume", "{line}");
    }
    let one = setting.folder.path().join("one.ply");
    for (line, volume, options) in [
        (&manifest[0], "a/head.npy", ""),
        (&manifest[3], "b/head.npy", ""),
        (&manifest[6], "b/steps.nii", "--step 1"),
    ] {
        let statistics = command::extract_to(
            &setting.input(volume),
            &format!("--iso 0 --error 0.1vx {options}"),
            &one,
        );
        let bytes = std::fs::read(&one).expect("a file");
        let name = line["file"].as_str().expect("a name");
        assert!(
            std::fs::read(setting.output().join(name)).expect(name) == bytes,
            "{volume}"
        );
        assert_eq!(
            (&line["triangles"], &line["error"]),
            (&statistics["triangles"], &statistics["error"])
        );
        assert_eq!(line["sha256"], checksum(&bytes));
        assert_eq!(line["bytes"], bytes.len());
    }

    // Again: one volume is whole now, one has other samples, one file was changed.
    let before = ["a-head.ply", "b-head.ply", "steps-0.ply", "steps-1.ply"].map(|name| setting.made(name));
    std::fs::write(setting.input("b/short.npy"), &whole).expect("written");
    write_ball(&setting.input("b/head.npy"), 7.5);
    std::fs::write(setting.output().join("steps-1.ply"), "changed").expect("written");
    std::fs::remove_file(setting.input("a/text.npy")).expect("removed");
    let (code, stderr, again) = setting.run(&inputs, options);
    assert_eq!(code, Some(0), "{stderr}");
    assert_eq!(column(&again, "file")[2..4], ["b-head.ply", "short.ply"]);
    let after = ["a-head.ply", "b-head.ply", "steps-0.ply", "steps-1.ply"].map(|name| setting.made(name));
    let remade: Vec<bool> = before
        .iter()
        .zip(&after)
        .map(|(before, after)| before != after)
        .collect();
    assert_eq!(remade, [false, true, false, true]);

    // Other options are other files.
    let (code, stderr, _) = setting.run(&inputs, &options.replace("0.1vx", "0.2vx"));
    assert_eq!(code, Some(0), "{stderr}");
    assert_ne!(setting.made("a-head.ply"), after[0]);

    // Steps that ParaView reads as one.
    let (code, stderr, _) = setting.run(&["b/steps.nii"], "--iso 0 --format vtp --steps 1..9");
    assert_eq!(code, Some(0), "{stderr}");
    let collection = std::fs::read_to_string(setting.output().join("steps.pvd")).expect("a collection");
    let steps: Vec<&str> = collection.lines().filter(|line| line.starts_with("<DataSet")).collect();
    assert_eq!(
        steps,
        [
            "<DataSet timestep=\"1\" group=\"\" part=\"0\" file=\"steps-1.vtp\"/>",
            "<DataSet timestep=\"2\" group=\"\" part=\"0\" file=\"steps-2.vtp\"/>",
        ]
    );
}

#[test]
fn a_batch_that_is_killed_goes_on_where_it_was() {
    if !server::has_device() {
        return;
    }
    let setting = Setting::new();
    for n in 0..40 {
        write_ball(&setting.input(&format!("a/{n:02}.npy")), 6.0 + 0.05 * n as f32);
    }
    let mut child = setting
        .command(&["a"], "--iso 0 --format stl")
        .spawn()
        .expect("the binary starts");
    let start = Instant::now();
    while setting.manifest().len() < 3 {
        assert!(start.elapsed() < LIMIT, "no surface within {LIMIT:?}");
        std::thread::sleep(Duration::from_millis(2));
    }
    child.kill().expect("killed");
    child.wait().expect("ended");
    let made: Vec<String> = column(&setting.manifest(), "file")
        .into_iter()
        .map(str::to_owned)
        .collect();
    assert!(made.len() < 40, "it was not killed in time");
    let before: Vec<_> = made.iter().map(|name| setting.made(name)).collect();
    let (code, stderr, manifest) = setting.run(&["a"], "--iso 0 --format stl");
    assert_eq!(code, Some(0), "{stderr}");
    assert_eq!(column(&manifest, "state"), ["done"; 40]);
    let after: Vec<_> = made.iter().map(|name| setting.made(name)).collect();
    assert_eq!(before, after, "what was made is left alone");
    let files = std::fs::read_dir(setting.output()).expect("a folder").count();
    assert_eq!(files, 41, "nothing else is left");
}

#[test]
fn bad_arguments_of_a_batch_are_refused_by_name() {
    let setting = Setting::new();
    write_ball(&setting.input("a/head.npy"), 8.0);
    let request = setting.input("request.json");
    std::fs::write(
        &request,
        r#"{"volume":"a/head.npy","extractions":[{"format":"stl","iso":0}]}"#,
    )
    .expect("written");
    for (inputs, options, expected) in [
        (["a"], "--iso 0", "--format is missing"),
        (["a"], "--iso 0 --format xyz", "invalid value 'xyz'"),
        (
            ["a"],
            "--iso 0 --format stl --steps 3..1",
            "expected all, or numbers and ranges",
        ),
        (["*.mha"], "--iso 0 --format stl", "matches no file"),
        (["request.json"], "--iso 0", "expected none of these options"),
        (["request.json"], "--format stl", "expected none of these options"),
    ] {
        let (code, stderr, _) = setting.run(&inputs, options);
        assert!(
            matches!(code, Some(1 | 2)) && stderr.contains(expected),
            "{options}: {stderr}"
        );
    }
}
