#![no_main]

mod common;

libfuzzer_sys::fuzz_target!(|input: &[u8]| common::read("a.npy", input, isopeel_volumes::formats::npy::open));
