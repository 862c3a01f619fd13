//! Uploads as clients see them.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::names::DeclaredFile;

/// Request to create an upload.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct UploadRequest {
    /// 1 to 20,000 files, whose bytes are sent one after the other in this order.
    #[schema(min_items = 1, max_items = 20_000)]
    pub files: Vec<DeclaredFile>,
}

/// State of an upload.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "lowercase")]
pub enum UploadState {
    /// Bytes are missing, or it was not read yet.
    Receiving,
    /// Its volumes are there.
    Ready,
}

impl UploadState {
    pub(super) const ALL: [Self; 2] = [Self::Receiving, Self::Ready];

    /// Returns the name in JSON and in metrics.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Receiving => "receiving",
            Self::Ready => "ready",
        }
    }
}

/// An upload.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct UploadInfo {
    /// Id of the upload, which the server has generated.
    pub id: String,
    /// Title for users, from the names of the files.
    pub title: String,
    /// User who owns the upload.
    pub owner: String,
    /// State of the upload.
    pub state: UploadState,
    /// Number of files.
    pub files: usize,
    /// Total bytes of the files, as declared.
    pub bytes: u64,
    /// Bytes that the server has received: the offset at which to continue.
    pub received_bytes: u64,
    /// When the upload was created (RFC 3339).
    pub created: String,
    /// When the server removes the upload (RFC 3339), unless it is used before: a part of it is sent, or one of its volumes is viewed.
    pub expires: String,
    /// Ids of the upload's volumes; empty until the server has read its files.
    pub volumes: Vec<String>,
    /// Why the files could not be read as a volume, if the server has tried.
    pub error: Option<String>,
}

/// The uploads of a user, and the user's quota.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct UploadList {
    /// Maximum bytes of the user's uploads.
    pub quota_bytes: u64,
    /// Bytes of the user's uploads that count: as declared, or as unpacked if that is more.
    pub used_bytes: u64,
    /// The uploads, the latest first; for an administrator, those of all users.
    pub uploads: Vec<UploadInfo>,
}
