//! The device of these tests: jobs wait until the test answers them.

use std::sync::Arc;
use std::time::Duration;

use isopeel_kernels::{Count, Level, Region, Surface, SurfaceStatistics, Vertex};
use tokio::sync::{mpsc, oneshot, watch};
use tokio_util::sync::CancellationToken;

use crate::extraction::{Extraction, OpeningProgress, Plan, PrefixCount, WorkError};
use crate::stream::backend::{Backend, Opening};
use crate::view::View;
use crate::volumes::{Dataset, VolumeStep, testing};

/// A β for which the scripted device has too many triangles.
pub(super) const TOO_FINE: f32 = 0.0625;

fn dataset(id: &str) -> Arc<Dataset> {
    Arc::new(Dataset {
        steps: 2,
        ..testing::dataset(id, [65; 3], &["density"])
    })
}

/// A job that waits for the test's answer.
pub(super) struct Job<T> {
    pub volume: VolumeStep,
    pub view: View,
    prefix: Option<Level>,
    pub token: CancellationToken,
    pub reply: oneshot::Sender<Result<T, WorkError>>,
    /// Of an `open`.
    pub progress: Option<watch::Sender<OpeningProgress>>,
}

#[derive(Clone)]
pub(super) struct Scripted {
    pub opens: mpsc::Sender<Job<Opening>>,
    pub extracts: mpsc::Sender<Job<Extraction>>,
}

impl Scripted {
    async fn ask<T>(
        to: &mpsc::Sender<Job<T>>,
        volume: &VolumeStep,
        view: &View,
        prefix: Option<Level>,
        token: &CancellationToken,
        progress: Option<watch::Sender<OpeningProgress>>,
    ) -> Result<T, WorkError> {
        let (reply, answer) = oneshot::channel();
        let job = Job {
            volume: volume.clone(),
            view: view.clone(),
            prefix,
            token: token.clone(),
            reply,
            progress,
        };
        to.send(job).await.map_err(|_| WorkError::Stopped)?;
        answer.await.unwrap_or(Err(WorkError::Stopped))
    }
}

impl Backend for Scripted {
    fn find(&self, volume: &str) -> Option<Arc<Dataset>> {
        ["head", "other"].contains(&volume).then(|| dataset(volume))
    }

    async fn open(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
        progress: &watch::Sender<OpeningProgress>,
    ) -> Result<Opening, WorkError> {
        Self::ask(&self.opens, volume, view, None, token, Some(progress.clone())).await
    }

    /// Counts at once, so that level 4 comes first, then the final surface. A preview is of level 2.
    async fn plan(
        &self,
        _: &VolumeStep,
        view: &View,
        levels: Vec<Level>,
        _: &CancellationToken,
    ) -> Result<Plan, WorkError> {
        let triangles = |level: Level| match level.get() {
            5 => 50,
            4 => 100,
            0 => 100_000,
            _ => 10_000,
        };
        let prefixes = levels.into_iter().map(|level| PrefixCount {
            level,
            count: Count {
                triangles: triangles(level),
                ..Count::default()
            },
        });
        if view.budget.is_none() && view.beta == TOO_FINE {
            return Err(WorkError::TooManyTriangles {
                triangles: 30,
                ceiling: 20,
            });
        }
        Ok(Plan {
            view: view.clone(),
            prefixes: prefixes.collect(),
            regions: 1,
            wall: Duration::ZERO,
        })
    }

    async fn extract(
        &self,
        volume: &VolumeStep,
        view: &View,
        prefix: Level,
        token: &CancellationToken,
    ) -> Result<Extraction, WorkError> {
        Self::ask(&self.extracts, volume, view, Some(prefix), token, None).await
    }
}

/// A region with one triangle; different shapes differ.
fn region(x: u32, shape: i32) -> Region {
    let vertex = |position| Vertex {
        position,
        normal: [0, 0],
        smoothness: 0,
        feature: 0,
    };
    Region {
        coords: [x, 0, 0],
        vertices: [[0, 0, 0], [65536, 0, 0], [0, 65536 * shape, 0]]
            .map(vertex)
            .to_vec()
            .into(),
        indices: vec![0, 1, 2].into(),
        level_triangles: [1, 0, 0, 0, 0, 0],
        error: None,
    }
}

/// A surface of regions 0, 1, … with these shapes; 0 leaves a region out.
pub(super) fn shapes(shapes: &[i32]) -> Vec<Region> {
    let regions = shapes.iter().enumerate().filter(|(_, shape)| **shape != 0);
    regions.map(|(x, shape)| region(x as u32, *shape)).collect()
}

impl Job<Extraction> {
    pub(super) fn level(&self) -> u8 {
        self.prefix.expect("an extraction").get()
    }

    pub(super) fn answer(self, regions: Vec<Region>) {
        self.answer_after(regions, Duration::from_millis(10));
    }

    /// Answers as a device that took so long.
    pub(super) fn answer_after(self, regions: Vec<Region>, wall: Duration) {
        let statistics = SurfaceStatistics {
            triangles: regions.len() as u64,
            full_triangles: 1000,
            ..SurfaceStatistics::default()
        };
        let extraction = Extraction {
            surface: Surface {
                prefix: self.prefix.expect("an extraction"),
                regions,
                statistics,
            },
            view: self.view.clone(),
            wall,
        };
        assert!(self.reply.send(Ok(extraction)).is_ok(), "the session dropped its job");
    }

    pub(super) fn answer_cancelled(self) {
        assert!(self.token.is_cancelled(), "the job was not cancelled");
        assert!(
            self.reply.send(Err(WorkError::Cancelled)).is_ok(),
            "the session dropped its job"
        );
    }
}

impl Job<Opening> {
    pub(super) fn answer(self) {
        let mut view = self.view.clone();
        view.iso = isopeel_kernels::Isovalue::new(100.0).ok();
        view.feature_range = Some([0.0, 50.0]);
        let opening = Opening {
            volume: serde_json::value::to_raw_value(&serde_json::json!({ "id": self.volume.dataset().id }))
                .expect("JSON"),
            view,
            device: "scripted".into(),
        };
        assert!(self.reply.send(Ok(opening)).is_ok(), "the session dropped its job");
    }
}
