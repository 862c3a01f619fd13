//! Reloads the token file when it changes.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;

use super::audit::{Audit, Event};
use super::named::{NamedTokens, TokenFile, TokenFileError};

/// Interval between two checks of the file, so that a revoked token is refused within 5 s.
const INTERVAL: Duration = Duration::from_secs(2);

/// The tokens of a file, reloaded when the file changes.
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
        self.look_every(INTERVAL).await;
    }

    pub(super) async fn look_every(self, interval: Duration) {
        let (mut seen, mut complaint) = (None, String::new());
        let mut known = Arc::clone(&self.tokens.borrow());
        loop {
            let file = self.file.clone();
            let looked = tokio::task::spawn_blocking(move || {
                let version = Some(file.version());
                (version != seen).then(|| (version, file.read()))
            });
            match looked.await {
                Ok(Some((version, Ok(tokens)))) => {
                    (seen, complaint) = (version, String::new());
                    let tokens = Arc::new(tokens);
                    self.note(&known, &tokens);
                    known = Arc::clone(&tokens);
                    self.tokens.send_replace(tokens);
                }
                Ok(Some((_, Err(error)))) => {
                    // Read the file again at the next check: corrected permissions may not change its version.
                    seen = None;
                    self.tokens.send_replace(Arc::default());
                    let why = crate::error::chain(&error);
                    if why != complaint {
                        tracing::error!("nobody is let in by a named token: {why}");
                        complaint = why;
                    }
                }
                Ok(None) => {}
                Err(error) => tracing::error!(%error, "the tokens could not be looked at"),
            }
            tokio::time::sleep(interval).await;
        }
    }
}

impl TokenWatch {
    /// Logs which tokens have appeared and which were removed.
    fn note(&self, before: &NamedTokens, now: &NamedTokens) {
        let Some(audit) = &self.audit else { return };
        before
            .without(now)
            .for_each(|token| audit.token(Event::TokenRevoked, token));
        now.without(before)
            .for_each(|token| audit.token(Event::TokenCreated, token));
    }
}
