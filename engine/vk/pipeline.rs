//! Vulkan compute pipelines: the check of their demands on the device, their creation, and descriptor sets.

use super::binding_numbers::{BUFFERS, SAMPLED_IMAGE, STORAGE_IMAGE, UNIFORM_BLOCK};
use super::debug::vk_error;
use super::limits::Limits;
use super::open_device::Device;
use super::pipeline_cache::{BindingKind, PipelineHandles, PipelineInfo};
use super::spirv::SubgroupRules;
use crate::error::{Error, Result};
use ash::vk;
use std::sync::{Arc, Mutex};

pub(super) fn check(d: &PipelineInfo, shared_bytes: u32, limits: &Limits) -> Result<()> {
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
    let l = limits;
    let limit = l.max_workgroup_invocations;
    let (shared_bytes, push_bytes) = (shared_bytes.into(), d.push_bytes.into());
    let bounds = [
        ("workgroup", invocations, "invocations", limit, "maxComputeWorkGroupInvocations"),
        ("workgroup", x.into(), "invocations", l.max_workgroup_size[0], "maxComputeWorkGroupSize[0]"),
        ("workgroup", y.into(), "invocations", l.max_workgroup_size[1], "maxComputeWorkGroupSize[1]"),
        ("workgroup", z.into(), "invocations", l.max_workgroup_size[2], "maxComputeWorkGroupSize[2]"),
        ("workgroup", subgroups, "subgroups", l.max_workgroup_subgroups, "maxComputeWorkgroupSubgroups"),
        ("shared memory", shared_bytes, "bytes", l.shared_memory_bytes, "maxComputeSharedMemorySize"),
        ("push constants", push_bytes, "bytes", l.push_constant_bytes, "maxPushConstantsSize"),
        ("uniform block", uniform_bytes, "bytes", l.max_uniform_range, "maxUniformBufferRange"),
        ("bindings", bindings, "buffers", l.max_push_descriptors, "maxPushDescriptors"),
        ("bindings", bindings, "buffers", MAX_BINDINGS as u32, "of this crate"),
    ];
    for (what, needed, unit, limit, limit_name) in bounds {
        if needed > u64::from(limit) {
            let what = format!("kernel {}: {what}", d.name);
            return Err(Error::too_large(what, (needed, unit), (limit.into(), limit_name)));
        }
    }
    Ok(())
}

pub(super) const MAX_BINDINGS: usize = 32;

/// Vulkan objects of a [`super::Kernel`].
pub(super) struct Pipeline {
    inner: Arc<Device>,
    pub(super) info: PipelineInfo,
    pub(super) handles: PipelineHandles,
    /// True if the device owns the handles and destroys them.
    shared: bool,
}

impl Pipeline {
    /// Returns a placeholder that no recording can use.
    pub(super) fn unbuilt(inner: &Arc<Device>, info: PipelineInfo) -> Self {
        Self { inner: inner.clone(), info, handles: PipelineHandles::default(), shared: true }
    }

    /// Returns the device's shared pipeline, and builds it if there is none.
    pub(super) fn shared(inner: &Arc<Device>, info: PipelineInfo, spirv: &[u32]) -> Result<Self> {
        let handles = inner.built.get_or_build(&info, || build(inner, &info, spirv))?;
        Ok(Self { inner: inner.clone(), info, handles, shared: true })
    }

    pub(super) fn new(inner: &Arc<Device>, info: PipelineInfo, spirv: &[u32]) -> Result<Self> {
        let handles = build(inner, &info, spirv)?;
        Ok(Self { inner: inner.clone(), info, handles, shared: false })
    }

    pub(super) fn is_of(&self, inner: &Arc<Device>) -> bool {
        Arc::ptr_eq(&self.inner, inner)
    }
}

fn build(inner: &Device, info: &PipelineInfo, spirv: &[u32]) -> Result<PipelineHandles> {
    let mut handles = PipelineHandles::default();
    let created = create_layout(inner, info, &mut handles)
        .and_then(|()| create_pipeline(inner, info, spirv, handles.layout));
    // SAFETY: they were made just now, and are not in use.
    handles.raw = created.inspect_err(|_| unsafe { handles.destroy(&inner.device) })?;
    if handles.set_layout != vk::DescriptorSetLayout::null() {
        inner.names.name(handles.set_layout, &format!("{} set layout", info.name));
    }
    inner.names.name(handles.layout, &format!("{} layout", info.name));
    inner.names.name(handles.raw, info.name);
    Ok(handles)
}

