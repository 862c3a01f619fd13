//! Zarr, versions 2 and 3 (<https://zarr-specs.readthedocs.io>), and OME-Zarr (<https://ngff.openmicroscopy.org>), its
//! images of several resolutions: a folder that ends in `.zarr`, or has `zarr.json`, `.zarray`, `.zgroup` or `.zattrs`; or the address
//! of a store over a network.
//!
//! - A multiscale image: its finest level of at most 2^31 samples. Axes t and c are time steps and fields, named by
//!   `omero`; spacing and origin are those of the scales and translations. `x.zarr:1` names another level,
//!   `x.zarr:labels/NAME` an image of labels.
//! - An array: names of dimensions and positions along them give the axes, see `named_axes`; without names they are `z, y, x`, `t, z, y, x`
//!   or `t, c, z, y, x`. Positions are those of `coordinates`.
//! - A group of arrays of one shape: each is a field. `x.zarr:NAME` names one of several.
//!
//! A chunk that is not stored has the fill value. Links are followed only below the folder. `codecs` lists the encodings of chunks that
//! are read.

mod codecs;
mod coordinates;
mod filters;
mod metadata;
mod n5;
mod ome;
mod samples;

use std::path::Path;
use std::sync::Arc;

use serde_json::Value;

use super::FolderVolume;
use super::header::{self, GridFields};
use super::spim_data::SpimData;
use super::store::{self, Store};
use super::variables::axes;
use super::variables::layout::Layout;
use super::variables::place::place_grid;
use super::variables::values::Values;
use crate::location::title_of;
use crate::{Field, FileLocation, Geometry, Notices, OpenedFile, ReadError, TimeAxis};
use coordinates::Variables;
use metadata::{Array, Node, node};
use ome::{Axis, Image, Level};
use samples::{Axes, ZarrSamples};

const FIELDS: GridFields = GridFields {
    dims: "shape",
    spacing: "scale",
    origin: "translation",
    direction: "axes",
};

/// Bytes of an `attributes.json` that are examined to detect N5.
const MAX_ATTRIBUTES: usize = 1 << 20;

/// Maximum arrays of a group that are opened as fields of one volume.
const MAX_ARRAYS: usize = 64;

/// Maximum samples of a level that is opened without being named.
const MAX_LEVEL_SAMPLES: u64 = 1 << 31;

/// Whether a folder is a Zarr array or group.
pub fn holds(folder: &Path) -> bool {
    let ends = folder.extension().is_some_and(|e| e.eq_ignore_ascii_case("zarr"));
    let names = ["zarr.json", ".zarray", ".zgroup", ".zattrs"];
    folder.is_dir() && (ends || names.iter().any(|name| folder.join(name).is_file()) || is_n5(folder))
}

/// Whether a folder is a container or dataset of N5.
fn is_n5(folder: &Path) -> bool {
    let ends = folder.extension().is_some_and(|e| e.eq_ignore_ascii_case("n5"));
    let attributes = FileLocation::disk(folder.join("attributes.json"));
    let text = attributes
        .open()
        .and_then(|blob| blob.head(MAX_ATTRIBUTES))
        .unwrap_or_default();
    let value: Value = serde_json::from_slice(&text).unwrap_or_default();
    ends || ["n5", "dimensions"].iter().any(|name| value.get(name).is_some())
}

/// Opens a view of BigDataViewer in an N5 folder, with the description in `data`.
///
/// # Errors
/// What is wrong with the folder, or the list of views if one must be named.
pub(super) fn open_views(location: &FileLocation, data: &SpimData) -> Result<OpenedFile, ReadError> {
    n5::open_views(&Arc::new(Store::open(location, "n5")?), location.part(), data)
}

/// Reads the metadata of a Zarr folder.
///
/// # Errors
/// What is wrong with the metadata, by field; several arrays or images of which none is named.
pub fn open(location: &FileLocation) -> Result<Vec<FolderVolume>, ReadError> {
    let store = Arc::new(Store::open(location, "zarr")?);
    let part = location.part().unwrap_or_default().trim_matches('/').to_owned();
    let file = match node(&store, &part)? {
        None => n5::open(&store, &part)?.ok_or_else(|| store.error(&part, store.nothing_there())),
        Some(Node::Array(array)) => open_array(&store, &part, *array),
        Some(Node::Group(attributes)) => open_group(&store, &part, &attributes),
    }?;
    let mut title = match location.address() {
        // The name of the folder, as for a folder on disk.
        Some(address) => address.shown().rsplit('/').next().unwrap_or_default().to_owned(),
        None => title_of(location.path()),
    };
    for extension in [".zarr", ".ome", ".n5"] {
        title = title.strip_suffix(extension).unwrap_or(&title).to_owned();
    }
    if !part.is_empty() {
        title = format!("{title} {part}");
    }
    Ok(vec![FolderVolume { title, file }])
}

