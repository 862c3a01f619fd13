//! Pyramids: from a volume, an isovalue and a feature.

use std::sync::atomic::{AtomicU64, Ordering};

use crate::cancel::check_cancelled;
use crate::layout::{self, Brick, Node, VertexRecord};
use crate::stages::{self, activate, classify, construct, derive};
use crate::{Cancel, Engine, Error, Feature, Isovalue, Pyramid, Result, Volume};

/// Id of the next pyramid. Ids are unique in the process, not only in an engine: cuts and trees of a lost engine may still refer to
/// their pyramids when another engine has replaced it.
static PYRAMIDS: AtomicU64 = AtomicU64::new(0);

impl Engine {
    /// Finds the active bricks and builds the pyramid of one isovalue.
    ///
    /// # Errors
    /// [`Error::Cancelled`], or an error of the device.
    pub fn build_pyramid(
        &self,
        volume: &Volume,
        feature: Feature<'_>,
        iso: Isovalue,
        cancel: &dyn Cancel,
    ) -> Result<Pyramid> {
        self.build(volume, feature, iso, true, cancel)
    }

    /// Builds the finest level alone, which takes less time. That is enough if [`crate::CutParams::is_full`].
    ///
    /// # Errors
    /// As [`Engine::build_pyramid`].
    pub fn build_cells(
        &self,
        volume: &Volume,
        feature: Feature<'_>,
        iso: Isovalue,
        cancel: &dyn Cancel,
    ) -> Result<Pyramid> {
        self.build(volume, feature, iso, false, cancel)
    }

    fn build(
        &self,
        volume: &Volume,
        feature: Feature<'_>,
        iso: Isovalue,
        whole: bool,
        cancel: &dyn Cancel,
    ) -> Result<Pyramid> {
        feature.check_grid(volume)?;
        let cx = &self.cx;
        cx.take_times()?;
        let before = cx.pool.restart();
        let iso = iso.get();

        let masks = activate::run(cx, volume, iso)?;
        check_cancelled(cancel)?;
        let mut region_index = vec![layout::NONE; masks.len()];
        let mut host_regions = Vec::new();
        let mut list = Vec::new();
        for (linear, &brick_mask) in masks.iter().enumerate() {
            let bits = u64::from(brick_mask[0]) | u64::from(brick_mask[1]) << 32;
            if bits == 0 {
                continue;
            }
            let compact = host_regions.len() as u32;
            region_index[linear] = compact;
            host_regions.push(layout::Region {
                region: linear as u32,
                brick_base: list.len() as u32,
                brick_mask,
                missing_mask: volume.missing_masks[linear],
                ..Default::default()
            });
            let mut left = bits;
            while left != 0 {
                list.push(compact << 6 | left.trailing_zeros());
                left &= left - 1;
            }
        }

        let mut regions = cx.upload(classify::STAGE, &host_regions)?;
        let bricks = cx.buffer::<Brick>(classify::STAGE, list.len())?;
        let work = stages::slab_work(volume, &host_regions, list.len());
        let list = cx.upload(classify::STAGE, &list)?;
        classify::run(cx, volume, iso, &work, &list, &regions, &bricks)?;
        drop(list);
        let mut arranged = cx.read(classify::STAGE, &regions, host_regions.len())?;
        let (mut slots, mut points) = (0u32, 0u32);
        for region in &mut arranged {
            region.slot_base = slots;
            region.point_base = points;
            points += region.cell_points();
            slots = slots
                .checked_add(region.level_base[7])
                .ok_or(Error::OutOfDeviceMemory {
                    stage: construct::STAGE,
                    needed_bytes: u64::from(u32::MAX) * size_of::<Node>() as u64,
                    limit_bytes: Some(cx.limit_bytes),
                })?;
        }
        cx.write(classify::STAGE, &mut regions, &arranged)?;
        check_cancelled(cancel)?;

        let nodes = cx.buffer::<Node>(construct::STAGE, slots as usize)?;
        let vertex_records = cx.buffer::<VertexRecord>(construct::STAGE, slots as usize)?;
        let input = construct::Input {
            volume,
            feature,
            iso,
            whole,
            work: &stages::launches(&work, &host_regions, cx.tuning.launch_bricks),
            regions: &regions,
            bricks: &bricks,
            case_facts: &self.case_facts,
        };
        if let Some(source) = derive::Source::of(volume, feature) {
            derive::run(cx, &source, &input, &nodes, cancel)?;
        }
        let totals = construct::run(cx, &input, &nodes, &vertex_records, cancel)?;
        let host_index = region_index;
        let region_index = cx.upload(construct::STAGE, &host_index)?;
        let near = cx.buffer(construct::STAGE, 27 * bricks.len())?;
        construct::link(cx, volume, &region_index, &regions, &bricks, &near)?;
        let [rx, ry, _] = volume.grid.regions();
        let coords = |linear: u32| [linear % rx, linear / rx % ry, linear / rx / ry];
        Ok(Pyramid {
            id: PYRAMIDS.fetch_add(1, Ordering::Relaxed),
            iso,
            grid: volume.grid,
            whole,
            region_index,
            host_index,
            regions,
            bricks,
            near,
            nodes,
            vertex_records,
            full_triangles: totals.iter().map(|&n| u64::from(n)).sum(),
            active_cells: arranged.iter().map(|r| u64::from(r.level_base[1])).sum(),
            coords: arranged.iter().map(|region| coords(region.region)).collect(),
            host_regions: arranged,
            stages: cx.take_times()?,
            peak_bytes: cx.pool.peak().saturating_sub(before),
            feature_bytes: feature.sample_bytes_beside(volume),
        })
    }
}
