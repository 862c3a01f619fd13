//! Selection of the device, and the check that it computes correctly.
//!
//! Drivers crash, hang and compile kernels wrongly. So this process does not list devices, and does not try unknown ones: child processes
//! ([`child`]) do both. One child checks each combination of device, driver version and isopeel version at its first use. Other children
//! compile its kernels at the same time, and the drivers cache them on disk. Verdicts are stored ([`verdicts`]).
//!
//! - [`setup`]: ways to use a device, the workarounds among them.
//! - [`child`]: what a child process does; [`run`]: how its parent sees it.
//! - [`building`]: the check in a child process, and the builders beside it.
//! - [`prepare`]: selects a device and checks it; [`proven`]: programs that have passed a check that is still running.
//! - [`cache`]: the folder of compiled kernels and verdicts.

mod building;
pub mod cache;
pub mod child;
mod listing;
pub mod prepare;
mod proven;
mod run;
pub mod setup;
mod verdicts;

pub use listing::{Listed, Unlisted, list};
pub use prepare::{Checked, DeviceFailure, DeviceRequirements, PendingCheck, Prepared, Unprepared, check_all, prepare};
pub use proven::Proven;
pub use run::Ended;
