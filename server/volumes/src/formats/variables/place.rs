//! Positions of the samples of a variable: even or uneven ones, and what is assumed if they are missing.

use std::path::Path;
use std::sync::Arc;

use super::super::super::rectilinear::{self, Positions};
use super::super::super::{AxisScale, AxisScales, Geometry, LengthUnit, OpenedFile, ReadError};
use super::super::header::{self, GridFields};
use super::file::{Variable, VariableFile};
use super::scale::{Scale, last_name};

/// A grid, and notices of unknown properties of its samples' positions.
pub struct Placed {
    /// Grid of the samples as they are stored; uneven ones at their mean distance.
    pub geometry: Geometry,
    pub notices: Vec<String>,
    /// Positions along x, y and z, if all three are known; see [`Placed::finish`].
    positions: Option<[Positions; 3]>,
    /// Meaning of the positions.
    axes: AxisScales,
}

impl Placed {
    /// Places the samples of a file at these positions, on an even grid if possible.
    pub fn finish(self, path: &Path, mut file: OpenedFile) -> Result<OpenedFile, ReadError> {
        file.axes = Some(self.axes)
            .filter(|axes| axes.iter().any(Option::is_some))
            .map(Arc::new);
        let file = match &self.positions {
            Some(positions) => rectilinear::on_even_grid(path, file, positions)
                .map_err(|why| ReadError::new(path, "positions", why))?,
            None => file,
        };
        Ok(header::with_notices(file, self.notices))
    }
}

/// Returns the grid of samples that have `dims` along the `axes` x, y, z of a variable, by these scales, with notices of unknown properties.
pub fn place_grid(
    path: &Path,
    file: &dyn VariableFile,
    variable: &Variable,
    scales: &[Option<Variable>],
    axes: [usize; 3],
    dims: [u32; 3],
) -> Result<Placed, ReadError> {
    let is_on_earth = is_on_earth(&axes.map(|axis| scales[axis].as_ref()));
    let spaced = [0, 1, 2].map(|role| {
        let axis = axes[role];
        let size = variable.axes[axis].size;
        scales[axis]
            .as_ref()
            .map(|scale| Scale::read(file, scale, size, role == 2 && is_on_earth))
    });
    let mut notices: Vec<String> = spaced
        .iter()
        .flatten()
        .flatten()
        .flat_map(|scale| scale.notices.clone())
        .collect();
    let mut geometry = Geometry::of_index(dims);
    if spaced.iter().all(Option::is_none) {
        notices.extend(without_positions(variable, axes, &mut geometry));
        return Ok(Placed {
            geometry: checked(path, geometry)?,
            notices,
            positions: None,
            axes: [None, None, None],
        });
    }
    let why = match place(geometry, &spaced).and_then(|placed| even_grid(path, placed, &spaced)) {
        Ok(placed) => {
            checked(path, placed.geometry)?;
            return Ok(Placed { notices, ..placed });
        }
        Err(why) => why,
    };
    let (geometry, notice, axes) = match place_known(geometry, &spaced) {
        Some((geometry, notice)) => (geometry, notice, axes_of(&spaced, geometry.unit, false)),
        None => {
            let notice = format!("coordinates are sample indices, as the file's grid is not used: {why}");
            (counted(geometry, &spaced), notice, axes_of(&spaced, None, true))
        }
    };
    notices.push(notice);
    Ok(Placed {
        geometry: checked(path, geometry)?,
        notices,
        positions: None,
        axes,
    })
}

/// Describes the positions along the axes. `is_counted`: the world's coordinates count samples. `unit`: that of the world, if it has one.
fn axes_of(scales: &[Option<Result<Scale, String>>; 3], unit: Option<LengthUnit>, is_counted: bool) -> AxisScales {
    [0, 1, 2].map(|axis| {
        let scale = scales[axis].as_ref()?.as_ref().ok()?;
        let sign = if scale.points_down { -1.0 } else { 1.0 };
        let values = || scale.positions.values().iter().map(|value| sign * value).collect();
        Some(AxisScale {
            name: last_name(scale.positions.name()).to_owned(),
            unit: unit.map(|unit| unit.symbol().to_owned()).or_else(|| scale.unit.clone()),
            kind: scale.kind,
            positions: is_counted.then(values),
            points_down: scale.points_down,
        })
    })
}