fn create_layout(inner: &Device, info: &PipelineInfo, handles: &mut PipelineHandles) -> Result<()> {
    let device = &inner.device;
    let buffers = info.bindings.iter().map(|b| (b.binding, b.kind.descriptor_type()));
    let images = info.images.iter().map(|i| (i.binding, i.kind.descriptor_type()));
    let all = buffers.chain(images);
    let bindings: Vec<_> = all.map(|(binding, kind)| layout_binding(binding, kind)).collect();
    let set = vk::DescriptorSetLayoutCreateInfo::default()
        .flags(vk::DescriptorSetLayoutCreateFlags::PUSH_DESCRIPTOR_KHR)
        .bindings(&bindings);
    // SAFETY: valid create infos; the number of bindings and push bytes was checked against the limits.
    unsafe {
        let sets = match (&inner.shared_layouts, kind_of(&bindings)) {
            (Some(layouts), Some(kind)) => {
                handles.set_kind = kind;
                [layouts[kind]]
            }
            (Some(_), None) => {
                let problem = "has several images or uniform blocks, which takes VK_KHR_push_descriptor";
                return Err(Error::argument(format!("kernel {}", info.name), problem));
            }
            (None, _) => {
                let layout = device.create_descriptor_set_layout(&set, None);
                handles.set_layout = layout.map_err(vk_error("vkCreateDescriptorSetLayout"))?;
                [handles.set_layout]
            }
        };
        let push = vk::PushConstantRange::default().stage_flags(vk::ShaderStageFlags::COMPUTE);
        let ranges = [push.size(info.push_bytes)];
        let ranges = if info.push_bytes > 0 { &ranges[..] } else { &[] };
        let info = vk::PipelineLayoutCreateInfo::default().set_layouts(&sets).push_constant_ranges(ranges);
        let layout = device.create_pipeline_layout(&info, None);
        handles.layout = layout.map_err(vk_error("vkCreatePipelineLayout"))?;
    }
    Ok(())
}

fn create_pipeline(
    inner: &Device,
    info: &PipelineInfo,
    spirv: &[u32],
    layout: vk::PipelineLayout,
) -> Result<vk::Pipeline> {
    let device = &inner.device;
    let PipelineInfo { name, constants, subgroup_size, .. } = info;
    let data: Vec<u8> = constants.iter().flat_map(|(_, bits)| bits.to_ne_bytes()).collect();
    let entry = |(i, &(id, _)): (usize, &(u32, u32))| {
        vk::SpecializationMapEntry::default().constant_id(id).offset(4 * i as u32).size(4)
    };
    let entries: Vec<_> = constants.iter().enumerate().map(entry).collect();
    let specialization = vk::SpecializationInfo::default().map_entries(&entries).data(&data);
    let rules = subgroup_size.map_or_else(SubgroupRules::default, |_| inner.subgroup_rules);
    let spirv = rules.apply(spirv);
    let module_info = vk::ShaderModuleCreateInfo::default().code(&spirv);
    // SAFETY: SPIR-V that build.rs compiled.
    let module = unsafe { device.create_shader_module(&module_info, None) };
    let module = module.map_err(vk_error("vkCreateShaderModule"))?;
    inner.names.name(module, name);
    let mut stage = vk::PipelineShaderStageCreateInfo::default()
        .stage(vk::ShaderStageFlags::COMPUTE)
        .module(module)
        .name(c"main")
        .specialization_info(&specialization);
    let mut required = vk::PipelineShaderStageRequiredSubgroupSizeCreateInfo::default();
    if let Some(size) = *subgroup_size {
        stage = stage.flags(vk::PipelineShaderStageCreateFlags::REQUIRE_FULL_SUBGROUPS);
        if inner.limits.subgroup_size_selectable {
            required = required.required_subgroup_size(size);
            stage = stage.push_next(&mut required);
        }
    }
    let flags = inner.executables.as_ref().map_or(vk::PipelineCreateFlags::empty(), |e| e.flags());
    let info = vk::ComputePipelineCreateInfo::default().stage(stage).layout(layout).flags(flags);
    // SAFETY: everything that `info` points to outlives the call; `check` has verified the subgroup rules. The
    // module is not needed any more once the pipeline exists.
    let pipelines = unsafe {
        let pipelines = device.create_compute_pipelines(inner.pipeline_cache.raw, &[info], None);
        device.destroy_shader_module(module, None);
        pipelines
    };
    let pipelines = pipelines.map_err(|(_, e)| vk_error("vkCreateComputePipelines")(e))?;
    Ok(pipelines.first().copied().unwrap_or_default())
}

