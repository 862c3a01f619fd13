//! Coarser cuts of the vertex tree that come before the final one on a slow line.

use std::collections::{BTreeMap, HashMap};

use isopeel::service::DeviceWorker;
use isopeel_extraction::{Refinement, Shown, Step};
use isopeel_kernels::{Region, RegionKey, Surface, Vertex};
use isopeel_view::View;
use isopeel_volumes::VolumeStep;
use tokio_util::sync::CancellationToken;

use crate::turns::{Folds, WHOLE};
use crate::{ALONE, view};

/// A line that takes few kilobytes in the time of a step.
const SLOW_BYTES: u64 = 4_000;

/// A surface of few folds, whose topology a thousand triangles have.
const RADIANS: f32 = 0.1;

/// The regions of a surface.
type Held = BTreeMap<RegionKey, Region>;

struct Viewer {
    worker: DeviceWorker,
    volume: VolumeStep,
    step: Step,
    /// The regions that the viewer shows.
    held: Held,
}

/// A step, and the surface after it.
struct Shows {
    made: Refinement,
    surface: Held,
}

impl Viewer {
    /// A viewer that is shown a cut of the tree.
    async fn start(opening: &View, volume: VolumeStep, bytes: u64) -> Self {
        let worker = DeviceWorker::start(None).expect("a thread");
        let token = CancellationToken::new();
        let improved = worker.improve(&volume, opening, &token).await;
        let improved = improved.expect("improves").expect("a tree");
        let step = Step {
            shown: Shown::Cut(improved.cut),
            line_bytes: bytes,
            ..WHOLE
        };
        let mut viewer = Self {
            worker,
            volume,
            step,
            held: Held::new(),
        };
        viewer.show(&improved.surface);
        viewer
    }

    /// Replaces the regions that a step has made.
    fn show(&mut self, made: &Surface) {
        match &made.remade {
            Some(remade) => self.held.retain(|key, _| !remade.contains(key)),
            None => self.held.clear(),
        }
        let regions = made.regions.iter().map(|region| (region.key(), region.clone()));
        self.held.extend(regions);
    }

    /// All steps to a view, the final one last.
    async fn steps(&mut self, view: &View) -> Vec<Shows> {
        let (token, mut steps) = (CancellationToken::new(), Vec::new());
        self.step.made_triangles = 0;
        loop {
            let made = self.worker.refine(&self.volume, view, self.step, &token).await;
            let made = made.expect("a step");
            self.step.shown = Shown::Cut(made.cut);
            self.step.made_triangles = made.surface.statistics.triangles;
            let is_final = made.is_final;
            self.show(&made.surface);
            let surface = self.held.clone();
            steps.push(Shows { made, surface });
            if is_final {
                return steps;
            }
            assert!(steps.len() < 10, "no end of steps");
        }
    }
}

/// Counts the edges of only one triangle, except those on the faces of the volume.
fn open_edges(surface: &Held) -> usize {
    const LATTICE: i64 = Vertex::LATTICE as i64;
    const LAST: i64 = (Folds::SIDE as i64 - 2) * LATTICE;
    let mut edges: HashMap<[[i64; 3]; 2], usize> = HashMap::new();
    for region in surface.values() {
        let place = |index: u32| region.position_of(&region.vertices[index as usize]);
        for triangle in region.indices.chunks_exact(3) {
            for (from, to) in [(0, 1), (1, 2), (2, 0)] {
                let mut edge = [place(triangle[from]), place(triangle[to])];
                edge.sort_unstable();
                *edges.entry(edge).or_default() += 1;
            }
        }
    }
    let is_inside = |place: &[i64; 3]| place.iter().all(|at| (LATTICE..LAST).contains(at));
    edges
        .iter()
        .filter(|(edge, times)| **times % 2 == 1 && edge.iter().any(is_inside))
        .count()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_slow_line_gets_coarser_cuts_first_and_the_same_surface_in_the_end() {
    let _alone = ALONE.lock().await;
    let dataset = Folds::dataset(RADIANS);
    let opening = view(&dataset, r#"{"iso":0.1,"triangles":{"share":0.2}}"#);
    let volume = VolumeStep::new(dataset.clone(), 0).expect("a step");
    let mut viewer = Viewer::start(&opening, volume, u64::MAX).await;
    let budget = view(&dataset, r#"{"iso":0.1,"triangles":30000,"alpha":0.2}"#);
    let guarded = view(
        &dataset,
        r#"{"iso":0.1,"error":"0.2vx","triangles":100000,"maxError":"0.5vx"}"#,
    );
    for view in [budget, guarded] {
        viewer.step.line_bytes = u64::MAX;
        let at_once = viewer.steps(&view).await;
        assert_eq!(at_once.len(), 1, "a fast line");
        viewer.step.line_bytes = SLOW_BYTES;
        let steps = viewer.steps(&view).await;
        assert!(steps.len() >= 2, "{} steps", steps.len());
        let triangles = |step: &Shows| step.made.surface.statistics.triangles;
        for pair in steps.windows(2) {
            assert!(2 * triangles(&pair[0]) <= triangles(&pair[1]), "each is much finer");
        }
        for step in &steps {
            assert_eq!(open_edges(&step.surface), 0, "of {} triangles", triangles(step));
        }
        let (one, last) = (&at_once[0], &steps[steps.len() - 1]);
        assert!(one.surface == last.surface, "another final surface");
        assert_eq!(
            (one.made.view.fitted, triangles(one)),
            (last.made.view.fitted, triangles(last))
        );
        let estimate = |step: &Shows| step.made.surface.statistics.estimate;
        assert_eq!(estimate(one), estimate(last));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_replaces_a_surface_at_once_is_final_on_any_line() {
    let _alone = ALONE.lock().await;
    let dataset = Folds::dataset(RADIANS);
    let opening = view(&dataset, r#"{"iso":0.1,"triangles":{"share":0.2}}"#);
    let volume = VolumeStep::new(dataset.clone(), 0).expect("a step");
    let mut viewer = Viewer::start(&opening, volume, SLOW_BYTES).await;
    viewer.step.shown = Shown::Alike;
    let edited = view(&dataset, r#"{"iso":0.1,"triangles":30000,"alpha":0.2}"#);
    assert_eq!(viewer.steps(&edited).await.len(), 1);
}
