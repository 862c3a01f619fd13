//! DICOM: incomplete folders, and data of patients that must never be published. The files are those of
//! `tests/fixtures/volumes/dicom`.

use std::ffi::OsStr;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use isopeel_kernels::SampleType;
use isopeel_volumes::{Catalog, Dataset, ReadError, open_dataset};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../tests/fixtures/volumes/dicom")
        .join(name)
}

/// A copy of a fixture's folder, to be changed.
fn copy(name: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for entry in std::fs::read_dir(fixture(name)).unwrap() {
        let path = entry.unwrap().path();
        std::fs::copy(&path, folder.path().join(path.file_name().unwrap())).unwrap();
    }
    folder
}

/// Replaces bytes of a file, which must occur in it.
fn patch(path: &Path, from: &[u8], to: &[u8]) {
    let mut bytes = std::fs::read(path).unwrap();
    let mut at = 0;
    let mut found = false;
    while let Some(next) = bytes[at..].windows(from.len()).position(|w| w == from) {
        bytes.splice(at + next..at + next + from.len(), to.iter().copied());
        at += next + to.len();
        found = true;
    }
    assert!(found, "{}", path.display());
    std::fs::write(path, bytes).unwrap();
}

fn refused(path: &Path) -> String {
    open_dataset(path).unwrap_err().to_string()
}

fn field_type(dataset: &Dataset) -> (SampleType, &str, Option<f32>) {
    let field = &dataset.fields[0];
    (field.sample_type, field.stored_type.as_str(), field.missing)
}

#[test]
fn a_missing_image_is_refused_with_the_gap() {
    let folder = copy("itk");
    // Names count five on, so that this is neither the first nor the last image.
    std::fs::remove_file(folder.path().join("3.dcm")).unwrap();
    let error = refused(folder.path());
    assert!(error.contains("3.0000 mm between images"), "{error}");
    assert!(
        error.contains("1.5000 mm between others: 1 seem to be missing"),
        "{error}"
    );
}

#[test]
fn folders_in_folders_are_searched_and_circles_are_not() {
    let folder = tempfile::tempdir().unwrap();
    let deep = folder.path().join("patient/study/series");
    std::fs::create_dir_all(&deep).unwrap();
    for entry in std::fs::read_dir(fixture("itk")).unwrap() {
        let path = entry.unwrap().path();
        std::fs::copy(&path, deep.join(path.file_name().unwrap())).unwrap();
    }
    std::os::unix::fs::symlink(folder.path(), deep.join("again")).unwrap();
    let [found, expected] = [folder.path(), &fixture("itk")].map(|path| open_dataset(path).unwrap());
    assert_eq!(found.geometry, expected.geometry);
    assert_eq!(found.layout, "DICOM");
}

#[test]
fn copies_are_passed_over_but_other_images_at_a_position_are_refused() {
    let folder = copy("itk");
    let copied = folder.path().join("copy");
    std::fs::copy(folder.path().join("3.dcm"), &copied).unwrap();
    assert_eq!(open_dataset(folder.path()).unwrap().geometry.dims, [7, 5, 6]);
    patch(&copied, b".77777.7.2", b".77777.7.9");
    let error = refused(folder.path());
    assert!(error.contains("1 to 2 different images at one position"), "{error}");
}

#[test]
fn a_time_without_all_positions_is_refused() {
    let folder = copy("times");
    std::fs::remove_file(folder.path().join("4.ima")).unwrap();
    assert!(refused(folder.path()).contains("different images at one position"));
}

#[test]
fn an_image_beside_the_line_is_refused() {
    let folder = copy("tilt");
    patch(&folder.path().join("2"), b"-12.5\\40.25\\12.0", b"-13.5\\40.25\\12.0");
    let error = refused(folder.path());
    assert!(error.contains("beside its place in a grid"), "{error}");
}

