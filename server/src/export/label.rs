//! The surface around labels of a segmentation. Its field is an expression that is 1 at samples with these labels and 0 elsewhere,
//! optionally smoothed; its isovalue is 0.5.

use isopeel_view::{Edit, EditError};
use isopeel_volumes::{Dataset, Field};

/// Isovalue halfway between samples inside and outside.
const ISO: f32 = 0.5;

/// Returns the edit for the surface around labels, such as `7`, `Hippocampus` or `3,Hippocampus`. The labels are values of the edit's
/// field; if the edit has no field, of the first field that names its labels, or else of the first field. `smoothing` is a standard
/// deviation in samples; 0 disables it.
///
/// # Errors
/// A label that is neither a whole number nor a name of the field, or an edit that has an isovalue.
pub(super) fn around_labels(dataset: &Dataset, labels: &str, smoothing: f32, edit: &Edit) -> Result<Edit, EditError> {
    let refuse = |why| Err(EditError { field: "label", why });
    if edit.iso.is_some() {
        return refuse(format!("{labels:?} beside iso, expected only one of both"));
    }
    let with_names = || dataset.fields.iter().find(|field| !field.labels.is_empty());
    let field = match &edit.field {
        Some(name) => dataset.field(name),
        None => with_names().or(dataset.fields.first()),
    };
    let Some(field) = field else {
        return refuse(format!("{labels:?} of an expression, expected a field of the volume"));
    };
    let quote = if field.name.contains('"') { '`' } else { '"' };
    // The text is first tried as one name, because a name may contain commas.
    let values = match value_of(field, labels.trim()) {
        Ok(value) => vec![value],
        Err(_) => {
            let values = labels.split(',').map(|label| value_of(field, label.trim()));
            match values.collect() {
                Ok(values) => values,
                Err(why) => return refuse(why),
            }
        }
    };
    let comparisons = values
        .iter()
        .map(|value| format!("{quote}{}{quote}=={value}", field.name));
    let condition = comparisons.collect::<Vec<_>>().join("||");
    Ok(Edit {
        iso: Some(ISO),
        field: Some(match smoothing {
            0.0 => format!("if({condition},1,0)"),
            sigma => format!("smooth({sigma},{condition})"),
        }),
        ..edit.clone()
    })
}

/// Returns the value of a label, which the text gives by its number or its name.
fn value_of(field: &Field, label: &str) -> Result<i128, String> {
    if let Ok(value) = label.parse() {
        return Ok(value);
    }
    let named: Vec<i128> = (field.labels.iter())
        .filter(|known| {
            known
                .name
                .as_deref()
                .is_some_and(|name| name.eq_ignore_ascii_case(label))
        })
        .map(|known| known.value)
        .collect();
    match named[..] {
        [value] => Ok(value),
        [] => {
            let names: Vec<&str> = field.labels.iter().filter_map(|known| known.name.as_deref()).collect();
            let known = match names.len() {
                0 => format!("{:?} has no names of labels", field.name),
                1..=12 => format!("names in {:?} are {}", field.name, names.join(", ")),
                count => format!("{:?} has {count} names, such as {}", field.name, names[..12].join(", ")),
            };
            Err(format!("{label:?}, expected a whole number or a name: {known}"))
        }
        [first, second, ..] => Err(format!(
            "{label:?} is the name of {first} and {second}, expected a number"
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isopeel_view::View;
    use isopeel_volumes::{Label, testing};

    fn dataset() -> Dataset {
        let mut dataset = testing::dataset("head", [4; 3], &["t1", "the labels"]);
        let label = |value, name: &str| Label {
            value,
            name: Some(name.to_owned()),
            color: None,
        };
        dataset.fields[1].labels = vec![
            label(3, "Pons"),
            label(17, "Hippocampus, left"),
            label(53, "Twice"),
            label(54, "twice"),
        ];
        dataset
    }

    #[test]
    fn labels_are_numbers_or_names() {
        for (labels, field, expected) in [
            ("7", None, r#"if("the labels"==7,1,0)"#),
            ("pons", None, r#"if("the labels"==3,1,0)"#),
            ("Hippocampus, left", None, r#"if("the labels"==17,1,0)"#),
            (
                "Pons, 7,-1",
                None,
                r#"if("the labels"==3||"the labels"==7||"the labels"==-1,1,0)"#,
            ),
            ("7", Some("t1"), r#"if("t1"==7,1,0)"#),
        ] {
            let edit = Edit {
                field: field.map(str::to_owned),
                ..Edit::default()
            };
            let found = around_labels(&dataset(), labels, 0.0, &edit).unwrap();
            assert_eq!(found.field.as_deref(), Some(expected));
            let view = View::requested(&found, &["t1", "the labels"]).unwrap();
            assert_eq!(view.iso.map(isopeel_kernels::Isovalue::get), Some(0.5));
        }
        let smooth = around_labels(&dataset(), "pons, 7", 0.8, &Edit::default()).unwrap();
        assert_eq!(
            smooth.field.as_deref(),
            Some(r#"smooth(0.8,"the labels"==3||"the labels"==7)"#)
        );
        assert!(View::requested(&smooth, &["t1", "the labels"]).is_ok());
    }

    #[test]
    fn what_is_no_label_is_named() {
        let refused = |labels: &str, edit: Edit| around_labels(&dataset(), labels, 0.0, &edit).unwrap_err().to_string();
        let unknown = refused("Cortex", Edit::default());
        assert!(
            unknown
                .starts_with("label: \"Cortex\", expected a whole number or a name: names in \"the labels\" are Pons"),
            "{unknown}"
        );
        let twice = refused("twice", Edit::default());
        assert_eq!(twice, "label: \"twice\" is the name of 53 and 54, expected a number");
        let iso = Edit {
            iso: Some(1.0),
            ..Edit::default()
        };
        assert_eq!(refused("7", iso), "label: \"7\" beside iso, expected only one of both");
        let of_t1 = Edit {
            field: Some("t1".into()),
            ..Edit::default()
        };
        assert!(refused("Pons", of_t1).ends_with("\"t1\" has no names of labels"));
    }
}
