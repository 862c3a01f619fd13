#![no_main]

mod common;

libfuzzer_sys::fuzz_target!(|input: &[u8]| common::read("a.json", input, isopeel::volumes::formats::raw::open));
