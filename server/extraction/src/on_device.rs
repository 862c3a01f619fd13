//! A view on the device, with the data that work on its surface uses.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use isopeel_geometry::IndexSpace;
use isopeel_kernels::{
    Cancel, CutParams, Engine, Error, Isovalue, Level, Pyramid, Region, StageTime, Surface, ValuesOf, Volume,
};
use isopeel_view::View;
use isopeel_volumes::VolumeStep;
use rayon::ThreadPool;

use super::WorkError;
use super::context::{JobContext, JobTimes};
use super::cuts::Cuts;
use super::dataset_views::view_space;
use super::identity::PyramidKey;
use super::job_error::JobError;
use super::keys::color_key;
use super::observer::Observer;
use super::workspace::{Trees, Workspace};

/// The data that a job on a view uses on the device: volume, pyramid and caches.
pub(crate) struct OnDevice<'a> {
    pub engine: &'a Engine,
    /// `cuts` and `trees` are locked for one statement only: other jobs lock them in a pause, on the same thread.
    pub cuts: &'a Mutex<Cuts>,
    pub trees: &'a Mutex<Trees>,
    /// Key of the pyramid and its tree.
    pub key: PyramidKey,
    pub volume: &'a Volume,
    pub pyramid: &'a Pyramid,
    /// The field whose values accompany the surface, and how they are found.
    colors: Option<(Arc<Volume>, ValuesOf)>,
    /// Whether the pyramid was cached before the job.
    was_cached: bool,
    /// Whether the work may take long. Only such work pauses.
    pub may_take_long: bool,
    job_times: &'a JobTimes,
    pub observer: &'a dyn Observer,
    /// Pool for long work on the host's processors; `None`: rayon's own.
    pub long_work: Option<&'a ThreadPool>,
    /// Parameters of the view as it was before the job.
    pub params: CutParams,
    /// The smallest spacing, in world units. It is the unit of lengths on the device.
    pub smallest: f64,
    pub index_space: IndexSpace,
}

impl OnDevice<'_> {
    /// Returns the parameters of a view that has been fitted since the job began.
    pub(crate) fn params_of(&self, view: &View) -> CutParams {
        view.cut_params(self.smallest, &self.index_space)
            .unwrap_or_else(|| self.params.clone())
    }

    /// Returns the time since `start` without the time of other jobs that ran during pauses.
    pub(crate) fn time_without_pauses(&self, start: Instant) -> Duration {
        self.job_times.time_without_pauses(start)
    }

    /// Sets the values of the view's field for colours at the vertices of regions, if there is one.
    pub(crate) fn set_values(&self, regions: &mut [Region], cancel: &dyn Cancel) -> Result<(), Error> {
        match &self.colors {
            Some((field, values)) => self.engine.vertex_values(field, *values, regions, cancel),
            None => Ok(()),
        }
    }

    /// Sets the values for colours. Adds to the surface's stages those that the job ran before its last pause. If the job has built the
    /// pyramid, the pyramid's stages come first. Reports all stages to the observer.
    pub(crate) fn complete(&self, mut surface: Surface, cancel: &dyn Cancel) -> Result<Surface, WorkError> {
        self.set_values(&mut surface.regions, cancel)?;
        let stages = &mut surface.statistics.stages;
        if self.colors.is_some() {
            stages.extend(self.engine.take_times()?);
        }
        self.job_times.complete(stages);
        stages.splice(0..0, self.new_pyramid_stages().iter().cloned());
        for stage in stages.iter() {
            self.observer.stage(stage.stage, stage.milliseconds);
        }
        Ok(surface)
    }

    /// Returns the stages of the pyramid if this job has built it, else none.
    pub(crate) fn new_pyramid_stages(&self) -> &[StageTime] {
        if self.was_cached { &[] } else { self.pyramid.stages() }
    }
}

/// Which nodes of a pyramid a job needs.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Nodes {
    /// Only nodes that can be leaves of the view's cut.
    OfTheView,
    /// All nodes, because the job cuts coarse prefixes too, and the next edit changes the cut.
    All,
}

