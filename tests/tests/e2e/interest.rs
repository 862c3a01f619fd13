//! Regions of interest: the surface is finer inside, within the same budget, and as before once they are removed.

use std::path::Path;

use isopeel_client::same_meshes;
use serde_json::{Value, json};

use crate::support::files::FileMesh;
use crate::support::viewer::Viewer;
use crate::support::{ball, command, demo, demo_file, files, http, mesh, server};

/// A region of interest of the tests: centre and radius, world units.
type Sphere = ([f64; 3], f64);

/// On the smooth side of the ball, whose surface is at a distance of 50 from its middle.
const ON_THE_BALL: Sphere = ([25.0, 65.0, 70.0], 25.0);
const BALL_MIDDLE: [f64; 3] = [75.0, 65.0, 70.0];

/// On the brain's surface: its grid begins at negative coordinates.
const ON_THE_BRAIN: Sphere = ([45.0, 20.0, 50.0], 20.0);

fn option((center, radius): Sphere) -> String {
    let [x, y, z] = center;
    format!("--interest sphere:{x},{y},{z}:{radius}=0.95")
}

fn of_json((center, radius): Sphere) -> Value {
    json!([{"sphere": {"center": center, "radius": radius}, "importance": 0.95}])
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
}

fn centroids(mesh: &FileMesh) -> Vec<[f64; 3]> {
    let of = |t: &[u32; 3]| std::array::from_fn(|axis| t.iter().map(|&v| mesh.positions[v as usize][axis] / 3.0).sum());
    mesh.triangles.iter().map(of).collect()
}

/// The centroids of triangles inside, and the share that they are.
fn inside(mesh: &FileMesh, (center, radius): Sphere) -> (Vec<[f64; 3]>, f64) {
    let all = centroids(mesh);
    let inside: Vec<_> = all
        .iter()
        .copied()
        .filter(|&at| distance(at, center) <= radius)
        .collect();
    let share = inside.len() as f64 / all.len() as f64;
    (inside, share)
}

fn count(statistics: &Value, name: &str) -> u64 {
    statistics[name]
        .as_u64()
        .unwrap_or_else(|| panic!("{name} in {statistics}"))
}

/// An extraction with 15 % of the triangles, and the mesh as a file has it.
fn extract(volume: &Path, options: &str, folder: &Path) -> (Value, FileMesh) {
    let out = folder.join("out.stl");
    let statistics = command::extract_to(volume, &format!("--triangles 15% {options}"), &out);
    let mesh = files::read("stl", &std::fs::read(&out).expect("written"));
    let budget = count(&statistics, "fullTriangles") * 15 / 100;
    let triangles = count(&statistics, "triangles");
    assert!(
        (budget * 95 / 100..=budget).contains(&triangles),
        "{triangles} triangles of {budget}"
    );
    assert_eq!(statistics["isTreeCut"], true, "{statistics}");
    (statistics, mesh)
}

/// V - E + F of a closed surface; each triangle has three halves of edges.
fn characteristic(statistics: &Value) -> i64 {
    let [vertices, triangles] = ["vertices", "triangles"].map(|name| count(statistics, name) as i64);
    vertices - triangles / 2
}

#[test]
fn a_budget_is_spent_where_the_interest_is() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let volume = folder.path().join("ball.npy");
    ball::write(&volume);
    let [(plain, plain_mesh), (raised, raised_mesh)] =
        ["", &option(ON_THE_BALL)].map(|interest| extract(&volume, &format!("--iso 0 {interest}"), folder.path()));
    let full = command::extract_to(&volume, "--iso 0 --beta -1", &folder.path().join("full.stl"));
    for statistics in [&plain, &raised] {
        assert_eq!(characteristic(statistics), characteristic(&full), "{statistics}");
    }
    let (before, share_before) = inside(&plain_mesh, ON_THE_BALL);
    let (after, share_after) = inside(&raised_mesh, ON_THE_BALL);
    assert!(
        share_after > 2.0 * share_before,
        "a share of {share_after}, {share_before} before"
    );
    let rms = |at: &[[f64; 3]]| {
        let off2: f64 = at.iter().map(|&at| (distance(at, BALL_MIDDLE) - 50.0).powi(2)).sum();
        (off2 / at.len() as f64).sqrt()
    };
    assert!(
        rms(&after) < 0.6 * rms(&before),
        "off by {} inside, {} before",
        rms(&after),
        rms(&before)
    );
}

