//! Draws the fields of an edit.

use serde_json::{Map, Value, json};

use super::super::model::View;
use super::super::volumes::Volume;
use super::{Generator, choice};

impl Generator<'_> {
    /// An edit of a surface, which the model may take for a bad one.
    pub(super) fn draw_edit(&mut self, viewer: usize) -> Value {
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
            "minPart",
            "parts",
        ];
        if !volume.masks.is_empty() {
            changes.extend(["mask"; 3]);
        }
        if !volume.fields.is_empty() {
            changes.extend(["field", "colorField", "colorField"]);
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
            "colorField" => match self.percent(30) {
                true => Value::Null,
                false => json!(self.choose(volume.fields)),
            },
            "criterion" => return self.add_criterion(is_marched, edit),
            "guards" => return self.add_guards(edit),
            "feature" => return self.add_feature(view, volume, edit),
            "field" => return self.add_field(volume, edit),
            "mesher" => return self.add_mesher(is_marched, edit),
            "minPart" | "parts" => return self.add_parts(change, is_marched, view, volume, edit),
            _ => return,
        };
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
            _ if is_marched && self.random.bool() => &[("triangles", triangles)],
            _ if is_marched => &[("beta", beta)],
            0..25 => &[("beta", beta)],
            25..50 => &[("error", error)],
            50..80 => &[("triangles", triangles)],
            80..87 => &[("bytes", bytes)],
            _ => &[("error", error), ("triangles", triangles)],
        };
        edit.extend(named.iter().map(|(name, value)| ((*name).to_owned(), value.clone())));
    }

    fn triangles(&mut self) -> Value {
        if self.percent(40) {
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
        edit.insert("feature".into(), json!(feature));
        if view.get("feature") != feature && self.percent(40) {
            let range = self.choose(&[[0.0, 1.0], [-1.0, 2.0], [0.0, 0.5], [0.0, 100.0]]);
            edit.insert("featureRange".into(), json!(range));
        }
    }

    fn add_field(&mut self, volume: &Volume, edit: &mut Map<String, Value>) {
        edit.insert("field".into(), json!(self.choose(volume.fields)));
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
