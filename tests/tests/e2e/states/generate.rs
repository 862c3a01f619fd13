//! Draws sequences: edits that fit the views at hand, and some that do not.

use std::collections::BTreeMap;

use fastrand::Rng;
use serde_json::{Map, Value, json};

use super::known::Ingredient;
use super::model::{Model, View};
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
    /// Steps that the series has more than at first.
    added_steps: u64,
    events: Vec<Event>,
}

/// The sequence of a seed, of so many bursts of edits.
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
        may_follow: random.u8(..4) == 0 && (!has_files || Ingredient::ReplacedInGroups.is_on()),
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

    /// Happens so many times of a hundred.
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

    /// What befalls the server between edits.
    fn befall(&mut self) {
        if Ingredient::LostDevices.is_on() && self.percent(8) {
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

    /// Cuts from before a loss, and as many from after it as it takes for numbers to meet.
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

    /// A viewer goes to the views of another one.
    fn look_at_the_same(&mut self, viewer: usize, other: usize) {
        let edits = self.models[other]
            .messages()
            .into_iter()
            .filter(|of| of["type"] == "edit");
        for edit in edits.collect::<Vec<_>>() {
            let mut model = self.models[viewer].clone();
            if model.edit(&edit) && self.is_allowed(&model) {
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
                let rewrite = Ingredient::RewrittenSeries.is_on() && self.random.bool();
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
        if model.edit(&message) && self.is_allowed(&model) {
            self.models[viewer] = model;
            self.send(viewer, message);
        }
    }

    /// A random edit that the model takes.
    fn edit(&mut self, viewer: usize) {
        for _ in 0..100 {
            let (mut model, edit) = (self.models[viewer].clone(), self.draw_edit(viewer));
            if model.edit(&edit) && self.is_allowed(&model) {
                self.models[viewer] = model;
                return self.send(viewer, edit);
            }
        }
        panic!("no edit fits {:?}", self.models[viewer]);
    }

    /// Whether the views have nothing that is left out.
    fn is_allowed(&self, model: &Model) -> bool {
        let views = || {
            model
                .surfaces
                .iter()
                .filter(|(surface, _)| model.edited.contains(surface))
                .map(|(_, view)| view)
        };
        let budgets = views().filter(|view| view.budget().is_some()).count();
        let is_guarded = |view: &View| view.get("maxError") != "auto" || view.get("topology") != "auto";
        let has_guarded_budget = views().any(|view| view.budget().is_some() && is_guarded(view));
        (budgets < 2 || Ingredient::SharedBudgets.is_on())
            && (!has_guarded_budget || Ingredient::GuardsBesideBudgets.is_on())
    }

    fn draw_edit(&mut self, viewer: usize) -> Value {
        let surface = match self.has_several_surfaces && !self.models[viewer].edited.is_empty() {
            true => self.choose(&[0, 0, 0, 0, 1, 1, 2, 3]),
            false => *self.models[viewer].edited.first().unwrap_or(&0),
        };
        let is_new = !self.models[viewer].edited.contains(&surface);
        let view = self.models[viewer].view(surface);
        let mut edit = Map::new();
        edit.insert("type".into(), json!("edit"));
        edit.insert("surface".into(), json!(surface));
        let volume = self.volume(viewer);
        if is_new {
            edit.insert("iso".into(), json!(self.choose(volume.isovalues)));
            if volume.steps > 1 && !Ingredient::OwnRangesOfSteps.is_on() {
                edit.insert("featureRange".into(), json!([0, 1]));
            }
        }
        let mut changes = vec![
            "iso",
            "alpha",
            "criterion",
            "criterion",
            "guards",
            "transferFunction",
            "interest",
            "maxLevel",
            "feature",
            "mesher",
            "colors",
            "nothing",
        ];
        if Ingredient::Parts.is_on() {
            changes.extend(["minPart", "parts"]);
        }
        if !volume.masks.is_empty() {
            changes.extend(["mask"; 3]);
        }
        if !volume.fields.is_empty() {
            changes.push("field");
        }
        self.random.shuffle(&mut changes);
        let count = self.choose(&[1, 1, 1, 2, 3]);
        for change in &changes[..count] {
            self.change(change, &view, volume, &mut edit);
        }
        Value::Object(edit)
    }

    fn change(&mut self, change: &str, view: &View, volume: &Volume, edit: &mut Map<String, Value>) {
        let is_marched = edit.get("mesher").unwrap_or(view.get("mesher")) == "marching-cubes";
        let value = match change {
            "iso" => json!(self.choose(volume.isovalues)),
            "alpha" => {
                let random = f64::from(self.random.u8(..=100)) / 100.0;
                json!(self.choose(&[0.0, 1.0, 0.3, 0.5, random]))
            }
            "maxLevel" => json!(self.random.u8(..=5)),
            "transferFunction" => self.transfer_function(),
            "colors" => {
                let mut of = view.get("transferFunction").clone();
                of["points"][0]["color"] = json!(format!("#{:06x}", self.random.u32(..1 << 24)));
                of
            }
            "interest" => self.interest(volume),
            "mask" => match self.percent(30) {
                true => Value::Null,
                false => json!(self.choose(volume.masks)),
            },
            "criterion" => return self.add_criterion(is_marched, edit),
            "guards" => return self.add_guards(edit),
            "feature" => return self.add_feature(view, volume, edit),
            "field" => return self.add_field(volume, edit),
            "mesher" => return self.add_mesher(is_marched, edit),
            "minPart" | "parts" => return self.add_parts(change, is_marched, view, volume, edit),
            _ => return,
        };
        if value == "labels==99" && !Ingredient::EmptyMasks.is_on() {
            return;
        }
        edit.insert(
            if change == "colors" { "transferFunction" } else { change }.into(),
            value,
        );
    }

    fn transfer_function(&mut self) -> Value {
        let count = self.choose(&[1, 2, 2, 3, 5]);
        let mut at: Vec<_> = (0..count).map(|_| self.random.u16(..=1000)).collect();
        at.sort_unstable();
        let point = |x: u16| {
            let random = f64::from(self.random.u16(..=1000)) / 1000.0;
            let importance = choice(&mut self.random, &[0.0, 1.0, random]);
            json!({"x": f64::from(x) / 1000.0, "importance": importance, "color": "#f57900"})
        };
        json!({"points": at.into_iter().map(point).collect::<Vec<_>>()})
    }

    fn interest(&mut self, volume: &Volume) -> Value {
        let count = self.choose(&[0, 1, 1, 2]);
        let region = |_| {
            let importance = self.choose(&[0.0, 0.5, 0.9, 1.0]);
            let [a, b] = [0; 2].map(|_| volume.position(&mut self.random));
            if self.random.bool() {
                let radius = volume.size() * self.choose(&[0.05, 0.1, 0.2, 2.0]);
                return json!({"sphere": {"center": a, "radius": radius}, "importance": importance});
            }
            let min: Vec<_> = a.iter().zip(b).map(|(a, b)| a.min(b)).collect();
            let max: Vec<_> = a.iter().zip(b).map(|(a, b)| a.max(b) + 0.01).collect();
            json!({"box": {"min": min, "max": max}, "importance": importance})
        };
        (0..count).map(region).collect()
    }

    fn has_criterion(edit: &Map<String, Value>) -> bool {
        ["beta", "error", "triangles", "bytes"]
            .iter()
            .any(|name| edit.contains_key(*name))
    }

    fn add_criterion(&mut self, is_marched: bool, edit: &mut Map<String, Value>) {
        if Self::has_criterion(edit) {
            return;
        }
        let beta = json!(self.choose(&[-1.0, 0.0, 0.005, 0.01, 0.02, 0.05, 0.1, 0.3, 1.0, 2.0]));
        let error = self.choose(&[
            json!("0.1vx"),
            json!("0.02vx"),
            json!("0.3vx"),
            json!("1vx"),
            json!(0),
            json!(0.17),
            json!("5vx"),
        ]);
        let triangles = self.triangles();
        let bytes = json!(self.choose(&[20_000, 100_000, 400_000]));
        let named: &[(&str, Value)] = match self.random.u8(..100) {
            _ if is_marched && !Ingredient::CoarseMarching.is_on() => &[("beta", json!(-1))],
            _ if is_marched && self.random.bool() => &[("triangles", triangles)],
            _ if is_marched => &[("beta", beta)],
            0..25 => &[("beta", beta)],
            25..50 => &[("error", error)],
            50..80 => &[("triangles", triangles)],
            80..87 if Ingredient::TightBudgets.is_on() => &[("bytes", bytes)],
            _ => &[("error", error), ("triangles", triangles)],
        };
        edit.extend(named.iter().map(|(name, value)| ((*name).to_owned(), value.clone())));
    }

    fn triangles(&mut self) -> Value {
        if Ingredient::TightBudgets.is_on() && self.percent(40) {
            return self.choose(&[
                json!(1),
                json!(4),
                json!(50),
                json!(300),
                json!({"share": 0.03}),
                json!({"share": 1e-4}),
            ]);
        }
        if self.percent(30) {
            return self.choose(&[json!(3000), json!(8000), json!(20_000), json!({"share": 1})]);
        }
        self.choose(&[
            json!({"share": 0.5}),
            json!({"share": 0.25}),
            json!({"share": 0.3, "max": 5000}),
            json!({"share": 0.6, "max": 1_000_000}),
        ])
    }

    fn add_guards(&mut self, edit: &mut Map<String, Value>) {
        if self.percent(60) {
            let guard = self.choose(&[
                json!("auto"),
                Value::Null,
                json!("0.25vx"),
                json!("0.05vx"),
                json!("1vx"),
                json!(0.333),
                json!("none"),
            ]);
            edit.insert("maxError".into(), guard);
        }
        if self.percent(60) {
            edit.insert("topology".into(), json!(self.choose(&["auto", "preserve", "free"])));
        }
    }

    fn add_feature(&mut self, view: &View, volume: &Volume, edit: &mut Map<String, Value>) {
        let feature = self.choose(volume.features);
        if feature.contains("==99") && !Ingredient::LateBadEdits.is_on() {
            return;
        }
        edit.insert("feature".into(), json!(feature));
        let is_explicit = volume.steps > 1 && !Ingredient::OwnRangesOfSteps.is_on();
        if is_explicit || view.get("feature") != feature && self.percent(40) {
            let range = self.choose(&[[0.0, 1.0], [-1.0, 2.0], [0.0, 0.5], [0.0, 100.0]]);
            edit.insert("featureRange".into(), json!(range));
        }
    }

    fn add_field(&mut self, volume: &Volume, edit: &mut Map<String, Value>) {
        edit.insert("field".into(), json!(self.choose(volume.fields)));
        if volume.steps > 1 && !Ingredient::OwnRangesOfSteps.is_on() {
            edit.insert("featureRange".into(), json!([0, 1]));
        }
        if self.random.bool() {
            edit.insert("iso".into(), json!(self.choose(volume.isovalues)));
        }
    }

    fn add_mesher(&mut self, is_marched: bool, edit: &mut Map<String, Value>) {
        if is_marched {
            edit.insert("mesher".into(), json!("dual"));
        } else if self.percent(40) && !Self::has_criterion(edit) {
            edit.insert("mesher".into(), json!("marching-cubes"));
            self.add_criterion(true, edit);
        }
    }

    fn add_parts(
        &mut self,
        change: &str,
        is_marched: bool,
        view: &View,
        volume: &Volume,
        edit: &mut Map<String, Value>,
    ) {
        if is_marched || edit.contains_key("beta") {
            return;
        }
        if !Self::has_criterion(edit) && !view.is_by_error() {
            edit.insert("error".into(), json!("0.1vx"));
        }
        let value = if change == "minPart" {
            self.choose(&[
                json!(0),
                Value::Null,
                json!(1),
                json!(5),
                json!(30),
                json!(200),
                json!(1e9),
            ])
        } else {
            let count = self.choose(&[1, 3, 8]);
            let positions: Vec<_> = (0..count).map(|_| volume.position(&mut self.random)).collect();
            self.choose(&[Value::Null, json!({"hide": positions}), json!({"keep": positions})])
        };
        edit.insert(change.into(), value);
    }
}
