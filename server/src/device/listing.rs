//! Devices of this machine, listed by child processes: a driver that crashes or hangs does not hide the others.

use std::path::{Path, PathBuf};

use isopeel_kernels::DeviceInfo;

use super::child::{Message, Request};
use super::run::{Ended, Environment, Running};

/// Environment variable that names the drivers to the OpenCL loader: a folder of `.icd` files.
const VENDORS: &str = "OCL_ICD_VENDORS";

/// Default value of [`VENDORS`].
const DEFAULT_VENDORS: &str = "/etc/OpenCL/vendors";

/// The devices, and drivers that have none to offer.
#[derive(Debug, Default)]
pub struct Listed {
    /// Preferred first.
    pub devices: Vec<DeviceInfo>,
    /// Drivers that crashed or hung, and are left out.
    pub broken: Vec<Unlisted>,
    /// Variables of the environment with which a process sees these devices, and not the broken drivers.
    pub environment: Vec<(String, String)>,
    /// Why there are no devices, in the words of the loader or the drivers.
    pub nothing: Option<String>,
}

/// A driver that could not be queried.
#[derive(Debug)]
pub struct Unlisted {
    /// Its `.icd` file.
    pub icd: PathBuf,
    /// What it did.
    pub why: String,
}

/// Lists the devices of all drivers. If listing them together crashes or hangs, each driver is queried in a process of its own. `folder`:
/// receives the `.icd` files of the working drivers in that case.
pub fn list(folder: Option<&Path>) -> Listed {
    match list_in(&Vec::new()) {
        Ok(devices) => Listed {
            devices,
            ..Listed::default()
        },
        Err(Ended::Wrong(text)) => Listed {
            nothing: Some(text),
            ..Listed::default()
        },
        Err(ended) => list_apart(folder, &ended),
    }
}

fn list_in(environment: &Environment) -> Result<Vec<DeviceInfo>, Ended> {
    let mut child = Running::start(&Request::List, environment)?;
    let mut devices = Vec::new();
    while let Some(message) = child.next()? {
        if let Message::Device(description) = message {
            devices.push(description.into());
        }
    }
    Ok(devices)
}

/// Queries each driver in a process of its own, then all that answered together.
fn list_apart(folder: Option<&Path>, ended: &Ended) -> Listed {
    let nothing = |text: String| Listed {
        nothing: Some(text),
        ..Listed::default()
    };
    let (Some(folder), icds) = (folder, icd_files()) else {
        return nothing(format!("an OpenCL driver is broken: {ended}"));
    };
    let mut listed = Listed::default();
    let mut working = Vec::new();
    for icd in icds {
        let alone = folder.join("one-driver");
        let found = name_drivers(&alone, std::slice::from_ref(&icd)).map(|vendors| list_in(&vendors));
        match found {
            Ok(Ok(_) | Err(Ended::Wrong(_))) => working.push(icd),
            Ok(Err(ended)) => listed.broken.push(Unlisted {
                icd,
                why: ended.to_string(),
            }),
            Err(error) => {
                return nothing(format!(
                    "an OpenCL driver is broken ({ended}), and {} cannot be written: {error}",
                    folder.display()
                ));
            }
        }
    }
    match name_drivers(&folder.join("drivers"), &working) {
        Ok(vendors) => listed.environment = vendors,
        Err(error) => return nothing(format!("{} cannot be written: {error}", folder.display())),
    }
    match list_in(&listed.environment) {
        Ok(devices) => listed.devices = devices,
        Err(ended) => listed.nothing = Some(ended.to_string()),
    }
    listed
}

/// Makes a folder that names only these drivers.
fn name_drivers(folder: &Path, icds: &[PathBuf]) -> std::io::Result<Environment> {
    match std::fs::remove_dir_all(folder) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(error),
        _ => std::fs::create_dir_all(folder)?,
    }
    for icd in icds {
        if let Some(name) = icd.file_name() {
            std::fs::copy(icd, folder.join(name))?;
        }
    }
    Ok(vec![(VENDORS.to_owned(), folder.display().to_string())])
}

fn icd_files() -> Vec<PathBuf> {
    let named = std::env::var_os(VENDORS).map(PathBuf::from);
    let path = named.unwrap_or_else(|| DEFAULT_VENDORS.into());
    let is_icd = |path: &PathBuf| path.extension().is_some_and(|extension| extension == "icd");
    let mut files: Vec<_> = match std::fs::read_dir(&path) {
        Ok(entries) => entries.flatten().map(|entry| entry.path()).filter(is_icd).collect(),
        Err(_) => vec![path],
    };
    files.sort();
    files
}
