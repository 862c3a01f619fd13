//! Model of a view after edits, by `server/PROTOCOL.md`: nothing here uses the server's code.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::{Map, Value, json};

/// Criteria of a surface's detail: an edit that names one of them replaces all.
const CRITERIA: [&str; 4] = ["beta", "error", "triangles", "bytes"];
/// Of these, the budgets, which surfaces share.
const BUDGETS: [&str; 2] = ["triangles", "bytes"];
/// Features that are computed from the field that is shown.
const DERIVED: [&str; 4] = [
    "gradient-magnitude",
    "mean-curvature",
    "gaussian-curvature",
    "local-variance",
];

/// All values in force of a surface, as an edit. Without `featureRange` the range is the feature's own.
#[derive(Clone, Debug, PartialEq)]
pub struct View(pub Map<String, Value>);

impl View {
    pub fn get(&self, name: &str) -> &Value {
        self.0.get(name).unwrap_or(&Value::Null)
    }

    pub fn is_marched(&self) -> bool {
        self.get("mesher") == "marching-cubes"
    }

    /// Whether an error or a budget decides and the mesher is dual.
    pub fn is_by_error(&self) -> bool {
        !self.is_marched()
            && ["error", "triangles", "bytes"]
                .iter()
                .any(|name| self.0.contains_key(*name))
    }

    pub fn has_mask(&self) -> bool {
        !self.get("mask").is_null()
    }

    pub fn removes_parts(&self) -> bool {
        self.get("minPart").as_f64().unwrap_or(0.0) > 0.0 || !self.get("parts").is_null()
    }

    /// The budget in force: its name and value.
    pub fn budget(&self) -> Option<(&'static str, &Value)> {
        BUDGETS.iter().find_map(|&name| Some((name, self.0.get(name)?)))
    }

    fn set_budget(&mut self, budget: Option<(&'static str, Value)>) {
        BUDGETS.iter().for_each(|&name| drop(self.0.remove(name)));
        if let Some((name, value)) = budget {
            self.0.insert(name.to_owned(), value);
        }
    }

    /// The view after an edit; `None` of one that is answered with `bad-edit`.
    pub fn edited(&self, edit: &Map<String, Value>) -> Option<Self> {
        let mut view = self.clone();
        let named: Vec<_> = CRITERIA.into_iter().filter(|name| edit.contains_key(*name)).collect();
        let is_named = |name: &str| named.contains(&name);
        if is_named("beta") && named.len() > 1 || is_named("triangles") && is_named("bytes") {
            return None;
        }
        if !named.is_empty() {
            CRITERIA.iter().for_each(|name| drop(view.0.remove(*name)));
        }
        for (name, value) in edit.iter().filter(|(name, _)| *name != "surface") {
            view.0.insert(name.clone(), value.clone());
        }
        if self.has_other_feature(&view) && !edit.contains_key("featureRange") {
            view.0.remove("featureRange");
        }
        if view.is_marched() {
            if is_named("error") {
                return None;
            }
            view.0.remove("error");
        }
        if !view.is_by_error() {
            let is_set = |name: &str| {
                edit.get(name)
                    .is_some_and(|value| !value.is_null() && *value != json!(0))
            };
            if is_set("minPart") || is_set("parts") {
                return None;
            }
            view.0.insert("minPart".into(), json!(0));
            view.0.insert("parts".into(), Value::Null);
        }
        view.is_in_range().then_some(view)
    }

    fn has_other_feature(&self, view: &Self) -> bool {
        let is_derived = DERIVED.iter().any(|name| view.get("feature") == name);
        view.get("feature") != self.get("feature") || is_derived && view.get("field") != self.get("field")
    }

    fn is_in_range(&self) -> bool {
        let number = |name: &str| self.get(name).as_f64().unwrap_or(0.0);
        let range = self.get("featureRange");
        (0.0..=1.0).contains(&number("alpha"))
            && (0.0..=5.0).contains(&number("maxLevel"))
            && (range.is_null() || range[0].as_f64() < range[1].as_f64())
    }
}

/// The volume that a viewer has open, and the views of its surfaces.
#[derive(Clone, Debug)]
pub struct Model {
    pub volume: String,
    pub step: u64,
    /// The values of `opened`.
    pub opening: View,
    pub surfaces: BTreeMap<u8, View>,
    /// Surfaces that an edit has named since the volume was opened.
    pub edited: BTreeSet<u8>,
    /// Whether surface 0 was removed, which is there from the start.
    pub is_first_removed: bool,
    /// Surfaces whose feature has its own range, and of which step: that at which the edit was sent.
    pub range_steps: BTreeMap<u8, u64>,
}

impl Model {
    /// After `opened`, which states these values.
    pub fn open(volume: &str, opening: &Value) -> Self {
        let opening = View(opening.as_object().expect("values in force").clone());
        Self {
            volume: volume.to_owned(),
            step: 0,
            surfaces: [(0, opening.clone())].into(),
            opening,
            edited: BTreeSet::new(),
            is_first_removed: false,
            range_steps: BTreeMap::new(),
        }
    }

