//! From a view to a surface within limits: finds what keeps a budget of bytes, and refuses what is too large.

use std::time::{Duration, Instant};

use isopeel_kernels::{BUDGET_FIT, Surface};
use tokio_util::sync::CancellationToken;

use super::{DeviceWorker, Extraction, Measurement, Refinement, Step, WorkError};
use crate::error::BoxError;
use crate::pool;
use crate::view::View;
use crate::view::quality::{Budget, Fitted, MesherName, TriangleBudget};
use crate::volumes::VolumeStep;

/// Bytes a triangle takes on the wire, to begin with: between a smooth surface's 4 and a noisy one's 7.
const FIRST_BYTES_PER_TRIANGLE: f64 = 5.0;

/// Surfaces that are made to find a budget of bytes. The first measures, the second is mostly within 5 %.
const BYTE_TRIALS: usize = 4;

/// A budget counts as kept from this share on.
const KEPT: f64 = 0.95;

/// Bytes of a surface in the encoding of the stream. A function, because the encoder is in a layer above.
pub type EncodedBytes = fn(&Surface) -> Result<u64, BoxError>;

/// Makes surfaces that keep budgets and limits. Clones are cheap.
#[derive(Clone)]
pub struct Extractor {
    worker: DeviceWorker,
    ceiling_triangles: u64,
    encoded_bytes: EncodedBytes,
}

impl Extractor {
    /// Works on a device. Surfaces of more than `ceiling_triangles` are refused; `u64::MAX`: none is.
    pub fn new(worker: DeviceWorker, ceiling_triangles: u64, encoded_bytes: EncodedBytes) -> Self {
        Self {
            worker,
            ceiling_triangles,
            encoded_bytes,
        }
    }

    /// The device.
    pub fn worker(&self) -> &DeviceWorker {
        &self.worker
    }

    /// A step from the surface that a client shows to that of a view.
    ///
    /// # Errors
    /// [`WorkError::TooManyTriangles`] where the final surface is above the ceiling, and the device's errors.
    pub async fn refine(
        &self,
        volume: &VolumeStep,
        view: &View,
        step: Step,
        token: &CancellationToken,
    ) -> Result<Refinement, WorkError> {
        let view = self.with_fitted_bytes(volume, view, token).await?;
        let ceiling = self.ceiling_triangles;
        self.worker.refine(volume, &view, step, ceiling, token).await
    }

    /// The final surface of a view once more, as a cut of the vertex tree, which takes longer to build: for a viewer that rests. `None`
    /// where there is no better one.
    ///
    /// # Errors
    /// As [`Extractor::refine`].
    pub async fn improve(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> Result<Option<Refinement>, WorkError> {
        self.worker.improve(volume, view, self.ceiling_triangles, token).await
    }

    /// How far the final surface of a view, whose budget is fitted, is from the undecimated one. `None`: of the marching-cubes mesher
    /// nothing is measured.
    ///
    /// # Errors
    /// As [`Extractor::refine`].
    pub async fn measure(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> Result<Option<Measurement>, WorkError> {
        if view.mesher != MesherName::Dual {
            return Ok(None);
        }
        Ok(Some(self.worker.measure(volume, view, token).await?))
    }

    /// The final surface of a view for an export.
    ///
    /// # Errors
    /// As [`Extractor::refine`].
    pub async fn extract(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> Result<Extraction, WorkError> {
        let start = Instant::now();
        let fitted = self.with_fitted_bytes(volume, view, token).await?;
        let planning = if fitted.fitted == view.fitted {
            Duration::ZERO
        } else {
            start.elapsed()
        };
        let mut extraction = self
            .worker
            .extract(volume, &fitted, self.ceiling_triangles, token)
            .await?;
        extraction.wall += planning;
        Ok(extraction)
    }

    /// The view with what keeps its budget of bytes, if it has one.
    async fn with_fitted_bytes(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> Result<View, WorkError> {
        let mut view = view.clone();
        if let (Some(Budget::Bytes(bytes)), None) = (view.budget, view.fitted) {
            view.fitted = Some(self.fit_bytes(volume, &view, bytes, token).await?);
        }
        Ok(view)
    }

    /// Finds how many triangles, and with them which threshold, take `budget` bytes on the wire: makes the surface, measures it
    /// and corrects.
    async fn fit_bytes(
        &self,
        volume: &VolumeStep,
        view: &View,
        budget: u64,
        token: &CancellationToken,
    ) -> Result<Fitted, WorkError> {
        let mut triangles = ((budget as f64 / FIRST_BYTES_PER_TRIANGLE) as u64).max(1);
        // The largest within the budget; if none is, the smallest.
        let mut best: Option<(u64, Fitted)> = None;
        let mut tried = Vec::new();
        for _ in 0..BYTE_TRIALS {
            let trial = View {
                budget: Some(Budget::Triangles(TriangleBudget::AtMost(
                    triangles.min(self.ceiling_triangles),
                ))),
                fitted: None,
                ..view.clone()
            };
            let extraction = self
                .worker
                .extract(volume, &trial, self.ceiling_triangles, token)
                .await?;
            let Some(fitted) = extraction.view.fitted else { break };
            if tried.contains(&fitted.threshold.to_bits()) {
                break;
            }
            tried.push(fitted.threshold.to_bits());
            let made = extraction.surface.statistics.triangles;
            let bytes = self.bytes_of(extraction.surface).await?;
            let keeps = |bytes: u64| bytes <= budget;
            if best.is_none_or(|(b, _)| (keeps(bytes) && (!keeps(b) || bytes > b)) || (!keeps(bytes) && bytes < b)) {
                best = Some((bytes, fitted));
            }
            if keeps(bytes) && bytes as f64 >= KEPT * budget as f64 {
                break;
            }
            // Aims at the middle of what counts as kept; the device meets a budget of triangles within `BUDGET_FIT`.
            let aim = (1.0 + KEPT) / (1.0 + BUDGET_FIT) * budget as f64 / bytes.max(1) as f64;
            let next = ((made.max(1) as f64 * aim) as u64).max(1);
            if next == triangles {
                break;
            }
            triangles = next;
        }
        best.map(|(_, fitted)| fitted).ok_or(WorkError::Stopped)
    }

    async fn bytes_of(&self, surface: Surface) -> Result<u64, WorkError> {
        let encoded_bytes = self.encoded_bytes;
        match pool::run(move || encoded_bytes(&surface)).await {
            Ok(Ok(bytes)) => Ok(bytes),
            Ok(Err(error)) => {
                tracing::error!(%error, "a surface could not be encoded");
                Err(WorkError::Stopped)
            }
            Err(_) => Err(WorkError::Stopped),
        }
    }
}
