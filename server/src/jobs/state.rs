//! Batch jobs as clients see them.

use isopeel_extraction::MeasuredError;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::export::FileRequest;

/// Request to create a batch job: surfaces of one volume, each in a file of its own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct JobRequest {
    /// Id of the volume, as `GET /api/v1/volumes` lists it.
    pub volume: String,
    /// The files to make, 1 to 10,000.
    #[schema(min_items = 1, max_items = 10_000)]
    pub extractions: Vec<FileRequest>,
}

/// State of a batch job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "lowercase")]
pub enum JobState {
    /// It waits for those before it.
    Queued,
    /// Its extractions are made, one after the other.
    Running,
    /// All results are there.
    Done,
    /// Some extraction failed, all surfaces are empty, or its input changed. Results that were made are there.
    Failed,
    /// A user cancelled it. Results that were made before are kept.
    Cancelled,
}

impl JobState {
    pub(super) const ALL: [Self; 5] = [Self::Queued, Self::Running, Self::Done, Self::Failed, Self::Cancelled];

    /// Returns the name in JSON and in the store.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Done => "done",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        }
    }

    /// Whether the job is done, failed or cancelled.
    pub const fn is_finished(self) -> bool {
        !matches!(self, Self::Queued | Self::Running)
    }
}

/// What a job is expected to cost, from the full surfaces of some of its extractions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS))]
pub struct Estimate {
    /// Maximum triangles: those of the full surfaces, or the budgets if these are lower.
    pub triangles: u64,
    /// Maximum bytes of the results.
    pub bytes: u64,
    /// Seconds on an idle device.
    pub seconds: f64,
}

/// Numbers of a job's extractions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS))]
pub struct Progress {
    /// Total number of extractions.
    pub total: u64,
    /// Number of extractions with a result.
    pub done: u64,
    /// Number of extractions without a result after three attempts, or after the first one if a retry would not help.
    pub failed: u64,
    /// Number of extractions without a result because the surface has no triangles.
    #[serde(default)]
    pub empty: u64,
}

impl Progress {
    /// Returns the number of extractions that will not be attempted again.
    pub const fn ended(&self) -> u64 {
        self.done + self.failed + self.empty
    }
}

/// Why something has no result.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS))]
pub struct Cause {
    /// Stable code for programs: a code of the problem documents, `input-changed`, `attempts-exhausted` or `over-quota`.
    pub code: String,
    /// Explanation for users.
    pub detail: String,
}

/// An extraction that failed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS))]
pub struct Failure {
    /// Number of the extraction, from 0.
    pub extraction: u32,
    /// Why the extraction failed.
    #[serde(flatten)]
    pub cause: Cause,
}

/// A batch job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct JobInfo {
    /// Id of the job.
    pub id: String,
    /// Id of the job's volume.
    pub volume: String,
    /// State of the job.
    pub state: JobState,
    /// Why the job is paused: `disk-full` or `storage`. Absent if it is not paused. The job resumes by itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(test, ts(optional))]
    pub paused: Option<String>,
    /// Numbers of the job's extractions.
    pub extractions: Progress,
    /// Total bytes of the results.
    pub bytes: u64,
    /// Expected cost of the job.
    pub estimate: Estimate,
    /// Estimated seconds until the job is done, if it runs and the time can be estimated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(test, ts(optional))]
    pub eta_seconds: Option<f64>,
    /// When the job was submitted, in seconds since 1970.
    pub submitted: f64,
    /// When the job's first extraction began, in seconds since 1970.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(test, ts(optional))]
    pub started: Option<f64>,
    /// When the job was done, failed or cancelled, in seconds since 1970.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(test, ts(optional))]
    pub finished: Option<f64>,
    /// Why the job failed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(test, ts(optional))]
    pub error: Option<Cause>,
    /// The first hundred extractions that failed. Only in the description of a single job.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(test, ts(as = "Option<Vec<Failure>>", optional))]
    pub failures: Vec<Failure>,
}

/// State of one extraction of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum ExtractionState {
    /// It is not made yet, or was not when its job ended.
    Waiting,
    /// Its file is there.
    Done,
    /// Its surface has no triangles, so that there is no file.
    Empty,
    /// It has no file.
    Failed,
}

/// An extraction of a job: a line of the job's manifest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct ManifestEntry {
    /// Number of the extraction, from 0.
    pub extraction: u32,
    /// State of the extraction.
    pub state: ExtractionState,
    /// Name of the result's file, if `isopeel batch` or `isopeel jobs fetch` writes one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// Triangles of the file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub triangles: Option<u64>,
    /// Measured distance of the file's surface to the full one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<MeasuredError>,
    /// Bytes of the file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bytes: Option<u64>,
    /// SHA-256 of the file, hexadecimal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
    /// Seconds that the extraction took.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
    /// What the file's format could not keep.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notices: Vec<String>,
    /// Why there is no file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub problem: Option<Cause>,
}

impl ManifestEntry {
    /// Returns the entry of an extraction that was not made yet.
    pub const fn waiting(extraction: u32) -> Self {
        Self {
            extraction,
            state: ExtractionState::Waiting,
            file: None,
            triangles: None,
            error: None,
            bytes: None,
            sha256: None,
            seconds: None,
            notices: Vec::new(),
            problem: None,
        }
    }
}

/// Returns the file name of an extraction's result. The number is padded, so that the order of names is the order of extractions.
pub fn file_name(extraction: u32, extension: &str) -> String {
    format!("{extraction:05}.{extension}")
}

/// What has happened to a job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct JobEvent {
    /// Increases from event to event of a server. Pauses and their ends have none: a disk that takes no results takes no notes either.
    #[serde(skip)]
    pub id: Option<i64>,
    /// State of the job after the event.
    pub state: JobState,
    /// Numbers of the job's extractions after the event.
    pub extractions: Progress,
    /// Number of the extraction that has ended, from 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub extraction: Option<u32>,
    /// Why the job is paused after the event: `disk-full` or `storage`. Absent if it is not paused. The job resumes by itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub paused: Option<String>,
}

impl JobEvent {
    /// Returns the name of the event: `paused`, or that of the job's state.
    pub fn name(&self) -> &'static str {
        match self.paused {
            Some(_) => "paused",
            None => self.state.name(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn states_have_one_name() {
        for state in JobState::ALL {
            assert_eq!(serde_json::to_value(state).unwrap(), state.name());
        }
    }
}
