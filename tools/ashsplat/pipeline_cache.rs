//! The driver's compiled kernels, kept between runs of the program.

use ashsplat::vk::PipelineCacheData;
use ashsplat_files::atomic;
use std::path::PathBuf;
use std::sync::Arc;

/// Larger files are not read: something else must have written them.
const MOST_BYTES: u64 = 256 << 20;

/// Where the cache is: the file that `ASHSPLAT_PIPELINE_CACHE` names, by default `ashsplat/pipelines` in the user's folder for caches.
/// None where the variable is empty or there is no such folder.
fn file() -> Option<PathBuf> {
    if let Some(file) = std::env::var_os("ASHSPLAT_PIPELINE_CACHE") {
        return (!file.is_empty()).then(|| PathBuf::from(file));
    }
    let folder = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let caches = folder("XDG_CACHE_HOME")
        .or_else(|| folder("LOCALAPPDATA"))
        .or_else(|| Some(folder("HOME")?.join(".cache")))?;
    Some(caches.join("ashsplat").join("pipelines"))
}

/// The cache of the runs before. That it cannot be read or written stops no run: kernels are compiled anew then.
pub fn kept() -> Option<PipelineCacheData> {
    let file = file()?;
    let small = std::fs::metadata(&file).is_ok_and(|metadata| metadata.len() <= MOST_BYTES);
    let data = if small { std::fs::read(&file).unwrap_or_default() } else { Vec::new() };
    let on_close = move |data: &[u8]| {
        if let Some(folder) = file.parent() {
            std::fs::create_dir_all(folder).ok();
        }
        atomic::write(&file, |out| out.write_all(data)).ok();
    };
    Some(PipelineCacheData { data, on_close: Arc::new(on_close) })
}
