use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use axum::extract::{Form, State};
use axum::http::HeaderMap;
use axum::routing::{get, post};
use axum::{Json, Router};
use base64::Engine;
use base64::engine::general_purpose::{STANDARD, URL_SAFE_NO_PAD};
use jsonwebtoken::jwk::JwkSet;
use ring::rand::SystemRandom;
use ring::signature::{
    ECDSA_P256_SHA256_FIXED_SIGNING, EcdsaKeyPair, KeyPair, RSA_PKCS1_SHA256, RSA_PSS_SHA256, RsaKeyPair,
};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use tokio::net::TcpListener;

use super::*;
use crate::access::named::now;

const ISSUER: &str = "https://login.example";
const CLIENT: &str = "isopeel";
const NONCE: &str = "a nonce";

/// Keys of an issuer.
struct Keys {
    rsa: RsaKeyPair,
    ec: EcdsaKeyPair,
    random: SystemRandom,
}

fn base64(bytes: impl AsRef<[u8]>) -> String {
    URL_SAFE_NO_PAD.encode(bytes)
}

impl Keys {
    fn new() -> Self {
        let random = SystemRandom::new();
        let ec = EcdsaKeyPair::generate_pkcs8(&ECDSA_P256_SHA256_FIXED_SIGNING, &random).unwrap();
        Self {
            rsa: RsaKeyPair::from_pkcs8(include_bytes!("test-key.pk8")).unwrap(),
            ec: EcdsaKeyPair::from_pkcs8(&ECDSA_P256_SHA256_FIXED_SIGNING, ec.as_ref(), &random).unwrap(),
            random,
        }
    }

    fn listed(&self) -> Value {
        let (rsa, point) = (self.rsa.public(), self.ec.public_key().as_ref());
        let rsa = ring::signature::RsaPublicKeyComponents::<Vec<u8>>::from(rsa);
        let (n, e) = (base64(rsa.n), base64(rsa.e));
        json!({"keys": [
            {"kty": "RSA", "kid": "rsa", "use": "sig", "n": n, "e": e},
            {"kty": "RSA", "kid": "secrets", "use": "enc", "n": n, "e": e},
            {"kty": "EC", "kid": "ec", "crv": "P-256", "alg": "ES256", "x": base64(&point[1..33]), "y": base64(&point[33..])},
        ]})
    }

    fn set(&self) -> JwkSet {
        serde_json::from_value(self.listed()).unwrap()
    }

    fn sign(&self, header: &Value, claims: &Value) -> String {
        let message = format!("{}.{}", base64(header.to_string()), base64(claims.to_string()));
        let rsa = |by| {
            let mut signature = vec![0; self.rsa.public().modulus_len()];
            self.rsa
                .sign(by, &self.random, message.as_bytes(), &mut signature)
                .unwrap();
            signature
        };
        let signature = match header["alg"].as_str() {
            Some("RS256") => rsa(&RSA_PKCS1_SHA256),
            Some("PS256") => rsa(&RSA_PSS_SHA256),
            Some("ES256") => self
                .ec
                .sign(&self.random, message.as_bytes())
                .unwrap()
                .as_ref()
                .to_vec(),
            // A known attack: the public key as a secret.
            Some("HS256") => {
                let key = ring::hmac::Key::new(ring::hmac::HMAC_SHA256, self.rsa.public().as_ref());
                ring::hmac::sign(&key, message.as_bytes()).as_ref().to_vec()
            }
            _ => Vec::new(),
        };
        format!("{message}.{}", base64(signature))
    }
}

fn claims() -> Value {
    json!({"iss": ISSUER, "aud": CLIENT, "sub": "7", "exp": now() + 60, "iat": now(), "nonce": NONCE, "groups": ["staff"]})
}

fn with(mut claims: Value, name: &str, value: Value) -> Value {
    claims[name] = value;
    claims
}

fn check(keys: &Keys, token: &str) -> Result<Claims, ClaimsError> {
    let expected = Expected {
        issuer: ISSUER,
        client_id: CLIENT,
        nonce: NONCE,
    };
    Claims::check(token, &keys.set(), &expected)
}

