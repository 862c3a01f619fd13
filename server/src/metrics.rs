//! Metrics for monitoring (`GET /metrics`): their names and units, and a function for each event. Labels have fixed sets of values, and
//! never contain names of volumes, files or users.
//!
//! Events before [`start`] are not recorded.

use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::Duration;

use ::metrics::{Counter, Unit, counter, describe_counter, describe_gauge, describe_histogram, gauge, histogram};
use metrics_exporter_prometheus::{BuildError, PrometheusBuilder, PrometheusHandle};

/// Bounds of the buckets of all histograms, in seconds: from a kernel of a small volume to an export of the largest one.
const BOUNDS: [f64; 15] = [
    0.000_1, 0.000_3, 0.001, 0.003, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 20.0, 100.0,
];

/// Interval between calls of [`upkeep`]. The recorder stores each value of a histogram until then.
pub const UPKEEP: Duration = Duration::from_secs(5);

const REQUESTS: &str = "isopeel_http_requests_total";
const REQUEST_SECONDS: &str = "isopeel_http_request_seconds";
const PROBLEMS: &str = "isopeel_problems_total";
const STREAM_ERRORS: &str = "isopeel_stream_errors_total";
const VIEWERS: &str = "isopeel_viewers";
const STREAMS: &str = "isopeel_streams_total";
const SENT_BYTES: &str = "isopeel_stream_sent_bytes_total";
const EDITS: &str = "isopeel_edits_total";
const FIRST_COMMIT_SECONDS: &str = "isopeel_edit_first_commit_seconds";
const DONE_SECONDS: &str = "isopeel_edit_done_seconds";
const STAGE_SECONDS: &str = "isopeel_device_stage_seconds";
const JOB_WAIT_SECONDS: &str = "isopeel_device_job_wait_seconds";
const JOB_SECONDS: &str = "isopeel_device_job_seconds";
const QUEUED: &str = "isopeel_device_queued_jobs";
const DEVICE_READY: &str = "isopeel_device_ready";
const DEVICE_VOLUMES: &str = "isopeel_device_volumes";
const VOLUMES_MOVED: &str = "isopeel_device_volumes_moved_total";
const VOLUMES_REPLICATED: &str = "isopeel_device_volumes_replicated_total";
const EXPORTS: &str = "isopeel_exports_running";
const BATCH_JOBS: &str = "isopeel_batch_jobs";
const DEVICE_LOST: &str = "isopeel_device_lost_total";
const DEVICE_PROCESS_ENDED: &str = "isopeel_device_process_ended_total";
const UPLOADS: &str = "isopeel_uploads";
const UPLOAD_BYTES: &str = "isopeel_upload_bytes";
const UPLOAD_RECEIVED: &str = "isopeel_upload_received_bytes_total";
const GROUPS: &str = "isopeel_groups";
const FOLLOWERS: &str = "isopeel_followers";
const CACHE: &str = "isopeel_cache_requests_total";
const MEMORY: &str = "isopeel_memory_bytes";
const RESIDENT: &str = "process_resident_memory_bytes";
const BUILD: &str = "isopeel_build_info";

static RECORDER: OnceLock<PrometheusHandle> = OnceLock::new();

/// Maximum number of devices of a server.
pub const MAX_DEVICES: usize = 16;

/// Values of the label `device`.
const DEVICE_LABELS: [&str; MAX_DEVICES] = [
    "0", "1", "2", "3", "4", "5", "6", "7", "8", "9", "10", "11", "12", "13", "14", "15",
];

/// Number of a device among those of the server, from 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceNumber(usize);

impl DeviceNumber {
    /// Returns the number of the device at a position; `None` from [`MAX_DEVICES`] on.
    pub fn new(index: usize) -> Option<Self> {
        (index < MAX_DEVICES).then_some(Self(index))
    }

    /// Returns the position of the device.
    pub fn index(self) -> usize {
        self.0
    }

    /// Returns the value of the label `device`.
    fn label(self) -> &'static str {
        DEVICE_LABELS[self.0]
    }
}

