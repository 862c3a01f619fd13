//! Assigns roles to the axes of an array, x, y, z, time and channels, by what a file states about each axis.
//!
//! The strongest evidence counts: a statement of the format (`axis` of CF, `axistags`, the type of an OME axis), then `standard_name`,
//! units and `positive` of the positions, then the axis' name. Axes without evidence get the remaining roles, in the order time, z, y, x,
//! with a notice.

/// Role of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    X,
    Y,
    Z,
    Time,
    /// Each sample along it is a field.
    Channel,
}

impl Role {
    const ALL: [Self; 5] = [Self::X, Self::Y, Self::Z, Self::Time, Self::Channel];

    const fn name(self) -> &'static str {
        match self {
            Self::X => "x",
            Self::Y => "y",
            Self::Z => "z",
            Self::Time => "time",
            Self::Channel => "channels",
        }
    }
}

/// What a file states about an axis.
#[derive(Clone, Debug, Default)]
pub struct AxisFacts<'a> {
    pub size: u64,
    pub name: Option<&'a str>,
    /// The role that the format itself states.
    pub stated: Option<Role>,
    /// Attributes of its positions: `standard_name`, `units`, `positive`.
    pub standard_name: Option<&'a str>,
    pub units: Option<&'a str>,
    pub positive: Option<&'a str>,
}

/// The axes of an array, by role.
#[derive(Clone, Debug, PartialEq)]
pub struct AxisRoles {
    /// x, y and z.
    pub space: [usize; 3],
    pub time: Option<usize>,
    pub channel: Option<usize>,
    /// Whether one of x, y and z is a time axis, because there are only two axes in space.
    pub has_time_in_space: bool,
    /// What was assumed.
    pub notices: Vec<String>,
}

/// Strength of the evidence for a role, in increasing order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Evidence {
    Name,
    Positions,
    Stated,
}

impl AxisFacts<'_> {
    fn role(&self, width_is_named: bool) -> Option<(Evidence, Role)> {
        if let Some(role) = self.stated {
            return Some((Evidence::Stated, role));
        }
        let positions = self
            .standard_name
            .and_then(role_of_standard_name)
            .or_else(|| self.units.and_then(role_of_units))
            .or_else(|| self.positive.map(|_| Role::Z));
        if let Some(role) = positions {
            return Some((Evidence::Positions, role));
        }
        let role = match (self.name?.to_lowercase().as_str(), width_is_named) {
            ("height", true) => Some(Role::Y),
            (name, _) => role_of_name(name),
        };
        role.map(|role| (Evidence::Name, role))
    }

    /// Returns the axis for messages.
    fn shown(&self, axis: usize) -> String {
        match self.name {
            Some(name) => format!("{name:?}"),
            None => format!("number {}", axis + 1),
        }
    }
}

/// The role that CF's attribute `axis` states.
pub fn role_of_cf_axis(text: &str) -> Option<Role> {
    Some(match text.trim() {
        "X" | "x" => Role::X,
        "Y" | "y" => Role::Y,
        "Z" | "z" => Role::Z,
        "T" | "t" => Role::Time,
        _ => return None,
    })
}

fn role_of_standard_name(name: &str) -> Option<Role> {
    Some(match name {
        "longitude" | "grid_longitude" | "projection_x_coordinate" | "projection_x_angular_coordinate" => Role::X,
        "latitude" | "grid_latitude" | "projection_y_coordinate" | "projection_y_angular_coordinate" => Role::Y,
        "time" | "forecast_period" | "forecast_reference_time" => Role::Time,
        "realization" => Role::Channel,
        "altitude" | "height" | "depth" | "air_pressure" | "model_level_number" | "sea_water_pressure" => Role::Z,
        name if name.starts_with("height_above_") || name.starts_with("depth_below_") => Role::Z,
        name if name.starts_with("atmosphere_") && name.ends_with("_coordinate") => Role::Z,
        name if name.starts_with("ocean_") && name.ends_with("_coordinate") => Role::Z,
        _ => return None,
    })
}

