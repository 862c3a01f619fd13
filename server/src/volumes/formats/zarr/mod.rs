//! Zarr, versions 2 and 3 (<https://zarr-specs.readthedocs.io>), and OME-Zarr (<https://ngff.openmicroscopy.org>), its
//! images of several resolutions: a folder that ends in `.zarr`, or has `zarr.json`, `.zarray`, `.zgroup` or `.zattrs`; or the address
//! of a store over a network.
//!
//! - A multiscale image: its finest level of at most 2^31 samples. Axes t and c are time steps and fields, named by
//!   `omero`; spacing and origin are what the scales and translations say. `x.zarr:1` names another level,
//!   `x.zarr:labels/NAME` an image of labels.
//! - An array: axes are `z, y, x` or `t, z, y, x`, or as its names of dimensions say; positions are those of `coordinates`.
//! - A group of arrays of one shape: each is a field. `x.zarr:NAME` names one of several.
//!
//! A chunk that is not stored has the fill value. Links are followed below the folder only. `codecs` lists what chunks
//! may be packed with.

mod blosc;
mod codecs;
mod coordinates;
mod metadata;
mod ome;
mod samples;

use std::path::Path;
use std::sync::Arc;

use serde_json::Value;

use super::FolderVolume;
use super::header::{self, GridFields, MAX_CHANNELS, not_3d};
use super::store::{self, Store};
use super::variables::axes::{self, Layout};
use super::variables::values::Values;
use crate::volumes::open::title_of;
use crate::volumes::{Field, FileLocation, Geometry, LengthUnit, Notices, OpenedFile, ReadError, TimeAxis};
use coordinates::Variables;
use metadata::{Array, Node, node};
use ome::{Axis, Level};
use samples::{Axes, ZarrSamples};

const FIELDS: GridFields = GridFields {
    dims: "shape",
    spacing: "scale",
    origin: "translation",
    direction: "axes",
};

/// Maximum arrays of a group that are opened together.
const MAX_ARRAYS: usize = 64;

/// Maximum samples of a level that is chosen without being named.
const MAX_LEVEL_SAMPLES: u64 = 1 << 31;

/// Whether a folder is a Zarr array or group.
pub fn holds(folder: &Path) -> bool {
    let ends = folder.extension().is_some_and(|e| e.eq_ignore_ascii_case("zarr"));
    let names = ["zarr.json", ".zarray", ".zgroup", ".zattrs"];
    folder.is_dir() && (ends || names.iter().any(|name| folder.join(name).is_file()))
}

/// Reads the metadata of a Zarr folder.
///
/// # Errors
/// What is wrong with it, by field; several arrays or images, none of them named.
pub fn open(location: &FileLocation) -> Result<Vec<FolderVolume>, ReadError> {
    let store = Arc::new(Store::open(location, "zarr")?);
    let part = location.part().unwrap_or_default().trim_matches('/').to_owned();
    let file = match node(&store, &part)? {
        None => Err(store.error(&part, store.nothing_there())),
        Some(Node::Array(array)) => open_array(&store, &part, *array),
        Some(Node::Group(attributes)) => open_group(&store, &part, &attributes),
    }?;
    let mut title = match location.address() {
        // A folder's name, as of one on disk.
        Some(address) => address.shown().rsplit('/').next().unwrap_or_default().to_owned(),
        None => title_of(location.path()),
    };
    for extension in [".zarr", ".ome"] {
        title = title.strip_suffix(extension).unwrap_or(&title).to_owned();
    }
    if !part.is_empty() {
        title = format!("{title} {part}");
    }
    Ok(vec![FolderVolume { title, file }])
}

/// An array that was named: perhaps a level of an image above it.
fn open_array(store: &Arc<Store>, path: &str, array: Array) -> Result<OpenedFile, ReadError> {
    for (at, _) in path.match_indices('/').chain((!path.is_empty()).then_some((0, ""))) {
        let (group, level) = (&path[..at], path[at..].trim_start_matches('/'));
        if let Some(Node::Group(attributes)) = node(store, group)?
            && let Some(image) = ome::image(store, group, &attributes)?
            && let Some(found) = image.levels.iter().find(|other| other.path == level)
        {
            return open_level(store, path, array, &image.axes, found, &image.channels);
        }
    }
    let variables = Variables::beside(store, path);
    let variable = variables.describe(path, &array);
    let scales = axes::scales(&variables, &variable);
    let is_time = |axis: usize| scales[axis].as_ref().is_some_and(axes::is_time);
    let roles = if array.has_own_names() {
        let layout = Layout::of(&variable, is_time).map_err(|why| not_3d(&store.path(path), "shape", why))?;
        Axes::of_layout(&layout)
    } else {
        Axes::of(store, path, &array.named_axes(), &array)?
    };
    let shown = store.path(path);
    let placed = axes::place_grid(&shown, &variables, &variable, &scales, roles.space, roles.dims)?;
    let steps = u64::from(roles.steps);
    let times = roles
        .time
        .and_then(|axis| axes::times(&variables, scales[axis].as_ref()?, steps));
    let file = open_samples(store, path, array, roles, placed.geometry, &[])?;
    placed.finish(&shown, OpenedFile { times, ..file })
}

