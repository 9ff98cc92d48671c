//! The program, the files that it reads and writes, and the order of modules: one binary, one Vulkan context.

#![allow(clippy::disallowed_methods, clippy::expect_used)]

extern crate ashsplat_reference as reference;

mod bench;
mod cli;
mod common;
mod compiled;
mod host;
mod profile;
mod program;
mod recipes;
mod viewer;
