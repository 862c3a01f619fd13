//! Properties of the whole road, on small random volumes and on a sphere.

use std::collections::{BTreeMap, BTreeSet};

use isopeel_kernels::tables::cases;
use isopeel_kernels::{CutParams, DerivedFeature, Grid, Level, Samples, Surface, Vertex};
use isopeel_reference::{Cut, Feature, Field, FineEdge, Mesh, Pipeline, cut::normalised_feature, files, march, patch};
use proptest::prelude::*;

pub fn params(beta: f32) -> CutParams {
    CutParams::paper(beta)
}

/// A field on unit or uneven spacing, from a function of the sample's place.
pub fn sampled(dims: [u32; 3], spacing: [f32; 3], mut value: impl FnMut([f32; 3]) -> f32) -> Field {
    let mut values = Vec::new();
    for z in 0..dims[2] {
        for y in 0..dims[1] {
            for x in 0..dims[0] {
                values.push(value([x as f32, y as f32, z as f32]));
            }
        }
    }
    Field::new(Grid::new(dims, spacing).expect("a valid grid"), values)
}

/// Distance to a point inside, so that inside the sphere is above the isovalue `-radius`.
pub fn sphere(side: u32, centre: [f32; 3]) -> Field {
    sampled([side; 3], [1.0; 3], |p| {
        -(0..3).map(|i| (p[i] - centre[i]).powi(2)).sum::<f32>().sqrt()
    })
}

/// How often each directed edge is used, less how often it is used the other way.
fn balance(mesh: &Mesh) -> BTreeMap<[FineEdge; 2], i32> {
    let mut balance = BTreeMap::new();
    for t in &mesh.triangles {
        for (a, b) in [(0, 1), (1, 2), (2, 0)].map(|(i, j)| (t.vertices[i], t.vertices[j])) {
            *balance.entry([a.min(b), a.max(b)]).or_insert(0) += if a < b { 1 } else { -1 };
        }
    }
    balance
}

/// Position in cells.
fn position(mesh: &Mesh, edge: &FineEdge) -> [f64; 3] {
    mesh.vertices[edge]
        .position
        .map(|p| p as f64 / f64::from(Vertex::LATTICE))
}

/// Whether both edges lie in one face of the volume.
fn on_border(field: &Field, edges: &[FineEdge; 2]) -> bool {
    (0..3).any(|axis| {
        [0, field.grid.dims[axis] - 1]
            .iter()
            .any(|&end| edges.iter().all(|e| e.low[axis] == end && e.high()[axis] == end))
    })
}

/// Small volumes of few values, often exactly at the isovalue 2; smooth enough blocks appear that cubes are decimated.
fn volumes(missing: bool) -> impl Strategy<Value = Field> {
    let dims = [2..12u32, 2..10u32, 2..8u32];
    let spacing = prop_oneof![Just([1.0f32; 3]), Just([0.5, 1.25, 3.0])];
    (dims, spacing, 0..3u8).prop_flat_map(move |(dims, spacing, kind)| {
        let samples = dims.iter().product::<u32>() as usize;
        let value = if missing {
            prop_oneof![12 => (0..5i32).prop_map(|v| v as f32), 1 => Just(f32::NAN)].boxed()
        } else {
            (0..5i32).prop_map(|v| v as f32).boxed()
        };
        proptest::collection::vec(value, samples).prop_map(move |noise| {
            // Noise alone, or a tilted plane with a little or some noise on it.
            let mut next = noise.into_iter();
            let weight = [1.0, 0.05, 0.3][usize::from(kind)];
            sampled(dims, spacing, |[x, y, z]| {
                let v = next.next().expect("one a sample");
                let plane = 2.0 + (x - dims[0] as f32 * 0.45) * 0.7 + (y - z) * 0.1;
                if kind == 0 { v } else { plane + weight * (v - 2.0) }
            })
        })
    })
}

