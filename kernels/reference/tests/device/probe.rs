//! What is next to a position: the cell, its leaf in cuts of cubes and of the vertex tree, and the field's value.

use super::host_tree::HostTree;
use super::interest::interests;
use super::recipes::{Random, any_recipe, recipes, surfaces};
use super::tree::plant;
use super::tree_cut::cut;
use super::*;
use isopeel_kernels::{PartFilter, ShownCut, TreeGoal};
use isopeel_reference::probe::{NearestCell, nearest_cell};
use isopeel_reference::tree::BlockId;
use isopeel_reference::tree_cut::{Cutter, TreeLeaf};
use isopeel_reference::tree_part::parts;
use std::collections::BTreeSet;

/// Positions on vertices, next to them, at the volume's ends and anywhere.
fn positions(host: &HostPyramid, random: &mut Random) -> Vec<[f32; 3]> {
    let ends = host.grid.dims.map(|n| (n - 1) as f32);
    let mut anywhere = || std::array::from_fn(|i| random.unit() * ends[i]);
    let mut positions = vec![[0.0; 3], ends, anywhere(), anywhere(), anywhere()];
    for i in 0..12 {
        let slot = random.next() as usize % host.nodes.len().max(1);
        let Some(leaf) = host.leaves.get(slot) else { break };
        let at = host
            .position(host.slots[leaf])
            .map(|x| x as f32 / Vertex::LATTICE as f32);
        let off = if i % 3 == 0 { 0.0 } else { 2.0 };
        positions.push(std::array::from_fn(|i| {
            (at[i] + off * (random.unit() - 0.5)).clamp(0.0, ends[i])
        }));
    }
    positions
}

fn params(random: &mut Random, dims: [u32; 3]) -> CutParams {
    CutParams {
        alpha: random.unit(),
        feature_range: [0.0, 1.5],
        interest: interests(random, dims),
        ..dual_params()
    }
}

fn twin(host: &HostPyramid, twin: &Twin, params: &CutParams, position: [f32; 3]) -> Option<NearestCell> {
    let vertex = |cell| {
        let slot = host.slots[&Leaf { level: 0, cube: cell }];
        host.position(slot).map(|x| x as f32 / Vertex::LATTICE as f32)
    };
    nearest_cell(twin, host.grid.spacing, params, position, vertex)
}

/// The twin's pyramid with the device's numbers.
fn filled(host: &HostPyramid, loaded: &Loaded) -> Twin {
    let feature = isopeel_reference::Feature::Derived(DerivedFeature::GradientMagnitude);
    let mut twin = isopeel_reference::construct::construct(&loaded.field, feature, loaded.iso);
    host.fill(&mut twin);
    twin
}

/// Two vertices may be as near as each other: then either will do.
fn check_cell(got: &isopeel_kernels::Probed, want: &NearestCell) -> Result<bool, TestCaseError> {
    prop_assert!(
        near(got.distance, want.distance, 1e-5),
        "{:?}, expected {:?}",
        got,
        want
    );
    let is_same = near(got.blended, want.blended, 1e-6) && near(got.importance, want.importance, 1e-6);
    prop_assert!(is_same || want.has_equal, "{:?}, expected {:?}", got, want);
    Ok(!want.has_equal)
}

fn check_cubes(engine: &Engine, recipe: &Recipe, seed: u64) -> Result<(), TestCaseError> {
    let (loaded, mut random) = (load(engine, recipe), Random(seed));
    let pyramid = build(engine, &loaded, Feature::Derived(DerivedFeature::GradientMagnitude));
    let host = HostPyramid::read(engine, &pyramid);
    let params = params(&mut random, recipe.dims);
    let state = host.random_state(seed, Topology::Free);
    let cut = testing::upload_cut(engine, &pyramid, &params, &state).expect("a cut");
    let pyramid_twin = filled(&host, &loaded);
    for position in positions(&host, &mut random) {
        let shown = ShownCut::Cubes(&cut);
        let got = engine
            .probe(&loaded.volume, &pyramid, &params, position, Some(&shown))
            .expect("a probe");
        let want = twin(&host, &pyramid_twin, &params, position);
        prop_assert_eq!(got.is_some(), want.is_some(), "at {:?}", position);
        let (Some(got), Some(want)) = (got, want) else { continue };
        if !check_cell(&got, &want)? {
            continue;
        }
        let level = state[host.slots[&Leaf {
            level: 0,
            cube: want.cell,
        }]];
        let leaf = Leaf {
            level,
            cube: want.cell.map(|c| c >> level),
        };
        prop_assert_eq!(got.part, None, "cubes know of no parts");
        let found = got.leaf.expect("a leaf");
        let error = host.vertex_records[host.slots[&leaf]].error;
        prop_assert_eq!((found.level, found.error), (level, error));
    }
    Ok(())
}

#[test]
fn cells_and_cubes_next_to_positions_are_the_twins() {
    let Some(engine) = device() else { return };
    proptest!(config(8), |(recipe in any_recipe(), seed in any::<u64>())| check_cubes(&engine, &recipe, seed)?);
}

