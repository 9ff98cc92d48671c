//! Inputs as files for the fuzzed readers.

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
