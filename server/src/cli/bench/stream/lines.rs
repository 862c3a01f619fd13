//! The output lines of the stream.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::Serialize;

use super::super::volumes::Recipe;
use super::super::{Args, Spread, round};
use super::Setting;
use super::client::{Dragged, Streamed};

/// One kind of edit at one setting.
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
    /// If the setting is a budget.
    #[serde(skip_serializing_if = "Option::is_none")]
    budget_triangles: Option<u64>,
    /// From `open` to `opened`.
    #[serde(skip_serializing_if = "Option::is_none")]
    opened_ms: Option<Spread>,
    /// To the first `committed`; `None` if no run had to show anything.
    #[serde(skip_serializing_if = "Option::is_none")]
    first_ms: Option<Spread>,
    /// To `done`.
    done_ms: Spread,
    /// The server's own work.
    wall_ms: Spread,
    /// Sum of all stages.
    device_ms: Spread,
    /// Device time of each stage in the run with the best device time.
    stages_ms: BTreeMap<String, f64>,
    // All below: of the last run.
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
        let spread = |of: &dyn Fn(&Streamed) -> f64| Spread::of(runs.iter().map(of));
        let optional = |of: fn(&Streamed) -> Option<Duration>| {
            let times: Vec<f64> = runs.iter().filter_map(of).map(milliseconds).collect();
            (!times.is_empty()).then(|| Spread::of(times))
        };
        let best = runs
            .iter()
            .min_by(|a, b| a.statistics.device_ms().total_cmp(&b.statistics.device_ms()));
        let mut stages_ms = best.map_or_else(BTreeMap::new, |run| run.statistics.stages_ms.clone());
        stages_ms.values_mut().for_each(|time| *time = round(*time));
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
            opened_ms: optional(|run| run.opened),
            first_ms: optional(|run| run.first),
            done_ms: spread(&|run| milliseconds(run.done)),
            wall_ms: spread(&|run| run.statistics.wall_ms),
            device_ms: spread(&|run| run.statistics.device_ms()),
            stages_ms,
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

/// One drag.
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
    pub fn new(args: &Args, recipe: &'a Recipe, edit: &'static str, hz: f64, edits: usize, seen: &Dragged) -> Self {
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
            commits: seen.commits,
            longest_gap_ms: milliseconds(seen.longest_gap),
            settle_ms: milliseconds(seen.settle),
            encoded_bytes: seen.bytes,
            triangles: seen.statistics.triangles,
        }
    }
}

fn milliseconds(time: Duration) -> f64 {
    round(time.as_secs_f64() * 1e3)
}
