//! What the paper's kind of data must give. The volumes are larger than a repository should be: these tests run where the
//! files are and say "not run" where they are not.

use std::ffi::OsStr;
use std::io::BufRead;

use serde_json::Value;

use crate::support::{assert_leaves, command, files, server, shared_data};

#[test]
fn ct_head_gives_the_counts_of_the_paper_run() {
    if !server::has_device() {
        return;
    }
    let Some(volume) = shared_data("ct-head.nrrd") else {
        return;
    };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = folder.path().join("head.glb");
    let statistics = command::extract_to(&volume, "--iso 517 --beta 0.02", &out);
    assert_eq!(statistics["full_triangles"], 612_514);
    assert_leaves(&statistics["leaves"], [133_613, 24_208, 4_404, 528, 53, 6]);
    let mesh = files::read("glb", &std::fs::read(&out).expect("the file is written"));
    assert_eq!(statistics["triangles"], mesh.triangles.len());
    assert!(mesh.triangles.len() < 612_514);
}

#[test]
fn every_line_of_the_expected_cuts_holds() {
    if !server::has_device() {
        return;
    }
    let Some(lines) = shared_data("expected-cuts.jsonl") else {
        return;
    };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = folder.path().join("out.stl");
    let lines = std::io::BufReader::new(std::fs::File::open(lines).expect("readable")).lines();
    for line in lines {
        let line = line.expect("UTF-8");
        let case: Value = serde_json::from_str(&line).expect("a JSON object a line");
        let Some(volume) = shared_data(case["volume"].as_str().expect("a file name")) else {
            continue;
        };
        let value = |name: &str| case[name].to_string();
        let mut arguments = vec!["--iso".to_owned(), value("iso"), "--alpha".to_owned(), value("alpha")];
        arguments.extend(["--beta".to_owned(), value("beta")]);
        let path = match case["feature"].as_str() {
            None => volume.clone(),
            // the feature is another field: the folder of both is one dataset
            Some(feature) => {
                let Some(other) = shared_data(feature) else { continue };
                let both = folder.path().join("both");
                std::fs::create_dir_all(&both).expect("a folder");
                for file in [&volume, &other] {
                    std::fs::copy(file, both.join(file.file_name().expect("a name"))).expect("copied");
                }
                let stem = |name: &str| name.split('.').next().expect("a stem").to_owned();
                arguments.extend([
                    "--feature".to_owned(),
                    stem(feature),
                    "--field".to_owned(),
                    stem(case["volume"].as_str().expect("a file name")),
                ]);
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
        assert_eq!(statistics["full_triangles"], case["full_triangles"], "{line}");
        assert_eq!(statistics["active_cells"], case["active_cells"], "{line}");
        let leaves: [u64; 6] = serde_json::from_value(case["leaves_per_level"].clone()).expect("six counts");
        assert_leaves(&statistics["leaves"], leaves);
    }
}