/// Counters that are updated for each frame of each viewer. They are stored here, because a look-up by labels would take longer than all
/// other work for a small frame.
struct FrameCounters {
    chunk_bytes: Counter,
    message_bytes: Counter,
    chunks_found: Counter,
    chunks_made: Counter,
}

static FRAMES: OnceLock<FrameCounters> = OnceLock::new();

/// Starts recording for the whole process. Further calls do nothing.
///
/// # Errors
/// Another recorder is installed in this process.
pub fn start() -> Result<(), BuildError> {
    // Tests start several servers in one process at the same time.
    static STARTING: Mutex<()> = Mutex::new(());
    let _guard = STARTING.lock().unwrap_or_else(PoisonError::into_inner);
    if RECORDER.get().is_some() {
        return Ok(());
    }
    let recorder = PrometheusBuilder::new().set_buckets(&BOUNDS)?.install_recorder()?;
    if RECORDER.set(recorder).is_ok() {
        describe();
        FRAMES.get_or_init(|| FrameCounters {
            chunk_bytes: counter!(SENT_BYTES, "kind" => "chunk"),
            message_bytes: counter!(SENT_BYTES, "kind" => "message"),
            chunks_found: counter!(CACHE, "what" => "chunk", "result" => "hit"),
            chunks_made: counter!(CACHE, "what" => "chunk", "result" => "miss"),
        });
        gauge!(BUILD, "version" => env!("CARGO_PKG_VERSION")).set(1.0);
    }
    Ok(())
}

fn describe() {
    describe_counter!(REQUESTS, "Answered requests, by route, method and status");
    describe_histogram!(
        REQUEST_SECONDS,
        Unit::Seconds,
        "Time to the head of an answer, by route"
    );
    describe_counter!(PROBLEMS, "Errors of REST, by code");
    describe_counter!(STREAM_ERRORS, "Errors that viewers were sent, by code");
    describe_gauge!(VIEWERS, "Connected viewers");
    describe_counter!(STREAMS, "Viewers that have connected, or were turned away");
    describe_counter!(
        SENT_BYTES,
        Unit::Bytes,
        "What the network has taken for viewers: chunks, and messages"
    );
    describe_counter!(EDITS, "Surfaces that were begun for viewers");
    describe_histogram!(
        FIRST_COMMIT_SECONDS,
        Unit::Seconds,
        "From the beginning of an edit's surface to its first commit"
    );
    describe_histogram!(
        DONE_SECONDS,
        Unit::Seconds,
        "From the beginning of an edit's surface to its last commit"
    );
    describe_histogram!(STAGE_SECONDS, Unit::Seconds, "Device time of a surface, by stage");
    describe_histogram!(
        JOB_WAIT_SECONDS,
        Unit::Seconds,
        "From a job's arrival in the device's queue to its turn, by caller and length"
    );
    describe_histogram!(
        JOB_SECONDS,
        Unit::Seconds,
        "From the beginning of a job to its end, with those that ran in its pauses"
    );
    describe_gauge!(QUEUED, "Jobs in a device's queue");
    describe_gauge!(DEVICE_READY, "1 if a device is open, else 0");
    describe_gauge!(DEVICE_VOLUMES, "Volumes that are assigned to a device");
    describe_counter!(
        VOLUMES_MOVED,
        "Volumes that were moved to a device because theirs could not be used"
    );
    describe_counter!(
        VOLUMES_REPLICATED,
        "Volumes that were assigned to a further device because the queue of theirs was long"
    );
    describe_gauge!(EXPORTS, "Exports that run");
    describe_gauge!(BATCH_JOBS, "Batch jobs, by state");
    describe_counter!(DEVICE_LOST, "How often a device was lost");
    describe_counter!(
        DEVICE_PROCESS_ENDED,
        "How often the process of a device has ended and was replaced, by reason"
    );
    describe_gauge!(UPLOADS, "Uploads, by state");
    describe_gauge!(UPLOAD_BYTES, Unit::Bytes, "Bytes of all uploads that are there");
    describe_counter!(UPLOAD_RECEIVED, Unit::Bytes, "Bytes of uploads that were received");
    describe_gauge!(GROUPS, "Groups of viewers");
    describe_gauge!(FOLLOWERS, "Viewers who follow another one");
    describe_counter!(
        CACHE,
        "What was looked for on the device and among what was made for others, by what it is and whether it was there"
    );
    describe_gauge!(MEMORY, Unit::Bytes, "Memory, by what holds it");
    describe_gauge!(
        RESIDENT,
        Unit::Bytes,
        "What the operating system says that the process holds"
    );
    describe_gauge!(BUILD, "1, with the version");
}

