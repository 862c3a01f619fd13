//! The twins alone: against properties that need no numbers, and on volumes whose answers can be written down.

mod distance_field;
mod hierarchy;
mod oracles;
mod properties;
mod stages;
mod surface_nets;
mod uneven;
