//! NeXus in HDF5 (<https://manual.nexusformat.org/classes/base_classes/NXdata.html>): finds the datasets with the positions along the axes
//! of another one.
//!
//! The attribute `axes` of a group of class `NXdata`, or of its signal in files from before 2014, names for each axis a dataset beside the
//! signal, the slowest axis first.

use std::collections::HashMap;

use super::file::{Attributes, Variable, VariableFile};

/// Sets the scales of the variables in NXdata groups. Variables that have scales keep them.
pub(super) fn find_axes(file: &dyn VariableFile, variables: &mut [Variable]) {
    let mut groups: HashMap<String, Attributes> = HashMap::new();
    let lines: HashMap<String, u64> = variables
        .iter()
        .filter_map(|variable| match variable.axes.as_slice() {
            [axis] => Some((variable.path.clone(), axis.size)),
            _ => None,
        })
        .collect();
    let mut used = Vec::new();
    for variable in variables.iter_mut().filter(|variable| variable.axes.len() > 2) {
        let parent = variable
            .path
            .rsplit_once('/')
            .map_or("", |(parent, _)| parent)
            .to_owned();
        let group = groups
            .entry(parent.clone())
            .or_insert_with_key(|parent| file.attributes_of(if parent.is_empty() { "/" } else { parent }));
        if group.text("NX_class") != Some("NXdata") {
            continue;
        }
        let mut names = names_of(group);
        if names.is_empty() {
            names = names_of(&file.attributes_of(&variable.path));
        }
        if names.len() != variable.axes.len() {
            continue;
        }
        for (axis, name) in variable.axes.iter_mut().zip(names) {
            let path = format!("{parent}/{name}");
            if axis.scale.is_none() && lines.get(&path) == Some(&axis.size) {
                axis.label.name.get_or_insert(name);
                axis.dimension = Some(path.clone());
                axis.scale = Some(path.clone());
                used.push(path);
            }
        }
    }
    for variable in variables.iter_mut() {
        variable.is_scale |= used.contains(&variable.path);
    }
}

/// Parses the names in `axes`: several texts, or one text with `:` or `,` between names, with or without brackets.
fn names_of(attributes: &Attributes) -> Vec<String> {
    let texts = attributes.texts("axes");
    let split = |text: &String| {
        let text = text.trim_matches(['[', ']']).to_owned();
        text.split([':', ','])
            .map(|name| name.trim().to_owned())
            .collect::<Vec<_>>()
    };
    match texts {
        [text] => split(text),
        texts => texts.iter().map(|text| text.trim().to_owned()).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::file::Attribute;
    use super::*;

    #[test]
    fn axes_are_a_list_or_one_text() {
        let of = |value| names_of(&Attributes(vec![("axes".to_owned(), value)]));
        let expected = ["qz", "qy", "qx"];
        assert_eq!(of(Attribute::Text("[qz:qy, qx]".to_owned())), expected);
        assert_eq!(of(Attribute::Texts(expected.map(str::to_owned).to_vec())), expected);
        assert!(of(Attribute::Numbers(vec![1.0], None)).is_empty());
    }
}
