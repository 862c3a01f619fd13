//! Positions along an axis: their values, whether they go on across a full turn, and whether they point down.

use super::super::super::rectilinear::Positions;
use super::super::named_axes;
use super::file::{Variable, VariableFile};

/// Positions along an axis that are read at most; no volume has so many samples along one.
pub(super) const MAX_POSITIONS: u64 = 1 << 22;

/// The last part of a dimension's path.
pub(super) fn last_name(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

/// Positions along an axis, with their unit.
pub(super) struct Scale {
    pub(super) positions: Positions,
    pub(super) unit: Option<String>,
    /// What was repaired or guessed.
    pub(super) notices: Vec<String>,
}

impl Scale {
    /// Reads a scale; why not, if its values are none. `is_vertical`: along z, on the Earth.
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
            .unread_numbers()
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
        // Depth grows downwards; the world's z does not.
        let (is_down, notice) = points_down(scale, &values, is_vertical);
        if is_down {
            values.iter_mut().for_each(|value| *value = -*value);
        }
        notices.extend(notice);
        Ok(Self {
            positions: Positions::new(name, values)?,
            unit: scale.text("units").map(str::to_owned),
            notices,
        })
    }
}

/// A full turn in the unit of positions around the Earth; `None` of other positions.
fn full_turn(scale: &Variable) -> Option<f64> {
    let units = scale.text("units").unwrap_or_default().to_lowercase();
    let name = last_name(&scale.path).to_lowercase();
    let standard_name = scale.text("standard_name").unwrap_or_default();
    let is_longitude = standard_name.contains("longitude") || name.contains("lon");
    match units.as_str() {
        "degrees_east" | "degree_east" | "degrees_e" | "degree_e" | "degreese" | "degreee" => Some(360.0),
        "degrees" | "degree" | "deg" | "" if is_longitude => Some(360.0),
        "radians" | "radian" | "rad" if is_longitude => Some(std::f64::consts::TAU),
        _ => None,
    }
}

/// Adds or takes full turns if neighbours are more than half a turn apart. Returns whether it changed any.
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

/// Whether positions grow downwards, and what to say if the file does not say so. By CF's attribute `positive`, else by what the
/// positions are: pressure and sigma decrease upwards, a depth is below the surface.
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
