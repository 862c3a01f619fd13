//! How what a client holds relates to what it will get.

use crate::extraction::{CutId, Shown};
use crate::view::View;
use crate::view::quality::MesherName;

/// How a surface that was made of a view relates to one of another view.
pub(super) fn shown_for(shown: &View, cut: CutId, view: &View) -> Shown {
    if !is_same_surface(shown, view) {
        return Shown::Another;
    }
    // Values of the feature are in every vertex; the paper's mesher makes whole surfaces.
    let by_region = |view: &View| view.mesher == MesherName::Dual;
    let same_feature = (&shown.feature, shown.feature_range) == (&view.feature, view.feature_range);
    if same_feature && by_region(shown) && by_region(view) {
        Shown::Cut(cut)
    } else {
        Shown::Alike
    }
}

/// Whether two views have the same full surface.
pub(super) fn is_same_surface(one: &View, other: &View) -> bool {
    (one.iso, &one.field) == (other.iso, &other.field)
}
