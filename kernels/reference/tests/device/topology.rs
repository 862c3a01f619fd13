//! The dual mesher's guarantees, tested on welded positions, bit for bit: watertight for any cut, a manifold if topology is
//! preserved, consistently oriented.

use super::recipes::{Pattern, recipes, surfaces};
use super::*;
use isopeel_kernels::{SampleType, Samples};

/// Uses of an edge from its smaller to its larger end, and back.
type Edges = HashMap<[[i64; 3]; 2], [u32; 2]>;

fn edges(triangles: &[[[i64; 3]; 3]]) -> Edges {
    let mut edges = Edges::default();
    for t in triangles {
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            edges.entry([a.min(b), a.max(b)]).or_default()[usize::from(a > b)] += 1;
        }
    }
    edges
}

/// The leaf of every vertex, by position; no two vertices of a cut have the same position.
fn owners(host: &HostPyramid, state: &[u8]) -> HashMap<[i64; 3], Leaf> {
    let mut owners = HashMap::default();
    for (slot, leaf) in host.leaves.iter().enumerate() {
        if state[slot] == leaf.level {
            let taken = owners.insert(host.position(slot), *leaf);
            assert_eq!(taken, None, "two vertices at one position, one of them {leaf:?}'s");
        }
    }
    owners
}

/// Whether the surface may end between two leaves: a sample at their contact is missing.
fn may_end(field: &Field, leaves: [Leaf; 2]) -> bool {
    let boxes = leaves.map(|l| field.cube_samples(usize::from(l.level), l.cube));
    let low: [u32; 3] = std::array::from_fn(|i| boxes[0][0][i].max(boxes[1][0][i]));
    let high: [u32; 3] = std::array::from_fn(|i| boxes[0][1][i].min(boxes[1][1][i]));
    let around = |x: u32, i: usize| x.saturating_sub(1)..=(high[i] + 1).min(field.grid.dims[i] - 1);
    around(low[2], 2).any(|z| around(low[1], 1).any(|y| around(low[0], 0).any(|x| field.at([x, y, z]).is_nan())))
}

/// Vertices inside the surface around which triangles make more than one fan: parts meet there in a point alone.
fn pinched(triangles: &[[[i64; 3]; 3]]) -> Vec<[i64; 3]> {
    // From one end of each opposite edge to the other: around a vertex they make loops.
    let mut next: HashMap<[i64; 3], HashMap<[i64; 3], [i64; 3]>> = HashMap::default();
    for t in triangles {
        for i in 0..3 {
            next.entry(t[i]).or_default().insert(t[(i + 1) % 3], t[(i + 2) % 3]);
        }
    }
    let is_pinched = |around: &HashMap<[i64; 3], [i64; 3]>| {
        let first = around.keys().next().expect("a triangle");
        let loop_of_first = std::iter::successors(around.get(first), |at| around.get(*at).filter(|_| *at != first));
        let is_inside = around.values().all(|end| around.contains_key(end));
        is_inside && loop_of_first.count() != around.len()
    };
    next.iter()
        .filter(|(_, around)| is_pinched(around))
        .map(|(at, _)| *at)
        .collect()
}

/// Checks the promises; `manifold`: that no edge is used by more than two triangles, and no vertex by more than one fan.
fn check(
    field: &Field,
    host: &HostPyramid,
    state: &[u8],
    triangles: &[[[i64; 3]; 3]],
    manifold: bool,
) -> Result<(), TestCaseError> {
    let owners = owners(host, state);
    for t in triangles {
        prop_assert!(
            t[0] != t[1] && t[1] != t[2] && t[2] != t[0],
            "a triangle with two equal corners at {t:?}"
        );
    }
    for (ends, [forth, back]) in edges(triangles) {
        let leaves = ends.map(|p| owners.get(&p).copied());
        let faces = ends.map(|p| host.faces_at(p));
        for (leaf, faces) in leaves.iter().zip(faces) {
            prop_assert!(
                leaf.is_some() || faces != 0,
                "{ends:?}: no leaf's vertex and not on a face: {leaves:?}"
            );
        }
        let uses = forth + back;
        // The surface ends on a face of the volume, and around missing samples.
        let on_border = faces[0] & faces[1] != 0;
        let at_gap = match leaves {
            [Some(a), Some(b)] => may_end(field, [a, b]),
            _ => field.values.iter().any(|v| v.is_nan()),
        };
        prop_assert!(
            forth == back || on_border || at_gap,
            "{forth} triangles one way, {back} the other, at the edge {ends:?} between {leaves:?}"
        );
        prop_assert!(
            !manifold || uses <= 2,
            "{uses} triangles at the edge {ends:?} between {leaves:?}, expected at most 2"
        );
    }
    let pinched = if manifold { pinched(triangles) } else { Vec::new() };
    prop_assert!(pinched.is_empty(), "several fans at {pinched:?}");
    Ok(())
}

