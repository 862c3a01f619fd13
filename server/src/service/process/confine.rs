//! Confinement of the process of the device by Landlock: a driver that is taken over by an expression or a volume cannot read what the
//! server keeps, cannot write except where drivers must, cannot use TCP, and cannot signal other processes.
//!
//! Landlock denies what no rule allows. Rules allow a file, or a folder with all that is beneath it. So all files except some are allowed
//! by the entries of each folder that leads to one of these.

use std::collections::{HashSet, VecDeque};
use std::fs::File;
use std::io::{self, Read, Seek, Write};
use std::os::fd::{FromRawFd, OwnedFd, RawFd};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::device::cache;
use crate::error::chain;

/// Maximum number of rules about reading. Entries beyond it cannot be used: folders at the top come first, which drivers need.
const MAX_RULES: usize = 10_000;

/// Folders of the system. They stay readable, except hidden paths beneath them, even if a folder above them is hidden.
const SYSTEM_FOLDERS: [&str; 11] = [
    "/bin",
    "/dev",
    "/etc",
    "/lib",
    "/lib32",
    "/lib64",
    "/nix/store",
    "/opt",
    "/proc",
    "/sys",
    "/usr",
];

/// Folder of device files. Device files beneath it may be used, except those in [`raw_memory`].
const DEVICE_FILES: &str = "/dev";

/// Folder of shared memory, in which drivers make files.
const SHARED_MEMORY: &str = "/dev/shm";

/// Settings of the process itself, such as names of threads.
const OWN_SETTINGS: &str = "/proc/self";

/// What the process of the device may do with files.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Confinement {
    /// Files and folders that it must not use, without symbolic links.
    hidden: Vec<PathBuf>,
    /// Folders in which it may write.
    writable: Vec<PathBuf>,
    /// Its folder of temporary files, which is one of `writable`.
    temporary: Option<PathBuf>,
}

impl Confinement {
    /// Returns the confinement that hides these paths, and lets the process write to folders of compiled kernels, and to a folder of
    /// temporary files of its own. Makes folders that do not exist.
    ///
    /// The usual folder of temporary files stays read-only: other programs have files there, and some of these may be hidden.
    pub(super) fn hiding(paths: &[PathBuf]) -> Self {
        let temporary = cache::temporary_folder();
        let folders = cache::kernel_folders().into_iter().chain(temporary.clone());
        Self {
            hidden: paths.iter().filter_map(|path| real(path)).collect(),
            writable: folders.filter_map(|folder| folder.canonicalize().ok()).collect(),
            temporary,
        }
    }

    /// Returns the value of `TMPDIR` for the process.
    pub(super) fn temporary(&self) -> Option<&Path> {
        self.temporary.as_deref()
    }

    /// Writes the confinement to a file in memory, for [`confine`].
    ///
    /// # Errors
    /// The system has no memory left.
    pub(super) fn to_file(&self) -> io::Result<OwnedFd> {
        let file = rustix::fs::memfd_create("isopeel-confinement", rustix::fs::MemfdFlags::CLOEXEC)?;
        let mut file = File::from(file);
        file.write_all(&postcard::to_stdvec(self).map_err(io::Error::other)?)?;
        file.rewind()?;
        Ok(file.into())
    }

    fn from_file(file: OwnedFd) -> io::Result<Self> {
        let mut bytes = Vec::new();
        File::from(file).read_to_end(&mut bytes)?;
        postcard::from_bytes(&bytes).map_err(io::Error::other)
    }
}

/// Returns a path without symbolic links. If the file does not exist, its folder must; else returns `None`.
fn real(path: &Path) -> Option<PathBuf> {
    path.canonicalize().ok().or_else(|| {
        let folder = path.parent().filter(|folder| *folder != Path::new(""));
        let folder = folder.unwrap_or(Path::new(".")).canonicalize().ok()?;
        Some(folder.join(path.file_name()?))
    })
}

/// Hidden paths, and the folders above them.
struct Hidden {
    paths: HashSet<PathBuf>,
    above: HashSet<PathBuf>,
}

impl Hidden {
    fn new(paths: impl IntoIterator<Item = PathBuf>) -> Self {
        let paths: HashSet<_> = paths.into_iter().collect();
        let above = paths.iter().flat_map(|path| path.ancestors().skip(1));
        Self {
            above: above.map(Path::to_owned).collect(),
            paths,
        }
    }

    /// Whether a path or a folder above it is hidden.
    fn contains(&self, path: &Path) -> bool {
        path.ancestors().any(|path| self.paths.contains(path))
    }

