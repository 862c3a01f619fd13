//! Paths in which volumes and time steps appear while a server runs.

use std::path::Path;

use isopeel_volumes::watch::Watcher;
use isopeel_volumes::{Frame, TimeAxis, VolumeStep};

use crate::write::{self, Volume};

fn put(folder: &Path, name: &str, bytes: impl AsRef<[u8]>) {
    std::fs::write(folder.join(name), bytes).unwrap();
}

fn nrrd(value: i64, nx: u64) -> Vec<u8> {
    let mut volume = Volume::new([nx as u32, 3, 5], 1, ('i', 2), false);
    volume.values.fill(value);
    write::nrrd(&volume, "raw")
}

fn open(folder: &Path) -> Watcher {
    Watcher::open(&[folder.to_owned()], false, Frame::Lps).unwrap()
}

/// Ids, steps and revisions.
fn listed(watcher: &Watcher) -> Vec<(String, u32, u32)> {
    let catalog = watcher.catalog().now();
    let datasets = catalog.datasets().iter();
    datasets.map(|d| (d.id.clone(), d.steps, d.revision)).collect()
}

#[test]
fn a_numbered_file_becomes_a_step_once_it_stays_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path().join("heat");
    std::fs::create_dir(&at).unwrap();
    for step in 0..3 {
        put(&at, &format!("t_{step:02}.nrrd"), nrrd(step, 4));
    }
    let mut watcher = open(&at);
    let shared = watcher.catalog();
    assert_eq!(listed(&watcher), [("heat".to_owned(), 3, 0)]);
    assert!(!watcher.look() && !watcher.look());
    let whole = nrrd(3, 4);
    put(&at, "t_03.nrrd", &whole[..whole.len() / 2]);
    assert!(!watcher.look(), "it may be written still");
    // Half a file that is no longer being written is passed over; the others stay.
    assert!(!watcher.look());
    assert_eq!(listed(&watcher), [("heat".to_owned(), 3, 0)]);
    put(&at, "t_03.nrrd", &whole);
    assert!(!watcher.look());
    assert!(watcher.look());
    assert_eq!(
        listed(&watcher),
        [("heat".to_owned(), 4, 0)],
        "the samples before are the same"
    );
    let dataset = shared.now().get("heat").cloned().unwrap();
    assert_eq!(dataset.times.as_ref().and_then(TimeAxis::labels).unwrap()[3], "step 03");
    assert_eq!(dataset.fields[0].source.load(3).unwrap().get(0), 3.0);
}

#[test]
fn steps_that_shift_or_change_are_another_revision() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path().join("heat");
    std::fs::create_dir(&at).unwrap();
    for step in 1..4 {
        put(&at, &format!("t_{step:02}.nrrd"), nrrd(step, 4));
    }
    let mut watcher = open(&at);
    put(&at, "t_00.nrrd", nrrd(0, 4));
    watcher.look();
    assert!(watcher.look());
    assert_eq!(listed(&watcher), [("heat".to_owned(), 4, 1)]);
    put(&at, "t_02.nrrd", nrrd(77, 4));
    // The time of a change may be too coarse to tell.
    let later = std::time::SystemTime::now() + std::time::Duration::from_secs(5);
    std::fs::File::options()
        .write(true)
        .open(at.join("t_02.nrrd"))
        .unwrap()
        .set_modified(later)
        .unwrap();
    watcher.look();
    assert!(watcher.look());
    assert_eq!(listed(&watcher), [("heat".to_owned(), 4, 2)]);
}

/// Writes a file whose time of the last change differs, however coarse that is.
fn rewrite(folder: &Path, name: &str, bytes: impl AsRef<[u8]>, seconds: u64) {
    put(folder, name, bytes);
    let later = std::time::SystemTime::now() + std::time::Duration::from_secs(seconds);
    let file = std::fs::File::options().write(true).open(folder.join(name)).unwrap();
    file.set_modified(later).unwrap();
}

