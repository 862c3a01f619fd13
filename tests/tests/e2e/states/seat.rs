//! A viewer with the frames that it got, and the model of the surfaces that it should get.

use std::collections::{HashMap, HashSet};
use std::net::SocketAddr;
use std::time::Duration;

use isopeel_client::{Chunk, Mesher};
use serde_json::{Value, json};
use tokio::net::TcpSocket;
use tokio::time::{Instant, timeout_at};

use super::compare::{Difference, Regions};
use super::model::{Model, View};
use super::volumes::MISSING;
use crate::support::mesh::open_edges;
use crate::support::viewer::{Frame, Viewer};

/// Longest wait until a viewer rests.
const REST_LIMIT: Duration = Duration::from_secs(90);
/// Time without a frame after which a question is repeated, because an event may have dropped it.
const SILENCE: Duration = Duration::from_secs(5);
/// The same after answers to questions before it.
const QUIET: Duration = Duration::from_secs(2);
/// Bytes that the network takes on a slow line.
const RECEIVE_BUFFER: u32 = 4096;
/// Edges that are named if a surface is not closed.
const SHOWN_EDGES: usize = 4;
/// Number of the last frames that are listed if an outcome is not as expected.
const SHOWN_FRAMES: usize = 40;

/// A final surface.
#[derive(Clone, Debug)]
pub struct Final {
    pub statistics: Value,
    pub shown: Regions,
}

impl Final {
    fn triangles(&self) -> u64 {
        self.shown.values().map(|chunk| chunk.triangles.len() as u64).sum()
    }

    /// Vertices at different positions, and those of all chunks.
    fn vertices(&self) -> (u64, u64) {
        let lattice = |chunk: &Chunk| {
            (0..chunk.vertices.len() as u32)
                .map(|vertex| chunk.lattice(vertex))
                .collect()
        };
        let all: Vec<[i32; 3]> = self
            .shown
            .values()
            .flat_map(|chunk| -> Vec<_> { lattice(chunk) })
            .collect();
        (all.iter().collect::<HashSet<_>>().len() as u64, all.len() as u64)
    }
}

/// Contents of `measured`.
#[derive(Clone, Debug)]
pub struct Measured {
    pub error: [f64; 2],
    pub regions: HashMap<[u32; 3], [f64; 2]>,
}

/// Why a generation failed.
#[derive(Clone, Debug)]
pub struct Failed {
    pub code: String,
    pub suggested_triangles: Option<u64>,
    /// The surface of the generation, if the error names it.
    pub surface: Option<u8>,
}

/// Outcome of the newest generation of a surface.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    generation: u32,
    /// The first prefix, if it is above level 0 and all of its regions were sent: its level and regions.
    pub first: Option<(u8, Regions)>,
    /// The first, and the better one.
    pub finals: Vec<Final>,
    pub measured: Option<Measured>,
    pub failure: Option<Failed>,
}

/// One viewer.
pub struct Seat {
    viewer: Viewer,
    pub model: Model,
    pub outcomes: [Outcome; 4],
    /// The last `opened` has come.
    is_open: bool,
    /// A `cancel` may have discarded work that was not requested again since.
    pub is_cancelled: bool,
    line: Option<u32>,
    /// `bad-edit` so far, and how many were expected.
    bad_edits: usize,
    pub expected_bad_edits: usize,
    /// Questions that were neither answered nor refused; some of them may have been dropped.
    questions: usize,
    /// Whether the last question, which waits for rest, was answered; whether others were answered since; and the number of chunks to come.
    is_answered: bool,
    were_others_answered: bool,
    /// Questions that were dropped, unless their answers are late.
    doubtful: usize,
    chunks_to_come: usize,
    /// Errors that no `superseded` has followed yet.
    errors: Vec<Failed>,
    pub group: Option<String>,
    pub prefixes: usize,
    /// `volume-removed` has come, and no volume was opened since.
    is_removed: bool,
    dims: [u32; 3],
    /// Surfaces that had a mask since the volume was opened: they end at the border of the mask.
    had_mask: [bool; 4],
    /// Whether marching cubes made the prefix at hand.
    is_marched: bool,
    /// Whether the prefix at hand is the first one of its generation and has all regions.
    is_whole_first: bool,
    pub is_follower: bool,
    /// The first fault found in the frames themselves, without a comparison.
    pub found: Option<Difference>,
}

