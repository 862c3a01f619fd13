//! Tickets for the stream. Browsers let a page of another origin send neither a header nor a cookie with a WebSocket, so such a page puts a
//! ticket in the address of the stream. Logs may contain addresses, so a ticket is valid only once, for 30 s, and for the origin that has
//! requested it.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use axum::http::HeaderValue;
use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use sha2::{Digest, Sha256};

use super::identity::Identity;
use super::token::TokenError;

/// Lifetime of a ticket. A page opens the stream as soon as it has the ticket.
pub const LIFETIME: Duration = Duration::from_secs(30);
/// Maximum number of unused tickets, some 200 bytes each.
const MAX_TICKETS: usize = 4_096;
/// Maximum number of unused tickets of one token, so that no user can use up all of them. A page needs one ticket for each stream. On a
/// server without authentication, all users share this maximum.
const MAX_OF_TOKEN: usize = 128;
const RANDOM_BYTES: usize = 32;

/// Why no ticket was issued.
#[derive(Debug, thiserror::Error)]
pub(super) enum TicketError {
    /// Too many tickets are unused.
    #[error("there are {0} unused tickets, the maximum: try again when they have expired, in {LIFETIME:?}")]
    TooMany(usize),
    /// The system has no random numbers.
    #[error(transparent)]
    Random(#[from] TokenError),
}

#[derive(Debug)]
struct Ticket {
    who: Identity,
    /// Origin of the page that may use the ticket; `None`: only a client that is not a page may.
    origin: Option<HeaderValue>,
    issued: Instant,
}

/// Unused tickets, by their hashes. Clones share them.
#[derive(Clone, Debug, Default)]
pub(super) struct Tickets(Arc<Mutex<HashMap<[u8; 32], Ticket>>>);

impl Tickets {
    /// Issues a ticket that `who` can use from a page of this origin; without an origin, from a client that is not a page.
    pub(super) fn issue(
        &self,
        who: &Identity,
        origin: Option<&HeaderValue>,
        now: Instant,
    ) -> Result<String, TicketError> {
        let mut bytes = [0; RANDOM_BYTES];
        getrandom::fill(&mut bytes).map_err(TokenError::from)?;
        let text = URL_SAFE_NO_PAD.encode(bytes);
        let mut tickets = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        tickets.retain(|_, ticket| now.duration_since(ticket.issued) < LIFETIME);
        let of_token = tickets.values().filter(|ticket| ticket.who.token() == who.token());
        let (all, own) = (tickets.len(), of_token.count());
        if own >= MAX_OF_TOKEN {
            return Err(TicketError::TooMany(MAX_OF_TOKEN));
        }
        if all >= MAX_TICKETS {
            return Err(TicketError::TooMany(MAX_TICKETS));
        }
        let ticket = Ticket {
            who: who.clone(),
            origin: origin.cloned(),
            issued: now,
        };
        tickets.insert(Sha256::digest(&text).into(), ticket);
        Ok(text)
    }

    /// Redeems a ticket. Returns its owner if the origin matches, the ticket has not expired, and the token of the owner is still valid.
    /// Removes the ticket if the origin matches.
    pub(super) fn take(&self, text: &str, origin: Option<&HeaderValue>, now: Instant) -> Option<Identity> {
        let hash: [u8; 32] = Sha256::digest(text).into();
        let mut tickets = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        // A page of another origin must not invalidate the ticket.
        if tickets.get(&hash)?.origin.as_ref() != origin {
            return None;
        }
        let ticket = tickets.remove(&hash)?;
        let is_unexpired = now.duration_since(ticket.issued) < LIFETIME;
        (is_unexpired && ticket.who.is_valid()).then_some(ticket.who)
    }
}

/// Returns the first ticket in the query of an address.
pub(super) fn in_query(query: &str) -> Option<&str> {
    query.split('&').find_map(|pair| pair.strip_prefix("ticket="))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ticket_is_of_use_once_and_soon_and_to_its_page() {
        let (tickets, now) = (Tickets::default(), Instant::now());
        let page = HeaderValue::from_static("https://viewer.example");
        let evil = HeaderValue::from_static("https://evil.example");
        let issue = |origin| {
            tickets
                .issue(&Identity::without_token(), origin, now)
                .expect("a ticket")
        };
        let ticket = issue(Some(&page));
        assert_eq!(ticket.len(), 43);
        assert!(tickets.take(&ticket, Some(&page), now).is_some());
        assert!(tickets.take(&ticket, Some(&page), now).is_none(), "twice");
        for other in [Some(&evil), None] {
            let ticket = issue(Some(&page));
            assert!(tickets.take(&ticket, other, now).is_none(), "{other:?}");
            assert!(
                tickets.take(&ticket, Some(&page), now).is_some(),
                "{other:?} does not use it up"
            );
        }
        let (late, early) = (issue(None), issue(None));
        assert!(!format!("{tickets:?}").contains(&late), "stored by its hash");
        assert!(tickets.take(&late, None, now + LIFETIME).is_none(), "late");
        let just = now + LIFETIME - Duration::from_millis(1);
        assert!(tickets.take(&early, None, just).is_some());
    }

    #[test]
    fn there_are_only_so_many_and_old_ones_make_space() {
        let (tickets, now) = (Tickets::default(), Instant::now());
        let who = Identity::without_token();
        for _ in 0..MAX_OF_TOKEN {
            tickets.issue(&who, None, now).expect("a ticket");
        }
        let other = Identity::of_start("other");
        assert!(tickets.issue(&other, None, now).is_ok(), "somebody else");
        let refused = tickets.issue(&who, None, now).expect_err("one too many");
        assert!(matches!(refused, TicketError::TooMany(MAX_OF_TOKEN)), "{refused}");
        assert!(tickets.issue(&who, None, now + LIFETIME).is_ok());
        assert_eq!(tickets.0.lock().expect("not poisoned").len(), 1);
    }

    #[test]
    fn the_first_ticket_of_a_query_counts() {
        assert_eq!(in_query("ticket=a-_b"), Some("a-_b"));
        assert_eq!(in_query("x=1&ticket=a&ticket=b"), Some("a"));
        assert_eq!(in_query("tickets=a"), None);
    }
}
