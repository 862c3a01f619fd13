//! The command `isopeel devices`: lists or checks the OpenCL devices.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::Duration;

use isopeel_kernels::{DeviceInfo, DeviceKind};

use crate::device::setup::Workaround;
use crate::device::{self, Checked, Listed, cache, child};
use crate::error::BoxError;

/// Arguments of `isopeel devices`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Check each device again: all stages on a small volume with known answers, and known workarounds if they fail. Exit code 1 if none
    /// passes
    #[arg(long)]
    check: bool,

    /// What a child process does for its parent; JSON
    #[arg(long, hide = true, value_name = "REQUEST", conflicts_with = "check")]
    child: Option<String>,
}

/// Why the devices cannot be listed.
#[derive(Debug, thiserror::Error)]
pub enum DevicesError {
    /// There is no loader, driver or device. The message says what to install.
    #[error("{0}")]
    Nothing(String),
    /// No device computes correctly.
    #[error("no device passes the check")]
    NonePasses,
}

/// Runs the command: lists or checks the devices, or serves a request of a parent process.
///
/// # Errors
/// [`DevicesError`], or standard output is closed.
pub fn run(args: &Args) -> Result<(), BoxError> {
    if let Some(request) = &args.child {
        return child::run(&serde_json::from_str(request)?);
    }
    let folder = cache::folder();
    if args.check {
        return check(folder);
    }
    let listed = device::list(folder.as_deref());
    super::print(describe_broken_drivers(&listed).as_bytes())?;
    if let Some(text) = listed.why_none {
        return Err(DevicesError::Nothing(text).into());
    }
    Ok(super::print(describe_devices(&listed.devices).as_bytes())?)
}

/// Checks all devices, shows progress on stderr, and prints a table of the results. `folder` stores the verdicts.
fn check(folder: Option<PathBuf>) -> Result<(), BoxError> {
    let bar = indicatif::ProgressBar::new_spinner();
    bar.enable_steady_tick(Duration::from_millis(200));
    let progress =
        |done: usize, of: usize| bar.set_message(format!("checking a device: {done} of {of} steps are done"));
    let (listed, checked) = device::check_all(folder, &progress);
    bar.finish_and_clear();
    let text = describe_broken_drivers(&listed) + &table(&checked);
    super::print(text.as_bytes())?;
    match listed.why_none {
        Some(text) => Err(DevicesError::Nothing(text).into()),
        None if checked.iter().all(|device| device.passed().is_none()) => Err(DevicesError::NonePasses.into()),
        None => Ok(()),
    }
}

/// Returns the results of a check: a table with a line for each device, and notes below.
fn table(checked: &[Checked]) -> String {
    let mut rows = vec![["", "result", "device", "driver"].map(str::to_owned)];
    rows.extend(checked.iter().map(row));
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let (index, result, device) = (width(0), width(1), width(2));
    let lines = rows
        .iter()
        .map(|[a, b, c, d]| format!("{a:index$}  {b:result$}  {c:device$}  {d}\n"));
    let mut text: String = if checked.is_empty() {
        String::new()
    } else {
        lines.collect()
    };
    text += &notes(checked);
    text
}

/// Returns notes on a check: the failures of each device, and the order of preference if several drivers offer the processors.
fn notes(checked: &[Checked]) -> String {
    let mut text = String::new();
    let has_failure = |device: &&Checked| device.tried.iter().any(|(_, ended)| ended.is_some());
    for failed in checked.iter().filter(has_failure) {
        let used = match failed.passed() {
            Some(_) => "is used with a workaround",
            None => "is not used without --trust-device",
        };
        // Writing to a string cannot fail.
        let _ = write!(
            text,
            "\n{} {used}, because it fails:\n{}\n",
            failed.device.index,
            failed.report()
        );
    }
    if checked
        .iter()
        .filter(|checked| checked.device.kind == DeviceKind::Cpu)
        .count()
        > 1
    {
        text += "\nThe first that passes is used: GPUs come before processors, and of the drivers of processors PoCL, then Intel's runtime, then \
                 others, then Mesa's, which compiles longest.\n";
    }
    text
}

