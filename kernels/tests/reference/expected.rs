//! Cuts of real volumes against an independent float64 implementation.
//!
//! The volumes are not in the repository: they are looked for in `$ISOPEEL_DATA`, by default `../shared/data` beside
//! the repository, and in the demo that the server embeds.

use std::io::Read;
use std::path::{Path, PathBuf};

use isopeel_kernels::reference::{Feature, Field, Oracle};
use isopeel_kernels::tables::cases;
use isopeel_kernels::{CutParams, Grid, Level};
use serde::Deserialize;

use crate::properties::{check_patched, params};

#[derive(Deserialize)]
struct Expected {
    volume: String,
    dims_xyz: [u32; 3],
    iso: f32,
    alpha: f32,
    feature: Option<String>,
    feature_range: Option<[f32; 2]>,
    beta: f32,
    full_triangles: u64,
    active_cells: u64,
    leaves_per_level: [u64; 6],
    decimated_triangles: u64,
}

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .expect("the crate lies in the repository")
        .to_owned()
}

fn find(name: &str) -> Option<PathBuf> {
    let data = std::env::var_os("ISOPEEL_DATA").map_or_else(|| repository().join("../shared/data"), PathBuf::from);
    [data, repository().join("server/demo")]
        .iter()
        .map(|folder| folder.join(name))
        .find(|path| path.is_file())
}

fn gunzip(bytes: &[u8]) -> Vec<u8> {
    let mut plain = Vec::new();
    flate2::read::MultiGzDecoder::new(bytes)
        .read_to_end(&mut plain)
        .expect("a whole gzip stream");
    plain
}

fn field(dims: [u32; 3], spacing: [f32; 3], kind: &str, bytes: &[u8]) -> Field {
    let values: Vec<f32> = match kind {
        "uint8" => bytes.iter().map(|&b| f32::from(b)).collect(),
        "int16" => bytes
            .chunks_exact(2)
            .map(|b| f32::from(i16::from_le_bytes([b[0], b[1]])))
            .collect(),
        other => panic!("samples of type {other}"),
    };
    Field::new(Grid::new(dims, spacing).expect("a valid grid"), values)
}

/// Just enough of NRRD (attached, gzip) and NIfTI (`.nii.gz`, little endian) for the files of the table.
fn load(path: &Path) -> Field {
    let file = std::fs::read(path).expect("the file can be read");
    if path.extension().is_some_and(|e| e == "nrrd") {
        let end = file
            .windows(2)
            .position(|w| w == b"\n\n")
            .expect("a blank line ends the header");
        let header = std::str::from_utf8(&file[..end]).expect("the header is text");
        let get = |key: &str| {
            header
                .lines()
                .find_map(|l| l.strip_prefix(key))
                .expect("the key is there")
                .trim()
        };
        let three = |key: &str| -> [f64; 3] {
            let numbers: Vec<f64> = get(key)
                .split_whitespace()
                .map(|n| n.parse().expect("a number"))
                .collect();
            numbers.try_into().expect("three numbers")
        };
        assert_eq!(get("encoding:"), "gzip");
        let bytes = gunzip(&file[end + 2..]);
        return field(
            three("sizes:").map(|n| n as u32),
            three("spacings:").map(|n| n as f32),
            get("type:"),
            &bytes,
        );
    }
    let bytes = gunzip(&file);
    let short = |at: usize| i16::from_le_bytes([bytes[at], bytes[at + 1]]);
    let float = |at: usize| f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
    let kind = match short(70) {
        2 => "uint8",
        4 => "int16",
        other => panic!("NIfTI data type {other}"),
    };
    assert!(
        matches!(float(112), 0.0 | 1.0) && float(116) == 0.0,
        "samples are not scaled"
    );
    let start = float(108) as usize;
    field(
        [42, 44, 46].map(|at| short(at) as u32),
        [80, 84, 88].map(float),
        kind,
        &bytes[start..],
    )
}

