//! Delegated tokens. The holder of a token, the lender, can delegate some of its roles to a new token that expires after minutes. A page of
//! another site passes this token to the viewer in its frame. The page has the token in memory only. The server stores its hash until the
//! token or the token of the lender expires.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use super::Access;
use super::identity::{Delegated, Identity};
use super::named::now;
use super::role::{Role, Roles};
use super::token::{Hash, Token, TokenError};

/// Default lifetime in seconds. The page requests the next token before this one expires.
pub const DEFAULT_SECONDS: u64 = 600;
/// Bounds of the lifetime in seconds: from the time that a page takes to load, to the length of a talk.
pub const SECONDS: std::ops::RangeInclusive<u64> = 10..=3_600;
/// Roles that may be delegated. Exports, jobs and uploads belong to a user, so all viewers of an embedding page would share them.
pub const ROLES: [Role; 2] = [Role::View, Role::Edit];
/// Maximum number of delegated tokens, some 500 bytes each.
const MAX_TOKENS: usize = 4_096;
/// Maximum number of tokens of one lender, so that no lender uses up all of them. Twice the maximum number of viewers.
const MAX_OF_LENDER: usize = 2_048;

/// Why a token was not delegated.
#[derive(Debug, thiserror::Error)]
pub enum DelegateError {
    /// The server runs without authentication, so no token is needed.
    #[error("this server runs without tokens (--no-auth), so that a frame needs none: leave out the request for one")]
    NoAuth,
    /// The lender's token is a delegated token. It must not be delegated again, because its holder could renew it forever.
    #[error(
        "this token was delegated, expected one that was not: the start token, one of the token file, or a sign-in"
    )]
    Delegated,
    /// A role that cannot be delegated.
    #[error("roles has {:?}, expected view or edit: files, jobs and uploads are their user's", .0.name())]
    Role(Role),
    /// The lender lacks one of the requested roles.
    #[error("this token has the roles {0}, requested are {1}: a token delegates only roles that it has")]
    NotOwn(Roles, Roles),
    /// The request names no roles.
    #[error("roles is empty, expected view or edit")]
    NoRoles,
    /// The lifetime is too short or too long.
    #[error("seconds is {0}, expected {start} to {end}", start = SECONDS.start(), end = SECONDS.end())]
    Seconds(u64),
    /// There are too many delegated tokens.
    #[error("{count} delegated tokens are valid, the maximum: the next one expires in {wait:?}")]
    TooMany {
        /// Number of delegated tokens.
        count: usize,
        /// Time until the next one expires.
        wait: Duration,
    },
    /// The system has no random numbers.
    #[error(transparent)]
    Random(#[from] TokenError),
}

/// All delegated tokens, by their ids. Clones share them.
#[derive(Clone, Debug, Default)]
pub(super) struct DelegatedTokens(Arc<Mutex<HashMap<String, (Hash, Delegated)>>>);

impl DelegatedTokens {
    /// Creates a token that expires after `seconds`.
    fn lend(&self, lender: &Identity, roles: Roles, seconds: u64) -> Result<Token, DelegateError> {
        let token = Token::random()?;
        let id = token.id().unwrap_or_default();
        let now = now();
        let mut tokens = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        tokens.retain(|_, (_, delegated)| delegated.is_valid());
        let is_own = |delegated: &Delegated| delegated.lender.token() == lender.token();
        let own = tokens.values().filter(|(_, delegated)| is_own(delegated)).count();
        let (is_full, count) = (tokens.len() >= MAX_TOKENS, tokens.len());
        if is_full || own >= MAX_OF_LENDER {
            let limiting = tokens.values().filter(|(_, delegated)| is_full || is_own(delegated));
            let next = limiting.map(|(_, delegated)| delegated.expires).min().unwrap_or(now);
            let wait = Duration::from_secs(next.saturating_sub(now).max(1));
            return Err(DelegateError::TooMany {
                count: if is_full { count } else { own },
                wait,
            });
        }
        let delegated = Delegated {
            id: id.into(),
            roles,
            expires: now.saturating_add(seconds),
            lender: Arc::new(lender.clone()),
        };
        tokens.insert(id.to_owned(), (Hash::of(token.text()), delegated));
        Ok(token)
    }

    /// Returns the delegated token with this id, if `token` is its text and it is still valid.
    pub(super) fn find(&self, id: &str, token: &str) -> Option<Delegated> {
        let tokens = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (hash, delegated) = tokens.get(id)?;
        (hash.matches(token) && delegated.is_valid()).then(|| delegated.clone())
    }
}

