//! isopeel's server: volumes from disk, a device behind a bounded queue, REST, WebSocket, exports.
//!
//! In layers from the bottom up; each uses only those above it in this list:
//!
//! - `clock`, [`error`], `math`, `pool`, [`private_folder`], [`problem`]: times of day, error chains, vectors, the CPU pool, folders of one user, HTTP errors.
//! - [`view`]: requests of users, as JSON.
//! - [`volumes`]: file formats, datasets and the catalog.
//! - [`device`]: chooses the device, and checks its results.
//! - [`extraction`]: from a view to a surface: the bounded queue to the device, budgets. Only this layer drives the
//!   kernels' engine, apart from the commands `bench` and `devices`.
//! - [`wire`]: messages and chunks of the stream, as bytes. Normative: `PROTOCOL.md`.
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
pub mod extraction;
#[cfg(test)]
mod generated;
pub mod jobs;
mod math;
pub mod metrics;
mod pool;
pub mod private_folder;
pub mod problem;
pub mod rest;
pub mod serve;
pub mod stream;
pub mod uploads;
pub mod view;
pub mod volumes;
pub mod wire;
