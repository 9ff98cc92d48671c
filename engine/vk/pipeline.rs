//! Vulkan compute pipelines: their demands on the device, and their creation.

use super::binding::{BindingInfo, BindingKind, ImageInfo};
use super::built::{PipelineHandles, PipelineKey};
use super::debug::vk_error;
use super::descriptors::{kind_of, layout_binding};
use super::limits::Limits;
use super::open_device::Device;
use super::spirv::SubgroupRules;
use crate::{Error, Result};
use ash::vk;
use std::sync::Arc;

/// Demands of a pipeline on the device.
#[derive(Clone, Debug)]
pub(super) struct Demands {
    pub(super) name: &'static str,
    pub(super) subgroup_size: Option<u32>,
    pub(super) workgroup_size: [u32; 3],
    pub(super) shared_bytes: u32,
    pub(super) push_bytes: u32,
    pub(super) bindings: &'static [BindingInfo],
    pub(super) images: &'static [ImageInfo],
}

impl Demands {
    /// Key that distinguishes kernels of one device, together with form and constants.
    pub(super) fn key(&self) -> (&'static str, Option<u32>, [u32; 3]) {
        (self.name, self.subgroup_size, self.workgroup_size)
    }
}

/// Fails for a kernel that exceeds the device's limits.
pub(super) fn check(d: &Demands, limits: &Limits) -> Result<()> {
    let argument = |problem| Err(Error::argument(format!("kernel {}", d.name), problem));
    let [x, y, z] = d.workgroup_size;
    let invocations = u64::from(x) * u64::from(y) * u64::from(z);
    if invocations == 0 {
        return argument("a workgroup of no invocations".to_owned());
    }
    if d.bindings.iter().any(|b| matches!(b.kind, BindingKind::Texels(_))) && limits.max_texels == 0 {
        return argument("reads texels, which takes VK_KHR_push_descriptor and shaderInt64".to_owned());
    }
    if let Some(size) = d.subgroup_size {
        let (min, max) = (limits.min_subgroup_size, limits.max_subgroup_size);
        if size != limits.subgroup_size && !limits.subgroup_size_selectable {
            return argument(format!("subgroup size {size}: the device has only {}", limits.subgroup_size));
        }
        if !size.is_power_of_two() || (limits.subgroup_size_selectable && !(min..=max).contains(&size)) {
            return argument(format!("subgroup size {size}: the device has {min} to {max}, powers of two"));
        }
        if !x.is_multiple_of(size) {
            return argument(format!("workgroup size {x} is no multiple of subgroup size {size}"));
        }
    }
    let bindings = d.bindings.len() as u64;
    let uniform_bytes = d.bindings.iter().map(|b| b.kind.uniform_bytes()).max().unwrap_or(0);
    let subgroups = d.subgroup_size.map_or(0, |size| invocations / u64::from(size));
    let bounds = [
        (
            "workgroup",
            invocations,
            "invocations",
            limits.max_workgroup_invocations,
            "maxComputeWorkGroupInvocations",
        ),
        ("workgroup", x.into(), "invocations", limits.max_workgroup_size[0], "maxComputeWorkGroupSize[0]"),
        ("workgroup", y.into(), "invocations", limits.max_workgroup_size[1], "maxComputeWorkGroupSize[1]"),
        ("workgroup", z.into(), "invocations", limits.max_workgroup_size[2], "maxComputeWorkGroupSize[2]"),
        ("workgroup", subgroups, "subgroups", limits.max_workgroup_subgroups, "maxComputeWorkgroupSubgroups"),
        (
            "shared memory",
            d.shared_bytes.into(),
            "bytes",
            limits.shared_memory_bytes,
            "maxComputeSharedMemorySize",
        ),
        ("push constants", d.push_bytes.into(), "bytes", limits.push_constant_bytes, "maxPushConstantsSize"),
        ("uniform block", uniform_bytes, "bytes", limits.max_uniform_range, "maxUniformBufferRange"),
        ("bindings", bindings, "buffers", limits.max_push_descriptors, "maxPushDescriptors"),
        ("bindings", bindings, "buffers", MAX_BINDINGS as u32, "of this crate"),
    ];
    for (what, needed, unit, limit, limit_name) in bounds {
        if needed > u64::from(limit) {
            let what = format!("kernel {}: {what}", d.name);
            return Err(Error::TooLarge { what, needed, unit, limit: limit.into(), limit_name });
        }
    }
    Ok(())
}