#[test]
fn tokens_of_the_issuer_for_this_sign_in_are_believed() {
    let keys = Keys::new();
    for (alg, kid) in [("RS256", "rsa"), ("PS256", "rsa"), ("ES256", "ec")] {
        let token = keys.sign(&json!({"alg": alg, "kid": kid}), &claims());
        assert_eq!(check(&keys, &token).unwrap().sub, "7", "{alg}");
    }
    // The only key of its kind needs no name.
    let token = keys.sign(&json!({"alg": "ES256"}), &claims());
    check(&keys, &token).unwrap();
    let many = with(with(claims(), "aud", json!([CLIENT, "other"])), "azp", json!(CLIENT));
    check(&keys, &keys.sign(&json!({"alg": "ES256"}), &many)).unwrap();
}

#[test]
fn all_others_are_not() {
    let keys = Keys::new();
    let good = json!({"alg": "RS256", "kid": "rsa"});
    let unsigned = |alg: &str| json!({"alg": alg, "kid": "rsa"});
    let mut without = claims();
    without.as_object_mut().unwrap().remove("exp");
    let altered = {
        let token = keys.sign(&good, &claims());
        let signature = token.rsplit('.').next().unwrap();
        let message = format!(
            "{}.{}",
            base64(good.to_string()),
            base64(with(claims(), "sub", json!("1")).to_string())
        );
        format!("{message}.{signature}")
    };
    let tokens = [
        ("altered", altered),
        ("unsigned", keys.sign(&unsigned("none"), &claims())),
        (
            "signed by the client's kind of key",
            keys.sign(&unsigned("HS256"), &claims()),
        ),
        (
            "of a key that is not listed",
            keys.sign(&json!({"alg": "RS256", "kid": "old"}), &claims()),
        ),
        (
            "of a key for encryption",
            keys.sign(&json!({"alg": "RS256", "kid": "secrets"}), &claims()),
        ),
        (
            "of a key of another kind",
            keys.sign(&json!({"alg": "RS256", "kid": "ec"}), &claims()),
        ),
        (
            "issuer",
            keys.sign(&good, &with(claims(), "iss", json!("https://evil.example"))),
        ),
        ("audience", keys.sign(&good, &with(claims(), "aud", json!("other")))),
        (
            "several audiences",
            keys.sign(&good, &with(claims(), "aud", json!([CLIENT, "other"]))),
        ),
        (
            "authorized party",
            keys.sign(&good, &with(claims(), "azp", json!("other"))),
        ),
        ("expired", keys.sign(&good, &with(claims(), "exp", json!(now() - 60)))),
        ("no expiry", keys.sign(&good, &without)),
        (
            "an expiry that is no number",
            keys.sign(&good, &with(claims(), "exp", json!("9999999999"))),
        ),
        ("not yet", keys.sign(&good, &with(claims(), "nbf", json!(now() + 120)))),
        ("nonce", keys.sign(&good, &with(claims(), "nonce", json!("another")))),
        ("no nonce", keys.sign(&good, &with(claims(), "nonce", Value::Null))),
        ("nobody", keys.sign(&good, &with(claims(), "sub", json!("")))),
        (
            "a long name",
            keys.sign(&good, &with(claims(), "sub", json!("7".repeat(256)))),
        ),
        (
            "a name in other letters",
            keys.sign(&good, &with(claims(), "sub", json!("ä"))),
        ),
        (
            "issued in the future",
            keys.sign(&good, &with(claims(), "iat", json!(now() + 36_000))),
        ),
        ("no token", "abc".to_owned()),
        ("nothing", String::new()),
    ];
    check(&keys, &keys.sign(&good, &claims())).unwrap();
    for (what, token) in tokens {
        assert!(check(&keys, &token).is_err(), "{what}");
    }
}

#[test]
fn groups_are_found_where_issuers_have_them() {
    let keys = Keys::new();
    let names = |claims: &Value, claim: &str| {
        let token = keys.sign(&json!({"alg": "ES256"}), claims);
        let checked = check(&keys, &token).unwrap();
        checked
            .names(claim)
            .iter()
            .map(|name| name.to_string())
            .collect::<Vec<_>>()
    };
    assert_eq!(names(&claims(), "groups"), ["staff"]);
    assert_eq!(names(&with(claims(), "groups", json!("one")), "groups"), ["one"]);
    let nested = with(claims(), "realm_access", json!({"roles": ["a", 3, "b"]}));
    assert_eq!(names(&nested, "realm_access.roles"), ["a", "b"]);
    for claim in ["none", "groups.deeper", "realm_access.none", ""] {
        assert_eq!(names(&nested, claim), [""; 0], "{claim}");
    }
}

/// An issuer on a port of its own.
struct Issuer {
    address: String,
    keys: Mutex<Keys>,
    /// How often its keys were asked for.
    asked: AtomicUsize,
    /// Claims of the next token; the nonce is that of the sign-in.
    claims: Mutex<Value>,
    /// What a browser came with: nonce and challenge.
    browser: Mutex<(String, String)>,
}

