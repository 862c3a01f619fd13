//! Zarr over HTTP from a server on this machine, which follows HTTP or violates it: the volumes are those of a folder, or the error says
//! why not.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::Request;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use futures_util::stream;
use isopeel_volumes::{Catalog, Dataset, ReadError, ReadProgress, open_dataset};
use tokio::runtime::Runtime;

/// Answers to requests for paths, instead of the files there.
type Answer = dyn Fn(&str, &HeaderMap) -> Option<Response> + Send + Sync;

/// A server of the files of a folder, without listings.
struct Server {
    address: String,
    requests: Arc<Mutex<Vec<String>>>,
    _runtime: Runtime,
}

fn fixtures() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fixtures/volumes")
}

fn file(root: &Path, path: &str, headers: &HeaderMap) -> Response {
    let Ok(bytes) = fs::read(root.join(path.trim_start_matches('/'))) else {
        return StatusCode::NOT_FOUND.into_response();
    };
    let range = headers.get(header::RANGE).and_then(|range| range.to_str().ok());
    let Some(range) = range.and_then(|range| range.strip_prefix("bytes=")) else {
        return bytes.into_response();
    };
    let (from, to) = range.split_once('-').unwrap();
    let last = bytes.len() - 1;
    let (from, to) = match (from.parse::<usize>(), to.parse::<usize>()) {
        (Ok(from), Ok(to)) => (from, to.min(last)),
        (Err(_), Ok(count)) => (bytes.len().saturating_sub(count), last),
        other => panic!("{other:?}"),
    };
    let content_range = format!("bytes {from}-{to}/{}", bytes.len());
    let headers = [(header::CONTENT_RANGE, content_range)];
    (StatusCode::PARTIAL_CONTENT, headers, bytes[from..=to].to_vec()).into_response()
}

fn serve(root: &Path, answer: impl Fn(&str, &HeaderMap) -> Option<Response> + Send + Sync + 'static) -> Server {
    let runtime = Runtime::new().unwrap();
    let listener = runtime.block_on(tokio::net::TcpListener::bind("127.0.0.1:0")).unwrap();
    let address = format!("http://{}", listener.local_addr().unwrap());
    let (root, answer): (_, Arc<Answer>) = (root.to_owned(), Arc::new(answer));
    let requests = Arc::new(Mutex::new(Vec::new()));
    let seen = Arc::clone(&requests);
    let app = Router::new().fallback(move |request: Request| {
        let (uri, headers) = (request.uri().to_string(), request.headers().clone());
        let path = request.uri().path().to_owned();
        seen.lock().unwrap().push(path.clone());
        let reply = answer(&uri, &headers).unwrap_or_else(|| file(&root, &path, &headers));
        async { reply }
    });
    runtime.spawn(async { axum::serve(listener, app).await.unwrap() });
    Server {
        address,
        requests,
        _runtime: runtime,
    }
}

impl Server {
    fn open(&self, path: &str) -> Result<Dataset, ReadError> {
        open_dataset(Path::new(&format!("{}/{path}", self.address)))
    }

    fn load(&self, path: &str) -> Result<Dataset, ReadError> {
        let dataset = self.open(path)?;
        for field in &dataset.fields {
            field.source.load(0)?;
        }
        Ok(dataset)
    }

    /// Asserts that an error names the address, and contains no secret.
    fn refused(&self, path: &str, words: &str) {
        let error = self.load(path).expect_err(words).to_string();
        assert!(error.contains(words), "expected {words:?} in: {error}");
        assert!(error.contains(&self.address), "no address in: {error}");
        assert!(!error.contains("secret"), "{error}");
    }
}

fn compare(remote: &Dataset, local: &Dataset) {
    let names = |dataset: &Dataset| -> Vec<_> {
        let fields = dataset.fields.iter();
        fields
            .map(|f| (f.name.clone(), f.stored_type.clone(), f.missing, f.unit.clone()))
            .collect()
    };
    assert_eq!(
        (&remote.id, &remote.title, remote.layout, remote.geometry, remote.steps),
        (&local.id, &local.title, local.layout, local.geometry, local.steps)
    );
    assert_eq!(
        (format!("{:?}", names(remote)), &remote.notices, &remote.times),
        (format!("{:?}", names(local)), &local.notices, &local.times)
    );
    for (remote, local) in remote.fields.iter().zip(&local.fields) {
        let progress = ReadProgress::default();
        let samples = remote.source.read(0, &progress).unwrap();
        // As bytes: some are NaN.
        let expected = local.source.load(0).unwrap();
        assert_eq!(samples.as_bytes(), expected.as_bytes(), "{}", remote.name);
        assert_eq!(progress.bytes(), remote.source.stored_bytes());
    }
}

