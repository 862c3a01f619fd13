//! N5 (<https://github.com/saalfeldlab/n5>): `attributes.json` for groups and datasets; each block has a header. The first axis is x.
//!
//! A dataset is opened by name (`a.n5:volumes/raw`); the only dataset of a container also without a name; of several levels (`s0`, `s1`,
//! …) the finest. The XML beside a container of BigDataViewer (`setup0/timepoint0/s0`) gives the position of its views.

use std::sync::Arc;

use serde_json::Value;

use super::super::header::{self, GridFields};
use super::super::named_axes::{self, AxisFacts};
use super::super::spim_data::{self, SpimData};
use super::super::store::{Store, join};
use super::super::variables::layout::Layout;
use super::super::variables::place::known_spacing;
use super::codecs::{Pipeline, integers};
use super::metadata::{Array, third_type};
use super::open_samples;
use super::samples::Axes;
use crate::numbered::join_steps;
use crate::{Geometry, LengthUnit, OpenedFile, ReadError};

const FIELDS: GridFields = GridFields {
    dims: "dimensions",
    spacing: "resolution",
    origin: "offset",
    direction: "resolution",
};

/// Levels of groups below the root that are searched for datasets.
const MAX_DEPTH: usize = 5;
/// Maximum datasets that a message lists.
const MAX_LISTED: usize = 20;
/// Maximum time steps.
const MAX_STEPS: usize = 1 << 16;

/// Opens the dataset, view or group at a path of an N5 container; `None` if the store is no N5.
pub(super) fn open(store: &Arc<Store>, path: &str) -> Result<Option<OpenedFile>, ReadError> {
    let root: Option<Value> = store.json("attributes.json")?;
    let own = attributes(store, path)?;
    if own.get("dimensions").is_some() {
        return open_dataset(store, path, &own).map(Some);
    }
    if root.is_none_or(|root| root.get("n5").is_none()) {
        return Ok(None);
    }
    // The path may be the name of a view, which is no folder.
    let folders = store.folders(path).unwrap_or_default();
    if folders.iter().any(|name| name == "s0") {
        let finest = join(path, "s0");
        return open_dataset(store, &finest, &attributes(store, &finest)?).map(Some);
    }
    let root_folders = store.folders("")?;
    if root_folders.iter().any(|name| setup_number(name).is_some()) {
        let beside = spim_data::beside(&store.location().clone());
        let notice = beside
            .is_none()
            .then(|| "there is no .xml of the same name beside the folder, which says where the view is".to_owned());
        let part = Some(path).filter(|path| !path.is_empty());
        let opened = open_views(store, part, &beside.unwrap_or_default())?;
        return Ok(Some(header::with_notices(opened, notice)));
    }
    let mut found = Vec::new();
    search(store, path, MAX_DEPTH, &mut found)?;
    match found.as_slice() {
        [one] => open_dataset(store, one, &attributes(store, one)?).map(Some),
        [] => Err(store.error(path, "no dataset in it, expected one at least")),
        several => {
            let more = several.len().saturating_sub(MAX_LISTED);
            let names = several[..several.len().min(MAX_LISTED)].join(", ");
            let why = format!(
                "{} datasets, expected the name of one behind a colon: {names} and {more} more",
                several.len()
            );
            Err(store.error(path, why.replace(" and 0 more", "")))
        }
    }
}

/// Parses the number in `setup0`.
fn setup_number(name: &str) -> Option<u64> {
    name.strip_prefix("setup")?.parse().ok()
}

fn attributes(store: &Store, path: &str) -> Result<Value, ReadError> {
    Ok(store.json(&join(path, "attributes.json"))?.unwrap_or_default())
}

/// Collects the paths of the datasets below a group. Of the levels `s0`, `s1`, … of an image only `s0`.
fn search(store: &Store, path: &str, depth: usize, found: &mut Vec<String>) -> Result<(), ReadError> {
    for name in store.folders(path)? {
        let whole = join(path, &name);
        if attributes(store, &whole)?.get("dimensions").is_some() {
            if name.starts_with('s') && name[1..].parse::<u32>().is_ok_and(|level| level > 0) {
                continue;
            }
            found.push(whole);
        } else if depth > 1 && found.len() <= MAX_LISTED {
            search(store, &whole, depth - 1, found)?;
        }
    }
    Ok(())
}

/// Opens a view of BigDataViewer.
pub(super) fn open_views(store: &Arc<Store>, part: Option<&str>, data: &SpimData) -> Result<OpenedFile, ReadError> {
    let fail = |why: String| store.error("", why);
    let mut setups: Vec<u64> = store
        .folders("")?
        .iter()
        .filter_map(|name| setup_number(name))
        .collect();
    setups.sort_unstable();
    let setup = data.choose(part, &setups).map_err(fail)?;
    let group = format!("setup{setup}");
    let number = |name: &String| name.strip_prefix("timepoint")?.parse::<u64>().ok();
    let mut points: Vec<u64> = store.folders(&group)?.iter().filter_map(number).collect();
    points.sort_unstable();
    if points.is_empty() || points.len() > MAX_STEPS {
        return Err(fail(format!(
            "{} time points of {group}, expected 1 to {MAX_STEPS}",
            points.len()
        )));
    }
    let mut files = Vec::new();
    let mut notices = Vec::new();
    let mut first = None;
    for time in points {
        let path = format!("{group}/timepoint{time}/s0");
        let array = array(store, &path, &attributes(store, &path)?)?;
        let layout = layout(store, &path, &array, &Value::Null)?.0;
        let (own, notice) = data.place(time, setup, [1.0; 3]);
        let grid = first.get_or_insert_with(|| own.clone()).clone();
        if grid != own {
            notices
                .push("the view moves from one time point to another: it was put where it is at the first".to_owned());
        }
        notices.extend(notice);
        let shown = store.path(&path);
        let placed = header::geometry(&shown, &FIELDS, layout.dims, grid.spacing, grid.origin, grid.direction)?;
        let geometry = Geometry {
            unit: grid.unit,
            ..placed
        };
        let name = data
            .setups
            .get(&setup)
            .and_then(|setup| setup.name.clone())
            .unwrap_or(group.clone());
        let file = open_samples(store, &path, array, Axes::of_layout(&layout), geometry, &[name])?;
        files.push((store.location().clone(), file));
    }
    Ok(header::with_notices(join_steps(files, None)?, notices))
}

