//! Pipelines of a device, each built once, and the VkPipelineCache kept between runs.

use super::debug::vk_error;
use super::format::{Access, ImageKind, TexelFormat};
use super::lock::lock;
use crate::error::Result;
use ash::vk;
use std::collections::HashMap;
use std::fmt;
use std::sync::{Arc, Mutex};

/// A buffer of a shader.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BindingInfo {
    /// Its name, and the name of the field in `Bind`.
    pub name: &'static str,
    /// Its number in set 0.
    pub binding: u32,
    /// How the shader accesses it.
    pub access: Access,
    /// True if another binding of the shader may be the same memory while one of them is written.
    pub aliased: bool,
    /// How it is bound.
    pub kind: BindingKind,
}

/// How a buffer is bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BindingKind {
    /// Storage buffer.
    Storage,
    /// Texel buffer.
    Texels(TexelFormat),
    /// Uniform block.
    Uniform {
        /// Size of the block.
        bytes: u32,
    },
}

impl BindingKind {
    pub(super) fn descriptor_type(self) -> vk::DescriptorType {
        match self {
            Self::Storage => vk::DescriptorType::STORAGE_BUFFER,
            Self::Texels(_) => vk::DescriptorType::UNIFORM_TEXEL_BUFFER,
            Self::Uniform { .. } => vk::DescriptorType::UNIFORM_BUFFER,
        }
    }

    pub(super) fn uniform_bytes(self) -> u64 {
        match self {
            Self::Uniform { bytes } => bytes.into(),
            _ => 0,
        }
    }
}

/// An image of a shader.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ImageInfo {
    /// Its name, and the name of the field in `Bind`.
    pub name: &'static str,
    /// Its number in set 0.
    pub binding: u32,
    /// How the shader accesses it.
    pub access: Access,
    /// How it is bound.
    pub kind: ImageKind,
}

/// A kernel with its constants and its demands on a device: identifies a pipeline. Kernels' constants are flags, sizes and
/// small counts, so there are few.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct PipelineInfo {
    pub(super) name: &'static str,
    pub(super) texels: bool,
    /// Hash of the replacement SPIR-V, if it is not the kernel's own.
    pub(super) replaced: Option<u64>,
    pub(super) subgroup_size: Option<u32>,
    pub(super) workgroup_size: [u32; 3],
    pub(super) push_bytes: u32,
    pub(super) bindings: &'static [BindingInfo],
    pub(super) images: &'static [ImageInfo],
    /// (constant_id, bits).
    pub(super) constants: Vec<(u32, u32)>,
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PipelineHandles {
    pub(super) raw: vk::Pipeline,
    pub(super) layout: vk::PipelineLayout,
    /// Null if all kernels share a layout.
    pub(super) set_layout: vk::DescriptorSetLayout,
    /// Kind of its descriptor sets, without push descriptors.
    pub(super) set_kind: usize,
}

impl PipelineHandles {
    /// # Safety
    /// They are the device's, and nothing uses them any more.
    pub(super) unsafe fn destroy(self, device: &ash::Device) {
        // SAFETY: the caller's word; null handles are allowed.
        unsafe {
            device.destroy_pipeline(self.raw, None);
            device.destroy_pipeline_layout(self.layout, None);
            device.destroy_descriptor_set_layout(self.set_layout, None);
        }
    }
}

/// Entry of one pipeline, empty until it is built. The thread that builds it holds the lock.
type PipelineEntry = Arc<Mutex<Option<PipelineHandles>>>;

/// Pipelines of a device, until it is closed.
#[derive(Debug, Default)]
pub(super) struct BuiltPipelines(Mutex<HashMap<PipelineInfo, PipelineEntry>>);

impl BuiltPipelines {
    /// Returns a pipeline, and builds it if necessary. A caller waits while another thread builds the same pipeline; threads
    /// that build different pipelines do not wait for each other.
    pub(super) fn get_or_build(
        &self,
        info: &PipelineInfo,
        build: impl FnOnce() -> Result<PipelineHandles>,
    ) -> Result<PipelineHandles> {
        let entry = lock(&self.0).entry(info.clone()).or_default().clone();
        let mut built = lock(&entry);
        match *built {
            Some(handles) => Ok(handles),
            None => Ok(*built.insert(build()?)),
        }
    }

    pub(super) fn all(&self) -> Vec<(PipelineInfo, PipelineHandles)> {
        let entries = lock(&self.0).clone();
        entries.into_iter().filter_map(|(info, entry)| Some((info, (*lock(&entry))?))).collect()
    }

    /// # Safety
    /// Nothing uses the pipelines any more.
    pub(super) unsafe fn close(&self, device: &ash::Device) {
        for (_, entry) in lock(&self.0).drain() {
            if let Some(handles) = lock(&entry).take() {
                // SAFETY: the caller's word.
                unsafe { handles.destroy(device) };
            }
        }
    }
}

/// Bytes of a version-one header: length, version, vendor, device, UUID of the cache.
const HEADER_BYTES: usize = 32;

/// Identifies the device and driver version to which a pipeline cache's data belong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PipelineCacheKey {
    header: [u8; HEADER_BYTES],
}

