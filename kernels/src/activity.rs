//! What an engine does now, for another thread that watches whether the driver is stuck.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// What an engine does now.
#[derive(Debug, Default)]
pub struct Activity {
    commands: AtomicU64,
    may_compile: AtomicBool,
}

impl Activity {
    /// Returns the number of commands that the driver has accepted or completed so far, and of other signs of progress. If it stays the same
    /// while a request runs, the driver is executing one command, or is stuck.
    pub fn commands(&self) -> u64 {
        self.commands.load(Ordering::Relaxed)
    }

    /// Whether the driver may be compiling, which takes minutes with some drivers: a program is being built, or a variant of a kernel was
    /// launched for the first time and has not ended.
    pub fn may_compile(&self) -> bool {
        self.may_compile.load(Ordering::Relaxed)
    }

    pub(crate) fn begin_compiling(&self) {
        self.may_compile.store(true, Ordering::Relaxed);
    }

    pub(crate) fn command(&self) {
        self.progress();
    }

    /// Records that work goes on, which no command shows: work on the host.
    pub fn progress(&self) {
        self.commands.fetch_add(1, Ordering::Relaxed);
    }

    /// All commands so far have ended.
    pub(crate) fn all_done(&self) {
        self.may_compile.store(false, Ordering::Relaxed);
        self.command();
    }
}
