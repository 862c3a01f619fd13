//! REST: descriptions of volumes, extractions, and refusals.

use serde_json::{Value, json};

use crate::support::{assert_leaves, command, demo, demo_file, files, http, server};

/// Clients without a token may request them, and compressing takes longer than sending.
#[test]
fn small_answers_are_not_compressed() {
    let Some(address) = server::shared() else { return };
    let ask = |path: &str| {
        let headers = [("accept-encoding", "gzip, zstd, br")];
        http::send(address, "GET", path, &headers, b"").expect("an answer")
    };
    for path in ["/api/v1/nothing", "/api/v1/volumes/none", "/api/v1/session"] {
        let answer = ask(path);
        assert_eq!(answer.header("content-encoding"), "", "{path}");
        assert!(
            answer.body.len() > 32 && answer.body.len() < 1024,
            "{path}: {} bytes",
            answer.body.len()
        );
    }
    assert_eq!(ask("/api/v1/openapi.json").header("content-encoding"), "zstd");
}

#[test]
fn volumes_are_listed_and_described_with_histograms() {
    let Some(address) = server::shared() else { return };
    let list = http::get(address, "/api/v1/volumes");
    assert_eq!((list.status, list.content_type.as_str()), (200, "application/json"));
    let ids: Vec<Value> = list
        .json()
        .as_array()
        .expect("a list")
        .iter()
        .map(|volume| volume["id"].clone())
        .collect();
    assert!(ids.contains(&json!(demo::ID)), "{ids:?}");

    let volume = http::get(address, &format!("/api/v1/volumes/{}", demo::ID)).json();
    assert_eq!(volume["id"], demo::ID);
    let samples: u64 = demo::DIMS.iter().map(|&n| u64::from(n)).product();
    let mut histograms = Vec::new();
    collect_histograms(&volume, &mut histograms);
    // three fields with the magnitude of their gradients, and four features
    assert_eq!(histograms.len(), 10, "histograms");
    for field in volume["fields"].as_array().expect("fields") {
        let gradient = &field["derivedFeatures"]["gradient-magnitude"];
        assert!(
            gradient["range"][1].as_f64() > gradient["range"][0].as_f64(),
            "{gradient}"
        );
        assert_ne!(gradient["histogram"]["counts"], field["histogram"]["counts"]);
        // A brain on a grid of zeros.
        let opening = &field["openingIso"];
        assert_eq!(opening["reason"], "background-left-out", "{opening}");
        assert!(
            (90.0..210.0).contains(&opening["iso"].as_f64().expect("a number")),
            "{opening}"
        );
        assert!(
            opening["explanation"]
                .as_str()
                .is_some_and(|why| why.contains("background")),
            "{opening}"
        );
    }
    assert_eq!(
        volume["features"][0]["histogram"],
        volume["fields"][0]["derivedFeatures"]["gradient-magnitude"]["histogram"]
    );
    for feature in volume["features"].as_array().expect("features") {
        assert!(feature["openingIso"].is_null(), "{feature}");
    }
    for bins in &histograms {
        assert_eq!(bins.len(), 256, "bins");
        let sum: u64 = bins.iter().map(|bin| bin.as_u64().expect("a count")).sum();
        assert!(sum > 0 && sum <= samples, "{sum} of {samples} samples counted");
    }
    let whole = histograms
        .iter()
        .filter(|bins| bins.iter().filter_map(Value::as_u64).sum::<u64>() == samples);
    assert!(whole.count() >= 3, "a field of bytes counts every sample");
    assert!(
        volume.to_string().contains("McConnell"),
        "the copyright notice stays with the demo"
    );
}

/// The counts of every histogram anywhere in a description.
fn collect_histograms<'a>(value: &'a Value, found: &mut Vec<&'a Vec<Value>>) {
    match value {
        Value::Object(fields) => {
            for (name, value) in fields {
                match value {
                    Value::Array(counts) if name == "counts" => found.push(counts),
                    other => collect_histograms(other, found),
                }
            }
        }
        Value::Array(values) => values.iter().for_each(|value| collect_histograms(value, found)),
        _ => {}
    }
}

fn extraction(format: &str, beta: f64) -> Value {
    let identity =
        json!([{"x": 0, "importance": 0, "color": "#000000"}, {"x": 1, "importance": 1, "color": "#ffffff"}]);
    // Full-resolution counts are those of marching cubes.
    let mesher = if beta < 0.0 { "marching-cubes" } else { "dual" };
    json!({"volume": demo::ID, "step": 0, "format": format, "mesher": mesher, "iso": demo::ISO, "field": "t1", "feature": "none", "alpha": 0,
        "beta": beta, "maxLevel": 5, "transferFunction": {"points": identity}})
}

