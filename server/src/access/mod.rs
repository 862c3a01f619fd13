//! Who may use the server.

pub mod origin;

pub use origin::AllowedOrigin;
