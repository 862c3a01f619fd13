//! OME-Zarr: images of several resolutions, versions 0.1 to 0.5.

use std::collections::BTreeMap;

use serde_json::Value;

use super::super::named_axes::{self, AxisFacts, AxisRoles, Role};
use super::super::store::Store;
use crate::{Label, LengthUnit, MAX_LABELS, ReadError};

/// An axis of an array.
#[derive(Clone, Debug)]
pub(super) struct Axis {
    pub(super) name: String,
    /// Role by the axis' type, if that is time or channel. `None` for an axis in space, which its name identifies.
    role: Option<Role>,
    /// Type of the axis, if it is not space, time or channel.
    other_type: Option<String>,
    pub(super) unit: Option<LengthUnit>,
    /// For an axis in space: its unit in the file, if it is no known unit of length.
    unknown_unit: Option<String>,
    /// For a time axis: its unit in the file.
    pub(super) time_unit: Option<String>,
}

impl Axis {
    pub(super) fn named(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            role: None,
            other_type: None,
            unit: None,
            unknown_unit: None,
            time_unit: None,
        }
    }

    /// Parses an entry of `axes`: an object, up to version 0.3 a name.
    fn parse(value: &Value) -> Self {
        let text = |key: &str| value.get(key).and_then(Value::as_str);
        let name = value.as_str().or_else(|| text("name")).unwrap_or_default();
        let (role, other_type) = match text("type") {
            Some("time") => (Some(Role::Time), None),
            Some("channel") => (Some(Role::Channel), None),
            None | Some("space") => (None, None),
            Some(other) => (None, Some(other.to_owned())),
        };
        let is_time = role == Some(Role::Time) || name == "t";
        let unit = text("unit").filter(|_| !is_time);
        Self {
            name: name.to_owned(),
            role,
            other_type,
            unit: unit.and_then(LengthUnit::parse),
            unknown_unit: unit.filter(|unit| LengthUnit::parse(unit).is_none()).map(str::to_owned),
            time_unit: is_time.then(|| text("unit").map(str::to_owned)).flatten(),
        }
    }
}

/// Assigns roles to the axes of an array of this shape.
///
/// # Errors
/// The array is no volume; the message lists its axes.
pub(super) fn roles(axes: &[Axis], shape: &[u64]) -> Result<AxisRoles, String> {
    if axes.len() != shape.len() {
        return Err(format!("{} names for {} axes", axes.len(), shape.len()));
    }
    let other = axes
        .iter()
        .zip(shape)
        .find(|(axis, size)| **size > 1 && axis.other_type.is_some());
    if let Some((Axis { name, other_type, .. }, size)) = other {
        let kind = other_type.as_deref().unwrap_or_default();
        return Err(format!(
            "{size} samples along {name:?} of type {kind:?}, expected space, time or channel"
        ));
    }
    let facts = axes.iter().zip(shape).map(|(axis, &size)| AxisFacts {
        size,
        name: Some(axis.name.as_str()),
        stated: axis.role,
        ..AxisFacts::default()
    });
    named_axes::assign(&facts.collect::<Vec<_>>())
}

/// Returns the unit of lengths along x, y and z, the factor of each axis to it, and notices of unknown units.
pub(super) fn length_unit(axes: &[Axis], space: [usize; 3]) -> (Option<LengthUnit>, [f64; 3], Vec<String>) {
    let units = space.map(|axis| axes[axis].unit);
    let unit = units.into_iter().flatten().next();
    let metres = |unit: Option<LengthUnit>| unit.and_then(LengthUnit::metres);
    let factors = units.map(|own| match (metres(own), metres(unit)) {
        (Some(own_metres), Some(metres)) if own != unit => own_metres / metres,
        _ => 1.0,
    });
    let mut notices = Vec::new();
    for axis in space.map(|axis| &axes[axis]) {
        match (&axis.unknown_unit, unit) {
            (Some(text), _) => notices.push(format!("the unit {text:?} of axis {:?} is not known", axis.name)),
            (None, Some(unit)) if axis.unit.is_none() => {
                notices.push(format!("axis {:?} has no unit: {} was taken", axis.name, unit.symbol()));
            }
            _ => {}
        }
    }
    (unit, factors, notices)
}

/// One level of resolution.
pub(super) struct Level {
    /// Path of its array, below the image.
    pub(super) path: String,
    /// Scale of each axis.
    pub(super) scale: Vec<f64>,
    pub(super) translation: Vec<f64>,
    /// Whether the file states the scale.
    pub(super) has_scale: bool,
}

impl Level {
    /// The level of an array without an image: samples 1 apart from 0.
    pub(super) fn plain(axes: usize) -> Self {
        Self {
            path: String::new(),
            scale: vec![1.0; axes],
            translation: vec![0.0; axes],
            has_scale: false,
        }
    }