    /// Returns files and folders that together have all in `folder` that is not hidden, at most `limit` of them, those at the top first.
    /// If a folder has hidden entries, it is not among them: its other entries are.
    ///
    /// Symbolic links are not among them, because what they lead to is allowed or hidden by its own path.
    fn others_in(&self, folder: &Path, limit: usize) -> Vec<PathBuf> {
        let (mut found, mut folders) = (Vec::new(), VecDeque::from([folder.to_owned()]));
        while let Some(folder) = folders.pop_front() {
            if !self.above.contains(&folder) {
                found.push(folder);
                continue;
            }
            // A folder that cannot be listed stays hidden.
            let entries = std::fs::read_dir(&folder).into_iter().flatten().flatten();
            for entry in entries {
                let path = entry.path();
                let is_link = entry.file_type().is_ok_and(|kind| kind.is_symlink());
                if is_link || self.paths.contains(&path) {
                    continue;
                }
                if self.above.contains(&path) {
                    folders.push_back(path);
                } else if found.len() < limit {
                    found.push(path);
                } else {
                    return found;
                }
            }
        }
        found
    }
}

/// Returns the files by which a privileged process could read disks and memory, as far as this process may read them.
fn raw_memory() -> Vec<PathBuf> {
    use std::os::unix::fs::FileTypeExt;
    let is_disk = |entry: &std::fs::DirEntry| entry.file_type().is_ok_and(|kind| kind.is_block_device());
    let folders = [DEVICE_FILES, "/dev/mapper"];
    let entries = folders.iter().flat_map(std::fs::read_dir).flatten().flatten();
    let disks = entries.filter(is_disk).map(|entry| entry.path());
    let memory = ["/dev/mem", "/dev/kmem", "/dev/port", "/proc/kcore"].map(PathBuf::from);
    let may_read = |path: &PathBuf| rustix::fs::access(path, rustix::fs::Access::READ_OK).is_ok();
    disks.chain(memory).filter(may_read).collect()
}

/// How far this process is confined.
#[derive(Debug)]
#[must_use]
pub enum Confined {
    /// By all rules.
    Fully,
    /// By the rules that the kernel knows: older ones do not know those about TCP, device files or signals.
    Partly,
    /// The kernel has no Landlock.
    NotSupported,
    /// The server has not asked for it.
    NotWanted,
    /// The rules cannot be made or set; the text says why.
    Failed(String),
}

impl Confined {
    /// Logs how far this process is confined.
    pub fn log(&self) {
        match self {
            Self::NotWanted => {}
            Self::Fully => tracing::info!("the process of the device is confined"),
            Self::Partly => {
                tracing::info!(
                    "the process of the device is confined as far as this kernel can; a later one can do more"
                );
            }
            Self::NotSupported => {
                tracing::info!(
                    "the process of the device is not confined: the kernel has no Landlock, or a filter of system calls denies it"
                );
            }
            Self::Failed(why) => tracing::warn!("the process of the device is not confined: {why}"),
        }
    }
}

/// Confines this process by the rules in an open file, which it has inherited. It must have one thread only: the others would not be
/// confined, and an intruder can use all threads of a process.
pub fn confine(file: RawFd) -> Confined {
    // SAFETY: the server has opened this file for this process, which uses it nowhere else.
    let file = unsafe { OwnedFd::from_raw_fd(file) };
    let confinement = match Confinement::from_file(file) {
        Ok(confinement) => confinement,
        Err(error) => return Confined::Failed(format!("its rules cannot be read: {}", chain(&error))),
    };
    let threads = std::fs::read_dir("/proc/self/task").map_or(1, Iterator::count);
    if threads > 1 {
        return Confined::Failed(format!("it has {threads} threads already, expected one"));
    }
    system::restrict(&confinement)
}

#[cfg(target_os = "linux")]
pub use system::landlock_version;

#[cfg(target_os = "linux")]
mod system {
    use std::os::fd::{AsFd, OwnedFd};
    use std::os::unix::fs::MetadataExt;

    use landlock::{
        ABI, Access, AccessFs, AccessNet, BitFlags, PathBeneath, Ruleset, RulesetAttr, RulesetCreated,
        RulesetCreatedAttr, RulesetError, RulesetStatus, Scope, make_bitflags,
    };
    use rustix::fs::{FileType, Mode, OFlags};

    use super::*;

    /// The rules are those of Linux 6.12. The kernel ignores those that it does not know.
    const VERSION: ABI = ABI::V6;

    /// Rights to use files and folders.
    const READ: BitFlags<AccessFs> = make_bitflags!(AccessFs::{Execute | ReadFile | ReadDir});

