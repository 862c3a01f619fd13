//! Rate limits for each peer and for each token. Expensive requests count more than others.

use std::net::IpAddr;
use std::num::NonZeroU32;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use axum::http::Method;
use governor::clock::{Clock, DefaultClock};
use governor::{DefaultKeyedRateLimiter, InsufficientCapacity, Quota, RateLimiter};

use super::peer::counted_as;

/// Rate limits: cost of requests per second, where the cheapest request costs 1. 0 means no limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rates {
    /// Limit of a peer.
    pub peer: u32,
    /// Limit of a token.
    pub token: u32,
}

impl Default for Rates {
    /// The defaults allow a viewer that drags three planes through a volume at 60 Hz, which requests 180 slices per second. The limit of a
    /// peer is higher, because a peer may be a proxy, or a router of an office.
    fn default() -> Self {
        Self {
            peer: 2_000,
            token: 1_000,
        }
    }
}

/// Burst, in seconds of the rate. Large enough that a thousand viewers can reconnect after a restart of the server.
const BURST_SECONDS: u32 = 10;

/// Cost of a request with a missing or wrong token. At the default rate, a peer has 20 attempts per second.
const REFUSED_COST: u32 = 100;

/// Returns the cost of a request.
pub(super) fn cost(method: &Method, path: &str) -> u32 {
    let parts: Vec<&str> = path.strip_prefix("/api/v1/").unwrap_or("").split('/').collect();
    match parts[..] {
        // Makes and encodes a surface, or estimates many surfaces.
        ["extract"] => 10,
        ["jobs"] if *method == Method::POST => 10,
        // Sends a request to the issuer.
        ["oidc", _] => 10,
        // Checks names and free space, or reads the headers of all files.
        ["uploads"] | ["uploads", _, "finish"] if *method == Method::POST => 10,
        // Occupies tasks, buffers and a seat.
        ["stream"] => 5,
        _ => 1,
    }
}

/// Number of keys, some 50 bytes each, above which keys with their full burst are dropped. Keys that were used within [`BURST_SECONDS`] may
/// stay.
const MANY_KEYS: usize = 4_096;

/// Number of requests between two checks of the number of keys.
const CHECK_EVERY: usize = 1_024;

/// The rate limit of each key; `None`: no limit. Clones share the counts.
#[derive(Clone, Debug)]
struct Limit<K: Clone + std::hash::Hash + Eq>(Option<Arc<Counts<K>>>);

#[derive(Debug)]
struct Counts<K: Clone + std::hash::Hash + Eq> {
    limiter: DefaultKeyedRateLimiter<K>,
    /// Number of requests so far.
    checks: AtomicUsize,
}

impl<K: Clone + std::hash::Hash + Eq> Limit<K> {
    fn new(rate: u32) -> Self {
        let rate = NonZeroU32::new(rate);
        Self(rate.map(|rate| {
            let burst = rate.saturating_mul(NonZeroU32::MIN.saturating_add(BURST_SECONDS - 1));
            let limiter = RateLimiter::keyed(Quota::per_second(rate).allow_burst(burst));
            let checks = AtomicUsize::new(0);
            Arc::new(Counts { limiter, checks })
        }))
    }

    /// Charges the cost of a request. The error is the time after which to try again.
    fn charge(&self, key: &K, cost: u32) -> Result<(), Duration> {
        let (Some(counts), Some(cost)) = (&self.0, NonZeroU32::new(cost)) else {
            return Ok(());
        };
        let limiter = &counts.limiter;
        if counts
            .checks
            .fetch_add(1, Ordering::Relaxed)
            .is_multiple_of(CHECK_EVERY)
            && limiter.len() > MANY_KEYS
        {
            limiter.retain_recent();
            limiter.shrink_to_fit();
        }
        match limiter.check_key_n(key, cost) {
            Ok(Ok(())) => Ok(()),
            Ok(Err(later)) => Err(later.wait_time_from(DefaultClock::default().now())),
            // At a very low rate, the cost exceeds the whole burst. Then the request costs the whole burst.
            Err(InsufficientCapacity(burst)) => self.charge(key, burst),
        }
    }
}

/// All rate limits. Clones share the counts.
#[derive(Clone, Debug)]
pub(super) struct RateLimits {
    peers: Limit<IpAddr>,
    tokens: Limit<Box<str>>,
    /// Limit of a peer for requests without a token or with a wrong one.
    unauthenticated: Limit<IpAddr>,
}

