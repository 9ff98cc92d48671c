//! Compiler statistics of all pipelines that were built.

use super::context::Context;
use super::executables::Executable;
use crate::Result;

/// Compiler statistics of a pipeline.
#[derive(Clone, Debug, PartialEq)]
pub struct PipelineStatistics {
    /// Name of the kernel.
    pub kernel: &'static str,
    /// True for the form that reads texels.
    pub texels: bool,
    /// Required subgroup size; None: the driver's choice.
    pub subgroup_size: Option<u32>,
    /// Invocations of a workgroup on each axis.
    pub workgroup_size: [u32; 3],
    /// Specialization constants: (constant_id, bits).
    pub constants: Vec<(u32, u32)>,
    /// Its compiled programs: usually one, or one per subgroup size if the driver chooses the size.
    pub executables: Vec<Executable>,
}

impl Context {
    /// Returns the compiler's statistics of every pipeline built so far, sorted by kernel and constants. Empty without
    /// [`ContextOptions::compile_only`](super::ContextOptions::compile_only).
    ///
    /// # Errors
    /// When the driver refuses.
    pub fn pipeline_statistics(&self) -> Result<Vec<PipelineStatistics>> {
        let Some(functions) = &self.device.executables else { return Ok(Vec::new()) };
        let mut all = Vec::new();
        for (key, handles) in self.device.built.all() {
            all.push(PipelineStatistics {
                kernel: key.name,
                texels: key.texels,
                subgroup_size: key.subgroup_size,
                workgroup_size: key.workgroup_size,
                constants: key.constants,
                executables: functions.of(handles.raw)?,
            });
        }
        all.sort_by(|a, b| {
            let key = |p: &PipelineStatistics| (p.kernel, p.texels, p.constants.clone());
            key(a).cmp(&key(b))
        });
        Ok(all)
    }
}
