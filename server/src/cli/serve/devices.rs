//! Options of `isopeel serve` that select its devices.

use isopeel_kernels::DeviceInfo;
use isopeel_kernels::device::position;

use crate::cli::device::{ALL_DEVICES, DeviceArgs, NextEnvironment};
use crate::device::{cache, list};
use crate::metrics::MAX_DEVICES;

/// Options of a server's devices.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct DevicesArgs {
    /// OpenCL device: an index or a part of a name, as `isopeel devices` lists them; may be given again, for a server that divides its volumes
    /// among several devices. all: each of the same kind as the first of the list [default: the first that passes the check]
    #[arg(long, value_name = "SEL")]
    device: Vec<String>,

    /// Use the devices of --device without a check, at your own risk: wrong surfaces are not noticed
    #[arg(long, requires = "device")]
    trust_device: bool,

    #[arg(skip)]
    next: NextEnvironment,
}

/// Why the devices cannot be selected.
#[derive(Debug, thiserror::Error)]
pub enum DevicesError {
    /// No device is listed.
    #[error("--device: no OpenCL device is found: {0}")]
    Nothing(String),
    /// A selector names no device.
    #[error("--device {selector}: there is no such device, expected all, or an index or a part of a name of: {found}")]
    Unknown {
        /// The selector.
        selector: String,
        /// Indices and names of the devices.
        found: String,
    },
    /// All devices are selected, and others too.
    #[error("--device all was given with {0} more, expected it alone")]
    AllAndOthers(usize),
    /// There are too many devices.
    #[error("--device: {0} devices, expected at most {MAX_DEVICES}")]
    TooMany(usize),
}

impl DevicesArgs {
    /// Returns the options of each device. Lists the devices only if several are selected.
    ///
    /// # Errors
    /// [`DevicesError`].
    pub(super) fn each(&self) -> Result<Vec<DeviceArgs>, DevicesError> {
        let selectors = match &self.device[..] {
            [] => vec![None],
            [one] if one != ALL_DEVICES => vec![Some(one.clone())],
            several => {
                let listed = list(cache::folder().as_deref());
                if listed.devices.is_empty() {
                    return Err(DevicesError::Nothing(listed.why_none.unwrap_or_default()));
                }
                let selected = select(several, &listed.devices)?;
                selected.into_iter().map(Some).collect()
            }
        };
        let args = |selector| DeviceArgs::new(selector, self.trust_device, self.next.clone());
        Ok(selectors.into_iter().map(args).collect())
    }

    /// Returns the environment variables for a process that replaces this one.
    pub(super) fn next(&self) -> &NextEnvironment {
        &self.next
    }
}

/// Returns a selector for each device that these selectors name. `devices`: all devices, at least one.
fn select(selectors: &[String], devices: &[DeviceInfo]) -> Result<Vec<String>, DevicesError> {
    let selected = if selectors.iter().any(|selector| selector == ALL_DEVICES) {
        if selectors.len() > 1 {
            return Err(DevicesError::AllAndOthers(selectors.len() - 1));
        }
        let first = devices.first().map(|device| device.kind);
        let alike = devices.iter().filter(|device| Some(device.kind) == first);
        alike.map(|device| device.index.to_string()).collect()
    } else {
        selectors.to_vec()
    };
    if selected.len() > MAX_DEVICES {
        return Err(DevicesError::TooMany(selected.len()));
    }
    if let Some(unknown) = selected.iter().find(|selector| position(devices, selector).is_none()) {
        let found = devices
            .iter()
            .map(|device| format!("{}: {}", device.index, device.name));
        return Err(DevicesError::Unknown {
            selector: unknown.clone(),
            found: found.collect::<Vec<_>>().join(", "),
        });
    }
    Ok(selected)
}

#[cfg(test)]
mod tests {
    use isopeel_kernels::DeviceKind;

    use super::*;

    fn device(index: usize, name: &str, kind: DeviceKind) -> DeviceInfo {
        DeviceInfo {
            index,
            platform: "a platform".into(),
            platform_version: "OpenCL 3.0".into(),
            name: name.into(),
            kind,
            memory_bytes: 1 << 30,
            max_allocation_bytes: 1 << 28,
            compute_units: 1,
            max_work_group: 256,
            version: "OpenCL 3.0".into(),
            driver: "1".into(),
        }
    }

    fn selected(selectors: &[&str]) -> Result<Vec<String>, String> {
        let devices = [
            device(0, "fast", DeviceKind::Gpu),
            device(1, "quick", DeviceKind::Gpu),
            device(2, "processor", DeviceKind::Cpu),
        ];
        let selectors: Vec<_> = selectors.iter().map(|&selector| selector.to_owned()).collect();
        select(&selectors, &devices).map_err(|error| error.to_string())
    }

    #[test]
    fn all_means_each_device_of_the_kind_of_the_first() {
        assert_eq!(selected(&["all"]), Ok(vec!["0".to_owned(), "1".to_owned()]));
    }

    #[test]
    fn a_device_may_be_named_twice() {
        let named = ["proc", "0", "0"];
        assert_eq!(selected(&named), Ok(named.map(str::to_owned).to_vec()));
    }

    #[test]
    fn what_is_no_device_is_named() {
        for (selectors, expected) in [
            (&["0", "slow"][..], "--device slow: there is no such device"),
            (&["3", "0"], "of: 0: fast, 1: quick, 2: processor"),
            (&["all", "0"], "--device all was given with 1 more"),
            (&["0"; 17], "17 devices, expected at most 16"),
        ] {
            let error = selected(selectors).expect_err("an error");
            assert!(error.contains(expected), "{error}");
        }
    }
}
