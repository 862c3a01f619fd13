//! The encoder on one thread, for regressions: `cargo bench -p isopeel-codec`. Against peers: `make bench`.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use isopeel_codec::chunk::PrefixId;
use isopeel_codec::encode::{MeshHash, encode};
use isopeel_kernels::{
    CutParams, Engine, Feature, Grid, Isovalue, Level, Mesher, Never, Region, Result, SampleType, Shape, Synthetic,
};

/// Regions of the full surface of a noisy volume.
fn regions() -> Result<Vec<Region>> {
    let engine = Engine::open(std::env::var("ISOPEEL_DEVICE").ok().as_deref())?;
    let grid = Grid::new([96; 3], [1.0; 3])?;
    let synthetic = Synthetic {
        shape: Shape::Sin,
        period: 96.0,
        closed: false,
    };
    let volume = engine.generate(&grid, SampleType::F32, &synthetic)?;
    let iso = Isovalue::new(Shape::Sin.isovalue(SampleType::F32))?;
    let pyramid = engine.build_pyramid(&volume, Feature::None, iso, &Never)?;
    let params = CutParams {
        mesher: Mesher::Dual,
        ..CutParams::paper(-1.0)
    };
    Ok(engine.peel(&volume, &pyramid, &params, Level::FINEST, &Never)?.regions)
}

fn encoder(criterion: &mut Criterion) {
    let regions = regions().expect("a surface");
    let triangles: u64 = regions.iter().map(|r| r.indices.len() as u64 / 3).sum();
    let mut group = criterion.benchmark_group("encoder");
    group.sample_size(20).throughput(Throughput::Elements(triangles));
    group.bench_function("hash", |b| {
        b.iter(|| {
            regions
                .iter()
                .fold(0, |all, region| all ^ MeshHash::of(region).unordered)
        });
    });
    group.bench_function("encode", |b| {
        b.iter(|| {
            let chunks = regions.iter().map(|region| encode(region, PrefixId::cut(0, 1, 0)));
            chunks.map(|chunk| chunk.expect("a whole region").len()).sum::<usize>()
        });
    });
    group.finish();
}

criterion_group!(benches, encoder);
criterion_main!(benches);
