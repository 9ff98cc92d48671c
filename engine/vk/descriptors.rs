//! Descriptor sets where push descriptors are missing: all kernels share one layout, so that sets can be allocated
//! ahead without knowing which kernel will need them.

use super::context::Inner;
use super::vk_error;
use crate::Result;
use ash::vk;

/// Storage buffers of a kernel at most: bindings 0 to 15.
pub(super) const BUFFERS: u32 = 16;
/// The binding of a kernel's storage image.
pub(super) const STORAGE_IMAGE: u32 = 16;
/// The binding of a kernel's sampled image.
pub(super) const SAMPLED_IMAGE: u32 = 17;

/// Sets of one pool.
const POOL_SETS: u32 = 128;

/// One resource of a kernel in the layout of its set.
pub(super) fn slot(binding: u32, kind: vk::DescriptorType) -> vk::DescriptorSetLayoutBinding<'static> {
    vk::DescriptorSetLayoutBinding::default()
        .binding(binding)
        .descriptor_type(kind)
        .descriptor_count(1)
        .stage_flags(vk::ShaderStageFlags::COMPUTE)
}

/// The layout that every kernel's set has.
pub(super) fn shared_layout(device: &ash::Device) -> Result<vk::DescriptorSetLayout> {
    let mut slots: Vec<_> = (0..BUFFERS).map(|b| slot(b, vk::DescriptorType::STORAGE_BUFFER)).collect();
    slots.push(slot(STORAGE_IMAGE, vk::DescriptorType::STORAGE_IMAGE));
    slots.push(slot(SAMPLED_IMAGE, vk::DescriptorType::SAMPLED_IMAGE));
    let info = vk::DescriptorSetLayoutCreateInfo::default().bindings(&slots);
    // SAFETY: a valid create info.
    let layout = unsafe { device.create_descriptor_set_layout(&info, None) };
    layout.map_err(vk_error("vkCreateDescriptorSetLayout"))
}

/// Sets of the shared layout, handed out one after the other during a recording. Whoever has them calls
/// [`DescriptorSets::destroy`] at the end.
pub(super) struct DescriptorSets {
    layout: vk::DescriptorSetLayout,
    pools: Vec<vk::DescriptorPool>,
    sets: Vec<vk::DescriptorSet>,
    used: usize,
}

impl DescriptorSets {
    /// None where there are push descriptors.
    pub(super) fn new(inner: &Inner) -> Option<Self> {
        let layout = inner.shared_layout?;
        Some(Self { layout, pools: Vec::new(), sets: Vec::new(), used: 0 })
    }

    /// Starts over: the sets of the recording before are free again.
    pub(super) fn reset(&mut self) {
        self.used = 0;
    }

    /// Makes sure of a number of sets for one recording.
    pub(super) fn reserve(&mut self, inner: &Inner, count: usize) -> Result<()> {
        while self.sets.len() < count {
            self.add_pool(inner)?;
        }
        Ok(())
    }

    /// A set that this recording has not used yet, allocated if need be.
    pub(super) fn next(&mut self, inner: &Inner) -> Result<vk::DescriptorSet> {
        self.reserve(inner, self.used + 1)?;
        self.used += 1;
        Ok(self.sets[self.used - 1])
    }

    fn add_pool(&mut self, inner: &Inner) -> Result<()> {
        let size = |kind, count| vk::DescriptorPoolSize::default().ty(kind).descriptor_count(count);
        let sizes = [
            size(vk::DescriptorType::STORAGE_BUFFER, POOL_SETS * BUFFERS),
            size(vk::DescriptorType::STORAGE_IMAGE, POOL_SETS),
            size(vk::DescriptorType::SAMPLED_IMAGE, POOL_SETS),
        ];
        let info = vk::DescriptorPoolCreateInfo::default().max_sets(POOL_SETS).pool_sizes(&sizes);
        let layouts = [self.layout; POOL_SETS as usize];
        // SAFETY: valid create infos; the pool has room for exactly these sets, and is kept as long as they are.
        unsafe {
            let pool = inner.device.create_descriptor_pool(&info, None);
            let pool = pool.map_err(vk_error("vkCreateDescriptorPool"))?;
            inner.names.name(pool, "descriptor sets");
            self.pools.push(pool);
            let info = vk::DescriptorSetAllocateInfo::default().descriptor_pool(pool).set_layouts(&layouts);
            let sets = inner.device.allocate_descriptor_sets(&info);
            self.sets.extend(sets.map_err(vk_error("vkAllocateDescriptorSets"))?);
        }
        Ok(())
    }

    /// Destroys the pools. No recording that uses a set is under way.
    pub(super) fn destroy(&mut self, inner: &Inner) {
        self.sets.clear();
        for pool in self.pools.drain(..) {
            // SAFETY: idle, as the caller sees to; destroyed once.
            unsafe { inner.device.destroy_descriptor_pool(pool, None) }
        }
    }
}
