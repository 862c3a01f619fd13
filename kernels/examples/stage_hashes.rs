//! Hashes of every buffer after every kernel, on 20 small volumes and with the kernels of a CPU and of a GPU: what two
//! commits print on one machine and driver must be equal unless the later one changes arithmetic.
//! `tests/scripts/compare-stages.sh` compares two commits.
//!
//! `stage_hashes [SETTING|VOLUME]...` records these alone, as in `stage_hashes cpu 3 6`.
//!
//! Each line: volume, setting, step, number of the launch, its kernel, then bytes and hash of each of its buffers.

use isopeel_kernels::{
    CutParams, DerivedFeature, Engine, Feature, Grid, Isovalue, Level, Mesher, Never, Result, Samples, Topology,
    Tuning, VectorFeature, Volume,
};

/// A volume by formula.
struct Small {
    dims: [u32; 3],
    spacing: [f32; 3],
    pattern: Pattern,
    stored: Stored,
    /// Period in samples at which one is missing; 0: none.
    missing_every: usize,
    /// Largest allocation in bytes, so that the volume is stored in several slabs.
    limit_bytes: Option<u64>,
}

#[derive(Clone, Copy)]
enum Pattern {
    /// Three plane waves, and noise of that share.
    Waves(f32),
    Noise,
    /// Blocks of 3³ samples: ambiguous faces and thin walls.
    Blocks,
    Checkerboard,
    /// A ball, smooth: leaves of every level.
    Ball,
}

#[derive(Clone, Copy)]
enum Stored {
    U8,
    I8,
    U16,
    I16,
    F32,
}

const fn small(dims: [u32; 3], pattern: Pattern, stored: Stored) -> Small {
    Small {
        dims,
        spacing: [1.0, 1.0, 1.0],
        pattern,
        stored,
        missing_every: 0,
        limit_bytes: None,
    }
}

const VOLUMES: [Small; 20] = [
    small([2, 2, 2], Pattern::Noise, Stored::F32),
    small([3, 17, 9], Pattern::Noise, Stored::U8),
    small([33, 33, 33], Pattern::Waves(0.0), Stored::F32),
    small([40, 40, 40], Pattern::Waves(0.1), Stored::F32),
    small([40, 40, 40], Pattern::Waves(0.5), Stored::U16),
    small([65, 9, 40], Pattern::Waves(0.02), Stored::I16),
    small([48, 44, 36], Pattern::Ball, Stored::F32),
    small([70, 70, 70], Pattern::Ball, Stored::U8),
    small([20, 21, 22], Pattern::Blocks, Stored::U8),
    small([35, 18, 34], Pattern::Blocks, Stored::I8),
    small([12, 12, 12], Pattern::Checkerboard, Stored::F32),
    small([34, 5, 5], Pattern::Checkerboard, Stored::U16),
    small([36, 20, 20], Pattern::Noise, Stored::I16),
    Small {
        spacing: [1.0, 0.3, 7.0],
        ..small([34, 34, 18], Pattern::Waves(0.1), Stored::F32)
    },
    Small {
        spacing: [0.5, 0.5, 1.25],
        ..small([40, 33, 20], Pattern::Blocks, Stored::F32)
    },
    Small {
        missing_every: 997,
        ..small([40, 40, 34], Pattern::Waves(0.05), Stored::F32)
    },
    Small {
        missing_every: 301,
        ..small([33, 20, 36], Pattern::Waves(0.05), Stored::U8)
    },
    Small {
        missing_every: 97,
        ..small([18, 34, 18], Pattern::Blocks, Stored::I16)
    },
    Small {
        limit_bytes: Some(850_000),
        ..small([70, 70, 97], Pattern::Ball, Stored::F32)
    },
    Small {
        limit_bytes: Some(850_000),
        missing_every: 1501,
        ..small([66, 34, 90], Pattern::Waves(0.0), Stored::F32)
    },
];

/// A number in [-1, 1) that depends on nothing but `n` (SplitMix64).
fn random(n: u64) -> f32 {
    let mut z = n.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ z >> 31) >> 40) as f32 / (1u64 << 23) as f32 - 1.0
}

