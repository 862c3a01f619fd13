//! Plain HTTP for the tests of REST.

use std::net::SocketAddr;
use std::time::Duration;

use serde_json::Value;

/// An answer, its body read whole.
pub struct Answer {
    pub status: u16,
    pub content_type: String,
    /// The header `isopeel-slice`, `null` if there is none.
    pub slice: Value,
    headers: ureq::http::HeaderMap,
    pub body: Vec<u8>,
}

impl Answer {
    /// Returns a header, empty if there is none.
    pub fn header(&self, name: &str) -> &str {
        let value = self.headers.get(name);
        value.map_or("", |value| value.to_str().expect("ASCII"))
    }

    /// The body as JSON.
    #[track_caller]
    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body)
            .unwrap_or_else(|e| panic!("not JSON ({e}): {}", String::from_utf8_lossy(&self.body)))
    }

    /// Checks that this is a problem of that status as RFC 9457 has it; returns its stable code.
    #[track_caller]
    pub fn problem(&self, status: u16) -> String {
        assert_eq!(self.status, status, "{}", String::from_utf8_lossy(&self.body));
        assert_eq!(self.content_type, "application/problem+json");
        let problem = self.json();
        assert_eq!(problem["status"], status, "{problem}");
        assert!(
            problem["title"].as_str().is_some_and(|title| !title.is_empty()),
            "no title: {problem}"
        );
        assert!(
            problem["detail"].as_str().is_some_and(|detail| !detail.is_empty()),
            "no detail: {problem}"
        );
        problem["code"]
            .as_str()
            .unwrap_or_else(|| panic!("no code: {problem}"))
            .to_owned()
    }
}

fn agent() -> ureq::Agent {
    let patience = Duration::from_secs(120);
    ureq::Agent::config_builder()
        .http_status_as_error(false)
        .timeout_global(Some(patience))
        .build()
        .into()
}

fn read(answer: ureq::http::Response<ureq::Body>) -> Answer {
    let (head, mut body) = answer.into_parts();
    let content_type = head
        .headers
        .get("content-type")
        .map(|value| value.to_str().expect("ASCII").to_owned());
    let slice = head
        .headers
        .get("isopeel-slice")
        .map(|value| value.to_str().expect("ASCII"));
    Answer {
        slice: slice.map_or(Value::Null, |text| serde_json::from_str(text).expect("JSON")),
        status: head.status.as_u16(),
        content_type: content_type.unwrap_or_default(),
        headers: head.headers.clone(),
        body: body
            .with_config()
            .limit(1 << 30)
            .read_to_vec()
            .expect("the body arrives whole"),
    }
}

pub fn get(address: SocketAddr, path: &str) -> Answer {
    read(
        agent()
            .get(format!("http://{address}{path}"))
            .call()
            .expect("an answer"),
    )
}

pub fn post(address: SocketAddr, path: &str, content_type: &str, body: impl AsRef<[u8]>) -> Answer {
    let request = agent()
        .post(format!("http://{address}{path}"))
        .content_type(content_type);
    read(request.send(body.as_ref()).expect("an answer"))
}

pub fn post_json(address: SocketAddr, path: &str, body: &Value) -> Answer {
    post(address, path, "application/json", body.to_string())
}

/// Sends a request with headers; `None` if the server ends meanwhile.
pub fn send(address: SocketAddr, method: &str, path: &str, headers: &[(&str, &str)], body: &[u8]) -> Option<Answer> {
    let mut request = ureq::http::Request::builder()
        .method(method)
        .uri(format!("http://{address}{path}"));
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    let answer = agent().run(request.body(body).expect("a request")).ok()?;
    let (head, body) = answer.into_parts();
    let whole = body.into_with_config().limit(1 << 30).read_to_vec().ok()?;
    let value = |name: &str| {
        head.headers
            .get(name)
            .map(|value| value.to_str().expect("ASCII").to_owned())
    };
    Some(Answer {
        status: head.status.as_u16(),
        content_type: value("content-type").unwrap_or_default(),
        slice: Value::Null,
        headers: head.headers,
        body: whole,
    })
}

/// As [`post_json`], of a server that may end meanwhile; the status.
pub fn try_post_json(address: SocketAddr, path: &str, body: &Value) -> Option<u16> {
    let request = agent().post(format!("http://{address}{path}"));
    let answer = request.content_type("application/json").send(body.to_string()).ok()?;
    let status = answer.status().as_u16();
    answer.into_body().with_config().limit(1 << 30).read_to_vec().ok()?;
    Some(status)
}

/// Whether a browser would let a page of that origin read the answer.
pub fn readable_by(address: SocketAddr, path: &str, origin: &str) -> bool {
    let request = agent().get(format!("http://{address}{path}")).header("Origin", origin);
    let answer = request.call().expect("an answer");
    answer
        .headers()
        .get("access-control-allow-origin")
        .is_some_and(|allowed| allowed == origin)
}
