//! Planes of a field's samples, as they are on the device.

use isopeel_kernels::SampleType;
use tokio_util::sync::CancellationToken;

use super::WorkError;
use super::keys::VolumeKey;
use super::turns::{Caller, Length, Turn};
use super::worker::DeviceWorker;
use super::worker_state::WorkerState;
use crate::volumes::VolumeStep;

/// A plane of samples.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Slice {
    /// Type of the samples.
    pub sample_type: SampleType,
    /// Little-endian, the lower of the plane's axes fastest.
    pub bytes: Vec<u8>,
}

impl DeviceWorker {
    /// The plane of a field across an axis (0 to 2). Loads the field where it is not on the device. Dropping the future cancels it.
    ///
    /// # Errors
    /// [`WorkError`].
    pub async fn slice(&self, volume: &VolumeStep, field: &str, axis: usize, index: u32) -> Result<Slice, WorkError> {
        let key = VolumeKey::new(volume, field, false);
        let job = move |state: &mut WorkerState, volume: &VolumeStep, _: &mut Turn<'_, WorkerState>| {
            state.use_field(volume, &key)?;
            let resident = state.resident(&key).ok_or(WorkError::Stopped)?;
            Ok(Slice {
                sample_type: resident.sample_type(),
                bytes: state.engine().slice(resident, axis, index)?,
            })
        };
        let never = CancellationToken::new();
        self.with_volumes(volume, &never, Caller::Request, Length::Short, job)
            .await
    }
}
