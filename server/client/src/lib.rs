//! A client of the stream, written from `server/PROTOCOL.md` alone: it uses no code of the server.
//!
//! [`Connection`] sends messages and receives frames without decoding them. [`Viewer`] decodes each frame, checks it against the
//! protocol, and holds the meshes of all surfaces. It is stricter than a client must be: it also rejects fields that the protocol does
//! not list.

mod chunk;
mod connection;
mod error;
mod frame;
mod surface;
mod viewer;

pub use chunk::{Chunk, ChunkError, LATTICE, RegionKey, Vertex};
pub use connection::{Connection, RawFrame, SUBPROTOCOL, request};
pub use error::Error;
pub use frame::{Frame, Mesher, Prefix};
pub use surface::{Meshes, Surface, same_meshes};
pub use tokio_tungstenite::tungstenite::Message;
pub use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
pub use viewer::Viewer;
