//! Work whose panics are errors like others.

use ashsplat::{Error, Result};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Does what others must not end with: what they hold has to be whole after a panic at any place of it.
pub fn guarded<T>(work: impl FnOnce() -> Result<T>) -> Result<T> {
    // The panic has told where.
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| Err(Error::argument("a panic", "told above")))
}
