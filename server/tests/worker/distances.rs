//! Distances to the samples at which a condition holds, as feature and as field.

use std::sync::Arc;

use isopeel::service::{DeviceWorker, describe_expression};
use isopeel_extraction::WorkError;
use isopeel_kernels::{SampleType, Samples};
use isopeel_volumes::{
    Dataset, Field, FileLocation, LengthUnit, ReadError, ReadProgress, Source, VolumeStep, open_dataset,
};
use tokio_util::sync::CancellationToken;

use crate::{ALONE, SIDE, dataset, field, view};

/// A field of bytes by the indices of a sample.
#[derive(Debug)]
struct Bytes(fn([usize; 3]) -> u8);

impl Source for Bytes {
    fn stored_bytes(&self) -> u64 {
        (SIDE * SIDE * SIDE) as u64
    }

    fn inputs(&self, _: u32) -> Vec<FileLocation> {
        Vec::new()
    }

    fn read(&self, _: u32, progress: &ReadProgress) -> Result<Samples, ReadError> {
        progress.add(self.stored_bytes());
        let sample = |i: usize| self.0([i % SIDE, i / SIDE % SIDE, i / SIDE / SIDE]);
        Ok(Samples::U8((0..SIDE * SIDE * SIDE).map(sample).collect()))
    }
}

/// Fields `value`, a ball of radius 11.25 or so; `labels`, with label 3 if x is below 4, and 255 for missing; and `ahead`, the distance to
/// that label along x.
fn labelled() -> Dataset {
    let bytes = |name: &str, value| Field {
        sample_type: SampleType::U8,
        missing: Some(255.0),
        labels: Vec::new(),
        declares_labels: false,
        source: Arc::new(Bytes(value)),
        ..field(name, &Arc::default())
    };
    let fields = vec![
        field("value", &Arc::default()),
        bytes("labels", |[x, y, _]| match (x, y) {
            (39, 0) => 255,
            (..4, _) => 3,
            _ => (x % 2) as u8,
        }),
        bytes("ahead", |[x, ..]| x.saturating_sub(3) as u8),
    ];
    Arc::into_inner(dataset(fields)).expect("nobody else has it")
}

