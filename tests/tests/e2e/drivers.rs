//! What becomes of drivers that are broken: `faults.c` is a layer between isopeel and the driver.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use tempfile::TempDir;

use crate::faults::build_layer;
use crate::support::command::binary;
use crate::support::{http, process, server};

/// Longest time until a workaround is found: kernels are compiled for it.
const LIMIT: Duration = Duration::from_secs(240);

/// Held while kernels are compiled for the workaround, which takes the processors a minute: the next test finds them compiled.
static COMPILES_WORKAROUND: Mutex<()> = Mutex::new(());

/// A driver that fails in one way, and an isopeel that has not seen it before.
struct Broken {
    folder: TempDir,
    layer: std::path::PathBuf,
}

impl Broken {
    /// `None` if there is no device.
    fn new(fault: &str) -> Option<Self> {
        if !server::has_device() {
            return None;
        }
        let folder = tempfile::tempdir().expect("a folder");
        let layer = build_layer(folder.path());
        std::fs::write(folder.path().join("fault"), fault).expect("written");
        Some(Self { folder, layer })
    }

    /// Writes a volume beside the driver.
    fn ball(&self) -> PathBuf {
        let volume = self.folder.path().join("ball.npy");
        crate::support::ball::write(&volume);
        volume
    }

    fn run(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().expect("the binary starts")
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(binary());
        command
            .args(arguments)
            .env("OPENCL_LAYERS", &self.layer)
            .env("DEVICE_FAULT", self.folder.path().join("fault"))
            .env("ISOPEEL_KERNEL_CACHE", self.folder.path().join("cache"))
            // Compiled kernels are those that all tests use.
            .env("POCL_CACHE_DIR", compiled_kernels())
            .env("ISOPEEL_CHECK_SECONDS", "4")
            .stdin(Stdio::null());
        command
    }

    /// Whether an option of PoCL can help against the fault.
    fn is_pocl(&self) -> bool {
        String::from_utf8_lossy(&self.run(&["devices"]).stdout).starts_with("0: pthread")
    }

    /// Checks the devices: what is said of them.
    fn check(&self) -> String {
        let output = self.run(&["devices", "--check"]);
        assert_eq!(output.status.code(), Some(1), "{output:?}");
        String::from_utf8(output.stdout).expect("text")
    }
}

/// Every sentence names device, driver, stage and what happened.
#[track_caller]
fn says(text: &str, expected: &[&str]) {
    for part in expected {
        assert!(text.contains(part), "{part:?} is missing in: {text}");
    }
}

#[test]
fn a_driver_that_ends_the_process_is_a_sentence() {
    let Some(broken) = Broken::new("crash minmax") else {
        return;
    };
    let text = broken.check();
    says(
        &text,
        &[
            "FAILS",
            "driver",
            "stage minmax",
            "signal 6",
            "default settings",
            "--trust-device",
        ],
    );
}

/// As if the system had no memory left: the cause may be gone soon, and no verdict is kept.
#[test]
fn a_check_that_is_killed_is_not_remembered() {
    let Some(broken) = Broken::new("kill minmax") else {
        return;
    };
    says(
        &broken.check(),
        &["FAILS", "the process was killed in stage minmax (signal 9)"],
    );
    let verdicts = std::fs::read_dir(broken.folder.path().join("cache/devices"));
    assert_eq!(verdicts.map_or(0, Iterator::count), 0);
}

#[test]
fn a_driver_that_hangs_is_a_sentence() {
    let Some(broken) = Broken::new("hang minmax") else {
        return;
    };
    says(&broken.check(), &["FAILS", "stage minmax did not end within 4 s"]);
}

#[test]
fn a_driver_that_computes_wrong_results_is_a_sentence() {
    let Some(broken) = Broken::new("wrong activate") else {
        return;
    };
    says(
        &broken.check(),
        &["FAILS", "stage construct computes wrong results", "expected"],
    );
}

