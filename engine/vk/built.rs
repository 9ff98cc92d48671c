//! The pipelines that a device has built, for all that use them: a driver takes a hundred times longer to build one than to
//! bind it, and renderers and trainers on one device need the same ones.

use super::raw_device::RawDevice;
use crate::Result;
use ash::vk;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

/// What tells one pipeline of a device from another. Kernels have no constants but flags, sizes and numbers of things of
/// a few kinds, so that there are not many.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct PipelineKey {
    pub(super) name: &'static str,
    pub(super) texels: bool,
    /// Of its SPIR-V, where that is not the kernel's own.
    pub(super) replaced: Option<u64>,
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

/// One pipeline's place, empty until it is built. A thread that builds it holds the lock.
type Place = Arc<Mutex<Option<PipelineHandles>>>;

/// The pipelines of a device, until it is closed.
#[derive(Debug, Default)]
pub(super) struct BuiltPipelines(Mutex<HashMap<PipelineKey, Place>>);

impl BuiltPipelines {
    /// The pipeline of a key. Whoever asks while another thread builds it waits for that one, and threads that build other
    /// pipelines do not wait for each other.
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

    /// All that have been built.
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
            // Long enough for the others to come.
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
