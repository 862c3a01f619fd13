//! Volumes of formulas, the same bit for bit as in `tests/scripts/expected_cuts.py`, which made the counts: whole numbers
//! and square roots in f64 alone.

use isopeel_kernels::{Grid, Samples};

/// Odd on purpose: two regions along each axis, the last bricks cut off.
const DIMS: [u32; 3] = [47, 41, 37];

/// The volume of that name in the fixture; a missing sample is NaN.
pub fn volume(name: &str) -> (Grid, Samples) {
    let ball = |at: [f64; 3]| {
        let [x, y, z] = [at[0] - 23.25, at[1] - 19.125, (at[2] - 17.75) * 1.5];
        (1000.0 - 60.0 * (x * x + y * y + z * z).sqrt()).floor()
    };
    let (spacing, values): (_, Vec<f64>) = match name {
        "ball" => ([1.0, 1.0, 1.5], samples(|p| ball(p.map(f64::from)))),
        "ball with holes" => {
            let value = |p: [u32; 3]| Some(ball(p.map(f64::from))).filter(|v| v.rem_euclid(50.0) != 3.0);
            ([1.0, 1.0, 1.5], samples(|p| value(p).unwrap_or(f64::NAN)))
        }
        "waves" => ([1.0, 1.0, 1.5], samples(waves)),
        "rough" => ([0.5, 1.0, 2.0], samples(rough)),
        other => panic!("no volume named {other}"),
    };
    let grid = Grid::new(DIMS, spacing).expect("a valid grid");
    // In the type that such values have in files, so that not only f32 is compared.
    let samples = match name {
        "ball" => Samples::I16(values.iter().map(|&v| v as i16).collect()),
        "waves" => Samples::U8(values.iter().map(|&v| v as u8).collect()),
        _ => Samples::F32(values.iter().map(|&v| v as f32).collect()),
    };
    (grid, samples)
}

fn samples(value: impl Fn([u32; 3]) -> f64) -> Vec<f64> {
    let [nx, ny, nz] = DIMS;
    let at = |i: u32| [i % nx, i / nx % ny, i / nx / ny];
    (0..nx * ny * nz).map(|i| value(at(i))).collect()
}

/// Saddles and ambiguous faces.
fn waves([x, y, z]: [u32; 3]) -> f64 {
    let wave = |at: u32, half: u32| (at % (2 * half)).abs_diff(half);
    f64::from(2 * (wave(x, 7) * wave(y, 5) + wave(z, 6) * wave(x + y, 9)))
}

/// A tilted plane under noise, with single samples missing.
fn rough([x, y, z]: [u32; 3]) -> f64 {
    if (7 * x + 13 * y + 29 * z).is_multiple_of(997) {
        return f64::NAN;
    }
    let mixed = x.wrapping_mul(73_856_093) ^ y.wrapping_mul(19_349_663) ^ z.wrapping_mul(83_492_791);
    let noise = mixed.wrapping_mul(2_654_435_761) >> 24;
    3.0 * f64::from(x) - f64::from(y) + 2.0 * f64::from(z) - 80.0 + f64::from(noise) / 32.0
}
