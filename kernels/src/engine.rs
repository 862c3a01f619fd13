//! A device with its programs: loads volumes, builds pyramids, peels surfaces.

use crate::buffer::Buffer;
use crate::context::Context;
use crate::layout::{self, Brick, Counters, Node, Placement, RegionMesh};
use crate::stages::{self, activate, classify, construct, cut, dual, histogram, march, minmax, pack, patch};
use crate::volume::{Slab, slab_layers, slab_planes};
use crate::{
    CutParams, DeviceInfo, Error, Grid, Isovalue, Level, Mesher, Region, Result, SampleType, Samples, StageTime,
    Statistics, Surface, Vertex, Volume, program,
};
use std::cell::RefCell;
use std::collections::HashSet;

/// Asked between stages whether the work is still wanted.
pub trait Cancel {
    /// True when the caller has no more use for the result.
    fn cancelled(&self) -> bool;
}

/// Never cancels.
pub struct Never;

impl Cancel for Never {
    fn cancelled(&self) -> bool {
        false
    }
}

/// What the user's importance looks at, beside smoothness.
#[derive(Clone, Copy)]
pub enum Feature<'a> {
    /// Nothing: `f` is zero everywhere.
    None,
    /// Another field on the same grid.
    Field(&'a Volume),
    /// Magnitude of the field's own gradient, in its units per world unit.
    GradientMagnitude,
}

/// Range and distribution of a field or a derived feature.
#[derive(Clone, Debug, PartialEq)]
pub struct Histogram {
    /// Least and greatest finite value; `[0, 0]` when there is none.
    pub range: [f32; 2],
    /// Samples in 256 equal bins from `range[0]` to `range[1]`.
    pub bins: Vec<u64>,
}

/// What depends on the isovalue and the feature alone: active bricks and nodes of levels 0 to 5 (algorithm, sections
/// 2 and 3). Peel it as often as α, β or the transfer function change.
pub struct Pyramid {
    pub(crate) iso: f32,
    pub(crate) grid: Grid,
    /// Compact index of every region of the grid, or [`layout::NONE`].
    pub(crate) region_index: Buffer<u32>,
    pub(crate) regions: Buffer<layout::Region>,
    pub(crate) bricks: Buffer<Brick>,
    pub(crate) nodes: Buffer<Node>,
    pub(crate) placements: Buffer<Placement>,
    /// The active regions once more, on the host.
    pub(crate) host_regions: Vec<layout::Region>,
    full_triangles: u64,
    active_cells: u64,
    stages: Vec<StageTime>,
    peak_bytes: u64,
    feature_bytes: u64,
}

impl Pyramid {
    /// Isovalue it was built for, in the field's units.
    pub fn iso(&self) -> f32 {
        self.iso
    }

    /// Triangles of the undecimated surface.
    pub fn full_triangles(&self) -> u64 {
        self.full_triangles
    }

    /// Cells that the surface crosses.
    pub fn active_cells(&self) -> u64 {
        self.active_cells
    }

    /// Active bricks: those that the surface may cross.
    pub fn active_bricks(&self) -> u64 {
        self.bricks.len() as u64
    }

    /// What building it took.
    pub fn stages(&self) -> &[StageTime] {
        &self.stages
    }

    /// Bytes it holds on the device.
    pub fn device_bytes(&self) -> u64 {
        self.region_index.bytes()
            + self.regions.bytes()
            + self.bricks.bytes()
            + self.nodes.bytes()
            + self.placements.bytes()
    }
}

/// A device, its queue and its programs. Lives on one thread.
pub struct Engine {
    pub(crate) cx: Context,
    cases: Buffer<u8>,
    warm: RefCell<HashSet<SampleType>>,
}

impl Engine {
    /// Opens the preferred device, or the one that `selector` names by index or by a part of its name.
    ///
    /// # Errors
    /// As [`crate::device::list`]; [`Error::NoDevice`] when the selector matches none.
    pub fn open(selector: Option<&str>) -> Result<Self> {
        Self::open_limited(selector, None)
    }

