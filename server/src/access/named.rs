//! Named tokens: users whom an administrator has given access, with their roles and an expiry. They are in a file of the state folder,
//! which holds only hashes of their secrets. `isopeel token` changes the file, and a running server reloads it.

use std::collections::HashMap;
use std::fs::{File, Metadata, OpenOptions};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use super::role::Roles;
use super::token::{Hash, Token, TokenError, cookie_value};
use serde::{Deserialize, Serialize};
use tempfile::NamedTempFile;

const FILE: &str = "tokens.json";
/// Lock file, held while the token file is changed.
const LOCK: &str = "tokens.lock";
/// Version of the file.
const VERSION: u32 = 1;
/// Maximum tokens: some 400 bytes each, and looked up by their ids.
const MAX_TOKENS: usize = 1_000;
/// Maximum bytes of the file.
const MAX_FILE_BYTES: u64 = 1 << 20;
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
    /// Time at which it was created, in seconds of Unix time.
    pub created: u64,
    /// Time at which it expires, in seconds of Unix time; `None`: never.
    pub expires: Option<u64>,
}

impl NamedToken {
    /// Whether it has expired at `now`, in seconds of Unix time.
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
    /// Time until it expires; `None`: never.
    pub lifetime: Option<Duration>,
}

/// Why tokens cannot be read or changed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TokenFileError {
    /// The file cannot be read or written.
    #[error("tokens {}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// The file's content is invalid, or another version of the program has written it.
    #[error("tokens {}: {why}, expected what `isopeel token` has written", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong with the file's content.
        why: String,
    },
    /// Other users of the machine can write the file, and could so give themselves access.
    #[error("tokens {} may be written by other users, expected its owner alone: chmod 600", .0.display())]
    Writable(PathBuf),
    /// A user's name is not valid.
    #[error("user {0:?}, expected 1 to {MAX_USER} letters, digits and signs of . _ @ -")]
    User(String),
    /// The token would have no role.
    #[error("a token needs a role: view, edit, export, upload, push or admin")]
    NoRole,
    /// The file has the maximum number of tokens.
    #[error("there are {MAX_TOKENS} tokens, as many as may be: revoke some")]
    TooMany,
    /// There is no such token.
    #[error("no token has the id {0:?}, `isopeel token list` has all")]
    Unknown(String),
    /// There are no random numbers.
    #[error(transparent)]
    Random(#[from] TokenError),
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Contents {
    version: u32,
    tokens: Vec<NamedToken>,
}

/// The tokens of a file.
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
    /// Returns the token file of a folder that only its user may access.
    pub fn in_folder(folder: &Path) -> Self {
        Self {
            folder: folder.to_owned(),
            path: folder.join(FILE),
        }
    }

    /// Returns all tokens, in the order in which they were created.
    ///
    /// # Errors
    /// [`TokenFileError`]. A missing file is no error: it has no tokens.
    pub fn list(&self) -> Result<Vec<NamedToken>, TokenFileError> {
        let mut text = String::new();
        let file = match File::open(&self.path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            other => other.map_err(|source| self.io(source))?,
        };
        self.check_mode(&file.metadata().map_err(|source| self.io(source))?)?;
        let read = file.take(MAX_FILE_BYTES).read_to_string(&mut text);
        read.map_err(|source| self.io(source))?;
        let contents: Contents = serde_json::from_str(&text).map_err(|error| self.malformed(error.to_string()))?;
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

    /// Creates a token and returns it. The file stores only its hash.
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
        let made = NamedToken {
            id: token.id().unwrap_or_default().to_owned(),
            user: new.user,
            roles: new.roles,
            sha256: Hash::of(token.text()),
            cookie: Hash::of(&cookie_value(token.text())),
            created,
            expires: new.lifetime.map(|lifetime| created.saturating_add(lifetime.as_secs())),
        };
        let kept = made.clone();
        self.change(|tokens| {
            if tokens.len() >= MAX_TOKENS {
                return Err(TokenFileError::TooMany);
            }
            tokens.push(kept);
            Ok(())
        })?;
        Ok((token, made))
    }

    /// Removes a token.
    ///
    /// # Errors
    /// [`TokenFileError`].
    pub fn revoke(&self, id: &str) -> Result<NamedToken, TokenFileError> {
        self.change(|tokens| {
            let found = tokens.iter().position(|token| token.id == id);
            let found = found.ok_or_else(|| TokenFileError::Unknown(id.to_owned()))?;
            Ok(tokens.remove(found))
        })
    }

    /// Changes the file, one process at a time. The change is atomic for readers.
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
        // Temporary files are readable for their user alone.
        let mut file = NamedTempFile::new_in(&self.folder)?;
        file.write_all(text)?;
        file.as_file().sync_all()?;
        file.persist(&self.path)?;
        if cfg!(unix) {
            File::open(&self.folder)?.sync_all()?;
        }
        Ok(())
    }

    /// Identifies the version of the file, which is replaced as a whole by each change.
    pub(super) fn version(&self) -> Option<(SystemTime, u64, u64)> {
        let found = std::fs::metadata(&self.path).ok()?;
        #[cfg(unix)]
        let inode = std::os::unix::fs::MetadataExt::ino(&found);
        #[cfg(not(unix))]
        let inode = 0;
        Some((found.modified().ok()?, found.len(), inode))
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

/// Seconds since 1970.
pub(super) fn now() -> u64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |since| since.as_secs())
}

#[cfg(test)]
mod tests;
