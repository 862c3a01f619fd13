//! Distance of a dual mesh from the surface that it represents.

mod sums;

use self::sums::{Sums, both};
use super::args::kernel_args;
use super::{BRICK_GROUP, SlabWork, slab_work};
use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::{CutParams, ErrorSum, ErrorTask, Grid, NONE, RegionMesh, Vertex};
use crate::surface::SurfaceError;
use crate::{Cancel, Pyramid, Result, VertexTree, Volume};
use std::ops::Range;

/// Name of the stage.
pub const STAGE: &str = "error";

kernel_args! {
    /// Arguments of `error_positions`.
    ErrorPositionsArgs {
        /// Extent of the volume.
        grid: Grid,
        /// What the cut depends on.
        params: CutParams,
        /// Compact index of the first region of this launch.
        first_region: u32,
    }
    /// Arguments of `error_leaves` and `error_corners`.
    ErrorLeavesArgs {
        /// Extent of the volume.
        grid: Grid,
        /// Slots of the pyramid.
        slots: u32,
        /// Points of cells and sheets.
        cell_points: u32,
        /// Points of the surface.
        points: u32,
        /// 1: the volume was padded by one sample on every side.
        cap: u32,
        /// Number of regions, which are the first blocks of the tree.
        regions: u32,
    }
    /// Arguments of `error_seeds`, `error_regions` and `error_far`.
    ErrorSeedsArgs {
        /// Extent of the volume.
        grid: Grid,
        /// Active regions.
        region_count: u32,
        /// Active bricks.
        brick_count: u32,
        /// 1: other vertices stand for those of slots.
        has_stand_ins: u32,
    }
    /// Arguments of `error_spread`.
    ErrorSpreadArgs {
        /// Extent of the volume.
        grid: Grid,
        /// Distance of the regions that are looked at, in regions.
        step: u32,
    }
    /// Arguments of `error_crossings`.
    ErrorCrossingsArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// Isovalue in the field's units.
        iso: f32,
        /// 1: the volume was padded by one sample on every side.
        cap: u32,
        /// 1: samples are missing somewhere.
        has_missing: u32,
        /// The first task of this launch.
        first_task: u32,
        /// Active regions.
        region_count: u32,
        /// 1: other vertices stand for those of slots.
        has_stand_ins: u32,
    }
    /// Arguments of `error_samples`.
    ErrorSamplesArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// Isovalue in the field's units.
        iso: f32,
        /// 1: the volume was padded by one sample on every side.
        cap: u32,
        /// The first task of this launch.
        first_task: u32,
        /// First layer of regions of the slab, counted in regions along z.
        first_layer: u32,
        /// Layer of regions after the last.
        end_layer: u32,
        /// Active regions.
        region_count: u32,
    }
}

/// What the stage reads.
pub struct Input<'a> {
    pub params: &'a CutParams,
    pub state: &'a Buffer<u8>,
    /// Parts of the mesh, one an active region.
    pub regions: &'a [RegionMesh],
    /// The same on the device.
    pub meshes: &'a Buffer<RegionMesh>,
    /// Slot behind every index of the mesh.
    pub corner_slots: &'a Buffer<u32>,
    pub indices: &'a Buffer<u32>,
    pub vertices: &'a Buffer<Vertex>,
    /// Set for a cut of the vertex tree, in which all cells are leaves of the octree.
    pub tree: Option<TreeLeaves<'a>>,
}

/// Leaves of a cut of the vertex tree.
#[derive(Clone, Copy)]
pub struct TreeLeaves<'a> {
    pub tree: &'a VertexTree,
    /// Of each point.
    pub leaves: &'a Buffer<u32>,
    /// The two sums of offsets of each node, from [`Cutter::offsets`](super::tree_cut::Cutter::offsets): they give how far it moves.
    pub offset_sums: &'a Buffer<u32>,
}

/// The vertex of each corner as this stage numbers them. `corner_leaves`: the leaf of each.
pub fn tree_corners(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    tree: &VertexTree,
    corner_leaves: &Buffer<u32>,
) -> Result<Buffer<u32>> {
    let corners = corner_leaves.len();
    let corner_slots = cx.buffer(STAGE, corners)?;
    let args = leaves_args(volume, pyramid, tree);
    cx.launch(
        STAGE,
        &cx.kernel(volume.sample_type, "error_corners")?,
        corners.div_ceil(BRICK_GROUP),
        BRICK_GROUP,
        &[&args, &(corners as u32), &tree.points, corner_leaves, &corner_slots],
    )?;
    Ok(corner_slots)
}

