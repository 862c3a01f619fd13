//! Draws sequences: edits that fit the views at hand, and some that do not.

mod edits;

use std::collections::BTreeMap;

use fastrand::Rng;
use serde_json::{Value, json};

use super::model::Model;
use super::sequence::{Caches, Event, Sequence};
use super::volumes::{OWN, SERIES, UPLOADED, VOLUMES, Volume};
use super::world::World;

/// Edits that are answered with `bad-edit`, whatever the view.
const BAD_EDITS: [&str; 8] = [
    r#"{"alpha":1.5}"#,
    r#"{"beta":0.1,"error":1}"#,
    r#"{"maxLevel":6}"#,
    r#"{"mask":"nothing==1"}"#,
    r#"{"field":"log("}"#,
    r#"{"surface":7}"#,
    r#"{"featureRange":[1,1]}"#,
    r#"{"bytes":0}"#,
];
/// Views that a viewer goes back to.
const REMEMBERED: usize = 12;

/// Draws one sequence.
struct Generator<'a> {
    world: &'a World,
    random: Rng,
    models: Vec<Model>,
    /// Views from before, by viewer.
    earlier: BTreeMap<usize, Vec<Value>>,
    has_several_surfaces: bool,
    may_open: bool,
    may_follow: bool,
    has_files: bool,
    is_uploaded: bool,
    first_volumes: Vec<String>,
    /// Contents of changing files so far.
    contents: u64,
    /// Number of steps added to the series so far.
    added_steps: u64,
    events: Vec<Event>,
}

/// The sequence of a seed, with `bursts` bursts of edits.
pub fn sequence(world: &World, seed: u64, bursts: usize) -> Sequence {
    let mut random = Rng::with_seed(seed);
    let has_files = random.u8(..10) == 0;
    let volume = match has_files {
        true => choice(&mut random, &[OWN, SERIES]),
        false => choice(&mut random, VOLUMES).name,
    };
    let viewers = if random.u8(..10) < 3 { 2 } else { 1 };
    let volumes = vec![volume.to_owned(); viewers];
    let caches = choice(&mut random, &Caches::ALL);
    let line = (random.u8(..8) == 0).then(|| choice(&mut random, &[150_000, 300_000, 1_000_000]));
    let mut generator = Generator {
        world,
        models: volumes.iter().map(|volume| world.model(volume)).collect(),
        earlier: BTreeMap::new(),
        has_several_surfaces: random.u8(..100) < 45,
        may_open: random.u8(..10) < 3,
        may_follow: random.u8(..4) == 0,
        has_files,
        is_uploaded: false,
        first_volumes: volumes.clone(),
        contents: 10,
        added_steps: 0,
        events: Vec::new(),
        random,
    };
    for _ in 0..bursts {
        generator.burst();
    }
    Sequence {
        seed,
        caches,
        line,
        has_files,
        volumes,
        events: generator.events,
    }
}

fn choice<T: Clone>(random: &mut Rng, of: &[T]) -> T {
    of[random.usize(..of.len())].clone()
}

