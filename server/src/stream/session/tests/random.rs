//! Random clients against a device that answers at random. Every frame is checked against `PROTOCOL.md`, and in the end each surface is
//! that of its last edit.

mod client;

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use futures_util::future::join_all;
use isopeel_extraction::{FullCount, Measurement, Refinement, WorkError};
use isopeel_kernels::Region;
use isopeel_view::View;
use isopeel_view::quality::{Budget, TriangleBudget};

use super::super::draw_pause::DRAW_PAUSE;
use super::super::rest::REST_AFTER;
use super::super::{Incoming, Outgoing};
use super::scripted::{Answer, Job, shapes};
use super::viewer::Viewer;
use client::Client;

/// A linear congruential generator.
struct Random(u64);

impl Random {
    fn below(&mut self, n: u64) -> u64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % n
    }

    fn is_one_in(&mut self, n: u64) -> bool {
        self.below(n) == 0
    }
}

/// Returns the triangles of the full surface of an isovalue.
fn full_triangles(iso: f32) -> u64 {
    1000 * (1 + iso as u64)
}

/// The values that determine a final surface and its number of triangles.
#[derive(Clone, Debug, PartialEq)]
struct Wanted {
    iso: f32,
    /// In tenths.
    alpha: u64,
    /// In hundredths; `None` if an error or a budget decides instead.
    beta: Option<u64>,
    budget: Option<Budget>,
}

impl Wanted {
    fn of(view: &View) -> Self {
        Self {
            iso: view.iso.expect("an isovalue").get(),
            alpha: (view.alpha * 10.0).round() as u64,
            beta: view.beta_in_force().map(|beta| (beta * 100.0).round() as u64),
            budget: view.budget,
        }
    }

    fn triangles(&self) -> u64 {
        let full = full_triangles(self.iso);
        match self.budget.map(|budget| budget.as_number(full)) {
            Some(Budget::Triangles(triangles)) => triangles.of(full).min(full),
            Some(Budget::Bytes(_)) | None => full,
        }
    }

    /// The shapes of eight regions; 0 stands for no region.
    fn shapes(&self) -> [i32; 8] {
        // The values go into the low bits, from which the generator derives all others.
        let mut hash =
            Random(self.triangles() + 10_000 * self.alpha + 1_000_000 * self.beta.map_or(0, |beta| beta + 1));
        hash.0 += u64::from(self.iso.to_bits()) << 24;
        for _ in 0..3 {
            hash.below(2);
        }
        std::array::from_fn(|_| hash.below(4) as i32)
    }
}

/// The one job that waits for an answer.
enum Work {
    Count(Job<FullCount>),
    Step(Job<Refinement>),
    Improve(Job<Option<Refinement>>),
    Measure(Job<Option<Measurement>>),
}

impl Work {
    /// Random answers of a device.
    fn answer(self, random: &mut Random, cut: u64) {
        match self {
            Self::Count(job) => {
                let triangles = full_triangles(job.view.iso.expect("an isovalue").get());
                let count = FullCount {
                    triangles,
                    ..FullCount::default()
                };
                let _ = job.reply.send(Ok(count));
            }
            Self::Step(job) if job.token.is_cancelled() && random.is_one_in(2) => {
                let _ = job.reply.send(Err(WorkError::Cancelled));
            }
            Self::Step(job) => {
                let (is_last, improvable) = (!random.is_one_in(3), random.is_one_in(3));
                let answer = if is_last {
                    let answer = last(&job.view, cut);
                    if improvable { answer.improvable() } else { answer }
                } else {
                    Answer::prefix(cut, random_shapes(random))
                };
                let answer = answer.of_full(full_triangles(job.view.iso.expect("an isovalue").get()));
                let made = answer.refinement(&job.view);
                let _ = job.reply.send(Ok(made));
            }
            Self::Improve(job) => {
                let answer = match random.below(3) {
                    _ if job.token.is_cancelled() => Err(WorkError::Cancelled),
                    0 => Ok(None),
                    _ => {
                        let full = full_triangles(job.view.iso.expect("an isovalue").get());
                        Ok(Some(last(&job.view, cut).of_full(full).refinement(&job.view)))
                    }
                };
                let _ = job.reply.send(answer);
            }
            Self::Measure(job) => {
                let measured = Measurement {
                    whole: isopeel_extraction::MeasuredError { rms: 0.0, max: 0.0 },
                    regions: Vec::new(),
                };
                let _ = job.reply.send(match job.token.is_cancelled() {
                    true => Err(WorkError::Cancelled),
                    false => Ok(Some(measured)),
                });
            }
        }
    }
}

