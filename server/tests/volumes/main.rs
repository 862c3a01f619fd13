//! The readers from outside: round trips, real files, folders and catalogs, and files that lie.

mod catalog;
mod formats;
mod hostile;
mod write;
