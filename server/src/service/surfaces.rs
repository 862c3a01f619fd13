//! Requests about the surface of a view: resolves the view, counts, makes and measures its surface, and answers questions about it. A
//! surface stays within its budget of bytes, the triangle limit of the handle, and the memory of the host.

use std::time::{Duration, Instant};

use isopeel_codec::encode::encoded_bytes;
use isopeel_extraction::{
    Answer, Ask, ByteSearch, Count, ExportWork, Extract, Extraction, FullCount, HostMemory, Improve, MakeHostSpace,
    Making, Measure, MeasuredError, Measurement, Measuring, Prepare, Question, Refine, Refinement, Refining, Resolve,
    ShownSurface, Step, Trial, WorkError,
};
use isopeel_kernels::Surface;
use isopeel_view::View;
use isopeel_view::quality::{Budget, Fitted, MesherName};
use isopeel_volumes::VolumeStep;
use tokio_util::sync::CancellationToken;

use super::scheduler::Caller;
use super::worker::DeviceWorker;
use crate::error::chain;
use crate::pool;

impl DeviceWorker {
    /// Fills in values that depend on the data: the default isovalue and the feature's own range. Cancelling `token` or dropping the future
    /// cancels the job before its next stage.
    ///
    /// # Errors
    /// [`WorkError`].
    pub async fn resolve(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> Result<View, WorkError> {
        let (volume, view) = (volume.clone(), view.clone());
        self.perform(Caller::Viewer, Resolve { volume, view }, token).await
    }

    /// As [`DeviceWorker::resolve`], and loads the fields that the view's surface is made of.
    ///
    /// # Errors
    /// [`WorkError`]; [`WorkError::Edit`] if there is no isovalue to choose, or a computed field has no values.
    pub async fn prepare(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> Result<View, WorkError> {
        let (volume, view) = (volume.clone(), view.clone());
        self.perform(Caller::Viewer, Prepare { volume, view }, token).await
    }

    /// Counts the triangles of the full surface of a view.
    ///
    /// # Errors
    /// The device's errors.
    pub async fn count(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> Result<FullCount, WorkError> {
        let (volume, view) = (volume.clone(), view.clone());
        self.perform(Caller::Viewer, Count { volume, view }, token).await
    }

    /// Makes the next step from the surface that a client shows to the surface of a view. A budget of bytes that is not fitted yet is
    /// fitted first, which makes whole surfaces; the fit is in the view of the result.
    ///
    /// # Errors
    /// [`WorkError::TooManyTriangles`] if the final surface has more triangles than the handle allows, [`WorkError::HostBusy`] if the host
    /// has no memory for it, [`WorkError::OverBytes`] if no surface keeps the budget of bytes, and the device's errors.
    pub async fn refine(
        &self,
        volume: &VolumeStep,
        view: &View,
        step: Step,
        token: &CancellationToken,
    ) -> Result<Refinement, WorkError> {
        let view = self.with_fitted_bytes(Caller::Viewer, volume, view, token).await?;
        self.within_memory(|ceiling| {
            let request = Refine {
                volume: volume.clone(),
                view: view.clone(),
                step,
                ceiling,
            };
            self.perform(Caller::Viewer, request, token)
        })
        .await
    }

    /// Makes the final surface of a view again, as a cut of the vertex tree. This is for a viewer at rest, because building the tree takes
    /// longer. `view`: the view of the final step, whose budget is fitted. `None` if there is no better surface.
    ///
    /// # Errors
    /// As [`DeviceWorker::refine`], without those of a budget of bytes.
    pub async fn improve(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> Result<Option<Refinement>, WorkError> {
        self.within_memory(|ceiling| {
            let request = Improve {
                volume: volume.clone(),
                view: view.clone(),
                ceiling,
            };
            self.perform(Caller::Viewer, request, token)
        })
        .await
    }

    /// Measures how far the final surface of a view, whose budget is fitted, is from the undecimated one. `None` for surfaces of the
    /// marching-cubes mesher, and if the surface has no triangles.
    ///
    /// # Errors
    /// The device's errors.
    pub async fn measure(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> Result<Option<Measurement>, WorkError> {
        self.measure_for(Caller::Viewer, volume, view, token).await
    }

    async fn measure_for(
        &self,
        caller: Caller,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> Result<Option<Measurement>, WorkError> {
        if view.mesher != MesherName::Dual {
            return Ok(None);
        }
        let (volume, view) = (volume.clone(), view.clone());
        self.perform(caller, Measure { volume, view }, token).await
    }

    /// Makes the final surface of a view for an export, and measures its error.
    ///
    /// # Errors
    /// As [`DeviceWorker::refine`].
    pub async fn extract(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> Result<Extraction, WorkError> {
        let work = ExportWork {
            measuring: Measuring::Always,
            refining: Refining::Never,
        };
        self.extract_with(volume, view, work, token).await
    }

    /// As [`DeviceWorker::extract`], measured and refined as `work` says. If measuring takes longer than allowed, the surface is returned
    /// without its error.
    ///
    /// # Errors
    /// As [`DeviceWorker::refine`].
    pub async fn extract_with(
        &self,
        volume: &VolumeStep,
        view: &View,
        work: ExportWork,
        token: &CancellationToken,
    ) -> Result<Extraction, WorkError> {
        let start = Instant::now();
        let fitted_view = self.with_fitted_bytes(Caller::Request, volume, view, token).await?;
        let fit_time = if fitted_view.fitted == view.fitted {
            Duration::ZERO
        } else {
            start.elapsed()
        };
        let making = Making {
            measures: work.measuring == Measuring::Always,
            refining: work.refining,
            ..Making::default()
        };
        let mut extraction = self
            .extract_within_memory(Caller::Request, volume, &fitted_view, making, token)
            .await?;
        extraction.wall += fit_time;
        if let Measuring::Within(limit) = work.measuring {
            // The time-out drops the future, which cancels the job.
            let error = self.measure_extraction(&extraction, volume, making, token);
            match tokio::time::timeout(limit, error).await {
                Ok(Ok(error)) => extraction.measured = error,
                Ok(Err(error)) if error.is_cancelled() => return Err(error),
                // The surface is valid without the figure.
                Ok(Err(error)) => tracing::warn!(error = chain(&error), "the error of an export could not be measured"),
                Err(_) => {}
            }
        }
        Ok(extraction)
    }

    /// Measures the error of a surface that was made as `making` says; `None` as for [`DeviceWorker::measure`].
    async fn measure_extraction(
        &self,
        extraction: &Extraction,
        volume: &VolumeStep,
        making: Making,
        token: &CancellationToken,
    ) -> Result<Option<MeasuredError>, WorkError> {
        let view = &extraction.view;
        // A refined cut is not cached, so the surface is made again and measured.
        if extraction.refined.is_some() {
            let with_measure = Making {
                measures: true,
                ..making
            };
            let extraction = self
                .extract_within_memory(Caller::Request, volume, view, with_measure, token)
                .await?;
            return Ok(extraction.statistics(volume, "").error);
        }
        let measured = self.measure_for(Caller::Request, volume, view, token).await?;
        Ok(measured.map(|measurement| measurement.whole))
    }

    /// Answers a question about the surface that a viewer is shown. If no surface is shown, a probe is answered for the volume alone.
    /// `token` as in [`DeviceWorker::resolve`].
    ///
    /// # Errors
    /// [`WorkError`].
    pub async fn answer(
        &self,
        volume: &VolumeStep,
        shown: Option<&ShownSurface>,
        question: Question,
        token: &CancellationToken,
    ) -> Result<Answer, WorkError> {
        let request = Ask {
            volume: volume.clone(),
            shown: shown.cloned(),
            question,
        };
        self.perform(Caller::Viewer, request, token).await
    }

    /// Returns the view. If it has a budget of bytes that is not fitted yet, adds the fit: the threshold that keeps the budget.
    async fn with_fitted_bytes(
        &self,
        caller: Caller,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> Result<View, WorkError> {
        let mut view = view.clone();
        if let (Some(Budget::Bytes(bytes)), None) = (view.budget, view.fitted) {
            view.fitted = Some(self.fit_bytes(caller, volume, &view, bytes, token).await?);
        }
        Ok(view)
    }

    /// Finds how many triangles, and thus which error threshold, take `budget` bytes on the wire: makes a surface, measures its bytes and
    /// corrects the estimate.
    ///
    /// # Errors
    /// [`WorkError::OverBytes`] if no surface keeps the budget, and the device's errors.
    async fn fit_bytes(
        &self,
        caller: Caller,
        volume: &VolumeStep,
        view: &View,
        budget: u64,
        token: &CancellationToken,
    ) -> Result<Fitted, WorkError> {
        let mut search = ByteSearch::new(budget);
        while let Some(trial_view) = search.next_trial(view, self.ceiling) {
            let making = Making {
                measures: false,
                ..Making::default()
            };
            let extraction = match self
                .extract_within_memory(caller, volume, &trial_view, making, token)
                .await
            {
                Ok(extraction) => extraction,
                Err(error) => {
                    // A surface that is too large is a result of the search; other errors end it.
                    search.refuse(error)?;
                    continue;
                }
            };
            // A fit that was tried before means that the search has converged.
            let Some(fitted) = search.new_fit(&extraction.view) else {
                break;
            };
            let unencoded = Trial::new(&extraction.surface, 0);
            let bytes = self.count_bytes(extraction.surface, caller, token).await?;
            search.add(fitted, Trial { bytes, ..unencoded });
        }
        search.end()
    }

    /// Makes the final surface of a view, within the limits of [`DeviceWorker::within_memory`].
    async fn extract_within_memory(
        &self,
        caller: Caller,
        volume: &VolumeStep,
        view: &View,
        making: Making,
        token: &CancellationToken,
    ) -> Result<Extraction, WorkError> {
        self.within_memory(|ceiling| {
            let request = Extract {
                volume: volume.clone(),
                view: view.clone(),
                making: Making { ceiling, ..making },
            };
            self.perform(caller, request, token)
        })
        .await
    }

    /// Calls `make` with the maximum triangles of a surface: the minimum of the handle's limit and what fits into the host's memory. If the
    /// memory is too small, evicts caches and retries once.
    async fn within_memory<T, F>(&self, make: impl Fn(u64) -> F) -> Result<T, WorkError>
    where
        F: Future<Output = Result<T, WorkError>>,
    {
        let try_now = async || {
            let memory = HostMemory::now();
            let outcome = make(self.ceiling.min(memory.triangles())).await;
            // If the triangles exceed the host's memory but not the limit of the handle, the error is `HostBusy`.
            outcome.map_err(|error| memory.explain(error, self.ceiling))
        };
        match try_now().await {
            Err(WorkError::HostBusy { needed_bytes }) => {
                self.run_for_cache(MakeHostSpace { bytes: needed_bytes }).await?;
                try_now().await
            }
            outcome => outcome,
        }
    }

    /// Returns the bytes of a surface's chunks, encoded on the pool of this caller.
    async fn count_bytes(&self, surface: Surface, caller: Caller, token: &CancellationToken) -> Result<u64, WorkError> {
        let token = token.clone();
        let count = move || encoded_bytes(&surface, &|| token.is_cancelled());
        let counted = match caller {
            Caller::Request => pool::run_export(count).await,
            Caller::Viewer | Caller::Cache => pool::run(count).await,
        };
        match counted {
            Ok(Ok(bytes)) => bytes.ok_or(WorkError::Cancelled),
            Ok(Err(error)) => {
                tracing::error!(%error, "a surface could not be encoded");
                Err(WorkError::Stopped)
            }
            Err(_) => Err(WorkError::Stopped),
        }
    }
}
