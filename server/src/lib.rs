//! isopeel's server: volumes from disk, a device behind a bounded queue, REST, WebSocket, exports.
//!
//! Volumes, views and chunks are crates of their own: `isopeel_volumes`, `isopeel_view` and `isopeel_codec`; above them is the engine,
//! `isopeel_extraction`. Above that, in layers from the bottom up; each uses only those above it in this list:
//!
//! - `clock`, [`error`], [`metrics`], `pool`, [`private_folder`]: times of day, error chains, metrics, the CPU pool, folders of one user.
//! - [`device`], [`problem`]: chooses the device and checks its results; HTTP errors.
//! - [`service`]: the engine for many callers: the bounded queue to the device, budgets. Only this layer has a workspace of the engine; apart
//!   from it, `device` and the commands `bench` and `devices` use the device.
//! - [`wire`]: messages of the stream. Normative: `PROTOCOL.md`.
//! - [`export`]: GLB, PLY, STL and other file formats.
//! - [`access`]: authentication and authorization.
//! - [`jobs`], [`uploads`]: batch jobs, and volumes that users bring, each kept in a folder.
//! - [`stream`]: one viewer: session and socket.
//! - [`rest`]: REST, OpenAPI and the embedded web client.
//! - [`serve`]: the whole server behind one listener.
//! - [`cli`]: the commands of the binary.

pub mod access;
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
