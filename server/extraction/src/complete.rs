//! Work with all that it needs, at once, for a program that has the device for itself.

use isopeel_codec::encode::encoded_bytes;
use isopeel_kernels::{Cancel, HistogramWork, RectilinearGrid};
use isopeel_view::View;
use isopeel_view::quality::{Budget, Fitted, TriangleBudget};
use isopeel_volumes::{ReadProgress, VolumeStep};

use super::WorkError;
use super::byte_search::{ByteSearch, Trial};
use super::context::{JobContext, Others};
use super::grids::padded_grid;
use super::keys::{HistogramKey, VolumeKey};
use super::reading::{Piece, bytes_while_read, read};
use super::results::{Extraction, Making, Refining};
use super::workspace::{JobError, Workspace};

/// How often work is tried before it fails: fields that it needs may be evicted again if the device runs out of memory.
const MAX_ATTEMPTS: usize = 6;

/// Nobody waits for the workspace.
struct Alone;

impl Others<Workspace> for Alone {
    fn are_waiting(&self) -> bool {
        false
    }

    fn run(&mut self, _workspace: &mut Workspace) {}
}

impl Workspace {
    /// Does a piece of work and all that it needs: loads or computes fields, makes histograms, takes as long as it takes.
    ///
    /// # Errors
    /// Those of the work, [`WorkError::Unreadable`], and [`WorkError::Busy`] if the fields do not stay on the device.
    pub fn complete<T>(
        &mut self,
        volume: &VolumeStep,
        cancel: &dyn Cancel,
        work: impl Fn(&mut Self, &mut JobContext<'_, Self>) -> Result<T, JobError>,
    ) -> Result<T, WorkError> {
        let mut _pin = None;
        for _ in 0..MAX_ATTEMPTS {
            match work(self, &mut JobContext::long(cancel, &mut Alone)) {
                Ok(result) => return Ok(result),
                Err(JobError::NotResident { needed, budget }) => {
                    _pin = self.pins.try_pin(&needed, budget);
                    for (key, _) in &needed {
                        self.load(volume, key, cancel)?;
                    }
                }
                Err(JobError::NeedsHistograms(keys)) => {
                    for key in &keys {
                        self.make_histogram(volume, key, cancel)?;
                    }
                }
                Err(error) => return Err(error.into()),
            }
        }
        Err(WorkError::Busy)
    }

    /// Makes the final surface of a view, of at most `ceiling_triangles`, and measures its error if `measures` says so. A budget of bytes
    /// is that of the stream's chunks.
    ///
    /// # Errors
    /// [`WorkError`].
    pub fn surface(
        &mut self,
        volume: &VolumeStep,
        view: &View,
        ceiling_triangles: u64,
        measures: bool,
        cancel: &dyn Cancel,
    ) -> Result<Extraction, WorkError> {
        let mut view = view.clone();
        if let (Some(Budget::Bytes(bytes)), None) = (view.budget, view.fitted) {
            view.fitted = Some(self.fit_bytes(volume, &view, bytes, ceiling_triangles, cancel)?);
        }
        let making = Making {
            ceiling: ceiling_triangles,
            measures,
            refining: Refining::Never,
        };
        self.complete(volume, cancel, |workspace, context| {
            workspace.extract(volume, &view, making, context)
        })
    }

    /// Finds the fit that keeps a budget of bytes.
    fn fit_bytes(
        &mut self,
        volume: &VolumeStep,
        view: &View,
        budget: u64,
        ceiling_triangles: u64,
        cancel: &dyn Cancel,
    ) -> Result<Fitted, WorkError> {
        let mut search = ByteSearch::new(budget);
        while let Some(triangles) = search.next_triangles() {
            let trial = View {
                budget: Some(Budget::Triangles(TriangleBudget::AtMost(
                    triangles.min(ceiling_triangles),
                ))),
                fitted: None,
                ..view.clone()
            };
            let Extraction { surface, view, .. } = match self.surface(volume, &trial, ceiling_triangles, false, cancel)
            {
                Err(WorkError::OverBudget { minimum, .. }) if minimum > triangles => {
                    search.refuse(minimum);
                    continue;
                }
                made => made?,
            };
            let Some(fitted) = view.fitted.filter(|fitted| search.is_new(fitted)) else {
                break;
            };
            let trial = Trial {
                triangles: surface.statistics.triangles,
                regions: surface.regions.len() as u64,
                // Encoding takes less time than making the surface.
                bytes: encoded_bytes(&surface, &|| false)
                    .inspect_err(|error| tracing::error!(%error, "a surface could not be encoded"))
                    .ok()
                    .flatten()
                    .ok_or(WorkError::Stopped)?,
            };
            search.add(fitted, trial);
        }
        search.end()
    }

    /// Makes a field resident: computes it on the device, or reads it.
    ///
    /// # Errors
    /// [`WorkError`].
    pub fn load(&mut self, volume: &VolumeStep, key: &VolumeKey, cancel: &dyn Cancel) -> Result<(), WorkError> {
        if self.is_resident(key) {
            return Ok(());
        }
        let progress = ReadProgress::default();
        let is_made = key.recipe(volume).is_some()
            && self.complete(volume, cancel, |workspace, context| {
                workspace.compute(volume, key, &progress, None, context)
            })?;
        if is_made {
            return Ok(());
        }
        match self.transfer(volume, key, cancel) {
            // Once more: the samples need another type, or the file changed while it was read.
            Err(WorkError::Unreadable(error)) if error.again => self.transfer(volume, key, cancel),
            outcome => outcome,
        }
    }

    /// Reads a field and sends it to the device.
    fn transfer(&mut self, volume: &VolumeStep, key: &VolumeKey, cancel: &dyn Cancel) -> Result<(), WorkError> {
        let grid = padded_grid(volume, key.padded)?;
        self.make_host_space(bytes_while_read(volume, key, self.engine().device().kind)?)?;
        let (mut sent, mut is_first) = (Ok(()), true);
        let read = read(volume, key, &ReadProgress::default(), &mut |piece| {
            sent = match cancel.is_cancelled() {
                true => Err(WorkError::Cancelled.into()),
                false => self.send(key, &grid, &piece, std::mem::take(&mut is_first)),
            };
            sent.is_ok()
        });
        let loaded = sent.map_err(WorkError::from).and(read).and_then(|()| {
            while !self.continue_table(key)? {}
            Ok(self.finish_upload(key.clone(), false)?)
        });
        if loaded.is_err() {
            self.drop_upload(key);
        }
        loaded
    }

    fn send(&mut self, key: &VolumeKey, grid: &RectilinearGrid, piece: &Piece, is_first: bool) -> Result<(), JobError> {
        if is_first {
            self.begin_upload(key.clone(), grid, piece.samples.sample_type(), piece.missing)?;
        }
        self.continue_upload(key, &piece.samples)
    }

    /// Makes a histogram.
    fn make_histogram(
        &mut self,
        volume: &VolumeStep,
        key: &HistogramKey,
        cancel: &dyn Cancel,
    ) -> Result<(), WorkError> {
        let mut work = HistogramWork::default();
        loop {
            let slice = std::cell::RefCell::new(work.clone());
            let histogram = self.complete(volume, cancel, |workspace, _| {
                workspace.continue_histogram(volume, key, &mut slice.borrow_mut())
            })?;
            if histogram.is_some() {
                return Ok(());
            }
            work = slice.into_inner();
        }
    }
}