impl Drop for Pipeline {
    fn drop(&mut self) {
        if !self.shared {
            // SAFETY: recordings and submissions hold the pipeline until they are done.
            unsafe { self.handles.destroy(&self.inner.device) };
        }
    }
}

/// A kernel that is not built yet. Any thread may build it, and threads may build several at once. All users of the device
/// share the built pipeline.
#[derive(Clone)]
pub struct KernelJob {
    pub(super) device: Arc<Device>,
    pub(super) info: PipelineInfo,
    pub(super) spirv: &'static [u32],
}

/// Jobs that are collected instead of being built.
pub(super) type Jobs = Arc<Mutex<Vec<KernelJob>>>;

impl KernelJob {
    /// Path of its shader below glsl/ without extension, "sort/sort_upsweep". Several kernels may have the same shader.
    pub fn name(&self) -> &'static str {
        self.info.name
    }

    /// Builds it, or waits for the thread that builds it.
    pub fn build(self) -> Result<()> {
        Pipeline::shared(&self.device, self.info, self.spirv).map(drop)
    }
}

// Descriptor sets for devices without push descriptors. Kernels share a few layouts, so that sets can be preallocated
// without knowing which kernels use them.
//
// Each use writes all descriptors of a set, including those that the kernel does not have. Resources of an earlier use may
// no longer exist, and drivers access descriptors that no shader uses. For example, lavapipe counts references to all
// buffers of a set.

/// Sets per pool: for kernels with only storage buffers, and for the others.
const POOL_SETS: [u32; 2] = [128, 16];

fn layout_binding(binding: u32, kind: vk::DescriptorType) -> vk::DescriptorSetLayoutBinding<'static> {
    vk::DescriptorSetLayoutBinding::default()
        .binding(binding)
        .descriptor_type(kind)
        .descriptor_count(1)
        .stage_flags(vk::ShaderStageFlags::COMPUTE)
}

/// Kinds of descriptor sets: binding and type of the resource that each has besides [`BUFFERS`] storage buffers.
const KINDS: [Option<(u32, vk::DescriptorType)>; 4] = [
    None,
    Some((UNIFORM_BLOCK, vk::DescriptorType::UNIFORM_BUFFER)),
    Some((STORAGE_IMAGE, vk::DescriptorType::STORAGE_IMAGE)),
    Some((SAMPLED_IMAGE, vk::DescriptorType::SAMPLED_IMAGE)),
];
/// Number of kinds that most dispatches use; they come first.
const FREQUENT_KINDS: usize = 2;
/// At most one in this many dispatches has an image: a view has 48 or more dispatches, and writes five images.
const DISPATCHES_PER_IMAGE: usize = 9;

/// Returns the kind of set for a kernel with these resources; None if no kind fits.
fn kind_of(bindings: &[vk::DescriptorSetLayoutBinding<'_>]) -> Option<usize> {
    let storage = vk::DescriptorType::STORAGE_BUFFER;
    let mut others = bindings.iter().filter(|binding| binding.descriptor_type != storage);
    let other = others.next().map(|binding| (binding.binding, binding.descriptor_type));
    match others.next() {
        None => KINDS.iter().position(|kind| *kind == other),
        Some(_) => None,
    }
}

/// Creates the layouts that kernels share, for a device without push descriptors.
pub(super) fn add_shared_layouts(open: &mut Device) -> Result<()> {
    let layouts = open.shared_layouts.insert(Vec::with_capacity(KINDS.len()));
    for other in KINDS {
        let storage = vk::DescriptorType::STORAGE_BUFFER;
        let mut bindings: Vec<_> = (0..BUFFERS).map(|b| layout_binding(b, storage)).collect();
        bindings.extend(other.map(|(binding, kind)| layout_binding(binding, kind)));
        let info = vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings);
        // SAFETY: a valid create info.
        let created = unsafe { open.device.create_descriptor_set_layout(&info, None) };
        layouts.push(created.map_err(vk_error("vkCreateDescriptorSetLayout"))?);
    }
    Ok(())
}

