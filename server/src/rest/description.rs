//! Parts of the API description that are common to every operation: authentication, and answers of the layers in front of the handlers.

use clap::ValueEnum as _;
use utoipa::Modify;
use utoipa::openapi::path::Operation;
use utoipa::openapi::security::{Http, HttpAuthScheme, SecurityRequirement, SecurityScheme};
use utoipa::openapi::{Content, OneOfBuilder, OpenApi, Ref, RefOr, Response};

use crate::export::Format;

/// Media type of problems.
const PROBLEM: &str = "application/problem+json";

/// The scheme of tokens.
const TOKEN: &str = "token";

/// Answers of the gate, which every path below `/api/` may give.
const OF_GATE: [(&str, &str); 4] = [
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

/// Completes a description.
pub(super) struct Completed;

impl Modify for Completed {
    fn modify(&self, openapi: &mut OpenApi) {
        let components = openapi.components.get_or_insert_default();
        let mut bearer = Http::new(HttpAuthScheme::Bearer);
        bearer.description = Some("A token of the server; a server with `--no-auth` asks for none".into());
        components.add_security_scheme(TOKEN, SecurityScheme::Http(bearer));
        let none: [&str; 0] = [];
        let asked = SecurityRequirement::new(TOKEN, none);
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
                // An empty requirement: a server may run without authentication.
                let security = if PUBLIC.contains(&path.as_str()) {
                    vec![SecurityRequirement::default()]
                } else {
                    vec![asked.clone(), SecurityRequirement::default()]
                };
                operation.security = Some(security);
                if path.starts_with("/api/") {
                    complete(operation);
                }
            }
        }
    }
}

/// Adds the media types of all file formats to answers that may be a GLB.
fn name_formats(operation: &mut Operation) {
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

/// For an answer that is JSON or a problem: gives its JSON the schemas of both, because generated clients accept one content type per
/// status.
fn join_problems(operation: &mut Operation) {
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
    name_formats(operation);
    join_problems(operation);
    for (status, description) in OF_GATE {
        let answers = &mut operation.responses.responses;
        answers.entry(status.to_owned()).or_insert_with(|| {
            let problem = Content::new(Some(Ref::from_schema_name("Problem")));
            let mut response = Response::new(description);
            response.content.insert(PROBLEM.into(), problem.into());
            RefOr::T(response)
        });
    }
}
