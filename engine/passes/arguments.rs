//! Arguments of the indirect dispatches over what a frame counts: its visible Gaussians, its instances.

use crate::error::Result;
use crate::frame::{FrameBuffers, LaunchSizes};
use crate::kernels::forward::write_indirect_args;
use crate::vk::{Context, Kernel, Recorder};

/// A count that the device knows, and where its dispatches' arguments are written.
pub(crate) struct Counted {
    /// Index of the count (STATE_*).
    pub count: u32,
    /// Largest number that the buffers hold.
    pub capacity: u32,
    /// Index of the first of three arguments (ARGUMENTS_*): elementwise, of the sort, of the caller (scan or duplicate).
    pub first_argument: u32,
    /// Elements per workgroup of the caller's dispatch.
    pub caller_block: u32,
}

/// Kernel that writes indirect arguments.
pub(crate) struct IndirectArguments {
    sizes: LaunchSizes,
    max_workgroups_per_axis: u32,
    write: Kernel<write_indirect_args::Interface>,
}

impl IndirectArguments {
    pub fn new(context: &Context) -> Result<Self> {
        let limits = context.limits();
        Ok(Self {
            sizes: LaunchSizes::new(limits),
            max_workgroups_per_axis: limits.max_workgroups_per_axis,
            write: Kernel::new(context, &write_indirect_args::Spec::default())?,
        })
    }

    pub fn record(&self, r: &mut Recorder, f: &FrameBuffers, counted: Counted) {
        let Counted { count: count_index, capacity, first_argument, caller_block } = counted;
        let push = write_indirect_args::Push {
            count_index,
            capacity,
            first_argument,
            block_elementwise: self.sizes.elementwise_workgroup,
            block_sort: self.sizes.sort,
            caller_block,
            max_workgroups_per_axis: self.max_workgroups_per_axis,
        };
        let bind = write_indirect_args::Bind { state: &f.state, arguments: &f.arguments };
        r.dispatch(&self.write, &bind, &push, 1);
    }
}