/// Sets of the shared layouts, handed out in order during a recording. They are destroyed with this value, which no recording
/// uses any more.
pub(super) struct DescriptorSets {
    inner: Arc<Device>,
    layouts: Vec<vk::DescriptorSetLayout>,
    pools: Vec<vk::DescriptorPool>,
    sets: [Vec<vk::DescriptorSet>; KINDS.len()],
    used: [usize; KINDS.len()],
}

impl DescriptorSets {
    /// Returns None with push descriptors.
    pub(super) fn new(inner: &Arc<Device>) -> Option<Self> {
        let layouts = inner.shared_layouts.clone()?;
        let (pools, sets, used) = Default::default();
        Some(Self { inner: inner.clone(), layouts, pools, sets, used })
    }

    /// Frees the sets of the previous recording.
    pub(super) fn reset(&mut self) {
        self.used = Default::default();
    }

    /// Allocates at least `count` sets of each frequent kind for one recording, and some with images.
    pub(super) fn reserve(&mut self, count: usize) -> Result<()> {
        for kind in 0..KINDS.len() {
            let count = match kind < FREQUENT_KINDS {
                true => count,
                false => count.div_ceil(DISPATCHES_PER_IMAGE).max(POOL_SETS[1] as usize),
            };
            self.reserve_kind(kind, count)?;
        }
        Ok(())
    }

    fn reserve_kind(&mut self, kind: usize, count: usize) -> Result<()> {
        while self.sets[kind].len() < count {
            self.add_pool(kind)?;
        }
        Ok(())
    }

    /// Returns an unused set of a kind, and allocates it if necessary.
    pub(super) fn next(&mut self, kind: usize) -> Result<vk::DescriptorSet> {
        self.reserve_kind(kind, self.used[kind] + 1)?;
        self.used[kind] += 1;
        Ok(self.sets[kind][self.used[kind] - 1])
    }

    fn add_pool(&mut self, kind: usize) -> Result<()> {
        let Device { device, names, .. } = &*self.inner;
        let count = POOL_SETS[usize::from(kind > 0)];
        let size = |kind, count| vk::DescriptorPoolSize::default().ty(kind).descriptor_count(count);
        let mut sizes = vec![size(vk::DescriptorType::STORAGE_BUFFER, count * BUFFERS)];
        sizes.extend(KINDS[kind].map(|(_, other)| size(other, count)));
        let info = vk::DescriptorPoolCreateInfo::default().max_sets(count).pool_sizes(&sizes);
        let layouts = vec![self.layouts[kind]; count as usize];
        // SAFETY: valid create infos; the pool has room for exactly these sets, and is kept as long as they are.
        unsafe {
            let pool = device.create_descriptor_pool(&info, None);
            let pool = pool.map_err(vk_error("vkCreateDescriptorPool"))?;
            names.name(pool, "descriptor sets");
            let info = vk::DescriptorSetAllocateInfo::default().descriptor_pool(pool).set_layouts(&layouts);
            let sets = device.allocate_descriptor_sets(&info);
            let sets = sets.inspect_err(|_| device.destroy_descriptor_pool(pool, None));
            self.sets[kind].extend(sets.map_err(vk_error("vkAllocateDescriptorSets"))?);
            self.pools.push(pool);
        }
        Ok(())
    }
}

impl Drop for DescriptorSets {
    fn drop(&mut self) {
        for pool in &self.pools {
            // SAFETY: idle, as the owner sees to; destroyed once.
            unsafe { self.inner.device.destroy_descriptor_pool(*pool, None) }
        }
    }
}