/// Most buffers of one kernel.
pub(super) const MAX_BINDINGS: usize = 32;

/// Vulkan objects of a [`super::Kernel`].
pub(super) struct Pipeline {
    inner: Arc<Device>,
    pub(super) name: &'static str,
    pub(super) bindings: &'static [BindingInfo],
    pub(super) images: &'static [ImageInfo],
    pub(super) handles: PipelineHandles,
    /// True if the device owns the handles and destroys them.
    shared: bool,
    pub(super) workgroup_size: [u32; 3],
}

impl Pipeline {
    /// Returns a placeholder that no recording can use.
    pub(super) fn never_built(inner: &Arc<Device>, demands: &Demands) -> Self {
        let mut pipeline = Self::unbuilt(inner, demands);
        pipeline.shared = true;
        pipeline
    }

    /// Returns the device's shared pipeline, and builds it if there is none.
    pub(super) fn shared(
        inner: &Arc<Device>,
        demands: &Demands,
        (texels, replaced, spirv): (bool, Option<u64>, &[u32]),
        constants: Vec<(u32, u32)>,
    ) -> Result<Self> {
        let Demands { name, subgroup_size, workgroup_size, .. } = *demands;
        let key = PipelineKey {
            name,
            texels,
            replaced,
            subgroup_size,
            workgroup_size,
            constants: constants.clone(),
        };
        let mut pipeline = Self::unbuilt(inner, demands);
        pipeline.handles = inner.built.get_or_build(key, || {
            let mut new = Self::new(inner, demands, spirv, &constants)?;
            new.shared = true;
            Ok(new.handles)
        })?;
        pipeline.shared = true;
        Ok(pipeline)
    }

    fn unbuilt(inner: &Arc<Device>, demands: &Demands) -> Self {
        Self {
            inner: inner.clone(),
            name: demands.name,
            bindings: demands.bindings,
            images: demands.images,
            handles: PipelineHandles::default(),
            shared: false,
            workgroup_size: demands.workgroup_size,
        }
    }

    pub(super) fn new(
        inner: &Arc<Device>,
        demands: &Demands,
        spirv: &[u32],
        constants: &[(u32, u32)],
    ) -> Result<Self> {
        let mut pipeline = Self::unbuilt(inner, demands);
        pipeline.create_layout(demands.push_bytes)?;
        pipeline.create_pipeline(spirv, constants, demands.subgroup_size)?;
        if pipeline.handles.set_layout != vk::DescriptorSetLayout::null() {
            inner.names.name(pipeline.handles.set_layout, &format!("{} set layout", demands.name));
        }
        inner.names.name(pipeline.handles.layout, &format!("{} layout", demands.name));
        inner.names.name(pipeline.handles.raw, demands.name);
        Ok(pipeline)
    }

    pub(super) fn is_of(&self, inner: &Arc<Device>) -> bool {
        Arc::ptr_eq(&self.inner, inner)
    }

