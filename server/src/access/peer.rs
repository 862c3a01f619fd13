//! The address of a client: the other end of its connection, or the address that a trusted proxy states.

use std::net::{IpAddr, Ipv6Addr};
use std::str::FromStr;

use axum::http::HeaderName;
use axum::http::header::{FORWARDED, HeaderMap};

const FORWARDED_FOR: HeaderName = HeaderName::from_static("x-forwarded-for");

/// Extension of a request: the address of the other end of its connection.
#[derive(Clone, Copy, Debug)]
pub struct PeerAddress(pub IpAddr);

/// Returns the key for counting requests and connections of an address. The key of an IPv6 address is its /64 network, because a client
/// usually has a whole /64.
pub fn counted_as(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(address) => IpAddr::V6(Ipv6Addr::from_bits(address.to_bits() >> 64 << 64)),
        address => address,
    }
}

/// A proxy that is trusted to state the addresses of its clients: an address, `10.0.0.7`, or a network, `10.0.0.0/8`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TrustedProxy {
    network: IpAddr,
    bits: u8,
}

impl FromStr for TrustedProxy {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let refuse = || format!("{text:?}, expected an address or a network, such as 10.0.0.7 or 10.0.0.0/8");
        let (address, bits) = match text.split_once('/') {
            Some((address, bits)) => (address, Some(bits.parse().map_err(|_| refuse())?)),
            None => (text, None),
        };
        let network: IpAddr = address.parse().map_err(|_| refuse())?;
        let address_bits = if network.is_ipv4() { 32 } else { 128 };
        let bits = bits.unwrap_or(address_bits);
        if bits > address_bits {
            return Err(refuse());
        }
        Ok(Self { network, bits })
    }
}

impl TrustedProxy {
    fn contains(&self, address: IpAddr) -> bool {
        match (self.network, address) {
            (IpAddr::V4(network), IpAddr::V4(address)) => {
                let differing = network.to_bits() ^ address.to_bits();
                differing.checked_shr(32 - u32::from(self.bits)).unwrap_or(0) == 0
            }
            (IpAddr::V6(network), IpAddr::V6(address)) => {
                let differing = network.to_bits() ^ address.to_bits();
                differing.checked_shr(128 - u32::from(self.bits)).unwrap_or(0) == 0
            }
            _ => false,
        }
    }
}

/// Whether an address is that of a trusted proxy.
pub fn is_trusted(proxies: &[TrustedProxy], address: IpAddr) -> bool {
    let address = address.to_canonical();
    proxies.iter().any(|proxy| proxy.contains(address))
}

/// Returns the address of the client for a request that arrived on a connection of `peer`.
///
/// Each proxy appends to a header the address from which it has received the request. So this function reads the list from its end: the
/// first address that is not a trusted proxy is the client. The client may have forged all addresses before that.
pub(super) fn client(peer: IpAddr, headers: &HeaderMap, proxies: &[TrustedProxy]) -> IpAddr {
    let mut client = peer.to_canonical();
    if !is_trusted(proxies, client) {
        return client;
    }
    for entry in forwarded(headers).into_iter().rev() {
        // If an entry cannot be parsed, the client counts as the trusted proxy that has appended the entry.
        let Some(address) = entry else { break };
        client = address.to_canonical();
        if !is_trusted(proxies, client) {
            break;
        }
    }
    client
}

/// Returns all addresses that proxies have appended to `X-Forwarded-For` or, if this header is missing, to `Forwarded` (RFC 7239). `None`
/// stands for an entry that cannot be parsed.
fn forwarded(headers: &HeaderMap) -> Vec<Option<IpAddr>> {
    let values = |name: HeaderName| {
        let values = headers.get_all(name).iter();
        values.flat_map(|value| value.to_str().unwrap_or("?").split(','))
    };
    let simple: Vec<_> = values(FORWARDED_FOR).map(address).collect();
    if !simple.is_empty() {
        return simple;
    }
    let standard = values(FORWARDED).map(|element| {
        let mut pairs = element.split(';').filter_map(|pair| pair.trim().split_once('='));
        let (_, value) = pairs.find(|(name, _)| name.eq_ignore_ascii_case("for"))?;
        address(value.trim_matches('"'))
    });
    standard.collect()
}

