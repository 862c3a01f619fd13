//! Reloads the token file when it changes.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;

use super::audit::{Audit, Event};
use super::named::{NamedTokens, TokenFile, TokenFileError};

/// Interval between two checks of the file, so that a revoked token is refused within 5 s.
const INTERVAL: Duration = Duration::from_secs(2);

/// The current tokens of a file. [`TokenWatch::run`] reloads them when the file changes.
#[derive(Debug)]
pub struct TokenWatch {
    file: TokenFile,
    tokens: watch::Sender<Arc<NamedTokens>>,
    audit: Option<Audit>,
}

impl TokenWatch {
    /// Reads the file.
    ///
    /// # Errors
    /// [`TokenFileError`].
    pub fn open(file: TokenFile) -> Result<Self, TokenFileError> {
        let tokens = watch::Sender::new(Arc::new(file.read()?));
        let audit = None;
        Ok(Self { file, tokens, audit })
    }

    /// Logs tokens that appear or are removed.
    #[must_use]
    pub fn with_audit(self, audit: Option<Audit>) -> Self {
        Self { audit, ..self }
    }

    pub(super) fn tokens(&self) -> watch::Receiver<Arc<NamedTokens>> {
        self.tokens.subscribe()
    }

    /// Reloads the token file when it changes; never returns. While the file cannot be read, all named tokens are refused, because any of
    /// them may have been revoked.
    pub async fn run(self) {
        self.check_every(INTERVAL).await;
    }

    pub(super) async fn check_every(self, interval: Duration) {
        let (mut read_version, mut logged_error) = (None, String::new());
        let mut last_tokens = Arc::clone(&self.tokens.borrow());
        loop {
            let file = self.file.clone();
            let check = tokio::task::spawn_blocking(move || {
                let version = Some(file.version());
                (version != read_version).then(|| (version, file.read()))
            });
            match check.await {
                Ok(Some((version, Ok(tokens)))) => {
                    (read_version, logged_error) = (version, String::new());
                    let tokens = Arc::new(tokens);
                    self.log_changes(&last_tokens, &tokens);
                    last_tokens = Arc::clone(&tokens);
                    self.tokens.send_replace(tokens);
                }
                Ok(Some((_, Err(error)))) => {
                    // Reads the file again at the next check, because corrected permissions may not change its version.
                    read_version = None;
                    self.tokens.send_replace(Arc::default());
                    let why = crate::error::chain(&error);
                    if why != logged_error {
                        tracing::error!("all named tokens are refused: {why}");
                        logged_error = why;
                    }
                }
                Ok(None) => {}
                Err(error) => tracing::error!(%error, "the check of the token file panicked"),
            }
            tokio::time::sleep(interval).await;
        }
    }
}

impl TokenWatch {
    /// Logs which tokens have appeared and which were removed.
    fn log_changes(&self, before: &NamedTokens, now: &NamedTokens) {
        let Some(audit) = &self.audit else { return };
        before
            .without(now)
            .for_each(|token| audit.token(Event::TokenRevoked, token));
        now.without(before)
            .for_each(|token| audit.token(Event::TokenCreated, token));
    }
}
