//! Twins and device against counts from independent float64 implementations (docs/algorithm.md#11-check-values).
//!
//! Volumes of the embedded demo are in the repository, others are made of formulas ([`synthetic`]). Those of
//! `expected-cuts-volumes.jsonl` are not in the repository: their tests are ignored unless asked for (`make test-volumes`),
//! and then fail if a file is missing.

mod synthetic;

use isopeel_kernels::tables::cases;
use isopeel_kernels::testing::device;
use isopeel_kernels::{CutParams, Engine, Isovalue, Level, Never, Volume};
use isopeel_kernels::{Feature as DeviceFeature, Grid, Samples};
use isopeel_reference::{Feature, Field, Pipeline, files};
use serde::Deserialize;
use std::collections::HashMap;

/// One line of a fixture.
#[derive(Deserialize)]
struct Expected {
    volume: String,
    dims_xyz: [u32; 3],
    iso: f32,
    alpha: f32,
    feature: Option<String>,
    feature_range: Option<[f32; 2]>,
    beta: f32,
    full_triangles: u64,
    active_cells: u64,
    leaves_per_level: [u64; 6],
    decimated_triangles: u64,
}

impl Expected {
    fn params(&self) -> CutParams {
        CutParams {
            alpha: self.alpha,
            feature_range: self.feature_range.unwrap_or([0.0, 1.0]),
            ..CutParams::paper(self.beta)
        }
    }
}

/// What is compared.
struct Counts {
    full_triangles: u64,
    active_cells: u64,
    leaves: [u64; 6],
    triangles: u64,
}

/// Lines of volumes made of formulas.
const SYNTHETIC: &str = include_str!("../../../../tests/fixtures/expected-cuts-synthetic.jsonl");
/// Lines of the demo's volumes.
const DEMO: &str = include_str!("../../../../tests/fixtures/expected-cuts-demo.jsonl");
/// Lines of volumes that are not in the repository.
const VOLUMES: &str = include_str!("../../../../tests/fixtures/expected-cuts-volumes.jsonl");

fn demo_volume(name: &str) -> (Grid, Samples) {
    files::read(&files::repository_file(&format!("server/demo/{name}")))
}

fn rows(fixture: &str) -> Vec<Expected> {
    let row = |line| serde_json::from_str(line).expect("a line of the fixture");
    let rows: Vec<Expected> = fixture.lines().map(row).collect();
    assert!(!rows.is_empty());
    rows
}

/// Within 0.1 %; small counts may be one off, by a node that lies at the threshold.
fn assert_close(what: &str, got: u64, expected: u64) {
    let tolerance = (expected as f64 * 0.001).max(1.0);
    assert!(
        (got as f64 - expected as f64).abs() <= tolerance,
        "{what}: {got}, expected {expected}"
    );
}

fn compare(row: &Expected, got: &Counts) {
    let name = format!("{} at {}, alpha {}, beta {}", row.volume, row.iso, row.alpha, row.beta);
    assert_eq!(got.full_triangles, row.full_triangles, "{name}: full triangles");
    assert_eq!(got.active_cells, row.active_cells, "{name}: active cells");
    for (level, (got, expected)) in got.leaves.into_iter().zip(row.leaves_per_level).enumerate() {
        assert_close(&format!("{name}: leaves of level {level}"), got, expected);
    }
    assert_close(&format!("{name}: triangles"), got.triangles, row.decimated_triangles);
}

/// Lines that one pyramid serves stand together.
fn groups(rows: &[Expected]) -> impl Iterator<Item = &[Expected]> {
    rows.chunk_by(|a, b| (&a.volume, a.iso, &a.feature) == (&b.volume, b.iso, &b.feature))
}

/// Loads every volume of the rows once.
fn load_all<T>(rows: &[Expected], load: impl Fn(&str) -> T) -> HashMap<&str, T> {
    let mut loaded = HashMap::new();
    for row in rows {
        for name in std::iter::once(&row.volume).chain(&row.feature) {
            loaded.entry(name.as_str()).or_insert_with(|| load(name));
        }
    }
    loaded
}

fn check_twins(fixture: &str, load: impl Fn(&str) -> (Grid, Samples)) {
    let rows = rows(fixture);
    let fields = load_all(&rows, |name| {
        let (grid, samples) = load(name);
        Field::from_samples(grid, &samples, None)
    });
    let table = cases::case_triangles();
    for group in groups(&rows) {
        let field = &fields[group[0].volume.as_str()];
        assert_eq!(field.grid.dims, group[0].dims_xyz);
        let feature = group[0].feature.as_deref();
        let feature = feature.map_or(Feature::None, |name| Feature::Field(&fields[name]));
        let pipeline = Pipeline::new(field, feature, group[0].iso);
        for row in group {
            let cut = pipeline.cut(&row.params(), Level::FINEST);
            let triangles = |signs: u8| u64::from(table[usize::from(signs)][0]);
            let counts = Counts {
                full_triangles: pipeline.pyramid.full_triangles(),
                active_cells: pipeline.pyramid.cells.len() as u64,
                leaves: cut.counts(),
                triangles: cut.leaves.values().map(|n| triangles(n.signs)).sum(),
            };
            compare(row, &counts);
        }
    }
}

fn check_device(engine: &Engine, fixture: &str, load: impl Fn(&str) -> (Grid, Samples)) {
    let rows = rows(fixture);
    let volumes: HashMap<&str, Volume> = load_all(&rows, |name| {
        let (grid, samples) = load(name);
        engine.upload(grid, &samples, None).expect("upload")
    });
    for group in groups(&rows) {
        let volume = &volumes[group[0].volume.as_str()];
        let feature = group[0].feature.as_deref();
        let feature = feature.map_or(DeviceFeature::None, |name| DeviceFeature::Field(&volumes[name]));
        let iso = Isovalue::new(group[0].iso).expect("finite");
        let pyramid = engine.build_pyramid(volume, feature, iso, &Never);
        let pyramid = pyramid.expect("build the pyramid");
        for row in group {
            let surface = engine.peel(volume, &pyramid, &row.params(), Level::FINEST, &Never);
            let surface = surface.expect("peel");
            let statistics = &surface.statistics;
            let counts = Counts {
                full_triangles: statistics.full_triangles,
                active_cells: statistics.active_cells,
                leaves: statistics.leaves,
                triangles: statistics.triangles,
            };
            compare(row, &counts);
            let in_regions: usize = surface.regions.iter().map(|r| r.indices.len() / 3).sum();
            assert_eq!(in_regions as u64, statistics.triangles);
        }
    }
}

#[test]
fn twins_cut_synthetic_volumes_as_expected() {
    check_twins(SYNTHETIC, synthetic::volume);
}

#[test]
fn device_cuts_synthetic_volumes_as_expected() {
    let Some(engine) = device() else { return };
    check_device(&engine, SYNTHETIC, synthetic::volume);
}

#[test]
fn twins_cut_the_demo_as_expected() {
    check_twins(DEMO, demo_volume);
}

#[test]
fn device_cuts_the_demo_as_expected() {
    let Some(engine) = device() else { return };
    check_device(&engine, DEMO, demo_volume);
}

#[test]
#[ignore = "its volumes are not in the repository: make test-volumes"]
fn twins_cut_large_volumes_as_expected() {
    check_twins(VOLUMES, files::read_from_data_folder);
}

#[test]
#[ignore = "its volumes are not in the repository: make test-volumes"]
fn device_cuts_large_volumes_as_expected() {
    let Some(engine) = device() else { return };
    check_device(&engine, VOLUMES, files::read_from_data_folder);
}
