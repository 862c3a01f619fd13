//! Jobs: requests in the queue of the device's thread.

use std::time::Instant;

use isopeel_extraction::{DeviceReply, DeviceRequest, JobContext, JobError, Question, WorkError, Workspace};
use tokio::sync::{OwnedSemaphorePermit, oneshot};
use tokio_util::sync::CancellationToken;

use super::scheduler::{Caller, Job, Length, PausedQueue, Queue, Token};
use crate::metrics::{self, JobLabels};

/// Returns the length with which a request is queued first. If its job then fails with [`JobError::TakesLong`], the request is queued again
/// with the length [`Caller::long`].
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

/// A request that waits for the device.
pub(super) struct DeviceJob {
    pub request: DeviceRequest,
    pub length: Length,
    pub token: CancellationToken,
    pub reply: oneshot::Sender<Result<DeviceReply, JobError>>,
    /// Permit of [`super::scheduler::Permits`], released when the job ends.
    pub permit: Option<OwnedSemaphorePermit>,
    /// Span of the caller, to which log entries of the job belong.
    pub span: tracing::Span,
    pub labels: JobLabels,
    /// When the job was queued.
    pub queued: Instant,
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
        let (_permit, _span, begun) = (self.permit, self.span.entered(), Instant::now());
        metrics::job_begun(self.labels, begun - self.queued);
        let outcome = run(self.request, workspace, queue, self.length, &self.token);
        metrics::job_ended(self.labels, begun.elapsed());
        // Sending fails if the caller is gone, which is no error.
        let _ = self.reply.send(outcome);
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
    let (cancel, mut waiting) = (Token(token), PausedQueue { queue, length });
    let mut context = match length {
        Length::Short => JobContext::short(&cancel),
        Length::Long | Length::Field | Length::Export | Length::Rest => JobContext::long(&cancel, &mut waiting),
    };
    let outcome = request.run(workspace, &mut context);
    outcome.map_err(|error| workspace.look_for_loss(error))
}
