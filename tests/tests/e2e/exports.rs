//! Properties of exports that other programs expect: orientation, unit, values, and vertices of one sheet each.

use std::collections::HashMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use crate::support::files::FileMesh;
use crate::support::{ball, command, files, server};

/// A ball of 12 samples' radius as NRRD, with high or low values inside, in this unit or none.
fn write(path: &Path, inside: f32, unit: Option<&str>) {
    let mut file = std::fs::File::create(path).expect("a file");
    let units = unit.map_or(String::new(), |unit| {
        format!("space units: \"{unit}\" \"{unit}\" \"{unit}\"\n")
    });
    // For a patient's axes, millimetres are assumed.
    let space = match unit {
        Some(_) => "space: left-posterior-superior",
        None => "space dimension: 3",
    };
    write!(
        file,
        "NRRD0005\ntype: float\ndimension: 3\n{space}\nsizes: 32 32 32\nspace directions: (2,0,0) (0,2,0) (0,0,2)\n\
         space origin: (100,0,0)\n{units}endian: little\nencoding: raw\n\n"
    )
    .expect("written");
    let samples = (0..32_768).flat_map(|i| {
        let at = [i % 32, i / 32 % 32, i / 1024].map(|n| n as f32 - 15.4);
        let radius = at.iter().map(|x| x * x).sum::<f32>().sqrt();
        (inside * (12.1 - radius)).to_le_bytes()
    });
    file.write_all(&samples.collect::<Vec<u8>>()).expect("written");
}

/// The volume that a mesh encloses: below 0 if it is inside out.
fn volume(mesh: &FileMesh) -> f64 {
    let of = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|corner| mesh.positions[corner as usize]);
        let cross = [0, 1, 2].map(|i| b[(i + 1) % 3] * c[(i + 2) % 3] - b[(i + 2) % 3] * c[(i + 1) % 3]);
        (a[0] * cross[0] + a[1] * cross[1] + a[2] * cross[2]) / 6.0
    };
    mesh.triangles.iter().map(of).sum()
}

/// A number in −0.5 to 0.5 of a sample's place.
fn random(at: [f32; 3]) -> f32 {
    let [x, y, z] = at.map(|x| x as u32);
    let hash = (x.wrapping_mul(73_856_093) ^ y.wrapping_mul(19_349_663) ^ z.wrapping_mul(83_492_791))
        .wrapping_mul(2_654_435_761);
    (hash >> 8) as f32 / (1 << 24) as f32 - 0.5
}

struct Setting {
    folder: tempfile::TempDir,
}