#[test]
fn steps_that_are_rewritten_while_others_are_added_have_other_samples() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path().join("heat");
    std::fs::create_dir(&at).unwrap();
    for step in 0..3 {
        put(&at, &format!("t_{step:02}.nrrd"), nrrd(step, 4));
    }
    let mut watcher = open(&at);
    let now = |watcher: &Watcher| watcher.catalog().now().get("heat").cloned().unwrap();
    let key = |dataset: &std::sync::Arc<isopeel_volumes::Dataset>, step| {
        VolumeStep::new(std::sync::Arc::clone(dataset), step).unwrap().key()
    };
    let before = now(&watcher);
    rewrite(&at, "t_01.nrrd", nrrd(77, 4), 5);
    put(&at, "t_03.nrrd", nrrd(3, 4));
    watcher.look();
    assert!(watcher.look());
    let after = now(&watcher);
    assert!(after.continues(&before) && after.steps == 4);
    let is_same: Vec<bool> = (0..3).map(|step| key(&before, step) == key(&after, step)).collect();
    assert_eq!(is_same, [true, false, true]);
    // Again, and a step more: each rewrite is another one.
    rewrite(&at, "t_01.nrrd", nrrd(78, 4), 9);
    put(&at, "t_04.nrrd", nrrd(4, 4));
    watcher.look();
    assert!(watcher.look());
    assert_eq!(now(&watcher).rewrites(1), 2);
    assert_eq!(now(&watcher).rewrites(3), 0);
}

#[test]
fn a_file_with_more_steps_may_have_other_samples_in_all() {
    let folder = tempfile::tempdir().unwrap();
    let four = |value: f32, steps: usize| {
        let mut npy = Vec::new();
        let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({steps}, 3, 4, 5), }}");
        npy.extend_from_slice(b"\x93NUMPY\x01\x00");
        npy.extend_from_slice(&(header.len() as u16).to_le_bytes());
        npy.extend_from_slice(header.as_bytes());
        npy.extend((0..steps * 60).flat_map(|_| value.to_le_bytes()));
        npy
    };
    put(folder.path(), "four.npy", four(1.0, 2));
    let mut watcher = Watcher::open(&[folder.path().join("four.npy")], false, Frame::Lps).unwrap();
    rewrite(folder.path(), "four.npy", four(2.0, 3), 5);
    watcher.look();
    assert!(watcher.look());
    let dataset = watcher.catalog().now().get("four").cloned().unwrap();
    assert_eq!((dataset.steps, dataset.rewrites(0), dataset.rewrites(1)), (3, 1, 1));
}

#[test]
fn new_volumes_are_listed_and_ids_stay() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut watcher = open(at);
    assert_eq!(listed(&watcher), []);
    put(at, "b.nrrd", nrrd(1, 4));
    watcher.look();
    watcher.look();
    assert_eq!(listed(&watcher).len(), 1);
    // Grids differ: each file is a volume.
    put(at, "c.nrrd", nrrd(1, 5));
    watcher.look();
    assert!(watcher.look());
    let ids: Vec<String> = listed(&watcher).into_iter().map(|(id, ..)| id).collect();
    assert_eq!(ids, ["b", "c"]);
    let before = watcher.catalog().now().get("c").cloned().unwrap();
    put(at, "a.nrrd", nrrd(1, 6));
    watcher.look();
    assert!(watcher.look());
    let ids: Vec<String> = listed(&watcher).into_iter().map(|(id, ..)| id).collect();
    assert_eq!(ids, ["a", "b", "c"]);
    assert!(std::sync::Arc::ptr_eq(
        &before,
        watcher.catalog().now().get("c").unwrap()
    ));
}

#[test]
fn what_cannot_be_opened_keeps_what_was_there() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.nrrd");
    std::fs::write(&path, nrrd(1, 4)).unwrap();
    let mut watcher = Watcher::open(std::slice::from_ref(&path), true, Frame::Lps).unwrap();
    let before = listed(&watcher);
    std::fs::write(&path, b"NRRD").unwrap();
    for _ in 0..6 {
        assert!(!watcher.look());
    }
    assert_eq!(listed(&watcher), before);
    std::fs::remove_file(&path).unwrap();
    for _ in 0..6 {
        assert!(!watcher.look());
    }
    assert_eq!(listed(&watcher), before);
    // From the start it is one that cannot be read, until it can.
    let mut watcher = Watcher::open(std::slice::from_ref(&path), false, Frame::Lps).unwrap();
    let unreadable = |watcher: &Watcher| watcher.catalog().now().unreadable().to_vec();
    let [gone] = unreadable(&watcher).try_into().expect("one path");
    assert_eq!(
        (gone.name.as_str(), gone.reason.as_str()),
        ("a.nrrd", "file: not found, expected a file")
    );
    std::fs::write(&path, nrrd(1, 4)).unwrap();
    assert!((0..80).any(|_| watcher.look()), "it is tried again");
    assert!(unreadable(&watcher).is_empty() && listed(&watcher).len() == 1);
}
