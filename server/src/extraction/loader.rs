//! Brings fields onto the device: files are read on tokio's blocking pool, never on the device's thread.

use std::sync::Arc;

use isopeel_kernels::Samples;
use tokio_util::sync::CancellationToken;

use super::WorkError;
use super::keys::VolumeKey;
use super::turns::Length;
use super::worker::{Caller, DeviceWorker};
use super::worker_state::padded_grid;
use crate::view::Mask;
use crate::volumes::{Field, ReadError, ReadProgress, VolumeStep};

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
            worker.load_locked(&volume, key, &load.progress).await
        });
        let outcome = task.await.unwrap_or(Err(WorkError::Stopped));
        if let (Ok(()), Some(watch)) = (&outcome, &self.watch) {
            watch.loaded(&loaded);
        }
        outcome
    }

    async fn load_locked(
        &self,
        volume: &VolumeStep,
        key: VolumeKey,
        progress: &Arc<ReadProgress>,
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
        let mask = key.mask_of(volume)?;
        let read = tokio::task::spawn_blocking(move || {
            let read = || {
                let samples = source.read(step, &counted)?;
                let (samples, missing) = match mask {
                    Some((mask, labels)) => masked(samples, missing, &mask, &labels, step)?,
                    None => (samples, missing),
                };
                let samples = if padded {
                    samples.padded(dims, missing).0
                } else {
                    samples
                };
                Ok::<_, ReadError>((samples, missing))
            };
            (read(), permit)
        });
        // Held until the samples are on the device, to bound host memory.
        let (read, _permit) = read.await.map_err(|_| WorkError::Stopped)?;
        let ((samples, missing), grid) = (read?, padded_grid(volume, padded)?);
        let upload = self.run(&never, finish, Length::Short, move |state, _| {
            state.upload(key, &grid, &samples, missing)
        });
        Ok(upload.await?)
    }
}

/// Samples of which those outside a mask are missing, and the value that stands for these. `labels`: the mask's field.
fn masked(
    samples: Samples,
    missing: Option<f32>,
    mask: &Mask,
    labels: &Field,
    step: u32,
) -> Result<(Samples, Option<f32>), ReadError> {
    let values = labels.source.load(step)?;
    let is_inside = |i| {
        let value = values.get(i);
        Some(value) != labels.missing && mask.holds(value)
    };
    Ok(samples.masked(missing, is_inside))
}
