//! Which axes of a variable are space and which is time, and where its samples are, by the conventions of CF.

use std::ops::Range;
use std::path::Path;

use super::super::super::{Geometry, LengthUnit, ReadError, TimeAxis};
use super::super::header::{self, GridFields};
use super::file::{Variable, VariableFile};

/// Largest deviation from even positions, in parts of their distance, that is taken for rounding.
const EVEN: f64 = 1e-3;

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

/// Where a variable's samples are, and what the grid does not say of that.
pub struct Grid {
    pub layout: Layout,
    pub geometry: Geometry,
    pub times: Option<TimeAxis>,
    pub notice: Option<String>,
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
    let (geometry, notice) = place_grid(path, file, variable, &scales, layout.axes, layout.dims)?;
    Ok(Grid {
        layout,
        geometry,
        times,
        notice,
    })
}

/// Where samples are that have `dims` along the `axes` x, y, z of a variable, by these scales; and what the grid does not say of that.
pub fn place_grid(
    path: &Path,
    file: &dyn VariableFile,
    variable: &Variable,
    scales: &[Option<Variable>],
    axes: [usize; 3],
    dims: [u32; 3],
) -> Result<(Geometry, Option<String>), ReadError> {
    let spaced = axes.map(|axis| {
        let size = variable.axes[axis].size;
        scales[axis].as_ref().map(|scale| Positions::read(file, scale, size))
    });
    let mut geometry = Geometry::of_index(dims);
    if spaced.iter().all(Option::is_none) {
        // The convention of Fiji and ilastik, in the order of the axes as stored.
        if let &[z, y, x] = variable.numbers("element_size_um") {
            geometry.spacing = [x, y, z];
            geometry.unit = Some(LengthUnit::Micrometre);
        }
        return Ok((checked(path, geometry)?, None));
    }
    let why = match place(geometry, &spaced) {
        Ok(geometry) => return Ok((checked(path, geometry)?, None)),
        Err(why) => why,
    };
    let notice = format!("positions count samples, as the file's are on no even grid: {why}");
    tracing::warn!(path = %path.display(), variable = variable.path, "{notice}");
    Ok((checked(path, counted(geometry, &spaced))?, Some(notice)))
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

/// Positions along an axis.
struct Positions {
    name: String,
    unit: Option<String>,
    first: f64,
    /// Mean distance of neighbours.
    step: f64,
    /// Largest deviation from even positions, in steps.
    deviation: f64,
}

impl Positions {
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
        let (first, last) = (values[0], values[values.len() - 1]);
        let step = (last - first) / (size - 1) as f64;
        let deviation = |(i, value): (usize, &f64)| ((value - first - i as f64 * step) / step).abs();
        let largest = values
            .iter()
            .enumerate()
            .map(deviation)
            .fold(0.0, |a: f64, b| if b > a || b.is_nan() { b } else { a });
        if largest.is_nan() {
            return Err(format!("{name:?} has positions that are no numbers"));
        }
        // Depth grows downwards; the world's z does not.
        let sign = if scale
            .text("positive")
            .is_some_and(|text| text.eq_ignore_ascii_case("down"))
        {
            -1.0
        } else {
            1.0
        };
        Ok(Self {
            name,
            unit: scale.text("units").map(str::to_owned),
            first: sign * (first * factor + offset),
            step: sign * step * factor,
            deviation: largest,
        })
    }
}

/// Positions that count samples, in the directions of the axes' own: north stays north, and depth is down.
fn counted(mut geometry: Geometry, axes: &[Option<Result<Positions, String>>; 3]) -> Geometry {
    for (i, axis) in axes.iter().enumerate() {
        if let Some(Ok(Positions { step, .. })) = axis {
            geometry.direction[i][i] = step.signum();
        }
    }
    geometry
}

/// Puts samples where their scales say, if they say it of all axes, in one unit.
fn place(mut geometry: Geometry, axes: &[Option<Result<Positions, String>>; 3]) -> Result<Geometry, String> {
    let refused = |axis: &Result<Positions, String>| match axis {
        Err(why) => Some(why.clone()),
        Ok(Positions {
            name, step, deviation, ..
        }) if *deviation > EVEN => Some(format!(
            "{name:?} is not even, by up to {deviation:.3} of its mean step {step}"
        )),
        Ok(_) => None,
    };
    let mut wrong: Vec<String> = axes.iter().flatten().filter_map(refused).collect();
    let found: Vec<&Positions> = axes.iter().flatten().flatten().collect();
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
    let names: Vec<&str> = found.iter().map(|axis| axis.name.as_str()).collect();
    if factors.is_empty() && found.len() > 1 {
        let (names, units) = (names.join(", "), units.join(", "));
        wrong.push(format!("the units of {names} differ: {units}"));
    } else if wrong.is_empty() && found.len() < 3 {
        wrong.push(format!("only {} has positions", names.join(" and ")));
    }
    if !wrong.is_empty() {
        return Err(wrong.join("; "));
    }
    for (axis, positions) in found.into_iter().enumerate() {
        let (first, step) = (positions.first * factors[axis], positions.step * factors[axis]);
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

    fn along(name: &str, unit: Option<&str>, step: f64) -> Option<Result<Positions, String>> {
        Some(Ok(Positions {
            name: name.into(),
            unit: unit.map(str::to_owned),
            first: 1.0,
            step,
            deviation: 0.0,
        }))
    }

    fn placed(axes: [Option<Result<Positions, String>>; 3]) -> Result<Geometry, String> {
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
