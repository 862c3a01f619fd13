//! Which axes of a variable are space and which is time, and where its samples are, by the conventions of CF.

use std::ops::Range;
use std::path::Path;

use super::super::super::rectilinear::{self, Positions};
use super::super::super::{Geometry, LengthUnit, Notices, OpenedFile, ReadError, TimeAxis};
use super::super::header::{self, GridFields};
use super::file::{Variable, VariableFile};

/// Positions along an axis that are read at most; no volume has so many samples along one.
const MAX_POSITIONS: u64 = 1 << 22;

/// The axes of a variable as those of a volume.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    /// Samples along x, y, z.
    pub dims: [u32; 3],
    /// Time steps, at least 1.
    pub steps: u32,
    /// Which axes of the variable are x, y, z.
    pub axes: [usize; 3],
    /// Which one is time.
    pub time: Option<usize>,
    /// Number of axes of the variable; those that are neither space nor time have length 1.
    pub rank: usize,
}

impl Layout {
    /// The last of the axes longer than 1 is x. Of four one is time: that of time's positions, else the first.
    pub fn of(variable: &Variable, is_time: impl Fn(usize) -> bool) -> Result<Self, String> {
        let sizes: Vec<u64> = variable.axes.iter().map(|axis| axis.size).collect();
        let long: Vec<usize> = (0..sizes.len()).filter(|&i| sizes[i] != 1).collect();
        let (time, space) = match long.as_slice() {
            &[z, y, x] => (None, [x, y, z]),
            four @ &[first, ..] if four.len() == 4 => {
                let time = four.iter().copied().find(|&i| is_time(i)).unwrap_or(first);
                let rest: Vec<usize> = four.iter().copied().filter(|&i| i != time).collect();
                (Some(time), [rest[2], rest[1], rest[0]])
            }
            _ => {
                let shape = variable.shape();
                return Err(format!(
                    "{shape} samples, expected 3 axes longer than 1, or 4 with time steps"
                ));
            }
        };
        let size = |axis: usize| {
            u32::try_from(sizes[axis])
                .ok()
                .filter(|&n| n > 0)
                .ok_or_else(|| format!("{} samples along an axis, expected 1 to {}", sizes[axis], u32::MAX))
        };
        let [x, y, z] = space;
        Ok(Self {
            dims: [size(x)?, size(y)?, size(z)?],
            steps: time.map_or(Ok(1), size)?,
            axes: space,
            time,
            rank: sizes.len(),
        })
    }

    /// Whether samples in the order in which they are stored are those of the steps, one after the other.
    pub fn is_in_order(&self) -> bool {
        self.time.is_none_or(|time| time < self.axes[2])
    }

    /// The box of whole slices `z` of a step.
    pub fn selection(&self, step: u32, z: Range<u64>) -> Vec<Range<u64>> {
        let mut selection = vec![0..1; self.rank];
        for (axis, size) in self.axes.into_iter().zip(self.dims) {
            selection[axis] = 0..u64::from(size);
        }
        selection[self.axes[2]] = z;
        if let Some(time) = self.time {
            selection[time] = u64::from(step)..u64::from(step) + 1;
        }
        selection
    }
}

/// Where a variable's samples are.
pub struct Grid {
    pub layout: Layout,
    pub placed: Placed,
    pub times: Option<TimeAxis>,
}

/// A grid, and what it does not say of where samples are.
pub struct Placed {
    /// Of the samples as they are stored; uneven ones at their mean distance.
    pub geometry: Geometry,
    pub notices: Notices,
    /// Along x, y and z, where there are all; see [`Placed::finish`].
    positions: Option<[Positions; 3]>,
}

impl Placed {
    /// A file whose samples lie so, on an even grid.
    pub fn finish(self, path: &Path, file: OpenedFile) -> Result<OpenedFile, ReadError> {
        let mut file = file;
        file.notices.extend(self.notices);
        let Some(positions) = &self.positions else {
            return Ok(file);
        };
        rectilinear::on_even_grid(path, file, positions).map_err(|why| ReadError::new(path, "positions", why))
    }
}

/// The variables with the positions along the axes of one.
pub fn scales(file: &dyn VariableFile, variable: &Variable) -> Vec<Option<Variable>> {
    let axes = variable.axes.iter();
    axes.map(|axis| axis.scale.as_ref().and_then(|scale| file.variable(scale).ok()))
        .collect()
}