    /// Applies transformations in their order.
    fn transform(&mut self, list: Option<&Value>) -> Result<(), String> {
        for one in list.and_then(Value::as_array).into_iter().flatten() {
            let kind = one.get("type").and_then(Value::as_str).unwrap_or_default();
            let numbers = || -> Result<Vec<f64>, String> {
                let list = one.get(kind).and_then(Value::as_array);
                let numbers: Option<Vec<f64>> = list.and_then(|l| l.iter().map(Value::as_f64).collect());
                let numbers = numbers.filter(|numbers| numbers.len() == self.scale.len());
                numbers.ok_or_else(|| format!("{kind} of {one}, expected {} numbers", self.scale.len()))
            };
            match kind {
                "identity" => {}
                "scale" => {
                    self.has_scale = true;
                    for (i, factor) in numbers()?.into_iter().enumerate() {
                        self.scale[i] *= factor;
                        self.translation[i] *= factor;
                    }
                }
                "translation" => {
                    for (i, by) in numbers()?.into_iter().enumerate() {
                        self.translation[i] += by;
                    }
                }
                other => return Err(format!("{other:?}, expected identity, scale or translation")),
            }
        }
        Ok(())
    }
}

/// An image, as the attributes of a group describe it.
pub(super) struct Image {
    pub(super) axes: Vec<Axis>,
    /// Levels of resolution, the finest first.
    pub(super) levels: Vec<Level>,
    /// Names of the channels; empty if the attributes have none.
    pub(super) channels: Vec<String>,
    /// Names and colours of labels, if it is an image of labels.
    pub(super) labels: Vec<Label>,
}

/// Returns the first image of a group; `None` if the group has none.
pub(super) fn image(store: &Store, path: &str, attributes: &Value) -> Result<Option<Image>, ReadError> {
    // From version 0.5 on, the attributes are below `ome`.
    let attributes = attributes.get("ome").unwrap_or(attributes);
    let Some(list) = attributes.get("multiscales").and_then(Value::as_array) else {
        return Ok(None);
    };
    let fail = |why: String| store.error(path, format!("multiscales: {why}"));
    let Some(first) = list.first() else {
        return Err(fail("none, expected one".to_owned()));
    };
    if list.len() > 1 {
        tracing::info!(path = %store.path(path).display(), "the first of {} images is opened", list.len());
    }
    let axes: Vec<Axis> = match first.get("axes").and_then(Value::as_array) {
        Some(axes) => axes.iter().map(Axis::parse).collect(),
        None => ["t", "c", "z", "y", "x"].map(Axis::named).into(),
    };
    let mut levels = Vec::new();
    for dataset in first.get("datasets").and_then(Value::as_array).into_iter().flatten() {
        let path = dataset.get("path").and_then(Value::as_str);
        let path = path.ok_or_else(|| fail("a dataset without a path, expected one".to_owned()))?;
        let mut level = Level {
            path: path.trim_matches('/').to_owned(),
            ..Level::plain(axes.len())
        };
        for list in [dataset, first].map(|of| of.get("coordinateTransformations")) {
            level
                .transform(list)
                .map_err(|why| fail(format!("coordinateTransformations: {why}")))?;
        }
        levels.push(level);
    }
    if levels.is_empty() {
        return Err(fail("no datasets, expected one at least".to_owned()));
    }
    let channels = attributes
        .get("omero")
        .and_then(|omero| omero.get("channels"))
        .and_then(Value::as_array);
    let label = |channel: &Value| {
        channel
            .get("label")
            .and_then(Value::as_str)
            .unwrap_or_default()
            .to_owned()
    };
    let channels = channels.into_iter().flatten().map(label).collect();
    let labels = attributes.get("image-label").map(labels).unwrap_or_default();
    Ok(Some(Image {
        axes,
        levels,
        channels,
        labels,
    }))
}

/// Parses names and colours of labels. The specification does not define which property holds the name.
fn labels(described: &Value) -> Vec<Label> {
    let list = |name: &str| described.get(name).and_then(Value::as_array).into_iter().flatten();
    let value = |entry: &Value| entry.get("label-value").and_then(Value::as_i64);
    let mut found: BTreeMap<i64, (String, Option<[u8; 3]>)> = BTreeMap::new();
    for entry in list("properties").take(MAX_LABELS) {
        let name = ["name", "label", "class", "label-name", "title"]
            .iter()
            .find_map(|name| entry.get(name)?.as_str());
        if let (Some(value), Some(name)) = (value(entry), name) {
            name.clone_into(&mut found.entry(value).or_default().0);
        }
    }
    for entry in list("colors").take(MAX_LABELS) {
        let color = |at: usize| u8::try_from(entry.get("rgba")?.get(at)?.as_u64()?).ok();
        if let (Some(value), Some(red), Some(green), Some(blue)) = (value(entry), color(0), color(1), color(2)) {
            found.entry(value).or_default().1 = Some([red, green, blue]);
        }
    }
    let label = |(value, (name, color)): (i64, (String, _))| Label::new(value, &name, color);
    found.into_iter().take(MAX_LABELS).map(label).collect()
}
