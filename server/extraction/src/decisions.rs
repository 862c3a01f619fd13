//! Outcome for a view that an error or a budget decides: a cut of the vertex tree, a cut of cubes, or a refusal.

use std::sync::Arc;

use isopeel_kernels::{Cut, CutParams, Surface};

use super::WorkError;

/// A surface of a view that an error or a budget decides.
pub(crate) enum Decided {
    Tree(Surface),
    Cubes {
        params: CutParams,
        cut: Arc<Cut>,
        /// The tree has not been tried yet.
        can_improve: bool,
    },
}

/// Returns the milder of two refusals of a view: the one of the tree's cut, if there is a tree, or the one of the cut of cubes. The milder
/// one names the smaller surface.
pub(crate) fn lesser(tree: Option<WorkError>, cubes: WorkError) -> WorkError {
    match (&tree, &cubes) {
        (Some(WorkError::OverBudget { minimum, .. }), WorkError::OverBudget { minimum: of_cubes, .. })
            if minimum < of_cubes => {}
        (
            Some(WorkError::TooManyTriangles { triangles, .. }),
            WorkError::TooManyTriangles {
                triangles: of_cubes, ..
            },
        ) if triangles < of_cubes => {}
        // With a larger budget the tree's cut is accepted; the cut of cubes exceeds the limit whatever the budget.
        (Some(WorkError::OverBudget { .. }), WorkError::TooManyTriangles { .. }) => {}
        _ => return cubes,
    }
    tree.unwrap_or(cubes)
}

/// Outcome of cutting the vertex tree for a view.
pub(crate) enum TreeCut {
    Made(Surface),
    /// Even the smallest cut that keeps the guards exceeds the budget or the server's limit.
    Refused(WorkError),
    /// There is no space for a tree on this device.
    NoTree,
}

#[cfg(test)]
mod tests {
    use super::{WorkError, lesser};

    #[test]
    fn a_view_that_is_refused_twice_is_told_the_smaller_minimum() {
        let over = |minimum| WorkError::OverBudget { minimum, budget: 9 };
        let large = |triangles| WorkError::TooManyTriangles { triangles, ceiling: 20 };
        let suggested = |tree, cubes| lesser(tree, cubes).suggested_triangles();
        assert_eq!(suggested(Some(over(30)), over(40)), Some(30));
        assert_eq!(suggested(Some(over(40)), over(30)), Some(30));
        assert_eq!(suggested(None, over(30)), Some(30));
        assert_eq!(suggested(Some(over(30)), large(99)), Some(30));
        assert_eq!(suggested(Some(large(50)), large(99)), Some(20));
        assert!(matches!(
            lesser(Some(large(50)), over(30)),
            WorkError::OverBudget { .. }
        ));
    }
}
