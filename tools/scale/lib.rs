//! Scenes that are larger than one machine: `ashsplat partition`, `blocks`, `exchange`, `merge` and `tiles`.

#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::expect_used))]
// Used by the program alone.
#![allow(missing_docs)]

#[macro_use]
extern crate ashsplat_program;

pub mod block_status;
pub mod exchange;
pub mod merge;
pub mod partition;
pub mod tiles;
