//! Datasets whose samples are in host memory, not in files.

use std::fmt;
use std::path::Path;
use std::sync::Arc;

use isopeel_kernels::Samples;

use super::open::slug;
use super::{Dataset, Field, FileLocation, Geometry, Notices, ReadError, ReadProgress, Source};

/// The time steps of one field. Steps may share their samples.
struct MemorySamples {
    title: String,
    steps: Vec<Arc<Samples>>,
}

impl fmt::Debug for MemorySamples {
    /// Omits the samples, which may be gigabytes.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (title, steps) = (&self.title, self.steps.len());
        write!(out, "MemorySamples({title:?}, {steps} steps)")
    }
}

impl Source for MemorySamples {
    fn stored_bytes(&self) -> u64 {
        self.steps.first().map_or(0, |samples| samples.as_bytes().len() as u64)
    }

    fn inputs(&self, _: u32) -> Vec<FileLocation> {
        Vec::new()
    }

    fn read(&self, step: u32, progress: &ReadProgress) -> Result<Samples, ReadError> {
        let samples = self.steps.get(step as usize).ok_or_else(|| {
            let why = format!("{step}, expected one below {}", self.steps.len());
            ReadError::new(Path::new(&self.title), "step", why)
        })?;
        let samples = Samples::clone(samples);
        progress.add(samples.as_bytes().len() as u64);
        Ok(samples)
    }
}

/// Makes a dataset of one field, `value`, with these time steps.
///
/// # Errors
/// No step, a step whose number of samples differs from the grid's, or whose type differs from the first one's. The error's path is the
/// title.
pub fn memory_dataset(title: &str, geometry: Geometry, steps: Vec<Arc<Samples>>) -> Result<Dataset, ReadError> {
    let fail = |why: String| ReadError::new(Path::new(title), "data", why);
    let first = steps
        .first()
        .ok_or_else(|| fail("no time step, expected at least 1".to_owned()))?;
    let sample_type = first.sample_type();
    for (step, samples) in steps.iter().enumerate() {
        if samples.len() as u64 != geometry.sample_count() {
            let (found, expected) = (samples.len(), geometry.sample_count());
            return Err(fail(format!("step {step} has {found} samples, expected {expected}")));
        }
        if samples.sample_type() != sample_type {
            let (found, expected) = (samples.sample_type().name(), sample_type.name());
            return Err(fail(format!(
                "step {step} has samples of {found}, expected {expected} as in step 0"
            )));
        }
    }
    let count = u32::try_from(steps.len()).map_err(|_| fail(format!("{} time steps", steps.len())))?;
    Ok(Dataset {
        layout: "memory",
        id: slug(title),
        title: title.to_owned(),
        geometry,
        steps: count,
        uneven: None,
        axes: None,
        times: None,
        fields: vec![Field {
            name: "value".into(),
            stored_type: sample_type.name().into(),
            sample_type,
            missing: None,
            unit: None,
            labels: Vec::new(),
            declares_labels: false,
            source: Arc::new(MemorySamples {
                title: title.to_owned(),
                steps,
            }),
        }],
        revision: 0,
        rewrites: Vec::new(),
        notices: Notices::default(),
        opening: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_read_as_they_were_given() {
        let steps: Vec<_> = [1, 2].map(|value| Arc::new(Samples::U8(vec![value; 8]))).into();
        let dataset = memory_dataset("Two steps", Geometry::of_index([2; 3]), steps.clone()).expect("a dataset");
        assert_eq!((dataset.id.as_str(), dataset.steps), ("two-steps", 2));
        let source = &dataset.fields[0].source;
        assert_eq!(source.stored_bytes(), 8);
        for (step, samples) in (0..).zip(&steps) {
            let progress = ReadProgress::default();
            assert_eq!(source.read(step, &progress).expect("samples"), **samples);
            assert_eq!(progress.bytes(), 8);
        }
        let error = source.load(2).expect_err("no such step");
        assert_eq!(error.to_string(), "Two steps: step: 2, expected one below 2");
    }

    #[test]
    fn what_does_not_fit_the_grid_is_refused() {
        let of = |samples: Vec<Samples>| {
            let steps = samples.into_iter().map(Arc::new).collect();
            memory_dataset("x", Geometry::of_index([2; 3]), steps)
                .expect_err("refused")
                .to_string()
        };
        assert_eq!(of(vec![]), "x: data: no time step, expected at least 1");
        assert_eq!(
            of(vec![Samples::U8(vec![0; 7])]),
            "x: data: step 0 has 7 samples, expected 8"
        );
        assert_eq!(
            of(vec![Samples::U8(vec![0; 8]), Samples::F32(vec![0.0; 8])]),
            "x: data: step 1 has samples of f32, expected u8 as in step 0"
        );
    }
}
