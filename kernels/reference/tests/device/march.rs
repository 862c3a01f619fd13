//! The paper's mesher on any cut: vertices by the fine edge they lie on, before and after patching, and as they leave.

use super::recipes::{recipes, surfaces};
use super::*;
use isopeel_kernels::layout::{Counters, RegionMesh, WorkVertex};
use isopeel_kernels::testing::Marched;
use isopeel_reference::{
    Feature as TwinFeature, FineEdge, Mesh, construct, march as twin_march, pack as twin_pack, patch as twin_patch,
};
use std::collections::{BTreeMap, BTreeSet};

/// Device vertices by fine edge: positions from the volume's first sample.
type Positions = BTreeMap<FineEdge, [i64; 3]>;

struct Work {
    meshes: Vec<RegionMesh>,
    keys: Vec<FineEdge>,
    unpatched: Positions,
    patched: Positions,
    triangles: Vec<[FineEdge; 3]>,
}

/// The vertices of all regions; what regions share must be equal.
fn positions(host: &HostPyramid, meshes: &[RegionMesh], vertices: &[WorkVertex]) -> (Vec<FineEdge>, Positions) {
    let [rx, ry, _] = host.grid.regions();
    let (mut keys, mut positions) = (Vec::new(), Positions::new());
    for (mesh, region) in meshes.iter().zip(&host.regions) {
        let origin = [region.region % rx, region.region / rx % ry, region.region / rx / ry].map(|c| c * 32);
        assert_eq!(mesh.vertex_base as usize, keys.len());
        for v in &vertices[keys.len()..keys.len() + mesh.vertices as usize] {
            let low = std::array::from_fn(|i| origin[i] + (v.key >> (6 * i) & 63));
            let edge = FineEdge {
                low,
                axis: (v.key >> 18 & 3) as u8,
            };
            let at = std::array::from_fn(|i| (i64::from(origin[i]) << 16) + i64::from(v.position[i]));
            if let Some(other) = positions.insert(edge, at) {
                assert_eq!(other, at, "{edge:?} has one position in all regions");
            }
            keys.push(edge);
        }
    }
    (keys, positions)
}

fn work(engine: &Engine, loaded: &Loaded, pyramid: &Pyramid, host: &HostPyramid, state: &[u8]) -> (Work, Counters) {
    let Marched {
        meshes,
        refined,
        patched,
        indices,
        counters,
    } = testing::march(engine, &loaded.volume, pyramid, state).expect("march");
    let (keys, unpatched) = positions(host, &meshes, &refined);
    let (_, patched) = positions(host, &meshes, &patched);
    let mut triangles = Vec::new();
    for mesh in &meshes {
        let count = mesh.triangles.iter().sum::<u32>() as usize;
        let from = 3 * mesh.triangle_base as usize;
        let own = indices[from..from + 3 * count].chunks_exact(3);
        triangles.extend(own.map(|t| [0, 1, 2].map(|i| keys[(mesh.vertex_base + t[i]) as usize])));
    }
    (
        Work {
            meshes,
            keys,
            unpatched,
            patched,
            triangles,
        },
        counters,
    )
}

/// Within a lattice unit.
fn check_positions(got: &Positions, want: &Mesh) -> Result<(), TestCaseError> {
    prop_assert!(got.keys().eq(want.vertices.keys()), "the same fine edges");
    for (edge, at) in got {
        let expected = want.vertices[edge].position;
        prop_assert!(
            (0..3).all(|i| (at[i] - expected[i]).abs() <= 1),
            "{:?} at {:?}, expected {:?}",
            edge,
            at,
            expected
        );
    }
    Ok(())
}

