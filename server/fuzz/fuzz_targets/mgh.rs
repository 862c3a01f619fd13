#![no_main]

mod common;

libfuzzer_sys::fuzz_target!(|input: &[u8]| common::read("a.mgh", input, isopeel::volumes::formats::mgh::open));