/// The part to open of a group that cannot be listed.
fn part_of(name: &str) -> &'static str {
    match name {
        "group.zarr" => ":dose",
        _ if name.starts_with("xarray") || name.starts_with("times") => ":",
        _ => "",
    }
}

#[test]
fn volumes_are_those_of_the_folder() {
    let server = serve(&fixtures(), |_, _| None);
    let names: BTreeSet<String> = fs::read_dir(fixtures())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| name.ends_with(".zarr"))
        .collect();
    assert!(names.len() > 30);
    for name in names {
        let part = match part_of(&name) {
            ":" => {
                let local = open_dataset(&fixtures().join(&name)).unwrap();
                format!(":{}", local.fields[0].name)
            }
            part => part.to_owned(),
        };
        let open = format!("{name}{part}");
        let local = open_dataset(&fixtures().join(&open)).unwrap();
        let remote = server.open(&open).unwrap_or_else(|error| panic!("{open}: {error}"));
        compare(&remote, &local);
    }
    for level in ["image-0.4.ome.zarr:1", "image-0.5.ome.zarr:labels/cells"] {
        let Ok(local) = open_dataset(&fixtures().join(level)) else {
            continue;
        };
        compare(&server.open(level).unwrap(), &local);
    }
}

#[test]
fn precomputed_volumes_are_those_of_the_folder() {
    let server = serve(&fixtures(), |_, _| None);
    for open in [
        "precomputed-raw",
        "precomputed-raw:16_16_60",
        "precomputed-channels",
        "precomputed-jpeg",
        "precomputed-labels",
        "precomputed-labels-shards",
    ] {
        let local = open_dataset(&fixtures().join(open)).unwrap();
        let address = format!("precomputed://{}/{open}", server.address);
        let remote = open_dataset(Path::new(&address)).unwrap_or_else(|error| panic!("{open}: {error}"));
        compare(&remote, &local);
    }
    // No files that only Zarr has are requested.
    assert!(
        server
            .requests
            .lock()
            .unwrap()
            .iter()
            .all(|path| !path.contains("zarr"))
    );
    let error = open_dataset(Path::new(&format!("precomputed://{}/group.zarr", server.address)));
    let error = error.unwrap_err().to_string();
    assert!(error.contains("info: info: not there, expected it"), "{error}");
}

#[test]
fn a_catalog_takes_addresses() {
    let server = serve(&fixtures(), |_, _| None);
    let paths = [PathBuf::from(format!("{}/image-0.4.ome.zarr/", server.address))];
    let catalog = Catalog::open(&paths, false).unwrap();
    let local = Catalog::open(&[fixtures().join("image-0.4.ome.zarr")], false).unwrap();
    compare(&catalog.datasets()[0], &local.datasets()[0]);
}

/// A copy of a group with the metadata of all its arrays in one file.
fn consolidated() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut metadata = serde_json::Map::new();
    let mut copy = |below: &str| {
        for entry in fs::read_dir(fixtures().join("group.zarr").join(below)).unwrap() {
            let entry = entry.unwrap();
            let path = Path::new(below).join(entry.file_name());
            let target = folder.path().join("group.zarr").join(&path);
            fs::create_dir_all(target.parent().unwrap()).unwrap();
            if entry.path().is_file() {
                fs::copy(entry.path(), target).unwrap();
            }
            let name = entry.file_name().into_string().unwrap();
            if [".zarray", ".zattrs", ".zgroup"].contains(&name.as_str()) {
                let value = serde_json::from_slice(&fs::read(entry.path()).unwrap()).unwrap();
                metadata.insert(path.to_str().unwrap().to_owned(), value);
            }
        }
    };
    copy("");
    for entry in fs::read_dir(fixtures().join("group.zarr")).unwrap() {
        let entry = entry.unwrap();
        if entry.path().is_dir() {
            copy(entry.file_name().to_str().unwrap());
        }
    }
    let text = serde_json::json!({"zarr_consolidated_format": 1, "metadata": metadata});
    fs::write(folder.path().join("group.zarr/.zmetadata"), text.to_string()).unwrap();
    folder
}

