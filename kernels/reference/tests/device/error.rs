//! The measured error of any cut's dual mesh, region by region, against brute force.

use std::ops::RangeInclusive;

use isopeel_kernels::testing::with_gpu_kernels;
use isopeel_kernels::{SampleType, SurfaceError};
use isopeel_reference::error::{Bounds, Triangle, bounds};
use isopeel_reference::{Feature as TwinFeature, construct};

use super::recipes::{Pattern, recipes_of, surfaces};
use super::*;

/// Extents for which every crossing can be compared with every triangle; some have several regions.
const DIMS: [[u32; 3]; 6] = [[2, 2, 2], [2, 9, 13], [7, 34, 5], [9, 10, 11], [35, 6, 7], [12, 12, 12]];

fn small_recipes() -> impl Strategy<Value = Recipe> {
    let spacing = prop_oneof![Just([1.0f32; 3]), Just([1.0, 0.3, 7.0]), Just([0.5, 0.5, 1.25])];
    recipes_of(proptest::sample::select(DIMS.to_vec()), spacing, surfaces())
}

/// Within the bounds by brute force, with a tolerance for rounding. In noise a search may end at a triangle that is not the nearest.
fn is_honest(got: SurfaceError, bounds: Bounds, spacing: [f32; 3]) -> bool {
    let diagonal = spacing.iter().map(|s| s * s).sum::<f32>().sqrt();
    let honest =
        |got: f32, low: f32, high: f32| (0.98 * low - 2e-3 * diagonal..=3.0 * high + 4.0 * diagonal).contains(&got);
    honest(got.rms, bounds.low.rms, bounds.high.rms) && honest(got.max, bounds.low.max, bounds.high.max)
}

fn world_triangles(field: &Field, regions: &[Region]) -> Vec<Triangle> {
    let world = |p: [i64; 3]| -> [f64; 3] {
        std::array::from_fn(|i| p[i] as f64 / f64::from(Vertex::LATTICE) * f64::from(field.grid.spacing[i]))
    };
    let of_region = |region: &Region| {
        let coords = region.coords;
        let corners = welded(std::slice::from_ref(region));
        corners.into_iter().map(move |corners| (coords, corners.map(world)))
    };
    let triangle = |(number, (region, corners))| Triangle {
        region,
        number: number as u32,
        corners,
    };
    regions.iter().flat_map(of_region).enumerate().map(triangle).collect()
}

/// Meshes a cut, with its error; `cap`: the volume counts as padded.
fn measured(engine: &Engine, loaded: &Loaded, pyramid: &Pyramid, state: &[u8], cap: bool) -> Surface {
    let params = CutParams {
        state_error: true,
        cap,
        ..dual_params()
    };
    mesh(engine, loaded, pyramid, &params, state)
}

/// Meshes a random cut and compares; `cap`: the volume counts as padded.
fn check(engine: &Engine, loaded: &Loaded, seed: u64, topology: Topology, cap: bool) -> Result<(), TestCaseError> {
    let pyramid = build(engine, loaded, Feature::None);
    let host = HostPyramid::read(engine, &pyramid);
    let state = host.random_state(seed, topology);
    let Surface {
        regions, statistics, ..
    } = measured(engine, loaded, &pyramid, &state, cap);
    let (field, iso) = (&loaded.field, loaded.iso);
    let triangles = world_triangles(field, &regions);
    let twin = construct::construct(field, TwinFeature::None, iso);
    let (by_region, whole) = bounds(field, iso, cap, &host.cut(&twin, &state), &triangles);
    if triangles.is_empty() {
        return Ok(());
    }
    let spacing = field.grid.spacing;
    for region in &regions {
        let (got, bounds) = (region.error.expect("asked for"), by_region[&region.coords]);
        prop_assert!(
            is_honest(got, bounds, spacing),
            "region {:?}: {:?}, {:?}",
            region.coords,
            got,
            bounds
        );
    }
    let got = statistics.error.expect("asked for");
    prop_assert!(is_honest(got, whole, spacing), "the whole: {:?}, {:?}", got, whole);
    Ok(())
}