    /// As [`Engine::open`], with no single allocation above `limit_bytes`, so that even a small volume is cut into slabs.
    ///
    /// # Errors
    /// As [`Engine::open`].
    pub fn open_limited(selector: Option<&str>, limit_bytes: Option<u64>) -> Result<Self> {
        let cx = Context::open(selector, limit_bytes)?;
        let cases = cx.upload("open", &program::case_table())?;
        Ok(Self {
            cx,
            cases,
            warm: RefCell::default(),
        })
    }

    /// The device in use.
    pub fn device(&self) -> &DeviceInfo {
        &self.cx.found.info
    }

    /// Builds the kernels of a sample type and runs each of them once: drivers finish compiling at the first launch.
    ///
    /// # Errors
    /// [`Error::Build`], or what the device says.
    pub fn warm_up(&self, sample_type: SampleType) -> Result<()> {
        if !self.warm.borrow_mut().insert(sample_type) {
            return Ok(());
        }
        // A step along x and a bump: leaves of several levels, vertices to patch.
        let (grid, iso) = (Grid::new([18, 18, 18], [1.0; 3])?, Isovalue::new(0.5)?);
        let bump = |i: usize| i % 18 > 8 || i == 18 * 18 * 9 + 18 * 9 + 3;
        let range = 0..grid.sample_count() as usize;
        let samples = match sample_type {
            SampleType::U8 => Samples::U8(range.map(|i| bump(i).into()).collect()),
            SampleType::I8 => Samples::I8(range.map(|i| bump(i).into()).collect()),
            SampleType::U16 => Samples::U16(range.map(|i| bump(i).into()).collect()),
            SampleType::I16 => Samples::I16(range.map(|i| bump(i).into()).collect()),
            SampleType::F32 => Samples::F32(range.map(|i| bump(i).into()).collect()),
        };
        let volume = self.upload(&grid, &samples, None)?;
        self.histogram(&volume, Feature::GradientMagnitude)?;
        let pyramid = self.build_pyramid(&volume, Feature::GradientMagnitude, iso, &Never)?;
        for mesher in [Mesher::MarchingCubes, Mesher::Dual] {
            let params = CutParams {
                mesher,
                ..CutParams::paper(0.01)
            };
            self.peel(&volume, &pyramid, &params, Level::FINEST, &Never)?;
        }
        Ok(())
    }

    /// Puts a field on the device and makes its min/max table. `missing` samples count as NaN.
    ///
    /// # Errors
    /// Too few samples for the grid, or no device memory.
    pub fn upload(&self, grid: &Grid, samples: &Samples, missing: Option<f32>) -> Result<Volume> {
        let grid = Grid::new(grid.dims, grid.spacing)?;
        if samples.len() as u64 != grid.sample_count() {
            return Err(Error::Invalid {
                what: "volume samples",
                why: format!(
                    "{} samples, expected {} for {:?}",
                    samples.len(),
                    grid.sample_count(),
                    grid.dims
                ),
            });
        }
        let sample_type = samples.sample_type();
        self.warm_up(sample_type)?;
        let bytes = samples.as_bytes();
        let plane = grid.dims[0] as usize * grid.dims[1] as usize * sample_type.bytes();
        let mut slabs = Vec::new();
        for layers in slab_layers(&grid, self.cx.limit_bytes)? {
            let planes = slab_planes(&grid, &layers);
            let part = &bytes[planes.start as usize * plane..planes.end as usize * plane];
            slabs.push(Slab {
                samples: self.cx.upload("upload", part)?,
                z0: planes.start,
                layers,
            });
        }
        self.resident(grid, sample_type, missing, slabs)
    }