/// Sets the spacing of a variable without positions. Returns notices of unknown properties.
fn without_positions(variable: &Variable, axes: [usize; 3], geometry: &mut Geometry) -> Vec<String> {
    // The convention of Fiji and ilastik, in the order in which the axes are stored.
    if let &[z, y, x] = variable.numbers("element_size_um").as_slice() {
        let mut stored = axes;
        stored.sort_unstable();
        let sizes = [z, y, x];
        geometry.spacing = axes.map(|axis| sizes[stored.iter().position(|&other| other == axis).unwrap_or_default()]);
        geometry.unit = Some(LengthUnit::Micrometre);
        return Vec::new();
    }
    let resolution = axes.map(|axis| variable.axes[axis].label.resolution);
    if let Some((spacing, notice)) = known_spacing(resolution) {
        geometry.spacing = spacing;
        return notice.into_iter().collect();
    }
    // These attributes are not used: programs differ in their order of axes and in their unit.
    let unread = [
        "resolution",
        "spacing",
        "voxel_size",
        "voxelsize",
        "pixel_size",
        "pixelsize",
        "element_size",
    ];
    let found = unread.iter().filter(|name| !variable.numbers(name).is_empty());
    let found: Vec<String> = found
        .map(|name| format!("{name} {:?}", variable.numbers(name)))
        .collect();
    if found.is_empty() {
        return vec!["the file does not say how far apart samples are: 1 was taken along each axis".to_owned()];
    }
    vec![format!(
        "samples are 1 apart along each axis: {} is not used, as neither its order of axes nor its unit is known",
        found.join(", ")
    )]
}

/// Returns the spacing along x, y and z, with a notice of unknown ones, which get a known one; `None` if none is known.
pub fn known_spacing(spacing: [Option<f64>; 3]) -> Option<([f64; 3], Option<String>)> {
    let known = spacing.iter().flatten().next().copied()?;
    let unknown: Vec<&str> = ["x", "y", "z"]
        .into_iter()
        .zip(spacing)
        .filter_map(|(name, spacing)| spacing.is_none().then_some(name))
        .collect();
    let notice = (!unknown.is_empty()).then(|| {
        format!(
            "the file has no spacing along {}: {known} was taken, as along another axis",
            unknown.join(" and ")
        )
    });
    Some((spacing.map(|spacing| spacing.unwrap_or(known)), notice))
}

/// Whether x and y are positions on the Earth, so that depths go down.
fn is_on_earth(scales: &[Option<&Variable>; 3]) -> bool {
    let is_geographic = |scale: &&Variable| {
        let units = scale.text("units").unwrap_or_default().to_lowercase();
        units.starts_with("degree")
            || scale
                .text("standard_name")
                .is_some_and(|name| name.starts_with("projection_"))
    };
    scales[..2].iter().flatten().any(is_geographic)
}

/// Returns the grid of `place` with the positions of its samples. An error if positions are missing, or neither only increase nor only
/// decrease along an axis.
fn even_grid(path: &Path, geometry: Geometry, axes: &[Option<Result<Scale, String>>; 3]) -> Result<Placed, String> {
    let [Some(Ok(x)), Some(Ok(y)), Some(Ok(z))] = axes else {
        return Err("positions are missing".to_owned());
    };
    let positions = [x, y, z].map(|scale| scale.positions.clone());
    rectilinear::check(path, &geometry, &positions)?;
    Ok(Placed {
        geometry,
        notices: Vec::new(),
        positions: Some(positions),
        axes: axes_of(axes, geometry.unit, false),
    })
}

/// Returns the grid whose positions count samples in the direction of each axis: north stays north, and depth points down.
fn counted(mut geometry: Geometry, axes: &[Option<Result<Scale, String>>; 3]) -> Geometry {
    for (i, axis) in axes.iter().enumerate() {
        if let Some(Ok(Scale { positions, .. })) = axis {
            geometry.direction[i][i] = positions.direction();
        }
    }
    geometry
}

/// Returns the common unit of positions along several axes, and the factor of each axis to it; `None` if there is no common unit.
fn common_unit(found: &[&Scale]) -> Option<(Option<LengthUnit>, Vec<f64>)> {
    let units: Vec<&str> = found
        .iter()
        .map(|axis| axis.unit.as_deref().unwrap_or("none"))
        .collect();
    let parsed: Vec<Option<LengthUnit>> = units.iter().map(|unit| LengthUnit::parse(unit)).collect();
    // Lengths in different units are converted to the first one.
    let metres: Option<Vec<f64>> = parsed.iter().map(|unit| unit.and_then(LengthUnit::metres)).collect();
    let first = parsed.first().copied()?;
    match metres {
        Some(metres) => Some((first, metres.iter().map(|m| m / metres[0]).collect())),
        None if parsed.windows(2).all(|p| p[0] == p[1])
            && (first.is_some() || units.windows(2).all(|u| u[0] == u[1])) =>
        {
            Some((first, vec![1.0; found.len()]))
        }
        None => None,
    }
}

