//! What features cost: processor time of an isovalue with each over one without, in turns, `sin` 256³, on even and on uneven axes. `cargo run --release --package
//! isopeel-kernels --example derive_cost [ROUNDS]`; each line has the shortest time of all rounds.

mod common;

use common::processor_time;
use isopeel_kernels::{
    DerivedFeature, Engine, Feature, Grid, Isovalue, Never, RectilinearGrid, Result, SampleType, Shape, Synthetic,
    VectorFeature, Volume,
};

/// Samples along each axis.
const SIZE: u32 = 256;

fn main() -> Result<()> {
    let rounds = std::env::args().nth(1).and_then(|n| n.parse().ok()).unwrap_or(7);
    let engine = Engine::open(std::env::var("ISOPEEL_DEVICE").ok().as_deref())?;
    let grid = Grid::new([SIZE; 3], [1.0; 3])?;
    let make = |shape| {
        let synthetic = Synthetic {
            shape,
            period: SIZE as f32,
            closed: false,
        };
        engine.generate(&grid, SampleType::F32, &synthetic)
    };
    let even = [make(Shape::Sin)?, make(Shape::Waves)?, make(Shape::Gyroid)?];
    // Every other cell is half as long.
    let cell = |i: u32| if i.is_multiple_of(2) { 1.0 } else { 0.5 };
    let along = || (0..SIZE - 1).map(cell).collect::<Vec<f32>>();
    let rectilinear = RectilinearGrid::uneven(grid, [along(), along(), along()])?;
    let make_uneven = |volume: &Volume| {
        let samples = engine.download(volume, 0..SIZE)?;
        engine.upload(rectilinear.clone(), &samples, None)
    };
    let uneven = [make_uneven(&even[0])?, make_uneven(&even[1])?, make_uneven(&even[2])?];
    let iso = Isovalue::new(Shape::Sin.isovalue(SampleType::F32))?;
    let mut cases = Vec::new();
    for (axes, [volume, other, third]) in [("even", &even), ("uneven", &uneven)] {
        let mut features = vec![("none", Feature::None), ("another field", Feature::Field(other))];
        features.extend(DerivedFeature::ALL.iter().map(|&f| (f.name(), Feature::Derived(f))));
        let vectors = VectorFeature::ALL.iter();
        features.extend(vectors.map(|&f| (f.name(), Feature::Vector(f, [volume, other, third]))));
        cases.extend(
            features
                .into_iter()
                .map(|(name, feature)| (axes, name, volume, feature)),
        );
    }
    let mut shortest = vec![f64::INFINITY; cases.len()];
    for _ in 0..rounds {
        for ((_, _, volume, feature), shortest) in cases.iter().zip(&mut shortest) {
            let before = processor_time();
            engine.build_pyramid(volume, *feature, iso, &Never)?;
            *shortest = shortest.min(processor_time() - before);
        }
    }
    for ((axes, name, ..), time) in cases.iter().zip(&shortest) {
        println!("{axes:6} {name:20} {:7.1} ms  {:.3}", time / 1e6, time / shortest[0]);
    }
    Ok(())
}
