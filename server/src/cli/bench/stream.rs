//! The case `stream`: times edits that a viewer sends through a socket of the real server, from the edit to its first and last byte.
//!
//! Server and client run in this process and use the loopback interface, so that the benchmark needs only the binary. No edit is a cache
//! hit: an isovalue is never used twice, and every other edit differs from the previous one.

pub(super) mod camera;
mod client;
mod lines;
mod server;

use std::sync::Arc;
use std::time::Duration;

use isopeel_codec::chunk::ChunkError;
use isopeel_kernels::SampleType;
use isopeel_view::quality::{MaxError, MesherName, TopologyName, TriangleBudget};
use isopeel_view::{Edit, PointJson, TransferFunctionJson};
use isopeel_volumes::{Dataset, Geometry, ReadError, memory_dataset};
use tokio::runtime::Runtime;

use super::reference::{Counts, count, equal};
use super::volumes::Recipe;
use super::{Args, BenchError, EditName, print, round};
use crate::serve::ServeError;
use client::{Client, Request, Streamed};
use lines::{DragLine, StreamLine};
use server::Server;

/// Edits per second of a drag: a slow pointer, and a pointer at the rate of the display.
const DRAG_HZ: [f64; 2] = [20.0, 60.0];

/// β at the ends of a drag.
const DRAG_BETA: [f32; 2] = [0.01, 0.1];

