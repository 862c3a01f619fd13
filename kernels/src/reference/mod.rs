//! Plain Rust twins of every device stage, for tests: slow, simple, independent of the kernels.

pub mod cases;