#[test]
fn any_cut_states_what_brute_force_finds() {
    let Some(engine) = device() else { return };
    proptest!(config(8), |(recipe in small_recipes(), seed in any::<u64>(), preserve in any::<bool>())| {
        let topology = if preserve { Topology::Preserve } else { Topology::Free };
        check(&engine, &load(&engine, &recipe), seed, topology, false)?;
    });
}

/// Compares cuts that merge all cubes below a level: what is stated ÷ what the twin finds.
fn check_merged(engine: &Engine, loaded: &Loaded, levels: &[u8], rms: RangeInclusive<f32>, max: RangeInclusive<f32>) {
    let pyramid = build(engine, loaded, Feature::None);
    let host = HostPyramid::read(engine, &pyramid);
    let twin = construct::construct(&loaded.field, TwinFeature::None, loaded.iso);
    for &level in levels {
        let merged = |leaf: &Leaf| if leaf.level <= level { level } else { 255 };
        let state: Vec<u8> = host.leaves.iter().map(merged).collect();
        let Surface {
            regions, statistics, ..
        } = measured(engine, loaded, &pyramid, &state, false);
        let triangles = world_triangles(&loaded.field, &regions);
        let (_, Bounds { high, .. }) = bounds(&loaded.field, loaded.iso, false, &host.cut(&twin, &state), &triangles);
        let got = statistics.error.expect("asked for");
        assert!(
            rms.contains(&(got.rms / high.rms)) && max.contains(&(got.max / high.max)),
            "level {level}: {got:?}, {high:?}"
        );
    }
}

