//! Writes MRC maps by the byte map of MRC2014. The fuzz targets take their seeds from here too.

use crate::write::Volume;

/// A header of 1024 bytes in the file's own byte order.
pub struct Header {
    pub bytes: Vec<u8>,
    big: bool,
}

impl Header {
    fn put(&mut self, word: usize, mut bytes: [u8; 4]) {
        if self.big {
            bytes.reverse();
        }
        self.bytes[4 * (word - 1)..4 * word].copy_from_slice(&bytes);
    }

    /// A word, numbered from 1 as in the specification.
    pub fn i32(&mut self, word: usize, value: i32) {
        self.put(word, value.to_le_bytes());
    }

    pub fn f32(&mut self, word: usize, value: f32) {
        self.put(word, value.to_le_bytes());
    }
}

/// Whether MRC has a mode for the type.
pub fn has_mode(v: &Volume) -> bool {
    matches!(v.kind, ('i', 1 | 2) | ('u', 2) | ('f', 4))
}

/// A map; time steps as a stack of volumes. `edit` may change the header.
pub fn mrc(v: &Volume, edit: impl FnOnce(&mut Header)) -> Vec<u8> {
    let mut h = Header {
        bytes: vec![0; 1024],
        big: v.big,
    };
    let [x, y, z] = v.dims.map(|n| n as i32);
    for (i, n) in [x, y, z * v.steps as i32].into_iter().enumerate() {
        h.i32(1 + i, n);
    }
    h.i32(
        4,
        match v.kind {
            ('i', 1) => 0,
            ('i', 2) => 1,
            ('f', 4) => 2,
            ('u', 2) => 6,
            kind => panic!("no mode for {kind:?}"),
        },
    );
    for (i, n) in [x, y, z].into_iter().enumerate() {
        h.i32(8 + i, n);
        h.f32(11 + i, (f64::from(n) * v.spacing[i]) as f32);
        h.f32(14 + i, 90.0);
        h.i32(17 + i, 1 + i as i32);
        h.f32(50 + i, v.origin[i] as f32);
    }
    h.i32(23, if v.steps > 1 { 401 } else { 1 });
    h.bytes[208..212].copy_from_slice(b"MAP ");
    h.bytes[212..214].copy_from_slice(if v.big { &[0x11, 0x11] } else { &[0x44, 0x44] });
    edit(&mut h);
    h.bytes.extend(v.bytes());
    h.bytes
}
