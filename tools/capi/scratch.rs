//! Memory for the lists of a recording, reused by the next one.

use ashsplat::Result;

/// Arena for the lists of a recording. Another recording of the same size allocates nothing on the heap.
pub(super) type Scratch = bumpalo::Bump;

/// A list in the arena.
pub(super) type List<'b, T> = bumpalo::collections::Vec<'b, T>;

/// Collects an iterator's values, up to its first error.
pub(super) fn collected<T>(
    values: impl Iterator<Item = Result<T>>,
    scratch: &Scratch,
) -> Result<List<'_, T>> {
    let mut all = List::with_capacity_in(values.size_hint().0, scratch);
    for value in values {
        all.push(value?);
    }
    Ok(all)
}