async fn keys_of(State(issuer): State<Arc<Issuer>>) -> Json<Value> {
    issuer.asked.fetch_add(1, Ordering::Relaxed);
    Json(issuer.keys.lock().unwrap().listed())
}

async fn metadata_of(State(issuer): State<Arc<Issuer>>) -> Json<Value> {
    let at = |path: &str| format!("{}/{path}", issuer.address);
    Json(json!({
        "issuer": issuer.address, "authorization_endpoint": at("authorize?theme=dark"), "token_endpoint": at("token"),
        "jwks_uri": at("keys"), "end_session_endpoint": at("end"),
    }))
}

type Fields = std::collections::HashMap<String, String>;

async fn token_of(
    State(issuer): State<Arc<Issuer>>,
    headers: HeaderMap,
    Form(form): Form<Fields>,
) -> Result<Json<Value>, StatusCode> {
    let (nonce, challenge) = issuer.browser.lock().unwrap().clone();
    let basic = format!("Basic {}", STANDARD.encode("isopeel:a%20secret"));
    let is_right = headers
        .get("authorization")
        .is_some_and(|value| value.to_str().unwrap() == basic)
        && form["grant_type"] == "authorization_code"
        && form["code"] == "a code"
        && form["redirect_uri"] == "http://localhost:8417/lab/api/v1/oidc/callback"
        && base64(Sha256::digest(&form["code_verifier"])) == challenge;
    if !is_right {
        return Err(StatusCode::BAD_REQUEST);
    }
    let claims = with(issuer.claims.lock().unwrap().clone(), "nonce", json!(nonce));
    let token = issuer
        .keys
        .lock()
        .unwrap()
        .sign(&json!({"alg": "ES256", "kid": "ec"}), &claims);
    Ok(Json(
        json!({"id_token": token, "access_token": "x", "token_type": "Bearer"}),
    ))
}

async fn issuer() -> Arc<Issuer> {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = format!("http://{}", listener.local_addr().unwrap());
    let issuer = Arc::new(Issuer {
        claims: Mutex::new(with(claims(), "iss", json!(address))),
        address,
        keys: Mutex::new(Keys::new()),
        asked: AtomicUsize::new(0),
        browser: Mutex::default(),
    });
    let router = Router::new()
        .route("/.well-known/openid-configuration", get(metadata_of))
        .route("/keys", get(keys_of))
        .route("/token", post(token_of))
        .with_state(Arc::clone(&issuer));
    tokio::spawn(async move { axum::serve(listener, router).await });
    issuer
}

fn options(issuer: &str) -> OidcOptions {
    OidcOptions {
        issuer: issuer.to_owned(),
        client_id: CLIENT.into(),
        client_secret: Some("a secret".into()),
        scope: "openid groups".into(),
        groups_claim: "groups".into(),
        roles: ["staff=edit,export", "guests=view"]
            .map(|roles| roles.parse().unwrap())
            .into(),
    }
}

fn oidc(issuer: &str) -> Oidc {
    Oidc::new(options(issuer), &"http://localhost:8417/lab".parse().unwrap(), None).unwrap()
}

/// A browser goes to the issuer: its secret, and the state that comes back.
async fn go(oidc: &Oidc, issuer: &Issuer) -> (String, String) {
    let (address, secret) = oidc.begin().await.unwrap();
    let address: Url = address.parse().unwrap();
    let query: Fields = address.query_pairs().into_owned().collect();
    for (name, value) in [
        ("response_type", "code"),
        ("client_id", CLIENT),
        ("redirect_uri", "http://localhost:8417/lab/api/v1/oidc/callback"),
        ("code_challenge_method", "S256"),
        ("theme", "dark"),
    ] {
        assert_eq!(query[name], value);
    }
    assert_eq!(query["scope"], "openid groups");
    *issuer.browser.lock().unwrap() = (query["nonce"].clone(), query["code_challenge"].clone());
    (secret, query["state"].clone())
}

