//! The commands, as a user types them.

use std::ffi::OsStr;
use std::io::Write;
use std::path::Path;

use crate::support::{assert_leaves, ball, command, demo, demo_file, files, server};

fn words<'a>(line: &'a str, path: &'a Path) -> impl Iterator<Item = &'a OsStr> {
    line.split_whitespace().map(move |word| {
        if word == "FILE" {
            path.as_os_str()
        } else {
            OsStr::new(word)
        }
    })
}

#[test]
fn extract_writes_what_its_statistics_count() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    for format in ["glb", "ply", "stl", "vtp"] {
        let out = folder.path().join(format!("brain.{format}"));
        let statistics = command::extract_to(&demo_file(), "--iso 100 --beta 0.1", &out);
        assert_eq!(statistics["fullTriangles"], demo::FULL_TRIANGLES);
        assert_leaves(&statistics["leaves"], demo::LEAVES_AT_0_1);
        let mesh = files::read(format, &std::fs::read(&out).expect("the file is written"));
        assert_eq!(statistics["triangles"], mesh.triangles.len(), "{format}");
    }
}

/// Uses an isovalue that no sample has. At a sample with the isovalue, the crossings of several edges are one point, which a file cannot
/// tell apart.
#[test]
fn the_vertices_of_a_file_are_those_that_the_statistics_count() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    for beta in ["-1", "0.02", "0.1"] {
        let out = folder.path().join("brain.glb");
        let statistics = command::extract_to(&demo_file(), &format!("--iso 100.5 --beta {beta}"), &out);
        let mesh = files::read("glb", &std::fs::read(&out).expect("the file is written"));
        let of_file =
            ["/vertices", "/shape/splitVertices"].map(|name| statistics.pointer(name).and_then(|n| n.as_u64()));
        assert_eq!(
            of_file[0].zip(of_file[1]).map(|(a, b)| a + b),
            Some(mesh.positions.len() as u64),
            "at β = {beta}"
        );
    }
}

/// Cells without a sample outside the mask that the surface crosses, counted here.
fn cells_inside(dims: [u32; 3], value: impl Fn([f32; 3]) -> f32, label: impl Fn([f32; 3]) -> f32) -> u64 {
    let cells = |n: u32| 0..n - 1;
    let all = cells(dims[2]).flat_map(|z| cells(dims[1]).flat_map(move |y| cells(dims[0]).map(move |x| [x, y, z])));
    let is_active = |cell: &[u32; 3]| {
        let corners: Vec<_> = (0..8)
            .map(|b| [0, 1, 2].map(|i| (cell[i] + (b >> i & 1)) as f32))
            .collect();
        let above = corners.iter().filter(|&&corner| value(corner) >= 0.0).count();
        (1..8).contains(&above) && corners.iter().all(|&corner| label(corner) == 3.0)
    };
    all.filter(is_active).count() as u64
}

#[test]
fn a_mask_restricts_the_surface_to_whole_cells_inside() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let dims = [40, 36, 34];
    let value = |[x, y, z]: [f32; 3]| 12.3 - ((x - 19.0).powi(2) + (y - 17.5).powi(2) + (z - 16.0).powi(2)).sqrt();
    let label = |[x, y, _]: [f32; 3]| if x + 0.5 * y < 25.0 { 3.0 } else { 1.0 };
    ball::write_field(&folder.path().join("ball.npy"), dims, value);
    ball::write_field(&folder.path().join("labels.npy"), dims, label);
    let out = folder.path().join("masked.glb");
    let extract = |options: &str| {
        command::extract_to(
            folder.path(),
            &format!("--field ball --iso 0 --beta 0.3 {options}"),
            &out,
        )
    };
    let whole = extract("");
    let half = extract("--mask labels==3");
    let inside = cells_inside(dims, value, label);
    assert!(0 < inside && inside < whole["activeCells"].as_u64().expect("a count"));
    assert_eq!(half["activeCells"], inside);
    for same in ["labels>1", "labels!=1", "labels==2..5"] {
        assert_eq!(
            extract(&format!("--mask {same}"))["triangles"],
            half["triangles"],
            "{same}"
        );
    }
    // The border of a mask is treated as that of a hole: it is not decimated, even if the rest is coarse.
    assert!(half["leaves"][0].as_u64() > Some(100), "{half}");
    assert_eq!(
        extract("--mask labels>1 --feature gradient-magnitude")["activeCells"],
        inside
    );
    let path = folder.path();
    let line = [
        "extract".as_ref(),
        path.as_os_str(),
        "--iso".as_ref(),
        "0".as_ref(),
        "--stats".as_ref(),
        "--mask".as_ref(),
        OsStr::new("labels=3"),
    ];
    let said = command::fail(line);
    assert!(said.contains("character 9: expected ==, !="), "{said}");
}