/// Sorts recorded values into the buckets of histograms. Call this every [`UPKEEP`].
pub fn upkeep() {
    if let Some(recorder) = RECORDER.get() {
        recorder.run_upkeep();
    }
}

/// Returns all metrics in Prometheus' text format; `None` before [`start`].
pub fn render() -> Option<String> {
    RECORDER.get().map(PrometheusHandle::render)
}

/// Records a request and its response. `route` is the pattern of the route, not the path.
pub fn answered(method: &'static str, route: &str, status: u16, time: Duration) {
    let status = status.to_string();
    counter!(REQUESTS, "method" => method, "route" => route.to_owned(), "status" => status).increment(1);
    histogram!(REQUEST_SECONDS, "route" => route.to_owned()).record(time);
}

/// Counts an error response of REST.
pub fn problem(code: &'static str) {
    counter!(PROBLEMS, "code" => code).increment(1);
}

/// Counts an error that was sent to a viewer.
pub fn stream_error(code: &'static str) {
    counter!(STREAM_ERRORS, "code" => code).increment(1);
}

/// Guard that counts a connected viewer until it is dropped.
pub struct ConnectedViewer(());

impl ConnectedViewer {
    /// Records that a viewer has connected.
    pub fn enter() -> Self {
        counter!(STREAMS, "outcome" => "served").increment(1);
        gauge!(VIEWERS).increment(1.0);
        Self(())
    }

    /// Counts a viewer that was refused.
    pub fn refused() {
        counter!(STREAMS, "outcome" => "refused").increment(1);
    }
}

impl Drop for ConnectedViewer {
    fn drop(&mut self) {
        gauge!(VIEWERS).decrement(1.0);
    }
}

/// Sets the number of groups of viewers.
pub fn groups(groups: usize) {
    gauge!(GROUPS).set(groups as f64);
}

/// Adds `more` to the number of viewers that follow another one. A negative number subtracts.
pub fn follower(more: f64) {
    gauge!(FOLLOWERS).increment(more);
}

/// Counts the bytes of a stream's chunks and messages that the network has accepted.
pub fn sent(chunk_bytes: usize, message_bytes: usize) {
    if let Some(frames) = FRAMES.get() {
        frames.chunk_bytes.increment(chunk_bytes as u64);
        frames.message_bytes.increment(message_bytes as u64);
    }
}

/// Counts a look-up of a chunk in the cache of encoded chunks, and whether it was a hit.
pub fn looked_up_chunk(was_there: bool) {
    if let Some(frames) = FRAMES.get() {
        let counter = if was_there {
            &frames.chunks_found
        } else {
            &frames.chunks_made
        };
        counter.increment(1);
    }
}

/// Counts a surface that was begun for a viewer.
pub fn edit_begun() {
    counter!(EDITS).increment(1);
}

/// Records the time from the beginning of a surface until its first commit is on its way.
pub fn edit_committed(time: Duration) {
    histogram!(FIRST_COMMIT_SECONDS).record(time);
}

/// Records the time from the beginning of a surface until its last commit is on its way.
pub fn edit_done(time: Duration) {
    histogram!(DONE_SECONDS).record(time);
}

/// Records the time of one stage of a surface on the device.
pub fn stage(device: DeviceNumber, name: &'static str, milliseconds: f64) {
    histogram!(STAGE_SECONDS, "device" => device.label(), "stage" => name).record(milliseconds / 1e3);
}

/// Labels of jobs on a device.
#[derive(Clone, Copy, Debug)]
pub struct JobLabels {
    /// The device.
    pub device: DeviceNumber,
    /// Kind of caller.
    pub caller: &'static str,
    /// How the job shares the device.
    pub length: &'static str,
}

