//! Case tables of a cube, computed at start and handed to the device as constants: the marching-cubes triangles
//! ([`cases`]) and the surface sheets ([`sheets`]), over one numbering of corners, edges and faces ([`cube`]).

pub mod cases;
pub mod cube;
pub mod sheets;

use sheets::Sheets;

/// The marching-cubes table as the kernels read it: 16 bytes a case, triangles first.
pub(crate) fn case_table() -> Vec<u8> {
    cases::case_triangles().concat()
}

/// One byte a case, four to a word: triangles, sheets << 3, and bit 6 if a face joins two segments in one sheet.
pub(crate) fn case_facts() -> Vec<u32> {
    let triangles = cases::case_triangles();
    let fact = |signs: usize| {
        let sheets = Sheets::trace(signs as u8, 0);
        u32::from(triangles[signs][0]) | u32::from(sheets.count) << 3 | u32::from(sheets.joined_faces() != 0) << 6
    };
    (0..64)
        .map(|word| (0..4).fold(0, |bits, byte| bits | fact(4 * word + byte) << (8 * byte)))
        .collect()
}
