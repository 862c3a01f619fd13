//! The `isopeel` binary.
fn main() {}
