//! Edits, their errors, and values that depend on the data.

use isopeel_kernels::Histogram;

use super::otsu;
use super::{Edit, FeatureName, PointJson, TransferFunctionJson, View};
use crate::view::quality::{Budget, Fitted, MaxError, TopologyName};

const FIELDS: &[&str] = &["t1", "gm"];

fn edit(json: &str) -> Edit {
    serde_json::from_str(json).expect("a valid edit")
}

fn histogram(range: [f32; 2], bins: &[(usize, u64)]) -> Histogram {
    let mut all = vec![0; 256];
    for &(bin, n) in bins {
        all[bin] = n;
    }
    Histogram { range, bins: all }
}

#[test]
fn an_edit_changes_what_it_names_and_nothing_else() {
    let before = View::opening(FIELDS, None).expect("defaults");
    let after = before.apply(&edit(r#"{"iso":7,"beta":0.5}"#), FIELDS).expect("valid");
    let mut expected = before.to_edit();
    expected.iso = Some(7.0);
    expected.beta = Some(0.5);
    assert_eq!(after.to_edit(), expected);
}

#[test]
fn a_new_feature_brings_its_own_range() {
    let start = View::opening(FIELDS, None).expect("defaults");
    let ranged = start
        .apply(&edit(r#"{"feature":"gm","featureRange":[1,2]}"#), FIELDS)
        .expect("valid");
    assert_eq!(ranged.feature_range, Some([1.0, 2.0]));

    let same = ranged.apply(&edit(r#"{"feature":"gm"}"#), FIELDS).expect("valid");
    assert_eq!(same.feature_range, Some([1.0, 2.0]), "the feature did not change");

    let mut other = ranged
        .apply(&edit(r#"{"feature":"gradient-magnitude"}"#), FIELDS)
        .expect("valid");
    assert_eq!(other.feature_range, None);
    other
        .resolve::<()>(
            || Ok(histogram([0.0, 256.0], &[(10, 5), (200, 5)])),
            || Ok(histogram([0.0, 40.0], &[(0, 1)])),
        )
        .expect("resolves");
    assert_eq!(other.feature_range, Some([0.0, 40.0]));

    let moved = other.apply(&edit(r#"{"field":"gm"}"#), FIELDS).expect("valid");
    assert_eq!(moved.feature_range, None, "another field has another gradient");
}

#[test]
fn a_constant_feature_still_has_a_proper_range() {
    for value in [0.0, -3.5, 1e30] {
        let mut view = View::opening(FIELDS, None).expect("defaults");
        view.resolve::<()>(
            || Ok(histogram([value; 2], &[(0, 8)])),
            || Ok(histogram([value; 2], &[(0, 8)])),
        )
        .expect("resolves");
        let params = view.cut_params([1.0; 3]).expect("resolved");
        params.check().unwrap_or_else(|e| panic!("{value}: {e}"));
    }
}

#[test]
fn the_default_isovalue_parts_two_peaks() {
    let iso = otsu(&histogram([0.0, 256.0], &[(20, 900), (21, 100), (180, 400), (181, 3)]));
    assert!((21.0..=180.0).contains(&iso), "{iso}");
}

#[test]
fn refusals_name_the_field_and_what_was_expected() {
    let view = View::opening(FIELDS, None).expect("defaults");
    for (json, message) in [
        (r#"{"iso":1e39}"#, "iso: inf, expected a finite number"),
        (r#"{"field":"t2"}"#, r#"field: "t2", expected one of "t1", "gm""#),
        (
            r#"{"feature":"x"}"#,
            r#"feature: "x", expected "none", "gradient-magnitude" or a field: "t1", "gm""#,
        ),
        (
            r#"{"featureRange":[2,2]}"#,
            "featureRange: [2, 2], expected two finite numbers, the first below the second",
        ),
        (r#"{"alpha":-0.1}"#, "alpha: -0.1, expected 0 to 1"),
        (r#"{"beta":-1e39}"#, "beta: -inf, expected a finite number"),
        (r#"{"maxLevel":6}"#, "maxLevel: 6, expected 0 to 5"),
        (
            r#"{"transferFunction":{"points":[]}}"#,
            "transferFunction: 0 points, expected 1 to 64",
        ),
        (
            r##"{"transferFunction":{"points":[{"x":0,"importance":2,"color":"#000000"}]}}"##,
            "transferFunction: point 0 is (0, 2), expected x and importance in [0, 1]",
        ),
        (
            r##"{"transferFunction":{"points":[{"x":0,"importance":1,"color":"#00"}]}}"##,
            r##"transferFunction: point 0 has color "#00", expected #rrggbb"##,
        ),
    ] {
        let error = view.apply(&edit(json), FIELDS).expect_err(json);
        assert_eq!(error.to_string(), message);
    }
}

#[test]
fn every_value_in_force_travels_and_comes_back() {
    let mut view = View::opening(FIELDS, None).expect("defaults");
    view.iso = isopeel_kernels::Isovalue::new(3.0).ok();
    view.feature = FeatureName::Field("gm".into());
    view.feature_range = Some([0.0, 9.0]);
    view.transfer_function = TransferFunctionJson {
        points: vec![PointJson {
            x: 0.5,
            importance: 1.0,
            color: "#abcdef".into(),
        }],
    };
    let json = serde_json::to_string(&view.to_edit()).expect("serialises");
    let again = View::opening(FIELDS, None)
        .expect("defaults")
        .apply(&edit(&json), FIELDS);
    assert_eq!(again, Ok(view));
}

#[test]
fn unknown_fields_are_refused() {
    let error = serde_json::from_str::<Edit>(r#"{"isovalue":3}"#).expect_err("unknown field");
    assert!(error.to_string().contains("isovalue"), "{error}");
}

#[test]
fn a_request_that_stands_alone_is_exact_with_beta_and_guarded_with_a_budget() {
    let opening = View::opening(FIELDS, None).expect("defaults");
    let on = (MaxError::Spacings(0.25), TopologyName::Preserve);
    let off = (MaxError::None, TopologyName::Free);
    for (json, expected) in [
        (r#"{"iso":3}"#, on),
        (r#"{"beta":0.02}"#, off),
        (r#"{"beta":0.02,"maxError":"0.25vx"}"#, (on.0, off.1)),
        (r#"{"beta":0.02,"topology":"preserve"}"#, (off.0, on.1)),
        (r#"{"triangles":9}"#, on),
        (r#"{"bytes":9,"maxError":null}"#, (off.0, on.1)),
        (r#"{"maxError":1.5,"topology":"free"}"#, (MaxError::World(1.5), off.1)),
    ] {
        let view = opening.apply(&edit(json).with_default_guards(), FIELDS).expect(json);
        assert_eq!((view.max_error, view.topology), expected, "{json}");
    }
    // In a stream, what is not named stays: on where it was on, off where it was off.
    for (max_error, topology) in [on, off] {
        let before = View {
            max_error,
            topology,
            ..opening.clone()
        };
        for json in [
            r#"{"beta":0.02}"#,
            r#"{"triangles":9}"#,
            r#"{"bytes":9}"#,
            r#"{"iso":3}"#,
        ] {
            let view = before.apply(&edit(json), FIELDS).expect(json);
            assert_eq!((view.max_error, view.topology), (max_error, topology), "{json}");
        }
    }
}

#[test]
fn beta_and_budgets_take_each_others_place() {
    let opening = View::opening(FIELDS, None).expect("defaults");
    let after = |json: &str| opening.apply(&edit(json), FIELDS).expect(json);
    // A budget replaces β, and β a budget; a fitted β is dropped.
    let mut budget = after(r#"{"triangles":9}"#);
    budget.fitted = Some(Fitted {
        beta: 0.5,
        triangles: 9,
    });
    assert_eq!(
        (
            budget.beta_in_force(),
            budget.to_edit().beta,
            budget.to_edit().triangles
        ),
        (0.5, None, Some(9))
    );
    let again = budget.apply(&edit(r#"{"iso":2}"#), FIELDS).expect("valid");
    assert_eq!((again.fitted, again.budget), (None, Some(Budget::Triangles(9))));
    let beta = budget.apply(&edit(r#"{"beta":0.1}"#), FIELDS).expect("valid");
    assert_eq!(
        (beta.budget, beta.to_edit().beta, beta.to_edit().triangles),
        (None, Some(0.1), None)
    );
    // The edit of a view changes nothing in it.
    for view in [opening.clone(), budget, beta, after(r#"{"polish":true,"cap":true}"#)] {
        let stated = serde_json::to_string(&view.to_edit()).expect("JSON");
        let mut same = view.apply(&edit(&stated), FIELDS).expect("valid");
        same.fitted = view.fitted;
        assert_eq!(same, view);
    }
}

#[test]
fn qualities_out_of_range_are_refused_by_name() {
    let view = View::opening(FIELDS, None).expect("defaults");
    for (json, field) in [
        (r#"{"triangles":0}"#, "triangles"),
        (r#"{"bytes":0}"#, "bytes"),
        (r#"{"beta":0.1,"triangles":5}"#, "triangles"),
        (r#"{"beta":0.1,"bytes":5}"#, "bytes"),
        (r#"{"bytes":1,"triangles":5}"#, "triangles"),
        (r#"{"maxError":-1}"#, "maxError"),
        (r#"{"cap":true,"mesher":"marching-cubes"}"#, "cap"),
    ] {
        assert_eq!(view.apply(&edit(json), FIELDS).expect_err(json).field, field, "{json}");
    }
    for json in [
        r#"{"mesher":"cubes"}"#,
        r#"{"topology":"kept"}"#,
        r#"{"maxError":"1px"}"#,
        r#"{"triangles":-1}"#,
    ] {
        assert!(serde_json::from_str::<Edit>(json).is_err(), "{json}");
    }
}