/// Why the stream could not be timed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StreamError {
    /// The server ended.
    #[error(transparent)]
    Server(#[from] ServeError),
    /// The server or its runtime cannot be started.
    #[error("the server cannot be started")]
    Start(#[from] std::io::Error),
    /// The client of the stream failed.
    #[error(transparent)]
    Client(#[from] isopeel_client::Error),
    /// The server has sent no frame for this time.
    #[error("no frame came for {} s", .0.as_secs())]
    Silent(Duration),
    /// The samples do not make a dataset.
    #[error(transparent)]
    Dataset(#[from] ReadError),
    /// A chunk has no valid header.
    #[error(transparent)]
    Chunk(#[from] ChunkError),
    /// The surface does not follow the camera.
    #[error("the surface is empty, or no cut of the vertex tree: only those follow the camera")]
    NoTreeCut,
}

/// Generates distinct isovalues around the isovalue of a recipe. Uses multiples of the golden ratio modulo 1, which are spread evenly.
struct Isovalues {
    centre: f32,
    half_width: f32,
    /// Number of isovalues so far.
    used: u32,
}

impl Isovalues {
    fn new(recipe: &Recipe) -> Self {
        Self {
            centre: recipe.iso,
            // A hundredth of the range of values. The surfaces have about the same size, but no common vertex.
            half_width: match recipe.sample_type {
                SampleType::U8 | SampleType::I8 => 2.56,
                SampleType::U16 | SampleType::I16 => 655.36,
                SampleType::F32 => 0.04,
            },
            used: 0,
        }
    }

    fn next(&mut self) -> f32 {
        const GOLDEN: f64 = 0.618_033_988_749_894_9;
        self.used += 1;
        let offset = (f64::from(self.used) * GOLDEN).fract() * 2.0 - 1.0;
        (f64::from(self.centre) + offset * f64::from(self.half_width)) as f32
    }

    /// Returns isovalues for a drag: the next `count` ones in ascending order.
    fn ascending(&mut self, count: usize) -> Vec<f32> {
        let mut values: Vec<f32> = (0..count).map(|_| self.next()).collect();
        values.sort_by(f32::total_cmp);
        values
    }
}

/// Values of the view at which all kinds of edits are timed.
struct Setting {
    name: String,
    /// Budget in triangles, if the setting has one.
    budget: Option<u64>,
    /// All values except the isovalue.
    edit: Edit,
}

impl Setting {
    fn is_full(&self) -> bool {
        self.edit.beta.is_some_and(|beta| beta < 0.0)
    }

    fn scaled_budget(&self, factor: f64) -> Option<u64> {
        self.budget.map(|budget| (budget as f64 * factor) as u64)
    }
}

/// A viewer of one volume.
struct Bench<'a> {
    args: &'a Args,
    recipe: &'a Recipe,
    client: Client,
    isovalues: Isovalues,
    /// The view with which the volume opens.
    opening: Edit,
    /// Number of time steps that were shown.
    steps: u32,
    full_triangles: u64,
}

/// Times the stream of one volume. No other engine may be open.
pub(super) fn run(args: &Args, recipe: &Recipe) -> Result<(), BenchError> {
    let (dataset, counts) = dataset(args, recipe)?;
    runtime()?.block_on(async {
        let id = dataset.id.clone();
        let server = Server::start(dataset, &args.device, args.in_process).await?;
        let mut client = Client::connect(server.address, &id).await?;
        let opening = client.open(0).await?;
        let mut bench = Bench {
            args,
            recipe,
            client,
            isovalues: Isovalues::new(recipe),
            opening,
            steps: 1,
            full_triangles: counts.full_triangles,
        };
        bench.check(&counts).await?;
        for setting in bench.settings() {
            bench.setting(&setting).await?;
        }
        for hz in DRAG_HZ.into_iter().filter(|_| args.wants_edit(EditName::Drag)) {
            bench.drag(hz, true).await?;
            bench.drag(hz, false).await?;
        }
        drop(bench);
        Ok(server.stop().await?)
    })
}

fn runtime() -> Result<Runtime, StreamError> {
    let mut builder = tokio::runtime::Builder::new_multi_thread();
    builder.enable_all().build().map_err(StreamError::Start)
}

/// Returns the volume in host memory, and the counts of its surface. Closes the engine that has generated the volume, because PoCL 3.1
/// fails with two engines in one process.
fn dataset(args: &Args, recipe: &Recipe) -> Result<(Dataset, Counts), BenchError> {
    let engine = args.device.open()?;
    let volume = recipe.generate(&engine)?;
    let counts = count(&engine, &volume, recipe.iso)?;
    let samples = Arc::new(recipe.download(&engine, &volume)?);
    let geometry = Geometry {
        spacing: recipe.grid.spacing.map(f64::from),
        ..Geometry::of_index(recipe.grid.dims)
    };
    // One step to open, and one for each run that opens a new step. All steps share the samples.
    let settings = args.fraction.len() + 1;
    let steps = vec![samples; 2 + settings * (args.repeats as usize + 1)];
    let dataset = memory_dataset(&recipe.name, geometry, steps).map_err(StreamError::Dataset)?;
    Ok((dataset, counts))
}

impl Bench<'_> {
    /// Compares the full surface of the stream with the reference counts.
    async fn check(&mut self, counts: &Counts) -> Result<(), BenchError> {
        let edit = Edit {
            iso: Some(self.recipe.iso),
            ..self.unguarded(Some(-1.0), None)
        };
        let statistics = self.client.edit(&edit).await?.statistics;
        let expected = match self.args.mesher {
            MesherName::Dual => counts.dual_triangles,
            MesherName::MarchingCubes => counts.full_triangles,
        };
        equal(
            self.recipe,
            "full triangles of the stream",
            statistics.full_triangles,
            counts.full_triangles,
        )?;
        equal(self.recipe, "triangles of the stream", statistics.triangles, expected)
    }

    /// Returns an edit that sets every value except the isovalue, and turns the guards off.
    fn unguarded(&self, beta: Option<f32>, triangles: Option<u64>) -> Edit {
        Edit {
            beta,
            error: None,
            triangles: triangles.map(TriangleBudget::AtMost),
            max_error: Some(MaxError::None),
            topology: Some(TopologyName::Free),
            ..self.opened()
        }
    }

    /// Returns the opening view of the volume without its isovalue, and with the chosen mesher.
    fn opened(&self) -> Edit {
        Edit {
            iso: None,
            cap: None,
            mesher: Some(self.args.mesher),
            error: self.opening.error.filter(|_| self.args.mesher == MesherName::Dual),
            ..self.opening.clone()
        }
    }

    fn settings(&self) -> Vec<Setting> {
        let mut settings = vec![Setting {
            name: "opening".to_owned(),
            budget: None,
            edit: self.opened(),
        }];
        for &fraction in &self.args.fraction {
            let full = fraction >= 1.0;
            let budget = (!full).then(|| ((fraction * self.full_triangles as f64) as u64).max(1));
            settings.push(Setting {
                name: if full {
                    "full".to_owned()
                } else {
                    format!("{} %", round(100.0 * fraction))
                },
                budget,
                edit: self.unguarded(full.then_some(-1.0), budget),
            });
        }
        settings
    }

    /// Returns an edit with a new isovalue.
    fn fresh(&mut self, edit: &Edit) -> Edit {
        Edit {
            iso: Some(self.isovalues.next()),
            ..edit.clone()
        }
    }

    /// Times every kind of edit at one setting.
    async fn setting(&mut self, setting: &Setting) -> Result<(), BenchError> {
        let wants = |edit| self.args.wants_edit(edit);
        if wants(EditName::Isovalue) {
            self.isovalue(setting).await?;
        }
        if wants(EditName::Budget) {
            self.budget_and_beta(setting).await?;
        }
        if wants(EditName::Alpha) {
            self.alternate(setting, "alpha", &alphas(setting)).await?;
        }
        if wants(EditName::TransferFunction) {
            self.alternate(setting, "transfer function", &transfer_functions())
                .await?;
        }
        if wants(EditName::Rested) {
            self.rested(setting).await?;
        }
        if wants(EditName::Feature) {
            self.feature(setting, "feature on", "gradient-magnitude", "none")
                .await?;
            self.feature(setting, "feature off", "none", "gradient-magnitude")
                .await?;
        }
        if wants(EditName::Step) {
            self.step(setting, "new time step", true).await?;
            self.step(setting, "resident time step", false).await?;
        }
        Ok(())
    }

    async fn isovalue(&mut self, setting: &Setting) -> Result<(), BenchError> {
        let start = self.fresh(&setting.edit);
        self.client.edit(&start).await?;
        let mut runs = Vec::new();
        for _ in 0..=self.args.repeats {
            let edit = Edit {
                iso: Some(self.isovalues.next()),
                ..Edit::default()
            };
            runs.push(self.client.edit(&edit).await?);
        }
        self.print(setting, "isovalue", &runs[1..])
    }

    /// Times edits of a budget by a tenth. Without a budget, times edits of β by a third and by a thousandth.
    async fn budget_and_beta(&mut self, setting: &Setting) -> Result<(), BenchError> {
        let of_beta = |beta: f32| Edit {
            beta: Some(beta),
            ..Edit::default()
        };
        if setting.is_full() {
            // From a quarter of the triangles to all of them. A β below 0 has no small edit, because all such values mean the same.
            let quarter = Edit {
                triangles: Some(TriangleBudget::AtMost((self.full_triangles / 4).max(1))),
                ..Edit::default()
            };
            return self.between(setting, "beta", &quarter, &of_beta(-1.0)).await;
        }
        if let Some(budgets) = budgets(setting) {
            return self.alternate(setting, "budget", &budgets).await;
        }
        let betas = [0.03, 0.02];
        let [_, beta] = betas;
        self.alternate(setting, "beta", &betas.map(of_beta)).await?;
        let close = [beta * 1.001, beta].map(of_beta);
        self.alternate(setting, "small beta", &close).await
    }

    /// Times two edits in turns, at a new isovalue. The second edit has the value of the setting.
    async fn alternate(&mut self, setting: &Setting, name: &'static str, edits: &[Edit; 2]) -> Result<(), BenchError> {
        let start = self.fresh(&setting.edit);
        self.client.edit(&start).await?;
        self.in_turns(setting, name, edits).await
    }

    /// Times edits of a viewer at rest. If an error or a budget decides, the vertex tree is already built.
    async fn rested(&mut self, setting: &Setting) -> Result<(), BenchError> {
        if setting.is_full() || self.args.mesher != MesherName::Dual {
            return Ok(());
        }
        let start = self.fresh(&setting.edit);
        self.client.edit(&start).await?;
        self.client.rest().await?;
        if let Some(budgets) = budgets(setting) {
            self.in_turns(setting, "budget, rested", &budgets).await?;
        }
        self.in_turns(setting, "alpha, rested", &alphas(setting)).await?;
        self.in_turns(setting, "transfer function, rested", &transfer_functions())
            .await
    }

    /// Times two edits in turns, at the current isovalue.
    async fn in_turns(&mut self, setting: &Setting, name: &'static str, edits: &[Edit; 2]) -> Result<(), BenchError> {
        self.client.edit(&edits[1]).await?;
        let mut runs = Vec::new();
        for i in 0..=self.args.repeats {
            runs.push(self.client.edit(&edits[i as usize % 2]).await?);
        }
        self.print(setting, name, &runs[1..])
    }

    /// Times the edit `to` after the edit `from`, at a new isovalue in each run.
    async fn between(
        &mut self,
        setting: &Setting,
        name: &'static str,
        from: &Edit,
        to: &Edit,
    ) -> Result<(), BenchError> {
        let mut runs = Vec::new();
        for _ in 0..=self.args.repeats {
            let start = self.fresh(&setting.edit);
            self.client.edit(&start).await?;
            self.client.edit(from).await?;
            runs.push(self.client.edit(to).await?);
        }
        self.print(setting, name, &runs[1..])
    }

    async fn feature(&mut self, setting: &Setting, name: &'static str, to: &str, from: &str) -> Result<(), BenchError> {
        let mut runs = Vec::new();
        for _ in 0..=self.args.repeats {
            // With a new isovalue, only the pyramid with the feature `from` is resident, and not the one with `to`.
            let before = Edit {
                feature: Some(from.to_owned()),
                feature_range: None,
                ..self.fresh(&setting.edit)
            };
            self.client.edit(&before).await?;
            let edit = Edit {
                feature: Some(to.to_owned()),
                ..Edit::default()
            };
            runs.push(self.client.edit(&edit).await?);
        }
        self.print(setting, name, &runs[1..])
    }

    /// Times opening a time step. If `is_new`, each run opens a step for the first time; otherwise the runs alternate between the last two
    /// steps.
    async fn step(&mut self, setting: &Setting, name: &'static str, is_new: bool) -> Result<(), BenchError> {
        let mut runs = Vec::new();
        for i in 0..=self.args.repeats {
            if is_new {
                self.steps += 1;
            }
            let step = if is_new { self.steps - 1 } else { self.steps - 2 + i % 2 };
            let edit = self.fresh(&setting.edit);
            runs.push(self.client.step(step, &edit).await?);
        }
        self.print(setting, name, &runs[1..])
    }

    /// Measures a drag from the opening view: of the isovalue, or else of β.
    async fn drag(&mut self, hz: f64, is_isovalue: bool) -> Result<(), BenchError> {
        let seconds = self.args.drag_seconds;
        let count = ((hz * seconds) as usize).max(1);
        let opened = self.fresh(&self.opened());
        let start = if is_isovalue {
            opened
        } else {
            Edit {
                beta: Some(DRAG_BETA[0]),
                error: None,
                triangles: None,
                ..opened
            }
        };
        self.client.edit(&start).await?;
        let edits: Vec<Edit> = if is_isovalue {
            let edit_of = |iso| Edit {
                iso: Some(iso),
                ..Edit::default()
            };
            self.isovalues.ascending(count).into_iter().map(edit_of).collect()
        } else {
            let beta = |i: usize| DRAG_BETA[0] + (DRAG_BETA[1] - DRAG_BETA[0]) * (i + 1) as f32 / count as f32;
            let edit_of = |i| Edit {
                beta: Some(beta(i)),
                ..Edit::default()
            };
            (0..count).map(edit_of).collect()
        };
        let requests = edits.iter().map(Request::Edit);
        let dragged = self.client.drag(requests, Duration::from_secs_f64(1.0 / hz)).await?;
        let edit = if is_isovalue { "isovalue" } else { "beta" };
        print(&DragLine::new(self.args, self.recipe, edit, hz, edits.len(), &dragged))
    }

    fn print(&self, setting: &Setting, edit: &'static str, runs: &[Streamed]) -> Result<(), BenchError> {
        print(&StreamLine::new(self.args, self.recipe, setting, edit, runs))
    }
}

/// Returns edits to a budget that is a tenth smaller, and to the budget of the setting; `None` if the setting has no budget.
fn budgets(setting: &Setting) -> Option<[Edit; 2]> {
    let smaller = setting.scaled_budget(0.9)?;
    Some([smaller, setting.scaled_budget(1.0)?].map(|triangles| Edit {
        triangles: Some(TriangleBudget::AtMost(triangles)),
        ..Edit::default()
    }))
}

fn alphas(setting: &Setting) -> [Edit; 2] {
    let alpha = setting.edit.alpha.unwrap_or(0.0);
    [alpha + 0.05, alpha].map(|alpha| Edit {
        alpha: Some(alpha),
        ..Edit::default()
    })
}

fn transfer_functions() -> [Edit; 2] {
    [other_transfer(), TransferFunctionJson::default()].map(|transfer| Edit {
        transfer_function: Some(transfer),
        ..Edit::default()
    })
}

/// Returns a transfer function that is not monotonic. With a budget, a monotonic one would lead to the same cut as the default, at another
/// β.
fn other_transfer() -> TransferFunctionJson {
    let point = |x: f32, importance: f32| PointJson {
        x,
        importance,
        color: "#888888".to_owned(),
    };
    TransferFunctionJson {
        points: vec![point(0.0, 0.0), point(0.15, 0.4), point(0.4, 0.1), point(1.0, 1.0)],
    }
}
