//! Loads fields onto the device: files are read on tokio's blocking pool, never on the device's thread, and sent there in pieces.

use std::pin::Pin;
use std::sync::Arc;

use isopeel_extraction::{
    HostMemory, JobContext, JobError, Piece, VolumeKey, WorkError, Workspace, bytes_while_read, padded_grid, read,
};
use isopeel_kernels::RectilinearGrid;
use isopeel_volumes::{ReadProgress, VolumeStep};
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use super::scheduler::{Caller, Length};
use super::worker::DeviceWorker;
use crate::pool::ReadPool;

/// Why a field is loaded.
#[derive(Clone, Copy)]
enum Purpose {
    /// A caller waits for it.
    Now,
    /// Read-ahead: a caller may need it later.
    Ahead { budget: u64 },
}

impl DeviceWorker {
    /// Makes a field resident. Loads are single-flight: callers of the same field wait for one load. When the last caller has given up, the
    /// load continues for a while and is then cancelled.
    pub(super) async fn load(&self, volume: &VolumeStep, key: VolumeKey) -> Result<(), WorkError> {
        let load = self.shared.loads.of(&key);
        let _waiting = load.wait();
        let free = Arc::clone(&load.turn).try_lock_owned();
        if free.is_ok() {
            load.progress.restart();
        }
        if let Some(watch) = &self.watch {
            watch.follow(&key, &load.progress);
        }
        let guard = match free {
            Ok(guard) => guard,
            Err(_) => {
                let guard = Arc::clone(&load.turn).lock_owned().await;
                load.progress.restart();
                guard
            }
        };
        let (worker, volume, loaded, progress) =
            (self.clone(), volume.clone(), key.clone(), Arc::clone(&load.progress));
        let task = tokio::spawn(async move {
            let _guard = guard;
            worker.load_locked(&volume, key, progress, Purpose::Now).await
        });
        let outcome = task.await.unwrap_or(Err(WorkError::Stopped));
        if let (Ok(()), Some(watch)) = (&outcome, &self.watch) {
            watch.loaded(&loaded);
        }
        outcome
    }

    /// Makes a field resident before a viewer needs it, unless a load of it is running already. Callers that need it meanwhile wait for
    /// this load.
    pub(super) async fn load_ahead(
        &self,
        volume: &VolumeStep,
        key: VolumeKey,
        budget: u64,
        token: &CancellationToken,
    ) -> Result<(), WorkError> {
        let load = self.shared.loads.of(&key);
        let Ok(guard) = Arc::clone(&load.turn).try_lock_owned() else {
            return Ok(());
        };
        load.progress.restart();
        let (worker, volume, token) = (self.clone(), volume.clone(), token.clone());
        let task = tokio::spawn(async move {
            let _guard = guard;
            let waiting = load.wait();
            let purpose = Purpose::Ahead { budget };
            let work = worker.load_locked(&volume, key, Arc::clone(&load.progress), purpose);
            tokio::pin!(work);
            tokio::select! {
                outcome = &mut work => return outcome,
                // The load continues for other callers that wait for it.
                () = token.cancelled() => drop(waiting),
            }
            work.await
        });
        task.await.unwrap_or(Err(WorkError::Stopped))
    }

    async fn load_locked(
        &self,
        volume: &VolumeStep,
        key: VolumeKey,
        progress: Arc<ReadProgress>,
        purpose: Purpose,
    ) -> Result<(), WorkError> {
        let asked = key.clone();
        if self.on_device(move |state| Ok(state.is_resident(&asked))).await? {
            return Ok(());
        }
        let is_made = matches!(purpose, Purpose::Now) && key.is_computed(volume);
        if is_made && self.compute(volume, key.clone(), Arc::clone(&progress)).await? {
            return Ok(());
        }
        let permits = Arc::clone(&self.shared.loads.permits);
        let _permit = permits.acquire_owned().await.map_err(|_| WorkError::Stopped)?;
        match self.transfer(volume, &key, &progress, purpose).await {
            // Retry: the samples need another type, or the file changed while it was read.
            Err(WorkError::Unreadable(error)) if error.can_retry => {
                progress.restart();
                self.transfer(volume, &key, &progress, purpose).await
            }
            outcome => outcome,
        }
    }

