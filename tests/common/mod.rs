//! What the tests share.

// Each test binary uses a part of it.
#![allow(dead_code, unused_imports)]

pub mod compare;
pub mod device;
pub mod npz;
pub mod scenes;

pub use device::{assert_silent, context, options};
