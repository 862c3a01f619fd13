//! Builds the levels of the vertex tree, one after another: regions, then blocks of twice the size, up to one block that is the volume, or
//! to `LAST_LEVEL` (docs/algorithm.md#7-vertex-tree).

use super::tree_vanish::{Remains, Vanishing};
use crate::buffer::Buffer;
use crate::cancel::check_cancelled;
use crate::layout::{Grid, NONE, Region, RegionMesh, TreeRegion};
use crate::stages::tree::{self, Gathered, Level, Risen};
use crate::stages::tree_begin;
use crate::stages::tree_build::{self, Queue, Work};
use crate::stages::tree_rise::{self, Clusters, Roots};
use crate::tree::{Built, TreeLevels};
use crate::{Cancel, Engine, Pyramid, Result, Volume, constants};
use std::ops::Range;

/// Maximum triangles per CPU core in one launch of `tree_build`, unless a block has more. Bounds the working memory, which each launch
/// allocates for its blocks. A launch for regions ends within about 50 ms, so that other jobs get the device soon.
const CORE_TRIANGLES: u64 = 50_000;
/// Clusters of a block times rounds of one launch on a CPU: as many as `CORE_TRIANGLES` take.
const CORE_VISITS: u32 = 100_000;
/// The same on a GPU: a block has hundreds of work-items there.
const GPU_VISITS: u32 = 2_000_000;

/// Minimum triangles of a launch on a GPU, which needs many blocks at once. A launch takes half of all triangles, to bound memory.
const MIN_GPU_TRIANGLES: u64 = 2_000_000;
/// Maximum triangles of a launch on a GPU; such a launch ends within about 50 ms.
const MAX_GPU_TRIANGLES: u64 = 8_000_000;
/// Few regions have more triangles. Added to half of all triangles, it makes the work two launches.
const MAX_REGION_TRIANGLES: u64 = 50_000;

/// The last level, if the volume is larger: one block of all would be built by one work-group, and far from their origin 32-bit floats
/// no longer tell errors apart.
const LAST_LEVEL: u32 = 3;

/// The blocks of a level.
struct Blocks {
    host: Vec<TreeRegion>,
    /// Points or clusters that each begins with.
    counts: Vec<u32>,
    /// Linear index of each in the grid of blocks.
    linear: Vec<u32>,
    device: Buffer<TreeRegion>,
    round_ends: Buffer<u32>,
}

impl Blocks {
    fn new(engine: &Engine, host: Vec<TreeRegion>, counts: Vec<u32>, linear: Vec<u32>) -> Result<Self> {
        let cx = &engine.cx;
        Ok(Self {
            device: cx.upload(tree::STAGE, &host)?,
            round_ends: cx.buffer(tree::STAGE, host.len() * constants::TREE_ROUNDS as usize)?,
            host,
            counts,
            linear,
        })
    }
}

/// The mesh of a level above the regions.
struct RisenMesh {
    grid: Grid,
    regions: Buffer<Region>,
    region_index: Buffer<u32>,
    meshes: Buffer<RegionMesh>,
    corners: Buffer<u32>,
    clusters: Clusters,
}

impl RisenMesh {
    fn level<'a>(&'a self, below: &Level<'a>) -> Level<'a> {
        Level {
            number: below.number + 1,
            is_last: self.grid.regions == [1; 3] || below.number + 1 == LAST_LEVEL,
            grid: self.grid,
            params: below.params,
            regions: &self.regions,
            region_index: &self.region_index,
            meshes: &self.meshes,
            corners: &self.corners,
            points: &self.clusters.points,
            cell_points: below.cell_points,
            risen: Risen {
                clusters: &self.clusters.clusters,
                members: &self.clusters.members,
            },
        }
    }
}

/// What all levels are built with.
#[derive(Clone, Copy)]
struct Builder<'a> {
    engine: &'a Engine,
    volume: &'a Volume,
    pyramid: &'a Pyramid,
    cancel: &'a dyn Cancel,
}

