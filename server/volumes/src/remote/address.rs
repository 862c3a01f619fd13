//! Addresses of stores, as operators write them.

use super::target::Target;

/// Schemes of addresses. Any other text is a path on disk.
const SCHEMES: [&str; 3] = ["https://", "http://", "s3://"];

/// Neuroglancer's prefix of the address of a precomputed volume.
const PRECOMPUTED: &str = "precomputed://";
/// The scheme that Neuroglancer uses for buckets of Google Cloud Storage, and the address of these.
const GOOGLE: [&str; 2] = ["gs://", "https://storage.googleapis.com/"];

/// Address of a store: `https://host/path`, `http://host/path` or `s3://bucket/path`. The address of a precomputed volume has the prefix
/// `precomputed://` and may also be `gs://bucket/path`.
#[derive(Clone)]
pub struct Address {
    shown: String,
    is_precomputed: bool,
    /// The parsed target, or the error that opening returns.
    pub(super) target: Result<Target, String>,
}

impl Address {
    /// Parses an argument into an address and the name of a volume in it (`https://host/x.zarr:labels/cells`); `None` for a path on disk.
    pub fn named(argument: &str) -> Option<(Self, Option<String>)> {
        let Some(inner) = argument.strip_prefix(PRECOMPUTED) else {
            return Self::of_zarr(argument);
        };
        let inner = match inner.strip_prefix(GOOGLE[0]) {
            Some(rest) => format!("{}{rest}", GOOGLE[1]),
            None => inner.to_owned(),
        };
        // The name of the part follows a colon in the path; a colon before the path begins the port.
        let end = inner.find(['?', '#']).unwrap_or(inner.len());
        let path = inner
            .find("://")
            .and_then(|at| Some(at + 3 + inner[at + 3..end].find('/')?));
        let colon = path.and_then(|path| Some(path + inner[path..end].find(':')?));
        let (whole, part) = match colon {
            Some(at) => (
                format!("{}{}", &inner[..at], &inner[end..]),
                Some(inner[at + 1..end].to_owned()),
            ),
            None => (inner, None),
        };
        let (address, _) = Self::of_zarr(&whole)?;
        let precomputed = Self {
            shown: format!("{PRECOMPUTED}{}", address.shown),
            is_precomputed: true,
            ..address
        };
        Some((precomputed, part))
    }

    /// Whether the address is that of a precomputed volume.
    pub fn is_precomputed(&self) -> bool {
        self.is_precomputed
    }

    fn of_zarr(argument: &str) -> Option<(Self, Option<String>)> {
        let scheme = SCHEMES.into_iter().find(|scheme| {
            let head = argument.get(..scheme.len());
            head.is_some_and(|head| head.eq_ignore_ascii_case(scheme))
        })?;
        let rest = &argument[scheme.len()..];
        let (path, query) = rest.split_at(rest.find(['?', '#']).unwrap_or(rest.len()));
        const ENDING: &str = ".zarr";
        let colon = path.to_ascii_lowercase().rfind(".zarr:").map(|at| at + ENDING.len());
        let (path, part) = match colon {
            Some(at) => (&path[..at], Some(path[at + 1..].to_owned())),
            None => (path.trim_end_matches('/'), None),
        };
        let target = match scheme {
            "s3://" => Target::of_s3(path, query),
            _ => Target::of_http(&format!("{scheme}{path}{query}")),
        };
        let (authority, below) = path.split_at(path.find('/').unwrap_or(path.len()));
        let host = authority.rsplit('@').next().unwrap_or_default();
        let shown = format!("{scheme}{host}{below}");
        let address = Self {
            shown,
            is_precomputed: false,
            target,
        };
        Some((address, part))
    }

    /// Returns the address for messages, without credentials and query.
    pub fn shown(&self) -> &str {
        &self.shown
    }
}

impl std::fmt::Debug for Address {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str(&self.shown)
    }
}

#[cfg(all(test, feature = "network"))]
mod tests {
    use super::*;

    #[test]
    fn addresses_and_parts() {
        for (text, shown, part) in [
            ("https://h.org/a/x.zarr", "https://h.org/a/x.zarr", None),
            ("https://h.org/a/x.zarr/", "https://h.org/a/x.zarr", None),
            ("HTTP://h.org:8080/x.ZARR:1", "http://h.org:8080/x.ZARR", Some("1")),
            ("https://h.org:8080", "https://h.org:8080", None),
            (
                "https://h.org/x.zarr:labels/a:b?s=1:2",
                "https://h.org/x.zarr",
                Some("labels/a:b"),
            ),
            (
                "https://me:secret@h.org/x.zarr?key=secret",
                "https://h.org/x.zarr",
                None,
            ),
            ("s3://bucket/a/x.zarr:0", "s3://bucket/a/x.zarr", Some("0")),
            ("s3://bucket", "s3://bucket", None),
        ] {
            let (address, found) = Address::named(text).expect(text);
            assert_eq!((address.shown(), found.as_deref()), (shown, part), "{text}");
            assert!(address.target.is_ok(), "{text}");
            assert!(!format!("{address:?}").contains("secret"), "{text}");
        }
        for text in ["a/x.zarr", "/data/http", "x.zarr:1", "ftp://h/x.zarr", "é"] {
            assert!(Address::named(text).is_none(), "{text}");
        }
        for text in [
            "http://",
            "s3://",
            "s3:///x.zarr",
            "https://h:x/a",
            "s3://bucket/x.zarr?versionId=1",
        ] {
            let (address, _) = Address::named(text).expect(text);
            assert!(address.target.is_err(), "{text}");
        }
    }

    #[test]
    fn precomputed_volumes_have_a_scheme_of_their_own() {
        for (text, shown, part) in [
            (
                "precomputed://https://h.org:80/a/b/",
                "precomputed://https://h.org:80/a/b",
                None,
            ),
            (
                "precomputed://s3://bucket/a:8_8_8",
                "precomputed://s3://bucket/a",
                Some("8_8_8"),
            ),
            (
                "precomputed://https://h.org/a:1?x=:",
                "precomputed://https://h.org/a",
                Some("1"),
            ),
            (
                "precomputed://gs://b/a",
                "precomputed://https://storage.googleapis.com/b/a",
                None,
            ),
        ] {
            let (address, found) = Address::named(text).expect(text);
            assert_eq!((address.shown(), found.as_deref()), (shown, part), "{text}");
            assert!(address.is_precomputed() && address.target.is_ok(), "{text}");
        }
        assert!(Address::named("precomputed://data").is_none());
        assert!(
            !Address::named("https://h.org/a")
                .expect("an address")
                .0
                .is_precomputed()
        );
    }
}
