//! `isopeel devices`

use std::fmt::Write as _;

use isopeel_kernels::{DeviceInfo, DeviceKind};

/// Why the devices cannot be listed.
#[derive(Debug, thiserror::Error)]
pub enum DevicesError {
    /// No loader, driver or device; the message says what to install.
    #[error(transparent)]
    Device(#[from] isopeel_kernels::Error),
    /// Stdout is closed.
    #[error("the list could not be printed")]
    Print(#[from] std::io::Error),
}

/// Lists the devices.
///
/// # Errors
/// [`DevicesError`].
pub fn run() -> Result<(), DevicesError> {
    let devices = isopeel_kernels::device::list()?;
    Ok(super::print(list(&devices).as_bytes())?)
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