impl Seat {
    /// Connects. `line`: limit of the connection in bytes per second.
    pub async fn connect(address: SocketAddr, line: Option<u32>) -> Self {
        let socket = TcpSocket::new_v4().expect("a socket");
        if line.is_some() {
            socket.set_recv_buffer_size(RECEIVE_BUFFER).expect("a small buffer");
        }
        let tcp = socket.connect(address).await.expect("the server listens");
        let viewer = Viewer::connect_on(tcp, address).await;
        Self {
            viewer,
            model: Model::open("", &json!({})),
            outcomes: Default::default(),
            is_open: false,
            is_cancelled: false,
            line,
            bad_edits: 0,
            expected_bad_edits: 0,
            questions: 0,
            is_answered: false,
            were_others_answered: false,
            doubtful: 0,
            chunks_to_come: 0,
            errors: Vec::new(),
            group: None,
            prefixes: 0,
            is_removed: false,
            dims: [0; 3],
            had_mask: [false; 4],
            is_marched: false,
            is_whole_first: false,
            is_follower: false,
            found: None,
        }
    }

    /// Connects and opens a volume; returns the view in force from `opened`.
    pub async fn open(address: SocketAddr, volume: &str, line: Option<u32>) -> Self {
        let mut seat = Self::connect(address, line).await;
        seat.reopen(volume).await;
        seat
    }

    /// Opens a volume and waits until it is open.
    pub async fn reopen(&mut self, volume: &str) {
        self.open_step(volume, 0).await;
    }

    /// Opens a time step of a volume and waits until it is open.
    pub async fn open_step(&mut self, volume: &str, step: u64) {
        self.is_open = false;
        self.is_cancelled = false;
        self.model.volume = volume.to_owned();
        self.send(json!({"type": "open", "volume": volume, "step": step, "codings": ["values"]}))
            .await;
        let limit = Instant::now() + REST_LIMIT;
        while !self.is_open {
            assert!(
                self.read_until(limit).await,
                "{volume} is not open after {REST_LIMIT:?}"
            );
        }
    }

    /// Waits for the message that the volume was removed.
    pub async fn wait_until_removed(&mut self) -> Result<(), Difference> {
        let limit = Instant::now() + REST_LIMIT;
        while !self.is_removed {
            if !self.read_until(limit).await {
                return Err(Difference::new(
                    "removed",
                    format!("no `volume-removed` after {REST_LIMIT:?}"),
                ));
            }
        }
        Ok(())
    }

    pub async fn send(&mut self, message: Value) {
        let is_question = matches!(
            message["type"].as_str(),
            Some("probe" | "distribution" | "curve" | "annotate")
        );
        self.questions += usize::from(is_question);
        self.viewer.send(message).await;
    }

    /// Reads until then.
    pub async fn listen(&mut self, until: Instant) {
        while self.read_until(until).await {}
    }

    /// Reads a frame; false if none comes until then.
    async fn read_until(&mut self, until: Instant) -> bool {
        let Ok(frame) = timeout_at(until, self.viewer.next()).await else {
            return false;
        };
        if let (Some(line), Frame::Chunk { bytes, .. }) = (self.line, &frame) {
            tokio::time::sleep(Duration::from_secs_f64(*bytes as f64 / f64::from(line))).await;
        }
        self.take(frame);
        true
    }

    /// What is shown of a surface.
    pub fn shown(&self, surface: u8) -> &Regions {
        &self.viewer.surfaces[usize::from(surface)].shown
    }