/// Within 0.1 %; small counts may be one off, by a node that lies at the threshold.
fn assert_close(what: &str, got: u64, expected: u64) {
    let tolerance = (expected as f64 * 0.001).max(1.0);
    assert!(
        (got as f64 - expected as f64).abs() <= tolerance,
        "{what}: {got}, expected {expected}"
    );
}

/// Checks every row of a volume; one test per volume, so that they run side by side.
fn check(volume: &str) {
    let table = std::fs::read_to_string(repository().join("tests/fixtures/expected-cuts.jsonl")).expect("the fixture");
    let rows: Vec<Expected> = table
        .lines()
        .map(|line| serde_json::from_str(line).expect("a row of the fixture"))
        .filter(|row: &Expected| row.volume == volume)
        .collect();
    assert!(!rows.is_empty(), "{volume} is in the table");
    let Some(path) = find(volume) else {
        println!("not run: {} row(s), {volume} is not there", rows.len());
        return;
    };
    let field = load(&path);
    let cases = cases::case_triangles();
    // Rows of one isovalue and feature stand together: the pyramid is built once for them.
    for group in rows.chunk_by(|a, b| a.iso == b.iso && a.feature == b.feature) {
        let first = &group[0];
        assert_eq!(field.grid.dims, first.dims_xyz);
        let other = match &first.feature {
            None => None,
            Some(name) => match find(name) {
                Some(path) => Some(load(&path)),
                None => {
                    println!("not run: {} row(s), {name} is not there", group.len());
                    continue;
                }
            },
        };
        let oracle = Oracle::new(&field, other.as_ref().map_or(Feature::None, Feature::Field), first.iso);
        for row in group {
            let name = format!("{volume} at {}, alpha {}, beta {}", row.iso, row.alpha, row.beta);
            assert_eq!(
                oracle.pyramid.full_triangles(),
                row.full_triangles,
                "{name}: full triangles"
            );
            assert_eq!(
                oracle.pyramid.cells.len() as u64,
                row.active_cells,
                "{name}: active cells"
            );
            let params = CutParams {
                alpha: row.alpha,
                feature_range: row.feature_range.unwrap_or([0.0, 1.0]),
                ..CutParams::paper(row.beta)
            };
            let cut = oracle.cut(&params, Level::FINEST);
            println!("{name}: leaves {:?}, expected {:?}", cut.counts(), row.leaves_per_level);
            for (level, (got, expected)) in cut.counts().into_iter().zip(row.leaves_per_level).enumerate() {
                assert_close(&format!("{name}: leaves of level {level}"), got, expected);
            }
            let triangles = cut
                .leaves
                .values()
                .map(|n| u64::from(cases[usize::from(n.signs)][0]))
                .sum();
            assert_close(
                &format!("{name}: decimated triangles"),
                triangles,
                row.decimated_triangles,
            );
        }
    }
}

#[test]
fn cuts_of_ct_head() {
    check("ct-head.nrrd");
}

#[test]
fn cuts_of_8_bit_head() {
    check("head-256x256x225-u8.nrrd");
}

#[test]
fn cuts_of_mni152() {
    check("mni152-t1.nii.gz");
}

#[test]
fn mesh_of_ct_head_is_patched() {
    let Some(path) = find("ct-head.nrrd") else {
        println!("not run: ct-head.nrrd is not there");
        return;
    };
    let field = load(&path);
    let oracle = Oracle::new(&field, Feature::None, 517.0);
    let cut = oracle.cut(&params(0.02), Level::FINEST);
    let mesh = oracle.mesh(&cut);
    assert_close("triangles", mesh.triangles.len() as u64, 334_858);
    println!(
        "{} vertices, {} unpatched, {} lost cubes",
        mesh.vertices.len(),
        mesh.unpatched,
        cut.lost_cubes()
    );
    check_patched(&oracle, &cut, &mesh).expect("finer vertices lie on coarser segments");
}
