//! What the random sequences leave out until the server handles it: the one list to empty.

/// An ingredient of sequences, or a check of what they lead to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ingredient {
    /// Masks that hold at no sample.
    EmptyMasks,
    /// Several surfaces of a connection that have a budget.
    SharedBudgets,
    /// Budgets so small that a surface may fail.
    TightBudgets,
    /// Marching cubes of coarse cuts.
    CoarseMarching,
    /// `maxError` and `topology` that were set, beside a budget.
    GuardsBesideBudgets,
    /// `minPart` and `parts`.
    Parts,
    /// Features that take their own range, on volumes with time steps.
    OwnRangesOfSteps,
    /// Conditions that hold nowhere, which is found while the surface is made.
    LateBadEdits,
    /// A device that is lost.
    LostDevices,
    /// A file that is replaced while a group looks at it.
    ReplacedInGroups,
    /// A series that is rewritten and longer between two looks.
    RewrittenSeries,
    /// The check that surfaces are closed in volumes of a few layers.
    ThinVolumes,
    /// The check that `statistics` counts no more vertices than the chunks have.
    VerticesOfMasks,
    /// The check that no region is sent again that has not changed.
    RepeatedRegions,
    /// The check that a measured maximum keeps a `maxError` that was set.
    MeasuredGuards,
    /// The check that an error suggests the same budget wherever it is found.
    SuggestedTriangles,
    /// The check that an error of a failed generation names its surface.
    SurfaceOfErrors,
}

/// Ingredients that are left out, and the defect that each would find.
const OFF: &[(Ingredient, &str)] = &[
    (
        Ingredient::SuggestedTriangles,
        "suggestions depend on caches and on other surfaces",
    ),
    (
        Ingredient::ThinVolumes,
        "surfaces in one layer of cells have open edges",
    ),
    (Ingredient::EmptyMasks, "a mask without samples is found late"),
    (
        Ingredient::SharedBudgets,
        "a part of the budget depends on what came before",
    ),
    (
        Ingredient::TightBudgets,
        "a cached vertex tree decides whether an edit fails",
    ),
    (
        Ingredient::GuardsBesideBudgets,
        "a cached vertex tree decides whether an edit fails",
    ),
    (
        Ingredient::Parts,
        "a cached vertex tree decides which parts are removed",
    ),
    (
        Ingredient::OwnRangesOfSteps,
        "a range is resolved when the surface is made; the reference would need the step of the edit, not the one shown",
    ),
    (Ingredient::LateBadEdits, "a late `bad-edit` is applied"),
    (Ingredient::LostDevices, "ids of cuts begin again with a new engine"),
    (Ingredient::ReplacedInGroups, "a follower stays on the volume before"),
    (Ingredient::RewrittenSeries, "a longer series keeps its revision"),
    (Ingredient::VerticesOfMasks, "leaves without triangles are counted"),
    (Ingredient::RepeatedRegions, "equal chunks are sent again"),
    (Ingredient::MeasuredGuards, "a measured maximum may exceed the guard"),
    (
        Ingredient::SurfaceOfErrors,
        "errors of failed generations lack `surface`",
    ),
];

impl Ingredient {
    /// Whether sequences have it: unless it is in the list. `ISOPEEL_STATES_ON` names some that they have nevertheless, or `all`.
    pub fn is_on(self) -> bool {
        let on = std::env::var("ISOPEEL_STATES_ON").unwrap_or_default();
        let is_named = on.split(',').any(|name| name == "all" || name == format!("{self:?}"));
        is_named || OFF.iter().all(|&(off, _)| off != self)
    }
}
