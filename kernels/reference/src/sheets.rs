//! Surface sheets of the cells of a volume, where neighbours decide which ambiguous faces are flipped
//! (docs/algorithm.md#62-sheets).

use crate::{Field, classify};
use isopeel_kernels::tables::sheets::Sheets;

/// Sheets of an active cell. Where two cells join sheets through the ambiguous face between them, the one whose coordinates
/// sum to an even number flips the face. A face on the volume's border any cell may flip, as if a mirror image were behind it.
/// Of all choices of such faces: the one that leaves the fewest joined, of equals the one with the largest bits.
pub fn cell_sheets(field: &Field, iso: f32, cell: [u32; 3], signs: u8) -> Sheets {
    let plain = Sheets::trace(signs, 0);
    let even = cell.iter().sum::<u32>() % 2 == 0;
    let shared = |face: u8| {
        let axis = usize::from(face / 2);
        let mut other = cell;
        let at = cell[axis].checked_add_signed(if face & 1 == 1 { 1 } else { -1 });
        let Some(at) = at.filter(|&at| at < field.grid.cells()[axis]) else {
            return true;
        };
        if !even {
            return false;
        }
        other[axis] = at;
        let corners = field.cell_corners(other);
        let there = Sheets::trace(classify::signs(corners, iso), 0);
        !corners.iter().any(|v| v.is_nan()) && there.joined_faces() >> (face ^ 1) & 1 == 1
    };
    let candidates = (0..6)
        .filter(|&f| plain.joined_faces() >> f & 1 == 1 && shared(f))
        .fold(0u8, |bits, f| bits | 1 << f);
    Sheets::flipped(signs, candidates)
}
