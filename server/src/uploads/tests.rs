//! Uploads without HTTP: limits, visibility, lost connections, restarts, expiry.

use axum::body::Bytes;
use futures_util::{StreamExt, stream};

use super::*;
use crate::private_folder::FolderAccess;

const ANN: Reader<'static> = Reader::new("ann", false);
const BOB: Reader<'static> = Reader::new("bob", false);
const ADMIN: Reader<'static> = Reader::new("root", true);
const HOUR: Duration = Duration::from_secs(3_600);
const LIMITS: Limits = Limits {
    quota_bytes: 10_000,
    keep: HOUR,
    keep_unfinished: HOUR,
};

type Sent = Result<Bytes, &'static str>;

struct Case {
    folder: tempfile::TempDir,
    catalog: SharedCatalog,
    uploads: Uploads,
}

impl Case {
    /// Removes what is overdue, as if it had been for long.
    async fn expire(&self) {
        let (mut overdue, at) = (Overdue::default(), Instant::now());
        for at in [at, at + MAX_GRACE_PERIOD] {
            self.uploads.expire(&mut overdue, SystemTime::now(), at).await;
        }
    }

    fn new(limits: Limits) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let catalog = SharedCatalog::default();
        let uploads = open(&folder, limits, &catalog);
        Self {
            folder,
            catalog,
            uploads,
        }
    }

    /// As after the end of the process.
    fn again(self, limits: Limits) -> Self {
        let Self { folder, uploads, .. } = self;
        drop(uploads);
        let catalog = SharedCatalog::default();
        let uploads = open(&folder, limits, &catalog);
        Self {
            folder,
            catalog,
            uploads,
        }
    }

    async fn create(&self, who: Reader<'_>, files: &[(&str, usize)]) -> Result<UploadInfo, UploadError> {
        Ok(self.uploads.create(who, None, request(files)).await?.0)
    }

    async fn send(&self, who: Reader<'_>, id: &str, offset: u64, bytes: &[u8]) -> Result<u64, UploadError> {
        let pieces: Vec<Sent> = bytes
            .chunks(100)
            .map(|piece| Ok(Bytes::copy_from_slice(piece)))
            .collect();
        let body = stream::iter(pieces);
        self.uploads.receive(who, id, offset, None, body).await
    }

    /// A volume of a user's; its id.
    async fn volume(&self, who: Reader<'_>) -> String {
        let bytes = npy();
        let upload = self
            .create(who, &[("Mustermann Erika.npy", bytes.len())])
            .await
            .unwrap();
        self.send(who, &upload.id, 0, &bytes).await.unwrap();
        let upload = self.uploads.finish(who, &upload.id).await.unwrap();
        assert_eq!(upload.state, UploadState::Ready);
        upload.volumes[0].clone()
    }
}

fn open(folder: &tempfile::TempDir, limits: Limits, catalog: &SharedCatalog) -> Uploads {
    let folder = UploadFolder::open(&folder.path().join("uploads"), FolderAccess::User).unwrap();
    Uploads::open(folder, limits, Frame::Lps, catalog.clone()).unwrap()
}

fn request(files: &[(&str, usize)]) -> UploadRequest {
    let file = |&(name, bytes): &(&str, usize)| DeclaredFile {
        name: name.into(),
        bytes: bytes as u64,
    };
    UploadRequest {
        files: files.iter().map(file).collect(),
    }
}

/// A NumPy file of 2 × 3 × 4 bytes.
fn npy() -> Vec<u8> {
    npy_of("(4, 3, 2)")
}

fn npy_of(shape: &str) -> Vec<u8> {
    let header = format!("{{'descr': '|u1', 'fortran_order': False, 'shape': {shape}, }}");
    let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    bytes.extend(format!("{header:<117}\n").bytes());
    bytes.extend(0..24);
    bytes
}

