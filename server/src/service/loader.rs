//! Loads fields onto the device, and frees the fields of a time step. Files are read on tokio's blocking pool, never on the device's
//! thread, and uploaded in pieces.

use std::pin::Pin;
use std::sync::Arc;
use std::time::Instant;

use isopeel_extraction::{
    BeginUpload, Compute, ContinueTable, ContinueUpload, DropUpload, FindResident, FinishUpload, HostMemory,
    MakeHostSpace, Piece, Release, VolumeKey, WorkError, bytes_while_read, padded_grid, read,
};
use isopeel_kernels::{RectilinearGrid, Samples};
use isopeel_volumes::{PIECE_SAMPLES, ReadProgress, VolumeStep};
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use super::loading::FieldLoad;
use super::scheduler::Caller;
use super::worker::DeviceWorker;
use crate::pool::ReadPool;

/// Maximum number of samples in one request. Some readers have a volume in one piece, for which other requests would wait.
const REQUEST_SAMPLES: usize = 4 * PIECE_SAMPLES;

/// Why a field is loaded.
#[derive(Clone, Copy)]
enum Purpose {
    /// A caller waits for the field.
    Now,
    /// Read-ahead: a caller may need the field later.
    Ahead { budget: u64 },
}

impl DeviceWorker {
    /// Makes a field resident. Loads are single-flight: callers of the same field wait for one load. If all callers leave, the load is
    /// cancelled, as [`FieldLoad::wait`] says.
    pub(super) async fn load(&self, volume: &VolumeStep, key: VolumeKey) -> Result<(), WorkError> {
        let arrived = Instant::now();
        let load = self.shared.loads.get_or_insert(&key);
        let _waiting = load.wait();
        let guard = Arc::clone(&load.lock).try_lock_owned();
        if guard.is_ok() {
            load.restart();
        }
        if let Some(watch) = &self.watch {
            watch.load_requested(&key, &load.progress);
        }
        let guard = match guard {
            Ok(guard) => guard,
            Err(_) => Arc::clone(&load.lock).lock_owned().await,
        };
        if let Some(error) = load.failure_since(arrived) {
            return Err(error.into());
        }
        let (worker, volume, task_key) = (self.clone(), volume.clone(), key.clone());
        let task_load = Arc::clone(&load);
        let task = tokio::spawn(async move {
            let _guard = guard;
            worker.load_locked(&volume, task_key, &task_load, Purpose::Now).await
        });
        let outcome = task.await.unwrap_or(Err(WorkError::Stopped));
        if let (Ok(()), Some(watch)) = (&outcome, &self.watch) {
            watch.field_loaded(&key);
        }
        outcome
    }

    /// Makes a field resident before a viewer needs it, unless a load of the field is running already. Callers that need the field
    /// meanwhile wait for this load. If `token` is cancelled, the load continues as long as such callers wait.
    pub(super) async fn load_ahead(
        &self,
        volume: &VolumeStep,
        key: VolumeKey,
        budget: u64,
        token: &CancellationToken,
    ) -> Result<(), WorkError> {
        let load = self.shared.loads.get_or_insert(&key);
        let Ok(guard) = Arc::clone(&load.lock).try_lock_owned() else {
            return Ok(());
        };
        let (worker, volume, token) = (self.clone(), volume.clone(), token.clone());
        let task = tokio::spawn(async move {
            let _guard = guard;
            let waiting = load.wait();
            let purpose = Purpose::Ahead { budget };
            let work = worker.load_locked(&volume, key, &load, purpose);
            tokio::pin!(work);
            tokio::select! {
                outcome = &mut work => return outcome,
                // The load continues as long as other callers wait for it.
                () = token.cancelled() => drop(waiting),
            }
            work.await
        });
        task.await.unwrap_or(Err(WorkError::Stopped))
    }

    /// Makes a field resident, if it is not: computes it on the device, or reads it. The caller must hold the lock of the load.
    async fn load_locked(
        &self,
        volume: &VolumeStep,
        key: VolumeKey,
        load: &FieldLoad,
        purpose: Purpose,
    ) -> Result<(), WorkError> {
        let keys = vec![key.clone()];
        if self.run_for_cache(FindResident { keys }).await? == [true] {
            return Ok(());
        }
        // Callers that waited for an earlier load of this field have the same progress until here.
        if !load.restart() {
            return Err(WorkError::Cancelled);
        }
        let is_computed = matches!(purpose, Purpose::Now) && key.is_computed(volume);
        if is_computed && self.compute(volume, key.clone(), load.token()).await? {
            return Ok(());
        }
        let permits = Arc::clone(&self.shared.loads.permits);
        let _permit = permits.acquire_owned().await.map_err(|_| WorkError::Stopped)?;
        let mut outcome = self.transfer(volume, &key, &load.progress, purpose).await;
        if matches!(&outcome, Err(WorkError::Unreadable(error)) if error.can_retry) && load.restart() {
            outcome = self.transfer(volume, &key, &load.progress, purpose).await;
        }
        if let Err(WorkError::Unreadable(error)) = &outcome
            && !load.progress.is_cancelled()
        {
            load.fail(error);
        }
        outcome
    }

