//! The server of isopeel: volumes from disk, a device behind a bounded queue, REST, WebSocket, and exports.
//!
//! Other crates contain volumes (`isopeel_volumes`), views (`isopeel_view`), chunks (`isopeel_codec`), and the engine above them
//! (`isopeel_extraction`). The layers of this crate, from the bottom up. A layer uses only layers that come before it in this list:
//!
//! - `clock`, [`error`], [`metrics`], `pool`, [`private_folder`]: times of day, error chains, metrics, thread pools, folders of one user.
//! - [`device`], [`problem`]: selection and check of the device; errors of HTTP.
//! - [`service`]: the engine for many callers, with the bounded queue to the device. Only this layer has a workspace of the engine. The
//!   layer   `device` and the commands `bench` and `devices` use the device, too.
//! - [`wire`]: messages of the stream. `PROTOCOL.md` is normative.
//! - [`export`]: files of surfaces and slices.
//! - [`access`]: authentication and authorization.
//! - [`jobs`], [`uploads`]: batch jobs, and volumes that users upload. Each stores its data in a folder.
//! - [`stream`]: viewers: sessions and sockets.
//! - [`rest`]: REST, OpenAPI and the embedded web client.
//! - [`serve`]: the whole server behind one listener.
//! - [`cli`]: the commands of the binary.

pub mod access;
mod bounded_read;
pub mod cli;
mod clock;
pub mod device;
pub mod error;
pub mod export;
#[cfg(test)]
mod generated;
pub mod jobs;
pub mod metrics;
mod pool;
pub mod private_folder;
pub mod problem;
pub mod rest;
pub mod serve;
pub mod service;
pub mod stream;
pub mod uploads;
pub mod wire;
