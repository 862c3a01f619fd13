//! Single stages, on volumes whose answers can be written down.

use isopeel_kernels::{ControlPoint, Grid, Level, Samples, TransferFunction, Vertex};
use isopeel_reference::{Feature, Field, FineEdge, Pipeline, classify, cut, histogram, minmax, octahedral, pack};

use crate::properties::{params, sampled, sphere};

#[test]
fn minmax_covers_shared_samples_and_cut_bricks() {
    let mut field = sampled([18, 9, 4], [1.0; 3], |[x, y, z]| x + 100.0 * y + 10_000.0 * z);
    assert_eq!(minmax::bricks(&field), [3, 1, 1]);
    let ranges = minmax::minmax(&field);
    assert_eq!(
        ranges.iter().map(|r| (r.min, r.max)).collect::<Vec<_>>(),
        [(0.0, 30_808.0), (8.0, 30_816.0), (16.0, 30_817.0)]
    );
    field.values[8] = f32::NAN;
    let missing: Vec<_> = minmax::minmax(&field).iter().map(|r| r.missing).collect();
    assert_eq!(missing, [true, true, false], "sample 8 belongs to both bricks");
    field.values.fill(f32::NAN);
    assert_eq!(
        (minmax::minmax(&field)[0].min, minmax::minmax(&field)[0].max),
        (f32::INFINITY, f32::NEG_INFINITY)
    );
}

#[test]
fn histogram_counts_every_finite_value_once() {
    let h = histogram::histogram(&[0.0, 1.0, 255.0, 256.0, f32::NAN, f32::INFINITY, 128.0]);
    assert_eq!(h.range, [0.0, 256.0]);
    assert_eq!((h.bins[0], h.bins[1], h.bins[128], h.bins[255]), (1, 1, 1, 2));
    assert_eq!(h.bins.iter().sum::<u64>(), 5);
    let constant = histogram::histogram(&[7.0; 9]);
    assert_eq!((constant.range, constant.bins[0]), ([7.0, 7.0], 9));
    assert_eq!(histogram::histogram(&[f32::NAN]).range, [0.0, 0.0]);
}

#[test]
fn value_at_the_isovalue_is_inside_and_missing_cells_are_inactive() {
    let grid = Grid::new([3, 2, 2], [1.0; 3]).expect("a valid grid");
    let samples = Samples::I16(vec![5, 4, -99, 4, 4, 4, 4, 4, 4, 4, 4, 4]);
    let field = Field::from_samples(grid, &samples, Some(-99.0));
    let classes = classify::classify(&field, 5.0);
    assert_eq!(classes.active.into_iter().collect::<Vec<_>>(), [([0, 0, 0], 1)]);
    assert_eq!(classes.missing, [false, true]);
}

#[test]
fn gradient_is_exact_on_a_linear_field_and_one_sided_at_its_ends() {
    let mut field = sampled([4, 5, 6], [0.5, 1.0, 2.0], |[x, y, z]| 2.0 * x - 3.0 * y + 4.0 * z);
    assert!(field.samples().all(|p| field.gradient(p) == [4.0, -3.0, 2.0]));
    assert!(
        field
            .gradient_magnitude()
            .values
            .iter()
            .all(|m| (m - 29f32.sqrt()).abs() < 1e-6)
    );
    field.values[2] = f32::NAN;
    assert_eq!(
        field.gradient([1, 0, 0]),
        [4.0, -3.0, 2.0],
        "beside a missing sample: the other side"
    );
    field.values[0] = f32::NAN;
    assert_eq!(field.gradient([1, 0, 0]), [0.0, -3.0, 2.0], "between two: nothing");
    assert!(field.gradient_magnitude().values[2].is_nan());
}

#[test]
fn plane_is_smooth_and_decimates_to_the_coarsest_level() {
    let field = sampled([34, 40, 37], [1.0, 1.0, 1.5], |[x, y, z]| 0.3 * x + 0.4 * y + z - 25.3);
    let pipeline = Pipeline::new(&field, Feature::None, 0.0);
    for nodes in &pipeline.pyramid.nodes {
        assert!(!nodes.is_empty());
        assert!(nodes.values().all(|n| n.s < 1e-6));
        assert_eq!(
            nodes.values().map(|n| u64::from(n.count)).sum::<u64>(),
            pipeline.pyramid.full_triangles()
        );
    }
    let counts = pipeline.cut(&params(1e-5), Level::FINEST).counts();
    assert_eq!(counts, [0, 0, 0, 0, 0, pipeline.pyramid.nodes[5].len() as u64]);
    let mut bounded = params(1e-5);
    bounded.max_level = Level::new(2).expect("a level");
    assert_eq!(
        pipeline.cut(&bounded, Level::FINEST).counts()[2],
        pipeline.pyramid.nodes[2].len() as u64
    );
}

