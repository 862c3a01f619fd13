#![no_main]

#[allow(dead_code)]
mod common;

use isopeel_volumes::{FileLocation, formats::precomputed};

// `info` of a scale whose key is `s`, then its only chunk, or a shard.
libfuzzer_sys::fuzz_target!(|input: &[u8]| {
    let at = input
        .windows(common::SEPARATOR.len())
        .position(|w| w == common::SEPARATOR);
    let (info, chunk) = match at {
        Some(at) => (&input[..at], &input[at + common::SEPARATOR.len()..]),
        None => (input, &[][..]),
    };
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::create_dir_all(folder.path().join("s")).expect("a folder");
    std::fs::write(folder.path().join("info"), info).expect("a file");
    for name in ["0-2_0-3_0-4", "0.shard"] {
        std::fs::write(folder.path().join("s").join(name), chunk).expect("a file");
    }
    let Ok(volumes) = precomputed::open(&FileLocation::disk(folder.path())) else {
        return;
    };
    let file = &volumes[0].file;
    for field in &file.fields {
        if let Ok(samples) = field.source.load(0) {
            assert_eq!(samples.len() as u64, file.geometry.sample_count());
            assert_eq!(samples.sample_type(), field.sample_type);
        }
    }
});