    /// Reads a field, uploads it, and makes its table of minima and maxima. If that fails, the partial upload is dropped.
    async fn transfer(
        &self,
        volume: &VolumeStep,
        key: &VolumeKey,
        progress: &Arc<ReadProgress>,
        purpose: Purpose,
    ) -> Result<(), WorkError> {
        let begun = Instant::now();
        let (key, progress) = (key.clone(), Arc::clone(progress));
        let grid = Arc::new(padded_grid(volume, key.padded)?);
        self.admit(volume, &key, purpose).await?;
        let (sender, pieces) = mpsc::channel(1);
        let (read_volume, read_key) = (volume.clone(), key.clone());
        // If the upload fails or has no space, it drops the receiver. Then sending fails, which ends the reading.
        let mut send = move |piece| sender.blocking_send(piece).is_ok();
        let read = move || read(&read_volume, &read_key, &progress, &mut send);
        let reading = tokio::task::spawn_blocking(|| ReadPool::start().run(read));
        let uploaded = self.upload_pieces(&key, grid, pieces, purpose).await;
        let read = reading.await.unwrap_or(Err(WorkError::Stopped));
        let loaded = match (uploaded, read) {
            (Ok(None), _) => return Ok(()),
            (Ok(Some(bytes)), Ok(())) => self.make_table(&key).await.map(|()| bytes),
            (Err(error), _) | (Ok(Some(_)), Err(error)) => Err(error),
        };
        match loaded {
            Ok(bytes) => self.shared.load_rate.add(bytes as f64 / begun.elapsed().as_secs_f64()),
            Err(error) => {
                // If dropping fails too, the device is lost, and its memory with it.
                let _ = self.run_for_cache(DropUpload { key }).await;
                return Err(error);
            }
        }
        let is_ahead = matches!(purpose, Purpose::Ahead { .. });
        self.run_for_cache(FinishUpload { key, is_ahead }).await
    }

    /// Makes the table of minima and maxima of an uploaded field, in slices between other jobs.
    async fn make_table(&self, key: &VolumeKey) -> Result<(), WorkError> {
        loop {
            let slice = ContinueTable { key: key.clone() };
            if self.run_slice(Caller::Cache, slice).await? {
                return Ok(());
            }
        }
    }

    /// Computes a field on the device from other fields, which are loaded if they are not resident. The waiting callers have pinned these
    /// fields. `token` is cancelled with the load. Returns false if the host has to mask the field.
    fn compute<'a>(
        &'a self,
        volume: &'a VolumeStep,
        key: VolumeKey,
        token: CancellationToken,
    ) -> Pin<Box<dyn Future<Output = Result<bool, WorkError>> + Send + 'a>> {
        // Boxed because the future is recursive: computing a field may load others.
        Box::pin(async move {
            let request = Compute {
                volume: volume.clone(),
                key,
                user: self.user.clone(),
            };
            self.perform(Caller::Cache, request, &token).await
        })
    }

    /// Frees the samples, pyramids and vertex trees of a time step that will not be used again. Ignores errors: if the device is lost, this
    /// data is gone anyway.
    pub async fn release(&self, volume: &VolumeStep) {
        let _ = self.run_for_cache(Release { step: volume.key() }).await;
    }

    /// Checks that the host has memory to read a field. If a caller waits for the field, first evicts caches to make space.
    async fn admit(&self, volume: &VolumeStep, key: &VolumeKey, purpose: Purpose) -> Result<(), WorkError> {
        let needed = bytes_while_read(volume, key, self.ready().await?.kind)?;
        match purpose {
            Purpose::Now => self.run_for_cache(MakeHostSpace { bytes: needed }).await,
            Purpose::Ahead { .. } => HostMemory::now().admit(needed),
        }
    }

    /// Uploads the pieces of a field as they arrive. Returns the bytes of all samples. If the field is read ahead and there is no space for
    /// it, drops the pieces and returns `None`.
    async fn upload_pieces(
        &self,
        key: &VolumeKey,
        grid: Arc<RectilinearGrid>,
        mut pieces: mpsc::Receiver<Piece>,
        purpose: Purpose,
    ) -> Result<Option<u64>, WorkError> {
        let (mut is_first, mut bytes) = (true, 0);
        while let Some(Piece { samples, missing }) = pieces.recv().await {
            bytes += (samples.len() * samples.sample_type().bytes()) as u64;
            if std::mem::take(&mut is_first) {
                let begin = BeginUpload {
                    key: key.clone(),
                    grid: Arc::clone(&grid),
                    sample_type: samples.sample_type(),
                    missing,
                    ahead_budget: match purpose {
                        Purpose::Now => None,
                        Purpose::Ahead { budget } => Some(budget),
                    },
                };
                if !self.run_for_cache(begin).await? {
                    return Ok(None);
                }
            }
            if samples.len() <= REQUEST_SAMPLES {
                let key = key.clone();
                self.run_for_cache(ContinueUpload { key, samples }).await?;
                continue;
            }
            for begin in (0..samples.len()).step_by(REQUEST_SAMPLES) {
                let samples = part_of(&samples, begin);
                let key = key.clone();
                self.run_for_cache(ContinueUpload { key, samples }).await?;
            }
        }
        Ok(Some(bytes))
    }
}

/// Returns at most [`REQUEST_SAMPLES`] samples from one on.
fn part_of(samples: &Samples, begin: usize) -> Samples {
    let range = begin..(begin + REQUEST_SAMPLES).min(samples.len());
    match samples {
        Samples::U8(values) => Samples::U8(values[range].to_vec()),
        Samples::I8(values) => Samples::I8(values[range].to_vec()),
        Samples::U16(values) => Samples::U16(values[range].to_vec()),
        Samples::I16(values) => Samples::I16(values[range].to_vec()),
        Samples::F32(values) => Samples::F32(values[range].to_vec()),
    }
}