/// A group: an image, or arrays side by side.
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
        let axes = Axes::of(store, &whole, &image.axes, &array)?;
        let samples = axes.dims.iter().map(|&n| u64::from(n)).product::<u64>();
        if samples > MAX_LEVEL_SAMPLES {
            too_large.push(format!("{whole} has {samples} samples"));
            continue;
        }
        if image.levels.len() > 1 {
            let path = store.shown().display();
            tracing::info!(%path, "level {} is opened: the finest of 2^31 samples at most", level.path);
        }
        return open_level(store, &whole, *array, &image.axes, level, &image.channels);
    }
    let why = format!(
        "{}; expected 2^31 at most, or a level that is named",
        too_large.join(", ")
    );
    Err(store.error(path, why))
}

/// Arrays of one shape are fields; with several shapes one must be named.
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
    // There is a first one.
    let mut file = files.next().unwrap_or_else(|| Err(store.error(path, "no array")))?;
    for other in files {
        let other = other?;
        if (other.geometry, other.steps) != (file.geometry, file.steps) {
            return Err(store.error(path, "arrays of several grids, expected one, or the name of an array"));
        }
        file.fields.extend(other.fields);
    }
    Ok(file)
}

/// One array with what is known of its axes.
fn open_level(
    store: &Arc<Store>,
    path: &str,
    array: Array,
    axes: &[Axis],
    level: &Level,
    channels: &[String],
) -> Result<OpenedFile, ReadError> {
    let roles = Axes::of(store, path, axes, &array)?;
    let geometry = geometry(&store.path(path), axes, &roles, level)?;
    let times = roles.time.filter(|_| roles.steps > 1).and_then(|axis| {
        let unit = axes[axis].time_unit.as_deref()?;
        TimeAxis::even(level.translation[axis], level.scale[axis], roles.steps, unit)
    });
    let file = open_samples(store, path, array, roles, geometry, channels)?;
    Ok(OpenedFile { times, ..file })
}

/// The fields of an array.
fn open_samples(
    store: &Arc<Store>,
    path: &str,
    array: Array,
    roles: Axes,
    geometry: Geometry,
    channels: &[String],
) -> Result<OpenedFile, ReadError> {
    let shown = store.path(path);
    if u64::from(roles.channels) > MAX_CHANNELS {
        return Err(not_3d(&shown, "shape", format!("{} channels", roles.channels)));
    }
    let (steps, count) = (roles.steps, roles.channels);
    let type_name = array.type_name.clone();
    let variable = Variables::beside(store, path).describe(path, &array);
    let values = Values::of(&variable, array.stored).map_err(|why| ReadError::new(&shown, "attributes", why))?;
    let unit = variable.text("units").filter(|&unit| unit != "1");
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
            source: Arc::new(samples),
        }
    };
    let fields = (0..)
        .zip(channel_names(store, path, count, channels))
        .map(field)
        .collect();
    Ok(OpenedFile {
        geometry,
        steps,
        uneven: None,
        times: None,
        fields,
        notices: Notices::default(),
    })
}

/// The grid of a level. Lengths are in the unit of x.
fn geometry(shown: &Path, axes: &[Axis], roles: &Axes, level: &Level) -> Result<Geometry, ReadError> {
    let units = roles.space.map(|axis| axes[axis].unit);
    let factor = |axis: usize| {
        let metres = |unit: Option<LengthUnit>| unit.and_then(LengthUnit::metres);
        match (metres(units[axis]), metres(units[0])) {
            (Some(own), Some(first)) if units[axis] != units[0] => own / first,
            _ => 1.0,
        }
    };
    let spacing: [f64; 3] = std::array::from_fn(|axis| level.scale[roles.space[axis]] * factor(axis));
    let origin: [f64; 3] = std::array::from_fn(|axis| level.translation[roles.space[axis]] * factor(axis));
    let placed = header::geometry(shown, &FIELDS, roles.dims, spacing, origin, Geometry::IDENTITY)?;
    Ok(Geometry {
        unit: units[0].filter(|_| units.iter().all(Option::is_some)),
        ..placed
    })
}

/// Names of the channels: those of `omero` where they differ, else numbers.
fn channel_names(store: &Store, path: &str, count: u32, labels: &[String]) -> Vec<String> {
    let distinct = (1..labels.len()).all(|i| !labels[..i].contains(&labels[i]));
    if labels.len() == count as usize && distinct && labels.iter().all(|label| !label.is_empty()) {
        return labels.to_vec();
    }
    // Of a level, whose name is a number, the name of its image.
    let own = path
        .rsplit('/')
        .find(|word| !word.is_empty() && word.parse::<u32>().is_err());
    let stem = crate::volumes::location::stem(store.shown());
    let name = own.unwrap_or(stem.strip_suffix(".ome").unwrap_or(&stem));
    match header::Channels::numbered(name, count) {
        header::Channels::Fields(names) => names,
        header::Channels::Luminance => Vec::new(),
    }
}
