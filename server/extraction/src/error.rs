//! Errors of work on the device.

use std::sync::Arc;
use std::time::Duration;

use isopeel_kernels::DeviceInfo;
use isopeel_kernels::check::CheckError;
use isopeel_view::EditError;
use isopeel_volumes::ReadError;
use serde::{Deserialize, Serialize};

use super::user_time::USER_TIME_PERIOD;

/// Why a device could not be opened.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OpenError {
    /// There is no device, or it does not open.
    #[error(transparent)]
    Device(#[from] isopeel_kernels::Error),
    /// The device computes wrong results.
    #[error("{device} (driver {driver}): {}; `isopeel devices --check` checks it again and looks for a workaround", chain(.why))]
    Check {
        /// Name of the device.
        device: String,
        /// Version of its driver.
        driver: String,
        /// The stage that failed, and how.
        why: Box<CheckError>,
    },
    /// The device must not be used; the text says why, and what to do.
    #[error("{0}")]
    Refused(String),
}

impl OpenError {
    /// Returns the error that a device has failed its check.
    pub fn check(device: &DeviceInfo, why: CheckError) -> Self {
        Self::Check {
            device: device.name.clone(),
            driver: device.driver.clone(),
            why: Box::new(why),
        }
    }

    /// Whether the device could be opened but computes wrong results.
    pub fn has_wrong_results(&self) -> bool {
        matches!(self, Self::Check { why, .. } if matches!(**why, CheckError::Differs { .. }))
    }
}

/// Why a piece of work has no result. Callers react differently to each variant.
#[derive(Debug, thiserror::Error, Serialize, Deserialize)]
#[non_exhaustive]
pub enum WorkError {
    /// The queue is full: try again later.
    #[error("the queue of the device is full, try again in a few seconds")]
    Busy,
    /// A file cannot be read.
    #[error(transparent)]
    Unreadable(#[from] ReadError),
    /// The volumes that one view needs do not fit on the device together.
    #[error("the volumes need {needed_bytes} bytes of device memory, the limit is {limit_bytes}")]
    TooLarge {
        /// Bytes of all fields the view needs.
        needed_bytes: u64,
        /// Maximum bytes of volumes on this device.
        limit_bytes: u64,
    },
    /// Fields of the view were evicted while it was made.
    #[error("fields of the view were evicted while its surface was made: it needs more memory on the device")]
    NotKept,
    /// The host has no memory for this work now.
    #[error(
        "this machine has no memory for the work now, which needs {needed_bytes} bytes: try again in a few seconds"
    )]
    HostBusy {
        /// Bytes that the work would take.
        needed_bytes: u64,
    },
    /// The host will never have memory for this work.
    #[error("the work needs {needed_bytes} bytes of this machine's memory, the limit is {limit_bytes}")]
    TooLargeForHost {
        /// Bytes that the work would take.
        needed_bytes: u64,
        /// Maximum bytes.
        limit_bytes: u64,
    },
    /// The request or its result is larger than what the server and the process of its device can exchange.
    #[error(
        "the work needs more memory than the {limit_bytes} bytes that the server shares with the process of its device: the limits \
         `ulimit -f` and `ulimit -v` of the server are too low"
    )]
    TooLargeToShare {
        /// Maximum bytes.
        limit_bytes: u64,
    },
    /// The surface would be above the server's limit.
    #[error(
        "the surface would have {triangles} triangles, the limit is {ceiling}: ask for a budget of triangles, such as {ceiling}"
    )]
    TooManyTriangles {
        /// Triangles that the surface would have.
        triangles: u64,
        /// Maximum triangles, and the budget that is suggested.
        ceiling: u64,
    },
    /// Every surface of the view exceeds its budget, given the guards that were set.
    #[error(
        "the smallest surface that the guards allow has {minimum} triangles, the budget is {budget}: ask for {minimum} or more"
    )]
    OverBudget {
        /// Triangles of the smallest surface that the guards allow.
        minimum: u64,
        /// Maximum triangles that were asked for.
        budget: u64,
    },
    /// Every surface of the view that was tried takes more bytes than its budget.
    #[error("the smallest surface found takes {minimum} bytes, the budget is {budget}: ask for {minimum} or more")]
    OverBytes {
        /// Bytes of the smallest surface that was made.
        minimum: u64,
        /// Triangles of that surface.
        triangles: u64,
        /// Maximum bytes that were asked for.
        budget: u64,
    },
    /// A question is about the shown surface, but no surface is shown.
    #[error("no surface is shown yet, expected an `edit` first")]
    NothingShown,
    /// Parts are to be removed, but there is no vertex tree to remove them from.
    #[error(
        "minPart, parts: parts are removed from the vertex tree, for which the surface is too large on this device"
    )]
    NoTree(#[source] isopeel_kernels::Error),
    /// The view does not fit the dataset.
    #[error(transparent)]
    Edit(#[from] EditError),
    /// The work took more device time than a request may take.
    #[error("it takes more than {} s of the device's time, which is the limit of a request: ask for a simpler expression", limit.as_secs_f64())]
    TookTooLong {
        /// Maximum time of a request.
        limit: Duration,
    },
    /// The user's computed fields have used up the device time that one user may take.
    #[error(
        "your expressions and distances have taken the {} s of the device's time that one user may take within {} minutes: try again in {} s, or \
         ask for a simpler expression",
        limit.as_secs_f64(),
        USER_TIME_PERIOD.as_secs() / 60,
        wait.as_secs() + 1
    )]
    UserTime {
        /// Maximum time of a user.
        limit: Duration,
        /// Time until the user has device time again.
        wait: Duration,
    },
    /// A stage failed.
    #[error(transparent)]
    Device(isopeel_kernels::Error),
    /// The device could not be opened.
    #[error(transparent)]
    NoDevice(#[serde(with = "open_error")] Arc<OpenError>),
    /// The device was lost while this job ran. It is reopened; its data is loaded again on demand.
    #[error("the device was lost during this work, and is being reopened: try again")]
    DeviceLost,
    /// The process that has the device ended twice while it did this work.
    #[error("{what} has ended the process of the device twice, and is refused until the server is started again")]
    EndsProcess {
        /// The work, as an expression or a field of a volume.
        what: String,
    },
    /// The device was lost, and could not be reopened so far.
    #[error("the device was lost and could not be reopened yet: try again in a few seconds")]
    Reopening,
    /// Cancelled by the caller's token.
    #[error("cancelled")]
    Cancelled,
    /// The device's thread ended, or the job panicked; the log says why.
    #[error("the job was aborted, the server's log says why")]
    Stopped,
}

