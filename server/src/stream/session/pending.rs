//! Edits and time steps that have not come into force.

use isopeel_view::quality::Budget;
use isopeel_view::{Edit, View};
use isopeel_volumes::VolumeStep;

/// Maximum number of edits of a surface that are kept one by one while they wait, so that an invalid one can be rejected without the
/// others.
pub(super) const MAX_KEPT_EDITS: usize = 64;

/// An edit that waits.
#[derive(Clone)]
pub(super) struct KeptEdit {
    pub edit: Edit,
    /// The time step that was in force, or on its way, when it came.
    pub at: VolumeStep,
    /// Place among the edits of the connection, from 1.
    pub number: u64,
    /// Whether the surface is made when the edit comes into force: not after a `cancel`.
    pub is_made: bool,
}

/// A budget that an edit has named, for all surfaces that have one.
#[derive(Clone, Copy)]
pub(super) struct NamedBudget {
    pub budget: Budget,
    /// Number of the edit: the latest one wins, whichever comes into force first.
    pub edit: u64,
}

impl NamedBudget {
    /// Returns the budget that an edit has named; `view` is the view after the edit.
    pub(super) fn of(kept: &KeptEdit, view: &View) -> Option<Self> {
        let is_named = kept.edit.triangles.is_some() || kept.edit.bytes.is_some();
        let budget = view.budget.filter(|_| is_named)?;
        Some(Self {
            budget,
            edit: kept.number,
        })
    }
}

/// Edits of a surface that have not come into force.
#[derive(Clone)]
pub(super) struct PendingView {
    /// The view after the edits.
    pub view: View,
    /// The time step from which the values are resolved that the view leaves open.
    pub at: VolumeStep,
    /// The last budget that one of the edits has named. A later edit may have removed the surface's budget.
    pub named: Option<NamedBudget>,
    /// Number of the last edit.
    pub edit: u64,
    /// Whether the surface is made when the view comes into force: not after a `cancel`.
    pub is_made: bool,
    /// Whether the query to the device has failed; the next edit retries it.
    pub is_paused: bool,
    /// The edits that led to the view from the one in force; empty if there were more than [`MAX_KEPT_EDITS`].
    pub edits: Vec<KeptEdit>,
    /// Edits that are applied one by one after this view has come into force or was found to be invalid. They are left from edits that were
    /// resolved together.
    pub queue: Vec<KeptEdit>,
}

/// A time step that has not come into force.
pub(super) struct PendingStep {
    pub volume: VolumeStep,
    /// Number of the last edit before a `cancel`; `None`: no `cancel` came. A surface that no later edit has changed is not made at this
    /// step.
    pub cancelled_after: Option<u64>,
}

impl PendingView {
    /// Returns the view after all waiting edits.
    pub(super) fn last_view(&self, fields: &[&str]) -> View {
        self.with_queue(fields).0
    }

    /// Returns the last budget that a waiting edit has named.
    pub(super) fn last_named(&self, fields: &[&str]) -> Option<NamedBudget> {
        self.with_queue(fields).1
    }

    /// Returns the view and the last named budget after all waiting edits. An invalid edit among them changes nothing.
    fn with_queue(&self, fields: &[&str]) -> (View, Option<NamedBudget>) {
        let (mut view, mut named) = (self.view.clone(), self.named);
        for kept in &self.queue {
            if let Ok(edited) = view.apply(&kept.edit, fields) {
                named = NamedBudget::of(kept, &edited).or(named);
                view = edited;
            }
        }
        (view, named)
    }

    /// Returns the number of the first waiting edit, or of the last one if there were too many to keep.
    pub(super) fn first_edit(&self) -> u64 {
        self.edits.first().map_or(self.edit, |first| first.number)
    }

    /// Cancels the making of the surface: the view still comes into force, but no surface of it is made.
    pub(super) fn cancel(&mut self) {
        self.is_made = false;
        let kept = self.edits.iter_mut().chain(&mut self.queue);
        kept.for_each(|kept| kept.is_made = false);
    }

    /// Whether the values that were resolved for `asked` are valid for this view too.
    pub(super) fn resolves_like(&self, asked: &Self) -> bool {
        let inputs = |pending: &Self| {
            let view = &pending.view;
            (
                view.field.clone(),
                view.mask.clone(),
                view.feature.clone(),
                pending.at.key(),
            )
        };
        inputs(self) == inputs(asked)
    }
}