/// Every vertex that a coarser leaf must carry lies on that leaf's contour; the rest are counted.
pub fn check_patched(pipeline: &Pipeline<'_>, cut: &Cut, mesh: &Mesh) -> Result<(), TestCaseError> {
    let emitted: BTreeSet<_> = mesh
        .triangles
        .iter()
        .flat_map(|t| t.vertices.map(|e| (t.leaf.level, e)))
        .collect();
    let mut unpatched = 0;
    for &edge in mesh.vertices.keys() {
        let leaves: BTreeSet<_> = edge
            .active_cells(&pipeline.pyramid)
            .iter()
            .map(|c| cut.leaf_of[c])
            .collect();
        prop_assert!(!leaves.is_empty());
        let level = leaves.iter().map(|l| l.level).max().unwrap_or(0);
        let coarse = || leaves.iter().filter(|l| l.level == level && level > 0);
        let segments: Vec<[FineEdge; 2]> = coarse()
            .flat_map(|l| patch::segments_at(pipeline.field, pipeline.iso, *l, &cut.leaves[l], edge))
            .collect();
        let emitted_by_coarse = emitted.contains(&(level, edge));
        if level == 0 || emitted_by_coarse {
            // Not moved: it is at the surface's crossing with its edge.
            for (axis, at) in position(mesh, &edge).into_iter().enumerate() {
                let (low, high) = (f64::from(edge.low[axis]), f64::from(edge.high()[axis]));
                prop_assert!((low..=high).contains(&at));
            }
        } else if segments.is_empty() {
            unpatched += 1;
        } else {
            let nearest = |p| {
                let distances = segments.iter().map(|s| distance(p, s.map(|e| position(mesh, &e))));
                distances.fold(f64::MAX, f64::min)
            };
            let (after, mut before) = (position(mesh, &edge), edge.low.map(f64::from));
            before[usize::from(edge.axis)] += f64::from(mesh.vertices[&edge].t);
            prop_assert!(
                nearest(after) <= 1e-4,
                "{edge:?} is {} cells from its segment",
                nearest(after)
            );
            let moved = distance(before, [after, after]);
            prop_assert!(
                (moved - nearest(before)).abs() <= 1e-4,
                "{edge:?} moved {moved} cells, past a nearer segment"
            );
        }
    }
    prop_assert_eq!(unpatched, mesh.unpatched);
    Ok(())
}

fn distance(p: [f64; 3], [a, b]: [[f64; 3]; 2]) -> f64 {
    let dot = |f: &dyn Fn(usize) -> f64| (0..3).map(f).sum::<f64>();
    let length = dot(&|i| (b[i] - a[i]).powi(2));
    let t = if length > 0.0 {
        (dot(&|i| (p[i] - a[i]) * (b[i] - a[i])) / length).clamp(0.0, 1.0)
    } else {
        0.0
    };
    dot(&|i| (p[i] - a[i] - t * (b[i] - a[i])).powi(2)).sqrt()
}

fn check_surface(surface: &Surface, mesh: &Mesh) -> Result<(), TestCaseError> {
    let statistics = &surface.statistics;
    let indices: usize = surface.regions.iter().map(|r| r.indices.len()).sum();
    prop_assert_eq!(indices as u64, 3 * statistics.triangles);
    // Vertices that regions share are bit-identical, except that positions are relative to the region's origin.
    let absolute = |r: &isopeel_kernels::Region, v: &Vertex| -> [i64; 3] {
        std::array::from_fn(|i| i64::from(r.coords[i]) * 32 * i64::from(Vertex::LATTICE) + i64::from(v.position[i]))
    };
    let positions: BTreeSet<_> = surface
        .regions
        .iter()
        .flat_map(|r| r.vertices.iter().map(|v| absolute(r, v)))
        .collect();
    let expected: BTreeSet<_> = mesh.vertices.values().map(|v| v.position).collect();
    prop_assert_eq!(positions, expected);
    for region in &surface.regions {
        prop_assert_eq!(
            3 * region.level_triangles.iter().sum::<u32>() as usize,
            region.indices.len()
        );
        let used: BTreeSet<_> = region.indices.iter().collect();
        prop_assert_eq!(
            used.len(),
            region.vertices.len(),
            "every vertex is used, every index is in range"
        );
        for v in &region.vertices {
            let length = v.unit_normal().iter().map(|n| n * n).sum::<f32>();
            prop_assert!((length - 1.0).abs() < 1e-4);
        }
    }
    Ok(())
}