    /// Reads a field and sends it to the device.
    async fn transfer(
        &self,
        volume: &VolumeStep,
        key: &VolumeKey,
        progress: &Arc<ReadProgress>,
        purpose: Purpose,
    ) -> Result<(), WorkError> {
        let (key, progress) = (key.clone(), Arc::clone(progress));
        let grid = Arc::new(padded_grid(volume, key.padded)?);
        self.admit(volume, &key, purpose).await?;
        let (sender, pieces) = mpsc::channel(1);
        let (of_read, volume_read) = (key.clone(), volume.clone());
        // Sending fails if the receiver is gone, because the device failed or had no space.
        let mut send = move |piece| sender.blocking_send(piece).is_ok();
        let read = move || read(&volume_read, &of_read, &progress, &mut send);
        let reading = tokio::task::spawn_blocking(|| ReadPool::start().run(read));
        let uploaded = self.upload_pieces(&key, grid, pieces, purpose).await;
        let read = reading.await.unwrap_or(Err(WorkError::Stopped));
        // If the device failed or had no space, reading was cancelled.
        let loaded = match uploaded {
            Ok(false) => return Ok(()),
            Ok(true) => read,
            Err(error) => Err(error),
        };
        let loaded = match loaded {
            Ok(()) => self.make_table(&key).await,
            failed => failed,
        };
        match loaded {
            Ok(()) => {
                let ahead = matches!(purpose, Purpose::Ahead { .. });
                self.on_device(move |state| state.finish_upload(key, ahead)).await
            }
            Err(error) => {
                let dropped = self.on_device(move |state| {
                    state.drop_upload(&key);
                    Ok(())
                });
                dropped.await?;
                Err(error)
            }
        }
    }

    /// Makes the min/max table of an uploaded field, a slice at a time between other jobs.
    async fn make_table(&self, key: &VolumeKey) -> Result<(), WorkError> {
        loop {
            let key = key.clone();
            let slice = self.run_slice(Caller::Cache, move |state| state.continue_table(&key));
            if slice.await? {
                return Ok(());
            }
        }
    }

    /// Computes a field on the device from others, which are loaded if they are not resident. Waiting callers have pinned all of them. A
    /// while after the last caller is gone, `progress` is cancelled, which ends the computation. Returns false if the host has to mask the
    /// field.
    fn compute<'a>(
        &'a self,
        volume: &'a VolumeStep,
        key: VolumeKey,
        progress: Arc<ReadProgress>,
    ) -> Pin<Box<dyn Future<Output = Result<bool, WorkError>> + Send + 'a>> {
        // Boxed because the future is recursive.
        Box::pin(async move {
            let (never, payer) = (CancellationToken::new(), self.payer.clone());
            self.with_volumes(
                volume,
                &never,
                Caller::Cache,
                Length::Field,
                move |state, volume, context| state.compute(volume, &key, &progress, payer.as_ref(), context),
            )
            .await
        })
    }

    /// Makes sure that the host has memory for a field before it is read. If a caller waits for the field, evicts caches to make space.
    async fn admit(&self, volume: &VolumeStep, key: &VolumeKey, purpose: Purpose) -> Result<(), WorkError> {
        let needed = bytes_while_read(volume, key, self.ready().await?.kind)?;
        match purpose {
            Purpose::Now => self.make_host_space(needed).await,
            Purpose::Ahead { .. } => HostMemory::now().admit(needed),
        }
    }

    /// Sends the pieces of a field to the device as they arrive. Returns false if a field that is read ahead has no space: the rest of it
    /// is not read.
    async fn upload_pieces(
        &self,
        key: &VolumeKey,
        grid: Arc<RectilinearGrid>,
        mut pieces: mpsc::Receiver<Piece>,
        purpose: Purpose,
    ) -> Result<bool, WorkError> {
        let mut is_first = true;
        while let Some(Piece { samples, missing }) = pieces.recv().await {
            let (key, grid, is_used) = (key.clone(), Arc::clone(&grid), self.is_open());
            let begins = std::mem::take(&mut is_first);
            let upload = self.on_device(move |state| {
                let sample_type = samples.sample_type();
                let has_space = match purpose {
                    _ if !begins => true,
                    Purpose::Now => state
                        .begin_upload(key.clone(), &grid, sample_type, missing)
                        .map(|()| true)?,
                    Purpose::Ahead { budget } => {
                        state.begin_upload_ahead(&key, &grid, sample_type, missing, budget, &is_used)?
                    }
                };
                if !has_space {
                    return Ok(false);
                }
                state.continue_upload(&key, &samples)?;
                Ok(true)
            });
            if !upload.await? {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Runs a short job, which is finished even if its caller is gone.
    async fn on_device<T: Send + 'static>(
        &self,
        job: impl FnOnce(&mut Workspace) -> Result<T, JobError> + Send + 'static,
    ) -> Result<T, WorkError> {
        let never = CancellationToken::new();
        let work = move |state: &mut Workspace, _: &mut JobContext<'_, Workspace>| job(state);
        Ok(self.run(&never, Caller::Cache, Length::Short, work).await?)
    }
}
