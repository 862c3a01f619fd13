//! Makes the files of extractions on the device, by the same code as every other export.

use std::collections::HashMap;
use std::io::Write;
use std::sync::{Arc, Mutex, PoisonError};

use async_trait::async_trait;
use isopeel_extraction::{MeasuredError, WorkError};
use isopeel_volumes::{Dataset, IdentityError, Reader, SharedCatalog, VolumeStep};
use tokio_util::sync::CancellationToken;

use super::results::ResultFile;
use super::state::Cause;
use super::store::work::Work;
use crate::export::{self, ExportError, FileContent, MakeError, OtherVolumes};
use crate::service::{DevicePool, DeviceWorker, Seat};

/// Makes the files of extractions. A trait, so that tests of the runner need no device.
#[async_trait]
pub trait Maker: Send + Sync + 'static {
    /// Makes the file of an extraction. Fails if the input files are not those that the job has pinned.
    async fn make(&self, work: &Work, token: &CancellationToken) -> Result<Box<dyn ResultFile>, MakeFailure>;

    /// Checks that the input files are still those that the job has pinned.
    async fn check(&self, work: &Work) -> Result<(), MakeFailure>;
}

/// Why a file was not made. Each variant tells the runner how to continue.
#[derive(Debug)]
pub enum MakeFailure {
    /// The server is too busy, or shuts down. The attempt does not count.
    Later,
    /// Another attempt may succeed.
    Retry(Cause),
    /// No attempt will succeed.
    Refused(Cause),
    /// The surface has no triangles.
    Empty(Cause),
    /// No other extraction of the job will succeed either.
    JobFailed(Cause),
}

/// For each user, the id of the job whose input files were hashed most recently. Further extractions of the same job check only size and
/// modification time of the files. One job per user is enough, because the jobs of a user run one after another.
type Hashed = Arc<Mutex<HashMap<String, String>>>;

/// Makes files from the volumes of the server.
pub(super) struct DeviceMaker {
    catalog: SharedCatalog,
    devices: DevicePool,
    hashed: Hashed,
}

impl DeviceMaker {
    pub(super) fn new(catalog: SharedCatalog, devices: DevicePool) -> Self {
        Self {
            catalog,
            devices,
            hashed: Arc::default(),
        }
    }

    fn dataset(&self, work: &Work) -> Result<Arc<Dataset>, MakeFailure> {
        // The user's access to the volume was checked when the job was submitted.
        self.catalog.find(&work.volume, Reader::of_all()).ok_or_else(|| {
            MakeFailure::JobFailed(Cause {
                code: "unknown-volume".into(),
                detail: format!("the server has no volume {:?} any more", work.volume),
            })
        })
    }

    /// Does the work of [`Maker::check`] for a dataset. Hashes the files, unless the previous check for this user was for the same job.
    async fn check_input(&self, work: &Work, dataset: Arc<Dataset>) -> Result<(), MakeFailure> {
        let (work, hashed) = (work.clone(), Arc::clone(&self.hashed));
        let check = move || check(&work, &dataset, &hashed);
        match tokio::task::spawn_blocking(check).await {
            Ok(Ok(())) => Ok(()),
            Ok(Err(error @ IdentityError::Changed { .. })) => Err(MakeFailure::JobFailed(input_changed(&error))),
            Ok(Err(error)) => Err(MakeFailure::Retry(input_changed(&error))),
            Err(_) => Err(MakeFailure::Later),
        }
    }
}

fn check(work: &Work, dataset: &Dataset, hashed: &Hashed) -> Result<(), IdentityError> {
    let hashed = || hashed.lock().unwrap_or_else(PoisonError::into_inner);
    if hashed().get(&work.owner) == Some(&work.job) {
        return work.input.check_stamps(dataset);
    }
    work.input.check(dataset)?;
    hashed().insert(work.owner.clone(), work.job.clone());
    Ok(())
}

fn input_changed(error: &IdentityError) -> Cause {
    Cause {
        code: "input-changed".into(),
        detail: crate::error::chain(error),
    }
}

#[async_trait]
impl Maker for DeviceMaker {
    async fn make(&self, work: &Work, token: &CancellationToken) -> Result<Box<dyn ResultFile>, MakeFailure> {
        let dataset = self.dataset(work)?;
        self.check_input(work, Arc::clone(&dataset)).await?;
        let refused = |code: &str, detail: String| {
            MakeFailure::Refused(Cause {
                code: code.into(),
                detail,
            })
        };
        let volume =
            VolumeStep::new(dataset, work.request.step).map_err(|error| refused("unknown-step", error.to_string()))?;
        let (volume, others) = (&volume, &OtherVolumes::new());
        let make =
            |worker: DeviceWorker| async move { export::make(&worker, volume, others, &work.request, token).await };
        let file = self.devices.perform(&Seat::default(), volume, make).await;
        Ok(Box::new(file.map_err(failure)?))
    }

    async fn check(&self, work: &Work) -> Result<(), MakeFailure> {
        self.check_input(work, self.dataset(work)?).await
    }
}

/// Converts an error to the way in which the runner continues.
pub(crate) fn failure(error: MakeError) -> MakeFailure {
    let cause = |code: &str, detail: String| Cause {
        code: code.into(),
        detail,
    };
    match error {
        MakeError::Work(WorkError::Busy | WorkError::HostBusy { .. } | WorkError::Reopening | WorkError::Cancelled)
        | MakeError::Export(ExportError::Cancelled) => MakeFailure::Later,
        MakeError::Work(error) => {
            let cause = cause(error.code(), error.public_message());
            match error {
                WorkError::Unreadable(_)
                | WorkError::Device(_)
                | WorkError::NoDevice(_)
                | WorkError::DeviceLost
                | WorkError::Stopped => MakeFailure::Retry(cause),
                _ => MakeFailure::Refused(cause),
            }
        }
        MakeError::Export(error @ (ExportError::TooLarge { .. } | ExportError::OutOfRange(_))) => {
            MakeFailure::Refused(cause("too-large", error.to_string()))
        }
        MakeError::Export(error) => MakeFailure::Retry(cause("internal", crate::error::chain(&error))),
        MakeError::Edit(error) => MakeFailure::Refused(cause("bad-edit", error.to_string())),
        MakeError::NotClean(error) => MakeFailure::Refused(cause("not-clean", error.to_string())),
        MakeError::Empty(why) => MakeFailure::Empty(cause("empty-surface", why)),
        MakeError::Panicked(error) => MakeFailure::Retry(cause("internal", error.to_string())),
    }
}

impl ResultFile for FileContent {
    fn write(&self, mut out: &mut dyn Write) -> Result<(), ExportError> {
        FileContent::write(self, &mut out)
    }

    fn triangles(&self) -> u64 {
        self.statistics.triangles
    }

    fn error(&self) -> Option<MeasuredError> {
        self.statistics.error
    }

    fn notices(&self) -> Vec<String> {
        self.statistics.notices.clone()
    }
}
