//! HDF5 and NetCDF: files of named variables.
//!
//! A location names one (`file.h5:/group/name`, `file.nc:name`). Else the largest variable that can be a volume is opened, with all
//! others on its grid as fields. The last axis is x, as stored; of four axes one is time. Positions and units are those of CF's
//! coordinate variables, which are HDF5's dimension scales; missing values, scale and offset those of NetCDF.
//!
//! - [`file`]: variables; the two kinds of files: [`hdf5`], [`netcdf3`]; [`reader`] knows which.
//! - [`axes`]: grid, positions and time; [`values`]: what samples mean; [`source`] reads them.

pub(super) mod axes;
pub(super) mod file;
mod hdf5;
mod lzf;
mod netcdf3;
mod reader;
mod source;
pub(super) mod values;

use std::sync::Arc;

use axes::{Grid, Layout};
use file::{Variable, VariableFile};
use reader::open_file;
use source::VariableSource;
use values::Values;

use super::super::stored::{Begin, StoredSamples};
use super::super::{Field, FileLocation, Geometry, Notices, OpenedFile, ReadError, Source};

/// Variables that a message lists at most.
const MAX_LISTED: usize = 20;

/// Reads the headers of a file's variables.
///
/// # Errors
/// What is wrong with it, or which variables it has where none can be a volume.
pub fn open(location: &FileLocation) -> Result<OpenedFile, ReadError> {
    let file = open_file(location)?;
    let variables = file.variables();
    let chosen = match location.part() {
        Some(part) => vec![named(location, file.as_ref(), &variables, part)?],
        None => on_one_grid(location, variables)?,
    };
    let Grid { layout, placed, times } = axes::grid(location.path(), file.as_ref(), &chosen[0])?;
    let names = field_names(&chosen);
    let fields = chosen
        .into_iter()
        .zip(names)
        .map(|(variable, name)| field(location, name, variable, &placed.geometry, &layout));
    let file = OpenedFile {
        geometry: placed.geometry,
        steps: layout.steps,
        uneven: None,
        times,
        fields: fields.collect::<Result<_, _>>()?,
        notices: Notices::default(),
    };
    placed.finish(location.path(), file)
}

/// Makes a field of a variable.
fn field(
    location: &FileLocation,
    name: String,
    variable: Variable,
    geometry: &Geometry,
    layout: &Layout,
) -> Result<Field, ReadError> {
    let fail = |why: String| ReadError::new(location.path(), &variable.path, why);
    let stored = variable.stored.clone().map_err(fail)?;
    let values = Values::of(&variable, stored).map_err(fail)?;
    let missing = values.missing();
    let unit = variable.text("units").filter(|&unit| unit != "1").map(str::to_owned);
    let plain = variable.plain.filter(|_| layout.is_in_order() && !values.needs_nan());
    let (sample_type, source): (_, Arc<dyn Source>) = if let Some((begin, endian)) = plain {
        let samples = StoredSamples::new(
            location,
            Begin::At(begin),
            values.stored,
            geometry,
            layout.steps,
            &variable.path,
        )?;
        // Something else may follow in the file. No end is a wrong one, which the check refuses.
        let bytes = samples.total_samples().checked_mul(values.stored.bytes());
        let samples = StoredSamples {
            end: bytes.and_then(|bytes| begin.checked_add(bytes)).or(Some(u64::MAX)),
            endian,
            scale: values.scale,
            ..samples
        };
        samples.check(&variable.path)?;
        (samples.sample_type(), Arc::new(samples))
    } else {
        let source = VariableSource {
            location: location.clone(),
            file_bytes: location.open()?.len(),
            layout: layout.clone(),
            values,
            variable,
        };
        (source.sample_type(), Arc::new(source))
    };
    Ok(Field {
        name,
        stored_type: stored.name().to_owned(),
        sample_type,
        missing,
        unit,
        labels: Vec::new(),
        source,
    })
}

/// The variable that a location names.
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
        // Its group may be one that cannot be listed.
        None => file
            .variable(&path)
            .map_err(|why| fail(format!("{why}, expected one of {}", list(all))))?,
    };
    match &variable.stored {
        Ok(_) => Ok(variable),
        Err(why) => Err(fail(why.clone())),
    }
}

/// The largest variable that can be a volume, and all others on its grid.
fn on_one_grid(location: &FileLocation, all: Vec<Variable>) -> Result<Vec<Variable>, ReadError> {
    let size = |variable: &Variable| variable.axes.iter().fold(1u64, |n, axis| n.saturating_mul(axis.size));
    let is_volume = |variable: &&Variable| {
        let layout = || Layout::of(variable, |_| false);
        variable.stored.is_ok() && !variable.is_scale && size(variable) > 0 && layout().is_ok()
    };
    // The first one of the largest.
    let Some(main) = all.iter().rev().filter(is_volume).max_by_key(|variable| size(variable)) else {
        let why = format!(
            "no variable is a volume, expected one with 3 axes longer than 1, or 4 with time; found {}",
            list(&all)
        );
        return Err(ReadError::new(location.path(), "variables", why));
    };
    let (axes, path) = (main.axes.clone(), main.path.clone());
    let same = |variable: &Variable| is_volume(&variable) && grid_of(variable) == grid_of_axes(&axes);
    let (mut chosen, others): (Vec<Variable>, Vec<Variable>) = all.into_iter().partition(same);
    let others: Vec<Variable> = others.into_iter().filter(|variable| !variable.is_scale).collect();
    if !others.is_empty() {
        tracing::info!(path = %location.path().display(), "not on the grid of {path}: {}", list(&others));
    }
    // The main one first.
    chosen.sort_by_key(|variable| variable.path != path);
    Ok(chosen)
}

/// What two variables on one grid share.
fn grid_of(variable: &Variable) -> Vec<(Option<&str>, u64)> {
    grid_of_axes(&variable.axes)
}

fn grid_of_axes(axes: &[file::Axis]) -> Vec<(Option<&str>, u64)> {
    axes.iter().map(|axis| (axis.dimension.as_deref(), axis.size)).collect()
}

/// Last parts of the paths; whole paths where two are equal.
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

/// Variables for a message: path, shape and type, or why it cannot be read.
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