/// Returns the table row of a device: index, result, name and driver.
fn row(checked: &Checked) -> [String; 4] {
    let device = &checked.device;
    let result = match checked.passed() {
        Some(Workaround::None) => "passes".to_owned(),
        Some(workaround) => format!("passes with {}", workaround.text()),
        None => "FAILS".to_owned(),
    };
    let driver = format!("{}, {}", device.platform, device.driver);
    [device.index.to_string(), result, device.name.clone(), driver]
}

/// Returns a line for each driver that is left out.
fn describe_broken_drivers(listed: &Listed) -> String {
    let drivers = listed.broken.iter();
    drivers
        .map(|driver| format!("left out: the driver of {}: {}\n", driver.icd.display(), driver.why))
        .collect()
}

/// Returns a paragraph for each device: its name, and a line for each property.
fn describe_devices(devices: &[DeviceInfo]) -> String {
    let mut text = String::new();
    for device in devices {
        let kind = match device.kind {
            DeviceKind::Gpu => "GPU",
            DeviceKind::Cpu => "CPU",
            DeviceKind::Other => "other",
        };
        let rows = [
            ("platform", device.platform.clone()),
            ("kind", kind.to_owned()),
            ("memory", gibibytes(device.memory_bytes)),
            ("largest allocation", gibibytes(device.max_allocation_bytes)),
            ("compute units", device.compute_units.to_string()),
            ("version", device.version.clone()),
            ("driver", device.driver.clone()),
        ];
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{}: {}", device.index, device.name.trim());
        for (name, value) in rows {
            // 19 is one more than the longest name.
            let _ = writeln!(text, "   {name:<19}{}", value.trim());
        }
    }
    text
}

fn gibibytes(bytes: u64) -> String {
    format!("{:.1} GiB", bytes as f64 / (1u64 << 30) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::Ended;

    fn device() -> DeviceInfo {
        DeviceInfo {
            index: 1,
            platform: "Portable Computing Language".into(),
            platform_version: "OpenCL 3.0 PoCL 3.1".into(),
            name: "pthread-skylake ".into(),
            kind: DeviceKind::Cpu,
            memory_bytes: 6 << 30,
            max_allocation_bytes: 2 << 30,
            compute_units: 2,
            max_work_group: 4096,
            version: "OpenCL 3.0 PoCL".into(),
            driver: "3.1".into(),
        }
    }

    #[test]
    fn a_device_is_listed_with_units() {
        assert_eq!(
            describe_devices(&[device()]),
            "1: pthread-skylake\n   platform           Portable Computing Language\n   kind               CPU\n   \
             memory             6.0 GiB\n   largest allocation 2.0 GiB\n   compute units      2\n   \
             version            OpenCL 3.0 PoCL\n   driver             3.1\n"
        );
    }

    #[test]
    fn checked_devices_are_a_table_with_reasons() {
        let wrong = Ended::PermanentError("stage cut fails".into());
        let passes = Checked {
            device: device(),
            tried: vec![(Workaround::None, Some(wrong.clone())), (Workaround::Loops, None)],
        };
        let fails = Checked {
            device: DeviceInfo {
                index: 2,
                name: "llvmpipe".into(),
                ..device()
            },
            tried: vec![(Workaround::None, Some(wrong))],
        };
        let text = table(&[passes, fails]);
        let lines: Vec<_> = text.lines().collect();
        assert_eq!(
            lines[..3],
            [
                "   result                                    device            driver",
                "1  passes with POCL_WORK_GROUP_METHOD=loops  pthread-skylake   Portable Computing Language, 3.1",
                "2  FAILS                                     llvmpipe          Portable Computing Language, 3.1",
            ]
        );
        assert!(
            text.contains("2 is not used without --trust-device") && text.contains("stage cut fails"),
            "{text}"
        );
        assert!(text.contains("Mesa's, which compiles longest"), "{text}");
        assert_eq!(table(&[]), "");
    }
}
