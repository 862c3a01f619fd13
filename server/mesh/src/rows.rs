//! Writes rows of a file that take longer to make than to write.

use std::io::{self, Write};

use rayon::prelude::*;

/// Rows that one task makes.
const PIECE_ROWS: usize = 16384;

/// Writes `count` rows in their order. `push` appends the bytes of the row with a number.
///
/// On a thread of a rayon pool, the pool makes the next rows while the calling thread writes earlier ones. Any other thread makes all rows
/// itself, so that a caller decides which pool works for it. Buffers two pieces of rows for each thread of the pool.
///
/// # Errors
/// Errors of `out`.
pub(crate) fn write_rows(
    count: usize,
    out: &mut dyn Write,
    push: impl Fn(usize, &mut Vec<u8>) + Sync,
) -> io::Result<()> {
    let threads = rayon::current_thread_index().map_or(1, |_| rayon::current_num_threads());
    let piece = |piece: usize, buffer: &mut Vec<u8>| {
        // On the stack, because lengths that lie side by side in memory would slow down the threads that change them.
        let mut bytes = std::mem::take(buffer);
        bytes.clear();
        let first = piece * PIECE_ROWS;
        (first..count.min(first + PIECE_ROWS)).for_each(|row| push(row, &mut bytes));
        *buffer = bytes;
    };
    let pieces = count.div_ceil(PIECE_ROWS);
    if threads == 1 {
        let mut bytes = Vec::new();
        return (0..pieces).try_for_each(|number| {
            piece(number, &mut bytes);
            out.write_all(&bytes)
        });
    }
    let [mut made, mut next] = [(); 2].map(|()| vec![Vec::new(); threads]);
    for first in (0..pieces + threads).step_by(threads) {
        rayon::in_place_scope(|scope| {
            scope.spawn(|_| {
                let buffers = next.par_iter_mut().enumerate();
                buffers.for_each(|(i, bytes)| piece(first + i, bytes));
            });
            made.iter().try_for_each(|bytes| out.write_all(bytes))
        })?;
        std::mem::swap(&mut made, &mut next);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_in_order_on_any_thread() {
        for count in [0, 1, PIECE_ROWS, PIECE_ROWS + 1, 7 * PIECE_ROWS + 3] {
            let push = |row: usize, bytes: &mut Vec<u8>| bytes.extend_from_slice(&row.to_le_bytes());
            let expected: Vec<u8> = (0..count).flat_map(usize::to_le_bytes).collect();
            let written = || {
                let mut written = Vec::new();
                write_rows(count, &mut written, push).unwrap();
                written
            };
            assert_eq!(written(), expected, "{count} rows on a thread of no pool");
            for threads in 1..4 {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                assert_eq!(pool.install(written), expected, "{count} rows, {threads} threads");
            }
        }
    }

    #[test]
    fn an_error_of_the_file_ends_the_work() {
        let mut small = [0; 10_000];
        let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
        let written = pool.install(|| write_rows(100 * PIECE_ROWS, &mut &mut small[..], |_, bytes| bytes.push(7)));
        assert_eq!(written.unwrap_err().kind(), io::ErrorKind::WriteZero);
        assert_eq!(small, [7; 10_000]);
    }
}
