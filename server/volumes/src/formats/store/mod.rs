//! Stores of chunked volumes: a folder, or a store over a network. Both hold objects that are named by relative paths.

mod folder;
mod network;

use std::path::{Path, PathBuf};

use folder::Folder;
use network::Network;

use crate::remote::{Limits, Object, Part};
use crate::{FileLocation, ReadError};

/// Maximum bytes of a file of metadata. That of a group may contain those of all arrays in it.
const MAX_METADATA_BYTES: u64 = 16 << 20;
/// Maximum folders of a group that are listed.
const MAX_FOLDERS: usize = 4096;

/// A folder of objects: a Zarr group or array, or a precomputed volume.
#[derive(Debug)]
pub(super) struct Store {
    /// The location as it was named; its path is for messages.
    location: FileLocation,
    kind: Kind,
    /// Name of the field in errors.
    field: &'static str,
}

#[derive(Debug)]
enum Kind {
    Folder(Folder),
    Network(Network),
}

/// Returns the path of `name` in a group.
pub(super) fn join(group: &str, name: &str) -> String {
    match group {
        "" => name.to_owned(),
        group => format!("{group}/{name}"),
    }
}

impl Store {
    /// Opens a Zarr folder or store.
    pub(super) fn open(location: &FileLocation, field: &'static str) -> Result<Self, ReadError> {
        let mut store = Self::plain(location, field)?;
        if let Kind::Network(network) = &mut store.kind {
            network.read_consolidated(location.path())?;
        }
        Ok(store)
    }

    /// Opens a folder or store without reading metadata. `field` is the name of the field in errors.
    pub(super) fn plain(location: &FileLocation, field: &'static str) -> Result<Self, ReadError> {
        let kind = match location.address() {
            Some(address) => Kind::Network(Network::open(address, Limits::default())?),
            None => Kind::Folder(Folder::open(location.path())?),
        };
        Ok(Self {
            location: location.clone(),
            kind,
            field,
        })
    }

    pub(super) fn shown(&self) -> &Path {
        self.location.path()
    }

    pub(super) fn location(&self) -> &FileLocation {
        &self.location
    }

    /// Returns the path of an object for messages.
    pub(super) fn path(&self, relative: &str) -> PathBuf {
        if relative.is_empty() {
            self.shown().to_owned()
        } else {
            self.shown().join(relative)
        }
    }

    /// Returns an error in a node.
    pub(super) fn error(&self, relative: &str, why: impl Into<String>) -> ReadError {
        ReadError::new(&self.path(relative), self.field, why)
    }

    /// Whether requests have latency, so that several should be in flight.
    pub(super) fn is_remote(&self) -> bool {
        matches!(self.kind, Kind::Network(_))
    }

    /// Returns the size of an object on disk in bytes; `None` if it does not exist, or the store is not on disk.
    pub(super) fn disk_bytes(&self, relative: &str) -> Result<Option<u64>, ReadError> {
        match &self.kind {
            Kind::Folder(folder) => folder.size(&self.path(relative), relative),
            Kind::Network(_) => Ok(None),
        }
    }

    /// Reads an object, or a part of it, of `limit` bytes at most; `None` if it does not exist.
    pub(super) fn read(
        &self,
        relative: &str,
        part: Part,
        limit: u64,
        stop: &dyn Fn() -> bool,
    ) -> Result<Option<Object>, ReadError> {
        let shown = self.path(relative);
        match &self.kind {
            Kind::Folder(folder) => folder.read(&shown, relative, part, limit),
            Kind::Network(network) => network.read(&shown, relative, part, limit, stop),
        }
    }

    /// Reads a file of metadata; `None` if it does not exist.
    pub(super) fn json<T: serde::de::DeserializeOwned>(&self, relative: &str) -> Result<Option<T>, ReadError> {
        let text = match &self.kind {
            Kind::Folder(folder) => folder.read(&self.path(relative), relative, Part::Whole, MAX_METADATA_BYTES),
            Kind::Network(network) => network.metadata(&self.path(relative), relative),
        };
        let Some(text) = text? else {
            return Ok(None);
        };
        let value = serde_json::from_slice(&text.bytes);
        value.map(Some).map_err(|e| self.error(relative, e.to_string()))
    }

    /// Returns the names of the folders in a group, sorted.
    pub(super) fn folders(&self, relative: &str) -> Result<Vec<String>, ReadError> {
        match &self.kind {
            Kind::Folder(folder) => folder.folders(&self.path(relative), relative),
            Kind::Network(network) => network.folders(&self.path(relative), relative),
        }
    }

    /// Returns the error text for a path at which there is neither an array nor a group.
    pub(super) fn nothing_there(&self) -> String {
        let expected = "no array or group there, expected zarr.json, .zarray or .zgroup";
        match &self.kind {
            Kind::Network(network) if network.was_forbidden() => {
                format!("{expected}; the store refused to say (status 403)")
            }
            Kind::Network(_) => format!("{expected}: of a network only Zarr is read, and precomputed://ADDRESS"),
            Kind::Folder(_) => expected.to_owned(),
        }
    }
}

/// Cancellation check for reads that are never cancelled.
pub(super) fn never() -> bool {
    false
}
