//! The cache folder of this user: compiled kernels, and verdicts on devices.

use std::path::{Path, PathBuf};

use isopeel_volumes::disk::free_bytes;
use rustix::fs::StatVfsMountFlags;

use crate::private_folder;

/// Environment variable that names the folder.
pub const VARIABLE: &str = "ISOPEEL_KERNEL_CACHE";

/// Environment variables that set where drivers cache compiled kernels, each with its subfolder of isopeel's cache folder.
const DRIVERS: [(&str, &str); 3] = [
    ("POCL_CACHE_DIR", "pocl"),
    ("CUDA_CACHE_PATH", "nvidia"),
    ("MESA_SHADER_CACHE_DIR", "mesa"),
];

/// Environment variables that set where drivers cache compiled kernels: those of [`DRIVERS`], and those of Intel's and AMD's drivers.
const FOLDER_VARIABLES: [&str; 5] = [
    "POCL_CACHE_DIR",
    "CUDA_CACHE_PATH",
    "MESA_SHADER_CACHE_DIR",
    "NEO_CACHE_DIR",
    "AMD_COMGR_CACHE_DIR",
];

/// Folders in the user's cache folder in which Mesa's, Intel's and AMD's drivers cache compiled kernels.
const OWN_FOLDERS: [&str; 4] = [
    "mesa_shader_cache",
    "mesa_shader_cache_db",
    "neo_compiler_cache",
    "comgr",
];

/// Environment variable that sets where PoCL caches compiled kernels.
const POCL: &str = "POCL_CACHE_DIR";

/// Minimum free bytes on the disk of a kernel cache when the process starts. The kernels of one device need less.
const START_BYTES: u64 = 64 << 20;

/// Minimum free bytes on that disk before another program is compiled.
const MIN_BYTES: u64 = 4 << 20;

/// Returns the path in an environment variable; `None` if the variable is unset or empty.
fn path(name: &str) -> Option<PathBuf> {
    let value = std::env::var_os(name).filter(|value| !value.is_empty());
    value.map(PathBuf::from)
}

/// Returns the cache folder: `ISOPEEL_KERNEL_CACHE`, or else `isopeel` in the user's cache folder. `None` if the environment names neither.
pub fn folder() -> Option<PathBuf> {
    path(VARIABLE)
        .or_else(|| path("XDG_CACHE_HOME").map(|cache| cache.join("isopeel")))
        .or_else(|| path("HOME").map(|home| home.join(".cache/isopeel")))
}

