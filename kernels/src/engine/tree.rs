//! Builds the vertex tree.

use super::peel::all;
use crate::buffer::Buffer;
use crate::cancel::check_cancelled;
use crate::layout::{self, TreeRegion};
use crate::stages::dual::{self, Corners};
use crate::stages::tree_cut::LEAF_NUMBER;
use crate::stages::{tree, tree_build};
use crate::tree::Built;
use crate::{Cancel, Cut, CutParams, Engine, Error, Level, Pyramid, Result, VertexTree, Volume};
use std::ops::Range;

/// Maximum triangles per CPU core in one launch of `tree_build`. Bounds the working memory, which each launch allocates for its regions,
/// and the launch ends within about 50 ms, so that other jobs get the device soon.
const CORE_TRIANGLES: u64 = 50_000;

/// Minimum triangles of a launch on a GPU, which needs many regions at once. A launch takes half of all triangles, to bound memory.
const MIN_GPU_TRIANGLES: u64 = 2_000_000;
/// Maximum triangles of a launch on a GPU; such a launch ends within about 50 ms.
const MAX_GPU_TRIANGLES: u64 = 8_000_000;
/// Few regions have more triangles. Added to half of all triangles, it makes the work two launches.
const MAX_REGION_TRIANGLES: u64 = 50_000;

/// Points and nodes that a leaf's number can name.
const MAX_LEAVES: usize = LEAF_NUMBER as usize + 1;

impl Engine {
    /// Builds the vertex tree of a pyramid. `params`: whether the volume is capped.
    ///
    /// # Errors
    /// [`Error::Cancelled`], or an error of the device.
    pub fn build_tree(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        params: &CutParams,
        cancel: &dyn Cancel,
    ) -> Result<VertexTree> {
        let cx = &self.cx;
        let full = self.full_cut(volume, pyramid, params)?;
        let (params, state) = (full.params, full.state);
        let regions = pyramid.host_regions.len();
        let (counted, mut meshes) = dual::count(cx, volume, pyramid, &state, &all(pyramid))?;
        check_cancelled(cancel)?;
        let border_base = cx.buffer(tree::STAGE, regions * tree::HALO_WORDS)?;
        let borders = tree::borders(cx, volume, regions, &counted.borders, &border_base)?;
        let cell_points: u32 = pyramid.host_regions.iter().map(layout::Region::cell_points).sum();
        let mut host_regions = numbered(pyramid, cell_points, &borders);
        let point_count = cell_points as usize + borders.iter().map(|&n| n as usize).sum::<usize>();
        // Points without triangles lie beside missing samples and on the volume's faces.
        let used: u64 = meshes.iter().map(|mesh| u64::from(mesh.distinct_vertices)).sum();
        let isolated_points = (point_count as u64).saturating_sub(used);

        if 2 * point_count > MAX_LEAVES {
            return Err(Error::Invalid {
                what: "vertex tree",
                why: format!("{point_count} vertices, above {}", MAX_LEAVES / 2),
            });
        }
        let (device_meshes, _, triangle_count) = self.with_bases(tree::STAGE, &mut meshes)?;
        let corners: Buffer<u32> = cx.buffer(tree::STAGE, 3 * triangle_count)?;
        let points = cx.buffer(tree::STAGE, point_count)?;
        let mut tree_regions = cx.upload(tree::STAGE, &host_regions)?;
        tree::points(cx, volume, pyramid, &params, &points)?;
        let input = dual::Input {
            params: &params,
            state: &state,
            counted: &counted,
            meshes: &device_meshes,
            corners: Corners::Points {
                border_base: &border_base,
                tree_regions: &tree_regions,
                points: &points,
            },
        };
        let no_vertices = cx.buffer(tree::STAGE, 0)?;
        dual::emit(cx, volume, pyramid, &input, &no_vertices, &corners)?;
        drop((counted, state, border_base));
        cx.pause(tree::STAGE, cancel)?;

        let mesh = tree::Mesh {
            params: &params,
            meshes: &device_meshes,
            corners: &corners,
            points: &points,
            cell_points,
        };
        tree::gather(cx, volume, pyramid, &mesh, 0..regions, &tree_regions, None)?;
        let counts = cx.read(tree::STAGE, &tree_regions, regions)?;
        let mut beside_count = 0;
        for (region, counted) in host_regions.iter_mut().zip(&counts) {
            region.triangle_count = counted.triangle_count;
            (region.beside_base, region.beside_count) = (beside_count, counted.beside_count);
            beside_count += counted.beside_count;
        }
        let beside = cx.buffer(tree::STAGE, beside_count as usize)?;
        let gathered = host_regions.iter().map(|region| u64::from(region.triangle_count)).sum();
        let batches = batches(&mut host_regions, pyramid, self.batch_triangles(gathered));
        cx.write(tree::STAGE, &mut tree_regions, &host_regions)?;
        let built = Built::new(cx, point_count, tree_regions)?;
        check_cancelled(cancel)?;
        let queue = tree_build::Queue::new(cx, &batches, &host_regions)?;
        for batch in batches {
            let of = &host_regions[batch.clone()];
            let last = &of[of.len() - 1];
            let clusters = last.cluster_base + pyramid.host_regions[batch.end - 1].cell_points() + last.border_points;
            let work = tree_build::Work::new(
                cx,
                &queue,
                (last.triangle_base + last.triangle_count) as usize,
                clusters as usize,
            )?;
            tree::gather(
                cx,
                volume,
                pyramid,
                &mesh,
                batch.clone(),
                &built.regions,
                Some([&work.triangles, &beside]),
            )?;
            tree_build::run(cx, volume, pyramid, &mesh, batch, &work, &built)?;
            cx.finish(tree::STAGE)?;
            drop(work);
            check_cancelled(cancel)?;
        }
        let collapsed_by = tree::collapses(cx, volume, &mesh, &built)?;
        let (point_corners, corner_ends) = tree::point_corners(cx, volume, pyramid, &mesh, &built, &beside)?;
        let lives = tree::lives(cx, volume, pyramid, point_count, &built)?;
        let host_regions = cx.read(tree::STAGE, &built.regions, regions)?;
        Ok(VertexTree {
            pyramid: pyramid.id,
            cap: params.cap != 0,
            host_regions,
            built,
            points,
            cell_points,
            corners,
            meshes: device_meshes,
            collapsed_by,
            point_corners,
            corner_ends,
            lives,
            beside,
            full_triangles: triangle_count as u64,
            isolated_points,
            parts: Default::default(),
            left_out: Default::default(),
            last_cut: Default::default(),
            importances: Default::default(),
        })
    }