impl Engine {
    /// Builds all levels. `first`: the one of the regions; `regions`: with their points. Also returns, region by region, numbers of
    /// triangles of other regions' meshes that have a corner in it.
    pub(super) fn build_levels(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        first: &Level<'_>,
        regions: Vec<TreeRegion>,
        cancel: &dyn Cancel,
    ) -> Result<(TreeLevels, Buffer<u32>)> {
        let builder = Builder {
            engine: self,
            volume,
            pyramid,
            cancel,
        };
        let counts = regions.iter().map(|region| region.points).collect();
        let linear = pyramid.host_regions.iter().map(|region| region.region).collect();
        let mut blocks = Blocks::new(self, regions, counts, linear)?;
        let mut levels = TreeLevels {
            built: Built::new(&self.cx, first.points.len())?,
            blocks: Vec::new(),
            block_levels: Vec::new(),
            vanishing: None,
        };
        let mut round_ends = Vec::new();
        let beside_count = builder.count_gathered(first, &mut blocks)?;
        let beside = self.cx.buffer(tree::STAGE, beside_count)?;
        builder.build_from(first, blocks, Some(&beside), &mut levels, &mut round_ends)?;
        levels.number_points();
        levels.built.regions = self.cx.upload(tree::STAGE, &levels.blocks)?;
        levels.built.round_ends = self.cx.upload(tree::STAGE, &round_ends)?;
        Ok((levels, beside))
    }

    /// Returns the maximum triangles of a launch. `all`: triangles of all blocks.
    fn batch_triangles(&self, all: u64) -> u64 {
        match self.cx.tuning.region_group {
            1 => CORE_TRIANGLES * u64::from(self.device().compute_units),
            _ => (all / 2 + MAX_REGION_TRIANGLES).clamp(MIN_GPU_TRIANGLES, MAX_GPU_TRIANGLES),
        }
    }
}