impl WorkError {
    /// Returns the error that a view has no isovalue, and that none can be chosen.
    pub(crate) fn no_finite_sample() -> Self {
        Self::Edit(EditError {
            field: "iso",
            why: "the field has no finite sample to choose an isovalue from".into(),
        })
    }

    /// Returns the stable code of `PROTOCOL.md`, which REST problems have too.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Busy | Self::HostBusy { .. } | Self::UserTime { .. } => "busy",
            Self::Unreadable(_) => "unreadable-volume",
            Self::TooManyTriangles { .. }
            | Self::TooLarge { .. }
            | Self::TooLargeForHost { .. }
            | Self::TooLargeToShare { .. }
            | Self::NoTree(_)
            | Self::NotKept
            | Self::TookTooLong { .. }
            | Self::Device(isopeel_kernels::Error::OutOfDeviceMemory { .. }) => "too-large",
            Self::OverBudget { .. } | Self::OverBytes { .. } => "over-budget",
            Self::Edit(_) => "bad-edit",
            Self::NothingShown => "no-surface",
            Self::Device(_)
            | Self::NoDevice(_)
            | Self::DeviceLost
            | Self::EndsProcess { .. }
            | Self::Reopening
            | Self::Stopped => "device",
            Self::Cancelled => "cancelled",
        }
    }

    /// Whether the caller has cancelled the work, which is no failure.
    pub fn is_cancelled(&self) -> bool {
        matches!(self, Self::Cancelled)
    }

    /// Whether the view itself cannot be shown, whatever the caller and however often it is retried. If so, the viewer returns to the
    /// surface shown before. False if another budget would help, or if the device failed, because a retry may succeed.
    pub fn rejects_view(&self) -> bool {
        matches!(
            self,
            Self::Edit(_)
                | Self::Unreadable(_)
                | Self::TooLarge { .. }
                | Self::TooLargeForHost { .. }
                | Self::TooLargeToShare { .. }
                | Self::TookTooLong { .. }
                | Self::UserTime { .. }
                | Self::NoTree(_)
                | Self::EndsProcess { .. }
        )
    }

    /// Returns the message for a client. The message names files without their folders, and contains no compiler messages, which name
    /// folders too. The log gets the whole error.
    pub fn public_message(&self) -> String {
        match self {
            Self::Unreadable(error) => error.without_folder(),
            Self::Device(error) => device_message(error),
            Self::NoDevice(error) => opening_message(error),
            other => chain(other),
        }
    }

    /// Returns a budget of triangles to try, if the surface exceeded a limit or its budget.
    pub fn suggested_triangles(&self) -> Option<u64> {
        match self {
            Self::TooManyTriangles { ceiling, .. } => Some(*ceiling),
            Self::OverBudget { minimum, .. } => Some(*minimum),
            Self::OverBytes { triangles, .. } => Some(*triangles),
            _ => None,
        }
    }
}

