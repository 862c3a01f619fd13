//! Completes the OpenAPI description with what many operations share: authentication, file formats, and the responses of the gate.

use clap::ValueEnum as _;
use utoipa::Modify;
use utoipa::openapi::path::Operation;
use utoipa::openapi::security::{Http, HttpAuthScheme, SecurityRequirement, SecurityScheme};
use utoipa::openapi::{Content, OneOfBuilder, OpenApi, Ref, RefOr, Response};

use crate::export::Format;

/// Media type of problem documents.
const PROBLEM: &str = "application/problem+json";

/// Name of the security scheme for tokens.
const TOKEN: &str = "token";

/// Responses of the gate, which are possible for every path below `/api/`: status and description.
const GATE_RESPONSES: [(&str, &str); 4] = [
    ("401", "`unauthorized`: no token, or one that is not valid"),
    (
        "403",
        "`forbidden`: the token lacks the role; `foreign-origin`: a page of another origin",
    ),
    ("421", "`foreign-host`: the request is for another host"),
    ("429", "`too-many-requests`"),
];

/// Paths that need no token.
const PUBLIC: [&str; 4] = ["/healthz", "/readyz", "/api/v1/oidc", "/api/v1/embed"];

/// Modifier that completes a description.
pub(super) struct Completed;

impl Modify for Completed {
    fn modify(&self, openapi: &mut OpenApi) {
        let components = openapi.components.get_or_insert_default();
        let mut bearer = Http::new(HttpAuthScheme::Bearer);
        bearer.description = Some("A token of the server; a server with `--no-auth` asks for none".into());
        components.add_security_scheme(TOKEN, SecurityScheme::Http(bearer));
        let none: [&str; 0] = [];
        let token_required = SecurityRequirement::new(TOKEN, none);
        for (path, item) in &mut openapi.paths.paths {
            let operations = [
                &mut item.get,
                &mut item.put,
                &mut item.post,
                &mut item.delete,
                &mut item.head,
                &mut item.patch,
            ];
            for operation in operations.into_iter().flatten() {
                // The empty requirement makes the token optional, because a server may run without authentication.
                let security = if PUBLIC.contains(&path.as_str()) {
                    vec![SecurityRequirement::default()]
                } else {
                    vec![token_required.clone(), SecurityRequirement::default()]
                };
                operation.security = Some(security);
                if path.starts_with("/api/") {
                    complete(operation);
                }
            }
        }
    }
}

/// Adds the media types of all file formats to responses that may be a GLB.
fn add_formats(operation: &mut Operation) {
    for response in operation.responses.responses.values_mut() {
        let RefOr::T(response) = response else { continue };
        let Some(file) = response.content.get(Format::Glb.content_type()).cloned() else {
            continue;
        };
        for format in Format::value_variants() {
            response.content.insert(format.content_type().to_owned(), file.clone());
        }
    }
}

/// Gives a response that is either JSON or a problem document one JSON schema for both, because generated clients accept one content type
/// per status.
fn merge_problems(operation: &mut Operation) {
    for response in operation.responses.responses.values_mut() {
        let RefOr::T(response) = response else { continue };
        let Some(RefOr::T(Content {
            schema: Some(problem), ..
        })) = response.content.get(PROBLEM).cloned()
        else {
            continue;
        };
        if let Some(RefOr::T(Content { schema: Some(json), .. })) = response.content.get_mut("application/json") {
            *json = OneOfBuilder::new().item(json.clone()).item(problem).into();
        }
    }
}

fn complete(operation: &mut Operation) {
    add_formats(operation);
    merge_problems(operation);
    for (status, description) in GATE_RESPONSES {
        let responses = &mut operation.responses.responses;
        responses.entry(status.to_owned()).or_insert_with(|| {
            let problem = Content::new(Some(Ref::from_schema_name("Problem")));
            let mut response = Response::new(description);
            response.content.insert(PROBLEM.into(), problem.into());
            RefOr::T(response)
        });
    }
}