    /// Rights to change files.
    const CHANGE: BitFlags<AccessFs> = make_bitflags!(AccessFs::{WriteFile | Truncate});

    /// Rights to make and remove files and folders. Device files are not among them: they would open disks to a privileged process.
    const MAKE: BitFlags<AccessFs> = make_bitflags!(AccessFs::{
        MakeReg | MakeDir | MakeSym | MakeFifo | MakeSock | RemoveFile | RemoveDir | Refer
    });

    /// Returns the version of the kernel's Landlock; 0 or less if it has none, or if it is not enabled.
    pub fn landlock_version() -> i64 {
        const QUERY_VERSION: libc::c_uint = 1;
        // SAFETY: the call only returns a number.
        unsafe {
            libc::syscall(
                libc::SYS_landlock_create_ruleset,
                std::ptr::null::<libc::c_void>(),
                0usize,
                QUERY_VERSION,
            )
        }
    }

    pub(super) fn restrict(confinement: &Confinement) -> Confined {
        match try_restrict(confinement) {
            Ok(RulesetStatus::FullyEnforced) => Confined::Fully,
            Ok(RulesetStatus::PartiallyEnforced) => Confined::Partly,
            Ok(RulesetStatus::NotEnforced) => Confined::NotSupported,
            Err(error) => Confined::Failed(chain(&error)),
        }
    }

    fn try_restrict(confinement: &Confinement) -> Result<RulesetStatus, RulesetError> {
        let hidden = Hidden::new(confinement.hidden.iter().cloned().chain(raw_memory()));
        let mut rules = Ruleset::default()
            .handle_access(AccessFs::from_all(VERSION))?
            .handle_access(AccessNet::from_all(VERSION))?
            .scope(Scope::Signal)?
            .create()?;
        let hidden_files = identities(&hidden.paths);
        let mut allow = |folder: &Path, rights| allow(&mut rules, &hidden, &hidden_files, folder, rights);
        if !hidden.contains(Path::new("/")) {
            allow(Path::new("/"), READ)?;
        }
        let program = std::env::current_exe().ok();
        for path in SYSTEM_FOLDERS.iter().map(PathBuf::from).chain(program) {
            match path.canonicalize() {
                // The others are allowed already.
                Ok(path) if hidden.contains(&path) => allow(&path, READ)?,
                _ => {}
            }
        }
        for folder in &confinement.writable {
            allow(folder, READ | CHANGE | MAKE)?;
        }
        for (folder, rights) in [
            (DEVICE_FILES, CHANGE | AccessFs::IoctlDev),
            (SHARED_MEMORY, CHANGE | MAKE),
            (OWN_SETTINGS, CHANGE),
        ] {
            if let Ok(folder) = Path::new(folder).canonicalize() {
                allow(&folder, rights)?;
            }
        }
        Ok(rules.restrict_self()?.ruleset)
    }

    /// Allows all in a folder that is not hidden. Skips files that cannot be opened, and other names of hidden files.
    fn allow(
        rules: &mut RulesetCreated,
        hidden: &Hidden,
        hidden_files: &HashSet<(u64, u64)>,
        folder: &Path,
        rights: BitFlags<AccessFs>,
    ) -> Result<(), RulesetError> {
        for path in hidden.others_in(folder, MAX_RULES) {
            let Ok(file) = rustix::fs::open(&path, OFlags::PATH | OFlags::NOFOLLOW | OFlags::CLOEXEC, Mode::empty())
            else {
                continue;
            };
            let Ok(status) = rustix::fs::fstat(&file) else { continue };
            let rights = match FileType::from_raw_mode(status.st_mode) {
                FileType::Symlink => continue,
                FileType::Directory => rights,
                // Rights for folders are errors for other files.
                _ if hidden_files.contains(&(status.st_dev, status.st_ino)) => continue,
                _ => rights & AccessFs::from_file(VERSION),
            };
            rules.add_rule(PathBeneath::new::<_>(file.as_fd(), rights))?;
            drop::<OwnedFd>(file);
        }
        Ok(())
    }

    /// Returns the device and inode numbers of files.
    fn identities(files: &HashSet<PathBuf>) -> HashSet<(u64, u64)> {
        let statuses = files.iter().filter_map(|file| std::fs::metadata(file).ok());
        statuses.map(|status| (status.dev(), status.ino())).collect()
    }
}

#[cfg(not(target_os = "linux"))]
mod system {
    use super::*;

    pub(super) fn restrict(_: &Confinement) -> Confined {
        Confined::NotSupported
    }
}

