//! Conversions of a host's pointers.

use ashsplat::{Error, Result};
use std::ffi::{CStr, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};

fn null(what: &str) -> Error {
    Error::argument(what, "the pointer is null")
}

/// The object behind a pointer.
///
/// # Safety
/// The pointer is null or valid for the call.
pub(super) unsafe fn borrowed<'a, T>(pointer: *const T, what: &str) -> Result<&'a T> {
    // SAFETY: as promised.
    unsafe { pointer.as_ref() }.ok_or_else(|| null(what))
}

/// The object behind a pointer, to change it.
///
/// # Safety
/// The pointer is null or valid for the call, and the object has no other user meanwhile.
pub(super) unsafe fn borrowed_mut<'a, T>(pointer: *mut T, what: &str) -> Result<&'a mut T> {
    // SAFETY: as promised.
    unsafe { pointer.as_mut() }.ok_or_else(|| null(what))
}

/// The objects behind a pointer and a count.
///
/// # Safety
/// The pointer is valid for `count` objects, or the count is 0.
pub(super) unsafe fn slice<'a, T>(pointer: *const T, count: usize, what: &str) -> Result<&'a [T]> {
    match (pointer.is_null(), count) {
        (_, 0) => Ok(&[]),
        (true, _) => Err(null(what)),
        // SAFETY: as promised.
        (false, _) => Ok(unsafe { std::slice::from_raw_parts(pointer, count) }),
    }
}

/// Same as [`slice`], with the same promise, but the pointer may be null.
pub(super) unsafe fn slice_if<'a, T>(pointer: *const T, count: usize, what: &str) -> Result<Option<&'a [T]>> {
    // SAFETY: as promised.
    if pointer.is_null() { Ok(None) } else { unsafe { slice(pointer, count, what) }.map(Some) }
}

/// Number of floats in an RGB picture.
pub(super) fn rgb_floats(width: u32, height: u32) -> Result<usize> {
    let floats = (width as usize).checked_mul(height as usize).and_then(|pixels| pixels.checked_mul(3));
    let floats = floats.filter(|floats| *floats <= isize::MAX as usize / size_of::<f32>());
    floats.ok_or_else(|| Error::argument("width, height", format!("{width}x{height} pixels are too many")))
}

/// Refuses a null pointer for results, before the work.
pub(super) fn check_pointer<T>(pointer: *const T, what: &str) -> Result<()> {
    if pointer.is_null() { Err(null(what)) } else { Ok(()) }
}

/// Writes an answer.
///
/// # Safety
/// `to` is null or valid for a write.
pub(super) unsafe fn put<T>(to: *mut T, what: &str, answer: T) -> Result<()> {
    // SAFETY: as promised.
    *unsafe { borrowed_mut(to, what)? } = answer;
    Ok(())
}

/// Writes an answer, unless the host passes null.
///
/// # Safety
/// `to` is null or valid for a write.
pub(super) unsafe fn put_if<T>(to: *mut T, answer: T) {
    // SAFETY: as promised.
    if let Some(to) = unsafe { to.as_mut() } {
        *to = answer;
    }
}

/// Writes numbers into a host's array.
///
/// # Safety
/// `to` is valid for as many writes as `from` has numbers.
pub(super) unsafe fn fill(to: *mut f32, from: &[f32]) {
    // SAFETY: as promised.
    unsafe { std::ptr::copy_nonoverlapping(from.as_ptr(), to, from.len()) }
}

/// Reads a C string in UTF-8.
///
/// # Safety
/// The pointer is null or a C string.
pub(super) unsafe fn text<'a>(pointer: *const c_char, what: &str) -> Result<&'a str> {
    check_pointer(pointer, what)?;
    // SAFETY: as promised.
    let text = unsafe { CStr::from_ptr(pointer) };
    text.to_str().map_err(|_| Error::argument(what, "is not UTF-8"))
}

/// Moves a new object to the host.
///
/// # Safety
/// `to` is null or valid for a write.
pub(super) unsafe fn give<T>(to: *mut *mut T, what: &str, make: impl FnOnce() -> Result<T>) -> Result<()> {
    // SAFETY: as promised.
    let to = unsafe { borrowed_mut(to, what)? };
    *to = std::ptr::null_mut();
    *to = Box::into_raw(Box::new(make()?));
    Ok(())
}

/// Drops an object of the host.
///
/// # Safety
/// The pointer is null or came from `give`, and is not used afterwards.
pub(super) unsafe fn take<T>(pointer: *mut T) {
    if !pointer.is_null() {
        // SAFETY: as promised.
        let _ = catch_unwind(AssertUnwindSafe(|| drop(unsafe { Box::from_raw(pointer) })));
    }
}
