//! The twins alone: against properties that need no numbers, and on volumes whose answers can be written down.

mod distance_field;
mod oracles;
mod properties;
mod stages;
mod uneven;