    /// A volume of slabs that are filled, with its min/max table.
    pub(crate) fn resident(
        &self,
        grid: Grid,
        sample_type: SampleType,
        missing: Option<f32>,
        slabs: Vec<Slab>,
    ) -> Result<Volume> {
        let regions = grid.regions().iter().map(|&r| r as usize).product::<usize>();
        let mut volume = Volume {
            grid,
            sample_type,
            missing: missing.unwrap_or(f32::NAN),
            slabs,
            table: self.cx.buffer(minmax::STAGE, regions * 64)?,
            missing_masks: Vec::new(),
        };
        self.make_table(&mut volume)?;
        Ok(volume)
    }

    /// Fills a volume's min/max table from its samples.
    pub(crate) fn make_table(&self, volume: &mut Volume) -> Result<()> {
        let regions = volume.table.len() / 64;
        let masks = self.cx.zeroed::<[u32; 2]>(minmax::STAGE, regions)?;
        let layout = volume.layout();
        for slab in &volume.slabs {
            minmax::run(&self.cx, volume.sample_type, &layout, slab, &volume.table, &masks)?;
        }
        volume.missing_masks = self.cx.read(minmax::STAGE, &masks, regions)?;
        Ok(())
    }

    /// Bytes that [`Engine::upload`] will take for a field, min/max table included.
    pub fn upload_bytes(&self, grid: &Grid, sample_bytes: usize) -> u64 {
        let regions: u64 = grid.regions().iter().map(|&r| u64::from(r)).product();
        grid.sample_count() * sample_bytes as u64 + regions * 64 * size_of::<[f32; 2]>() as u64
    }

    /// Range and 256-bin histogram of a field (`Feature::None` or `Field`) or of its gradient magnitude.
    ///
    /// # Errors
    /// What the device says.
    pub fn histogram(&self, volume: &Volume, feature: Feature<'_>) -> Result<Histogram> {
        let (volume, feature) = match feature {
            Feature::Field(field) => (field, Feature::None),
            other => (volume, other),
        };
        histogram::run(&self.cx, volume, feature)
    }

    /// Finds the active bricks and builds the pyramid of one isovalue.
    ///
    /// # Errors
    /// [`Error::Cancelled`], or what the device says.
    pub fn build_pyramid(
        &self,
        volume: &Volume,
        feature: Feature<'_>,
        iso: Isovalue,
        cancel: &dyn Cancel,
    ) -> Result<Pyramid> {
        if let Feature::Field(field) = feature
            && field.grid.dims != volume.grid.dims
        {
            return Err(Error::Invalid {
                what: "feature",
                why: format!(
                    "its grid has {:?} samples, expected {:?}",
                    field.grid.dims, volume.grid.dims
                ),
            });
        }
        let cx = &self.cx;
        cx.take_times()?;
        let before = cx.meter.restart();
        let iso = iso.get();

        let masks = activate::run(cx, volume, iso)?;
        check(cancel)?;
        let mut region_index = vec![layout::NONE; masks.len()];
        let mut host_regions = Vec::new();
        let mut list = Vec::new();
        for (linear, &brick_mask) in masks.iter().enumerate() {
            let bits = u64::from(brick_mask[0]) | u64::from(brick_mask[1]) << 32;
            if bits == 0 {
                continue;
            }
            let compact = host_regions.len() as u32;
            region_index[linear] = compact;
            host_regions.push(layout::Region {
                region: linear as u32,
                brick_base: list.len() as u32,
                brick_mask,
                missing_mask: volume.missing_masks[linear],
                ..Default::default()
            });
            list.extend((0..64).filter(|b| bits >> b & 1 == 1).map(|b| compact << 6 | b));
        }

        let mut regions = cx.upload(classify::STAGE, &host_regions)?;
        let bricks = cx.buffer::<Brick>(classify::STAGE, list.len())?;
        let work = stages::slab_work(volume, &host_regions, list.len());
        let list = cx.upload(classify::STAGE, &list)?;
        classify::run(cx, volume, iso, &work, &list, &regions, &bricks)?;
        drop(list);
        let mut arranged = cx.read(classify::STAGE, &regions, host_regions.len())?;
        let mut slots = 0u32;
        for region in &mut arranged {
            region.slot_base = slots;
            slots = slots
                .checked_add(region.level_base[7])
                .ok_or(Error::OutOfDeviceMemory {
                    stage: construct::STAGE,
                    needed_bytes: u64::from(u32::MAX) * size_of::<Node>() as u64,
                    limit_bytes: cx.limit_bytes,
                })?;
        }
        cx.write(classify::STAGE, &mut regions, &arranged)?;
        check(cancel)?;

        let nodes = cx.buffer::<Node>(construct::STAGE, slots as usize)?;
        let placements = cx.buffer::<Placement>(construct::STAGE, slots as usize)?;
        let input = construct::Input {
            volume,
            feature,
            iso,
            work: &work,
            regions: &regions,
            bricks: &bricks,
            cases: &self.cases,
        };
        let totals = construct::run(cx, &input, &nodes, &placements)?;
        let region_index = cx.upload(construct::STAGE, &region_index)?;
        Ok(Pyramid {
            iso,
            grid: volume.grid,
            region_index,
            regions,
            bricks,
            nodes,
            placements,
            full_triangles: totals.iter().map(|&n| u64::from(n)).sum(),
            active_cells: arranged.iter().map(|r| u64::from(r.level_base[1])).sum(),
            host_regions: arranged,
            stages: cx.take_times()?,
            peak_bytes: cx.meter.peak() - before,
            feature_bytes: match feature {
                Feature::Field(field) if !std::ptr::eq(field, volume) => field.sample_bytes(),
                _ => 0,
            },
        })
    }

