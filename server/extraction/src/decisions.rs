//! Outcome for a view that an error or a budget decides: a cut of the vertex tree, a cut of cubes, or a refusal.

use std::sync::Arc;

use isopeel_kernels::{Cut, CutParams, TreeRegions, TreeSurface};

use super::WorkError;

/// How a cut of the tree is made.
#[derive(Clone, Copy, Default)]
pub(crate) struct TreeMaking<'a> {
    /// Maximum triangles.
    pub ceiling: u64,
    /// Whether the error is measured.
    pub state_error: bool,
    /// Regions of the cut that the client shows. Only regions that differ from them are made.
    pub shown: Option<&'a TreeRegions>,
}

impl TreeMaking<'_> {
    /// Makes the whole surface, of at most this number of triangles.
    pub(crate) fn whole(ceiling: u64) -> Self {
        Self {
            ceiling,
            ..Self::default()
        }
    }
}

/// A surface of a view that an error or a budget decides.
pub(crate) enum Decided {
    Tree(Box<TreeSurface>),
    Cubes {
        params: CutParams,
        cut: Arc<Cut>,
        /// Whether the tree has not been tried yet.
        can_improve: bool,
    },
}

/// Returns the milder of two refusals of a view: that of the cut of the tree, if there is a tree, or that of the cut of cubes. The milder
/// refusal names the smaller surface.
pub(crate) fn milder_refusal(tree: Option<WorkError>, cubes: WorkError) -> WorkError {
    match (&tree, &cubes) {
        (
            Some(WorkError::OverBudget { minimum, .. }),
            WorkError::OverBudget {
                minimum: cubes_minimum, ..
            },
        ) if minimum < cubes_minimum => {}
        (
            Some(WorkError::TooManyTriangles { triangles, .. }),
            WorkError::TooManyTriangles {
                triangles: cubes_triangles,
                ..
            },
        ) if triangles < cubes_triangles => {}
        // With a larger budget the cut of the tree would be accepted. The cut of cubes exceeds the server's limit whatever the budget is.
        (Some(WorkError::OverBudget { .. }), WorkError::TooManyTriangles { .. }) => {}
        _ => return cubes,
    }
    tree.unwrap_or(cubes)
}

/// Outcome of cutting the vertex tree for a view.
pub(crate) enum TreeCut {
    Made(Box<TreeSurface>),
    /// Even the smallest cut that keeps the guards exceeds the budget or the server's limit.
    Refused(WorkError),
    /// There is no space for a tree on this device.
    NoTree,
}

#[cfg(test)]
mod tests {
    use super::{WorkError, milder_refusal};

    #[test]
    fn a_view_that_is_refused_twice_is_told_the_smaller_minimum() {
        let over = |minimum| WorkError::OverBudget { minimum, budget: 9 };
        let large = |triangles| WorkError::TooManyTriangles { triangles, ceiling: 20 };
        let suggested = |tree, cubes| milder_refusal(tree, cubes).suggested_triangles();
        assert_eq!(suggested(Some(over(30)), over(40)), Some(30));
        assert_eq!(suggested(Some(over(40)), over(30)), Some(30));
        assert_eq!(suggested(None, over(30)), Some(30));
        assert_eq!(suggested(Some(over(30)), large(99)), Some(30));
        assert_eq!(suggested(Some(large(50)), large(99)), Some(20));
        assert!(matches!(
            milder_refusal(Some(large(50)), over(30)),
            WorkError::OverBudget { .. }
        ));
    }
}
