//! Views of a dataset: the view with which viewers open it, and the grid of a view's surface.

use isopeel_geometry::IndexSpace;
use isopeel_view::{Edit, EditError, View};
use isopeel_volumes::{Dataset, Geometry};

/// Returns the edit with which viewers open the dataset, if the dataset has one.
///
/// # Errors
/// The dataset's JSON is no edit.
pub fn opening_edit(dataset: &Dataset) -> Result<Option<Edit>, EditError> {
    let edit = dataset.opening.clone().map(serde_json::from_value).transpose();
    edit.map_err(|error| EditError {
        field: "opening",
        why: error.to_string(),
    })
}

/// Returns the view with which viewers open the dataset.
///
/// # Errors
/// The dataset's JSON is no edit, or the edit does not fit the fields.
pub fn opening_view(dataset: &Dataset) -> Result<View, EditError> {
    View::opening(&dataset.field_names(), opening_edit(dataset)?.as_ref())
}

/// Returns the grid of a view's surface, which a cap pads by one sample on every side, and the positions of its samples in the world.
pub fn view_space(dataset: &Dataset, view: &View) -> (Geometry, IndexSpace) {
    if view.cap {
        dataset.padded_space()
    } else {
        (dataset.geometry, dataset.sample_space())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_demo_opens_with_an_edit_that_fits_it() {
        let demo = isopeel_volumes::demo().expect("the demo");
        let edit = opening_edit(&demo).expect("an edit").expect("one of its own");
        assert_eq!(
            (edit.beta, edit.max_error),
            (None, None),
            "it opens by error, as all volumes do"
        );
        let view = opening_view(&demo).expect("fits");
        assert_eq!((view.field.as_str(), view.feature.as_str()), ("t1", "gm"));
        let points = edit.transfer_function.expect("colours of its own").points;
        assert!(
            points
                .iter()
                .all(|p| p.color.len() == 7 && u32::from_str_radix(&p.color[1..], 16).is_ok())
        );
        let geometry = demo.geometry;
        let (space, _) = view_space(&demo, &view);
        assert_eq!(space, geometry);
        let (capped, _) = view_space(&demo, &View { cap: true, ..view });
        assert_eq!(capped.dims, geometry.dims.map(|samples| samples + 2));
    }
}