/// One image as ITK writes it in each of its formats, of a patient who lies askew.
#[test]
fn an_image_has_its_surface_in_one_place_whatever_its_format() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let volumes = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/volumes");
    let mesh = |name: &str| {
        let out = folder.path().join("surface.ply");
        command::extract_to(&volumes.join(name), "--iso 40.5 --beta -1", &out);
        files::read("ply", &std::fs::read(&out).expect("the file is written"))
    };
    let nrrd = mesh("itk.nrrd");
    assert!(nrrd.triangles.len() > 50, "{nrrd:?}");
    for name in ["itk.mha", "itk.nii", "itk.nii.gz", "dicom/itk"] {
        let other = mesh(name);
        assert_eq!(other.triangles, nrrd.triangles, "{name}");
        for (a, b) in other.positions.iter().zip(&nrrd.positions) {
            let apart = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(apart < 1e-4, "{name}: {a:?}, in NRRD {b:?}");
        }
    }
}

/// A ball of 30 samples across, as NRRD in metres, with the same spacing along all axes.
fn write_ball(path: &Path, spacing: f64, origin: [f64; 3]) {
    let mut file = std::fs::File::create(path).expect("a file");
    let [x, y, z] = origin;
    write!(
        file,
        "NRRD0005\ntype: float\ndimension: 3\nspace dimension: 3\nsizes: 40 40 40\nspace directions: ({spacing:e},0,0) (0,{spacing:e},0) \
         (0,0,{spacing:e})\nspace origin: ({x:e},{y:e},{z:e})\nspace units: \"m\" \"m\" \"m\"\nendian: little\nencoding: raw\n\n"
    )
    .expect("written");
    let samples = (0..64_000).flat_map(|i| {
        let at = [i % 40, i / 40 % 40, i / 1600].map(|n| f64::from(n) - 19.3);
        let radius = at.iter().map(|x| x * x).sum::<f64>().sqrt();
        ((15.2 - radius) as f32).to_le_bytes()
    });
    file.write_all(&samples.collect::<Vec<u8>>()).expect("written");
}

#[test]
fn a_surface_far_from_the_origin_is_as_exact_as_near_it() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    // Cells of 5 cm in coordinates of UTM.
    let origin = [500_000.0, 4.6e6, 120.0];
    let [near, far] = ["near.nrrd", "far.nrrd"].map(|name| folder.path().join(name));
    write_ball(&near, 0.05, [0.0; 3]);
    write_ball(&far, 0.05, origin);
    for format in ["glb", "ply", "vtp", "stl"] {
        let mesh = |volume: &Path| {
            let out = folder.path().join(format!("ball.{format}"));
            let statistics = command::extract_to(volume, "--iso 0 --triangles 20%", &out);
            (statistics, files::read(format, &std::fs::read(&out).expect("written")))
        };
        let ((_, near), (statistics, far)) = (mesh(&near), mesh(&far));
        assert_eq!(near.triangles, far.triangles, "{format}");
        let [x, y, z] = origin;
        let moved = match format {
            "glb" => [x, z, -y],
            // In millimetres.
            "stl" => origin.map(|x| 1e3 * x),
            _ => origin,
        };
        let pairs = near.positions.iter().zip(&far.positions);
        let apart = pairs.flat_map(|(near, far)| [0, 1, 2].map(|i| (near[i] + moved[i] - far[i]).abs()));
        let largest = apart.fold(0.0, f64::max);
        let notices = &statistics["notices"];
        if format == "stl" {
            let said = notices[0].as_str().expect("a notice");
            assert!(
                said.contains("rounded by up to 2.") && said.contains("e2 mm, 5."),
                "{said}"
            );
            assert!((100.0..300.0).contains(&largest), "{largest}");
        } else {
            assert!(largest < 1e-5, "{format}: {largest} m");
            assert!(notices.is_null(), "{notices}");
        }
    }
}