    fn outcome(&mut self, surface: u8, generation: u32) -> &mut Outcome {
        let outcome = &mut self.outcomes[usize::from(surface)];
        if generation > outcome.generation {
            *outcome = Outcome {
                generation,
                ..Outcome::default()
            };
        }
        outcome
    }

    fn take(&mut self, frame: Frame) {
        match frame {
            Frame::Opened { edit, step, volume, .. } => {
                self.dims = serde_json::from_value(volume["geometry"]["dims"].clone()).expect("three counts");
                self.had_mask = [self.model.volume == MISSING; 4];
                self.outcomes = Default::default();
                self.model = Model::open(&self.model.volume, &edit);
                self.model.step = step;
                self.is_open = true;
                if std::mem::take(&mut self.is_removed) {
                    // Edits in flight found no volume.
                    self.errors.clear();
                    self.expected_bad_edits = self.bad_edits;
                }
            }
            Frame::Prefix(of) => {
                self.prefixes += 1;
                self.is_marched = of.mesher == Mesher::MarchingCubes;
                // Those of its generations before.
                self.errors
                    .retain(|error| error.surface.is_some_and(|surface| surface != of.surface));
                let is_new = of.generation > self.outcomes[usize::from(of.surface)].generation;
                // A coarse cut of the tree has level 0; its number of triangles depends on the line.
                self.is_whole_first = is_new && of.unchanged == 0 && of.level > 0 && !of.is_final;
                self.outcome(of.surface, of.generation);
            }
            Frame::Committed { surface, level, .. } => {
                self.check_closed(surface, level);
                if self.is_whole_first {
                    let shown = self.shown(surface).clone();
                    self.outcomes[usize::from(surface)].first = Some((level, shown));
                }
            }
            Frame::Superseded { surface, generation } => {
                let is_of_it = |error: &Failed| error.surface.is_none_or(|of| of == surface);
                let error = self.errors.iter().rposition(is_of_it).map(|at| self.errors.remove(at));
                self.outcome(surface, generation).failure = error;
            }
            Frame::Done {
                surface,
                generation,
                statistics,
                ..
            } => {
                let shown = self.shown(surface).clone();
                self.outcome(surface, generation)
                    .finals
                    .push(Final { statistics, shown });
            }
            Frame::Measured {
                surface,
                generation,
                error,
                regions,
            } => {
                let regions = regions.into_iter().collect();
                self.outcome(surface, generation).measured = Some(Measured { error, regions });
            }
            Frame::Removed { surface } => self.outcomes[usize::from(surface)] = Outcome::default(),
            Frame::Error {
                code,
                surface,
                suggested_triangles,
                ..
            } => self.take_error(code, surface, suggested_triangles),
            Frame::Answer { kind, answer, .. } if kind == "annotated" => {
                self.chunks_to_come = answer["regions"].as_u64().expect("a count") as usize;
                self.take_answer();
            }
            Frame::Answer { .. } => self.questions = self.questions.saturating_sub(1),
            Frame::Errors { .. } => self.chunks_to_come = self.chunks_to_come.saturating_sub(1),
            Frame::Group(group) => self.group = group["group"].as_str().map(str::to_owned),
            Frame::Closed { code } => panic!("closed with {code:?}"),
            _ => {}
        }
    }

    /// Checks that a surface of the dual mesher is closed except at the volume's faces, for any prefix.
    fn check_closed(&mut self, surface: u8, level: u8) {
        if self.is_marched || self.had_mask[usize::from(surface)] || self.is_follower {
            return;
        }
        let open = open_edges(self.shown(surface).values(), self.dims);
        if !open.is_empty() {
            let detail = format!(
                "{} open edges in a prefix of level {level} of surface {surface} of {}: {:?}",
                open.len(),
                self.model.volume,
                &open[..open.len().min(SHOWN_EDGES)]
            );
            self.found.get_or_insert(Difference::new("open edges", detail));
        }
    }