fn open_dataset(store: &Arc<Store>, path: &str, attributes: &Value) -> Result<OpenedFile, ReadError> {
    let array = array(store, path, attributes)?;
    let (layout, mut notices) = layout(store, path, &array, attributes)?;
    let geometry = geometry(store, path, &layout, attributes, &mut notices)?;
    let file = open_samples(store, path, array, Axes::of_layout(&layout), geometry, &[])?;
    Ok(header::with_notices(file, notices))
}

/// Describes a dataset as an array whose last axis is fastest: N5 lists the fastest axis first.
fn array(store: &Store, path: &str, attributes: &Value) -> Result<Array, ReadError> {
    let fail = |why: String| store.error(path, why);
    let list = |name: &str| {
        let mut numbers =
            integers(attributes.get(name)).ok_or_else(|| fail(format!("no {name}, expected a list of numbers")))?;
        numbers.reverse();
        Ok::<_, ReadError>(numbers)
    };
    let (shape, chunks) = (list("dimensions")?, list("blockSize")?);
    let name = attributes.get("dataType").and_then(Value::as_str).unwrap_or("none");
    let stored = third_type(name).ok_or_else(|| {
        fail(format!(
            "dataType {name:?}, expected an integer of 8 to 64 bits, float32 or float64"
        ))
    })?;
    let pipeline = Pipeline::of_n5(attributes, &chunks, stored.bytes()).map_err(fail)?;
    let array = Array {
        fill: 0.0,
        shape,
        chunks,
        stored,
        type_name: name.to_owned(),
        pipeline,
        key_prefix: "",
        key_separator: "/".to_owned(),
        is_key_reversed: true,
        attributes: Value::Null,
        missing: None,
        names: Vec::new(),
    };
    array.checked(store, path)
}

/// Returns the roles of the axes: those that the file names, else z, y, x in the order of storage.
fn layout(store: &Store, path: &str, array: &Array, attributes: &Value) -> Result<(Layout, Vec<String>), ReadError> {
    let mut names: Vec<String> = texts(attributes.get("axes"));
    names.reverse();
    let by_place = ["z", "y", "x"];
    let name = |axis: usize| match names.len() == array.shape.len() {
        true => names.get(axis).map(String::as_str),
        false => by_place.get(axis).copied().filter(|_| array.shape.len() == 3),
    };
    let facts = array.shape.iter().enumerate().map(|(axis, &size)| AxisFacts {
        size,
        name: name(axis),
        ..AxisFacts::default()
    });
    let fail = |why: String| ReadError::new(&store.path(path), "dimensions", why);
    let roles = named_axes::assign(&facts.collect::<Vec<_>>()).map_err(fail)?;
    let layout = Layout::new(array.shape.clone(), &roles).map_err(fail)?;
    Ok((layout, roles.notices))
}

fn texts(value: Option<&Value>) -> Vec<String> {
    let list = value.and_then(Value::as_array);
    list.into_iter()
        .flatten()
        .map(|text| text.as_str().unwrap_or_default().to_owned())
        .collect()
}

/// Returns the grid, by `resolution` and `units` or by `pixelResolution`, which list x first.
fn geometry(
    store: &Store,
    path: &str,
    layout: &Layout,
    attributes: &Value,
    notices: &mut Vec<String>,
) -> Result<Geometry, ReadError> {
    let pixel = attributes.get("pixelResolution");
    let listed = |value: Option<&Value>| -> Vec<Option<f64>> {
        let list = value.and_then(Value::as_array);
        let mut numbers: Vec<Option<f64>> = list.into_iter().flatten().map(Value::as_f64).collect();
        numbers.resize(layout.sizes.len(), None);
        numbers.reverse();
        numbers
    };
    let resolution = attributes
        .get("resolution")
        .or_else(|| pixel.and_then(|pixel| pixel.get("dimensions")))
        .or(pixel);
    let steps = listed(resolution);
    let spacing = match known_spacing(layout.axes.map(|axis| steps[axis].filter(|step| *step > 0.0))) {
        Some((spacing, notice)) => {
            notices.extend(notice);
            spacing
        }
        None => [1.0; 3],
    };
    let offset = listed(attributes.get("offset"));
    let origin = layout.axes.map(|axis| offset[axis].unwrap_or(0.0));
    let placed = header::geometry(
        &store.path(path),
        &FIELDS,
        layout.dims,
        spacing,
        origin,
        Geometry::IDENTITY,
    )?;
    let units = texts(attributes.get("units"));
    let of_pixel = pixel.and_then(|pixel| pixel.get("unit")).and_then(Value::as_str);
    let unit = units.first().map(String::as_str).or(of_pixel);
    if units.windows(2).any(|pair| pair[0] != pair[1]) {
        notices.push(format!("the units {units:?} differ: none was taken"));
        return Ok(placed);
    }
    Ok(Geometry {
        unit: unit.and_then(LengthUnit::parse),
        ..placed
    })
}
