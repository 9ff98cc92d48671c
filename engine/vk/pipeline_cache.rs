//! The VkPipelineCache that kernels are built with: a host's, our own, or none.

use super::error::vk_error;
use crate::Result;
use ash::vk;
use std::fmt;
use std::sync::Arc;

/// Gets the data of a pipeline cache.
pub type PipelineCacheSink = Arc<dyn Fn(&[u8]) + Send + Sync>;

/// A cache of our own: what it begins with, and who gets its data at the end.
#[derive(Clone)]
pub struct PipelineCacheData {
    /// The data of a run before; empty or of another device: the cache begins empty.
    pub data: Vec<u8>,
    /// Called with the data when the context ends, if they have changed.
    pub on_close: PipelineCacheSink,
}

impl fmt::Debug for PipelineCacheData {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("PipelineCacheData").field("bytes", &self.data.len()).finish_non_exhaustive()
    }
}

/// The cache of an open device.
#[derive(Default)]
pub(super) struct PipelineCache {
    pub(super) raw: vk::PipelineCache,
    own: Option<PipelineCacheData>,
}

impl PipelineCache {
    /// A host's, which stays the host's.
    pub(super) fn of_host(raw: vk::PipelineCache) -> Self {
        Self { raw, own: None }
    }

    /// Our own, from the data of a run before, where these are of the same device and driver.
    pub(super) fn of_data(
        device: &ash::Device,
        properties: &vk::PhysicalDeviceProperties,
        own: PipelineCacheData,
    ) -> Result<Self> {
        let data = if fits(&own.data, properties) { own.data.as_slice() } else { &[] };
        let info = vk::PipelineCacheCreateInfo::default().initial_data(data);
        // SAFETY: the data are empty, or have the header of this device.
        let raw = unsafe { device.create_pipeline_cache(&info, None) };
        Ok(Self { raw: raw.map_err(vk_error("vkCreatePipelineCache"))?, own: Some(own) })
    }

    /// Hands out the data and destroys the cache, if it is ours.
    pub(super) fn close(&mut self, device: &ash::Device) {
        let Some(own) = self.own.take() else { return };
        // SAFETY: the cache is ours, and no pipeline is being built any more. Pipelines do not refer to it.
        let data = unsafe {
            let data = device.get_pipeline_cache_data(self.raw);
            device.destroy_pipeline_cache(self.raw, None);
            data
        };
        self.raw = vk::PipelineCache::null();
        // A lost device has none; the next run then begins with what there was.
        if let Ok(data) = data
            && data != own.data
        {
            (own.on_close)(&data);
        }
    }
}

/// Bytes of the header of version one: its length, its version, vendor, device, UUID of the cache.
const HEADER_BYTES: usize = 32;

/// Whether data have the header that a device's own have. Not every driver checks.
fn fits(data: &[u8], properties: &vk::PhysicalDeviceProperties) -> bool {
    let mut header = Vec::with_capacity(HEADER_BYTES);
    let version = vk::PipelineCacheHeaderVersion::ONE.as_raw() as u32;
    for word in [HEADER_BYTES as u32, version, properties.vendor_id, properties.device_id] {
        header.extend(word.to_le_bytes());
    }
    header.extend(properties.pipeline_cache_uuid);
    data.starts_with(&header)
}

#[cfg(test)]
mod tests {
    use super::fits;
    use ash::vk;

    #[test]
    fn pipeline_caches_of_other_devices_are_not_used() {
        let device = vk::PhysicalDeviceProperties { vendor_id: 7, device_id: 9, ..Default::default() };
        let mut data = [32_u32, 1, 7, 9].map(u32::to_le_bytes).concat();
        data.extend([0; 16]);
        assert!(fits(&data, &device));
        assert!(!fits(&data[..31], &device) && !fits(&[], &device));
        for byte in 0..32 {
            let mut other = data.clone();
            other[byte] ^= 1;
            assert!(!fits(&other, &device), "byte {byte}");
        }
    }
}
