//! Fields that an expression over others gives.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use isopeel::service::{DeviceWorker, describe_expression};
use isopeel_kernels::Samples;
use isopeel_view::{FeatureName, View};
use isopeel_volumes::{Field, FileLocation, ReadError, ReadProgress, Source, VolumeStep};
use tokio_util::sync::CancellationToken;

use crate::{ALONE, Distance, SIDE, dataset, field, view};

#[tokio::test(flavor = "multi_thread")]
async fn expressions_are_fields_and_features() {
    let _alone = ALONE.lock().await;
    let worker = DeviceWorker::start(None).expect("a thread");
    let (value, other) = (Arc::<Distance>::default(), Arc::<Distance>::default());
    let data = dataset(vec![field("value", &value), field("other", &other)]);
    let step = VolumeStep::new(data.clone(), 1).expect("a step");
    let token = CancellationToken::new();
    let extract = async |json: &str| {
        let view = view(&data, json);
        let made = worker.extract(&step, &view, &token).await.expect("a surface");
        (
            made.surface.statistics.full_triangles,
            made.surface.statistics.triangles,
        )
    };
    // All values are tripled: with three times the isovalue the surface is the same.
    let computed = r#""field": "2 * value + other""#;
    for rest in [
        "",
        r#", "cap": true"#,
        r#", "mask": "other>9""#,
        r#", "feature": "other", "alpha": 0.5"#,
    ] {
        let plain = extract(&format!(r#"{{"field": "value", "iso": 11.25, "beta": 0.01{rest}}}"#)).await;
        let found = extract(&format!(r#"{{{computed}, "iso": 33.75, "beta": 0.01{rest}}}"#)).await;
        assert!(plain.0 > 1000, "{plain:?}");
        assert_eq!(found, plain, "{rest}");
    }
    // As a feature: the field itself, scaled.
    let with = async |feature: &str, lo: f32| {
        let json = format!(
            r#"{{"field": "value", "iso": 11.25, "beta": 0.3, "alpha": 0.5, "feature": "{feature}", "featureRange": [{lo}, {}]}}"#,
            2.0 * lo
        );
        extract(&json).await
    };
    assert_eq!(with("magnitude(other, 0)", 9.0).await, with("other", 9.0).await);
    assert_eq!(with("4 * other", 36.0).await, with("other", 9.0).await);
    // Nothing was read for a second expression: padded and masked ones are computed on the host.
    let loads = (value.loads.load(Ordering::Relaxed), other.loads.load(Ordering::Relaxed));
    extract(r#"{"field": "value - 3 * other", "iso": -30}"#).await;
    assert_eq!(
        loads,
        (value.loads.load(Ordering::Relaxed), other.loads.load(Ordering::Relaxed))
    );
    // Isovalue and range come from its own histogram.
    let resolved = worker
        .resolve(
            &step,
            &view(&data, r#"{"field": "-value", "feature": "other / 2"}"#),
            &token,
        )
        .await
        .expect("a view");
    assert!(resolved.iso.expect("an isovalue").get() < 0.0);
    let [low, high] = resolved.feature_range.expect("a range");
    assert!(low > 0.5 && high < 20.0 && low < high, "{low} to {high}");
    let error = View::plain(&data.field_names())
        .apply(
            &serde_json::from_str(r#"{"field": "log(valu)"}"#).expect("an edit"),
            &data.field_names(),
        )
        .expect_err("no such field");
    assert!(error.to_string().contains("character 5: no field \"valu\""), "{error}");
}

/// A field by the place of a sample.
#[derive(Debug)]
struct Placed(fn([f32; 3]) -> f32);

impl Source for Placed {
    fn stored_bytes(&self) -> u64 {
        4 * (SIDE * SIDE * SIDE) as u64
    }

    fn inputs(&self, _: u32) -> Vec<FileLocation> {
        Vec::new()
    }

    fn read(&self, _: u32, progress: &ReadProgress) -> Result<Samples, ReadError> {
        progress.add(self.stored_bytes());
        let at = |i: usize| i as f32 - 19.5;
        let sample = |i: usize| self.0([at(i % SIDE), at(i / SIDE % SIDE), at(i / SIDE / SIDE)]);
        Ok(Samples::F32((0..SIDE * SIDE * SIDE).map(sample).collect()))
    }
}

/// A vortex along z on a grid that is turned about z, by components along the world's axes. If expressions turn these back, features are
/// those of the vector.
#[tokio::test(flavor = "multi_thread")]
async fn expressions_turn_vectors_to_the_grid() {
    fn swirl([x, y, _]: [f32; 3]) -> [f32; 2] {
        let speed = 1.0 + (x * x + y * y) / 512.0;
        [-y * speed, x * speed]
    }
    let _alone = ALONE.lock().await;
    let worker = DeviceWorker::start(None).expect("a thread");
    let placed = |name: &str, value| Field {
        labels: Vec::new(),
        declares_labels: false,
        source: Arc::new(Placed(value)),
        ..field(name, &Arc::default())
    };
    let data = dataset(vec![
        field("value", &Arc::default()),
        placed("along x", |p| swirl(p)[0]),
        placed("along y", |p| swirl(p)[1]),
        placed("w", |_| 1.0),
        // The same in the world, whose y is the grid's x: a quarter turn, and another one of which x is 0.6 and y 0.8.
        placed("u4", |p| -swirl(p)[1]),
        placed("v4", |p| swirl(p)[0]),
        placed("u", |p| 0.6 * swirl(p)[0] - 0.8 * swirl(p)[1]),
        placed("v", |p| 0.8 * swirl(p)[0] + 0.6 * swirl(p)[1]),
    ]);
    let step = VolumeStep::new(data.clone(), 0).expect("a step");
    let token = CancellationToken::new();
    for feature in [
        "vorticity-magnitude",
        "divergence",
        "q-criterion",
        "lambda2",
        "helicity",
    ] {
        let range = async |components: &str| {
            let name = FeatureName::find(&format!("{feature}({components})"), &data.field_names()).expect("a feature");
            worker
                .histogram(&step, "value", &name)
                .await
                .expect("a histogram")
                .range
        };
        let aligned = range("along x,along y,w").await;
        assert_eq!(range("v4,-u4,w").await, aligned, "{feature}");
        let turned = range("0.6*u + 0.8*v, 0.6*v - 0.8*u, w").await;
        let size = aligned[0].abs().max(aligned[1].abs());
        for end in 0..2 {
            assert!(
                (turned[end] - aligned[end]).abs() <= 1e-4 * size.max(1.0),
                "{feature}: {turned:?}, expected {aligned:?}"
            );
        }
        let raw = range("u,v,w").await;
        assert!(
            (raw[1] - aligned[1]).abs() > 0.1 || (raw[0] - aligned[0]).abs() > 0.1,
            "{feature}: {raw:?} without turning, {aligned:?} with it"
        );
        let triangles = async |components: &str| {
            let json = format!(
                r#"{{"field": "value", "iso": 11.25, "beta": 0.3, "alpha": 0.5, "feature": "{feature}({components})"}}"#
            );
            let made = worker.extract(&step, &view(&data, &json), &token).await;
            made.expect("a surface").surface.statistics.triangles
        };
        assert_eq!(
            triangles("v4,-u4,w").await,
            triangles("along x,along y,w").await,
            "{feature}"
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn expressions_are_described_as_fields_are() {
    let _alone = ALONE.lock().await;
    let worker = DeviceWorker::start(None).expect("a thread");
    let (value, other) = (Arc::<Distance>::default(), Arc::<Distance>::default());
    let in_metres = |name, source| Field {
        unit: Some("m".to_owned()),
        ..field(name, source)
    };
    let data = dataset(vec![in_metres("value", &value), in_metres("other", &other)]);
    let step = VolumeStep::new(data, 0).expect("a step");
    let own = describe_expression(&worker, &step, "value").await.expect("a field");
    let twice = describe_expression(&worker, &step, "value + other")
        .await
        .expect("a field");
    assert_eq!(
        (twice.name.as_str(), twice.sample_type, twice.unit.as_deref()),
        ("value + other", "f32", Some("m"))
    );
    assert_eq!(twice.range, own.range.map(|end| 2.0 * end));
    assert_eq!(
        twice.histogram.counts, own.histogram.counts,
        "the same bins, twice as wide"
    );
    let iso = |info: &isopeel::service::FieldInfo| info.opening_iso.as_ref().expect("an isovalue").iso;
    assert!((iso(&twice) - 2.0 * iso(&own)).abs() < 1e-3);
    let log = describe_expression(&worker, &step, "log(value)")
        .await
        .expect("a field");
    assert_eq!((log.unit, log.range[1]), (None, own.range[1].ln()));
    let error = describe_expression(&worker, &step, "value + wert")
        .await
        .expect_err("no such field");
    assert!(
        error
            .to_string()
            .contains("\"value + wert\", character 9: no field \"wert\""),
        "{error}"
    );
}