impl PipelineCacheKey {
    fn of(properties: &vk::PhysicalDeviceProperties) -> Self {
        let version = vk::PipelineCacheHeaderVersion::ONE.as_raw() as u32;
        let words = [HEADER_BYTES as u32, version, properties.vendor_id, properties.device_id];
        let mut header = [0; HEADER_BYTES];
        let bytes = words.into_iter().flat_map(u32::to_le_bytes).chain(properties.pipeline_cache_uuid);
        header.iter_mut().zip(bytes).for_each(|(to, byte)| *to = byte);
        Self { header }
    }

    /// True if the data belong to this device. Not every driver checks this.
    fn fits(&self, data: &[u8]) -> bool {
        data.starts_with(&self.header)
    }
}

/// Hexadecimal digits, usable as a file name.
impl fmt::Display for PipelineCacheKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // The first two words are the same on all devices.
        self.header[8..].iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// Keeps the data of pipeline caches between runs.
pub trait PipelineCacheStore: fmt::Debug + Send + Sync {
    /// Returns the data of an earlier run; empty if there are none. Data of another device are ignored.
    fn load(&self, key: &PipelineCacheKey) -> Vec<u8>;

    /// Saves the data. Called when the context ends, if they have changed.
    fn save(&self, key: &PipelineCacheKey, data: &[u8]);
}

#[derive(Default)]
pub(super) struct PipelineCache {
    pub(super) raw: vk::PipelineCache,
    stored: Option<StoredCache>,
}

struct StoredCache {
    store: Arc<dyn PipelineCacheStore>,
    key: PipelineCacheKey,
    data: Vec<u8>,
}

impl PipelineCache {
    /// Uses a host's cache, which the host still owns.
    pub(super) fn of_host(raw: vk::PipelineCache) -> Self {
        Self { raw, stored: None }
    }

    /// Creates our own cache, from the data of an earlier run with the same device and driver.
    pub(super) fn of_store(
        device: &ash::Device,
        properties: &vk::PhysicalDeviceProperties,
        store: Arc<dyn PipelineCacheStore>,
    ) -> Result<Self> {
        let key = PipelineCacheKey::of(properties);
        let mut data = store.load(&key);
        if !key.fits(&data) {
            data.clear();
        }
        let info = vk::PipelineCacheCreateInfo::default().initial_data(&data);
        // SAFETY: the data are empty, or have the header of this device.
        let raw = unsafe { device.create_pipeline_cache(&info, None) };
        Ok(Self {
            raw: raw.map_err(vk_error("vkCreatePipelineCache"))?,
            stored: Some(StoredCache { store, key, data }),
        })
    }

    /// Saves the data and destroys the cache, if it is ours.
    pub(super) fn close(&mut self, device: &ash::Device) {
        let Some(stored) = self.stored.take() else { return };
        // SAFETY: the cache is ours, and no pipeline is being built any more. Pipelines do not refer to it.
        let data = unsafe {
            let data = device.get_pipeline_cache_data(self.raw);
            device.destroy_pipeline_cache(self.raw, None);
            data
        };
        self.raw = vk::PipelineCache::null();
        // A lost device returns no data; the next run then begins with the old data.
        if let Ok(data) = data
            && data != stored.data
        {
            stored.store.save(&stored.key, &data);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Error;
    use std::sync::atomic::{AtomicU32, Ordering};

    const INFO: PipelineInfo = PipelineInfo {
        name: "sort",
        texels: false,
        replaced: None,
        subgroup_size: None,
        workgroup_size: [64, 1, 1],
        push_bytes: 0,
        bindings: &[],
        images: &[],
        constants: Vec::new(),
    };

    #[test]
    fn threads_that_want_one_pipeline_build_it_once() {
        let (built, builds) = (BuiltPipelines::default(), AtomicU32::new(0));
        let build = || {
            builds.fetch_add(1, Ordering::Relaxed);
            // Long enough for the other threads to arrive.
            std::thread::sleep(std::time::Duration::from_millis(50));
            Ok(PipelineHandles { set_kind: 7, ..PipelineHandles::default() })
        };
        std::thread::scope(|scope| {
            let ask = || built.get_or_build(&INFO, build).expect("a pipeline").set_kind;
            let threads: Vec<_> = (0..4).map(|_| scope.spawn(ask)).collect();
            assert!(threads.into_iter().all(|thread| thread.join().expect("no panic") == 7));
        });
        assert_eq!(builds.into_inner(), 1);
    }

    #[test]
    fn a_pipeline_that_could_not_be_built_is_tried_again() {
        let built = BuiltPipelines::default();
        assert!(built.get_or_build(&INFO, || Err(Error::argument("kernel sort", "no memory"))).is_err());
        assert!(built.get_or_build(&INFO, || Ok(PipelineHandles::default())).is_ok());
    }

    #[test]
    fn pipeline_caches_of_other_devices_are_not_used() {
        let device = vk::PhysicalDeviceProperties { vendor_id: 7, device_id: 9, ..Default::default() };
        let mut data = [32_u32, 1, 7, 9].map(u32::to_le_bytes).concat();
        data.extend([0; 16]);
        let key = PipelineCacheKey::of(&device);
        assert!(key.fits(&data));
        assert!(!key.fits(&data[..31]) && !key.fits(&[]));
        assert_eq!(key.to_string(), format!("0700000009000000{}", "00".repeat(16)));
        for byte in 0..32 {
            let mut other = data.clone();
            other[byte] ^= 1;
            assert!(!key.fits(&other), "byte {byte}");
        }
    }
}
