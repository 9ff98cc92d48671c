//! Kernels of one shader, chosen by their specialization constants.

use super::context::Context;
use super::kernel::{Kernel, KernelInterface};
use super::recorder::Recorder;
use crate::error::{Error, Result};

/// The kernels of one shader by their specialization constants. They are built before recording.
pub struct KernelSet<K: KernelInterface>(Vec<(K::Spec, Kernel<K>)>);

impl<K: KernelInterface> Default for KernelSet<K> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<K: KernelInterface> KernelSet<K> {
    /// Builds the kernel with these constants unless it exists.
    pub fn prepare(&mut self, context: &Context, spec: K::Spec) -> Result<()> {
        if !self.0.iter().any(|(built, _)| *built == spec) {
            let kernel = Kernel::new(context, &spec)?;
            self.0.push((spec, kernel));
        }
        Ok(())
    }

    /// The kernel with these constants. If it is not built, the recording fails with an error that names it.
    pub fn get_or_fail(&self, r: &mut Recorder, spec: &K::Spec) -> Option<&Kernel<K>> {
        let found = self.0.iter().find(|(built, _)| built == spec);
        if found.is_none() {
            let problem = format!("{spec:?} is not built: prepare it before recording");
            r.fail(Error::argument(format!("kernel {}", K::NAME), problem));
        }
        found.map(|(_, kernel)| kernel)
    }
}
