//! Edits and time steps that have not come into force.

use crate::view::quality::Budget;
use crate::view::{Edit, View};
use crate::volumes::VolumeStep;

/// Edits of a surface that are kept one by one while they wait, so that a bad one among them takes no other one with it.
pub(super) const MAX_KEPT_EDITS: usize = 64;

/// An edit that waits.
#[derive(Clone)]
pub(super) struct KeptEdit {
    pub edit: Edit,
    /// The time step that was in force, or on its way, when it came.
    pub at: VolumeStep,
    /// Place among the edits of the connection, from 1.
    pub number: u64,
    /// Whether its surface is made when it comes into force: not after a `cancel`.
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
    /// As the edits left it.
    pub view: View,
    /// The time step whose values fill those that the view leaves open.
    pub at: VolumeStep,
    /// The last budget that one of the edits has named. A later one may have left the surface without any.
    pub named: Option<NamedBudget>,
    /// Number of the last edit.
    pub edit: u64,
    /// Whether the surface is made then: not after a `cancel`.
    pub is_made: bool,
    /// The query to the device has failed; the next edit retries it.
    pub is_paused: bool,
    /// The edits that led to the view from the one in force; empty if there were more than [`MAX_KEPT_EDITS`].
    pub edits: Vec<KeptEdit>,
    /// Edits that are applied one by one after this one has come into force or was found to be invalid: they were resolved together before.
    pub queue: Vec<KeptEdit>,
}

/// A time step that has not come into force.
pub(super) struct PendingStep {
    pub volume: VolumeStep,
    /// Number of the last edit before a `cancel`: surfaces that no later edit has changed are not made then. `None`: no `cancel` came.
    pub cancelled_after: Option<u64>,
}

impl PendingView {
    /// The view once all edits are applied that wait.
    pub(super) fn last_view(&self, fields: &[&str]) -> View {
        self.with_queue(fields).0
    }

    /// The last budget that one of the edits that wait has named.
    pub(super) fn last_named(&self, fields: &[&str]) -> Option<NamedBudget> {
        self.with_queue(fields).1
    }

    /// The view and the last named budget once all edits are applied that wait. A bad one among them changes nothing.
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

    /// Number of the first edit that waits, or of the last one if there were too many to keep.
    pub(super) fn first_edit(&self) -> u64 {
        self.edits.first().map_or(self.edit, |first| first.number)
    }

    /// Nothing is made when it comes into force.
    pub(super) fn cancel(&mut self) {
        self.is_made = false;
        let kept = self.edits.iter_mut().chain(&mut self.queue);
        kept.for_each(|kept| kept.is_made = false);
    }

    /// Whether the values that were resolved for `asked` hold for this view, too.
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
