//! Another process in place of this one, where the device's driver is of no use to it any more: the same program with the same arguments, which listens at
//! the same address and asks for the same token. Its number stays, so that whatever watches over it sees no end.

use std::io;
use std::os::unix::process::CommandExt;
use std::process::Command;
use std::sync::PoisonError;

use serde::{Deserialize, Serialize};

use crate::access::Token;
use crate::cli::device::NextEnvironment;
use crate::serve::ListenAddress;

/// Says which file the next process finds [`Handed`] in.
const VARIABLE: &str = "ISOPEEL_RELAUNCHED";

/// What this process has made up, and the next one must not.
#[derive(Serialize, Deserialize)]
struct Handed {
    listen: String,
    token: Option<String>,
}

/// What a process has of the one that it came from.
pub(super) struct Before {
    pub listen: ListenAddress,
    pub token: Option<Token>,
}

/// What there is of a process before this one.
pub(super) fn before() -> Option<Before> {
    let file = std::env::var(VARIABLE).ok()?.parse::<i32>().ok()?;
    let path = format!("/proc/self/fd/{file}");
    let handed: Handed = serde_json::from_slice(&std::fs::read(&path).ok()?).ok()?;
    // The token is nowhere but in the process's memory.
    let _ = std::fs::File::create(path);
    Some(Before {
        listen: handed.listen.parse().ok()?,
        token: handed.token.and_then(|token| Token::of_text(&token)),
    })
}

/// Starts the next process; returns where that cannot be done.
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
        .envs(next.lock().unwrap_or_else(PoisonError::into_inner).drain(..))
        .exec()
}

/// Starts the next process; returns where that cannot be done.
#[cfg(not(target_os = "linux"))]
pub(super) fn relaunch(_: &ListenAddress, _: Option<&Token>, _: &NextEnvironment) -> io::Error {
    io::ErrorKind::Unsupported.into()
}
