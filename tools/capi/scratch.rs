//! Memory for the lists of a recording, which is used again by the next one.

use ashsplat::Result;

/// Where the lists of a recording lie. Once it has held those of a recording, those of another one like it take nothing from the heap.
pub(super) type Scratch = bumpalo::Bump;

/// A list therein.
pub(super) type List<'b, T> = bumpalo::collections::Vec<'b, T>;

/// What an iterator gives up to its first error.
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