impl Builder<'_> {
    /// Builds a level and those above it.
    fn build_from(
        &self,
        level: &Level<'_>,
        mut blocks: Blocks,
        beside: Option<&Buffer<u32>>,
        levels: &mut TreeLevels,
        round_ends: &mut Vec<u32>,
    ) -> Result<()> {
        let cx = &self.engine.cx;
        let roots = self.build_level(level, &mut blocks, beside, levels)?;
        round_ends.extend(cx.read(tree::STAGE, &blocks.round_ends, blocks.round_ends.len())?);
        let first = levels.blocks.len();
        levels.block_levels.push(first..first + blocks.host.len());
        let (mesh, mut next) = self.rise(level, &mut blocks, &roots, &levels.built)?;
        drop(roots);
        if level.is_last {
            return self.vanish(level, &mesh, blocks, levels, round_ends);
        }
        let first = levels.blocks.len() + blocks.host.len();
        blocks.host.iter_mut().for_each(|block| block.above += first as u32);
        levels.blocks.append(&mut blocks.host);
        drop(blocks);
        let level = mesh.level(level);
        self.count_gathered(&level, &mut next)?;
        self.build_from(&level, next, None, levels, round_ends)
    }

    /// Makes the nodes at which small parts of the surface vanish, a block behind all others. `mesh`: what the last level has left.
    fn vanish(
        &self,
        level: &Level<'_>,
        mesh: &RisenMesh,
        mut blocks: Blocks,
        levels: &mut TreeLevels,
        round_ends: &mut Vec<u32>,
    ) -> Result<()> {
        let points = blocks.host.iter().map(|block| block.points).sum();
        let vanishing = self.find_vanishing(level, mesh, &levels.built)?;
        let above = if vanishing.nodes.is_empty() {
            NONE
        } else {
            (levels.blocks.len() + blocks.host.len()) as u32
        };
        blocks.host.iter_mut().for_each(|block| block.above = above);
        levels.blocks.append(&mut blocks.host);
        if vanishing.nodes.is_empty() {
            return Ok(());
        }
        round_ends.extend(&vanishing.round_ends);
        round_ends.resize(round_ends.len().next_multiple_of(constants::TREE_ROUNDS as usize), 0);
        let block = levels.blocks.len();
        levels.vanishing = Some(block);
        levels.block_levels.push(block..block + 1);
        levels.blocks.push(TreeRegion {
            node_base: levels.built.node_count,
            nodes: vanishing.nodes.len() as u32,
            rounds: vanishing.round_ends.len() as u32,
            above: NONE,
            points,
            ..Default::default()
        });
        self.append(&vanishing, &mut levels.built)
    }

    /// Returns the nodes at which parts vanish: none if there is no space for them.
    fn find_vanishing(&self, level: &Level<'_>, mesh: &RisenMesh, built: &Built) -> Result<Vanishing> {
        let cx = &self.engine.cx;
        check_cancelled(self.cancel)?;
        let clusters = &mesh.clusters;
        let remains = Remains {
            clusters: cx.read(tree::STAGE, &clusters.clusters, clusters.clusters.len())?,
            members: cx.read(tree::STAGE, &clusters.members, clusters.members.len())?,
            points: cx.read(tree::STAGE, &clusters.points, clusters.points.len())?,
            corners: cx.read(tree::STAGE, &mesh.corners, mesh.corners.len())?,
        };
        let points = built.point_parents.len() as u32;
        check_cancelled(self.cancel)?;
        let vanishing = remains.vanishing(&level.grid, level.number + 1, points, built.node_count);
        // Only nodes of parts with handles can be too many. There are always fewer nodes than points (`cl/lib/tree_leaf.h`).
        let fits = (built.node_count as usize + vanishing.nodes.len()) < built.nodes.len();
        Ok(if fits { vanishing } else { Vanishing::default() })
    }

    /// Writes these nodes behind all others.
    fn append(&self, vanishing: &Vanishing, built: &mut Built) -> Result<()> {
        let cx = &self.engine.cx;
        let first = built.node_count as usize;
        let levels = vec![constants::MAX_CUBE_LEVEL as u8; vanishing.nodes.len()];
        cx.write_at(tree::STAGE, &mut built.nodes, first, &vanishing.nodes)?;
        cx.write_at(tree::STAGE, &mut built.node_errors, first, &vanishing.errors)?;
        cx.write_at(tree::STAGE, &mut built.node_levels, first, &levels)?;
        tree_rise::link(cx, self.volume, built, &vanishing.parents)?;
        built.node_count += vanishing.nodes.len() as u32;
        Ok(())
    }

    /// Counts the triangles that have a corner in each block. Returns how many of these belong to other blocks' meshes.
    fn count_gathered(&self, level: &Level<'_>, blocks: &mut Blocks) -> Result<usize> {
        let cx = &self.engine.cx;
        let all = 0..blocks.host.len();
        tree::gather(cx, self.volume, level, all, &blocks.device, Gathered::Count)?;
        let counted = cx.read(tree::STAGE, &blocks.device, blocks.host.len())?;
        let mut beside = 0;
        for (block, counted) in blocks.host.iter_mut().zip(&counted) {
            block.triangle_count = counted.triangle_count;
            (block.beside_base, block.beside_count) = (beside, counted.beside_count);
            beside += counted.beside_count;
        }
        check_cancelled(self.cancel)?;
        Ok(beside as usize)
    }

    /// Builds the blocks of a level, launch by launch. `beside`: receives the numbers of triangles of other blocks' meshes.
    fn build_level(
        &self,
        level: &Level<'_>,
        blocks: &mut Blocks,
        beside: Option<&Buffer<u32>>,
        levels: &mut TreeLevels,
    ) -> Result<Vec<Roots>> {
        let cx = &self.engine.cx;
        let gathered = blocks.host.iter().map(|block| u64::from(block.triangle_count)).sum();
        let batches = batches(&mut blocks.host, &blocks.counts, self.engine.batch_triangles(gathered));
        cx.write(tree::STAGE, &mut blocks.device, &blocks.host)?;
        let queue = Queue::new(cx, &batches, &blocks.host)?;
        let mut roots = Vec::new();
        for batch in batches {
            let last = batch.end - 1;
            let block = &blocks.host[last];
            let triangles = (block.triangle_base + block.triangle_count) as usize;
            let clusters = (block.cluster_base + blocks.counts[last]) as usize;
            let work = Work::new(cx, &queue, triangles, clusters)?;
            let output = match beside {
                Some(beside) => Gathered::Beside(&work.triangles, beside),
                None => Gathered::Triangles(&work.triangles),
            };
            tree::gather(cx, self.volume, level, batch.clone(), &blocks.device, output)?;
            self.build_blocks(level, blocks, batch.clone(), &work)?;
            for block in &mut blocks.host[batch.clone()] {
                block.node_base = levels.built.node_count;
                levels.built.node_count += block.nodes;
            }
            let built = (&blocks.host[batch.clone()], &blocks.device);
            roots.push(tree_rise::commit(
                cx,
                self.volume,
                level,
                batch,
                built,
                &work,
                &levels.built,
            )?);
            cx.pause(tree::STAGE, self.cancel)?;
        }
        Ok(roots)
    }

    /// Makes all rounds of merges of some blocks. Large blocks take several launches.
    fn build_blocks(&self, level: &Level<'_>, blocks: &mut Blocks, batch: Range<usize>, work: &Work<'_>) -> Result<()> {
        let cx = &self.engine.cx;
        let largest = blocks.counts[batch.clone()].iter().copied().max().unwrap_or(0);
        let visits = if cx.tuning.region_group == 1 {
            CORE_VISITS
        } else {
            GPU_VISITS
        };
        let rounds = (visits / largest.max(1)).clamp(1, constants::TREE_ROUNDS);
        tree_begin::run(
            cx,
            self.volume,
            self.pyramid,
            level,
            batch.clone(),
            work,
            &blocks.device,
        )?;
        loop {
            let to = (&blocks.device, &blocks.round_ends);
            tree_build::run(cx, self.volume, level, batch.clone(), rounds, work, to)?;
            let built = cx.read_at(tree::STAGE, &blocks.device, batch.start, batch.len())?;
            let is_done = built.iter().all(|block| block.is_done != 0);
            blocks.host[batch.clone()].copy_from_slice(&built);
            check_cancelled(self.cancel)?;
            if is_done {
                return Ok(());
            }
        }
    }

    /// Makes what the blocks of a level have left the mesh of the next one, and sets the block above each.
    fn rise(
        &self,
        level: &Level<'_>,
        blocks: &mut Blocks,
        roots: &[Roots],
        built: &Built,
    ) -> Result<(RisenMesh, Blocks)> {
        let (cx, volume) = (&self.engine.cx, self.volume);
        let grid = Grid {
            regions: level.grid.regions.map(|n| n.div_ceil(2)),
            ..level.grid
        };
        let linear = find_above(&mut blocks.host, &blocks.linear, level.grid.regions, grid.regions);
        let above: Vec<usize> = blocks.host.iter().map(|block| block.above as usize).collect();
        let cluster_counts: Vec<u32> = blocks.host.iter().map(|block| block.clusters).collect();
        let clusters = Grouped::new(&above, &cluster_counts, linear.len());
        let next_clusters = Clusters::new(cx, clusters.total as usize)?;
        let risen_of = cx.buffer(tree::STAGE, built.point_parents.len() + built.node_count as usize)?;
        for roots in roots {
            let to = (roots, &clusters.firsts[roots.blocks.clone()]);
            tree_rise::rise(cx, volume, level, &blocks.device, to, &next_clusters, &risen_of)?;
        }
        let risen = tree_rise::risen(cx, volume, level, built, &risen_of)?;
        drop(risen_of);
        let counts = tree_rise::count_survivors(cx, volume, level, &risen)?;
        let triangles = Grouped::new(&above, &counts, linear.len());
        let to = (&triangles.firsts[..], triangles.total as usize);
        let corners = tree_rise::survivors(cx, volume, level, &risen, to)?;
        let mesh = RisenMesh {
            regions: cx.upload(tree::STAGE, &regions_of(&linear, &clusters))?,
            region_index: cx.upload(tree::STAGE, &index_of(&linear, grid.regions))?,
            meshes: cx.upload(tree::STAGE, &meshes_of(&triangles))?,
            corners,
            clusters: next_clusters,
            grid,
        };
        let counts = clusters.groups.iter().map(|group| group[1]).collect();
        let next = Blocks::new(self.engine, blocks_above(&blocks.host, linear.len()), counts, linear)?;
        cx.pause(tree::STAGE, self.cancel)?;
        Ok((mesh, next))
    }
}

