//! Errors and budgets are kept on the command line, in REST and on the stream.

use serde_json::{Value, json};

use crate::support::viewer::{Frame, Viewer};
use crate::support::{ball, command, demo, demo_file, files, http, mesh, server};

/// The demo's surface as a command line has it by default.
fn plain(decides: &Value) -> Value {
    let identity =
        json!([{"x": 0, "importance": 0, "color": "#000000"}, {"x": 1, "importance": 1, "color": "#ffffff"}]);
    let mut edit = json!({"iso": demo::ISO, "field": "t1", "feature": "none", "alpha": 0, "maxError": "auto", "topology": "auto",
        "maxLevel": 5, "transferFunction": {"points": identity}});
    for (name, value) in decides.as_object().expect("an object") {
        edit[name] = value.clone();
    }
    edit
}

fn count(statistics: &Value, name: &str) -> u64 {
    statistics[name]
        .as_u64()
        .unwrap_or_else(|| panic!("{name} in {statistics}"))
}

/// Asserts that the triangles are within the budget and nearly use it.
#[track_caller]
fn assert_kept(triangles: u64, budget: u64) {
    assert!(
        triangles <= budget && triangles * 100 >= budget * 95,
        "{triangles} triangles, {budget} allowed"
    );
}

/// Shares, in percent.
const SHARES: [u64; 3] = [1, 10, 50];

fn budget_of(percent: u64) -> u64 {
    demo::FULL_TRIANGLES * percent / 100
}

#[test]
fn the_command_keeps_and_fills_budgets() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = folder.path().join("brain.stl");
    for percent in SHARES {
        let budget = budget_of(percent);
        let of = |triangles: &str| {
            let options = format!("--iso 100 --no-measure --triangles {triangles}");
            command::extract_to(&demo_file(), &options, &out)
        };
        let share = of(&format!("{percent}%"));
        assert_kept(count(&share, "triangles"), budget);
        let file = files::read("stl", &std::fs::read(&out).expect("written"));
        assert_eq!(count(&share, "triangles"), file.triangles.len() as u64);
        if percent != SHARES[1] {
            continue;
        }
        let number = of(&budget.to_string());
        for name in ["triangles", "vertices", "leaves", "tolerance", "gaveWay"] {
            assert_eq!(share[name], number[name], "{name} of a share and of a number");
        }
    }
}

#[test]
fn rest_keeps_and_fills_budgets_and_makes_what_the_command_makes() {
    let Some(address) = server::shared() else { return };
    let post = |decides: Value| {
        let mut body = plain(&decides);
        (body["volume"], body["format"]) = (json!(demo::ID), json!("stl"));
        // As on the command line, guards that are not named are `auto`.
        let fields = body.as_object_mut().expect("an object");
        fields.retain(|name, _| name != "maxError" && name != "topology");
        let answer = http::post_json(address, "/api/v1/extract", &body);
        assert_eq!(answer.status, 200, "{}", String::from_utf8_lossy(&answer.body));
        files::read("stl", &answer.body).triangles.len() as u64
    };
    for percent in SHARES {
        let budget = budget_of(percent);
        let triangles = post(json!({ "triangles": budget }));
        assert_kept(triangles, budget);
        if percent != SHARES[1] {
            continue;
        }
        let share = json!({"share": percent as f64 / 100.0});
        assert_eq!(post(json!({ "triangles": share })), triangles);
        let capped = json!({"share": 1, "max": budget});
        assert_eq!(post(json!({ "triangles": capped })), triangles);
    }
    let by_command = command::extract(
        ["--iso", "100", "--error", "0.1vx"]
            .iter()
            .map(Into::into)
            .chain([demo_file().into_os_string()]),
    );
    assert_eq!(post(json!({"error": "0.1vx"})), count(&by_command, "triangles"));
}

#[tokio::test]
async fn every_final_surface_of_the_stream_keeps_its_budget() {
    let Some(address) = server::shared() else { return };
    // A fresh isovalue: no tree of it is built yet.
    let iso = demo::ISO + 3.0;
    let mut viewer = Viewer::open(address, demo::ID).await;
    for percent in SHARES {
        let mut edit = plain(&json!({"triangles": {"share": percent as f64 / 100.0}}));
        edit["iso"] = json!(iso);
        let done = viewer.edit_and_rest(edit).await;
        for statistics in &done {
            let budget = count(statistics, "fullTriangles") * percent / 100;
            assert_kept(count(statistics, "triangles"), budget);
        }
    }
}

/// The greater tolerance of an error and a budget decides.
#[test]
fn an_error_beside_a_budget() {
    if !server::has_device() {
        return;
    }
    let extract = |options: &str| {
        let options = format!("--iso 100 --no-measure {options}");
        let words = options.split_whitespace().map(Into::into);
        command::extract([demo_file().into_os_string()].into_iter().chain(words))
    };
    let [error, loose, tight, budget] = [
        "--error 0.5vx",
        "--error 0.5vx --triangles 50%",
        "--error 0.1vx --triangles 10%",
        "--triangles 10%",
    ]
    .map(extract);
    for (both, alone) in [(&loose, &error), (&tight, &budget)] {
        for name in ["triangles", "tolerance"] {
            assert_eq!(both[name], alone[name], "{name}");
        }
    }
    assert_eq!(error["tolerance"], 0.5);
    assert!(error["beta"].is_null() && error["gaveWay"] == json!([]), "{error}");
    assert_eq!(tight["gaveWay"], json!(["max-error"]));
}

