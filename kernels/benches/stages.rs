//! Device time of every stage, for regressions: `cargo bench -p isopeel-kernels`. Criterion compares with the last run.
//! `ISOPEEL_DEVICE` chooses the device as `--device` does. Absolute figures and peers: `make bench`.

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use isopeel_kernels::{
    CutParams, Engine, Feature, Grid, Isovalue, Level, Mesher, Never, Pyramid, Result, SampleType, Shape, StageTime,
    Surface, Synthetic, Volume,
};
use std::time::Duration;

/// Samples along each axis.
const SIZE: u32 = 128;
/// Keeps about a quarter of the triangles.
const BETA: f32 = 0.17;

struct Bench {
    engine: Engine,
    volume: Volume,
    iso: Isovalue,
}

impl Bench {
    fn new() -> Result<Self> {
        let device = std::env::var("ISOPEEL_DEVICE").ok();
        let engine = Engine::open(device.as_deref())?;
        let grid = Grid::new([SIZE; 3], [1.0; 3])?;
        let synthetic = Synthetic {
            shape: Shape::Sin,
            period: SIZE as f32,
            closed: false,
        };
        let volume = engine.generate(&grid, SampleType::F32, &synthetic)?;
        let iso = Isovalue::new(Shape::Sin.isovalue(SampleType::F32))?;
        Ok(Self { engine, volume, iso })
    }

    fn pyramid(&self) -> Result<Pyramid> {
        self.engine.build_pyramid(&self.volume, Feature::None, self.iso, &Never)
    }

    fn peel(&self, pyramid: &Pyramid, mesher: Mesher) -> Result<Surface> {
        let params = CutParams {
            mesher,
            ..CutParams::paper(BETA)
        };
        self.engine.peel(&self.volume, pyramid, &params, Level::FINEST, &Never)
    }
}

fn time_of(stages: &[StageTime], stage: &str) -> Duration {
    let milliseconds = stages.iter().filter(|t| t.stage == stage).map(|t| t.milliseconds);
    Duration::from_secs_f64(milliseconds.sum::<f64>() / 1e3)
}

fn stages(criterion: &mut Criterion) {
    let mut bench = Bench::new().expect("a device");
    let mut group = criterion.benchmark_group("device time");
    group.sample_size(10);
    group.bench_function("minmax", |b| {
        b.iter_custom(|runs| {
            let run = |_| {
                time_of(
                    &bench.engine.refresh_table(&mut bench.volume).expect("a table"),
                    "minmax",
                )
            };
            (0..runs).map(run).sum()
        });
    });
    for stage in ["activate", "classify", "construct"] {
        group.bench_function(stage, |b| {
            b.iter_custom(|runs| {
                (0..runs)
                    .map(|_| time_of(bench.pyramid().expect("a pyramid").stages(), stage))
                    .sum()
            });
        });
    }
    let pyramid = bench.pyramid().expect("a pyramid");
    let before = pyramid.stages().len();
    for (mesher, name, stages) in [
        (Mesher::Dual, "dual", &["cut", "dual"][..]),
        (Mesher::MarchingCubes, "marching cubes", &["march", "patch", "pack"][..]),
    ] {
        for &stage in stages {
            group.bench_function(BenchmarkId::new(name, stage), |b| {
                b.iter_custom(|runs| {
                    let run = |_| {
                        let surface = bench.peel(&pyramid, mesher).expect("a surface");
                        time_of(&surface.statistics.stages[before..], stage)
                    };
                    (0..runs).map(run).sum()
                });
            });
        }
    }
    group.finish();
}

criterion_group!(benches, stages);
criterion_main!(benches);
