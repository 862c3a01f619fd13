//! `isopeel token`: manages the named tokens of a server.

use std::path::PathBuf;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use clap::Subcommand;
use serde::Serialize;

use crate::access::{NamedToken, NewToken, Role, Roles, TokenFile, TokenFileError};
use crate::jobs::{StateFolder, StateFolderError};
use crate::private_folder::FolderAccess;

/// Arguments of `isopeel token`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// State folder of the server, which may be running: it knows of a change within 5 s. Made where there is none
    #[arg(long, global = true, value_name = "DIR", env = "ISOPEEL_STATE_FOLDER")]
    state_folder: Option<PathBuf>,

    /// Who may use the state folder: this user alone, or its group too
    #[arg(
        long,
        global = true,
        value_enum,
        default_value_t,
        value_name = "WHO",
        env = "ISOPEEL_FOLDER_ACCESS"
    )]
    folder_access: FolderAccess,

    /// What to do.
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Make a token and print it, this once: nobody can ask for it again
    Create {
        /// Whose it is: batch jobs belong to their user, whichever of their tokens they use
        #[arg(long, value_name = "NAME")]
        user: String,

        /// What it is for: view, edit (and view), export, upload, push (for nothing yet), or admin (all of these); may be given again
        #[arg(long, value_name = "ROLE", required = true)]
        role: Vec<Role>,

        /// How long it lasts: 30d, 12h, 90m or 45s [default: until it is revoked]
        #[arg(long, value_name = "TIME", value_parser = lifetime)]
        expires: Option<Duration>,
    },
    /// List all tokens by their ids, without their secrets
    List {
        /// Print JSON, times in seconds since 1970
        #[arg(long)]
        json: bool,
    },
    /// Remove a token: within 5 s it lets nobody in, and connections of its owner are closed
    Revoke {
        /// Id, the part of the token between its two first `_`
        #[arg(value_name = "ID")]
        id: String,
    },
}

/// Why the command has failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CommandError {
    /// No state folder is given.
    #[error("expected --state-folder DIR, the folder that the server is started with")]
    NoFolder,
    /// The state folder cannot be used.
    #[error(transparent)]
    Folder(#[from] StateFolderError),
    /// The tokens cannot be read or changed.
    #[error(transparent)]
    File(#[from] TokenFileError),
    /// Stdout is closed.
    #[error("the tokens cannot be printed")]
    Print(#[from] std::io::Error),
}

/// Runs a command.
///
/// # Errors
/// [`CommandError`].
pub fn run(args: &Args) -> Result<(), CommandError> {
    let folder = args.state_folder.as_deref().ok_or(CommandError::NoFolder)?;
    let file = TokenFile::in_folder(&StateFolder::prepare(folder, args.folder_access)?);
    match &args.command {
        Command::Create { user, role, expires } => {
            let (token, entry) = file.create(NewToken {
                user: user.clone(),
                roles: role.clone().into(),
                lifetime: *expires,
            })?;
            eprintln!("isopeel: {}", line(&entry, now()));
            if role.contains(&Role::Push) {
                eprintln!("isopeel: the role push is for nothing: this server takes no time steps that are sent to it");
            }
            super::print(format!("{}\n", token.text()).as_bytes())?;
        }
        Command::List { json: false } => {
            let now = now();
            let lines: String = file.list()?.iter().map(|token| line(token, now) + "\n").collect();
            super::print(lines.as_bytes())?;
        }
        Command::List { json: true } => {
            let tokens = file.list()?;
            let listed: Vec<Listed<'_>> = tokens.iter().map(Listed::of).collect();
            let mut text = serde_json::to_vec(&listed).map_err(std::io::Error::from)?;
            text.push(b'\n');
            super::print(&text)?;
        }
        Command::Revoke { id } => eprintln!("isopeel: revoked {}", line(&file.revoke(id)?, now())),
    }
    Ok(())
}

/// A token in the JSON of a list, without its hashes.
#[derive(Serialize)]
struct Listed<'a> {
    id: &'a str,
    user: &'a str,
    roles: Roles,
    created: u64,
    expires: Option<u64>,
}

impl<'a> Listed<'a> {
    fn of(token: &'a NamedToken) -> Self {
        Self {
            id: &token.id,
            user: &token.user,
            roles: token.roles,
            created: token.created,
            expires: token.expires,
        }
    }
}

/// Formats a token as a line of a list.
fn line(token: &NamedToken, now: u64) -> String {
    let expires = match token.expires {
        None => "until it is revoked".to_owned(),
        Some(_) if token.has_expired(now) => "expired".to_owned(),
        Some(expires) => format!("for {} more", span(expires - now)),
    };
    let age = span(now.saturating_sub(token.created));
    format!(
        "{}  {}  {}  made {age} ago, {expires}",
        token.id, token.user, token.roles
    )
}

/// Units of time, and their lengths in seconds.
const UNITS: [(&str, u64); 4] = [("d", 86_400), ("h", 3_600), ("m", 60), ("s", 1)];

/// Formats a time in the largest unit that is not longer than the time.
fn span(seconds: u64) -> String {
    let (unit, size) = UNITS.into_iter().find(|&(_, size)| seconds >= size).unwrap_or(("s", 1));
    format!("{} {unit}", seconds / size)
}

/// Parses a time such as `30d`.
pub(super) fn lifetime(text: &str) -> Result<Duration, String> {
    let refuse = || format!("{text:?}, expected a number and d, h, m or s, such as 30d");
    let units = UNITS.into_iter();
    let mut parsed = units.filter_map(|(unit, size)| text.strip_suffix(unit)?.parse::<u64>().ok()?.checked_mul(size));
    let seconds = parsed.next().filter(|&seconds| seconds > 0);
    seconds.map(Duration::from_secs).ok_or_else(refuse)
}

fn now() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |since| since.as_secs())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lifetimes_have_a_unit() {
        for (text, seconds) in [("30d", 2_592_000), ("12h", 43_200), ("90m", 5_400), ("45s", 45)] {
            assert_eq!(lifetime(text), Ok(Duration::from_secs(seconds)));
        }
        for text in ["", "30", "0d", "-1h", "1.5h", "d", "1w", "999999999999999999999d"] {
            assert!(lifetime(text).unwrap_err().contains("such as 30d"), "{text:?}");
        }
        assert_eq!(
            [span(0), span(59), span(60), span(90_000)],
            ["0 s", "59 s", "1 m", "1 d"]
        );
    }
}
