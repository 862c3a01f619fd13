//! Jobs: requests in the queue of the device's thread.

use std::sync::{Arc, Mutex};
use std::time::Instant;

use isopeel_extraction::{DeviceReply, DeviceRequest, JobContext, JobError, Question, WorkError, Workspace, lock};
use tokio::sync::{OwnedSemaphorePermit, oneshot};
use tokio_util::sync::CancellationToken;

use super::means::Mean;
use super::scheduler::{Caller, Job, Length, PausedQueue, Queue, Token};
use crate::metrics::{self, JobLabels};

/// Returns the length with which a request is queued first. If its job then fails with [`JobError::TakesLong`], the request is queued again
/// with the length [`Caller::length_if_long`].
pub(super) fn length_of(request: &DeviceRequest, caller: Caller) -> Length {
    match request {
        DeviceRequest::Extract(_) => caller.length_if_long(),
        DeviceRequest::Measure(_) if caller == Caller::Request => caller.length_if_long(),
        DeviceRequest::Measure(_) | DeviceRequest::Improve(_) => Length::Rest,
        DeviceRequest::Ask(ask) if matches!(ask.question, Question::VertexErrors(_)) => Length::Rest,
        DeviceRequest::Compute(_) => Length::Field,
        DeviceRequest::Ask(_)
        | DeviceRequest::Resolve(_)
        | DeviceRequest::Prepare(_)
        | DeviceRequest::Count(_)
        | DeviceRequest::Refine(_)
        | DeviceRequest::FindResident(_)
        | DeviceRequest::UseField(_)
        | DeviceRequest::BeginUpload(_)
        | DeviceRequest::ContinueUpload(_)
        | DeviceRequest::ContinueTable(_)
        | DeviceRequest::FinishUpload(_)
        | DeviceRequest::DropUpload(_)
        | DeviceRequest::MakeSpaceAhead(_)
        | DeviceRequest::MakeHostSpace(_)
        | DeviceRequest::Release(_)
        | DeviceRequest::UseHistogramFields(_)
        | DeviceRequest::ContinueHistogram(_)
        | DeviceRequest::ContinueOverview(_)
        | DeviceRequest::ReadSamples(_)
        | DeviceRequest::ReadSlice(_)
        | DeviceRequest::CheckAnswers(_) => Length::Short,
    }
}

tokio::task_local! {
    /// Id in the log of the edit that a task works on.
    pub static TRACE: String;
}

/// The code that waits for a job.
pub(super) trait Requester: Send {
    /// The job begins to run.
    fn begun(&self);

    /// The job has ended. A job that is dropped without this call was never run.
    fn ended(self: Box<Self>, outcome: Result<DeviceReply, JobError>);
}

/// A caller in this process, with the space of its job in the queue.
pub(super) struct LocalRequester {
    reply: oneshot::Sender<Result<DeviceReply, JobError>>,
    labels: JobLabels,
    /// When the job was queued.
    queued: Instant,
    /// Mean time of the device's jobs.
    seconds: Arc<Mean>,
    /// When the job began, and its space in the queue until then.
    begun: Mutex<(Option<Instant>, Option<OwnedSemaphorePermit>)>,
}

impl LocalRequester {
    /// Returns the caller of a job that is queued now, and the receiver of the job's outcome.
    pub(super) fn new(
        labels: JobLabels,
        space: OwnedSemaphorePermit,
        seconds: Arc<Mean>,
    ) -> (Self, oneshot::Receiver<Result<DeviceReply, JobError>>) {
        let (reply, outcome) = oneshot::channel();
        let requester = Self {
            reply,
            labels,
            seconds,
            queued: Instant::now(),
            begun: Mutex::new((None, Some(space))),
        };
        (requester, outcome)
    }
}

impl Requester for LocalRequester {
    fn begun(&self) {
        let now = Instant::now();
        *lock(&self.begun) = (Some(now), None);
        metrics::job_begun(self.labels, now - self.queued);
    }

    fn ended(self: Box<Self>, outcome: Result<DeviceReply, JobError>) {
        if let Some(begun) = lock(&self.begun).0 {
            let time = begun.elapsed();
            metrics::job_ended(self.labels, time);
            self.seconds.add(time.as_secs_f64());
        }
        // Sending fails if the caller is gone, which is no error.
        let _ = self.reply.send(outcome);
    }
}

/// A request that waits for the device.
pub(super) struct DeviceJob {
    pub request: DeviceRequest,
    pub length: Length,
    pub token: CancellationToken,
    pub requester: Box<dyn Requester>,
    /// Permit of [`super::scheduler::Permits`], released when the job ends.
    pub permit: Option<OwnedSemaphorePermit>,
    /// Span of the caller, to which log entries of the job belong.
    pub span: tracing::Span,
    /// The edit that the job is for, for the log of another process.
    pub trace: Option<String>,
}

impl Job for DeviceJob {
    type State = Workspace;

    fn name(&self) -> &'static str {
        self.request.name()
    }

    fn length(&self) -> Length {
        self.length
    }

    fn is_cancelled(&self) -> bool {
        self.token.is_cancelled()
    }

    fn run(self, workspace: &mut Workspace, queue: &mut Queue<Self>) {
        let (_permit, _span) = (self.permit, self.span.entered());
        self.requester.begun();
        let (name, begun) = (self.request.name(), Instant::now());
        let outcome = run(self.request, workspace, queue, self.length, &self.token);
        tracing::debug!(
            job = name,
            milliseconds = begun.elapsed().as_millis() as u64,
            "a job has ended"
        );
        self.requester.ended(outcome);
    }
}

/// Runs a request, unless it was cancelled. A long request pauses for jobs of higher priority.
fn run(
    request: DeviceRequest,
    workspace: &mut Workspace,
    queue: &mut Queue<DeviceJob>,
    length: Length,
    token: &CancellationToken,
) -> Result<DeviceReply, JobError> {
    if token.is_cancelled() {
        return Err(WorkError::Cancelled.into());
    }
    let cancel = Token(token, workspace.engine().activity());
    let mut waiting = PausedQueue { queue, length };
    let mut context = match length {
        Length::Short => JobContext::short(&cancel),
        Length::Long | Length::Field | Length::Export | Length::Rest => JobContext::long(&cancel, &mut waiting),
    };
    let outcome = request.run(workspace, &mut context);
    outcome.map_err(|error| workspace.look_for_loss(error))
}
