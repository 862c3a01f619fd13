//! What a session needs of the rest of the server, so that tests can play a device of their own.

use std::sync::Arc;

use isopeel_kernels::Level;
use serde_json::value::RawValue;
use tokio_util::sync::CancellationToken;

use crate::extraction::{Extraction, Plan, VolumeStep, WorkError};
use crate::view::View;
use crate::volumes::Dataset;

/// What a session asks of the rest of the server.
pub trait Backend: Clone + Send + Sync + 'static {
    /// The dataset of that id.
    fn find(&self, volume: &str) -> Option<Arc<Dataset>>;

    /// Describes a volume, and fills in what only the data can say of the view it opens with.
    fn open(
        &self,
        volume: &VolumeStep,
        view: &View,
        token: &CancellationToken,
    ) -> impl Future<Output = Result<Opening, WorkError>> + Send;

    /// Every value in force, what keeps the view's budget included, and what the prefixes of `levels` would have.
    fn plan(
        &self,
        volume: &VolumeStep,
        view: &View,
        levels: Vec<Level>,
        token: &CancellationToken,
    ) -> impl Future<Output = Result<Plan, WorkError>> + Send;

    /// One prefix of a planned view's surface.
    fn extract(
        &self,
        volume: &VolumeStep,
        view: &View,
        prefix: Level,
        token: &CancellationToken,
    ) -> impl Future<Output = Result<Extraction, WorkError>> + Send;
}

/// An open volume.
#[derive(Clone, Debug)]
pub struct Opening {
    /// As `GET /api/v1/volumes/{id}`.
    pub volume: Box<RawValue>,
    /// The view with every value in force.
    pub view: View,
    /// Name of the device.
    pub device: String,
}