impl Generator<'_> {
    fn choose<T: Clone>(&mut self, of: &[T]) -> T {
        choice(&mut self.random, of)
    }

    /// Returns true with a probability of `percent` per cent.
    fn percent(&mut self, percent: u8) -> bool {
        self.random.u8(..100) < percent
    }

    fn volume(&self, viewer: usize) -> &'static Volume {
        Volume::named(&self.models[viewer].volume)
    }

    /// Messages one after the other, then rest.
    fn burst(&mut self) {
        let count = if self.percent(45) {
            1
        } else {
            self.choose(&[2, 3, 5, 8])
        };
        let gap = self.choose(&[0, 0, 10, 50, 150, 400]);
        for _ in 0..count {
            let viewer = self.random.usize(..self.models.len());
            self.step(viewer, count > 1);
            if gap > 0 && self.percent(80) {
                let milliseconds = self.random.u64(1..=gap);
                self.events.push(Event::Wait { milliseconds });
            }
        }
        self.befall();
        for viewer in 0..self.models.len() {
            if self.models[viewer].edited.is_empty() {
                self.edit(viewer);
            }
            let views = self.models[viewer]
                .messages()
                .into_iter()
                .filter(|of| of["type"] == "edit");
            let earlier = self.earlier.entry(viewer).or_default();
            earlier.extend(views);
            let excess = earlier.len().saturating_sub(REMEMBERED);
            earlier.drain(..excess);
        }
        let newcomer = self.percent(33);
        self.events.push(Event::Settle { newcomer });
    }

    /// Draws an event of the server between edits.
    fn befall(&mut self) {
        if self.percent(8) {
            self.lose_device();
        }
        if self.may_follow && self.percent(20) {
            self.events.push(Event::Follow);
        }
        if self.percent(2) {
            self.events.push(Event::Restart);
            for viewer in 0..self.models.len() {
                self.begin_anew(viewer, &self.first_volumes[viewer].clone());
            }
        }
        if self.has_files && self.percent(50) {
            self.change_files();
        }
    }

    /// Loses the device between cuts, with enough cuts after the loss that ids before and after it could collide.
    fn lose_device(&mut self) {
        self.events.push(Event::LoseDevice);
        let count = self.choose(&[2, 5, 12, 30]);
        let viewer = self.random.usize(..self.models.len());
        if let [first, second] = &self.models[..]
            && (&first.volume, first.step) == (&second.volume, second.step)
        {
            self.look_at_the_same(viewer, 1 - viewer);
        }
        for _ in 0..count {
            self.change_cut(viewer);
        }
        for viewer in 0..self.models.len() {
            self.change_cut(viewer);
        }
    }

    /// Sends a viewer the views of another one.
    fn look_at_the_same(&mut self, viewer: usize, other: usize) {
        let edits = self.models[other]
            .messages()
            .into_iter()
            .filter(|of| of["type"] == "edit");
        for edit in edits.collect::<Vec<_>>() {
            let mut model = self.models[viewer].clone();
            if model.edit(&edit) {
                self.models[viewer] = model;
                self.send(viewer, edit);
            }
        }
    }

    /// An edit that changes nothing but the cut of a surface, and time to make it.
    fn change_cut(&mut self, viewer: usize) {
        let surfaces: Vec<_> = self.models[viewer].edited.iter().copied().collect();
        let Some(&surface) = surfaces.get(self.random.usize(..surfaces.len().max(1))) else {
            return self.edit(viewer);
        };
        let random = f64::from(self.random.u8(..=100)) / 100.0;
        let is_by_error = self.models[viewer].view(surface).is_by_error();
        let (name, value) = if is_by_error {
            ("alpha", random)
        } else {
            ("beta", random / 20.0)
        };
        let edit = json!({"type": "edit", "surface": surface, name: value});
        self.models[viewer].edit(&edit);
        self.send(viewer, edit);
        self.events.push(Event::Wait { milliseconds: 150 });
    }

    /// A viewer has opened a volume.
    fn begin_anew(&mut self, viewer: usize, volume: &str) {
        self.models[viewer] = self.world.model(volume);
        self.earlier.remove(&viewer);
    }

    fn begin_all_anew(&mut self, looked_at: &str) {
        for viewer in 0..self.models.len() {
            if self.models[viewer].volume == looked_at {
                let volume = if looked_at == UPLOADED {
                    self.first_volumes[viewer].clone()
                } else {
                    looked_at.to_owned()
                };
                self.begin_anew(viewer, &volume);
            }
        }
    }

    fn change_files(&mut self) {
        self.contents += 2;
        let content = self.contents;
        match self.random.u8(..4) {
            0 => {
                self.events.push(Event::Replace { content });
                self.begin_all_anew(OWN);
            }
            1 => {
                let rewrite = self.random.bool();
                self.added_steps += 1;
                self.events.push(Event::Grow { content, rewrite });
                if rewrite {
                    self.begin_all_anew(SERIES);
                }
            }
            _ if self.is_uploaded => {
                self.is_uploaded = false;
                self.events.push(Event::DeleteUpload);
                self.begin_all_anew(UPLOADED);
            }
            _ => {
                self.is_uploaded = true;
                self.events.push(Event::Upload { content });
                let viewer = self.random.usize(..self.models.len());
                self.open(viewer, UPLOADED);
            }
        }
    }

    /// One message, or an `open`.
    fn step(&mut self, viewer: usize, is_within: bool) {
        let volume = self.volume(viewer);
        let is_started = !self.models[viewer].edited.is_empty();
        match self.random.u8(..100) {
            0..25 if volume.steps > 1 && is_started => {
                let added = if volume.name == SERIES { self.added_steps } else { 0 };
                let step = self.random.u64(..volume.steps + added);
                self.models[viewer].step = step;
                self.send(viewer, json!({"type": "step", "step": step}));
            }
            25..28 if is_within && is_started => self.send(viewer, json!({"type": "cancel"})),
            28..31 if self.models[viewer].edited.len() > 1 => {
                let surfaces: Vec<_> = self.models[viewer].edited.iter().copied().collect();
                let surface = self.choose(&surfaces);
                self.models[viewer].remove(surface);
                self.send(viewer, json!({"type": "remove", "surface": surface}));
            }
            31..33 if self.may_open => {
                let volume = match self.has_files {
                    true => self.choose(&[OWN, SERIES]),
                    false => self.choose(VOLUMES).name,
                };
                self.open(viewer, volume);
            }
            33..38 if is_started => self.ask(viewer),
            38..44 if is_within && self.earlier.contains_key(&viewer) => self.go_back(viewer),
            46..52 if volume.name == "fields" && is_started => {
                let name = self.choose(&["field", "feature"]);
                let message = json!({"type": "edit", name: "distance(labels==99)"});
                self.events.push(Event::SendLateBad { viewer, message });
                self.events.push(Event::Settle { newcomer: false });
            }
            44..46 => {
                let mut message: Value = serde_json::from_str(self.choose(&BAD_EDITS).trim()).expect("JSON");
                message["type"] = json!("edit");
                self.events.push(Event::SendBad { viewer, message });
            }
            _ => self.edit(viewer),
        }
    }

    fn send(&mut self, viewer: usize, message: Value) {
        self.events.push(Event::Send { viewer, message });
    }

    fn open(&mut self, viewer: usize, volume: &str) {
        self.begin_anew(viewer, volume);
        let volume = volume.to_owned();
        self.events.push(Event::Open { viewer, volume });
        self.edit(viewer);
    }

    fn ask(&mut self, viewer: usize) {
        let position = self.volume(viewer).position(&mut self.random);
        let surface = *self.models[viewer].edited.first().expect("a surface");
        let question = self.choose(&[
            json!({"type": "probe", "surface": surface, "position": position}),
            json!({"type": "distribution", "surface": surface}),
            json!({"type": "curve", "surface": surface}),
            json!({"type": "drawn", "generation": 1}),
        ]);
        self.send(viewer, question);
    }

    /// A view from before, as one edit.
    fn go_back(&mut self, viewer: usize) {
        let message = self.choose(&self.earlier[&viewer].clone());
        let mut model = self.models[viewer].clone();
        if model.edit(&message) {
            self.models[viewer] = model;
            self.send(viewer, message);
        }
    }

    /// A random edit that the model takes.
    fn edit(&mut self, viewer: usize) {
        for _ in 0..100 {
            let (mut model, edit) = (self.models[viewer].clone(), self.draw_edit(viewer));
            if model.edit(&edit) {
                self.models[viewer] = model;
                return self.send(viewer, edit);
            }
        }
        panic!("no edit fits {:?}", self.models[viewer]);
    }
}
