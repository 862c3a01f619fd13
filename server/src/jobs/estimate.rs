//! Estimates the cost of a job before the job is accepted. The device counts the triangles of a few extractions' full surfaces, but makes
//! no meshes.

use std::sync::Arc;

use isopeel_extraction::WorkError;
use isopeel_view::View;
use isopeel_view::quality::Budget;
use isopeel_volumes::{Dataset, UnknownStep, VolumeStep};
use tokio_util::sync::CancellationToken;

use super::state::Estimate;
use crate::export::{FileRequest, OtherVolumes};
use crate::service::{DevicePool, DeviceWorker, Seat};

/// Number of extractions whose triangles are counted: the first, the middle and the last one. Few, because each may have to load a time
/// step.
const SAMPLES: usize = 3;

/// Seconds for each triangle of the full surface, including the tree, the cut and the file. A guess for two cores of a CPU. It is used
/// until the first extractions of the job have been timed.
const SECONDS_PER_TRIANGLE: f64 = 2e-6;

/// Estimates the cost of extractions of a volume. A budget bounds the triangles of a surface; otherwise the full surface is assumed,
/// because the effect of an error or β is unknown before the surface is made.
///
/// # Errors
/// The volume cannot be read, or the device does not work.
pub(super) async fn estimate(
    devices: &DevicePool,
    dataset: &Arc<Dataset>,
    extractions: &[(FileRequest, View)],
    token: &CancellationToken,
) -> Result<Estimate, EstimateError> {
    let (mut triangles, mut seconds) = (0.0, 0.0);
    let (samples, seat) = (samples(extractions.len()), Seat::default());
    for &sample in &samples {
        let (request, _) = &extractions[sample];
        let volume = VolumeStep::new(Arc::clone(dataset), request.step)?;
        let surfaces = request.surfaces(&volume, &OtherVolumes::new());
        for surface in surfaces.map_err(WorkError::Edit)? {
            let (volume, view) = (&surface.volume, &surface.view);
            let count = |worker: DeviceWorker| async move { worker.count(volume, view, token).await };
            let count = devices.perform(&seat, volume, count).await?;
            triangles += within_budget(count.triangles, &surface.view) as f64;
            seconds += count.wall.as_secs_f64() + count.triangles as f64 * SECONDS_PER_TRIANGLE;
        }
    }
    let mean_triangles = triangles / samples.len() as f64;
    let bytes = extractions.iter().map(|(request, _)| {
        let fields = request.options.field_values.len();
        request
            .options
            .format
            .typical_bytes(mean_triangles as u64, fields as u64)
    });
    let count = extractions.len() as f64;
    Ok(Estimate {
        triangles: (mean_triangles * count) as u64,
        bytes: bytes.sum(),
        seconds: seconds / samples.len() as f64 * count,
    })
}

/// Why there is no estimate.
#[derive(Debug, thiserror::Error)]
pub(super) enum EstimateError {
    /// The volume has no such time step.
    #[error(transparent)]
    Step(#[from] UnknownStep),
    /// The volume cannot be read, or the device does not work.
    #[error(transparent)]
    Work(#[from] WorkError),
}

/// Returns the indices of at most [`SAMPLES`] evenly spaced extractions among `count`, including the first and the last.
fn samples(count: usize) -> Vec<usize> {
    let last = count.saturating_sub(1);
    let mut samples: Vec<_> = (0..SAMPLES).map(|i| last * i / (SAMPLES - 1)).collect();
    samples.dedup();
    samples
}

fn within_budget(full: u64, view: &View) -> u64 {
    match view.budget {
        Some(Budget::Triangles(triangles)) => triangles.of(full).min(full),
        Some(Budget::Bytes(_)) | None => full,
    }
}

#[cfg(test)]
mod tests {
    use isopeel_view::quality::{ShareBudget, TriangleBudget};

    use super::*;

    #[test]
    fn samples_are_spread_over_all() {
        assert_eq!(samples(1), [0]);
        assert_eq!(samples(2), [0, 1]);
        assert_eq!(samples(10_000), [0, 4_999, 9_999]);
    }

    #[test]
    fn a_budget_bounds_the_triangles() {
        let with = |budget| View {
            budget: Some(budget),
            ..View::plain(&["a"])
        };
        let share = ShareBudget { share: 0.25, max: None };
        assert_eq!(within_budget(1_000, &View::plain(&["a"])), 1_000);
        assert_eq!(
            within_budget(1_000, &with(Budget::Triangles(TriangleBudget::AtMost(300)))),
            300
        );
        assert_eq!(
            within_budget(1_000, &with(Budget::Triangles(TriangleBudget::AtMost(3_000)))),
            1_000
        );
        assert_eq!(
            within_budget(1_000, &with(Budget::Triangles(TriangleBudget::Share(share)))),
            250
        );
    }
}
