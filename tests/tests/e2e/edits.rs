//! Edits on top of edits: which regions are sent again, and which edit supersedes which.

use std::collections::{HashMap, HashSet};
use std::time::Duration;

use isopeel::stream::{Deadlines, StepTimes};
use isopeel_client::RegionKey;
use serde_json::{Value, json};

use crate::support::viewer::{Frame, Viewer};
use crate::support::{demo, server};

fn plain(iso: f64, beta: f64) -> Value {
    let identity =
        json!([{"x": 0, "importance": 0, "color": "#000000"}, {"x": 1, "importance": 1, "color": "#ffffff"}]);
    json!({"type": "edit", "iso": iso, "field": "t1", "feature": "none", "alpha": 0, "beta": beta, "maxError": null, "topology": "free",
        "maxLevel": 5, "transferFunction": {"points": identity}})
}

/// β from 0.02 to 0.0201 merges a few cubes here and there: most regions stay as they are. The viewer itself refuses a chunk
/// that repeats what it holds; here the log proves that a region whose final mesh is the same was not touched at all.
#[tokio::test]
async fn a_beta_edit_sends_only_the_regions_that_it_changes() {
    // Directly to the final surface, even on a slow machine.
    let deadlines = Deadlines {
        steps: StepTimes {
            first: Duration::MAX,
            ..StepTimes::default()
        },
        ..Deadlines::default()
    };
    let Some(own) = server::start_with(deadlines) else {
        return;
    };
    let mut viewer = Viewer::open(own.address, demo::ID).await;
    viewer.edit(plain(100.0, 0.02)).await;
    let before = viewer.shown.clone();
    let frames = viewer.log.len();
    viewer.edit(plain(100.0, 0.0201)).await;

    let regions: HashSet<RegionKey> = before.keys().chain(viewer.shown.keys()).copied().collect();
    let same = |region: &RegionKey| match (before.get(region), viewer.shown.get(region)) {
        (Some(before), Some(after)) => before.same_mesh(after),
        _ => false,
    };
    let changed: HashSet<RegionKey> = regions.iter().filter(|region| !same(region)).copied().collect();
    assert!(
        !changed.is_empty() && changed.len() * 2 < regions.len(),
        "{} of {} changed",
        changed.len(),
        regions.len()
    );
    let sent: HashSet<RegionKey> = viewer.log[frames..]
        .iter()
        .filter_map(|frame| match frame {
            Frame::Chunk { region, .. } => Some(*region),
            _ => None,
        })
        .collect();
    assert_eq!(sent, changed, "regions that were sent and regions that changed");
}

#[tokio::test]
async fn an_edit_that_changes_nothing_sends_nothing() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    viewer.edit(plain(100.0, 0.1)).await;
    let frames = viewer.log.len();
    viewer.edit(plain(100.0, 0.1)).await;
    let chunks = viewer.log[frames..]
        .iter()
        .filter(|frame| matches!(frame, Frame::Chunk { .. }))
        .count();
    assert_eq!(chunks, 0);
}

/// Sixty edits in one flush: they are merged, at most a few are taken up, and the last one is `done`. The viewer checks that no
/// frame of an older generation follows the first of a newer one.
#[tokio::test]
async fn a_storm_of_edits_is_merged_and_ends_at_the_last() {
    let Some(address) = server::shared() else { return };
    let mut alone = Viewer::open(address, demo::ID).await;
    let expected = alone.edit(plain(90.0, 0.1)).await;
    alone.close().await;

    let mut viewer = Viewer::open(address, demo::ID).await;
    let isovalues = (0..60).map(|i| 60.0 + f64::from(i) * 0.5);
    viewer
        .send_all(isovalues.chain([90.0]).map(|iso| plain(iso, 0.1)))
        .await;
    // An earlier edit may be done too, if its first prefix is its final surface.
    let mut statistics = viewer.until_done().await;
    while statistics["fullTriangles"] != expected["fullTriangles"] {
        statistics = viewer.until_done().await;
    }
    for count in ["leaves", "triangles", "vertices"] {
        assert_eq!(statistics[count], expected[count], "{count} of the last edit");
    }
    let ends = |kind: fn(&Frame) -> Option<u32>| -> Vec<u32> { viewer.log.iter().filter_map(kind).collect() };
    let done = ends(|frame| match frame {
        Frame::Done { generation, .. } => Some(*generation),
        _ => None,
    });
    let superseded = ends(|frame| match frame {
        Frame::Superseded { generation, .. } => Some(*generation),
        _ => None,
    });
    let begun: HashSet<u32> = viewer.log.iter().filter_map(Frame::generation).collect();
    assert_eq!(
        begun.len(),
        superseded.len() + done.len(),
        "a generation is done or superseded: {begun:?}"
    );
    assert!(
        begun.len() < 30,
        "61 edits made {} generations: they were not merged",
        begun.len()
    );
    assert_eq!(begun.iter().max(), done.last(), "the last generation is done");
}

