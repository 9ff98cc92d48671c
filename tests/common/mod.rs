//! Code that the tests share.

// Each test binary uses only a part of it.
#![allow(dead_code, unused_imports)]

pub mod adam;
pub mod blending;
pub mod child;
pub mod compare;
pub mod corner;
pub mod device;
pub mod engine;
pub mod frame;
pub mod gpu;
pub mod layout;
pub mod lenses;
pub mod lpips_files;
pub mod machine;
pub mod poses;
pub mod prelude;
pub mod scenes;
mod slashes;
pub mod splats;
pub mod terms;
pub mod training;

pub use device::{assert_silent, bounded, context, count_hits, options};
pub use slashes::with_slashes;
use std::path::{Path, PathBuf};

/// Folder of the golden vectors and data sets: `$ASHSPLAT_SHARED`, or next to the repository.
pub fn shared_folder() -> PathBuf {
    std::env::var_os("ASHSPLAT_SHARED").map_or_else(|| root().join("../shared"), PathBuf::from)
}

pub fn root() -> PathBuf {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let is_root = |folder: &&Path| folder.join("glsl").is_dir();
    package.ancestors().find(is_root).expect("packages lie within the project").to_owned()
}

/// All files below a folder, sorted, with relative paths. None if there is no such folder.
pub fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        let Ok(entries) = std::fs::read_dir(&next) else { continue };
        for entry in entries {
            let path = entry.expect("a folder's entry").path();
            if path.is_dir() {
                folders.push(path);
            } else {
                files.push(path.strip_prefix(folder).expect("below the folder").to_owned());
            }
        }
    }
    files.sort();
    files
}

#[track_caller]
pub fn assert_says(message: impl AsRef<str>, words: &[&str]) {
    let message = with_slashes(message.as_ref());
    for word in words {
        assert!(message.contains(&with_slashes(word)), "no '{word}' in: {message}");
    }
}

/// Paths of these names in a new folder, which exists as long as the first value.
pub fn new_paths<const N: usize>(names: [&str; N]) -> (tempfile::TempDir, [PathBuf; N]) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let paths = names.map(|name| folder.path().join(name));
    (folder, paths)
}