#[tokio::test(flavor = "multi_thread")]
async fn triangles_go_near_what_a_distance_is_to() {
    let _alone = ALONE.lock().await;
    let worker = DeviceWorker::start(None).expect("a thread");
    let data = Arc::new(labelled());
    let step = VolumeStep::new(Arc::clone(&data), 0).expect("a step");
    let token = CancellationToken::new();
    // Vertices of the half of the ball that is nearer to the label, and of the other half.
    let halves = async |alpha: f32| {
        let json = format!(
            r##"{{"iso": 11.25, "beta": 0.5, "alpha": {alpha}, "feature": "distance(labels==3)", "featureRange": [5, 27],
            "transferFunction": {{"points": [{{"x": 0, "importance": 1, "color": "#000000"}}, {{"x": 1, "importance": 0, "color": "#ffffff"}}]}}}}"##
        );
        let made = worker.extract(&step, &view(&data, &json), &token).await;
        let regions = made.expect("a surface").surface.regions;
        let x = |region: &isopeel_kernels::Region| -> Vec<f32> {
            let of = |v: &isopeel_kernels::Vertex| {
                32.0 * region.coords[0] as f32 + v.position[0] as f32 / isopeel_kernels::Vertex::LATTICE as f32
            };
            region.vertices.iter().map(of).collect()
        };
        let all: Vec<f32> = regions.iter().flat_map(x).collect();
        let near = all.iter().filter(|&&x| x < 19.5).count();
        [near, all.len() - near]
    };
    let [near, far] = halves(1.0).await;
    assert!(
        near > 500 && near > 3 * far,
        "{near} vertices near the label, {far} far from it"
    );
    let [near, far] = halves(0.0).await;
    assert!(
        near.abs_diff(far) < near / 5,
        "{near} and {far} vertices without the distance"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn distances_are_fields_like_others() {
    let _alone = ALONE.lock().await;
    let worker = DeviceWorker::start(None).expect("a thread");
    let mut data = labelled();
    data.geometry.unit = Some(LengthUnit::Millimetre);
    let data = Arc::new(data);
    let step = VolumeStep::new(Arc::clone(&data), 0).expect("a step");
    let token = CancellationToken::new();
    let described = describe_expression(&worker, &step, "distance(labels==3)")
        .await
        .expect("a field");
    assert_eq!((described.range, described.unit.as_deref()), ([0.0, 36.0], Some("mm")));
    // The isosurface of the same values in a file, on the device, and on the host if it is capped or masked.
    let made = async |field: &str, rest: &str| {
        let json = format!(r#"{{"field": "{field}", "iso": 10.5, "beta": 0.02{rest}}}"#);
        worker.extract(&step, &view(&data, &json), &token).await
    };
    for rest in ["", r#", "cap": true"#, r#", "mask": "value>9""#] {
        let [found, expected] = [
            made("distance(labels==3)", rest)
                .await
                .expect("a surface")
                .surface
                .statistics,
            made("ahead", rest).await.expect("a surface").surface.statistics,
        ];
        assert!(expected.full_triangles > 1000);
        let counts = |s: &isopeel_kernels::SurfaceStatistics| (s.full_triangles, s.triangles, s.vertices);
        assert_eq!(counts(&found), counts(&expected), "{rest}");
    }
    // No sample has the label: an error on the device and on the host.
    for rest in ["", r#", "cap": true"#, r#", "mask": "value>9""#] {
        let error = made("distance(labels==9)", rest)
            .await
            .expect_err("no sample has that label");
        assert!(matches!(error, WorkError::Edit(_)), "{error:?}");
        assert!(error.to_string().contains("distance(labels==9)"), "{error}");
        assert!(
            error
                .to_string()
                .contains("holds at no sample of step 0, expected at least one"),
            "{error}"
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn distances_are_those_of_the_world_on_uneven_axes() {
    let _alone = ALONE.lock().await;
    let worker = DeviceWorker::start(None).expect("a thread");
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/fixtures/volumes/uneven.vtr");
    let data = Arc::new(open_dataset(file.as_ref()).expect("opens"));
    let (field, [nx, ny, _]) = (&data.fields[0], data.geometry.dims.map(|n| n as usize));
    let samples = field.source.load(0).expect("samples");
    let values: Vec<f32> = (0..samples.len()).map(|i| samples.get(i)).collect();
    let [low, high] = values
        .iter()
        .fold([f32::INFINITY, f32::NEG_INFINITY], |[l, h], &v| [l.min(v), h.max(v)]);
    let threshold = 0.1 * low + 0.9 * high;
    let space = data.sample_space();
    let place = |i: usize| space.world([i % nx, i / nx % ny, i / nx / ny].map(|i| i as f64).into());
    let inside: Vec<usize> = (0..values.len()).filter(|&i| values[i] > threshold).collect();
    assert!(
        (1..values.len() / 2).contains(&inside.len()),
        "{} samples inside",
        inside.len()
    );
    let to_nearest = |i: usize| {
        let between = |&k: &usize| (place(i) - place(k)).length();
        inside.iter().map(between).fold(f64::INFINITY, f64::min)
    };
    let farthest = (0..values.len()).map(to_nearest).fold(0.0, f64::max);
    let step = VolumeStep::new(Arc::clone(&data), 0).expect("a step");
    let text = format!("distance({} > {threshold:?})", field.name);
    let described = describe_expression(&worker, &step, &text).await.expect("a field");
    assert_eq!(described.range[0], 0.0);
    let found = f64::from(described.range[1]);
    assert!(
        (found - farthest).abs() < 1e-5 * farthest,
        "{found}, expected {farthest}"
    );
}