fn last(view: &View, cut: u64) -> Answer {
    let wanted = Wanted::of(view);
    Answer::last(cut, shapes(&wanted.shapes())).of_triangles(wanted.triangles())
}

fn random_shapes(random: &mut Random) -> Vec<Region> {
    let some: [i32; 8] = std::array::from_fn(|_| random.below(4) as i32);
    shapes(&some)
}

/// A session, its client and its device.
struct Play {
    viewer: Viewer,
    client: Client,
    work: Option<Work>,
    random: Random,
    jobs: u64,
}

impl Play {
    /// Lets the session run, and takes its next job for the device.
    async fn turn(&mut self) {
        for _ in 0..4 {
            tokio::task::yield_now().await;
        }
        let viewer = &mut self.viewer;
        let counts = viewer.counts.try_recv().ok().map(Work::Count);
        let steps = viewer.steps.try_recv().ok().map(Work::Step);
        let improvements = viewer.improvements.try_recv().ok().map(Work::Improve);
        let measurements = viewer.measurements.try_recv().ok().map(Work::Measure);
        for work in [counts, steps, improvements, measurements].into_iter().flatten() {
            assert!(self.work.replace(work).is_none(), "two jobs at a time");
        }
    }

    fn answer(&mut self) {
        if let Some(work) = self.work.take() {
            self.jobs += 1;
            work.answer(&mut self.random, self.jobs);
        }
    }

    /// Reads a frame, if one comes soon.
    async fn read(&mut self, patience: Duration) -> bool {
        match tokio::time::timeout(patience, self.viewer.frames.recv()).await {
            Err(_) => return false,
            Ok(None) => panic!("the session ended"),
            Ok(Some(Outgoing::Text(text))) => self.client.text(&serde_json::from_str(&text).expect("JSON")),
            Ok(Some(Outgoing::Binary(bytes))) => self.client.chunk(&bytes),
            Ok(Some(Outgoing::Ping(number))) => {
                let inbox = self.viewer.inbox.as_ref().expect("connected");
                inbox.send(Incoming::Pong(number)).await.expect("the session listens");
            }
            Ok(Some(Outgoing::Close(code))) => panic!("closed with {code:?}"),
        }
        true
    }

    /// Reads and answers until nothing has arrived for longer than both the draw pause and the time until a viewer rests.
    async fn settle(&mut self) {
        let mut last = Instant::now();
        while last.elapsed() < 4 * DRAW_PAUSE.max(REST_AFTER) {
            self.turn().await;
            let has_work = self.work.is_some();
            self.answer();
            if self.read(Duration::from_millis(5)).await || has_work {
                last = Instant::now();
            }
        }
    }
}

/// The surfaces that a client's edits request, by `PROTOCOL.md`.
struct Model {
    surfaces: BTreeMap<u64, Wanted>,
    opening: Wanted,
}

