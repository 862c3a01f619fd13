//! Objects of a store over a network: by HTTP, which cannot list objects, or in S3.
//!
//! For Zarr, the consolidated metadata are requested first. If they exist, they are taken as complete: they also list the groups.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use serde::Deserialize;
use serde_json::value::RawValue;

use super::{MAX_FOLDERS, MAX_METADATA_BYTES, join, never};
use crate::ReadError;
use crate::remote::{Address, Fault, Limits, Object, Part, Remote};

/// A store.
#[derive(Debug)]
pub(super) struct Network {
    remote: Remote,
    /// Metadata by path, if the root has consolidated metadata.
    consolidated: Option<BTreeMap<String, Box<RawValue>>>,
    /// Whether the store has refused to let an object be read.
    forbidden: AtomicBool,
}

/// `.zmetadata`, and the consolidated metadata in `zarr.json`.
#[derive(Deserialize)]
struct Consolidated {
    metadata: BTreeMap<String, Box<RawValue>>,
}

/// `zarr.json`.
#[derive(Deserialize)]
struct Root {
    #[serde(default)]
    consolidated_metadata: Option<Consolidated>,
}

impl Network {
    pub(super) fn open(address: &Address, limits: Limits) -> Result<Self, ReadError> {
        let shown = Path::new(address.shown());
        let fail = |why: String| ReadError::new(shown, "address", why);
        Ok(Self {
            remote: Remote::open(address, limits).map_err(fail)?,
            consolidated: None,
            forbidden: AtomicBool::new(false),
        })
    }

    /// Reads the consolidated metadata of Zarr, if the store has them.
    pub(super) fn read_consolidated(&mut self, shown: &Path) -> Result<(), ReadError> {
        let (third, second) = (shown.join("zarr.json"), shown.join(".zmetadata"));
        let wrong = |name: &Path, e: serde_json::Error| ReadError::new(name, "zarr", e.to_string());
        if let Some(text) = self.metadata(&third, "zarr.json")? {
            let root: Root = serde_json::from_slice(&text.bytes).map_err(|e| wrong(&third, e))?;
            if let Some(found) = root.consolidated_metadata {
                let nodes = found.metadata.into_iter();
                let mut known: BTreeMap<_, _> = nodes.map(|(path, text)| (join(&path, "zarr.json"), text)).collect();
                let own = serde_json::from_slice(&text.bytes).map_err(|e| wrong(&third, e))?;
                known.insert("zarr.json".to_owned(), own);
                self.consolidated = Some(known);
            }
        } else if let Some(text) = self.metadata(&second, ".zmetadata")? {
            let found: Consolidated = serde_json::from_slice(&text.bytes).map_err(|e| wrong(&second, e))?;
            self.consolidated = Some(found.metadata);
        }
        Ok(())
    }

    pub(super) fn was_forbidden(&self) -> bool {
        self.forbidden.load(Ordering::Relaxed)
    }

    pub(super) fn read(
        &self,
        shown: &Path,
        relative: &str,
        part: Part,
        limit: u64,
        stop: &dyn Fn() -> bool,
    ) -> Result<Option<Object>, ReadError> {
        let fail = |why: &str| Err(ReadError::new(shown, "object", why));
        match self.remote.get(relative, part, limit, stop) {
            Ok(object) => Ok(Some(object)),
            Err(Fault::Missing) => Ok(None),
            Err(Fault::Forbidden) => {
                self.forbidden.store(true, Ordering::Relaxed);
                fail("may not be read (status 403), expected a chunk, or status 404 where there is none")
            }
            Err(Fault::Other(why)) => fail(&why),
        }
    }

    /// Reads a file of metadata; `None` if it does not exist or may not be read. The two cases cannot be told apart in a store that may not
    /// be listed: it gives the same answer to both.
    pub(super) fn metadata(&self, shown: &Path, relative: &str) -> Result<Option<Object>, ReadError> {
        if let Some(known) = &self.consolidated {
            let bytes = known.get(relative).map(|text| text.get().as_bytes().to_vec());
            return Ok(bytes.map(|bytes| Object {
                size: bytes.len() as u64,
                bytes,
            }));
        }
        let read = self.remote.get(relative, Part::Whole, MAX_METADATA_BYTES, &never);
        match read {
            Ok(object) => Ok(Some(object)),
            Err(Fault::Missing) => Ok(None),
            Err(Fault::Forbidden) => {
                self.forbidden.store(true, Ordering::Relaxed);
                Ok(None)
            }
            Err(Fault::Other(why)) => Err(ReadError::new(shown, "object", why)),
        }
    }

    /// Returns the names of the folders in a group, sorted.
    pub(super) fn folders(&self, shown: &Path, relative: &str) -> Result<Vec<String>, ReadError> {
        if let Some(known) = &self.consolidated {
            let prefix = join(relative, "");
            let below = known.keys().filter_map(|path| path.strip_prefix(prefix.as_str()));
            let names: BTreeSet<&str> = below.filter_map(|path| Some(path.split_once('/')?.0)).collect();
            return Ok(names.into_iter().take(MAX_FOLDERS).map(str::to_owned).collect());
        }
        let fail = |why: &str| Err(ReadError::new(shown, "group", why));
        match self.remote.folders(relative, MAX_FOLDERS) {
            Some(Ok(names)) => Ok(names),
            None => fail(
                "no consolidated metadata, and what is in it cannot be listed over HTTP; expected the path of an array or image in it, \
                 as https://host/x.zarr:PATH",
            ),
            Some(Err(Fault::Missing)) => fail("no such bucket"),
            Some(Err(Fault::Forbidden)) => fail(
                "no consolidated metadata, and the store may not be listed (status 403); expected the path of an array or image in it, as \
                 s3://bucket/x.zarr:PATH",
            ),
            Some(Err(Fault::Other(why))) => fail(&why),
        }
    }
}
