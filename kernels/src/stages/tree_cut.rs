//! Cuts of the vertex tree, and their meshes.

use super::args::kernel_args;
use crate::buffer::Buffer;
use crate::context::{Arg, Context};
use crate::layout::{CutParams, Grid, RegionMesh, TreeCutRegion, Vertex};
use crate::stages::cut::Criterion;
use crate::stages::fit::Keys;
use crate::tree::{SmallParts, VertexTree};
use crate::{Pyramid, Result, Volume, constants};

/// Name of the stage.
pub const STAGE: &str = "tree_cut";

kernel_args! {
    /// Arguments of `tree_weigh`.
    TreeWeighArgs {
        /// What the importance depends on.
        params: CutParams,
    }
    /// Arguments of `tree_histogram`.
    TreeHistogramArgs {
        /// First key of bin 1.
        first_key: u32,
        /// A bin holds 2^shift keys.
        shift: u32,
        /// Keys, also where there is no node.
        nodes: u32,
    }
    /// Arguments of `tree_leaves` and `tree_sum`.
    TreeLeavesArgs {
        /// Nodes with keys up to this one are merged.
        tolerance: f32,
        /// Points of the surface.
        points: u32,
        /// 1: there was no cut before this one.
        first: u32,
        /// 1: there was none of the same tolerance.
        whole: u32,
        /// Parts of a smaller area are left out; 0: none are.
        min_part: f32,
    }
    /// Arguments of `tree_count`.
    TreeCountArgs {
        /// Extent of the volume.
        grid: Grid,
        /// Points of cells and sheets.
        cell_points: u32,
        /// Points of the surface.
        points: u32,
        /// 1: there was no cut before this one.
        first: u32,
        /// 1: there was none of the same tolerance.
        whole: u32,
    }
    /// Arguments of `tree_link` and `tree_check`.
    TreeLinkArgs {
        /// Extent of the volume.
        grid: Grid,
        /// Nodes with keys up to this one are merged.
        tolerance: f32,
        /// Points of cells and sheets.
        cell_points: u32,
        /// Points of the surface.
        points: u32,
        /// Entries of the table of edges.
        capacity: u32,
    }
    /// Arguments of `tree_vertices`.
    TreeVerticesArgs {
        /// Extent of the volume.
        grid: Grid,
        /// What vertices depend on: the feature's range.
        params: CutParams,
        /// Points of the surface.
        points: u32,
    }
}

/// Keys that one work-group of `tree_histogram` counts.
const HISTOGRAM_KEYS: usize = 8192;

/// A stage at work on a tree: what all its launches have in common.
pub struct Cutter<'a> {
    pub cx: &'a Context,
    pub volume: &'a Volume,
    pub pyramid: &'a Pyramid,
    pub tree: &'a VertexTree,
    /// Parts that cuts leave out.
    pub small: Option<SmallParts>,
}

/// A cut while it is made again and again, until its topology is that of the full mesh.
pub struct CutWork {
    /// 1: the node is never merged.
    marks: Buffer<u8>,
    /// Of each region, whether there are new marks.
    marked: Buffer<u32>,
    /// Of each region, whether its keys are not those of the cut before.
    renewed: Buffer<u32>,
    keys: Buffer<u32>,
    /// The leaf of each point, and that of the cut before.
    pub leaves: Buffer<u32>,
    previous: Buffer<u32>,
    /// Triangles by region and level.
    meshes: Buffer<RegionMesh>,
    /// Triangles around each leaf, those of its region and all others.
    around: Buffer<u32>,
    /// Triangles whose leaves are not those of the cut before, and how many each region has.
    changed: Buffer<u32>,
    changed_counts: Buffer<u32>,
    is_first: bool,
    tolerance: f32,
}

/// A cut's triangles.
pub struct CutMesh {
    /// Three leaves a triangle.
    pub corners: Buffer<u32>,
    /// Where each region's triangles are.
    pub meshes: Buffer<RegionMesh>,
}

