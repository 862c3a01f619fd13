//! Requests that need no device, through the whole router.

use std::collections::HashSet;
use std::sync::Arc;

use axum::Extension;
use axum::body::Body;
use axum::http::{Method, Request, StatusCode, header};
use axum::middleware::from_fn_with_state;
use axum::response::Response;
use isopeel_kernels::SampleType;
use isopeel_volumes::{
    Catalog, Dataset, Field, FileLocation, Geometry, Notices, ReadError, ReadProgress, Samples, Source,
};
use serde_json::{Value, json};
use tower::ServiceExt;

use super::*;
use crate::access::gate::admit;
use crate::access::{Access, Identity, NewToken, Role, Token, TokenFile, TokenWatch};
use crate::service::DeviceWorker;

#[derive(Debug)]
struct Ramp;

impl Source for Ramp {
    fn stored_bytes(&self) -> u64 {
        8
    }

    fn inputs(&self, _: u32) -> Vec<FileLocation> {
        Vec::new()
    }

    fn read(&self, _: u32, _: &ReadProgress) -> Result<Samples, ReadError> {
        Ok(Samples::U8((0..8).collect()))
    }
}

fn catalog() -> Catalog {
    let mut catalog = Catalog::default();
    catalog.add(Dataset {
        id: "ramp".into(),
        title: "Ramp".into(),
        layout: "file",
        geometry: Geometry::of_index([2; 3]),
        steps: 2,
        uneven: None,
        axes: None,
        times: None,
        revision: 0,
        rewrites: Vec::new(),
        fields: vec![Field {
            name: "value".into(),
            stored_type: "uint8".into(),
            sample_type: SampleType::U8,
            missing: None,
            unit: Some("K".into()),
            labels: Vec::new(),
            declares_labels: false,
            source: Arc::new(Ramp),
        }],
        notices: Notices::of("made here"),
        opening: Some(serde_json::json!({})),
    });
    catalog
}

/// With a device that does not exist, so that these tests do the same on every machine.
fn state() -> ApiState {
    let worker = DeviceWorker::start(Some("a device that is nowhere".into())).unwrap();
    let access = Access::new(([127, 0, 0, 1], 8417).into(), &[], &[]);
    ApiState::new(catalog().into(), worker, access)
}

async fn send(request: Request<Body>) -> Response {
    let behind_a_gate = router(state()).layer(Extension(Identity::without_token()));
    behind_a_gate.oneshot(request).await.unwrap()
}

async fn get(path: &str) -> Response {
    send(Request::get(path).body(Body::empty()).unwrap()).await
}

async fn post(body: impl Into<Body>) -> Response {
    let request = Request::post("/api/v1/extract").header(header::CONTENT_TYPE, "application/json");
    send(request.body(body.into()).unwrap()).await
}

async fn body(response: Response) -> Value {
    let bytes = axum::body::to_bytes(response.into_body(), 1 << 20).await.unwrap();
    serde_json::from_slice(&bytes).unwrap()
}

/// Checks that the answer is a problem in every part; returns its detail.
async fn problem(response: Response, status: StatusCode, code: &str) -> String {
    assert_eq!(response.status(), status);
    assert_eq!(response.headers()[header::CONTENT_TYPE], "application/problem+json");
    let mut problem = body(response).await;
    let detail = problem["detail"].take();
    let expected = json!({
        "type": format!("urn:isopeel:problem:{code}"),
        "title": status.canonical_reason().unwrap(),
        "status": status.as_u16(),
        "detail": null,
        "code": code,
    });
    assert_eq!(problem, expected);
    detail.as_str().unwrap().to_owned()
}

#[tokio::test]
async fn volumes_are_listed_without_a_device() {
    let response = get("/api/v1/volumes").await;
    assert_eq!(response.status(), StatusCode::OK);
    let expected = json!([{
        "id": "ramp",
        "title": "Ramp",
        "dims": [2, 2, 2],
        "steps": 2,
        "fields": ["value"],
        "notice": "made here",
        "jobServer": null,
    }]);
    assert_eq!(body(response).await, expected);
}