fn any_cut(engine: &Engine, recipe: &Recipe, seed: u64, topology: Topology) -> Result<(), TestCaseError> {
    let loaded = load(engine, recipe);
    let pyramid = build(engine, &loaded, Feature::None);
    let host = HostPyramid::read(engine, &pyramid);
    let state = host.random_state(seed, topology);
    let Surface {
        regions, statistics, ..
    } = mesh(engine, &loaded, &pyramid, &dual_params(), &state);
    let triangles = welded(&regions);
    check(&loaded.field, &host, &state, &triangles, topology == Topology::Preserve)?;
    let mut different: Vec<_> = triangles.iter().flatten().collect();
    different.sort_unstable();
    different.dedup();
    prop_assert_eq!(different.len() as u64, statistics.vertices, "vertices counted once");
    Ok(())
}

#[test]
fn any_cut_is_watertight() {
    let Some(engine) = device() else { return };
    proptest!(config(16), |(recipe in recipes(surfaces()), seed in any::<u64>())| {
        any_cut(&engine, &recipe, seed, Topology::Free)?;
    });
}

#[test]
fn safe_cuts_are_manifold() {
    let Some(engine) = device() else { return };
    proptest!(config(16), |(recipe in recipes(surfaces()), seed in any::<u64>())| {
        any_cut(&engine, &recipe, seed, Topology::Preserve)?;
    });
}

#[test]
fn full_resolution_is_manifold() {
    let Some(engine) = device() else { return };
    proptest!(config(12), |(recipe in recipes(surfaces()))| {
        let loaded = load(&engine, &recipe);
        let pyramid = build(&engine, &loaded, Feature::None);
        let host = HostPyramid::read(&engine, &pyramid);
        let state: Vec<u8> = host.leaves.iter().map(|l| if l.level == 0 { 0 } else { 255 }).collect();
        let regions = mesh(&engine, &loaded, &pyramid, &dual_params(), &state).regions;
        check(&loaded.field, &host, &state, &welded(&regions), true)?;
    });
}

/// Triangles of the whole surface with welded corners, and its Euler characteristic.
fn euler(triangles: &[[[i64; 3]; 3]]) -> i64 {
    let mut vertices: Vec<_> = triangles.iter().flatten().collect();
    vertices.sort_unstable();
    vertices.dedup();
    vertices.len() as i64 - edges(triangles).len() as i64 + triangles.len() as i64
}

/// Six times the volume that a surface encloses, positive if its normals point outward.
fn enclosed(triangles: &[[[i64; 3]; 3]]) -> f64 {
    let of = |t: &[[i64; 3]; 3]| {
        let [a, b, c] = t.map(|p| p.map(|x| x as f64 / f64::from(Vertex::LATTICE)));
        a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])
    };
    triangles.iter().map(of).sum()
}

/// A sphere or torus, higher inside, across four regions.
fn solid(torus: bool) -> (Grid, Samples) {
    let dims = [46, 44, 30];
    let grid = Grid::new(dims, [1.0; 3]).expect("a grid");
    let mut values = Vec::new();
    for z in 0..dims[2] {
        for y in 0..dims[1] {
            for x in 0..dims[0] {
                let [x, y, z] = [x as f32 - 22.7, y as f32 - 21.3, z as f32 - 14.6];
                let ring = (x * x + y * y).sqrt();
                values.push(if torus {
                    6.2 - ((ring - 13.1).powi(2) + z * z).sqrt()
                } else {
                    11.9 - (ring * ring + z * z).sqrt()
                });
            }
        }
    }
    (grid, Samples::F32(values))
}

