//! Named tokens, by which an administrator gives users access. A token has a user, roles and an expiry. A file in the state folder stores
//! the tokens, with hashes of their secrets only. `isopeel token` changes the file, and a running server reloads it.

use std::collections::HashMap;
use std::fs::{File, Metadata, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use super::role::Roles;
use super::token::{Hash, Token, TokenError, cookie_value};
use serde::{Deserialize, Serialize};
use tempfile::NamedTempFile;

use crate::bounded_read::read_bounded;

const FILE: &str = "tokens.json";
/// Name of the lock file. A process that changes the token file holds the lock.
const LOCK: &str = "tokens.lock";
/// Version of the file format.
const VERSION: u32 = 1;
/// Maximum number of tokens, some 400 bytes each, so that a file of [`MAX_FILE_BYTES`] can hold them.
const MAX_TOKENS: usize = 1_000;
/// Maximum bytes of the file.
const MAX_FILE_BYTES: usize = 1 << 20;
/// Maximum characters of a user's name.
const MAX_USER: usize = 64;

/// A token, without its secret.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NamedToken {
    /// Public part of the token.
    pub id: String,
    /// User who owns the token.
    pub user: String,
    /// Roles of the token.
    pub roles: Roles,
    /// SHA-256 of the token.
    pub(super) sha256: Hash,
    /// SHA-256 of the cookie that stands for the token.
    pub(super) cookie: Hash,
    /// Time of creation in seconds of Unix time.
    pub created: u64,
    /// Expiry in seconds of Unix time; `None`: never.
    pub expires: Option<u64>,
}

impl NamedToken {
    /// Whether the token has expired at `now`, in seconds of Unix time.
    pub fn has_expired(&self, now: u64) -> bool {
        self.expires.is_some_and(|expires| expires <= now)
    }
}

/// The properties of a new token.
#[derive(Clone, Debug)]
pub struct NewToken {
    /// User who owns the token.
    pub user: String,
    /// Roles of the token.
    pub roles: Roles,
    /// Time until the token expires; `None`: never.
    pub lifetime: Option<Duration>,
}

