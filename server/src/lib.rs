//! isopeel's server: volumes from disk, a device behind a bounded queue, REST, WebSocket, exports.
//!
//! In layers; each uses only those above it in this list:
//!
//! - [`view`]: what a user asks for, as JSON in REST and WebSocket alike.
//! - [`volumes`]: where data comes from: one reader a format, and the catalog that names them.
//! - [`extraction`]: from a view to a surface: the bounded queue to the device, budgets, simplification.
//! - [`wire`]: messages and chunks of the stream. Normative: `PROTOCOL.md`.
//! - [`export`]: GLB, PLY and STL.
//! - [`access`]: who may use the server.
//! - [`stream`]: one viewer: session and socket.
//! - [`rest`]: REST, OpenAPI and the embedded web client.
//! - [`serve`]: all of it behind one listener.
//! - [`cli`]: the commands of the binary.

pub mod access;
pub mod cli;
pub mod error;
pub mod export;
pub mod extraction;
#[cfg(test)]
mod generated;
mod math;
mod pool;
pub mod problem;
pub mod rest;
pub mod serve;
pub mod stream;
pub mod view;
pub mod volumes;
pub mod wire;
