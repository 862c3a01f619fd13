#![no_main]

mod common;

libfuzzer_sys::fuzz_target!(|input: &[u8]| common::read("a.dcm", input, isopeel::volumes::formats::dicom::open));
