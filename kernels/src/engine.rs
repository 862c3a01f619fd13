//! A device with its programs: loads volumes, builds pyramids, peels surfaces.

use crate::buffer::{Buffer, DeviceMemory};
use crate::context::Context;
use crate::stages::{self, histogram, minmax};
use crate::volume::Slab;
use crate::{
    CutParams, DerivedFeature, DeviceInfo, Feature, Grid, Histogram, Isovalue, Level, Mesher, Never, PartFilter,
    Result, SampleType, Samples, StageTime, TreeGoal, Tuning, Volume, tables,
};
use std::cell::RefCell;
use std::collections::HashSet;
use std::rc::Rc;

mod build;
pub(crate) mod cut;
mod distance_field;
pub(crate) mod evaluate;
pub(crate) mod fit;
mod generate;
mod measure;
pub(crate) mod peel;
pub(crate) mod query;
mod tree;
mod tree_cut;
mod tree_part;
pub(crate) mod upload;

/// A device, its queue and its programs. Lives on one thread.
pub struct Engine {
    pub(crate) cx: Context,
    pub(crate) cases: Buffer<u8>,
    pub(crate) case_facts: Buffer<u32>,
    warm: RefCell<HashSet<SampleType>>,
    /// Programs of expressions, and that of distances.
    expressions: evaluate::Programs,
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
        Self::open_tuned(selector, limit_bytes, None)
    }

    /// As [`Engine::open_limited`], with the kernels of another kind of device: a CPU runs those of a GPU, if slowly.
    ///
    /// # Errors
    /// As [`Engine::open`].
    pub fn open_tuned(selector: Option<&str>, limit_bytes: Option<u64>, tuning: Option<Tuning>) -> Result<Self> {
        let cx = Context::open(selector, limit_bytes, tuning, stages::SOURCES)?;
        let cases = cx.upload("open", &tables::case_table())?;
        let case_facts = cx.upload("open", &tables::case_facts())?;
        Ok(Self {
            cx,
            cases,
            case_facts,
            warm: RefCell::default(),
            expressions: evaluate::Programs::new(),
        })
    }

    /// The device in use.
    pub fn device(&self) -> &DeviceInfo {
        &self.cx.found.info
    }

    /// Whether the device still does what it is asked for: it gives back a byte that it holds.
    pub fn answers(&self) -> bool {
        self.cx.read("answers", &self.cases, 1).is_ok()
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
        let volume = self.upload(grid, &samples, None)?;
        let feature = Feature::Derived(DerivedFeature::GradientMagnitude);
        self.histogram(&volume, feature)?;
        let pyramid = self.build_pyramid(&volume, feature, iso, &Never)?;
        for mesher in [Mesher::MarchingCubes, Mesher::Dual] {
            let params = CutParams {
                mesher,
                ..CutParams::paper(0.01)
            };
            self.peel(&volume, &pyramid, &params, Level::FINEST, &Never)?;
            if mesher == Mesher::Dual {
                self.measure_error(&volume, &pyramid, &params, &Never)?;
                let tree = self.build_tree(&volume, &pyramid, &params, &Never)?;
                let params = CutParams {
                    state_error: true,
                    ..params
                };
                let goal = TreeGoal {
                    tolerance: 0.0,
                    max_triangles: tree.full_triangles() / 2,
                    max_tolerance: f32::INFINITY,
                    without: PartFilter {
                        min_area: f32::MIN_POSITIVE,
                        chosen: None,
                    },
                };
                self.tree_surface(&volume, &pyramid, &tree, &params, &goal, &Never)?;
            }
        }
        Ok(())
    }

    /// A volume of slabs that are filled, with its min/max table.
    pub(crate) fn resident(
        &self,
        grid: Grid,
        sample_type: SampleType,
        missing: Option<f32>,
        slabs: Vec<Slab>,
        inverse_lengths: Option<Rc<Buffer<f32>>>,
    ) -> Result<Volume> {
        let regions = grid.regions().iter().map(|&r| r as usize).product::<usize>();
        let mut volume = Volume {
            grid,
            sample_type,
            missing: missing.unwrap_or(f32::NAN),
            slabs,
            table: self.cx.buffer(minmax::STAGE, regions * 64)?,
            missing_masks: Vec::new(),
            inverse_lengths,
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

    /// Keeps at most so many bytes that were freed, for the next surfaces; or a sixteenth of the device's memory, if that is less.
    pub fn limit_idle(&self, bytes: u64) {
        self.cx.pool.limit_idle(bytes);
    }

    /// Bytes that are allocated on the device, and on the host for surfaces.
    ///
    /// # Errors
    /// What the device says.
    pub fn memory(&self) -> Result<DeviceMemory> {
        self.cx.reclaim()?;
        let memory = self.cx.pool.memory();
        Ok(DeviceMemory {
            lent: memory.lent + self.cx.blocks.borrow().bytes(),
            ..memory
        })
    }

    /// Bytes that [`Engine::upload`] will take for a field, min/max table included; the lengths of cells are some kilobytes more.
    pub fn upload_bytes(&self, grid: &Grid, sample_bytes: usize) -> u64 {
        let regions: u64 = grid.regions().iter().map(|&r| u64::from(r)).product();
        grid.sample_count() * sample_bytes as u64 + regions * 64 * size_of::<[f32; 2]>() as u64
    }

    /// Range and 256-bin histogram of a field (`Feature::None` or `Field`) or of a derived feature.
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

    /// Waits for what was started, and returns the time of each stage since the last call, pyramid or surface: whoever lets others use the
    /// device ([`crate::Cancel`]) keeps its own.
    ///
    /// # Errors
    /// What the device says.
    pub fn take_times(&self) -> Result<Vec<StageTime>> {
        self.cx.take_times()
    }

    /// Starts recording launches. New buffers are cleared from now on, so that what no kernel writes is the same in every run.
    #[cfg(feature = "testing")]
    pub fn record_launches(&self) {
        self.cx.recorder.start();
    }

    /// The launches since [`Engine::record_launches`] or the last call.
    #[cfg(feature = "testing")]
    pub fn take_launches(&self) -> Vec<crate::recorder::Launch> {
        self.cx.recorder.take()
    }
}
