#![no_main]

mod common;

libfuzzer_sys::fuzz_target!(|input: &[u8]| common::read("a.h5", input, isopeel_volumes::formats::variables::open));
