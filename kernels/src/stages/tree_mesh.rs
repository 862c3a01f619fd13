//! Meshes of cuts of the vertex tree. The time is billed to the stage `tree_cut`.

use super::args::kernel_args;
use super::tree_cut::{CutWork, Cutter, STAGE};
use crate::Result;
use crate::buffer::Buffer;
use crate::context::Arg;
use crate::layout::{CutParams, Grid, RegionMesh, Vertex};

kernel_args! {
    /// Arguments of `tree_vertices`.
    TreeVerticesArgs {
        /// Extent of the volume.
        grid: Grid,
        /// What vertices depend on: the feature's range.
        params: CutParams,
        /// 1: the volume was padded by one sample on every side.
        cap: u32,
        /// Points of the surface.
        points: u32,
    }
}

/// A cut's triangles.
pub struct CutMesh {
    /// Three leaves a triangle.
    pub corners: Buffer<u32>,
    /// Range of the triangles of each region of the mesh.
    pub meshes: Buffer<RegionMesh>,
    /// Of each region of the mesh the number of its first active region, and of the one at its low corner in the grid.
    pub corner_regions: Buffer<[u32; 2]>,
}

impl Cutter<'_> {
    /// Returns two words for each active region, which are a signature of its mesh among cuts of this tree. `offset_sums`: from
    /// [`Cutter::offsets`].
    pub fn sign(&self, work: &CutWork, offset_sums: &Buffer<u32>) -> Result<Vec<u32>> {
        let signatures: Buffer<u32> = self.cx.buffer(STAGE, 2 * self.regions())?;
        self.launch_wide(
            "tree_sign",
            &[
                &self.tree.point_count(),
                &self.tree.built.regions,
                &self.tree.meshes,
                &self.tree.corners,
                &work.leaves,
                &work.left,
                &work.meshes,
                offset_sums,
                &signatures,
            ],
        )?;
        self.cx.read(STAGE, &signatures, signatures.len())
    }

    /// Makes the triangles of some regions. `level_starts`: of each active region and level, the place of the first triangle, or
    /// [`crate::layout::NONE`] if the region is not made.
    pub fn emit(&self, work: &CutWork, level_starts: &[u32], triangles: usize) -> Result<Buffer<u32>> {
        let corners = self.cx.buffer(STAGE, 3 * triangles)?;
        let level_starts = self.cx.upload(STAGE, level_starts)?;
        self.launch_wide(
            "tree_emit",
            &[
                &self.tree.built.regions,
                &self.tree.meshes,
                &self.tree.corners,
                &work.leaves,
                &work.left,
                &work.meshes,
                &level_starts,
                &corners,
            ],
        )?;
        Ok(corners)
    }

    /// Replaces leaves by indices of vertices in their region's mesh. `table_bases`: the offset of each region's hash table, and the end of
    /// the last. Returns the indices, the leaf of each vertex, and the meshes with their vertices counted.
    pub fn index(&self, mesh: &CutMesh, table_bases: &[u32]) -> Result<(Buffer<u32>, Buffer<u32>, Vec<RegionMesh>)> {
        let entries = table_bases.last().copied().unwrap_or(0) as usize;
        let bases = self.cx.upload(STAGE, table_bases)?;
        let own_numbers: Buffer<u32> = self.cx.buffer(STAGE, self.tree.leaf_count())?;
        let table_leaves: Buffer<u32> = self.cx.buffer(STAGE, entries)?;
        let table_numbers: Buffer<u32> = self.cx.buffer(STAGE, entries)?;
        let indices = self.cx.buffer(STAGE, mesh.corners.len())?;
        let vertex_leaves = self.cx.buffer(STAGE, mesh.corners.len())?;
        self.launch_made(
            "tree_index",
            mesh.corner_regions.len(),
            &[
                &self.tree.point_count(),
                &self.pyramid.regions,
                &self.tree.built.regions,
                &mesh.corner_regions,
                &bases,
                &mesh.corners,
                &own_numbers,
                &table_leaves,
                &table_numbers,
                &indices,
                &vertex_leaves,
                &mesh.meshes,
            ],
        )?;
        let meshes = self.cx.read(STAGE, &mesh.meshes, mesh.meshes.len())?;
        Ok((indices, vertex_leaves, meshes))
    }

    /// Fills `vertices`. `offset_sums`: from [`Cutter::offsets`].
    pub fn vertices(
        &self,
        params: &CutParams,
        offset_sums: &Buffer<u32>,
        corner_regions: &Buffer<[u32; 2]>,
        meshes: &Buffer<RegionMesh>,
        vertex_leaves: &Buffer<u32>,
        vertices: &Buffer<Vertex>,
    ) -> Result<()> {
        let args = TreeVerticesArgs {
            grid: self.volume.layout(),
            params: *params,
            cap: self.tree.cap.into(),
            points: self.tree.point_count(),
        };
        self.launch_made(
            "tree_vertices",
            corner_regions.len(),
            &[
                &args,
                &self.pyramid.region_index,
                &self.pyramid.regions,
                &self.pyramid.bricks,
                &self.pyramid.nodes,
                &self.pyramid.vertex_records,
                &self.tree.built.nodes,
                &self.tree.points,
                offset_sums,
                corner_regions,
                meshes,
                vertex_leaves,
                vertices,
            ],
        )
    }

    /// One wide work-group for each region of a mesh.
    fn launch_made(&self, kernel: &str, regions: usize, args: &[&dyn Arg]) -> Result<()> {
        self.launch_groups(STAGE, kernel, regions, self.cx.tuning.wide_group, args)
    }
}
