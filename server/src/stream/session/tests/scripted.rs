//! The device of these tests: jobs wait until the test answers them.

use std::sync::Arc;
use std::time::Duration;

use isopeel_extraction::{
    self, CutId, FullCount, Measurement, Question, Refinement, Shown, ShownSurface, Step, WorkError,
};
use isopeel_kernels::{Level, Region, RegionKey, Surface, SurfaceStatistics, Topology, Vertex};
use isopeel_view::View;
use isopeel_view::quality::Fitted;
use isopeel_volumes::{Dataset, VolumeStep, testing};
use serde_json::value::RawValue;
use tokio::sync::{mpsc, oneshot, watch};
use tokio_util::sync::CancellationToken;

use crate::access::Identity;
use crate::service::OpeningProgress;
use crate::stream::backend::{Backend, Opening};

fn dataset(id: &str) -> Arc<Dataset> {
    Arc::new(Dataset {
        steps: 6,
        ..testing::dataset(id, [65; 3], &["density"])
    })
}

/// A job that waits for the test's answer.
pub(super) struct Job<T> {
    pub volume: VolumeStep,
    pub view: View,
    step: Option<Step>,
    pub token: CancellationToken,
    pub reply: oneshot::Sender<Result<T, WorkError>>,
    /// Progress of an `open`; `None` for other jobs.
    pub progress: Option<watch::Sender<OpeningProgress>>,
}

/// A question that waits for the test's answer.
pub(super) struct Asked {
    pub shown: Option<ShownSurface>,
    pub question: Question,
    pub token: CancellationToken,
    pub reply: oneshot::Sender<Result<isopeel_extraction::Answer, WorkError>>,
}

#[derive(Clone)]
pub(super) struct Scripted {
    pub opens: mpsc::Sender<Job<Opening>>,
    pub counts: mpsc::Sender<Job<FullCount>>,
    pub steps: mpsc::Sender<Job<Refinement>>,
    pub improvements: mpsc::Sender<Job<Option<Refinement>>>,
    pub measurements: mpsc::Sender<Job<Option<Measurement>>>,
    pub questions: mpsc::Sender<Asked>,
    /// Jobs that read time steps ahead.
    pub ahead: mpsc::Sender<Job<()>>,
    /// Jobs that resolve views, if the test answers them. `None`: views are resolved at once.
    pub resolutions: Option<mpsc::Sender<Job<View>>>,
}

impl Scripted {
    async fn ask<T>(
        to: &mpsc::Sender<Job<T>>,
        volume: &VolumeStep,
        view: &View,
        step: Option<Step>,
        token: &CancellationToken,
        progress: Option<watch::Sender<OpeningProgress>>,
    ) -> Result<T, WorkError> {
        let (reply, answer) = oneshot::channel();
        let job = Job {
            volume: volume.clone(),
            view: view.clone(),
            step,
            token: token.clone(),
            reply,
            progress,
        };
        to.send(job).await.map_err(|_| WorkError::Stopped)?;
        answer.await.unwrap_or(Err(WorkError::Stopped))
    }
}

