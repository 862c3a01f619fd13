//! BigDataViewer in HDF5 (<https://imagej.net/plugins/bdv>): views (setups), time points and levels of resolution are groups. The XML
//! beside the file gives the position of a view in the world.
//!
//! The finest level is opened. If there are several views, the location names one: `file.h5:0`, or by the name in the XML. Samples of 16
//! bits are unsigned, though their type is signed.

use std::collections::BTreeSet;

use super::{Array, MAX_STEPS, World, numbered, roles_in_order, volume};
use crate::formats::header::{self, Channels, GridFields};
use crate::formats::spim_data::{self, SpimData, ViewGrid};
use crate::formats::variables::file::{Attribute, VariableFile};
use crate::numbered::join_steps;
use crate::stored::StoredType;
use crate::{FileLocation, OpenedFile, ReadError};

const FIELDS: GridFields = GridFields {
    dims: "cells",
    spacing: "affine",
    origin: "affine",
    direction: "affine",
};

pub(super) fn open(location: &FileLocation, file: &dyn VariableFile) -> Result<OpenedFile, ReadError> {
    let beside = spim_data::beside(location);
    let notice = beside.is_none().then(|| {
        format!(
            "there is no {}.xml beside the file, which says where the view is",
            location.stem()
        )
    });
    let opened = open_described(location, file, &beside.unwrap_or_default())?;
    Ok(header::with_notices(opened, notice))
}

/// Opens the view that the location names.
pub(super) fn open_described(
    location: &FileLocation,
    file: &dyn VariableFile,
    data: &SpimData,
) -> Result<OpenedFile, ReadError> {
    let fail = |field: &str, why: String| ReadError::new(location.path(), field, why);
    let points = numbered(file.members("/")[0].clone(), "t");
    let setups = |point: &str| numbered(file.members(&format!("/{point}"))[0].clone(), "s");
    let found: BTreeSet<u64> = points
        .first()
        .map(|(_, point)| setups(point))
        .unwrap_or_default()
        .into_iter()
        .map(|s| s.0)
        .collect();
    let found: Vec<u64> = found.into_iter().collect();
    let setup = data.choose(location.part(), &found).map_err(|why| fail("setup", why))?;
    if points.len() > MAX_STEPS {
        return Err(fail(
            "timepoint",
            format!("{}, expected {MAX_STEPS} at most", points.len()),
        ));
    }
    let mut files = Vec::new();
    let mut first: Option<ViewGrid> = None;
    let mut notices = Vec::new();
    for (time, point) in &points {
        let Some((_, own)) = setups(point).into_iter().find(|(number, _)| *number == setup) else {
            return Err(fail(
                point,
                format!("setup {setup} is missing, expected it at each time point"),
            ));
        };
        let (own_grid, notice) = data.place(*time, setup, [1.0; 3]);
        let grid = first.get_or_insert_with(|| own_grid.clone());
        if *grid != own_grid {
            notices
                .push("the view moves from one time point to another: it was put where it is at the first".to_owned());
        }
        notices.extend(notice);
        let grid = grid.clone();
        let name = data
            .setups
            .get(&setup)
            .and_then(|setup| setup.name.clone())
            .unwrap_or_else(|| location.stem());
        files.push((
            location.clone(),
            open_view(location, file, &format!("/{point}/{own}/0/cells"), name, &grid)?,
        ));
    }
    if files.is_empty() {
        return Err(fail("timepoint", "none, expected one at least".to_owned()));
    }
    notices.dedup();
    Ok(header::with_notices(join_steps(files, None)?, notices))
}

fn open_view(
    location: &FileLocation,
    file: &dyn VariableFile,
    path: &str,
    name: String,
    grid: &ViewGrid,
) -> Result<OpenedFile, ReadError> {
    let fail = |why: String| ReadError::new(location.path(), path, why);
    let mut variable = file.variable(path).map_err(fail)?;
    if variable.axes.len() != 3 {
        return Err(fail(format!("{} samples, expected 3 axes", variable.shape())));
    }
    if variable.stored == Ok(StoredType::I16) {
        variable.attributes.set("_Unsigned", Attribute::Text("true".to_owned()));
    }
    let array = Array {
        channels: Channels::Fields(vec![name]),
        ..Array::new(location, variable, &roles_in_order(false, false))?
    };
    let ViewGrid {
        spacing,
        origin,
        direction,
        unit,
    } = grid.clone();
    let world = World {
        spacing,
        origin,
        direction,
    };
    let mut opened = volume(location, &[array], &world, &FIELDS)?;
    opened.geometry.unit = unit;
    Ok(opened)
}
