//! Checks the resource limits of the process at the start. Without this check, libraries and drivers would abort the process when they
//! reach a limit.

use std::io;
use std::num::NonZero;
use std::sync::RwLock;

/// Minimum address space in bytes. Twice as much as a server uses after its start.
const ADDRESS_BYTES: u64 = 2 << 30;

/// Minimum limit of the size of files in bytes. Compiled kernels have some megabytes; uploads and results have more.
const FILE_BYTES: u64 = 64 << 20;

/// Number of threads that must be possible in addition to four per processor. Threads of sockets, pools, the device and its driver need
/// them.
const THREADS: usize = 16;

/// A limit that is too low.
#[derive(Debug, thiserror::Error)]
pub enum LimitError {
    /// The limit of the address space.
    #[error(
        "this process may have {0} bytes of address space, expected {ADDRESS_BYTES} or more: raise the limit (ulimit -v, LimitAS= of systemd); \
         --host-memory bounds what volumes and surfaces take"
    )]
    AddressSpace(u64),
    /// The limit of the size of files.
    #[error(
        "files that this process writes may have {0} bytes, expected {FILE_BYTES} or more: raise the limit (ulimit -f, LimitFSIZE= of systemd)"
    )]
    FileSize(u64),
    /// The limit of the number of threads.
    #[error(
        "the system does not let this process start {0} threads: raise the limit (ulimit -u, LimitNPROC= and TasksMax= of systemd, --pids-limit of \
         containers)"
    )]
    Threads(usize, #[source] io::Error),
}

/// Checks the limits of this process. Also ignores SIGXFSZ, so that a write beyond the limit of the file size fails, but does not end the
/// process.
///
/// # Errors
/// A limit is too low. The message says how to raise it.
pub fn check() -> Result<(), LimitError> {
    #[cfg(unix)]
    {
        use rustix::process::{Resource, getrlimit};
        check_sizes(getrlimit(Resource::As).current, getrlimit(Resource::Fsize).current)?;
        // SAFETY: the signal is ignored; no handler runs.
        unsafe { libc::signal(libc::SIGXFSZ, libc::SIG_IGN) };
    }
    let processors = std::thread::available_parallelism().map_or(1, NonZero::get);
    let threads = THREADS + 4 * processors;
    start_threads(threads, None).map_err(|error| LimitError::Threads(threads, error))
}

fn check_sizes(address_space: Option<u64>, file: Option<u64>) -> Result<(), LimitError> {
    match (address_space, file) {
        (Some(bytes), _) if bytes < ADDRESS_BYTES => Err(LimitError::AddressSpace(bytes)),
        (_, Some(bytes)) if bytes < FILE_BYTES => Err(LimitError::FileSize(bytes)),
        _ => Ok(()),
    }
}

/// Starts `count` threads at the same time, and waits for their end.
fn start_threads(count: usize, stack_bytes: Option<usize>) -> io::Result<()> {
    // The write lock makes all threads wait until the last one was started.
    let gate = RwLock::new(());
    std::thread::scope(|scope| {
        let write_lock = gate.write();
        let started = (0..count).try_for_each(|_| {
            let mut thread = std::thread::Builder::new();
            if let Some(bytes) = stack_bytes {
                thread = thread.stack_size(bytes);
            }
            thread.spawn_scoped(scope, || drop(gate.read())).map(drop)
        });
        drop(write_lock);
        started
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_that_are_too_low_are_named_with_their_remedy() {
        assert!(check_sizes(None, None).is_ok());
        assert!(check_sizes(Some(ADDRESS_BYTES), Some(FILE_BYTES)).is_ok());
        let memory = check_sizes(Some(1 << 30), None).unwrap_err().to_string();
        assert!(
            memory.contains("1073741824 bytes of address space, expected 2147483648 or more"),
            "{memory}"
        );
        assert!(memory.contains("ulimit -v"), "{memory}");
        let file = check_sizes(None, Some(1024)).unwrap_err().to_string();
        assert!(
            file.contains("may have 1024 bytes") && file.contains("ulimit -f"),
            "{file}"
        );
        assert!(start_threads(8, None).is_ok());
        // No thread has so large a stack.
        let refused = start_threads(8, Some(1 << 50)).unwrap_err();
        let threads = LimitError::Threads(8, refused).to_string();
        assert!(
            threads.contains("start 8 threads") && threads.contains("ulimit -u"),
            "{threads}"
        );
    }
}
