//! Every kernel on small volumes: both meshers, every feature, leaves of several levels, patching, ghosts across regions, extra
//! sheets, missing samples. These are tests of their own, and `tests/scripts/oclgrind.sh` runs them under Oclgrind, which interprets
//! every work-item, so volumes are as small as possible. All cases run with floats. For other types the kernels differ only in how
//! they read samples, so only kernels that read samples are run, for one type of each size: the accesses have the same addresses.

use isopeel_kernels::expression::{Binary, Comparison, Op};
use isopeel_kernels::testing::device;
use isopeel_kernels::{
    ChosenParts, CutParams, DerivedFeature, Engine, Expression, Feature, Grid, Interest, InterestShape, Isovalue,
    Level, Mesher, Never, PartFilter, Pyramid, RectilinearGrid, RegionWeights, Samples, TreeGoal, ValueSet,
    VectorFeature, Volume,
};
use std::sync::Arc;

const DIMS: [u32; 3] = [36, 5, 4];

/// So large that there are several bricks.
const DERIVED_DIMS: [u32; 3] = [18, 5, 4];

/// A wave along x with a bump and a checkered corner: flat parts to decimate, cells of several sheets. In [0, 200].
fn values(dims: [u32; 3]) -> Vec<u8> {
    let [nx, ny, nz] = dims;
    let mut values = Vec::new();
    for z in 0..nz {
        for y in 0..ny {
            for x in 0..nx {
                let height = 2.3 + (x as f32 * 0.35).sin();
                let value = 100.0 + (height - y as f32 + 0.1 * z as f32) * 30.0;
                let checkered = x + 4 >= nx && (x + y + z) % 2 == 0;
                values.push(if checkered { 180 } else { value.clamp(0.0, 200.0) as u8 });
            }
        }
    }
    values
}

fn extract(samples: &Samples, missing: Option<f32>, iso: f32, all: bool) {
    let Some(engine) = device() else { return };
    let grid = Grid::new(DIMS, [1.0, 0.5, 2.0]).expect("a grid");
    let volume = engine.upload(grid, samples, missing).expect("upload");
    let other = engine
        .upload(grid, &Samples::U8(values(DIMS)), Some(180.0))
        .expect("upload the feature");
    let histogram = engine
        .histogram(&volume, Feature::Derived(DerivedFeature::GradientMagnitude))
        .expect("histogram");
    assert!(histogram.bins.iter().sum::<u64>() > 0);
    let gradient = Feature::Derived(DerivedFeature::GradientMagnitude);
    let features = if all {
        vec![Feature::None, gradient, Feature::Field(&other)]
    } else {
        vec![gradient]
    };
    for feature in features {
        let pyramid = engine
            .build_pyramid(&volume, feature, Isovalue::new(iso).expect("finite"), &Never)
            .expect("build the pyramid");
        if all && matches!(feature, Feature::Derived(_)) {
            tree(&engine, &volume, &pyramid);
        }
        for mesher in [Mesher::MarchingCubes, Mesher::Dual] {
            for &beta in if all { &[0.05, -1.0][..] } else { &[0.05] } {
                let params = CutParams {
                    mesher,
                    beta,
                    alpha: 0.25,
                    feature_range: [0.0, 4000.0],
                    max_level: Level::new(2).expect("a level"),
                    interest: interest(),
                    state_error: mesher == Mesher::Dual,
                    ..CutParams::paper(0.0)
                };
                let surface = engine
                    .peel(&volume, &pyramid, &params, Level::FINEST, &Never)
                    .expect("peel");
                let coarse = surface.statistics.leaves[1..].iter().any(|&n| n > 0);
                assert!(surface.statistics.leaves[0] > 0);
                assert_eq!(coarse, beta > 0.0, "leaves of several levels");
                assert!(coarse || surface.regions.len() == 2, "both regions have triangles");
            }
        }
    }
}

