//! Kernels that are built ahead, on threads of the host's choice.

use super::context::Context;
use super::open_device::Device;
use super::pipeline::{Demands, Pipeline};
use crate::Result;
use std::sync::{Arc, Mutex, PoisonError};

/// A kernel that is not built yet. Any thread may build it, several threads several at once: what is built serves all that
/// use the device.
#[derive(Clone)]
pub struct KernelJob {
    device: Arc<Device>,
    pub(super) demands: Demands,
    pub(super) texels: bool,
    pub(super) spirv: &'static [u32],
    pub(super) constants: Vec<(u32, u32)>,
}

/// Jobs that are collected in place of being done.
pub(super) type Jobs = Arc<Mutex<Vec<KernelJob>>>;

impl KernelJob {
    /// Path of its shader below glsl/ without extension, "sort/sort_upsweep". Several kernels may be of one shader.
    pub fn name(&self) -> &'static str {
        self.demands.name
    }

    /// Builds it, or waits for the thread that does.
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
    /// The kernels that `build` would build with the context that it is given. It may use nothing of that but kernels.
    pub(crate) fn kernel_jobs(&self, build: impl FnOnce(&Context) -> Result<()>) -> Result<Vec<KernelJob>> {
        let jobs = Jobs::default();
        build(&Context { jobs: Some(jobs.clone()), ..self.clone() })?;
        let mut list = jobs.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(std::mem::take(&mut *list))
    }

    /// Takes note of a kernel if jobs are collected: None if it is to be built now.
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
