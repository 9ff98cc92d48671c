//! Descriptor sets for devices without push descriptors. Kernels share a few layouts, so that sets can be preallocated
//! without knowing which kernels use them.
//!
//! Each use writes all descriptors of a set, including those that the kernel does not have. Resources of an earlier use may
//! no longer exist, and drivers access descriptors that no shader uses. For example, lavapipe counts references to all
//! buffers of a set.

use super::binding_numbers::{BUFFERS, SAMPLED_IMAGE, STORAGE_IMAGE, UNIFORM_BLOCK};
use super::debug::vk_error;
use super::open_device::Device;
use crate::Result;
use ash::vk;
use std::ops::{Deref, DerefMut};
use std::sync::{Arc, Mutex, PoisonError};

/// Sets per pool: for kernels with only storage buffers, and for the others.
const POOL_SETS: [u32; 2] = [128, 16];

/// Returns the layout binding of one resource.
pub(super) fn layout_binding(
    binding: u32,
    kind: vk::DescriptorType,
) -> vk::DescriptorSetLayoutBinding<'static> {
    vk::DescriptorSetLayoutBinding::default()
        .binding(binding)
        .descriptor_type(kind)
        .descriptor_count(1)
        .stage_flags(vk::ShaderStageFlags::COMPUTE)
}

/// Kinds of sets: the resource that each has beside [`BUFFERS`] storage buffers, with its binding.
const KINDS: [Option<(u32, vk::DescriptorType)>; 4] = [
    None,
    Some((UNIFORM_BLOCK, vk::DescriptorType::UNIFORM_BUFFER)),
    Some((STORAGE_IMAGE, vk::DescriptorType::STORAGE_IMAGE)),
    Some((SAMPLED_IMAGE, vk::DescriptorType::SAMPLED_IMAGE)),
];
/// Number of kinds that most dispatches use; they come first.
const FREQUENT_KINDS: usize = 2;
/// At most one in this many dispatches has an image: a view has 48 or more dispatches, and writes four images.
const DISPATCHES_PER_IMAGE: usize = 12;

