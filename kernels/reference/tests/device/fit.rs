//! How many leaves a cut has as a function of β, against the cuts themselves; and budgets.

use super::recipes::{recipes, surfaces};
use super::*;
use isopeel_kernels::BUDGET_FIT;

#[test]
fn the_curve_has_the_leaves_of_each_cut() {
    let Some(engine) = device() else { return };
    proptest!(config(6), |(recipe in recipes(surfaces()), seed in any::<u64>())| {
        let loaded = load(&engine, &recipe);
        let pyramid = build(&engine, &loaded, Feature::Derived(DerivedFeature::GradientMagnitude));
        let host = HostPyramid::read(&engine, &pyramid);
        let (params, _) = cut::params(seed, &host, &recipe);
        let curve = testing::curve(&engine, &loaded.volume, &pyramid, &params).expect("the curve");
        for (beta, leaves) in curve.iter().step_by(251).chain(&curve[curve.len() - 1..]) {
            let params = CutParams { beta: *beta, ..params.clone() };
            let cut = engine.cut(&loaded.volume, &pyramid, &params, Level::FINEST).expect("cut");
            prop_assert_eq!(cut.leaves().iter().sum::<u64>() as i64, *leaves, "beta {}", beta);
        }
    });
}

#[test]
fn budgets_are_kept_and_used() {
    let Some(engine) = device() else { return };
    proptest!(config(24), |(recipe in recipes(surfaces()), share in 0.02..1.2f64, preserve in any::<bool>())| {
        let loaded = load(&engine, &recipe);
        let pyramid = build(&engine, &loaded, Feature::None);
        let topology = if preserve { Topology::Preserve } else { Topology::Free };
        let params = CutParams { topology, ..dual_params() };
        let triangles = |beta: f32| {
            let params = CutParams { beta, ..params.clone() };
            let cut = engine.cut(&loaded.volume, &pyramid, &params, Level::FINEST).expect("cut");
            engine.count(&loaded.volume, &pyramid, &cut, &Never).expect("count").triangles
        };
        let (full, coarsest) = (triangles(-1.0), triangles(1.0));
        let budget = ((full as f64 * share) as u64).max(1);
        let (fitted, cut, counted) = engine.fit(&loaded.volume, &pyramid, &params, budget, &Never).expect("fit");
        let may_fit = engine.may_fit(&loaded.volume, &pyramid, &params, budget).expect("the curve");
        prop_assert!(may_fit || coarsest > budget, "{} triangles, expected to be refused", coarsest);
        let found = engine.count(&loaded.volume, &pyramid, &cut, &Never).expect("count").triangles;
        prop_assert_eq!(found, counted);
        prop_assert_eq!(found, triangles(fitted.beta), "the cut is that of the parameters");
        if full <= budget {
            prop_assert_eq!(found, full);
        } else if coarsest > budget {
            prop_assert_eq!(found, coarsest);
        } else {
            prop_assert!(found <= budget, "{} triangles, expected at most {}", found, budget);
            // If that is not enough, no beta in between has more triangles within the budget than a few steps allow.
            if (found as f64) < BUDGET_FIT * budget as f64 {
                let finer = f32::from_bits((fitted.beta.to_bits().max(1 << 17) as f64 - f64::from(1 << 17)) as u32);
                let next = triangles(finer);
                prop_assert!(next > budget || next <= found || next as f64 >= 0.9 * budget as f64,
                    "{} triangles at {}, {} at {}, of {}", found, fitted.beta, next, finer, budget);
            }
        }
    });
}
