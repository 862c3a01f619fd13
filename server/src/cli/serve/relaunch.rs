//! Replaces this process after it can no longer use the driver of the device. The new process runs the same program with the same
//! arguments, listens on the same address, and accepts the same token. The process id does not change, so that a supervisor does not see an
//! end.

use std::io;
use std::os::unix::process::CommandExt;
use std::process::Command;

use serde::{Deserialize, Serialize};

use crate::access::Token;
use crate::cli::device::NextEnvironment;
use crate::serve::ListenAddress;

/// Environment variable with the number of an open file, from which the next process reads a [`Handover`].
const VARIABLE: &str = "ISOPEEL_RELAUNCHED";

/// Address and token as JSON. This process may have chosen them at random, so the next process cannot know them from its arguments.
#[derive(Serialize, Deserialize)]
struct Handover {
    listen: String,
    token: Option<String>,
}

/// Address and token that a process has inherited from the process that it replaces.
pub(super) struct Inherited {
    pub listen: ListenAddress,
    pub token: Option<Token>,
}

/// Returns the address and token of the process that this one replaces, if it replaces one.
pub(super) fn inherited() -> Option<Inherited> {
    let file = std::env::var(VARIABLE).ok()?.parse::<i32>().ok()?;
    let path = format!("/proc/self/fd/{file}");
    let handover: Handover = serde_json::from_slice(&std::fs::read(&path).ok()?).ok()?;
    // Empties the file, so that the token is only in the memory of this process.
    let _ = std::fs::File::create(path);
    Some(Inherited {
        listen: handover.listen.parse().ok()?,
        token: handover.token.and_then(|token| Token::of_text(&token)),
    })
}

/// Replaces this process with the next one. Returns only if that fails.
#[cfg(target_os = "linux")]
pub(super) fn relaunch(listen: &ListenAddress, token: Option<&Token>, next: &NextEnvironment) -> io::Error {
    use std::io::Write;
    use std::os::fd::AsRawFd;

    let handover = Handover {
        listen: listen.to_string(),
        token: token.map(|token| token.text().to_owned()),
    };
    let write_handover = || {
        // A file in memory. `exec` leaves it open for the next process.
        let file = rustix::fs::memfd_create("isopeel", rustix::fs::MemfdFlags::empty())?;
        let mut file = std::fs::File::from(file);
        file.write_all(&serde_json::to_vec(&handover)?)?;
        Ok::<_, io::Error>(file)
    };
    let file = match write_handover() {
        Ok(file) => file,
        Err(error) => return error,
    };
    // Runs the same program even if an update has replaced its file.
    Command::new("/proc/self/exe")
        .args(std::env::args_os().skip(1))
        .env(VARIABLE, file.as_raw_fd().to_string())
        .envs(next.take())
        .exec()
}

/// Returns an error, because the process can be replaced only on Linux.
#[cfg(not(target_os = "linux"))]
pub(super) fn relaunch(_: &ListenAddress, _: Option<&Token>, _: &NextEnvironment) -> io::Error {
    io::ErrorKind::Unsupported.into()
}