/// Parts of blocks, grouped by the block above.
struct Grouped {
    /// Of each block, the place of its first part among all.
    firsts: Vec<u32>,
    /// Of each block above, the place of its first part and the number of its parts.
    groups: Vec<[u32; 2]>,
    total: u32,
}

impl Grouped {
    fn new(above: &[usize], counts: &[u32], groups: usize) -> Self {
        let mut of_groups = vec![[0, 0]; groups];
        for (&group, count) in above.iter().zip(counts) {
            of_groups[group][1] += count;
        }
        let mut total = 0;
        for group in &mut of_groups {
            group[0] = total;
            total += group[1];
        }
        let mut next: Vec<u32> = of_groups.iter().map(|group| group[0]).collect();
        let first = |(&group, &count): (&usize, &u32)| {
            next[group] += count;
            next[group] - count
        };
        Self {
            firsts: above.iter().zip(counts).map(first).collect(),
            groups: of_groups,
            total,
        }
    }
}

/// Finds the block above each block, of twice the size. Returns the linear indices of these, in a grid of `to` blocks. `linear`: of the
/// blocks, in a grid of `from` blocks.
fn find_above(blocks: &mut [TreeRegion], linear: &[u32], from: [u32; 3], to: [u32; 3]) -> Vec<u32> {
    let linear_above = |index: &u32| {
        let [x, y, z] = [index % from[0], index / from[0] % from[1], index / from[0] / from[1]];
        (z / 2 * to[1] + y / 2) * to[0] + x / 2
    };
    let all: Vec<u32> = linear.iter().map(linear_above).collect();
    let mut above: Vec<u32> = all.clone();
    above.sort_unstable();
    above.dedup();
    for (block, index) in blocks.iter_mut().zip(all) {
        block.above = above.partition_point(|&other| other < index) as u32;
    }
    above
}