/// Distance of a point to a segment.
fn distance(p: [i64; 3], [a, b]: [[i64; 3]; 2]) -> f64 {
    let between = |from: [i64; 3], to: [i64; 3]| -> [f64; 3] { std::array::from_fn(|i| (to[i] - from[i]) as f64) };
    let dot = |u: [f64; 3], v: [f64; 3]| (0..3).map(|i| u[i] * v[i]).sum::<f64>();
    let (d, to) = (between(a, b), between(a, p));
    let t = if dot(d, d) > 0.0 {
        (dot(to, d) / dot(d, d)).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let away: [f64; 3] = std::array::from_fn(|i| to[i] - t * d[i]);
    dot(away, away).sqrt()
}

/// Patched vertices lie as near to their original positions as the twin's, on the segment that the twin chooses or one equally near.
fn check_patched(
    loaded: &Loaded,
    twin: &Twin,
    cut: &Cut,
    before: &Mesh,
    got: &Positions,
    want: &Mesh,
) -> Result<(), TestCaseError> {
    for (edge, at) in got {
        let expected = want.vertices[edge].position;
        if (0..3).all(|i| (at[i] - expected[i]).abs() <= 1) {
            continue;
        }
        // If two segments are equally near, the device may have chosen the other one, for this vertex or earlier for an end of a
        // segment. The vertex still is the nearest point of the segments between the ends at their positions on the device.
        let from = before.vertices[edge].position;
        let leaves: Vec<Leaf> = edge.active_cells(twin).iter().map(|c| cut.leaf_of[c]).collect();
        let coarsest = leaves.iter().map(|l| l.level).max();
        let nearest = leaves
            .iter()
            .filter(|l| Some(l.level) == coarsest)
            .flat_map(|l| twin_patch::segments_at(&loaded.field, loaded.iso, *l, &cut.leaves[l], *edge))
            .map(|ends| distance(from, ends.map(|e| got[&e])))
            .fold(f64::INFINITY, f64::min);
        let moved = distance(from, [*at, *at]);
        prop_assert!(
            (moved - nearest).abs() <= 4.0,
            "{:?} moved {} to {:?}, its segments are {} away; expected {:?}",
            edge,
            moved,
            at,
            nearest,
            expected
        );
    }
    Ok(())
}

fn sorted(mut triangles: Vec<[FineEdge; 3]>) -> Vec<[FineEdge; 3]> {
    for t in &mut triangles {
        let first = (0..3).min_by_key(|&i| t[i]).unwrap_or(0);
        t.rotate_left(first);
    }
    triangles.sort_unstable();
    triangles
}

/// A random cut on the device and in the twin's form.
struct RandomCut {
    loaded: Loaded,
    pyramid: Pyramid,
    host: HostPyramid,
    twin: Twin,
    state: Vec<u8>,
    cut: Cut,
}

impl RandomCut {
    fn new(engine: &Engine, recipe: &Recipe, seed: u64) -> Self {
        let loaded = load(engine, recipe);
        let pyramid = build(engine, &loaded, Feature::Derived(DerivedFeature::GradientMagnitude));
        let host = HostPyramid::read(engine, &pyramid);
        let mut twin = construct::construct(
            &loaded.field,
            TwinFeature::Derived(DerivedFeature::GradientMagnitude),
            loaded.iso,
        );
        host.fill(&mut twin);
        let state = host.random_state(seed, Topology::Free);
        let cut = host.cut(&twin, &state);
        Self {
            loaded,
            pyramid,
            host,
            twin,
            state,
            cut,
        }
    }
}

/// A vertex as it leaves the device: attributes and normal of the crossing at `t` on `edge`.
fn check_packed(
    random: &RandomCut,
    params: &CutParams,
    vertex: &Vertex,
    edge: FineEdge,
    t: f32,
) -> Result<(), TestCaseError> {
    let wanted = twin_pack::attributes(edge, &random.twin, &random.cut, params);
    for (got, want) in [vertex.smoothness, vertex.feature].into_iter().zip(wanted) {
        prop_assert!((f32::from(got) - want.clamp(0.0, 1.0) * 65535.0).abs() <= 0.51);
    }
    let field = &random.loaded.field;
    let (a, b) = (field.gradient(edge.low), field.gradient(edge.high()));
    let steep = (0..3).map(|i| (a[i] + (b[i] - a[i]) * t).abs()).fold(0.0, f32::max);
    let scale = (0..3).map(|i| a[i].abs().max(b[i].abs())).fold(0.0, f32::max);
    // If the two gradients nearly cancel out, rounding decides.
    if steep > 1e-3 * scale {
        let (got, want) = (vertex.unit_normal(), twin_pack::normal(field, edge, t));
        let off = (0..3).map(|i| (got[i] - want[i]).abs()).fold(0.0, f32::max);
        prop_assert!(
            off < 2e-4 + 4e-5 * scale / steep,
            "normal of {:?}: {:?}, expected {:?}",
            edge,
            got,
            want
        );
    }
    Ok(())
}

/// Marching cubes on a random cut, before patching, patched, and as it leaves the device.
fn check(engine: &Engine, random: &RandomCut) -> Result<(), TestCaseError> {
    let RandomCut {
        loaded,
        pyramid,
        host,
        twin,
        state,
        cut,
    } = random;
    let (work, counters) = work(engine, loaded, pyramid, host, state);

    let before = twin_march::march(&loaded.field, twin, loaded.iso, cut);
    check_positions(&work.unpatched, &before)?;
    let want = before.triangles.iter().map(|t| t.vertices).collect();
    prop_assert_eq!(
        sorted(work.triangles),
        sorted(want),
        "the same triangles, oriented alike"
    );
    let of_level = |l: u8| before.triangles.iter().filter(|t| t.leaf.level == l).count() as u32;
    let by_level: Vec<u32> = (0..6)
        .map(|l| work.meshes.iter().map(|m| m.triangles[l]).sum())
        .collect();
    prop_assert_eq!(by_level, (0..6).map(of_level).collect::<Vec<_>>(), "triangles by level");

    let mut after = before.clone();
    twin_patch::patch(&loaded.field, twin, loaded.iso, cut, &mut after);
    check_patched(loaded, twin, cut, &before, &work.patched, &after)?;
    prop_assert_eq!(u64::from(counters.unpatched_vertices), after.unpatched);

    let params = CutParams {
        alpha: 0.5,
        feature_range: [0.0, 40.0],
        ..CutParams::paper(0.0)
    };
    let Surface {
        regions, statistics, ..
    } = mesh(engine, loaded, pyramid, &params, state);
    prop_assert_eq!(
        statistics.vertices as usize,
        before.vertices.len(),
        "vertices counted once"
    );
    prop_assert_eq!(statistics.unpatched_vertices, after.unpatched);
    let mut seen = BTreeSet::new();
    let made = work.meshes.iter().filter(|m| m.triangles.iter().any(|&n| n > 0));
    for (region, mesh) in regions.iter().zip(made) {
        let keys = &work.keys[mesh.vertex_base as usize..];
        for (vertex, &edge) in region.vertices.iter().zip(keys) {
            seen.insert(edge);
            prop_assert_eq!(absolute(region, vertex), work.patched[&edge]);
            check_packed(random, &params, vertex, edge, before.vertices[&edge].t)?;
        }
    }
    prop_assert_eq!(seen.len(), before.vertices.len());
    Ok(())
}

#[test]
fn any_cut_is_marched_patched_and_packed_as_the_twin_does() {
    let Some(engine) = device() else { return };
    proptest!(config(12), |(recipe in recipes(surfaces()), seed in any::<u64>())| {
        check(&engine, &RandomCut::new(&engine, &recipe, seed))?;
    });
}
