//! Replaces this process if it can no longer use the device's driver. The new process is the same program with the same arguments; it
//! listens at the same address and accepts the same token. It keeps the process id, so a supervisor does not see the old one end.

use std::io;
use std::os::unix::process::CommandExt;
use std::process::Command;

use serde::{Deserialize, Serialize};

use crate::access::Token;
use crate::cli::device::NextEnvironment;
use crate::serve::ListenAddress;

/// Says which file the next process finds [`Handed`] in.
const VARIABLE: &str = "ISOPEEL_RELAUNCHED";

/// What this process has chosen itself (port, token), and the next one has to keep.
#[derive(Serialize, Deserialize)]
struct Handed {
    listen: String,
    token: Option<String>,
}

/// What a process takes over from the one that it replaces.
pub(super) struct Before {
    pub listen: ListenAddress,
    pub token: Option<Token>,
}

/// Returns what the process before this one handed over; `None` if there was none.
pub(super) fn before() -> Option<Before> {
    let file = std::env::var(VARIABLE).ok()?.parse::<i32>().ok()?;
    let path = format!("/proc/self/fd/{file}");
    let handed: Handed = serde_json::from_slice(&std::fs::read(&path).ok()?).ok()?;
    // Empties the file, so that the token is only in the memory of this process.
    let _ = std::fs::File::create(path);
    Some(Before {
        listen: handed.listen.parse().ok()?,
        token: handed.token.and_then(|token| Token::of_text(&token)),
    })
}

/// Replaces this process with the next one. Returns only if that fails.
#[cfg(target_os = "linux")]
pub(super) fn relaunch(listen: &ListenAddress, token: Option<&Token>, next: &NextEnvironment) -> io::Error {
    use std::io::Write;
    use std::os::fd::AsRawFd;

    let handed = Handed {
        listen: listen.to_string(),
        token: token.map(|token| token.text().to_owned()),
    };
    let hand = || {
        // In memory, and left open for the next process.
        let file = rustix::fs::memfd_create("isopeel", rustix::fs::MemfdFlags::empty())?;
        let mut file = std::fs::File::from(file);
        file.write_all(&serde_json::to_vec(&handed)?)?;
        Ok::<_, io::Error>(file)
    };
    let file = match hand() {
        Ok(file) => file,
        Err(error) => return error,
    };
    // The program as it was started, even if its file was replaced meanwhile.
    Command::new("/proc/self/exe")
        .args(std::env::args_os().skip(1))
        .env(VARIABLE, file.as_raw_fd().to_string())
        .envs(next.take())
        .exec()
}

/// Returns an error: only Linux can replace the process.
#[cfg(not(target_os = "linux"))]
pub(super) fn relaunch(_: &ListenAddress, _: Option<&Token>, _: &NextEnvironment) -> io::Error {
    io::ErrorKind::Unsupported.into()
}
