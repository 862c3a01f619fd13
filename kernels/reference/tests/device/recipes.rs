//! Random volumes of many kinds, each made by a recipe that a failing test prints.

use isopeel_kernels::{Grid, SampleType, Samples};
use proptest::prelude::*;

/// SplitMix64: the same numbers everywhere.
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    /// In [0, 1).
    pub fn unit(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1u64 << 24) as f32
    }
}

/// What the values look like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pattern {
    /// Five values, the middle one exactly the isovalue.
    Noise,
    /// Two values in blocks of 2³ to 5³ samples: ambiguous faces and thin walls, yet cubes to merge.
    Blocks,
    /// Waves, and noise of the given hundredths on them.
    Waves(u8),
    Checkerboard,
    Constant,
    /// Ends of the type's range, for floats infinities too.
    Extremes,
}

/// How to make a volume.
#[derive(Clone, Debug)]
pub struct Recipe {
    pub dims: [u32; 3],
    pub spacing: [f32; 3],
    pub pattern: Pattern,
    pub kind: SampleType,
    pub missing: bool,
    pub seed: u64,
}

impl Recipe {
    /// A float volume on unit spacing without missing samples.
    pub fn plain(dims: [u32; 3], pattern: Pattern, seed: u64) -> Self {
        Self {
            dims,
            spacing: [1.0; 3],
            pattern,
            kind: SampleType::F32,
            missing: false,
            seed,
        }
    }

    /// Waves on `DIMS[i]`, samples missing in every other one.
    pub fn waves_on(i: usize) -> Self {
        Self {
            missing: i % 2 == 1,
            spacing: [1.0, 0.3, 7.0],
            ..Self::plain(DIMS[i], Pattern::Waves(20), i as u64)
        }
    }

    /// Grid, samples, the value that counts as missing, and an isovalue that is one of the values if it can be.
    pub fn make(&self) -> (Grid, Samples, Option<f32>, f32) {
        let grid = Grid::new(self.dims, self.spacing).expect("a valid grid");
        let mut random = Random(self.seed);
        let waves: Vec<[f32; 4]> = (0..4)
            .map(|_| std::array::from_fn(|i| random.unit() * [0.5, 0.5, 0.5, 6.3][i]))
            .collect();
        let block = 2 + (random.next() % 4) as u32;
        // Values in [-1, 1], the isovalue at 0.
        let mut values = Vec::with_capacity(grid.sample_count() as usize);
        for z in 0..self.dims[2] {
            for y in 0..self.dims[1] {
                for x in 0..self.dims[0] {
                    let noise = random.unit() * 2.0 - 1.0;
                    values.push(match self.pattern {
                        Pattern::Noise => (noise * 2.4).round() / 2.0,
                        Pattern::Blocks => {
                            let [bx, by, bz] = [x, y, z].map(|c| u64::from(c / block));
                            let mut of = Random(self.seed ^ bx << 8 ^ by << 20 ^ bz << 32);
                            if of.next().is_multiple_of(2) { 0.5 } else { -0.75 }
                        }
                        Pattern::Waves(hundredths) => {
                            let at = [x as f32, y as f32, z as f32, 1.0];
                            let wave = |w: &[f32; 4]| (0..4).map(|i| w[i] * at[i]).sum::<f32>().sin();
                            (waves.iter().map(wave).sum::<f32>() / 4.0 + noise * f32::from(hundredths) / 100.0)
                                .clamp(-1.0, 1.0)
                        }
                        Pattern::Checkerboard => ((x + y + z) % 2) as f32 - 0.5,
                        Pattern::Constant => 0.0,
                        Pattern::Extremes => match random.next() % 8 {
                            0..=2 => 1.0,
                            3..=5 => -1.0,
                            6 => 0.0,
                            _ => noise,
                        },
                    });
                }
            }
        }
        // Missing samples stand alone or in small blocks, so that cubes without any are left.
        let mut holes = vec![false; values.len()];
        if self.missing {
            for _ in 0..values.len().div_ceil(3000) {
                let centre: [u32; 3] = std::array::from_fn(|i| (random.next() % u64::from(self.dims[i])) as u32);
                let size = random.next() as u32 % 3;
                let end = |i: usize| (centre[i] + size).min(self.dims[i] - 1);
                for z in centre[2]..=end(2) {
                    for y in centre[1]..=end(1) {
                        for x in centre[0]..=end(0) {
                            holes[((z * self.dims[1] + y) * self.dims[0] + x) as usize] = true;
                        }
                    }
                }
            }
        }
        let (samples, missing, iso) = self.convert(&values, &holes);
        (grid, samples, missing, iso)
    }

