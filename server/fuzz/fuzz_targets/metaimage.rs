#![no_main]

mod common;

libfuzzer_sys::fuzz_target!(|input: &[u8]| common::read("a.mhd", input, isopeel::volumes::formats::metaimage::open));
