//! The parts of a vertex tree's surface, and which of them a cut leaves out.

use crate::layout::TreePartSum;
use crate::lock::lock;
use crate::stages::cut::Criterion;
use crate::stages::probe;
use crate::stages::tree_cut::Cutter;
use crate::stages::tree_part::STAGE;
use crate::tree::{LeftOut, TreeParts};
use crate::{
    Cancel, ChosenParts, CutParams, DeviceKind, Engine, Level, Never, PartFilter, ProbedPart, Pyramid, RemovedParts,
    Result, VertexTree, Volume,
};
use std::sync::Arc;

/// A probe finds the parts of full surfaces of at most this size, which takes some 50 ms. Parts of larger surfaces are found only when a
/// filter removes some, because a probe does not pause for other jobs.
const MAX_TRIANGLES_ON_CPU: u64 = 200_000;
/// See [`MAX_TRIANGLES_ON_CPU`].
const MAX_TRIANGLES_ON_GPU: u64 = 10_000_000;

impl Engine {
    /// Returns what a filter removes from a tree's surface. The first call that removes anything finds the parts, which are then kept in
    /// device memory for the lifetime of the tree.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`], or an error of the device.
    pub fn removed_parts(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        tree: &VertexTree,
        params: &CutParams,
        filter: &PartFilter,
        cancel: &dyn Cancel,
    ) -> Result<RemovedParts> {
        let cutter = self.cutter(volume, pyramid, tree, params);
        let left_out = left_out(&cutter, params, filter, cancel)?;
        Ok(left_out.map_or(RemovedParts::default(), |left_out| left_out.removed))
    }

    /// Returns the part of a point; `None` if it belongs to none, or if the parts are unknown and the surface is too large to find them
    /// for a probe.
    pub(super) fn part_of(&self, cutter: &Cutter<'_>, point: u32) -> Result<Option<ProbedPart>> {
        let limit = match self.device().kind {
            DeviceKind::Cpu => MAX_TRIANGLES_ON_CPU,
            _ => MAX_TRIANGLES_ON_GPU,
        };
        if cutter.tree.parts.get().is_none() && cutter.tree.full_triangles > limit {
            return Ok(None);
        }
        let parts = parts(cutter, &Never)?;
        let area = self.cx.read_at(STAGE, &parts.areas, point as usize, 1)?[0].abs();
        let first = self.cx.read_at(STAGE, &parts.firsts, point as usize, 1)?[0];
        Ok((area > 0.0).then_some(ProbedPart { number: first, area }))
    }
}

/// The parts that a filter removes; `None` if it removes none.
pub(super) fn left_out(
    cutter: &Cutter<'_>,
    params: &CutParams,
    filter: &PartFilter,
    cancel: &dyn Cancel,
) -> Result<Option<Arc<LeftOut>>> {
    if !filter.removes() {
        return Ok(None);
    }
    let kept = lock(&cutter.tree.left_out).clone();
    if kept.as_ref().is_some_and(|kept| kept.filter == *filter) {
        return Ok(kept);
    }
    let parts = parts(cutter, cancel)?;
    let (firsts, unmatched) = chosen(cutter, params, &parts, filter)?;
    let keep = matches!(filter.chosen, Some(ChosenParts::Keep(_)));
    let points = cutter.removed_points(&parts, filter.min_area, &firsts, keep)?;
    let sums = cutter.sum_removed(&parts, &points)?;
    let total = |of: fn(&TreePartSum) -> u32| sums.iter().map(|sum| u64::from(of(sum))).sum();
    let left_out = Arc::new(LeftOut {
        filter: filter.clone(),
        points,
        removed: RemovedParts {
            parts: total(|sum| sum.parts),
            full_triangles: total(|sum| sum.full_triangles),
            unmatched,
        },
        triangles: total(|sum| sum.triangles),
        area_left: sums.iter().map(|sum| f64::from(sum.area_left)).sum(),
    });
    *lock(&cutter.tree.left_out) = Some(Arc::clone(&left_out));
    Ok(Some(left_out))
}

/// The first points of the parts that positions choose, each once, and how many positions have no part next to them. A position chooses
/// the part of the vertex that a probe finds there; of a cell with several sheets, that of the first.
fn chosen(cutter: &Cutter<'_>, params: &CutParams, parts: &TreeParts, filter: &PartFilter) -> Result<(Vec<u32>, u64)> {
    let positions = filter.chosen.as_ref().map_or(&[][..], ChosenParts::positions);
    let inside: Vec<[f32; 3]> = positions.iter().copied().flatten().collect();
    let criterion = Criterion::upload(cutter.cx, params, Level::FINEST)?;
    let cells = probe::run(cutter.cx, cutter.volume, cutter.pyramid, &criterion, &inside)?;
    let (mut firsts, mut matched) = (Vec::new(), 0);
    for cell in cells.into_iter().flatten() {
        let point = cell.point as usize;
        // A cell without triangles belongs to no part.
        if cutter.cx.read_at(STAGE, &parts.areas, point, 1)?[0] != 0.0 {
            firsts.push(cutter.cx.read_at(STAGE, &parts.firsts, point, 1)?[0]);
            matched += 1;
        }
    }
    firsts.sort_unstable();
    firsts.dedup();
    Ok((firsts, positions.len() as u64 - matched))
}

/// Returns the parts of the surface, which the tree caches.
fn parts(cutter: &Cutter<'_>, cancel: &dyn Cancel) -> Result<Arc<TreeParts>> {
    if let Some(parts) = cutter.tree.parts.get() {
        return Ok(Arc::clone(parts));
    }
    let parts = Arc::new(cutter.parts(cancel)?);
    Ok(Arc::clone(cutter.tree.parts.get_or_init(|| parts)))
}
