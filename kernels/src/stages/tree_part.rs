//! The connected parts of the full dual mesh, and what goes with the small ones.

use super::args::kernel_args;
use super::tree_cut::Cutter;
use crate::buffer::Buffer;
use crate::context::Arg;
use crate::layout::{Grid, TreePartSum};
use crate::stages::BRICK_GROUP;
use crate::{Cancel, Result, cancel};

/// Name of the stage.
pub const STAGE: &str = "tree_part";

kernel_args! {
    /// Arguments of `tree_part_add`.
    TreePartAddArgs {
        /// Extent of the volume.
        grid: Grid,
        /// Unit of areas, world units.
        quantum: f32,
    }
    /// Arguments of `tree_part_sum` and `tree_part_mark`.
    TreePartSumArgs {
        /// Parts of a smaller area are counted or marked.
        min_part: f32,
    }
}

/// Quanta of the largest face of a cell: those of a triangle fit 32 bits, those of all triangles 64.
const QUANTA_A_FACE: f32 = (1u32 << 24) as f32;

impl Cutter<'_> {
    /// One work-group a region.
    fn launch_part(&self, kernel: &str, args: &[&dyn Arg]) -> Result<()> {
        self.launch_regions(STAGE, kernel, args)
    }

    /// One work-item a point.
    fn launch_points(&self, kernel: &str, args: &[&dyn Arg]) -> Result<()> {
        let kernels = self.cx.kernels(self.volume.sample_type)?;
        let groups = self.tree.points.len().div_ceil(BRICK_GROUP);
        self.cx.launch(STAGE, kernels.get(kernel), groups, BRICK_GROUP, args)
    }

    /// The area of each point's part, world units; negative for the first point of a part.
    pub fn part_areas(&self, cancel: &dyn Cancel) -> Result<Buffer<f32>> {
        let tree = self.tree;
        let (points, count) = (tree.points.len(), tree.point_count());
        let labels = self.cx.buffer::<u32>(STAGE, points)?;
        let sums = self.cx.buffer::<[u32; 2]>(STAGE, points)?;
        self.launch_points("tree_part_begin", &[&count, &labels, &sums])?;
        self.launch_part("tree_part_join", &[&tree.meshes, &tree.corners, &labels])?;
        let firsts = self.cx.buffer::<u32>(STAGE, points)?;
        self.launch_points("tree_part_flatten", &[&count, &labels, &firsts])?;
        drop(labels);
        self.cx.finish(STAGE)?;
        cancel::check(cancel)?;
        let [x, y, z] = self.volume.grid.spacing;
        let args = TreePartAddArgs {
            grid: self.volume.layout(),
            quantum: (x * y).max(y * z).max(z * x) / QUANTA_A_FACE,
        };
        self.launch_part(
            "tree_part_add",
            &[&args, &tree.meshes, &tree.corners, &tree.points, &firsts, &sums],
        )?;
        let areas = self.cx.buffer(STAGE, points)?;
        self.launch_points("tree_part_spread", &[&count, &args.quantum, &firsts, &sums, &areas])?;
        Ok(areas)
    }

    /// What the parts below an area add up to in each region.
    pub fn small_parts(&self, areas: &Buffer<f32>, min_part: f32) -> Result<Vec<TreePartSum>> {
        let sums = self.cx.buffer(STAGE, self.regions())?;
        self.launch_part(
            "tree_part_sum",
            &[
                &TreePartSumArgs { min_part },
                &self.pyramid.regions,
                &self.tree.built.regions,
                &self.tree.meshes,
                &self.tree.corners,
                &self.tree.points,
                &self.pyramid.nodes,
                areas,
                &sums,
            ],
        )?;
        self.cx.read(STAGE, &sums, self.regions())
    }

    /// Marks the nodes of the parts below an area.
    pub fn mark_small_parts(&self, areas: &Buffer<f32>, min_part: f32, marks: &Buffer<u8>) -> Result<()> {
        self.launch_part(
            "tree_part_mark",
            &[
                &TreePartSumArgs { min_part },
                &self.pyramid.regions,
                &self.tree.built.regions,
                &self.tree.built.node_parents,
                &self.tree.built.point_parents,
                areas,
                marks,
            ],
        )
    }
}
