//! The driver's compiled kernels, kept between runs of the program.

use ashsplat::vk::{PipelineCacheKey, PipelineCacheStore};
use ashsplat_files::{atomic, regular_file};
use std::path::PathBuf;
use std::sync::Arc;

/// Largest file that is read; a larger one is from another program.
const MAX_BYTES: u64 = 256 << 20;

/// A folder with a file per device and driver version.
#[derive(Debug)]
struct Folder(PathBuf);

/// The folder named by `ASHSPLAT_PIPELINE_CACHE`, by default `ashsplat/pipeline-caches` in the user's folder for
/// caches. `None` if the variable is empty or there is no such folder.
pub fn kept() -> Option<Arc<dyn PipelineCacheStore>> {
    if let Some(folder) = std::env::var_os("ASHSPLAT_PIPELINE_CACHE") {
        return if folder.is_empty() { None } else { Some(Arc::new(Folder(folder.into()))) };
    }
    let folder = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let caches = folder("XDG_CACHE_HOME")
        .or_else(|| folder("LOCALAPPDATA"))
        .or_else(|| Some(folder("HOME")?.join(".cache")))?;
    Some(Arc::new(Folder(caches.join("ashsplat").join("pipeline-caches"))))
}

/// A file that cannot be read or written is ignored: kernels are then compiled again.
impl PipelineCacheStore for Folder {
    fn load(&self, key: &PipelineCacheKey) -> Vec<u8> {
        let data = regular_file::read_at_most(self.0.join(key.to_string()), MAX_BYTES);
        data.ok().flatten().unwrap_or_default()
    }

    fn save(&self, key: &PipelineCacheKey, data: &[u8]) {
        std::fs::create_dir_all(&self.0).ok();
        atomic::write(self.0.join(key.to_string()), |out| out.write_all(data)).ok();
    }
}