/// Why tokens cannot be read or changed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TokenFileError {
    /// The file cannot be read or written.
    #[error("tokens {}", path.display())]
    Io {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// The content of the file is invalid, or another version of the program has written it.
    #[error("tokens {}: {why}, expected what `isopeel token` has written", path.display())]
    Malformed {
        /// Path of the file.
        path: PathBuf,
        /// What is wrong with the content.
        why: String,
    },
    /// Other users of the machine can write to the file, and so could give themselves access.
    #[error("tokens {} may be written by other users, expected its owner alone: chmod 600", .0.display())]
    Writable(PathBuf),
    /// Other users of the machine can replace the file.
    #[error("token folder {} may be written by other users, expected its owner alone: chmod o-w", .0.display())]
    WritableFolder(PathBuf),
    /// The name of the user is not valid.
    #[error("user {0:?}, expected 1 to {MAX_USER} letters, digits and signs of . _ @ -")]
    User(String),
    /// The token would have no role.
    #[error("a token needs a role: view, edit, export, upload, push or admin")]
    NoRole,
    /// The file has the maximum number of tokens.
    #[error("there are {MAX_TOKENS} tokens, as many as may be: revoke some")]
    TooMany,
    /// The file has no such token.
    #[error("no token has the id {0:?}, `isopeel token list` has all")]
    Unknown(String),
    /// The system has no random numbers.
    #[error(transparent)]
    Random(#[from] TokenError),
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Contents {
    version: u32,
    tokens: Vec<NamedToken>,
}

/// All tokens of a file, by their ids.
#[derive(Debug, Default)]
pub struct NamedTokens(HashMap<String, Arc<NamedToken>>);

impl NamedTokens {
    pub(super) fn get(&self, id: &str) -> Option<&Arc<NamedToken>> {
        self.0.get(id)
    }

    /// Returns the tokens that are not in another set.
    pub(super) fn without<'a>(&'a self, others: &'a Self) -> impl Iterator<Item = &'a NamedToken> {
        let tokens = self.0.values().map(|token| &**token);
        tokens.filter(|token| !others.0.contains_key(&token.id))
    }
}

/// The file that stores the tokens of a state folder.
#[derive(Clone, Debug)]
pub struct TokenFile {
    folder: PathBuf,
    path: PathBuf,
}

impl TokenFile {
    /// Returns the token file of a state folder.
    pub fn in_folder(folder: &Path) -> Self {
        Self {
            folder: folder.to_owned(),
            path: folder.join(FILE),
        }
    }

    /// Returns the token file of a folder that several servers read. The folder may belong to another user, as volumes of containers do.
    ///
    /// # Errors
    /// There is no such folder, or all users may replace its files.
    pub fn in_shared_folder(folder: &Path) -> Result<Self, TokenFileError> {
        let file = Self::in_folder(folder);
        let metadata = std::fs::read_dir(folder).and_then(|_| std::fs::metadata(folder));
        let metadata = metadata.map_err(|source| TokenFileError::Io {
            path: folder.to_owned(),
            source,
        })?;
        if can_be_replaced(&metadata) {
            return Err(TokenFileError::WritableFolder(folder.to_owned()));
        }
        Ok(file)
    }

    /// Returns all tokens, in the order in which they were created.
    ///
    /// # Errors
    /// [`TokenFileError`]. A missing file is not an error, but an empty list.
    pub fn list(&self) -> Result<Vec<NamedToken>, TokenFileError> {
        let file = match File::open(&self.path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            other => other.map_err(|source| self.io(source))?,
        };
        self.check_mode(&file.metadata().map_err(|source| self.io(source))?)?;
        let text = read_bounded(file, MAX_FILE_BYTES).map_err(|source| self.io(source))?;
        let text = text.ok_or_else(|| self.malformed(format!("more than {MAX_FILE_BYTES} bytes")))?;
        let contents: Contents = serde_json::from_slice(&text).map_err(|error| self.malformed(error.to_string()))?;
        if contents.version != VERSION {
            return Err(self.malformed(format!("version {}", contents.version)));
        }
        if contents.tokens.len() > MAX_TOKENS {
            return Err(self.malformed(format!("{} tokens", contents.tokens.len())));
        }
        Ok(contents.tokens)
    }

    /// Returns all tokens, by their ids.
    pub(super) fn read(&self) -> Result<NamedTokens, TokenFileError> {
        let tokens = self.list()?.into_iter();
        Ok(NamedTokens(
            tokens.map(|token| (token.id.clone(), Arc::new(token))).collect(),
        ))
    }

    /// Creates a token, and stores its hash in the file. Returns the token and its entry in the file.
    ///
    /// # Errors
    /// [`TokenFileError`].
    pub fn create(&self, new: NewToken) -> Result<(Token, NamedToken), TokenFileError> {
        let is_name = |byte: u8| byte.is_ascii_alphanumeric() || b"._@-".contains(&byte);
        if !(1..=MAX_USER).contains(&new.user.len()) || !new.user.bytes().all(is_name) {
            return Err(TokenFileError::User(new.user));
        }
        if new.roles.is_empty() {
            return Err(TokenFileError::NoRole);
        }
        let token = Token::random()?;
        let created = now();
        let entry = NamedToken {
            id: token.id().unwrap_or_default().to_owned(),
            user: new.user,
            roles: new.roles,
            sha256: Hash::of(token.text()),
            cookie: Hash::of(&cookie_value(token.text())),
            created,
            expires: new.lifetime.map(|lifetime| created.saturating_add(lifetime.as_secs())),
        };
        let stored = entry.clone();
        self.change(|tokens| {
            if tokens.len() >= MAX_TOKENS {
                return Err(TokenFileError::TooMany);
            }
            tokens.push(stored);
            Ok(())
        })?;
        Ok((token, entry))
    }

    /// Removes a token.
    ///
    /// # Errors
    /// [`TokenFileError`].
    pub fn revoke(&self, id: &str) -> Result<NamedToken, TokenFileError> {
        self.change(|tokens| {
            let index = tokens.iter().position(|token| token.id == id);
            let index = index.ok_or_else(|| TokenFileError::Unknown(id.to_owned()))?;
            Ok(tokens.remove(index))
        })
    }

    /// Changes the file while no other process changes it. Readers see the old or the new file, never a part of it.
    fn change<T>(
        &self,
        change: impl FnOnce(&mut Vec<NamedToken>) -> Result<T, TokenFileError>,
    ) -> Result<T, TokenFileError> {
        let lock = OpenOptions::new()
            .create(true)
            .truncate(false)
            .write(true)
            .open(self.folder.join(LOCK))
            .and_then(|lock| lock.lock().map(|()| lock));
        let _lock = lock.map_err(|source| self.io(source))?;
        let mut tokens = self.list()?;
        let changed = change(&mut tokens)?;
        let version = VERSION;
        let text = serde_json::to_vec_pretty(&Contents { version, tokens });
        let text = text.map_err(|error| self.io(error.into()))?;
        self.replace(&text).map_err(|source| self.io(source))?;
        Ok(changed)
    }

    fn replace(&self, text: &[u8]) -> io::Result<()> {
        // A temporary file is readable for its user alone.
        let mut file = NamedTempFile::new_in(&self.folder)?;
        file.write_all(text)?;
        file.as_file().sync_all()?;
        file.persist(&self.path)?;
        if cfg!(unix) {
            File::open(&self.folder)?.sync_all()?;
        }
        Ok(())
    }

    /// Returns modification time, length and inode of the file. Each change replaces the file, and so changes these values.
    pub(super) fn version(&self) -> Option<(SystemTime, u64, u64)> {
        let metadata = std::fs::metadata(&self.path).ok()?;
        #[cfg(unix)]
        let inode = std::os::unix::fs::MetadataExt::ino(&metadata);
        #[cfg(not(unix))]
        let inode = 0;
        Some((metadata.modified().ok()?, metadata.len(), inode))
    }

    #[cfg(unix)]
    fn check_mode(&self, file: &Metadata) -> Result<(), TokenFileError> {
        use std::os::unix::fs::PermissionsExt;
        if file.permissions().mode() & 0o022 != 0 {
            return Err(TokenFileError::Writable(self.path.clone()));
        }
        Ok(())
    }

    #[cfg(not(unix))]
    fn check_mode(&self, _: &Metadata) -> Result<(), TokenFileError> {
        Ok(())
    }

    fn io(&self, source: io::Error) -> TokenFileError {
        TokenFileError::Io {
            path: self.path.clone(),
            source,
        }
    }

    fn malformed(&self, why: String) -> TokenFileError {
        TokenFileError::Malformed {
            path: self.path.clone(),
            why,
        }
    }
}

/// Whether users who own neither a folder nor its files can replace these files: they may write to the folder, and it is not sticky.
#[cfg(unix)]
fn can_be_replaced(folder: &Metadata) -> bool {
    use std::os::unix::fs::PermissionsExt;
    folder.permissions().mode() & 0o1002 == 0o0002
}

#[cfg(not(unix))]
fn can_be_replaced(_: &Metadata) -> bool {
    false
}

/// Returns the current Unix time in seconds.
pub(super) fn now() -> u64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |since| since.as_secs())
}

#[cfg(test)]
mod tests;
