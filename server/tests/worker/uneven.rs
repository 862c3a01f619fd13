//! Surfaces of samples at uneven positions, beside VTK's contour of the same file.

use std::path::Path;
use std::sync::Arc;

use isopeel::export::Mesh;
use isopeel::service::DeviceWorker;
use isopeel_extraction::dataset_views::{opening_view, view_space};
use isopeel_extraction::{Answer, CutId, Extraction, Probe, Question, ShownSurface};
use isopeel_view::View;
use isopeel_volumes::{Dataset, Frame, VolumeStep, open_dataset};
use tokio_util::sync::CancellationToken;

use crate::{ALONE, view};

type Point = [f64; 3];

fn fixture(name: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../tests/fixtures/volumes")
        .join(name)
}

fn opened(name: &str) -> Arc<Dataset> {
    let dataset = open_dataset(&fixture(name)).expect("opens");
    assert_eq!(dataset.geometry.dims, [16, 15, 17], "the samples stay as they are");
    assert!(dataset.notice().is_some_and(|text| text.contains("bounds from above")));
    Arc::new(dataset)
}

/// The points of VTK's contour.
fn contour() -> Vec<Point> {
    let text = std::fs::read_to_string(fixture("uneven-contour.csv")).expect("a list");
    let point = |line: &str| {
        let numbers: Vec<f64> = line
            .split(',')
            .map(|number| number.parse().expect("a number"))
            .collect();
        <Point>::try_from(numbers).expect("three numbers")
    };
    text.lines().map(point).collect()
}

async fn extract(worker: &DeviceWorker, dataset: &Arc<Dataset>, view: &View) -> (Extraction, Mesh) {
    let step = VolumeStep::new(Arc::clone(dataset), 0).expect("a step");
    let made = worker.extract(&step, view, &CancellationToken::new()).await;
    let made = made.expect("a surface");
    let (geometry, space) = view_space(dataset, view);
    let uneven = space.uneven.as_deref().map(|axes| (axes, view.mesher));
    let mesh = Mesh::new_unless(&made.surface, &geometry, uneven, &|| false).expect("a mesh");
    (made, mesh)
}

