//! The program as a process: how tests start it, serve a page with it, and stop it.

// Each test binary uses a part of it.
#![allow(dead_code)]

pub mod cinema;
pub mod page;
pub mod running;