impl Model {
    fn edit(&mut self, surface: u64, random: &mut Random, decides: bool) -> String {
        let budget = self.surfaces.values().find_map(|wanted| wanted.budget);
        let mut wanted = self.surfaces.get(&surface).cloned().unwrap_or_else(|| Wanted {
            budget: budget.or(self.opening.budget),
            ..self.opening.clone()
        });
        let mut fields = format!(r#"{{"type":"edit","surface":{surface}"#);
        if random.is_one_in(2) {
            wanted.iso = 1.0 + random.below(6) as f32;
            fields += &format!(r#","iso":{}"#, wanted.iso);
        }
        if random.is_one_in(2) {
            wanted.alpha = random.below(10);
            fields += &format!(r#","alpha":0.{}"#, wanted.alpha);
        }
        if decides {
            match random.below(6) {
                0 => {
                    wanted.beta = Some(1 + random.below(9));
                    wanted.budget = None;
                    fields += &format!(r#","beta":0.0{}"#, wanted.beta.expect("set"));
                }
                1 => {
                    (wanted.beta, wanted.budget) = (None, None);
                    fields += r#","error":0.5"#;
                }
                2 => {
                    let triangles = 100 * (1 + random.below(20));
                    let budget = Some(Budget::Triangles(TriangleBudget::AtMost(triangles)));
                    (wanted.beta, wanted.budget) = (None, budget);
                    for other in self.surfaces.values_mut().filter(|other| other.budget.is_some()) {
                        other.budget = budget;
                    }
                    fields += &format!(r#","triangles":{triangles}"#);
                }
                _ => {}
            }
        }
        self.surfaces.insert(surface, wanted);
        fields + "}"
    }

    /// Surfaces that a client shows in the end.
    fn shapes(&self) -> BTreeMap<u64, BTreeMap<u32, i32>> {
        let sharing: Vec<&Wanted> = self
            .surfaces
            .values()
            .filter(|wanted| wanted.budget.is_some())
            .collect();
        let all: u64 = sharing.iter().map(|wanted| full_triangles(wanted.iso)).sum();
        let shapes = |wanted: &Wanted| {
            let part = |budget: Budget| budget.part(full_triangles(wanted.iso), all);
            let wanted = Wanted {
                budget: wanted.budget.map(part),
                ..wanted.clone()
            };
            let shapes = (0..).zip(wanted.shapes());
            shapes.filter(|(_, shape)| *shape != 0).collect()
        };
        self.surfaces
            .iter()
            .map(|(number, wanted)| (*number, shapes(wanted)))
            .collect()
    }
}

/// Plays one random script. `decides`: edits also change the criterion, and work is cancelled; else all surfaces share one budget all the
/// time.
async fn play(seed: u64, decides: bool) {
    let viewer = Viewer::opened().await;
    let opening = Wanted {
        iso: 100.0,
        alpha: (View::OPENING_ALPHA * 10.0) as u64,
        beta: None,
        budget: Some(Budget::Triangles(TriangleBudget::AtMost(3000))),
    };
    viewer.say(r#"{"type":"edit","triangles":3000}"#).await;
    let mut model = Model {
        surfaces: BTreeMap::from([(0, opening.clone())]),
        opening: Wanted {
            budget: Some(Budget::Triangles(TriangleBudget::Share(View::OPENING_BUDGET))),
            ..opening
        },
    };
    let client = Client::new((!decides).then_some(3000));
    let (work, random) = (None, Random(seed));
    let mut play = Play {
        viewer,
        client,
        work,
        random,
        jobs: 1,
    };
    for _ in 0..150 {
        play.turn().await;
        match play.random.below(8) {
            0 => {
                let surface = play.random.below(4);
                let edit = model.edit(surface, &mut play.random, decides);
                play.viewer.say(&edit).await;
            }
            1 if play.random.is_one_in(4) => {
                let surface = play.random.below(6);
                // Without any surface the budget is forgotten.
                if model.surfaces.keys().eq([&surface]) {
                    continue;
                }
                model.surfaces.remove(&surface);
                play.viewer
                    .say(&format!(r#"{{"type":"remove","surface":{surface}}}"#))
                    .await;
            }
            2 if decides && play.random.is_one_in(8) => play.viewer.say(r#"{"type":"cancel"}"#).await,
            3 if play.random.is_one_in(4) => {
                let generation = play.client.newest;
                play.viewer
                    .say(&format!(r#"{{"type":"drawn","generation":{generation}}}"#))
                    .await;
            }
            4 if play.random.is_one_in(8) => play.viewer.say(r#"{"type":"edit","surface":5,"alpha":0.5}"#).await,
            1..=5 => play.answer(),
            _ => {
                play.read(Duration::from_millis(1)).await;
            }
        }
    }
    if decides {
        // Cancelled surfaces are made only after another edit.
        for surface in model.surfaces.keys() {
            play.viewer
                .say(&format!(r#"{{"type":"edit","surface":{surface}}}"#))
                .await;
        }
    }
    play.settle().await;
    let shown = play
        .client
        .surfaces
        .iter()
        .map(|(number, held)| (*number, held.map.clone()));
    let shown: BTreeMap<_, _> = shown
        .filter(|(number, _)| model.surfaces.contains_key(number))
        .collect();
    assert_eq!(
        shown,
        model.shapes(),
        "seed {seed}: {:?}, {:?}",
        model.surfaces,
        play.client.log
    );
    assert!(play.client.surfaces.len() <= model.surfaces.len(), "seed {seed}");
}

#[tokio::test]
async fn random_edits_of_surfaces_with_one_budget_end_in_what_was_asked_for() {
    join_all((0..24).map(|seed| play(seed, false))).await;
}

#[tokio::test]
async fn random_edits_and_cancellations_end_in_what_was_asked_for() {
    join_all((100..124).map(|seed| play(seed, true))).await;
}
