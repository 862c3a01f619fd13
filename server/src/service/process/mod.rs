//! The device in a process of its own. A driver that crashes, hangs or takes all memory ends that process alone: it is replaced, and its
//! jobs are tried again.
//!
//! In the server:
//! - `link`: the queue of jobs, and the thread that sends them. `table`: jobs that have no outcome yet.
//! - `supervisor`: the thread that starts and replaces the process, and receives its messages. `child`: the process as its parent sees it.
//! - `monitor`: the thread that kills a process that hangs or takes too much memory.
//! - `blame`: requests that have ended the process before.
//!
//! In both processes: `messages`, the `meshes` of replies, and the `channel` that they go through, with
//!   `shared_memory` and `blocks`.
//!
//! In the process: `worker`. `confine`: what it may do with files and the network.

mod blame;
mod blocks;
mod channel;
mod child;
mod confine;
mod link;
mod meshes;
mod messages;
mod monitor;
mod shared_memory;
mod supervisor;
mod table;
mod worker;

pub use confine::{Confined, confine, landlock_version};
pub(super) use link::Link;
pub(super) use supervisor::start;
pub use worker::run;
