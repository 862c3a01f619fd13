//! Defaults of requests that do not depend on earlier edits: those of the command line, batch jobs and REST. docs/command-line.md has a
//! table of these defaults.

use super::{Edit, EditError, FeatureName, View};

/// Weight of a feature that a request names without a weight.
const FEATURE_ALPHA: f32 = 0.3;

impl View {
    /// Returns the view of a request: its edit, applied to defaults. The defaults are the same for all volumes, and do not depend on the
    /// view with which a volume opens in a viewer. Only the isovalue depends on the volume: if the edit has none, it is the field's opening
    /// isovalue.
    ///
    /// # Errors
    /// A value out of its range, or a field that the volume does not have.
    pub fn requested(edit: &Edit, fields: &[&str]) -> Result<Self, EditError> {
        let view = Self::plain(fields).apply(&edit.clone().with_default_guards(), fields)?;
        let alpha = match (edit.alpha, &view.feature) {
            (Some(alpha), _) => alpha,
            (None, FeatureName::None) => 0.0,
            (None, _) => FEATURE_ALPHA,
        };
        Ok(Self { alpha, ..view })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quality::{MaxError, MesherName, TopologyName};

    fn requested(edit: &str) -> View {
        let edit = serde_json::from_str(edit).unwrap();
        View::requested(&edit, &["t1", "gm"]).unwrap()
    }

    #[test]
    fn defaults_are_those_of_the_table() {
        let view = requested("{}");
        assert_eq!((view.iso, view.field.as_str(), view.mask), (None, "t1", None));
        assert_eq!(
            (view.feature, view.feature_range, view.alpha),
            (FeatureName::None, None, 0.0)
        );
        assert_eq!((view.beta, view.error, view.budget), (0.02, None, None));
        assert_eq!((view.min_part, view.parts), (0.0, None));
        assert_eq!((view.max_error, view.topology), (MaxError::Auto, TopologyName::Auto));
        assert_eq!(
            (view.mesher, view.cap, view.max_level.get()),
            (MesherName::Dual, false, 5)
        );
        assert!(view.interest.is_empty());
    }

    #[test]
    fn a_feature_has_a_weight_and_beta_alone_turns_off_the_guards() {
        assert_eq!(requested(r#"{"feature":"gm"}"#).alpha, FEATURE_ALPHA);
        assert_eq!(requested(r#"{"feature":"gm","alpha":0.7}"#).alpha, 0.7);
        assert_eq!(requested(r#"{"feature":"none"}"#).alpha, 0.0);
        assert_eq!(requested(r#"{"alpha":0.7}"#).alpha, 0.7);
        let cut = requested(r#"{"beta":0.02}"#);
        assert_eq!((cut.max_error, cut.topology), (MaxError::None, TopologyName::Free));
    }
}
