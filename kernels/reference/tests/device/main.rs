//! The device against the plain Rust twins, stage by stage, with buffers read back; and what the dual mesher promises of any
//! cut. One file a stage, in one test binary, for tests use the device one at a time.

mod cell_values;
mod classify;
mod construct;
mod curve;
mod cut;
mod derive;
mod differences;
mod distance;
mod distance_field;
mod distribution;
mod dual;
mod error;
mod expression;
mod fit;
mod histogram;
mod host_pyramid;
mod host_tree;
mod interest;
mod interpolate;
mod march;
mod mask;
mod minmax;
mod overview;
mod probe;
mod recipes;
mod slabs;
mod slice;
mod topology;
mod tree;
mod tree_cut;
mod tree_part;

use host_pyramid::{HostPyramid, region_at, unmorton};
use isopeel_kernels::testing::{self, PyramidContents, device};
use isopeel_kernels::{
    CutParams, DerivedFeature, Differences, Engine, Feature, Grid, Isovalue, Kept, Level, Mesher, Never, Pyramid,
    Region, Surface, Topology, Vertex, Volume,
};
use isopeel_reference::{Cut, Field, Leaf, Pyramid as Twin};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use recipes::{Random, Recipe};
use rustc_hash::FxHashMap as HashMap;

/// Few cases of large volumes rather than many of tiny ones; a failure prints its recipe, no file of seeds. They are the same in each run,
/// unless the variable `ISOPEEL_TEST_TIMES` multiplies their number, as in `make fuzz`.
fn config(cases: u32) -> ProptestConfig {
    let times: Option<u32> = std::env::var("ISOPEEL_TEST_TIMES").ok().and_then(|t| t.parse().ok());
    ProptestConfig {
        cases: cases * times.unwrap_or(1),
        failure_persistence: None,
        max_shrink_iters: 40,
        rng_seed: times.map_or(RngSeed::Fixed(2013), |_| RngSeed::Random),
        ..ProptestConfig::default()
    }
}

/// A recipe on the device and on the host.
struct Loaded {
    volume: Volume,
    field: Field,
    iso: f32,
}

fn load(engine: &Engine, recipe: &Recipe) -> Loaded {
    let (grid, samples, missing, iso) = recipe.make();
    load_samples(engine, grid, &samples, missing, iso)
}

fn load_samples(
    engine: &Engine,
    grid: Grid,
    samples: &isopeel_kernels::Samples,
    missing: Option<f32>,
    iso: f32,
) -> Loaded {
    Loaded {
        volume: engine.upload(grid, samples, missing).expect("upload"),
        field: Field::from_samples(grid, samples, missing),
        iso,
    }
}

fn build(engine: &Engine, loaded: &Loaded, feature: Feature<'_>) -> Pyramid {
    let iso = Isovalue::new(loaded.iso).expect("finite");
    engine
        .build_pyramid(&loaded.volume, feature, iso, &Never)
        .expect("build the pyramid")
}

/// Whether two results agree within rounding.
fn near(a: f32, b: f32, tolerance: f32) -> bool {
    a == b || (a - b).abs() <= tolerance * a.abs().max(b.abs()).max(1.0)
}

/// The full surface by the dual mesher.
fn dual_params() -> CutParams {
    CutParams {
        mesher: Mesher::Dual,
        ..CutParams::paper(-1.0)
    }
}

/// The mesh of a cut that the host gives.
fn mesh(engine: &Engine, loaded: &Loaded, pyramid: &Pyramid, params: &CutParams, state: &[u8]) -> Surface {
    testing::mesh(engine, &loaded.volume, pyramid, params, state).expect("mesh")
}

/// A vertex's position in the whole volume, bit for bit what every region has.
fn absolute(region: &Region, vertex: &Vertex) -> [i64; 3] {
    std::array::from_fn(|i| (i64::from(region.coords[i]) << 21) + i64::from(vertex.position[i]))
}

/// Triangles with welded corners.
fn welded(regions: &[Region]) -> Vec<[[i64; 3]; 3]> {
    let corners = |r: &Region| -> Vec<_> {
        let at = |i: &u32| absolute(r, &r.vertices[*i as usize]);
        r.indices
            .chunks_exact(3)
            .map(|t| [at(&t[0]), at(&t[1]), at(&t[2])])
            .collect()
    };
    regions.iter().flat_map(corners).collect()
}
