//! Parts of the surface that are chosen by positions: hidden, or kept alone.

use isopeel_kernels::ChosenParts;
use serde::{Deserialize, Serialize};

use super::error::EditError;
use super::interest::triple;

/// Maximum number of positions. It is small, because each position is compared with the part of every vertex.
const MAX_POSITIONS: usize = 64;

/// Parts (connected components) of the surface. Each position, in world coordinates, chooses the part whose surface is nearest to it; if
/// there is no surface in the two cells around it, the position chooses nothing. 1 to 64 positions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "typescript", derive(ts_rs::TS), ts(rename = "ChosenParts"))]
#[serde(rename_all = "camelCase")]
pub enum ChosenPartsJson {
    /// These parts are removed.
    Hide(Vec<[f64; 3]>),
    /// All other parts are removed.
    Keep(Vec<[f64; 3]>),
}

impl ChosenPartsJson {
    fn name_and_positions(&self) -> (&'static str, &[[f64; 3]]) {
        match self {
            Self::Hide(positions) => ("hide", positions),
            Self::Keep(positions) => ("keep", positions),
        }
    }

    /// Checks the positions.
    pub(super) fn check(&self) -> Result<(), EditError> {
        let refuse = |why| Err(EditError { field: "parts", why });
        let (name, positions) = self.name_and_positions();
        if !(1..=MAX_POSITIONS).contains(&positions.len()) {
            return refuse(format!(
                "{name} has {} positions, expected 1 to {MAX_POSITIONS}, or null instead of parts: all are shown",
                positions.len()
            ));
        }
        match positions
            .iter()
            .position(|position| !position.iter().all(|x| x.is_finite()))
        {
            Some(i) => refuse(format!(
                "position {i} of {name} is {:?}, expected finite numbers",
                positions[i]
            )),
            None => Ok(()),
        }
    }

    /// Converts to the kernels' type. `index_of` maps a position in the world to the volume's index space, or to `None` outside the volume.
    pub fn to_kernel(&self, index_of: impl Fn([f64; 3]) -> Option<[f32; 3]>) -> ChosenParts {
        let indices = |positions: &[[f64; 3]]| positions.iter().copied().map(&index_of).collect();
        match self {
            Self::Hide(positions) => ChosenParts::Hide(indices(positions)),
            Self::Keep(positions) => ChosenParts::Keep(indices(positions)),
        }
    }
}

/// Parses a position of the command line, `X,Y,Z`.
///
/// # Errors
/// The text that was found, and the expected form.
pub fn parse_position(text: &str) -> Result<[f64; 3], String> {
    let finite = triple(text).filter(|position| position.iter().all(|x| x.is_finite()));
    finite.ok_or_else(|| format!("{text:?}, expected three numbers X,Y,Z, such as 10,-20.5,30"))
}

#[cfg(test)]
mod tests {
    use isopeel_kernels::ChosenParts;

    use super::{ChosenPartsJson, parse_position};

    #[test]
    fn what_is_wrong_is_named() {
        let good = [1.0, -2.0, 3.5];
        assert!(ChosenPartsJson::Hide(vec![good; 64]).check().is_ok());
        for (parts, why) in [
            (
                ChosenPartsJson::Hide(Vec::new()),
                "parts: hide has 0 positions, expected 1 to 64, or null instead of parts: all are shown",
            ),
            (
                ChosenPartsJson::Keep(vec![good; 65]),
                "parts: keep has 65 positions, expected 1 to 64, or null instead of parts: all are shown",
            ),
            (
                ChosenPartsJson::Keep(vec![good, [0.0, f64::INFINITY, 1.0]]),
                "parts: position 1 of keep is [0.0, inf, 1.0], expected finite numbers",
            ),
        ] {
            assert_eq!(parts.check().expect_err(why).to_string(), why);
        }
    }

    #[test]
    fn json_has_one_of_both_lists() {
        let hide = ChosenPartsJson::Hide(vec![[1.0, 2.0, -3.5]]);
        let json = r#"{"hide":[[1.0,2.0,-3.5]]}"#;
        assert_eq!(serde_json::to_string(&hide).expect("JSON"), json);
        assert_eq!(serde_json::from_str::<ChosenPartsJson>(json).expect("parsed"), hide);
        for bad in [
            "{}",
            r#"{"hide":[[1,2,3]],"keep":[[1,2,3]]}"#,
            r#"{"show":[[1,2,3]]}"#,
            r#"{"hide":[[1,2]]}"#,
            r#"{"hide":[1,2,3]}"#,
            r#"{"keep":null}"#,
            "[[1,2,3]]",
            r#""hide""#,
        ] {
            assert!(serde_json::from_str::<ChosenPartsJson>(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn the_kernels_get_indices_in_order() {
        let inside = |[x, y, z]: [f64; 3]| (x >= 0.0).then_some([x as f32 / 2.0, y as f32, z as f32]);
        let keep = ChosenPartsJson::Keep(vec![[2.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]);
        assert_eq!(
            keep.to_kernel(inside),
            ChosenParts::Keep(vec![Some([1.0, 1.0, 0.0]), None])
        );
    }

    #[test]
    fn positions_on_the_command_line_are_three_numbers() {
        assert_eq!(parse_position("10,-20.5,3e1"), Ok([10.0, -20.5, 30.0]));
        for bad in ["", "1,2", "1,2,3,4", "1,2,x", "1 2 3", "nan,0,0", "1,inf,0"] {
            let error = parse_position(bad).expect_err(bad);
            assert!(
                error.starts_with(&format!("{bad:?}, expected three numbers X,Y,Z")),
                "{error}"
            );
        }
    }
}