/// Returns the kind of set for a kernel with these resources; None if no kind fits.
pub(super) fn kind_of(bindings: &[vk::DescriptorSetLayoutBinding<'_>]) -> Option<usize> {
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

/// Sets of the shared layouts, handed out in order during a recording. The owner calls
/// [`DescriptorSets::destroy`] at the end.
pub(super) struct DescriptorSets {
    pools: Vec<vk::DescriptorPool>,
    sets: [Vec<vk::DescriptorSet>; KINDS.len()],
    used: [usize; KINDS.len()],
}

impl DescriptorSets {
    /// Returns None with push descriptors.
    pub(super) fn new(inner: &Device) -> Option<Self> {
        let none = Self { pools: Vec::new(), sets: Default::default(), used: Default::default() };
        inner.shared_layouts.is_some().then_some(none)
    }

    /// Frees the sets of the previous recording.
    pub(super) fn reset(&mut self) {
        self.used = Default::default();
    }

    /// Allocates at least `count` sets of each frequent kind for one recording, and some with images.
    pub(super) fn reserve(&mut self, inner: &Device, count: usize) -> Result<()> {
        for kind in 0..KINDS.len() {
            let count = match kind < FREQUENT_KINDS {
                true => count,
                false => count.div_ceil(DISPATCHES_PER_IMAGE).max(POOL_SETS[1] as usize),
            };
            self.reserve_kind(inner, kind, count)?;
        }
        Ok(())
    }

    fn reserve_kind(&mut self, inner: &Device, kind: usize, count: usize) -> Result<()> {
        while self.sets[kind].len() < count {
            self.add_pool(inner, kind)?;
        }
        Ok(())
    }

    /// Returns an unused set of a kind, and allocates it if necessary.
    pub(super) fn next(&mut self, inner: &Device, kind: usize) -> Result<vk::DescriptorSet> {
        self.reserve_kind(inner, kind, self.used[kind] + 1)?;
        self.used[kind] += 1;
        Ok(self.sets[kind][self.used[kind] - 1])
    }

    fn add_pool(&mut self, inner: &Device, kind: usize) -> Result<()> {
        let count = POOL_SETS[usize::from(kind > 0)];
        let size = |kind, count| vk::DescriptorPoolSize::default().ty(kind).descriptor_count(count);
        let mut sizes = vec![size(vk::DescriptorType::STORAGE_BUFFER, count * BUFFERS)];
        sizes.extend(KINDS[kind].map(|(_, other)| size(other, count)));
        let info = vk::DescriptorPoolCreateInfo::default().max_sets(count).pool_sizes(&sizes);
        let layouts: Vec<_> = inner.shared_layouts.iter().flatten().copied().collect();
        let layouts = vec![layouts[kind]; count as usize];
        // SAFETY: valid create infos; the pool has room for exactly these sets, and is kept as long as they are.
        unsafe {
            let pool = inner.device.create_descriptor_pool(&info, None);
            let pool = pool.map_err(vk_error("vkCreateDescriptorPool"))?;
            inner.names.name(pool, "descriptor sets");
            let info = vk::DescriptorSetAllocateInfo::default().descriptor_pool(pool).set_layouts(&layouts);
            let sets = inner.device.allocate_descriptor_sets(&info);
            let sets = sets.inspect_err(|_| inner.device.destroy_descriptor_pool(pool, None));
            self.sets[kind].extend(sets.map_err(vk_error("vkAllocateDescriptorSets"))?);
            self.pools.push(pool);
        }
        Ok(())
    }

    /// Destroys the pools. No recording that uses a set may be running.
    pub(super) fn destroy(&mut self, inner: &Device) {
        self.sets.iter_mut().for_each(Vec::clear);
        for pool in self.pools.drain(..) {
            // SAFETY: idle, as the caller sees to; destroyed once.
            unsafe { inner.device.destroy_descriptor_pool(pool, None) }
        }
    }
}

/// Sets that are destroyed with this value; none with push descriptors.
#[derive(Default)]
pub(super) struct OwnedSets(Option<(Arc<Device>, DescriptorSets)>);

impl OwnedSets {
    /// Allocates sets for recordings of up to `count` dispatches.
    pub(super) fn new(inner: &Arc<Device>, count: usize) -> Result<Self> {
        let mut owned = Self(DescriptorSets::new(inner).map(|sets| (inner.clone(), sets)));
        match &mut owned.0 {
            Some((inner, sets)) => sets.reserve(inner, count).map(|()| owned),
            None => Ok(owned),
        }
    }

    /// True if a leaked recording still owns the sets.
    pub(super) fn are_lost(&self, inner: &Device) -> bool {
        self.0.is_none() && inner.shared_layouts.is_some()
    }

    /// Returns the sets; None with push descriptors.
    pub(super) fn sets(&mut self) -> Option<&mut DescriptorSets> {
        self.0.as_mut().map(|(_, sets)| sets)
    }
}

impl Drop for OwnedSets {
    fn drop(&mut self) {
        if let Some((inner, sets)) = &mut self.0 {
            sets.destroy(inner);
        }
    }
}

// Objects that a recording borrows and returns when it ends, even by a panic.

/// Storage of a reusable object between recordings.
pub(super) type Pool<T> = Arc<Mutex<T>>;

/// A value that returns to its pool when it is dropped.
pub(super) struct PoolGuard<T: Default> {
    value: T,
    /// None: the value is dropped, not returned.
    pool: Option<Pool<T>>,
}

impl<T: Default> PoolGuard<T> {
    /// Takes the object out of the pool, and leaves a default value there.
    pub(super) fn take_from(pool: &Pool<T>) -> Self {
        let value = std::mem::take(&mut *pool.lock().unwrap_or_else(PoisonError::into_inner));
        Self { value, pool: Some(pool.clone()) }
    }

    /// Takes the value out of the guard; it does not return to the pool.
    pub(super) fn keep(mut self) -> T {
        self.pool = None;
        std::mem::take(&mut self.value)
    }

    /// True if this is the pool to which the value returns.
    pub(super) fn is_from(&self, pool: &Pool<T>) -> bool {
        self.pool.as_ref().is_some_and(|own| Arc::ptr_eq(own, pool))
    }
}

impl<T: Default> Default for PoolGuard<T> {
    fn default() -> Self {
        Self { value: T::default(), pool: None }
    }
}

impl<T: Default> Deref for PoolGuard<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}

impl<T: Default> DerefMut for PoolGuard<T> {
    fn deref_mut(&mut self) -> &mut T {
        &mut self.value
    }
}

impl<T: Default> Drop for PoolGuard<T> {
    fn drop(&mut self) {
        if let Some(pool) = &self.pool {
            *pool.lock().unwrap_or_else(PoisonError::into_inner) = std::mem::take(&mut self.value);
        }
    }
}

#[cfg(test)]
mod pool_tests {
    use super::*;

    #[test]
    fn it_goes_home_unless_it_is_kept() {
        let pool: Pool<Vec<u32>> = Arc::new(Mutex::new(vec![1]));
        let mut guard = PoolGuard::take_from(&pool);
        guard.push(2);
        assert!(pool.lock().expect("unpoisoned").is_empty() && guard.is_from(&pool));
        drop(guard);
        assert_eq!(*pool.lock().expect("unpoisoned"), [1, 2]);
        assert_eq!(PoolGuard::take_from(&pool).keep(), [1, 2]);
        assert!(pool.lock().expect("unpoisoned").is_empty());
    }

    #[test]
    fn a_panic_sends_it_home() {
        let pool: Pool<Vec<u32>> = Arc::new(Mutex::new(vec![1]));
        let guard = PoolGuard::take_from(&pool);
        let panicked = std::panic::catch_unwind(std::panic::AssertUnwindSafe(move || {
            let _guard = guard;
            panic!("in the middle");
        }));
        assert!(panicked.is_err());
        assert_eq!(*pool.lock().expect("unpoisoned"), [1]);
    }
}
