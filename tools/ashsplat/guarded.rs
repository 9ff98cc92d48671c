//! Turns panics into errors.

use ashsplat::{Error, Result};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Runs `work` and turns a panic into an error. What `work` holds must be valid after a panic at any point.
pub fn guarded<T>(work: impl FnOnce() -> Result<T>) -> Result<T> {
    // The panic has already printed its place.
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| Err(Error::argument("a panic", "told above")))
}