proptest! {
    // A failure prints its shrunk volume; no file of seeds beside a test of this kind.
    #![proptest_config(ProptestConfig { cases: 128, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn undecimated_surface_is_closed_inside_the_volume(field in volumes(false)) {
        let pipeline = Pipeline::new(&field, Feature::None, 2.0);
        let cut = pipeline.cut(&params(-1.0), Level::FINEST);
        let mesh = pipeline.mesh(&cut);
        prop_assert_eq!(mesh.triangles.len() as u64, pipeline.pyramid.full_triangles());
        prop_assert_eq!(mesh.unpatched, 0);
        for (edges, n) in balance(&mesh) {
            prop_assert!(n == 0 || on_border(&field, &edges), "{edges:?} is used {n} times more one way");
        }
    }

    #[test]
    fn cuts_cover_every_active_cell_once(field in volumes(true), beta in -0.1f32..0.5, prefix in 0..=5u8) {
        let pipeline = Pipeline::new(&field, Feature::Derived(DerivedFeature::GradientMagnitude), 2.0);
        let prefix = Level::new(prefix).expect("a level");
        let mut p = params(beta);
        p.alpha = 0.25;
        let cut = pipeline.cut(&p, prefix);
        prop_assert_eq!(cut.leaf_of.len(), pipeline.pyramid.cells.len());
        let below: u64 = cut.leaves.values().map(|n| u64::from(n.count)).sum();
        prop_assert_eq!(below, pipeline.pyramid.full_triangles(), "no leaf lies in another, none is left out");
        for (leaf, node) in &cut.leaves {
            prop_assert!((0.0..=0.5001).contains(&node.s));
            if leaf.level > 0 {
                prop_assert!(!node.missing);
                let [low, high] = field.cube_samples(usize::from(leaf.level), leaf.cube);
                let inside = |s: [u32; 3]| (0..3).all(|i| (low[i]..=high[i]).contains(&s[i]));
                prop_assert!(!field.samples().any(|s| inside(s) && field.at(s).is_nan()), "no hole is filled");
            } else {
                let cube = leaf.cube.map(|c| c >> prefix.get());
                prop_assert!(prefix == Level::FINEST || pipeline.pyramid.nodes[usize::from(prefix.get())][&cube].missing);
            }
            prop_assert!((0.0..=1.0).contains(&normalised_feature(node.f, &p)));
        }
    }

    #[test]
    fn decimated_surfaces_are_patched_and_packed(field in volumes(true), beta in 0.0f32..0.5, prefix in 0..=2u8) {
        let pipeline = Pipeline::new(&field, Feature::None, 2.0);
        let prefix = Level::new(prefix).expect("a level");
        let cut = pipeline.cut(&params(beta), prefix);
        let mesh = pipeline.mesh(&cut);
        let table = cases::case_triangles();
        let triangles: usize = cut.leaves.values().map(|n| usize::from(table[usize::from(n.signs)][0])).sum();
        prop_assert_eq!(mesh.triangles.len(), triangles);
        for edge in mesh.vertices.keys() {
            let (a, b) = (field.at(edge.low), field.at(edge.high()));
            prop_assert!(!a.is_nan() && !b.is_nan() && (a >= 2.0) != (b >= 2.0));
        }
        check_patched(&pipeline, &cut, &mesh)?;
        check_surface(&pipeline.peel(&params(beta), prefix), &mesh)?;
    }
}

