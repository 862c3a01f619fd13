//! What the device gives back: a surface, or what is known of one before it is made.

use std::time::Duration;

use isopeel_kernels::{Count, Level, Surface};

use crate::view::View;

/// A surface and its view.
#[derive(Clone, Debug)]
pub struct Extraction {
    /// The surface.
    pub surface: Surface,
    /// The view it shows, with isovalue and feature range filled in.
    pub view: View,
    /// Time on the device's thread, without waiting and reading files.
    pub wall: Duration,
}

/// Counts of a prefix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrefixCount {
    /// Its level.
    pub level: Level,
    /// Its triangles, vertices and leaves.
    pub count: Count,
}

/// What is known of a surface before it is made.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The view with every value in force, the β of a budget included.
    pub view: View,
    /// The prefixes of the requested levels, in their order.
    pub prefixes: Vec<PrefixCount>,
    /// Regions of the full-resolution surface; no prefix has more.
    pub regions: usize,
    /// Time on the device's thread.
    pub wall: Duration,
}
