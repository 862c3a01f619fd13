//! Names of features: `none`, a field, a feature computed from the shown field, or one of three fields.

use isopeel_kernels::{DerivedFeature, VectorFeature};

use serde::{Deserialize, Serialize};

use super::error::{EditError, quoted};
use super::expression::FieldExpression;

/// The feature that importance depends on in addition to smoothness.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum FeatureName {
    /// No feature.
    None,
    /// A feature that is computed from the shown field.
    Derived(DerivedFeature),
    /// A feature that is computed from a vector field.
    Vector(Box<VectorName>),
    /// A field of the same volume, or an expression over its fields.
    Field(String),
}

/// A feature of a vector field by its components: `divergence(u,v,w)`.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct VectorName {
    /// Kind of feature.
    pub feature: VectorFeature,
    /// Fields of the volume, or expressions over them: the components along its axes x, y, z.
    pub components: [String; 3],
    name: String,
}

impl VectorName {
    /// Returns the feature of these components.
    pub fn new(feature: VectorFeature, components: [String; 3]) -> Self {
        let name = format!("{}({})", feature.name(), components.join(","));
        Self {
            feature,
            components,
            name,
        }
    }

    /// Parses `FEATURE(X,Y,Z)` of three fields or expressions; `None` if `name` does not begin with a vector feature and a parenthesis.
    /// Ignores spaces around a name.
    fn find(name: &str, fields: &[&str]) -> Option<Result<Self, EditError>> {
        let (kind, rest) = name.split_once('(')?;
        let feature = *VectorFeature::ALL
            .iter()
            .find(|feature| feature.name() == kind.trim())?;
        let refuse = |why| Some(Err(EditError { field: "feature", why }));
        let Some(list) = rest.trim_end().strip_suffix(')') else {
            return refuse(format!("{name:?}, expected \")\" at its end"));
        };
        let is_field = |name: &&str| fields.contains(name);
        let mut names: Vec<_> = list.split(',').map(str::trim).collect();
        // A field's name may contain any character; an expression may have commas between its parentheses.
        if !names.iter().all(is_field) {
            names = arguments(list);
        }
        let Ok(components) = <[&str; 3]>::try_from(names.as_slice()) else {
            return refuse(format!("{name:?} of {} fields, expected three", names.len()));
        };
        match components.into_iter().find_map(|component| fault_of(component, fields)) {
            Some(why) => refuse(format!("{name:?} of {why}")),
            None => Some(Ok(Self::new(feature, components.map(str::to_owned)))),
        }
    }
}

/// Splits a list at the commas outside of parentheses and quotation marks.
pub fn arguments(list: &str) -> Vec<&str> {
    let (mut depth, mut quote) = (0i32, None);
    let parts = list.split(|c: char| {
        match (quote, c) {
            (Some(end), _) if c == end => quote = None,
            (Some(_), _) => {}
            (None, '"' | '`') => quote = Some(c),
            (None, '(') => depth += 1,
            (None, ')') => depth -= 1,
            _ => {}
        }
        c == ',' && depth == 0 && quote.is_none()
    });
    parts.map(str::trim).collect()
}

/// Returns the fault of a component that is neither a field nor an expression over fields; `None` if it is valid.
fn fault_of(component: &str, fields: &[&str]) -> Option<String> {
    if fields.contains(&component) {
        return None;
    }
    if FieldExpression::may_be(component) {
        return FieldExpression::parse(component, fields, "feature")
            .err()
            .map(|error| error.why);
    }
    Some(format!(
        "{component:?}, expected an expression or one of {}",
        quoted(fields)
    ))
}

/// Multiplies a range by a factor. The result is clamped to finite 32-bit numbers.
fn scaled(range: [f32; 2], factor: f64) -> [f32; 2] {
    range.map(|value| ((f64::from(value) * factor) as f32).clamp(f32::MIN, f32::MAX))
}

impl FeatureName {
    /// Returns the power of length in the unit of the feature's values, relative to the unit of the fields that it is computed from.
    fn length_power(&self) -> i32 {
        match self {
            Self::None | Self::Field(_) => 0,
            Self::Derived(feature) => match feature {
                DerivedFeature::LocalVariance => 0,
                DerivedFeature::GradientMagnitude | DerivedFeature::MeanCurvature => -1,
                DerivedFeature::GaussianCurvature => -2,
            },
            Self::Vector(vector) => match vector.feature {
                VectorFeature::Magnitude => 0,
                VectorFeature::Divergence | VectorFeature::VorticityMagnitude | VectorFeature::Helicity => -1,
                VectorFeature::QCriterion | VectorFeature::Lambda2 => -2,
            },
        }
    }

    /// Converts a range of the feature's values from the device's units, in which lengths are multiples of the smallest spacing, to world
    /// units.
    pub fn range_in_world(&self, range: [f32; 2], smallest: f64) -> [f32; 2] {
        scaled(range, smallest.powi(self.length_power()))
    }

    /// Converts a range of the feature's values to the device's units: the inverse of [`Self::range_in_world`].
    pub fn range_on_device(&self, range: [f32; 2], smallest: f64) -> [f32; 2] {
        scaled(range, smallest.powi(-self.length_power()))
    }

    /// Name of [`FeatureName::None`] in JSON.
    pub const NONE: &str = "none";