    /// Cuts the pyramid and meshes the cut. With `prefix` above 0, undecided cubes of that level count as leaves
    /// (algorithm, section 7). `volume` is the one the pyramid was built from. Stage times are the pyramid's and this call's.
    ///
    /// # Errors
    /// [`Error::Cancelled`], or what the device says.
    pub fn peel(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        params: &CutParams,
        prefix: Level,
        cancel: &dyn Cancel,
    ) -> Result<Surface> {
        params.check()?;
        if volume.grid != pyramid.grid {
            return Err(Error::Invalid {
                what: "pyramid",
                why: format!(
                    "built from {:?} samples, expected {:?}",
                    pyramid.grid.dims, volume.grid.dims
                ),
            });
        }
        let cx = &self.cx;
        cx.take_times()?;
        let before = cx.meter.restart();
        let slabs = stages::slab_work(volume, &pyramid.host_regions, pyramid.bricks.len());

        let cut_params = cut::layout(params, prefix);
        let points: Vec<[f32; 2]> = params.transfer.points().iter().map(|p| [p.x, p.importance]).collect();
        let points = cx.upload(cut::STAGE, &points)?;
        let counters = cx.zeroed::<Counters>(cut::STAGE, 1)?;
        let state = cx.buffer::<u8>(cut::STAGE, pyramid.nodes.len())?;
        cut::run(cx, volume, pyramid, &cut_params, &points, &state, &counters)?;
        check(cancel)?;

        let (host_meshes, vertices, indices) = match params.mesher {
            Mesher::Dual => {
                let (counted, mut host_meshes) = dual::count(cx, volume, pyramid, &state)?;
                check(cancel)?;
                let (meshes, vertices, indices) = self.room(dual::STAGE, &mut host_meshes)?;
                let input = dual::Input {
                    params: &cut_params,
                    state: &state,
                    counted: &counted,
                    meshes: &meshes,
                };
                dual::emit(cx, volume, pyramid, &input, &vertices, &indices, &counters)?;
                (host_meshes, vertices, indices)
            }
            Mesher::MarchingCubes => {
                let (marks, mut host_meshes) = march::gather(cx, volume, pyramid, &slabs, &state, &self.cases)?;
                check(cancel)?;
                let (meshes, vertices, indices) = self.room(march::STAGE, &mut host_meshes)?;
                let work = cx.buffer(march::STAGE, vertices.len())?;
                let gathered = march::Gathered {
                    state: &state,
                    cases: &self.cases,
                    marks: &marks,
                    meshes: &meshes,
                };
                march::assemble(cx, volume, pyramid, &slabs, &gathered, &work, &indices)?;
                let deepest = u32::from(params.max_level.get().max(prefix.get()));
                patch::run(cx, volume, pyramid, &gathered, deepest, &work, &counters)?;
                check(cancel)?;
                let input = pack::Input {
                    params: &cut_params,
                    state: &state,
                    owners: &marks.owners,
                    meshes: &meshes,
                    work: &work,
                };
                pack::run(cx, volume, pyramid, &slabs, &input, &vertices, &counters)?;
                (host_meshes, vertices, indices)
            }
        };

        let packed = cx.read("read back", &vertices, vertices.len())?;
        let indices = cx.read("read back", &indices, indices.len())?;
        let counters = cx.read("read back", &counters, 1)?[0];
        let mut times = pyramid.stages.clone();
        times.extend(cx.take_times()?);
        Ok(Surface {
            regions: split(pyramid, &host_meshes, bytemuck::cast_slice(&packed), &indices),
            prefix,
            statistics: Statistics {
                full_triangles: pyramid.full_triangles,
                active_cells: pyramid.active_cells,
                leaves: counters.leaves.map(u64::from),
                triangles: indices.len() as u64 / 3,
                vertices: counters.vertices.into(),
                lost_cubes: counters.lost_cubes.into(),
                unpatched_vertices: counters.unpatched_vertices.into(),
                stages: times,
                device_bytes: volume.table_bytes()
                    + pyramid
                        .peak_bytes
                        .max(pyramid.device_bytes() + cx.meter.peak() - before),
                volume_bytes: volume.sample_bytes() + pyramid.feature_bytes,
            },
        })
    }
}

