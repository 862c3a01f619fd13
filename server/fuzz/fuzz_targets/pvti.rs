#![no_main]

mod common;

libfuzzer_sys::fuzz_target!(|input: &[u8]| common::read("a.pvti", input, isopeel_volumes::formats::vtk::pieces::open));