#[test]
fn a_driver_whose_compiler_fails_is_a_sentence() {
    let Some(broken) = Broken::new("nobuild minmax") else {
        return;
    };
    says(&broken.check(), &["FAILS", "stage minmax did not build"]);
}

#[test]
fn a_device_without_memory_is_a_sentence() {
    let Some(broken) = Broken::new("full 1000") else { return };
    says(
        &broken.check(),
        &["FAILS", "the driver ran out of memory in stage", "bytes"],
    );
}

#[test]
fn a_fault_that_passes_leaves_no_workaround() {
    let Some(broken) = Broken::new("fail") else { return };
    let output = broken.run(&["devices", "--check"]);
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(
        !broken.folder.path().join("fault").exists(),
        "no kernel has failed: {said}"
    );
    assert!(output.status.success(), "{output:?}");
    assert!(
        !said.contains("POCL_WORK_GROUP_METHOD") && !said.contains("fails"),
        "{said}"
    );
}

#[test]
fn a_device_that_fails_is_used_only_if_it_is_trusted() {
    let Some(broken) = Broken::new("crash minmax") else {
        return;
    };
    let volume = broken.ball();
    let volume = volume.to_str().expect("text");
    let refused = broken.run(&["extract", volume, "--iso", "0.5", "--stats"]);
    let text = String::from_utf8_lossy(&refused.stderr);
    assert_eq!(refused.status.code(), Some(1), "{text}");
    says(
        &text,
        &["no OpenCL device passes the check", "stage minmax", "--trust-device"],
    );
    // The driver is believed, and does what it does.
    let trusted = broken.run(&[
        "extract",
        volume,
        "--iso",
        "0.5",
        "--stats",
        "--device",
        "0",
        "--trust-device",
    ]);
    assert_eq!(trusted.status.code(), None, "{trusted:?}");
}

#[test]
fn a_trusted_device_that_is_wrong_is_used_and_logged() {
    let Some(broken) = Broken::new("wrong histogram_bins") else {
        return;
    };
    let volume = broken.ball();
    let volume = volume.to_str().expect("text");
    let edit = ["extract", volume, "--iso", "0.5", "--beta", "-1", "--stats"];
    let refused = broken.run(&edit);
    assert_eq!(refused.status.code(), Some(1), "{refused:?}");
    let trusted = broken.run(&[&edit[..], &["--device", "0", "--trust-device"]].concat());
    let text = String::from_utf8_lossy(&trusted.stderr);
    assert_eq!(trusted.status.code(), Some(0), "{text}");
    says(&text, &["the trusted device is wrong", "stage histogram"]);
}

/// The preferred one of two devices fails: the other one is used, also by the next process, which does not check the first one again.
#[test]
fn the_choice_of_another_device_is_kept() {
    let Some(broken) = Broken::new("crash minmax") else {
        return;
    };
    if !broken.is_pocl() {
        return;
    }
    let volume = broken.ball();
    let run = |arguments: &[&str]| {
        let mut command = broken.command(arguments);
        // PoCL offers the same processors twice, and lists `basic` first.
        command
            .env("POCL_DEVICES", "basic pthread")
            .env("DEVICE_FAULT_ON", "basic");
        let output = command
            .env("ISOPEEL_CHECK_SECONDS", "120")
            .output()
            .expect("the binary starts");
        assert_eq!(output.status.code(), Some(0), "{output:?}");
        [output.stdout, output.stderr].map(|text| String::from_utf8(text).expect("text"))
    };
    let extract = || run(&["extract", volume.to_str().expect("text"), "--iso", "0.5", "--stats"]);
    let [surface, log] = extract();
    says(&log, &["basic-", "is not used", "stage minmax"]);
    let [again, log] = extract();
    says(
        &log,
        &["basic-", "failed the check before", "stage minmax", "devices --check"],
    );
    assert!(!log.contains("is not used"), "{log}");
    let triangles = |text: &str| serde_json::from_str::<serde_json::Value>(text).expect("JSON")["triangles"].clone();
    assert!(triangles(&surface).as_u64() > Some(0), "{surface}");
    assert_eq!(triangles(&again), triangles(&surface));

    // Checking all devices again keeps what it found.
    let [table, _] = run(&["devices", "--check"]);
    says(&table, &["0  FAILS", "1  passes"]);
    says(&extract()[1], &["failed the check before"]);
}