    fn create_layout(&mut self, push_bytes: u32) -> Result<()> {
        let device = &self.inner.device;
        let buffers = self.bindings.iter().map(|b| (b.binding, b.kind.descriptor_type()));
        let images = self.images.iter().map(|i| (i.binding, i.kind.descriptor_type()));
        let all = buffers.chain(images);
        let bindings: Vec<_> = all.map(|(binding, kind)| layout_binding(binding, kind)).collect();
        let set = vk::DescriptorSetLayoutCreateInfo::default()
            .flags(vk::DescriptorSetLayoutCreateFlags::PUSH_DESCRIPTOR_KHR)
            .bindings(&bindings);
        // SAFETY: valid create infos; the number of bindings and push bytes was checked against the limits.
        unsafe {
            let sets = match (&self.inner.shared_layouts, kind_of(&bindings)) {
                (Some(layouts), Some(kind)) => {
                    self.handles.set_kind = kind;
                    [layouts[kind]]
                }
                (Some(_), None) => {
                    let problem = "has several images or uniform blocks, which takes VK_KHR_push_descriptor";
                    return Err(Error::argument(format!("kernel {}", self.name), problem));
                }
                (None, _) => {
                    let layout = device.create_descriptor_set_layout(&set, None);
                    self.handles.set_layout = layout.map_err(vk_error("vkCreateDescriptorSetLayout"))?;
                    [self.handles.set_layout]
                }
            };
            let ranges = [vk::PushConstantRange::default()
                .stage_flags(vk::ShaderStageFlags::COMPUTE)
                .size(push_bytes)];
            let mut info = vk::PipelineLayoutCreateInfo::default().set_layouts(&sets);
            if push_bytes > 0 {
                info = info.push_constant_ranges(&ranges);
            }
            self.handles.layout =
                device.create_pipeline_layout(&info, None).map_err(vk_error("vkCreatePipelineLayout"))?;
        }
        Ok(())
    }

    fn create_pipeline(
        &mut self,
        spirv: &[u32],
        constants: &[(u32, u32)],
        subgroup_size: Option<u32>,
    ) -> Result<()> {
        let device = &self.inner.device;
        let data: Vec<u8> = constants.iter().flat_map(|(_, bits)| bits.to_ne_bytes()).collect();
        let entries: Vec<_> = (constants.iter().enumerate())
            .map(|(i, &(id, _))| {
                vk::SpecializationMapEntry::default().constant_id(id).offset(4 * i as u32).size(4)
            })
            .collect();
        let specialization = vk::SpecializationInfo::default().map_entries(&entries).data(&data);
        let rules = subgroup_size.map_or_else(SubgroupRules::default, |_| self.inner.subgroup_rules);
        let spirv = rules.apply(spirv);
        let module_info = vk::ShaderModuleCreateInfo::default().code(&spirv);
        // SAFETY: SPIR-V that build.rs compiled.
        let module = unsafe { device.create_shader_module(&module_info, None) };
        let module = module.map_err(vk_error("vkCreateShaderModule"))?;
        self.inner.names.name(module, self.name);
        let mut stage = vk::PipelineShaderStageCreateInfo::default()
            .stage(vk::ShaderStageFlags::COMPUTE)
            .module(module)
            .name(c"main")
            .specialization_info(&specialization);
        let mut required = vk::PipelineShaderStageRequiredSubgroupSizeCreateInfo::default();
        if let Some(size) = subgroup_size {
            stage = stage.flags(vk::PipelineShaderStageCreateFlags::REQUIRE_FULL_SUBGROUPS);
            if self.inner.limits.subgroup_size_selectable {
                required = required.required_subgroup_size(size);
                stage = stage.push_next(&mut required);
            }
        }
        let flags = self.inner.executables.as_ref().map_or(vk::PipelineCreateFlags::empty(), |e| e.flags());
        let info =
            vk::ComputePipelineCreateInfo::default().stage(stage).layout(self.handles.layout).flags(flags);
        // SAFETY: everything that `info` points to outlives the call; `check` has verified the subgroup rules. The
        // module is not needed any more once the pipeline exists.
        let pipelines = unsafe {
            let pipelines = device.create_compute_pipelines(self.inner.pipeline_cache.raw, &[info], None);
            device.destroy_shader_module(module, None);
            pipelines
        };
        let pipelines = pipelines.map_err(|(_, e)| vk_error("vkCreateComputePipelines")(e))?;
        self.handles.raw = pipelines.first().copied().unwrap_or_default();
        Ok(())
    }
}

impl Drop for Pipeline {
    fn drop(&mut self) {
        if !self.shared {
            // SAFETY: recordings and submissions hold the pipeline until they are done.
            unsafe { self.handles.destroy(&self.inner.device) };
        }
    }
}
