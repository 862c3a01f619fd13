//! A store and results in a folder of their own, and files that no device makes.

use std::collections::BTreeSet;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use async_trait::async_trait;
use isopeel_extraction::MeasuredError;
use isopeel_volumes::testing::dataset;
use isopeel_volumes::{InputIdentity, SeenFiles};
use sha2::{Digest, Sha256};
use tempfile::TempDir;
use tokio_util::sync::CancellationToken;

use super::maker::{MakeFailure, Maker};
use super::results::{Checksum, ResultFile, Results};
use super::runner::{Backoff, Runner, Signals};
use super::state::Estimate;
use super::store::Store;
use super::store::requests::{NewJob, RequestKey};
use super::store::work::Work;
use super::{Limits, OPERATOR};
use crate::export::ExportError;

pub(super) const LIMITS: Limits = Limits { quota_bytes: 1 << 30 };

/// Store and results of a folder, as a server opens them.
pub(super) async fn open(folder: &Path) -> (Store, Results) {
    let store = Store::open(&folder.join("jobs.sqlite")).unwrap();
    let results = Results::open(&folder.join("results")).unwrap();
    results.sweep(&store.results().await.unwrap()).unwrap();
    (store, results)
}

/// In a folder that goes with the test.
pub(super) async fn open_new() -> (TempDir, Store, Results) {
    let folder = tempfile::tempdir().unwrap();
    let (store, results) = open(folder.path()).await;
    (folder, store, results)
}

/// Returns a job with a number of extractions.
pub(super) fn job(id: &str, key: Option<&str>, extractions: u32) -> NewJob {
    let identity = InputIdentity::of(
        &dataset("a", [2; 3], &["f"]),
        &BTreeSet::from([0]),
        &SeenFiles::default(),
    );
    NewJob {
        id: id.into(),
        request: RequestKey {
            owner: OPERATOR.into(),
            key: key.map(str::to_owned),
            digest: Sha256::digest(extractions.to_le_bytes()).into(),
        },
        volume: "a".into(),
        input: serde_json::to_string(&identity.unwrap()).unwrap(),
        extractions: (0..extractions)
            .map(|n| format!(r#"{{"step":0,"format":"stl","iso":{n}.0}}"#))
            .collect(),
        estimate: Estimate {
            triangles: 1_000,
            bytes: 1_000,
            seconds: 10.0,
        },
    }
}

/// What the file of an extraction holds.
pub(super) fn content(work: &Work) -> Vec<u8> {
    // More than a part of a result.
    let length = 100_000 + 4_500_000 * usize::from(work.extraction == 1);
    let seed = work.extraction as u8;
    (0..length).map(|i| (i as u8).wrapping_mul(31) ^ seed).collect()
}

pub(super) fn checksum(bytes: &[u8]) -> Checksum {
    Sha256::digest(bytes).into()
}

struct Content(Vec<u8>);

impl ResultFile for Content {
    fn write(&self, out: &mut dyn Write) -> Result<(), ExportError> {
        Ok(out.write_all(&self.0)?)
    }

    fn triangles(&self) -> u64 {
        7
    }

    fn error(&self) -> Option<MeasuredError> {
        Some(MeasuredError { rms: 0.25, max: 0.5 })
    }

    fn notices(&self) -> Vec<String> {
        vec!["rounded".into()]
    }
}

/// Failures that a [`FakeMaker`] returns instead of a file.
pub(super) type Trouble = Arc<dyn Fn(&Work, u32) -> Option<MakeFailure> + Send + Sync>;

/// Makes [`content`], and counts how often.
#[derive(Clone)]
pub(super) struct FakeMaker {
    pub made: Arc<AtomicU32>,
    pub trouble: Trouble,
    /// Waits for the token before it ends.
    pub is_slow: bool,
}

impl Default for FakeMaker {
    fn default() -> Self {
        Self {
            made: Arc::default(),
            trouble: Arc::new(|_, _| None),
            is_slow: false,
        }
    }
}

#[async_trait]
impl Maker for FakeMaker {
    async fn make(&self, work: &Work, token: &CancellationToken) -> Result<Box<dyn ResultFile>, MakeFailure> {
        let made = self.made.fetch_add(1, Ordering::Relaxed);
        if self.is_slow {
            token.cancelled().await;
        }
        match (self.trouble)(work, made) {
            Some(failure) => Err(failure),
            None => Ok(Box::new(Content(content(work)))),
        }
    }

    async fn check(&self, _: &Work) -> Result<(), MakeFailure> {
        Ok(())
    }
}

/// A runner that tries again soon.
pub(super) fn runner(store: &Store, results: &Results, maker: FakeMaker) -> Runner<FakeMaker> {
    Runner {
        store: store.clone(),
        results: results.clone(),
        maker,
        signals: Arc::new(Signals::default()),
        stop: CancellationToken::new(),
        quota_bytes: LIMITS.quota_bytes,
        backoff: Backoff {
            first: Duration::from_millis(5),
            longest: Duration::from_millis(20),
        },
    }
}