/// Features of `derive`, at cells and at samples, of fields of every sample type.
#[test]
fn derived_features_run() {
    let Some(engine) = device() else { return };
    let grid = Grid::new(DERIVED_DIMS, [1.0, 0.5, 2.0]).expect("a grid");
    let upload = |samples, missing| engine.upload(grid, &samples, missing).expect("upload");
    let volume = upload(Samples::U8(values(DERIVED_DIMS)), Some(180.0));
    let [x, y] = [
        upload(Samples::F32(of_values(DERIVED_DIMS, f32::from)), None),
        upload(Samples::I16(of_values(DERIVED_DIMS, signed)), Some(-77.0)),
    ];
    let derived = DerivedFeature::ALL.iter().map(|&feature| Feature::Derived(feature));
    let vectors = VectorFeature::ALL
        .iter()
        .map(|&feature| Feature::Vector(feature, [&x, &y, &volume]));
    for feature in derived.chain(vectors) {
        derive(&engine, &volume, feature);
    }
    evaluate(&engine, [&volume, &y]);
    mask(&engine, [&volume, &y]);
    distances(&engine, &y);
}

/// A feature at cells and at samples.
fn derive(engine: &Engine, volume: &Volume, feature: Feature<'_>) {
    let histogram = engine.histogram(volume, feature).expect("histogram");
    assert!(histogram.range[0] < histogram.range[1]);
    let iso = Isovalue::new(100.0).expect("finite");
    let pyramid = engine
        .build_cells(volume, feature, iso, &Never)
        .expect("build the cells");
    assert!(pyramid.full_triangles() > 0);
}

/// Features of `derive` on uneven axes: one of all derivatives at whole neighbourhoods, one of first ones beside missing samples.
#[test]
fn derived_features_of_uneven_axes_run() {
    let Some(engine) = device() else { return };
    let grid = Grid::new(DERIVED_DIMS, [1.0, 0.5, 2.0]).expect("a grid");
    let along = |axis: usize| (1..DERIVED_DIMS[axis]).map(|i| 0.25 * (1 + i % 3) as f32).collect();
    let rectilinear = RectilinearGrid::uneven(grid, [along(0), along(1), along(2)]).expect("lengths of cells");
    let samples = Samples::U8(values(DERIVED_DIMS));
    let volume = engine.upload(rectilinear, &samples, Some(180.0)).expect("upload");
    let other = engine.upload(grid, &Samples::F32(of_values(DERIVED_DIMS, f32::from)), None);
    let other = other.expect("upload");
    for feature in [
        Feature::Derived(DerivedFeature::MeanCurvature),
        Feature::Vector(VectorFeature::Helicity, [&volume, &other, &other]),
    ] {
        derive(&engine, &volume, feature);
    }
}

/// `evaluate`, of as many fields as there may be: four times the sum of two.
fn evaluate(engine: &Engine, [x, y]: [&Volume; 2]) {
    let mut ops: Vec<Op> = (0..8).map(Op::Field).collect();
    ops.extend((0..7).map(|i| Op::Binary(Binary::Add, if i == 0 { 0 } else { 7 + i }, i + 1)));
    let expression = Expression::new(ops).expect("an expression");
    let sum = engine.evaluate(&expression, &[x, y, x, y, x, y, x, y], &Never);
    let planes = engine.download(&sum.expect("evaluate"), 0..1).expect("download");
    let at = |i: usize| 4.0 * (f32::from(values(DERIVED_DIMS)[i]) + f32::from(of_values(DERIVED_DIMS, signed)[i]));
    let is_as_expected = |i: usize| planes.get(i) == at(i) || planes.get(i).is_nan();
    assert!((0..planes.len()).all(is_as_expected) && planes.get(3) == at(3));
}

/// `mask`, of samples of one type by labels of another.
fn mask(engine: &Engine, [field, labels]: [&Volume; 2]) {
    let inside = ValueSet {
        ranges: vec![[-5.0, 0.0], [20.0, 40.0]],
        is_complement: false,
    };
    let masked = engine.mask(field, labels, &inside, &Never).expect("mask");
    let planes = engine.download(&masked, 0..1).expect("download");
    let (values, labels) = (values(DERIVED_DIMS), of_values(DERIVED_DIMS, signed));
    let count = (0..planes.len()).filter(|&i| inside.holds(f32::from(labels[i])));
    let of_inside = count.map(|i| planes.get(i) == f32::from(values[i])).collect::<Vec<_>>();
    assert!(!of_inside.is_empty() && of_inside.len() < planes.len() && of_inside.iter().all(|is_same| *is_same));
}

