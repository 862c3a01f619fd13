//! Brings fields onto the device: files are read on tokio's blocking pool, never on the device's thread.

use std::sync::Arc;

use tokio_util::sync::CancellationToken;

use super::WorkError;
use super::keys::VolumeKey;
use super::turns::Length;
use super::worker::{Caller, DeviceWorker};
use super::worker_state::padded_grid;
use crate::volumes::{ReadProgress, VolumeStep};

/// Why a field is loaded.
enum Purpose {
    /// A caller waits for it.
    Now,
    /// One may come, unless this is cancelled.
    Ahead { budget: u64, token: CancellationToken },
}

impl DeviceWorker {
    /// Makes a field resident, unless another caller just did. A load goes on when its caller gives up; the next caller waits for
    /// the same one.
    pub(super) async fn load(&self, volume: &VolumeStep, key: VolumeKey) -> Result<(), WorkError> {
        let load = self.shared.loads.of(&key);
        let free = Arc::clone(&load.turn).try_lock_owned();
        if free.is_ok() {
            load.progress.set(0);
        }
        if let Some(watch) = &self.watch {
            watch.follow(&key, &load.progress);
        }
        let guard = match free {
            Ok(guard) => guard,
            Err(_) => Arc::clone(&load.turn).lock_owned().await,
        };
        let (worker, volume, loaded) = (self.clone(), volume.clone(), key.clone());
        let task = tokio::spawn(async move {
            let _guard = guard;
            worker.load_locked(&volume, key, &load.progress, &Purpose::Now).await
        });
        let outcome = task.await.unwrap_or(Err(WorkError::Stopped));
        if let (Ok(()), Some(watch)) = (&outcome, &self.watch) {
            watch.loaded(&loaded);
        }
        outcome
    }

    /// Makes a field resident before anybody asks for it, if nobody loads it already. Who asks meanwhile waits for it.
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
        load.progress.set(0);
        let (worker, volume, token) = (self.clone(), volume.clone(), token.clone());
        let task = tokio::spawn(async move {
            let _guard = guard;
            let purpose = Purpose::Ahead { budget, token };
            worker.load_locked(&volume, key, &load.progress, &purpose).await
        });
        task.await.unwrap_or(Err(WorkError::Stopped))
    }

    async fn load_locked(
        &self,
        volume: &VolumeStep,
        key: VolumeKey,
        progress: &Arc<ReadProgress>,
        purpose: &Purpose,
    ) -> Result<(), WorkError> {
        let finish = Caller::Cache;
        let never = CancellationToken::new();
        let asked = key.clone();
        let resident = self.run(&never, finish, Length::Short, move |state, _| {
            Ok(state.is_resident(&asked))
        });
        if resident.await? {
            return Ok(());
        }
        let permits = Arc::clone(&self.shared.loads.permits);
        let permit = permits.acquire_owned().await.map_err(|_| WorkError::Stopped)?;
        let field = key.field_of(volume)?.clone();
        let step = volume.step();
        let source = Arc::clone(&field.source);
        let counted = Arc::clone(progress);
        let (dims, missing, padded) = (volume.dataset().geometry.dims, field.missing, key.padded);
        let read = tokio::task::spawn_blocking(move || {
            let samples = source.read(step, &counted);
            let samples = if padded {
                samples.map(|samples| samples.padded(dims, missing).0)
            } else {
                samples
            };
            (samples, permit)
        });
        // Held until the samples are on the device, to bound host memory.
        let (samples, _permit) = read.await.map_err(|_| WorkError::Stopped)?;
        let (samples, grid) = (samples?, padded_grid(volume, padded)?);
        let upload = match purpose {
            Purpose::Ahead { token, .. } if token.is_cancelled() => return Ok(()),
            Purpose::Ahead { budget, .. } => {
                let (budget, is_used) = (*budget, self.is_open());
                let upload = self.run(&never, finish, Length::Short, move |state, _| {
                    state.upload_ahead(key, &grid, &samples, missing, budget, &is_used)
                });
                upload.await
            }
            Purpose::Now => {
                let upload = self.run(&never, finish, Length::Short, move |state, _| {
                    state.upload(key, &grid, &samples, missing)
                });
                upload.await
            }
        };
        Ok(upload?)
    }
}