#[test]
fn a_group_is_opened_by_its_consolidated_metadata() {
    let server = serve(&fixtures(), |_, _| None);
    server.refused("group.zarr", "no consolidated metadata");
    let folder = consolidated();
    let server = serve(folder.path(), |_, _| None);
    let local = open_dataset(&folder.path().join("group.zarr")).unwrap();
    compare(&server.open("group.zarr").unwrap(), &local);
    let requests = server.requests.lock().unwrap();
    let metadata: Vec<_> = requests
        .iter()
        .filter(|path| !path.ends_with(char::is_numeric))
        .collect();
    assert_eq!(metadata, ["/group.zarr/zarr.json", "/group.zarr/.zmetadata"]);
}

#[test]
fn missing_chunks_have_the_fill_value() {
    let is_chunk = |path: &str| path.ends_with("/0.0.0") || path.ends_with("/c/0/0/0");
    let server = serve(&fixtures(), move |path, _| {
        is_chunk(path).then(|| StatusCode::NOT_FOUND.into_response())
    });
    let name = "v3-zstd.zarr";
    let (remote, local) = (
        server.open(name).unwrap(),
        open_dataset(&fixtures().join(name)).unwrap(),
    );
    let load = |dataset: &Dataset| dataset.fields[0].source.load(0).unwrap();
    let (remote, local) = (load(&remote), load(&local));
    assert_eq!(remote.len(), local.len());
    assert_ne!(remote.as_bytes(), local.as_bytes());
    let nothing = serve(&fixtures(), |path, _| {
        path.contains("/c/").then(|| StatusCode::NOT_FOUND.into_response())
    });
    nothing.refused(name, "no chunk of step 0 is stored");
}

#[test]
fn a_server_that_fails_twice_is_asked_again() {
    let count = AtomicUsize::new(0);
    let server = serve(&fixtures(), move |path, _| {
        let is_first = path.contains("/c/") && count.fetch_add(1, Ordering::Relaxed) < 2;
        is_first.then(|| StatusCode::INTERNAL_SERVER_ERROR.into_response())
    });
    let local = open_dataset(&fixtures().join("v3-zstd.zarr")).unwrap();
    compare(&server.open("v3-zstd.zarr").unwrap(), &local);
}

#[test]
fn what_is_wrong_is_told_with_the_address() {
    let with = |words: &str, answer: fn() -> Response| {
        let server = serve(&fixtures(), move |path, _| path.contains("/c/").then(answer));
        server.refused("v3-zstd.zarr?key=secret", words);
    };
    with("redirected to http://localhost:1, expected", || {
        (
            StatusCode::FOUND,
            [(header::LOCATION, "http://localhost:1/c?key=secret")],
        )
            .into_response()
    });
    with("status 403", || (StatusCode::FORBIDDEN, "secret").into_response());
    with("410 Gone", || (StatusCode::GONE, "secret").into_response());
    with("expected 65", || vec![0; 1 << 20].into_response());
    with("chunk c/", || vec![7; 40].into_response());
    // The body is shorter than the stated length.
    with("zarr/c/", || {
        let body = Body::from_stream(stream::iter([Ok::<_, std::io::Error>(Bytes::from_static(b"short"))]));
        ([(header::CONTENT_LENGTH, "50")], body).into_response()
    });
    let server = serve(&fixtures(), |_, _| Some("<html>".into_response()));
    server.refused("v3-zstd.zarr", "zarr.json");
    server.refused("ct.nrrd", "zarr.json");
    let server = serve(&fixtures(), |_, _| Some(StatusCode::FORBIDDEN.into_response()));
    server.refused("v3-zstd.zarr", "the store refused to say (status 403)");
    let server = serve(&fixtures(), |_, _| None);
    server.refused("ct.nrrd", "of a network only Zarr is read");
    for (path, words) in [("http://", "expected https://host/path"), ("s3://", "s3://bucket/path")] {
        let error = open_dataset(Path::new(path)).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
}

#[test]
fn a_server_without_ranges_has_no_shards() {
    let server = serve(&fixtures(), |path, headers| {
        let whole = headers.contains_key(header::RANGE).then(HeaderMap::new)?;
        Some(file(&fixtures(), path, &whole))
    });
    assert!(server.load("v3-zstd.zarr").is_ok());
    server.refused("v3-shards.zarr", "ange");
}

#[test]
fn claims_of_a_server_are_not_allocated() {
    let metadata = r#"{"zarr_format":3,"node_type":"array","shape":[60000,60000,1000],"data_type":"uint8","fill_value":1,
        "chunk_grid":{"name":"regular","configuration":{"chunk_shape":[1000,1000,1000]}},
        "chunk_key_encoding":{"name":"default"},"codecs":[{"name":"bytes"}]}"#;
    let server = serve(&fixtures(), move |path, _| {
        path.ends_with("zarr.json").then(|| metadata.into_response())
    });
    let error = server.load("a.zarr").unwrap_err().to_string();
    assert!(
        error.contains("no memory for") || error.contains("is stored"),
        "{error}"
    );
}

