//! Files that change while they are read.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use isopeel::service::DeviceWorker;
use isopeel_extraction::WorkError;
use isopeel_kernels::Samples;
use isopeel_view::FeatureName;
use isopeel_volumes::{Field, FileLocation, ReadError, ReadProgress, Source, VolumeStep};

use crate::{ALONE, SIDE, dataset, field};

/// A file that another program writes during the first `writes` of its readings.
#[derive(Debug)]
struct Written {
    path: PathBuf,
    writes: usize,
    /// Such a reading fails.
    is_cut_off: bool,
    reads: AtomicUsize,
}

impl Source for Written {
    fn stored_bytes(&self) -> u64 {
        4 * SIDE.pow(3) as u64
    }

    fn inputs(&self, _: u32) -> Vec<FileLocation> {
        vec![FileLocation::disk(&self.path)]
    }

    fn read(&self, _: u32, _: &ReadProgress) -> Result<Samples, ReadError> {
        let read = self.reads.fetch_add(1, Ordering::Relaxed);
        if read < self.writes {
            // Of the same length.
            std::fs::write(self.path.with_extension("new"), [read as u8 + 1]).expect("written");
            std::fs::rename(self.path.with_extension("new"), &self.path).expect("renamed");
            if self.is_cut_off {
                return Err(ReadError::new(&self.path, "data", "it ends early"));
            }
        }
        Ok(Samples::F32((0..SIDE.pow(3)).map(|i| (i + read) as f32).collect()))
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_file_that_changes_while_it_is_read_is_read_again_or_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let _alone = ALONE.lock().await;
    let worker = DeviceWorker::start(None).expect("a thread");
    for (writes, is_cut_off, reads) in [
        (0, false, 1),
        (1, false, 2),
        (1, true, 2),
        (usize::MAX, false, 2),
        (usize::MAX, true, 2),
    ] {
        let path = folder.path().join("a.raw");
        std::fs::write(&path, [0]).expect("written");
        let source = Arc::new(Written {
            path,
            writes,
            is_cut_off,
            reads: AtomicUsize::default(),
        });
        let written = Field {
            source: source.clone(),
            ..field(&format!("{writes}{is_cut_off}"), &Arc::default())
        };
        let name = written.name.clone();
        let step = VolumeStep::new(dataset(vec![written]), 0).expect("a step");
        let found = worker.histogram(&step, &name, &FeatureName::None).await;
        assert_eq!(source.reads.load(Ordering::Relaxed), reads, "{writes} writes");
        match found {
            Ok(histogram) => assert_eq!(
                histogram.range[0],
                (reads - 1) as f32,
                "the samples of the last reading"
            ),
            Err(WorkError::Unreadable(error)) => {
                assert_eq!(writes, usize::MAX);
                assert!(
                    error.to_string().contains("written or replaced while it was read"),
                    "{error}"
                );
            }
            Err(error) => panic!("{error:?}"),
        }
    }
}
