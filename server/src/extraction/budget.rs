//! From a wish to a surface: finds the β of a budget, refuses what is too large before it is made, and polishes.

use isopeel_kernels::{FIT, Level, Surface};
use rayon::prelude::*;
use tokio_util::sync::CancellationToken;

use super::simplification::{self, Blocks, Goal};
use super::{DeviceWorker, Extraction, Plan, VolumeStep, WorkError};
use crate::pool;
use crate::view::View;
use crate::view::quality::{Budget, Fitted, MaxError};
use crate::wire::encode::{AT_ONCE, EncodeError, WireRegion};

/// Bytes a triangle takes on the wire, to begin with: between a smooth surface's 4 and a noisy one's 7.
const FIRST_BYTES_PER_TRIANGLE: f64 = 5.0;

/// Surfaces that are made to find a budget of bytes. The first measures, the second is mostly within 5 %.
const BYTE_TRIALS: usize = 4;

/// A budget counts as kept from here on.
const KEPT: f64 = 0.95;

/// What is known of a view's surface before it is made: every value in force, β of a budget included, and what the
/// prefixes of `levels` would have.
///
/// # Errors
/// [`WorkError::TooManyTriangles`] where the final surface would have more than `ceiling`, and what the device says.
pub async fn plan(
    worker: &DeviceWorker,
    volume: &VolumeStep,
    view: &View,
    mut levels: Vec<Level>,
    ceiling: u64,
    token: &CancellationToken,
) -> Result<Plan, WorkError> {
    if !levels.contains(&Level::FINEST) {
        levels.push(Level::FINEST);
    }
    let mut view = view.clone();
    if let (Some(Budget::Bytes(bytes)), None) = (view.budget, view.fitted) {
        view.fitted = Some(fit_bytes(worker, volume, &view, bytes, ceiling, token).await?);
    }
    let plan = worker.plan(volume, &view, levels, token).await?;
    check(&plan, ceiling)?;
    Ok(plan)
}

/// The final surface of a view for an export, polished where the view says so.
///
/// # Errors
/// As [`plan`].
pub async fn extract(
    worker: &DeviceWorker,
    volume: &VolumeStep,
    view: &View,
    ceiling: u64,
    token: &CancellationToken,
) -> Result<Extraction, WorkError> {
    // Without a budget and a ceiling there is nothing to count.
    let (view, planning) = if view.budget.is_some() || ceiling < u64::MAX {
        let plan = plan(worker, volume, view, Vec::new(), ceiling, token).await?;
        (plan.view, plan.wall)
    } else {
        (view.clone(), std::time::Duration::ZERO)
    };
    let mut extraction = worker.extract(volume, &view, Level::FINEST, token).await?;
    extraction.wall += planning;
    if view.polish {
        return polished(extraction, volume, Blocks::EXPORT, token).await;
    }
    Ok(extraction)
}

/// Simplifies a surface: to its view's budget, or else as far as the guard on the error goes.
///
/// # Errors
/// [`WorkError::Cancelled`], or [`WorkError::Stopped`] where the simplifier failed.
pub async fn polished(
    extraction: Extraction,
    volume: &VolumeStep,
    blocks: Blocks,
    token: &CancellationToken,
) -> Result<Extraction, WorkError> {
    let start = std::time::Instant::now();
    let spacing = volume.dataset().geometry.spacing;
    let Extraction { surface, view, wall } = extraction;
    let guard = match view.max_error {
        MaxError::None => MaxError::default(),
        guard => guard,
    };
    let goal = match view.fitted {
        Some(fitted) => Goal::Triangles(fitted.triangles),
        None => Goal::Error(guard.world(spacing).unwrap_or_default()),
    };
    let token = token.clone();
    let (surface, view) = pool::run(move || {
        let importance = simplification::Importance::new(&view);
        let surface = simplification::polish(surface, spacing, &importance, goal, blocks, &token);
        (surface, view)
    })
    .await
    .map_err(|_| WorkError::Stopped)?;
    Ok(Extraction {
        surface: surface.ok_or(WorkError::Cancelled)?,
        view,
        wall: wall + start.elapsed(),
    })
}

fn check(plan: &Plan, ceiling: u64) -> Result<(), WorkError> {
    let last = plan.prefixes.iter().find(|prefix| prefix.level == Level::FINEST);
    match last.map(|prefix| prefix.count.triangles) {
        Some(triangles) if triangles > ceiling => Err(WorkError::TooManyTriangles { triangles, ceiling }),
        _ => Ok(()),
    }
}

/// Finds how many triangles, and with them which β, take `budget` bytes on the wire: makes the surface, weighs it, and
/// corrects.
async fn fit_bytes(
    worker: &DeviceWorker,
    volume: &VolumeStep,
    view: &View,
    budget: u64,
    ceiling: u64,
    token: &CancellationToken,
) -> Result<Fitted, WorkError> {
    let mut triangles = ((budget as f64 / FIRST_BYTES_PER_TRIANGLE) as u64).max(1);
    // The one that keeps the budget and fills it best; or else the smallest.
    let mut best: Option<(u64, Fitted)> = None;
    let mut tried = Vec::new();
    for _ in 0..BYTE_TRIALS {
        let trial = View {
            budget: Some(Budget::Triangles(triangles.min(ceiling))),
            fitted: None,
            ..view.clone()
        };
        let plan = worker.plan(volume, &trial, vec![Level::FINEST], token).await?;
        check(&plan, ceiling)?;
        let Some(fitted) = plan.view.fitted else { break };
        if !view.polish && tried.contains(&fitted.beta.to_bits()) {
            break;
        }
        tried.push(fitted.beta.to_bits());
        let mut extraction = worker.extract(volume, &plan.view, Level::FINEST, token).await?;
        if view.polish {
            extraction = polished(extraction, volume, Blocks::Regions, token).await?;
        }
        let made = extraction.surface.statistics.triangles;
        let wire = wire_bytes(extraction.surface).await?;
        let keeps = |bytes: u64| bytes <= budget;
        if best.is_none_or(|(b, _)| (keeps(wire) && (!keeps(b) || wire > b)) || (!keeps(wire) && wire < b)) {
            best = Some((wire, fitted));
        }
        if keeps(wire) && wire as f64 >= KEPT * budget as f64 {
            break;
        }
        // Aims at the middle of what counts as kept, by asking for what a budget of triangles about there is met with.
        let aim = (1.0 + KEPT) / (1.0 + FIT) * budget as f64 / wire.max(1) as f64;
        let next = ((made.max(1) as f64 * aim) as u64).max(1);
        if next == triangles {
            break;
        }
        triangles = next;
    }
    best.map(|(_, fitted)| fitted).ok_or(WorkError::Stopped)
}

/// Bytes of a surface's chunks.
async fn wire_bytes(surface: Surface) -> Result<u64, WorkError> {
    let weighed = pool::run(move || {
        let weigh = |region: &isopeel_kernels::Region| Ok(WireRegion::new(region)?.encode(0, 0).len() as u64);
        let regions = surface.regions.par_iter().with_max_len(AT_ONCE);
        regions.map(weigh).sum::<Result<u64, EncodeError>>()
    });
    match weighed.await {
        Ok(Ok(bytes)) => Ok(bytes),
        Ok(Err(error)) => {
            tracing::error!(%error, "a surface could not be weighed");
            Err(WorkError::Stopped)
        }
        Err(_) => Err(WorkError::Stopped),
    }
}
