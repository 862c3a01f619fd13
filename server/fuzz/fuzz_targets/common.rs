//! Common part of all targets: splits the bytes into files in memory, opens the first with the reader, and loads a few steps.

use std::sync::Arc;

use isopeel_volumes::location::MemoryFolder;
use isopeel_volumes::{FileLocation, OpenedFile, ReadError};

/// Input is the header's file, then, behind the first `\0----\0`, the file `data` that the header may name, `data.vti`, as a collection takes
/// names with an ending alone, or `a.img`, the samples of a pair.
pub const SEPARATOR: &[u8] = b"\0----\0";

type Open = fn(&FileLocation) -> Result<OpenedFile, ReadError>;

/// An error or a volume of as many samples as its header says; the fuzzer's own limits watch time and memory.
pub fn read(name: &str, input: &[u8], open: Open) {
    let at = input.windows(SEPARATOR.len()).position(|w| w == SEPARATOR);
    let (header, data) = match at {
        Some(at) => (&input[..at], Some(&input[at + SEPARATOR.len()..])),
        None => (input, None),
    };
    let mut folder = MemoryFolder::from([(name.to_owned(), header.to_owned().into())]);
    if let Some(data) = data {
        for name in ["data", "data.vti", "a.img"] {
            folder.insert(name.to_owned(), data.to_owned().into());
        }
    }
    let Ok(file) = open(&FileLocation::memory(Arc::new(folder), name)) else {
        return;
    };
    for step in 0..file.steps.min(3) {
        if let Ok(samples) = file.fields[0].source.load(step) {
            assert_eq!(samples.len() as u64, file.geometry.sample_count());
            assert_eq!(samples.sample_type(), file.fields[0].sample_type);
        }
    }
}