#[test]
fn sphere_and_torus_keep_their_topology_at_any_beta() {
    let Some(engine) = device() else { return };
    for (torus, characteristic) in [(false, 2), (true, 0)] {
        let (grid, samples) = solid(torus);
        let volume = engine.upload(grid, &samples, None).expect("upload");
        let iso = Isovalue::new(0.0).expect("finite");
        let pyramid = engine
            .build_pyramid(&volume, Feature::None, iso, &Never)
            .expect("build the pyramid");
        let mut minimum = u64::MAX;
        for beta in [-1.0, 0.0005, 0.003, 0.01, 0.03, 0.1, 1.0] {
            let params = CutParams {
                beta,
                topology: Topology::Preserve,
                ..dual_params()
            };
            let surface = engine
                .peel(&volume, &pyramid, &params, Level::FINEST, &Never)
                .expect("peel");
            let triangles = welded(&surface.regions);
            assert_eq!(euler(&triangles), characteristic, "torus: {torus}, beta {beta}");
            assert!(
                edges(&triangles).values().all(|uses| *uses == [1, 1]),
                "closed and consistently oriented"
            );
            // Of the sphere's or the torus's: a coarse cut is a coarse solid, but never inside out.
            let pi = std::f64::consts::PI;
            let want = if torus {
                2.0 * pi * pi * 13.1 * 6.2f64.powi(2)
            } else {
                4.0 / 3.0 * pi * 11.9f64.powi(3)
            };
            let share = enclosed(&triangles) / 6.0 / want;
            let allowed = if beta < 0.0 { 0.01 } else { 0.3 };
            assert!(
                (share - 1.0).abs() < allowed,
                "torus: {torus}, beta {beta}: {share} of the volume"
            );
            minimum = minimum.min(surface.statistics.triangles);
        }
        assert!(minimum < pyramid.full_triangles() / 4, "decimated to {minimum}");
    }
}

/// A cut of cubes with one sheet each, two of which shared an ambiguous face: four triangles at one edge, until cubes with
/// such a face no longer were safe to merge.
#[test]
fn cubes_with_ambiguous_faces_are_not_merged() {
    let Some(engine) = device() else { return };
    let recipe = Recipe {
        kind: SampleType::U8,
        ..Recipe::plain([33, 33, 33], Pattern::Waves(0), 2_422_874_308_217_482_364)
    };
    any_cut(&engine, &recipe, 4_563_508_721_978_424_566, Topology::Preserve).expect("manifold");
}

/// What differs between two surfaces, region by region.
fn differences(a: &[Region], b: &[Region]) -> Vec<String> {
    let of_regions = |(a, b): (&Region, &Region)| {
        let vertices = a.vertices.iter().zip(&*b.vertices);
        let first = vertices.enumerate().find(|(_, (a, b))| a != b);
        let indices = (a.indices != b.indices).then_some("other indices");
        format!(
            "{:?}: {} and {} vertices, first different {first:?}, {indices:?}, error {:?} and {:?}",
            a.coords,
            a.vertices.len(),
            b.vertices.len(),
            a.error,
            b.error
        )
    };
    if a.len() != b.len() {
        return vec![format!("{} and {} regions", a.len(), b.len())];
    }
    a.iter().zip(b).filter(|(a, b)| a != b).map(of_regions).collect()
}

#[test]
fn cells_alone_give_the_full_surface_and_no_other() {
    let Some(engine) = device() else { return };
    proptest!(config(6), |(recipe in recipes(surfaces()))| {
        let loaded = load(&engine, &recipe);
        let (iso, feature) = (Isovalue::new(loaded.iso).expect("finite"), Feature::Derived(DerivedFeature::GradientMagnitude));
        let whole = build(&engine, &loaded, feature);
        let cells = engine.build_cells(&loaded.volume, feature, iso, &Never).expect("build the cells");
        prop_assert_eq!(cells.full_triangles(), whole.full_triangles());
        let params = CutParams { state_error: true, ..dual_params() };
        let peel = |pyramid: &Pyramid, params: &CutParams| {
            engine.peel(&loaded.volume, pyramid, params, Level::FINEST, &Never)
        };
        let (from_whole, from_cells) = (peel(&whole, &params).expect("peel"), peel(&cells, &params).expect("peel"));
        let differing = differences(&from_whole.regions, &from_cells.regions);
        prop_assert!(differing.is_empty(), "{:?}", differing);
        prop_assert_eq!(from_whole.statistics.leaves, from_cells.statistics.leaves);
        prop_assert_eq!(from_whole.statistics.error, from_cells.statistics.error);
        let refused = peel(&cells, &CutParams { beta: 0.1, ..dual_params() }).expect_err("needs the cubes");
        prop_assert!(refused.to_string().contains("cells alone"), "{}", refused);
    });
}

/// Two sheets of a cell that touch in one point of a face: their border vertices lay there both.
#[test]
fn sheets_that_touch_on_a_face_have_vertices_of_their_own() {
    let Some(engine) = device() else { return };
    let recipe = Recipe {
        kind: SampleType::U8,
        ..Recipe::plain([7, 93, 31], Pattern::Noise, 4_790_176_990_765_387_805)
    };
    any_cut(&engine, &recipe, 14_694_541_107_857_536_766, Topology::Preserve).expect("as many positions as vertices");
}
