//! State of the device for monitoring: memory by purpose.

use isopeel_extraction::{MemoryUse, WorkError};

use super::device_thread::DeviceState;
use super::worker::DeviceWorker;

impl DeviceWorker {
    /// Returns the memory by purpose, as of the last job.
    ///
    /// # Errors
    /// As [`DeviceWorker::ready`].
    pub async fn memory(&self) -> Result<MemoryUse, WorkError> {
        let device = self.ready().await?;
        Ok(self.shared.memory.borrow().stated(device.kind))
    }

    /// As [`DeviceWorker::memory`], without waiting: `None` unless the device is open.
    pub fn memory_now(&self) -> Option<MemoryUse> {
        match self.state() {
            DeviceState::Ready(device) => Some(self.shared.memory.borrow().stated(device.kind)),
            DeviceState::Opening(_) | DeviceState::Lost | DeviceState::NeedsNewProcess | DeviceState::Failed(_) => None,
        }
    }
}