/// An error of opening a device, with the device's error or as its text.
mod open_error {
    use std::sync::Arc;

    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use super::OpenError;

    /// Serialized as `Result<&Error, String>`.
    pub fn serialize<S: Serializer>(error: &OpenError, serializer: S) -> Result<S::Ok, S::Error> {
        let form = match error {
            OpenError::Device(error) => Ok(error),
            other => Err(other.to_string()),
        };
        form.serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Arc<OpenError>, D::Error> {
        let form = Result::<isopeel_kernels::Error, String>::deserialize(deserializer)?;
        Ok(Arc::new(form.map_or_else(OpenError::Refused, OpenError::Device)))
    }
}

/// Returns the message for a client about a device that could not be opened.
fn opening_message(error: &OpenError) -> String {
    match error {
        OpenError::Device(error) => device_message(error),
        other => chain(other),
    }
}

/// Returns the message for a client about an error of the kernels.
fn device_message(error: &isopeel_kernels::Error) -> String {
    match error {
        isopeel_kernels::Error::Build { stage, .. } => {
            format!("stage {stage} did not build on this device, the server's log says why")
        }
        other => chain(other),
    }
}

impl From<isopeel_kernels::Error> for WorkError {
    fn from(error: isopeel_kernels::Error) -> Self {
        match error {
            isopeel_kernels::Error::Cancelled => Self::Cancelled,
            other => Self::Device(other),
        }
    }
}

/// Formats an error and its causes on one line. Skips a cause if the line already ends with its message.
pub fn chain(error: &(dyn std::error::Error + 'static)) -> String {
    let mut line = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let message = error.to_string();
        if !line.ends_with(&message) {
            line.push_str(": ");
            line.push_str(&message);
        }
        cause = error.source();
    }
    line
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn clients_are_told_no_folders() {
        let unreadable = ReadError::new(
            Path::new("/data/patients/7/scan.nrrd"),
            "data file",
            "\"/data/patients/7/scan.raw\" has 3 bytes, expected 8",
        );
        let build = isopeel_kernels::Error::Build {
            stage: "classify",
            options: "-I /opt/driver".into(),
            log: "/tmp/kernel.cl:1: error".into(),
        };
        for (error, told) in [
            (
                WorkError::from(unreadable),
                "scan.nrrd: data file: \"scan.raw\" has 3 bytes, expected 8",
            ),
            (
                WorkError::from(build),
                "stage classify did not build on this device, the server's log says why",
            ),
        ] {
            assert_eq!(error.public_message(), told);
        }
    }

    #[derive(Debug, thiserror::Error)]
    #[error("{text}")]
    struct Link {
        text: &'static str,
        source: Option<Box<Link>>,
    }

    fn link(text: &'static str, source: Option<Link>) -> Link {
        Link {
            text,
            source: source.map(Box::new),
        }
    }

    #[test]
    fn a_chain_says_everything_once() {
        let error = link(
            "no surface",
            Some(link("file.nrrd: cut off", Some(link("cut off", None)))),
        );
        assert_eq!(chain(&error), "no surface: file.nrrd: cut off");
    }
}
