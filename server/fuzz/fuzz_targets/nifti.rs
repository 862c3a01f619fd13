#![no_main]

mod common;

libfuzzer_sys::fuzz_target!(|input: &[u8]| common::read("a.nii", input, isopeel::volumes::formats::nifti::open));
