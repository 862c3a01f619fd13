//! HDF5 and NetCDF: files of named variables.
//!
//! A location names one variable (`file.h5:/group/name`, `file.nc:name`). Otherwise the largest variable that can be a volume is opened,
//! with all others on its grid as fields. Positions, names of dimensions, labels and `axistags` give the roles of its axes
//! ([`named_axes`](super::named_axes)); channels are fields. Positions and units are those of CF's coordinate variables, which are HDF5's
//! dimension scales; missing values, scale and offset are those of NetCDF.
//!
//! - [`file`]: variables; the two kinds of files: [`hdf5`], [`netcdf3`]; [`reader`] detects the kind.
//! - [`kinds`]: HDF5 files whose groups follow a convention for the positions of samples.
//! - [`fields`]: makes fields of a variable.
//! - [`axes`]: roles of axes, and times; [`layout`]: the axes of the volume; [`place`]: positions; [`values`]: meaning of samples; [`source`] reads them.

pub(super) mod axes;
mod bitshuffle;
mod fields;
pub(super) mod file;
mod filters;
mod hdf5;
mod hdf5_attributes;
mod hdf5_types;
mod kinds;
mod labels;
pub(super) mod layout;
mod long_float;
mod lzf;
mod netcdf3;
mod nexus;
pub(super) mod place;
mod reader;
mod scale;
mod source;
pub(super) mod values;

use std::collections::HashMap;

use axes::Grid;
use fields::fields_of;
use file::{Variable, VariableFile};
use reader::open_file;

use super::super::{FileLocation, Notices, OpenedFile, ReadError};
use super::header;
use super::spim_data::SpimData;

/// Maximum variables that a message lists.
const MAX_LISTED: usize = 20;

/// Reads the headers of a file's variables.
///
/// # Errors
/// What is wrong with the file; the list of its variables if none of them can be a volume.
pub fn open(location: &FileLocation) -> Result<OpenedFile, ReadError> {
    let file = open_file(location)?;
    if let Some(opened) = kinds::open(location, file.as_ref()) {
        return opened;
    }
    let mut variables = file.variables();
    nexus::find_axes(file.as_ref(), &mut variables);
    let chosen = match location.part() {
        Some(part) => vec![named(location, file.as_ref(), &variables, part)?],
        None => on_one_grid(location, variables)?,
    };
    let Grid { layout, placed, times } = axes::grid(location.path(), file.as_ref(), &chosen[0])?;
    let names = field_names(&chosen);
    let mut notices = Vec::new();
    let mut fields = Vec::new();
    for (variable, name) in chosen.into_iter().zip(names) {
        notices.extend(variable.notices().into_iter().map(|why| format!("{name}: {why}")));
        let channels = header::Channels::numbered(&name, layout.channels);
        fields.extend(fields_of(location, channels, &variable, &placed.geometry, &layout)?);
    }
    let file = OpenedFile {
        geometry: placed.geometry,
        steps: layout.steps,
        uneven: None,
        axes: None,
        times,
        fields,
        notices: Notices::default(),
    };
    Ok(header::with_notices(placed.finish(location.path(), file)?, notices))
}

/// Opens a view of BigDataViewer, with the description in `data`.
///
/// # Errors
/// What is wrong with the file, or the list of views if one must be named.
pub(super) fn open_views(location: &FileLocation, data: &SpimData) -> Result<OpenedFile, ReadError> {
    kinds::open_views(location, open_file(location)?.as_ref(), data)
}

/// Returns the variable that a location names.
fn named(
    location: &FileLocation,
    file: &dyn VariableFile,
    all: &[Variable],
    part: &str,
) -> Result<Variable, ReadError> {
    let path = format!("/{}", part.trim_start_matches('/'));
    let fail = |why: String| ReadError::new(location.path(), &path, why);
    let variable = match all.iter().find(|variable| variable.path == path) {
        Some(variable) => variable.clone(),
        // It may be in a group that cannot be listed.
        None => file
            .variable(&path)
            .map_err(|why| fail(format!("{why}, expected one of {}", list(all))))?,
    };
    match &variable.stored {
        Ok(_) => Ok(variable),
        Err(why) => Err(fail(why.clone())),
    }
}

