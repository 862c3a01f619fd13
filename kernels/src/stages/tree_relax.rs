//! Nodes of a cut of the vertex tree move. Their time counts as that of the cuts.

use super::args::kernel_args;
use super::tree_cut::{Cutter, STAGE};
use crate::Result;
use crate::buffer::Buffer;
use crate::layout::{Grid, RegionMesh, Vertex};

kernel_args! {
    /// Arguments of `tree_offsets`.
    TreeOffsetsArgs {
        /// Extent of the volume.
        grid: Grid,
        /// First plane of the slab.
        z0: u32,
        /// Isovalue in the field's units.
        iso: f32,
        /// 1: the volume was padded by one sample on every side.
        cap: u32,
        /// First layer of regions of the slab, counted in regions along z.
        first_layer: u32,
        /// Layer of regions after the last.
        end_layer: u32,
        /// Points of the surface.
        points: u32,
    }
    /// Arguments of `tree_move`.
    TreeMoveArgs {
        /// Extent of the volume.
        grid: Grid,
        /// 1: the volume was padded by one sample on every side.
        cap: u32,
        /// Points of the surface.
        points: u32,
    }
}

/// The mesh of a cut as it is before its nodes move.
pub struct UnmovedMesh<'a> {
    /// Where each region's mesh is.
    pub meshes: &'a Buffer<RegionMesh>,
    /// Leaf of each vertex, from its region's first corner on.
    pub vertex_leaves: &'a Buffer<u32>,
    /// Three vertices of the region's mesh a triangle.
    pub indices: &'a Buffer<u32>,
    /// Vertices, whose positions change.
    pub vertices: &'a Buffer<Vertex>,
}

impl Cutter<'_> {
    /// Moves the nodes of a cut. Returns of each node the sum of the offsets around it (`cl/lib/tree_offset.h`).
    pub fn relax(&self, mesh: &UnmovedMesh<'_>) -> Result<Buffer<u32>> {
        let Self { cx, volume, pyramid, tree, .. } = *self;
        let vertex_sums: Buffer<u32> = cx.buffer(STAGE, mesh.vertices.len())?;
        let sums = cx.zeroed(STAGE, tree.built.nodes.len())?;
        for slab in &volume.slabs {
            let args = TreeOffsetsArgs {
                grid: volume.layout(),
                z0: slab.z0,
                iso: pyramid.iso,
                cap: tree.cap.into(),
                first_layer: slab.layers.start,
                end_layer: slab.layers.end,
                points: tree.point_count(),
            };
            self.launch_wide(
                "tree_offsets",
                &[
                    &args,
                    &slab.samples,
                    &pyramid.regions,
                    mesh.meshes,
                    mesh.vertex_leaves,
                    mesh.indices,
                    mesh.vertices,
                    &vertex_sums,
                    &sums,
                ],
            )?;
        }
        let args = TreeMoveArgs { grid: volume.layout(), cap: tree.cap.into(), points: tree.point_count() };
        self.launch_wide(
            "tree_move",
            &[
                &args,
                &pyramid.regions,
                &tree.built.nodes,
                &sums,
                mesh.meshes,
                mesh.vertex_leaves,
                mesh.vertices,
            ],
        )?;
        Ok(sums)
    }
}
