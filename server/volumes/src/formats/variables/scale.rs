//! Positions along an axis: their values, across a full turn if necessary, and whether they point down.

use super::super::super::rectilinear::Positions;
use super::super::super::{AxisKind, LengthUnit};
use super::super::named_axes;
use super::file::{Variable, VariableFile};

/// Maximum positions along an axis that are read; no volume has that many samples along one.
pub(super) const MAX_POSITIONS: u64 = 1 << 22;

/// Returns the last component of a dimension's path.
pub(super) fn last_name(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

/// Positions along an axis, with their unit.
pub(super) struct Scale {
    pub(super) positions: Positions,
    pub(super) unit: Option<String>,
    /// Kind of the positions.
    pub(super) kind: AxisKind,
    /// Whether the file's positions grow downwards. Then `positions` are theirs times −1.
    pub(super) points_down: bool,
    /// Notices of repairs and assumptions.
    pub(super) notices: Vec<String>,
}

impl Scale {
    /// Reads a scale, or returns why its values are no positions. `is_vertical`: along z, on the Earth.
    pub(super) fn read(
        file: &dyn VariableFile,
        scale: &Variable,
        size: u64,
        is_vertical: bool,
    ) -> Result<Self, String> {
        let name = scale.path.trim_start_matches('/').to_owned();
        let values = file
            .read_line(scale, MAX_POSITIONS)
            .map_err(|why| format!("{name:?}: {why}"))?;
        if values.len() as u64 != size || size < 2 {
            return Err(format!("{name:?} has {} positions, expected {size}", values.len()));
        }
        let [factor, offset] = scale.packing();
        let mut values: Vec<f64> = values.into_iter().map(|value| value * factor + offset).collect();
        let mut notices: Vec<String> = scale
            .notices()
            .into_iter()
            .map(|why| format!("{name:?}: {why}"))
            .collect();
        if full_turn(scale).is_some_and(|turn| unwrap_turns(&mut values, turn)) {
            notices.push(format!(
                "{name:?} crosses a full turn: its positions go on from {} to {}",
                values[0],
                values[values.len() - 1]
            ));
        }
        // Depth grows downwards, but the world's z grows upwards.
        let (is_down, notice) = points_down(scale, &values, is_vertical);
        if is_down {
            values.iter_mut().for_each(|value| *value = -*value);
        }
        notices.extend(notice);
        let kind = kind_of(
            scale.text("units").unwrap_or_default(),
            scale.text("standard_name").unwrap_or_default(),
            last_name(&scale.path),
            is_down && is_vertical,
        );
        Ok(Self {
            positions: Positions::new(name, values)?,
            unit: scale.text("units").map(str::to_owned),
            kind,
            points_down: is_down,
            notices,
        })
    }
}

/// Returns the kind of positions, by the attributes of CF and their units. `is_below`: they grow downwards, on the Earth.
fn kind_of(units: &str, standard_name: &str, name: &str, is_below: bool) -> AxisKind {
    let (units, name) = (units.to_lowercase(), name.to_lowercase());
    let is_north = matches!(
        units.as_str(),
        "degrees_north" | "degree_north" | "degrees_n" | "degree_n" | "degreesn" | "degreen"
    );
    let is_degrees = units.starts_with("deg") || units.is_empty();
    if is_north || standard_name == "latitude" || (is_degrees && name.starts_with("lat")) {
        return AxisKind::Latitude;
    }
    if is_east(&units) || standard_name == "longitude" || (is_degrees && name.starts_with("lon")) {
        return AxisKind::Longitude;
    }
    if named_axes::is_pressure(&units) {
        return AxisKind::Pressure;
    }
    let is_depth = standard_name == "depth" || standard_name.starts_with("depth_below_") || name.starts_with("depth");
    if is_depth || (is_below && LengthUnit::parse(&units).is_some()) {
        return AxisKind::Depth;
    }
    if ["height", "altitude"]
        .iter()
        .any(|known| standard_name.starts_with(known) || name.starts_with(known))
    {
        return AxisKind::Height;
    }
    AxisKind::Other
}

/// Returns a full turn in the unit of positions around the Earth; `None` for other positions.
fn full_turn(scale: &Variable) -> Option<f64> {
    let units = scale.text("units").unwrap_or_default().to_lowercase();
    let name = last_name(&scale.path).to_lowercase();
    let standard_name = scale.text("standard_name").unwrap_or_default();
    let is_longitude = standard_name.contains("longitude") || name.contains("lon");
    match units.as_str() {
        east if is_east(east) => Some(360.0),
        "degrees" | "degree" | "deg" | "" if is_longitude => Some(360.0),
        "radians" | "radian" | "rad" if is_longitude => Some(std::f64::consts::TAU),
        _ => None,
    }
}

fn is_east(units: &str) -> bool {
    matches!(
        units,
        "degrees_east" | "degree_east" | "degrees_e" | "degree_e" | "degreese" | "degreee"
    )
}

/// Adds or subtracts full turns if neighbours are more than half a turn apart. Returns whether any value changed.
fn unwrap_turns(values: &mut [f64], turn: f64) -> bool {
    let mut turns = 0.0;
    let mut before = values[0];
    for value in &mut values[1..] {
        let distance = *value - before;
        before = *value;
        if distance.abs() > 0.5 * turn && distance.abs() <= turn {
            turns -= distance.signum();
        }
        *value += turn * turns;
    }
    turns != 0.0
}

/// Whether positions grow downwards, with a notice if the file does not state it. CF's attribute `positive` decides, else the kind of
/// positions: pressure and sigma decrease upwards, a depth is below the surface.
fn points_down(scale: &Variable, values: &[f64], is_vertical: bool) -> (bool, Option<String>) {
    let is_pressure = scale.text("units").is_some_and(named_axes::is_pressure);
    if let Some(positive) = scale.text("positive") {
        let is_down = positive.eq_ignore_ascii_case("down");
        let notice = (is_pressure && !is_down).then(|| {
            let name = last_name(&scale.path);
            format!("{name:?} has positive = {positive:?}, but is a pressure, which decreases upwards: it points down")
        });
        return (is_down || is_pressure, notice);
    }
    let standard_name = scale.text("standard_name").unwrap_or_default();
    let name = last_name(&scale.path).to_lowercase();
    let says = |text: &str| Some(format!("{name:?} has no attribute positive: {text}, so it points down"));
    if is_pressure {
        return (true, None);
    }
    match standard_name {
        "depth" => (true, says("it is a depth")),
        _ if standard_name.starts_with("depth_below_") => (true, says("it is a depth")),
        "atmosphere_sigma_coordinate" | "atmosphere_hybrid_sigma_pressure_coordinate" => {
            (true, says("sigma decreases upwards"))
        }
        "" if is_vertical && name.starts_with("depth") && values.iter().all(|&value| value >= 0.0) => {
            (true, says("by its name it is a depth"))
        }
        "" if is_vertical && scale.text("units").is_none() && is_named_pressure(&name) => {
            (true, says("by its name it is a pressure"))
        }
        _ => (false, None),
    }
}

fn is_named_pressure(name: &str) -> bool {
    ["plev", "isobaric", "pres"].iter().any(|start| name.starts_with(start))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_are_named_by_units_standard_names_and_names() {
        for (units, standard_name, name, is_below, kind) in [
            ("degrees_east", "", "XAX_SUBSET", false, AxisKind::Longitude),
            ("degrees_north", "", "y", false, AxisKind::Latitude),
            ("degrees", "longitude", "x", false, AxisKind::Longitude),
            ("", "", "lat", false, AxisKind::Latitude),
            ("METERS", "", "ZAXLEVIT19", true, AxisKind::Depth),
            ("m", "depth", "lev", false, AxisKind::Depth),
            ("m", "height", "z", false, AxisKind::Height),
            ("hPa", "air_pressure", "plev", true, AxisKind::Pressure),
            ("m", "", "z", false, AxisKind::Other),
            ("m", "", "length", false, AxisKind::Other),
        ] {
            assert_eq!(
                kind_of(units, standard_name, name, is_below),
                kind,
                "{units} {standard_name} {name}"
            );
        }
    }

    #[test]
    fn positions_go_on_across_a_full_turn() {
        for (mut values, turn, expected) in [
            (vec![350.0, 355.0, 0.0, 5.0], 360.0, vec![350.0, 355.0, 360.0, 365.0]),
            (vec![170.0, 179.0, -172.0], 360.0, vec![170.0, 179.0, 188.0]),
            (vec![2.0, 358.0, 354.0], 360.0, vec![2.0, -2.0, -6.0]),
            (vec![0.0, 120.0, 240.0, 0.0], 360.0, vec![0.0, 120.0, 240.0, 360.0]),
        ] {
            assert!(unwrap_turns(&mut values, turn));
            assert_eq!(values, expected);
        }
        assert!(!unwrap_turns(&mut [0.0, 90.0, 180.0, 270.0], 360.0));
    }
}