    fn convert(&self, values: &[f32], holes: &[bool]) -> (Samples, Option<f32>, f32) {
        macro_rules! integers {
            ($kind:ident, $variant:ident, $middle:expr) => {{
                // A missing sample is the minimum of the type, which no other sample then is.
                let minimum = $kind::MIN + u8::from(self.missing) as $kind;
                let value = |(&v, &hole): (&f32, &bool)| {
                    let scaled = $middle + v * ($kind::MAX as f32 - $middle + 1.0);
                    if hole {
                        $kind::MIN
                    } else {
                        (scaled.round() as $kind).max(minimum)
                    }
                };
                let samples = values.iter().zip(holes).map(value).collect();
                (
                    Samples::$variant(samples),
                    self.missing.then_some($kind::MIN as f32),
                    $middle,
                )
            }};
        }
        match self.kind {
            SampleType::U8 => integers!(u8, U8, 128.0f32),
            SampleType::I8 => integers!(i8, I8, 0.0f32),
            SampleType::U16 => integers!(u16, U16, 32768.0f32),
            SampleType::I16 => integers!(i16, I16, 0.0f32),
            SampleType::F32 => {
                let value = |(&v, &hole): (&f32, &bool)| match (hole, self.pattern) {
                    (true, _) => f32::NAN,
                    (_, Pattern::Extremes) if v == 1.0 => f32::INFINITY,
                    (_, Pattern::Extremes) if v == -1.0 => f32::NEG_INFINITY,
                    (_, Pattern::Extremes) => v * 1e37,
                    _ => v,
                };
                (Samples::F32(values.iter().zip(holes).map(value).collect()), None, 0.0)
            }
        }
    }
}

/// Extents: smallest, thin, odd, one region and one sample more, several regions.
pub const DIMS: [[u32; 3]; 7] = [
    [2, 2, 2],
    [2, 33, 40],
    [7, 93, 31],
    [33, 33, 33],
    [34, 18, 35],
    [65, 9, 70],
    [40, 40, 40],
];

pub fn kinds() -> impl Strategy<Value = SampleType> {
    prop_oneof![
        1 => Just(SampleType::U8),
        1 => Just(SampleType::I8),
        1 => Just(SampleType::U16),
        1 => Just(SampleType::I16),
        2 => Just(SampleType::F32),
    ]
}

/// Patterns that have a dual surface; [`any_recipe`] adds constants and infinities.
pub fn surfaces() -> impl Strategy<Value = Pattern> {
    prop_oneof![
        1 => Just(Pattern::Noise),
        2 => Just(Pattern::Blocks),
        2 => Just(Pattern::Waves(0)),
        2 => Just(Pattern::Waves(15)),
        1 => Just(Pattern::Waves(60)),
        1 => Just(Pattern::Checkerboard),
    ]
}

pub fn recipes(patterns: impl Strategy<Value = Pattern>) -> impl Strategy<Value = Recipe> {
    let dims = prop_oneof![
        3 => proptest::sample::select(DIMS.to_vec()),
        1 => [2..50u32, 2..50u32, 2..50u32],
    ];
    recipes_of(dims, prop_oneof![Just([1.0f32; 3]), Just([1.0, 0.3, 7.0])], patterns)
}

/// Recipes with these extents and spacings.
pub fn recipes_of(
    dims: impl Strategy<Value = [u32; 3]>,
    spacing: impl Strategy<Value = [f32; 3]>,
    patterns: impl Strategy<Value = Pattern>,
) -> impl Strategy<Value = Recipe> {
    (
        dims,
        spacing,
        patterns,
        kinds(),
        proptest::bool::weighted(0.3),
        any::<u64>(),
    )
        .prop_map(|(dims, spacing, pattern, kind, missing, seed)| Recipe {
            dims,
            spacing,
            pattern,
            kind,
            missing,
            seed,
        })
}

/// Everything.
pub fn any_recipe() -> impl Strategy<Value = Recipe> {
    recipes(prop_oneof![
        6 => surfaces(),
        1 => Just(Pattern::Constant),
        1 => Just(Pattern::Extremes),
    ])
}
