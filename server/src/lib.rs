//! isopeel's server: volumes from disk, a device behind a bounded queue, REST, WebSocket, exports.
//!
//! In reading order:
//!
//! - [`volumes`]: where data comes from: one reader a format, and the catalog that names them.
//! - [`edit`]: what a user asks for, as JSON, in REST and WebSocket alike.
//! - [`quality`]: the part of it that says how fine: mesher, guards, budgets.
//! - [`budget`]: from a wish to a surface: β for a budget, the ceiling, the polish.
//! - [`device_worker`]: the bounded queue to the thread that owns the device.
//! - [`statistics`]: what one extraction did, as JSON.
//! - [`polish`]: quadric simplification of a finished surface.
//! - [`stream`]: one viewer: protocol, session, encoder. Normative: `PROTOCOL.md`.
//! - [`api`]: REST and OpenAPI.
//! - [`export`]: GLB, PLY and STL.
//! - [`web_client`]: the web client, embedded in the binary.
//! - [`serve`]: all of it behind one listener.
//! - [`cli`]: the commands of the binary.

pub mod api;
pub mod budget;
pub mod cli;
pub mod device_worker;
pub mod edit;
pub mod export;
pub mod polish;
pub mod quality;
pub mod serve;
pub mod statistics;
pub mod stream;
pub mod volumes;
pub mod web_client;