fn role_of_units(units: &str) -> Option<Role> {
    let units = units.trim().to_lowercase();
    if units.contains(" since ") {
        return Some(Role::Time);
    }
    Some(match units.as_str() {
        "degrees_east" | "degree_east" | "degree_e" | "degrees_e" | "degreee" | "degreese" => Role::X,
        "degrees_north" | "degree_north" | "degree_n" | "degrees_n" | "degreen" | "degreesn" => Role::Y,
        _ if is_pressure(&units) => Role::Z,
        "level" | "layer" | "sigma_level" => Role::Z,
        _ => return None,
    })
}

/// Whether a unit is one of pressure, which decreases upwards.
pub fn is_pressure(units: &str) -> bool {
    matches!(
        units.trim().to_lowercase().as_str(),
        "pa" | "hpa"
            | "kpa"
            | "pascal"
            | "pascals"
            | "hectopascal"
            | "hectopascals"
            | "bar"
            | "mbar"
            | "mb"
            | "millibar"
            | "millibars"
            | "dbar"
            | "decibar"
            | "decibars"
            | "atm"
    )
}

/// Returns the role for a name of a dimension that programs use; `name` is in lower case.
fn role_of_name(name: &str) -> Option<Role> {
    // xarray and GRIB converters count equal names: `lon_2`.
    let name = match name.rsplit_once('_') {
        Some((stem, digits)) if !stem.is_empty() && digits.bytes().all(|b| b.is_ascii_digit()) => stem,
        _ => name,
    };
    Some(match name {
        "x"
        | "lon"
        | "long"
        | "longitude"
        | "lons"
        | "longitudes"
        | "rlon"
        | "grid_longitude"
        | "nlon"
        | "nx"
        | "ni"
        | "xc"
        | "xdim"
        | "dim_x"
        | "xt_ocean"
        | "xu_ocean"
        | "xh"
        | "xq"
        | "xi_rho"
        | "xi_u"
        | "xi_v"
        | "xi_psi"
        | "west_east"
        | "west_east_stag"
        | "easting"
        | "eastings"
        | "column"
        | "columns"
        | "cols"
        | "col"
        | "width"
        | "projection_x_coordinate"
        | "i" => Role::X,
        "y"
        | "lat"
        | "latitude"
        | "lats"
        | "latitudes"
        | "rlat"
        | "grid_latitude"
        | "nlat"
        | "ny"
        | "nj"
        | "yc"
        | "ydim"
        | "dim_y"
        | "yt_ocean"
        | "yu_ocean"
        | "yh"
        | "yq"
        | "eta_rho"
        | "eta_u"
        | "eta_v"
        | "eta_psi"
        | "south_north"
        | "south_north_stag"
        | "northing"
        | "northings"
        | "row"
        | "rows"
        | "projection_y_coordinate"
        | "j" => Role::Y,
        "t" | "time" | "times" | "nt" | "ntime" | "tdim" | "time_counter" | "ocean_time" | "valid_time"
        | "time_step" | "timestep" | "timesteps" | "step" | "steps" | "frame" | "frames" | "date" | "xtime" => {
            Role::Time
        }
        "c" | "ch" | "channel" | "channels" | "nc" | "nchannel" | "nchannels" | "band" | "bands" | "rgb" | "rgba"
        | "color" | "colour" | "colors" | "colours" | "component" | "components" | "comp" | "member" | "members"
        | "ensemble" | "ensemble_member" | "realization" | "realisation" | "number" | "feature" | "features"
        | "class" | "classes" => Role::Channel,
        "z" | "lev" | "levs" | "level" | "levels" | "nlev" | "plev" | "plevel" | "pres" | "pressure"
        | "pressure_level" | "height" | "heights" | "altitude" | "altitudes" | "alt" | "elevation" | "nz" | "nk"
        | "zc" | "zdim" | "dim_z" | "st_ocean" | "sw_ocean" | "zl" | "s_rho" | "s_w" | "bottom_top"
        | "bottom_top_stag" | "sigma" | "hybrid" | "slice" | "slices" | "plane" | "planes" | "vertical" | "layer"
        | "layers" | "k" | "olevel" | "model_level" | "model_level_number" | "z_t" | "z_w" => Role::Z,
        name if [
            "depth",
            "isobaric",
            "height_above",
            "altitude_above",
            "hybrid_level",
            "lev_",
        ]
        .iter()
        .any(|start| name.starts_with(start)) =>
        {
            Role::Z
        }
        _ => return None,
    })
}

