//! Vector fields of a dataset, found by the names of their components.

/// Ends of the names of components. The longest that fits decides; letters count in either case.
const SUFFIXES: [[&str; 3]; 3] = [["x", "y", "z"], ["1", "2", "3"], ["u", "v", "w"]];

/// What may stand before a suffix; nothing between a digit and the name before it would make `t1`, `t2`, `t3` a vector.
const SEPARATORS: [char; 5] = [' ', '_', '-', '.', ':'];

/// The name before a component's suffix and its separator: `flow` of `flow x`, nothing of `u`. Letters may follow the name at once: `Bx`.
fn stem<'a>(name: &'a str, suffix: &str) -> Option<&'a str> {
    let cut = name.len().checked_sub(suffix.len())?;
    let (stem, end) = (name.get(..cut)?, name.get(cut..)?);
    if !end.eq_ignore_ascii_case(suffix) {
        return None;
    }
    let is_digit = suffix.starts_with(|c: char| c.is_ascii_digit());
    let is_apart = stem.ends_with(SEPARATORS);
    // `velocity` does not end in a component `y`; `vx` and `Bx` do.
    let is_short = !is_digit && stem.chars().count() <= 1;
    (is_apart || is_short).then_some(stem)
}

/// Triples of fields that are the components of vectors along x, y, z: `flow x`, `flow y`, `flow z` (or 1, 2, 3, or u, v, w, behind a
/// space, `_`, `-`, `.` or `:`), `vx`, `vy`, `vz`, or `u`, `v`, `w`. A coordinate alone, `x`, `y`, `z`, is no component.
pub fn vectors<'a>(fields: &[&'a str]) -> Vec<[&'a str; 3]> {
    let mut found = Vec::new();
    for [x, y, z] in SUFFIXES {
        for first in fields {
            let Some(stem_of_first) = stem(first, x) else { continue };
            if stem_of_first.is_empty() && x != "u" {
                continue;
            }
            let other = |suffix| {
                let has = |field: &&&'a str| stem(field, suffix) == Some(stem_of_first);
                fields.iter().find(has).copied()
            };
            // Four channels and more are no vector in space.
            if x == "1" && other("4").is_some() {
                continue;
            }
            if let (Some(second), Some(third)) = (other(y), other(z)) {
                found.push([*first, second, third]);
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::vectors;

    #[test]
    fn components_are_found_by_their_names() {
        assert_eq!(vectors(&["p", "u", "v", "w"]), [["u", "v", "w"]]);
        assert_eq!(
            vectors(&["flow z", "flow x", "flow y"]),
            [["flow x", "flow y", "flow z"]]
        );
        assert_eq!(vectors(&["B_1", "B_2", "B_3"]), [["B_1", "B_2", "B_3"]]);
        assert_eq!(vectors(&["Vx", "Vy", "Vz", "x", "y", "z"]), [["Vx", "Vy", "Vz"]]);
        assert_eq!(vectors(&["U", "V", "W", "wind.u", "wind.v", "wind.w"]).len(), 2);
    }

    #[test]
    fn other_names_are_no_vectors() {
        assert!(vectors(&["u", "v"]).is_empty());
        assert!(vectors(&["t1", "t2", "t3"]).is_empty());
        assert!(vectors(&["channel 1", "channel 2", "channel 3", "channel 4"]).is_empty());
        assert!(vectors(&["x", "y", "z"]).is_empty());
        assert!(vectors(&["matrix", "matriy", "matriz"]).is_empty());
        assert!(vectors(&["ä", "öx", "üy"]).is_empty());
    }
}