impl Backend for Scripted {
    fn find(&self, volume: &str, _: &Identity) -> Option<Arc<Dataset>> {
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

    async fn describe(&self, volume: &VolumeStep, token: &CancellationToken) -> Result<Box<RawValue>, WorkError> {
        tokio::select! {
            () = tokio::time::sleep(Duration::from_millis(1)) => {}
            () = token.cancelled() => return Err(WorkError::Cancelled),
        }
        Ok(serde_json::value::to_raw_value(&serde_json::json!({ "step": volume.step() })).expect("JSON"))
    }

    async fn read_ahead(&self, volume: &VolumeStep, views: &[View], token: &CancellationToken) {
        if let Some(view) = views.first() {
            let _ = Self::ask(&self.ahead, volume, view, None, token, None).await;
        }
    }

    async fn resolve(&self, volume: &VolumeStep, view: &View, token: &CancellationToken) -> Result<View, WorkError> {
        match &self.resolutions {
            Some(resolutions) => Self::ask(resolutions, volume, view, None, token, None).await,
            None => Ok(resolved(volume, view)),
        }
    }

    async fn count(&self, volume: &VolumeStep, view: &View, token: &CancellationToken) -> Result<FullCount, WorkError> {
        Self::ask(&self.counts, volume, view, None, token, None).await
    }

    async fn refine(
        &self,
        volume: &VolumeStep,
        view: &View,
        step: Step,
        token: &CancellationToken,
    ) -> Result<Refinement, WorkError> {
        Self::ask(&self.steps, volume, view, Some(step), token, None).await
    }

    async fn improve(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> Result<Option<Refinement>, WorkError> {
        Self::ask(&self.improvements, volume, view, None, token, None).await
    }

    async fn measure(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> Result<Option<Measurement>, WorkError> {
        Self::ask(&self.measurements, volume, view, None, token, None).await
    }

    async fn answer(
        &self,
        _: &VolumeStep,
        shown: Option<&ShownSurface>,
        question: Question,
        token: &CancellationToken,
    ) -> Result<isopeel_extraction::Answer, WorkError> {
        let (reply, answer) = oneshot::channel();
        let asked = Asked {
            shown: shown.cloned(),
            question,
            token: token.clone(),
            reply,
        };
        self.questions.send(asked).await.map_err(|_| WorkError::Stopped)?;
        answer.await.unwrap_or(Err(WorkError::Stopped))
    }
}

/// A view with every value: the range of its feature ends with the number of the step.
pub(super) fn resolved(volume: &VolumeStep, view: &View) -> View {
    View {
        iso: view.iso.or(isopeel_kernels::Isovalue::new(100.0).ok()),
        feature_range: view.feature_range.or(Some([-1.0, volume.step() as f32])),
        ..view.clone()
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
        size: 0,
        vertices: [[0, 0, 0], [65536, 0, 0], [0, 65536 * shape, 0]]
            .map(vertex)
            .to_vec()
            .into(),
        indices: vec![0, 1, 2].into(),
        values: Vec::new().into(),
        level_triangles: [1, 0, 0, 0, 0, 0],
        error: None,
    }
}

/// A surface of regions 0, 1, … with these shapes; 0 leaves a region out.
pub(super) fn shapes(shapes: &[i32]) -> Vec<Region> {
    let regions = shapes.iter().enumerate().filter(|(_, shape)| **shape != 0);
    regions.map(|(x, shape)| region(x as u32, *shape)).collect()
}

/// Result of a step: the cut that it ends with, and the regions.
pub(super) struct Answer {
    cut: u64,
    level: u8,
    is_final: bool,
    can_improve: bool,
    remade: Option<Vec<RegionKey>>,
    regions: Vec<Region>,
    full_triangles: u64,
    triangles: u64,
    is_tree_cut: bool,
}

impl Answer {
    /// The final surface, as a whole.
    pub(super) fn last(cut: u64, regions: Vec<Region>) -> Self {
        Self {
            cut,
            level: 0,
            is_final: true,
            can_improve: false,
            remade: None,
            triangles: regions.len() as u64,
            regions,
            full_triangles: 1000,
            is_tree_cut: false,
        }
    }

    /// Reports that the surface is a cut of the vertex tree.
    pub(super) fn of_tree(self) -> Self {
        Self {
            is_tree_cut: true,
            ..self
        }
    }

    /// Sets the reported number of triangles, whatever the regions have.
    pub(super) fn of_triangles(self, triangles: u64) -> Self {
        Self { triangles, ..self }
    }

    /// Sets the number of triangles of the full surface.
    pub(super) fn of_full(self, full_triangles: u64) -> Self {
        Self { full_triangles, ..self }
    }

    /// A prefix of level 4.
    pub(super) fn prefix(cut: u64, regions: Vec<Region>) -> Self {
        Self {
            level: 4,
            is_final: false,
            ..Self::last(cut, regions)
        }
    }

    /// Reports that only these regions were remade.
    pub(super) fn of_regions(self, remade: &[u32]) -> Self {
        Self {
            remade: Some(remade.iter().map(|&x| RegionKey::smallest([x, 0, 0])).collect()),
            ..self
        }
    }

    /// Reports that a better surface may follow.
    pub(super) fn improvable(self) -> Self {
        Self {
            can_improve: true,
            ..self
        }
    }

    /// Reports that this is not the final surface yet.
    pub(super) fn on_the_way(self) -> Self {
        Self {
            is_final: false,
            ..self
        }
    }
}

impl Job<Refinement> {
    /// The surface that the client shows when the step begins.
    pub(super) fn shown(&self) -> Shown {
        self.step.expect("a step").shown
    }

    /// Triangles of the surface that the last step towards the view has made.
    pub(super) fn made_triangles(&self) -> u64 {
        self.step.expect("a step").made_triangles
    }

    pub(super) fn answer(self, answer: Answer) {
        let made = answer.refinement(&self.view);
        assert!(self.reply.send(Ok(made)).is_ok(), "the session dropped its job");
    }

    pub(super) async fn answer_cancelled(self) {
        self.token.cancelled().await;
        assert!(
            self.reply.send(Err(WorkError::Cancelled)).is_ok(),
            "the session dropped its job"
        );
    }
}

impl Answer {
    /// Converts this to the device's answer to a job of this view.
    pub(super) fn refinement(self, view: &View) -> Refinement {
        let answer = self;
        let statistics = SurfaceStatistics {
            triangles: answer.triangles,
            full_triangles: answer.full_triangles,
            ..SurfaceStatistics::default()
        };
        Refinement {
            surface: Surface {
                prefix: Level::new(answer.level).expect("a level"),
                remade: answer.remade,
                regions: answer.regions,
                statistics,
            },
            view: View {
                fitted: answer.is_tree_cut.then_some(Fitted {
                    threshold: 1.0,
                    topology: Topology::Preserve,
                    triangles: answer.triangles,
                    is_tree_cut: true,
                    pixels: None,
                }),
                ..view.clone()
            },
            cut: CutId::new(answer.cut),
            target: Some(CutId::new(1000)),
            is_final: answer.is_final,
            can_improve: answer.can_improve,
            wall: Duration::from_millis(10),
            meshing: Duration::from_millis(5),
        }
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
            shares_processors: true,
        };
        assert!(self.reply.send(Ok(opening)).is_ok(), "the session dropped its job");
    }
}