impl Setting {
    /// None without a device.
    fn new() -> Option<Self> {
        server::has_device().then(|| Self {
            folder: tempfile::tempdir().expect("a temporary folder"),
        })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Statistics, bytes and mesh of an extraction.
    fn extract(&self, volume: &Path, options: &str, format: &str) -> (serde_json::Value, Vec<u8>, FileMesh) {
        let out = self.path(&format!("out.{format}"));
        let statistics = command::extract_to(volume, options, &out);
        let bytes = std::fs::read(&out).expect("written");
        let mesh = files::read(format, &bytes);
        (statistics, bytes, mesh)
    }
}

#[test]
fn the_outside_of_a_closed_surface_is_away_from_what_it_encloses() {
    let Some(setting) = Setting::new() else { return };
    let [high, low] = ["high.nrrd", "low.nrrd"].map(|name| setting.path(name));
    write(&high, 1.0, Some("mm"));
    write(&low, -1.0, Some("mm"));
    let ball = 4.0 / 3.0 * std::f64::consts::PI * 24.2f64.powi(3);
    for format in ["glb", "ply", "stl", "vtp", "obj"] {
        let in_unit = if format == "glb" { 1e-9 } else { 1.0 };
        let cases = [
            (&low, "", "high", 1.0),
            (&high, "--outward high", "high", -1.0),
            (&high, "", "low", 1.0),
            (&low, "--outward low", "low", -1.0),
            (&low, "--outward high", "high", 1.0),
        ];
        // All with one format: the writers see two kinds, turned and not.
        let cases = if format == "stl" { &cases[..] } else { &cases[..2] };
        for &(volume_file, options, outward, sign) in cases {
            let (statistics, _, mesh) = setting.extract(volume_file, &format!("--iso 0 {options}"), format);
            let share = volume(&mesh) / (ball * in_unit);
            assert!((share / sign - 1.0).abs() < 0.02, "{format} {options}: {share}");
            let shape = &statistics["shape"];
            assert_eq!(
                (&shape["outward"], &shape["isClosed"]),
                (&outward.into(), &true.into()),
                "{format} {options}"
            );
            assert!(
                (shape["volume"].as_f64().expect("a volume") / ball - 1.0).abs() < 0.02,
                "{shape}"
            );
        }
    }
    // A surface that leaves the volume encloses no volume.
    let (open, ..) = setting.extract(&low, "--iso 5", "stl");
    assert_eq!(
        open["shape"],
        serde_json::json!({"outward": "low", "splitVertices": 0, "isClosed": false, "volume": null, "selfIntersections": 0, "cleaned": null})
    );
}

#[test]
fn files_are_in_the_unit_that_their_readers_take_them_for() {
    let Some(setting) = Setting::new() else { return };
    let [micro, none, angstrom] = ["micro.nrrd", "none.nrrd", "angstrom.nrrd"].map(|name| setting.path(name));
    write(&micro, 1.0, Some("µm"));
    write(&none, 1.0, None);
    write(&angstrom, 1.0, Some("angstrom"));
    let width = |mesh: &FileMesh| {
        let [low, high] = mesh.extent();
        high[0] - low[0]
    };
    for (volume, options, format, expected, unit) in [
        (&micro, "", "stl", 48.4e-3, "mm"),
        (&micro, "", "ply", 48.4, "um"),
        (&micro, "", "vtp", 48.4, "um"),
        (&micro, "", "glb", 48.4e-6, "m"),
        (&micro, "--unit mm", "ply", 48.4e-3, "mm"),
        (&micro, "--unit m", "stl", 48.4e-3, "mm"),
        (&micro, "--unit m", "vtp", 48.4e-6, "m"),
        (&none, "", "stl", 48.4, "unknown"),
        (&none, "", "ply", 48.4, "unknown"),
        (&none, "--unit cm", "stl", 484.0, "mm"),
        (&none, "--unit cm", "ply", 48.4, "cm"),
        (&none, "--unit cm", "glb", 0.484, "m"),
        (&angstrom, "", "ply", 48.4, "angstrom"),
        (&angstrom, "", "stl", 48.4e-7, "mm"),
    ] {
        let (statistics, bytes, mesh) = setting.extract(volume, &format!("--iso 0 {options}"), format);
        let found = width(&mesh);
        assert!(
            (found / expected - 1.0).abs() < 0.01,
            "{format} {options}: {found}, expected {expected}"
        );
        let header = match format {
            "stl" => &bytes[..80],
            "ply" => &bytes[..bytes.windows(10).position(|w| w == b"end_header").expect("a header")],
            _ => continue,
        };
        assert!(header.is_ascii());
        let header = String::from_utf8_lossy(header);
        assert_eq!(header.contains("SPACE=LPS"), volume != &none, "{header}");
        assert!(header.contains(&format!("unit {unit}")), "{header}");
        let notice = statistics["notices"][0].as_str().unwrap_or_default();
        assert_eq!(
            notice.contains("declares no unit"),
            unit == "unknown" && format == "stl",
            "{notice}"
        );
    }
    let volume = micro.display().to_string();
    let refused = command::fail(["extract", &volume, "--iso", "0", "--unit", "parsec", "--stats"]);
    assert!(
        refused.contains("unit: \"parsec\", expected one of m, mm, cm, um, nm, km or angstrom"),
        "{refused}"
    );
}

#[test]
fn values_of_fields_are_attributes_in_their_units() {
    let Some(setting) = Setting::new() else { return };
    let folder = setting.path("fields");
    std::fs::create_dir(&folder).expect("a folder");
    let dims = [40, 36, 34];
    let value = |[x, y, z]: [f32; 3]| 12.3 - ((x - 19.0).powi(2) + (y - 17.5).powi(2) + (z - 16.0).powi(2)).sqrt();
    ball::write_field(&folder.join("ball.npy"), dims, value);
    // Linear, so that it is known between samples.
    ball::write_field(&folder.join("temp 1.npy"), dims, |[x, y, z]| {
        300.0 + x - 2.0 * y + 0.5 * z
    });
    for options in ["", "--cap"] {
        let options = format!("--field ball --iso 0 --beta -1 --field-values {options}");
        let out = setting.path("out.ply");
        let words = options.split_whitespace().map(String::from);
        let line = ["extract".to_owned(), folder.display().to_string()];
        let line = line.into_iter().chain(words.flat_map(|word| match word.as_str() {
            "--field-values" => vec![word, "temp 1, max(0*ball,7)".to_owned()],
            _ => vec![word],
        }));
        command::succeed(line.chain(["-o".to_owned(), out.display().to_string()]));
        let bytes = std::fs::read(&out).expect("written");
        let end = bytes.windows(11).position(|w| w == b"end_header\n").expect("a header") + 11;
        let header = String::from_utf8_lossy(&bytes[..end]);
        assert!(header.contains("property float temp_1\n"), "{header}");
        assert!(
            header.contains("comment field: temp_1 is temp 1, unit unknown"),
            "{header}"
        );
        assert!(header.contains("is max(0*ball,7), unit unknown"), "{header}");
        let mesh = files::read("ply", &bytes);
        for (row, position) in bytes[end..].chunks_exact(52).zip(&mesh.positions) {
            assert_eq!(row[48..], 7f32.to_le_bytes(), "an expression's value");
            let found = f64::from(f32::from_le_bytes(row[44..48].try_into().expect("four bytes")));
            let expected = 300.0 + position[0] - 2.0 * position[1] + 0.5 * position[2];
            assert!(
                (found - expected).abs() < 1e-3,
                "{found}, expected {expected} at {position:?}"
            );
        }
    }
    let path = folder.display().to_string();
    let refused = command::fail(["extract", &path, "--iso", "0", "--field-values", "heat", "--stats"]);
    assert!(
        refused.contains("fieldValues: \"heat\", expected some of \"ball\", \"temp 1\""),
        "{refused}"
    );
}

#[test]
fn the_surface_of_a_label_is_around_its_samples() {
    let Some(setting) = Setting::new() else { return };
    let labels = setting.path("labels.npy");
    let balls = [
        (1.0, [10.0, 10.0, 10.0]),
        (2.0, [22.0, 20.0, 20.0]),
        (7.0, [10.0, 22.0, 20.0]),
    ];
    ball::write_field(&labels, [32, 32, 32], |at| {
        let is_in = |centre: &[f32; 3]| (0..3).map(|i| (at[i] - centre[i]).powi(2)).sum::<f32>() < 25.0;
        balls
            .iter()
            .find(|(_, centre)| is_in(centre))
            .map_or(0.0, |(label, _)| *label)
    });
    for (label, centres) in [("7", &balls[2..]), ("1,2", &balls[..2])] {
        let (statistics, _, mesh) = setting.extract(&labels, &format!("--label {label} --beta -1"), "ply");
        assert_eq!(statistics["shape"]["isClosed"], true, "{label}");
        for position in &mesh.positions {
            let near = |(_, centre): &(f32, [f32; 3])| {
                let square = |i: usize| (position[i] - f64::from(centre[i])).powi(2);
                ((0..3).map(square).sum::<f64>().sqrt() - 5.0).abs() < 1.5
            };
            assert!(centres.iter().any(near), "{label}: {position:?}");
        }
        let volume = volume(&mesh) / centres.len() as f64;
        assert!((450.0..600.0).contains(&volume), "{label}: {volume}");
    }
    // Smoothed, on even ground and with caps: vertices are nearer to one sphere.
    let spread = |options: &str| {
        let (statistics, _, mesh) = setting.extract(&labels, &format!("--label 7 --beta -1 {options}"), "ply");
        assert_eq!(statistics["shape"]["isClosed"], true, "{options}");
        let radius = |at: &[f64; 3]| {
            let square = |i: usize| (at[i] - f64::from(balls[2].1[i])).powi(2);
            (0..3).map(square).sum::<f64>().sqrt()
        };
        let radii = mesh.positions.iter().map(radius);
        radii.clone().fold(0.0, f64::max) - radii.fold(f64::INFINITY, f64::min)
    };
    let exact = spread("");
    for options in ["--label-smoothing 0.8", "--label-smoothing 0.8 --cap"] {
        let smoothed = spread(options);
        assert!(smoothed < 0.7 * exact, "{options}: {smoothed}, {exact} without");
    }
    let path = labels.display().to_string();
    let out = setting.path("none.stl").display().to_string();
    let empty = command::run(["extract", &path, "--label", "5", "-o", &out]);
    assert_eq!(
        empty.status.code(),
        Some(3),
        "{}",
        String::from_utf8_lossy(&empty.stderr)
    );
    let refused = command::fail(["extract", &path, "--label", "Pons", "--stats"]);
    assert!(
        refused.contains("label: \"Pons\", expected a whole number or a name"),
        "{refused}"
    );
}

/// Vertices whose triangles are not connected by edges at it.
fn pinched(mesh: &FileMesh) -> usize {
    let mut around: HashMap<u32, Vec<[u32; 2]>> = HashMap::new();
    for &[a, b, c] in &mesh.triangles {
        for (at, ends) in [(a, [b, c]), (b, [c, a]), (c, [a, b])] {
            around.entry(at).or_default().push(ends);
        }
    }
    let is_pinched = |ends: &Vec<[u32; 2]>| {
        let mut seen = vec![ends[0][0], ends[0][1]];
        loop {
            let before = seen.len();
            for pair in ends {
                if pair.iter().any(|end| seen.contains(end)) {
                    seen.extend(
                        pair.iter()
                            .filter(|end| !seen.contains(end))
                            .copied()
                            .collect::<Vec<_>>(),
                    );
                }
            }
            if seen.len() == before {
                return ends.iter().any(|pair| !seen.contains(&pair[0]));
            }
        }
    };
    around.values().filter(|ends| is_pinched(ends)).count()
}

#[test]
fn a_vertex_is_of_one_sheet() {
    let Some(setting) = Setting::new() else { return };
    let noise = setting.path("noise.npy");
    ball::write_field(&noise, [24, 22, 20], |at| {
        let [x, y, z] = at;
        if x.min(y).min(z) == 0.0 || x == 23.0 || y == 21.0 || z == 19.0 {
            return -1.0;
        }
        random(at)
    });

    for options in [
        "--beta -1",
        "--beta 0.1",
        "--triangles 60%",
        "--mesher marching-cubes --beta -1",
    ] {
        let (statistics, _, mesh) = setting.extract(&noise, &format!("--iso 0.013 {options}"), "ply");
        assert!(mesh.triangles.len() > 1_000, "{options}");
        assert_eq!(pinched(&mesh), 0, "{options}");
        let of_file =
            ["/vertices", "/shape/splitVertices"].map(|name| statistics.pointer(name).and_then(|n| n.as_u64()));
        assert_eq!(
            of_file[0].zip(of_file[1]).map(|(a, b)| a + b),
            Some(mesh.positions.len() as u64),
            "{options}"
        );
    }
}

#[test]
fn clean_files_have_no_triangles_that_intersect() {
    let Some(setting) = Setting::new() else { return };
    // A ball whose surface is rough, which the faces of the volume cut.
    let noise = setting.path("rough.npy");
    ball::write_field(&noise, [24, 22, 20], |at| {
        let [x, y, z] = at;
        let radius = ((x - 11.0).powi(2) + (y - 10.0).powi(2) + (z - 9.0).powi(2)).sqrt();
        9.6 - radius + 1.6 * random(at)
    });
    let number = |statistics: &serde_json::Value, name: &str| statistics.pointer(name).and_then(|n| n.as_u64());
    let (plain, ..) = setting.extract(&noise, "--iso 0.013 --cap --triangles 60%", "ply");
    let found = number(&plain, "/shape/selfIntersections").expect("counted");
    assert!(found > 0, "nothing to do");
    for format in ["ply", "stl"] {
        let (clean, _, mesh) = setting.extract(&noise, "--iso 0.013 --cap --triangles 60% --clean", format);
        assert_eq!(number(&clean, "/shape/selfIntersections"), Some(0), "{format}");
        let [before, after, rounds] = ["trianglesBefore", "trianglesAfter", "rounds"]
            .map(|name| number(&clean, &format!("/shape/cleaned/{name}")));
        assert_eq!(before, number(&plain, "/shape/cleaned/trianglesBefore"));
        assert_eq!(after, Some(mesh.triangles.len() as u64));
        assert!(
            after <= before.map(|before| before + before / 50) && rounds > Some(0),
            "{format}: {clean}"
        );
        assert_eq!(piercing(&mesh), 0, "{format}");
    }
    let (unmeasured, ..) = setting.extract(&noise, "--iso 0.013 --triangles 60% --no-measure", "ply");
    assert_eq!(
        unmeasured.pointer("/shape/selfIntersections"),
        Some(&serde_json::Value::Null)
    );
}

#[test]
fn caps_add_no_triangles_that_intersect() {
    let Some(setting) = Setting::new() else { return };
    let gyroid = setting.path("gyroid.npy");
    ball::write_field(&gyroid, [40; 3], |at| {
        let [x, y, z] = at.map(|x| x * std::f32::consts::PI / 8.0);
        x.sin() * y.cos() + y.sin() * z.cos() + z.sin() * x.cos()
    });
    let number = |statistics: &serde_json::Value, name: &str| statistics.pointer(name).and_then(|n| n.as_u64());
    for (options, what) in [("--triangles 25%", "rounds"), ("--beta 0.1", "movedVertices")] {
        let (open, ..) = setting.extract(&gyroid, &format!("--iso 0 {options}"), "ply");
        assert_eq!(number(&open, "/shape/selfIntersections"), Some(0), "{options}");
        assert_eq!(open.pointer("/shape/cleaned"), Some(&serde_json::Value::Null));
        let (capped, _, mesh) = setting.extract(&gyroid, &format!("--iso 0 --cap {options}"), "ply");
        assert_eq!(number(&capped, "/shape/selfIntersections"), Some(0), "{options}");
        assert!(
            number(&capped, &format!("/shape/cleaned/{what}")) > Some(0),
            "nothing to do: {options}"
        );
        // By less than triangles are long, although some vertices stand for cubes of 16 cells.
        let moved = capped.pointer("/shape/cleaned/largestMove").and_then(|n| n.as_f64());
        assert!(moved.is_some_and(|moved| moved < 2.5), "{options}: {moved:?}");
        // Nothing was moved out of the volume, whose faces are closed.
        let all = || mesh.positions.iter().flatten();
        assert!(all().all(|at| (0.0..=39.0).contains(at)), "{options}");
        assert!(all().filter(|&&at| at == 39.0).count() > 50, "{options}");
        let (bounded, ..) = setting.extract(&gyroid, &format!("--iso 0 --cap {options} --measure 60"), "ply");
        assert_eq!(bounded.pointer("/error"), capped.pointer("/error"), "{options}");
    }
    // In large cubes a cap also changes vertices that are far from it.
    let wide = setting.path("wide.npy");
    ball::write_field(&wide, [129; 3], |at| {
        let [x, y, z] = at.map(|x| x * std::f32::consts::PI / 16.0);
        x.sin() * y.cos() + y.sin() * z.cos() + z.sin() * x.cos()
    });
    let (capped, ..) = setting.extract(&wide, "--iso 0 --cap --beta 0.2 --no-measure", "ply");
    assert_eq!(number(&capped, "/shape/selfIntersections"), Some(0), "{capped}");
    assert!(
        number(&capped, "/shape/cleaned/movedVertices") > Some(0),
        "nothing to do"
    );
}

/// Counts edges that pierce a triangle without a common corner, over all pairs. Not exact: edges and triangles that hardly meet are left
/// out.
fn piercing(mesh: &FileMesh) -> usize {
    let at = |corner: u32| mesh.positions[corner as usize];
    let minus = |a: [f64; 3], b: [f64; 3]| [0, 1, 2].map(|i| a[i] - b[i]);
    let volume = |a: [f64; 3], b: [f64; 3], c: [f64; 3], d: [f64; 3]| {
        let [u, v, w] = [minus(b, a), minus(c, a), minus(d, a)];
        let cross = [0, 1, 2].map(|i| u[(i + 1) % 3] * v[(i + 2) % 3] - u[(i + 2) % 3] * v[(i + 1) % 3]);
        cross[0] * w[0] + cross[1] * w[1] + cross[2] * w[2]
    };
    let pierces = |[p, q]: [u32; 2], [a, b, c]: [u32; 3]| {
        let corners = [a, b, c].map(at);
        let [from, to] = [p, q].map(at);
        let is_near = |i: usize| {
            let [low, high] = [f64::min, f64::max].map(|of| corners.iter().map(|x| x[i]).reduce(of).expect("corners"));
            from[i].min(to[i]) <= high && from[i].max(to[i]) >= low
        };
        let ends = [p, q].map(at);
        if !(0..3).all(is_near) || corners.iter().any(|corner| ends.contains(corner)) {
            return false;
        }
        let [a, b, c] = corners;
        let sides = [volume(a, b, c, from), volume(a, b, c, to)];
        let turns = [volume(from, to, a, b), volume(from, to, b, c), volume(from, to, c, a)];
        let clear = 1e-9;
        sides[0] * sides[1] < -clear
            && (turns.iter().all(|turn| *turn > clear) || turns.iter().all(|turn| *turn < -clear))
    };
    let edges = mesh
        .triangles
        .iter()
        .flat_map(|[a, b, c]| [[*a, *b], [*b, *c], [*c, *a]]);
    let edges = edges.filter(|[a, b]| a < b);
    edges
        .map(|edge| {
            mesh.triangles
                .iter()
                .filter(|triangle| pierces(edge, **triangle))
                .count()
        })
        .sum()
}

/// The JSON of a GLB.
fn gltf(bytes: &[u8]) -> serde_json::Value {
    let length = u32::from_le_bytes(bytes[12..16].try_into().expect("four bytes")) as usize;
    serde_json::from_slice(&bytes[20..20 + length]).expect("JSON")
}

#[test]
fn several_surfaces_are_nodes_of_one_file() {
    let Some(setting) = Setting::new() else { return };
    let [high, low] = ["high.nrrd", "low.nrrd"].map(|name| setting.path(name));
    write(&high, 1.0, Some("mm"));
    write(&low, -1.0, Some("mm"));
    let out = setting.path("out.glb");
    let skin = r##"{"name":"skin","color":"#ff0000","opacity":0.5}"##.to_owned();
    let other = serde_json::json!({"iso": -5, "volume": low});
    let inner = r#"{"iso":5,"error":"0.5vx"}"#.to_owned();
    let line = |out: &Path, format: &str| {
        let mut line = vec!["extract".to_owned(), high.display().to_string()];
        line.extend(["--iso", "0", "--error", "0.1vx", "--stats", "--format", format].map(str::to_owned));
        for surface in [&skin, &other.to_string(), &inner] {
            line.extend(["--surface".to_owned(), surface.clone()]);
        }
        line.extend(["-o".to_owned(), out.display().to_string()]);
        line
    };
    let printed = command::succeed(line(&out, "glb"));
    let statistics: serde_json::Value = serde_json::from_str(&printed).expect("one JSON object");
    let json = gltf(&std::fs::read(&out).expect("written"));
    let names: Vec<_> = (0..3)
        .map(|node| json["nodes"][node]["name"].as_str().expect("a name"))
        .collect();
    assert_eq!(names, ["skin", "low: low = -5", "high: high = 5"]);
    let triangles = |mesh: usize| {
        let accessor = json["meshes"][mesh]["primitives"][0]["indices"]
            .as_u64()
            .expect("indices");
        json["accessors"][accessor as usize]["count"].as_u64().expect("a count") / 3
    };
    let alone = setting.path("alone.glb");
    for (mesh, volume, options) in [
        (0, &high, "--iso 0 --error 0.1vx"),
        (1, &low, "--iso -5 --error 0.1vx"),
        (2, &high, "--iso 5 --error 0.5vx"),
    ] {
        let one = command::extract_to(volume, options, &alone);
        assert_eq!(one["triangles"].as_u64(), Some(triangles(mesh)), "{options}");
    }
    assert_eq!(statistics["triangles"].as_u64(), Some((0..3).map(triangles).sum()));
    assert_eq!(json["materials"][0]["alphaMode"], "BLEND");
    let extras = json["asset"]["extras"]["surfaces"].as_array().expect("surfaces");
    assert_eq!((extras.len(), &extras[1]["volume"]), (3, &"low".into()));
    for format in ["3mf", "obj", "precomputed", "usdz"] {
        command::succeed(line(&setting.path("out.any"), format));
    }
    let refused = command::fail(line(&setting.path("out.ply"), "ply"));
    assert!(
        refused.contains("surfaces: 3 surfaces in a PLY, expected one"),
        "{refused}"
    );
}

#[test]
fn errors_on_stdin_name_no_temporary_file() {
    for command in [
        "info -",
        "extract - --stats",
        "slice - --axis z --index 0 -o /dev/null --format png",
    ] {
        let said = command::fail(command.split(' '));
        assert!(
            said.contains("error: stdin: file: is empty, expected a volume"),
            "{said}"
        );
    }
}

#[test]
fn a_volume_comes_from_stdin_and_a_file_goes_to_stdout() {
    let Some(setting) = Setting::new() else { return };
    let volume = setting.path("ball.nrrd");
    write(&volume, 1.0, Some("mm"));
    let run = |options: &str| {
        std::process::Command::new(command::binary())
            .args("extract - --iso 0 -o -".split(' ').chain(options.split_whitespace()))
            .stdin(std::fs::File::open(&volume).expect("a file"))
            .output()
            .expect("the binary starts")
    };
    let piped = run("--format stl");
    assert!(piped.status.success(), "{}", String::from_utf8_lossy(&piped.stderr));
    let out = setting.path("out.stl");
    command::extract_to(&volume, "--iso 0", &out);
    assert!(piped.stdout == std::fs::read(&out).expect("written"));
    for (options, expected) in [
        ("", "-o - does not say the format"),
        ("--format stl --stats", "both are for stdout"),
    ] {
        let refused = run(options);
        let said = String::from_utf8_lossy(&refused.stderr);
        assert!(!refused.status.success() && said.contains(expected), "{said}");
    }
}

#[test]
fn an_error_is_measured_unless_that_is_not_asked_for() {
    let Some(setting) = Setting::new() else { return };
    let volume = setting.path("ball.nrrd");
    write(&volume, 1.0, Some("mm"));
    let (whole, bytes, _) = setting.extract(&volume, "--iso 0 --error 0.3vx", "ply");
    let (bounded, of_bounded, _) = setting.extract(&volume, "--iso 0 --error 0.3vx --measure 600", "ply");
    let (none, of_none, _) = setting.extract(&volume, "--iso 0 --error 0.3vx --no-measure", "ply");
    assert_eq!(whole["error"], bounded["error"]);
    assert!(
        whole["error"]["max"].as_f64() > Some(0.0) && none["error"].is_null(),
        "{none}"
    );
    assert!(bytes == of_bounded && bytes == of_none, "the surface is the same");
    let (late, ..) = setting.extract(&volume, "--iso 0 --error 0.3vx --measure 1e-9", "ply");
    assert!(late["error"].is_null(), "{late}");
    let notice = late["notices"][0].as_str().expect("a notice");
    assert!(notice.starts_with("the error was not measured"), "{notice}");
}
