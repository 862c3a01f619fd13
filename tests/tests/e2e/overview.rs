//! Volumes at a low resolution.

use serde_json::json;

use crate::support::{ball, demo, http, server};

/// More samples than values along the first axis, and missing ones.
const DIMS: [u32; 3] = [300, 5, 4];

fn value([x, y, z]: [f32; 3]) -> f32 {
    if x < 6.0 || (x < 9.0 && y > 2.0) {
        f32::NAN
    } else {
        x + 10.0 * y - 100.0 * z
    }
}

/// The finite samples of a block of three along x.
fn block([x, y, z]: [u32; 3]) -> Vec<f32> {
    let samples = (3 * x..3 * x + 3).map(|x| value([x as f32, y as f32, z as f32]));
    samples.filter(|v| v.is_finite()).collect()
}

#[test]
fn overviews_have_means_and_maxima_of_blocks_and_say_what_codes_stand_for() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("ramp.npy");
    ball::write_field(&file, DIMS, value);
    let Some(own) = server::start_with_volumes(std::slice::from_ref(&file)) else {
        return;
    };
    // The last block ends with the sample 299.
    let dims = [100, DIMS[1], DIMS[2]];
    for (mode, of) in [
        (
            "mean",
            (|v: &[f32]| v.iter().sum::<f32>() / v.len() as f32) as fn(&[f32]) -> f32,
        ),
        ("maximum", |v: &[f32]| {
            v.iter().copied().fold(f32::NEG_INFINITY, f32::max)
        }),
    ] {
        let path = format!("/api/v1/volumes/ramp/overview?field=ramp&step=0&mode={mode}");
        let answer = http::get(own.address, &path);
        assert_eq!(answer.status, 200, "{}", String::from_utf8_lossy(&answer.body));
        let info: serde_json::Value = serde_json::from_str(answer.header("isopeel-overview")).expect("JSON");
        let at = |i: u32| [i % dims[0], i / dims[0] % dims[1], i / dims[0] / dims[1]];
        let count = dims.iter().product::<u32>();
        let values: Vec<Option<f32>> = (0..count)
            .map(|i| {
                Some(block(at(i)))
                    .filter(|block| !block.is_empty())
                    .map(|block| of(&block))
            })
            .collect();
        let lo = values.iter().flatten().copied().fold(f32::INFINITY, f32::min);
        let hi = values.iter().flatten().copied().fold(f32::NEG_INFINITY, f32::max);
        let expected = json!({
            "field": "ramp", "mode": mode, "dims": dims, "factors": [3, 1, 1], "range": [lo, hi],
        });
        assert_eq!(info, expected);
        assert_eq!(answer.body.len() as u32, count);
        for (i, (&code, value)) in answer.body.iter().zip(&values).enumerate() {
            let expected = value.map_or(0.0, |value| 1.0 + 254.0 * (value - lo) / (hi - lo));
            assert!(
                (f32::from(code) - expected).abs() < 0.51,
                "{mode} {i}: {code}, expected {expected}"
            );
        }
        assert!(values.iter().any(Option::is_none), "some blocks are missing");
    }
}

#[test]
fn overviews_are_compressed_for_clients_that_take_it_and_wrong_requests_are_problems() {
    let Some(address) = server::shared() else { return };
    let path = format!("/api/v1/volumes/{}/overview", demo::ID);
    let plain = http::get(address, &path);
    let zipped = http::send(address, "GET", &path, &[("accept-encoding", "zstd")], &[]).expect("an answer");
    assert_eq!((zipped.status, zipped.header("content-encoding")), (200, "zstd"));
    assert_eq!(zipped.header("isopeel-overview"), plain.header("isopeel-overview"));
    let only = [("accept-encoding", "zstd, identity;q=0")];
    let only_zipped = http::send(address, "GET", &path, &only, &[]).expect("an answer");
    assert_eq!(
        (only_zipped.status, only_zipped.header("content-encoding")),
        (200, "zstd")
    );
    assert!(only_zipped.body == zipped.body);
    assert!(
        zipped.body.len() * 3 < plain.body.len() * 2,
        "{} of {}",
        zipped.body.len(),
        plain.body.len()
    );
    for (path, status, code) in [
        (format!("{path}?mode=median"), 400, "bad-request"),
        (format!("{path}?step=99"), 404, "unknown-step"),
        (format!("{path}?field=nothing"), 404, "unknown-field"),
        ("/api/v1/volumes/nothing/overview".to_owned(), 404, "unknown-volume"),
    ] {
        assert_eq!(http::get(address, &path).problem(status), code, "{path}");
    }
    let problem = |query: &str| {
        let answer = http::get(address, &format!("{path}?{query}"));
        serde_json::from_slice::<serde_json::Value>(&answer.body).expect("JSON")["detail"].to_string()
    };
    let mistake = problem("field=t1%2B");
    assert!(
        mistake.contains("As an expression: ") && mistake.contains("character"),
        "{mistake}"
    );
    for query in ["step=NaN", "step=-1"] {
        let detail = problem(query);
        let value = &query["step=".len()..];
        assert!(
            detail.contains(&format!("step: {value:?}, expected a whole number").replace('"', "\\\"")),
            "{detail}"
        );
    }
}

#[test]
fn equal_requests_for_an_overview_share_one_place() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("ramp.npy");
    ball::write_field(&file, [200, 200, 200], value);
    let Some(own) = server::start_with_volumes(std::slice::from_ref(&file)) else {
        return;
    };
    let address = own.address;
    let ask = move || http::get(address, "/api/v1/volumes/ramp/overview").status;
    let requests: Vec<_> = (0..12).map(|_| std::thread::spawn(ask)).collect();
    let statuses: Vec<u16> = requests.into_iter().map(|one| one.join().expect("an answer")).collect();
    assert_eq!(statuses, [200; 12]);
}