/// Parses an address with an optional port. An IPv6 address with a port is in brackets.
fn address(text: &str) -> Option<IpAddr> {
    let text = text.trim();
    if let Ok(address) = text.parse() {
        return Some(address);
    }
    match text.strip_prefix('[') {
        Some(rest) => rest.split_once(']')?.0.parse().ok(),
        None => text.rsplit_once(':')?.0.parse().ok(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ip(text: &str) -> IpAddr {
        text.parse().expect("an address")
    }

    #[test]
    fn a_network_of_ipv6_is_one_peer() {
        let peer = |text: &str| counted_as(ip(text));
        assert_eq!(peer("2001:db8::1"), peer("2001:db8::ffff:1"));
        assert_ne!(peer("2001:db8::1"), peer("2001:db8:0:1::1"));
        assert_eq!(peer("::ffff:192.0.2.1"), peer("192.0.2.1"));
        assert_ne!(peer("192.0.2.1"), peer("192.0.2.2"));
    }

    #[test]
    fn a_proxy_is_an_address_or_a_network() {
        let has = |proxy: &str, address: &str| is_trusted(&[proxy.parse().expect("a proxy")], ip(address));
        for (proxy, address, expected) in [
            ("10.0.0.7", "10.0.0.7", true),
            ("10.0.0.7", "10.0.0.8", false),
            ("10.0.0.0/8", "10.255.0.1", true),
            ("10.0.0.0/8", "11.0.0.1", false),
            ("10.0.0.0/8", "::ffff:10.1.1.1", true),
            ("0.0.0.0/0", "192.0.2.1", true),
            ("2001:db8::/32", "2001:db8:1::1", true),
            ("2001:db8::/32", "2001:db9::1", false),
            ("::/0", "192.0.2.1", false),
        ] {
            assert_eq!(has(proxy, address), expected, "{address} in {proxy}");
        }
        for text in ["", "proxy", "10.0.0.0/33", "10.0.0.0/x", "::1/129", "10.0.0.0/8/8"] {
            let error = text.parse::<TrustedProxy>().expect_err(text);
            assert!(error.contains("such as 10.0.0.7"), "{error}");
        }
    }

    #[test]
    fn only_what_trusted_proxies_have_added_counts() {
        let proxies = ["10.0.0.0/8", "::1"].map(|text| text.parse().expect("a proxy"));
        let from = |peer: &str, name: &'static str, values: &[&str]| {
            let mut headers = HeaderMap::new();
            for value in values {
                headers.append(name, value.parse().expect("a header"));
            }
            client(ip(peer), &headers, &proxies).to_string()
        };
        let simple = "x-forwarded-for";
        for (peer, name, values, expected) in [
            ("10.0.0.1", simple, &["192.0.2.1"][..], "192.0.2.1"),
            ("10.0.0.1", simple, &["6.6.6.6, 192.0.2.1, 10.0.0.2"], "192.0.2.1"),
            ("10.0.0.1", simple, &["6.6.6.6", "192.0.2.1"], "192.0.2.1"),
            ("10.0.0.1", simple, &["6.6.6.6, made up, 10.0.0.2"], "10.0.0.2"),
            ("10.0.0.1", simple, &["10.0.0.3"], "10.0.0.3"),
            ("10.0.0.1", simple, &["192.0.2.1:4711"], "192.0.2.1"),
            ("10.0.0.1", simple, &["[2001:db8::1]:4711"], "2001:db8::1"),
            ("10.0.0.1", simple, &[], "10.0.0.1"),
            ("192.0.2.9", simple, &["6.6.6.6"], "192.0.2.9"),
            (
                "::1",
                "forwarded",
                &["for=6.6.6.6, for=\"[2001:db8::1]:80\";proto=https"],
                "2001:db8::1",
            ),
            ("::1", "forwarded", &["proto=http;For=192.0.2.1"], "192.0.2.1"),
            ("::1", "forwarded", &["for=unknown"], "::1"),
        ] {
            assert_eq!(from(peer, name, values), expected, "{peer}, {name}: {values:?}");
        }
    }
}