#[tokio::test]
async fn of_several_servers_lists_and_errors_name_the_one_for_jobs_and_uploads() {
    let several = state().with_job_server(Some("first".into()));
    let behind_a_gate = router(several).layer(Extension(Identity::without_token()));
    let get = |path: &str| {
        behind_a_gate
            .clone()
            .oneshot(Request::get(path).body(Body::empty()).unwrap())
    };
    let listed = body(get("/api/v1/volumes").await.unwrap()).await;
    assert_eq!(listed[0]["jobServer"], "first");
    for (path, code) in [("/api/v1/jobs/1", "jobs-off"), ("/api/v1/uploads/1", "uploads-off")] {
        let detail = problem(get(path).await.unwrap(), StatusCode::NOT_IMPLEMENTED, code).await;
        assert!(detail.contains("\"first\" takes them"), "{detail}");
    }
    let unknown = get("/api/v1/volumes/upload-1").await.unwrap();
    let detail = problem(unknown, StatusCode::NOT_FOUND, "unknown-volume").await;
    assert!(
        detail.ends_with("an upload belongs to the server that took it"),
        "{detail}"
    );
}

#[tokio::test]
async fn volumes_and_steps_that_are_not_there_are_named() {
    let detail = problem(
        get("/api/v1/volumes/nothing").await,
        StatusCode::NOT_FOUND,
        "unknown-volume",
    )
    .await;
    assert!(detail.contains("\"nothing\""), "{detail}");
    let detail = problem(
        get("/api/v1/volumes/ramp?step=2").await,
        StatusCode::NOT_FOUND,
        "unknown-step",
    )
    .await;
    assert!(detail.contains("step 2") && detail.contains("0 to 1"), "{detail}");
    for path in [
        "/api/v1/volumes/ramp?step=-1",
        "/api/v1/volumes/ramp?stp=1",
        "/api/v1/volumes/%ff",
    ] {
        problem(get(path).await, StatusCode::BAD_REQUEST, "bad-request").await;
    }
}

/// Returns the answer to a client if the samples of a volume cannot be read.
fn answer_to_unreadable(state: &ApiState, volume: &Dataset) -> (StatusCode, &'static str) {
    let unreadable = ReadError::new(std::path::Path::new("a.nrrd"), "data", "it has 3 bytes, expected 8");
    let error = isopeel_extraction::WorkError::from(unreadable);
    let error = state.failed(&Identity::without_token(), &[Arc::new(volume.clone())], error);
    (error.status(), error.code())
}

#[tokio::test]
async fn volumes_that_were_removed_are_unknown_and_broken_uploads_are_their_users_fault() {
    let (state, served) = (state(), catalog());
    let served = Dataset::clone(&served.datasets()[0]);
    let uploaded = Dataset {
        id: "upload-1".into(),
        ..served.clone()
    };
    let private = state.catalog.private();
    let owner = Identity::without_token().user().to_owned();
    private.add(&owner, [Arc::new(uploaded.clone())], std::time::SystemTime::now());
    assert_eq!(
        answer_to_unreadable(&state, &uploaded),
        (StatusCode::UNPROCESSABLE_ENTITY, "unreadable-volume")
    );
    assert_eq!(
        answer_to_unreadable(&state, &served),
        (StatusCode::INTERNAL_SERVER_ERROR, "unreadable-volume")
    );
    private.remove("upload-1");
    assert_eq!(
        answer_to_unreadable(&state, &uploaded),
        (StatusCode::NOT_FOUND, "unknown-volume")
    );
}

