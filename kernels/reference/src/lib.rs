//! Plain Rust twins of the device stages, for tests: single-threaded, sparse maps over a dense slice, written from the
//! algorithm and not from the kernels. They share the kernels' case tables ([`isopeel_kernels::tables`]), whose own tests
//! need neither.
//!
//! One file per stage, named as the stage: [`minmax`], [`histogram`], [`classify`], [`derive`], [`construct`], [`cut`], [`march`],
//! [`patch`], [`pack`], [`dual`], [`error`], [`tree`], [`tree_part`], [`tree_cut`], [`slice`], [`overview`], [`probe`], [`distribution`],
//! [`curve`], [`distance`] and [`interpolate`]; beside them [`expression`], [`distance_field`], [`cell_values`] and, for tests of whole surfaces, [`edges`]. What `construct` does for the dual mesher is in [`sheets`], [`vertices`] and `relax`, over
//! [`quadric`] and [`octahedral`]; the rounds of `tree` are in `block`, over `cluster`; `levels` leads from one level of blocks to the next, and `vanishing`
//! adds the nodes above the last one. Both cuts use [`interest`].
//! [`Pipeline`] runs the stages of the paper's mesher in order. Every stage can also be fed with another's results: a test
//! that fills [`Pyramid`] with nodes read back from a device gets a cut that must agree leaf for leaf. [`files`] reads test
//! volumes.
//!
//! A new stage's twin is a file here, with its line below, and a file of comparisons in `tests/device`, with its line in
//! `main.rs`.
//!
//! Arithmetic is f32, sums run over children in Morton order. Cells, cubes, samples and regions are `[x, y, z]`; the
//! cube of level `l` that holds cell `c` has the coordinates `c >> l`.

mod block;
pub mod cell_values;
pub mod classify;
mod cluster;
pub mod construct;
pub mod curve;
pub mod cut;
pub mod derive;
pub mod distance;
pub mod distance_field;
pub mod distribution;
pub mod dual;
pub mod edges;
pub mod error;
pub mod expression;
mod field;
pub mod files;
pub mod histogram;
pub mod interest;
pub mod interpolate;
mod levels;
pub mod march;
pub mod minmax;
pub mod octahedral;
pub mod overview;
pub mod pack;
pub mod patch;
pub mod probe;
pub mod quadric;
mod relax;
pub mod sheets;
pub mod slice;
pub mod tree;
pub mod tree_cut;
pub mod tree_part;
pub mod tree_relax;
mod trilinear;
mod vanishing;
pub mod vertices;

pub use construct::{Cell, Feature, Node, Pyramid};
pub use cut::{Cut, Leaf};
pub use field::Field;
use field::{boxes, offset};
pub use march::{FineEdge, Mesh, MeshVertex, Triangle};

use isopeel_kernels::{CutParams, Level, Surface};

/// The stages in order, for one field, feature and isovalue.
pub struct Pipeline<'a> {
    /// The field.
    pub field: &'a Field,
    /// Isovalue, in the field's units.
    pub iso: f32,
    /// Active cells and nodes.
    pub pyramid: Pyramid,
}

impl<'a> Pipeline<'a> {
    /// Classifies and builds the pyramid.
    pub fn new(field: &'a Field, feature: Feature<'_>, iso: f32) -> Self {
        Self {
            field,
            iso,
            pyramid: construct::construct(field, feature, iso),
        }
    }

    /// The cut of a prefix; 0 is the final one.
    pub fn cut(&self, params: &CutParams, prefix: Level) -> Cut {
        cut::cut(&self.pyramid, params, prefix)
    }

    /// The mesh of a cut, patched.
    pub fn mesh(&self, cut: &Cut) -> Mesh {
        let mut mesh = march::march(self.field, &self.pyramid, self.iso, cut);
        patch::patch(self.field, &self.pyramid, self.iso, cut, &mut mesh);
        mesh
    }

    /// The whole pipeline: returns the surface that `Engine::peel` returns, except times and bytes.
    pub fn peel(&self, params: &CutParams, prefix: Level) -> Surface {
        let cut = self.cut(params, prefix);
        let mesh = self.mesh(&cut);
        pack::pack(self.field, &self.pyramid, &cut, &mesh, params, prefix)
    }
}
