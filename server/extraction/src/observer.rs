//! The interface through which a workspace reports events, for counters and timers.

/// Observes the work of a workspace. Calls come from the thread that uses the workspace.
pub trait Observer {
    /// An entry was looked up in the cache of this name.
    fn looked_up(&self, cache: &'static str, is_hit: bool);

    /// A stage of a surface took this time on the device.
    fn stage(&self, stage: &'static str, milliseconds: f64);

    /// The device no longer answers.
    fn device_lost(&self);
}

/// Observes nothing.
pub struct Unobserved;

impl Observer for Unobserved {
    fn looked_up(&self, _cache: &'static str, _is_hit: bool) {}

    fn stage(&self, _stage: &'static str, _milliseconds: f64) {}

    fn device_lost(&self) {}
}
