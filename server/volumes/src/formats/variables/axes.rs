//! Axes of a variable by the conventions of CF: which are space, which is time, and the times of the steps.

use std::path::Path;

use super::super::super::{ReadError, TimeAxis};
use super::super::named_axes::{self, AxisFacts, AxisRoles, Role};
use super::file::{Variable, VariableFile};
use super::layout::Layout;
use super::place::{Placed, place_grid};
use super::scale::{MAX_POSITIONS, last_name};

/// Assigns roles to the axes of a variable; `scales` are the variables with the positions along them.
pub fn roles(variable: &Variable, scales: &[Option<Variable>]) -> Result<AxisRoles, String> {
    let facts = variable.axes.iter().zip(scales).map(|(axis, scale)| {
        let text = |name: &str| scale.as_ref().and_then(|scale| scale.text(name));
        let dimension = axis.dimension.as_deref().map(last_name);
        let stated = text("axis").and_then(named_axes::role_of_cf_axis);
        let stated = stated.or_else(|| text("_CoordinateAxisType").and_then(role_of_coordinate_type));
        AxisFacts {
            size: axis.size,
            name: axis.label.name.as_deref().or(dimension),
            stated: axis.label.role.or(stated),
            standard_name: text("standard_name"),
            units: text("units"),
            positive: text("positive"),
        }
    });
    let facts: Vec<AxisFacts<'_>> = facts.collect();
    named_axes::assign(&facts)
}

/// Returns the role for a value of the attribute `_CoordinateAxisType`, which Unidata's libraries write.
fn role_of_coordinate_type(text: &str) -> Option<Role> {
    Some(match text {
        "Lon" | "GeoX" => Role::X,
        "Lat" | "GeoY" => Role::Y,
        "Height" | "Pressure" | "GeoZ" => Role::Z,
        "Time" | "RunTime" => Role::Time,
        "Ensemble" => Role::Channel,
        _ => return None,
    })
}

/// Layout, positions and times of a variable's samples.
pub struct Grid {
    pub layout: Layout,
    pub placed: Placed,
    pub times: Option<TimeAxis>,
}

/// Returns the variables with the positions along the axes of a variable.
pub fn scales(file: &dyn VariableFile, variable: &Variable) -> Vec<Option<Variable>> {
    let axes = variable.axes.iter();
    axes.map(|axis| axis.scale.as_ref().and_then(|scale| file.variable(scale).ok()))
        .collect()
}

/// Reads the positions along the axes of a variable.
pub fn grid(path: &Path, file: &dyn VariableFile, variable: &Variable) -> Result<Grid, ReadError> {
    let fail = |why: String| ReadError::new(path, &variable.path, why);
    let scales = scales(file, variable);
    let roles = roles(variable, &scales).map_err(fail)?;
    let layout = Layout::new(variable.sizes(), &roles).map_err(fail)?;
    let times = layout
        .time
        .and_then(|axis| times(file, scales[axis].as_ref()?, variable.axes[axis].size));
    let mut placed = place_grid(path, file, variable, &scales, layout.axes, layout.dims)?;
    placed.notices.splice(0..0, roles.notices);
    Ok(Grid { layout, placed, times })
}

/// Returns the times of the steps, if the positions along their axis are times.
pub fn times(file: &dyn VariableFile, scale: &Variable, steps: u64) -> Option<TimeAxis> {
    let read = file
        .read_line(scale, MAX_POSITIONS)
        .and_then(|values| match values.len() as u64 {
            n if n == steps => Ok(values),
            n => Err(format!("{n} of {steps}")),
        });
    let values = match read {
        Ok(values) => values,
        Err(why) => {
            tracing::warn!(
                variable = scale.path,
                "steps are counted, as their times cannot be read: {why}"
            );
            return None;
        }
    };
    let [factor, offset] = scale.packing();
    let values = values.into_iter().map(|value| value * factor + offset).collect();
    TimeAxis::listed(values, scale.text("units").unwrap_or_default(), scale.text("calendar"))
}