#[test]
fn the_command_says_which_guards_gave_way() {
    if !server::has_device() {
        return;
    }
    let said = |options: &str| {
        let line = format!("--iso 100 --stats --no-measure {options}");
        let file = demo_file();
        let words = line.split_whitespace().map(std::ffi::OsStr::new);
        let output = command::run(
            [std::ffi::OsStr::new("extract"), file.as_os_str()]
                .into_iter()
                .chain(words),
        );
        let text = String::from_utf8(output.stderr).expect("UTF-8");
        (serde_json::from_slice(&output.stdout).unwrap_or(Value::Null), text)
    };
    let (_, text) = said("--topology preserve --triangles 8");
    let numbers = text.split(|c: char| !c.is_ascii_digit());
    let minimum: u64 = numbers
        .filter_map(|number| number.parse().ok())
        .max()
        .expect("a minimum");
    // With all parts one triangle too many.
    let (statistics, text) = said(&format!("--triangles {}", minimum - 1));
    assert_eq!(statistics["gaveWay"], json!(["max-error", "topology"]), "{text}");
    assert!(
        count(&statistics, "triangles") < minimum && count(&statistics, "vanishedParts") > 0,
        "{statistics}"
    );
    assert!(
        text.contains("error gave way") && text.contains("topology gave way") && text.contains("vanished"),
        "{text}"
    );
    let (statistics, text) = said("--triangles 50%");
    assert_eq!(
        (&statistics["gaveWay"], &statistics["vanishedParts"], text.as_str()),
        (&json!([]), &json!(0), "")
    );
}

/// On a CPU a cut of cubes is shown first.
#[tokio::test]
async fn a_viewer_that_rests_gets_a_tree_cut_and_edits_after_it_are_tree_cuts_at_once() {
    let Some(address) = server::shared() else { return };
    let is_cpu = isopeel_kernels::device::list().expect("a device")[0].kind == isopeel_kernels::DeviceKind::Cpu;
    let mut viewer = Viewer::open(address, demo::ID).await;
    let mut edit = plain(&json!({"triangles": {"share": 0.1}}));
    edit["iso"] = json!(demo::ISO + 5.0);
    let done = viewer.edit_and_rest(edit).await;
    let is_tree_cut: Vec<bool> = done.iter().map(|statistics| statistics["isTreeCut"] == true).collect();
    assert_eq!(is_tree_cut, if is_cpu { vec![false, true] } else { vec![true] });
    let last = &done[done.len() - 1];
    assert_eq!((&last["topology"], &last["beta"]), (&json!("preserve"), &Value::Null));
    assert!(last["stagesMs"]["tree"].is_number(), "it builds the tree: {last}");
    // One generation; only the final surface is sent once more.
    let finals = viewer.log.iter().filter_map(|frame| match frame {
        Frame::Prefix(prefix) if prefix.is_final => Some(prefix.generation),
        _ => None,
    });
    assert_eq!(finals.collect::<Vec<_>>(), vec![1; done.len()]);

    for edit in [
        json!({"triangles": {"share": 0.3}}),
        json!({"error": "0.2vx"}),
        json!({"alpha": 0.5, "feature": "none"}),
    ] {
        let statistics = viewer.edit(edit).await;
        assert_eq!(statistics["isTreeCut"], true, "{statistics}");
        assert!(
            statistics["stagesMs"]["tree"].is_null(),
            "the tree is there: {statistics}"
        );
    }
    // β is the paper's cut again.
    let statistics = viewer.edit(json!({"beta": 0.02})).await;
    assert_eq!(
        (&statistics["isTreeCut"], &statistics["tolerance"]),
        (&json!(false), &Value::Null)
    );
    assert_eq!(
        (&statistics["maxError"], &statistics["topology"]),
        (&json!(0.25), &json!("preserve"))
    );
}

#[tokio::test]
async fn cancel_ends_the_rest() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    let mut edit = plain(&json!({"triangles": {"share": 0.1}}));
    edit["iso"] = json!(demo::ISO + 7.0);
    viewer.edit(edit).await;
    viewer.send(json!({"type": "cancel"})).await;
    let silent = tokio::time::timeout(std::time::Duration::from_secs(1), viewer.next()).await;
    assert!(silent.is_err(), "nothing follows, found {silent:?}");
}