#[test]
fn feature_field_is_averaged_over_known_corners() {
    let field = sampled([3, 2, 2], [1.0; 3], |[x, ..]| x);
    let mut feature = sampled([3, 2, 2], [1.0; 3], |[x, ..]| 8.0 * x);
    feature.values[0] = f32::NAN;
    let pipeline = Pipeline::new(&field, Feature::Field(&feature), 0.5);
    let f = pipeline.pyramid.cells[&[0, 0, 0]].f;
    assert!((f - 32.0 / 7.0).abs() < 1e-6, "three corners of 0, four of 8: {f}");
    feature.values.fill(f32::NAN);
    assert_eq!(
        Pipeline::new(&field, Feature::Field(&feature), 0.5).pyramid.cells[&[0, 0, 0]].f,
        0.0
    );
}

#[test]
fn transfer_function_decides_the_cut() {
    let field = sphere(33, [16.1, 15.9, 16.3]);
    let pipeline = Pipeline::new(&field, Feature::None, -12.0);
    let mut p = params(0.5);
    let point = |x, importance| ControlPoint { x, importance };
    p.transfer = TransferFunction::new(vec![point(0.0, 1.0), point(1.0, 1.0)]).expect("valid");
    assert_eq!(
        pipeline.cut(&p, Level::FINEST).counts()[1..],
        [0; 5],
        "everything matters: nothing is decimated"
    );
    p.transfer = TransferFunction::new(vec![point(0.0, 0.0)]).expect("valid");
    assert_eq!(
        pipeline.cut(&p, Level::FINEST).counts()[..5],
        [0; 5],
        "nothing matters: only the coarsest are left"
    );
    let node = pipeline.pyramid.nodes[5][&[0, 0, 0]];
    assert_eq!(cut::importance_of(node.s, node.f, &params(0.0)), node.s);
}

#[test]
fn small_ball_in_a_coarse_cube_is_lost_and_counted() {
    let field = sphere(9, [4.2, 4.1, 3.9]);
    let pipeline = Pipeline::new(&field, Feature::None, -1.2);
    let surface = pipeline.peel(&params(1.0), Level::FINEST);
    assert_eq!((surface.statistics.lost_cubes, surface.statistics.triangles), (1, 0));
    assert!(surface.regions.is_empty());
    assert!(surface.statistics.full_triangles > 0);
}

#[test]
fn refinement_finds_the_full_resolution_crossing_of_a_cut_cube() {
    // One cube of 8 cells, cut at the volume's end to 5 along x; the surface is the plane x = 3.25.
    let field = sampled([6, 9, 9], [1.0; 3], |[x, ..]| 3.25 - x);
    let pipeline = Pipeline::new(&field, Feature::None, 0.0);
    let mesh = pipeline.mesh(&pipeline.cut(&params(0.0), Level::FINEST));
    let expected = [[0, 0], [8, 0], [0, 8], [8, 8]].map(|[y, z]| FineEdge {
        low: [3, y, z],
        axis: 0,
    });
    let mut edges: Vec<_> = mesh.vertices.keys().copied().collect();
    edges.sort_by_key(|e| (e.low[2], e.low[1]));
    assert_eq!(edges, expected);
    assert!(
        mesh.vertices
            .values()
            .all(|v| v.position[0] == 3 * 65536 + 16384 && v.t == 0.25)
    );
    assert_eq!(
        pack::normal(&field, expected[0], 0.25),
        [1.0, 0.0, 0.0],
        "towards lower values"
    );
}

#[test]
fn octahedral_normals_survive_packing() {
    for i in 0..2000 {
        let a = i as f32 * 2.399_963_2;
        let z = 1.0 - (i as f32 + 0.5) / 1000.0;
        let r = (1.0 - z * z).max(0.0).sqrt();
        let n = [r * a.cos(), r * a.sin(), z];
        let v = Vertex {
            position: [0; 3],
            normal: octahedral::encode(n).map(|v| (v * 32767.0).round_ties_even() as i16),
            smoothness: 0,
            feature: 0,
        };
        for back in [v.unit_normal(), octahedral::decode(octahedral::encode(n))] {
            assert!((0..3).all(|i| (n[i] - back[i]).abs() < 1e-4), "{n:?} became {back:?}");
        }
    }
}

#[test]
fn thin_constant_and_checkered_volumes() {
    let constant = sampled([7, 5, 3], [1.0; 3], |_| 4.0);
    assert!(Pipeline::new(&constant, Feature::None, 4.0).pyramid.cells.is_empty());
    // Every cell of a checkerboard is the case of four separate corners.
    let checkers = sampled([5, 2, 4], [1.0; 3], |[x, y, z]| (x + y + z) % 2.0);
    let pipeline = Pipeline::new(&checkers, Feature::None, 0.5);
    assert_eq!(pipeline.pyramid.cells.len(), 12);
    assert_eq!(pipeline.pyramid.full_triangles(), 48);
    assert!(pipeline.pyramid.cells.values().all(|c| c.g == [0.0; 3]));
}