#[test]
fn every_format_holds_the_same_surface_in_the_same_place() {
    let Some(address) = server::shared() else { return };
    for (beta, triangles) in [(-1.0, Some(demo::FULL_TRIANGLES)), (0.1, None)] {
        let mut counts = Vec::new();
        let mut extents = Vec::new();
        for (format, kind) in [
            ("ply", ""),
            ("stl", "model/stl"),
            ("vtp", ""),
            ("glb", "model/gltf-binary"),
        ] {
            let answer = http::post_json(address, "/api/v1/extract", &extraction(format, beta));
            assert_eq!(answer.status, 200, "{}", String::from_utf8_lossy(&answer.body));
            assert!(
                kind.is_empty() || answer.content_type == kind,
                "{format} as {}",
                answer.content_type
            );
            let mesh = files::read(format, &answer.body);
            counts.push(mesh.triangles.len() as u64);
            extents.push(mesh.extent());
        }
        assert_eq!(
            counts,
            [triangles.unwrap_or(counts[0]); 4],
            "triangles as PLY, STL, VTP and GLB"
        );
        // GLB is in metres, y up: x, z, −y of the world.
        let glb: [[f64; 3]; 2] = extents.pop().expect("four");
        let [low, high] = glb.map(|[x, y, z]| [1e3 * x, -1e3 * z, 1e3 * y]);
        let glb = [[low[0], high[1], low[2]], [high[0], low[1], high[2]]];
        // An STL has 32 bits.
        let in_32_bits = |extent: [[f64; 3]; 2]| extent.map(|corner| corner.map(|x| x as f32));
        assert_eq!(
            [extents[0], extents[2]].map(in_32_bits),
            [in_32_bits(extents[1]); 2],
            "extent as PLY, VTP and STL"
        );
        let [low, high] = extents[0];
        for (here, there) in extents[0].iter().flatten().zip(glb.iter().flatten()) {
            assert!((here - there).abs() < 1e-3, "{:?}, as GLB {glb:?}", extents[0]);
        }
        // Spacing is 1 mm. In LPS sample (0, 0, 0) is at (98, 134, -72), x and y fall.
        let dims = demo::DIMS.map(|n| f64::from(n) - 1.0);
        for (axis, origin) in [98.0 - dims[0], 134.0 - dims[1], -72.0].into_iter().enumerate() {
            let last = origin + dims[axis];
            assert!(
                low[axis] >= origin && high[axis] <= last,
                "axis {axis}: {low:?} to {high:?}"
            );
            assert!(
                high[axis] - low[axis] > 100.0,
                "a head is larger than that: {low:?} to {high:?}"
            );
        }
    }
}

#[test]
fn extract_and_the_command_write_the_same_bytes_of_stl() {
    let Some(address) = server::shared() else { return };
    let answer = http::post_json(address, "/api/v1/extract", &extraction("stl", 0.02));
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("head.stl");
    let statistics = command::extract_to(&demo_file(), "--iso 100 --beta 0.02", &file);
    assert_leaves(&statistics["leaves"], demo::LEAVES_AT_0_02);
    let (by_rest, by_command) = (
        files::read("stl", &answer.body),
        files::read("stl", &std::fs::read(file).expect("written")),
    );
    assert_eq!(statistics["triangles"], by_command.triangles.len());
    assert_eq!(by_rest.positions, by_command.positions);
}

#[test]
fn what_cannot_be_extracted_is_a_problem_with_a_stable_code() {
    let Some(address) = server::shared() else { return };
    let good = extraction("glb", 0.1);
    let with = |field: &str, value: Value| {
        let mut body = good.clone();
        body[field] = value;
        http::post_json(address, "/api/v1/extract", &body)
    };
    let mut codes = vec![
        with("volume", json!("nothing")).problem(404),
        with("step", json!(1)).problem(404),
        with("format", json!("fbx")).problem(400),
        with("alpha", json!(2)).problem(422),
        with("maxLevel", json!(9)).problem(422),
        with("field", json!("t2")).problem(422),
        with("featureRange", json!([1, 0])).problem(422),
        with("isovalue", json!(3)).problem(400),
        with("transferFunction", json!({"points": []})).problem(422),
    ];
    let post = |content_type: &str, body: &str| http::post(address, "/api/v1/extract", content_type, body);
    codes.push(post("application/json", "{").problem(400));
    codes.push(post("application/json", "[]").problem(400));
    codes.push(post("text/plain", &good.to_string()).problem(415));
    codes.push(post("application/json", &" ".repeat((64 << 10) + 1)).problem(413));
    let stable = |code: &String| !code.is_empty() && code.chars().all(|c| c.is_ascii_lowercase() || c == '-');
    assert!(codes.iter().all(stable), "{codes:?}");
    // after all that it still works
    assert_eq!(http::post_json(address, "/api/v1/extract", &good).status, 200);
}

