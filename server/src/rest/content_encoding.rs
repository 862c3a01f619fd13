//! Encodings of a body that is written as it is sent: zstd and gzip, if the client takes them.

use std::io::{self, Write};

use axum::http::{HeaderMap, header};

/// The fastest levels, because a client waits while the file is compressed. Higher levels hardly make its numbers smaller.
const ZSTD_LEVEL: i32 = 1;
const GZIP_LEVEL: flate2::Compression = flate2::Compression::fast();

/// How a body is encoded.
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

    /// Returns the entity tag of a body in this encoding. `hash` is that of its content before encoding.
    pub(super) fn tag(self, hash: &str) -> String {
        match self {
            Self::Identity => format!("\"{hash}\""),
            _ => format!("\"{hash}-{}\"", self.name()),
        }
    }

    /// Whether the client states that it already has the content of this hash, in any encoding. The tag `*` stands for any content.
    pub(super) fn is_known(headers: &HeaderMap, hash: &str) -> bool {
        let known = Self::ALL.map(|encoding| encoding.tag(hash));
        let shown = headers.get_all(header::IF_NONE_MATCH).iter();
        let mut tags = shown
            .filter_map(|tags| tags.to_str().ok())
            .flat_map(|tags| tags.split(','))
            // The tags are compared weakly, as RFC 9110 requires.
            .map(|shown| shown.trim().trim_start_matches("W/"));
        tags.any(|shown| shown == "*" || known.iter().any(|tag| tag == shown))
    }

    /// Returns the encoding with the highest weight in `Accept-Encoding`; without that header, `Identity`.
    pub(super) fn accepted(headers: &HeaderMap) -> Self {
        let lists = headers.get_all(header::ACCEPT_ENCODING).iter();
        let lists: Vec<&str> = lists.filter_map(|list| list.to_str().ok()).collect();
        let weights: Vec<(&str, f32)> = lists.iter().flat_map(|list| list.split(',')).map(weight).collect();
        let of = |encoding: Self| {
            let named = |name: &str| weights.iter().find(|(other, _)| other.eq_ignore_ascii_case(name));
            let weight = named(encoding.name()).or_else(|| named("*")).map(|(_, weight)| *weight);
            // An encoding that the header does not name is not accepted. `Identity` always is, as the last choice.
            weight.unwrap_or(if encoding == Self::Identity {
                f32::MIN_POSITIVE
            } else {
                0.0
            })
        };
        // Reversed, because `max_by` returns the last of equal ones.
        let best = Self::ALL.into_iter().rev().max_by(|a, b| of(*a).total_cmp(&of(*b)));
        best.filter(|encoding| of(*encoding) > 0.0).unwrap_or(Self::Identity)
    }

    /// Writes a body in this encoding.
    ///
    /// # Errors
    /// Those of `body`, and of `out`.
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

/// Parses an encoding of `Accept-Encoding` and its weight: 1 if it has none, 0 if the weight is invalid.
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