/// Opens an array that was named. It may be a level of an image in a group above it.
fn open_array(store: &Arc<Store>, path: &str, array: Array) -> Result<OpenedFile, ReadError> {
    for (at, _) in path.match_indices('/').chain((!path.is_empty()).then_some((0, ""))) {
        let (group, level) = (&path[..at], path[at..].trim_start_matches('/'));
        if let Some(Node::Group(attributes)) = node(store, group)?
            && let Some(image) = ome::image(store, group, &attributes)?
            && let Some(found) = image.levels.iter().find(|other| other.path == level)
        {
            return open_level(store, path, array, &image, found);
        }
    }
    let mut notices = Vec::new();
    let array = with_fill_as_value(array, &mut notices);
    let variables = Variables::beside(store, path);
    let mut variable = variables.describe(path, &array);
    if array.shape.len() == 5 && !array.has_names() {
        notices.push("the file does not say what its axes are: time, channels, z, y, x were taken".to_owned());
        for (axis, name) in variable.axes.iter_mut().zip(["t", "c", "z", "y", "x"]) {
            axis.label.name = Some(name.to_owned());
        }
    }
    let scales = axes::scales(&variables, &variable);
    let shown = store.path(path);
    let fail = |why: String| ReadError::new(&shown, "shape", why);
    let roles = axes::roles(&variable, &scales).map_err(fail)?;
    let layout = Layout::new(variable.sizes(), &roles).map_err(fail)?;
    let placed = place_grid(&shown, &variables, &variable, &scales, layout.axes, layout.dims)?;
    let steps = u64::from(layout.steps);
    let times = layout
        .time
        .and_then(|axis| axes::times(&variables, scales[axis].as_ref()?, steps));
    let file = open_samples(store, path, array, Axes::of_layout(&layout), placed.geometry, &[])?;
    let file = placed.finish(&shown, OpenedFile { times, ..file })?;
    Ok(header::with_notices(file, roles.notices.into_iter().chain(notices)))
}

/// Treats a fill value of 0 as a value, with a notice: in version 2, programs write it by default, also for images.
fn with_fill_as_value(array: Array, notices: &mut Vec<String>) -> Array {
    if array.missing != Some(0.0) {
        return array;
    }
    notices.push("the fill value 0 is taken as a value; xarray takes it as missing".to_owned());
    Array { missing: None, ..array }
}

/// Opens a group: an image, or arrays side by side.
fn open_group(store: &Arc<Store>, path: &str, attributes: &Value) -> Result<OpenedFile, ReadError> {
    let Some(image) = ome::image(store, path, attributes)? else {
        return open_arrays(store, path);
    };
    let mut too_large = Vec::new();
    for level in &image.levels {
        let whole = store::join(path, &level.path);
        let Some(Node::Array(array)) = node(store, &whole)? else {
            return Err(store.error(&whole, "no array there, expected one: `datasets` names it"));
        };
        let layout = layout_of(store, &whole, &image.axes, &array)?.0;
        let samples = layout.dims.iter().map(|&n| u64::from(n)).product::<u64>();
        if samples > MAX_LEVEL_SAMPLES {
            too_large.push(format!("{whole} has {samples} samples"));
            continue;
        }
        if image.levels.len() > 1 {
            let path = store.shown().display();
            tracing::info!(%path, "level {} is opened: the finest of 2^31 samples at most", level.path);
        }
        return open_level(store, &whole, *array, &image, level);
    }
    let why = format!(
        "{}; expected 2^31 at most, or a level that is named",
        too_large.join(", ")
    );
    Err(store.error(path, why))
}

/// Opens the arrays of a group. Arrays of one shape are fields; with several shapes one must be named.
fn open_arrays(store: &Arc<Store>, path: &str) -> Result<OpenedFile, ReadError> {
    let mut found: Vec<(String, Array)> = Vec::new();
    let mut names = Vec::new();
    for name in store.folders(path)? {
        let whole = store::join(path, &name);
        match node(store, &whole) {
            Ok(Some(Node::Array(array))) if (3..=5).contains(&array.shape.len()) => found.push((name.clone(), *array)),
            Ok(None | Some(_)) => {}
            Err(error) => tracing::warn!("passed over: {error}"),
        }
        names.push(name);
    }
    let Some((_, first)) = found.first() else {
        let why = format!("no array of 3 to 5 axes in it, expected one, or the path of one below: {names:?}");
        return Err(store.error(path, why));
    };
    if found.iter().any(|(_, array)| array.shape != first.shape) || found.len() > MAX_ARRAYS {
        let shapes: Vec<String> = found.iter().map(|(name, a)| format!("{name} {:?}", a.shape)).collect();
        let why = format!(
            "arrays of several shapes, expected one: name it, as {}:{} ({})",
            store.shown().display(),
            store::join(path, &found[0].0),
            shapes.join(", ")
        );
        return Err(store.error(path, why));
    }
    let mut files = found
        .into_iter()
        .map(|(name, array)| open_array(store, &store::join(path, &name), array));
    // There is at least one file.
    let mut file = files.next().unwrap_or_else(|| Err(store.error(path, "no array")))?;
    for other in files {
        let other = other?;
        if (other.geometry, other.steps) != (file.geometry, file.steps) {
            return Err(store.error(path, "arrays of several grids, expected one, or the name of an array"));
        }
        file.fields.extend(other.fields);
        file.notices.extend(other.notices);
    }
    Ok(file)
}

