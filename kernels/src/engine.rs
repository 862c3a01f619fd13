//! A device with its programs: loads volumes, builds pyramids, peels surfaces.

use std::sync::Arc;

use crate::activity::Activity;
use crate::buffer::{Buffer, DeviceMemory};
use crate::context::Context;
use crate::lock::lock;
use crate::program::{CompilerCheck, Gate};
use crate::stages;
use crate::stages::histogram::{self, HistogramWork};
use crate::stages::overview::{self, OverviewPart, OverviewValues};
use crate::{DeviceInfo, Error, Feature, Grid, Histogram, Result, SampleType, StageTime, Tuning, Volume, tables};

mod build;
pub(crate) mod cut;
mod distance_field;
mod evaluate;
pub(crate) mod fit;
mod generate;
mod mask;
mod measure;
pub(crate) mod peel;
pub(crate) mod query;
mod table;
mod tree;
pub(crate) mod tree_cut;
mod tree_levels;
mod tree_part;
pub(crate) mod tree_refine;
mod tree_vanish;
pub(crate) mod upload;
pub(crate) mod vertex_distances;
pub(crate) mod vertex_values;

/// A device, its queue and its programs. It may move between threads. If several use it at once, results are right, but times and peak
/// memory are mixed, and nothing is faster: all commands are in one queue.
pub struct Engine {
    pub(crate) cx: Context,
    pub(crate) cases: Buffer<u8>,
    pub(crate) case_facts: Buffer<u32>,
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
        Ok(Self { cx, cases, case_facts })
    }

    /// The device in use.
    pub fn device(&self) -> &DeviceInfo {
        &self.cx.found.info
    }

    /// What the engine does now, for another thread.
    pub fn activity(&self) -> Arc<Activity> {
        Arc::clone(&self.cx.activity)
    }

    /// Names of the programs that were built so far.
    pub fn programs(&self) -> Vec<String> {
        self.cx.programs.names()
    }

    /// Calls `gate` before a program is built. A call that needs a program that the gate does not allow yet fails with
    /// [`Error::ProgramUnchecked`], or with [`Error::Refused`] if the gate returns an error.
    pub fn set_gate(&self, gate: Gate) {
        self.cx.programs.set_gate(gate);
    }

    /// Calls `check` before the driver's compiler runs. If it returns an error, every call that needs a kernel that is not compiled yet
    /// fails with [`Error::Refused`].
    pub fn check_compiler(&self, check: CompilerCheck) {
        self.cx.programs.check_compiler(check);
    }

    /// Whether the device still works: reads one byte back from it.
    pub fn answers(&self) -> bool {
        self.cx.read("answers", &self.cases, 1).is_ok()
    }

    /// Names of the stages that have programs, in the order of execution.
    pub fn stages() -> impl Iterator<Item = &'static str> {
        stages::SOURCES.iter().map(|source| source.stage)
    }

    /// Builds the program of a stage for samples of a type. Otherwise it is built when the stage is first used.
    ///
    /// # Errors
    /// [`Error::Invalid`] if there is no such stage, [`Error::Build`], or an error of the device.
    pub fn build_stage(&self, stage: &str, sample_type: SampleType) -> Result<()> {
        let source = stages::SOURCES.iter().find(|source| source.stage == stage);
        let kernel = source.and_then(|source| source.kernel_names().next());
        let kernel = kernel.ok_or_else(|| Error::Invalid {
            what: "stage",
            why: format!("{stage:?} has no program"),
        })?;
        self.cx.kernel(sample_type, kernel)?;
        Ok(())
    }

    /// Limits the freed memory that is cached for the next surfaces to `bytes`, or to a sixteenth of the device's memory if that is less.
    pub fn limit_idle(&self, bytes: u64) {
        self.cx.pool.limit_idle(bytes);
    }

    /// Releases the cached freed memory to the driver.
    pub fn release_idle(&self) {
        self.cx.pool.release_idle();
    }

    /// Bytes that are allocated on the device, and on the host for surfaces.
    ///
    /// # Errors
    /// An error of the device.
    pub fn memory(&self) -> Result<DeviceMemory> {
        self.cx.reclaim()?;
        let memory = self.cx.pool.memory();
        Ok(DeviceMemory {
            lent: memory.lent + lock(&self.cx.blocks).bytes(),
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
    /// An error of the device.
    pub fn histogram(&self, volume: &Volume, feature: Feature<'_>) -> Result<Histogram> {
        let mut work = HistogramWork::default();
        loop {
            if let Some(histogram) = work.complete() {
                return Ok(histogram);
            }
            self.continue_histogram(volume, feature, &mut work)?;
        }
    }

    /// Does the next part of a histogram, one launch of some milliseconds. The parts before it may have been done by another engine.
    ///
    /// # Errors
    /// An error of the device; `work` is as before.
    pub fn continue_histogram(&self, volume: &Volume, feature: Feature<'_>, work: &mut HistogramWork) -> Result<()> {
        let (volume, feature) = match feature {
            Feature::Field(field) => (field, Feature::None),
            other => (volume, other),
        };
        histogram::step(&self.cx, volume, feature, work)
    }

    /// Returns the values of a part of an overview, one launch of some milliseconds. The parts before it may have been done by another
    /// engine.
    ///
    /// # Errors
    /// What the device says, or a volume of another size.
    pub fn overview_values(&self, volume: &Volume, part: &OverviewPart) -> Result<OverviewValues> {
        overview::values_of(&self.cx, volume, part)
    }

    /// Waits for the commands in flight, and returns the time of each stage since the last call, pyramid or surface. A job that pauses for
    /// others ([`crate::Cancel`]) calls this first, so that its times stay its own.
    ///
    /// # Errors
    /// An error of the device.
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
