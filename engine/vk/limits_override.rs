//! For tests: stricter limits than the device's.

use super::limits::Limits;

/// Stricter limits than the device's; `None` keeps the device's.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LimitsOverride {
    /// For [`Limits::max_storage_buffer_range`].
    pub max_storage_buffer_range: Option<u64>,
    /// For [`Limits::max_allocation_bytes`].
    pub max_allocation_bytes: Option<u64>,
    /// For [`Limits::max_workgroups_per_axis`].
    pub max_workgroups_per_axis: Option<u32>,
    /// For [`Limits::max_workgroup_invocations`].
    pub max_workgroup_invocations: Option<u32>,
    /// For [`Limits::shared_memory_bytes`].
    pub shared_memory_bytes: Option<u32>,
    /// For [`Limits::push_constant_bytes`].
    pub push_constant_bytes: Option<u32>,
    /// For [`Limits::max_workgroup_subgroups`].
    pub max_workgroup_subgroups: Option<u32>,
    /// For [`Limits::max_push_descriptors`].
    pub max_push_descriptors: Option<u32>,
    /// For [`Limits::max_texels`].
    pub max_texels: Option<u64>,
    /// For [`Limits::subgroup_size`]: emulates a device with this size that does not let it be required.
    pub fixed_subgroup_size: Option<u32>,
    /// For [`Limits::instances_per_dispatch`].
    pub instances_per_dispatch: Option<u32>,
}

impl Limits {
    /// Lowers each limit to the override's value. An override never raises a limit, except the fixed subgroup size.
    pub fn lowered(mut self, to: &LimitsOverride) -> Self {
        fn lower<T: Ord + Copy>(limit: &mut T, to: Option<T>) {
            *limit = to.map_or(*limit, |to| to.min(*limit));
        }
        lower(&mut self.max_storage_buffer_range, to.max_storage_buffer_range);
        lower(&mut self.max_allocation_bytes, to.max_allocation_bytes);
        lower(&mut self.max_workgroups_per_axis, to.max_workgroups_per_axis);
        lower(&mut self.max_workgroup_invocations, to.max_workgroup_invocations);
        lower(&mut self.shared_memory_bytes, to.shared_memory_bytes);
        lower(&mut self.push_constant_bytes, to.push_constant_bytes);
        lower(&mut self.max_workgroup_subgroups, to.max_workgroup_subgroups);
        lower(&mut self.max_push_descriptors, to.max_push_descriptors);
        lower(&mut self.max_texels, to.max_texels);
        lower(&mut self.instances_per_dispatch, to.instances_per_dispatch);
        if let Some(size) = to.fixed_subgroup_size {
            [self.subgroup_size, self.heavy_subgroup_size, self.own_subgroup_size] = [size; 3];
            self.subgroup_size_selectable = false;
        }
        self
    }
}
