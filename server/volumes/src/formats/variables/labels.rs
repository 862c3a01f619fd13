//! Descriptions of axes in HDF5 files other than dimension scales.

use super::super::named_axes::Role;
use super::file::{Attributes, AxisLabel};

/// Evaluates labels of dimensions and `axistags` for `count` axes.
pub(super) fn labels(attributes: &Attributes, count: usize) -> Vec<AxisLabel> {
    if let Some(text) = attributes.text("axistags")
        && let Some(tags) = axistags(text).filter(|tags| tags.len() == count)
    {
        return tags;
    }
    let names = attributes.texts("DIMENSION_LABELS");
    let label = |name: Option<&String>| AxisLabel {
        name: name.map(|name| name.trim().to_owned()).filter(|name| !name.is_empty()),
        ..AxisLabel::default()
    };
    (0..count).map(|axis| label(names.get(axis))).collect()
}

/// Parses the axes as vigra and ilastik write them: a list of keys in JSON, the slowest axis first.
fn axistags(text: &str) -> Option<Vec<AxisLabel>> {
    let tags: serde_json::Value = serde_json::from_str(text).ok()?;
    let label = |tag: &serde_json::Value| {
        let key = tag.get("key")?.as_str()?;
        Some(AxisLabel {
            name: Some(key.to_owned()),
            role: match key {
                "x" => Some(Role::X),
                "y" => Some(Role::Y),
                "z" => Some(Role::Z),
                "t" => Some(Role::Time),
                "c" => Some(Role::Channel),
                _ => None,
            },
            resolution: tag
                .get("resolution")
                .and_then(serde_json::Value::as_f64)
                .filter(|resolution| *resolution > 0.0 && resolution.is_finite()),
        })
    };
    tags.get("axes")?.as_array()?.iter().map(label).collect()
}