impl Cutter<'_> {
    /// One work-group a region.
    fn launch(&self, kernel: &str, args: &[&dyn Arg]) -> Result<()> {
        self.launch_groups(kernel, self.regions(), args)
    }

    fn launch_groups(&self, kernel: &str, groups: usize, args: &[&dyn Arg]) -> Result<()> {
        let kernels = self.cx.kernels(self.volume.sample_type)?;
        self.cx
            .launch(STAGE, kernels.get(kernel), groups, self.cx.tuning.region_group, args)
    }

    fn regions(&self) -> usize {
        self.pyramid.host_regions.len()
    }

    /// The maximum importance of the points below each node.
    pub fn weigh(&self, criterion: &Criterion) -> Result<Buffer<u32>> {
        let importances = self.cx.buffer(STAGE, self.tree.built.nodes.len())?;
        let args = TreeWeighArgs {
            params: criterion.params,
        };
        self.launch(
            "tree_weigh",
            &[
                &args,
                &criterion.points,
                &criterion.interests,
                &self.pyramid.regions,
                &self.tree.built.regions,
                &self.tree.built.nodes,
                &self.tree.built.round_ends,
                &self.tree.built.point_parents,
                &self.tree.points,
                &self.pyramid.nodes,
                &importances,
            ],
        )?;
        Ok(importances)
    }

    /// Triangles of the full dual mesh that cuts do not leave out.
    pub fn full_triangles(&self) -> u64 {
        self.tree.full_triangles - self.small.as_ref().map_or(0, |small| small.triangles)
    }

    /// A cut that is not made yet.
    pub fn begin(&self) -> Result<CutWork> {
        let (nodes, points) = (self.tree.built.nodes.len(), self.tree.points.len());
        let marks = self.cx.zeroed(STAGE, nodes)?;
        if let Some(small) = &self.small {
            self.mark_small_parts(&small.areas, small.min_part, &marks)?;
        }
        Ok(CutWork {
            marks,
            marked: self.cx.filled(STAGE, self.regions(), 1)?,
            renewed: self.cx.buffer(STAGE, self.regions())?,
            // Above infinity where there is no node.
            keys: self.cx.filled(STAGE, nodes, u32::MAX)?,
            leaves: self.cx.buffer(STAGE, points)?,
            previous: self.cx.buffer(STAGE, points)?,
            meshes: self.cx.upload(STAGE, &vec![RegionMesh::default(); self.regions()])?,
            around: self.cx.zeroed(STAGE, 2 * self.tree.leaf_count())?,
            changed: self.cx.buffer(STAGE, self.tree.full_triangles as usize)?,
            changed_counts: self.cx.buffer(STAGE, self.regions())?,
            is_first: true,
            tolerance: 0.0,
        })
    }

    /// Fills in each node's key.
    pub fn keys(&self, importances: Option<&Buffer<u32>>, work: &CutWork) -> Result<()> {
        let weighted = u32::from(importances.is_some());
        let importances = importances.unwrap_or(&self.tree.built.point_parents);
        self.launch(
            "tree_keys",
            &[
                &weighted,
                &self.tree.built.regions,
                &self.tree.built.nodes,
                &self.tree.built.round_ends,
                importances,
                &work.marks,
                &work.marked,
                &work.renewed,
                &work.keys,
            ],
        )
    }

    /// Triangles that go where the tolerance passes each bin; the first bin is for keys before all others.
    pub fn histogram(&self, work: &CutWork, range: Keys) -> Result<Vec<u32>> {
        let removed = self.cx.filled(STAGE, constants::FIT_BINS as usize, 0)?;
        let args = TreeHistogramArgs {
            first_key: range.first,
            shift: range.shift,
            nodes: work.keys.len() as u32,
        };
        let groups = work.keys.len().div_ceil(HISTOGRAM_KEYS);
        self.launch_groups("tree_histogram", groups, &[&args, &work.keys, &removed])?;
        self.cx.read(STAGE, &removed, removed.len())
    }

    /// Cuts the tree: the leaf of each point, and the triangles that are left. Marks nodes whose merging changes the
    /// topology. Whether there are any; then the keys are to be made again.
    pub fn cut(&self, work: &mut CutWork, tolerance: f32) -> Result<bool> {
        std::mem::swap(&mut work.leaves, &mut work.previous);
        let (points, first) = (self.tree.point_count(), work.is_first.into());
        let whole = (work.is_first || tolerance != work.tolerance).into();
        work.is_first = false;
        work.tolerance = tolerance;
        // Any buffer where nothing is left out.
        let (min_part, areas): (f32, &dyn Arg) = match &self.small {
            Some(small) => (small.min_part, &*small.areas),
            None => (0.0, &self.tree.points),
        };
        let args = TreeLeavesArgs {
            tolerance,
            points,
            first,
            whole,
            min_part,
        };
        self.launch(
            "tree_leaves",
            &[
                &args,
                &self.pyramid.regions,
                &self.tree.built.regions,
                &self.tree.built.nodes,
                &self.tree.built.point_parents,
                areas,
                &work.keys,
                &work.renewed,
                &work.previous,
                &work.leaves,
            ],
        )?;
        self.launch(
            "tree_count",
            &[
                &TreeCountArgs {
                    grid: self.volume.layout(),
                    cell_points: self.tree.cell_points,
                    points,
                    first,
                    whole,
                },
                &self.pyramid.region_index,
                &work.renewed,
                &self.pyramid.regions,
                &self.tree.built.regions,
                &self.tree.built.nodes,
                &self.tree.meshes,
                &self.tree.corners,
                &work.leaves,
                &work.previous,
                &work.meshes,
                &work.around,
                &work.changed,
                &work.changed_counts,
            ],
        )?;
        let changed = self.cx.read(STAGE, &work.changed_counts, self.regions())?;
        self.check(work, &changed)
    }

    /// Whether merges change the topology. `changed`: how many triangles changed in each region.
    fn check(&self, work: &CutWork, changed: &[u32]) -> Result<bool> {
        // At least half the entries stay free, and there is one.
        let mut capacity = 0;
        let ends = changed.iter().map(|triangles| {
            capacity += 6 * triangles + 16;
            capacity
        });
        let table_bases: Vec<u32> = std::iter::once(0).chain(ends).collect();
        let table_bases = self.cx.upload(STAGE, &table_bases)?;
        let edges = self.cx.filled(STAGE, capacity as usize, constants::NONE)?;
        let failed = self.cx.filled(STAGE, 1, 0)?;
        let args = TreeLinkArgs {
            grid: self.volume.layout(),
            tolerance: work.tolerance,
            cell_points: self.tree.cell_points,
            points: self.tree.point_count(),
            capacity,
        };
        self.launch(
            "tree_link",
            &[
                &args,
                &self.pyramid.regions,
                &self.tree.built.regions,
                &self.tree.meshes,
                &self.tree.corners,
                &work.leaves,
                &work.changed,
                &work.changed_counts,
                &self.tree.built.nodes,
                &work.around,
                &table_bases,
                &edges,
                &work.marks,
                &work.marked,
                &failed,
            ],
        )?;
        self.launch(
            "tree_check",
            &[
                &args,
                &self.pyramid.region_index,
                &work.changed_counts,
                &self.pyramid.regions,
                &self.tree.built.regions,
                &self.tree.built.nodes,
                &work.keys,
                &work.around,
                &work.marks,
                &work.marked,
                &failed,
            ],
        )?;
        Ok(self.cx.read(STAGE, &failed, 1)?[0] != 0)
    }

    /// What each region's leaves add up to.
    pub fn sums(&self, work: &CutWork) -> Result<Vec<TreeCutRegion>> {
        let sums = self.cx.buffer(STAGE, self.regions())?;
        let args = TreeLeavesArgs {
            tolerance: work.tolerance,
            points: self.tree.point_count(),
            first: 0,
            whole: 0,
            min_part: 0.0,
        };
        self.launch(
            "tree_sum",
            &[
                &args,
                &self.pyramid.regions,
                &self.tree.built.regions,
                &self.tree.built.nodes,
                &work.keys,
                &work.leaves,
                &sums,
            ],
        )?;
        self.cx.read(STAGE, &sums, self.regions())
    }

    /// Each region's triangles, by level.
    pub fn meshes(&self, work: &CutWork) -> Result<Vec<RegionMesh>> {
        self.cx.read(STAGE, &work.meshes, self.regions())
    }

    /// Makes the triangles. `meshes`: where each region's go.
    pub fn emit(&self, work: &CutWork, meshes: Buffer<RegionMesh>, triangles: usize) -> Result<CutMesh> {
        let made = CutMesh {
            corners: self.cx.buffer(STAGE, 3 * triangles)?,
            meshes,
        };
        self.launch(
            "tree_emit",
            &[
                &self.tree.meshes,
                &self.tree.corners,
                &work.leaves,
                &made.meshes,
                &made.corners,
            ],
        )?;
        Ok(made)
    }

    /// Replaces leaves by indices of vertices in their region's mesh. `table_bases`: where each region's hash table begins, and the end of
    /// the last. Returns the indices, the leaf of each vertex, and the meshes with their vertices counted.
    pub fn index(&self, mesh: &CutMesh, table_bases: &[u32]) -> Result<(Buffer<u32>, Buffer<u32>, Vec<RegionMesh>)> {
        let entries = table_bases.last().copied().unwrap_or(0) as usize;
        let bases = self.cx.upload(STAGE, table_bases)?;
        let table_leaves = self.cx.filled(STAGE, entries, constants::NONE)?;
        let table_firsts = self.cx.filled(STAGE, entries, constants::NONE)?;
        let indices = self.cx.buffer(STAGE, mesh.corners.len())?;
        let vertex_leaves = self.cx.buffer(STAGE, mesh.corners.len())?;
        self.launch(
            "tree_index",
            &[
                &bases,
                &mesh.corners,
                &table_leaves,
                &table_firsts,
                &indices,
                &vertex_leaves,
                &mesh.meshes,
            ],
        )?;
        let meshes = self.cx.read(STAGE, &mesh.meshes, self.regions())?;
        Ok((indices, vertex_leaves, meshes))
    }

    /// Fills `vertices`.
    pub fn vertices(
        &self,
        params: &CutParams,
        meshes: &Buffer<RegionMesh>,
        vertex_leaves: &Buffer<u32>,
        vertices: &Buffer<Vertex>,
    ) -> Result<()> {
        let args = TreeVerticesArgs {
            grid: self.volume.layout(),
            params: *params,
            points: self.tree.point_count(),
        };
        self.launch(
            "tree_vertices",
            &[
                &args,
                &self.pyramid.regions,
                &self.pyramid.nodes,
                &self.pyramid.vertex_records,
                &self.tree.built.nodes,
                &self.tree.points,
                meshes,
                vertex_leaves,
                vertices,
            ],
        )
    }
}
