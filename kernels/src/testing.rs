//! Access to the crate's internals for tests: the device, buffers read back, single stages run on cuts that the host
//! supplies. Behind the feature `testing`; a production build does not contain it.

use crate::buffer::Buffer;
use crate::layout::{self, Brick, Counters, Node, RegionMesh, TreeNode, TreeRegion, VertexRecord, WorkVertex};
use crate::lock::lock;
use crate::stages::{self, cut, march, patch};
use crate::{
    Cut, CutParams, DeviceInfo, DeviceKind, Engine, Error, Grid, Level, Never, Pyramid, Result, Surface, Tuning,
    VertexTree, Volume, constants, tables,
};
use std::ops::{Deref, DerefMut};
use std::sync::{Arc, Mutex, MutexGuard};

/// Planes of a slab that serves one layer of regions inside the volume.
pub const LAYER_PLANES: u32 = crate::volume::LAYER_PLANES;

/// Stage that errors and times of this module name.
const STAGE: &str = "test";

/// PoCL crashes if several threads build and run programs at once (isopeel itself has one thread a device).
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// An engine that no other test of the process uses at the same time.
pub struct Device {
    engine: Engine,
    _guard: MutexGuard<'static, ()>,
}

impl Deref for Device {
    type Target = Engine;
    fn deref(&self) -> &Engine {
        &self.engine
    }
}

impl DerefMut for Device {
    fn deref_mut(&mut self) -> &mut Engine {
        &mut self.engine
    }
}

/// Returns the device that `ISOPEEL_DEVICE` selects, or the preferred one. Returns `None` only if there is no device and
/// `ISOPEEL_TESTS_WITHOUT_DEVICE=1` is set.
///
/// # Panics
/// There is no device, and one is expected.
pub fn device() -> Option<Device> {
    // A test that panicked while it held the device left no inconsistent state.
    let guard = lock(&ONE_AT_A_TIME);
    crate::program::shared::begin();
    let selector = std::env::var("ISOPEEL_DEVICE").ok();
    match Engine::open(selector.as_deref()) {
        Ok(engine) => Some(Device { engine, _guard: guard }),
        Err(e @ (Error::NoLoader | Error::NoDriver | Error::NoDevice { .. })) => {
            let none_expected = std::env::var_os("ISOPEEL_TESTS_WITHOUT_DEVICE").is_some_and(|v| v == "1");
            assert!(
                none_expected,
                "{e}; ISOPEEL_TESTS_WITHOUT_DEVICE=1 leaves out tests that need a device"
            );
            None
        }
        Err(e) => panic!("{e}"),
    }
}

/// Returns a setting that a driver compiles in seconds: PoCL takes minutes to optimise kernels with the work-groups of a GPU.
pub fn compiled_soon(tuning: Tuning, device: &DeviceInfo) -> Tuning {
    Tuning {
        optimises: device.kind != DeviceKind::Cpu,
        ..tuning
    }
}

/// Opens the device again, with the kernels for GPUs. `limit_bytes`: as in [`Engine::open_limited`].
///
/// # Panics
/// The device does not open.
pub fn with_gpu_kernels(engine: &Engine, limit_bytes: Option<u64>) -> Engine {
    let device = engine.device();
    let tuning = compiled_soon(Tuning::GPU, device);
    Engine::open_tuned(Some(&device.name), limit_bytes, Some(tuning)).expect("the device opens again")
}

/// Lowers or restores the largest allocation, which cuts volumes into slabs; returns the limit before.
pub fn limit_allocations(engine: &mut Engine, bytes: u64) -> u64 {
    std::mem::replace(&mut engine.cx.limit_bytes, bytes)
}

/// Number of slabs of a volume.
pub fn slab_count(volume: &Volume) -> usize {
    volume.slabs.len()
}

/// A volume's min/max table read back.
pub struct MinmaxContents {
    /// Minimum and maximum of each brick, 64 a region in Morton order.
    pub ranges: Vec<[f32; 2]>,
    /// For each region, one bit per brick: samples are missing.
    pub missing_masks: Vec<[u32; 2]>,
}

/// Reads a volume's min/max table back.
///
/// # Errors
/// An error of the device.
pub fn read_minmax(engine: &Engine, volume: &Volume) -> Result<MinmaxContents> {
    Ok(MinmaxContents {
        ranges: engine.cx.read(STAGE, &volume.table, volume.table.len())?,
        missing_masks: volume.missing_masks.clone(),
    })
}