#[test]
fn a_surface_is_the_same_at_any_spacing() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = folder.path().join("ball.ply");
    let volume = folder.path().join("ball.nrrd");
    for options in [
        "--beta -1",
        "--triangles 10%",
        "--feature gradient-magnitude --triangles 20%",
        "--mesher marching-cubes",
    ] {
        let made = |spacing: f64| {
            write_ball(&volume, spacing, [0.0; 3]);
            let statistics = command::extract_to(&volume, &format!("--iso 0 {options}"), &out);
            let mesh = files::read("ply", &std::fs::read(&out).expect("written"));
            let error = statistics["error"]["rms"].as_f64().map(|rms| rms / spacing);
            (mesh, error)
        };
        let (unit, error) = made(1.0);
        for exponent in [-30, 30] {
            let spacing = 10f64.powi(exponent);
            let (mesh, error_here) = made(spacing);
            assert_eq!(mesh.triangles, unit.triangles, "{options} at 1e{exponent}");
            let pairs = mesh.positions.iter().zip(&unit.positions);
            let apart = pairs.flat_map(|(here, there)| [0, 1, 2].map(|i| (here[i] / spacing - there[i]).abs()));
            let largest = apart.fold(0.0, f64::max);
            assert!(largest < 1e-5, "{options} at 1e{exponent}: {largest} spacings");
            if let (Some(error), Some(here)) = (error, error_here) {
                assert!(
                    (here / error - 1.0).abs() < 1e-5,
                    "{options} at 1e{exponent}: {here}, at 1 {error}"
                );
            }
        }
    }
}

#[test]
fn a_surface_without_triangles_is_an_exit_code_and_no_file() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (format, bytes) in [("glb", 12), ("ply", 4), ("stl", 84), ("vtp", 5)] {
        let out = folder.path().join(format!("none.{format}"));
        let line = "extract FILE --iso 1000 --stats -o".to_owned();
        let file = demo_file();
        let arguments = || words(&line, &file).chain([out.as_os_str()]);
        let refused = command::run(arguments());
        let said = String::from_utf8_lossy(&refused.stderr);
        assert_eq!(refused.status.code(), Some(3), "{said}");
        assert!(
            said.contains("no surface at isovalue 1000: values of \"t1\" go from 0 to"),
            "{said}"
        );
        assert!(!out.exists() && std::fs::read_dir(folder.path()).expect("a folder").count() == 0);
        assert!(String::from_utf8_lossy(&refused.stdout).contains("\"triangles\":0"));

        command::succeed(arguments().chain([OsStr::new("--allow-empty")]));
        let written = std::fs::read(&out).expect("the file is written");
        assert!(written.len() >= bytes, "{format}: {} bytes", written.len());
        std::fs::remove_file(&out).expect("removed");
    }
    // If triangles are only counted, none is a valid result.
    let counted = command::extract(["--iso".as_ref(), "1000".as_ref(), demo_file().as_os_str()]);
    assert_eq!(counted["triangles"], 0);
}

#[test]
fn a_beta_below_zero_gives_the_full_surface() {
    if !server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = folder.path().join("full.stl");
    let statistics = command::extract_to(&demo_file(), "--iso 100 --beta -1 --mesher marching-cubes", &out);
    assert_eq!(statistics["triangles"], demo::FULL_TRIANGLES);
}

#[test]
fn bad_arguments_and_bad_files_are_refused_by_name() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = folder.path().join("out.glb");
    let extract = |path: &Path, rest: &str| {
        let line = format!("extract FILE {rest} -o");
        command::fail(words(&line, path).chain([out.as_os_str()]))
    };
    let demo_file = demo_file();
    assert!(extract(&folder.path().join("nothing.nrrd"), "--iso 1").contains("nothing.nrrd"));
    assert!(extract(&demo_file, "--iso abc").contains("--iso"));
    assert!(extract(&demo_file, "--iso 100 --alpha 2").contains("alpha"));
    assert!(extract(&demo_file, "--iso 100 --max-level 9").contains("level"));
    assert!(extract(&demo_file, "--iso 100 --field nothing").contains("nothing"));
    assert!(extract(&demo_file, "--iso 100 --feature nothing").contains("nothing"));
    let line = "extract FILE --iso 100 -o out.xyz";
    assert!(command::fail(words(line, &demo_file)).contains("out.xyz"));

    // a header that claims 64 GB of samples over 4 bytes: refused at once, nothing that large allocated
    let lying = folder.path().join("lying.nrrd");
    let mut file = std::fs::File::create(&lying).expect("a file");
    file.write_all(
        b"NRRD0004\ntype: float\ndimension: 3\nsizes: 4000 4000 1000\nencoding: raw\nendian: little\n\n1234",
    )
    .expect("written");
    drop(file);
    let start = std::time::Instant::now();
    let said = extract(&lying, "--iso 1");
    assert!(said.contains("lying.nrrd"), "{said}");
    assert!(start.elapsed().as_secs() < 5, "refused after {:?}", start.elapsed());
    assert!(!out.exists(), "a refused extraction leaves no file");
}

