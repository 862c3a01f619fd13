//! Records hashes of the buffers after each kernel launch. Two versions of the program with equal records compute the same results,
//! bit for bit, on that device and driver.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Mutex;

use crate::lock::lock;

/// Contents of a buffer after a launch that had it as an argument.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BufferHash {
    /// Size of the buffer's contents.
    pub bytes: u64,
    /// Hash of the contents.
    pub hash: u64,
}

/// One launch of a kernel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Launch {
    /// Name of the kernel.
    pub kernel: String,
    /// Its buffers in the order of its arguments.
    pub buffers: Vec<BufferHash>,
}

/// Launches since recording was switched on; `None` while it is off.
#[derive(Default)]
pub(crate) struct Recorder(Mutex<Option<Vec<Launch>>>);

impl Recorder {
    pub fn is_on(&self) -> bool {
        lock(&self.0).is_some()
    }

    pub fn start(&self) {
        *lock(&self.0) = Some(Vec::new());
    }

    /// The launches since [`Recorder::start`] or the last call.
    pub fn take(&self) -> Vec<Launch> {
        lock(&self.0).as_mut().map(std::mem::take).unwrap_or_default()
    }

    pub fn add(&self, launch: Launch) {
        if let Some(launches) = lock(&self.0).as_mut() {
            launches.push(launch);
        }
    }
}

impl BufferHash {
    pub(crate) fn of(contents: &[u8]) -> Self {
        let mut hasher = DefaultHasher::new();
        contents.hash(&mut hasher);
        Self {
            bytes: contents.len() as u64,
            hash: hasher.finish(),
        }
    }
}
