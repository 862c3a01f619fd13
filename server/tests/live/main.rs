//! The whole server on a real device, with the client that is written from `PROTOCOL.md` alone.

mod client;

use std::time::Duration;

use isopeel::stream::StepTimes;
use isopeel_client::{Chunk, Frame, RegionKey, same_meshes};
use serde_json::json;
use tokio::time::timeout;

use client::{LARGE_STEPS, SMALL_STEPS, Server};

#[tokio::test(flavor = "multi_thread")]
async fn the_demo_comes_coarse_first_and_whole() {
    let server = Server::start(&[], true, LARGE_STEPS).await;
    let mut viewer = server.viewer("mni152").await;
    viewer.edit(json!({"beta": 0.4})).await;
    let (prefixes, statistics) = viewer.until_done().await;
    let (first, last) = (&prefixes[0], &prefixes[prefixes.len() - 1]);
    assert!(prefixes.len() >= 2 && last.level == 0);
    assert!(prefixes.is_sorted_by(|a, b| a.level > b.level));
    assert!(
        first.bytes * 20 < last.bytes,
        "first prefix {} bytes, last {} bytes",
        first.bytes,
        last.bytes
    );
    assert_eq!(viewer.triangles() as u64, statistics["triangles"]);

    // An edit of the cut sends what changed; the result equals what a new client gets.
    let before = viewer.shown.clone();
    let edit = json!({"beta": 0.4002});
    viewer.edit(edit.clone()).await;
    let (prefixes, statistics) = viewer.until_done().await;
    assert_eq!(viewer.triangles() as u64, statistics["triangles"]);
    let [prefix] = prefixes.as_slice() else {
        panic!("straight to the final surface, found {prefixes:?}");
    };
    let is_unchanged =
        |(region, mesh): &(&RegionKey, &Chunk)| before.get(*region).is_some_and(|held| held.same_mesh(mesh));
    let unchanged = viewer.shown.iter().filter(is_unchanged).count();
    let removed = before
        .keys()
        .filter(|coords| !viewer.shown.contains_key(*coords))
        .count();
    assert!(
        unchanged > 0 && unchanged < viewer.shown.len(),
        "{unchanged} of {} are unchanged",
        viewer.shown.len()
    );
    assert_eq!(prefix.unchanged, unchanged);
    assert_eq!(
        prefix.chunks,
        viewer.shown.len() - unchanged + removed,
        "only what changed is sent"
    );
    let mut fresh = server.viewer("mni152").await;
    fresh.edit(edit).await;
    fresh.until_done().await;
    assert!(
        same_meshes(&fresh.shown, &viewer.shown),
        "two clients of one view hold the same"
    );
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_storm_of_edits_ends_at_the_last_and_starves_nobody() {
    let server = Server::start(&[], true, StepTimes::default()).await;
    let mut storm = server.viewer("mni152").await;
    let mut calm = server.viewer("mni152").await;
    calm.edit(json!({})).await;
    for i in 0..40 {
        storm.edit(json!({"iso": 60 + i})).await;
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    storm.edit(json!({"iso": 45, "beta": 0.1})).await;
    let ((_, calm_statistics), ()) = tokio::join!(calm.until_done(), async {
        // Edits before the last may reach `done`.
        while storm.until_done().await.1["beta"].as_f64() != Some(0.1) {}
    });
    assert_eq!(calm.triangles() as u64, calm_statistics["triangles"]);
    let mut fresh = server.viewer("mni152").await;
    fresh.edit(json!({"iso": 45, "beta": 0.1})).await;
    fresh.until_done().await;
    assert!(
        same_meshes(&fresh.shown, &storm.shown),
        "the storm ends at its last edit"
    );
    server.stop().await;
}

/// A noisy volume of two steps, below every isovalue on its border, so that all surfaces are closed.
fn closed_volume(path: &std::path::Path) {
    const DIMS: [usize; 3] = [67, 40, 36];
    let [nx, ny, nz] = DIMS;
    let header = format!("{{'descr': '|u1', 'fortran_order': False, 'shape': (2, {nz}, {ny}, {nx}), }}");
    let length = (header.len() + 11).next_multiple_of(64) - 10;
    let mut file = b"\x93NUMPY\x01\x00".to_vec();
    file.extend((length as u16).to_le_bytes());
    file.extend(format!("{header:<width$}\n", width = length - 1).bytes());
    let mut state = 1u32;
    for step in 0..2 {
        for i in 0..nx * ny * nz {
            let p = [i % nx, i / nx % ny, i / nx / ny];
            let inside = (0..3).all(|axis| p[axis] > 0 && p[axis] + 1 < DIMS[axis]);
            let [x, y, z] = p.map(|v| v as f32 * 0.17 + step as f32 * 0.3);
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let noise = (state >> 24) as f32 / 16.0;
            let value = 120.0 + 60.0 * (x.sin() * y.cos() + y.sin() * z.cos() + z.sin() * x.cos()) + noise;
            file.push(if inside { value.clamp(1.0, 255.0) as u8 } else { 0 });
        }
    }
    std::fs::write(path, file).expect("written");
}

#[tokio::test(flavor = "multi_thread")]
async fn every_commit_of_a_session_is_a_closed_surface() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("closed.npy");
    closed_volume(&path);
    let server = Server::start(&[path], false, SMALL_STEPS).await;
    let mut viewer = server.viewer("closed").await;
    viewer.closed = true;
    let mut commits = 0;
    for step in [0, 1] {
        if step > 0 {
            viewer.open("closed", step).await;
        }
        for edit in [
            json!({"iso": 120}),
            json!({"beta": 0.02, "maxError": null, "topology": "free"}),
            json!({"beta": 0.3}),
            json!({"beta": 0.3, "topology": "preserve"}),
            json!({"beta": 1, "maxLevel": 3}),
            json!({"beta": -1}),
            json!({"iso": 150, "feature": "gradient-magnitude", "alpha": 0.7, "maxLevel": 5}),
            json!({"featureRange": [1, 40]}),
            json!({"transferFunction": {"points": [{"x": 0.2, "importance": 1, "color": "#000000"}, {"x": 0.4, "importance": 0, "color": "#ffffff"}]}}),
            json!({"triangles": 20000, "maxError": "auto", "topology": "auto"}),
            json!({"bytes": 150000}),
            json!({"error": "0.2vx", "triangles": 9000}),
            json!({"field": "2 * closed", "iso": 180}),
            json!({"field": "closed", "iso": 90, "feature": "sqrt(abs(closed))"}),
            json!({"beta": 0.05, "maxError": "0.1vx"}),
        ] {
            viewer.edit(edit.clone()).await;
            let (prefixes, statistics) = viewer.until_done().await;
            commits += prefixes.len();
            assert_eq!(viewer.triangles() as u64, statistics["triangles"], "{edit}");
        }
        // `cancel` and superseded edits keep what was committed.
        for (iso, beta) in [(80, 0.8), (100, 0.1), (130, 0.13), (160, 0.16)] {
            viewer.edit(json!({"iso": iso})).await;
            tokio::time::sleep(Duration::from_millis(iso)).await;
            viewer.send(json!({"type": "cancel"})).await;
            viewer.edit(json!({"beta": beta})).await;
        }
        // An edit before the last may reach `done`.
        while timeout(Duration::from_secs(3), viewer.until_done()).await.is_ok() {
            commits += 1;
        }
        assert_eq!(viewer.open_edges(), 0);
    }
    assert!(commits > 30, "{commits}");
    server.stop().await;
}

/// Samples along each axis of [`write_steps`].
const SIDE: usize = 96;

/// Writes three time steps that differ in one corner alone: some waves, higher there in the second one.
fn write_steps(folder: &std::path::Path) {
    for step in 0..3 {
        let wave = |i: usize| (i as f32 * 0.3).sin();
        let sample = |at: usize| {
            let [x, y, z] = [at % SIDE, at / SIDE % SIDE, at / SIDE / SIDE];
            let is_corner = step == 1 && x.max(y).max(z) < 20;
            wave(x) + wave(y) + wave(z) + if is_corner { 0.5 } else { 0.0 }
        };
        let samples = (0..SIDE.pow(3)).flat_map(|at| sample(at).to_le_bytes());
        let header = format!(
            "NRRD0004\ntype: float\ndimension: 3\nsizes: {SIDE} {SIDE} {SIDE}\nendian: little\nencoding: raw\n\n"
        );
        let bytes: Vec<u8> = header.into_bytes().into_iter().chain(samples).collect();
        std::fs::write(folder.join(format!("waves_{step:02}.nrrd")), bytes).expect("a file");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn another_time_step_sends_only_the_regions_that_differ() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("waves");
    std::fs::create_dir(&path).expect("a folder");
    write_steps(&path);
    let server = Server::start(&[path], false, LARGE_STEPS).await;
    let mut viewer = server.viewer("waves").await;
    // Values of the feature are in every vertex: their range stays, though that of the second step is another one.
    viewer
        .edit(json!({"iso": 0.2, "beta": 0.02, "feature": "gradient-magnitude", "alpha": 0.2}))
        .await;
    viewer.until_done().await;
    let first = viewer.shown.clone();
    assert_eq!(first.len(), 27);
    for step in [1, 2] {
        viewer.send(json!({"type": "step", "step": step})).await;
        let stepped = loop {
            let frame = viewer.next().await;
            if !matches!(frame, Frame::Measured { .. } | Frame::Described { .. }) {
                break frame;
            }
        };
        let label = json!(format!("step {step:02}"));
        assert_eq!(stepped, Frame::Stepped { step, label });
        let (prefixes, _) = viewer.until_done().await;
        let [prefix] = prefixes.as_slice() else {
            panic!("in one commit, found {prefixes:?}");
        };
        // The corner's region, and neighbours whose polygons meet its.
        assert!((1..=4).contains(&prefix.chunks), "{prefix:?}");
        assert_eq!(prefix.unchanged, 27 - prefix.chunks);
        assert_eq!(
            same_meshes(&viewer.shown, &first),
            step == 2,
            "the third step is the first one again"
        );
    }
    server.stop().await;
}
