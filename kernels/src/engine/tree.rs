//! The vertex tree: built, cut and meshed.

use super::fit::ERROR_KEYS;
use super::peel::{Mesh, all, triangles};
use super::tree_part::small_parts;
use crate::buffer::Buffer;
use crate::cancel::check;
use crate::cut::sum_levels;
use crate::layout::{self, RegionMesh, TreeCutRegion, TreeRegion};
use crate::stages::cut::Criterion;
use crate::stages::dual::{self, Corners};
use crate::stages::fit::{INNER_BINS, Keys};
use crate::stages::tree_cut::{CutWork, Cutter};
use crate::stages::{cut, error, tree, tree_cut};
use crate::tree::Built;
use crate::{
    Cancel, Cut, CutParams, Engine, Error, ErrorEstimate, Level, Pyramid, Result, Surface, SurfaceStatistics,
    VertexTree, Volume,
};
use std::ops::Range;

/// Regions whose tree is built in one launch have at most so many triangles for each core of a CPU: working memory is theirs alone, and
/// the launch ends within about 50 ms, for whoever waits for the device.
const CORE_TRIANGLES: u64 = 12_500;

/// The same of a GPU, which needs many regions at once.
const GPU_TRIANGLES: u64 = 4_000_000;

/// Cuts that are tried until none of their merges changes the topology. Each one forbids at least one merge.
const MAX_REPAIRS: usize = 64;

/// One in so many triangles of a budget is left for merges that repairs undo: most cuts need fewer, and are not fitted again.
const REPAIR_SHARE: u64 = 64;

/// Points and nodes that a leaf's number can name (`LEAF_NUMBER` in `cl/lib/tree_leaf.h`).
const MAX_LEAVES: usize = 1 << 28;

/// How far a tree is cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TreeGoal {
    /// A node is merged up to this error over its weight, world units; below 0 none is.
    pub tolerance: f32,
    /// And beyond that until there are at most so many triangles.
    pub max_triangles: u64,
    /// But not beyond this error over its weight, world units: a guard.
    pub max_tolerance: f32,
    /// Before that, parts of a smaller area are left out, world units; 0: none are.
    pub min_part: f32,
}

impl Engine {
    /// Builds the vertex tree of a pyramid. `params`: whether the volume is capped.
    ///
    /// # Errors
    /// [`Error::Cancelled`], or what the device says.
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
        check(cancel)?;
        let border_base = cx.buffer(tree::STAGE, regions * tree::HALO_WORDS)?;
        let borders = tree::borders(cx, volume, regions, &counted.borders, &border_base)?;
        let cell_points: u32 = pyramid.host_regions.iter().map(layout::Region::cell_points).sum();
        let mut host_regions = numbered(pyramid, cell_points, &borders);
        let point_count = cell_points as usize + borders.iter().map(|&n| n as usize).sum::<usize>();

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
        self.pause(tree::STAGE, cancel)?;