#[test]
fn a_reader_is_cancelled() {
    let server = serve(&fixtures(), |_, _| None);
    let dataset = server.open("v3-zstd.zarr").unwrap();
    let progress = ReadProgress::default();
    progress.cancel();
    let error = dataset.fields[0].source.read(0, &progress).unwrap_err().to_string();
    assert!(error.contains("reading was cancelled"), "{error}");
}

/// The part of S3 that is used: objects by path, and listings.
fn s3(uri: &str, headers: &HeaderMap) -> Option<Response> {
    let signed = headers.get(header::AUTHORIZATION).and_then(|value| value.to_str().ok());
    if !signed.is_some_and(|value| value.starts_with("AWS4-HMAC-SHA256")) {
        return Some(StatusCode::FORBIDDEN.into_response());
    }
    if !uri.contains("list-type=2") {
        let path = uri.strip_prefix("/bucket/")?;
        return Some(file(&fixtures(), path, headers));
    }
    let prefix = uri
        .split(['?', '&'])
        .find_map(|word| word.strip_prefix("prefix="))
        .unwrap();
    let prefix = prefix.replace("%2F", "/");
    let folders = fs::read_dir(fixtures().join(&prefix))
        .unwrap()
        .map(|entry| entry.unwrap());
    let names: String = folders
        .filter(|entry| entry.path().is_dir())
        .map(|entry| entry.file_name().into_string().unwrap())
        .map(|name| format!("<CommonPrefixes><Prefix>{prefix}{name}/</Prefix></CommonPrefixes>"))
        .collect();
    let text = format!("<ListBucketResult><IsTruncated>false</IsTruncated>{names}</ListBucketResult>");
    Some(text.into_response())
}

#[test]
fn s3_is_read_with_the_keys_of_the_environment() {
    let server = serve(&fixtures(), s3);
    let info = |path: &str, with_keys: bool| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_isopeel"));
        command.args(["info", "--json", path]).env("AWS_ALLOW_HTTP", "true");
        command.env("AWS_ENDPOINT_URL", &server.address);
        if with_keys {
            command.envs([("AWS_ACCESS_KEY_ID", "key"), ("AWS_SECRET_ACCESS_KEY", "secret")]);
        } else {
            command.env("AWS_SKIP_SIGNATURE", "true");
        }
        let output = command.output().unwrap();
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        (text(output.stdout), text(output.stderr))
    };
    for name in [
        "image-0.5.ome.zarr",
        "group.zarr",
        "xarray-v2.zarr",
        "v3-shards.zarr",
        "group.zarr:dose",
    ] {
        let (remote, error) = info(&format!("s3://bucket/{name}"), true);
        let (local, _) = info(fixtures().join(name).to_str().unwrap(), true);
        assert_eq!(remote, local, "{error}");
        assert!(remote.contains("title"), "{error}");
    }
    let (_, error) = info("s3://bucket/group.zarr", false);
    assert!(
        error.contains("s3://bucket/group.zarr") && error.contains("status 403"),
        "{error}"
    );
}
