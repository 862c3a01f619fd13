//! `isopeel devices`

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
    /// Check each device anew: all stages on a small volume with known answers, and known workarounds if they fail. Exit code 1 if none passes
    #[arg(long)]
    check: bool,

    /// What a child process does for its parent; JSON
    #[arg(long, hide = true, value_name = "REQUEST", conflicts_with = "check")]
    child: Option<String>,
}

/// Why the devices cannot be listed.
#[derive(Debug, thiserror::Error)]
pub enum DevicesError {
    /// No loader, driver or device; the message says what to install.
    #[error("{0}")]
    Nothing(String),
    /// All devices are there, and none is to be believed.
    #[error("no device passes the check")]
    NonePasses,
}

/// Lists or checks the devices.
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
    super::print(broken(&listed).as_bytes())?;
    if let Some(text) = listed.nothing {
        return Err(DevicesError::Nothing(text).into());
    }
    Ok(super::print(list(&listed.devices).as_bytes())?)
}

fn check(folder: Option<PathBuf>) -> Result<(), BoxError> {
    let bar = indicatif::ProgressBar::new_spinner();
    bar.enable_steady_tick(Duration::from_millis(200));
    let progress =
        |done: usize, of: usize| bar.set_message(format!("checking a device: {done} of {of} steps are done"));
    let (listed, checked) = device::check_all(folder, &progress);
    bar.finish_and_clear();
    let mut text = broken(&listed);
    for one in &checked {
        let _ = writeln!(text, "{}", verdict(one));
    }
    super::print(text.as_bytes())?;
    match listed.nothing {
        Some(text) => Err(DevicesError::Nothing(text).into()),
        None if checked.iter().all(|one| one.passed().is_none()) => Err(DevicesError::NonePasses.into()),
        None => Ok(()),
    }
}

/// A device, and how it passed or why it did not.
fn verdict(checked: &Checked) -> String {
    let device = &checked.device;
    let named = format!(
        "{}: {}\n   {}, driver {}\n",
        device.index, device.name, device.platform, device.driver
    );
    let result = match checked.passed() {
        Some(Workaround::None) => "   passes".to_owned(),
        Some(workaround) => format!("   passes with {}; without:\n{}", workaround.text(), checked.report()),
        None => format!(
            "   FAILS, and is not used without --trust-device:\n{}",
            checked.report()
        ),
    };
    named + &result
}

/// Drivers that are left out, a line each.
fn broken(listed: &Listed) -> String {
    let broken = listed.broken.iter();
    broken
        .map(|one| format!("left out: the driver of {}: {}\n", one.icd.display(), one.why))
        .collect()
}

fn list(devices: &[DeviceInfo]) -> String {
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

    #[test]
    fn a_device_is_listed_with_units() {
        let device = DeviceInfo {
            index: 1,
            platform: "Portable Computing Language".into(),
            name: "pthread-skylake ".into(),
            kind: DeviceKind::Cpu,
            memory_bytes: 6 << 30,
            max_allocation_bytes: 2 << 30,
            compute_units: 2,
            max_work_group: 4096,
            version: "OpenCL 3.0 PoCL".into(),
            driver: "3.1".into(),
        };
        assert_eq!(
            list(&[device]),
            "1: pthread-skylake\n   platform           Portable Computing Language\n   kind               CPU\n   \
             memory             6.0 GiB\n   largest allocation 2.0 GiB\n   compute units      2\n   \
             version            OpenCL 3.0 PoCL\n   driver             3.1\n"
        );
    }
}
