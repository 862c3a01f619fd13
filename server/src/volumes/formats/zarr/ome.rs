//! OME-Zarr: images of several resolutions, versions 0.1 to 0.5.

use serde_json::Value;

use super::super::store::Store;
use crate::volumes::{LengthUnit, ReadError};

/// An axis of an array.
#[derive(Clone, Debug)]
pub(super) struct Axis {
    pub(super) name: String,
    pub(super) unit: Option<LengthUnit>,
    /// Of an axis of time, as the file names it.
    pub(super) time_unit: Option<String>,
}

impl Axis {
    pub(super) fn named(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            unit: None,
            time_unit: None,
        }
    }

    /// An object of `axes`; up to version 0.3 a name.
    fn parse(value: &Value) -> Self {
        let text = |key: &str| value.get(key).and_then(Value::as_str);
        let name = value.as_str().or_else(|| text("name")).unwrap_or_default();
        let name = match text("type") {
            Some("time") => "t",
            Some("channel") => "c",
            _ => name,
        };
        Self {
            name: name.to_owned(),
            unit: text("unit").and_then(LengthUnit::parse),
            time_unit: (name == "t").then(|| text("unit").map(str::to_owned)).flatten(),
        }
    }
}

/// One resolution.
pub(super) struct Level {
    /// Of its array, below the image.
    pub(super) path: String,
    /// Of each axis.
    pub(super) scale: Vec<f64>,
    pub(super) translation: Vec<f64>,
}

impl Level {
    /// An array without an image: samples 1 apart from 0.
    pub(super) fn plain(axes: usize) -> Self {
        Self {
            path: String::new(),
            scale: vec![1.0; axes],
            translation: vec![0.0; axes],
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

/// What the attributes of a group say of an image.
pub(super) struct Image {
    pub(super) axes: Vec<Axis>,
    /// The finest first.
    pub(super) levels: Vec<Level>,
    /// Names of the channels, where they have some.
    pub(super) channels: Vec<String>,
}

/// The image of a group; `None` where it is none. Of several the first.
pub(super) fn image(store: &Store, path: &str, attributes: &Value) -> Result<Option<Image>, ReadError> {
    // From version 0.5 on the attributes have a name of their own.
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
    Ok(Some(Image { axes, levels, channels }))
}
