//! The connected parts of the full dual mesh, and the removal of some of them.

use super::args::kernel_args;
use super::tree_cut::Cutter;
use crate::buffer::Buffer;
use crate::context::Arg;
use crate::layout::{Grid, TreePartSum};
use crate::stages::BRICK_GROUP;
use crate::tree::TreeParts;
use crate::{Cancel, Result};

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
    /// Arguments of `tree_part_remove`.
    TreePartRemoveArgs {
        /// Points of the surface.
        points: u32,
        /// Parts of a smaller area are removed, world units.
        min_area: f32,
        /// Parts that were chosen.
        chosen: u32,
        /// 1: all but the chosen ones are removed; 0: the chosen ones are.
        keep: u32,
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
        let groups = self.tree.points.len().div_ceil(BRICK_GROUP);
        self.cx.launch(
            STAGE,
            &self.cx.kernel(self.volume.sample_type, kernel)?,
            groups,
            BRICK_GROUP,
            args,
        )
    }

    /// The part of each point, and its area.
    pub fn parts(&self, cancel: &dyn Cancel) -> Result<TreeParts> {
        let tree = self.tree;
        let (points, count) = (tree.points.len(), tree.point_count());
        let labels = self.cx.buffer::<u32>(STAGE, points)?;
        let sums = self.cx.buffer::<[u32; 2]>(STAGE, points)?;
        self.launch_points("tree_part_begin", &[&count, &labels, &sums])?;
        self.launch_part("tree_part_join", &[&tree.meshes, &tree.corners, &labels])?;
        let firsts = self.cx.buffer::<u32>(STAGE, points)?;
        self.launch_points("tree_part_flatten", &[&count, &labels, &firsts])?;
        drop(labels);
        self.cx.pause(STAGE, cancel)?;
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
        Ok(TreeParts { firsts, areas })
    }

    /// Returns for each point whether its part is removed: because the part's area is below the minimum, or because it is among the chosen
    /// parts (with `keep`: not among them). `chosen`: the first points of the chosen parts.
    pub fn removed_points(&self, parts: &TreeParts, min_area: f32, chosen: &[u32], keep: bool) -> Result<Buffer<u8>> {
        let removed = self.cx.buffer(STAGE, self.tree.points.len())?;
        let args = TreePartRemoveArgs {
            points: self.tree.point_count(),
            min_area,
            chosen: chosen.len() as u32,
            keep: keep.into(),
        };
        let chosen = self.cx.upload(STAGE, chosen)?;
        self.launch_points(
            "tree_part_remove",
            &[&args, &chosen, &parts.firsts, &parts.areas, &removed],
        )?;
        Ok(removed)
    }

    /// Sums of the removed parts in each region, and of the remaining ones.
    pub fn sum_removed(&self, parts: &TreeParts, removed: &Buffer<u8>) -> Result<Vec<TreePartSum>> {
        let sums = self.cx.buffer(STAGE, self.regions())?;
        self.launch_part(
            "tree_part_sum",
            &[
                &self.pyramid.regions,
                &self.tree.built.regions,
                &self.tree.meshes,
                &self.tree.corners,
                &self.tree.points,
                &self.pyramid.nodes,
                &parts.areas,
                removed,
                &sums,
            ],
        )?;
        self.cx.read(STAGE, &sums, self.regions())
    }

    /// Marks the nodes of removed parts.
    pub fn mark_removed(&self, removed: &Buffer<u8>, marks: &Buffer<u8>) -> Result<()> {
        self.launch_part(
            "tree_part_mark",
            &[
                &self.pyramid.regions,
                &self.tree.built.regions,
                &self.tree.built.node_parents,
                &self.tree.built.point_parents,
                removed,
                marks,
            ],
        )
    }
}