/// A ball with a bump, and of it cuts that merge more and more.
#[test]
fn smooth_surfaces_are_measured_within_a_twentieth() {
    let Some(engine) = device() else { return };
    let grid = Grid::new([30; 3], [1.0, 1.0, 1.25]).expect("a grid");
    let radius = |p: [u32; 3]| -> f32 {
        let d: [f32; 3] = std::array::from_fn(|i| (p[i] as f32 - 14.3) * grid.spacing[i]);
        (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt() + (0.4 * d[0]).sin()
    };
    let points = (0..30).flat_map(|z| (0..30).flat_map(move |y| (0..30).map(move |x| [x, y, z])));
    let samples = points.map(|p| 11.2 - radius(p)).collect();
    let samples = isopeel_kernels::Samples::F32(samples);
    let loaded = load_samples(&engine, grid, &samples, None, 0.0);
    check_merged(&engine, &loaded, &[0, 1, 2], 0.98..=1.03, 0.95..=1.05);
}

/// Half a ball: many of its triangles are next to the border of the surface, whose nearest point is no foot of a perpendicular.
#[test]
fn a_surface_that_ends_at_missing_samples_is_measured_within_a_tenth() {
    let Some(engine) = device() else { return };
    let grid = Grid::new([14; 3], [1.0, 1.0, 1.25]).expect("a grid");
    let points = (0..14).flat_map(|z| (0..14).flat_map(move |y| (0..14).map(move |x| [x, y, z])));
    let value = |p: [u32; 3]| -> f32 {
        let d: [f32; 3] = std::array::from_fn(|i| (p[i] as f32 - 6.4) * grid.spacing[i]);
        let is_known = d[0] + 0.4 * d[1] - 0.3 * d[2] > 0.6;
        if is_known {
            5.3 - (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt()
        } else {
            f32::NAN
        }
    };
    let samples = isopeel_kernels::Samples::F32(points.map(value).collect());
    let loaded = load_samples(&engine, grid, &samples, None, 0.0);
    check_merged(&engine, &loaded, &[0, 1], 0.97..=1.1, 0.97..=1.1);
}

/// A volume with one sample more on every side, below all others, as capping has it.
fn padded(field: &Field) -> Vec<f32> {
    let [nx, ny, nz] = field.grid.dims;
    let mut samples = Vec::new();
    for z in 0..nz + 2 {
        for y in 0..ny + 2 {
            for x in 0..nx + 2 {
                let inside = (1..=nx).contains(&x) && (1..=ny).contains(&y) && (1..=nz).contains(&z);
                samples.push(if inside { field.at([x - 1, y - 1, z - 1]) } else { -1e4 });
            }
        }
    }
    samples
}

#[test]
fn capped_volumes_end_on_their_faces() {
    let Some(engine) = device() else { return };
    proptest!(config(4), |(dims in proptest::sample::select(DIMS.to_vec()), seed in any::<u64>(), pattern in surfaces())| {
        let inner = load(&engine, &Recipe::plain(dims, pattern, seed));
        let grid = Grid::new(dims.map(|n| n + 2), [1.0; 3]).expect("a grid");
        let samples = isopeel_kernels::Samples::F32(padded(&inner.field));
        let loaded = load_samples(&engine, grid, &samples, None, inner.iso);
        check(&engine, &loaded, seed, Topology::Free, true)?;
    });
}

/// A solid with a round hole in one of its faces, over which a coarse cut has triangles: no point of these is further from the surface than the
/// hole is deep, though the cells around it and around their corners have none.
#[test]
fn triangles_over_a_hole_are_as_far_as_it_is_deep() {
    let Some(engine) = device() else { return };
    const RADIUS: f32 = 22.0;
    let middle = [30.3, 31.2, 0.0];
    let dims = [64u32, 64, 40];
    let grid = Grid::new(dims.map(|n| n + 2), [1.0; 3]).expect("a grid");
    let mut samples = Vec::new();
    for z in 0..dims[2] + 2 {
        for y in 0..dims[1] + 2 {
            for x in 0..dims[0] + 2 {
                let p = [x, y, z];
                let inside = (0..3).all(|axis| (1..=dims[axis]).contains(&p[axis]));
                let to: [f32; 3] = std::array::from_fn(|axis| p[axis] as f32 - 1.0 - middle[axis]);
                let distance = to.iter().map(|d| d * d).sum::<f32>().sqrt();
                samples.push(if inside { distance - RADIUS } else { -1e4 });
            }
        }
    }
    let loaded = load_samples(&engine, grid, &isopeel_kernels::Samples::F32(samples), None, 0.0);
    let pyramid = build(&engine, &loaded, Feature::None);
    let host = HostPyramid::read(&engine, &pyramid);
    let state: Vec<u8> = host
        .leaves
        .iter()
        .map(|leaf| if leaf.level <= 5 { 5 } else { 255 })
        .collect();
    let Surface { statistics, .. } = measured(&engine, &loaded, &pyramid, &state, true);
    let got = statistics.error.expect("asked for");
    assert!((0.5 * RADIUS..=RADIUS).contains(&got.max), "{got:?}");
}

/// A ball, and far from it specks that a coarse cut loses.
#[test]
fn parts_that_vanish_count_with_their_distance_to_what_is_left() {
    let Some(engine) = device() else { return };
    let dims = [80u32, 40, 40];
    let mut samples = Vec::new();
    for z in 0..dims[2] {
        for y in 0..dims[1] {
            for x in 0..dims[0] {
                let r2 = [x as f32 - 12.0, y as f32 - 12.0, z as f32 - 12.0]
                    .iter()
                    .map(|d| d * d)
                    .sum::<f32>();
                let speck = [x, y, z] == [75, 37, 5];
                samples.push(if speck { 100.0 } else { 8.3 - r2.sqrt() });
            }
        }
    }
    let grid = Grid::new(dims, [1.0; 3]).expect("a grid");
    let samples = isopeel_kernels::Samples::F32(samples);
    let loaded = load_samples(&engine, grid, &samples, None, 0.0);
    let pyramid = build(&engine, &loaded, Feature::None);
    let host = HostPyramid::read(&engine, &pyramid);
    // All cells of the ball, and cubes of level 2 about the speck.
    let is_speck = |leaf: &Leaf| leaf.cube[0] << leaf.level >= 64;
    let state: Vec<u8> = host
        .leaves
        .iter()
        .map(|leaf| match (is_speck(leaf), leaf.level) {
            (false, 0) => 0,
            (true, 0..=3) => 3,
            _ => 255,
        })
        .collect();
    let Surface {
        regions, statistics, ..
    } = measured(&engine, &loaded, &pyramid, &state, false);
    assert!(regions.iter().all(|r| r.coords[0] < 2), "the speck has no triangles");
    let (twin, triangles) = (
        construct::construct(&loaded.field, TwinFeature::None, loaded.iso),
        world_triangles(&loaded.field, &regions),
    );
    let cut = host.cut(&twin, &state);
    let (_, Bounds { low, .. }) = bounds(&loaded.field, loaded.iso, false, &cut, &triangles);
    let got = statistics.error.expect("asked for");
    assert!(low.max > 50.0);
    assert!(
        (0.999 * low.max..=1.02 * low.max).contains(&got.max),
        "{got:?}, at least {low:?}"
    );
}

#[test]
fn a_call_of_its_own_measures_what_a_peel_states_and_can_be_cancelled() {
    let Some(engine) = device() else { return };
    let recipe = Recipe {
        kind: SampleType::U8,
        ..Recipe::plain([70, 40, 40], Pattern::Waves(15), 5)
    };
    let loaded = load(&engine, &recipe);
    let pyramid = build(&engine, &loaded, Feature::None);
    let params = CutParams {
        state_error: true,
        beta: 0.1,
        ..dual_params()
    };
    let surface = engine
        .peel(&loaded.volume, &pyramid, &params, Level::FINEST, &Never)
        .expect("peel");
    let measured = engine
        .measure_error(&loaded.volume, &pyramid, &params, &Never)
        .expect("measure");
    assert_eq!(Some(measured.whole), surface.statistics.error);
    let stated: Vec<_> = surface
        .regions
        .iter()
        .map(|r| (r.coords, r.error.expect("asked for")))
        .collect();
    assert_eq!(measured.regions, stated);
    assert!(
        measured
            .stages
            .iter()
            .any(|s| s.stage == "error" && s.milliseconds > 0.0)
    );

    struct After(std::cell::Cell<u32>);
    impl isopeel_kernels::Cancel for After {
        fn is_cancelled(&self) -> bool {
            self.0.set(self.0.get() + 1);
            self.0.get() > 4
        }
    }
    let cancelled = engine.measure_error(&loaded.volume, &pyramid, &params, &After(0.into()));
    assert!(matches!(cancelled, Err(isopeel_kernels::Error::Cancelled)));
}

/// The kernels of a GPU on any device: work-groups of many, one cell and one sample at a time.
#[test]
fn work_groups_of_a_gpu_measure_the_same() {
    let Some(engine) = device() else { return };
    let of_gpu = with_gpu_kernels(&engine, None);
    let recipe = Recipe::plain([65, 34, 35], Pattern::Waves(15), 9);
    let measure = |engine: &Engine| {
        let loaded = load(engine, &recipe);
        let pyramid = build(engine, &loaded, Feature::None);
        let params = CutParams {
            beta: 0.15,
            ..dual_params()
        };
        engine
            .measure_error(&loaded.volume, &pyramid, &params, &Never)
            .expect("measure")
            .whole
    };
    let (of_cpu, of_gpu) = (measure(&engine), measure(&of_gpu));
    assert!(
        near(of_cpu.rms, of_gpu.rms, 1e-3) && near(of_cpu.max, of_gpu.max, 1e-2),
        "{of_cpu:?}, {of_gpu:?}"
    );
}
