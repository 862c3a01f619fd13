//! Counts from an independent float64 implementation, by the command line. Volumes of the paper's kind are larger than a repository should
//! be. Their tests are ignored unless they are requested (`make test-volumes`), and then fail if a file is missing.

use std::ffi::OsStr;
use std::path::PathBuf;

use serde_json::Value;

use crate::support::{assert_leaves, command, data_file, files, repository, server};

#[test]
#[ignore = "its volume is not in the repository: make test-volumes"]
fn ct_head_gives_the_counts_of_the_paper_run() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = folder.path().join("head.glb");
    let statistics = command::extract_to(&data_file("ct-head.nrrd"), "--iso 517 --beta 0.02", &out);
    assert_eq!(statistics["fullTriangles"], 612_514);
    assert_leaves(&statistics["leaves"], [133_613, 24_208, 4_404, 528, 53, 6]);
    let mesh = files::read("glb", &std::fs::read(&out).expect("the file is written"));
    assert_eq!(statistics["triangles"], mesh.triangles.len());
    assert!(mesh.triangles.len() < 612_514);
}

/// Extracts every line of a fixture. `find`: the file of a volume.
fn check_lines(fixture: &str, find: impl Fn(&str) -> PathBuf) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = folder.path().join("out.stl");
    let fixture = repository().join("tests/fixtures").join(fixture);
    let lines = std::fs::read_to_string(fixture).expect("the fixture");
    for line in lines.lines() {
        let case: Value = serde_json::from_str(line).expect("a JSON object a line");
        let name = case["volume"].as_str().expect("a file name");
        let volume = find(name);
        let value = |name: &str| case[name].to_string();
        let mut arguments = vec!["--iso".to_owned(), value("iso"), "--alpha".to_owned(), value("alpha")];
        arguments.extend(["--beta".to_owned(), value("beta")]);
        let path = match case["feature"].as_str() {
            None => volume,
            // the feature is another field: the folder of both is one dataset
            Some(feature) => {
                let both = folder.path().join("both");
                std::fs::create_dir_all(&both).expect("a folder");
                for file in [&volume, &find(feature)] {
                    std::fs::copy(file, both.join(file.file_name().expect("a name"))).expect("copied");
                }
                let stem = |name: &str| name.split('.').next().expect("a stem").to_owned();
                arguments.extend(["--feature".to_owned(), stem(feature), "--field".to_owned(), stem(name)]);
                let range: [f64; 2] = serde_json::from_value(case["feature_range"].clone()).expect("a range");
                arguments.extend(["--feature-range".to_owned(), range[0].to_string(), range[1].to_string()]);
                both
            }
        };
        let arguments = arguments
            .iter()
            .map(OsStr::new)
            .chain([OsStr::new("-o"), out.as_os_str()]);
        let statistics = command::extract([path.as_os_str()].into_iter().chain(arguments));
        assert_eq!(statistics["fullTriangles"], case["full_triangles"], "{line}");
        assert_eq!(statistics["activeCells"], case["active_cells"], "{line}");
        let leaves: [u64; 6] = serde_json::from_value(case["leaves_per_level"].clone()).expect("six counts");
        assert_leaves(&statistics["leaves"], leaves);
    }
}

#[test]
fn every_line_of_the_demo_holds() {
    if server::has_device() {
        check_lines("expected-cuts-demo.jsonl", |name| {
            repository().join("server/demo").join(name)
        });
    }
}

#[test]
#[ignore = "its volumes are not in the repository: make test-volumes"]
fn every_line_of_large_volumes_holds() {
    if server::has_device() {
        check_lines("expected-cuts-volumes.jsonl", data_file);
    }
}
