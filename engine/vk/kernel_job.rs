//! Kernels that are built ahead, on the host's threads.

use super::context::Context;
use super::open_device::Device;
use super::pipeline::{Demands, Pipeline};
use crate::Result;
use std::sync::{Arc, Mutex, PoisonError};

/// A kernel that is not built yet. Any thread may build it, and threads may build several at once. All users of the device
/// share the built pipeline.
#[derive(Clone)]
pub struct KernelJob {
    device: Arc<Device>,
    pub(super) demands: Demands,
    pub(super) texels: bool,
    pub(super) spirv: &'static [u32],
    pub(super) constants: Vec<(u32, u32)>,
}

/// Jobs that are collected instead of being built.
pub(super) type Jobs = Arc<Mutex<Vec<KernelJob>>>;

impl KernelJob {
    /// Path of its shader below glsl/ without extension, "sort/sort_upsweep". Several kernels may have the same shader.
    pub fn name(&self) -> &'static str {
        self.demands.name
    }

    /// Builds it, or waits for the thread that builds it.
    ///
    /// # Errors
    /// When the driver refuses it.
    pub fn build(self) -> Result<()> {
        let form = (self.texels, None, self.spirv);
        Pipeline::shared(&self.device, &self.demands, form, self.constants).map(drop)
    }

    fn is(&self, other: &Self) -> bool {
        let key = |job: &Self| (job.demands.key(), job.texels);
        key(self) == key(other) && self.constants == other.constants
    }
}

impl Context {
    /// Returns the kernels that `build` would build. `build` may use its context only to build kernels.
    pub(crate) fn kernel_jobs(&self, build: impl FnOnce(&Context) -> Result<()>) -> Result<Vec<KernelJob>> {
        let jobs = Jobs::default();
        build(&Context { jobs: Some(jobs.clone()), ..self.clone() })?;
        let mut list = jobs.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(std::mem::take(&mut *list))
    }

    /// Adds a kernel to the jobs if they are collected. None: the caller builds it now.
    pub(super) fn collect_job(
        &self,
        demands: &Demands,
        (texels, spirv): (bool, &'static [u32]),
        constants: &[(u32, u32)],
    ) -> Option<Pipeline> {
        let jobs = self.jobs.as_ref()?;
        let (device, demands) = (self.device.clone(), demands.clone());
        let job = KernelJob { device, demands, texels, spirv, constants: constants.to_vec() };
        let pipeline = Pipeline::never_built(&self.device, &job.demands);
        let mut jobs = jobs.lock().unwrap_or_else(PoisonError::into_inner);
        if !jobs.iter().any(|other| other.is(&job)) {
            jobs.push(job);
        }
        Some(pipeline)
    }
}