    /// Finds a feature by its name in JSON: a field of the volume, or a computed feature. A field takes precedence.
    ///
    /// # Errors
    /// The name is neither a field nor a computed feature.
    pub fn find(name: &str, fields: &[&str]) -> Result<Self, EditError> {
        if fields.contains(&name) {
            return Ok(Self::Field(name.to_owned()));
        }
        if name == Self::NONE {
            return Ok(Self::None);
        }
        let derived = || DerivedFeature::ALL.iter();
        if let Some(&feature) = derived().find(|feature| feature.name() == name) {
            return Ok(Self::Derived(feature));
        }
        if let Some(vector) = VectorName::find(name, fields) {
            return vector.map(|vector| Self::Vector(Box::new(vector)));
        }
        let mut fault = None;
        if FieldExpression::may_be(name) {
            match FieldExpression::parse(name, fields, "feature") {
                Ok(_) => return Ok(Self::Field(name.to_owned())),
                Err(error) => fault = Some(error.why),
            }
        }
        let names: Vec<_> = derived().map(|feature| feature.name()).collect();
        let vector_forms: Vec<_> = VectorFeature::ALL
            .iter()
            .map(|feature| format!("{}(X,Y,Z)", feature.name()))
            .collect();
        let vector_forms: Vec<_> = vector_forms.iter().map(String::as_str).collect();
        Err(EditError {
            field: "feature",
            why: format!(
                "{} expected {:?}, {}, {} or a field: {}",
                fault.map_or_else(
                    || format!("{name:?},"),
                    |fault| format!("{fault}; without an expression")
                ),
                Self::NONE,
                quoted(&names),
                quoted(&vector_forms),
                quoted(fields)
            ),
        })
    }

    /// Returns the name in JSON.
    pub fn as_str(&self) -> &str {
        match self {
            Self::None => Self::NONE,
            Self::Derived(feature) => feature.name(),
            Self::Vector(vector) => &vector.name,
            Self::Field(name) => name,
        }
    }

    /// Returns the fields that the feature is computed from. `shown` is the field of the surface.
    pub fn fields<'a>(&'a self, shown: &'a str) -> Vec<&'a str> {
        match self {
            Self::None => Vec::new(),
            Self::Derived(_) => vec![shown],
            Self::Vector(vector) => vector.components.iter().map(String::as_str).collect(),
            Self::Field(name) => vec![name],
        }
    }

    /// Returns the range of values that is mapped to 0 to 1 if the view sets none, from the minimum and the maximum. For a computed
    /// feature the magnitude of the values counts: if they have both signs, the range begins at 0.
    pub(super) fn own_range(&self, [lo, hi]: [f32; 2]) -> [f32; 2] {
        let is_computed = matches!(self, Self::Derived(_) | Self::Vector(_));
        if is_computed && lo < 0.0 {
            [(-hi).max(0.0), hi.max(-lo)]
        } else {
            [lo, hi]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FIELDS: &[&str] = &["u", "v", "flow z", "divergence(a)"];

    #[test]
    fn components_of_vectors_may_be_expressions() {
        let name = "divergence(0.6*u - 0.8*v, max(u, v) ,\"flow z\" / 2)";
        let found = FeatureName::find(name, FIELDS).expect("a feature");
        let components = ["0.6*u - 0.8*v", "max(u, v)", "\"flow z\" / 2"];
        assert_eq!(found.fields("p"), components);
        assert_eq!(FeatureName::find(found.as_str(), FIELDS).expect("its own name"), found);
        // A name that is like a call is one component all the same.
        let odd = FeatureName::find("helicity(divergence(a),-u,v)", FIELDS).expect("a feature");
        assert_eq!(odd.fields("p"), ["divergence(a)", "-u", "v"]);
        for (name, words) in [
            ("divergence(u, v + w, u)", "\"v + w\", character 5: no field \"w\""),
            ("divergence(u, max(u, v))", "of 2 fields, expected three"),
            (
                "divergence(u, v, w)",
                "of \"w\", expected an expression or one of \"u\"",
            ),
            ("divergence(u, (v, u)", "of 2 fields, expected three"),
        ] {
            let error = FeatureName::find(name, FIELDS).expect_err(name).to_string();
            assert!(error.contains(words), "{name}: {error}");
        }
    }

    #[test]
    fn vectors_are_named_by_their_components() {
        let found = FeatureName::find("divergence( u, v,flow z)", FIELDS).expect("a feature");
        assert_eq!(found.as_str(), "divergence(u,v,flow z)");
        assert_eq!(found.fields("p"), ["u", "v", "flow z"]);
        assert_eq!(FeatureName::find(found.as_str(), FIELDS).expect("its own name"), found);
        let field = FeatureName::find("divergence(a)", FIELDS).expect("a field");
        assert_eq!(field, FeatureName::Field("divergence(a)".into()));
    }

    #[test]
    fn what_is_wrong_with_a_vector_is_said() {
        let why = |name| FeatureName::find(name, FIELDS).expect_err("no feature").why;
        assert!(why("divergence(u,v)").contains("of 2 fields, expected three"));
        assert!(why("divergence(u,v,q)").contains("of \"q\", expected an expression or one of"));
        assert!(why("divergence(u,v,v").contains("expected \")\" at its end"));
        assert!(why("enstrophy(u,v,v)").contains("\"q-criterion(X,Y,Z)\""));
    }

    #[test]
    fn computed_features_of_both_signs_begin_at_zero() {
        let curvature = FeatureName::Derived(DerivedFeature::MeanCurvature);
        assert_eq!(curvature.own_range([-0.25, 2.0]), [0.0, 2.0]);
        assert_eq!(curvature.own_range([-3.0, 2.0]), [0.0, 3.0]);
        assert_eq!(curvature.own_range([-3.0, -1.0]), [1.0, 3.0]);
        assert_eq!(curvature.own_range([1.0, 2.0]), [1.0, 2.0]);
        assert_eq!(FeatureName::Field("u".into()).own_range([-3.0, 2.0]), [-3.0, 2.0]);
    }
}
