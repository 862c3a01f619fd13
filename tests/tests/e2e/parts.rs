//! Small parts of a surface, and those that positions choose, are removed first. The number of removed parts is reported, and the
//! remaining surface keeps its topology and the budget.

use std::collections::HashMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use crate::support::files::FileMesh;
use crate::support::viewer::Viewer;
use crate::support::{ball, command, files, http, mesh, server};

const DIMS: [u32; 3] = [90, 70, 66];

/// Middle and radius: two large ones, each in several regions, and five small ones, some on the faces between regions.
const BALLS: [([f32; 3], f32); 7] = [
    ([34.0, 30.0, 33.0], 20.0),
    ([70.0, 50.0, 40.0], 11.0),
    ([64.0, 32.0, 32.0], 3.0),
    ([80.0, 10.0, 10.0], 2.2),
    ([70.0, 8.0, 50.0], 2.6),
    ([8.0, 60.0, 8.0], 3.1),
    ([32.0, 64.0, 60.0], 1.6),
];
/// The large ones have areas of 1500 or more, the small ones of 120 or less.
const MIN_PART: f64 = 400.0;
const SMALL: u64 = 5;

fn write(folder: &Path) -> PathBuf {
    let path = folder.join("balls.npy");
    ball::write_field(&path, DIMS, |at| {
        let inside = |(middle, radius): &([f32; 3], f32)| {
            let distance2: f32 = (0..3).map(|axis| (at[axis] - middle[axis]).powi(2)).sum();
            radius - distance2.sqrt()
        };
        BALLS.iter().map(inside).fold(f32::NEG_INFINITY, f32::max)
    });
    path
}

fn count(statistics: &Value, name: &str) -> u64 {
    statistics[name]
        .as_u64()
        .unwrap_or_else(|| panic!("{name} in {statistics}"))
}

/// V - E + F of a closed surface; each triangle has three halves of edges.
fn characteristic(statistics: &Value) -> i64 {
    let [vertices, triangles] = ["vertices", "triangles"].map(|name| count(statistics, name) as i64);
    vertices - triangles / 2
}

/// Statistics and mesh of an extraction.
fn extract(volume: &Path, options: &str) -> (Value, FileMesh) {
    let out = volume.with_extension("stl");
    let statistics = command::extract_to(volume, &format!("--iso 0 --allow-empty {options}"), &out);
    (statistics, files::read("stl", &std::fs::read(&out).expect("written")))
}

/// The triangles of each part of a mesh, by the bits of their corners' positions; triangles and parts in order.
fn parts(mesh: &FileMesh) -> Vec<Vec<[[u64; 3]; 3]>> {
    let mut above: HashMap<[u64; 3], [u64; 3]> = HashMap::new();
    fn root(above: &mut HashMap<[u64; 3], [u64; 3]>, at: [u64; 3]) -> [u64; 3] {
        let mut at = at;
        loop {
            let next = *above.entry(at).or_insert(at);
            if next == at {
                return at;
            }
            at = next;
        }
    }
    let corners = |triangle: &[u32; 3]| triangle.map(|corner| mesh.positions[corner as usize].map(f64::to_bits));
    for triangle in &mesh.triangles {
        let [a, b, c] = corners(triangle);
        for (a, b) in [(a, b), (b, c)] {
            let (a, b) = (root(&mut above, a), root(&mut above, b));
            above.insert(a.max(b), a.min(b));
        }
    }
    let mut parts: HashMap<[u64; 3], Vec<[[u64; 3]; 3]>> = HashMap::new();
    for triangle in &mesh.triangles {
        let corners = corners(triangle);
        parts.entry(root(&mut above, corners[0])).or_default().push(corners);
    }
    let mut parts: Vec<_> = parts.into_values().collect();
    parts.iter_mut().for_each(|triangles| triangles.sort_unstable());
    parts.sort_unstable_by_key(|triangles| std::cmp::Reverse(triangles.len()));
    parts
}