    /// The view that an edit of this surface starts from.
    pub fn view(&self, surface: u8) -> View {
        if let Some(view) = self.surfaces.get(&surface) {
            return view.clone();
        }
        let mut view = self.opening.clone();
        let shared = self.surfaces.values().find_map(View::budget);
        if let Some((name, value)) = shared {
            view.set_budget(Some((name, value.clone())));
        }
        view
    }

    /// Applies an edit; returns false if the server is to answer it with `bad-edit`.
    pub fn edit(&mut self, edit: &Value) -> bool {
        let edit = edit.as_object().expect("an edit");
        let edit: Map<_, _> = edit
            .iter()
            .filter(|(name, _)| *name != "type")
            .map(|(k, v)| (k.clone(), v.clone()))
            .collect();
        let surface = edit.get("surface").and_then(Value::as_u64).unwrap_or(0);
        let Some(surface) = u8::try_from(surface).ok().filter(|&surface| surface < 4) else {
            return false;
        };
        let before = self.view(surface);
        let Some(view) = before.edited(&edit) else {
            return false;
        };
        self.note_range(surface, &before, &view);
        if BUDGETS.iter().any(|name| edit.contains_key(*name)) {
            let budget = view.budget().map(|(name, value)| (name, value.clone()));
            let shares = self.surfaces.values_mut().filter(|view| view.budget().is_some());
            shares.for_each(|view| view.set_budget(budget.clone()));
        }
        self.surfaces.insert(surface, view);
        self.edited.insert(surface);
        self.is_first_removed &= surface != 0;
        true
    }

    fn note_range(&mut self, surface: u8, before: &View, view: &View) {
        let has_own = |view: &View| view.get("featureRange").is_null();
        if !has_own(view) {
            self.range_steps.remove(&surface);
        } else if !has_own(before) || before.has_other_feature(view) {
            self.range_steps.insert(surface, self.step);
        }
    }

    /// Removes a surface, which must be there.
    pub fn remove(&mut self, surface: u8) {
        self.surfaces.remove(&surface);
        self.range_steps.remove(&surface);
        self.edited.remove(&surface);
        self.is_first_removed |= surface == 0;
    }

    /// The step that a fresh client opens first to get the same surfaces: the first step from which a range was taken, or else the current
    /// one.
    pub fn first_step(&self) -> u64 {
        let of_ranges = self
            .range_steps
            .iter()
            .filter(|(surface, _)| self.edited.contains(surface));
        of_ranges.map(|(_, step)| *step).min().unwrap_or(self.step)
    }

    /// The messages that it sends then.
    pub fn messages(&self) -> Vec<Value> {
        let mut messages = Vec::new();
        if self.is_first_removed && !self.edited.is_empty() {
            messages.push(json!({"type": "remove", "surface": 0}));
        }
        let step_of = |surface: &u8| self.range_steps.get(surface).copied().unwrap_or(self.step);
        let mut step = self.first_step();
        // Not of a range of its own: with the last ones.
        let steps: BTreeSet<_> = self.edited.iter().map(step_of).chain([self.step]).collect();
        let (others, last): (Vec<_>, Vec<_>) = steps.into_iter().partition(|step| *step != self.step);
        for next in others.into_iter().chain(last) {
            if next != step {
                messages.push(json!({"type": "step", "step": next}));
                step = next;
            }
            let edited = self.edited.iter().filter(|surface| step_of(surface) == next);
            messages.extend(edited.map(|&surface| self.full_edit(surface)));
        }
        messages
    }

    /// All values of a surface.
    fn full_edit(&self, surface: u8) -> Value {
        let view = &self.surfaces[&surface];
        let mut edit = view.0.clone();
        edit.insert("type".into(), json!("edit"));
        edit.insert("surface".into(), json!(surface));
        if !view.is_by_error() {
            edit.remove("minPart");
            edit.remove("parts");
        }
        Value::Object(edit)
    }
}
