//! Measures the highest arithmetic rate of the device's shaders: chains of multiply-adds on registers.

use crate::error::Result;
use crate::kernels::arithmetic::multiply_add;
use crate::kernels::constants as c;
use crate::vk::{Buffer, Context, Kernel, Recorder};

/// Rounds per invocation: enough that the start of an invocation takes a negligible part.
const ROUNDS: u32 = 1024;
/// Factor of a step. Values stay finite for any number of steps, because the fixed point is 2.
const FACTOR: f32 = 0.75;
const TERM: f32 = 0.5;

/// Kernel of the measurement.
pub struct Arithmetic {
    kernel: Kernel<multiply_add::Interface>,
    workgroup_size: u32,
}

impl Arithmetic {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        let workgroup_size = context.limits().workgroup_size(256);
        let spec = multiply_add::Spec { workgroup_size, rounds: ROUNDS };
        Ok(Self { kernel: Kernel::new(context, &spec)?, workgroup_size })
    }

    /// Records one dispatch with one invocation per f32 of `results`. The caller places barriers.
    pub fn record(&self, recorder: &mut Recorder, results: &Buffer) {
        let count = (results.bytes() / 4) as u32;
        let push = multiply_add::Push { count, factor: FACTOR, term: TERM };
        let workgroups = count.div_ceil(self.workgroup_size);
        recorder.dispatch(&self.kernel, &multiply_add::Bind { results }, &push, workgroups.into());
    }

    /// Operations of a dispatch for `count` results. A multiplication and an addition count as one each.
    pub fn operations(&self, count: u64) -> u64 {
        let invocations = count.next_multiple_of(self.workgroup_size.into());
        let steps = u64::from(ROUNDS * c::MULTIPLY_ADD_CHAINS * c::MULTIPLY_ADD_STEPS);
        invocations * steps * 2
    }
}
