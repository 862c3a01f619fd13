//! Makes space for allocations on the host.

use isopeel_extraction::WorkError;
use tokio_util::sync::CancellationToken;

use super::scheduler::{Caller, Length};
use super::worker::DeviceWorker;

impl DeviceWorker {
    /// Makes sure that this machine has memory for `needed_bytes`; evicts data that can be made again.
    ///
    /// # Errors
    /// As [`Workspace::make_host_space`](isopeel_extraction::Workspace::make_host_space).
    pub(super) async fn make_host_space(&self, needed_bytes: u64) -> Result<(), WorkError> {
        let never = CancellationToken::new();
        let job = self.run(&never, Caller::Cache, Length::Short, move |state, _| {
            Ok(state.make_host_space(needed_bytes)?)
        });
        Ok(job.await?)
    }
}