impl Small {
    /// In [-1, 1].
    fn value(&self, p: [u32; 3], index: usize) -> f32 {
        let [x, y, z] = p.map(|c| c as f32);
        match self.pattern {
            Pattern::Waves(noise) => {
                let waves = (0.31 * x + 0.17 * y).sin() + (0.23 * y - 0.29 * z).sin() + (0.19 * z + 0.11 * x).sin();
                (waves / 3.0 + noise * random(index as u64)).clamp(-1.0, 1.0)
            }
            Pattern::Noise => (random(index as u64) * 2.4).round() / 2.4,
            Pattern::Blocks => {
                let [x, y, z] = p.map(|c| u64::from(c / 3));
                if random(x | y << 10 | z << 20) > 0.1 {
                    0.5
                } else {
                    -0.75
                }
            }
            Pattern::Checkerboard => ((p[0] + p[1] + p[2]) % 2) as f32 - 0.5,
            Pattern::Ball => {
                let centre = self.dims.map(|n| n as f32 * 0.47);
                let radius = centre[0].min(centre[1]).min(centre[2]) * 0.9;
                let distance = ((x - centre[0]).powi(2) + (y - centre[1]).powi(2) + (z - centre[2]).powi(2)).sqrt();
                ((radius - distance) / 8.0).clamp(-1.0, 1.0)
            }
        }
    }

    /// Samples, the value that counts as missing, isovalue.
    fn make(&self) -> (Samples, Option<f32>, f32) {
        let [nx, ny, nz] = self.dims;
        let points = (0..nz).flat_map(|z| (0..ny).flat_map(move |y| (0..nx).map(move |x| [x, y, z])));
        let values = points.enumerate().map(|(index, p)| {
            let missing = self.missing_every > 0 && index % self.missing_every == self.missing_every / 2;
            (self.value(p, index), missing)
        });
        macro_rules! integers {
            ($type:ty, $variant:ident) => {{
                let half = (<$type>::MAX as f32 - <$type>::MIN as f32) / 2.0;
                let middle = half + <$type>::MIN as f32;
                let value = |(v, missing): (f32, bool)| match missing {
                    true => <$type>::MIN,
                    false => (middle + v * half).round().max(<$type>::MIN as f32 + 1.0) as $type,
                };
                let samples = Samples::$variant(values.map(value).collect());
                (
                    samples,
                    (self.missing_every > 0).then_some(<$type>::MIN as f32),
                    middle.ceil(),
                )
            }};
        }
        match self.stored {
            Stored::U8 => integers!(u8, U8),
            Stored::I8 => integers!(i8, I8),
            Stored::U16 => integers!(u16, U16),
            Stored::I16 => integers!(i16, I16),
            Stored::F32 => {
                let samples = values.map(|(v, missing)| if missing { f32::NAN } else { v }).collect();
                (Samples::F32(samples), None, 0.0)
            }
        }
    }
}

/// Prints what was launched since the last call.
fn print(engine: &Engine, volume: usize, setting: &str, step: &str) {
    for (number, launch) in engine.take_launches().iter().enumerate() {
        print!("{volume:02} {setting} {step} {number} {}", launch.kernel);
        for buffer in &launch.buffers {
            print!(" {}:{:016x}", buffer.bytes, buffer.hash);
        }
        println!();
    }
}

/// The cuts that are meshed of each pyramid: name, parameters, prefix.
fn cuts(spacing: [f32; 3]) -> Vec<(&'static str, CutParams, u8)> {
    let range = [0.0, 0.3];
    let paper = |beta| CutParams {
        alpha: 0.3,
        feature_range: range,
        ..CutParams::paper(beta)
    };
    let dual = |beta| CutParams {
        mesher: Mesher::Dual,
        ..paper(beta)
    };
    let guarded = CutParams {
        max_error: Some(0.2 * spacing[0]),
        topology: Topology::Preserve,
        state_error: true,
        ..dual(0.3)
    };
    let stated = CutParams {
        state_error: true,
        ..dual(0.05)
    };
    let capped = CutParams {
        cap: true,
        ..dual(0.02)
    };
    let shallow = CutParams {
        max_level: Level::new(2).expect("a level"),
        ..dual(0.1)
    };
    vec![
        ("paper", paper(0.02), 0),
        ("paper-coarse", paper(0.2), 0),
        ("paper-prefix", paper(0.02), 3),
        ("dual", dual(0.02), 0),
        ("dual-prefix", dual(0.02), 4),
        ("dual-full", dual(-1.0), 0),
        ("dual-coarsest", dual(1.0), 0),
        ("guarded", guarded, 0),
        ("stated", stated, 0),
        ("capped", capped, 0),
        ("shallow", shallow, 0),
    ]
}