#[tokio::test]
async fn what_is_above_a_limit_is_refused_before_anything_is_stored() {
    let case = Case::new(LIMITS);
    let folders = || std::fs::read_dir(case.folder.path().join("uploads")).unwrap().count();
    let before = folders();
    for (files, words) in [
        (&[("../up.npy", 1)][..], "expected a relative name"),
        (&[], "0 files"),
        (
            &[("a.npy", 10_001)],
            "10001 bytes, but 0 of your 10000 bytes are taken: expected at most 10000",
        ),
    ] {
        let error = case.create(ANN, files).await.unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
    assert_eq!(folders(), before);
    // Declared bytes count, whether they have come or not; each user has their own.
    case.create(ANN, &[("a.npy", 9_000)]).await.unwrap();
    let over = case.create(ANN, &[("b.npy", 1_001)]).await.unwrap_err();
    assert!(matches!(over, UploadError::OverQuota { used: 9_000, .. }), "{over}");
    case.create(ANN, &[("b.npy", 1_000)]).await.unwrap();
    case.create(BOB, &[("b.npy", 10_000)]).await.unwrap();
    let list = case.uploads.list(ANN);
    assert_eq!(
        (list.quota_bytes, list.used_bytes, list.uploads.len()),
        (10_000, 10_000, 2)
    );
    // More than any disk has.
    let vast = Case::new(Limits {
        quota_bytes: u64::MAX,
        ..LIMITS
    });
    let full = vast.create(ANN, &[("a.npy", 1 << 60)]).await.unwrap_err();
    assert!(matches!(full, UploadError::DiskFull(_)), "{full}");
    for _ in 0..MAX_UPLOADS {
        vast.create(ANN, &[("a.npy", 1)]).await.unwrap();
    }
    assert!(matches!(
        vast.create(ANN, &[("a.npy", 1)]).await,
        Err(UploadError::TooMany)
    ));
}

#[tokio::test]
async fn what_is_in_compressed_files_counts() {
    let packed = |bytes: &[u8]| {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        std::io::Write::write_all(&mut encoder, bytes).unwrap();
        encoder.finish().unwrap()
    };
    let case = Case::new(LIMITS);
    let finish = async |name: &str, bytes: &[u8]| {
        let upload = case.create(ANN, &[(name, bytes.len())]).await?;
        case.send(ANN, &upload.id, 0, bytes).await?;
        case.uploads.finish(ANN, &upload.id).await
    };
    let used = || case.uploads.list(ANN).used_bytes;
    let samples = [&npy_of("(4, 30, 50)"), &vec![0; 5_976][..]].concat();
    let first = packed(&samples);
    finish("a.npy.gz", &first).await.unwrap();
    assert_eq!(used(), samples.len() as u64, "{} bytes as they are stored", first.len());
    let second = finish("b.npy.gz", &first).await.unwrap_err();
    assert!(
        matches!(second, UploadError::UnpacksOverQuota { .. }),
        "6,128 bytes of 3,872: {second}"
    );
    let seen = case.uploads.list(ANN);
    assert!(
        seen.uploads[0]
            .error
            .as_ref()
            .unwrap()
            .contains("\"b.npy.gz\" unpacks to more")
    );
    case.uploads.delete(ANN, &seen.uploads[0].id).await.unwrap();
    finish("c.npy", &npy()).await.unwrap();
    let case = case.again(LIMITS);
    assert_eq!(case.uploads.list(ANN).used_bytes, samples.len() as u64 + 152);
}

#[tokio::test]
async fn the_same_request_makes_one_upload() {
    let case = Case::new(LIMITS);
    let key = || Some("k1".to_owned());
    let files = request(&[("a.npy", 7)]);
    let (first, is_new) = case.uploads.create(ANN, key(), files.clone()).await.unwrap();
    assert!(is_new);
    assert_eq!(
        case.uploads.create(ANN, key(), files.clone()).await.unwrap(),
        (first.clone(), false)
    );
    let (bobs, is_new) = case.uploads.create(BOB, key(), files.clone()).await.unwrap();
    assert!(is_new && bobs.id != first.id);
    let other = case.uploads.create(ANN, key(), request(&[("b.npy", 7)])).await;
    assert!(matches!(other, Err(UploadError::KeyReused { .. })));
    let bad = case.uploads.create(ANN, Some("a\nb".into()), files.clone()).await;
    assert!(matches!(bad, Err(UploadError::BadKey(3))));
    // Across a restart too.
    let case = case.again(LIMITS);
    let (again, is_new) = case.uploads.create(ANN, key(), files).await.unwrap();
    assert!(!is_new && again.id == first.id);
}

#[tokio::test]
async fn parts_that_do_not_fit_are_refused_and_what_came_is_kept() {
    let case = Case::new(LIMITS);
    let bytes = npy();
    let id = case.create(ANN, &[("a.npy", bytes.len())]).await.unwrap().id;
    let wrong = case.send(ANN, &id, 3, &bytes[3..]).await.unwrap_err();
    assert!(
        matches!(wrong, UploadError::WrongOffset { found: 3, expected: 0 }),
        "{wrong}"
    );
    // A body that says that it is too long, and one that does not.
    let none = stream::empty::<Sent>();
    let long = case
        .uploads
        .receive(ANN, &id, 0, Some(bytes.len() as u64 + 1), none)
        .await;
    assert!(matches!(long, Err(UploadError::TooLong { .. })));
    let long = case.send(ANN, &id, 0, &[bytes.clone(), vec![0; 50]].concat()).await;
    assert!(matches!(long, Err(UploadError::TooLong { left: 52 })), "{long:?}");
    assert_eq!(case.uploads.offset(ANN, &id).await.unwrap(), (100, 152));
    let early = case.uploads.finish(ANN, &id).await.unwrap_err();
    assert_eq!(
        early.to_string(),
        "100 of 152 bytes are there, expected all of them: \"a.npy\" is not whole"
    );
    // A connection that is lost.
    let lost = stream::iter([Ok(Bytes::copy_from_slice(&bytes[100..120])), Err("lost")]);
    let lost = case.uploads.receive(ANN, &id, 100, None, lost).await;
    assert!(matches!(lost, Err(UploadError::Interrupted { kept: 120 })), "{lost:?}");
    assert_eq!(case.send(ANN, &id, 120, &bytes[120..]).await.unwrap(), 152);
    let ready = case.uploads.finish(ANN, &id).await.unwrap();
    assert_eq!(
        case.uploads.finish(ANN, &id).await.unwrap().volumes,
        ready.volumes,
        "asked again"
    );
    let more = case.send(ANN, &id, 152, b"x").await;
    assert!(matches!(more, Err(UploadError::Finished(_))));
}

#[tokio::test]
async fn who_comes_again_takes_the_place_of_the_connection_before() {
    let case = Case::new(LIMITS);
    let id = case.create(ANN, &[("a.npy", 200)]).await.unwrap().id;
    let (uploads, of) = (case.uploads.clone(), id.clone());
    // A connection whose other end is gone, which the server has not noticed.
    let hanging = stream::iter([Sent::Ok(Bytes::from_static(&[1; 60]))]).chain(stream::pending());
    let before = tokio::spawn(async move { uploads.receive(ANN, &of, 0, None, Box::pin(hanging)).await });
    tokio::time::sleep(Duration::from_millis(50)).await;
    assert_eq!(case.uploads.offset(ANN, &id).await.unwrap(), (60, 200));
    assert!(matches!(
        before.await.unwrap(),
        Err(UploadError::TakenOver { kept: 60 })
    ));
    assert_eq!(case.send(ANN, &id, 60, &[2; 140]).await.unwrap(), 200);
    let file = case.folder.path().join("uploads").join(&id).join("files/a.npy");
    assert_eq!(std::fs::read(file).unwrap(), [vec![1; 60], vec![2; 140]].concat());
}

#[tokio::test]
async fn a_user_holds_only_so_many_connections() {
    let case = Case::new(LIMITS);
    let mut hanging = Vec::new();
    for n in 0..=4 {
        let id = case.create(ANN, &[(&format!("{n}"), 10)]).await.unwrap().id;
        let uploads = case.uploads.clone();
        let body = Box::pin(stream::pending::<Sent>());
        let part = async move { uploads.receive(ANN, &id, 0, None, body).await };
        hanging.push(tokio::spawn(part));
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    assert!(matches!(hanging.remove(4).await.unwrap(), Err(UploadError::Busy)));
    let id = case.create(BOB, &[("b", 10)]).await.unwrap().id;
    assert_eq!(case.send(BOB, &id, 0, &[0; 10]).await.unwrap(), 10, "another user");
    hanging.iter().for_each(tokio::task::JoinHandle::abort);
    for ended in hanging {
        let _ = ended.await;
    }
    let id = case.create(ANN, &[("c", 10)]).await.unwrap().id;
    assert_eq!(case.send(ANN, &id, 0, &[0; 10]).await.unwrap(), 10);
}

#[tokio::test]
async fn only_the_owner_and_administrators_see_an_upload() {
    let case = Case::new(LIMITS);
    let volume = case.volume(ANN).await;
    assert!(
        volume.starts_with("upload-") && !volume.contains("ustermann"),
        "{volume}"
    );
    let found = case.catalog.find(&volume, ANN).unwrap();
    assert_eq!(
        (found.title.as_str(), found.geometry.dims),
        ("Mustermann Erika", [2, 3, 4])
    );
    assert!(case.catalog.find(&volume, ADMIN).is_some() && case.catalog.find(&volume, BOB).is_none());
    let id = &volume["upload-".len()..];
    let unknown = |error: UploadError| assert_eq!(error.to_string(), UploadError::Unknown(id.into()).to_string());
    unknown(case.uploads.get(BOB, id).unwrap_err());
    unknown(case.uploads.offset(BOB, id).await.unwrap_err());
    unknown(case.send(BOB, id, 0, b"x").await.unwrap_err());
    unknown(case.uploads.finish(BOB, id).await.unwrap_err());
    unknown(case.uploads.delete(BOB, id).await.unwrap_err());
    assert!(case.uploads.list(BOB).uploads.is_empty());
    assert_eq!(case.uploads.list(ADMIN).uploads[0].owner, "ann");
    // Viewers learn it.
    let lease = case.catalog.private().lease(&volume);
    case.uploads.delete(ADMIN, id).await.unwrap();
    lease.removed().await;
    assert!(case.catalog.find(&volume, ANN).is_none());
    assert_eq!(
        std::fs::read_dir(case.folder.path().join("uploads")).unwrap().count(),
        1,
        "the lock alone"
    );
}

#[tokio::test]
async fn a_restart_keeps_parts_and_volumes() {
    let case = Case::new(LIMITS);
    let volume = case.volume(ANN).await;
    let files = [("scan/a.mhd", 3), ("scan/a.raw", 90)];
    let half = case.create(ANN, &files).await.unwrap().id;
    case.send(ANN, &half, 0, &[7; 50]).await.unwrap();
    let case = case.again(LIMITS);
    assert_eq!(case.catalog.find(&volume, ANN).unwrap().title, "Mustermann Erika");
    assert!(case.catalog.find(&volume, BOB).is_none());
    assert_eq!(case.uploads.offset(ANN, &half).await.unwrap(), (50, 93));
    assert_eq!(case.send(ANN, &half, 50, &[8; 43]).await.unwrap(), 93);
    assert_eq!(case.uploads.get(ANN, &half).unwrap().title, "scan");
    // One that cannot be read any more is listed with the reason, and kept.
    let id = &volume["upload-".len()..];
    let file = case
        .folder
        .path()
        .join("uploads")
        .join(id)
        .join("files/Mustermann Erika.npy");
    std::fs::write(file, b"something else").unwrap();
    let case = case.again(Limits {
        keep_unfinished: Duration::ZERO,
        ..LIMITS
    });
    case.expire().await;
    let list = case.uploads.list(ANN).uploads;
    assert_eq!(
        list.iter().map(|upload| upload.id.as_str()).collect::<Vec<_>>(),
        [id],
        "the half one has expired"
    );
    assert!(list[0].volumes.is_empty() && list[0].error.as_ref().unwrap().starts_with("Mustermann Erika.npy: "));
}

#[tokio::test]
async fn several_files_are_one_volume_and_faults_name_the_file_alone() {
    let case = Case::new(LIMITS);
    let samples: Vec<u8> = (0..24).collect();
    let header = "ObjectType = Image\nNDims = 3\nDimSize = 2 3 4\nElementType = MET_UCHAR\nElementDataFile = DATA\n";
    let send = async |names: [&str; 2], data: &str| {
        let header = header.replace("DATA", data);
        let files = [(names[0], header.len()), (names[1], samples.len())];
        let id = case.create(ANN, &files).await.unwrap().id;
        let bytes = [header.as_bytes(), &samples].concat();
        case.send(ANN, &id, 0, &bytes).await.unwrap();
        (case.uploads.finish(ANN, &id).await, id)
    };
    for names in [["scan/head.mhd", "scan/head.raw"], ["head.mhd", "head.raw"]] {
        let upload = send(names, "head.raw").await.0.unwrap();
        let dataset = case.catalog.find(&upload.volumes[0], ANN).unwrap();
        assert_eq!(dataset.geometry.dims, [2, 3, 4]);
        let title = if names[0].contains('/') { "scan" } else { "head" };
        assert_eq!(dataset.title, title);
    }
    // A header leads nowhere else.
    std::fs::write(case.folder.path().join("secret.raw"), &samples).unwrap();
    let secret = case.folder.path().join("secret.raw").to_string_lossy().into_owned();
    for data in ["../../../secret.raw", "../../secret.raw", &secret, "gone.raw"] {
        let (outcome, id) = send(["head.mhd", "head.raw"], data).await;
        let error = outcome.unwrap_err().to_string();
        assert!(error.starts_with("head.mhd: ElementDataFile"), "{error}");
        assert!(
            !error.contains(case.folder.path().to_str().unwrap()) || data == secret,
            "{error}"
        );
        assert_eq!(case.uploads.get(ANN, &id).unwrap().error, Some(error));
        case.uploads.delete(ANN, &id).await.unwrap();
    }
    // Two that do not fit together are two volumes, as on the command line.
    let (bytes, other) = (npy(), npy_of("(3, 4, 2)"));
    let files = [("a.npy", bytes.len()), ("b.npy", other.len())];
    let id = case.create(ANN, &files).await.unwrap().id;
    case.send(ANN, &id, 0, &[bytes, other].concat()).await.unwrap();
    let volumes = case.uploads.finish(ANN, &id).await.unwrap().volumes;
    assert_eq!(volumes, [format!("upload-{id}"), format!("upload-{id}-2")]);
}

#[tokio::test]
async fn what_nobody_uses_is_removed_and_what_somebody_looks_at_is_not() {
    let short = Duration::from_millis(300);
    let case = Case::new(Limits {
        keep: short,
        keep_unfinished: short,
        ..LIMITS
    });
    let (seen, left) = (case.volume(ANN).await, case.volume(ANN).await);
    let half = case.create(ANN, &[("a", 10)]).await.unwrap().id;
    let lease = case.catalog.private().lease(&seen);
    let gone = case.catalog.private().lease(&left);
    drop(gone);
    tokio::time::sleep(2 * short).await;
    case.expire().await;
    assert!(case.catalog.find(&seen, ANN).is_some(), "somebody looks at it");
    assert!(case.catalog.find(&left, ANN).is_none());
    assert!(case.uploads.get(ANN, &half).is_err());
    drop(lease);
    tokio::time::sleep(2 * short).await;
    case.expire().await;
    assert!(case.catalog.find(&seen, ANN).is_none());
    assert!(case.uploads.list(ANN).uploads.is_empty());
}

#[tokio::test]
async fn a_clock_that_is_ahead_for_a_while_removes_nothing() {
    let week = Duration::from_secs(7 * 86_400);
    let case = Case::new(Limits { keep: week, ..LIMITS });
    let volume = case.volume(ANN).await;
    let (mut overdue, now, at) = (Overdue::default(), SystemTime::now(), Instant::now());
    let ahead = now + week * 2;
    let minutes = |n: u64| at + Duration::from_secs(60 * n);
    for (clock, time, is_there) in [
        (ahead, minutes(0), true),
        (ahead, minutes(50), true),
        // It is set right.
        (now, minutes(55), true),
        (ahead, minutes(56), true),
        (ahead, minutes(110), true),
        (ahead, minutes(117), false),
    ] {
        case.uploads.expire(&mut overdue, clock, time).await;
        assert_eq!(case.catalog.find(&volume, ANN).is_some(), is_there, "{:?}", time - at);
    }
}