/// Runs `distance_field` with the samples inside at which a field is below 0.
fn distances(engine: &Engine, field: &Volume) {
    let below = Op::Compare(Comparison::Below, 0, 1);
    let ops = vec![Op::Field(0), Op::Number(0.0), below, Op::Select(2, 0, 1)];
    let expression = Expression::new(ops).expect("an expression");
    let found = engine
        .distance_field(&expression, &[field], 1.0, &Never)
        .expect("distances");
    let planes = engine
        .download(&found.expect("values below 0"), 0..1)
        .expect("download");
    let farthest = (0..planes.len()).map(|i| planes.get(i)).fold(0.0, f32::max);
    assert!(farthest > 1.0 && farthest < 25.0, "{farthest}");
}

/// A ball and a box near the surface.
fn interest() -> Vec<Interest> {
    let [x, y] = [[4.0, 2.0, 2.0], [20.0, 3.0, 1.0]];
    let of = |centre, shape| Interest {
        centre,
        rows: [[0.5, 0.0, 0.0], [0.0, 0.25, 0.0], [0.0, 0.0, 1.0]],
        shape,
        importance: 0.5,
    };
    vec![of(x, InterestShape::Ball), of(y, InterestShape::Cube)]
}

/// Cuts of the vertex tree, with weights, to a tolerance and to a budget.
fn tree(engine: &Engine, volume: &Volume, pyramid: &Pyramid) {
    let params = CutParams {
        interest: interest(),
        ..CutParams::paper(-1.0)
    };
    let tree = engine
        .build_tree(volume, pyramid, &params, &Never)
        .expect("build the tree");
    let hidden = PartFilter {
        min_area: 1e-6,
        chosen: Some(ChosenParts::Hide(vec![None, Some([1.0; 3])])),
    };
    let weights = RegionWeights {
        of_regions: (1..).map(|n| n as f32).take(pyramid.active_regions()).collect(),
        in_steps: true,
    };
    let cases = [
        (0.2, u64::MAX, PartFilter::default(), false, None),
        (-1.0, tree.full_triangles() / 2, hidden, false, None),
        // Leaves of all levels, and parts that vanish.
        (-1.0, 0, PartFilter::default(), true, Some(Arc::new(weights))),
    ];
    let mut shown = None;
    for (tolerance, max_triangles, without, may_vanish, weights) in cases {
        let goal = TreeGoal {
            tolerance,
            max_triangles,
            max_tolerance: f32::INFINITY,
            without,
            may_vanish,
            weights,
        };
        let surface = engine
            .tree_surface(volume, pyramid, &tree, &params, &goal, shown.as_ref(), &Never)
            .expect("cut the tree");
        shown = surface.regions;
        let made = surface.surface.statistics.triangles;
        assert!(
            0 < made && made < tree.full_triangles(),
            "{made} triangles of {}",
            tree.full_triangles()
        );
    }
}

fn of_values<T>(dims: [u32; 3], make: impl Fn(u8) -> T) -> Vec<T> {
    values(dims).into_iter().map(make).collect()
}

fn signed(value: u8) -> i16 {
    i16::from(value) - 100
}

#[test]
fn kernels_that_read_samples_run_on_u8() {
    extract(&Samples::U8(values(DIMS)), None, 100.0, false);
}

#[test]
fn kernels_that_read_samples_run_on_i16() {
    extract(&Samples::I16(of_values(DIMS, signed)), Some(-77.0), 0.0, false);
}

#[test]
fn every_kernel_runs_on_f32() {
    let mut samples = of_values(DIMS, f32::from);
    samples[77] = f32::NAN;
    extract(&Samples::F32(samples), None, 100.0, true);
}
