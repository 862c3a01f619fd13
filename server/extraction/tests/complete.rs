//! The engine as a program uses it that has the device for itself.

use std::collections::HashMap;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use isopeel_codec::encode::encoded_bytes;
use isopeel_extraction::dataset_views::opening_view;
use isopeel_extraction::{Extraction, Making, Options, WorkError, Workspace, WorldMesh};
use isopeel_kernels::{Cancel, Engine, Never, Samples};
use isopeel_view::{Edit, View};
use isopeel_volumes::{Geometry, VolumeStep, memory_dataset, open_dataset};

const SIDE: u32 = 48;
const RADIUS: f64 = 15.0;

/// Held while a test uses the device: drivers crash if two threads open it at once.
static ALONE: Mutex<()> = Mutex::new(());

fn alone() -> MutexGuard<'static, ()> {
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

fn workspace() -> Workspace {
    Workspace::new(Engine::open(None).expect("a device"), Options::default())
}

/// Values that fall from the middle, 0 at distance [`RADIUS`]. The first axis points towards lower coordinates: index space is mirrored.
fn ball() -> VolumeStep {
    let middle = f64::from(SIDE - 1) / 2.0;
    let at = |x, y, z| {
        let distance = [x, y, z]
            .map(|i: u32| (f64::from(i) - middle).powi(2))
            .iter()
            .sum::<f64>();
        (RADIUS - distance.sqrt()) as f32
    };
    let all = 0..SIDE;
    let samples = all
        .clone()
        .flat_map(|z| (0..SIDE).flat_map(move |y| (0..SIDE).map(move |x| at(x, y, z))));
    let geometry = Geometry {
        origin: [middle, -middle, -middle],
        direction: [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        ..Geometry::of_index([SIDE; 3])
    };
    let dataset = memory_dataset("ball", geometry, vec![Arc::new(Samples::F32(samples.collect()))]);
    VolumeStep::new(Arc::new(dataset.expect("a dataset")), 0).expect("a step")
}

fn view(volume: &VolumeStep, edit: &str) -> View {
    let edit: Edit = serde_json::from_str(edit).expect("an edit");
    let opening = opening_view(volume.dataset()).expect("an opening view");
    opening
        .apply(&edit, &volume.dataset().field_names())
        .expect("a good edit")
}

fn surface(workspace: &mut Workspace, volume: &VolumeStep, edit: &str) -> Extraction {
    let made = workspace.surface(volume, &view(volume, edit), Making::default(), &Never);
    made.expect("a surface")
}

/// Triangles on each side of each edge.
fn sides(mesh: &WorldMesh) -> HashMap<[u32; 2], [u32; 2]> {
    let mut sides: HashMap<_, [u32; 2]> = HashMap::new();
    for &[a, b, c] in &mesh.triangles {
        for [from, to] in [[a, b], [b, c], [c, a]] {
            let edge = [from.min(to), from.max(to)];
            sides.entry(edge).or_default()[usize::from(from > to)] += 1;
        }
    }
    sides
}

/// Volume that a mesh encloses, whose triangles are counter-clockwise seen from outside.
fn enclosed(mesh: &WorldMesh) -> f64 {
    let of = |&[a, b, c]: &[u32; 3]| {
        let [a, b, c] = [a, b, c].map(|i| mesh.positions[i as usize]);
        let cross = [
            b[1] * c[2] - b[2] * c[1],
            b[2] * c[0] - b[0] * c[2],
            b[0] * c[1] - b[1] * c[0],
        ];
        (0..3).map(|i| a[i] * cross[i]).sum::<f64>() / 6.0
    };
    mesh.triangles.iter().map(of).sum()
}

#[test]
fn a_surface_within_a_budget_is_a_closed_mesh_in_the_world() {
    let _alone = alone();
    let (mut workspace, volume) = (workspace(), ball());
    let full = surface(&mut workspace, &volume, r#"{"iso":0,"triangles":10000000,"error":0}"#);
    let fewer = surface(&mut workspace, &volume, r#"{"iso":0,"triangles":{"share":0.25}}"#);
    let triangles = |extraction: &Extraction| extraction.surface.statistics.triangles;
    assert!(triangles(&fewer) * 4 <= full.surface.statistics.full_triangles && triangles(&fewer) > 100);
    for extraction in [&full, &fewer] {
        let mesh = extraction.mesh(&volume).expect("a mesh");
        assert_eq!(mesh.triangles.len() as u64, triangles(extraction));
        assert!(sides(&mesh).values().all(|sides| *sides == [1, 1]), "open edges");
        let ball = 4.0 / 3.0 * std::f64::consts::PI * RADIUS.powi(3);
        let off = enclosed(&mesh) / ball - 1.0;
        assert!(off.abs() < 0.02, "outward, and as large as the ball: {off}");
        let error = extraction.statistics(&volume, "").error.expect("a measured error");
        assert!(error.max < 0.5, "{error:?}");
    }
}

#[test]
fn a_budget_of_bytes_is_filled_and_kept() {
    let _alone = alone();
    let (mut workspace, volume) = (workspace(), ball());
    let made = surface(&mut workspace, &volume, r#"{"iso":0,"bytes":20000}"#);
    let bytes = encoded_bytes(&made.surface, &|| false)
        .expect("encodes")
        .expect("not cancelled");
    assert!((10_000..=20_000).contains(&bytes), "{bytes}");
    let too_few = workspace.surface(
        &volume,
        &view(&volume, r#"{"iso":0,"bytes":100}"#),
        Making::default(),
        &Never,
    );
    assert!(matches!(
        too_few,
        Err(WorkError::OverBytes { .. } | WorkError::OverBudget { .. })
    ));
}

#[test]
fn fields_that_a_view_needs_are_loaded_or_computed() {
    let _alone = alone();
    let (mut workspace, volume) = (workspace(), ball());
    let mut triangles = |edit: &str| surface(&mut workspace, &volume, edit).surface.statistics.full_triangles;
    let plain = triangles(r#"{"iso":1}"#);
    assert_eq!(triangles(r#"{"field":"3*value","iso":3}"#), plain);
    assert_eq!(triangles(r#"{"field":"3*value","iso":3,"cap":true}"#), plain);
    // The isovalue and the range of the feature come from histograms.
    assert!(triangles(r#"{"field":"-value","feature":"value"}"#) > 1000);
    let masked = triangles(r#"{"iso":1,"mask":"value>0.5"}"#);
    assert!(masked < plain, "{masked} of {plain}");
}

#[test]
fn what_cannot_be_is_an_error() {
    let _alone = alone();
    let (mut workspace, volume) = (workspace(), ball());
    struct Always;
    impl Cancel for Always {
        fn is_cancelled(&self) -> bool {
            true
        }
    }
    let cancelled = workspace.surface(&volume, &view(&volume, r#"{"iso":0}"#), Making::default(), &Always);
    assert!(matches!(cancelled, Err(WorkError::Cancelled)), "{cancelled:?}");
    let limited = workspace.surface(
        &volume,
        &view(&volume, r#"{"iso":0,"triangles":10000000,"error":0}"#),
        Making {
            ceiling: 100,
            ..Making::default()
        },
        &Never,
    );
    assert!(
        matches!(limited, Err(WorkError::TooManyTriangles { ceiling: 100, .. })),
        "{limited:?}"
    );
    // A file that was cut off after its header was read.
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("cut.nrrd");
    let header = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 32 32 32\nspacings: 1 1 1\nencoding: raw\n\n";
    let whole = [header.as_bytes(), &[7; 32 * 32 * 32]].concat();
    std::fs::write(&path, &whole).expect("a file");
    let dataset = Arc::new(open_dataset(Path::new(&path)).expect("a dataset"));
    std::fs::write(&path, &whole[..whole.len() / 2]).expect("a shorter file");
    let volume = VolumeStep::new(dataset, 0).expect("a step");
    let unreadable = workspace.surface(&volume, &view(&volume, r#"{"iso":5}"#), Making::default(), &Never);
    assert!(matches!(unreadable, Err(WorkError::Unreadable(_))), "{unreadable:?}");
}