#[test]
fn what_is_left_is_the_rest_of_the_full_surface() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let volume = write(folder.path());
    let (full, full_mesh) = extract(&volume, "--beta -1");
    let all = parts(&full_mesh);
    assert_eq!(all.len(), BALLS.len());
    assert_eq!(
        (&full["removedParts"], &full["removedTriangles"]),
        (&Value::Null, &Value::Null)
    );
    let full_triangles = count(&full, "fullTriangles");
    // The surface in full, by a budget that it does not need.
    let (left, left_mesh) = extract(&volume, &format!("--triangles 1000000 --min-part {MIN_PART}"));
    assert_eq!(parts(&left_mesh), all[..2], "the same triangles as before");
    assert_eq!(count(&left, "removedParts"), SMALL);
    assert_eq!(
        count(&left, "fullTriangles") + count(&left, "removedTriangles"),
        full_triangles
    );
    assert!(count(&left, "removedTriangles") > 0, "{left}");
    assert_eq!(characteristic(&left), 4, "two spheres: {left}");
    assert!(left["error"]["max"].as_f64().is_some_and(|max| max < 0.5), "{left}");

    for (options, maximum) in [
        ("--triangles 20%", count(&left, "fullTriangles") / 5),
        ("--triangles 2000", 2000),
        ("--error 0.5vx", u64::MAX),
        ("--error 0", u64::MAX),
    ] {
        let (cut, cut_mesh) = extract(&volume, &format!("{options} --min-part {MIN_PART}"));
        assert_eq!(parts(&cut_mesh).len(), 2, "{options}");
        assert_eq!(
            (count(&cut, "removedParts"), characteristic(&cut)),
            (SMALL, 4),
            "{options}: {cut}"
        );
        assert!(count(&cut, "triangles") <= maximum, "{options}: {cut}");
        assert_eq!(cut["isTreeCut"], true, "{cut}");
        // The removed parts, dozens of voxels away, are not measured.
        assert!(
            cut["error"]["max"].as_f64().is_some_and(|max| max < 2.0),
            "{options}: {cut}"
        );
    }
    // A budget of bytes applies to the remaining parts.
    let cut = command::extract_to(
        &volume,
        &format!("--iso 0 --bytes 12000 --min-part {MIN_PART}"),
        &folder.path().join("out.ply"),
    );
    assert_eq!((count(&cut, "removedParts"), characteristic(&cut)), (SMALL, 4), "{cut}");
    // An area below that of any part removes none, and counts.
    let (cut, _) = extract(&volume, "--triangles 50% --min-part 0.01");
    assert_eq!(
        (count(&cut, "removedParts"), characteristic(&cut)),
        (0, 2 * BALLS.len() as i64),
        "{cut}"
    );
    assert_eq!(count(&cut, "fullTriangles"), full_triangles);
}

#[test]
fn a_surface_of_small_parts_alone_is_empty() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let volume = write(folder.path());
    for options in ["--triangles 1000", "--triangles 10%", "--error 0.1vx"] {
        let (nothing, mesh) = extract(&volume, &format!("{options} --min-part 1e6"));
        assert_eq!(count(&nothing, "removedParts"), BALLS.len() as u64, "{options}");
        let counts = ["triangles", "vertices", "fullTriangles"].map(|name| count(&nothing, name));
        assert_eq!((counts, mesh.triangles.len()), ([0; 3], 0), "{options}");
    }
}

#[test]
fn the_command_says_how_many_and_refuses_what_it_cannot_do() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let volume = write(folder.path());
    let run = |options: &str| {
        let words = format!("--iso 0 --stats {options}");
        let words: Vec<&OsStr> = words.split_whitespace().map(OsStr::new).collect();
        command::run([OsStr::new("extract"), volume.as_os_str()].into_iter().chain(words))
    };
    let output = run("--triangles 50% --min-part 400");
    assert!(output.status.success());
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("5 parts with an area below 400 were removed"), "{said}");
    assert!(!String::from_utf8_lossy(&run("--triangles 50%").stderr).contains("removed"));

    let over = |options: &str| {
        let output = run(options);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && said.contains("ask for"), "{said}");
        let minimum = said.rsplit("ask for ").next().and_then(|rest| rest.split(' ').next());
        minimum
            .and_then(|number| number.parse::<u64>().ok())
            .expect("the minimum")
    };
    // The minimum is that of the remaining parts, and a cut of cubes, which has all parts, does not replace the tree's.
    let (all, left) = (
        over("--triangles 3 --topology preserve"),
        over("--triangles 3 --min-part 400"),
    );
    assert!(left < all, "{left} triangles at least, {all} with all parts");
    assert!(run(&format!("--triangles {left} --min-part 400")).status.success());
    for (options, words) in [
        (
            "--min-part 5",
            "minPart: 5 with beta alone, expected error, triangles or bytes too",
        ),
        (
            "--min-part 5 --error 1 --mesher marching-cubes",
            "expected the dual mesher",
        ),
        (
            "--min-part -2 --error 1",
            "minPart: -2, expected an area in world units, 0 or more",
        ),
        ("--min-part nan --error 1", "minPart: NaN, expected an area"),
        ("--min-part x --error 1", "--min-part"),
    ] {
        let output = run(options);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && said.contains(words), "{options}: {said}");
    }
}

