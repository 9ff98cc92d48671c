//! Pipelines that a device has built, shared by its renderers and trainers. Building one takes a driver a hundred times
//! longer than binding it.

use super::raw_device::RawDevice;
use crate::Result;
use ash::vk;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Identifies a pipeline of a device. Kernels' constants are flags, sizes and small counts, so there are few keys.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct PipelineKey {
    pub(super) name: &'static str,
    pub(super) texels: bool,
    /// Hash of the replacement SPIR-V, if it is not the kernel's own.
    pub(super) replaced: Option<u64>,
    pub(super) subgroup_size: Option<u32>,
    pub(super) workgroup_size: [u32; 3],
    /// (constant_id, bits).
    pub(super) constants: Vec<(u32, u32)>,
}

/// Handles of a pipeline.
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
    pub(super) unsafe fn destroy(self, device: &RawDevice) {
        // SAFETY: the caller's word; null handles are allowed.
        unsafe {
            device.destroy_pipeline(self.raw, None);
            device.destroy_pipeline_layout(self.layout, None);
            device.destroy_descriptor_set_layout(self.set_layout, None);
        }
    }
}

/// Entry of one pipeline, empty until it is built. The thread that builds it holds the lock.
type Place = Arc<Mutex<Option<PipelineHandles>>>;

/// Pipelines of a device, until it is closed.
#[derive(Debug, Default)]
pub(super) struct BuiltPipelines(Mutex<HashMap<PipelineKey, Place>>);

impl BuiltPipelines {
    /// Returns the pipeline of a key, and builds it if necessary. A caller waits while another thread builds the same
    /// pipeline; threads that build different pipelines do not wait for each other.
    pub(super) fn get_or_build(
        &self,
        key: PipelineKey,
        build: impl FnOnce() -> Result<PipelineHandles>,
    ) -> Result<PipelineHandles> {
        let place = self.0.lock().unwrap_or_else(PoisonError::into_inner).entry(key).or_default().clone();
        let mut built = place.lock().unwrap_or_else(PoisonError::into_inner);
        match *built {
            Some(handles) => Ok(handles),
            None => Ok(*built.insert(build()?)),
        }
    }

    /// Returns all pipelines that have been built.
    pub(super) fn all(&self) -> Vec<(PipelineKey, PipelineHandles)> {
        let places: Vec<(PipelineKey, Place)> = (self.0.lock().unwrap_or_else(PoisonError::into_inner))
            .iter()
            .map(|(key, place)| (key.clone(), place.clone()))
            .collect();
        let built = |(key, place): (PipelineKey, Place)| {
            let handles = *place.lock().unwrap_or_else(PoisonError::into_inner);
            Some((key, handles?))
        };
        places.into_iter().filter_map(built).collect()
    }

    /// # Safety
    /// Nothing uses the pipelines any more.
    pub(super) unsafe fn close(&self, device: &RawDevice) {
        for (_, place) in self.0.lock().unwrap_or_else(PoisonError::into_inner).drain() {
            if let Some(handles) = place.lock().unwrap_or_else(PoisonError::into_inner).take() {
                // SAFETY: the caller's word.
                unsafe { handles.destroy(device) };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use std::sync::atomic::{AtomicU32, Ordering};

    fn key(name: &'static str) -> PipelineKey {
        let (subgroup_size, workgroup_size) = (None, [64, 1, 1]);
        PipelineKey {
            name,
            texels: false,
            replaced: None,
            subgroup_size,
            workgroup_size,
            constants: vec![(0, 1)],
        }
    }

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
            let ask = || built.get_or_build(key("sort"), build).expect("a pipeline").set_kind;
            let threads: Vec<_> = (0..4).map(|_| scope.spawn(ask)).collect();
            assert!(threads.into_iter().all(|thread| thread.join().expect("no panic") == 7));
        });
        assert_eq!(builds.into_inner(), 1);
    }

    #[test]
    fn a_pipeline_that_could_not_be_built_is_tried_again() {
        let built = BuiltPipelines::default();
        let failed = built.get_or_build(key("scan"), || Err(Error::argument("kernel scan", "no memory")));
        assert!(failed.is_err());
        let handles = built.get_or_build(key("scan"), || Ok(PipelineHandles::default()));
        assert!(handles.is_ok());
    }
}