/// Reads the positions along the axes of a variable.
pub fn grid(path: &Path, file: &dyn VariableFile, variable: &Variable) -> Result<Grid, ReadError> {
    let fail = |why: String| ReadError::new(path, &variable.path, why);
    let scales = scales(file, variable);
    let is_time = |axis: usize| scales[axis].as_ref().is_some_and(is_time);
    let layout = Layout::of(variable, is_time).map_err(fail)?;
    let times = layout
        .time
        .and_then(|axis| times(file, scales[axis].as_ref()?, variable.axes[axis].size));
    let placed = place_grid(path, file, variable, &scales, layout.axes, layout.dims)?;
    Ok(Grid { layout, placed, times })
}

/// Where samples are that have `dims` along the `axes` x, y, z of a variable, by these scales; and what the grid does not say of that.
pub fn place_grid(
    path: &Path,
    file: &dyn VariableFile,
    variable: &Variable,
    scales: &[Option<Variable>],
    axes: [usize; 3],
    dims: [u32; 3],
) -> Result<Placed, ReadError> {
    let spaced = axes.map(|axis| {
        let size = variable.axes[axis].size;
        scales[axis].as_ref().map(|scale| Scale::read(file, scale, size))
    });
    let mut geometry = Geometry::of_index(dims);
    if spaced.iter().all(Option::is_none) {
        // The convention of Fiji and ilastik, in the order of the axes as stored.
        if let &[z, y, x] = variable.numbers("element_size_um") {
            geometry.spacing = [x, y, z];
            geometry.unit = Some(LengthUnit::Micrometre);
        }
        return Ok(Placed {
            geometry: checked(path, geometry)?,
            notices: Notices::default(),
            positions: None,
        });
    }
    let why = match place(geometry, &spaced).and_then(|placed| even_grid(path, placed, &spaced)) {
        Ok(placed) => {
            checked(path, placed.geometry)?;
            return Ok(placed);
        }
        Err(why) => why,
    };
    let notice = format!("positions count samples, as the file's are on no even grid: {why}");
    Ok(Placed {
        geometry: checked(path, counted(geometry, &spaced))?,
        notices: Notices::of(notice),
        positions: None,
    })
}

/// What `place` says, if samples may be interpolated where they are uneven.
fn even_grid(path: &Path, geometry: Geometry, axes: &[Option<Result<Scale, String>>; 3]) -> Result<Placed, String> {
    let [Some(Ok(x)), Some(Ok(y)), Some(Ok(z))] = axes else {
        return Err("positions are missing".to_owned());
    };
    let positions = [x, y, z].map(|scale| scale.positions.clone());
    rectilinear::check(path, &geometry, &positions)?;
    Ok(Placed {
        geometry,
        notices: Notices::default(),
        positions: Some(positions),
    })
}

/// Whether positions are those of time.
pub fn is_time(scale: &Variable) -> bool {
    scale.text("axis") == Some("T")
        || scale.text("standard_name") == Some("time")
        || scale.text("units").is_some_and(|units| units.contains(" since "))
}

/// When the steps are, where the positions along their axis say it.
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

/// Positions along an axis, with their unit.
struct Scale {
    positions: Positions,
    unit: Option<String>,
}

impl Scale {
    /// Reads a scale; why not, where its values are none.
    fn read(file: &dyn VariableFile, scale: &Variable, size: u64) -> Result<Self, String> {
        let name = scale.path.trim_start_matches('/').to_owned();
        let values = file
            .read_line(scale, MAX_POSITIONS)
            .map_err(|why| format!("{name:?}: {why}"))?;
        if values.len() as u64 != size || size < 2 {
            return Err(format!("{name:?} has {} positions, expected {size}", values.len()));
        }
        let [factor, offset] = scale.packing();
        // Depth grows downwards; the world's z does not.
        let is_down = scale
            .text("positive")
            .is_some_and(|text| text.eq_ignore_ascii_case("down"));
        let sign = if is_down { -1.0 } else { 1.0 };
        let values = values.into_iter().map(|value| sign * (value * factor + offset));
        Ok(Self {
            positions: Positions::new(name, values.collect())?,
            unit: scale.text("units").map(str::to_owned),
        })
    }
}

/// Positions that count samples, in the directions of the axes' own: north stays north, and depth is down.
fn counted(mut geometry: Geometry, axes: &[Option<Result<Scale, String>>; 3]) -> Geometry {
    for (i, axis) in axes.iter().enumerate() {
        if let Some(Ok(Scale { positions, .. })) = axis {
            geometry.direction[i][i] = positions.step().signum();
        }
    }
    geometry
}