impl Workspace {
    /// Runs `work` with the volume and the pyramid of a view. If the device runs out of memory, frees caches and retries once. Pins the
    /// volumes of a long job, if there is space for them beside the volumes that are pinned already.
    pub(crate) fn with_pyramid<T>(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        nodes: Nodes,
        context: &mut JobContext<'_, Self>,
        work: impl Fn(&OnDevice<'_>, &mut View, &dyn Cancel) -> Result<T, JobError>,
    ) -> Result<T, JobError> {
        let keys = self.require(volume, view)?;
        self.resolve(volume, view)?;
        let _pin = match context.may_take_long() {
            true => self.pins.try_pin(&self.bytes_of(volume, &keys)?, self.volumes.budget()),
            false => None,
        };
        match self.try_with_pyramid(volume, view, nodes, context, &work) {
            Err(JobError::Failed(
                WorkError::Device(Error::OutOfDeviceMemory { .. }) | WorkError::NoTree(Error::OutOfDeviceMemory { .. }),
            )) if self.free_all_but(&keys) => self.try_with_pyramid(volume, view, nodes, context, &work),
            outcome => outcome,
        }
    }

    /// As [`Workspace::with_pyramid`], without a retry.
    fn try_with_pyramid<T>(
        &mut self,
        volume: &VolumeStep,
        view: &mut View,
        nodes: Nodes,
        context: &mut JobContext<'_, Self>,
        work: &impl Fn(&OnDevice<'_>, &mut View, &dyn Cancel) -> Result<T, JobError>,
    ) -> Result<T, JobError> {
        let iso: Isovalue = view.iso.ok_or_else(WorkError::no_finite_sample)?;
        let smallest = volume.dataset().smallest_length();
        let (_, index_space) = view_space(volume.dataset(), view);
        let params = view
            .cut_params(smallest, &index_space)
            .ok_or_else(WorkError::no_finite_sample)?;
        let key = PyramidKey::new(volume, view);
        let shown_volume = self
            .volumes
            .peek(key.samples())
            .map(Arc::clone)
            .ok_or(WorkError::Stopped)?;
        // Fitting a budget needs the whole pyramid.
        let cells_suffice = nodes == Nodes::OfTheView && params.is_full(Level::FINEST) && view.budget.is_none();
        let is_cached = self
            .pyramids
            .get(&key)
            .is_some_and(|cached| cells_suffice || cached.is_whole());
        self.observer.looked_up("pyramid", is_cached);
        let colors = color_key(volume, view).map(|key| {
            let field = self.volumes.peek(&key).map(Arc::clone).ok_or(WorkError::Stopped)?;
            let values = ValuesOf {
                padding: u32::from(view.cap),
                nearest: key.field_of(volume)?.has_labels(),
            };
            Ok::<_, JobError>((field, values))
        });
        let colors = colors.transpose()?;
        let (engine, cuts, trees) = (self.shared_engine(), Arc::clone(&self.cuts), Arc::clone(&self.trees));
        let (observer, long_work) = (Arc::clone(&self.observer), self.long_work.clone());
        // An error is ignored here: if the device failed, the job's next launch reports it.
        let take_times = || engine.take_times().unwrap_or_default();
        let job_times = JobTimes::default();
        // A cancelled job has left its times.
        take_times();
        if !is_cached {
            let feature = self.feature_fields(volume, &view.feature, view.cap)?;
            let pyramid = context.run(self, &take_times, &job_times, |cancel| match cells_suffice {
                true => engine.build_cells(&shown_volume, feature.get(), iso, cancel),
                false => engine.build_pyramid(&shown_volume, feature.get(), iso, cancel),
            })?;
            // In a pause, another job may have cached the whole pyramid and its tree, which must not be replaced.
            if self.pyramids.peek(&key).is_none_or(|cached| !cached.is_whole()) {
                self.pyramids
                    .insert(key.clone(), pyramid.device_bytes(), Arc::new(pyramid));
            }
        }
        let pyramid = self.pyramids.peek(&key).map(Arc::clone).ok_or(WorkError::Stopped)?;
        let job = OnDevice {
            engine: &engine,
            cuts: &cuts,
            trees: &trees,
            key,
            volume: &shown_volume,
            pyramid: &pyramid,
            colors,
            was_cached: is_cached,
            may_take_long: context.may_take_long(),
            job_times: &job_times,
            observer: &*observer,
            long_work: long_work.as_deref(),
            params,
            smallest,
            index_space,
        };
        context.run(self, &take_times, &job_times, |cancel| work(&job, view, cancel))
    }
}