#[test]
fn single_images_are_no_volume() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::copy(fixture("ct/IM0"), folder.path().join("scout")).unwrap();
    assert!(refused(folder.path()).contains("a single image, expected a series of 2 or more"));
    assert!(refused(&folder.path().join("scout")).contains("by the name of its folder"));
    std::fs::copy(fixture("ct/DICOMDIR"), folder.path().join("scout")).unwrap();
    assert!(refused(folder.path()).contains("no image with a place in space"));
}

#[test]
fn integers_stay_integers_where_their_offset_fits() {
    let ct = open_dataset(&fixture("ct")).unwrap();
    assert_eq!(field_type(&ct), (SampleType::I16, "u16", Some(4000.0 - 1024.0)));
    let pet = open_dataset(&fixture("rescale")).unwrap();
    assert_eq!(field_type(&pet), (SampleType::F32, "i16", None));
    let frames = open_dataset(&fixture("frames.dcm")).unwrap();
    assert_eq!(field_type(&frames), (SampleType::U16, "u16", None));
}

#[test]
fn series_are_named_by_number_and_modality() {
    let catalog = Catalog::open(&[fixture("two"), fixture("ct"), fixture("enhanced.dcm")], false).unwrap();
    let names: Vec<(&str, &str)> = catalog
        .datasets()
        .iter()
        .map(|d| (d.id.as_str(), d.title.as_str()))
        .collect();
    let expected = [
        ("series-11-ot", "Series 11 · OT"),
        ("series-12-mr", "Series 12 · MR"),
        ("series-3-ct", "Series 3 · CT"),
        ("series-21-mr", "Series 21 · MR"),
    ];
    assert_eq!(names, expected);
    let error = refused(&fixture("two"));
    assert!(
        error.contains("two:1 (1: Series 11 · OT, 2: Series 12 · MR)"),
        "{error}"
    );
    let error = refused(&fixture("two").with_file_name("two:3"));
    assert!(error.contains("expected a number from 1 to 2"), "{error}");
}

#[test]
fn a_series_that_is_refused_hides_no_other() {
    let folder = copy("itk");
    std::fs::create_dir(folder.path().join("other")).unwrap();
    for name in ["0", "1", "2", "4"] {
        std::fs::copy(fixture("tilt").join(name), folder.path().join("other").join(name)).unwrap();
    }
    assert_eq!(open_dataset(folder.path()).unwrap().title, "Series 7 · MR");
}

/// A file of an unknown kind of color in another series.
#[test]
fn a_file_that_is_refused_hides_no_other_series() {
    let folder = copy("itk");
    let other = folder.path().join("other");
    std::fs::copy(fixture("two/a/0"), &other).unwrap();
    patch(&other, b"RGB ", b"RGBX");
    assert_eq!(open_dataset(folder.path()).unwrap().title, "Series 7 · MR");
    // In its own series it is missed.
    let folder = copy("two/a");
    patch(&folder.path().join("2"), b"RGB ", b"RGBX");
    assert!(refused(folder.path()).contains("file 3 by name: PhotometricInterpretation"));
}

#[test]
fn other_compressions_are_refused_by_name() {
    let folder = copy("tilt");
    for entry in std::fs::read_dir(folder.path()).unwrap() {
        patch(
            &entry.unwrap().path(),
            b"1.2.840.10008.1.2.1\0",
            b"1.2.840.10008.1.2.9\0",
        );
    }
    let error = refused(folder.path());
    assert!(
        error.contains("TransferSyntaxUID: a film or a retired compression, expected"),
        "{error}"
    );
}

/// Texts that identify the patient in the files: see PLANTED in the module that writes them.
/// Numbers are long, so that none is in a time or a position by chance.
const PLANTED: [&str; 8] = [
    "planted",
    "47114711",
    "19370207",
    "19990307",
    "171819.271828",
    ".77777",
    "1.2.826.0",
    "3680043",
];

#[track_caller]
fn says_nothing(what: &str, text: &str) {
    let text = text.to_lowercase();
    for word in PLANTED {
        assert!(!text.contains(word), "{what} says {word:?}: {text}");
    }
}

/// Collects log lines.
#[derive(Clone, Default)]
struct Log(Arc<Mutex<Vec<u8>>>);

