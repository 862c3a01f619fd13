//! How leaves' values are distributed, in cuts of cubes and of the vertex tree.

use super::host_tree::HostTree;
use super::recipes::{Random, recipes, surfaces};
use super::tree::plant;
use super::tree_cut::cut;
use super::*;
use isopeel_kernels::testing::with_gpu_kernels;
use isopeel_kernels::{PartFilter, ShownCut, TreeGoal};
use isopeel_reference::distribution::{of_cut, of_tree};
use isopeel_reference::tree_cut::Cutter;
use isopeel_reference::tree_part::{Filter, parts, without};
use std::collections::BTreeSet;

fn params(random: &mut Random) -> CutParams {
    CutParams {
        alpha: [0.0, 0.5, 1.0][(random.next() % 3) as usize],
        feature_range: [0.0, 1.5],
        ..dual_params()
    }
}

fn check_cubes(engine: &Engine, recipe: &Recipe, seed: u64, bins: u32) -> Result<(), TestCaseError> {
    let loaded = load(engine, recipe);
    let pyramid = build(engine, &loaded, Feature::Derived(DerivedFeature::GradientMagnitude));
    let host = HostPyramid::read(engine, &pyramid);
    let params = params(&mut Random(seed));
    let state = host.random_state(seed, Topology::Free);
    let cut = testing::upload_cut(engine, &pyramid, &params, &state).expect("a cut");
    let feature = isopeel_reference::Feature::Derived(DerivedFeature::GradientMagnitude);
    let mut twin = isopeel_reference::construct::construct(&loaded.field, feature, loaded.iso);
    host.fill(&mut twin);
    let got = engine
        .distribution(&loaded.volume, &pyramid, &params, &ShownCut::Cubes(&cut), bins)
        .expect("a distribution");
    prop_assert_eq!(got, of_cut(&twin, &host.cut(&twin, &state), &params, bins));
    Ok(())
}

fn check_tree(engine: &Engine, recipe: &Recipe, seed: u64, bins: u32) -> Result<(), TestCaseError> {
    let planted = plant(engine, recipe, false);
    let params = params(&mut Random(seed));
    let host = HostTree::read(engine, &planted);
    let parts = parts(&host.mesh);
    let largest = parts.areas.iter().copied().fold(0.0, f64::max) as f32;
    for min_area in [0.0, 0.9 * largest] {
        let filter = Filter {
            min_area: min_area.into(),
            chosen: None,
        };
        let goal = TreeGoal {
            tolerance: 0.1,
            max_triangles: u64::MAX,
            max_tolerance: f32::INFINITY,
            without: PartFilter { min_area, chosen: None },
            may_vanish: false,
            weights: None,
        };
        cut(engine, &planted, &params, &goal);
        let (volume, pyramid, tree) = (&planted.loaded.volume, &planted.pyramid, &planted.tree);
        let shown = engine
            .shown_tree_cut(volume, pyramid, tree, &params, &goal, &Never)
            .expect("the cut");
        let got = engine
            .distribution(volume, pyramid, &params, &shown, bins)
            .expect("a distribution");
        let remaining = without(&host.mesh, &host.tree, &parts, &filter);
        let nothing = BTreeSet::new();
        let (mesh, removed) = match min_area {
            0.0 => (&host.mesh, &nothing),
            _ => (&remaining.mesh, &remaining.nodes),
        };
        let cutter = Cutter {
            mesh,
            tree: &host.tree,
            removed,
            may_vanish: false,
            weights: None,
        };
        let importances = host.importances(engine, &planted, &cutter, &params)?;
        let want = cutter.cut(importances.as_ref(), &goal).expect("a cut without faults");
        prop_assert_eq!(
            got,
            of_tree(
                &cutter,
                &want.leaves,
                |point| remaining.is_removed[point],
                &params,
                bins
            )
        );
    }
    Ok(())
}

#[test]
fn values_of_leaves_are_distributed_as_the_twins() {
    let Some(engine) = device() else { return };
    proptest!(config(6), |(recipe in recipes(surfaces()), seed in any::<u64>(), bins in 1..=256u32)| {
        check_cubes(&engine, &recipe, seed, bins)?;
        check_tree(&engine, &recipe, seed, bins)?;
    });
}

/// The kernels of a GPU on any device: work-groups of many.
#[test]
fn work_groups_of_a_gpu_count_the_same() {
    let Some(engine) = device() else { return };
    let of_gpu = with_gpu_kernels(&engine, None);
    let recipe = Recipe::plain([38, 20, 35], recipes::Pattern::Waves(15), 9);
    check_cubes(&of_gpu, &recipe, 4, 64).expect("the twin's counts");
    check_tree(&of_gpu, &recipe, 4, 256).expect("the twin's counts");
}

#[test]
fn too_few_and_too_many_bins_are_refused() {
    let Some(engine) = device() else { return };
    let loaded = load(&engine, &Recipe::plain([9, 9, 9], recipes::Pattern::Waves(0), 1));
    let pyramid = build(&engine, &loaded, Feature::None);
    let params = dual_params();
    let cut = engine
        .cut(&loaded.volume, &pyramid, &params, Level::FINEST)
        .expect("a cut");
    for bins in [0, 257, u32::MAX] {
        let refused = engine.distribution(&loaded.volume, &pyramid, &params, &ShownCut::Cubes(&cut), bins);
        assert!(refused.is_err(), "{bins} bins");
    }
}