/// A budget below the minimum fails with the minimum, which then works, and is the minimum.
#[tokio::test]
async fn guards_that_were_set_name_the_minimum_budget() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    // The tree is built, so that the minimum budget is that of its cuts.
    viewer.edit_and_rest(plain(&json!({"triangles": {"share": 0.5}}))).await;
    for guard in [json!({"topology": "preserve"}), json!({"maxError": "0.25vx"})] {
        let mut edit = plain(&json!({"triangles": 20}));
        for (name, value) in guard.as_object().expect("an object") {
            edit[name] = value.clone();
        }
        let (code, minimum) = viewer.refused(edit.clone()).await;
        assert_eq!(code, "over-budget", "{guard}");
        let minimum = minimum.expect("a budget");
        edit["triangles"] = json!(minimum);
        let statistics = viewer.edit(edit.clone()).await;
        assert!(count(&statistics, "triangles") <= minimum, "{statistics}");
        // The other guard is `auto`.
        let gave_way = statistics["gaveWay"].as_array().expect("a list");
        let other = if guard["maxError"].is_null() {
            "max-error"
        } else {
            "topology"
        };
        assert!(gave_way.iter().all(|name| name == other), "{guard}: {statistics}");
        // Merges remove several triangles at once: a few below the minimum there may be none.
        edit["triangles"] = json!(minimum * 9 / 10);
        assert_eq!(
            viewer.refused(edit).await,
            ("over-budget".to_owned(), Some(minimum)),
            "{guard}"
        );
    }
}

#[test]
fn rest_and_the_command_name_the_minimum_budget() {
    let Some(address) = server::shared() else { return };
    let mut body = plain(&json!({"triangles": 20, "topology": "preserve"}));
    (body["volume"], body["format"]) = (json!(demo::ID), json!("stl"));
    let answer = http::post_json(address, "/api/v1/extract", &body);
    assert_eq!(answer.problem(422), "over-budget");
    let minimum = answer.json()["suggestedTriangles"].as_u64().expect("a budget");
    body["triangles"] = json!(minimum);
    let answer = http::post_json(address, "/api/v1/extract", &body);
    let triangles = files::read("stl", &answer.body).triangles.len() as u64;
    assert!(
        answer.status == 200 && triangles <= minimum,
        "{triangles} of {minimum} triangles"
    );

    let file = demo_file();
    let line = "--iso 100 --stats --topology preserve --triangles 20";
    let words = line.split_whitespace().map(std::ffi::OsStr::new);
    let said = command::fail(
        [std::ffi::OsStr::new("extract"), file.as_os_str()]
            .into_iter()
            .chain(words),
    );
    assert!(said.contains(&minimum.to_string()), "{minimum} in {said}");
}

/// A closed surface stays one, with the Euler characteristic of the full surface.
#[tokio::test]
async fn a_tree_cut_is_watertight_and_keeps_the_topology() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("ball.npy");
    ball::write(&file);
    let Some(own) = server::start_with_volumes(&[file]) else {
        return;
    };
    let mut viewer = Viewer::open(own.address, "ball").await;
    // V - E + F; each triangle has three halves of edges.
    let characteristic = |statistics: &Value| {
        let [vertices, triangles] = ["vertices", "triangles"].map(|name| count(statistics, name) as i64);
        assert_eq!(triangles % 2, 0, "a closed surface");
        vertices - triangles / 2
    };
    let full = viewer
        .edit(json!({"iso": 0, "beta": -1, "maxError": "auto", "topology": "auto"}))
        .await;
    for decides in [
        json!({"triangles": {"share": 0.5}}),
        json!({"triangles": {"share": 0.1}}),
        json!({"triangles": {"share": 0.02}}),
        json!({"error": "1vx"}),
    ] {
        let done = viewer.edit_and_rest(decides.clone()).await;
        let last = &done[done.len() - 1];
        assert_eq!(last["isTreeCut"], true, "{decides}: {last}");
        assert_eq!(characteristic(last), characteristic(&full), "{decides}");
        assert_eq!(
            mesh::open_edges(viewer.shown.values(), ball::DIMS).len(),
            0,
            "{decides}: edges that do not close"
        );
        assert!(mesh::area_turned_right(viewer.shown.values()) > 0.97, "{decides}");
    }
}

/// Whether a guard allows a budget does not depend on earlier extractions.
#[tokio::test]
async fn a_set_guard_allows_on_a_fresh_surface_what_it_allows_later() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    let mut edit = plain(&json!({"triangles": {"share": 0.05}, "topology": "preserve"}));
    edit["iso"] = json!(demo::ISO + 9.0);
    let statistics = viewer.edit(edit).await;
    let budget = count(&statistics, "fullTriangles") / 20;
    assert!(count(&statistics, "triangles") <= budget, "{statistics}");
    assert_eq!(statistics["topology"], "preserve");
}

#[tokio::test]
async fn a_tree_cut_is_measured() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    let done = viewer.edit_and_rest(plain(&json!({"triangles": {"share": 0.1}}))).await;
    assert_eq!(done[done.len() - 1]["isTreeCut"], true);
    let Some(Frame::Measured { error, regions, .. }) = viewer.log.last() else {
        panic!("{:?}", viewer.log.last())
    };
    assert!(
        error[0] > 0.0 && !regions.is_empty(),
        "{error:?} in {} regions",
        regions.len()
    );
}