/// The blocks above, without their clusters.
fn blocks_above(blocks: &[TreeRegion], count: usize) -> Vec<TreeRegion> {
    let empty = TreeRegion {
        region: NONE,
        above: NONE,
        ..Default::default()
    };
    let mut above = vec![empty; count];
    for block in blocks {
        let to = &mut above[block.above as usize];
        to.points += block.points;
        to.region = to.region.min(block.region);
    }
    above
}

/// The blocks at these linear indices, which begin with clusters instead of points.
fn regions_of(linear: &[u32], clusters: &Grouped) -> Vec<Region> {
    let region = |(&linear, &[first, count]): (&u32, &[u32; 2])| Region {
        region: linear,
        point_base: first,
        level_base: [0, count, 0, 0, 0, 0, 0, 0],
        ..Default::default()
    };
    linear.iter().zip(&clusters.groups).map(region).collect()
}

/// The number of the block at each linear index of a grid, or `NONE`.
fn index_of(linear: &[u32], grid: [u32; 3]) -> Vec<u32> {
    let mut index = vec![NONE; grid.iter().product::<u32>() as usize];
    for (number, &at) in linear.iter().enumerate() {
        index[at as usize] = number as u32;
    }
    index
}

fn meshes_of(triangles: &Grouped) -> Vec<RegionMesh> {
    let mesh = |&[first, count]: &[u32; 2]| RegionMesh {
        triangle_base: first,
        triangles: [count, 0, 0, 0, 0, 0],
        ..Default::default()
    };
    triangles.groups.iter().map(mesh).collect()
}

/// Divides blocks into batches of at most `max_triangles` triangles, or of one block, and assigns each block its range of the batch's
/// working memory. `counts`: points or clusters that each begins with.
fn batches(blocks: &mut [TreeRegion], counts: &[u32], max_triangles: u64) -> Vec<Range<usize>> {
    let mut batches: Vec<Range<usize>> = Vec::new();
    let (mut triangles, mut clusters) = (0u32, 0u32);
    for (i, block) in blocks.iter_mut().enumerate() {
        if batches.is_empty() || u64::from(triangles) + u64::from(block.triangle_count) > max_triangles {
            batches.push(i..i);
            (triangles, clusters) = (0, 0);
        }
        (block.triangle_base, block.cluster_base) = (triangles, clusters);
        triangles += block.triangle_count;
        clusters += counts[i];
        if let Some(batch) = batches.last_mut() {
            batch.end = i + 1;
        }
    }
    batches
}
