//! The pipelines that a device has built, for all that use them: a driver takes a hundred times longer to build one than to
//! bind it, and renderers and trainers on one device need the same ones.

use super::raw_device::RawDevice;
use ash::vk;
use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

/// What tells one pipeline of a device from another. Kernels have no constants but flags, sizes and numbers of things of
/// a few kinds, so that there are not many.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct PipelineKey {
    pub(super) name: &'static str,
    pub(super) texels: bool,
    pub(super) subgroup_size: Option<u32>,
    pub(super) workgroup_size: [u32; 3],
    /// (constant_id, bits).
    pub(super) constants: Vec<(u32, u32)>,
}

/// The handles of a pipeline.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PipelineHandles {
    pub(super) raw: vk::Pipeline,
    pub(super) layout: vk::PipelineLayout,
    /// Null if all kernels share a layout.
    pub(super) set_layout: vk::DescriptorSetLayout,
    /// The kind of its sets without push descriptors.
    pub(super) set_kind: usize,
}

impl PipelineHandles {
    /// # Safety
    /// They are the device's, and nothing uses them any more.
    pub(super) unsafe fn destroy(self, device: &RawDevice) {
        // SAFETY: the caller's word; null handles are allowed.
        unsafe {
            device.destroy_pipeline(self.raw, None);
            device.destroy_pipeline_layout(self.layout, None);
            device.destroy_descriptor_set_layout(self.set_layout, None);
        }
    }
}

/// The pipelines of a device, until it is closed.
#[derive(Debug, Default)]
pub(super) struct BuiltPipelines(Mutex<HashMap<PipelineKey, PipelineHandles>>);

impl BuiltPipelines {
    pub(super) fn find(&self, key: &PipelineKey) -> Option<PipelineHandles> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).get(key).copied()
    }

    /// Takes over a pipeline; false if another thread has built the same in the meantime.
    pub(super) fn keep(&self, key: PipelineKey, handles: PipelineHandles) -> bool {
        let mut built = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let is_new = !built.contains_key(&key);
        built.entry(key).or_insert(handles);
        is_new
    }

    /// # Safety
    /// Nothing uses the pipelines any more.
    pub(super) unsafe fn close(&self, device: &RawDevice) {
        for (_, handles) in self.0.lock().unwrap_or_else(PoisonError::into_inner).drain() {
            // SAFETY: the caller's word.
            unsafe { handles.destroy(device) };
        }
    }
}
