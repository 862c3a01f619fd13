//! Surface sheets of the cells of a volume; neighbouring cells decide which ambiguous faces are flipped
//! (docs/algorithm.md#62-sheets).

use crate::{Field, classify};
use isopeel_kernels::tables::sheets::Sheets;

/// Signs of the cell beyond a face; `None` beyond the volume.
fn beyond(field: &Field, iso: f32, cell: [u32; 3], face: u8) -> Option<([u32; 3], Option<u8>)> {
    let axis = usize::from(face / 2);
    let mut other = cell;
    other[axis] = cell[axis].checked_add_signed(if face & 1 == 1 { 1 } else { -1 })?;
    if other[axis] >= field.grid.cells()[axis] {
        return None;
    }
    let corners = field.cell_corners(other);
    let known = !corners.iter().any(|v| v.is_nan());
    Some((other, known.then(|| classify::signs(corners, iso))))
}

fn is_joined(signs: u8, face: u8) -> bool {
    Sheets::trace(signs, 0).joined_faces() >> face & 1 == 1
}

/// The faces with a property, one bit each.
fn faces(has: impl Fn(u8) -> bool) -> u8 {
    (0..6).filter(|&face| has(face)).fold(0, |bits, face| bits | 1 << face)
}

/// Faces of a cell that the cells on both sides join: those of neighbours, and those of the volume, which meet their mirror image.
fn joined_on_both_sides(field: &Field, iso: f32, cell: [u32; 3], signs: u8) -> [u8; 2] {
    let there = |face| beyond(field, iso, cell, face);
    let inner = |face| there(face).is_some_and(|(_, there)| there.is_some_and(|there| is_joined(there, face ^ 1)));
    let outer = |face| there(face).is_none();
    [
        faces(|face| is_joined(signs, face) && inner(face)),
        faces(|face| is_joined(signs, face) && outer(face)),
    ]
}

/// Sheets of an active cell. If two cells join sheets through the ambiguous face between them, the one whose coordinates
/// sum to an even number may flip the face, for both. A face on the volume's border any cell may flip, as if a mirror image were behind it.
/// Of all choices of such faces: the one that leaves the fewest joined, of equals the one with the largest bits.
pub fn cell_sheets(field: &Field, iso: f32, cell: [u32; 3], signs: u8) -> Sheets {
    let is_even = |cell: [u32; 3]| cell.iter().sum::<u32>() % 2 == 0;
    let [inner, outer] = joined_on_both_sides(field, iso, cell, signs);
    if is_even(cell) {
        return Sheets::trace(signs, Sheets::choose_flips(signs, 0, inner | outer));
    }
    let forced = faces(|face| {
        let Some((other, Some(there))) = beyond(field, iso, cell, face).filter(|_| inner >> face & 1 == 1) else {
            return false;
        };
        let [inner, outer] = joined_on_both_sides(field, iso, other, there);
        Sheets::choose_flips(there, 0, inner | outer) >> (face ^ 1) & 1 == 1
    });
    Sheets::trace(signs, forced | Sheets::choose_flips(signs, forced, outer))
}