/// A pyramid read back.
pub struct PyramidContents {
    /// Grid of the volume.
    pub grid: Grid,
    /// Active regions.
    pub regions: Vec<layout::Region>,
    /// Active bricks.
    pub bricks: Vec<Brick>,
    /// Nodes and extra sheets, by slot.
    pub nodes: Vec<Node>,
    /// Their vertices, by slot.
    pub vertex_records: Vec<VertexRecord>,
}

/// Reads a pyramid back.
///
/// # Errors
/// An error of the device.
pub fn read_pyramid(engine: &Engine, pyramid: &Pyramid) -> Result<PyramidContents> {
    let cx = &engine.cx;
    Ok(PyramidContents {
        grid: pyramid.grid,
        regions: cx.read(STAGE, &pyramid.regions, pyramid.regions.len())?,
        bricks: cx.read(STAGE, &pyramid.bricks, pyramid.bricks.len())?,
        nodes: cx.read(STAGE, &pyramid.nodes, pyramid.nodes.len())?,
        vertex_records: cx.read(STAGE, &pyramid.vertex_records, pyramid.vertex_records.len())?,
    })
}

/// The state of every slot of a cut.
///
/// # Errors
/// An error of the device.
pub fn read_cut(engine: &Engine, cut: &Cut) -> Result<Vec<u8>> {
    engine.cx.read(STAGE, &cut.state, cut.state.len())
}

/// Uploads the cut `state`, one byte per slot.
///
/// # Errors
/// An error of the device.
pub fn upload_cut(engine: &Engine, pyramid: &Pyramid, params: &CutParams, state: &[u8]) -> Result<Cut> {
    Ok(Cut {
        pyramid: pyramid.id,
        params: cut::layout(params, Level::FINEST),
        mesher: params.mesher,
        prefix: Level::FINEST,
        state: engine.cx.upload(STAGE, state)?,
        regions: vec![layout::RegionCut::default(); pyramid.host_regions.len()],
        counted: Default::default(),
        meshes: Default::default(),
        unpatched_vertices: Default::default(),
    })
}

/// Leaves of the final cut at some values of β, ascending; the guards of `params` stay in force.
///
/// # Errors
/// An error of the device.
pub fn curve(engine: &Engine, volume: &Volume, pyramid: &Pyramid, params: &CutParams) -> Result<Vec<(f32, i64)>> {
    engine.leaves_by_beta(volume, pyramid, params)
}

/// Meshes the cut `state`, one byte a slot.
///
/// # Errors
/// An error of the device.
pub fn mesh(engine: &Engine, volume: &Volume, pyramid: &Pyramid, params: &CutParams, state: &[u8]) -> Result<Surface> {
    let cut = upload_cut(engine, pyramid, params, state)?;
    engine.surface(volume, pyramid, params, &cut, None, &Never)
}

/// Mesh of a cut by marching cubes, before and after crack patching.
pub struct Marched {
    /// Vertices and triangles of each active region.
    pub meshes: Vec<RegionMesh>,
    /// Vertices at full-resolution crossings, region by region.
    pub refined: Vec<WorkVertex>,
    /// The same vertices after patching.
    pub patched: Vec<WorkVertex>,
    /// Three a triangle, from the region's first vertex.
    pub indices: Vec<u32>,
    /// The counts.
    pub counters: Counters,
}

/// Runs the stages `march` and `patch` on the cut `state`, one byte a slot.
///
/// # Errors
/// An error of the device.
pub fn march(engine: &Engine, volume: &Volume, pyramid: &Pyramid, state: &[u8]) -> Result<Marched> {
    let cx = &engine.cx;
    let slabs = stages::slab_work(volume, &pyramid.host_regions, pyramid.bricks.len());
    let state = cx.upload(STAGE, state)?;
    let cases = cx.upload(STAGE, &tables::case_table())?;
    let counters = cx.zeroed::<Counters>(STAGE, 1)?;
    let (marks, mut meshes) = march::gather(cx, volume, pyramid, &slabs, &state, &cases)?;
    let (device_meshes, vertices, indices) = engine.allocate_mesh(STAGE, &mut meshes)?;
    let work = cx.buffer::<WorkVertex>(STAGE, vertices.len())?;
    let gathered = march::Gathered {
        state: &state,
        cases: &cases,
        marks: &marks,
        meshes: &device_meshes,
    };
    march::assemble(cx, volume, pyramid, &slabs, &gathered, &work, &indices)?;
    let refined = cx.read(STAGE, &work, work.len())?;
    patch::run(cx, volume, pyramid, &gathered, 5, &work, &counters)?;
    Ok(Marched {
        meshes,
        refined,
        patched: cx.read(STAGE, &work, work.len())?,
        indices: cx.read(STAGE, &indices, indices.len())?,
        counters: cx.read(STAGE, &counters, 1)?[0],
    })
}

