//! Objects of a store over a network: by HTTP, or from S3. Only the operator names such a store, on the command line. Without the feature
//! `network` no store opens.
//!
//! Calls block. Each request has limits of time and of bytes, and is retried after a pause if that may help. Redirects to another origin
//! are refused.

mod address;
#[cfg(feature = "network")]
mod client;
#[cfg_attr(not(feature = "network"), path = "no_store.rs")]
mod store;
#[cfg_attr(not(feature = "network"), path = "no_target.rs")]
mod target;

use std::ops::Range;

pub use address::Address;
pub(crate) use store::{Limits, Remote};

/// Range of an object that is read.
#[derive(Clone, Debug)]
pub(crate) enum Part {
    Whole,
    At(Range<u64>),
    /// This many bytes before its end.
    End(u64),
}

/// An object, or a part of it, that was read.
#[derive(Debug)]
pub(crate) struct Object {
    pub(crate) bytes: Vec<u8>,
    /// Bytes of the whole object.
    pub(crate) size: u64,
}

/// Why an object was not read.
#[derive(Debug, PartialEq, Eq)]
#[cfg_attr(not(feature = "network"), expect(dead_code, reason = "no store opens"))]
pub(crate) enum Fault {
    /// There is no such object.
    Missing,
    /// The store refuses to let it be read. Some stores also do so for objects that do not exist.
    Forbidden,
    Other(String),
}

/// Whether the host of an address is this machine: then no proxy is used.
pub fn is_this_machine(host: &str) -> bool {
    let address = host.trim_start_matches('[').trim_end_matches(']');
    host == "localhost"
        || address
            .parse::<std::net::IpAddr>()
            .is_ok_and(|address| address.is_loopback())
}
