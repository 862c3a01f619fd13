//! Content encodings of response bodies: zstd and gzip, if the client accepts them. A body is encoded while it is sent.

use std::io::{self, Write};

use axum::http::{HeaderMap, header};

/// Compression levels. The fastest ones, because a client waits for the compression, and higher levels hardly reduce the size of binary
/// numbers.
const ZSTD_LEVEL: i32 = 1;
const GZIP_LEVEL: flate2::Compression = flate2::Compression::fast();

/// Content encoding of a body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ContentEncoding {
    /// Not encoded.
    Identity,
    /// RFC 8878.
    Zstd,
    /// RFC 1952.
    Gzip,
}

impl ContentEncoding {
    /// All encodings, the preferred one first.
    pub(super) const ALL: [Self; 3] = [Self::Zstd, Self::Gzip, Self::Identity];

    /// Returns the name in headers.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Identity => "identity",
            Self::Zstd => "zstd",
            Self::Gzip => "gzip",
        }
    }

    /// Returns the entity tag of a body in this encoding. `hash` is the hash of the unencoded content.
    pub(super) fn tag(self, hash: &str) -> String {
        match self {
            Self::Identity => format!("\"{hash}\""),
            _ => format!("\"{hash}-{}\"", self.name()),
        }
    }

    /// Whether `If-None-Match` states that the client has the content with this hash, in any encoding. The tag `*` stands for any content.
    pub(super) fn is_known(headers: &HeaderMap, hash: &str) -> bool {
        let current = Self::ALL.map(|encoding| encoding.tag(hash));
        let lists = headers.get_all(header::IF_NONE_MATCH).iter();
        let mut client_tags = lists
            .filter_map(|tags| tags.to_str().ok())
            .flat_map(|tags| tags.split(','))
            // RFC 9110 requires the weak comparison here.
            .map(|tag| tag.trim().trim_start_matches("W/"));
        client_tags.any(|client_tag| client_tag == "*" || current.iter().any(|tag| tag == client_tag))
    }

    /// Returns the encoding with the highest weight in `Accept-Encoding`, or `Identity` without this header.
    pub(super) fn accepted(headers: &HeaderMap) -> Self {
        let lists = headers.get_all(header::ACCEPT_ENCODING).iter();
        let lists: Vec<&str> = lists.filter_map(|list| list.to_str().ok()).collect();
        let weights: Vec<(&str, f32)> = lists.iter().flat_map(|list| list.split(',')).map(weight).collect();
        let weight_of = |encoding: Self| {
            let named = |name: &str| weights.iter().find(|(other, _)| other.eq_ignore_ascii_case(name));
            let weight = named(encoding.name()).or_else(|| named("*")).map(|(_, weight)| *weight);
            // The client does not accept an encoding that the header does not name. `Identity` is the exception, with the lowest weight.
            weight.unwrap_or(if encoding == Self::Identity {
                f32::MIN_POSITIVE
            } else {
                0.0
            })
        };
        // In reverse order, because `max_by` returns the last of several equal elements.
        let candidates = Self::ALL.into_iter().rev();
        let best = candidates.max_by(|a, b| weight_of(*a).total_cmp(&weight_of(*b)));
        best.filter(|encoding| weight_of(*encoding) > 0.0)
            .unwrap_or(Self::Identity)
    }

    /// Writes a body to `out` in this encoding. `body` writes the unencoded content.
    ///
    /// # Errors
    /// Errors of `body` and `out`.
    pub(super) fn write<W: Write, E: From<io::Error>>(
        self,
        mut out: W,
        body: impl FnOnce(&mut dyn Write) -> Result<(), E>,
    ) -> Result<(), E> {
        match self {
            Self::Identity => {
                body(&mut out)?;
                Ok(out.flush()?)
            }
            Self::Zstd => {
                let mut encoder = zstd::stream::write::Encoder::new(out, ZSTD_LEVEL)?;
                body(&mut encoder)?;
                Ok(encoder.finish()?.flush()?)
            }
            Self::Gzip => {
                let mut encoder = flate2::write::GzEncoder::new(out, GZIP_LEVEL);
                body(&mut encoder)?;
                Ok(encoder.finish()?.flush()?)
            }
        }
    }
}

/// Parses an item of `Accept-Encoding`: the name of an encoding and its weight. A missing weight is 1, and an invalid one is 0.
fn weight(item: &str) -> (&str, f32) {
    let mut parts = item.split(';');
    let name = parts.next().unwrap_or_default().trim();
    let weight = parts.find_map(|part| part.trim().to_ascii_lowercase().strip_prefix("q=").map(str::to_owned));
    (name, weight.map_or(1.0, |weight| weight.parse().unwrap_or(0.0)))
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use axum::http::HeaderValue;

    use super::*;

    #[test]
    fn the_client_chooses_and_zstd_is_preferred() {
        use ContentEncoding::{Gzip, Identity, Zstd};
        for (accepted, expected) in [
            (None, Identity),
            (Some(""), Identity),
            (Some("gzip, deflate, br, zstd"), Zstd),
            (Some("gzip, deflate"), Gzip),
            (Some("deflate, br"), Identity),
            (Some("zstd;q=0.5, gzip;q=0.8"), Gzip),
            (Some("zstd;q=0, *"), Gzip),
            (Some("*;q=0"), Identity),
            (Some("identity, gzip;q=0.5"), Identity),
            (Some("GZIP;Q=1"), Gzip),
            (Some("gzip;q=much"), Identity),
        ] {
            let mut headers = HeaderMap::new();
            if let Some(accepted) = accepted {
                headers.insert(header::ACCEPT_ENCODING, HeaderValue::from_static(accepted));
            }
            assert_eq!(ContentEncoding::accepted(&headers), expected, "{accepted:?}");
        }
    }

    #[test]
    fn what_is_encoded_is_decoded() {
        let body: Vec<u8> = (0..100_000u32).flat_map(|i| (i / 7).to_le_bytes()).collect();
        for encoding in ContentEncoding::ALL {
            let mut encoded = Vec::new();
            let written: io::Result<()> = encoding.write(&mut encoded, |out| out.write_all(&body));
            written.unwrap();
            let mut decoded = Vec::new();
            match encoding {
                ContentEncoding::Identity => decoded.clone_from(&encoded),
                ContentEncoding::Zstd => decoded = zstd::decode_all(&encoded[..]).unwrap(),
                ContentEncoding::Gzip => {
                    flate2::read::GzDecoder::new(&encoded[..])
                        .read_to_end(&mut decoded)
                        .unwrap();
                }
            }
            assert!(decoded == body, "{encoding:?}");
            assert!(encoding == ContentEncoding::Identity || encoded.len() * 2 < body.len());
        }
    }
}
