//! The parts of a vertex tree's surface, and which of them a cut leaves out.

use crate::buffer::Buffer;
use crate::stages::tree_cut::Cutter;
use crate::tree::SmallParts;
use crate::{Cancel, CutParams, Engine, Pyramid, RemovedParts, Result, VertexTree, Volume};
use std::rc::Rc;

impl Engine {
    /// What goes with the parts of a tree's surface below an area, world units. At the first call the parts are found, which takes memory
    /// beside the tree for as long as that lives.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`], or what the device says.
    pub fn small_parts(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        tree: &VertexTree,
        params: &CutParams,
        min_part: f32,
        cancel: &dyn Cancel,
    ) -> Result<RemovedParts> {
        let cutter = self.cutter(volume, pyramid, tree, params);
        Ok(small_parts(&cutter, min_part, cancel)?.map_or(RemovedParts::default(), |small| small.removed))
    }
}

/// The parts below an area; `None` where that is 0.
pub(super) fn small_parts(cutter: &Cutter<'_>, min_part: f32, cancel: &dyn Cancel) -> Result<Option<Rc<SmallParts>>> {
    if min_part.is_nan() || min_part <= 0.0 {
        return Ok(None);
    }
    let kept = cutter.tree.small_parts.borrow().clone();
    if kept.as_ref().is_some_and(|kept| kept.min_part == min_part) {
        return Ok(kept);
    }
    let areas = part_areas(cutter, cancel)?;
    let sums = cutter.small_parts(&areas, min_part)?;
    let total = |of: fn(&crate::layout::TreePartSum) -> u32| sums.iter().map(|sum| u64::from(of(sum))).sum();
    let small = Rc::new(SmallParts {
        areas,
        min_part,
        removed: RemovedParts {
            parts: total(|sum| sum.parts),
            full_triangles: total(|sum| sum.full_triangles),
        },
        triangles: total(|sum| sum.triangles),
        area: sums.iter().map(|sum| f64::from(sum.area)).sum(),
    });
    cutter.tree.small_parts.replace(Some(Rc::clone(&small)));
    Ok(Some(small))
}

/// The area of each point's part, which the tree keeps.
fn part_areas(cutter: &Cutter<'_>, cancel: &dyn Cancel) -> Result<Rc<Buffer<f32>>> {
    if let Some(areas) = cutter.tree.part_areas.get() {
        return Ok(Rc::clone(areas));
    }
    let areas = Rc::new(cutter.part_areas(cancel)?);
    Ok(Rc::clone(cutter.tree.part_areas.get_or_init(|| areas)))
}