fn run(engine: &Engine, index: usize, setting: &str, volume: &Volume, other: &Volume, iso: f32) -> Result<()> {
    engine.histogram(volume, Feature::None)?;
    engine.histogram(volume, Feature::Derived(DerivedFeature::GradientMagnitude))?;
    print(engine, index, setting, "histogram");
    let iso = Isovalue::new(iso)?;
    let cells = engine.build_cells(volume, Feature::None, iso, &Never)?;
    print(engine, index, setting, "cells");
    let full = CutParams {
        mesher: Mesher::Dual,
        ..CutParams::paper(-1.0)
    };
    engine.peel(volume, &cells, &full, Level::FINEST, &Never)?;
    print(engine, index, setting, "cells/dual-full");
    let features = [
        ("none", Feature::None),
        ("gradient", Feature::Derived(DerivedFeature::GradientMagnitude)),
        ("field", Feature::Field(other)),
    ];
    for (name, feature) in features {
        let pyramid = engine.build_pyramid(volume, feature, iso, &Never)?;
        print(engine, index, setting, name);
        // What a feature changes in a cut is shown by a few of them.
        let cuts = cuts(volume.grid().spacing).into_iter();
        for (cut, params, prefix) in cuts.filter(|(cut, ..)| name == "none" || ["paper", "guarded"].contains(cut)) {
            engine.peel(volume, &pyramid, &params, Level::new(prefix)?, &Never)?;
            print(engine, index, setting, &format!("{name}/{cut}"));
        }
    }
    let derived = DerivedFeature::ALL.iter().map(|&f| (f.name(), Feature::Derived(f)));
    let vectors = VectorFeature::ALL.iter();
    let vectors = vectors.map(|&f| (f.name(), Feature::Vector(f, [volume, other, volume])));
    for (name, feature) in derived.chain(vectors) {
        engine.histogram(volume, feature)?;
        engine.build_cells(volume, feature, iso, &Never)?;
        print(engine, index, setting, name);
    }
    Ok(())
}

fn main() -> Result<()> {
    let device = std::env::var("ISOPEEL_DEVICE").ok();
    let wanted: Vec<String> = std::env::args().skip(1).collect();
    let (volumes, settings): (Vec<_>, Vec<_>) = wanted.iter().partition(|word| word.parse::<usize>().is_ok());
    let any_of = |words: &[&String], word: &str| words.is_empty() || words.iter().any(|w| *w == word);
    for (setting, tuning) in [("cpu", Tuning::CPU), ("gpu", Tuning::GPU)] {
        if !any_of(&settings, setting) {
            continue;
        }
        for limit_bytes in [None, Some(850_000)] {
            let engine = Engine::open_tuned(device.as_deref(), limit_bytes, Some(tuning))?;
            let volumes = VOLUMES
                .iter()
                .enumerate()
                .filter(|(index, v)| v.limit_bytes == limit_bytes && any_of(&volumes, &index.to_string()));
            for (index, small) in volumes {
                let grid = Grid::new(small.dims, small.spacing)?;
                let (samples, missing, iso) = small.make();
                engine.record_launches();
                let volume = engine.upload(grid, &samples, missing)?;
                // The feature's field: the same numbers, others of them missing.
                let other = engine.upload(grid, &samples, Some(iso))?;
                print(&engine, index, setting, "upload");
                run(&engine, index, setting, &volume, &other, iso)?;
                eprintln!("{setting}: volume {index} of {}", VOLUMES.len());
            }
        }
    }
    Ok(())
}
