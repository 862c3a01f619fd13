//! Delegated tokens. The holder of a token, the lender, can delegate some of its roles to a new token that expires after minutes. A page of
//! another site passes this token to the viewer in its frame. The page has the token in memory only. The server stores its hash until the
//! token or the token of the lender expires. If several servers share a key, the secret of the token states who has lent what, so that all
//! of them accept it.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::Access;
use super::identity::{Credential, Delegated, Identity};
use super::named::now;
use super::role::{Role, Roles};
use super::sealed::SessionKey;
use super::token::{Hash, Token, TokenError, secret_of};

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

/// What the secrets of delegated tokens are sealed for.
const PURPOSE: &str = "delegated token";

/// What the secret of a delegated token states, if servers share a key.
#[derive(Serialize, Deserialize)]
pub(super) struct SealedToken {
    id: String,
    /// Makes each secret different.
    random: String,
    roles: Roles,
    expires: u64,
    pub lender: Lender,
}

/// The token of a lender, as each server finds it.
#[derive(Serialize, Deserialize)]
pub(super) enum Lender {
    /// The start token.
    Start,
    /// A named token, by its id.
    Named(String),
    /// A session.
    SignedIn {
        user: String,
        roles: Roles,
        name: String,
        expires: u64,
    },
}

impl Lender {
    /// Returns the token of a lender; `None` for an identity that delegates nothing.
    fn of(lender: &Identity) -> Option<Self> {
        Some(match lender.credential() {
            Credential::Start => Self::Start,
            Credential::Named(token) => Self::Named(token.id.clone()),
            Credential::SignedIn(session) => Self::SignedIn {
                user: session.user.to_string(),
                roles: session.roles,
                name: session.name.to_string(),
                expires: session.expires,
            },
            Credential::Delegated => return None,
        })
    }
}

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
pub(super) struct DelegatedTokens {
    tokens: Arc<Mutex<HashMap<String, (Hash, Delegated)>>>,
    /// If there is a key, tokens that another server has sealed with it are accepted.
    key: Option<SessionKey>,
}

impl DelegatedTokens {
    /// Accepts the delegated tokens of all servers that have this key.
    pub(super) fn with_key(self, key: SessionKey) -> Self {
        let key = Some(key);
        Self { key, ..self }
    }

    /// Returns the token with a secret that states who has lent what, if there is a key.
    fn sealed(&self, token: Token, delegated: &Delegated) -> Token {
        let (Some(key), Some(lender)) = (&self.key, Lender::of(&delegated.lender)) else {
            return token;
        };
        let sealed = SealedToken {
            id: delegated.id.to_string(),
            random: secret_of(token.text()).unwrap_or_default().to_owned(),
            roles: delegated.roles,
            expires: delegated.expires,
            lender,
        };
        match key.seal(PURPOSE, &sealed) {
            Ok(secret) => token.with_secret(&secret),
            // Cannot fail: serde_json fails only for maps whose keys are not strings.
            Err(_) => token,
        }
    }

    /// Returns what the secret of a token states, if a server with the same key has sealed it and the token has not expired.
    pub(super) fn unseal(&self, id: &str, token: &str) -> Option<SealedToken> {
        let sealed: SealedToken = self.key.as_ref()?.open(PURPOSE, secret_of(token)?)?;
        (sealed.id == id && now() < sealed.expires).then_some(sealed)
    }

    /// Creates a token that expires after `seconds`.
    fn lend(&self, lender: &Identity, roles: Roles, seconds: u64) -> Result<Token, DelegateError> {
        let token = Token::random()?;
        let id = token.id().unwrap_or_default();
        let now = now();
        let mut tokens = self.tokens.lock().unwrap_or_else(PoisonError::into_inner);
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
        let id = id.to_owned();
        let token = self.sealed(token, &delegated);
        tokens.insert(id, (Hash::of(token.text()), delegated));
        Ok(token)
    }

    /// Returns the delegated token with this id, if `token` is its text and it is still valid.
    pub(super) fn find(&self, id: &str, token: &str) -> Option<Delegated> {
        let tokens = self.tokens.lock().unwrap_or_else(PoisonError::into_inner);
        let (hash, delegated) = tokens.get(id)?;
        (hash.matches(token) && delegated.is_valid()).then(|| delegated.clone())
    }
}

impl SealedToken {
    /// Returns the delegated token of this lender.
    pub(super) fn of_lender(self, lender: Identity) -> Delegated {
        Delegated {
            id: self.id.into(),
            roles: self.roles,
            expires: self.expires,
            lender: Arc::new(lender),
        }
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
    use crate::access::sealed::tests::key;
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

    #[tokio::test]
    async fn a_token_that_one_server_lends_is_valid_at_others_with_its_key() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = TokenFile::in_folder(folder.path());
        let new = NewToken {
            user: "ann".into(),
            roles: vec![Role::Edit].into(),
            lifetime: None,
        };
        let (ann, entry) = file.create(new).expect("a token");
        let start = Token::random().expect("random");
        let server = |letter: &str| {
            let access = Access::new(([127, 0, 0, 1], 8417).into(), &[], &[]).with_token(&start);
            let watch = TokenWatch::open(file.clone()).expect("tokens");
            access.with_named(&watch).with_session_key(Some(&key(letter)))
        };
        let (one, other, foreign) = (server("a"), server("a"), server("b"));
        for lender in [start.text(), ann.text()] {
            let who = one.who(lender).expect("the lender");
            let token = one.lend(&who, vec![Role::View], 60).expect("a token");
            let (here, there) = (one.who(token.text()), other.who(token.text()));
            let (here, there) = (here.expect("here"), there.expect("there"));
            assert_eq!((there.user(), there.token()), (who.user(), here.token()));
            assert!(there.may(Role::View) && !there.may(Role::Edit) && there.is_delegated());
            assert!(
                there
                    .expires_seconds()
                    .is_some_and(|seconds| (58..=60).contains(&seconds))
            );
            assert!(foreign.who(token.text()).is_none(), "another key");
            let changed = token.text().replacen('.', "x.", 1);
            assert!(other.who(&changed).is_none());
        }
        // It ends with the lender's, also at the server that has not made it.
        let who = one.who(ann.text()).expect("ann");
        let token = one.lend(&who, vec![Role::View], 60).expect("a token");
        file.revoke(&entry.id).expect("revoked");
        assert!(server("a").who(token.text()).is_none());
    }

    #[test]
    fn one_that_a_session_has_lent_ends_with_the_session_where_that_ends() {
        let server = || {
            let (access, _) = access();
            access.with_session_key(Some(&key("a")))
        };
        let (one, other) = (server(), server());
        let sessions = |access: &Access| access.authenticator.clone().expect("authenticator").sessions().clone();
        let roles = vec![Role::View].into();
        let secret = sessions(&one).secret("oidc:ann", roles, 60).expect("a secret");
        let who = Identity::of_signed_in(sessions(&one).find(&secret).expect("a session"));
        let token = one.lend(&who, vec![Role::View], 60).expect("a token");
        assert_eq!(other.who(token.text()).expect("there").user(), "oidc:ann");
        for access in [&one, &other] {
            assert!(sessions(access).end(&secret));
            assert!(access.who(token.text()).is_none());
        }
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
