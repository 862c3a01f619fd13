//! Lists the devices of this machine in child processes, so that a driver that crashes or hangs does not hide the devices of other drivers.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use isopeel_kernels::DeviceInfo;

use super::cache;
use super::child::{Message, Request};
use super::run::{Ended, Environment, Running};
use crate::private_folder;

/// Environment variable that tells the OpenCL loader the folder of `.icd` files. Each file names a driver.
const VENDORS: &str = "OCL_ICD_VENDORS";

/// Default value of [`VENDORS`].
const DEFAULT_VENDORS: &str = "/etc/OpenCL/vendors";

/// The devices, and the drivers that could not be queried.
#[derive(Debug, Default)]
pub struct Listed {
    /// Devices, the preferred one first.
    pub devices: Vec<DeviceInfo>,
    /// Drivers that crashed or hung. Their devices are not listed.
    pub broken: Vec<Unlisted>,
    /// Environment variables with which a process sees `devices`, but not the broken drivers.
    pub environment: Vec<(String, String)>,
    /// Why there are no devices, in the words of the loader or the drivers.
    pub why_none: Option<String>,
}

impl Listed {
    fn none(text: String) -> Self {
        Self {
            why_none: Some(text),
            ..Self::default()
        }
    }
}

/// A driver that could not be queried.
#[derive(Debug)]
pub struct Unlisted {
    /// The `.icd` file that names the driver.
    pub icd: PathBuf,
    /// How the child process that queried the driver ended.
    pub why: String,
}

/// Lists the devices of all drivers. If the child process that lists them crashes or hangs, queries each driver in a separate process.
///
/// In that case, `folder` receives the `.icd` files of the working drivers. A folder for temporary files replaces it if it is `None` or not
/// writable.
pub fn list(folder: Option<&Path>) -> Listed {
    match list_in(&Vec::new()) {
        Ok(devices) => Listed {
            devices,
            ..Listed::default()
        },
        Err(Ended::PermanentError(text) | Ended::TemporaryError(text)) => Listed::none(text),
        Err(ended @ Ended::NotStarted(_)) => Listed::none(ended.to_string()),
        Err(ended) => {
            let spare = cache::spare_folder().ok();
            let mut folders = folder.into_iter().chain(spare.as_deref());
            let folder = folders.find(|folder| check_writable(folder).is_ok());
            let no_folder =
                || io::Error::other("neither the kernel cache nor the folder of temporary files can be written");
            folder.ok_or_else(no_folder).and_then(list_apart).unwrap_or_else(|why| {
                Listed::none(format!(
                    "an OpenCL driver is broken, and cannot be left out ({why}): {ended}"
                ))
            })
        }
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

/// Queries each driver in a process of its own, then lists the devices of all working drivers together.
fn list_apart(folder: &Path) -> io::Result<Listed> {
    let mut listed = Listed::default();
    let mut working = Vec::new();
    for icd in icd_files() {
        let alone = name_drivers(folder, std::slice::from_ref(&icd))?;
        match list_in(&alone) {
            Ok(_) | Err(Ended::PermanentError(_) | Ended::TemporaryError(_)) => working.push(icd),
            Err(ended) => listed.broken.push(Unlisted {
                icd,
                why: ended.to_string(),
            }),
        }
    }
    listed.environment = name_drivers(folder, &working)?;
    match list_in(&listed.environment) {
        Ok(devices) => listed.devices = devices,
        Err(ended) => listed.why_none = Some(ended.to_string()),
    }
    Ok(listed)
}

/// Checks that [`name_drivers`] can write to a folder, by writing a temporary file. Existing files do not prove that: the folder may have
/// become read-only, or its disk full.
fn check_writable(folder: &Path) -> io::Result<()> {
    let parent = drivers_in(folder);
    private_folder::make(&parent)?;
    tempfile::tempfile_in(&parent)?.write_all(&[0; 4096])
}

fn drivers_in(folder: &Path) -> PathBuf {
    folder.join("drivers")
}

/// Makes a folder with the `.icd` files of only these drivers. Returns the environment that makes the OpenCL loader use this folder.
///
/// The name of the folder is a hash of the files. The folder gets its name by a rename when it is complete, so that other processes never
/// see a part of it.
fn name_drivers(folder: &Path, icds: &[PathBuf]) -> io::Result<Environment> {
    let texts: io::Result<Vec<_>> = icds.iter().map(std::fs::read).collect();
    let files: Vec<_> = icds.iter().zip(texts?).collect();
    let hash = xxhash_rust::xxh3::xxh3_64(format!("{files:?}").as_bytes());
    let (parent, name) = (drivers_in(folder), format!("{hash:016x}"));
    let complete = parent.join(&name);
    if !complete.exists() {
        private_folder::make(&parent)?;
        let draft = tempfile::tempdir_in(&parent)?;
        for (icd, text) in files {
            if let Some(name) = icd.file_name() {
                std::fs::write(draft.path().join(name), text)?;
            }
        }
        match std::fs::rename(draft.path(), &complete) {
            // Another process has made the same folder meanwhile.
            Err(_) if complete.exists() => {}
            renamed => renamed?,
        }
    }
    Ok(vec![(VENDORS.to_owned(), complete.display().to_string())])
}

/// Returns the paths of all readable `.icd` files.
fn icd_files() -> Vec<PathBuf> {
    let configured = std::env::var_os(VENDORS).map(PathBuf::from);
    let path = configured.unwrap_or_else(|| DEFAULT_VENDORS.into());
    let is_icd = |path: &PathBuf| path.extension().is_some_and(|extension| extension == "icd");
    let mut files: Vec<_> = match std::fs::read_dir(&path) {
        Ok(entries) => entries.flatten().map(|entry| entry.path()).filter(is_icd).collect(),
        Err(_) => vec![path],
    };
    files.retain(|file| std::fs::read(file).is_ok());
    files.sort();
    files
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use rustix::thread::{CapabilitySet, capabilities, set_capabilities};

    use super::*;

    /// Runs a function in a thread for which permissions count also if root runs it.
    fn without_privileges<T: Send>(run: impl FnOnce() -> T + Send) -> T {
        let unprivileged = || {
            let mut sets = capabilities(None).unwrap();
            sets.effective -= CapabilitySet::DAC_OVERRIDE;
            set_capabilities(None, sets).unwrap();
            run()
        };
        std::thread::scope(|scope| scope.spawn(unprivileged).join().unwrap())
    }

    #[test]
    fn a_folder_that_became_read_only_is_found_out() {
        let folder = tempfile::tempdir().unwrap();
        name_drivers(folder.path(), &[]).unwrap();
        check_writable(folder.path()).unwrap();
        let parent = drivers_in(folder.path());
        std::fs::set_permissions(&parent, PermissionsExt::from_mode(0o500)).unwrap();
        let error = without_privileges(|| check_writable(folder.path())).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::PermissionDenied);
        std::fs::set_permissions(&parent, PermissionsExt::from_mode(0o700)).unwrap();
    }
}
