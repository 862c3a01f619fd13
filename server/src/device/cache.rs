//! The folder of this user's compiled kernels and of verdicts on devices.

use std::path::{Path, PathBuf};

/// What names the folder.
pub const VARIABLE: &str = "ISOPEEL_KERNEL_CACHE";

/// Variables that set where drivers keep compiled kernels, and the folders below ours.
const DRIVERS: [(&str, &str); 3] = [
    ("POCL_CACHE_DIR", "pocl"),
    ("CUDA_CACHE_PATH", "nvidia"),
    ("MESA_SHADER_CACHE_DIR", "mesa"),
];

/// The folder: `ISOPEEL_KERNEL_CACHE`, else `isopeel` in the user's cache folder. `None`: the user has none.
pub fn folder() -> Option<PathBuf> {
    let path = |name: &str| {
        std::env::var_os(name)
            .filter(|value| !value.is_empty())
            .map(PathBuf::from)
    };
    path(VARIABLE)
        .or_else(|| path("XDG_CACHE_HOME").map(|cache| cache.join("isopeel")))
        .or_else(|| path("HOME").map(|home| home.join(".cache/isopeel")))
}

/// Where drivers keep compiled kernels, if `ISOPEEL_KERNEL_CACHE` names a folder and nothing else is set: variables for the environment.
pub fn driver_folders() -> Vec<(&'static str, PathBuf)> {
    if std::env::var_os(VARIABLE).is_none() {
        return Vec::new();
    }
    let Some(folder) = folder() else { return Vec::new() };
    let unset = DRIVERS.into_iter().filter(|(name, _)| std::env::var_os(name).is_none());
    unset.map(|(name, below)| (name, folder.join(below))).collect()
}

/// Makes a folder that only this user may read.
pub(super) fn make(folder: &Path) -> std::io::Result<()> {
    use std::os::unix::fs::DirBuilderExt;
    std::fs::DirBuilder::new().recursive(true).mode(0o700).create(folder)
}
