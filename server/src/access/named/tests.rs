//! The file of tokens, and servers that look at it.

use super::super::role::Role;
use super::super::{Access, Token, TokenWatch};
use super::*;

fn new(user: &str, roles: &[Role]) -> NewToken {
    NewToken {
        user: user.into(),
        roles: roles.to_vec().into(),
        lifetime: None,
    }
}

#[test]
fn tokens_are_kept_without_their_secrets_and_revoked_ones_are_gone() {
    let folder = tempfile::tempdir().unwrap();
    let file = TokenFile::in_folder(folder.path());
    assert_eq!(file.list().unwrap(), []);
    let (token, made) = file.create(new("ann", &[Role::View, Role::Export])).unwrap();
    let (_, other) = file.create(new("bob@example.org", &[Role::Admin])).unwrap();
    assert_eq!(file.list().unwrap(), [made.clone(), other.clone()]);
    assert_eq!(token.id(), Some(made.id.as_str()));
    let path = folder.path().join(FILE);
    let text = std::fs::read_to_string(&path).unwrap();
    let secret = token.text().splitn(3, '_').nth(2).unwrap();
    assert!(!text.contains(secret) && !text.contains(token.text()), "{text}");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let mode = std::fs::metadata(&path).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
    }
    assert_eq!(file.revoke(&made.id).unwrap(), made);
    assert_eq!(file.list().unwrap(), [other]);
    let again = file.revoke(&made.id).unwrap_err();
    assert!(
        matches!(&again, TokenFileError::Unknown(id) if *id == made.id),
        "{again}"
    );
}

#[cfg(unix)]
#[test]
fn a_shared_folder_is_one_whose_files_others_cannot_replace() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let set = |mode| std::fs::set_permissions(folder.path(), std::fs::Permissions::from_mode(mode)).unwrap();
    TokenFile::in_folder(folder.path())
        .create(new("ann", &[Role::View]))
        .unwrap();
    // A secret of Kubernetes is in a folder with the sticky bit.
    for mode in [0o700, 0o755, 0o1777] {
        set(mode);
        assert_eq!(
            TokenFile::in_shared_folder(folder.path())
                .unwrap()
                .list()
                .unwrap()
                .len(),
            1
        );
    }
    set(0o777);
    let error = TokenFile::in_shared_folder(folder.path()).unwrap_err();
    assert!(
        matches!(&error, TokenFileError::WritableFolder(path) if path == folder.path()),
        "{error}"
    );
    let missing = TokenFile::in_shared_folder(&folder.path().join("none")).unwrap_err();
    assert!(matches!(missing, TokenFileError::Io { .. }));
}

#[test]
fn what_is_no_token_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = TokenFile::in_folder(folder.path());
    for user in ["", "a b", "a/b", "ä", &"a".repeat(65)] {
        let error = file.create(new(user, &[Role::View])).unwrap_err();
        assert!(matches!(error, TokenFileError::User(_)), "{user:?}");
    }
    assert!(matches!(file.create(new("ann", &[])), Err(TokenFileError::NoRole)));
    for text in [
        "",
        "{}",
        r#"{"version":2,"tokens":[]}"#,
        r#"{"version":1,"tokens":[{}]}"#,
    ] {
        std::fs::write(folder.path().join(FILE), text).unwrap();
        let error = file.list().unwrap_err();
        assert!(matches!(error, TokenFileError::Malformed { .. }), "{text}");
        assert!(
            file.create(new("ann", &[Role::View])).is_err(),
            "{text} is not overwritten"
        );
    }
}

#[cfg(unix)]
#[test]
fn a_file_that_others_may_write_lets_nobody_in() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let file = TokenFile::in_folder(folder.path());
    file.create(new("ann", &[Role::View])).unwrap();
    std::fs::set_permissions(folder.path().join(FILE), PermissionsExt::from_mode(0o620)).unwrap();
    assert!(matches!(TokenWatch::open(file), Err(TokenFileError::Writable(_))));
}

/// A server with a token of its start, and the file's.
fn access(watch: &TokenWatch) -> Access {
    let start = Token::random().unwrap();
    Access::new(([127, 0, 0, 1], 8417).into(), &[], &[])
        .with_token(&start)
        .with_named(watch)
}

/// Waits for what becomes so.
async fn until(is_so: impl Fn() -> bool) {
    let waiting = async {
        while !is_so() {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(5), waiting)
        .await
        .expect("in time");
}

#[tokio::test]
async fn a_running_server_learns_of_tokens_and_of_their_end() {
    let folder = tempfile::tempdir().unwrap();
    let file = TokenFile::in_folder(folder.path());
    let watch = TokenWatch::open(file.clone()).unwrap();
    let access = access(&watch);
    let running = tokio::spawn(watch.check_every(Duration::from_millis(20)));
    let (token, made) = file.create(new("ann", &[Role::Edit])).unwrap();
    until(|| access.who(token.text()).is_some()).await;
    let who = access.who(token.text()).unwrap();
    assert_eq!((who.user(), who.token()), ("ann", made.id.as_str()));
    assert!(who.may(Role::View) && !who.may(Role::Export));
    let other = token.text().replace(&made.id, "000000000000");
    for wrong in [other.as_str(), &token.text()[..token.text().len() - 1], "isop__"] {
        assert!(access.who(wrong).is_none(), "{wrong}");
    }
    // Another token, which changes the file, is not this one's end.
    file.create(new("bob", &[Role::View])).unwrap();
    let ended = tokio::time::timeout(Duration::from_millis(200), who.ended()).await;
    assert!(ended.is_err(), "it holds");
    file.revoke(&made.id).unwrap();
    let ended = tokio::time::timeout(Duration::from_secs(5), who.ended()).await;
    assert!(ended.is_ok() && access.who(token.text()).is_none());
    running.abort();
}

#[tokio::test]
async fn while_the_file_cannot_be_read_it_lets_nobody_in() {
    let folder = tempfile::tempdir().unwrap();
    let file = TokenFile::in_folder(folder.path());
    let (token, _) = file.create(new("ann", &[Role::Edit])).unwrap();
    let watch = TokenWatch::open(file).unwrap();
    let access = access(&watch);
    let running = tokio::spawn(watch.check_every(Duration::from_millis(20)));
    let path = folder.path().join(FILE);
    let text = std::fs::read(&path).unwrap();
    std::fs::write(&path, "{").unwrap();
    until(|| access.who(token.text()).is_none()).await;
    std::fs::write(&path, text).unwrap();
    until(|| access.who(token.text()).is_some()).await;
    std::fs::remove_file(&path).unwrap();
    until(|| access.who(token.text()).is_none()).await;
    running.abort();
}

#[tokio::test]
async fn an_expired_token_ends_by_itself() {
    let folder = tempfile::tempdir().unwrap();
    let file = TokenFile::in_folder(folder.path());
    let lifetime = Some(Duration::from_secs(2));
    let (token, made) = file
        .create(NewToken {
            lifetime,
            ..new("ann", &[Role::View])
        })
        .unwrap();
    let watch = TokenWatch::open(file).unwrap();
    let who = access(&watch).who(token.text()).expect("it holds for two seconds");
    tokio::time::timeout(Duration::from_secs(5), who.ended())
        .await
        .expect("it has expired");
    assert!(made.has_expired(now()));
    assert!(access(&watch).who(token.text()).is_none());
}
