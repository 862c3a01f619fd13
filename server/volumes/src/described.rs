//! Datasets in messages to another process, which gets everything but the samples.

use std::path::Path;
use std::sync::Arc;

use isopeel_geometry::UnevenAxes;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::{Dataset, FileLocation, Geometry, LabelRanks, Notices, ReadError, ReadProgress, Samples, Source};

/// What another process knows of the source of a field: its state when it was serialized.
#[derive(Debug, Serialize, Deserialize)]
struct DescribedSource {
    stored_bytes: u64,
    ranks: Option<Arc<LabelRanks>>,
    notices: Notices,
}

impl Source for DescribedSource {
    fn stored_bytes(&self) -> u64 {
        self.stored_bytes
    }

    fn inputs(&self, _: u32) -> Vec<FileLocation> {
        Vec::new()
    }

    fn read(&self, _: u32, _: &ReadProgress) -> Result<Samples, ReadError> {
        let why = "the samples are in another process, expected a field whose file this process has opened";
        Err(ReadError::new(Path::new(""), "data", why))
    }

    fn notices(&self) -> Notices {
        self.notices.clone()
    }

    fn ranks(&self) -> Option<Arc<LabelRanks>> {
        self.ranks.clone()
    }
}

/// The source of a field, for `serde(with)`.
pub(super) mod source {
    use super::{Arc, DescribedSource, Deserialize, Deserializer, Serialize, Serializer, Source};

    pub fn serialize<S: Serializer>(source: &Arc<dyn Source>, serializer: S) -> Result<S::Ok, S::Error> {
        let described = DescribedSource {
            stored_bytes: source.stored_bytes(),
            ranks: source.ranks(),
            notices: source.notices(),
        };
        described.serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Arc<dyn Source>, D::Error> {
        Ok(Arc::new(DescribedSource::deserialize(deserializer)?))
    }
}

isopeel_kernels::checked_serde!(Geometry, |geometry| {
    let padded = geometry.dims.map(|n| n.checked_add(2).filter(|n| *n >= 4));
    let count = padded.iter().try_fold(1u64, |count, n| count.checked_mul((*n)?.into()));
    let is_usable = count.is_some() && geometry.spacing.iter().all(|s| s.is_finite() && *s > 0.0);
    is_usable.then_some(()).ok_or("a grid without samples or distances")
});

isopeel_kernels::checked_serde!(Dataset, |dataset| {
    if dataset.steps == 0 || dataset.fields.is_empty() {
        return Err("a dataset without steps or fields");
    }
    let matches = |uneven: &UnevenAxes| (0..3).all(|axis| is_axis(uneven.of_axis(axis), dataset.geometry.dims[axis]));
    let is_usable = dataset.uneven.as_deref().is_none_or(matches);
    is_usable
        .then_some(())
        .ok_or("a dataset with uneven axes that are not those of its grid")
});

/// Whether positions are those of `count` samples, or those of an even axis.
fn is_axis(positions: Option<&[f64]>, count: u32) -> bool {
    let Some(positions) = positions else { return true };
    let ascends = positions.windows(2).all(|pair| pair[0] < pair[1]);
    ascends && positions.len() == count as usize && positions.iter().all(|at| at.is_finite())
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;
    use crate::{Label, VolumeStep, testing};

    /// A source in whose samples labels were found.
    #[derive(Debug)]
    struct Labels;

    impl Source for Labels {
        fn stored_bytes(&self) -> u64 {
            99
        }

        fn inputs(&self, _: u32) -> Vec<FileLocation> {
            Vec::new()
        }

        fn read(&self, _: u32, _: &ReadProgress) -> Result<Samples, ReadError> {
            Ok(Samples::U8(Vec::new()))
        }

        fn notices(&self) -> Notices {
            Notices::of("labels are ranks")
        }

        fn ranks(&self) -> Option<Arc<LabelRanks>> {
            let values = [-7, 0, (1 << 24) + 1, i128::MAX];
            Some(Arc::new(LabelRanks::new(values.into(), None)))
        }
    }

    fn volume(opening: Value) -> VolumeStep {
        let mut dataset = testing::dataset("head", [5, 6, 7], &["labels"]);
        dataset.fields[0].source = Arc::new(Labels);
        dataset.fields[0].labels = vec![Label::new((1 << 24) + 1, "bone", Some([1, 2, 3]))];
        dataset.opening = Some(opening);
        VolumeStep::new(Arc::new(dataset), 0).expect("a step")
    }

    fn sent(volume: &VolumeStep) -> Result<VolumeStep, postcard::Error> {
        postcard::from_bytes(&postcard::to_stdvec(volume)?)
    }

    #[test]
    fn a_volume_is_the_same_without_its_samples() {
        // 0.30000000000000004 and 1e23 are numbers that serde_json rounds when it reads their texts.
        let opening = json!({"a": [0.300_000_000_000_000_04, 1e23, -5, u64::MAX, null, true], "b": {"c": "é"}});
        let before = volume(opening.clone());
        let after = sent(&before).expect("a volume");
        assert_eq!(after.dataset().opening, Some(opening));
        let [before, after] = [before, after].map(|volume| volume.dataset().fields[0].clone());
        assert_eq!(before.all_labels(), after.all_labels());
        assert_eq!(before.source.ranks(), after.source.ranks());
        assert_eq!(before.source.notices(), after.source.notices());
        assert_eq!(after.source.stored_bytes(), 99);
    }

    #[test]
    fn deep_json_is_refused() {
        let nested = |depth| (0..depth).fold(Value::Null, |inner, _| json!([inner]));
        assert!(sent(&volume(nested(128))).is_ok());
        assert!(sent(&volume(nested(129))).is_err());
    }

    #[test]
    fn samples_stay_in_their_process() {
        let source = DescribedSource {
            stored_bytes: 7,
            ranks: None,
            notices: Notices::default(),
        };
        let error = source.load(0).expect_err("no samples").to_string();
        assert!(error.contains("in another process"), "{error}");
        assert!(source.inputs(0).is_empty());
    }

    #[test]
    fn positions_are_those_of_the_samples() {
        assert!(is_axis(None, 5) && is_axis(Some(&[0.0, 0.5, 2.0]), 3));
        for positions in [&[0.0, 1.0][..], &[0.0, 2.0, 1.0], &[0.0, 1.0, f64::NAN]] {
            assert!(!is_axis(Some(positions), 3), "{positions:?}");
        }
    }
}
