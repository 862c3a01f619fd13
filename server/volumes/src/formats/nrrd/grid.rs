//! Positions of samples and times of steps.

use super::super::super::{Frame, Geometry, LengthUnit, Notices, ReadError, TimeAxis};
use super::super::header::{self, numbers, three};
use super::FIELDS;
use super::axes::Axes;
use super::header::{Header, vectors};

impl Header<'_> {
    pub(super) fn geometry(&self, axes: &Axes, notices: &mut Notices) -> Result<Geometry, ReadError> {
        let path = self.location.path();
        let (spacing, direction) = if let Some(text) = self.get("space directions") {
            let all = vectors(text).ok_or_else(|| self.error("space directions", malformed(text)))?;
            let mut chosen = [[0.0; 3]; 3];
            for (out, &axis) in chosen.iter_mut().zip(&axes.space) {
                *out = match all.get(axis) {
                    Some(Some(v)) => three(path, "space directions", in_space(v))?,
                    _ => return Err(self.error("space directions", format!("no vector for axis {axis}, expected one"))),
                };
            }
            header::split_axes(chosen)
        } else if let Some(text) = self.get("spacings") {
            let all: Vec<f64> = numbers(path, "spacings", text, Some(axes.count))?;
            header::signed_distances(axes.space.map(|a| all[a]), Geometry::IDENTITY, notices)
        } else if let Some(distances) = self.axis_distances(axes) {
            header::signed_distances(distances, Geometry::IDENTITY, notices)
        } else {
            ([1.0; 3], Geometry::IDENTITY)
        };
        let origin = match self.get("space origin") {
            None => [0.0; 3],
            Some(text) => match vectors(text).as_deref() {
                Some([Some(v)]) => header::known_origin(three(path, "space origin", at_a_time(v))?, notices),
                _ => return Err(self.error("space origin", malformed(text))),
            },
        };
        let origin = match self.axis_mins(axes) {
            Some(mins) if self.get("space origin").is_none() && self.get("space directions").is_none() => mins,
            _ => origin,
        };
        let geometry = header::geometry(path, &FIELDS, axes.dims, spacing, origin, direction)?;
        Ok(self.framed(geometry, axes, notices))
    }

    /// Returns the numbers for the axes in space, from a field with one number for each axis.
    fn of_space(&self, field: &str, axes: &Axes) -> Option<[f64; 3]> {
        let words: Vec<&str> = self.get(field)?.split_whitespace().collect();
        let number = |axis: usize| words.get(axis)?.parse::<f64>().ok().filter(|number| number.is_finite());
        let [x, y, z] = axes.space.map(number);
        Some([x?, y?, z?])
    }

    /// Returns the positions of the first samples by `axis mins`. If samples are at the centres of cells, `axis mins` states the beginning
    /// of the first cell, and half a cell is added.
    fn axis_mins(&self, axes: &Axes) -> Option<[f64; 3]> {
        let mins = self.of_space("axis mins", axes)?;
        let half = self.half_cells(axes);
        let spacings = self.of_space("spacings", axes);
        let distances = spacings.or_else(|| self.axis_distances(axes)).unwrap_or([1.0; 3]);
        Some(std::array::from_fn(|axis| mins[axis] + half[axis] * distances[axis]))
    }

    /// Returns half a cell for each axis whose samples are at the centres of cells, 0 for other axes.
    fn half_cells(&self, axes: &Axes) -> [f64; 3] {
        let words: Vec<&str> = self
            .get("centers")
            .map_or_else(Vec::new, |text| text.split_whitespace().collect());
        axes.space
            .map(|axis| words.get(axis).is_some_and(|word| word.eq_ignore_ascii_case("cell")))
            .map(|is_cell| if is_cell { 0.5 } else { 0.0 })
    }

    /// Returns the distances of samples by `axis mins` and `axis maxs`.
    fn axis_distances(&self, axes: &Axes) -> Option<[f64; 3]> {
        let (mins, maxs) = (self.of_space("axis mins", axes)?, self.of_space("axis maxs", axes)?);
        let half = self.half_cells(axes);
        Some(std::array::from_fn(|axis| {
            let intervals = f64::from(axes.dims[axis]) - 1.0 + 2.0 * half[axis];
            (maxs[axis] - mins[axis]) / intervals
        }))
    }

    /// Returns the times of the steps, if the file states their distance: in `space directions` with four components, else in `spacings`
    /// with `axis mins` and `units`.
    pub(super) fn times(&self, axes: &Axes) -> Option<TimeAxis> {
        let axis = axes.time?;
        // In a world with time, it is the last component of the vectors.
        let last = |text: &str, at: usize| match vectors(text)?.get(at) {
            Some(Some(vector)) if vector.len() == 4 => Some(vector[3]),
            _ => None,
        };
        if let Some(between) = self.get("space directions").and_then(|text| last(text, axis)) {
            let start = self.get("space origin").and_then(|text| last(text, 0)).unwrap_or(0.0);
            let unit = self.get("space units").and_then(|text| quoted(text).nth(3));
            return TimeAxis::even(start, between, axes.steps, unit.unwrap_or_default());
        }
        let number = |name: &str| -> Option<f64> { self.get(name)?.split_whitespace().nth(axis)?.parse().ok() };
        let unit = self
            .get("units")
            .and_then(|text| quoted(text).nth(axis))
            .unwrap_or_default();
        let start = number("axis mins").filter(|start| start.is_finite()).unwrap_or(0.0);
        TimeAxis::even(start, number("spacings")?, axes.steps, unit)
    }

    /// Returns the grid in the frame that `space` names. Lengths are in `space units`, or in `units` if there are none, provided that the
    /// units of the axes agree; else in millimetres if the frame is a patient's.
    fn framed(&self, mut geometry: Geometry, axes: &Axes, notices: &mut Notices) -> Geometry {
        let (frame, signs) = self
            .get("space")
            .map_or((Frame::World, [1.0; 3]), header::frame_of_space);
        for vector in geometry.direction.iter_mut().chain([&mut geometry.origin]) {
            *vector = std::array::from_fn(|i| 0.0 + vector[i] * signs[i]);
        }
        geometry.frame = frame;
        let of_space = self.get("space units").map(|text| quoted(text).take(3).collect());
        let of_axes = || {
            self.get("units")
                .map(|text| axes.space.iter().filter_map(|&a| quoted(text).nth(a)).collect())
        };
        let named: Option<Vec<&str>> = of_space.or_else(of_axes);
        let named = named.map(|units| named_units(units, notices));
        geometry.unit = match named.as_deref() {
            Some([first, rest @ ..]) if rest.iter().all(|unit| unit == first) => LengthUnit::parse(first),
            Some(units) if units.len() > 1 && frame == Frame::World => {
                notices.add(format!(
                    "the units of the axes differ: {}; distances are the numbers of the file, without a unit",
                    units.join(", ")
                ));
                None
            }
            _ => None,
        }
        .or(frame.is_anatomical().then_some(LengthUnit::Millimetre));
        geometry
    }
}