/// Puts samples where their scales say, if they say it of all axes, in one unit; uneven ones at their mean distance.
fn place(mut geometry: Geometry, axes: &[Option<Result<Scale, String>>; 3]) -> Result<Geometry, String> {
    let failed = axes.iter().flatten().filter_map(|axis| axis.as_ref().err().cloned());
    let mut wrong: Vec<String> = failed.collect();
    let found: Vec<&Scale> = axes.iter().flatten().flatten().collect();
    let units: Vec<&str> = found
        .iter()
        .map(|axis| axis.unit.as_deref().unwrap_or("none"))
        .collect();
    let parsed: Vec<Option<LengthUnit>> = units.iter().map(|unit| LengthUnit::parse(unit)).collect();
    // Lengths in different units become lengths in the first one.
    let metres: Option<Vec<f64>> = parsed.iter().map(|unit| unit.and_then(LengthUnit::metres)).collect();
    let factors = match metres {
        Some(metres) => metres.iter().map(|m| m / metres[0]).collect(),
        None if parsed.windows(2).all(|p| p[0] == p[1])
            && (parsed[..1] != [None] || units.windows(2).all(|u| u[0] == u[1])) =>
        {
            vec![1.0; found.len()]
        }
        None => Vec::new(),
    };
    let names: Vec<&str> = found.iter().map(|axis| axis.positions.name()).collect();
    if factors.is_empty() && found.len() > 1 {
        let (names, units) = (names.join(", "), units.join(", "));
        wrong.push(format!("the units of {names} differ: {units}"));
    } else if wrong.is_empty() && found.len() < 3 {
        wrong.push(format!("only {} has positions", names.join(" and ")));
    }
    if !wrong.is_empty() {
        let uneven = found.iter().filter(|axis| !axis.positions.is_even());
        let uneven: Vec<String> = uneven.map(|axis| axis.positions.unevenness()).collect();
        return Err([uneven, wrong].concat().join("; "));
    }
    for (axis, Scale { positions, .. }) in found.into_iter().enumerate() {
        let (first, step) = (positions.first() * factors[axis], positions.step() * factors[axis]);
        geometry.spacing[axis] = step.abs();
        geometry.origin[axis] = first;
        geometry.direction[axis][axis] = step.signum();
    }
    geometry.unit = parsed[0];
    Ok(geometry)
}

fn checked(path: &Path, geometry: Geometry) -> Result<Geometry, ReadError> {
    let names = GridFields {
        dims: "dimensions",
        spacing: "positions",
        origin: "positions",
        direction: "positions",
    };
    let Geometry {
        dims,
        spacing,
        origin,
        direction,
        ..
    } = geometry;
    Ok(Geometry {
        unit: geometry.unit,
        ..header::geometry(path, &names, dims, spacing, origin, direction)?
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn along(name: &str, unit: Option<&str>, step: f64) -> Option<Result<Scale, String>> {
        let positions = Positions::new(name, vec![1.0, 1.0 + step]).expect("positions");
        let unit = unit.map(str::to_owned);
        Some(Ok(Scale { positions, unit }))
    }

    fn placed(axes: [Option<Result<Scale, String>>; 3]) -> Result<Geometry, String> {
        place(Geometry::of_index([2; 3]), &axes)
    }

    #[test]
    fn lengths_in_different_units_are_joined() {
        let lengths = [
            along("x", Some("km"), 2.0),
            along("y", Some("m"), -500.0),
            along("z", Some("m"), 10.0),
        ];
        let geometry = placed(lengths).unwrap();
        assert_eq!(
            (geometry.spacing, geometry.unit),
            ([2.0, 0.5, 0.01], Some(LengthUnit::Kilometre))
        );
        assert_eq!(geometry.direction[1], [0.0, -1.0, 0.0]);
    }

    #[test]
    fn an_angle_and_a_length_have_no_common_grid() {
        let degrees = |name| along(name, Some("degrees_east"), 1.0);
        let why = placed([degrees("lon"), degrees("lat"), along("z", Some("m"), 10.0)]).unwrap_err();
        assert!(
            why.contains("the units of lon, lat, z differ: degrees_east, degrees_east, m"),
            "{why}"
        );
        assert!(
            placed([degrees("lon"), degrees("lat"), None])
                .unwrap_err()
                .contains("only lon and lat")
        );
        assert!(
            placed([
                along("x", None, 1.0),
                along("y", None, 1.0),
                along("z", Some("furlong"), 1.0)
            ])
            .is_err()
        );
        assert_eq!(
            placed([degrees("a"), degrees("b"), degrees("c")]).unwrap().unit,
            Some(LengthUnit::Degree)
        );
        assert_eq!(
            placed([along("x", None, 1.0), along("y", None, 1.0), along("z", None, 3.0)])
                .unwrap()
                .unit,
            None
        );
    }
}