#[tokio::test]
async fn slices_that_are_not_there_are_refused_before_any_work() {
    let at = |query: &str| format!("/api/v1/volumes/ramp/slices?{query}");
    for (query, words) in [
        ("", "missing field `axis`"),
        ("axis=w&index=0", "unknown variant `w`"),
        ("axis=x", "missing field `index`"),
        ("axis=x&index=-1", "index: \"-1\", expected a whole number"),
        ("axis=x&index=0&format=jpg", "unknown variant `jpg`"),
        ("axis=x&index=0&colour=red", "unknown field `colour`"),
        ("axis=x&index=0&format=png&window=wide", "invalid float"),
    ] {
        let detail = problem(get(&at(query)).await, StatusCode::BAD_REQUEST, "bad-request").await;
        assert!(detail.contains(words), "{query}: {detail}");
    }
    for (query, words) in [
        ("axis=x&index=2", "index: 2, expected 0 to 1"),
        ("axis=z&index=4294967295", "index: 4294967295"),
        ("axis=x&index=0&window=1", "expected format=png"),
        ("axis=x&index=0&format=png&window=0", "window: 0"),
        ("axis=x&index=0&format=png&window=NaN", "window: NaN"),
        ("axis=x&index=0&format=png&level=inf", "level: inf"),
    ] {
        let detail = problem(get(&at(query)).await, StatusCode::UNPROCESSABLE_ENTITY, "bad-slice").await;
        assert!(detail.contains(words), "{query}: {detail}");
    }
    let detail = problem(
        get(&at("axis=x&index=0&field=pressure")).await,
        StatusCode::NOT_FOUND,
        "unknown-field",
    )
    .await;
    assert!(
        detail.contains("\"pressure\"") && detail.contains("\"value\""),
        "{detail}"
    );
    problem(
        get(&at("axis=x&index=0&step=2")).await,
        StatusCode::NOT_FOUND,
        "unknown-step",
    )
    .await;
    let nowhere = get("/api/v1/volumes/none/slices?axis=x&index=0").await;
    problem(nowhere, StatusCode::NOT_FOUND, "unknown-volume").await;
    problem(
        get(&at("axis=x&index=0")).await,
        StatusCode::SERVICE_UNAVAILABLE,
        "device",
    )
    .await;
}

#[tokio::test]
async fn more_slices_than_the_server_makes_are_told_to_come_back() {
    let state = state();
    let operator = Identity::without_token();
    let _all: Vec<_> = std::iter::from_fn(|| state.slices.acquire((&operator).into()).ok()).collect();
    let request = Request::get("/api/v1/volumes/ramp/slices?axis=x&index=0")
        .body(Body::empty())
        .unwrap();
    let response = router(state.clone())
        .layer(Extension(Identity::without_token()))
        .oneshot(request)
        .await
        .unwrap();
    assert_eq!(response.headers()[header::RETRY_AFTER], "2");
    problem(response, StatusCode::SERVICE_UNAVAILABLE, "busy").await;
}

#[tokio::test]
async fn paths_and_methods_that_are_not_there_are_problems() {
    for path in [
        "/api/v1/nothing",
        "/api/v2/volumes",
        "/api",
        "/nothing.txt",
        "/metrics/",
        "/healthz/",
        "/readyz/now",
    ] {
        let detail = problem(get(path).await, StatusCode::NOT_FOUND, "not-found").await;
        assert!(detail.contains(path), "{detail}");
    }
    let request = Request::delete("/api/v1/volumes").body(Body::empty()).unwrap();
    let response = send(request).await;
    assert_eq!(response.headers()[header::ALLOW], "GET,HEAD");
    problem(response, StatusCode::METHOD_NOT_ALLOWED, "method-not-allowed").await;
    let request = Request::builder()
        .method(Method::PUT)
        .uri("/")
        .body(Body::empty())
        .unwrap();
    problem(
        send(request).await,
        StatusCode::METHOD_NOT_ALLOWED,
        "method-not-allowed",
    )
    .await;
}

