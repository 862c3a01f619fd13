//! Stores over a network, in a build without them: each is refused with an error.

use super::{Address, Fault, Object, Part};

/// Limits of requests, of which there are none.
#[derive(Clone, Debug, Default)]
pub(crate) struct Limits {}

/// An open store; there is none.
#[derive(Debug)]
pub(crate) enum Remote {}

impl Remote {
    /// Opens no store.
    ///
    /// # Errors
    /// Always.
    pub(crate) fn open(address: &Address, _limits: Limits) -> Result<Self, String> {
        match &address.target {
            Err(why) => Err(why.clone()),
            Ok(target) => match *target {},
        }
    }

    pub(crate) fn get(&self, _: &str, _: Part, _: u64, _: &dyn Fn() -> bool) -> Result<Object, Fault> {
        match *self {}
    }

    pub(crate) fn folders(&self, _: &str, _: usize) -> Option<Result<Vec<String>, Fault>> {
        match *self {}
    }
}
