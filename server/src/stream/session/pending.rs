//! Edits and time steps that have not come into force.

use isopeel_view::quality::Budget;
use isopeel_view::{Edit, FeatureName, View};
use isopeel_volumes::VolumeStep;

/// Maximum number of waiting edits of a surface that are stored one by one. They are stored so that an invalid edit can be rejected
/// without the others.
pub(super) const MAX_WAITING_EDITS: usize = 64;

/// An edit that has not come into force yet.
#[derive(Clone)]
pub(super) struct WaitingEdit {
    pub edit: Edit,
    /// The time step that was pending when the edit came, or else the one that was in force.
    pub step: VolumeStep,
    /// Number of the edit among those of the connection, from 1.
    pub number: u64,
    /// Whether the surface is made when the edit comes into force: not after a `cancel`.
    pub makes_surface: bool,
}

/// The budget that an edit has set, for all surfaces that have one.
#[derive(Clone, Copy)]
pub(super) struct BudgetEdit {
    pub budget: Budget,
    /// Number of the edit: the latest one wins, whichever comes into force first.
    pub edit: u64,
}

impl BudgetEdit {
    /// Returns the budget that an edit has set; `view` is the view after the edit.
    pub(super) fn new(waiting: &WaitingEdit, view: &View) -> Option<Self> {
        let has_budget = waiting.edit.triangles.is_some() || waiting.edit.bytes.is_some();
        let budget = view.budget.filter(|_| has_budget)?;
        Some(Self {
            budget,
            edit: waiting.number,
        })
    }
}

/// Edits of a surface that have not come into force.
#[derive(Clone)]
pub(super) struct PendingView {
    /// The view after the edits.
    pub view: View,
    /// The time step for which the values that the view leaves open are resolved.
    pub step: VolumeStep,
    /// The last budget that one of the edits has set. A later edit may have removed the surface's budget.
    pub budget_edit: Option<BudgetEdit>,
    /// Number of the last edit.
    pub edit: u64,
    /// Whether the surface is made when the view comes into force: not after a `cancel`.
    pub makes_surface: bool,
    /// Whether resolving the view has failed. The next edit retries it.
    pub is_paused: bool,
    /// The edits that led to the view from the one in force; empty if there were more than [`MAX_WAITING_EDITS`].
    pub edits: Vec<WaitingEdit>,
    /// The rest of a list of edits that are applied one by one. The next of them is applied once this view has come into force or was found
    /// to be invalid.
    pub queue: Vec<WaitingEdit>,
}

/// A time step that has not come into force.
pub(super) struct PendingStep {
    pub volume: VolumeStep,
    /// Number of the last edit before a `cancel`; `None` if no `cancel` came. At this step only surfaces that a later edit has changed are
    /// made.
    pub cancelled_after: Option<u64>,
}

impl PendingView {
    /// Returns the view after all waiting edits.
    pub(super) fn last_view(&self, fields: &[&str]) -> View {
        self.with_queue(fields).0
    }

    /// Returns the last budget that a waiting edit has set.
    pub(super) fn last_budget_edit(&self, fields: &[&str]) -> Option<BudgetEdit> {
        self.with_queue(fields).1
    }

    /// Returns the view and the last budget after all waiting edits. An invalid edit among them changes nothing.
    fn with_queue(&self, fields: &[&str]) -> (View, Option<BudgetEdit>) {
        let (mut view, mut budget_edit) = (self.view.clone(), self.budget_edit);
        for waiting in &self.queue {
            if let Ok(edited) = view.apply(&waiting.edit, fields) {
                budget_edit = BudgetEdit::new(waiting, &edited).or(budget_edit);
                view = edited;
            }
        }
        (view, budget_edit)
    }

    /// Whether the range of the feature is still to be resolved, and `view` has the same feature.
    pub(super) fn leaves_range_open(&self, view: &View) -> bool {
        // A derived feature is computed from the field, so another field is another feature.
        let is_derived = matches!(view.feature, FeatureName::Derived(_));
        let is_same_feature = self.view.feature == view.feature && (!is_derived || self.view.field == view.field);
        self.view.feature_range.is_none() && is_same_feature
    }

    /// Returns the number of the first waiting edit, or of the last one if there were too many to keep.
    pub(super) fn first_edit(&self) -> u64 {
        self.edits.first().map_or(self.edit, |first| first.number)
    }

    /// Cancels the making of the surface: the view still comes into force, but no surface of it is made.
    pub(super) fn cancel(&mut self) {
        self.makes_surface = false;
        let edits = self.edits.iter_mut().chain(&mut self.queue);
        edits.for_each(|waiting| waiting.makes_surface = false);
    }

    /// Whether the values that were resolved for `requested` are valid for this view too.
    pub(super) fn resolves_like(&self, requested: &Self) -> bool {
        let inputs = |pending: &Self| {
            let view = &pending.view;
            (
                view.field.clone(),
                view.mask.clone(),
                view.feature.clone(),
                pending.step.key(),
            )
        };
        inputs(self) == inputs(requested)
    }
}
