//! Sign-in through an OpenID Connect issuer: redirects a browser to the issuer, and receives the browser when it returns with a code.

use axum::Json;
use axum::extract::{Query, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::ApiState;
use crate::problem::{ApiError, Problem, ProblemCode};

/// How users can sign in without a token.
#[derive(Serialize, ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct SignInWays {
    /// Sign-in through an issuer; null if the server has no issuer.
    #[schema(required)]
    sign_in: Option<SignIn>,
}

/// The issuer through which users sign in.
#[derive(Serialize, ToSchema)]
pub struct SignIn {
    /// Address of the issuer.
    issuer: String,
    /// Address to which a browser is sent to sign in, relative to the server's address.
    login: &'static str,
}

/// What the issuer sends a browser back with.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub struct Callback {
    /// Code for which the issuer gives the server an ID token.
    code: Option<String>,
    /// Identifies the sign-in that the browser returns from.
    state: Option<String>,
    /// Error code of the issuer, if there is no `code`.
    error: Option<String>,
}

/// The issuer through which users sign in, if there is one.
#[utoipa::path(
    get,
    path = "/api/v1/oidc",
    operation_id = "show_oidc",
    tag = "session",
    responses((status = 200, description = "The issuer, or null", body = SignInWays)),
)]
pub async fn show(State(state): State<ApiState>) -> Json<SignInWays> {
    let sign_in = state.access.oidc().map(|oidc| SignIn {
        issuer: oidc.issuer().to_owned(),
        login: "api/v1/oidc/login",
    });
    Json(SignInWays { sign_in })
}

/// Sends a browser to the issuer.
#[utoipa::path(
    get,
    path = "/api/v1/oidc/login",
    operation_id = "sign_in",
    tag = "session",
    responses(
        (status = 303, description = "Redirect to the issuer", headers(
            ("location" = String, description = "Address of the issuer"),
            ("set-cookie" = String, description = "Cookie of the sign-in, which the browser sends when it returns"),
        )),
        (status = 404, description = "`not-found`: the server has no issuer", body = Problem, content_type = "application/problem+json"),
        (status = 502, description = "`issuer`: the request to the issuer failed", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub async fn login(State(state): State<ApiState>) -> Result<Response, ApiError> {
    let (address, cookie) = state.access.begin_sign_in().await?;
    redirect(&address, [cookie])
}

/// The address to which the issuer sends a browser back: signs in, and redirects to the viewer with a cookie.
#[utoipa::path(
    get,
    path = "/api/v1/oidc/callback",
    operation_id = "complete_sign_in",
    tag = "session",
    params(Callback),
    responses(
        (status = 303, description = "Redirect to the viewer: with a cookie, or with the reason of the failure in `#sign-in-failed=`", headers(
            ("location" = String, description = "The viewer's address"),
        )),
        (status = 404, description = "`not-found`: the server has no issuer", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub async fn callback(
    State(state): State<ApiState>,
    headers: HeaderMap,
    query: Result<Query<Callback>, axum::extract::rejection::QueryRejection>,
) -> Result<Response, ApiError> {
    let Query(Callback {
        code,
        state: sign_in_state,
        error,
    }) = query?;
    let Some(oidc) = state.access.oidc() else {
        return Err(no_issuer());
    };
    let signed_in = match (code, sign_in_state) {
        (Some(code), Some(sign_in_state)) => state.access.end_sign_in(&headers, &sign_in_state, &code).await,
        // The error is an ASCII word of the issuer (RFC 6749, section 4.1.2.1).
        _ => Err(ApiError::new(
            StatusCode::UNAUTHORIZED,
            "unauthorized",
            format!("the issuer says {:?}", error.as_deref().unwrap_or("nothing")),
        )),
    };
    match signed_in {
        Ok((who, cookies)) => {
            let mut response = redirect(oidc.home(), cookies)?;
            // The audit log reads the identity from the response.
            response.extensions_mut().insert(who);
            Ok(response)
        }
        Err(error) => {
            error.log();
            let mut response = redirect(&state.access.sign_in_failed(&error), [])?;
            // The audit log reads the code from the response.
            response.extensions_mut().insert(ProblemCode(error.code()));
            Ok(response)
        }
    }
}

/// Signs the user out. The response has the address at which to sign out at the issuer too, if there is one.
#[utoipa::path(
    delete,
    path = "/api/v1/session",
    operation_id = "sign_out",
    tag = "session",
    responses(
        (status = 200, description = "The cookie is no longer valid, and the streams that it has opened are closed", body = SignedOut),
        (status = 401, description = "`unauthorized`", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub async fn sign_out(State(state): State<ApiState>, headers: HeaderMap) -> Result<Response, ApiError> {
    let (end_session, cookie) = state.access.sign_out(&headers).await;
    let mut response = Json(SignedOut { end_session }).into_response();
    response.headers_mut().insert(header::SET_COOKIE, cookie);
    Ok(response)
}

/// The response to a sign-out.
#[derive(Serialize, ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct SignedOut {
    /// Address at which a browser ends the session at the issuer.
    #[schema(required)]
    end_session: Option<String>,
}

fn no_issuer() -> ApiError {
    ApiError::new(
        StatusCode::NOT_FOUND,
        "not-found",
        "this server has no issuer to sign in through: authenticate with a token",
    )
}

fn redirect(address: &str, cookies: impl IntoIterator<Item = HeaderValue>) -> Result<Response, ApiError> {
    let address = HeaderValue::try_from(address).map_err(ApiError::internal)?;
    let mut response = StatusCode::SEE_OTHER.into_response();
    let headers: &mut HeaderMap = response.headers_mut();
    headers.insert(header::LOCATION, address);
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    let set_cookie: HeaderName = header::SET_COOKIE;
    for cookie in cookies {
        headers.append(&set_cookie, cookie);
    }
    Ok(response)
}