/// Returns the largest variable that can be a volume, and all others on its grid. A variable whose third axis is time is chosen only if
/// there is no other.
fn on_one_grid(location: &FileLocation, all: Vec<Variable>) -> Result<Vec<Variable>, ReadError> {
    let size = |variable: &Variable| variable.axes.iter().fold(1u64, |n, axis| n.saturating_mul(axis.size));
    let by_path: HashMap<&str, &Variable> = all.iter().map(|variable| (variable.path.as_str(), variable)).collect();
    let rank = |variable: &Variable| {
        let scale = |axis: &file::Axis| {
            axis.scale
                .as_deref()
                .and_then(|path| by_path.get(path).copied().cloned())
        };
        let scales: Vec<Option<Variable>> = variable.axes.iter().map(scale).collect();
        let is_read = variable.stored.is_ok() && !variable.is_scale && size(variable) > 0;
        let roles = axes::roles(variable, &scales).ok().filter(|_| is_read)?;
        Some((!roles.has_time_in_space, size(variable)))
    };
    let ranks: Vec<Option<(bool, u64)>> = all.iter().map(rank).collect();
    let best = ranks.iter().flatten().max().copied();
    // The first of equally good ones.
    let main = best.and_then(|best| ranks.iter().position(|rank| *rank == Some(best)));
    let Some(main) = main.map(|at| &all[at]) else {
        let why = format!(
            "no variable is a volume, expected one with 3 axes longer than 1, or 4 with time or channels; found {}",
            list(&all)
        );
        return Err(ReadError::new(location.path(), "variables", why));
    };
    let (axes, path) = (main.axes.clone(), main.path.clone());
    let (mut chosen, mut others) = (Vec::new(), Vec::new());
    for (variable, rank) in all.into_iter().zip(ranks) {
        if rank.is_some() && is_on_grid(&variable, &axes) {
            chosen.push(variable);
        } else if !variable.is_scale {
            others.push(variable);
        }
    }
    if !others.is_empty() {
        tracing::info!(path = %location.path().display(), "not on the grid of {path}: {}", list(&others));
    }
    // The largest one first.
    chosen.sort_by_key(|variable| variable.path != path);
    Ok(chosen)
}

/// Whether a variable has the same axes.
fn is_on_grid(variable: &Variable, axes: &[file::Axis]) -> bool {
    let is_same =
        |(a, b): (&file::Axis, &file::Axis)| (&a.dimension, a.size, &a.label) == (&b.dimension, b.size, &b.label);
    variable.axes.len() == axes.len() && variable.axes.iter().zip(axes).all(is_same)
}

/// Names the fields by the last parts of the paths; by whole paths if two last parts are equal.
fn field_names(variables: &[Variable]) -> Vec<String> {
    let last = |variable: &Variable| variable.path.rsplit('/').next().unwrap_or_default().to_owned();
    let names: Vec<String> = variables.iter().map(last).collect();
    let name = |(variable, name): (&Variable, &String)| {
        let is_unique = names.iter().filter(|other| *other == name).count() == 1;
        if is_unique {
            name.clone()
        } else {
            variable.path.trim_start_matches('/').to_owned()
        }
    };
    variables.iter().zip(&names).map(name).collect()
}

/// Lists variables for a message: path, shape and type, or why a variable cannot be read.
fn list(variables: &[Variable]) -> String {
    let describe = |variable: &Variable| match &variable.stored {
        Ok(stored) => format!("{} ({} {})", variable.path, variable.shape(), stored.name()),
        Err(why) => format!("{} ({why})", variable.path),
    };
    let mut listed: Vec<String> = variables.iter().take(MAX_LISTED).map(describe).collect();
    if variables.len() > MAX_LISTED {
        listed.push(format!("{} more", variables.len() - MAX_LISTED));
    }
    if listed.is_empty() {
        "none".into()
    } else {
        listed.join(", ")
    }
}
