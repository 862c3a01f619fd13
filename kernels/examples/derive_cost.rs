//! What features cost: processor time of an isovalue with each over one without, in turns, `sin` 256³. `cargo run --release --package
//! isopeel-kernels --example derive_cost [ROUNDS]`; each line has the shortest time of all rounds.

mod common;

use common::processor_time;
use isopeel_kernels::{
    DerivedFeature, Engine, Feature, Grid, Isovalue, Never, Result, SampleType, Shape, Synthetic, VectorFeature,
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
    let (volume, other, third) = (make(Shape::Sin)?, make(Shape::Waves)?, make(Shape::Gyroid)?);
    let iso = Isovalue::new(Shape::Sin.isovalue(SampleType::F32))?;
    let mut features = vec![("none", Feature::None), ("another field", Feature::Field(&other))];
    features.extend(DerivedFeature::ALL.iter().map(|&f| (f.name(), Feature::Derived(f))));
    let vectors = VectorFeature::ALL.iter();
    features.extend(vectors.map(|&f| (f.name(), Feature::Vector(f, [&volume, &other, &third]))));
    let mut shortest = vec![f64::INFINITY; features.len()];
    for _ in 0..rounds {
        for ((_, feature), shortest) in features.iter().zip(&mut shortest) {
            let before = processor_time();
            engine.build_pyramid(&volume, *feature, iso, &Never)?;
            *shortest = shortest.min(processor_time() - before);
        }
    }
    for ((name, _), time) in features.iter().zip(&shortest) {
        println!("{name:20} {:7.1} ms  {:.3}", time / 1e6, time / shortest[0]);
    }
    Ok(())
}
