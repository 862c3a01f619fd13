//! Surfaces for a camera: finer from near, within the same budget and error, the same in files and in the stream.

use std::path::Path;

use isopeel_client::same_meshes;
use serde_json::{Value, json};

use crate::support::files::FileMesh;
use crate::support::viewer::{Frame, Viewer};
use crate::support::{ball, command, demo, files, http, server};

const MIDDLE: [f64; 3] = [75.0, 65.0, 70.0];
const RADIUS: f64 = 50.0;

/// A camera this far from the smooth side of the ball, looking at its middle.
fn camera(distance: f64) -> String {
    format!(
        "--camera {},65,70,75,65,70 --viewport 1280x960 --fov 45",
        75.0 - RADIUS - distance
    )
}

fn extract(volume: &Path, options: &str, folder: &Path) -> (Value, FileMesh) {
    let out = folder.join("out.stl");
    let statistics = command::extract_to(volume, &format!("--iso 0 {options}"), &out);
    (statistics, files::read("stl", &std::fs::read(&out).expect("written")))
}

/// Root mean square distance from the ball of the triangles' centroids, on its side towards the camera and on the other smooth part.
fn errors(mesh: &FileMesh) -> [f64; 2] {
    let mut sums = [(0.0, 0.0); 2];
    for triangle in &mesh.triangles {
        let at: [f64; 3] =
            std::array::from_fn(|axis| triangle.iter().map(|&v| mesh.positions[v as usize][axis]).sum::<f64>() / 3.0);
        let from = [0, 1, 2].map(|axis| at[axis] - MIDDLE[axis]);
        let off = from.iter().map(|x| x * x).sum::<f64>().sqrt() - RADIUS;
        // The other half has wrinkles.
        let side = match from[0] {
            ..-40.0 => 0,
            -25.0..-5.0 => 1,
            _ => continue,
        };
        sums[side] = (sums[side].0 + off * off, sums[side].1 + 1.0);
    }
    sums.map(|(sum, count)| (sum / count).sqrt())
}

#[test]
fn what_the_camera_sees_from_near_is_finer_within_the_same_budget() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let volume = folder.path().join("ball.npy");
    ball::write(&volume);
    let budget = 4000;
    let cut = |camera: &str| extract(&volume, &format!("--triangles {budget} {camera}"), folder.path());
    let (plain, plain_mesh) = cut("");
    let (seen, seen_mesh) = cut(&camera(20.0));
    for statistics in [&plain, &seen] {
        let triangles = statistics["triangles"].as_u64().expect("a number");
        assert!((budget * 9 / 10..=budget).contains(&triangles), "{triangles}");
        assert_eq!(
            (&statistics["isTreeCut"], &statistics["vanishedParts"]),
            (&json!(true), &json!(0))
        );
    }
    assert_eq!(plain["pixels"], json!(null));
    assert_eq!(seen["pixels"]["limitedBy"], "budget", "{seen}");
    let ([near, _], [near_plain, _]) = (errors(&seen_mesh), errors(&plain_mesh));
    assert!(near < 0.5 * near_plain, "{near}, without a camera {near_plain}");
    let (uniform, uniform_mesh) = cut(&format!("{} --detail uniform", camera(20.0)));
    assert_eq!(
        (&uniform["triangles"], &uniform["pixels"]),
        (&plain["triangles"], &json!(null))
    );
    assert!(uniform_mesh.triangles == plain_mesh.triangles);
}

#[test]
fn an_error_in_pixels_needs_more_triangles_the_nearer_the_camera_is() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let volume = folder.path().join("ball.npy");
    ball::write(&volume);
    let cut = |error: &str, distance: f64| {
        let (statistics, _) = extract(&volume, &format!("--error {error} {}", camera(distance)), folder.path());
        let pixels = &statistics["pixels"];
        (
            statistics["triangles"].as_u64().expect("a number"),
            pixels["within"].as_f64().expect("a number"),
            pixels["limitedBy"].as_str().expect("a name").to_owned(),
        )
    };
    let (near, rms, limit) = cut("1px", 20.0);
    assert!(0.2 < rms && rms <= 1.0 && limit == "error", "{rms} {limit}");
    let (far, ..) = cut("1px", 300.0);
    let (coarse, ..) = cut("4px", 20.0);
    assert!(
        far * 2 < near && coarse * 2 < near,
        "{near}, {far} from afar, {coarse} with 4px"
    );
    let (finest, _, limit) = cut("1e-9vx", 300.0);
    assert!(limit == "pixels" && finest > far, "{finest} {limit}");
    // Without a camera a pixel is a tenth of a spacing.
    let triangles = |options: &str| extract(&volume, options, folder.path()).0["triangles"].clone();
    assert_eq!(triangles("--error 2px"), triangles("--error 0.2vx"));
}

