//! The cut, leaf for leaf, on nodes read back from the device, so that not even rounding may differ.

use super::interest::interests;
use super::recipes::{Random, recipes, surfaces};
use super::*;
use isopeel_kernels::{ControlPoint, ErrorEstimate, MAX_LEVEL, TransferFunction};
use isopeel_reference::{Feature as TwinFeature, construct, cut};

pub fn params(seed: u64, host: &HostPyramid, recipe: &Recipe) -> (CutParams, Level) {
    let mut random = Random(seed);
    let mut some = |n: u64| random.next() % n;
    let level = |l: u64| Level::new(l as u8).expect("a level");
    // Sometimes exactly the importance of a node.
    let beta = match some(3) {
        0 => host
            .nodes
            .get(some(1 << 20) as usize % host.nodes.len().max(1))
            .map_or(0.1, |n| n.s),
        1 => 0.01,
        _ => some(1000) as f32 / 2000.0,
    };
    let alpha = [0.0, 0.0, 0.3, 1.0][some(4) as usize];
    let points = (0..some(5))
        .map(|_| ControlPoint {
            x: some(5) as f32 / 4.0,
            importance: some(9) as f32 / 8.0,
        })
        .collect::<Vec<_>>();
    let interest = interests(&mut Random(seed ^ 1), recipe.dims);
    let params = CutParams {
        alpha,
        beta,
        feature_range: [[0.0, 1.0], [-3.5, 100.0]][some(2) as usize],
        max_level: if some(2) == 0 { MAX_LEVEL } else { level(some(6)) },
        transfer: TransferFunction::new(points).unwrap_or_default(),
        interest,
        max_error: (some(2) == 0).then(|| some(100) as f32 / 100.0 * recipe.spacing[1]),
        topology: if some(2) == 0 {
            Topology::Free
        } else {
            Topology::Preserve
        },
        ..CutParams::paper(0.0)
    };
    (params, if some(3) == 0 { level(some(6)) } else { Level::FINEST })
}

/// The estimate is the mean over the leaves, weighted by their triangles.
fn check_estimate(host: &HostPyramid, state: &[u8], estimate: ErrorEstimate) -> Result<(), TestCaseError> {
    let (mut error2, mut weight, mut worst) = (0.0, 0.0, 0f32);
    for (slot, leaf) in host.leaves.iter().enumerate() {
        if state[slot] != leaf.level || host.is_extra(slot) {
            continue;
        }
        let triangles = if leaf.level == 0 {
            host.nodes[slot].count & 0xff
        } else {
            host.nodes[slot].count
        };
        let error = host.vertex_records[slot].error;
        error2 += f64::from(triangles) * f64::from(error).powi(2);
        weight += f64::from(triangles);
        worst = worst.max(error);
    }
    let rms = if weight > 0.0 {
        (error2 / weight).sqrt() as f32
    } else {
        0.0
    };
    prop_assert!(near(estimate.rms, rms, 1e-4), "{estimate:?}, expected rms {rms}");
    prop_assert_eq!(estimate.worst_leaf, worst);
    Ok(())
}

#[test]
fn cuts_agree_leaf_for_leaf() {
    let Some(engine) = device() else { return };
    proptest!(config(10), |(recipe in recipes(surfaces()), seed in any::<u64>())| {
        let loaded = load(&engine, &recipe);
        let pyramid = build(&engine, &loaded, Feature::Derived(DerivedFeature::GradientMagnitude));
        let host = HostPyramid::read(&engine, &pyramid);
        let mut twin = construct::construct(&loaded.field, TwinFeature::Derived(DerivedFeature::GradientMagnitude), loaded.iso);
        host.fill(&mut twin);
        for nth in 0..4 {
            let (params, prefix) = params(seed ^ nth, &host, &recipe);
            let on_device = engine.cut(&loaded.volume, &pyramid, &params, prefix).expect("cut");
            let state = testing::read_cut(&engine, &on_device).expect("read the cut");
            let want = cut::guarded(&twin, &params, prefix, |leaf| {
                let slot = host.slots[leaf];
                (params.topology == Topology::Free || host.nodes[slot].meta >> 25 & 1 == 1)
                    && params.max_error.is_none_or(|e| host.vertex_records[slot].error <= e)
            });
            let got = host.cut(&twin, &state);
            prop_assert_eq!(&got.leaf_of, &want.leaf_of, "{:?}, prefix {:?}", params, prefix);
            prop_assert_eq!(on_device.leaves(), want.counts());
            prop_assert_eq!(on_device.lost_cubes(), want.lost_cubes());
            check_estimate(&host, &state, on_device.estimate())?;
            let fills = params.mesher == Mesher::Dual || twin.nodes[5].values().all(|node| !node.missing);
            if prefix == Level::FINEST && fills {
                for level in (0..6).map(|l| Level::new(l).expect("a level")) {
                    let of_prefix = engine.cut(&loaded.volume, &pyramid, &params, level).expect("cut").leaves();
                    prop_assert_eq!(on_device.prefix_leaves(level), of_prefix.iter().sum::<u64>(), "prefix {:?}", level);
                }
            }
            // What no active cell says: nodes above the leaves, and extra sheets.
            for (slot, leaf) in host.leaves.iter().enumerate() {
                if host.nodes[slot].count > 0 && leaf.level > 0 {
                    let above = (leaf.level..6).any(|level| {
                        let cube = leaf.cube.map(|c| c >> (level - leaf.level));
                        want.leaves.contains_key(&Leaf { level, cube })
                    });
                    prop_assert_eq!(state[slot] != 255, above, "{:?}", leaf);
                }
                if host.is_extra(slot) {
                    prop_assert_eq!(state[slot], state[host.slots[leaf]]);
                }
            }
        }
    });
}