/// Folder of compiled kernels that all tests use.
fn compiled_kernels() -> PathBuf {
    let home = std::env::var_os("HOME").expect("a home");
    let kept = Path::new(&home).join(".cache/pocl/kcache");
    std::env::var_os("POCL_CACHE_DIR").map_or(kept, Into::into)
}

/// Another process takes the place of the one that has read stdin. It finds the volume, and no temporary file of either is left.
#[test]
fn a_volume_from_stdin_is_read_by_the_process_with_the_workaround() {
    let Some(broken) = Broken::new("crash minmax") else {
        return;
    };
    if !broken.is_pocl() {
        return;
    }
    let _compiles = COMPILES_WORKAROUND.lock().unwrap_or_else(PoisonError::into_inner);
    let [volume, temporary, output] =
        ["ball.npy", "temporary", "out/ball.stl"].map(|name| broken.folder.path().join(name));
    crate::support::ball::write(&volume);
    std::fs::create_dir(&temporary).expect("a folder");
    std::fs::create_dir(output.parent().expect("a folder")).expect("a folder");
    let extracted = broken
        .command(&["extract", "-", "--iso", "0.5", "-o", output.to_str().expect("text")])
        .env("DEVICE_FAULT_UNLESS", "POCL_WORK_GROUP_METHOD")
        .env("TMPDIR", &temporary)
        .env("ISOPEEL_CHECK_SECONDS", "120")
        .stdin(std::fs::File::open(&volume).expect("a file"))
        .output()
        .expect("the binary starts");
    assert_eq!(extracted.status.code(), Some(0), "{extracted:?}");
    assert!(
        !crate::support::files::read("stl", &std::fs::read(&output).expect("written"))
            .triangles
            .is_empty()
    );
    let left = |folder: &Path| std::fs::read_dir(folder).expect("a folder").count();
    assert_eq!((left(&temporary), left(output.parent().expect("a folder"))), (0, 1));
}

/// A stage fails that no first surface needs: the server has made surfaces already.
#[test]
fn a_server_whose_driver_fails_late_starts_again_with_a_workaround() {
    let Some(broken) = Broken::new("wrong slice") else {
        return;
    };
    if !broken.is_pocl() {
        return;
    }
    let _compiles = COMPILES_WORKAROUND.lock().unwrap_or_else(PoisonError::into_inner);
    let volume = broken.ball();
    let cache = broken.folder.path().join("cache");
    let environment = [
        ("OPENCL_LAYERS", &*broken.layer),
        ("DEVICE_FAULT", &*broken.folder.path().join("fault")),
        ("DEVICE_FAULT_UNLESS", Path::new("POCL_WORK_GROUP_METHOD")),
        ("ISOPEEL_KERNEL_CACHE", &*cache),
        ("POCL_CACHE_DIR", &*compiled_kernels()),
    ];
    let process = process::start_in(&[volume], &[], &environment).expect("a device");
    let verdict = || {
        let files = std::fs::read_dir(cache.join("devices")).ok()?;
        let texts = files.map(|file| std::fs::read_to_string(file.expect("a file").path()).expect("text"));
        texts.last()
    };
    let is_ready =
        || http::send(process.address, "GET", "/readyz", &[], b"").is_some_and(|answer| answer.status == 200);
    let start = Instant::now();
    while verdict().is_none() || !is_ready() {
        assert!(
            start.elapsed() < LIMIT,
            "the server has found no workaround: {:?}",
            verdict()
        );
        std::thread::sleep(Duration::from_millis(50));
    }
    assert!(
        verdict().is_some_and(|text| text.contains("\"loops\"")),
        "{:?}",
        verdict()
    );
    let body = serde_json::json!({"volume": "ball", "iso": 0.5, "format": "stl"});
    assert_eq!(http::post_json(process.address, "/api/v1/extract", &body).status, 200);
}

