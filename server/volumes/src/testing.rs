//! Datasets for tests that read no samples.

use std::sync::Arc;

use isopeel_kernels::{SampleType, Samples};

use super::{Dataset, Field, FileLocation, Geometry, Notices, ReadError, ReadProgress, Source};

#[derive(Debug)]
struct NoSamples;

impl Source for NoSamples {
    fn stored_bytes(&self) -> u64 {
        0
    }

    fn inputs(&self, _: u32) -> Vec<FileLocation> {
        Vec::new()
    }

    fn read(&self, _: u32, _: &ReadProgress) -> Result<Samples, ReadError> {
        unreachable!("this test reads no samples")
    }
}

/// A dataset of one step whose fields have samples of one byte.
pub fn dataset(id: &str, dims: [u32; 3], fields: &[&str]) -> Dataset {
    let field = |name: &&str| Field {
        name: (*name).into(),
        stored_type: "u8".into(),
        sample_type: SampleType::U8,
        missing: None,
        unit: None,
        labels: Vec::new(),
        declares_labels: false,
        source: Arc::new(NoSamples),
    };
    Dataset {
        id: id.into(),
        title: "Test".into(),
        layout: "file",
        geometry: Geometry::of_index(dims),
        steps: 1,
        uneven: None,
        axes: None,
        times: None,
        revision: 0,
        rewrites: Vec::new(),
        fields: fields.iter().map(field).collect(),
        notices: Notices::default(),
        opening: None,
    }
}