impl RateLimits {
    pub(super) fn new(rates: Rates) -> Self {
        Self {
            peers: Limit::new(rates.peer),
            tokens: Limit::new(rates.token),
            unauthenticated: Limit::new(rates.peer),
        }
    }

    /// Charges the cost of a request to its peer. The error is the time after which to try again.
    pub(super) fn charge_peer(&self, peer: IpAddr, cost: u32) -> Result<(), Duration> {
        self.peers.charge(&counted_as(peer), cost)
    }

    /// Charges the cost of a missing or wrong token to its peer. This limit is separate from the limit of other requests, so that it does
    /// not affect users with valid tokens at the same address. The error is the time after which to try again.
    pub(super) fn charge_unauthenticated(&self, peer: IpAddr) -> Result<(), Duration> {
        self.unauthenticated.charge(&counted_as(peer), REFUSED_COST)
    }

    /// Charges the cost of a request to its token. The error is the time after which to try again.
    pub(super) fn charge_token(&self, token: &str, cost: u32) -> Result<(), Duration> {
        self.tokens.charge(&token.into(), cost)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ip(last: u8) -> IpAddr {
        [192, 0, 2, last].into()
    }

    #[test]
    fn who_asks_too_often_waits_and_others_do_not() {
        let limits = RateLimits::new(Rates { peer: 10, token: 1 });
        // A burst of ten seconds, whatever its requests cost.
        for _ in 0..5 {
            limits.charge_peer(ip(1), 20).expect("within the burst");
        }
        let wait = limits.charge_peer(ip(1), 20).expect_err("beyond it");
        assert!((1.5..=2.0).contains(&wait.as_secs_f64()), "{wait:?}");
        assert!(limits.charge_peer(ip(2), 100).is_ok(), "another peer");
        assert!(limits.charge_token("a", 10).is_ok() && limits.charge_token("b", 10).is_ok());
        assert!(limits.charge_token("a", 1).is_err());
        let free = RateLimits::new(Rates { peer: 0, token: 0 });
        assert!((0..1_000).all(|_| free.charge_peer(ip(1), 1_000).is_ok()));
        // A request that costs more than the whole burst takes the whole burst.
        assert!(limits.charge_token("c", 11).is_ok() && limits.charge_token("c", 1).is_err());
    }

    #[test]
    fn who_shows_wrong_tokens_waits_for_what_they_cost() {
        let limits = RateLimits::new(Rates { peer: 50, token: 0 });
        let tries = (0..20).take_while(|_| limits.charge_unauthenticated(ip(1)).is_ok());
        assert_eq!(tries.count(), 5, "500 units, 100 each");
        let wait = limits.charge_unauthenticated(ip(1)).expect_err("nothing is left");
        assert!((1.0..=2.0).contains(&wait.as_secs_f64()), "{wait:?}");
        assert!(limits.charge_unauthenticated(ip(2)).is_ok());
        assert!(
            (0..500).all(|_| limits.charge_peer(ip(1), 1).is_ok()),
            "others at the address go on"
        );
    }

    #[test]
    fn what_costs_the_server_more_costs_more() {
        let of = |method, path| cost(&method, path);
        for path in [
            "/api/v1/extract",
            "/api/v1/jobs",
            "/api/v1/uploads",
            "/api/v1/uploads/a/finish",
        ] {
            assert_eq!(of(Method::POST, path), 10, "{path}");
        }
        assert_eq!(of(Method::GET, "/api/v1/stream"), 5);
        assert_eq!(of(Method::GET, "/api/v1/uploads"), 1);
        assert_eq!(of(Method::PATCH, "/api/v1/uploads/a"), 1);
    }

    #[test]
    fn a_viewer_that_drags_three_planes_meets_no_limit() {
        let limits = RateLimits::new(Rates::default());
        let slice = cost(&Method::GET, "/api/v1/volumes/head/slices");
        // Fifty seconds of it in no time, in which nothing is given back.
        for _ in 0..60 * 3 * 50 {
            limits.charge_peer(ip(1), slice).expect("of the peer");
            limits.charge_token("a", slice).expect("of the token");
        }
    }

    #[test]
    fn peers_that_have_their_burst_again_are_forgotten() {
        let limit: Limit<u32> = Limit::new(1_000_000);
        for key in 0..3 * MANY_KEYS as u32 {
            limit.charge(&key, 1).expect("one");
        }
        std::thread::sleep(Duration::from_millis(5));
        for _ in 0..CHECK_EVERY {
            limit.charge(&0, 1).expect("one");
        }
        let counts = limit.0.expect("a limit");
        assert!(counts.limiter.len() <= MANY_KEYS, "{}", counts.limiter.len());
    }
}
