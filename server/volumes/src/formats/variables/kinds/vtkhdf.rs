//! VTKHDF, VTK's format in HDF5 (<https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/index.html>): `ImageData`, with time.
//!
//! Arrays of point data are fields, their last axis has components; without point data those of cells, at the cells' centres. Arrays of a
//! file with `Steps` have time as their first axis, and `PointDataOffsets` gives the index of each step along it.

use std::sync::Arc;

use super::{Array, ChosenSteps, MAX_STEPS, World, roles_in_order, volume};
use crate::formats::header::{self, GridFields};
use crate::formats::variables::file::{Variable, VariableFile};
use crate::formats::vtk;
use crate::{FileLocation, OpenedFile, ReadError, TimeAxis};

const ROOT: &str = "/VTKHDF";

const FIELDS: GridFields = GridFields {
    dims: "WholeExtent",
    spacing: "Spacing",
    origin: "Origin",
    direction: "Direction",
};

pub(super) fn open(location: &FileLocation, file: &dyn VariableFile) -> Result<OpenedFile, ReadError> {
    let fail = |field: &str, why: String| ReadError::new(location.path(), field, why);
    let attributes = file.attributes_of(ROOT);
    match attributes.text("Type") {
        Some("ImageData") => {}
        other => {
            let why = format!(
                "{:?}, expected ImageData: other data sets are no grids of samples",
                other.unwrap_or("none")
            );
            return Err(fail("Type", why));
        }
    }
    let extent: [f64; 6] = attributes
        .array("WholeExtent")
        .ok_or_else(|| fail("WholeExtent", "missing, expected 6 whole numbers".to_owned()))?;
    let points = points(&extent).ok_or_else(|| {
        fail(
            "WholeExtent",
            format!("{extent:?}, expected first and last index along x, y and z"),
        )
    })?;
    let mut world = world(&attributes, &extent);
    let steps = steps(location, file)?;
    let (mut arrays, mut left_out) = arrays(location, file, "PointData", points, steps.is_some())?;
    let mut section = "PointData";
    if arrays.is_empty() {
        section = "CellData";
        let (of_cells, others) = self::arrays(
            location,
            file,
            section,
            points.map(|n| n.saturating_sub(1)),
            steps.is_some(),
        )?;
        left_out.extend(others);
        left_out.push(vtk::CELL_DATA.to_owned());
        arrays = of_cells;
        for axis in 0..3 {
            for row in 0..3 {
                world.origin[row] += 0.5 * world.spacing[axis] * world.direction[axis][row];
            }
        }
    }
    let has_ghosts = |section: &str| file.variable(&format!("{ROOT}/{section}/vtkGhostType")).is_ok();
    if has_ghosts("PointData") || has_ghosts("CellData") {
        left_out.push(vtk::UNUSED_GHOSTS.to_owned());
    }
    if arrays.is_empty() && !left_out.is_empty() {
        let why = format!("none is on the grid, expected one at least: {}", left_out.join("; "));
        return Err(fail("PointData", why));
    }
    let mut opened = volume(location, &arrays, &world, &FIELDS)?;
    if let Some(steps) = steps {
        let mut fields = opened.fields.into_iter();
        let mut chosen = Vec::new();
        for array in &arrays {
            let offsets = offsets(location, file, section, array, steps.count)?;
            for mut field in fields.by_ref().take(array.layout.channels as usize) {
                field.source = Arc::new(ChosenSteps {
                    source: field.source,
                    steps: offsets.clone(),
                });
                chosen.push(field);
            }
        }
        opened.fields = chosen;
        opened.steps = steps.count;
        opened.times = steps.times;
    }
    Ok(header::with_notices(opened, left_out))
}

/// Returns the samples along x, y and z of an extent.
fn points(extent: &[f64; 6]) -> Option<[u64; 3]> {
    let count = |axis: usize| {
        let count = extent[2 * axis + 1] - extent[2 * axis] + 1.0;
        (count >= 1.0 && count.fract() == 0.0 && count < 4e9).then_some(count as u64)
    };
    Some([count(0)?, count(1)?, count(2)?])
}

