//! Loops over the threads of the pool.
//!
//! The loop itself is compiled once, not for each type of sample: `rayon`'s generic iterators were a quarter of this crate's code.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, OnceLock};

use isopeel_kernels::lock;
use rayon::prelude::*;

/// Values of a task of [`for_each_row`]: enough that a task takes longer than its administration.
const CHUNK_VALUES: usize = 1 << 16;

/// Calls `task` with each number below `count`, on several threads. Once a call has returned false, no further call begins.
fn for_each_while(count: usize, task: &(dyn Fn(usize) -> bool + Sync)) {
    let _ = (0..count)
        .into_par_iter()
        .try_for_each(|number| task(number).then_some(()));
}

/// Returns the results of `task` for each number below `count`, in order. After an error, no further call begins.
///
/// # Errors
/// An error of `task`: of several, the one with the lowest number.
pub(super) fn try_map<R: Send + Sync, E: Send + Sync>(
    count: usize,
    task: impl Fn(usize) -> Result<R, E> + Sync,
) -> Result<Vec<R>, E> {
    let results: Vec<OnceLock<Result<R, E>>> = std::iter::repeat_with(OnceLock::new).take(count).collect();
    for_each_while(count, &|number| results[number].get_or_init(|| task(number)).is_ok());
    // Only after an error are results missing.
    results.into_iter().filter_map(OnceLock::into_inner).collect()
}

/// As [`try_map`], of items that each call takes.
///
/// # Errors
/// Errors of `task`.
pub(super) fn try_map_items<T: Send, R: Send + Sync, E: Send + Sync>(
    items: Vec<T>,
    task: impl Fn(T) -> Result<R, E> + Sync,
) -> Result<Vec<R>, E> {
    let items: Vec<_> = items.into_iter().map(|item| Mutex::new(Some(item))).collect();
    let take = |number: usize| lock(&items[number]).take();
    let results = try_map(items.len(), |number| take(number).map(&task).transpose())?;
    Ok(results.into_iter().flatten().collect())
}

/// Returns the sum of the results of `task` for each number below `count`, at most [`u64::MAX`]. After an error, no further call begins.
///
/// # Errors
/// Errors of `task`.
pub(super) fn try_sum<E: Send + Sync>(count: u64, task: impl Fn(u64) -> Result<u64, E> + Sync) -> Result<u64, E> {
    let (sum, failure) = (AtomicU64::new(0), OnceLock::new());
    for_each_while(
        usize::try_from(count).unwrap_or(usize::MAX),
        &|number| match task(number as u64) {
            Ok(more) => {
                let _ = sum.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |sum| {
                    Some(sum.saturating_add(more))
                });
                true
            }
            Err(error) => {
                let _ = failure.set(error);
                false
            }
        },
    );
    failure.into_inner().map_or(Ok(sum.into_inner()), Err)
}

/// Calls `task` with each chunk of at most `size` values, and with the chunk's number.
///
/// # Errors
/// Errors of `task`.
pub(super) fn try_for_each_chunk<T: Send, E: Send + Sync>(
    values: &mut [T],
    size: usize,
    task: impl Fn(usize, &mut [T]) -> Result<(), E> + Sync,
) -> Result<(), E> {
    let chunks = values.chunks_mut(size).enumerate().collect();
    try_map_items(chunks, |(number, chunk)| task(number, chunk))?;
    Ok(())
}

/// Calls `task` with each row of `length` values, and with the row's number. The last row may be shorter.
pub(super) fn for_each_row<T: Send>(values: &mut [T], length: usize, task: impl Fn(usize, &mut [T]) + Sync) {
    let rows = (CHUNK_VALUES / length.max(1)).max(1);
    let result = try_for_each_chunk(values, rows * length, |chunk, values| {
        let numbered = (chunk * rows..).zip(values.chunks_mut(length));
        numbered.for_each(|(row, values)| task(row, values));
        Ok::<(), std::convert::Infallible>(())
    });
    let Ok(()) = result;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_in_order_and_an_error_ends_the_loop() {
        let squares = try_map(1000, |i| Ok::<_, ()>(i * i));
        assert_eq!(squares, Ok((0..1000).map(|i| i * i).collect()));
        let failed = try_map(1000, |i| if i % 100 == 99 { Err(i) } else { Ok(i) });
        assert!(failed.is_err_and(|i| i % 100 == 99));
        assert_eq!(try_sum(1000, Ok::<_, ()>), Ok(499_500));
        assert_eq!(try_sum(3, |i| if i == 1 { Err(i) } else { Ok(u64::MAX) }), Err(1));
        let names = try_map_items(vec!["a".to_owned(), "b".to_owned()], |name| Ok::<_, ()>(name + "!"));
        assert_eq!(names, Ok(vec!["a!".to_owned(), "b!".to_owned()]));
    }

    #[test]
    fn chunks_and_rows_cover_all_values_once() {
        for (length, size) in [(0, 7), (1, 7), (7, 7), (200_003, 7), (200_003, 70_000)] {
            let mut values = vec![0usize; length];
            let add = |chunk: usize, values: &mut [usize]| {
                assert!(values.len() <= size);
                values.iter_mut().for_each(|value| *value += chunk + 1);
            };
            let done = try_for_each_chunk(&mut values, size, |chunk, values| {
                add(chunk, values);
                Ok::<_, ()>(())
            });
            assert_eq!(done, Ok(()));
            for_each_row(&mut values, size, add);
            let expected = (0..length).map(|i| 2 * (i / size + 1));
            assert!(values.iter().copied().eq(expected));
        }
    }
}
