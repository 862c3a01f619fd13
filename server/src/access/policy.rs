//! The `Content-Security-Policy` of the server's pages.

use axum::http::HeaderValue;

use super::{Access, AllowedOrigin};

/// Policy of the page. It loads scripts, workers and styles only from the server, and sends requests only to the server. `wasm-unsafe-eval`
/// is for the decoder of chunks; `blob:` and `data:` are for pictures that the page creates. The page embeds no other pages, sends no
/// forms, and has no `base` element.
const CONTENT: &str = "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; worker-src 'self'; style-src 'self'; img-src 'self' blob: data:; \
    connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'self'";

/// Returns the `Content-Security-Policy` of all responses. Pages of `--allow-origin` and `--embed-origin` may embed the viewer in a frame.
pub fn content_security_policy(access: &Access) -> HeaderValue {
    let origins = access.frame_origins().map(AllowedOrigin::header);
    let mut policy = CONTENT.as_bytes().to_vec();
    for origin in origins {
        policy.push(b' ');
        policy.extend(origin.as_bytes());
    }
    // Cannot fail: origins are valid header values, and so is the rest of the text.
    HeaderValue::from_bytes(&policy).unwrap_or(HeaderValue::from_static(CONTENT))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_allowed_origins_may_frame_the_page() {
        let policy = |origins: &[AllowedOrigin]| {
            let access = Access::new(([127, 0, 0, 1], 8417).into(), &[], origins);
            content_security_policy(&access).to_str().expect("ASCII").to_owned()
        };
        assert!(policy(&[]).ends_with("frame-ancestors 'self'"));
        let lab = "https://lab.example".parse().expect("an origin");
        assert!(policy(&[lab]).ends_with("frame-ancestors 'self' https://lab.example"));
        let frames = ["https://blog.example".parse().expect("an origin")];
        let access = Access::new(([127, 0, 0, 1], 8417).into(), &[], &[]).with_frames(&frames);
        let policy = content_security_policy(&access);
        assert!(
            policy
                .as_bytes()
                .ends_with(b"frame-ancestors 'self' https://blog.example"),
            "{policy:?}"
        );
    }
}
