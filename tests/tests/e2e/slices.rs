//! Planes of samples: raw samples with their place in the world, pictures, and contours.

use serde_json::json;

use crate::support::{ball, command, demo, http, server};

fn value([x, y, z]: [f32; 3]) -> f32 {
    if x == 3.0 && y == 4.0 {
        f32::NAN
    } else {
        x + 100.0 * y - 10_000.0 * z
    }
}

#[test]
fn slices_have_the_samples_of_the_file_and_say_where_they_lie() {
    let folder = tempfile::tempdir().expect("a folder");
    let (file, dims) = (folder.path().join("ramp.npy"), [11u32, 7, 40]);
    ball::write_field(&file, dims, value);
    let Some(own) = server::start_with_volumes(std::slice::from_ref(&file)) else {
        return;
    };
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let others = [[1, 2], [0, 2], [0, 1]][axis];
        for index in [0, dims[axis] / 2, dims[axis] - 1] {
            let path = format!("/api/v1/volumes/ramp/slices?axis={name}&index={index}&field=ramp&step=0");
            let answer = http::get(own.address, &path);
            assert_eq!(
                (answer.status, answer.content_type.as_str()),
                (200, "application/octet-stream")
            );
            let mut origin = [0.0; 3];
            origin[axis] = f64::from(index);
            let step = |of: usize| std::array::from_fn::<f64, 3, _>(|i| f64::from(u8::from(i == of)));
            let names = others.map(|other| ["x", "y", "z"][other]);
            let expected = json!({
                "field": "ramp", "axis": name, "index": index, "axes": names, "dims": others.map(|other| dims[other]),
                "type": "f32", "missing": null, "origin": origin, "steps": others.map(step),
            });
            assert_eq!(answer.slice, expected);
            let samples = floats(&answer.body);
            let [width, height] = others.map(|other| dims[other]);
            assert_eq!(samples.len() as u32, width * height);
            for (i, &sample) in samples.iter().enumerate() {
                let mut at = [index as f32; 3];
                at[others[0]] = (i as u32 % width) as f32;
                at[others[1]] = (i as u32 / width) as f32;
                let expected = value(at);
                assert!(
                    sample == expected || (sample.is_nan() && expected.is_nan()),
                    "{sample} at {at:?}"
                );
            }
        }
    }
}

#[test]
fn a_small_slice_that_cannot_be_written_is_an_error() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("ramp.npy");
    ball::write_field(&file, [11, 7, 5], value);
    let full = std::fs::File::options()
        .write(true)
        .open("/dev/full")
        .expect("a device of Linux");
    let output = std::process::Command::new(command::binary())
        .args(["slice", file.to_str().expect("text"), "--axis", "z", "--index", "3"])
        .args(["--format", "raw", "-o", "-"])
        .stdout(full)
        .output()
        .expect("the binary starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && said.contains("No space left"), "{said}");
}

/// Samples as they come.
fn floats(body: &[u8]) -> Vec<f32> {
    let words = body.as_chunks().0;
    words.iter().map(|word| f32::from_le_bytes(*word)).collect()
}