/// Folders in which drivers cache compiled kernels.
pub struct DriverFolders {
    /// Environment variables to set, and their values.
    pub variables: Vec<(&'static str, PathBuf)>,
    /// If PoCL's own folder is unusable: the reason, and the folder that is used instead.
    pub warning: Option<String>,
}

impl DriverFolders {
    /// Logs the warning, if there is one.
    pub fn warn(&self) {
        if let Some(warning) = &self.warning {
            tracing::warn!("{warning}");
        }
    }
}

/// Chooses the folders in which drivers cache compiled kernels. They are subfolders of `ISOPEEL_KERNEL_CACHE` if that variable is set,
/// except for drivers whose own variable is set.
///
/// Checks the folder of PoCL, because PoCL aborts the process if it cannot write its kernels. If the folder is unusable, a temporary folder
/// replaces it.
pub fn driver_folders() -> DriverFolders {
    let mut variables = default_variables();
    let warning = match pocl_folder().map(|folder| (check(&folder, START_BYTES), folder)) {
        Some((Ok(()), _)) => None,
        Some((Err(why), folder)) => Some(format!("{}: {why}", folder.display())),
        None => Some("this user has no folder for compiled kernels: HOME is not set".to_owned()),
    };
    let warning = warning.map(|why| {
        let (spare, how) = match spare_folder() {
            Ok(folder) => (Some(folder), "this one is used instead"),
            Err(_) => (
                None,
                "there is no other one, as the folder of temporary files (TMPDIR) is of no use either",
            ),
        };
        variables.retain(|(name, _)| *name != POCL || spare.is_none());
        let place = spare
            .as_ref()
            .map_or_else(String::new, |folder| format!(" {}", folder.display()));
        variables.extend(spare.map(|folder| (POCL, folder)));
        format!("the folder of PoCL's compiled kernels is of no use: {why}; {how}{place}. {POCL} names another one")
    });
    DriverFolders { variables, warning }
}

/// Returns the folders in which drivers cache compiled kernels in this process: those that the environment names, and those that drivers
/// use by themselves. Creates subfolders of isopeel's cache folder that do not exist.
pub fn kernel_folders() -> Vec<PathBuf> {
    let default = default_variables();
    for (_, folder) in &default {
        // An error is ignored: drivers work without a cache.
        let _ = private_folder::make(folder);
    }
    let cache = path("XDG_CACHE_HOME").or_else(|| path("HOME").map(|home| home.join(".cache")));
    let own = OWN_FOLDERS.iter().filter_map(|name| Some(cache.as_ref()?.join(name)));
    let nvidia = path("HOME").map(|home| home.join(".nv"));
    if let Some(folder) = &nvidia
        && Path::new("/dev/nvidiactl").exists()
    {
        // An error is ignored, as above.
        let _ = private_folder::make(folder);
    }
    let named = FOLDER_VARIABLES.iter().filter_map(|name| path(name));
    let folders = named.chain(default.into_iter().map(|(_, folder)| folder));
    folders.chain(pocl_folder()).chain(own).chain(nvidia).collect()
}

/// Returns the folder for temporary files of the process of a server's device: a subfolder of
/// isopeel's cache folder, or else of the folder of temporary files. `None` if neither can be used.
pub fn temporary_folder() -> Option<PathBuf> {
    let folder = folder().map(|folder| folder.join("tmp"));
    let usable = folder.filter(|folder| check(folder, 0).is_ok());
    usable.or_else(|| spare_folder().ok())
}

/// Checks that PoCL has disk space to compile another program. If not, the log names the folder.
///
/// # Errors
/// The reason, as a sentence for clients that does not name the folder.
pub fn check_space() -> Result<(), String> {
    let Some(folder) = pocl_folder() else { return Ok(()) };
    match free_bytes(&folder) {
        Ok(free) if free < MIN_BYTES => {
            tracing::error!(folder = %folder.display(), free, "no space for compiled kernels, expected {MIN_BYTES} bytes");
            Err("the disk has no space for compiled kernels, the server's log says where".to_owned())
        }
        // An error is ignored: PoCL creates a folder that was removed again.
        _ => Ok(()),
    }
}

/// Returns the variables in [`DRIVERS`] that are not set, each with its subfolder of the cache folder. Returns none if [`VARIABLE`] is not
/// set.
fn default_variables() -> Vec<(&'static str, PathBuf)> {
    if std::env::var_os(VARIABLE).is_none() {
        return Vec::new();
    }
    let Some(folder) = folder() else { return Vec::new() };
    let unset = DRIVERS.into_iter().filter(|(name, _)| std::env::var_os(name).is_none());
    unset.map(|(name, subfolder)| (name, folder.join(subfolder))).collect()
}

/// Returns the folder in which PoCL caches its kernels in this process, by PoCL's own rules.
pub(super) fn pocl_folder() -> Option<PathBuf> {
    let default = default_variables().into_iter().find(|(name, _)| *name == POCL);
    path(POCL)
        .or(default.map(|(_, folder)| folder))
        .or_else(|| path("XDG_CACHE_HOME").map(|cache| cache.join("pocl/kcache")))
        .or_else(|| path("HOME").map(|home| home.join(".cache/pocl/kcache")))
}

/// Returns a folder for temporary files that only this user can access. Creates the folder if it does not exist.
pub(super) fn spare_folder() -> Result<PathBuf, String> {
    let user = rustix::process::geteuid().as_raw();
    let folder = std::env::temp_dir().join(format!("isopeel-kernels-{user}"));
    check_spare(&folder).map(|()| folder)
}

/// Checks a folder as [`check`] does, with stricter rules. Its name is predictable, and all users can write to its parent, so it must not
/// be a symbolic link, and other users must not have any access.
fn check_spare(folder: &Path) -> Result<(), String> {
    use std::os::unix::fs::MetadataExt;
    check(folder, START_BYTES)?;
    let metadata = std::fs::symlink_metadata(folder).map_err(|error| error.to_string())?;
    if !metadata.is_dir() || metadata.mode() & 0o077 != 0 {
        let mode = metadata.mode() & 0o7777;
        return Err(format!(
            "expected a folder with mode 0700 and no link, found mode {mode:04o}"
        ));
    }
    Ok(())
}

/// Checks that a folder can cache kernels. Creates the folder if it does not exist. Other users must not be able to write to the folder,
/// because this process executes the kernels in it.
fn check(folder: &Path, min_bytes: u64) -> Result<(), String> {
    use std::os::unix::fs::MetadataExt;
    let text = |error: std::io::Error| error.to_string();
    private_folder::make(folder).map_err(text)?;
    let metadata = std::fs::metadata(folder).map_err(text)?;
    let user = rustix::process::geteuid().as_raw();
    if metadata.uid() != user {
        return Err(format!("it belongs to user {}, expected {user}", metadata.uid()));
    }
    if metadata.mode() & 0o022 != 0 {
        let mode = metadata.mode() & 0o7777;
        return Err(format!(
            "others may write there (mode {mode:04o}), and what is there is run: chmod go-w"
        ));
    }
    let disk = rustix::fs::statvfs(folder).map_err(|error| text(error.into()))?;
    check_mount_flags(disk.f_flag)?;
    let mut file = tempfile::tempfile_in(folder).map_err(text)?;
    std::io::Write::write_all(&mut file, &[0; 4096]).map_err(text)?;
    let free = free_bytes(folder).map_err(text)?;
    if free < min_bytes {
        return Err(format!("it has {free} bytes free, expected {min_bytes}"));
    }
    Ok(())
}

fn check_mount_flags(flags: StatVfsMountFlags) -> Result<(), String> {
    match flags.contains(StatVfsMountFlags::NOEXEC) {
        true => Err("its disk is mounted with noexec, and kernels are loaded as libraries".to_owned()),
        false => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn a_folder_of_kernels_is_checked_before_it_is_used() {
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("a/b");
        check(&folder, 1).unwrap();
        assert_eq!(std::fs::metadata(&folder).unwrap().permissions().mode() & 0o777, 0o700);
        let full = check(&folder, u64::MAX).unwrap_err();
        assert!(full.contains("bytes free, expected"), "{full}");
        std::fs::set_permissions(&folder, PermissionsExt::from_mode(0o777)).unwrap();
        let open = check(&folder, 1).unwrap_err();
        assert!(open.contains("others may write there (mode 0777)"), "{open}");
        let link = parent.path().join("link");
        std::os::unix::fs::symlink(&folder, &link).unwrap();
        std::fs::set_permissions(&folder, PermissionsExt::from_mode(0o700)).unwrap();
        check(&link, 1).unwrap();
        assert!(check_spare(&link).unwrap_err().contains("no link"));
        std::fs::set_permissions(&folder, PermissionsExt::from_mode(0o750)).unwrap();
        assert!(check_spare(&folder).unwrap_err().contains("found mode 0750"));
        assert!(
            check_mount_flags(StatVfsMountFlags::NOEXEC)
                .unwrap_err()
                .contains("noexec")
        );
        let file = parent.path().join("file");
        std::fs::write(&file, "").unwrap();
        assert!(check(&file.join("below"), 1).is_err());
    }
}