fn leaves_args(volume: &Volume, pyramid: &Pyramid, tree: &VertexTree) -> ErrorLeavesArgs {
    ErrorLeavesArgs {
        grid: volume.layout(),
        slots: pyramid.nodes.len() as u32,
        cell_points: tree.cell_points,
        points: tree.point_count(),
        cap: tree.cap.into(),
        regions: pyramid.host_regions.len() as u32,
    }
}

/// Cells or triangles of a task.
const TASK_ITEMS: u32 = 256;

/// Tasks that one launch measures: few enough that a cancellation is seen within 50 ms on a CPU of two cores, and enough to fill
/// a GPU.
const fn tasks_per_launch(region_group: usize) -> usize {
    if region_group == 1 { 256 } else { 4096 }
}

/// Corners that one launch links, for the same reason.
const LINKED_CORNERS: usize = 1 << 23;

/// The work of these regions in tasks; `items`: of each region.
fn tasks(regions: Range<usize>, items: impl Fn(usize) -> u32) -> Vec<ErrorTask> {
    let of_region = |region: usize| {
        let items = items(region);
        (0..items).step_by(TASK_ITEMS as usize).map(move |first| ErrorTask {
            region: region as u32,
            first,
            count: TASK_ITEMS.min(items - first),
        })
    };
    regions.flat_map(of_region).collect()
}

/// The vertex positions of all slots, and their fans of triangles.
struct Fans {
    positions: Buffer<[f32; 4]>,
    /// The vertices that replace those of slots, if any do.
    stand_ins: Option<Buffer<u32>>,
    heads: Buffer<u32>,
    next: Buffer<u32>,
}

impl Fans {
    /// Returns `stand_ins` as a kernel argument; any other buffer if there are none.
    fn stand_ins(&self) -> &Buffer<u32> {
        self.stand_ins.as_ref().unwrap_or(&self.heads)
    }
}

/// Start points of searches for the nearest triangle.
struct Seeds {
    seeds: Buffer<u32>,
    far: Buffer<u32>,
}

/// A volume, its pyramid and a mesh that is measured.
struct Measurement<'a> {
    cx: &'a Context,
    volume: &'a Volume,
    pyramid: &'a Pyramid,
    input: &'a Input<'a>,
    cancel: &'a dyn Cancel,
}

