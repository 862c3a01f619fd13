//! Targets of addresses, in a build without stores over a network: there are none.

/// Error of each address.
const ABSENT: &str =
    "this program reads no stores over a network (feature `network` of isopeel-volumes), expected a file or a folder";

/// Target of an address; there is none.
#[derive(Clone)]
pub(super) enum Target {}

impl Target {
    pub(super) fn of_s3(_path: &str, _query: &str) -> Result<Self, String> {
        Err(ABSENT.to_owned())
    }

    pub(super) fn of_http(_text: &str) -> Result<Self, String> {
        Err(ABSENT.to_owned())
    }
}