impl Access {
    /// Delegates some of the roles of `who` to a new token that expires after `seconds`.
    ///
    /// # Errors
    /// [`DelegateError`].
    pub fn lend(&self, who: &Identity, roles: Vec<Role>, seconds: u64) -> Result<Token, DelegateError> {
        let Some(authenticator) = &self.authenticator else {
            return Err(DelegateError::NoAuth);
        };
        if who.is_delegated() {
            return Err(DelegateError::Delegated);
        }
        if let Some(role) = roles.iter().find(|role| !ROLES.contains(role)) {
            return Err(DelegateError::Role(*role));
        }
        if !SECONDS.contains(&seconds) {
            return Err(DelegateError::Seconds(seconds));
        }
        let has_all = roles.iter().all(|&role| who.may(role));
        let roles = Roles::from(roles);
        if roles.is_empty() {
            return Err(DelegateError::NoRoles);
        }
        if !has_all {
            return Err(DelegateError::NotOwn(who.roles(), roles));
        }
        authenticator.delegated().lend(who, roles, seconds)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::{NewToken, TokenFile, TokenWatch};

    fn access() -> (Access, Identity) {
        let token = Token::random().expect("random");
        let access = Access::new(([127, 0, 0, 1], 8417).into(), &[], &[]).with_token(&token);
        let operator = access.who(token.text()).expect("the operator");
        (access, operator)
    }

    #[test]
    fn what_is_lent_is_less_and_ends() {
        let (access, operator) = access();
        let token = access.lend(&operator, vec![Role::View], 10).expect("a token");
        let who = access.who(token.text()).expect("whose it is");
        assert_eq!((who.user(), who.token()), (operator.user(), token.id().expect("an id")));
        assert!(who.may(Role::View) && !who.may(Role::Edit) && !who.may(Role::Export) && !who.may(Role::Admin));
        assert!(who.expires_seconds().is_some_and(|seconds| (8..=10).contains(&seconds)));
        let wrong = format!("{}x", &token.text()[..token.text().len() - 1]);
        assert!(access.who(&wrong).is_none());
        assert!(!format!("{access:?}").contains(token.text()));
        let refused = access.exchange(token.text()).expect_err("it is for no cookie");
        assert_eq!(refused.status().as_u16(), 403);
        // A token that has expired already: the minimum lifetime of ten seconds is too long for a test.
        let lent = access.authenticator.as_ref().expect("authenticator").delegated();
        let ended = lent.lend(&operator, vec![Role::View].into(), 0).expect("a token");
        assert!(access.who(ended.text()).is_none());
    }

    #[test]
    fn nobody_lends_what_they_have_not_or_what_is_lent() {
        let (access, operator) = access();
        let lend = |who: &Identity, roles: &[Role], seconds| access.lend(who, roles.to_vec(), seconds);
        let said = |found: Result<Token, DelegateError>| found.expect_err("refused").to_string();
        assert!(said(lend(&operator, &[Role::Export], 60)).contains("roles has \"export\", expected view or edit"));
        assert!(said(lend(&operator, &[], 60)).contains("roles is empty"));
        assert!(said(lend(&operator, &[Role::View], 9)).contains("seconds is 9, expected 10 to 3600"));
        assert!(said(lend(&operator, &[Role::View], 3_601)).contains("seconds is 3601"));
        let token = lend(&operator, &[Role::Edit], 60).expect("a token");
        let who = access.who(token.text()).expect("somebody");
        assert!(matches!(lend(&who, &[Role::View], 60), Err(DelegateError::Delegated)));
        let open = Access::new(([127, 0, 0, 1], 8417).into(), &[], &[]);
        let nobody = Identity::without_token();
        assert!(matches!(
            open.lend(&nobody, vec![Role::View], 60),
            Err(DelegateError::NoAuth)
        ));
    }

    #[tokio::test]
    async fn it_ends_with_the_token_that_it_was_made_with() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = TokenFile::in_folder(folder.path());
        let new = |lifetime| NewToken {
            user: "ann".into(),
            roles: vec![Role::View].into(),
            lifetime,
        };
        let (ann, _) = file.create(new(Some(Duration::from_secs(3)))).expect("a token");
        let access = access().0.with_named(&TokenWatch::open(file).expect("tokens"));
        let lender = access.who(ann.text()).expect("ann");
        let edits = access
            .lend(&lender, vec![Role::Edit], 60)
            .expect_err("she may only look");
        assert!(
            edits
                .to_string()
                .contains("this token has the roles view, requested are edit"),
            "{edits}"
        );
        let token = access.lend(&lender, vec![Role::View], 60).expect("a token");
        let who = access.who(token.text()).expect("somebody");
        assert!(who.expires_seconds().is_some_and(|seconds| seconds <= 3));
        let ended = tokio::time::timeout(Duration::from_secs(5), who.ended());
        ended.await.expect("what is lent ends too");
        assert!(access.who(token.text()).is_none());
    }

    #[test]
    fn there_are_only_so_many() {
        let (access, operator) = access();
        let other = Identity::without_token();
        let lent = access.authenticator.as_ref().expect("authenticator").delegated();
        for _ in 0..MAX_OF_LENDER {
            lent.lend(&operator, vec![Role::View].into(), 60).expect("a token");
        }
        let refused = lent
            .lend(&operator, vec![Role::View].into(), 60)
            .expect_err("one too many");
        assert!(
            matches!(refused, DelegateError::TooMany { count: MAX_OF_LENDER, wait } if wait <= Duration::from_secs(60)),
            "{refused}"
        );
        lent.lend(&other, vec![Role::View].into(), 60).expect("somebody else's");
    }
}