fn minus(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: Point, b: Point) -> Point {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

fn positions(mesh: &Mesh) -> Vec<Point> {
    (0..mesh.positions.len()).map(|vertex| mesh.world(vertex)).collect()
}

/// Distance from each of some points to the nearest of others, at most.
fn farthest(points: &[Point], others: &[Point]) -> f64 {
    let nearest = |p: &Point| {
        let squares = others.iter().map(|q| dot(minus(*p, *q), minus(*p, *q)));
        squares.fold(f64::INFINITY, f64::min)
    };
    points.iter().map(nearest).fold(0.0, f64::max).sqrt()
}

/// Distance of a point to a segment, squared.
fn to_segment(p: Point, a: Point, b: Point) -> f64 {
    let along = minus(b, a);
    let length = dot(along, along);
    let t = if length > 0.0 {
        (dot(minus(p, a), along) / length).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let off = minus(p, [a[0] + t * along[0], a[1] + t * along[1], a[2] + t * along[2]]);
    dot(off, off)
}

/// Distance of a point to a triangle, squared.
fn to_triangle(p: Point, [a, b, c]: [Point; 3]) -> f64 {
    let normal = cross(minus(b, a), minus(c, a));
    let inside = |from: Point, to: Point| dot(cross(minus(to, from), minus(p, from)), normal) >= 0.0;
    if dot(normal, normal) > 0.0 && inside(a, b) && inside(b, c) && inside(c, a) {
        return dot(minus(p, a), normal).powi(2) / dot(normal, normal);
    }
    to_segment(p, a, b).min(to_segment(p, b, c)).min(to_segment(p, c, a))
}

fn corners(mesh: &Mesh) -> Vec<[Point; 3]> {
    let at = positions(mesh);
    mesh.triangles.iter().map(|t| t.map(|i| at[i as usize])).collect()
}

/// Distance of each of some points to a mesh.
fn distances(points: &[Point], mesh: &Mesh) -> Vec<f64> {
    let triangles = corners(mesh);
    let nearest = |p: &Point| {
        let squares = triangles.iter().map(|triangle| to_triangle(*p, *triangle));
        squares.fold(f64::INFINITY, f64::min).sqrt()
    };
    points.iter().map(nearest).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn surfaces_are_where_vtk_has_them() {
    let _alone = ALONE.lock().await;
    let worker = DeviceWorker::start(None).expect("a thread");
    let expected = contour();
    assert!(expected.len() > 400);
    let cubes = r#"{"iso": 1, "beta": -1, "mesher": "marching-cubes"}"#;
    for (name, sign) in [("uneven.vtr", 1.0), ("uneven.pvtr", 1.0), ("uneven.nc", -1.0)] {
        let dataset = opened(name);
        let (_, mesh) = extract(&worker, &dataset, &view(&dataset, cubes)).await;
        let expected: Vec<Point> = expected.iter().map(|&[x, y, z]| [x, y, sign * z]).collect();
        let found = positions(&mesh);
        assert!(
            farthest(&found, &expected) < 1e-4,
            "{name}: {}",
            farthest(&found, &expected)
        );
        assert!(
            farthest(&expected, &found) < 1e-4,
            "{name}: {}",
            farthest(&expected, &found)
        );
        // The dual mesh has other vertices; its triangles pass close to the crossings of the grid's edges.
        let (_, mesh) = extract(&worker, &dataset, &view(&dataset, r#"{"iso": 1, "beta": -1}"#)).await;
        let off = distances(&expected, &mesh).into_iter().fold(0.0, f64::max);
        assert!(
            off < 0.06,
            "{name}: {off}, expected a fraction of a cell, of up to 0.95"
        );
        let at = positions(&mesh);
        let mut worst = 1.0f64;
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|i| at[i as usize]);
            let normal = cross(minus(b, a), minus(c, a));
            let length = dot(normal, normal).sqrt();
            for vertex in triangle.iter().filter(|_| length > 1e-9) {
                let of_vertex = mesh.normals[*vertex as usize].map(f64::from);
                worst = worst.min(dot(normal, of_vertex) / length);
            }
        }
        assert!(
            worst > 0.6,
            "{name}: a normal leans off its triangle, by a cosine of {worst}"
        );
    }
}

/// Positions along x and y, 8 apart, and along z, by a factor of 1.5.
fn written_positions() -> [Vec<f64>; 2] {
    let (even, growing) = ((0..12).map(|i| 8.0 * f64::from(i)), (0..12).map(|k| 1.5f64.powi(k)));
    [even.collect(), growing.collect()]
}

/// A grid of samples there, by a function of the position.
fn write_grid(path: &Path, value: impl Fn(Point) -> f64) {
    let [x, z] = written_positions();
    let text = |values: &[f64]| values.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
    let rows = z.iter().flat_map(|z| x.iter().map(move |y| (*y, *z)));
    let values: Vec<f64> = rows
        .flat_map(|(y, z)| x.iter().map(move |x| [*x, y, z]))
        .map(value)
        .collect();
    let extent = "0 11 0 11 0 11";
    let array = |name: &str, kind: &str, values: &[f64]| {
        let values = text(values);
        format!(r#"<DataArray type="{kind}" Name="{name}" format="ascii">{values}</DataArray>"#)
    };
    let file = format!(
        r#"<VTKFile type="RectilinearGrid" version="1.0"><RectilinearGrid WholeExtent="{extent}"><Piece Extent="{extent}"><PointData Scalars="d">{}</PointData><Coordinates>{}{}{}</Coordinates></Piece></RectilinearGrid></VTKFile>"#,
        array("d", "Float32", &values),
        array("x", "Float64", &x),
        array("y", "Float64", &x),
        array("z", "Float64", &z)
    );
    std::fs::write(path, file).expect("written");
}

#[tokio::test(flavor = "multi_thread")]
async fn normals_are_exact_on_a_plane_but_for_their_rounding() {
    let _alone = ALONE.lock().await;
    let worker = DeviceWorker::start(None).expect("a thread");
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("plane.vtr");
    write_grid(&path, |[x, _, z]| x + z);
    let dataset = Arc::new(open_dataset(&path).expect("opens"));
    let plain = r#""iso": 60, "beta": -1, "alpha": 0, "feature": "none""#;

    let cubes = format!(r#"{{{plain}, "mesher": "marching-cubes"}}"#);
    let (_, mesh) = extract(&worker, &dataset, &view(&dataset, &cubes)).await;
    assert!(mesh.normals.len() > 200);
    for (position, [x, y, z]) in positions(&mesh).iter().zip(&mesh.normals) {
        let cosine = f64::from(-x - z) / 2f64.sqrt();
        assert!(cosine > 0.999_99, "{position:?}: {:?}, cosine {cosine}", [x, y, z]);
    }

    // Normals of the dual mesher are exact except for their rounding to two bytes, in cells of the largest lengths.
    let (_, mesh) = extract(&worker, &dataset, &view(&dataset, &format!("{{{plain}}}"))).await;
    assert!(mesh.normals.len() > 200);
    let [_, z] = written_positions();
    let to_sum = |p: Point| p.map(|c| c / (p[0].abs() + p[1].abs() + p[2].abs()));
    for (position, normal) in positions(&mesh).iter().zip(&mesh.normals) {
        let cell = z.windows(2).find(|cell| position[2] < cell[1]).expect("a cell");
        let share = (cell[1] - cell[0]) / (z[11] - z[10]);
        let [x, y, z] = normal.map(f64::from);
        let (found, exact) = (to_sum([x, y, z * share]), to_sum([-1.0, 0.0, -share]));
        let off = minus(found, exact).map(f64::abs);
        assert!(
            off[0].max(off[1]) < 0.5 / 127.0 + 1e-4,
            "{position:?}: {found:?}, expected {exact:?}"
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn stated_errors_are_bounds_from_above() {
    let _alone = ALONE.lock().await;
    let worker = DeviceWorker::start(None).expect("a thread");
    let dataset = opened("uneven.vtr");
    let crossings = contour();
    for rest in [
        r#""beta": 0.4, "maxError": "none""#,
        r#""triangles": {"share": 0.2}"#,
        r#""error": 0.3"#,
    ] {
        let json = format!(r#"{{"iso": 1, "topology": "free", {rest}}}"#);
        let (made, mesh) = extract(&worker, &dataset, &view(&dataset, &json)).await;
        let statistics = &made.surface.statistics;
        assert!(
            statistics.triangles < statistics.full_triangles / 2,
            "{rest}: decimated"
        );
        let step = VolumeStep::new(Arc::clone(&dataset), 0).expect("a step");
        let stated = made.statistics(&step, "device").error.expect("a measured error");
        let found = distances(&crossings, &mesh);
        let max = found.iter().copied().fold(0.0, f64::max);
        let rms = (found.iter().map(|d| d * d).sum::<f64>() / found.len() as f64).sqrt();
        assert!(max > 0.01, "{rest}: {max}");
        assert!(
            max <= f64::from(stated.max) * 1.001,
            "{rest}: {max}, stated {}",
            stated.max
        );
        // The stated error combines both directions, so this direction has half of the squares.
        assert!(
            rms <= f64::from(stated.rms) * 2f64.sqrt(),
            "{rest}: {rms}, stated {}",
            stated.rms
        );
    }
}

async fn probe(worker: &DeviceWorker, dataset: &Arc<Dataset>, view: &View, position: Point) -> Probe {
    let step = VolumeStep::new(Arc::clone(dataset), 0).expect("a step");
    let token = CancellationToken::new();
    let view = worker.resolve(&step, view, &token).await.expect("a view");
    let shown = ShownSurface {
        view,
        cut: CutId::new(1),
    };
    let answer = worker
        .answer(&step, Some(&shown), Question::Probe(position), &token)
        .await;
    match answer.expect("an answer") {
        Answer::Probe(probe) => probe,
        other => panic!("{other:?}, expected a probe"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn positions_of_questions_and_regions_are_those_of_the_world() {
    let _alone = ALONE.lock().await;
    let worker = DeviceWorker::start(None).expect("a thread");
    let dataset = opened("uneven.vtr");
    let plain = view(&dataset, r#"{"iso": 1, "beta": -1, "alpha": 0}"#);
    let (_, mesh) = extract(&worker, &dataset, &plain).await;
    // A vertex among the fine levels, one among the coarse ones.
    let mut at = positions(&mesh);
    at.sort_by(|a, b| a[2].total_cmp(&b[2]));
    for position in [at[0], at[at.len() - 1]] {
        let found = probe(&worker, &dataset, &plain, position).await;
        let value = found.values[0].value.expect("a value");
        assert!((value - 1.0).abs() < 0.05, "{value} on the surface");
        let nearest = found.nearest.expect("a vertex");
        assert!(nearest.distance < 1e-2, "{nearest:?}");
        // A small box and a small ball around it, and none.
        let [x, y, z] = position;
        let ball = format!(r#"{{"sphere": {{"center": [{x}, {y}, {z}], "radius": 0.05}}, "importance": 0.75}}"#);
        let (low, high) = ([x - 0.05, y - 0.05, z - 0.02], [x + 0.05, y + 0.05, z + 0.02]);
        let cuboid = format!(r#"{{"box": {{"min": {low:?}, "max": {high:?}}}, "importance": 0.75}}"#);
        let beside = format!(
            r#"{{"box": {{"min": [{x}, {y}, {}], "max": [{}, {}, {}]}}, "importance": 0.75}}"#,
            z + 0.03,
            x + 0.05,
            y + 0.05,
            z + 0.05
        );
        for (region, is_raised) in [(ball, true), (cuboid, true), (beside, false)] {
            let json = format!(
                r##"{{"iso": 1, "beta": -1, "alpha": 0, "transferFunction": {{"points": [{{"x": 0, "importance": 0, "color": "#000000"}}]}}, "interest": [{region}]}}"##
            );
            let nearest = probe(&worker, &dataset, &view(&dataset, &json), position).await.nearest;
            let importance = nearest.expect("a vertex").importance;
            assert_eq!(
                importance,
                if is_raised { 0.75 } else { 0.0 },
                "{region} at {position:?}"
            );
        }
    }
    assert!(!probe(&worker, &dataset, &plain, [0.0, 0.0, -0.01]).await.inside);
    // A capped volume has a layer of samples more, and the same surface inside.
    let capped = view(&dataset, r#"{"iso": 1, "beta": -1, "alpha": 0, "cap": true}"#);
    let nearest = probe(&worker, &dataset, &capped, at[at.len() / 2]).await.nearest;
    assert!(
        nearest.as_ref().is_some_and(|nearest| nearest.distance < 1e-2),
        "{nearest:?}"
    );
}

/// A feature at a position of the world.
type Value = fn(Point) -> f64;

fn length(p: Point) -> f64 {
    dot(p, p).sqrt()
}

/// The mean over the corners of the cell of a position; `None` if the cell is at the border, or the position is next to another cell.
fn corner_mean(position: Point, value: impl Fn(Point) -> f64) -> Option<f64> {
    let [x, z] = written_positions();
    let axes = [&x, &x, &z];
    let mut cells = [[0.0; 2]; 3];
    for axis in 0..3 {
        let inner = axes[axis][1..11].windows(2);
        let is_inside = |cell: &&[f64]| {
            let t = (position[axis] - cell[0]) / (cell[1] - cell[0]);
            (0.01..0.99).contains(&t)
        };
        cells[axis].copy_from_slice(inner.clone().find(is_inside)?);
    }
    let corner = |b: usize| [cells[0][b & 1], cells[1][b >> 1 & 1], cells[2][b >> 2]];
    Some((0..8).map(|b| value(corner(b))).sum::<f64>() / 8.0)
}

#[tokio::test(flavor = "multi_thread")]
async fn derivatives_are_those_of_the_world() {
    let _alone = ALONE.lock().await;
    let worker = DeviceWorker::start(None).expect("a thread");
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("ball.vtr");
    // Squares have exact differences inside.
    write_grid(&path, |p| dot(p, p));
    let dataset = Arc::new(open_dataset(&path).expect("opens"));
    assert!(dataset.uneven.is_some());
    let (_, mesh) = extract(&worker, &dataset, &view(&dataset, r#"{"iso": 3600, "beta": -1}"#)).await;
    let expected: [(&str, Value); 6] = [
        ("gradient-magnitude", |p| 2.0 * length(p)),
        // Seen from the outside, the side of higher values, the surface is hollow.
        ("mean-curvature", |p| -1.0 / length(p)),
        ("gaussian-curvature", |p| 1.0 / dot(p, p)),
        ("divergence(d,d,d)", |[x, y, z]| 2.0 * (x + y + z)),
        ("vorticity-magnitude(d,d,d)", |[x, y, z]| {
            2.0 * length([y - z, z - x, x - y])
        }),
        ("q-criterion(d,d,d)", |[x, y, z]| -2.0 * (x + y + z).powi(2)),
    ];
    for (feature, value) in expected {
        let json = format!(r#"{{"iso": 3600, "beta": -1, "feature": "{feature}"}}"#);
        let view = view(&dataset, &json);
        let mut compared = 0;
        for position in positions(&mesh).into_iter().step_by(7) {
            let Some(expected) = corner_mean(position, value) else {
                continue;
            };
            let nearest = probe(&worker, &dataset, &view, position).await.nearest;
            let found = f64::from(nearest.expect("a vertex").feature);
            assert!(
                (found / expected - 1.0).abs() < 1e-3,
                "{feature} at {position:?}: {found}, expected {expected}"
            );
            compared += 1;
        }
        assert!(compared > 5, "{feature}: {compared} compared");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn features_are_described_and_extracted_at_uneven_positions() {
    let _alone = ALONE.lock().await;
    let worker = DeviceWorker::start(None).expect("a thread");
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("ball.vtr");
    write_grid(&path, |p| dot(p, p));
    let step = VolumeStep::new(Arc::new(open_dataset(&path).expect("opens")), 0).expect("a step");
    let described = isopeel::service::describe(&worker, &step).await.expect("a description");
    let names: Vec<_> = described.fields[0].derived_features.keys().collect();
    assert_eq!(
        names,
        [
            "gaussian-curvature",
            "gradient-magnitude",
            "local-variance",
            "mean-curvature"
        ]
    );
    // Differences are one-sided at the ends of the grid: twice the middle of the last cell along each axis.
    let info = &described.fields[0].derived_features["gradient-magnitude"];
    let [x, z] = written_positions();
    let ends = [(0, 1), (10, 11)].map(|(a, b)| length([x[a] + x[b], x[a] + x[b], z[a] + z[b]]));
    let range = info.range.expect("a range").map(f64::from);
    for (found, expected) in range.into_iter().zip(ends) {
        assert!((found / expected - 1.0).abs() < 1e-5, "{range:?}, expected {ends:?}");
    }
    let counts = &info.histogram.as_ref().expect("a histogram").counts;
    assert_eq!(counts.iter().sum::<u64>(), 12 * 12 * 12);

    let dataset = opened("uneven.vtr");
    let step = VolumeStep::new(Arc::clone(&dataset), 0).expect("a step");
    let token = CancellationToken::new();
    let opening = opening_view(&dataset).expect("a view");
    assert_eq!(opening.feature.as_str(), "gradient-magnitude");
    assert!(worker.extract(&step, &opening, &token).await.is_ok(), "it opens");
    for feature in described.fields[0].derived_features.keys() {
        // Padded, the axes have a sample more at each end.
        for cap in [false, true] {
            let json = format!(r#"{{"iso": 1, "feature": "{feature}", "cap": {cap}}}"#);
            let made = worker.extract(&step, &view(&dataset, &json), &token).await;
            assert!(made.expect(feature).surface.statistics.triangles > 100);
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn positions_are_described_and_samples_can_be_counted() {
    let _alone = ALONE.lock().await;
    let worker = DeviceWorker::start(None).expect("a thread");
    let dataset = opened("uneven.vtr");
    let step = VolumeStep::new(Arc::clone(&dataset), 0).expect("a step");
    let described = isopeel::service::describe(&worker, &step).await.expect("a description");
    let [x, y, z] = described.geometry.positions.expect("positions");
    assert!(x.is_none() && y.is_some_and(|y| y.len() == 15));
    let (z, last) = (z.expect("uneven"), described.geometry.spacing[2] * 16.0);
    assert!((z[1] - 0.0125).abs() < 1e-9 && (z[16] - last).abs() < 1e-9, "{z:?}");

    let mut counted = Dataset::clone(&dataset);
    counted.set_frame(Frame::Index);
    let counted = Arc::new(counted);
    let cubes = view(&counted, r#"{"iso": 1, "beta": -1, "mesher": "marching-cubes"}"#);
    let (_, mesh) = extract(&worker, &counted, &cubes).await;
    let crossing = |p: &Point| p.iter().filter(|x| x.fract() == 0.0).count() >= 2;
    assert!(
        positions(&mesh).iter().all(crossing),
        "on the edges between whole numbers"
    );
}
