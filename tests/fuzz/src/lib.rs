//! Writes inputs as files for the fuzzed readers, and limits their memory.

mod checkpoint;
pub mod hostile;

use ashsplat::scene::{Gaussians, PointCloud};
use ashsplat_files::HostMemory;
use ashsplat_files::splats::{self, ReadOptions};
use cap::Cap;
use std::alloc::System;
use std::path::{Path, PathBuf};

pub use ashsplat::Error;
pub use checkpoint::checkpoint;

#[global_allocator]
static MEMORY: Cap<System> = Cap::new(System, usize::MAX);

/// Memory that reading an input of this length may take, bytes.
pub fn allowance(bytes: usize) -> usize {
    64 * bytes + (64 << 20)
}

/// Runs a reader of an input of `bytes` bytes within its allowance. A larger allocation ends the process, which is a
/// finding. The reader gets a bound for `max_host_memory` that it must keep: the allowance minus an eighth.
pub fn within<T>(bytes: usize, read: impl FnOnce(u64) -> T) -> T {
    let allowance = allowance(bytes);
    MEMORY.set_limit(MEMORY.allocated() + allowance).expect("more than is in use");
    let bound = (allowance - allowance / 8) as u64;
    HostMemory::set_default(bound);
    let result = read(bound);
    MEMORY.set_limit(usize::MAX).expect("no bound");
    result
}

/// The value, or None for an error, whose message must be one line.
pub fn in_one_line<T>(result: Result<T, Error>) -> Option<T> {
    result.map_err(|error| assert!(!error.to_string().contains('\n'), "{error}")).ok()
}

/// Writes bytes into a file, and reads it as Gaussians, with and without unusable ones.
pub fn check_gaussians(path: &Path, bytes: &[u8]) {
    std::fs::write(path, bytes).expect("written");
    within(bytes.len(), |bound| {
        for drop_invalid in [false, true] {
            let options = ReadOptions { drop_invalid, max_host_memory: Some(bound) };
            if let Some(scene) = in_one_line(splats::read(path, &options)) {
                scene.gaussians.check_shapes().expect("shapes that fit together");
            }
        }
    });
}

/// A folder for this process' files, in memory if possible.
pub fn folder(name: &str) -> PathBuf {
    let memory = PathBuf::from("/dev/shm");
    let base = if memory.is_dir() { memory } else { std::env::temp_dir() };
    let folder = base.join(format!("ashsplat-fuzz-{name}-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder for the inputs");
    folder
}

/// Writes a valid input into the folder `ASHSPLAT_FUZZ_SEEDS`, if set; the fuzzer starts from it.
pub fn leave_seed(name: &str, bytes: &[u8]) {
    if let Some(folder) = std::env::var_os("ASHSPLAT_FUZZ_SEEDS") {
        std::fs::write(PathBuf::from(folder).join(name), bytes).expect("a seed");
    }
}

pub fn gaussians(count: usize, sh_degree: u32) -> Gaussians {
    let positions: Vec<[f32; 3]> = (0..count).map(|k| [k as f32, (k % 7) as f32, (k % 3) as f32]).collect();
    let points = PointCloud { colors: vec![[1, 2, 3]; count], positions };
    ashsplat_files::initial_gaussians(&points, sh_degree).expect("Gaussians")
}
