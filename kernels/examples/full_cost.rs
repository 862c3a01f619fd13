//! What the full surface costs: best wall time and processor time of an isovalue with its mesh, `sin`, and the best time of each stage.
//! `cargo run --release --package isopeel-kernels --example full_cost [SIZE [TYPE [ROUNDS]]]`, as in `full_cost 256 u8 20`.

mod common;

use common::processor_time;
use isopeel_kernels::{
    CutParams, Engine, Feature, Grid, Isovalue, Level, Mesher, Never, Result, SampleType, Shape, Synthetic,
};
use std::collections::BTreeMap;
use std::time::Instant;

fn main() -> Result<()> {
    let mut args = std::env::args().skip(1);
    let size = args.next().and_then(|n| n.parse().ok()).unwrap_or(256);
    let sample_type = match args.next().as_deref() {
        Some("u8") => SampleType::U8,
        _ => SampleType::F32,
    };
    let rounds = args.next().and_then(|n| n.parse().ok()).unwrap_or(20);
    let engine = Engine::open(std::env::var("ISOPEEL_DEVICE").ok().as_deref())?;
    let synthetic = Synthetic {
        shape: Shape::Sin,
        period: size as f32,
        closed: false,
    };
    let volume = engine.generate(&Grid::new([size; 3], [1.0; 3])?, sample_type, &synthetic)?;
    let iso = Isovalue::new(Shape::Sin.isovalue(sample_type))?;
    let params = CutParams {
        mesher: Mesher::Dual,
        ..CutParams::paper(-1.0)
    };
    let (mut wall, mut processor) = (f64::INFINITY, f64::INFINITY);
    let mut stages = BTreeMap::<&str, f64>::new();
    for _ in 0..=rounds {
        let (start, before) = (Instant::now(), processor_time());
        let pyramid = engine.build_cells(&volume, Feature::None, iso, &Never)?;
        let surface = engine.peel(&volume, &pyramid, &params, Level::FINEST, &Never)?;
        wall = wall.min(start.elapsed().as_secs_f64() * 1e3);
        processor = processor.min((processor_time() - before) / 1e6);
        for time in &surface.statistics.stages {
            let best = stages.entry(time.stage).or_insert(f64::INFINITY);
            *best = best.min(time.milliseconds);
        }
    }
    print!("wall {wall:.2} ms, processor {processor:.2} ms");
    for (stage, milliseconds) in stages {
        print!(", {stage} {milliseconds:.2}");
    }
    println!();
    Ok(())
}
