//! Relation of the surface that a client holds to the next one.

use crate::extraction::{CutId, Shown, SurfaceKey};
use crate::view::View;
use crate::view::quality::MesherName;

/// The surface that a client holds.
#[derive(Clone, Debug)]
pub(super) struct HeldSurface {
    /// The view, with the threshold that was fitted to its budget.
    pub view: View,
    /// Of its full surface.
    pub key: SurfaceKey,
    pub cut: CutId,
}

impl HeldSurface {
    /// How it relates to a surface of another view, whose full surface has this key.
    pub(super) fn shown_for(&self, key: &SurfaceKey, view: &View) -> Shown {
        if !self.key.has_triangles_of(key) {
            return Shown::Another;
        }
        // Values of the feature are in every vertex; the paper's mesher makes whole surfaces.
        let by_region = |view: &View| view.mesher == MesherName::Dual;
        if self.key.has_vertices_of(key) && by_region(&self.view) && by_region(view) {
            Shown::Cut(self.cut)
        } else {
            Shown::Alike
        }
    }
}