/// Records that a job begins, and its waiting time.
pub fn job_begun(labels: JobLabels, waited: Duration) {
    histogram!(
        JOB_WAIT_SECONDS, "device" => labels.device.label(), "caller" => labels.caller, "length" => labels.length
    )
    .record(waited);
}

/// Records that a job has ended, and its duration.
pub fn job_ended(labels: JobLabels, time: Duration) {
    histogram!(
        JOB_SECONDS, "device" => labels.device.label(), "caller" => labels.caller, "length" => labels.length
    )
    .record(time);
}

/// Counts a loss of a device.
pub fn device_lost(device: DeviceNumber) {
    counter!(DEVICE_LOST, "device" => device.label()).increment(1);
}

/// Counts an end of the process of a device that was not asked for. `reason`: `crashed`, `killed`, `silent`, `stuck`, `memory`, `replaced`
/// or `unknown`.
pub fn device_process_ended(device: DeviceNumber, reason: &'static str) {
    counter!(DEVICE_PROCESS_ENDED, "device" => device.label(), "reason" => reason).increment(1);
}

/// Counts a look-up in a cache of a device, and whether it was a hit.
pub fn looked_up(device: DeviceNumber, what: &'static str, was_there: bool) {
    let result = if was_there { "hit" } else { "miss" };
    counter!(CACHE, "device" => device.label(), "what" => what, "result" => result).increment(1);
}

/// Counts a step for a viewer. `result` is `hit` if the step was cached, `joined` if it was in flight for another viewer, and `miss`
/// otherwise.
pub fn found_step(result: &'static str) {
    counter!(CACHE, "what" => "step", "result" => result).increment(1);
}

/// Sets the number of jobs in a device's queue.
pub fn set_queued_jobs(device: DeviceNumber, jobs: usize) {
    gauge!(QUEUED, "device" => device.label()).set(jobs as f64);
}

/// Sets whether a device is open, and the number of volumes that are assigned to it.
pub fn set_device(device: DeviceNumber, is_ready: bool, volumes: usize) {
    gauge!(DEVICE_READY, "device" => device.label()).set(f64::from(u8::from(is_ready)));
    gauge!(DEVICE_VOLUMES, "device" => device.label()).set(volumes as f64);
}

/// Counts a volume that was moved to this device.
pub fn volume_moved(to: DeviceNumber) {
    counter!(VOLUMES_MOVED, "device" => to.label()).increment(1);
}

/// Counts a volume that was assigned to this device beside others.
pub fn volume_replicated(to: DeviceNumber) {
    counter!(VOLUMES_REPLICATED, "device" => to.label()).increment(1);
}

/// Sets the number of running exports.
pub fn set_running_exports(running: usize) {
    gauge!(EXPORTS).set(running as f64);
}

/// Sets the number of batch jobs in a state.
pub fn set_batch_jobs(state: &'static str, jobs: u64) {
    gauge!(BATCH_JOBS, "state" => state).set(jobs as f64);
}

/// Sets the number of uploads in a state.
pub fn set_uploads(state: &'static str, uploads: usize) {
    gauge!(UPLOADS, "state" => state).set(uploads as f64);
}

/// Sets the bytes of all uploads.
pub fn set_upload_bytes(bytes: u64) {
    gauge!(UPLOAD_BYTES).set(bytes as f64);
}

/// Counts received bytes of an upload.
pub fn upload_received(bytes: usize) {
    counter!(UPLOAD_RECEIVED).increment(bytes as u64);
}

/// Sets the memory of an owner on a device.
pub fn set_device_memory(device: DeviceNumber, owner: &'static str, bytes: u64) {
    gauge!(MEMORY, "device" => device.label(), "owner" => owner).set(bytes as f64);
}

/// Sets the memory of an owner that belongs to no device.
pub fn set_memory(owner: &'static str, bytes: u64) {
    gauge!(MEMORY, "owner" => owner).set(bytes as f64);
}

/// Sets the memory of the process.
pub fn set_resident_bytes(bytes: u64) {
    gauge!(RESIDENT).set(bytes as f64);
}