    /// These surfaces have a mask.
    pub fn mark_masks<'a>(&mut self, masked: impl Iterator<Item = (&'a u8, &'a View)>) {
        masked.for_each(|(&surface, _)| self.had_mask[usize::from(surface)] = true);
    }

    /// Sends an edit that is a good one, and applies it to the model.
    pub async fn edit(&mut self, message: Value) {
        assert!(self.model.edit(&message), "the model takes {message} for a bad edit");
        let surface = message["surface"].as_u64().unwrap_or(0);
        let is_masked = self.model.view(surface as u8).has_mask();
        self.had_mask[surface as usize] |= is_masked;
        self.send(message).await;
    }

    fn take_error(&mut self, code: String, surface: Option<u8>, suggested_triangles: Option<u64>) {
        match code.as_str() {
            // It may be the late answer to another question, so the question is repeated.
            "no-surface" if self.questions == 1 && self.doubtful > 0 => {
                self.doubtful -= 1;
                self.were_others_answered = true;
                return;
            }
            "no-surface" | "unknown-surface" => return self.take_answer(),
            "volume-removed" => return self.is_removed = true,
            "bad-edit" => return self.bad_edits += 1,
            _ => {}
        }
        self.errors.push(Failed {
            code,
            suggested_triangles,
            surface,
        });
    }

    /// A question was answered, or refused because its surface does not exist. A refusal does not name its question: it is the one that
    /// waits for rest if there is no other.
    fn take_answer(&mut self) {
        self.questions = self.questions.saturating_sub(1);
        match self.questions {
            0 => self.is_answered = true,
            _ => self.were_others_answered = true,
        }
    }

    /// Waits until the viewer rests and all frames that follow then have arrived: an annotation is made after all of them.
    pub async fn rest(&mut self) -> Result<(), Difference> {
        let Some(&surface) = self.model.edited.first() else {
            return Ok(());
        };
        if std::mem::take(&mut self.is_cancelled) {
            for surface in self.model.edited.clone() {
                self.send(json!({"type": "edit", "surface": surface})).await;
            }
        }
        self.wait_for_rest(surface).await?;
        self.take_late_errors();
        if let Some(found) = self.found.take() {
            return Err(found);
        }
        if self.bad_edits != self.expected_bad_edits {
            let detail = format!(
                "{} answers `bad-edit`, expected {}",
                self.bad_edits, self.expected_bad_edits
            );
            return Err(Difference::new("bad edits", detail));
        }
        Ok(())
    }

    /// Errors that were found at rest: the surface that is shown stays.
    fn take_late_errors(&mut self) {
        for error in std::mem::take(&mut self.errors) {
            let removes_parts = |surface: &&u8| self.model.surfaces[surface].removes_parts();
            let surface = error
                .surface
                .or_else(|| self.model.edited.iter().find(removes_parts).copied());
            let outcome = surface.map(|surface| &mut self.outcomes[usize::from(surface)]);
            match outcome {
                Some(outcome) if outcome.failure.is_none() => outcome.failure = Some(error),
                _ => drop(self.found.get_or_insert(Difference::new("error", format!("{error:?}")))),
            }
        }
    }

    /// Asks for an annotation and reads until it is there.
    pub async fn wait_for_rest(&mut self, surface: u8) -> Result<(), Difference> {
        let limit = Instant::now() + REST_LIMIT;
        let question = json!({"type": "annotate", "surface": surface, "annotation": "error"});
        (self.is_answered, self.were_others_answered, self.doubtful) = (false, false, 0);
        self.send(question.clone()).await;
        while !self.is_answered || self.chunks_to_come > 0 {
            if Instant::now() > limit {
                let (states, frames) = (self.states(), self.last_frames());
                let detail = format!("no rest after {REST_LIMIT:?}: {states:?}\n{frames}");
                return Err(Difference::new("hang", detail));
            }
            // Those that are missing then were dropped.
            let silence = if self.were_others_answered { QUIET } else { SILENCE };
            if !self.read_until(Instant::now() + silence).await {
                self.doubtful += self.questions.saturating_sub(1);
                (self.questions, self.were_others_answered) = (0, false);
                self.send(question.clone()).await;
            }
        }
        Ok(())
    }

    /// Checks that no final surface exceeds its budget, nor all of them together.
    pub fn check_budgets(&self) -> Result<(), Difference> {
        let (mut together, mut limit) = (0, u64::MAX);
        for (&surface, view) in &self.model.surfaces {
            let Some((name, budget)) = view.budget() else { continue };
            let finals = &self.outcomes[usize::from(surface)].finals;
            for of in finals {
                check_budget(surface, of, name, budget)?;
            }
            let max = budget.as_u64().or_else(|| budget["max"].as_u64());
            if let (Some(max), Some(of), "triangles") = (max, finals.last(), name) {
                together += of.triangles();
                limit = max;
            }
        }
        match together <= limit {
            true => Ok(()),
            false => Err(Difference::new(
                "budget",
                format!("{together} triangles together, expected at most {limit}"),
            )),
        }
    }

    /// Checks that a surface's statistics are true of its mesh.
    pub fn check_statistics(&self) -> Result<(), Difference> {
        for (&surface, view) in &self.model.surfaces {
            let outcome = &self.outcomes[usize::from(surface)];
            let Some(of) = outcome.finals.last() else { continue };
            let stated = of.statistics["vertices"].as_u64().expect("a count");
            let (distinct, all) = of.vertices();
            if !(distinct..=all).contains(&stated) {
                let detail = format!("{stated}, of {all} in chunks {distinct} are distinct; {view:?}");
                return Err(Difference::new("vertices", detail));
            }
        }
        Ok(())
    }

    /// The last messages, chunks left out.
    pub fn last_frames(&self) -> String {
        let frames = self.viewer.log.iter().rev();
        let frames = frames.filter(|frame| !matches!(frame, Frame::Chunk { .. } | Frame::Errors { .. }));
        let texts: Vec<_> = frames
            .take(SHOWN_FRAMES)
            .map(|frame| brief(format!("{frame:?}")))
            .collect();
        texts.into_iter().rev().collect::<Vec<_>>().join("\n")
    }

    fn states(&self) -> Vec<(u32, usize, bool)> {
        let state = |outcome: &Outcome| (outcome.generation, outcome.finals.len(), outcome.failure.is_some());
        self.outcomes.iter().map(state).collect()
    }

    pub async fn close(self) {
        self.viewer.close().await;
    }
}

/// Whether a final surface keeps the budget of this name.
fn check_budget(surface: u8, of: &Final, name: &str, budget: &Value) -> Result<(), Difference> {
    let (found, limit) = match (name, budget["share"].as_f64()) {
        ("bytes", _) => {
            let bytes = of.shown.values().map(|chunk| chunk.frame_bytes as u64).sum();
            (bytes, budget.as_u64().expect("a number"))
        }
        (_, None) => (of.triangles(), budget.as_u64().expect("a number")),
        // If parts are to be removed from a cut of cubes, the share is one of the surface with all parts.
        (_, Some(share)) => {
            let full = of.statistics["fullTriangles"].as_f64().expect("a number");
            (of.triangles(), ((share * full + 1e-3) as u64).max(1))
        }
    };
    match found <= limit {
        true => Ok(()),
        false => Err(Difference::new(
            "budget",
            format!("surface {surface}: {found} {name}, expected at most {limit}"),
        )),
    }
}

/// The beginning of a text.
fn brief(mut text: String) -> String {
    const LENGTH: usize = 240;
    if let Some((end, _)) = text.char_indices().nth(LENGTH) {
        text.truncate(end);
    }
    text
}
