#![no_main]

mod common;

// BigDataViewer's XML, then the HDF5 file `data` that it names.
libfuzzer_sys::fuzz_target!(|input: &[u8]| common::read(
    "a.xml",
    input,
    isopeel_volumes::formats::big_data_viewer::open
));