fn world(attributes: &crate::formats::variables::file::Attributes, extent: &[f64; 6]) -> World {
    let direction = attributes
        .array::<9>("Direction")
        .unwrap_or([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    let columns = std::array::from_fn(|axis| std::array::from_fn(|row| direction[3 * row + axis]));
    let (lengths, direction) = header::split_axes(columns);
    let own: [f64; 3] = attributes.array("Spacing").unwrap_or([1.0; 3]);
    let spacing: [f64; 3] = std::array::from_fn(|axis| own[axis] * lengths[axis]);
    let mut origin: [f64; 3] = attributes.array("Origin").unwrap_or([0.0; 3]);
    for axis in 0..3 {
        for row in 0..3 {
            origin[row] += extent[2 * axis] * spacing[axis] * direction[axis][row];
        }
    }
    World {
        spacing,
        origin,
        direction,
    }
}

/// Returns the arrays of a section that are on the grid, the active scalars first, and notices of the others.
fn arrays(
    location: &FileLocation,
    file: &dyn VariableFile,
    section: &str,
    dims: [u64; 3],
    has_time: bool,
) -> Result<(Vec<Array>, Vec<String>), ReadError> {
    let group = format!("{ROOT}/{section}");
    let [_, mut names] = file.members(&group);
    names.retain(|name| !name.starts_with("vtkGhost"));
    let active = file.attributes_of(&group).text("Scalars").map(str::to_owned);
    names.sort_by_key(|name| Some(name) != active.as_ref());
    let (mut found, mut left_out) = (Vec::new(), Vec::new());
    let first = usize::from(has_time);
    for name in names {
        let Ok(variable) = file.variable(&format!("{group}/{name}")) else {
            continue;
        };
        let sizes = variable.sizes();
        let is_on_grid = sizes.get(first..first + 3) == Some(&[dims[2], dims[1], dims[0]]) && sizes.len() <= first + 4;
        if let (Ok(_), true) = (&variable.stored, is_on_grid) {
            let roles = roles_in_order(has_time, sizes.len() == first + 4);
            found.push(Array::new(location, variable, &roles)?);
        } else {
            let why = variable
                .stored
                .err()
                .unwrap_or_else(|| format!("{sizes:?} samples, the grid has {dims:?} along x, y, z"));
            left_out.push(format!("{name} of {section} was left out: {why}"));
        }
    }
    Ok((found, left_out))
}

struct Steps {
    count: u32,
    times: Option<TimeAxis>,
}

/// Returns the steps of a file with time; `None` for a file without.
fn steps(location: &FileLocation, file: &dyn VariableFile) -> Result<Option<Steps>, ReadError> {
    let attributes = file.attributes_of("/VTKHDF/Steps");
    let Some(&count) = attributes.numbers("NSteps").first() else {
        return Ok(None);
    };
    if !(count >= 1.0 && count <= MAX_STEPS as f64 && count.fract() == 0.0) {
        let why = format!("{count}, expected 1 to {MAX_STEPS}");
        return Err(ReadError::new(location.path(), "NSteps", why));
    }
    let values = file.variable("/VTKHDF/Steps/Values");
    let values = values.and_then(|values| file.read_line(&values, MAX_STEPS as u64)).ok();
    let count = count as u32;
    Ok(Some(Steps {
        count,
        times: values
            .filter(|values| values.len() == count as usize && count > 1)
            .and_then(|values| TimeAxis::listed(values, "", None)),
    }))
}

/// Returns the index of each step along the first axis of an array.
fn offsets(
    location: &FileLocation,
    file: &dyn VariableFile,
    section: &str,
    array: &Array,
    count: u32,
) -> Result<Vec<u32>, ReadError> {
    let Variable { path, .. } = &array.variable;
    let name = path.rsplit('/').next().unwrap_or_default();
    let stated = file.variable(&format!("{ROOT}/Steps/{section}Offsets/{name}"));
    let stated = stated
        .and_then(|offsets| file.read_line(&offsets, MAX_STEPS as u64))
        .ok();
    let offsets = match stated {
        Some(offsets) if offsets.len() == count as usize => offsets,
        Some(offsets) => {
            let why = format!("{} offsets, expected {count}", offsets.len());
            return Err(ReadError::new(location.path(), path, why));
        }
        None => (0..count).map(f64::from).collect(),
    };
    let have = f64::from(array.layout.steps);
    match offsets.iter().find(|at| !(**at >= 0.0 && **at < have)) {
        Some(at) => Err(ReadError::new(
            location.path(),
            path,
            format!("a step at {at}, the array has {have}"),
        )),
        None => Ok(offsets.into_iter().map(|at| at as u32).collect()),
    }
}