        let mesh = tree::Mesh {
            params: &params,
            meshes: &device_meshes,
            corners: &corners,
            points: &points,
            cell_points,
        };
        tree::gather(cx, volume, pyramid, &mesh, 0..regions, &tree_regions, None)?;
        let counts = cx.read(tree::STAGE, &tree_regions, regions)?;
        for (region, counted) in host_regions.iter_mut().zip(&counts) {
            region.triangle_count = counted.triangle_count;
        }
        let batches = batches(&mut host_regions, pyramid, self.batch_triangles());
        cx.write(tree::STAGE, &mut tree_regions, &host_regions)?;
        let built = Built::new(cx, point_count, tree_regions)?;
        check(cancel)?;
        for batch in batches {
            let of = &host_regions[batch.clone()];
            let last = &of[of.len() - 1];
            let clusters = last.cluster_base + pyramid.host_regions[batch.end - 1].cell_points() + last.border_points;
            let work = tree::Work::new(
                cx,
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
                Some(&work.triangles),
            )?;
            tree::build(cx, volume, pyramid, &mesh, batch, &work, &built)?;
            cx.finish(tree::STAGE)?;
            drop(work);
            check(cancel)?;
        }
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
            full_triangles: triangle_count as u64,
            part_areas: Default::default(),
        })
    }

    fn batch_triangles(&self) -> u64 {
        match self.cx.tuning.region_group {
            1 => CORE_TRIANGLES * u64::from(self.device().compute_units),
            _ => GPU_TRIANGLES,
        }
    }

    /// Waits for what was launched, so that whoever is let in by `cancel` does not.
    pub(super) fn pause(&self, stage: &'static str, cancel: &dyn Cancel) -> Result<()> {
        self.cx.finish(stage)?;
        check(cancel)
    }

    /// Cuts a tree and meshes the cut. Topology is that of the full dual mesh without removed parts, so there is a minimum of triangles:
    /// where a budget is below it, or below what the guard allows, the surface has that many. Returns the tolerance as well.
    ///
    /// # Errors
    /// [`Error::Cancelled`], or what the device says.
    pub fn tree_surface(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        tree: &VertexTree,
        params: &CutParams,
        goal: TreeGoal,
        cancel: &dyn Cancel,
    ) -> Result<(Surface, f32)> {
        let cx = &self.cx;
        let before = cx.pool.restart();
        let cutter = self.cutter_without_parts(volume, pyramid, tree, params, goal.min_part, cancel)?;
        let (work, tolerance) = self.cut_tree(&cutter, params, goal, cancel)?;
        let (mut meshes, statistics) = self.count_tree_cut(&cutter, &work)?;
        check(cancel)?;
        let mesh = self.mesh_tree_cut(&cutter, params, work, &mut meshes, cancel)?;
        let error = mesh.errors.as_ref().map(|(_, whole)| *whole);
        let regions = self.read_back(pyramid, mesh)?;
        let device_bytes = pyramid.device_bytes() + tree.device_bytes() + cx.pool.peak().saturating_sub(before);
        let surface = Surface {
            regions,
            remade: None,
            prefix: Level::FINEST,
            statistics: SurfaceStatistics {
                error,
                stages: cx.take_times()?,
                device_bytes: volume.table_bytes() + pyramid.peak_bytes.max(device_bytes),
                volume_bytes: volume.sample_bytes() + pyramid.feature_bytes,
                ..statistics
            },
        };
        Ok((surface, tolerance))
    }

    /// What cuts a tree; it must be one of this pyramid.
    pub(crate) fn cutter<'a>(
        &'a self,
        volume: &'a Volume,
        pyramid: &'a Pyramid,
        tree: &'a VertexTree,
        params: &CutParams,
    ) -> Cutter<'a> {
        assert!(
            tree.is_of(pyramid) && tree.cap == params.cap,
            "a tree of another pyramid"
        );
        Cutter {
            cx: &self.cx,
            volume,
            pyramid,
            tree,
            small: None,
        }
    }

    /// What cuts a tree without the parts below an area.
    pub(super) fn cutter_without_parts<'a>(
        &'a self,
        volume: &'a Volume,
        pyramid: &'a Pyramid,
        tree: &'a VertexTree,
        params: &CutParams,
        min_part: f32,
        cancel: &dyn Cancel,
    ) -> Result<Cutter<'a>> {
        let cutter = self.cutter(volume, pyramid, tree, params);
        let small = small_parts(&cutter, min_part, cancel)?;
        Ok(Cutter { small, ..cutter })
    }

    /// The cut of a goal, repaired until no merge changes the topology, and its tolerance.
    pub(super) fn cut_tree(
        &self,
        cutter: &Cutter<'_>,
        params: &CutParams,
        goal: TreeGoal,
        cancel: &dyn Cancel,
    ) -> Result<(CutWork, f32)> {
        params.check()?;
        let importances = match params.has_importance() {
            true => Some(cutter.weigh(&Criterion::upload(&self.cx, params, Level::FINEST)?)?),
            false => None,
        };
        let fit = |work: &CutWork| -> Result<f32> {
            let fitted = self.fit_tree(cutter, work, goal.max_triangles)?;
            Ok(goal.tolerance.max(fitted).min(goal.max_tolerance.min(f32::MAX)))
        };
        let mut work = cutter.begin()?;
        cutter.keys(importances.as_ref(), &work)?;
        self.pause(tree_cut::STAGE, cancel)?;
        let mut tolerance = fit(&work)?;
        for _ in 0..MAX_REPAIRS {
            check(cancel)?;
            if !cutter.cut(&mut work, tolerance)? {
                return Ok((work, tolerance));
            }
            cutter.keys(importances.as_ref(), &work)?;
            if self.triangles_at(cutter, &work, tolerance)? > goal.max_triangles {
                tolerance = tolerance.max(fit(&work)?);
            }
        }
        Err(Error::Invalid {
            what: "vertex tree",
            why: format!("{MAX_REPAIRS} cuts changed the topology"),
        })
    }

    /// Triangles of each region, and what is known of a cut before it is meshed.
    fn count_tree_cut(&self, cutter: &Cutter<'_>, work: &CutWork) -> Result<(Vec<RegionMesh>, SurfaceStatistics)> {
        let (sums, meshes) = (cutter.sums(work)?, cutter.meshes(work)?);
        let leaves = sum_levels(sums.iter().map(|region| &region.leaves));
        let removed = cutter.small.as_ref().map(|small| small.removed);
        let statistics = SurfaceStatistics {
            full_triangles: cutter.pyramid.full_triangles - removed.map_or(0, |removed| removed.full_triangles),
            removed,
            active_cells: cutter.pyramid.active_cells,
            leaves,
            triangles: meshes.iter().map(|mesh| triangles(mesh) as u64).sum(),
            vertices: leaves.iter().sum(),
            estimate: estimate(cutter, &sums),
            ..Default::default()
        };
        Ok((meshes, statistics))
    }

    /// The mesh of a cut, with its error where `params` ask for it.
    pub(super) fn mesh_tree_cut(
        &self,
        cutter: &Cutter<'_>,
        params: &CutParams,
        work: CutWork,
        meshes: &mut [RegionMesh],
        cancel: &dyn Cancel,
    ) -> Result<Mesh> {
        let Cutter {
            cx,
            volume,
            pyramid,
            tree,
            ..
        } = *cutter;
        let layout = cut::layout(params, Level::FINEST);
        let (device_meshes, _, made) = self.with_bases(tree_cut::STAGE, meshes)?;
        let mesh = cutter.emit(&work, device_meshes, made)?;
        let (indices, vertex_leaves, mut regions) = cutter.index(&mesh, &table_bases(meshes))?;
        let corner_slots = params
            .state_error
            .then(|| error::tree_corners(cx, volume, pyramid, tree, &mesh.corners))
            .transpose()?;
        drop(mesh);
        check(cancel)?;
        let (device_meshes, vertex_count, _) = self.with_bases(tree_cut::STAGE, &mut regions)?;
        let vertices = cx.buffer(tree_cut::STAGE, vertex_count)?;
        cutter.vertices(&layout, &device_meshes, &vertex_leaves, &vertices)?;
        self.pause(tree_cut::STAGE, cancel)?;
        let errors = match &corner_slots {
            Some(corner_slots) => {
                let full = self.full_cut(volume, pyramid, params)?;
                let input = error::Input {
                    params: &layout,
                    state: &full.state,
                    regions: &regions,
                    meshes: &device_meshes,
                    corner_slots,
                    indices: &indices,
                    vertices: &vertices,
                    tree: Some(error::TreeLeaves {
                        tree,
                        leaves: &work.leaves,
                    }),
                };
                Some(error::run(cx, volume, pyramid, &input, cancel)?)
            }
            None => None,
        };
        Ok(Mesh {
            regions,
            vertices,
            indices,
            errors,
        })
    }

    /// The full surface as a cut of cubes.
    fn full_cut(&self, volume: &Volume, pyramid: &Pyramid, params: &CutParams) -> Result<Cut> {
        let full = CutParams {
            beta: -1.0,
            tolerance: None,
            ..params.clone()
        };
        self.cut(volume, pyramid, &full, Level::FINEST)
    }

    /// Triangles of the cut to a tolerance, before repairs.
    fn triangles_at(&self, cutter: &Cutter<'_>, work: &CutWork, tolerance: f32) -> Result<u64> {
        // All keys up to the tolerance are in the bin before the first.
        let above = Keys {
            first: tolerance.max(0.0).to_bits() + 1,
            shift: ERROR_KEYS.shift,
        };
        let removed = cutter.histogram(work, above)?[0];
        Ok(cutter.full_triangles() - u64::from(removed))
    }

    /// The tolerance for a budget, with triangles to spare for repairs; but where many merges have one tolerance, with none.
    fn fit_tree(&self, cutter: &Cutter<'_>, work: &CutWork, max_triangles: u64) -> Result<f32> {
        if cutter.full_triangles() <= max_triangles {
            return Ok(f32::NEG_INFINITY);
        }
        let spare = max_triangles / REPAIR_SHARE;
        let (tolerance, triangles) = self.tolerance_of(cutter, work, max_triangles - spare)?;
        if triangles + 2 * spare >= max_triangles {
            return Ok(tolerance);
        }
        Ok(self.tolerance_of(cutter, work, max_triangles)?.0)
    }

    /// The minimum tolerance whose cut has at most so many triangles before repairs, and how many; the maximum where none has. Marked nodes
    /// have an infinite key.
    fn tolerance_of(&self, cutter: &Cutter<'_>, work: &CutWork, max_triangles: u64) -> Result<(f32, u64)> {
        let full = cutter.full_triangles();
        let wanted = full.saturating_sub(max_triangles);
        if wanted == 0 {
            return Ok((f32::NEG_INFINITY, full));
        }
        let mut range = ERROR_KEYS;
        loop {
            let removed = cutter.histogram(work, range)?;
            let mut sum = 0u64;
            let bin = removed.iter().position(|&n| {
                sum += u64::from(n);
                sum >= wanted
            });
            let Some(bin) = bin.filter(|&bin| bin <= INNER_BINS) else {
                return Ok((f32::MAX, full - sum));
            };
            if bin == 0 || range.shift == 0 {
                let tolerance = f32::from_bits(range.first + ((bin as u32) << range.shift) - 1);
                return Ok((tolerance, full - sum));
            }
            // Once more inside the bin: what is before it is in the first of the new bins.
            range = Keys {
                first: range.first + ((bin as u32 - 1) << range.shift),
                shift: range.shift.saturating_sub(INNER_BINS.ilog2()),
            };
        }
    }
}