#[tokio::test]
async fn bodies_that_make_no_sense_are_problems() {
    for (text, words) in [
        ("{", "EOF"),
        ("not json", "expected"),
        (r#"{"volume":"ramp"}"#, "missing field `format`"),
        (
            r#"{"volume":"ramp","format":"glb","colour":1}"#,
            "unknown field `colour`",
        ),
    ] {
        let detail = problem(post(text).await, StatusCode::BAD_REQUEST, "bad-json").await;
        assert!(detail.contains(words), "{text}: {detail}");
    }
    let request = Request::post("/api/v1/extract").body(Body::from("{}")).unwrap();
    problem(
        send(request).await,
        StatusCode::UNSUPPORTED_MEDIA_TYPE,
        "unsupported-media-type",
    )
    .await;
    let large = format!(r#"{{"volume":"{}"}}"#, "x".repeat(MAX_BODY_BYTES));
    problem(post(large).await, StatusCode::PAYLOAD_TOO_LARGE, "body-too-large").await;
}

#[tokio::test]
async fn edits_out_of_range_are_refused_before_any_work() {
    for (edit, words) in [
        (json!({ "alpha": 2 }), "alpha: 2"),
        (json!({ "maxLevel": 6 }), "maxLevel: 6"),
        (json!({ "field": "pressure" }), "expected one of \"value\""),
        (
            json!({ "transferFunction": { "points": [] } }),
            "transferFunction: 0 points",
        ),
        (
            json!({ "interest": [{ "importance": 1 }] }),
            "interest: region 0 has neither",
        ),
        (json!({ "minPart": -1 }), "minPart: -1"),
        (json!({ "minPart": 1, "beta": 0.1 }), "minPart: 1 with beta alone"),
        (json!({ "parts": { "hide": [] } }), "parts: hide has 0 positions"),
        (
            json!({ "parts": { "keep": [[1, 2, 3]] }, "beta": 0.1 }),
            "parts: given with beta alone",
        ),
    ] {
        let mut request = json!({ "volume": "ramp", "format": "stl" });
        request
            .as_object_mut()
            .unwrap()
            .extend(edit.as_object().unwrap().clone());
        let response = post(request.to_string()).await;
        let detail = problem(response, StatusCode::UNPROCESSABLE_ENTITY, "bad-edit").await;
        assert!(detail.contains(words), "{detail}");
    }
    let response = post(r#"{"volume":"none","format":"stl"}"#).await;
    problem(response, StatusCode::NOT_FOUND, "unknown-volume").await;
    let response = post(r#"{"volume":"ramp","format":"stl","step":7}"#).await;
    problem(response, StatusCode::NOT_FOUND, "unknown-step").await;
}

#[tokio::test]
async fn a_mistake_in_an_expression_that_is_typed_is_an_answer() {
    let path = |typed: &str| format!("/api/v1/volumes/ramp/expression?expression=log(x{typed}");
    let wrong = get(&path("")).await;
    let detail = problem(wrong, StatusCode::UNPROCESSABLE_ENTITY, "bad-edit").await;
    let typed = get(&path("&typed=true")).await;
    assert_eq!(typed.status(), StatusCode::OK);
    assert_eq!(typed.headers()[header::CONTENT_TYPE], "application/problem+json");
    let answer = body(typed).await;
    assert_eq!((&answer["detail"], &answer["status"]), (&json!(detail), &json!(422)));
}

#[tokio::test]
async fn without_a_device_the_server_lives_and_says_what_it_cannot_do() {
    let response = get("/healthz").await;
    assert_eq!(response.status(), StatusCode::OK);

    let state = state();
    assert!(state.devices.ready().await.is_err());
    let request = Request::get("/readyz").body(Body::empty()).unwrap();
    let response = router(state.clone())
        .layer(Extension(Identity::without_token()))
        .oneshot(request)
        .await
        .unwrap();
    problem(response, StatusCode::SERVICE_UNAVAILABLE, "device").await;

    problem(get("/api/v1/memory").await, StatusCode::SERVICE_UNAVAILABLE, "device").await;
    problem(
        get("/api/v1/volumes/ramp").await,
        StatusCode::SERVICE_UNAVAILABLE,
        "device",
    )
    .await;
    let response = post(r#"{"volume":"ramp","format":"glb","iso":3}"#).await;
    problem(response, StatusCode::SERVICE_UNAVAILABLE, "device").await;
}

#[tokio::test]
async fn more_exports_than_wait_are_told_to_come_back() {
    let state = ApiState {
        exports: ExportQueue::new(QueueLimits {
            max_running: 1,
            max_waiting: 0,
            ..EXPORTS
        }),
        ..state()
    };
    let export = || {
        let request = Request::post("/api/v1/extract").header(header::CONTENT_TYPE, "application/json");
        let request = request.body(Body::from(r#"{"volume":"ramp","format":"glb","iso":3}"#));
        let router = router(state.clone()).layer(Extension(Identity::without_token()));
        router.oneshot(request.unwrap())
    };
    let running = state.exports.admit("a").await.unwrap();
    let response = export().await.unwrap();
    assert_eq!(response.headers()[header::RETRY_AFTER], "2");
    problem(response, StatusCode::SERVICE_UNAVAILABLE, "busy").await;
    drop(running);
    // A permit is free, and only the device is missing; a failed export returns its permit.
    for _ in 0..2 {
        problem(export().await.unwrap(), StatusCode::SERVICE_UNAVAILABLE, "device").await;
    }
}

#[tokio::test]
async fn a_panic_is_a_problem_that_gives_nothing_away() {
    let response = panicked(Box::new("secret".to_owned()));
    let detail = problem(response, StatusCode::INTERNAL_SERVER_ERROR, "internal").await;
    assert_eq!(detail, "the server failed, its log says why");
}

#[tokio::test]
async fn the_page_is_served_beside_the_api() {
    let response = get("/").await;
    assert_eq!(response.status(), StatusCode::OK);
    assert_eq!(response.headers()[header::CONTENT_TYPE], "text/html; charset=utf-8");
}

/// The contract with clients: a change of it shows in review. `UPDATE_SNAPSHOTS=1 cargo test -p isopeel openapi` rewrites it.
#[tokio::test]
async fn openapi_is_the_one_checked_in() {
    let served = body(get("/api/v1/openapi.json").await).await;
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/openapi.json");
    if std::env::var_os("UPDATE_SNAPSHOTS").is_some() {
        std::fs::write(path, format!("{served:#}\n")).unwrap();
    }
    let kept: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    assert!(served == kept, "the API is no longer what server/openapi.json says");
}

/// Every value below `value` that has this name.
fn all_named<'a>(value: &'a Value, name: &str, found: &mut Vec<&'a Value>) {
    match value {
        Value::Object(fields) => {
            found.extend(fields.get(name));
            fields.values().for_each(|field| all_named(field, name, found));
        }
        Value::Array(values) => values.iter().for_each(|value| all_named(value, name, found)),
        _ => {}
    }
}

#[test]
fn openapi_is_complete() {
    let openapi = serde_json::to_value(openapi()).unwrap();
    let mut references = Vec::new();
    all_named(&openapi, "$ref", &mut references);
    assert!(references.len() > 100, "{}", references.len());
    for reference in references {
        let path = reference.as_str().unwrap().trim_start_matches('#');
        assert!(openapi.pointer(path).is_some(), "{reference} is not there");
    }
    let paths = openapi["paths"].as_object().unwrap();
    let operations = || paths.values().flat_map(|item| item.as_object().unwrap().values());
    let names: Vec<&str> = operations()
        .map(|operation| operation["operationId"].as_str().unwrap())
        .collect();
    let once: HashSet<&str> = names.iter().copied().collect();
    assert_eq!(once.len(), names.len(), "{names:?}");
    let mut links = Vec::new();
    operations().for_each(|operation| all_named(&operation["responses"], "operationId", &mut links));
    assert!(links.len() > 5, "{links:?}");
    for link in links {
        assert!(once.contains(link.as_str().unwrap()), "{link} is not there");
    }
    assert_eq!(openapi["components"]["securitySchemes"]["token"]["scheme"], "bearer");
    for (path, item) in openapi["paths"].as_object().unwrap() {
        for (method, operation) in item.as_object().unwrap() {
            assert!(operation["security"].is_array(), "{method} {path}");
            let answers = operation["responses"].as_object().unwrap();
            let has = |status: &&str| answers.contains_key(*status);
            assert!(
                !path.starts_with("/api/") || ["401", "403", "429"].iter().all(has),
                "{method} {path}"
            );
            for (kind, content) in answers
                .values()
                .filter_map(|answer| answer["content"].as_object())
                .flatten()
            {
                let is_binary = ["model/", "octet-stream"].iter().any(|part| kind.contains(part));
                assert!(
                    !is_binary || content["schema"]["type"] != "array",
                    "{method} {path}: {kind}"
                );
            }
        }
    }
}

#[test]
fn openapi_names_every_name_of_an_extract_request_and_refuses_others() {
    let openapi = serde_json::to_value(openapi()).unwrap();
    let schema = &openapi["components"]["schemas"]["ExtractRequest"];
    assert_eq!(schema["additionalProperties"], false);
    assert_eq!(schema["required"], json!(["volume", "format"]));
    let mut names: Vec<_> = schema["properties"]
        .as_object()
        .unwrap()
        .keys()
        .map(String::as_str)
        .collect();
    names.sort_unstable();
    let expected = [
        "allowEmpty",
        "alpha",
        "beta",
        "bytes",
        "camera",
        "cap",
        "clean",
        "colorField",
        "compress",
        "detail",
        "error",
        "feature",
        "featureRange",
        "field",
        "fieldValues",
        "format",
        "interest",
        "iso",
        "label",
        "labelSmoothing",
        "mask",
        "maxError",
        "maxLevel",
        "measure",
        "mesher",
        "minPart",
        "outward",
        "parts",
        "step",
        "surfaces",
        "topology",
        "transferFunction",
        "triangles",
        "unit",
        "volume",
    ];
    assert_eq!(names, expected);
}

/// The roles that routes need are in a list beside the routes. None is missing from the list: a missing route would need `admin`.
#[tokio::test]
async fn what_each_path_needs_is_listed() {
    let folder = tempfile::tempdir().unwrap();
    let file = TokenFile::in_folder(folder.path());
    let roles: Vec<Role> = Role::ALL.into_iter().filter(|&role| role != Role::Admin).collect();
    let new = NewToken {
        user: "ann".into(),
        roles: roles.into(),
        lifetime: None,
    };
    let (token, _) = file.create(new).unwrap();
    let access = Access::new(([127, 0, 0, 1], 8417).into(), &[], &[])
        .with_token(&Token::random().unwrap())
        .with_named(&TokenWatch::open(file).unwrap());
    let gated = router(state()).layer(from_fn_with_state(access, admit));
    let description = serde_json::to_value(openapi()).unwrap();
    for (path, methods) in description["paths"].as_object().unwrap() {
        for method in methods.as_object().unwrap().keys() {
            let request = Request::builder()
                .method(method.to_uppercase().as_str())
                .uri(path.replace(['{', '}'], ""))
                .header(header::HOST, "localhost:8417")
                .header(header::AUTHORIZATION, format!("Bearer {}", token.text()));
            let answer = gated.clone().oneshot(request.body(Body::empty()).unwrap()).await;
            let is_refused = answer.unwrap().status() == StatusCode::FORBIDDEN;
            let is_for_admin = ["/api/v1/devices", "/api/v1/memory", "/metrics"].contains(&path.as_str());
            assert_eq!(is_refused, is_for_admin, "{method} {path}");
        }
    }
}
