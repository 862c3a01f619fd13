//! Options of `isopeel serve` for one of several servers behind a proxy.

use std::path::PathBuf;

use crate::access::{SessionKey, Token, TokenError, TokenFile, TokenFileError};
use crate::jobs::StateFolder;

/// These options.
#[derive(Debug, clap::Args)]
pub struct ServersArgs {
    /// Name or address of the one of several servers behind a proxy that takes batch jobs and uploads, for lists of volumes and errors; the same at
    /// all of them, that one too
    #[arg(long, value_name = "NAME")]
    job_server: Option<String>,

    /// Folder with the tokens that `isopeel token` has made, which several servers may share and only read; else it is the state folder
    #[arg(long, value_name = "DIR")]
    token_folder: Option<PathBuf>,

    /// File whose only line is a secret that all servers behind a proxy have: a user who has signed in at one of them is signed in at all, and
    /// tokens for frames are valid at all
    #[arg(long, value_name = "FILE")]
    session_key_file: Option<PathBuf>,
}

impl ServersArgs {
    /// Returns the name of the server that takes batch jobs and uploads.
    pub(super) fn job_server(&self) -> Option<&str> {
        self.job_server.as_deref()
    }

    /// Returns the file of named tokens: in the folder of these options, or else in the state folder.
    pub(super) fn tokens(&self, state: Option<&StateFolder>) -> Result<Option<TokenFile>, TokenFileError> {
        match &self.token_folder {
            Some(folder) => TokenFile::in_shared_folder(folder).map(Some),
            None => Ok(state.map(|state| TokenFile::in_folder(state.path()))),
        }
    }

    /// Reads the key that the servers share.
    pub(super) fn session_key(&self) -> Result<Option<SessionKey>, TokenError> {
        let secret = self.session_key_file.as_deref().map(Token::read).transpose()?;
        Ok(secret.as_ref().map(SessionKey::of))
    }

    /// Returns the files and folders of secrets.
    pub(super) fn secrets(&self) -> impl Iterator<Item = &PathBuf> {
        self.token_folder.iter().chain(&self.session_key_file)
    }
}
