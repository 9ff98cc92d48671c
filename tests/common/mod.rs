//! Code that the tests share.

// Each test binary uses only a part of it.
#![allow(dead_code, unused_imports)]

pub mod adam;
pub mod blending;
pub mod child;
pub mod compare;
pub mod compose;
pub mod corner;
pub mod depth_points;
pub mod device;
pub mod engine;
pub mod exposures;
pub mod feature_maps;
pub mod frame;
pub mod gpu;
pub mod inverse_depth;
pub mod keys;
pub mod layout;
pub mod lens_rows;
pub mod lenses;
pub mod loss;
pub mod lpips_files;
pub mod machine;
pub mod poses;
pub mod regularizers;
pub mod scenes;
pub mod splats;
pub mod tiles;

pub use device::{assert_silent, bounded, context, count_hits, options};
use std::path::{Path, PathBuf};

/// Folder of the golden vectors and data sets: `$ASHSPLAT_SHARED`, or next to the repository.
pub fn shared_folder() -> PathBuf {
    std::env::var_os("ASHSPLAT_SHARED").map_or_else(|| root().join("../shared"), PathBuf::from)
}

/// Root folder of the repository.
pub fn root() -> PathBuf {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let is_root = |folder: &&Path| folder.join("glsl").is_dir();
    package.ancestors().find(is_root).expect("packages lie within the project").to_owned()
}