    /// Returns the maximum triangles of a launch. `all`: triangles of all regions.
    fn batch_triangles(&self, all: u64) -> u64 {
        match self.cx.tuning.region_group {
            1 => CORE_TRIANGLES * u64::from(self.device().compute_units),
            _ => (all / 2 + MAX_REGION_TRIANGLES).clamp(MIN_GPU_TRIANGLES, MAX_GPU_TRIANGLES),
        }
    }

    /// The full surface as a cut of cubes.
    pub(super) fn full_cut(&self, volume: &Volume, pyramid: &Pyramid, params: &CutParams) -> Result<Cut> {
        let full = CutParams {
            beta: -1.0,
            tolerance: None,
            ..params.clone()
        };
        self.cut(volume, pyramid, &full, Level::FINEST)
    }
}

/// Assigns each region its range of border points (points on the volume's faces) and of nodes. `borders`: border points per region.
fn numbered(pyramid: &Pyramid, cell_points: u32, borders: &[u32]) -> Vec<TreeRegion> {
    let (mut border_base, mut node_base) = (cell_points, 0);
    let regions = pyramid.host_regions.iter().zip(borders);
    regions
        .map(|(region, &border_points)| {
            let numbered = TreeRegion {
                border_base,
                border_points,
                node_base,
                ..Default::default()
            };
            border_base += border_points;
            // An upper bound: n points allow at most n - 1 merges, and each merge makes one node.
            node_base += region.cell_points() + border_points;
            numbered
        })
        .collect()
}

/// Divides the regions into batches of at most `max_triangles` triangles, or of one region, and assigns each region its range of the
/// batch's working memory.
fn batches(regions: &mut [TreeRegion], pyramid: &Pyramid, max_triangles: u64) -> Vec<Range<usize>> {
    let mut batches: Vec<Range<usize>> = Vec::new();
    let (mut triangles, mut clusters) = (0u32, 0u32);
    for (i, region) in regions.iter_mut().enumerate() {
        if batches.is_empty() || u64::from(triangles) + u64::from(region.triangle_count) > max_triangles {
            batches.push(i..i);
            (triangles, clusters) = (0, 0);
        }
        (region.triangle_base, region.cluster_base) = (triangles, clusters);
        triangles += region.triangle_count;
        clusters += pyramid.host_regions[i].cell_points() + region.border_points;
        if let Some(batch) = batches.last_mut() {
            batch.end = i + 1;
        }
    }
    batches
}
