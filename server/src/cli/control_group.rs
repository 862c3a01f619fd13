//! Memory limits of Linux control groups: those of containers, of jobs of a batch system such as Slurm, and of services of systemd.

use std::path::{Path, PathBuf};

use isopeel_extraction::limit_host_memory;

/// Larger limits are none: version 1 writes the largest number of whole pages.
const MAX_LIMIT: u64 = 1 << 60;

/// Limits the host memory of this process to that of `--host-memory`, if it is given, and to that of its control groups. Call this once,
/// before any other work.
pub(super) fn limit_memory(option_bytes: Option<u64>) {
    let limits = [option_bytes, memory_limit()];
    limits
        .into_iter()
        .flatten()
        .min()
        .into_iter()
        .for_each(limit_host_memory);
}

/// Returns the smallest memory limit of this process's control group and of the groups above it that the system shows, in bytes.
fn memory_limit() -> Option<u64> {
    let read = |name: &str| std::fs::read_to_string(name).ok();
    smallest_limit(&read("/proc/self/cgroup")?, &read("/proc/self/mountinfo")?)
}

/// As [`memory_limit`], with the text of `/proc/self/cgroup` and `/proc/self/mountinfo`.
fn smallest_limit(groups: &str, mounts: &str) -> Option<u64> {
    let hierarchies = mounts.lines().filter_map(Hierarchy::mounted);
    hierarchies.filter_map(|hierarchy| hierarchy.limit(groups)).min()
}

/// A mounted hierarchy of control groups.
struct Hierarchy {
    mount_point: PathBuf,
    /// Group that is at the mount point.
    root: PathBuf,
    /// File of a group that has its limit.
    file: &'static str,
}

impl Hierarchy {
    /// Returns the hierarchy of a line of `/proc/self/mountinfo`, if it may limit memory.
    fn mounted(line: &str) -> Option<Self> {
        let (mount, kind) = line.split_once(" - ")?;
        let kind: Vec<&str> = kind.split(' ').collect();
        let file = match *kind.first()? {
            "cgroup2" => "memory.max",
            "cgroup" if kind.last()?.split(',').any(|option| option == "memory") => "memory.limit_in_bytes",
            _ => return None,
        };
        // Number, number of the parent, device, root, mount point.
        let mut paths = mount.split(' ').skip(3).map(PathBuf::from);
        let (root, mount_point) = (paths.next()?, paths.next()?);
        Some(Self {
            mount_point,
            root,
            file,
        })
    }

    /// Returns the path of this process's group in `/proc/self/cgroup`.
    fn group<'a>(&self, groups: &'a str) -> Option<&'a Path> {
        // Number, controllers, path. Version 2 has number 0 and names no controllers.
        let mut lines = groups.lines().map(|line| line.splitn(3, ':').collect::<Vec<_>>());
        let is_own = |controllers: &str| match self.file {
            "memory.max" => controllers.is_empty(),
            _ => controllers.split(',').any(|controller| controller == "memory"),
        };
        lines.find_map(|line| match line[..] {
            [_, controllers, path] if is_own(controllers) => Some(Path::new(path)),
            _ => None,
        })
    }

    /// Returns the smallest limit of a group and of those above it, up to the mount point.
    fn limit(&self, groups: &str) -> Option<u64> {
        let group = self.group(groups)?;
        // A container may see the path of its group outside, and have the group itself at the mount point.
        let below = group.strip_prefix(&self.root).unwrap_or(Path::new(""));
        let limits = below.ancestors().filter_map(|group| {
            let text = std::fs::read_to_string(self.mount_point.join(group).join(self.file)).ok()?;
            text.trim().parse::<u64>().ok().filter(|&limit| limit < MAX_LIMIT)
        });
        limits.min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A hierarchy with these limits, in a folder that stands for its mount point.
    fn mounted(limits: &[(&str, &str)]) -> (tempfile::TempDir, String) {
        let folder = tempfile::tempdir().unwrap();
        for (file, limit) in limits {
            let file = folder.path().join(file);
            std::fs::create_dir_all(file.parent().unwrap()).unwrap();
            std::fs::write(file, format!("{limit}\n")).unwrap();
        }
        let path = folder.path().display().to_string();
        (folder, path)
    }

    #[test]
    fn the_smallest_limit_of_a_job_and_the_groups_above_it_counts() {
        let (_folder, path) = mounted(&[
            ("slurm/job_7/step_0/memory.max", "max"),
            ("slurm/job_7/memory.max", "3000"),
            ("slurm/memory.max", "5000"),
        ]);
        let mounts = format!("24 23 0:22 / {path} rw,nosuid shared:4 - cgroup2 cgroup2 rw,nsdelegate");
        assert_eq!(smallest_limit("0::/slurm/job_7/step_0\n", &mounts), Some(3000));
        assert_eq!(smallest_limit("0::/slurm\n", &mounts), Some(5000));
        assert_eq!(smallest_limit("0::/other\n", &mounts), None, "a group without a limit");
        assert_eq!(smallest_limit("", &mounts), None);
    }

    #[test]
    fn version_1_has_its_limit_in_another_file() {
        let (_folder, path) = mounted(&[
            ("docker/c/memory.limit_in_bytes", "2000"),
            ("memory.limit_in_bytes", "9223372036854771712"),
        ]);
        let mounts = format!(
            "30 24 0:26 / {path} rw - cgroup cgroup rw,memory\n31 24 0:27 / {path}/docker/c rw - cgroup cgroup rw,cpu,cpuacct\n\
             32 24 0:28 / /none rw - cgroup2 cgroup2 rw"
        );
        let groups = "5:cpu,cpuacct:/\n4:memory:/docker/c\n0::/docker/c\n";
        assert_eq!(smallest_limit(groups, &mounts), Some(2000));
        assert_eq!(smallest_limit("4:memory:/\n", &mounts), None, "no limit");
    }

    #[test]
    fn a_container_has_its_group_at_the_mount_point() {
        let (_folder, path) = mounted(&[("memory.limit_in_bytes", "2000")]);
        let mounts = format!("30 24 0:26 /docker/c {path} ro - cgroup memory rw,memory");
        assert_eq!(smallest_limit("4:memory:/docker/c\n", &mounts), Some(2000));
        let mounts = format!("30 24 0:26 /../.. {path} ro - cgroup memory rw,memory");
        assert_eq!(
            smallest_limit("4:memory:/\n", &mounts),
            Some(2000),
            "a mount of another namespace"
        );
    }
}
