//! Runs work to its end, with everything that it needs first, for a program that has the device for itself.

use isopeel_codec::encode::encoded_bytes;
use isopeel_kernels::{Cancel, HistogramWork, RectilinearGrid, check_cancelled};
use isopeel_view::View;
use isopeel_view::quality::{Budget, Fitted};
use isopeel_volumes::{ReadProgress, VolumeStep};

use super::WorkError;
use super::byte_search::{ByteSearch, Trial};
use super::context::{JobContext, WaitingWork};
use super::grids::padded_grid;
use super::host_memory::HostMemory;
use super::job_error::JobError;
use super::keys::{HistogramKey, VolumeKey};
use super::reading::{Piece, bytes_while_read, read};
use super::results::{Extraction, Making};
use super::workspace::Workspace;

/// Maximum attempts at a piece of work. One retry is not always enough: fields that the work needs may be evicted again if the device runs
/// out of memory.
const MAX_ATTEMPTS: usize = 6;

/// States that no other work waits for the workspace.
struct NoWaitingWork;

impl WaitingWork<Workspace> for NoWaitingWork {
    fn is_waiting(&self) -> bool {
        false
    }

    fn run(&mut self, _workspace: &mut Workspace) {}
}

impl Workspace {
    /// Runs a piece of work as long work. First loads or computes the fields and makes the histograms that it needs.
    ///
    /// # Errors
    /// Those of the work, [`WorkError::Unreadable`], and [`WorkError::NotKept`] if the fields do not stay on the device.
    pub fn run_to_completion<T>(
        &mut self,
        volume: &VolumeStep,
        cancel: &dyn Cancel,
        mut work: impl FnMut(&mut Self, &mut JobContext<'_, Self>) -> Result<T, JobError>,
    ) -> Result<T, WorkError> {
        let mut pin = None;
        for _ in 0..MAX_ATTEMPTS {
            match work(self, &mut JobContext::long(cancel, &mut NoWaitingWork)) {
                Ok(result) => return Ok(result),
                Err(JobError::NotResident { needed, budget }) => {
                    drop(pin.take());
                    pin = self.pins.try_pin(&needed, budget);
                    for (key, _) in &needed {
                        self.load(volume, key, cancel)?;
                    }
                }
                Err(JobError::NeedsHistograms(keys)) => {
                    drop(pin.take());
                    for key in &keys {
                        self.make_histogram(volume, key, cancel)?;
                    }
                }
                Err(error) => return Err(self.look_for_loss(error).into()),
            }
        }
        Err(WorkError::NotKept)
    }

    /// Makes the final surface of a view. A budget of bytes is that of the stream's chunks. The surface has no more triangles than the
    /// host's memory allows.
    ///
    /// # Errors
    /// [`WorkError`].
    pub fn surface(
        &mut self,
        volume: &VolumeStep,
        view: &View,
        making: Making,
        cancel: &(dyn Cancel + Sync),
    ) -> Result<Extraction, WorkError> {
        let mut view = view.clone();
        if let (Some(Budget::Bytes(bytes)), None) = (view.budget, view.fitted) {
            view.fitted = Some(self.fit_bytes(volume, &view, bytes, making.ceiling, cancel)?);
        }
        match self.surface_now(volume, &view, making, cancel) {
            Err(WorkError::HostBusy { needed_bytes }) => {
                self.make_host_space(needed_bytes)?;
                self.surface_now(volume, &view, making, cancel)
            }
            outcome => outcome,
        }
    }

    /// As [`Workspace::surface`], within the host's memory that is available now.
    fn surface_now(
        &mut self,
        volume: &VolumeStep,
        view: &View,
        making: Making,
        cancel: &dyn Cancel,
    ) -> Result<Extraction, WorkError> {
        let memory = HostMemory::now();
        let limited = Making {
            ceiling: making.ceiling.min(memory.triangles()),
            ..making
        };
        self.run_to_completion(volume, cancel, |workspace, context| {
            workspace.extract(volume, view, limited, context)
        })
        .map_err(|error| memory.explain(error, making.ceiling))
    }

    /// Finds the fit that keeps a budget of bytes.
    fn fit_bytes(
        &mut self,
        volume: &VolumeStep,
        view: &View,
        budget: u64,
        ceiling: u64,
        cancel: &(dyn Cancel + Sync),
    ) -> Result<Fitted, WorkError> {
        let mut search = ByteSearch::new(budget);
        let making = Making {
            ceiling,
            measures: false,
            ..Making::default()
        };
        while let Some(trial_view) = search.next_trial(view, ceiling) {
            let extraction = match self.surface(volume, &trial_view, making, cancel) {
                Ok(extraction) => extraction,
                Err(error) => {
                    search.refuse(error)?;
                    continue;
                }
            };
            let Some(fitted) = search.new_fit(&extraction.view) else {
                break;
            };
            let bytes = encoded_bytes(&extraction.surface, &|| cancel.is_cancelled())
                .inspect_err(|error| tracing::error!(%error, "a surface could not be encoded"))
                .map_err(|_| WorkError::Stopped)?;
            let bytes = bytes.ok_or(WorkError::Cancelled)?;
            search.add(fitted, Trial::new(&extraction.surface, bytes));
        }
        search.end()
    }

    /// Makes a field resident: computes it on the device, or reads it. A file whose samples are padded or masked is read as a whole before
    /// `cancel` is polled again.
    ///
    /// # Errors
    /// [`WorkError`].
    pub fn load(&mut self, volume: &VolumeStep, key: &VolumeKey, cancel: &dyn Cancel) -> Result<(), WorkError> {
        if self.is_resident(key) {
            return Ok(());
        }
        let is_computed = key.is_computed(volume)
            && self.run_to_completion(volume, cancel, |workspace, context| {
                workspace.compute(volume, key, None, context)
            })?;
        if is_computed {
            return Ok(());
        }
        let loaded = match self.transfer(volume, key, cancel) {
            // Retries once: the samples need another type, or the file changed while it was read.
            Err(JobError::Failed(WorkError::Unreadable(error))) if error.can_retry => {
                self.transfer(volume, key, cancel)
            }
            outcome => outcome,
        };
        loaded.map_err(|error| self.look_for_loss(error).into())
    }

    /// Reads a field and sends it to the device.
    fn transfer(&mut self, volume: &VolumeStep, key: &VolumeKey, cancel: &dyn Cancel) -> Result<(), JobError> {
        let grid = padded_grid(volume, key.padded)?;
        self.make_host_space(bytes_while_read(volume, key, self.engine().device().kind)?)?;
        let (mut sent, mut is_first) = (Ok(()), true);
        let read = read(volume, key, &ReadProgress::default(), &mut |piece| {
            // After a failure the reader may still send a few pieces, which are dropped.
            if sent.is_ok() {
                sent = check_cancelled(cancel)
                    .map_err(JobError::from)
                    .and_then(|()| self.send_piece(key, &grid, &piece, std::mem::take(&mut is_first)));
            }
            sent.is_ok()
        });
        let loaded = sent
            .and(read.map_err(JobError::from))
            .and_then(|()| self.complete_upload(key, cancel));
        if loaded.is_err() {
            self.drop_upload(key);
        }
        loaded
    }

    /// Sends a piece of a field to the device. `is_first`: begins the upload.
    fn send_piece(
        &mut self,
        key: &VolumeKey,
        grid: &RectilinearGrid,
        piece: &Piece,
        is_first: bool,
    ) -> Result<(), JobError> {
        if is_first {
            self.begin_upload(key.clone(), grid, piece.samples.sample_type(), piece.missing)?;
        }
        self.continue_upload(key, &piece.samples)
    }

    /// Makes the table of minima and maxima of an uploaded field, and makes the field resident.
    fn complete_upload(&mut self, key: &VolumeKey, cancel: &dyn Cancel) -> Result<(), JobError> {
        while !self.continue_table(key)? {
            check_cancelled(cancel)?;
        }
        self.finish_upload(key.clone(), false)
    }

    /// Makes a histogram.
    fn make_histogram(
        &mut self,
        volume: &VolumeStep,
        key: &HistogramKey,
        cancel: &dyn Cancel,
    ) -> Result<(), WorkError> {
        let mut work = HistogramWork::default();
        self.run_to_completion(volume, cancel, |workspace, _| {
            while workspace.continue_histogram(volume, key, &mut work)?.is_none() {
                check_cancelled(cancel)?;
            }
            Ok(())
        })
    }
}
