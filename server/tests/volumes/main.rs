//! The readers from outside: round trips, real files, folders and catalogs, and false files.

mod catalog;
mod formats;
mod hostile;
mod write;
