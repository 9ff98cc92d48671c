//! Parts that the commands of the program `ashsplat` share: arguments, settings, progress, data sets, pages.

#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::expect_used))]
// Used by the program alone.
#![allow(missing_docs)]

/// Prints a line on stdout. Unlike `println!`, a failure does not panic: a training must continue. A full disk is
/// reported at the end, a closed pipe never.
#[macro_export]
macro_rules! outln {
    ($($text:tt)*) => { $crate::output::outln(format_args!($($text)*)) };
}

/// Prints a line on stderr.
#[macro_export]
macro_rules! errln {
    ($($text:tt)*) => { $crate::output::errln(format_args!($($text)*)) };
}

pub mod appearance;
pub mod args;
pub mod blocks;
pub mod child;
pub mod config;
pub mod eval;
pub mod film_file;
pub mod html;
pub mod lock;
pub mod look;
pub mod measure;
pub mod model;
pub mod output;
mod pipeline_cache;
pub mod progress;
pub mod session;
pub mod train_log;
