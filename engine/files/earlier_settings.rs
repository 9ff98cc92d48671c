//! Settings of earlier versions that no longer exist. Files of these versions list all settings.

use std::fmt::Display;

/// Switch for steps from the gradients of several views, which no longer exist.
const MULTI_STEP: &str = "multi_step";

/// Removes such settings from a table by `take`, which takes a name and returns the value.
///
/// # Errors
/// The problem, if the table switches one of them on: without it a training has other bits.
pub fn remove_earlier<V: Display>(take: impl FnOnce(&str) -> Option<V>) -> Result<(), String> {
    let value = take(MULTI_STEP).map(|value| value.to_string());
    match value.filter(|value| value != "false") {
        Some(value) => Err(format!("has {MULTI_STEP} = {value}, but steps of several views no longer exist")),
        None => Ok(()),
    }
}