impl Measurement<'_> {
    /// Waits for the launches so far, so that a cancellation is seen before the next launch.
    fn pause(&self) -> Result<()> {
        self.cx.pause(STAGE, self.cancel)
    }

    fn find_fans(&self) -> Result<Fans> {
        let Self { cx, pyramid, input, .. } = *self;
        let kernel = |name| cx.kernel(self.volume.sample_type, name);
        let (slots, corners) = (pyramid.nodes.len(), input.corner_slots.len());
        let vertices = slots + input.tree.map_or(0, |cut| cut.tree.built.nodes.len());
        let fans = Fans {
            positions: cx.buffer(STAGE, vertices)?,
            stand_ins: input.tree.map(|_| cx.buffer(STAGE, slots)).transpose()?,
            heads: cx.filled(STAGE, vertices, NONE)?,
            next: cx.buffer(STAGE, corners)?,
        };
        let args = ErrorPositionsArgs {
            grid: self.volume.layout(),
            params: *input.params,
            first_region: 0,
        };
        cx.launch(
            STAGE,
            &kernel("error_positions")?,
            pyramid.host_regions.len(),
            cx.tuning.region_group,
            &[&args, &pyramid.regions, &pyramid.vertex_records, &fans.positions],
        )?;
        if let (Some(cut), Some(stand_ins)) = (input.tree, &fans.stand_ins) {
            cx.launch(
                STAGE,
                &kernel("error_leaves")?,
                cut.tree.blocks.len(),
                cx.tuning.region_group,
                &[
                    &leaves_args(self.volume, pyramid, cut.tree),
                    &pyramid.regions,
                    &cut.tree.built.regions,
                    &cut.tree.built.nodes,
                    cut.offset_sums,
                    &cut.tree.points,
                    cut.leaves,
                    stand_ins,
                    &fans.positions,
                ],
            )?;
        }
        for first in (0..corners).step_by(LINKED_CORNERS) {
            let count = LINKED_CORNERS.min(corners - first);
            cx.launch(
                STAGE,
                &kernel("error_link")?,
                count.div_ceil(BRICK_GROUP),
                BRICK_GROUP,
                &[
                    &(first as u32),
                    &(count as u32),
                    input.corner_slots,
                    &fans.heads,
                    &fans.next,
                ],
            )?;
            self.pause()?;
        }
        Ok(fans)
    }

    fn find_seeds(&self, fans: &Fans) -> Result<Seeds> {
        let Self {
            cx,
            volume,
            pyramid,
            input,
            ..
        } = *self;
        let (bricks, regions) = (pyramid.bricks.len(), pyramid.host_regions.len());
        let grid_regions = pyramid.region_index.len();
        let args = ErrorSeedsArgs {
            grid: volume.layout(),
            region_count: regions as u32,
            brick_count: bricks as u32,
            has_stand_ins: fans.stand_ins.is_some().into(),
        };
        let launch = |kernel: &str, items: usize, args: &[&dyn crate::context::Arg]| {
            cx.launch(
                STAGE,
                &cx.kernel(volume.sample_type, kernel)?,
                items.div_ceil(BRICK_GROUP),
                BRICK_GROUP,
                args,
            )
        };
        let found = Seeds {
            seeds: cx.buffer(STAGE, 8 * bricks)?,
            far: cx.buffer(STAGE, bricks)?,
        };
        launch(
            "error_seeds",
            8 * bricks,
            &[
                &args,
                &pyramid.regions,
                &pyramid.bricks,
                input.state,
                fans.stand_ins(),
                &fans.heads,
                &fans.positions,
                &found.seeds,
            ],
        )?;
        let mut of_regions = cx.filled(STAGE, grid_regions, NONE)?;
        launch(
            "error_regions",
            regions,
            &[&args, &pyramid.regions, &found.seeds, &fans.positions, &of_regions],
        )?;
        // Jump flooding: a seed reaches every region by steps of half the grid, a quarter and so on.
        let widest = volume.grid.regions().into_iter().max().unwrap_or(1);
        let mut step = widest.next_power_of_two() / 2;
        while step > 0 {
            let to = cx.buffer(STAGE, grid_regions)?;
            let args = ErrorSpreadArgs {
                grid: volume.layout(),
                step,
            };
            launch(
                "error_spread",
                grid_regions,
                &[&args, &fans.positions, &of_regions, &to],
            )?;
            of_regions = to;
            step /= 2;
        }
        launch(
            "error_far",
            bricks,
            &[
                &args,
                &pyramid.region_index,
                &pyramid.regions,
                &pyramid.bricks,
                &pyramid.near,
                &fans.positions,
                &found.seeds,
                &of_regions,
                &found.far,
            ],
        )?;
        self.pause()?;
        Ok(found)
    }

    /// Launches the tasks in parts and adds their results to `sums`. `launch` takes the index of the first task and the number of tasks.
    fn measure(
        &self,
        sums: &mut Sums,
        tasks: &[ErrorTask],
        launch: impl Fn(u32, usize, &Buffer<ErrorTask>, &Buffer<ErrorSum>) -> Result<()>,
    ) -> Result<()> {
        let list = self.cx.upload(STAGE, tasks)?;
        let out = self.cx.buffer(STAGE, tasks.len())?;
        let limit = tasks_per_launch(self.cx.tuning.region_group);
        for first in (0..tasks.len()).step_by(limit) {
            launch(first as u32, limit.min(tasks.len() - first), &list, &out)?;
            self.pause()?;
        }
        sums.add(tasks, &self.cx.read(STAGE, &out, tasks.len())?);
        Ok(())
    }

    fn measure_crossings(&self, slabs: &[SlabWork<'_>], fans: &Fans, seeds: &Seeds) -> Result<Sums> {
        let Self {
            cx,
            volume,
            pyramid,
            input,
            ..
        } = *self;
        let kernel = |name| cx.kernel(volume.sample_type, name);
        let mut sums = Sums::new(pyramid.host_regions.len());
        for slab in slabs {
            let tasks = tasks(slab.regions.clone(), |region| {
                pyramid.host_regions[region].level_base[1]
            });
            self.measure(&mut sums, &tasks, |first_task, count, list, out| {
                let args = ErrorCrossingsArgs {
                    grid: volume.layout(),
                    z0: slab.z0,
                    iso: pyramid.iso,
                    cap: input.params.cap,
                    has_missing: volume.has_missing().into(),
                    first_task,
                    region_count: pyramid.host_regions.len() as u32,
                    has_stand_ins: fans.stand_ins.is_some().into(),
                };
                cx.launch(
                    STAGE,
                    &kernel("error_crossings")?,
                    count,
                    cx.tuning.region_group,
                    &[
                        &args,
                        slab.samples,
                        list,
                        &pyramid.regions,
                        &pyramid.bricks,
                        &pyramid.nodes,
                        input.state,
                        fans.stand_ins(),
                        &pyramid.near,
                        &seeds.seeds,
                        &seeds.far,
                        input.corner_slots,
                        &fans.positions,
                        input.meshes,
                        input.indices,
                        input.vertices,
                        &fans.heads,
                        &fans.next,
                        out,
                    ],
                )
            })?;
        }
        Ok(sums)
    }

    /// Measures the distances at the samples, slab by slab. A triangle reaches at most one region beyond its own, so each slab also
    /// launches the regions next to it; it measures only the samples that it holds.
    fn measure_samples(&self, fans: &Fans) -> Result<Sums> {
        let Self {
            cx,
            volume,
            pyramid,
            input,
            ..
        } = *self;
        let kernel = |name| cx.kernel(volume.sample_type, name);
        let [rx, ry, _] = volume.grid.regions();
        let layer = |region: &crate::layout::Region| region.region / (rx * ry);
        let regions = &pyramid.host_regions;
        let mut sums = Sums::new(regions.len());
        for slab in &volume.slabs {
            let begin = regions.partition_point(|r| layer(r) + 1 < slab.layers.start);
            let end = regions.partition_point(|r| layer(r) <= slab.layers.end);
            let tasks = tasks(begin..end, |region| input.regions[region].triangles.iter().sum());
            self.measure(&mut sums, &tasks, |first_task, count, list, out| {
                let args = ErrorSamplesArgs {
                    grid: volume.layout(),
                    z0: slab.z0,
                    iso: pyramid.iso,
                    cap: input.params.cap,
                    first_task,
                    first_layer: slab.layers.start,
                    end_layer: slab.layers.end,
                    region_count: regions.len() as u32,
                };
                cx.launch(
                    STAGE,
                    &kernel("error_samples")?,
                    count,
                    cx.tuning.region_group,
                    &[
                        &args,
                        &slab.samples,
                        list,
                        &pyramid.region_index,
                        &pyramid.regions,
                        &pyramid.bricks,
                        input.corner_slots,
                        &fans.positions,
                        input.meshes,
                        input.indices,
                        input.vertices,
                        out,
                    ],
                )
            })?;
        }
        Ok(sums)
    }
}

/// Error of each active region, and of the whole surface.
///
/// # Errors
/// [`crate::Error::Cancelled`], or an error of the device.
pub fn run(
    cx: &Context,
    volume: &Volume,
    pyramid: &Pyramid,
    input: &Input<'_>,
    cancel: &dyn Cancel,
) -> Result<(Vec<SurfaceError>, SurfaceError)> {
    let measurement = Measurement {
        cx,
        volume,
        pyramid,
        input,
        cancel,
    };
    let fans = measurement.find_fans()?;
    let seeds = measurement.find_seeds(&fans)?;
    let slabs = slab_work(volume, &pyramid.host_regions, pyramid.bricks.len());
    let crossings = measurement.measure_crossings(&slabs, &fans, &seeds)?;
    let samples = measurement.measure_samples(&fans)?;
    let regions = crossings.regions.iter().zip(&samples.regions);
    Ok((
        regions.map(|(a, b)| both(a, b)).collect(),
        both(&crossings.whole, &samples.whole),
    ))
}
