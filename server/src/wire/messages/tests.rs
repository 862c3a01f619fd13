use isopeel_codec::chunk::ChunkKind;
use isopeel_extraction::{
    Curve, CurvePoint, Distribution, FieldValue, LeafKind, MeasuredError, NearestLeaf, NearestSurface, NoValue, Probe,
    Question,
};
use isopeel_view::quality::MesherName;
use proptest::prelude::*;

use super::{Annotation, Capabilities, ClientMessage, RegionError, ServerMessage, SurfaceEdit};
use crate::service::Preparation;

#[test]
fn messages_parse_as_in_the_protocol_page() {
    let parse = |text: &str| ClientMessage::parse(text).expect(text);
    assert_eq!(
        parse(r#"{"type":"open","volume":"mni152"}"#),
        ClientMessage::Open {
            volume: "mni152".into(),
            step: 0,
            codings: Vec::new(),
        }
    );
    assert_eq!(
        parse(r#"{"type":"open","volume":"ct","step":2,"codings":["later","predictive"]}"#),
        ClientMessage::Open {
            volume: "ct".into(),
            step: 2,
            codings: vec!["later".into(), "predictive".into()],
        }
    );
    assert_eq!(
        parse(r#"{"type":"join","group":"5f","codings":["predictive"]}"#),
        ClientMessage::Join {
            group: "5f".into(),
            name: None,
            codings: vec!["predictive".into()],
        }
    );
    assert_eq!(parse(r#"{"type":"cancel"}"#), ClientMessage::Cancel {});
    assert_eq!(parse(r#"{"type":"step","step":7}"#), ClientMessage::Step { step: 7 });
    assert_eq!(
        parse(r#"{"type":"remove","surface":3}"#),
        ClientMessage::Remove { surface: 3 }
    );
    assert_eq!(
        parse(r#"{"type":"drawn","generation":3}"#),
        ClientMessage::Drawn { generation: 3 }
    );
    assert_eq!(
        parse(r#"{"type":"probe","surface":1,"position":[1,-2.5,3e4]}"#),
        ClientMessage::Probe {
            surface: 1,
            position: [1.0, -2.5, 3e4]
        }
    );
    assert_eq!(
        parse(r#"{"type":"distribution"}"#),
        ClientMessage::Distribution { surface: 0, bins: 64 }
    );
    assert_eq!(
        parse(r#"{"type":"annotate","annotation":"error"}"#),
        ClientMessage::Annotate {
            surface: 0,
            annotation: Annotation::Error
        }
    );
    assert_eq!(parse(r#"{"type":"curve"}"#), ClientMessage::Curve { surface: 0 });
    let nothing = SurfaceEdit::default();
    assert_eq!(parse(r#"{"type":"edit"}"#), ClientMessage::Edit(nothing.clone().into()));
    let third = SurfaceEdit { surface: 2, ..nothing };
    assert_eq!(
        parse(r#"{"type":"edit","surface":2}"#),
        ClientMessage::Edit(third.into())
    );
    let ClientMessage::Edit(of) = parse(
        r##"{"type":"edit","iso":517,"field":"ct-head","feature":"gradient-magnitude","featureRange":[0,400],
 "alpha":0.3,"beta":0.02,"maxLevel":5,
 "transferFunction":{"points":[{"x":0,"importance":0,"color":"#3465a4"},{"x":1,"importance":1,"color":"#f57900"}]}}"##,
    ) else {
        panic!("not an edit");
    };
    let SurfaceEdit { surface, edit } = *of;
    assert_eq!(surface, 0);
    assert_eq!(
        (edit.iso, edit.feature_range, edit.max_level),
        (Some(517.0), Some([0.0, 400.0]), Some(5))
    );
}

#[test]
fn unknown_or_malformed_messages_are_refused() {
    for text in [
        "",
        "x",
        "[]",
        "null",
        "{}",
        r#"{"type":"close"}"#,
        r#"{"type":"open"}"#,
        r#"{"type":"open","volume":"a","step":-1}"#,
        r#"{"type":"open","volume":"a","extra":1}"#,
        r#"{"type":"cancel","extra":1}"#,
        r#"{"type":"remove"}"#,
        r#"{"type":"remove","surface":-1}"#,
        r#"{"type":"remove","surface":1,"generation":1}"#,
        r#"{"type":"drawn"}"#,
        r#"{"type":"edit","isovalue":1}"#,
        r#"{"type":"edit","iso":"1"}"#,
        r#"{"type":"edit","iso":1,"iso":1}"#,
        r#"{"type":"edit","surface":-1}"#,
        r#"{"type":"edit","surface":"0"}"#,
        r#"{"type":"edit","surface":0,"surface":0}"#,
        r#"{"type":"edit","featureRange":[1]}"#,
        r#"{"type":"edit","transferFunction":{"points":[],"extra":1}}"#,
        r#"{"type":"edit"} {"type":"edit"}"#,
        r#"{"type":"probe"}"#,
        r#"{"type":"probe","position":[0,0,0,0]}"#,
        r#"{"type":"probe","position":["0",0,0]}"#,
        r#"{"type":"probe","position":[1e999,0,0]}"#,
        r#"{"type":"distribution","bins":1.5}"#,
        r#"{"type":"curve","extra":1}"#,
        r#"{"type":"annotate"}"#,
        r#"{"type":"annotate","annotation":"colour"}"#,
    ] {
        assert!(ClientMessage::parse(text).is_err(), "{text}");
    }
}

#[test]
fn server_messages_have_the_names_of_the_protocol_page() {
    let expect = |message: ServerMessage, json: &str| assert_eq!(message.to_json(), json);
    let opening = |bytes, device| ServerMessage::Opening {
        bytes,
        total_bytes: 2 * bytes,
        device,
    };
    let preparing = opening(0, Some(Preparation { done: 1, of: 2 }));
    expect(
        preparing,
        r#"{"type":"opening","bytes":0,"totalBytes":0,"device":{"done":1,"of":2}}"#,
    );
    expect(opening(1, None), r#"{"type":"opening","bytes":1,"totalBytes":2}"#);
    let prefix = ServerMessage::Prefix {
        surface: 0,
        generation: 3,
        level: 2,
        kind: ChunkKind::Cut,
        mesher: MesherName::MarchingCubes,
        regions: 7,
        unchanged: 9,
        triangles: 1000,
        color_field: Some("log(t1)".to_owned()),
        is_final: false,
    };
    expect(
        prefix,
        r#"{"type":"prefix","surface":0,"generation":3,"level":2,"kind":"cut","mesher":"marching-cubes","regions":7,"unchanged":9,"triangles":1000,"colorField":"log(t1)","final":false}"#,
    );
    let committed = ServerMessage::Committed {
        surface: 0,
        generation: 3,
        level: 0,
        is_final: true,
    };
    expect(
        committed,
        r#"{"type":"committed","surface":0,"generation":3,"level":0,"final":true}"#,
    );
    let measured = ServerMessage::Measured {
        surface: 0,
        generation: 3,
        error: MeasuredError { rms: 0.25, max: 1.0 },
        regions: vec![RegionError {
            region: [1, 0, 2],
            rms: 0.125,
            max: 0.5,
        }],
    };
    expect(
        measured,
        r#"{"type":"measured","surface":0,"generation":3,"error":{"rms":0.25,"max":1.0},"regions":[{"region":[1,0,2],"rms":0.125,"max":0.5}]}"#,
    );
    let probed = ServerMessage::Probed {
        surface: 0,
        generation: 3,
        probe: Probe {
            position: [1.0, 2.0, 3.5],
            inside: true,
            values: vec![
                FieldValue {
                    field: "t1".into(),
                    value: Some(12.5),
                    why: None,
                },
                FieldValue {
                    field: "gm".into(),
                    value: None,
                    why: Some(NoValue::NotResident),
                },
            ],
            nearest: Some(NearestSurface {
                distance: 0.5,
                smoothness: 0.25,
                feature: 4.0,
                blended: 0.125,
                importance: 0.75,
                leaf: Some(NearestLeaf {
                    kind: LeafKind::Tree,
                    level: 2,
                    error: 0.0625,
                }),
                part: Some(7),
                part_area: Some(12.25),
            }),
        },
    };
    expect(
        probed,
        concat!(
            r#"{"type":"probed","surface":0,"generation":3,"position":[1.0,2.0,3.5],"inside":true,"#,
            r#""values":[{"field":"t1","value":12.5},{"field":"gm","value":null,"why":"not-resident"}],"#,
            r#""nearest":{"distance":0.5,"smoothness":0.25,"feature":4.0,"blended":0.125,"importance":0.75,"#,
            r#""leaf":{"kind":"tree","level":2,"error":0.0625},"part":7,"partArea":12.25}}"#
        ),
    );
    let distribution = ServerMessage::Distribution {
        surface: 0,
        generation: 3,
        distribution: Distribution {
            kind: LeafKind::Cubes,
            bins: vec![3, 1],
            coarse: vec![1, 0],
            coarse_share: 0.25,
        },
    };
    expect(
        distribution,
        r#"{"type":"distribution","surface":0,"generation":3,"kind":"cubes","bins":[3,1],"coarse":[1,0],"coarseShare":0.25}"#,
    );
    let curve = ServerMessage::Curve {
        surface: 0,
        generation: 3,
        curve: Curve {
            kind: LeafKind::Tree,
            by_error: true,
            points: vec![CurvePoint {
                triangles: 100,
                rms: 0.5,
                threshold: 2.0,
            }],
        },
    };
    expect(
        curve,
        r#"{"type":"curve","surface":0,"generation":3,"kind":"tree","byError":true,"points":[{"triangles":100,"rms":0.5,"threshold":2.0}]}"#,
    );
    expect(
        ServerMessage::Removed { surface: 3 },
        r#"{"type":"removed","surface":3}"#,
    );
    let annotated = ServerMessage::Annotated {
        surface: 0,
        generation: 3,
        annotation: Annotation::Error,
        regions: 7,
    };
    expect(
        annotated,
        r#"{"type":"annotated","surface":0,"generation":3,"annotation":"error","regions":7}"#,
    );
    let stepped = ServerMessage::Stepped {
        step: 7,
        label: Some("1850-01-16".into()),
    };
    expect(stepped, r#"{"type":"stepped","step":7,"label":"1850-01-16"}"#);
    let described = ServerMessage::Described {
        volume: serde_json::value::to_raw_value(&1).expect("JSON"),
        step: 7,
    };
    expect(described, r#"{"type":"described","volume":1,"step":7}"#);
    let error = |surface, suggested_triangles| ServerMessage::Error {
        code: "bad-edit",
        message: "alpha: 2, expected 0 to 1".into(),
        open: true,
        surface,
        suggested_triangles,
    };
    expect(
        error(None, None),
        r#"{"type":"error","code":"bad-edit","message":"alpha: 2, expected 0 to 1","open":true}"#,
    );
    expect(
        error(Some(0), Some(20)),
        r#"{"type":"error","code":"bad-edit","message":"alpha: 2, expected 0 to 1","open":true,"surface":0,"suggestedTriangles":20}"#,
    );
    assert_eq!(
        serde_json::to_string(&Capabilities::default()).expect("JSON"),
        r#"{"surfaces":4,"chunkKinds":["cut","error"],"measuredError":true,"steps":true,"watches":false,"groups":true,"questions":["probe","distribution","curve","annotate"]}"#
    );
}

proptest! {
    #[test]
    fn noise_never_panics(text in ".{0,200}") {
        let _ = ClientMessage::parse(&text);
    }

    /// Fields of questions with any JSON in them: what is parsed can be checked, and only what is in range passes.
    #[test]
    fn hostile_questions_never_panic(
        kind in prop_oneof![Just("probe"), Just("distribution"), Just("curve")],
        name in prop_oneof![Just("surface"), Just("position"), Just("bins"), Just("extra")],
        value in prop_oneof![
            any::<f64>().prop_map(|x| x.to_string()),
            any::<u64>().prop_map(|x| x.to_string()),
            any::<[f64; 3]>().prop_map(|p| format!("{p:?}")),
            "[\\[\\]{}\",:0-9eE+.nul-]{0,40}",
        ],
    ) {
        let text = format!(r#"{{"type":"{kind}","{name}":{value}}}"#);
        match ClientMessage::parse(&text) {
            Ok(ClientMessage::Probe { position, .. }) => {
                prop_assert!(position.iter().all(|x| x.is_finite()));
                prop_assert!(Question::Probe(position).check().is_ok());
            }
            Ok(ClientMessage::Distribution { bins, .. }) => {
                prop_assert_eq!(Question::Distribution(bins).check().is_ok(), (1..=256).contains(&bins));
            }
            _ => {}
        }
    }
}
