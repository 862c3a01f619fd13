use super::*;

#[test]
fn stems() {
    for (name, expected) in [
        ("a/ct.nrrd", "ct"),
        ("a/t1.nii.gz", "t1"),
        ("a/T1.NII.GZ", "T1"),
        ("a.b/head.v2.mha", "head.v2"),
        ("ct.nrrd.zst", "ct"),
        ("noext", "noext"),
        (".nrrd", ".nrrd"),
    ] {
        assert_eq!(stem(Path::new(name)), expected, "{name}");
    }
}

#[test]
fn links_out_of_the_folder_are_refused() {
    let (folder, outside) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let path = |name: &str| folder.path().join(name);
    std::fs::create_dir(path("sub")).unwrap();
    for file in [path("sub/here.raw"), outside.path().join("there.raw")] {
        std::fs::write(file, b"").unwrap();
    }
    std::os::unix::fs::symlink(path("sub/here.raw"), path("in.raw")).unwrap();
    std::os::unix::fs::symlink(outside.path().join("there.raw"), path("out.raw")).unwrap();
    std::os::unix::fs::symlink(outside.path(), path("far")).unwrap();
    let header = FileLocation::disk(path("head.mhd"));
    assert!(header.sibling("in.raw", "f").is_ok());
    for name in ["out.raw", "far/there.raw"] {
        let error = header.sibling(name, "ElementDataFile").unwrap_err();
        assert!(error.why.contains("a link out of the header's own folder"), "{error}");
    }
}

#[test]
fn detached_data_stays_in_the_folder() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::create_dir(path("sub")).unwrap();
    for file in ["head.raw", "sub/head.raw"] {
        std::fs::write(path(file), b"").unwrap();
    }
    let header = FileLocation::disk(path("head.mhd"));
    assert_eq!(header.sibling("head.raw", "f").unwrap().path(), path("head.raw"));
    assert_eq!(
        header.sibling("./sub/head.raw", "f").unwrap().path(),
        path("./sub/head.raw")
    );
    for bad in [
        "",
        "/etc/passwd",
        "../head.raw",
        "sub/../../head.raw",
        "a\0b",
        "none.raw",
        "sub",
    ] {
        let error = header.sibling(bad, "ElementDataFile").unwrap_err();
        assert_eq!(error.field, "ElementDataFile", "{bad:?}");
    }
}

#[test]
fn what_is_no_file_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let error = FileLocation::disk(folder.path()).open().err().unwrap();
    assert!(error.to_string().contains("a folder, expected a file"), "{error}");
    let error = FileLocation::disk("/dev/zero").open().err().unwrap();
    assert!(error.to_string().contains("not a regular file"), "{error}");
    let error = FileLocation::disk(folder.path().join("none.nrrd"))
        .open()
        .err()
        .unwrap();
    assert!(error.to_string().contains("none.nrrd: file: not found"), "{error}");
}