#[test]
fn info_describes_a_file_and_a_folder() {
    let said = command::succeed([OsStr::new("info"), demo_file().as_os_str()]);
    for expected in ["197", "233", "189", "u8", "t1"] {
        assert!(said.contains(expected), "{expected} in {said}");
    }
    let folder = demo_file();
    let folder = folder.parent().expect("a folder");
    let said = command::succeed([OsStr::new("info"), folder.as_os_str()]);
    for field in ["t1", "gm", "wm"] {
        assert!(said.contains(field), "{field} in {said}");
    }
}

#[test]
fn info_says_what_the_positions_along_axes_are() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/volumes/named_longitude.nc");
    let said = command::succeed([OsStr::new("info"), file.as_os_str()]);
    assert!(said.contains("along x     lon (longitude): 358 to 364 °\n"), "{said}");
}

#[test]
fn devices_lists_what_there_is() {
    if !server::has_device() {
        return;
    }
    let said = command::succeed(["devices"]);
    let devices = isopeel_kernels::device::list().expect("there is a device");
    for device in devices {
        assert!(said.contains(&device.name), "{} in {said}", device.name);
    }
}

#[test]
fn help_and_version_are_there() {
    for line in [
        "--help",
        "serve --help",
        "extract --help",
        "info --help",
        "devices --help",
        "--version",
    ] {
        assert!(!command::succeed(line.split_whitespace()).is_empty(), "{line}");
    }
    let help = command::succeed(["extract", "--help"]);
    for option in [
        "--iso",
        "--field",
        "--feature",
        "--feature-range",
        "--alpha",
        "--beta",
        "--transfer-function",
        "--max-level",
        "--stats",
    ] {
        assert!(help.contains(option), "{option} in {help}");
    }
}

/// PoCL needs a folder for compiled kernels. If the folder is unusable, another one is used, with a warning.
#[test]
fn without_a_folder_for_kernels_another_one_is_used() {
    use std::os::unix::fs::PermissionsExt;
    if !crate::support::server::has_device() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let open = folder.path().join("open");
    std::fs::create_dir(&open).expect("a folder");
    std::fs::set_permissions(&open, PermissionsExt::from_mode(0o777)).expect("its mode");
    for (name, value, why) in [
        ("POCL_CACHE_DIR", "/proc/nowhere", "/proc/nowhere"),
        ("HOME", "/proc/nowhere", "/proc/nowhere"),
        ("HOME", "", "HOME is not set"),
        ("POCL_CACHE_DIR", open.to_str().expect("text"), "others may write there"),
    ] {
        let output = std::process::Command::new(command::binary())
            .arg("devices")
            .env_remove("POCL_CACHE_DIR")
            .env_remove("XDG_CACHE_HOME")
            .env("TMPDIR", folder.path())
            .env(name, value)
            .output()
            .expect("the binary starts");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(
            output.status.success() && !output.stdout.is_empty(),
            "{name}={value}: {said}"
        );
        assert!(
            said.contains(why) && said.contains("isopeel-kernels-"),
            "{name}={value}: {said}"
        );
    }
    let mut folders = std::fs::read_dir(folder.path()).expect("a folder");
    let made = folders.find_map(|entry| {
        let entry = entry.expect("an entry");
        let is_spare = entry.file_name().to_string_lossy().starts_with("isopeel-kernels-");
        is_spare.then(|| entry.metadata().expect("metadata").permissions().mode() & 0o777)
    });
    assert_eq!(made, Some(0o700));
}

#[test]
fn folders_that_others_may_use_and_uploads_that_all_would_see_are_refused() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().expect("a folder");
    let [state, served] = ["state", "served"].map(|name| folder.path().join(name));
    for path in [&state, &served] {
        std::fs::create_dir(path).expect("a folder");
        std::fs::set_permissions(path, PermissionsExt::from_mode(0o755)).expect("its mode");
    }
    ball::write(&served.join("ball.npy"));
    let text = |path: &std::path::Path| path.to_str().expect("text").to_owned();
    let serve = ["serve", "--listen", "127.0.0.1:0", "--no-auth"].map(str::to_owned);
    let refused = |more: &[String]| command::fail(serve.iter().chain(more));
    let said = refused(&["--state-folder".into(), text(&state)]);
    assert!(
        said.contains("has mode 0755") && said.contains("chmod go-rwx"),
        "{said}"
    );
    let said = refused(&["--uploads".into(), text(&state)]);
    assert!(said.contains("has mode 0755"), "{said}");
    let said = refused(&[text(&served), "--uploads".into(), text(&served.join("uploads"))]);
    assert!(said.contains("which is served to all"), "{said}");
}
