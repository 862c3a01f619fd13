//! Programs that have passed a check that is still running.

use std::collections::HashSet;

use serde::{Deserialize, Serialize};
use tokio::sync::watch;

/// Programs that have passed, shared by the thread that follows the check and the threads that use the device.
#[derive(Default)]
pub struct Proven(watch::Sender<CheckState>);

/// State of a check that may be still running.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CheckState {
    /// Programs that have passed.
    pub programs: HashSet<String>,
    /// Outcome of the check, once it has ended: all programs have passed, or none may be used.
    pub ended: Option<Result<(), String>>,
}

impl CheckState {
    fn has_passed(&self, program: &str) -> Result<bool, String> {
        match &self.ended {
            Some(ended) => ended.clone().map(|()| true),
            None => Ok(self.programs.contains(program)),
        }
    }
}

impl Proven {
    /// Adds programs that have passed.
    pub fn add(&self, programs: Vec<String>) {
        self.0.send_modify(|state| state.programs.extend(programs));
    }

    /// Records the end of the check, and its error if it failed.
    pub fn end(&self, ended: Result<(), String>) {
        self.0.send_modify(|state| state.ended = Some(ended));
    }

    /// Returns the state of the check.
    pub fn state(&self) -> CheckState {
        self.0.borrow().clone()
    }

    /// Waits until the state differs from `last`, and returns it.
    pub async fn after(&self, last: &CheckState) -> CheckState {
        let mut states = self.0.subscribe();
        // The sender lives as long as `self`, so waiting cannot fail.
        let changed = states.wait_for(|state| state != last).await.map(|state| state.clone());
        changed.unwrap_or_default()
    }

    /// Replaces the state by that of a check which another process follows.
    pub fn set(&self, state: CheckState) {
        self.0.send_replace(state);
    }

    /// Whether this program has passed. All programs have passed once the check has succeeded.
    ///
    /// # Errors
    /// The error of a failed check. It may concern another program.
    pub fn has_passed(&self, program: &str) -> Result<bool, String> {
        self.0.borrow().has_passed(program)
    }

    /// Waits until a program has passed, or the check has failed.
    pub async fn settled(&self, program: &str) {
        let mut states = self.0.subscribe();
        // The sender lives as long as `self`, so waiting cannot fail.
        let _ = states.wait_for(|state| state.has_passed(program) != Ok(false)).await;
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::time::Duration;

    use super::*;

    #[tokio::test]
    async fn a_program_waits_until_it_or_all_have_passed() {
        let proven = Arc::new(Proven::default());
        proven.add(vec!["dual.cl".to_owned()]);
        proven.settled("dual.cl").await;
        assert_eq!(proven.has_passed("dual.cl"), Ok(true));
        assert_eq!(proven.has_passed("tree.cl"), Ok(false));
        let waits = Arc::clone(&proven);
        let waiting = tokio::spawn(async move { waits.settled("tree.cl").await });
        proven.add(vec!["fit.cl".to_owned()]);
        tokio::time::sleep(Duration::from_millis(20)).await;
        assert!(!waiting.is_finished());
        proven.add(vec!["tree.cl".to_owned()]);
        waiting.await.expect("no panic");
        assert_eq!(proven.has_passed("tree.cl"), Ok(true));
        proven.end(Err("stage curve is wrong".to_owned()));
        for program in ["dual.cl", "curve.cl"] {
            proven.settled(program).await;
            assert_eq!(proven.has_passed(program), Err("stage curve is wrong".to_owned()));
        }
    }
}