/// Returns the units of axes. Axes without a unit get that of the others if these agree, with a notice.
fn named_units<'a>(units: Vec<&'a str>, notices: &mut Notices) -> Vec<&'a str> {
    let is_named = |unit: &&str| !matches!(unit.trim(), "" | "???");
    let named: Vec<&str> = units.iter().copied().filter(is_named).collect();
    match named[..] {
        [first, ..] if named.len() < units.len() && named.iter().all(|unit| *unit == first) => {
            let without = units.len() - named.len();
            notices.add(format!(
                "{without} of {} axes have no unit: {first:?} was taken for all, as the others have it",
                units.len()
            ));
            named
        }
        _ => units,
    }
}

/// Returns the space components of an axis, in a world that may include time.
fn in_space(vector: &[f64]) -> &[f64] {
    match vector {
        [space @ .., 0.0] if space.len() == 3 => space,
        _ => vector,
    }
}

/// Returns the space components of a position, in a world that may include time.
fn at_a_time(place: &[f64]) -> &[f64] {
    match place {
        [space @ .., _] if space.len() == 3 => space,
        _ => place,
    }
}

fn malformed(text: &str) -> String {
    let shown: String = text.chars().take(60).collect();
    format!("{shown:?}, expected vectors like (1,0,0)")
}

/// Returns the words of a list such as `"mm" "mm" ""`.
fn quoted(text: &str) -> impl Iterator<Item = &str> {
    text.split('"').skip(1).step_by(2)
}
