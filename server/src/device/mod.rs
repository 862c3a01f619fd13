//! Selection of the device, and the check that it computes correctly.
//!
//! Drivers crash, hang and compile kernels wrongly. So child processes ([`child`]) list the devices and check unknown ones; this process
//! does neither. A combination of device, driver version and isopeel version is checked at its first use. Meanwhile other children compile
//! the kernels, and the drivers cache them on disk. Verdicts are stored ([`verdicts`]).
//!
//! - [`setup`]: identity of a device, and workarounds for driver faults.
//! - [`child`]: the side of the child process; [`run`]: the side of its parent.
//! - [`building`]: the child that checks a device, and the children that compile its kernels.
//! - [`prepare`]: selects a device and checks it; [`proven`]: programs that have passed while the check still runs.
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
pub use proven::{CheckState, Proven};
pub use run::Ended;
pub(crate) use run::{describe, end_with_parent, not_started, program, was_killed};
