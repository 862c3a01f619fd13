//! Samples of a field, as they are on the device.

use isopeel_extraction::{JobContext, Slice, VolumeKey, WorkError, Workspace};
use isopeel_kernels::{SampleType, Samples};
use isopeel_volumes::VolumeStep;
use tokio_util::sync::CancellationToken;

use super::scheduler::{Caller, Length};
use super::worker::DeviceWorker;

/// Samples that are copied in one job: other jobs may run between two copies.
const COPIED_SAMPLES: u64 = 16 << 20;

impl DeviceWorker {
    /// Returns all samples of a field, or of an expression over fields, in pieces of whole planes across z. Also returns the number of
    /// planes of a piece; the last one may have fewer. Loads or computes fields that are not on the device.
    ///
    /// # Errors
    /// [`WorkError`].
    pub async fn samples(
        &self,
        volume: &VolumeStep,
        field: &str,
        token: &CancellationToken,
    ) -> Result<(Vec<Samples>, u32), WorkError> {
        let [width, height, depth] = volume.dataset().geometry.dims;
        let plane = u64::from(width) * u64::from(height);
        let sample_type = volume
            .dataset()
            .field(field)
            .map_or(SampleType::F32, |field| field.sample_type);
        self.make_host_space(plane * u64::from(depth) * sample_type.bytes() as u64)
            .await?;
        let planes = (COPIED_SAMPLES / plane).clamp(1, depth.into()) as u32;
        let mut pieces = Vec::new();
        for first in (0..depth).step_by(planes as usize) {
            let key = VolumeKey::new(volume, field, false);
            let job = move |workspace: &mut Workspace, volume: &VolumeStep, _: &mut JobContext<'_, Workspace>| {
                workspace.samples(volume, &key, first..depth.min(first + planes))
            };
            let piece = self.with_volumes(volume, token, Caller::Request, Length::Short, job);
            pieces.push(piece.await?);
        }
        Ok((pieces, planes))
    }

    /// Returns the plane of a field across an axis (0 to 2). Loads the field if it is not on the device. Dropping the future cancels the
    /// work.
    ///
    /// # Errors
    /// [`WorkError`].
    pub async fn slice(&self, volume: &VolumeStep, field: &str, axis: usize, index: u32) -> Result<Slice, WorkError> {
        let key = VolumeKey::new(volume, field, false);
        let job = move |workspace: &mut Workspace, volume: &VolumeStep, _: &mut JobContext<'_, Workspace>| {
            workspace.slice(volume, &key, axis, index)
        };
        let never = CancellationToken::new();
        self.with_volumes(volume, &never, Caller::Request, Length::Short, job)
            .await
    }
}