/// While a generation runs, a newer edit supersedes it: committed prefixes stand, the client ends with the newer surface.
#[tokio::test]
async fn an_edit_during_another_supersedes_it() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    viewer.send(plain(100.0, -1.0)).await;
    let first = loop {
        if let Frame::Committed { generation, .. } = viewer.next().await {
            break generation;
        }
    };
    viewer.send(plain(120.0, 0.1)).await;
    let statistics = viewer.until_done().await;
    let Some(Frame::Done { generation: last, .. }) = viewer.log.last() else {
        panic!("{:?}", viewer.log.last())
    };
    // the first edit may have been completed before the second arrived; then both are done, in order
    let ended_first = viewer.log.iter().any(|frame| match frame {
        Frame::Superseded { generation, .. } | Frame::Done { generation, .. } => *generation == first,
        _ => false,
    });
    assert!(ended_first, "generation {first} neither done nor superseded");
    let statistics = if *last == first {
        viewer.until_done().await
    } else {
        statistics
    };

    let mut alone = Viewer::open(address, demo::ID).await;
    let expected = alone.edit(plain(120.0, 0.1)).await;
    assert_eq!(statistics["triangles"], expected["triangles"]);
    let meshes = |viewer: &Viewer| -> HashMap<RegionKey, usize> {
        viewer
            .shown
            .iter()
            .map(|(&region, chunk)| (region, chunk.triangles.len()))
            .collect()
    };
    assert_eq!(
        meshes(&viewer),
        meshes(&alone),
        "the map after superseding is the map of the edit alone"
    );
    assert!(
        viewer
            .shown
            .iter()
            .all(|(region, chunk)| alone.shown[region].same_mesh(chunk))
    );
}

#[tokio::test]
async fn cancel_ends_running_work_and_what_was_committed_stands() {
    let Some(address) = server::shared() else { return };
    let mut viewer = Viewer::open(address, demo::ID).await;
    viewer.send_all([plain(95.0, -1.0), json!({"type": "cancel"})]).await;
    // whichever came first: the generation is superseded, or it was never begun and the next edit is the first
    let statistics = viewer.edit(plain(95.0, 0.1)).await;
    assert!(statistics["triangles"].as_u64().is_some_and(|triangles| triangles > 0));
    let generations: HashSet<u32> = viewer.log.iter().filter_map(Frame::generation).collect();
    let ended = viewer
        .log
        .iter()
        .filter(|frame| matches!(frame, Frame::Superseded { .. } | Frame::Done { .. }));
    assert_eq!(ended.count(), generations.len(), "every generation ends once");
    let done = viewer
        .log
        .iter()
        .filter(|frame| matches!(frame, Frame::Done { .. }))
        .count();
    assert_eq!(done, 1, "the cancelled edit is not done");
}

/// On a CPU, finding the cut for a budget takes as long as building the pyramid.
#[tokio::test]
async fn a_new_surface_is_seen_before_its_budget_is_found() {
    let Some(address) = server::shared() else { return };
    let is_cpu = isopeel_kernels::device::list().expect("a device")[0].kind == isopeel_kernels::DeviceKind::Cpu;
    let mut viewer = Viewer::open(address, demo::ID).await;
    let budget = demo::FULL_TRIANGLES / 2;
    viewer
        .edit(json!({"iso": 90, "triangles": budget, "maxError": null, "topology": "free"}))
        .await;
    let statistics = viewer.edit(json!({"iso": 91})).await;
    // The generation before may have become better meanwhile.
    let generation = viewer.surfaces[0].generation();
    let prefixes: Vec<_> = viewer
        .log
        .iter()
        .filter_map(|frame| match frame {
            Frame::Prefix(prefix) if prefix.generation == generation => Some(prefix.clone()),
            _ => None,
        })
        .collect();
    let (first, last) = (&prefixes[0], &prefixes[prefixes.len() - 1]);
    if is_cpu {
        assert!(!first.is_final && first.level > 0, "{prefixes:?}");
        assert!((first.triangles as u64) < budget / 4, "{prefixes:?}");
    }
    assert!(
        last.is_final && statistics["triangles"].as_u64().expect("a count") <= budget,
        "{statistics}"
    );
    viewer.close().await;
}