/// Returns the version of the kernel's Landlock: this system has none.
#[cfg(not(target_os = "linux"))]
pub fn landlock_version() -> i64 {
    0
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use tempfile::TempDir;

    use super::*;

    /// A folder with these files; the name of a folder ends with a slash.
    fn tree(files: &[&str]) -> (TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().canonicalize().unwrap();
        for file in files {
            let path = path.join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            match file.strip_suffix('/') {
                Some(_) => std::fs::create_dir_all(path).unwrap(),
                None => std::fs::write(path, "").unwrap(),
            }
        }
        (folder, path)
    }

    /// What is allowed in a folder if these paths are hidden, relative to it.
    fn others(root: &Path, hidden: &[&str], folder: &str) -> BTreeSet<String> {
        let hidden = Hidden::new(hidden.iter().map(|path| real(&root.join(path)).unwrap()));
        let found = hidden.others_in(&real(&root.join(folder)).unwrap(), MAX_RULES);
        let relative = |path: PathBuf| path.strip_prefix(root).unwrap().to_str().unwrap().to_owned();
        found.into_iter().map(relative).collect()
    }

    fn set(paths: &[&str]) -> BTreeSet<String> {
        paths.iter().map(|&path| path.to_owned()).collect()
    }

    #[test]
    fn all_but_hidden_files_and_folders_is_allowed() {
        let (_folder, root) = tree(&["a/b/secret", "a/b/c", "a/d/e/f", "g", "volumes/one", "volumes/two"]);
        assert_eq!(others(&root, &[], ""), set(&[""]), "the folder as a whole");
        assert_eq!(
            others(&root, &["a/b/secret", "volumes"], ""),
            set(&["a/b/c", "a/d", "g"])
        );
        // A hidden path in a hidden folder changes nothing.
        assert_eq!(
            others(&root, &["volumes", "volumes/one", "g"], ""),
            others(&root, &["volumes", "g"], "")
        );
        // A folder above a hidden one, and one beside it.
        assert_eq!(others(&root, &["a/b/secret"], "a"), set(&["a/b/c", "a/d"]));
        assert_eq!(others(&root, &["a/b/secret"], "volumes"), set(&["volumes"]));
        // What does not exist yet is hidden before it exists.
        assert_eq!(others(&root, &["a/later"], "a"), set(&["a/b", "a/d"]));
    }

    #[test]
    fn a_folder_that_is_allowed_beneath_a_hidden_one_keeps_what_is_hidden_in_it() {
        let (_folder, root) = tree(&[
            "home/.cache/kernels/",
            "home/volume",
            "home/.cache/other/volume",
            "home/.cache/other/a",
        ]);
        let hidden = ["home", "home/.cache/other/volume"];
        assert_eq!(others(&root, &hidden, ""), set(&[]));
        assert_eq!(
            others(&root, &hidden, "home/.cache/kernels"),
            set(&["home/.cache/kernels"])
        );
        assert_eq!(
            others(&root, &hidden, "home/.cache/other"),
            set(&["home/.cache/other/a"])
        );
    }

    #[test]
    fn links_are_hidden_with_what_they_lead_to() {
        use std::os::unix::fs::symlink;
        let (_folder, root) = tree(&["store/volume", "store/other", "named/readme"]);
        symlink(root.join("store/volume"), root.join("named/volume")).unwrap();
        symlink(root.join("store"), root.join("stored")).unwrap();
        for path in ["named/volume", "stored/volume"] {
            assert_eq!(others(&root, &[path], ""), set(&["named", "store/other"]), "{path}");
        }
        // A link in a folder whose entries are allowed one by one is not one of them.
        assert_eq!(
            others(&root, &["named/volume", "named/readme"], ""),
            set(&["store/other"])
        );
        assert_eq!(real(Path::new("https://volumes.example/a")), None);
    }

    #[test]
    fn the_number_of_rules_is_limited_and_folders_at_the_top_come_first() {
        let files: Vec<_> = (0..50).map(|n| format!("many/{n}")).collect();
        let files: Vec<_> = files
            .iter()
            .map(String::as_str)
            .chain(["top/a", "many/secret"])
            .collect();
        let (_folder, root) = tree(&files);
        let hidden = Hidden::new([root.join("many/secret")]);
        let found = hidden.others_in(&root, 10);
        assert_eq!((found.len(), &found[0]), (10, &root.join("top")));
    }

    #[test]
    fn a_confinement_arrives_as_it_was_sent() {
        let confinement = Confinement {
            hidden: vec!["/a".into()],
            writable: vec!["/b".into(), "/c".into()],
            temporary: Some("/c".into()),
        };
        let file = confinement.to_file().unwrap();
        assert_eq!(Confinement::from_file(file).unwrap(), confinement);
    }
}
