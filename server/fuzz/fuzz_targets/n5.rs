#![no_main]

#[allow(dead_code)]
mod common;

use isopeel_volumes::{FileLocation, formats::zarr};

// `attributes.json`, then a block.
libfuzzer_sys::fuzz_target!(|input: &[u8]| {
    let at = input
        .windows(common::SEPARATOR.len())
        .position(|w| w == common::SEPARATOR);
    let (attributes, block) = match at {
        Some(at) => (&input[..at], &input[at + common::SEPARATOR.len()..]),
        None => (input, &[][..]),
    };
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::create_dir_all(folder.path().join("0/0")).expect("a folder");
    std::fs::write(folder.path().join("attributes.json"), attributes).expect("a file");
    std::fs::write(folder.path().join("0/0/0"), block).expect("a file");
    let Ok(volumes) = zarr::open(&FileLocation::disk(folder.path())) else {
        return;
    };
    let file = &volumes[0].file;
    if let Ok(samples) = file.fields[0].source.load(0) {
        assert_eq!(samples.len() as u64, file.geometry.sample_count());
        assert_eq!(samples.sample_type(), file.fields[0].sample_type);
    }
});