/// Places samples at the positions of their scales, uneven ones at their mean distance. An error unless all axes have positions, in one
/// common unit.
fn place(mut geometry: Geometry, axes: &[Option<Result<Scale, String>>; 3]) -> Result<Geometry, String> {
    let failed = axes.iter().flatten().filter_map(|axis| axis.as_ref().err().cloned());
    let mut wrong: Vec<String> = failed.collect();
    let found: Vec<&Scale> = axes.iter().flatten().flatten().collect();
    let names: Vec<&str> = found.iter().map(|axis| axis.positions.name()).collect();
    let common = common_unit(&found);
    if common.is_none() && found.len() > 1 {
        let units: Vec<&str> = found
            .iter()
            .map(|axis| axis.unit.as_deref().unwrap_or("none"))
            .collect();
        wrong.push(format!(
            "the units of {} differ: {}",
            names.join(", "),
            units.join(", ")
        ));
    } else if wrong.is_empty() && found.len() < 3 {
        wrong.push(format!("only {} has positions", names.join(" and ")));
    }
    let (unit, factors) = match common {
        Some(common) if wrong.is_empty() => common,
        _ => {
            let uneven = found.iter().filter(|axis| !axis.positions.is_even());
            let uneven: Vec<String> = uneven.map(|axis| axis.positions.unevenness()).collect();
            return Err([uneven, wrong].concat().join("; "));
        }
    };
    for (axis, Scale { positions, .. }) in found.into_iter().enumerate() {
        let (first, step) = (positions.first() * factors[axis], positions.step() * factors[axis]);
        geometry.spacing[axis] = step.abs();
        geometry.origin[axis] = first;
        geometry.direction[axis][axis] = step.signum();
    }
    geometry.unit = unit;
    Ok(geometry)
}

/// Places samples at the positions of their scales if these are even and have a common unit, and one or two axes have no scale. Also
/// returns the notice about the axes without a scale.
fn place_known(mut geometry: Geometry, axes: &[Option<Result<Scale, String>>; 3]) -> Option<(Geometry, String)> {
    let found: Vec<&Scale> = axes
        .iter()
        .flatten()
        .map(|axis| axis.as_ref().ok())
        .collect::<Option<_>>()?;
    if found.len() == 3 || found.iter().any(|axis| !axis.positions.is_even()) {
        return None;
    }
    let (unit, factors) = common_unit(&found)?;
    let mut factors = factors.into_iter();
    let mut spacing = [None; 3];
    for (axis, scale) in axes.iter().enumerate() {
        let (Some(Ok(Scale { positions, .. })), Some(factor)) = (scale, scale.as_ref().and_then(|_| factors.next()))
        else {
            continue;
        };
        spacing[axis] = Some((positions.step() * factor).abs());
        geometry.origin[axis] = positions.first() * factor;
        geometry.direction[axis][axis] = positions.direction();
    }
    let (spacing, notice) = known_spacing(spacing)?;
    (geometry.spacing, geometry.unit) = (spacing, unit);
    Some((geometry, notice?))
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
    use crate::AxisKind;

    fn along(name: &str, unit: Option<&str>, step: f64) -> Option<Result<Scale, String>> {
        let positions = Positions::new(name, vec![1.0, 1.0 + step]).expect("positions");
        let unit = unit.map(str::to_owned);
        Some(Ok(Scale {
            positions,
            unit,
            kind: AxisKind::Other,
            points_down: false,
            notices: Vec::new(),
        }))
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
    fn positions_are_listed_where_coordinates_count_samples() {
        let mut scales = [
            along("lon", Some("degrees_east"), 2.0),
            along("lat", None, 1.0),
            along("z", Some("m"), -10.0),
        ];
        if let Some(Ok(depth)) = &mut scales[2] {
            (depth.points_down, depth.kind) = (true, AxisKind::Depth);
        }
        let counted = axes_of(&scales, None, true);
        let lon = counted[0].as_ref().expect("longitudes");
        assert_eq!(
            (lon.positions.as_deref(), lon.unit.as_deref()),
            (Some(&[1.0, 3.0][..]), Some("degrees_east"))
        );
        // The file's own positions, which grow downwards.
        let depth = counted[2].as_ref().expect("depths");
        assert_eq!(
            (depth.positions.as_deref(), depth.kind),
            (Some(&[-1.0, 9.0][..]), AxisKind::Depth)
        );
        let placed = axes_of(&scales, Some(LengthUnit::Kilometre), false);
        let depth = placed[2].as_ref().expect("depths");
        assert_eq!(
            (depth.positions.as_deref(), depth.unit.as_deref(), depth.points_down),
            (None, Some("km"), true)
        );
        assert_eq!(axes_of(&[None, None, None], None, true), [None, None, None]);
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
