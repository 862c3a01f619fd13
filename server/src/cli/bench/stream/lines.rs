//! The output lines of the case `stream`.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::Serialize;

use super::super::volumes::Recipe;
use super::super::{Args, Spread, round};
use super::Setting;
use super::client::{Dragged, Streamed};

/// The output line of one kind of edit at one setting.
#[derive(Serialize)]
pub(super) struct StreamLine<'a> {
    volume: &'a str,
    dims: [u32; 3],
    #[serde(rename = "type")]
    sample_type: &'static str,
    volume_bytes: u64,
    case: &'static str,
    setting: &'a str,
    edit: &'static str,
    repeats: u32,
    /// Budget of the setting, if it has one.
    #[serde(skip_serializing_if = "Option::is_none")]
    budget_triangles: Option<u64>,
    /// Time from `open` to `opened`.
    #[serde(skip_serializing_if = "Option::is_none")]
    opened_ms: Option<Spread>,
    /// Time to the first `committed`; `None` if no run had one.
    #[serde(skip_serializing_if = "Option::is_none")]
    first_ms: Option<Spread>,
    /// Time to `done`.
    done_ms: Spread,
    /// Time of the work in the server.
    wall_ms: Spread,
    /// Sum of the device times of all stages.
    device_ms: Spread,
    /// Device time of each stage in the run with the best device time.
    stages_ms: BTreeMap<String, f64>,
    // The fields below are values of the last run.
    beta: Option<f32>,
    tolerance: Option<f32>,
    prefixes: u64,
    chunks: u64,
    encoded_bytes: u64,
    full_triangles: u64,
    triangles: u64,
    vertices: u64,
    device_bytes: u64,
}

impl<'a> StreamLine<'a> {
    pub fn new(args: &Args, recipe: &'a Recipe, setting: &'a Setting, edit: &'static str, runs: &[Streamed]) -> Self {
        let spread = |time_of: &dyn Fn(&Streamed) -> f64| Spread::of(runs.iter().map(time_of));
        let optional_spread = |time_of: fn(&Streamed) -> Option<Duration>| {
            let times: Vec<f64> = runs.iter().filter_map(time_of).map(milliseconds).collect();
            (!times.is_empty()).then(|| Spread::of(times))
        };
        let last = runs.last().cloned().unwrap_or_default();
        Self {
            volume: &recipe.name,
            dims: recipe.grid.dims,
            sample_type: recipe.sample_type.name(),
            volume_bytes: recipe.grid.sample_count() * recipe.sample_type.bytes() as u64,
            case: "stream",
            setting: &setting.name,
            edit,
            repeats: args.repeats,
            budget_triangles: setting.budget,
            opened_ms: optional_spread(|run| run.opened),
            first_ms: optional_spread(|run| run.first),
            done_ms: spread(&|run| milliseconds(run.done)),
            wall_ms: spread(&|run| run.statistics.wall_ms),
            device_ms: spread(&|run| run.statistics.device_ms()),
            stages_ms: best_stages_ms(runs),
            beta: last.statistics.beta,
            tolerance: last.statistics.tolerance,
            prefixes: last.prefixes,
            chunks: last.chunks,
            encoded_bytes: last.bytes,
            full_triangles: last.statistics.full_triangles,
            triangles: last.statistics.triangles,
            vertices: last.statistics.vertices,
            device_bytes: last.statistics.device_bytes,
        }
    }
}

/// The output line of one drag.
#[derive(Serialize)]
pub(super) struct DragLine<'a> {
    volume: &'a str,
    dims: [u32; 3],
    #[serde(rename = "type")]
    sample_type: &'static str,
    case: &'static str,
    setting: &'static str,
    edit: &'static str,
    hz: f64,
    seconds: f64,
    edits: usize,
    commits: u64,
    longest_gap_ms: f64,
    settle_ms: f64,
    encoded_bytes: u64,
    triangles: u64,
}

impl<'a> DragLine<'a> {
    pub fn new(args: &Args, recipe: &'a Recipe, edit: &'static str, hz: f64, edits: usize, dragged: &Dragged) -> Self {
        Self {
            volume: &recipe.name,
            dims: recipe.grid.dims,
            sample_type: recipe.sample_type.name(),
            case: "drag",
            setting: "opening",
            edit,
            hz,
            seconds: args.drag_seconds,
            edits,
            commits: dragged.commits,
            longest_gap_ms: milliseconds(dragged.longest_gap),
            settle_ms: milliseconds(dragged.settle),
            encoded_bytes: dragged.bytes,
            triangles: dragged.statistics.triangles,
        }
    }
}

/// Returns the device time of each stage in the run with the best device time.
pub(super) fn best_stages_ms(runs: &[Streamed]) -> BTreeMap<String, f64> {
    let best = runs
        .iter()
        .min_by(|a, b| a.statistics.device_ms().total_cmp(&b.statistics.device_ms()));
    let mut stages_ms = best.map_or_else(BTreeMap::new, |run| run.statistics.stages_ms.clone());
    stages_ms.values_mut().for_each(|time| *time = round(*time));
    stages_ms
}

pub(super) fn milliseconds(time: Duration) -> f64 {
    round(time.as_secs_f64() * 1e3)
}
