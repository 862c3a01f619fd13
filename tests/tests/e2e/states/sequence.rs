//! A sequence as JSON: messages of clients and events of the server, so that a failure can be replayed.

use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Sizes of a server's caches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Caches {
    /// Only the last used entries are cached.
    Cold,
    /// So small that entries are evicted all the time.
    Tiny,
    /// The defaults of the server.
    Warm,
}

impl Caches {
    pub const ALL: [Self; 3] = [Self::Cold, Self::Tiny, Self::Warm];

    /// Options of `isopeel serve`.
    pub fn options(self) -> &'static [&'static str] {
        match self {
            Self::Cold => &["--surface-memory", "0", "--shared-memory", "0", "--read-ahead", "0"],
            Self::Tiny => &["--surface-memory", "2", "--shared-memory", "1", "--read-ahead", "1"],
            Self::Warm => &[],
        }
    }
}

/// One event of a sequence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Event {
    /// A viewer sends a message.
    Send { viewer: usize, message: Value },
    /// A viewer sends an edit that is answered with `bad-edit`.
    SendBad { viewer: usize, message: Value },
    /// The same, but the error is found while the surface is made.
    SendLateBad { viewer: usize, message: Value },
    /// A viewer opens a volume, and waits until it is open.
    Open { viewer: usize, volume: String },
    /// All viewers read for a while.
    Wait { milliseconds: u64 },
    /// All viewers wait until they rest, and their surfaces are compared. `newcomer`: also with those of another viewer of the same server.
    Settle { newcomer: bool },
    /// One more viewer follows the first.
    Follow,
    /// The device is lost.
    LoseDevice,
    /// The server is killed and started again; all viewers reconnect and reopen, and none follows.
    Restart,
    /// The sequence's own file is replaced, and viewers that look at it open it again.
    Replace { content: u64 },
    /// The sequence's own series has one more step. `rewrite`: and another first one, and viewers that look at it open it again.
    Grow { content: u64, rewrite: bool },
    /// A volume is uploaded.
    Upload { content: u64 },
    /// The uploaded volume is deleted; viewers that look at it open their first one.
    DeleteUpload,
}

/// A sequence, with the settings of its server.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Sequence {
    /// Seed from which it was drawn.
    pub seed: u64,
    pub caches: Caches,
    /// Bytes per second that the first viewer reads; null: no limit.
    pub line: Option<u32>,
    /// Whether it has files of its own, which the server watches, and uploads.
    #[serde(default)]
    pub has_files: bool,
    /// The volume that each viewer opens first.
    pub volumes: Vec<String>,
    pub events: Vec<Event>,
}
