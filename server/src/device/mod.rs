//! Selection of the device, and the check that it computes correctly.
//!
//! Drivers crash, hang and compile kernels wrongly. So this process neither lists nor tries a device that it does not know: child processes
//! do ([`child`]). One of them checks each combination of device, driver version and isopeel version at its first use. Others compile its
//! kernels at the same time, which the drivers keep on disk. Verdicts are kept ([`verdicts`]).
//!
//! - [`setup`]: ways to use a device, the workarounds among them.
//! - [`child`]: what a child process does; [`run`]: how its parent sees it.
//! - [`prepare`]: from a selector to a device that passed; [`proven`]: what has passed while the rest of a check runs.
//! - [`cache`]: the folder of compiled kernels and verdicts.

pub mod cache;
pub mod child;
mod listing;
pub mod prepare;
mod proven;
mod run;
pub mod setup;
mod verdicts;

pub use listing::{Listed, Unlisted, list};
pub use prepare::{Checked, DeviceFailure, Prepared, Rest, Unprepared, Wanted, check_all, prepare};
pub use proven::Proven;
pub use run::Ended;