/// Where each region's points on the volume's faces and its nodes are, by how many such points it has.
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
            // One less would do: each merge has one cluster less.
            node_base += region.cell_points() + border_points;
            numbered
        })
        .collect()
}

/// Divides the regions into batches of at most so many triangles, or one region, and gives each its places in the batch's working memory.
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

/// Where the hash table of each region's vertices begins, and the end of the last: at least a third of the entries stay free.
fn table_bases(meshes: &[RegionMesh]) -> Vec<u32> {
    let mut end = 0u32;
    let ends = meshes.iter().map(|mesh| {
        end += (4 * triangles(mesh) as u32).next_power_of_two();
        end
    });
    std::iter::once(0).chain(ends).collect()
}

/// How far a cut's surface may be from the full one, from the quadrics of its leaves.
fn estimate(cutter: &Cutter<'_>, sums: &[TreeCutRegion]) -> ErrorEstimate {
    let spacing = cutter.volume.grid.spacing.into_iter().fold(f32::INFINITY, f32::min);
    let regions = cutter.tree.host_regions.iter();
    let removed = cutter.small.as_ref().map_or(0.0, |small| small.area);
    let area = regions.map(|region| f64::from(region.area)).sum::<f64>() - removed;
    let error2: f64 = sums.iter().map(|region| f64::from(region.error2)).sum();
    let worst_leaf = sums.iter().map(|region| region.worst).fold(0.0, f32::max);
    let rms = if area > 0.0 {
        f64::from(spacing) * (error2 / area).sqrt()
    } else {
        0.0
    };
    ErrorEstimate {
        rms: rms as f32,
        worst_leaf,
    }
}
