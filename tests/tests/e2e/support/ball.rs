//! A volume with a closed surface.

use std::path::Path;

/// Samples per axis.
pub const DIMS: [u32; 3] = [150, 130, 140];

/// Writes a NumPy file of a ball whose surface is wrinkled on one side and smooth on the other, and closed at isovalues above -13.
pub fn write(path: &Path) {
    write_field(path, DIMS, |at| {
        let [u, v, w] = [at[0] - 75.0, at[1] - 65.0, at[2] - 70.0];
        let wrinkles = if u > 0.0 {
            2.0 * (0.6 * u).sin() * (0.6 * v).sin() * (0.6 * w).sin()
        } else {
            0.0
        };
        50.0 + wrinkles - (u * u + v * v + w * w).sqrt()
    });
}

/// Writes a NumPy file of a field's values at the samples.
pub fn write_field(path: &Path, dims: [u32; 3], value: impl Fn([f32; 3]) -> f32) {
    let dims = dims.map(|n| n as u16);
    let shape = dims.map(|n| n.to_string());
    let header = format!(
        "{{'descr': '<f4', 'fortran_order': False, 'shape': ({}, {}, {}), }}",
        shape[2], shape[1], shape[0]
    );
    let header = format!("{header:<117}\n");
    let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    bytes.extend(header.bytes());
    for z in 0..dims[2] {
        for y in 0..dims[1] {
            for x in 0..dims[0] {
                bytes.extend(value([x, y, z].map(f32::from)).to_le_bytes());
            }
        }
    }
    std::fs::write(path, bytes).expect("a file");
}
