//! Uploads as clients see them.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::names::DeclaredFile;

/// What `POST uploads` asks for.
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
    /// Its name in URLs, made by the server.
    pub id: String,
    /// Name for people, of its files.
    pub title: String,
    /// Whose it is.
    pub owner: String,
    /// Its state.
    pub state: UploadState,
    /// Number of its files.
    pub files: usize,
    /// Bytes in all, as they were declared.
    pub bytes: u64,
    /// Bytes that are there: the offset at which to continue.
    pub received_bytes: u64,
    /// When it was made, RFC 3339.
    pub created: String,
    /// When it is removed, unless it is used before: a part of it is sent, or a volume of it is looked at.
    pub expires: String,
    /// Ids of its volumes, once they are there.
    pub volumes: Vec<String>,
    /// Why it could not be read as a volume, if that was tried.
    pub error: Option<String>,
}

/// What `GET uploads` answers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
#[cfg_attr(test, derive(ts_rs::TS))]
#[serde(rename_all = "camelCase")]
pub struct UploadList {
    /// Bytes that a user may have.
    pub quota_bytes: u64,
    /// Bytes of the user's uploads that count: as declared, or as unpacked if that is more.
    pub used_bytes: u64,
    /// The latest first; an administrator's has those of all users.
    pub uploads: Vec<UploadInfo>,
}
