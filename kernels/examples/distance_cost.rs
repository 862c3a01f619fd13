//! What a field of distances takes: device time at 256³, to one sample, to few and to half of them, on even and on uneven axes; beside a copy of
//! as many bytes and a field that an expression gives. `cargo run --release --package isopeel-kernels --example distance_cost [ROUNDS]`; each line
//! has the shortest time of all rounds, which are in turns.

use isopeel_kernels::expression::{Comparison, Op};
use isopeel_kernels::{Engine, Expression, Grid, Never, RectilinearGrid, Result, Samples, Volume};

/// Samples along each axis.
const SIZE: u32 = 256;

fn main() -> Result<()> {
    let rounds = std::env::args().nth(1).and_then(|n| n.parse().ok()).unwrap_or(5);
    let engine = Engine::open(std::env::var("ISOPEEL_DEVICE").ok().as_deref())?;
    println!("{}", engine.device().name);
    let grid = Grid::new([SIZE; 3], [1.0; 3])?;
    // Every other cell is half as long.
    let along = || (1..SIZE).map(|i| 0.5 + (i % 2) as f32 / 2.0).collect::<Vec<f32>>();
    let uneven = RectilinearGrid::uneven(grid, [along(), along(), along()])?;
    let mut cases = Vec::new();
    for (axes, grid) in [("even", RectilinearGrid::from(grid)), ("uneven", uneven)] {
        for (name, rarity) in [("one inside", u64::MAX), ("1 of 1000", 1000), ("half", 2)] {
            cases.push((axes, name, labels(&engine, &grid, rarity)?));
        }
    }
    let ops = vec![
        Op::Field(0),
        Op::Number(1.0),
        Op::Compare(Comparison::Is, 0, 1),
        Op::Number(0.0),
        Op::Select(2, 1, 3),
    ];
    let expression = Expression::new(ops)?;
    let mut shortest = vec![[f64::INFINITY; 2]; cases.len()];
    let mut copy = f64::INFINITY;
    engine.take_times()?;
    for _ in 0..rounds {
        for ((.., volume), shortest) in cases.iter().zip(&mut shortest) {
            assert!(
                engine.distance_field(&expression, &[volume], 1.0, &Never)?.is_some(),
                "some are inside"
            );
            for time in engine.take_times()? {
                match time.stage {
                    "distance_field" => shortest[0] = shortest[0].min(time.milliseconds),
                    "evaluate" => shortest[1] = shortest[1].min(time.milliseconds),
                    _ => {}
                }
            }
        }
        let bytes = 2.0 * 4.0 * f64::from(SIZE).powi(3);
        copy = copy.min(1e3 * bytes / engine.measure()?.copy_bytes_per_second);
    }
    println!("a copy of {SIZE}³ floats: {copy:.2} ms");
    for ((axes, name, _), [distances, evaluate]) in cases.iter().zip(&shortest) {
        println!(
            "{axes:6} {name:10} {distances:8.2} ms, {:5.1} copies; evaluate {evaluate:.2} ms",
            distances / copy
        );
    }
    Ok(())
}

/// Labels in which one sample in `rarity` is 1, and also the one in the middle.
fn labels(engine: &Engine, grid: &RectilinearGrid, rarity: u64) -> Result<Volume> {
    let count = grid.grid().sample_count();
    let is_in = |i: u64| i == count / 2 || ((i + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 20).is_multiple_of(rarity);
    let samples = Samples::U8((0..count).map(|i| is_in(i).into()).collect());
    engine.upload(grid.clone(), &samples, None)
}