/// Assigns the roles to all axes longer than 1.
///
/// # Errors
/// The array is no volume; the message lists its axes.
pub fn assign(axes: &[AxisFacts<'_>]) -> Result<AxisRoles, String> {
    let long: Vec<usize> = (0..axes.len()).filter(|&axis| axes[axis].size != 1).collect();
    if long.len() < 3 {
        return Err(expected(axes));
    }
    let mut notices = Vec::new();
    let mut found = claims(axes, &long, &mut notices);
    let mut rest: Vec<usize> = long
        .iter()
        .copied()
        .filter(|&axis| !found.contains(&Some(axis)))
        .collect();
    let missing: Vec<usize> = [2, 1, 0].into_iter().filter(|&role| found[role].is_none()).collect();
    let is_all_assumed = missing.len() == 3 && found == [None; 5];
    if rest.len() == missing.len() + 1 && found[TIME].is_none() {
        found[TIME] = Some(rest.remove(0));
    } else if rest.len() == missing.len() + 1 && found[CHANNEL].is_none() && !is_all_assumed {
        found[CHANNEL] = Some(rest.remove(0));
    } else if let ([missing], []) = (missing.as_slice(), rest.as_slice())
        && let Some(time) = found[TIME].take()
    {
        // Two axes in space and one in time: also a volume, whose third axis is time.
        found[*missing] = Some(time);
        notices.push(format!(
            "axis {} is time and there are two others: {} of the volume is time",
            axes[time].shown(time),
            Role::ALL[*missing].name()
        ));
        return Ok(AxisRoles {
            has_time_in_space: true,
            ..roles(found, notices)
        });
    }
    if rest.len() != missing.len() {
        return Err(expected(axes));
    }
    for (role, axis) in missing.into_iter().zip(&rest) {
        found[role] = Some(*axis);
    }
    if is_all_assumed {
        notices.extend(assumption(axes, found));
    } else {
        let assumed = |role: usize| {
            let axis = found[role].filter(|&axis| claim(axes, axis) != Some(Role::ALL[role]))?;
            Some(format!("{} as {}", axes[axis].shown(axis), Role::ALL[role].name()))
        };
        let assumed: Vec<String> = (0..5).filter_map(assumed).collect();
        if !assumed.is_empty() {
            notices.push(format!(
                "the file does not say what all axes are: axis {} was taken, as what is left",
                assumed.join(", ")
            ));
        }
    }
    Ok(roles(found, notices))
}

/// Indices of roles in [`Role::ALL`].
const TIME: usize = 3;
const CHANNEL: usize = 4;

fn roles(found: [Option<usize>; 5], notices: Vec<String>) -> AxisRoles {
    AxisRoles {
        space: [0, 1, 2].map(|role| found[role].unwrap_or_default()),
        time: found[TIME],
        channel: found[CHANNEL],
        has_time_in_space: false,
        notices,
    }
}

fn expected(axes: &[AxisFacts<'_>]) -> String {
    let sizes: Vec<String> = axes.iter().map(|axis| axis.size.to_string()).collect();
    let names: Vec<&str> = axes.iter().filter_map(|axis| axis.name).collect();
    let named = if names.len() == axes.len() && !names.is_empty() {
        format!(" along {}", names.join(", "))
    } else {
        String::new()
    };
    format!(
        "{} samples{named}, expected 3 axes in space longer than 1, or 4 with time steps or channels, or 5 with both",
        sizes.join(" x ")
    )
}

fn width_is_named(axes: &[AxisFacts<'_>]) -> bool {
    axes.iter()
        .any(|axis| axis.name.is_some_and(|name| name.eq_ignore_ascii_case("width")))
}

fn claim(axes: &[AxisFacts<'_>], axis: usize) -> Option<Role> {
    axes[axis].role(width_is_named(axes)).map(|(_, role)| role)
}

/// Returns for each role the axis that the file gives it to. If two axes have the same evidence for a role, neither is taken, with a
/// notice.
fn claims(axes: &[AxisFacts<'_>], long: &[usize], notices: &mut Vec<String>) -> [Option<usize>; 5] {
    let width = width_is_named(axes);
    Role::ALL.map(|role| {
        let claiming = long.iter().filter_map(|&axis| {
            let (evidence, of_axis) = axes[axis].role(width)?;
            (of_axis == role).then_some((evidence, axis))
        });
        let claiming: Vec<(Evidence, usize)> = claiming.collect();
        let strongest = claiming.iter().map(|(evidence, _)| *evidence).max()?;
        let mut best = claiming.iter().filter(|(evidence, _)| *evidence == strongest);
        match (best.next(), best.next()) {
            (Some(&(_, axis)), None) => Some(axis),
            (Some(&(_, a)), Some(&(_, b))) => {
                notices.push(format!(
                    "axes {} and {} both seem to be {}",
                    axes[a].shown(a),
                    axes[b].shown(b),
                    role.name()
                ));
                None
            }
            _ => None,
        }
    })
}

/// Returns the notices if nothing is known of any axis.
fn assumption(axes: &[AxisFacts<'_>], found: [Option<usize>; 5]) -> Vec<String> {
    let sizes: Vec<u64> = axes.iter().map(|axis| axis.size).collect();
    let order = if found[TIME].is_some() {
        "time, z, y, x"
    } else {
        "z, y, x"
    };
    let mut notices = vec![format!("the file does not say what its axes are: {order} were taken")];
    notices.extend(doubt_of_order(&sizes));
    notices
}

/// Returns a notice if an array without names of axes, taken as (time,) z, y, x, has a last axis that looks like channels.
pub fn doubt_of_order(sizes: &[u64]) -> Option<String> {
    let mut long = sizes.iter().copied().filter(|&size| size != 1);
    let count = long.clone().count();
    let last = long.next_back()?;
    let smallest_other = long.clone().min()?;
    if sizes.last() == Some(&1) {
        return Some("the last axis has one sample and was left out".to_owned());
    }
    let is_short = match count {
        // Volumes with so few samples along x are rarer than channels in this place.
        4.. => smallest_other > last,
        _ => smallest_other >= last.saturating_mul(2),
    };
    if last > 4 || !is_short {
        return None;
    }
    Some(match (count, long.next()) {
        (4.., Some(steps)) => {
            format!("{last} samples along x and {steps} steps: are channels last? expected axes time, z, y, x")
        }
        _ => format!("{last} samples along x: are these channels of an image? expected axes z, y, x"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named<'a>(axes: &[(&'a str, u64)]) -> Vec<AxisFacts<'a>> {
        let facts = |&(name, size): &(&'a str, u64)| AxisFacts {
            size,
            name: Some(name).filter(|name| !name.is_empty()),
            ..AxisFacts::default()
        };
        axes.iter().map(facts).collect()
    }

    fn found(axes: &[(&str, u64)]) -> AxisRoles {
        assign(&named(axes)).expect("a volume")
    }

    #[test]
    fn names_say_what_axes_are() {
        for (axes, space, time, channel) in [
            (vec![("x", 4), ("y", 5), ("z", 6)], [0, 1, 2], None, None),
            (vec![("lon", 4), ("lat", 5), ("lev", 6)], [0, 1, 2], None, None),
            (vec![("z", 6), ("t", 3), ("y", 5), ("x", 4)], [3, 2, 0], Some(1), None),
            (
                vec![("time", 3), ("depth", 6), ("lat", 5), ("lon", 4)],
                [3, 2, 1],
                Some(0),
                None,
            ),
            (vec![("depth", 6), ("height", 5), ("width", 4)], [2, 1, 0], None, None),
            (vec![("z", 6), ("y", 5), ("x", 4), ("c", 3)], [2, 1, 0], None, Some(3)),
            (
                vec![
                    ("Time", 2),
                    ("bottom_top", 6),
                    ("south_north", 5),
                    ("west_east_stag", 4),
                ],
                [3, 2, 1],
                Some(0),
                None,
            ),
            (
                vec![
                    ("number", 3),
                    ("time", 2),
                    ("level", 6),
                    ("latitude", 5),
                    ("longitude", 4),
                ],
                [4, 3, 2],
                Some(1),
                Some(0),
            ),
            (vec![("c", 1), ("x", 4), ("y", 5), ("z", 6)], [1, 2, 3], None, None),
        ] {
            let roles = found(&axes);
            assert_eq!(
                (roles.space, roles.time, roles.channel),
                (space, time, channel),
                "{axes:?}"
            );
            assert!(roles.notices.is_empty(), "{axes:?}: {:?}", roles.notices);
        }
    }

    #[test]
    fn what_is_left_is_assumed_with_a_notice() {
        let roles = found(&[("", 6), ("", 5), ("", 7)]);
        assert_eq!(roles.space, [2, 1, 0]);
        assert!(
            roles.notices[0].contains("does not say what its axes are: z, y, x"),
            "{:?}",
            roles.notices
        );
        let roles = found(&[("plume", 6), ("lat", 5), ("lon", 7)]);
        assert_eq!(roles.space, [2, 1, 0]);
        assert!(roles.notices[0].contains("\"plume\" as z"), "{:?}", roles.notices);
        let roles = found(&[("", 16), ("", 20), ("", 24), ("", 3)]);
        assert_eq!((roles.space, roles.time), ([3, 2, 1], Some(0)));
        assert!(
            roles.notices[1].contains("3 samples along x and 16 steps"),
            "{:?}",
            roles.notices
        );
        let roles = found(&[("time", 9), ("lat", 5), ("lon", 7)]);
        assert_eq!((roles.space, roles.time), ([2, 1, 0], None));
        assert!(
            roles.notices[0].contains("z of the volume is time"),
            "{:?}",
            roles.notices
        );
    }

    #[test]
    fn attributes_count_more_than_names() {
        let mut axes = named(&[("z", 6), ("y", 5), ("x", 7)]);
        axes[0].units = Some("degrees_east");
        axes[2].standard_name = Some("height");
        let roles = assign(&axes).expect("a volume");
        assert_eq!(roles.space, [0, 1, 2]);
        axes[1].stated = Some(Role::Z);
        assert_eq!(assign(&axes).expect("a volume").space, [0, 2, 1]);
    }

    #[test]
    fn what_is_no_volume_is_refused() {
        for axes in [
            vec![("y", 5), ("x", 4), ("c", 3)],
            vec![("y", 5), ("x", 4)],
            vec![("", 2), ("", 2), ("", 2), ("", 2), ("", 2)],
        ] {
            let why = assign(&named(&axes)).expect_err("no volume");
            assert!(why.contains("expected 3 axes in space"), "{why}");
        }
    }

    #[test]
    fn a_short_last_axis_is_doubted() {
        assert!(doubt_of_order(&[16, 20, 24]).is_none());
        assert!(doubt_of_order(&[16, 20, 24, 3]).is_some_and(|why| why.contains("channels last")));
        assert!(doubt_of_order(&[480, 640, 3]).is_some_and(|why| why.contains("channels of an image")));
        assert!(doubt_of_order(&[5, 6, 7, 4]).is_some_and(|why| why.contains("channels last")));
        assert!(doubt_of_order(&[5, 6, 4]).is_none());
        assert!(doubt_of_order(&[16, 20, 24, 1]).is_some_and(|why| why.contains("left out")));
        assert!(doubt_of_order(&[2, 2, 2]).is_none());
    }
}