#[test]
fn slices_of_an_expression_are_computed_from_the_fields() {
    let folder = tempfile::tempdir().expect("a folder");
    let (dims, other) = ([11u32, 7, 9], |[x, y, z]: [f32; 3]| x - y + z);
    for (name, field) in [("ramp", value as fn([f32; 3]) -> f32), ("other", other)] {
        ball::write_field(&folder.path().join(format!("{name}.npy")), dims, field);
    }
    let Some(own) = server::start_with_volumes(&[folder.path().to_owned()]) else {
        return;
    };
    let volumes = http::get(own.address, "/api/v1/volumes");
    let volumes: serde_json::Value = serde_json::from_slice(&volumes.body).expect("JSON");
    let id = volumes[0]["id"].as_str().expect("an id").to_owned();
    let slice = |field: &str, rest: &str| {
        http::get(
            own.address,
            &format!("/api/v1/volumes/{id}/slices?axis=y&index=4&field={field}{rest}"),
        )
    };
    // As `2 * ramp + sqrt(other)`: missing if the ramp is missing, or the root is of a negative number.
    let answer = slice("2%20*%20ramp%20%2B%20sqrt(other)", "");
    assert_eq!(answer.status, 200);
    let expected = json!({
        "field": "2 * ramp + sqrt(other)", "axis": "y", "index": 4, "axes": ["x", "z"], "dims": [11, 9],
        "type": "f32", "missing": null, "origin": [0.0, 4.0, 0.0], "steps": [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
    });
    assert_eq!(answer.slice, expected);
    let samples = floats(&answer.body);
    assert_eq!(samples.len(), 11 * 9);
    let mut missing = 0;
    for (i, &sample) in samples.iter().enumerate() {
        let at = [(i % 11) as f32, 4.0, (i / 11) as f32];
        let expected = 2.0 * value(at) + other(at).sqrt();
        missing += u32::from(expected.is_nan());
        let is_near = (sample - expected).abs() <= 1e-6 * expected.abs();
        assert!(
            is_near || (sample.is_nan() && expected.is_nan()),
            "{sample} at {at:?}, expected {expected}"
        );
    }
    // The column of the ramp, and otherwise x + z < 4.
    assert_eq!(missing, 9 + 9);
    let picture = slice("2*other", "&format=png");
    assert_eq!((picture.status, &picture.body[..4]), (200, b"\x89PNG".as_slice()));
    assert_eq!(slice("2*othe", "").problem(404), "unknown-field");
    assert_eq!(slice("2*", "").problem(404), "unknown-field");
}

#[test]
fn pictures_of_slices_are_png_files() {
    let Some(address) = server::shared() else { return };
    for query in [
        "axis=z&index=90",
        "axis=x&index=98&field=t1&window=100&level=60",
        "axis=y&index=0&level=3",
    ] {
        let path = format!("/api/v1/volumes/{}/slices?{query}&format=png", demo::ID);
        let answer = http::get(address, &path);
        assert_eq!(
            (answer.status, answer.content_type.as_str()),
            (200, "image/png"),
            "{query}"
        );
        assert_eq!(answer.body[..8], *b"\x89PNG\r\n\x1a\n");
        let number = |at: usize| u32::from_be_bytes([0, 1, 2, 3].map(|i| answer.body[at + i]));
        let dims: [u32; 2] = serde_json::from_value(answer.slice["dims"].clone()).expect("two counts");
        assert_eq!([number(16), number(20)], dims, "{query}");
        assert_eq!(answer.body[24..26], [8, 4], "eight bits of grey and of alpha");
    }
}

#[test]
fn slices_that_are_not_there_are_problems() {
    let Some(address) = server::shared() else { return };
    let problem = |query: &str, status| {
        http::get(address, &format!("/api/v1/volumes/{}/slices?{query}", demo::ID)).problem(status)
    };
    assert_eq!(problem("axis=q&index=0", 400), "bad-request");
    assert_eq!(problem("axis=z&index=189", 422), "bad-slice");
    assert_eq!(problem("axis=z&index=0&field=t9", 404), "unknown-field");
    assert_eq!(problem("axis=z&index=0&step=1", 404), "unknown-step");
    assert_eq!(problem("axis=z&index=0&format=png&window=-3", 422), "bad-slice");
}

#[test]
fn contours_are_where_the_surface_crosses_the_plane() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let volume = folder.path().join("disc.npy");
    ball::write_field(&volume, [32, 30, 6], |[x, y, z]| {
        10.0 - ((x - 15.2).powi(2) + (y - 14.7).powi(2) + (z - 2.5).powi(2)).sqrt()
    });
    let Some(server) = server::start_with_volumes(std::slice::from_ref(&volume)) else {
        return;
    };
    for format in ["svg", "geojson", "nrrd", "png"] {
        let out = folder.path().join(format!("slice.{format}"));
        let iso = if matches!(format, "svg" | "geojson") {
            "1.5,4"
        } else {
            ""
        };
        let [volume, out_path] = [&volume, &out].map(|path| path.to_str().expect("UTF-8"));
        let mut arguments = vec!["slice", volume, "--axis", "z", "--index", "2", "-o", out_path];
        if !iso.is_empty() {
            arguments.extend(["--iso", iso]);
        }
        command::succeed(arguments);
        let path = format!("/api/v1/volumes/disc/slices?axis=z&index=2&format={format}&iso={iso}");
        let answer = http::get(server.address, &path);
        let file = std::fs::read(&out).expect("written");
        assert!(
            answer.status == 200 && answer.body == file,
            "{format}: not what the command line writes"
        );
        if format != "geojson" {
            continue;
        }
        let json: serde_json::Value = serde_json::from_slice(&file).expect("JSON");
        for (feature, iso) in json["features"].as_array().expect("features").iter().zip([1.5f64, 4.0]) {
            assert_eq!(feature["properties"]["isovalue"], iso);
            let lines = feature["geometry"]["coordinates"].as_array().expect("lines");
            assert_eq!(lines.len(), 1);
            let radius = ((10.0 - iso).powi(2) - 0.25).sqrt();
            for point in lines[0].as_array().expect("points") {
                let at = |i: usize| point[i].as_f64().expect("a number");
                assert!(
                    ((at(0) - 15.2).hypot(at(1) - 14.7) - radius).abs() < 0.03 && at(2) == 2.0,
                    "{point}"
                );
            }
        }
    }
    let path = "/api/v1/volumes/disc/slices?axis=z&index=2";
    for query in ["format=svg", "format=svg&iso=much", "format=png&iso=1"] {
        assert_eq!(
            http::get(server.address, &format!("{path}&{query}")).problem(422),
            "bad-slice",
            "{query}"
        );
    }
}
