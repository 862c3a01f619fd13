//! Writes the seeds: small valid files of every format, by the writer of the reader tests.

#[path = "fuzz_targets/common.rs"]
#[allow(dead_code)]
mod common;
#[path = "../tests/volumes/write.rs"]
mod write;

use std::path::Path;

use write::{KINDS, Volume};

fn main() -> std::io::Result<()> {
    let with = |header: Vec<u8>, data: Vec<u8>| [header.as_slice(), common::SEPARATOR, data.as_slice()].concat();
    for (i, kind) in KINDS.into_iter().enumerate() {
        let v = Volume::new([3, 2, 4], 1 + i as u32 % 3, kind, i % 2 == 0);
        let nifti = write::nifti(&v, |h| h.f32(112, 1.0 + (i % 2) as f32));
        let seeds = [
            ("nrrd", write::nrrd(&v, "raw")),
            ("nrrd", write::nrrd(&v, "gzip")),
            ("nrrd", write::nrrd(&v, "text")),
            (
                "nrrd",
                with((write::nrrd_header(&v, "raw") + "data file: data\n").into(), v.bytes()),
            ),
            ("metaimage", write::mha(&v, false)),
            ("metaimage", write::mha(&v, true)),
            (
                "metaimage",
                with(write::meta_header(&v, false, "data").into(), v.bytes()),
            ),
            ("nifti", write::gzip(&nifti)),
            ("nifti", nifti),
            ("npy", write::npy(&v, false)),
            ("npy", write::npy(&v, true)),
            ("raw", with(write::sidecar(&v, "data", "raw"), v.bytes())),
            ("raw", with(write::sidecar(&v, "data", "gzip"), write::zlib(&v.bytes()))),
        ];
        for (n, (target, bytes)) in seeds.into_iter().enumerate() {
            let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(target);
            std::fs::create_dir_all(&folder)?;
            std::fs::write(folder.join(format!("seed-{i}-{n}")), bytes)?;
        }
    }
    Ok(())
}