/// The leaf of the vertex tree of each cell is the one that the twin's cut has there.
#[test]
fn leaves_of_the_tree_are_the_twins() {
    let Some(engine) = device() else { return };
    proptest!(config(4), |(recipe in recipes(surfaces()), seed in any::<u64>())| {
        let (planted, mut random) = (plant(&engine, &recipe, false), Random(seed));
        let host = HostPyramid::read(&engine, &planted.pyramid);
        let params = params(&mut random, recipe.dims);
        let goal = TreeGoal { tolerance: 0.1, max_triangles: u64::MAX, max_tolerance: f32::INFINITY, without: PartFilter::default(), may_vanish: false, weights: None };
        cut(&engine, &planted, &params, &goal);
        let (volume, pyramid) = (&planted.loaded.volume, &planted.pyramid);
        let shown = engine.shown_tree_cut(volume, pyramid, &planted.tree, &params, &goal, &Never).expect("the cut");
        // Of a large surface a probe knows the parts once some were removed.
        let small = PartFilter { min_area: f32::MIN_POSITIVE, chosen: None };
        engine.removed_parts(volume, pyramid, &planted.tree, &params, &small, &Never).expect("the parts");
        let of_tree = HostTree::read(&engine, &planted);
        let removed = BTreeSet::new();
        let cutter = Cutter { mesh: &of_tree.mesh, tree: &of_tree.tree, removed: &removed, may_vanish: false, weights: None };
        let importances = of_tree.importances(&engine, &planted, &cutter, &params)?;
        let want = cutter.cut(importances.as_ref(), &goal).expect("a cut without faults");
        let pyramid_twin = filled(&host, &planted.loaded);
        let parts = parts(&of_tree.mesh);
        let spacing = host.grid.smallest_spacing();
        for position in positions(&host, &mut random) {
            let got = engine.probe(volume, pyramid, &params, position, Some(&shown)).expect("a probe");
            let cell = twin(&host, &pyramid_twin, &params, position);
            prop_assert_eq!(got.is_some(), cell.is_some());
            let (Some(got), Some(cell)) = (got, cell) else { continue };
            if !check_cell(&got, &cell)? {
                continue;
            }
            // The first point of a cell is that of its first sheet.
            let point = of_tree.mesh.points.iter().position(|p| p.cell == cell.cell).expect("a point");
            let area = parts.firsts[point].map(|_| parts.areas[point] as f32);
            prop_assert_eq!(got.part.is_some(), area.is_some());
            prop_assert!(near(got.part.map_or(0.0, |part| part.area), area.unwrap_or(0.0), 1e-4), "{:?}, expected an area of {:?}", got, area);
            let leaf = want.leaves[point];
            let found = got.leaf.expect("a leaf");
            prop_assert_eq!(found.level, cutter.level(leaf));
            let error = match leaf {
                TreeLeaf::Point(_) => 0.0,
                TreeLeaf::Node(id) => {
                    let block = &of_tree.tree.blocks[&id.block];
                    let region_of = |p: &usize| of_tree.mesh.points[*p].region;
                    let is_inside = |p: &usize| BlockId::of_region(id.block.level, region_of(p)) == id.block;
                    let all = (0..want.leaves.len()).filter(is_inside).count() as f32;
                    let own = want.leaves.iter().filter(|other| **other == leaf).count() as f32;
                    spacing * block.nodes[id.index].error / (block.area * own / all).sqrt()
                }
            };
            prop_assert!(near(found.error, error, 1e-4), "{:?}, expected {}", found, error);
        }
    });
}

/// Samples are read through slabs of every type; if one that counts is missing, so is the value.
#[test]
fn values_are_the_fields_trilinear_ones() {
    let Some(engine) = device() else { return };
    proptest!(config(12), |(recipe in any_recipe(), seed in any::<u64>())| {
        let (loaded, mut random) = (load(&engine, &recipe), Random(seed));
        for i in 0..8 {
            let at: [f32; 3] = std::array::from_fn(|axis| {
                let x = random.unit() * (recipe.dims[axis] - 1) as f32;
                if i % 2 == 0 { x } else { x.round() }
            });
            let got = engine.value_at(&loaded.volume, at).expect("a value");
            let low: [u32; 3] = std::array::from_fn(|i| (at[i] as u32).min(recipe.dims[i] - 2));
            let (mut want, mut largest) = (0.0f64, 1.0f32);
            for (corner, value) in loaded.field.cell_corners(low).into_iter().enumerate() {
                let weight: f32 = (0..3).map(|i| {
                    let t = at[i] - low[i] as f32;
                    if corner >> i & 1 == 1 { t } else { 1.0 - t }
                }).product();
                if weight > 0.0 {
                    want += f64::from(weight) * f64::from(value);
                    largest = largest.max(value.abs());
                }
            }
            prop_assert_eq!(got.is_none(), want.is_nan() && got.is_none_or(|v| !v.is_nan()), "{:?} at {:?}", want, at);
            if let Some(got) = got {
                let want = want as f32;
                let is_near = got == want || (got.is_nan() && want.is_nan()) || (got - want).abs() <= 1e-5 * largest;
                prop_assert!(is_near, "{} at {:?}, expected {}", got, at, want);
            }
        }
    });
}