/// The check of a new device stands still at stage `slice`: a request that needs it waits beside the device's thread, not on it.
#[test]
fn others_work_while_a_request_waits_for_the_check_of_its_program() {
    let Some(broken) = Broken::new("hang slice") else {
        return;
    };
    let volume = broken.ball();
    let (fault, cache) = (broken.folder.path().join("fault"), broken.folder.path().join("cache"));
    let environment = [
        ("OPENCL_LAYERS", &*broken.layer),
        ("DEVICE_FAULT", &*fault),
        ("ISOPEEL_KERNEL_CACHE", &*cache),
        ("POCL_CACHE_DIR", &*compiled_kernels()),
    ];
    let process = process::start_in(&[volume], &[], &environment).expect("a device");
    let address = process.address;
    let extract = |iso: f64| {
        let body = serde_json::json!({"volume": "ball", "iso": iso, "format": "stl"});
        http::post_json(address, "/api/v1/extract", &body).status
    };
    assert_eq!(extract(0.5), 200, "all that an export needs comes before slices");
    std::thread::scope(|scope| {
        let slice = scope.spawn(|| http::get(address, "/api/v1/volumes/ball/slices?axis=z&index=5").status);
        // It has been queued by then, and waits.
        std::thread::sleep(Duration::from_millis(500));
        for iso in [0.4, 0.45, 0.55] {
            assert_eq!(extract(iso), 200);
        }
        assert!(!slice.is_finished(), "no program runs before its check");
        std::fs::remove_file(&fault).expect("removed");
        assert_eq!(slice.join().expect("no panic"), 200);
    });
}

/// Kernels by their stages' files, in the order of their names.
fn kernels() -> Vec<String> {
    let folder = crate::support::repository().join("kernels/cl");
    let mut files: Vec<_> = std::fs::read_dir(folder)
        .expect("the kernels' sources")
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "cl"))
        .collect();
    files.sort();
    let texts = files.iter().map(|file| std::fs::read_to_string(file).expect("text"));
    let names = texts.flat_map(|text| {
        let after = text
            .split("__kernel")
            .skip(1)
            .map(|rest| rest.split_once("void ").expect("a kernel").1);
        let names = after.map(|rest| rest.split_once('(').expect("a kernel").0.to_owned());
        names.collect::<Vec<_>>()
    });
    names.collect()
}

/// Faults of one kernel, of those that `ISOPEEL_FAULTS` names, or of all with `ISOPEEL_FAULTS=all`.
#[test]
fn a_kernel_of_any_stage_that_fails_is_a_sentence() {
    let named = std::env::var("ISOPEEL_FAULTS").unwrap_or_else(|_| "classify".to_owned());
    let is_chosen = |name: &String| named == "all" || named.split(',').any(|one| one == name);
    // Makes volumes of benchmarks alone, by a program of its own.
    let chosen: Vec<_> = kernels()
        .into_iter()
        .filter(|name| name != "generate" && is_chosen(name))
        .collect();
    let mut unnoticed = Vec::new();
    for kernel in chosen {
        for fault in ["crash", "wrong", "nobuild"] {
            let Some(broken) = Broken::new(&format!("{fault} {kernel}")) else {
                return;
            };
            let output = broken.run(&["devices", "--check"]);
            let text = String::from_utf8_lossy(&output.stdout);
            let is_said = output.status.code() == Some(1)
                && ["FAILS", "driver", "stage", "--trust-device"]
                    .iter()
                    .all(|part| text.contains(part));
            if !is_said {
                unnoticed.push(format!("{fault} {kernel}: {:?}", output.status));
            }
        }
    }
    assert!(unnoticed.is_empty(), "{unnoticed:#?}");
}
