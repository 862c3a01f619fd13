//! Requests to a workspace, as data: they can be queued, logged, ordered, repeated, and sent to another process. Each has a type of its own, with the type of its
//! reply.

mod fields;
mod samples;
mod surfaces;

use isopeel_kernels::{Histogram, HistogramWork, OverviewValues, Samples};
use isopeel_view::View;
use isopeel_volumes::VolumeStep;
use serde::{Deserialize, Serialize};

use super::context::JobContext;
use super::job_error::JobError;
use super::questions::Answer;
use super::results::{Extraction, FullCount, Measurement, Refinement};
use super::slices::Slice;
use super::workspace::Workspace;
pub use fields::{
    BeginUpload, Compute, ContinueTable, ContinueUpload, DropUpload, FindResident, FinishUpload, MakeHostSpace,
    MakeSpaceAhead, Release, UseField,
};
pub use samples::{CheckAnswers, ContinueHistogram, ContinueOverview, ReadSamples, ReadSlice, UseHistogramFields};
pub use surfaces::{Ask, Count, Extract, Improve, Measure, Prepare, Refine, Resolve};

/// A request, with the type of its reply.
pub trait Request: Into<DeviceRequest> + Send + 'static {
    /// Type of the reply.
    type Reply: Send + 'static;

    /// Extracts the reply to this type of request; `None` if `reply` belongs to another type.
    fn take_reply(reply: DeviceReply) -> Option<Self::Reply>;
}

/// A request about a volume. It can be repeated, for example after the volume was loaded.
pub trait VolumeRequest: Request + Clone {
    /// Returns the volume.
    fn volume(&self) -> &VolumeStep;
}

macro_rules! requests {
    ($($name:ident -> $reply:ty),* $(,)?) => {
        /// Any request.
        #[derive(Serialize, Deserialize)]
        pub enum DeviceRequest {
            $(
                #[doc = concat!("See [`", stringify!($name), "`].")]
                $name($name),
            )*
        }

        /// The reply to any request.
        #[derive(Serialize, Deserialize)]
        pub enum DeviceReply {
            $(
                #[doc = concat!("The reply to [`", stringify!($name), "`].")]
                $name($reply),
            )*
        }

        /// Names of all requests.
        #[cfg(test)]
        const NAMES: &[&str] = &[$(stringify!($name)),*];

        impl DeviceRequest {
            /// Returns the name of the request's type.
            pub fn name(&self) -> &'static str {
                match self {
                    $(Self::$name(_) => stringify!($name),)*
                }
            }

            /// Runs the request on a workspace.
            ///
            /// # Errors
            /// [`JobError`].
            pub fn run(
                self,
                workspace: &mut Workspace,
                context: &mut JobContext<'_, Workspace>,
            ) -> Result<DeviceReply, JobError> {
                match self {
                    $(Self::$name(request) => request.perform(workspace, context).map(DeviceReply::$name),)*
                }
            }
        }

        $(
            impl From<$name> for DeviceRequest {
                fn from(request: $name) -> Self {
                    Self::$name(request)
                }
            }

            impl Request for $name {
                type Reply = $reply;

                fn take_reply(reply: DeviceReply) -> Option<$reply> {
                    match reply {
                        DeviceReply::$name(reply) => Some(reply),
                        _ => None,
                    }
                }
            }
        )*
    };
}

requests! {
    Resolve -> View,
    Prepare -> View,
    Count -> FullCount,
    Refine -> Refinement,
    Improve -> Option<Refinement>,
    Measure -> Option<Measurement>,
    Extract -> Extraction,
    Ask -> Answer,
    FindResident -> Vec<bool>,
    UseField -> (),
    Compute -> bool,
    BeginUpload -> bool,
    ContinueUpload -> (),
    ContinueTable -> bool,
    FinishUpload -> (),
    DropUpload -> (),
    MakeSpaceAhead -> bool,
    MakeHostSpace -> (),
    Release -> (),
    UseHistogramFields -> (),
    ContinueHistogram -> (HistogramWork, Option<Histogram>),
    ContinueOverview -> OverviewValues,
    ReadSamples -> Samples,
    ReadSlice -> Slice,
    CheckAnswers -> bool,
}

macro_rules! volume_requests {
    ($($name:ident),* $(,)?) => {
        $(
            impl VolumeRequest for $name {
                fn volume(&self) -> &VolumeStep {
                    &self.volume
                }
            }
        )*
    };
}

volume_requests! {
    Resolve, Prepare, Count, Refine, Improve, Measure, Extract, Ask, UseField, Compute, UseHistogramFields,
    ContinueHistogram, ContinueOverview, ReadSamples, ReadSlice,
}

#[cfg(test)]
mod tests;