/// The area of the part of each point of a tree, world units; negative for the first point of a part.
///
/// # Errors
/// An error of the device.
pub fn part_areas(
    engine: &Engine,
    volume: &Volume,
    pyramid: &Pyramid,
    tree: &VertexTree,
    params: &CutParams,
) -> Result<Vec<f32>> {
    let parts = engine.cutter(volume, pyramid, tree, params).parts(&Never)?;
    engine.cx.read(STAGE, &parts.areas, parts.areas.len())
}

/// The maximum importance of the points below each node of a tree; `None` if all are 0.
///
/// # Errors
/// An error of the device.
pub fn node_importances(
    engine: &Engine,
    volume: &Volume,
    pyramid: &Pyramid,
    tree: &VertexTree,
    params: &CutParams,
) -> Result<Option<Vec<f32>>> {
    let importances = engine.cutter(volume, pyramid, tree, params).importances(params)?;
    let read = |bits: Arc<Buffer<u32>>| engine.cx.read(STAGE, &bits, bits.len());
    let bits = importances.map(read).transpose()?;
    Ok(bits.map(|bits| bits.into_iter().map(f32::from_bits).collect()))
}

/// A vertex tree read back.
pub struct TreeContents {
    /// Ranges of the tree in each active region.
    pub regions: Vec<TreeRegion>,
    /// Nodes; those of a region from its `node_base` on.
    pub nodes: Vec<TreeNode>,
    /// Their errors; negative if the merge removes one triangle instead of two.
    pub node_errors: Vec<f32>,
    /// The node that each node merges into, or [`layout::NONE`].
    pub node_parents: Vec<u32>,
    /// Of each region, nodes after each round.
    pub round_ends: Vec<Vec<u32>>,
    /// The node that each point merges into, or [`layout::NONE`].
    pub point_parents: Vec<u32>,
    /// Position of each point in the volume, and its slot.
    pub points: Vec<[i32; 4]>,
    /// Number of points of cells and sheets; the other points are on the volume's faces.
    pub cell_points: u32,
    /// Three points a triangle of the full mesh.
    pub corners: Vec<u32>,
    /// The node that each triangle collapses with, or [`layout::NONE`].
    pub collapsed_by: Vec<u32>,
    /// Ranges of each region's triangles.
    pub meshes: Vec<RegionMesh>,
}

/// Reads a vertex tree back.
///
/// # Errors
/// An error of the device.
pub fn read_tree(engine: &Engine, tree: &VertexTree) -> Result<TreeContents> {
    let (cx, built) = (&engine.cx, &tree.built);
    let regions = cx.read(STAGE, &tree.built.regions, tree.built.regions.len())?;
    let errors = cx.read(STAGE, &built.node_errors, built.node_errors.len())?;
    let round_ends = cx.read(STAGE, &built.round_ends, built.round_ends.len())?;
    let of_region = |(region, ends): (&TreeRegion, &[u32])| ends[..region.rounds as usize].to_vec();
    let rounds = round_ends.chunks_exact(constants::TREE_ROUNDS as usize);
    Ok(TreeContents {
        round_ends: regions.iter().zip(rounds).map(of_region).collect(),
        regions,
        nodes: cx.read(STAGE, &built.nodes, built.nodes.len())?,
        node_errors: errors.into_iter().map(f32::from_bits).collect(),
        node_parents: cx.read(STAGE, &built.node_parents, built.node_parents.len())?,
        point_parents: cx.read(STAGE, &built.point_parents, built.point_parents.len())?,
        points: cx.read(STAGE, &tree.points, tree.points.len())?,
        cell_points: tree.cell_points,
        corners: cx.read(STAGE, &tree.corners, tree.corners.len())?,
        collapsed_by: cx.read(STAGE, &tree.collapsed_by, tree.collapsed_by.len())?,
        meshes: cx.read(STAGE, &tree.meshes, tree.meshes.len())?,
    })
}