#[test]
fn cameras_that_cannot_be_meant_are_refused() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let volume = folder.path().join("ball.npy");
    ball::write(&volume);
    for (options, why) in [
        ("--error 1px --camera 0,0,0,1,1,1", "--viewport"),
        (
            "--camera 0,0,0,1,1,1 --viewport 9x9",
            "camera: given with beta alone, expected error, triangles or bytes too",
        ),
        (
            "--error 1px --camera 0,0,0,0,0,9 --viewport 9x9",
            "camera: up [0.0, 0.0, 1.0], expected another direction",
        ),
        (
            "--error 1px --camera 0,0,0,1,1 --viewport 9x9",
            "expected six or nine numbers",
        ),
        ("--error 0px", "expected a number of world units"),
        (
            "--error 1px --camera 0,0,0,1,1,1 --viewport 9",
            "expected pixels as 1280x720",
        ),
    ] {
        let line = format!("extract {} --iso 0 --stats {options}", volume.display());
        let failed = command::fail(line.split_whitespace());
        assert!(failed.contains(why), "{options}: {failed}");
    }
}

/// The camera of a message, at this distance from the brain's left side.
fn json_camera(distance: f64) -> Value {
    json!({"position": [70.0 + distance, 10.0, 30.0], "target": [0.0, 10.0, 30.0], "fov": 32, "viewport": [1280, 720]})
}

#[tokio::test]
async fn the_stream_follows_the_camera_and_makes_what_a_request_makes() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    let identity =
        json!([{"x": 0, "importance": 0, "color": "#000000"}, {"x": 1, "importance": 1, "color": "#ffffff"}]);
    let view = json!({"iso": 110, "field": "t1", "feature": "none", "alpha": 0, "error": "1px", "triangles": 60000, "interest": [],
        "transferFunction": {"points": identity}});
    let first = viewer.edit_and_rest(view.clone()).await;
    assert_eq!(first.last().expect("done")["isTreeCut"], true);
    let start = viewer.shown.clone();

    let mut triangles = Vec::new();
    for distance in [300.0, 60.0, 15.0] {
        let frames = viewer.log.len();
        viewer
            .send(json!({"type": "camera", "camera": json_camera(distance)}))
            .await;
        let statistics = viewer.until_done().await;
        triangles.push(statistics["triangles"].as_u64().expect("a number"));
        let prefixes = viewer.log[frames..]
            .iter()
            .filter(|frame| matches!(frame, Frame::Prefix(_)));
        assert_eq!(prefixes.count(), 1, "one step");
        let mut request = view.clone();
        request["format"] = json!("stl");
        request["camera"] = json_camera(distance);
        request["volume"] = json!(demo::ID);
        let answer = http::post_json(address, "/api/v1/extract", &request);
        let stated: Value = serde_json::from_str(answer.header("isopeel-statistics")).expect("JSON");
        for name in ["triangles", "vertices", "leaves", "pixels"] {
            assert_eq!(stated[name], statistics[name], "{name} at {distance}");
        }
    }
    assert!(triangles[0] < triangles[1] && triangles[2] <= 60000, "{triangles:?}");

    // A small step of the camera sends a part of the regions.
    let frames = viewer.log.len();
    viewer
        .send(json!({"type": "camera", "camera": json_camera(15.2)}))
        .await;
    viewer.until_done().await;
    let sent = viewer.log[frames..]
        .iter()
        .filter(|frame| matches!(frame, Frame::Chunk { .. }))
        .count();
    assert!(
        sent * 2 < viewer.shown.len(),
        "{sent} of {} regions",
        viewer.shown.len()
    );

    // Without a camera the surface is as before.
    viewer.send(json!({"type": "camera", "camera": null})).await;
    viewer.until_done().await;
    assert!(same_meshes(&viewer.shown, &start), "as before");
    viewer.close().await;
}