/// Returns the roles of the axes of an image's level, with notices of assumptions.
fn layout_of(store: &Store, path: &str, axes: &[Axis], array: &Array) -> Result<(Layout, Vec<String>), ReadError> {
    let fail = |why: String| ReadError::new(&store.path(path), "axes", why);
    let roles = ome::roles(axes, &array.shape).map_err(fail)?;
    let layout = Layout::new(array.shape.clone(), &roles).map_err(fail)?;
    Ok((layout, roles.notices))
}

/// Opens an array with the known properties of its axes.
fn open_level(
    store: &Arc<Store>,
    path: &str,
    array: Array,
    image: &Image,
    level: &Level,
) -> Result<OpenedFile, ReadError> {
    let axes = image.axes.as_slice();
    let (layout, mut notices) = layout_of(store, path, axes, &array)?;
    let geometry = geometry(&store.path(path), axes, &layout, level, &mut notices)?;
    let times = layout.time.and_then(|axis| {
        let unit = axes[axis].time_unit.as_deref()?;
        TimeAxis::even(level.translation[axis], level.scale[axis], layout.steps, unit)
    });
    // No sample of an image is missing, whatever the fill value.
    let array = Array { missing: None, ..array };
    let mut file = open_samples(store, path, array, Axes::of_layout(&layout), geometry, &image.channels)?;
    for field in &mut file.fields {
        field.labels.clone_from(&image.labels);
    }
    Ok(header::with_notices(OpenedFile { times, ..file }, notices))
}

/// Makes the fields of an array.
fn open_samples(
    store: &Arc<Store>,
    path: &str,
    array: Array,
    roles: Axes,
    geometry: Geometry,
    channels: &[String],
) -> Result<OpenedFile, ReadError> {
    let shown = store.path(path);
    let (steps, count) = (roles.steps, roles.channels);
    let type_name = array.type_name.clone();
    let variable = Variables::beside(store, path).describe(path, &array);
    let values = Values::of(&variable, array.stored).map_err(|why| ReadError::new(&shown, "attributes", why))?;
    let unit = variable.text("units").filter(|&unit| unit != "1");
    let notices = variable.notices();
    let base = ZarrSamples::new(store.clone(), path.to_owned(), array, roles, values)?;
    let field = |(channel, name): (u32, String)| {
        let samples = base.of_channel(channel);
        Field {
            name,
            stored_type: type_name.clone(),
            sample_type: samples.sample_type(),
            missing: base.missing(),
            unit: unit.map(str::to_owned),
            labels: Vec::new(),
            declares_labels: false,
            source: Arc::new(samples),
        }
    };
    let fields = (0..)
        .zip(channel_names(store, path, count, channels))
        .map(field)
        .collect();
    let file = OpenedFile {
        geometry,
        steps,
        uneven: None,
        axes: None,
        times: None,
        fields,
        notices: Notices::default(),
    };
    Ok(header::with_notices(file, notices))
}

/// Returns the grid of a level, with notices of unknown properties. Lengths are in the unit of x, or of the first axis that has one.
fn geometry(
    shown: &Path,
    axes: &[Axis],
    layout: &Layout,
    level: &Level,
    notices: &mut Vec<String>,
) -> Result<Geometry, ReadError> {
    let space = layout.axes;
    let (unit, factors, unknown) = ome::length_unit(axes, space);
    notices.extend(unknown);
    if !level.has_scale {
        notices.push("the image has no scale: samples are 1 apart along each axis".to_owned());
    }
    let steps: [f64; 3] = std::array::from_fn(|axis| level.scale[space[axis]] * factors[axis]);
    let origin: [f64; 3] = std::array::from_fn(|axis| level.translation[space[axis]] * factors[axis]);
    let mut direction = Geometry::IDENTITY;
    for (axis, step) in steps.into_iter().enumerate().filter(|(_, step)| *step < 0.0) {
        direction[axis][axis] = -1.0;
        let name = &axes[space[axis]].name;
        notices.push(format!(
            "the scale {step} along {name:?} is negative: positions decrease along it"
        ));
    }
    let placed = header::geometry(shown, &FIELDS, layout.dims, steps.map(f64::abs), origin, direction)?;
    Ok(Geometry { unit, ..placed })
}

/// Returns the names of the channels: those of `omero` if every channel has one of its own, else numbers.
fn channel_names(store: &Store, path: &str, count: u32, labels: &[String]) -> Vec<String> {
    let distinct = (1..labels.len()).all(|i| !labels[..i].contains(&labels[i]));
    if labels.len() == count as usize && distinct && labels.iter().all(|label| !label.is_empty()) {
        return labels.to_vec();
    }
    // The name of a level is a number: use the name of its image.
    let own = path
        .rsplit('/')
        .find(|word| !word.is_empty() && word.parse::<u32>().is_err());
    let stem = crate::location::stem(store.shown());
    let name = own.unwrap_or(stem.strip_suffix(".ome").unwrap_or(&stem));
    match header::Channels::numbered(name, count) {
        header::Channels::Fields(names) => names,
        header::Channels::Luminance => Vec::new(),
    }
}