#[test]
fn equal_requests_have_equal_bytes_which_can_be_resumed() {
    let Some(address) = server::shared() else { return };
    for format in ["glb", "ply", "stl", "vtp"] {
        let body = json!({"volume": demo::ID, "format": format, "iso": 101.5, "triangles": {"share": 0.05}});
        let posted = http::post_json(address, "/api/v1/extract", &body).body;
        let path = format!(
            "/api/v1/extract?volume={}&format={format}&iso=101.5&triangles=%7B%22share%22%3A0.05%7D",
            demo::ID
        );
        let whole = http::get(address, &path);
        assert_eq!(whole.status, 200, "{}", String::from_utf8_lossy(&whole.body));
        assert!(whole.body == posted, "{format}: POST and GET");
        // What follows does not look into the bytes.
        if format != "glb" {
            continue;
        }
        let ask = |method: &str, headers: &[(&str, &str)]| {
            http::send(address, method, &path, headers, b"").expect("an answer")
        };
        let length = whole.body.len();
        let head = ask("HEAD", &[]);
        let of = |answer: &http::Answer| ["content-length", "etag"].map(|name| answer.header(name).to_owned());
        assert_eq!(of(&head), of(&whole), "{format}");
        let etag = whole.header("etag");
        assert!(
            etag.starts_with('"') && head.header("accept-ranges") == "bytes",
            "{etag}"
        );
        assert_eq!(ask("GET", &[("if-none-match", etag)]).status, 304);

        let half = length / 2;
        let rest = ask("GET", &[("range", &format!("bytes={half}-")), ("if-range", etag)]);
        assert_eq!(
            (rest.status, rest.header("content-range")),
            (206, format!("bytes {half}-{}/{length}", length - 1).as_str())
        );
        assert!(rest.body == whole.body[half..], "{format}");
        let of_another = ask("GET", &[("range", "bytes=5-"), ("if-range", "\"another\"")]);
        assert!(of_another.status == 200 && of_another.body == whole.body);
        let beyond = ask("GET", &[("range", &format!("bytes={length}-"))]);
        assert_eq!(beyond.problem(416), "bad-range");

        for encoding in ["zstd", "gzip"] {
            let packed = ask("GET", &[("accept-encoding", encoding)]);
            assert_eq!((packed.status, packed.header("content-encoding")), (200, encoding));
            assert!(
                packed.body.len() < length,
                "{format} as {encoding}: {} bytes of {length}",
                packed.body.len()
            );
            let tag = packed.header("etag");
            assert!(
                tag != etag && packed.header("vary").contains("Accept-Encoding"),
                "{tag}"
            );
            assert_eq!(
                ask("GET", &[("accept-encoding", encoding), ("if-none-match", tag)]).status,
                304
            );
        }
    }
}

#[test]
fn a_surface_without_triangles_is_refused_unless_it_is_allowed() {
    let Some(address) = server::shared() else { return };
    for format in ["glb", "ply", "stl", "vtp"] {
        let mut nothing = extraction(format, 0.1);
        nothing["iso"] = json!(1000);
        let refused = http::post_json(address, "/api/v1/extract", &nothing);
        assert_eq!(refused.problem(422), "empty-surface");
        let detail = refused.json()["detail"].as_str().expect("a detail").to_owned();
        assert!(detail.starts_with("no surface at isovalue 1000"), "{detail}");
        nothing["allowEmpty"] = json!(true);
        let allowed = http::post_json(address, "/api/v1/extract", &nothing);
        assert_eq!(allowed.status, 200, "{}", String::from_utf8_lossy(&allowed.body));
    }
    let by_address = format!("/api/v1/extract?volume={}&format=stl&iso=1000", demo::ID);
    assert_eq!(http::get(address, &by_address).problem(422), "empty-surface");
    let allowed = http::get(address, &format!("{by_address}&allowEmpty=true"));
    assert_eq!((allowed.status, allowed.body.len()), (200, 84));
}

#[test]
fn unknown_paths_and_methods_are_problems_too() {
    let Some(address) = server::shared() else { return };
    http::get(address, "/api/v1/volumes/nothing").problem(404);
    http::get(address, "/api/v1/volumes/%2e%2e%2f%2e%2e%2fetc%2fpasswd").problem(404);
    http::get(address, "/api/v1/nothing").problem(404);
    http::get(address, "/api/v1/extract").problem(400);
    http::post_json(address, "/api/v1/volumes", &json!({})).problem(405);
    // not a WebSocket handshake
    assert!((400..500).contains(&http::get(address, "/api/v1/stream").status));
}

#[test]
fn health_readiness_description_and_client_are_served() {
    let Some(address) = server::shared() else { return };
    assert_eq!(http::get(address, "/healthz").status, 200);
    assert_eq!(http::get(address, "/readyz").status, 200);
    let openapi = http::get(address, "/api/v1/openapi.json").json();
    assert!(
        openapi["openapi"]
            .as_str()
            .is_some_and(|version| version.starts_with("3."))
    );
    for path in [
        "/api/v1/volumes",
        "/api/v1/volumes/{id}",
        "/api/v1/extract",
        "/healthz",
        "/readyz",
    ] {
        assert!(openapi["paths"].get(path).is_some(), "{path} is not described");
    }
    let page = http::get(address, "/");
    assert_eq!(page.status, 200);
    assert!(page.content_type.starts_with("text/html"), "{}", page.content_type);
}
