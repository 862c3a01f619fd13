//! Programs that a check which still runs has proven.

use std::collections::HashSet;
use std::sync::{Condvar, Mutex, PoisonError};

/// Programs that have passed.
#[derive(Default)]
pub struct Proven {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    programs: HashSet<String>,
    /// How the check ended, once it has: then all programs have passed, or none may be used.
    ended: Option<Result<(), String>>,
}

impl Proven {
    /// These have passed.
    pub fn add(&self, programs: Vec<String>) {
        self.change(|state| state.programs.extend(programs));
    }

    /// The check has ended, with what was found wrong if anything was.
    pub fn end(&self, ended: Result<(), String>) {
        self.change(|state| state.ended = Some(ended));
    }

    /// Waits until a program has passed, or all have.
    ///
    /// # Errors
    /// What was found wrong, of this program or of others.
    pub fn wait_for(&self, program: &str) -> Result<(), String> {
        let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let is_open = |state: &mut State| state.ended.is_none() && !state.programs.contains(program);
        let state = self
            .changed
            .wait_while(state, is_open)
            .unwrap_or_else(PoisonError::into_inner);
        state.ended.clone().unwrap_or(Ok(()))
    }

    fn change(&self, change: impl FnOnce(&mut State)) {
        change(&mut self.state.lock().unwrap_or_else(PoisonError::into_inner));
        self.changed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_waits_until_it_or_all_have_passed() {
        let proven = Proven::default();
        proven.add(vec!["dual.cl".to_owned()]);
        assert_eq!(proven.wait_for("dual.cl"), Ok(()));
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| proven.wait_for("tree.cl"));
            proven.add(vec!["fit.cl".to_owned()]);
            std::thread::sleep(std::time::Duration::from_millis(20));
            assert!(!waiting.is_finished());
            proven.add(vec!["tree.cl".to_owned()]);
            assert_eq!(waiting.join().expect("no panic"), Ok(()));
        });
        proven.end(Err("stage curve is wrong".to_owned()));
        for program in ["dual.cl", "curve.cl"] {
            assert_eq!(proven.wait_for(program), Err("stage curve is wrong".to_owned()));
        }
    }
}
