//! Shared code of the tests: a server, a client that does not use its code, and readers of its files.

pub mod ball;
pub mod command;
pub mod files;
pub mod http;
pub mod mesh;
pub mod process;
pub mod server;
pub mod uploader;
pub mod viewer;

use std::path::PathBuf;

/// Root of the repository.
pub fn repository() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

/// A test volume that does not come with the repository, in the folder that `ISOPEEL_DATA` names.
pub fn data_file(name: &str) -> PathBuf {
    let folder = std::env::var_os("ISOPEEL_DATA");
    let folder = folder.unwrap_or_else(|| panic!("ISOPEEL_DATA must name a folder that holds {name}"));
    let path = PathBuf::from(folder).join(name);
    assert!(path.exists(), "{} is not there", path.display());
    path
}

/// File of the embedded demo's field whose surface is shown.
pub fn demo_file() -> PathBuf {
    repository().join("server/demo/t1.nii.gz")
}

/// Check values of the demo at isovalue 100, feature off, identity transfer function: from an independent float64
/// implementation; the full count equals VTK's flying edges.
pub mod demo {
    /// Id of the dataset.
    pub const ID: &str = "mni152";
    /// Samples per axis.
    pub const DIMS: [u32; 3] = [197, 233, 189];
    /// The isovalue of all values here.
    pub const ISO: f32 = 100.0;
    /// Triangles of the undecimated surface.
    pub const FULL_TRIANGLES: u64 = 378_608;
    /// Cells that it crosses.
    pub const ACTIVE_CELLS: u64 = 187_940;
    /// Leaves of levels 0 to 5 at β = 0.02.
    pub const LEAVES_AT_0_02: [u64; 6] = [108_627, 16_006, 2_091, 256, 22, 1];
    /// Leaves of levels 0 to 5 at β = 0.1.
    pub const LEAVES_AT_0_1: [u64; 6] = [28_451, 11_892, 2_901, 725, 132, 17];
    /// Leaves of levels 0 to 5 at β = 0.15 if α = 0.35 and the feature is grey matter from 0 to 255.
    pub const LEAVES_GREY_AT_0_15: [u64; 6] = [80_163, 12_719, 2_377, 442, 57, 4];
}

/// Asserts that leaves agree within 0.1 % of each level (float32 rounds at the threshold), or within one leaf if 0.1 % is less.
#[track_caller]
pub fn assert_leaves(found: &serde_json::Value, expected: [u64; 6]) {
    let found: Vec<u64> = serde_json::from_value(found.clone()).expect("leaves are six counts");
    assert_eq!(found.len(), 6, "leaves of levels 0 to 5");
    for (level, (found, expected)) in found.iter().zip(expected).enumerate() {
        let allowed = (expected / 1000).max(1);
        assert!(
            found.abs_diff(expected) <= allowed,
            "leaves of level {level}: {found}, expected {expected} ± {allowed}"
        );
    }
}
