//! What the dual mesher promises, on welded positions, bit for bit: watertight for any cut, a manifold where topology is
//! preserved, turned one way.

use super::volumes::{Pattern, recipes, surfaces};
use super::*;
use crate::{Mesher, SampleType};
use std::collections::HashMap;

/// Uses of an edge from its lesser to its greater end, and back.
type Edges = HashMap<[[i64; 3]; 2], [u32; 2]>;

fn edges(triangles: &[[[i64; 3]; 3]]) -> Edges {
    let mut edges = Edges::new();
    for t in triangles {
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            edges.entry([a.min(b), a.max(b)]).or_default()[usize::from(a > b)] += 1;
        }
    }
    edges
}

/// The leaf of every vertex, by position; no two vertices of a cut lie in one place.
fn owners(host: &Host, state: &[u8]) -> HashMap<[i64; 3], Leaf> {
    let mut owners = HashMap::new();
    for (slot, leaf) in host.leaves.iter().enumerate() {
        if state[slot] == leaf.level {
            let taken = owners.insert(host.position(slot), *leaf);
            assert_eq!(taken, None, "two vertices in one place, one of them {leaf:?}'s");
        }
    }
    owners
}

/// Whether the surface may end between two leaves: where they touch, the volume ends or a sample is missing.
fn may_end(field: &Field, leaves: [Leaf; 2]) -> bool {
    let boxes = leaves.map(|l| field.cube_samples(usize::from(l.level), l.cube));
    let low: [u32; 3] = std::array::from_fn(|i| boxes[0][0][i].max(boxes[1][0][i]));
    let high: [u32; 3] = std::array::from_fn(|i| boxes[0][1][i].min(boxes[1][1][i]));
    if (0..3).any(|i| low[i] == 0 || high[i] + 1 == field.grid.dims[i]) {
        return true;
    }
    let around = |x: u32, i: usize| x.saturating_sub(1)..=(high[i] + 1).min(field.grid.dims[i] - 1);
    around(low[2], 2).any(|z| around(low[1], 1).any(|y| around(low[0], 0).any(|x| field.at([x, y, z]).is_nan())))
}

/// Checks the promises; `manifold`: that no edge is used by more than two triangles.
fn check(
    field: &Field,
    host: &Host,
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
        let [Some(a), Some(b)] = leaves else {
            return Err(TestCaseError::fail(format!("{ends:?} is no leaf's vertex: {leaves:?}")));
        };
        let uses = forth + back;
        prop_assert!(
            forth == back || may_end(field, [a, b]),
            "{forth} triangles one way, {back} the other, at the edge between {a:?} and {b:?}"
        );
        prop_assert!(
            !manifold || uses <= 2,
            "{uses} triangles at the edge between {a:?} and {b:?}, expected at most 2"
        );
    }
    Ok(())
}

fn dual() -> CutParams {
    CutParams {
        mesher: Mesher::Dual,
        ..CutParams::paper(-1.0)
    }
}

fn any_cut(engine: &Engine, recipe: &Recipe, seed: u64, topology: Topology) -> Result<(), TestCaseError> {
    let loaded = load(engine, recipe);
    let pyramid = build(engine, &loaded, Feature::None);
    let host = Host::read(engine, &pyramid);
    let state = host.random_state(seed, topology);
    let (regions, counters) = mesh(engine, &loaded, &pyramid, &dual(), &state);
    let triangles = welded(&regions);
    check(&loaded.field, &host, &state, &triangles, topology == Topology::Preserve)?;
    let mut different: Vec<_> = triangles.iter().flatten().collect();
    different.sort_unstable();
    different.dedup();
    prop_assert_eq!(different.len(), counters.vertices as usize, "vertices counted once");
    Ok(())
}

#[test]
fn any_cut_is_watertight() {
    let Some(engine) = device() else { return };
    proptest!(config(48), |(recipe in recipes(surfaces()), seed in any::<u64>())| {
        any_cut(&engine, &recipe, seed, Topology::Free)?;
    });
}

#[test]
fn safe_cuts_are_manifold() {
    let Some(engine) = device() else { return };
    proptest!(config(48), |(recipe in recipes(surfaces()), seed in any::<u64>())| {
        any_cut(&engine, &recipe, seed, Topology::Preserve)?;
    });
}

#[test]
fn full_resolution_is_manifold() {
    let Some(engine) = device() else { return };
    proptest!(config(32), |(recipe in recipes(surfaces()))| {
        let loaded = load(&engine, &recipe);
        let pyramid = build(&engine, &loaded, Feature::None);
        let host = Host::read(&engine, &pyramid);
        let state: Vec<u8> = host.leaves.iter().map(|l| if l.level == 0 { 0 } else { 255 }).collect();
        let (regions, _) = mesh(&engine, &loaded, &pyramid, &dual(), &state);
        check(&loaded.field, &host, &state, &welded(&regions), true)?;
    });
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
