//! The VkPipelineCache with which kernels are built: a host's, our own, or none.

use super::debug::vk_error;
use crate::Result;
use ash::vk;
use std::fmt;
use std::sync::Arc;

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

/// Cache of an open device.
#[derive(Default)]
pub(super) struct PipelineCache {
    pub(super) raw: vk::PipelineCache,
    own: Option<Own>,
}

/// A cache of our own.
struct Own {
    store: Arc<dyn PipelineCacheStore>,
    key: PipelineCacheKey,
    /// Data loaded at the beginning.
    data: Vec<u8>,
}

impl PipelineCache {
    /// Uses a host's cache, which the host still owns.
    pub(super) fn of_host(raw: vk::PipelineCache) -> Self {
        Self { raw, own: None }
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
        Ok(Self { raw: raw.map_err(vk_error("vkCreatePipelineCache"))?, own: Some(Own { store, key, data }) })
    }

    /// Saves the data and destroys the cache, if it is ours.
    pub(super) fn close(&mut self, device: &ash::Device) {
        let Some(own) = self.own.take() else { return };
        // SAFETY: the cache is ours, and no pipeline is being built any more. Pipelines do not refer to it.
        let data = unsafe {
            let data = device.get_pipeline_cache_data(self.raw);
            device.destroy_pipeline_cache(self.raw, None);
            data
        };
        self.raw = vk::PipelineCache::null();
        // A lost device returns no data; the next run then begins with the old data.
        if let Ok(data) = data
            && data != own.data
        {
            own.store.save(&own.key, &data);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::PipelineCacheKey;
    use ash::vk;

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
