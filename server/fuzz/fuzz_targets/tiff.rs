#![no_main]

mod common;

libfuzzer_sys::fuzz_target!(|input: &[u8]| common::read("a.tif", input, isopeel_volumes::formats::tiff::open));
