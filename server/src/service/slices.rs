//! Reads samples of a field back from the device: all of them, or a plane.

use isopeel_extraction::{MakeHostSpace, ReadSamples, ReadSlice, Slice, VolumeKey, WorkError};
use isopeel_kernels::{SampleType, Samples};
use isopeel_volumes::VolumeStep;
use tokio_util::sync::CancellationToken;

use super::scheduler::Caller;
use super::worker::DeviceWorker;

/// Approximate number of samples that one job copies. Other jobs may run between two copies.
const SAMPLES_PER_COPY: u64 = 16 << 20;

impl DeviceWorker {
    /// Returns all samples of a field, or of an expression over fields, in pieces of whole planes across z, and the number of planes of a
    /// piece. The last piece may have fewer. Loads or computes fields that are not on the device.
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
        let plane_samples = u64::from(width) * u64::from(height);
        let field_info = volume.dataset().field(field);
        let sample_type = field_info.map_or(SampleType::F32, |field| field.sample_type);
        let bytes = plane_samples * u64::from(depth) * sample_type.bytes() as u64;
        self.run_for_cache(MakeHostSpace { bytes }).await?;
        let piece_planes = (SAMPLES_PER_COPY / plane_samples).clamp(1, depth.into()) as u32;
        let mut pieces = Vec::new();
        for first in (0..depth).step_by(piece_planes as usize) {
            let request = ReadSamples {
                volume: volume.clone(),
                key: VolumeKey::new(volume, field, false),
                planes: first..depth.min(first + piece_planes),
            };
            pieces.push(self.perform(Caller::Request, request, token).await?);
        }
        Ok((pieces, piece_planes))
    }

    /// Returns the plane `index` of a field across an axis (0 to 2). Loads the field if it is not on the device. Dropping the future cancels
    /// the work.
    ///
    /// # Errors
    /// [`WorkError`].
    pub async fn slice(&self, volume: &VolumeStep, field: &str, axis: usize, index: u32) -> Result<Slice, WorkError> {
        let request = ReadSlice {
            volume: volume.clone(),
            key: VolumeKey::new(volume, field, false),
            axis,
            index,
        };
        self.perform(Caller::Request, request, &CancellationToken::new()).await
    }
}
