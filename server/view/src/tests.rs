//! Edits, their errors, and values that depend on the data.

use isopeel_geometry::DAffine3;
use isopeel_kernels::{Histogram, Topology};

use super::{ChosenPartsJson, Edit, FeatureName, OpeningIso, PointJson, TransferFunctionJson, View};
use crate::quality::{Distance, ErrorLimit, Fitted, GuardName, MaxError, TopologyName, TriangleBudget};

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
    (expected.beta, expected.error, expected.triangles) = (Some(0.5), None, None);
    assert_eq!(after.to_edit(), expected);
}

#[test]
fn the_field_of_the_colours_is_a_field_an_expression_or_none() {
    let start = View::opening(FIELDS, None).expect("defaults");
    assert_eq!(start.color_field, None);
    let colored = start.apply(&edit(r#"{"colorField":"gm"}"#), FIELDS).expect("valid");
    assert_eq!(colored.color_field.as_deref(), Some("gm"));
    let computed = colored.apply(&edit(r#"{"colorField":"log(t1) + gm"}"#), FIELDS);
    assert_eq!(computed.expect("valid").color_field.as_deref(), Some("log(t1) + gm"));
    let same = colored.apply(&edit(r#"{"alpha":0.25}"#), FIELDS).expect("valid");
    assert_eq!(same.color_field, colored.color_field);
    assert_eq!(
        same.feature_range, start.feature_range,
        "it has nothing to do with the feature"
    );
    let json = serde_json::to_value(same.to_edit()).expect("JSON");
    assert_eq!(json["colorField"], "gm");
    let none = same.apply(&edit(r#"{"colorField":null}"#), FIELDS).expect("valid");
    assert_eq!(none.color_field, None);
    let why = |json| start.apply(&edit(json), FIELDS).expect_err("refused").to_string();
    assert!(why(r#"{"colorField":"wm"}"#).contains(r#"colorField: "wm", expected one of "t1""#));
    assert!(why(r#"{"colorField":"log(wm)"}"#).starts_with("colorField: "));
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
            || {
                Ok(OpeningIso::of(
                    &histogram([0.0, 256.0], &[(10, 5), (200, 5)]),
                    None,
                    false,
                ))
            },
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
            || Ok(OpeningIso::of(&histogram([value; 2], &[(0, 8)]), None, false)),
            || Ok(histogram([value; 2], &[(0, 8)])),
        )
        .expect("resolves");
        let params = view.cut_params(1.0, &DAffine3::IDENTITY.into()).expect("resolved");
        params.check().unwrap_or_else(|e| panic!("{value}: {e}"));
    }
}

#[test]
fn refusals_name_the_field_and_what_was_expected() {
    let view = View::opening(FIELDS, None).expect("defaults");
    for (json, message) in [
        (r#"{"iso":1e39}"#, "iso: inf, expected a finite number"),
        (r#"{"field":"t2"}"#, r#"field: "t2", expected one of "t1", "gm""#),
        (
            r#"{"feature":"x"}"#,
            concat!(
                r#"feature: "x", expected "none", "gradient-magnitude", "mean-curvature", "gaussian-curvature", "local-variance", "#,
                r#""vector-magnitude(X,Y,Z)", "divergence(X,Y,Z)", "vorticity-magnitude(X,Y,Z)", "q-criterion(X,Y,Z)", "lambda2(X,Y,Z)", "helicity(X,Y,Z)" or a field: "#,
                r#""t1", "gm""#
            ),
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
            r#"{"minPart":-0.5}"#,
            "minPart: -0.5, expected an area in world units, 0 or more",
        ),
        (
            r#"{"minPart":5,"beta":0.1}"#,
            "minPart: 5 with beta alone, expected error, triangles or bytes too",
        ),
        (
            r#"{"minPart":5,"mesher":"marching-cubes"}"#,
            "minPart: 5 with marching-cubes, expected the dual mesher",
        ),
        (
            r#"{"parts":{"hide":[]}}"#,
            "parts: hide has 0 positions, expected 1 to 64, or null instead of parts: all are shown",
        ),
        (
            r#"{"parts":{"keep":[[1,2,3]]},"beta":0.1}"#,
            "parts: given with beta alone, expected error, triangles or bytes too",
        ),
        (
            r#"{"parts":{"keep":[[1,2,3]]},"mesher":"marching-cubes"}"#,
            "parts: given with marching-cubes, expected the dual mesher",
        ),
        (
            r#"{"interest":[{"importance":0.5}]}"#,
            "interest: region 0 has neither a sphere nor a box, expected one of both",
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
fn small_parts_are_removed_until_an_edit_says_otherwise() {
    let view = View::opening(FIELDS, None).expect("defaults");
    let after = |edits: &[&str]| {
        let applied = edits
            .iter()
            .try_fold(view.clone(), |view, json| view.apply(&edit(json), FIELDS));
        applied.map(|view| view.min_part)
    };
    let parts = r#"{"minPart":5}"#;
    for (edits, expected) in [
        (&[][..], 0.0),
        (&[parts], 5.0),
        (&[parts, r#"{"alpha":1,"triangles":100}"#], 5.0),
        (&[parts, r#"{"minPart":null}"#], 0.0),
        (&[parts, r#"{"minPart":0}"#], 0.0),
        // What is not a cut of the vertex tree has all parts; and so it stays until they are named again.
        (&[parts, r#"{"beta":0.1}"#, r#"{"error":1}"#], 0.0),
        (&[parts, r#"{"mesher":"marching-cubes"}"#], 0.0),
        (&[r#"{"beta":0.1,"minPart":0}"#], 0.0),
        (&[r#"{"beta":0.1,"minPart":null}"#], 0.0),
    ] {
        assert_eq!(after(edits), Ok(expected), "{edits:?}");
    }
}

#[test]
fn chosen_parts_stay_until_an_edit_says_otherwise() {
    let hide = r#"{"parts":{"hide":[[1,2,3]]}}"#;
    let keep = r#"{"parts":{"keep":[[4,5,6],[7,8,9]]}}"#;
    let hidden = Some(ChosenPartsJson::Hide(vec![[1.0, 2.0, 3.0]]));
    let kept = Some(ChosenPartsJson::Keep(vec![[4.0, 5.0, 6.0], [7.0, 8.0, 9.0]]));
    for (edits, expected) in [
        (&[][..], None),
        (&[hide], hidden.clone()),
        (&[hide, keep], kept),
        (&[hide, r#"{"alpha":1,"triangles":100,"minPart":3}"#], hidden),
        (&[hide, r#"{"parts":null}"#], None),
        (&[hide, r#"{"beta":0.1}"#, r#"{"error":1}"#], None),
        (&[hide, r#"{"mesher":"marching-cubes"}"#], None),
        (&[r#"{"beta":0.1,"parts":null}"#], None),
    ] {
        let start = View::opening(FIELDS, None).expect("defaults");
        let view = edits
            .iter()
            .try_fold(start, |view, json| view.apply(&edit(json), FIELDS));
        let view = view.expect("valid");
        assert_eq!(view.removes_parts(), expected.is_some(), "{edits:?}");
        assert_eq!(view.parts, expected, "{edits:?}");
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
    view.min_part = 12.5;
    view.parts = Some(ChosenPartsJson::Keep(vec![[1.5, -2.0, 3.0]]));
    view.interest = vec!["sphere:-1,2,3:4.5=0.75".parse().expect("a sphere")];
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
fn guards_of_a_request_that_stands_alone_are_off_with_beta_and_auto_with_a_budget() {
    let opening = View::opening(FIELDS, None).expect("defaults");
    let on = (MaxError::Auto, TopologyName::Auto);
    let off = (MaxError::None, TopologyName::Free);
    for (json, expected) in [
        (r#"{"iso":3}"#, on),
        (r#"{"beta":0.02}"#, off),
        (
            r#"{"beta":0.02,"maxError":"0.25vx"}"#,
            (MaxError::At(MaxError::AUTO), off.1),
        ),
        (
            r#"{"beta":0.02,"topology":"preserve"}"#,
            (off.0, TopologyName::Preserve),
        ),
        (r#"{"triangles":9}"#, on),
        (r#"{"bytes":9,"maxError":null}"#, (off.0, on.1)),
        (
            r#"{"maxError":1.5,"topology":"free"}"#,
            (MaxError::At(Distance::World(1.5)), off.1),
        ),
    ] {
        let view = opening.apply(&edit(json).with_default_guards(), FIELDS).expect(json);
        assert_eq!((view.max_error, view.topology), expected, "{json}");
    }
    // In a stream, guards that an edit does not name stay on or off as they were.
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
fn what_decides_takes_the_place_of_what_decided() {
    let opening = View::opening(FIELDS, None).expect("defaults");
    let after = |view: &View, json: &str| view.apply(&edit(json), FIELDS).expect(json);
    let of = |view: &View| {
        let edit = view.to_edit();
        (edit.beta, edit.error, edit.triangles, edit.bytes)
    };
    let nine = Some(TriangleBudget::AtMost(9));
    let half = Some(ErrorLimit::Distance(Distance::Spacings(0.5)));
    let beta = after(&opening, r#"{"beta":0.1}"#);
    assert_eq!(of(&beta), (Some(0.1), None, None, None));
    let budget = after(&beta, r#"{"triangles":9}"#);
    assert_eq!(of(&budget), (None, None, nine, None));
    let error = after(&budget, r#"{"error":"0.5vx"}"#);
    assert_eq!(of(&error), (None, half, None, None));
    let both = after(&error, r#"{"error":"0.5vx","triangles":9}"#);
    assert_eq!(of(&both), (None, half, nine, None));
    assert_eq!(of(&after(&both, r#"{"bytes":7}"#)), (None, None, None, Some(7)));
    assert_eq!(of(&after(&both, r#"{"iso":2}"#)), of(&both));
    assert_eq!(of(&after(&both, r#"{"beta":0.1}"#)), of(&beta));
    // The edit of a view changes nothing in it.
    for view in [
        opening.clone(),
        budget,
        beta,
        error,
        both,
        after(&opening, r#"{"cap":true}"#),
    ] {
        let stated = serde_json::to_string(&view.to_edit()).expect("JSON");
        assert_eq!(after(&view, &stated), view);
    }
}

#[test]
fn the_greater_of_error_and_budget_is_in_force() {
    let opening = View::opening(FIELDS, None).expect("defaults");
    let fitted = |json: &str, threshold| View {
        fitted: Some(Fitted {
            threshold,
            topology: Topology::Preserve,
            triangles: 9,
            is_tree_cut: true,
            pixels: None,
        }),
        ..opening.apply(&edit(json), FIELDS).expect(json)
    };
    let tolerance = |view: &View| view.tolerance_in_force(1.0);
    let both = r#"{"error":"0.5vx","triangles":9}"#;
    assert_eq!(tolerance(&fitted(both, 0.25)), Some(0.5));
    assert_eq!(tolerance(&fitted(both, 4.0)), Some(4.0));
    assert_eq!(tolerance(&fitted(r#"{"triangles":9}"#, -1.0)), Some(-1.0));
    assert_eq!(fitted(both, 4.0).beta_in_force(), None);
    let beta = opening.apply(&edit(r#"{"beta":0.1}"#), FIELDS).expect("valid");
    assert_eq!((tolerance(&beta), beta.beta_in_force()), (None, Some(0.1)));
    let guarded = fitted(r#"{"error":"0.5vx","triangles":9,"maxError":"0.25vx"}"#, 0.25);
    assert_eq!(tolerance(&guarded), Some(0.25));
    // An edit forgets what was fitted.
    let again = fitted(both, 4.0).apply(&edit(r#"{"iso":2}"#), FIELDS).expect("valid");
    assert_eq!(again.fitted, None);
}

#[test]
fn guards_that_are_auto_give_way_to_a_budget_error_first() {
    let opening = View::opening(FIELDS, None).expect("defaults");
    let gave_way = |json: &str, threshold, topology| {
        let view = View {
            fitted: Some(Fitted {
                threshold,
                topology,
                triangles: 9,
                is_tree_cut: topology == Topology::Preserve,
                pixels: None,
            }),
            ..opening.apply(&edit(json), FIELDS).expect(json)
        };
        view.gave_way(1.0)
    };
    let auto = r#"{"triangles":9}"#;
    assert_eq!(gave_way(auto, 0.2, Topology::Preserve), []);
    assert_eq!(gave_way(auto, 0.3, Topology::Preserve), [GuardName::MaxError]);
    assert_eq!(
        gave_way(auto, 0.3, Topology::Free),
        [GuardName::MaxError, GuardName::Topology]
    );
    let off = r#"{"triangles":9,"maxError":"none","topology":"free"}"#;
    assert_eq!(gave_way(off, 0.3, Topology::Free), []);
    let error = r#"{"triangles":9,"error":"1vx"}"#;
    assert_eq!(gave_way(error, 1.0, Topology::Preserve), []);
    assert_eq!(gave_way(error, 1.5, Topology::Preserve), [GuardName::MaxError]);
}

#[test]
fn qualities_out_of_range_are_refused_by_name() {
    let view = View::opening(FIELDS, None).expect("defaults");
    for (json, field) in [
        (r#"{"triangles":0}"#, "triangles"),
        (r#"{"bytes":0}"#, "bytes"),
        (r#"{"beta":0.1,"triangles":5}"#, "triangles"),
        (r#"{"beta":0.1,"bytes":5}"#, "bytes"),
        (r#"{"beta":0.1,"error":5}"#, "error"),
        (r#"{"bytes":1,"triangles":5}"#, "triangles"),
        (r#"{"triangles":{"share":0}}"#, "triangles"),
        (r#"{"triangles":{"share":1.5}}"#, "triangles"),
        (r#"{"triangles":{"share":0.5,"max":0}}"#, "triangles"),
        (r#"{"error":-1}"#, "error"),
        (r#"{"error":1,"mesher":"marching-cubes"}"#, "error"),
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
        r#"{"error":"auto"}"#,
    ] {
        assert!(serde_json::from_str::<Edit>(json).is_err(), "{json}");
    }
}

#[test]
fn the_papers_mesher_drops_an_error_that_the_edit_does_not_name() {
    let opening = View::opening(FIELDS, None).expect("defaults");
    let paper = opening
        .apply(&edit(r#"{"mesher":"marching-cubes"}"#), FIELDS)
        .expect("valid");
    assert_eq!(
        (paper.error, paper.budget, paper.is_by_error()),
        (None, opening.budget, false)
    );
}