#[test]
fn sphere_is_a_sphere() {
    let (radius, centre) = (11.3f32, [15.6, 16.2, 15.9]);
    let field = sphere(33, centre);
    let pipeline = Pipeline::new(&field, Feature::None, -radius);
    let mesh = pipeline.mesh(&pipeline.cut(&params(-1.0), Level::FINEST));
    let edges = balance(&mesh);
    assert!(edges.values().all(|n| *n == 0), "closed");
    let euler = mesh.vertices.len() as i64 - edges.len() as i64 + mesh.triangles.len() as i64;
    assert_eq!(euler, 2);
    // Counter-clockwise from the outside: the volume it encloses is positive, and nearly the ball's.
    let volume: f64 = mesh
        .triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.vertices.map(|e| position(&mesh, &e));
            (a[0] * (b[1] * c[2] - b[2] * c[1])
                + a[1] * (b[2] * c[0] - b[0] * c[2])
                + a[2] * (b[0] * c[1] - b[1] * c[0]))
                / 6.0
        })
        .sum();
    let ball = 4.0 / 3.0 * std::f64::consts::PI * f64::from(radius).powi(3);
    assert!((volume / ball - 1.0).abs() < 0.01, "volume {volume}, ball {ball}");
}

#[test]
fn decimated_sphere_is_patched_across_levels() {
    let field = sphere(41, [19.6, 20.2, 19.9]);
    let pipeline = Pipeline::new(&field, Feature::None, -17.3);
    let mut used = [false; 6];
    for (beta, prefix) in [
        (0.001, 0),
        (0.003, 0),
        (0.01, 0),
        (0.03, 0),
        (0.05, 0),
        (0.1, 0),
        (0.0, 3),
        (0.0, 2),
    ] {
        let cut = pipeline.cut(&params(beta), Level::new(prefix).expect("a level"));
        let mesh = pipeline.mesh(&cut);
        (0..6).for_each(|l| used[l] |= cut.counts()[l] > 0);
        check_patched(&pipeline, &cut, &mesh).expect("patched");
        assert!(mesh.triangles.len() as u64 <= pipeline.pyramid.full_triangles());
    }
    assert!(used[..4].iter().all(|u| *u), "the cuts use levels {used:?}");
}

#[test]
fn a_vertex_between_levels_moves() {
    let field = sphere(41, [19.6, 20.2, 19.9]);
    let pipeline = Pipeline::new(&field, Feature::None, -17.3);
    let cut = pipeline.cut(&params(0.03), Level::FINEST);
    let before = march::march(&field, &pipeline.pyramid, pipeline.iso, &cut);
    let after = pipeline.mesh(&cut);
    let moved = before
        .vertices
        .iter()
        .filter(|(e, v)| after.vertices[e].position != v.position)
        .count();
    assert!(
        moved > 0 && moved < before.vertices.len() / 2,
        "{moved} of {} vertices",
        before.vertices.len()
    );
}

/// A cut of a real volume: the mesh has as many triangles as `expected_cuts` expects, and it is patched.
fn check_patched_mesh((grid, samples): (Grid, Samples), iso: f32, triangles: usize) {
    let field = Field::from_samples(grid, &samples, None);
    let pipeline = Pipeline::new(&field, Feature::None, iso);
    let cut = pipeline.cut(&params(0.02), Level::FINEST);
    let mesh = pipeline.mesh(&cut);
    assert!(
        mesh.triangles.len().abs_diff(triangles) <= triangles / 1000,
        "{} triangles",
        mesh.triangles.len()
    );
    check_patched(&pipeline, &cut, &mesh).expect("finer vertices lie on coarser segments");
}

#[test]
fn mesh_of_the_demo_is_patched() {
    let file = files::repository_file("server/demo/t1.nii.gz");
    check_patched_mesh(files::read(&file), 100.0, 256_582);
}

#[test]
#[ignore = "its volume is not in the repository: make test-volumes"]
fn mesh_of_ct_head_is_patched() {
    check_patched_mesh(files::read_from_data_folder("ct-head.nrrd"), 517.0, 334_858);
}
