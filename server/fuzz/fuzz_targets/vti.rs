#![no_main]

mod common;

libfuzzer_sys::fuzz_target!(|input: &[u8]| common::read("a.vti", input, isopeel_volumes::formats::vtk::xml::open));
