//! Relates the surface that a client holds to the next surface.

use isopeel_view::View;
use isopeel_view::quality::MesherName;

use isopeel_extraction::{CutId, Shown, SurfaceKey};

/// The surface that a client holds.
#[derive(Clone, Debug)]
pub(super) struct HeldSurface {
    /// The view, with the threshold that was fitted to its budget.
    pub view: View,
    /// Key of the view's full surface.
    pub key: SurfaceKey,
    pub cut: CutId,
}

impl HeldSurface {
    /// Returns how the held surface relates to the surface of another view, whose full surface has this key.
    pub(super) fn shown_for(&self, key: &SurfaceKey, view: &View) -> Shown {
        if !self.key.has_triangles_of(key) {
            return Shown::Another;
        }
        // Regions can stay only if the dual mesher makes both surfaces, because the other mesher makes whole surfaces. A change of the
        // feature affects every vertex.
        let is_dual = |view: &View| view.mesher == MesherName::Dual;
        if self.key.has_vertices_of(key) && is_dual(&self.view) && is_dual(view) {
            Shown::Cut(self.cut)
        } else {
            Shown::Alike
        }
    }
}
