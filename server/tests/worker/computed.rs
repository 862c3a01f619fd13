//! Fields that an expression over others gives.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use isopeel::extraction::{DeviceWorker, describe_expression};
use isopeel::view::View;
use isopeel::volumes::{Field, VolumeStep};
use tokio_util::sync::CancellationToken;

use crate::{ALONE, Distance, dataset, field, view};

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
        let made = worker.extract(&step, &view, u64::MAX, &token).await.expect("a surface");
        (
            made.surface.statistics.full_triangles,
            made.surface.statistics.triangles,
        )
    };
    // Three times the distance: the same surface where the isovalue is, too.
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
    let iso = |info: &isopeel::extraction::FieldInfo| info.opening_iso.as_ref().expect("an isovalue").iso;
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
