//! Compares two viewers of equal views, which must not differ.

use std::collections::BTreeSet;

use isopeel_client::{Chunk, Meshes};
use serde_json::Value;

use super::seat::{Failed, Final, Measured, Outcome};

/// Numbers of `statistics` that describe the surface, not the effort.
const STATISTICS: [&str; 18] = [
    "mesher",
    "beta",
    "tolerance",
    "maxError",
    "topology",
    "gaveWay",
    "isTreeCut",
    "estimatedError",
    "fullTriangles",
    "activeCells",
    "removedParts",
    "removedTriangles",
    "unmatchedPositions",
    "leaves",
    "triangles",
    "vertices",
    "lostCubes",
    "unpatchedVertices",
];
/// Relative: sums of floats in another order.
const STATISTICS_TOLERANCE: f64 = 2e-5;
const MEASURED_TOLERANCE: f64 = 1e-3;

/// Meshes by region.
pub type Regions = Meshes;

/// A difference from the expected state: its kind and details.
#[derive(Clone, Debug)]
pub struct Difference {
    pub kind: String,
    pub detail: String,
}

impl Difference {
    pub fn new(kind: impl Into<String>, detail: impl Into<String>) -> Self {
        Self {
            kind: kind.into(),
            detail: detail.into(),
        }
    }
}

/// Compares the outcomes of a surface's view.
pub fn outcomes(found: &Outcome, expected: &Outcome) -> Result<(), Difference> {
    match (&found.failure, &expected.failure) {
        (None, None) => {}
        (Some(found), Some(expected)) if found.code == expected.code => return failures(found, expected),
        (found, expected) => {
            return Err(Difference::new("failure", format!("{found:?}, expected {expected:?}")));
        }
    }
    if [found, expected].iter().all(|outcome| outcome.finals.is_empty()) {
        return Err(Difference::new("no answer", "neither a surface nor an error"));
    }
    let (Some(of_found), Some(of_expected)) = (found.finals.last(), expected.finals.last()) else {
        let count = [found, expected].map(|outcome| outcome.finals.len());
        return Err(Difference::new("no surface", format!("final surfaces: {count:?}")));
    };
    finals(of_found, of_expected)?;
    if let (true, Some((_, found)), Some((_, expected))) = (have_first(found, expected), &found.first, &expected.first)
    {
        regions(found, expected).map_err(|of| Difference::new(format!("first prefix: {}", of.kind), of.detail))?;
    }
    let cubes = |outcome: &Outcome| {
        outcome
            .finals
            .iter()
            .find(|of| of.statistics["isTreeCut"] == false)
            .cloned()
    };
    if let (Some(found), Some(expected)) = (cubes(found), cubes(expected)) {
        finals(&found, &expected).map_err(|of| Difference::new(format!("first final: {}", of.kind), of.detail))?;
    }
    measured(found.measured.as_ref(), expected.measured.as_ref())
}

/// Whether both have a first prefix of the same level.
pub fn have_first(found: &Outcome, expected: &Outcome) -> bool {
    let levels = [found, expected].map(|outcome| outcome.first.as_ref().map(|(level, _)| *level));
    levels[0].is_some() && levels[0] == levels[1]
}

fn failures(found: &Failed, expected: &Failed) -> Result<(), Difference> {
    match found.surface.is_none() || found.suggested_triangles != expected.suggested_triangles {
        true => Err(Difference::new("error", format!("{found:?}, expected {expected:?}"))),
        false => Ok(()),
    }
}

fn finals(found: &Final, expected: &Final) -> Result<(), Difference> {
    regions(&found.shown, &expected.shown)?;
    for name in STATISTICS {
        let (found, expected) = (&found.statistics[name], &expected.statistics[name]);
        if !is_close(found, expected, STATISTICS_TOLERANCE) {
            return Err(Difference::new(
                format!("statistics: {name}"),
                format!("{found}, expected {expected}"),
            ));
        }
    }
    Ok(())
}

fn measured(found: Option<&Measured>, expected: Option<&Measured>) -> Result<(), Difference> {
    let (Some(found), Some(expected)) = (found, expected) else {
        return match found.is_some() == expected.is_some() {
            true => Ok(()),
            false => Err(Difference::new(
                "measured or not",
                format!("{found:?}, expected {expected:?}"),
            )),
        };
    };
    let is_close =
        |[a, b]: [f64; 2], [c, d]: [f64; 2]| is_near(a, c, MEASURED_TOLERANCE) && is_near(b, d, MEASURED_TOLERANCE);
    let mut all = vec![("all".to_owned(), found.error, expected.error)];
    for (region, error) in &found.regions {
        let other = expected.regions.get(region).copied().unwrap_or([f64::NAN; 2]);
        all.push((format!("{region:?}"), *error, other));
    }
    match all
        .into_iter()
        .find(|(_, found, expected)| !is_close(*found, *expected))
    {
        None => Ok(()),
        Some(of) => Err(Difference::new("measured", format!("{of:?}"))),
    }
}