impl std::io::Write for Log {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().unwrap().extend(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// Every kind of broken file: cut off at every tenth byte, and with bytes changed.
fn errors_of_broken_files(name: &str) -> Vec<ReadError> {
    let folder = copy(name);
    let path = std::fs::read_dir(folder.path())
        .unwrap()
        .next()
        .unwrap()
        .unwrap()
        .path();
    let whole = std::fs::read(&path).unwrap();
    let mut errors = Vec::new();
    for at in (0..whole.len()).step_by(10) {
        for broken in [whole[..at].to_vec(), {
            let mut changed = whole.clone();
            changed[at] ^= 0x5a;
            changed
        }] {
            std::fs::write(&path, broken).unwrap();
            match open_dataset(folder.path()) {
                Err(error) => errors.push(error),
                Ok(dataset) => errors.extend(dataset.fields[0].source.load(0).err()),
            }
        }
    }
    assert!(errors.len() > 50, "{}", errors.len());
    errors
}

#[test]
fn nothing_that_identifies_a_patient_is_said() {
    let log = Log::default();
    let writer = log.clone();
    let subscriber = tracing_subscriber::fmt()
        .with_max_level(tracing::Level::TRACE)
        .with_writer(move || writer.clone())
        .finish();
    let names = [
        "ct",
        "itk",
        "two",
        "times",
        "enhanced.dcm",
        "dose.dcm",
        "jpegls-i16.dcm",
    ];
    tracing::subscriber::with_default(subscriber, || {
        for name in names {
            // The folder's name is the operator's, so that the words must not be in it.
            let catalog = Catalog::open(&[fixture(name)], false).unwrap();
            for dataset in catalog.datasets() {
                says_nothing("the dataset", &format!("{dataset:?}"));
                dataset.fields[0].source.load(0).unwrap();
            }
        }
        for name in ["ct", "times"] {
            for error in errors_of_broken_files(name) {
                says_nothing("an error", &format!("{error} {error:?}"));
            }
        }
    });
    let log = String::from_utf8(log.0.lock().unwrap().clone()).unwrap();
    assert!(log.contains("passed over"), "{log}");
    says_nothing("the log", &log);
}

#[test]
fn names_of_files_in_a_folder_are_not_said() {
    let folder = copy("itk");
    for (i, entry) in std::fs::read_dir(folder.path()).unwrap().enumerate() {
        let path = entry.unwrap().path();
        std::fs::rename(&path, folder.path().join(format!("PLANTED^PATIENT {i}"))).unwrap();
    }
    let whole = open_dataset(folder.path()).unwrap();
    let broken = folder.path().join("PLANTED^PATIENT 2");
    let bytes = std::fs::read(&broken).unwrap();
    for length in [0, 200, 400, bytes.len() - 1] {
        std::fs::write(&broken, &bytes[..length]).unwrap();
        let errors = [open_dataset(folder.path()).err(), whole.fields[0].source.load(0).err()];
        for error in errors.into_iter().flatten() {
            says_nothing("an error", &format!("{error} {error:?}"));
            let text = error.to_string();
            assert!(
                text.contains("file 3 by name") || text.contains("mm between images"),
                "{text}"
            );
        }
    }
    std::fs::remove_file(&broken).unwrap();
    says_nothing("an error", &whole.fields[0].source.load(0).unwrap_err().to_string());
    // A file of its own: neither id nor title nor field is its name.
    let file = folder.path().join("PLANTED^PATIENT.dcm");
    std::fs::copy(fixture("frames.dcm"), &file).unwrap();
    let catalog = Catalog::open(&[file], false).unwrap();
    says_nothing("the dataset", &format!("{:?}", catalog.datasets()));
}

fn run(arguments: &[&OsStr]) -> (bool, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isopeel"));
    let output = command.env("RUST_LOG", "trace").args(arguments).output().unwrap();
    let text = [output.stdout, output.stderr].concat();
    (output.status.success(), String::from_utf8_lossy(&text).into_owned())
}

#[test]
fn info_and_exports_say_nothing_that_identifies_a_patient() {
    for (name, iso) in [("ct", "0"), ("enhanced.dcm", "30"), ("rescale", "30")] {
        let path = fixture(name);
        for more in [&["info"][..], &["info", "--json"]] {
            let arguments: Vec<&OsStr> = more.iter().map(OsStr::new).chain([path.as_os_str()]).collect();
            let (succeeded, text) = run(&arguments);
            assert!(succeeded && text.contains("Series"), "{text}");
            says_nothing("isopeel info", &text);
        }
        let folder = tempfile::tempdir().unwrap();
        for ending in ["glb", "ply", "stl", "vtp"] {
            let out = folder.path().join(format!("out.{ending}"));
            let (succeeded, text) = run(&[
                "extract".as_ref(),
                path.as_os_str(),
                "--iso".as_ref(),
                iso.as_ref(),
                "-o".as_ref(),
                out.as_os_str(),
            ]);
            assert!(succeeded, "{text}");
            says_nothing("isopeel extract", &text);
            let bytes = std::fs::read(out).unwrap();
            assert!(bytes.len() > 500, "{name} {ending}: {} bytes", bytes.len());
            // Numbers of few digits may be in vertices by chance.
            let text = String::from_utf8_lossy(&bytes).to_lowercase();
            assert!(!text.contains("planted") && !text.contains("3680043"), "{ending}");
        }
    }
    let folder = copy("ct");
    std::fs::remove_file(folder.path().join("IM1")).unwrap();
    let (succeeded, text) = run(&["info".as_ref(), folder.path().as_os_str()]);
    assert!(!succeeded && text.contains("mm between images"), "{text}");
    says_nothing("isopeel info", &text);
}

/// A server that ends with the test.
struct Server {
    process: Child,
    address: String,
    log: tempfile::NamedTempFile,
}

impl Server {
    fn start(path: &Path) -> Self {
        let log = tempfile::NamedTempFile::new().unwrap();
        let mut process = Command::new(env!("CARGO_BIN_EXE_isopeel"))
            .args(["serve", "--no-auth", "--no-demo", "--listen", "127.0.0.1:0"])
            .arg(path)
            .env("RUST_LOG", "trace")
            .stderr(log.reopen().unwrap())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut said = String::new();
        BufReader::new(process.stdout.take().unwrap())
            .read_line(&mut said)
            .unwrap();
        let address = said
            .trim()
            .strip_prefix("http://")
            .unwrap_or_else(|| panic!("{said:?}"));
        Self {
            process,
            address: address.to_owned(),
            log,
        }
    }

    fn get(&self, path: &str) -> String {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        // A driver may have to compile the kernels first.
        stream.set_read_timeout(Some(Duration::from_secs(120))).unwrap();
        let request = format!(
            "GET {path} HTTP/1.1\r\nhost: {}\r\nconnection: close\r\n\r\n",
            self.address
        );
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        String::from_utf8_lossy(&answer).into_owned()
    }
}

#[test]
fn a_server_says_nothing_that_identifies_a_patient() {
    let server = Server::start(&fixture("ct"));
    let list = server.get("/api/v1/volumes");
    assert!(list.contains("Series 3 · CT") && list.contains("series-3-ct"), "{list}");
    for path in [
        "/api/v1/volumes",
        "/api/v1/volumes/series-3-ct",
        "/api/v1/volumes/none",
        "/api/v1/memory",
    ] {
        let answer = server.get(path);
        assert!(answer.starts_with("HTTP/1.1"), "{answer}");
        says_nothing(path, answer.split_once("\r\n\r\n").unwrap().1);
    }
    let log = std::fs::read_to_string(server.log.path()).unwrap();
    assert!(log.contains("single images"), "{log}");
    says_nothing("the log", &log);
}

impl Drop for Server {
    fn drop(&mut self) {
        // Also when a test fails.
        self.process.kill().unwrap();
        self.process.wait().unwrap();
    }
}