impl Engine {
    /// Gives every region its place in one vertex and one index buffer.
    fn room(
        &self,
        stage: &'static str,
        meshes: &mut [RegionMesh],
    ) -> Result<(Buffer<RegionMesh>, Buffer<layout::Vertex>, Buffer<u32>)> {
        let (mut vertices, mut triangles) = (0u64, 0u64);
        for mesh in meshes.iter_mut() {
            mesh.vertex_base = vertices as u32;
            mesh.triangle_base = triangles as u32;
            vertices += u64::from(mesh.vertices);
            triangles += mesh.triangles.iter().map(|&n| u64::from(n)).sum::<u64>();
        }
        // Places in the index buffer are 32-bit in the kernels.
        let limit = u64::from(u32::MAX);
        if triangles * 3 > limit {
            return Err(Error::OutOfDeviceMemory {
                stage,
                needed_bytes: triangles * 12,
                limit_bytes: limit * 4,
            });
        }
        Ok((
            self.cx.upload(stage, meshes)?,
            self.cx.buffer(stage, vertices as usize)?,
            self.cx.buffer(stage, triangles as usize * 3)?,
        ))
    }
}

/// Regions that have triangles, each with its own part of the buffers.
fn split(pyramid: &Pyramid, meshes: &[RegionMesh], vertices: &[Vertex], indices: &[u32]) -> Vec<Region> {
    let [rx, ry, _] = pyramid.grid.regions();
    let mut regions = Vec::new();
    for (mesh, active) in meshes.iter().zip(&pyramid.host_regions) {
        let triangles = mesh.triangles.iter().sum::<u32>() as usize;
        if triangles == 0 {
            continue;
        }
        let (v, t) = (mesh.vertex_base as usize, mesh.triangle_base as usize * 3);
        regions.push(Region {
            coords: [active.region % rx, active.region / rx % ry, active.region / rx / ry],
            vertices: vertices[v..v + mesh.vertices as usize].to_vec(),
            indices: indices[t..t + 3 * triangles].to_vec(),
            level_triangles: mesh.triangles,
        });
    }
    regions
}

fn check(cancel: &dyn Cancel) -> Result<()> {
    if cancel.cancelled() {
        Err(Error::Cancelled)
    } else {
        Ok(())
    }
}
