//! The readers alone: the modules that know no Vulkan, compiled from their own place, and inputs as files for them.

// A part of the crate is here, and not all of that part is used.
#![allow(dead_code, rustdoc::broken_intra_doc_links)]

#[path = "../../../engine/error.rs"]
pub mod error;
#[path = "../../../engine/fingerprint.rs"]
pub mod fingerprint;
#[path = "../../../engine/io/mod.rs"]
pub mod io;
#[path = "../../../engine/metrics.rs"]
pub mod metrics;
#[path = "../../../engine/scene/mod.rs"]
pub mod scene;
pub mod trainer;

pub use error::{Error, Result};
use std::path::PathBuf;

/// A folder in memory, where there is such a thing, for this process' files.
pub fn folder(name: &str) -> PathBuf {
    let memory = PathBuf::from("/dev/shm");
    let base = if memory.is_dir() { memory } else { std::env::temp_dir() };
    let folder = base.join(format!("ashsplat-fuzz-{name}-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder for the inputs");
    folder
}

/// Puts a valid input where the fuzzer begins: into the folder `ASHSPLAT_FUZZ_SEEDS`, if it is set.
pub fn leave_seed(name: &str, bytes: &[u8]) {
    if let Some(folder) = std::env::var_os("ASHSPLAT_FUZZ_SEEDS") {
        std::fs::write(PathBuf::from(folder).join(name), bytes).expect("a seed");
    }
}
