//! isopeel's server: volumes from disk, a device behind a bounded queue, REST, WebSocket, exports.
//!
//! In reading order:
//!
//! - [`volumes`]: where data comes from: one reader a format, and the catalog that names them.
//! - [`edit`]: what a user asks for, as JSON, in REST and WebSocket alike.
//! - [`device_worker`]: the bounded queue to the thread that owns the device.
//! - [`stream`]: one viewer: protocol, session, encoder. Normative: `PROTOCOL.md`.
//! - [`api`]: REST and OpenAPI.
//! - [`export`]: GLB, PLY and STL.
//! - [`cli`]: the commands of the binary.

pub mod cli;
pub mod edit;
pub mod volumes;