/// A position on the surface of a ball, along x.
fn on_ball(ball: usize) -> [f32; 3] {
    let ([x, y, z], radius) = BALLS[ball];
    [x + radius, y, z]
}

/// The balls of which a mesh has triangles.
fn balls_of(mesh: &FileMesh) -> Vec<usize> {
    let is_of = |ball: usize, at: [f64; 3]| {
        let (middle, radius) = BALLS[ball];
        let distance2: f64 = (0..3).map(|i| (at[i] - f64::from(middle[i])).powi(2)).sum();
        (distance2.sqrt() - f64::from(radius)).abs() < 1.0
    };
    let has = |&ball: &usize| mesh.positions.iter().any(|&at| is_of(ball, at));
    (0..BALLS.len()).filter(has).collect()
}

#[test]
fn parts_are_hidden_or_kept_by_positions_next_to_them() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let volume = write(folder.path());
    let (full, _) = extract(&volume, "--beta -1");
    let option = |option: &str, at: [f32; 3]| format!("--{option} {},{},{}", at[0], at[1], at[2]);
    let hide = |ball| option("hide-part", on_ball(ball));
    let keep = |ball| option("keep-part", on_ball(ball));
    let cases = [
        (hide(0), vec![1, 2, 3, 4, 5, 6], 0),
        // Twice the same ball, a small one, and a place inside the first one.
        (
            format!("{0} {0} {1} {2}", hide(1), hide(5), option("hide-part", BALLS[0].0)),
            vec![0, 2, 3, 4, 6],
            1,
        ),
        (keep(1), vec![1], 0),
        (format!("{} {}", keep(0), keep(6)), vec![0, 6], 0),
        // Both at once.
        (format!("{} --min-part {MIN_PART}", hide(0)), vec![1], 0),
        (format!("{} {} --min-part {MIN_PART}", keep(0), keep(6)), vec![0], 0),
        // Outside the volume nothing is chosen.
        (option("hide-part", [-500.0, 0.0, 1e9]), (0..7).collect(), 1),
        (option("keep-part", BALLS[0].0), Vec::new(), 1),
    ];
    // Each with one of three budgets, by turns: a command takes a second.
    for (case, (options, balls, unmatched)) in cases.into_iter().enumerate() {
        let details = ["--triangles 1000000", "--triangles 40%", "--error 0.2vx"]
            .into_iter()
            .enumerate();
        for (_, detail) in details.filter(|(budget, _)| case % 3 == *budget) {
            let (left, mesh) = extract(&volume, &format!("{detail} {options}"));
            let named = format!("{detail} {options}: {left}");
            assert_eq!(balls_of(&mesh), balls, "{named}");
            assert_eq!(parts(&mesh).len(), balls.len(), "{named}");
            assert_eq!(
                (count(&left, "removedParts"), count(&left, "unmatchedPositions")),
                ((BALLS.len() - balls.len()) as u64, unmatched),
                "{named}"
            );
            assert_eq!(characteristic(&left), 2 * balls.len() as i64, "{named}");
            let all = count(&left, "fullTriangles") + count(&left, "removedTriangles");
            assert_eq!(all, count(&full, "fullTriangles"), "{named}");
            if detail.ends_with('%') {
                assert!(
                    count(&left, "triangles") * 5 <= 2 * count(&left, "fullTriangles"),
                    "{named}"
                );
            }
        }
    }
}