/// Compares what is shown region by region: triangles, attributes, levels.
pub fn regions(found: &Regions, expected: &Regions) -> Result<(), Difference> {
    let all: BTreeSet<_> = found.keys().chain(expected.keys()).collect();
    let mut differences = all.into_iter().filter_map(|at| {
        let kind = match (found.get(at), expected.get(at)) {
            (Some(found), Some(expected)) => region(found, expected)?,
            (Some(_), None) => "region too many".to_owned(),
            _ => "region missing".to_owned(),
        };
        Some((kind, *at))
    });
    let Some((kind, at)) = differences.next() else {
        return Ok(());
    };
    let count = 1 + differences.count();
    let triangles = [found, expected].map(|regions| regions.values().map(|chunk| chunk.triangles.len()).sum::<usize>());
    let detail = format!(
        "{at:?} and others, {count} of {}; triangles {}, expected {}",
        expected.len(),
        triangles[0],
        triangles[1]
    );
    Err(Difference::new(kind, detail))
}

/// Returns the difference between two meshes of a region, if there is one.
fn region(found: &Chunk, expected: &Chunk) -> Option<String> {
    if !found.same_mesh(expected) {
        let [of_found, of_expected] = [found, expected].map(triangles);
        if of_found != of_expected {
            let positions = |triangles: &[[Corner; 3]]| {
                let mut all: Vec<_> = triangles.iter().map(|corners| corners.map(|(at, _)| at)).collect();
                all.sort_unstable();
                all
            };
            let is_same_place = positions(&of_found) == positions(&of_expected);
            return Some(if is_same_place { "attributes" } else { "geometry" }.to_owned());
        }
        if values(found) != values(expected) {
            return Some("values".to_owned());
        }
    }
    (found.level_triangles != expected.level_triangles).then(|| "triangles of levels".to_owned())
}

/// The bits of the values of a field, each with the position of its vertex, in order; `None` if the chunk has none.
fn values(chunk: &Chunk) -> Option<Vec<([i16; 3], u32)>> {
    let at_vertices = chunk.vertices.iter().zip(chunk.values.as_ref()?);
    let mut all: Vec<_> = at_vertices
        .map(|(vertex, value)| (vertex.position, value.to_bits()))
        .collect();
    all.sort_unstable();
    Some(all)
}

/// Position, and normal, smoothness and feature.
type Corner = ([i16; 3], [i32; 4]);

/// All triangles, each with the same first corner wherever it began, in order.
fn triangles(chunk: &Chunk) -> Vec<[Corner; 3]> {
    let corner = |index: u32| {
        let vertex = &chunk.vertices[index as usize];
        let [x, y] = vertex.normal.map(i32::from);
        (
            vertex.position,
            [x, y, i32::from(vertex.smoothness), i32::from(vertex.feature)],
        )
    };
    let turned = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(corner);
        [[a, b, c], [b, c, a], [c, a, b]].into_iter().min().expect("three")
    };
    let mut all: Vec<_> = chunk.triangles.iter().map(turned).collect();
    all.sort_unstable();
    all
}

fn is_near(found: f64, expected: f64, tolerance: f64) -> bool {
    (found - expected).abs() <= tolerance * found.abs().max(expected.abs()).max(1e-9)
}

fn is_close(found: &Value, expected: &Value, tolerance: f64) -> bool {
    match (found, expected) {
        (Value::Number(found), Value::Number(expected)) => {
            let number = |value: &serde_json::Number| value.as_f64().unwrap_or(f64::NAN);
            is_near(number(found), number(expected), tolerance)
        }
        (Value::Array(found), Value::Array(expected)) => {
            let is_each = || found.iter().zip(expected).all(|(a, b)| is_close(a, b, tolerance));
            found.len() == expected.len() && is_each()
        }
        (Value::Object(found), Value::Object(expected)) => {
            let is_each = |(name, a): (&String, &Value)| expected.get(name).is_some_and(|b| is_close(a, b, tolerance));
            found.len() == expected.len() && found.iter().all(is_each)
        }
        (found, expected) => found == expected,
    }
}