#[tokio::test]
async fn who_signs_in_has_the_roles_of_their_groups() {
    let issuer = issuer().await;
    let oidc = oidc(&issuer.address);
    let (secret, state) = go(&oidc, &issuer).await;
    let confirmed = oidc.end(Some(&secret), &state, "a code").await.unwrap();
    assert_eq!(
        (confirmed.user.as_str(), confirmed.roles.to_string().as_str()),
        ("oidc:7", "edit, export")
    );
    // What came back is of no use once more, nor in another browser, and no code is none.
    assert!(oidc.end(Some(&secret), &state, "a code").await.is_err());
    let (secret, state) = go(&oidc, &issuer).await;
    assert!(oidc.end(None, &state, "a code").await.is_err());
    assert!(oidc.end(Some("another"), &state, "a code").await.is_err());
    let refused = oidc.end(Some(&secret), &state, "another code").await.unwrap_err();
    assert_eq!((refused.status().as_u16(), refused.code()), (502, "issuer"));
    // Groups of which none is known here.
    let strangers = with(issuer.claims.lock().unwrap().clone(), "groups", json!(["visitors"]));
    *issuer.claims.lock().unwrap() = strangers;
    let (secret, state) = go(&oidc, &issuer).await;
    let refused = oidc.end(Some(&secret), &state, "a code").await.unwrap_err();
    assert_eq!(refused.status().as_u16(), 403);
    assert_eq!(issuer.asked.load(Ordering::Relaxed), 1, "its keys are kept");
    let end = oidc.sign_out().await.unwrap();
    assert!(
        end.contains("post_logout_redirect_uri=http%3A%2F%2Flocalhost%3A8417%2Flab%2F"),
        "{end}"
    );
}

#[tokio::test]
async fn new_keys_of_the_issuer_are_asked_for_when_they_are_met() {
    let issuer = issuer().await;
    let oidc = oidc(&issuer.address);
    let (secret, state) = go(&oidc, &issuer).await;
    // With other names, as keys are replaced.
    if let Some((_, _, keys)) = &mut oidc.provider.cache.lock().await.answer {
        keys.keys.clear();
    }
    assert!(oidc.end(Some(&secret), &state, "a code").await.is_ok());
    assert_eq!(issuer.asked.load(Ordering::Relaxed), 2);
}

#[tokio::test]
async fn an_issuer_that_is_away_or_another_one_is_said() {
    let refused = oidc("http://127.0.0.1:9").begin().await.unwrap_err();
    assert_eq!((refused.status().as_u16(), refused.code()), (502, "issuer"));
    let issuer = issuer().await;
    let other = oidc(&issuer.address.replace("127.0.0.1", "localhost"));
    let refused = other.begin().await.unwrap_err();
    assert_eq!(refused.code(), "issuer");
}

/// Each of them would wait for as long as the ones before together.
#[tokio::test]
async fn those_who_sign_in_while_the_issuer_hangs_wait_for_one_time_limit() {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let oidc = oidc(&format!("http://{}", listener.local_addr().unwrap()));
    // Takes requests and closes them unanswered, after a while in which the others have come.
    let issuer = tokio::spawn(async move {
        let mut asked = 0;
        while let Ok((socket, _)) = listener.accept().await {
            asked += 1;
            tokio::time::sleep(Duration::from_millis(300)).await;
            drop(socket);
            if asked == 4 {
                break;
            }
        }
    });
    let start = Instant::now();
    let all = (0..6).map(|_| {
        let oidc = oidc.clone();
        tokio::spawn(async move { oidc.begin().await.unwrap_err().code() })
    });
    for one in all.collect::<Vec<_>>() {
        assert_eq!(one.await.unwrap(), "issuer");
    }
    // The client may ask a second time after a connection was closed.
    assert!(start.elapsed() < Duration::from_millis(1_100), "{:?}", start.elapsed());
    issuer.abort();
}

#[test]
fn options_that_let_nobody_or_anybody_in_are_refused() {
    let public = "https://volumes.example".parse().unwrap();
    for issuer in [
        "login.example",
        "http://login.example",
        "https://login.example?x",
        "ftp://login.example",
        "",
    ] {
        assert!(
            matches!(Oidc::new(options(issuer), &public, None), Err(OidcError::Issuer(_))),
            "{issuer}"
        );
    }
    let nobody = OidcOptions {
        roles: Vec::new(),
        ..options(ISSUER)
    };
    assert!(matches!(Oidc::new(nobody, &public, None), Err(OidcError::NoRoles)));
    for roles in ["staff", "=view", "staff=", "staff=root", "staff=view,"] {
        assert!(roles.parse::<GroupRoles>().is_err(), "{roles}");
    }
    assert!(
        "a=b=view".parse::<GroupRoles>().is_ok(),
        "a group's name may have a sign of equality"
    );
    assert!(!format!("{:?}", oidc(ISSUER)).contains("a secret"));
}