#[tokio::test]
async fn a_viewer_hides_and_keeps_parts_without_another_tree() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let Some(own) = server::start_with_volumes(&[write(folder.path())]) else {
        return;
    };
    let mut viewer = Viewer::open(own.address, "balls").await;
    viewer.edit_and_rest(json!({"iso": 0, "error": "0.3vx"})).await;
    for (edit, balls) in [
        (json!({"parts": {"hide": [on_ball(0)]}}), 6),
        (json!({"parts": {"hide": [on_ball(0), on_ball(3)]}}), 5),
        (json!({"alpha": 0.9}), 5),
        (json!({"minPart": MIN_PART}), 1),
        (json!({"parts": {"keep": [on_ball(1), on_ball(3)]}}), 1),
        (json!({"minPart": null}), 2),
        (json!({"parts": null}), 7),
    ] {
        let done = viewer.edit(edit.clone()).await;
        assert_eq!(characteristic(&done), 2 * balls, "{edit}: {done}");
        assert!(
            done["isTreeCut"] == true && done["stagesMs"]["tree"].is_null(),
            "{edit}: {done}"
        );
        assert_eq!(mesh::open_edges(viewer.shown.values(), DIMS).len(), 0, "{edit}");
        let triangles: usize = viewer.shown.values().map(|chunk| chunk.triangles.len()).sum();
        assert_eq!(triangles as u64, count(&done, "triangles"), "{edit}");
    }
    // At another isovalue there are other parts, among which the same positions choose.
    viewer
        .edit_and_rest(json!({"iso": 1, "parts": {"keep": [on_ball(1)]}}))
        .await;
    let (_, hidden) = viewer.ask(json!({"type": "probe", "position": on_ball(0)})).await;
    assert!(hidden["nearest"]["leaf"].is_null(), "its part was removed: {hidden}");
    let area = hidden["nearest"]["partArea"].as_f64().expect("an area");
    let expected = 4.0 * std::f64::consts::PI * f64::from(BALLS[0].1 - 1.0).powi(2);
    assert!((area / expected - 1.0).abs() < 0.02, "{area}, expected {expected}");
    // Two places of one part have its number, whether it is removed or not; those of another part have another.
    let ([x, y, z], radius) = BALLS[0];
    let mut numbers = Vec::new();
    for position in [on_ball(0), [x - radius, y, z], on_ball(1)] {
        let (_, probed) = viewer.ask(json!({"type": "probe", "position": position})).await;
        numbers.push(probed["nearest"]["part"].as_u64().expect("a part"));
    }
    assert!(numbers[0] == numbers[1] && numbers[0] != numbers[2], "{numbers:?}");
    // β has all parts again.
    let all = viewer.edit(json!({"beta": -1})).await;
    assert!(
        all["removedParts"].is_null() && all["unmatchedPositions"].is_null(),
        "{all}"
    );

    let address = own.address;
    let request =
        json!({"volume": "balls", "format": "stl", "iso": 0, "error": "0.1vx", "parts": {"keep": [on_ball(1)]}});
    let answer = tokio::task::spawn_blocking(move || http::post_json(address, "/api/v1/extract", &request))
        .await
        .expect("an answer");
    assert_eq!(answer.status, 200);
    assert_eq!(balls_of(&files::read("stl", &answer.body)), [1]);
}

#[tokio::test]
async fn a_viewer_and_an_export_have_small_parts_removed_until_an_edit_ends_it() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let volume = write(folder.path());
    let Some(own) = server::start_with_volumes(&[volume]) else {
        return;
    };
    let mut viewer = Viewer::open(own.address, "balls").await;
    let edit = json!({"iso": 0, "triangles": {"share": 0.5}, "minPart": MIN_PART});
    let done = viewer.edit_and_rest(edit).await;
    let last = &done[done.len() - 1];
    assert_eq!(
        (count(last, "removedParts"), characteristic(last)),
        (SMALL, 4),
        "{last}"
    );
    // The cut of cubes before it has all parts, and says so.
    assert!(
        done.iter()
            .all(|statistics| statistics["removedParts"].is_null() != (statistics["isTreeCut"] == true))
    );
    assert_eq!(mesh::open_edges(viewer.shown.values(), DIMS).len(), 0);
    // Once the tree is there, at once.
    let fewer = viewer.edit(json!({"triangles": {"share": 0.2}})).await;
    assert_eq!(
        (count(&fewer, "removedParts"), characteristic(&fewer)),
        (SMALL, 4),
        "{fewer}"
    );
    assert!(
        count(&fewer, "triangles") <= count(&fewer, "fullTriangles") / 5,
        "{fewer}"
    );
    let all = viewer.edit(json!({"minPart": null})).await;
    assert_eq!(
        (&all["removedParts"], characteristic(&all)),
        (&Value::Null, 2 * BALLS.len() as i64)
    );
    // β has all parts.
    viewer.edit(json!({"minPart": MIN_PART})).await;
    let all = viewer.edit(json!({"beta": -1})).await;
    assert_eq!(
        (&all["removedParts"], characteristic(&all)),
        (&Value::Null, 2 * BALLS.len() as i64)
    );

    let request =
        json!({"volume": "balls", "format": "stl", "iso": 0, "triangles": {"share": 0.5}, "minPart": MIN_PART});
    let address = own.address;
    let answer = tokio::task::spawn_blocking(move || http::post_json(address, "/api/v1/extract", &request))
        .await
        .expect("an answer");
    assert_eq!(answer.status, 200);
    assert_eq!(parts(&files::read("stl", &answer.body)).len(), 2);
}