/// The brain's origin is not that of its grid, and neither is that of a capped one.
#[test]
fn regions_are_in_world_coordinates() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let share = |options: &str| {
        let (_, mesh) = extract(&demo_file(), &format!("--iso 100 {options}"), folder.path());
        inside(&mesh, ON_THE_BRAIN).1
    };
    let before = share("");
    assert!(before > 0.005, "a share of {before}: the surface passes through");
    for cap in ["", "--cap"] {
        let after = share(&format!("{cap} {}", option(ON_THE_BRAIN)));
        assert!(after > 2.0 * before, "{cap}: a share of {after}, {before} before");
    }
}

/// β is compared with the importance, so nothing is merged in regions whose importance is above β.
#[test]
fn beta_merges_nothing_in_a_region_of_more_importance() {
    let Some(address) = server::shared() else { return };
    let leaves = |interest: Value| {
        let body = json!({"volume": demo::ID, "format": "stl", "iso": demo::ISO, "feature": "none", "alpha": 0, "beta": 0.6,
            "transferFunction": {"points": [{"x": 0, "importance": 0, "color": "#000000"}]}, "interest": interest});
        let answer = http::post_json(address, "/api/v1/extract", &body);
        assert_eq!(answer.status, 200, "{}", String::from_utf8_lossy(&answer.body));
        inside(&files::read("stl", &answer.body), ON_THE_BRAIN).0.len()
    };
    let whole = |importance: f32| json!([{"box": {"min": [-1e3, -1e3, -1e3], "max": [1e3, 1e3, 1e3]}, "importance": importance}]);
    let [none, below, above, sphere] = [json!([]), whole(0.6), whole(0.61), of_json(ON_THE_BRAIN)].map(leaves);
    assert_eq!(none, below);
    assert!(above > 10 * none.max(1), "{above} triangles, {none} before");
    // Equal, except for triangles across the border, whose cubes all reach inside.
    assert!(
        sphere.abs_diff(above) * 100 <= above,
        "{sphere} triangles, {above} where all is important"
    );
}

#[tokio::test]
async fn setting_and_removing_regions_gives_the_bytes_of_before() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    let identity =
        json!([{"x": 0, "importance": 0, "color": "#000000"}, {"x": 1, "importance": 1, "color": "#ffffff"}]);
    let first = json!({"iso": demo::ISO + 11.0, "feature": "none", "alpha": 0, "triangles": {"share": 0.15}, "maxError": "auto",
        "topology": "auto", "transferFunction": {"points": identity}, "interest": []});
    viewer.edit_and_rest(first).await;
    let before = viewer.shown.clone();
    // From here on there is a tree, and an edit of the regions alone is answered with a cut of it.
    let plain = viewer.edit(json!({})).await;
    let raised = viewer.edit(json!({"interest": of_json(ON_THE_BRAIN)})).await;
    assert!(!same_meshes(&before, &viewer.shown), "nothing changed");
    for statistics in [&plain, &raised] {
        assert_eq!(statistics["isTreeCut"], true, "{statistics}");
        let (triangles, budget) = (
            count(statistics, "triangles"),
            count(statistics, "fullTriangles") * 15 / 100,
        );
        assert!(
            (budget * 95 / 100..=budget).contains(&triangles),
            "{triangles} triangles of {budget}"
        );
    }
    let raised_shown = viewer.shown.clone();
    // What an edit does not name stays.
    viewer.edit(json!({"alpha": 0.3})).await;
    viewer.edit(json!({"alpha": 0})).await;
    assert!(
        same_meshes(&raised_shown, &viewer.shown),
        "another edit changed the regions"
    );
    viewer.edit(json!({"interest": []})).await;
    assert!(same_meshes(&before, &viewer.shown), "the regions were removed");
    assert_eq!(mesh::open_edges(viewer.shown.values(), demo::DIMS).len(), 0);
    viewer.close().await;
}
