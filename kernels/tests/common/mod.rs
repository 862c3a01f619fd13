//! What several test binaries need: the device, real volumes, expected counts.
#![allow(dead_code, reason = "every test binary uses its own part")]

use flate2::read::GzDecoder;
use isopeel_kernels::{Engine, Error, Grid, Samples};
use std::io::Read;
use std::path::PathBuf;

/// One line of `expected-cuts.jsonl`.
#[derive(serde::Deserialize)]
pub struct ExpectedCut {
    pub volume: String,
    pub iso: f32,
    pub alpha: f32,
    pub feature: Option<String>,
    pub feature_range: Option<[f32; 2]>,
    pub beta: f32,
    pub full_triangles: u64,
    pub active_cells: u64,
    pub leaves_per_level: [u64; 6],
    pub decimated_triangles: u64,
}

/// Counts from an independent float64 implementation.
pub const EXPECTED_CUTS: &str = include_str!("../../../tests/fixtures/expected-cuts.jsonl");

/// The device that the environment selects with `ISOPEEL_DEVICE`, or the preferred one. Without any device the test does
/// not run, unless `OPENCL_EXPECTED` says that this is a failure.
pub fn engine() -> Option<Engine> {
    open(None)
}

/// As [`engine`], with a limit on single allocations, which cuts volumes into slabs.
pub fn open(limit_bytes: Option<u64>) -> Option<Engine> {
    let selector = std::env::var("ISOPEEL_DEVICE").ok();
    match Engine::open_limited(selector.as_deref(), limit_bytes) {
        Ok(engine) => Some(engine),
        Err(e @ (Error::NoLoader | Error::NoDriver | Error::NoDevice { .. })) => {
            assert!(
                std::env::var_os("OPENCL_EXPECTED").is_none(),
                "OPENCL_EXPECTED is set, but: {e}"
            );
            println!("not run: {e}");
            None
        }
        Err(e) => panic!("{e}"),
    }
}

fn data(name: &str) -> Option<Vec<u8>> {
    let root = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    let beside = std::env::var_os("ISOPEEL_DATA").map_or_else(|| root.join("../shared/data"), PathBuf::from);
    let places = [beside.join(name), root.join("server/demo").join(name)];
    match places.iter().find_map(|p| std::fs::read(p).ok()) {
        Some(bytes) => Some(bytes),
        None => {
            println!("not run: {} is not there", places[0].display());
            None
        }
    }
}

fn unzip(bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    GzDecoder::new(bytes).read_to_end(&mut out).expect("a gzip stream");
    out
}

/// One of the real volumes, by file name; `None` where its file is missing. Readers of the server are not used on purpose.
pub fn volume(name: &str) -> Option<(Grid, Samples)> {
    let bytes = data(name)?;
    if name.ends_with(".nii.gz") {
        let bytes = unzip(&bytes);
        let short = |at: usize| i16::from_le_bytes([bytes[at], bytes[at + 1]]);
        let float = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        let dims = [42, 44, 46].map(|at| short(at) as u32);
        assert_eq!(short(70), 2, "{name} holds unsigned bytes");
        let grid = Grid::new(dims, [80, 84, 88].map(float)).unwrap();
        return Some((grid, Samples::U8(bytes[float(108) as usize..].to_vec())));
    }
    let split = bytes.windows(2).position(|w| w == b"\n\n").expect("an NRRD header");
    let header = std::str::from_utf8(&bytes[..split]).unwrap();
    let field = |key: &str| {
        let line = header
            .lines()
            .find(|l| l.starts_with(key))
            .unwrap_or_else(|| panic!("{name} has no {key}"));
        line.split_once(": ").unwrap().1.to_owned()
    };
    let sizes: Vec<u32> = field("sizes").split(' ').map(|v| v.parse().unwrap()).collect();
    let spacings: Vec<f32> = field("spacings").split(' ').map(|v| v.parse().unwrap()).collect();
    let grid = Grid::new(sizes.try_into().unwrap(), spacings.try_into().unwrap()).unwrap();
    let raw = unzip(&bytes[split + 2..]);
    let samples = match field("type").as_str() {
        "int16" => Samples::I16(raw.chunks_exact(2).map(|b| i16::from_le_bytes([b[0], b[1]])).collect()),
        "uint8" => Samples::U8(raw),
        other => panic!("{name} holds {other}"),
    };
    Some((grid, samples))
}
