//! Records commands: dispatches, fills, copies, and the barriers between them.

use super::audit;
use super::binding::{BindingInfo, BindingKind};
use super::binding_numbers::BUFFERS;
use super::buffer::Buffer;
use super::commands::Commands;
use super::declared::Hazards;
use super::descriptors::{DescriptorSets, OwnedSets, PoolGuard};
use super::format::ImageKind;
use super::hazard::Access;
use super::image::{Image, ImageState};
use super::kernel::{Kernel, KernelInterface};
use super::limits::Limits;
use super::open_device::Device;
use super::pipeline::{MAX_BINDINGS, Pipeline};
use super::profile::Profiler;
use super::profile::{BoundBuffer, CommandRecord, Commands as Profiled};
use super::resources::{Bound, Kept};
use super::texels::{TexelFormat, TexelRange};
use crate::{Error, Result};
use ash::vk;
use std::sync::Arc;

/// Most bytes of [`Recorder::update`].
pub const MAX_UPDATE_BYTES: usize = 65_536;

/// A recording in progress. Commands run in recording order, but those between two barriers may overlap.
///
/// Push constants determine how much a kernel reads and writes; nothing compares that with the sizes of its buffers. A
/// device of our own has robustBufferAccess, and robustBufferAccess2 if available. Accesses outside a buffer then write
/// nothing and read zero (with robustBufferAccess alone, other values of the same allocation). For a host's device see
/// [`super::Context::from_foreign`].
///
/// Nothing is executed before [`super::Context::submit`]. In debug builds, and with
/// [`super::ContextOptions::hazard_check`], a missing barrier panics with the names of both commands.
pub struct Recorder {
    // Fields drop in this order: the commands must be dropped before the memory that they use.
    pub(super) commands: Target,
    pub(super) inner: Arc<Device>,
    profiler: Profiler,
    pub(super) kept: PoolGuard<Kept>,
    pub(super) bound: vk::Pipeline,
    pub(super) hazards: Option<Hazards>,
    pub(super) barriers: u32,
    /// For tests: barriers to omit.
    #[cfg(feature = "testing")]
    pub(super) omitted: Vec<u32>,
    /// Present if there is an audit.
    pub(super) audit: Option<audit::Commands>,
    /// Error of the first call that failed. No dispatch is recorded after it, and the recording cannot be submitted.
    pub(super) failed: Option<Error>,
}

pub(super) enum Target {
    Owned(Commands),
    Foreign(ForeignTarget),
}

/// A host's command buffer, and the objects that the recording borrows from a [`super::RecordSlot`].
pub(super) struct ForeignTarget {
    pub(super) raw: vk::CommandBuffer,
    pub(super) descriptors: PoolGuard<OwnedSets>,
}

impl Target {
    pub(super) fn descriptors(&mut self) -> Option<&mut DescriptorSets> {
        match self {
            Self::Owned(commands) => commands.descriptors.as_mut(),
            Self::Foreign(target) => target.descriptors.sets(),
        }
    }
}

impl Recorder {
    pub(super) fn new(
        commands: Commands,
        label: &str,
        profiled: Option<Profiled>,
        audit: Option<audit::Commands>,
    ) -> Self {
        // An audited recording may use several command buffers.
        let queries = if audit.is_some() { vk::QueryPool::null() } else { commands.queries() };
        let inner = commands.inner.clone();
        let mut recorder = Self::with_target(Target::Owned(commands), inner, Profiler::new(queries, None));
        recorder.profiler.commands = profiled;
        recorder.audit = audit;
        recorder.profiler.begin(&recorder.inner, recorder.raw(), label);
        recorder
    }

    /// Records into a command buffer that the host submits: see [`super::RecordSlot::begin`].
    pub(super) fn foreign(
        inner: &Arc<Device>,
        target: ForeignTarget,
        kept: PoolGuard<Kept>,
        profiler: Profiler,
        label: &str,
    ) -> Self {
        let mut recorder = Self::with_target(Target::Foreign(target), inner.clone(), profiler);
        recorder.kept = kept;
        recorder.profiler.behind_host = true;
        recorder.profiler.begin(inner, recorder.raw(), label);
        recorder
    }

    /// Ends a recording into a host's command buffer. Borrowed objects return to their pools when they are dropped.
    pub(super) fn finish_foreign(mut self) -> (ForeignTarget, Profiler, PoolGuard<Kept>) {
        self.profiler.end(&self.inner, self.raw());
        match self.commands {
            Target::Foreign(target) => (target, self.profiler, self.kept),
            Target::Owned(_) => panic!("an own command buffer is submitted by the context"),
        }
    }

    fn with_target(commands: Target, inner: Arc<Device>, profiler: Profiler) -> Self {
        Self {
            commands,
            profiler,
            kept: PoolGuard::default(),
            bound: vk::Pipeline::null(),
            hazards: inner.hazard_check.then(Hazards::default),
            barriers: 0,
            #[cfg(feature = "testing")]
            omitted: Vec::new(),
            audit: None,
            failed: None,
            inner,
        }
    }

    pub(super) fn finish(mut self) -> (Commands, Profiler, Kept, Option<audit::Commands>) {
        self.profiler.end(&self.inner, self.raw());
        self.copy_indirect_arguments();
        match self.commands {
            Target::Owned(commands) => (commands, self.profiler, self.kept.keep(), self.audit),
            Target::Foreign(_) => panic!("a foreign command buffer is submitted by its owner"),
        }
    }

    pub(super) fn raw(&self) -> vk::CommandBuffer {
        match &self.commands {
            Target::Owned(commands) => commands.raw(),
            Target::Foreign(target) => target.raw,
        }
    }

    /// Dispatches a number of workgroups, in two dimensions if one is too small: see [`super::Limits::grid`].
    ///
    /// # Panics
    /// When a buffer cannot be bound, when a resource belongs to another context, or when a barrier is missing (see
    /// [`Recorder`]).
    pub fn dispatch<K: KernelInterface>(
        &mut self,
        kernel: &Kernel<K>,
        bind: &K::Bind<'_>,
        push: &K::Push,
        workgroups: u64,
    ) {
        let grid = self.inner.limits.grid(workgroups);
        self.dispatch_3d(kernel, bind, push, grid);
    }

    /// Dispatches a grid of workgroups. An empty grid records nothing.
    ///
    /// # Panics
    /// Same as [`Recorder::dispatch`], and when the grid exceeds the device's limit.
    pub fn dispatch_3d<K: KernelInterface>(
        &mut self,
        kernel: &Kernel<K>,
        bind: &K::Bind<'_>,
        push: &K::Push,
        [x, y, z]: [u32; 3],
    ) {
        let limit = self.inner.limits.max_workgroups_per_axis;
        assert!(x.max(y).max(z) <= limit, "{}: grid {x}x{y}x{z} exceeds {limit}", K::NAME);
        let (buffers, images) = (K::buffers(bind), K::images(bind));
        let bound = Bound { buffers: buffers.as_ref(), images: images.as_ref() };
        self.declare(&kernel.pipeline, &bound, None);
        if x == 0 || y == 0 || z == 0 {
            return;
        }
        if !self.prepare(&kernel.pipeline, &bound, K::push_bytes(push)) {
            return;
        }
        // SAFETY: the pipeline and everything that it uses are bound, the counts are within the limits.
        unsafe { self.inner.device.cmd_dispatch(self.raw(), x, y, z) }
        self.profile_dispatch(&kernel.pipeline, bound.buffers, Some([x, y, z]));
    }

    /// Dispatches the grid that `arguments` holds when the command runs: x, y, z as u32, in its first 12 bytes.
    ///
    /// # Panics
    /// Same as [`Recorder::dispatch`], and when `arguments` is too small.
    pub fn dispatch_indirect<K: KernelInterface>(
        &mut self,
        kernel: &Kernel<K>,
        bind: &K::Bind<'_>,
        push: &K::Push,
        arguments: &Buffer,
    ) {
        assert!(arguments.bytes() >= 12, "{}: '{}' holds no grid", K::NAME, arguments.name());
        assert!(arguments.offset().is_multiple_of(4), "{}: '{}' is misaligned", K::NAME, arguments.name());
        let (buffers, images) = (K::buffers(bind), K::images(bind));
        let bound = Bound { buffers: buffers.as_ref(), images: images.as_ref() };
        self.declare(&kernel.pipeline, &bound, Some(arguments));
        if !self.prepare(&kernel.pipeline, &bound, K::push_bytes(push)) {
            return;
        }
        self.keep(arguments);
        // SAFETY: as above; the buffer has the INDIRECT usage and twelve bytes at an offset divisible by four.
        unsafe {
            self.inner.device.cmd_dispatch_indirect(self.raw(), arguments.raw(), arguments.offset());
        }
        self.profile_dispatch(&kernel.pipeline, bound.buffers, None);
        if let Some(profiled) = &mut self.profiler.commands {
            profiled.is_indirect(arguments);
        }
    }

    fn profile_dispatch(&mut self, pipeline: &Pipeline, buffers: &[&Buffer], grid: Option<[u32; 3]>) {
        let accesses = pipeline.bindings.iter().map(|info| info.access);
        self.audit(pipeline.name, buffers.iter().copied().zip(accesses));
        let raw = self.raw();
        self.profiler.command(&self.inner, raw, self.barriers, || {
            let bound = pipeline.bindings.iter().zip(buffers);
            let bound = bound.map(|(info, buffer)| BoundBuffer::new(info.name, buffer, info.access));
            CommandRecord::new(pipeline.name, grid, bound)
        });
    }

    fn profile_transfer(&mut self, command: &'static str, uses: &[(&Buffer, &'static str, Access)]) {
        self.audit(command, uses.iter().map(|&(buffer, _, access)| (buffer, access)));
        let raw = self.raw();
        self.profiler.command(&self.inner, raw, self.barriers, || {
            let bound = uses.iter().map(|&(buffer, role, access)| BoundBuffer::new(role, buffer, access));
            CommandRecord::new(command, None, bound)
        });
    }

    /// Copies the final arguments of indirect dispatches to the profile's readback buffer.
    fn copy_indirect_arguments(&mut self) {
        let Some(profiled) = self.profiler.commands.take() else { return };
        let copies: Vec<_> = profiled.copies().collect();
        if !copies.is_empty() {
            self.barrier();
        }
        for (from, to) in copies {
            self.kept.block(to.block());
            let region =
                vk::BufferCopy::default().src_offset(from.offset()).dst_offset(to.offset()).size(to.bytes());
            // SAFETY: recording state; ranges of equal size in buffers that are kept, with transfer usage.
            unsafe { self.inner.device.cmd_copy_buffer(self.raw(), from.raw(), to.raw(), &[region]) }
        }
        self.profiler.commands = Some(profiled);
    }

    /// Makes the recording fail with this error, unless it has failed already. Nothing is dispatched after it.
    pub(super) fn fail(&mut self, error: Error) {
        self.failed.get_or_insert(error);
    }

    /// Returns the first error of the recording so far: the driver had no memory for descriptors or views, or a kernel was
    /// not built. [`super::Context::submit`] checks this itself.
    ///
    /// # Errors
    /// [`Error::Vulkan`], [`Error::Argument`]
    pub(crate) fn check(&mut self) -> Result<()> {
        self.failed.take().map_or(Ok(()), Err)
    }

    /// Declares the accesses of a dispatch to the hazard checker.
    fn declare(&mut self, pipeline: &Pipeline, bound: &Bound<'_>, arguments: Option<&Buffer>) {
        let Some(hazards) = self.hazards.as_mut().filter(|_| self.failed.is_none()) else { return };
        for (info, buffer) in pipeline.bindings.iter().zip(bound.buffers) {
            hazards.add_binding(buffer, info);
        }
        for (info, image) in pipeline.images.iter().zip(bound.images) {
            hazards.add_image(image, info.name, info.access);
        }
        if let Some(arguments) = arguments {
            // Only the first three words are read.
            hazards.add(&arguments.range(0, 12), "indirect arguments", Access::Read);
        }
        hazards.commit(pipeline.name);
    }

    /// Sets every word of a buffer.
    ///
    /// # Panics
    /// When the buffer's offset or size is no multiple of 4, or a barrier is missing.
    pub fn fill(&mut self, buffer: &Buffer, value: u32) {
        self.transfer("fill", &[(buffer, "destination", Access::Write)]);
        if buffer.bytes() == 0 {
            return;
        }
        // SAFETY: recording state; a range within a buffer that is kept, with TRANSFER_DST usage.
        unsafe {
            let (offset, bytes) = (buffer.offset(), buffer.bytes());
            self.inner.device.cmd_fill_buffer(self.raw(), buffer.raw(), offset, bytes, value);
        }
        self.profile_transfer("fill", &[(buffer, "destination", Access::Write)]);
    }

    /// Copies a buffer to the start of another one.
    ///
    /// # Panics
    /// When the destination is smaller or the two overlap, or a barrier is missing.
    pub fn copy(&mut self, from: &Buffer, to: &Buffer) {
        let bytes = from.bytes();
        assert!(bytes <= to.bytes(), "copy: '{}' does not hold '{}'", to.name(), from.name());
        let apart = from.offset() + bytes <= to.offset() || to.offset() + bytes <= from.offset();
        assert!(from.raw() != to.raw() || apart, "copy: '{}' and '{}' overlap", from.name(), to.name());
        let to = &to.range(0, bytes);
        let uses = [(from, "source", Access::Read), (to, "destination", Access::Write)];
        self.transfer("copy", &uses);
        if bytes == 0 {
            return;
        }
        let region = vk::BufferCopy::default().src_offset(from.offset()).dst_offset(to.offset()).size(bytes);
        // SAFETY: recording state; ranges within buffers that are kept, with transfer usage, that do not overlap.
        unsafe { self.inner.device.cmd_copy_buffer(self.raw(), from.raw(), to.raw(), &[region]) }
        self.profile_transfer("copy", &uses);
    }

    /// Writes bytes, stored in the recording itself, to the start of a buffer.
    ///
    /// # Panics
    /// With more than [`MAX_UPDATE_BYTES`], more than the buffer holds, a length that is no multiple of 4, or when a
    /// barrier is missing.
    pub fn update(&mut self, buffer: &Buffer, bytes: &[u8]) {
        assert!(bytes.len() <= MAX_UPDATE_BYTES, "update: {} bytes are too many", bytes.len());
        let range = buffer.range(0, bytes.len() as u64);
        if bytes.is_empty() {
            return;
        }
        self.transfer("update", &[(&range, "destination", Access::Write)]);
        // SAFETY: recording state; a range within a buffer that is kept, sizes checked above.
        unsafe { self.inner.device.cmd_update_buffer(self.raw(), range.raw(), range.offset(), bytes) }
        self.profile_transfer("update", &[(&range, "destination", Access::Write)]);
    }

    pub(super) fn transfer(&mut self, command: &'static str, uses: &[(&Buffer, &'static str, Access)]) {
        for (buffer, role, access) in uses {
            let aligned = buffer.offset().is_multiple_of(4) && buffer.bytes().is_multiple_of(4);
            assert!(aligned, "{command}: '{}' is no range of whole words", buffer.name());
            self.keep(buffer);
            if let Some(hazards) = &mut self.hazards {
                hazards.add(buffer, role, *access);
            }
        }
        if let Some(hazards) = &mut self.hazards {
            hazards.commit(command);
        }
    }

    /// Orders all earlier commands before all later ones: compute and transfer writes become visible to compute, transfers
    /// and indirect arguments. It is the only kind of barrier.
    pub fn barrier(&mut self) {
        #[cfg(feature = "testing")]
        if self.omits_barrier() {
            return;
        }
        self.barriers += 1;
        if let Some(hazards) = &mut self.hazards {
            hazards.tracker.barrier();
        }
        self.record_barrier();
    }

    pub(super) fn record_barrier(&self) {
        type Stage = vk::PipelineStageFlags2;
        type Flags = vk::AccessFlags2;
        // All stages on both sides: a write must also wait for earlier reads.
        let stages = Stage::COMPUTE_SHADER | Stage::ALL_TRANSFER | Stage::DRAW_INDIRECT;
        let writes = Flags::SHADER_WRITE | Flags::TRANSFER_WRITE;
        let shader_reads = Flags::SHADER_READ | Flags::UNIFORM_READ;
        let reads = shader_reads | Flags::TRANSFER_READ | Flags::INDIRECT_COMMAND_READ;
        let barriers = [vk::MemoryBarrier2::default()
            .src_stage_mask(stages)
            .src_access_mask(writes)
            .dst_stage_mask(stages)
            .dst_access_mask(reads | writes)];
        let dependency = vk::DependencyInfo::default().memory_barriers(&barriers);
        // SAFETY: recording state, outside of a render pass.
        unsafe { self.inner.device.cmd_pipeline_barrier2(self.raw(), &dependency) }
    }

    /// Labels and times the commands that `f` records.
    pub fn scope<T>(&mut self, name: &str, f: impl FnOnce(&mut Self) -> T) -> T {
        self.profiler.begin(&self.inner, self.raw(), name);
        let result = f(self);
        self.profiler.end(&self.inner, self.raw());
        result
    }

    /// Returns the device's limits.
    pub fn limits(&self) -> &Limits {
        &self.inner.limits
    }

    /// Returns the number of calls of [`Recorder::barrier`].
    pub fn barriers(&self) -> u32 {
        self.barriers
    }
}

// Binds the resources of a dispatch, by push descriptors or by a preallocated set.

/// Most images of one kernel.
const MAX_IMAGES: usize = 2;

impl Recorder {
    /// Binds the pipeline, its buffers, images and push constants. Returns false if this call or an earlier
    /// one has failed. Nothing may be dispatched then, and the end of the recording reports the error
    /// ([`Recorder::check`]).
    pub(super) fn prepare(&mut self, pipeline: &Arc<Pipeline>, bound: &Bound<'_>, push: &[u8]) -> bool {
        if self.failed.is_none() {
            self.failed = self.try_prepare(pipeline, bound, push).err();
        }
        self.failed.is_none()
    }

    fn try_prepare(&mut self, pipeline: &Arc<Pipeline>, bound: &Bound<'_>, push: &[u8]) -> Result<()> {
        assert!(pipeline.is_of(&self.inner), "kernel {} is of another context", pipeline.name);
        let mut buffers = [vk::DescriptorBufferInfo::default(); MAX_BINDINGS];
        let mut views = [vk::BufferView::null(); MAX_BINDINGS];
        let descriptors = buffers.iter_mut().zip(&mut views).zip(pipeline.bindings);
        for (((descriptor, view), info), buffer) in descriptors.zip(bound.buffers) {
            self.check_binding(pipeline, info, buffer);
            if let BindingKind::Texels(format) = info.kind {
                *view = self.texel_view(pipeline, info.name, buffer, format)?;
            }
            self.keep(buffer);
            let bytes = match info.kind {
                BindingKind::Uniform { bytes } => bytes.into(),
                _ => bound_bytes(buffer),
            };
            let offset = buffer.offset();
            *descriptor =
                vk::DescriptorBufferInfo::default().buffer(buffer.raw()).offset(offset).range(bytes);
        }
        let mut images = [vk::DescriptorImageInfo::default(); MAX_IMAGES];
        for ((descriptor, info), image) in images.iter_mut().zip(pipeline.images).zip(bound.images) {
            let (kernel, name) = (pipeline.name, image.name());
            assert!(image.purpose().kind() == info.kind, "{kernel}: image '{name}' is no {:?}", info.kind);
            self.keep_image(image);
            *descriptor = image.descriptor();
        }
        let mut writes = [vk::WriteDescriptorSet::default(); MAX_BINDINGS + MAX_IMAGES];
        let (first, rest) = writes.split_at_mut(bound.buffers.len());
        let descriptors = pipeline.bindings.iter().zip(&buffers).zip(&views);
        for (write, ((info, descriptor), view)) in first.iter_mut().zip(descriptors) {
            let empty = vk::WriteDescriptorSet::default().dst_binding(info.binding);
            let empty = empty.descriptor_type(info.kind.descriptor_type());
            *write = match info.kind {
                BindingKind::Texels(_) => empty.texel_buffer_view(std::slice::from_ref(view)),
                _ => empty.buffer_info(std::slice::from_ref(descriptor)),
            };
        }
        for ((write, info), descriptor) in rest.iter_mut().zip(pipeline.images).zip(&images) {
            *write = vk::WriteDescriptorSet::default()
                .dst_binding(info.binding)
                .descriptor_type(info.kind.descriptor_type())
                .image_info(std::slice::from_ref(descriptor));
        }
        let mut count = bound.buffers.len() + bound.images.len();
        let storage = pipeline.bindings.iter().position(|info| info.kind == BindingKind::Storage);
        if let (Some(_), Some(any)) = (&self.inner.shared_layouts, storage) {
            // No descriptor of an earlier use may remain in the set: see the module `descriptors`.
            let missing = |binding: &u32| pipeline.bindings.iter().all(|info| info.binding != *binding);
            for binding in (0..BUFFERS).filter(missing) {
                writes[count] = vk::WriteDescriptorSet::default()
                    .dst_binding(binding)
                    .descriptor_type(vk::DescriptorType::STORAGE_BUFFER)
                    .buffer_info(&buffers[any..=any]);
                count += 1;
            }
        }
        self.kept.pipeline(pipeline);
        self.bind(pipeline, &mut writes[..count], push)
    }

    /// Keeps a buffer's memory alive for the recording. The buffer must belong to the recording's device.
    pub(super) fn keep(&mut self, buffer: &Buffer) {
        let block = buffer.block();
        assert!(block.is_of(&self.inner), "buffer '{}' is of another context", buffer.name());
        self.kept.block(block);
    }

    /// Same as [`Self::keep`], but for an image.
    pub(super) fn keep_image(&mut self, image: &Image) {
        assert!(image.is_of(&self.inner), "image '{}' is of another context", image.name());
        self.kept.image(image);
    }

    /// Panics for a buffer that cannot be bound.
    fn check_binding(&self, pipeline: &Pipeline, info: &BindingInfo, buffer: &Buffer) {
        let limits = &self.inner.limits;
        let (kernel, role, name, bytes) = (pipeline.name, info.name, buffer.name(), buffer.bytes());
        let (least, most, alignment) = match info.kind {
            BindingKind::Uniform { bytes } => (u64::from(bytes), u64::MAX, limits.uniform_alignment),
            _ => (1, limits.max_storage_buffer_range, limits.storage_alignment),
        };
        assert!(
            (least..=most).contains(&bytes),
            "{kernel}: '{name}' bound as '{role}' has {bytes} bytes, the limits are {least} and {most}"
        );
        assert!(
            buffer.offset().is_multiple_of(alignment),
            "{kernel}: '{name}' bound as '{role}' begins at {}, no multiple of {alignment}",
            buffer.offset()
        );
    }

    /// Returns a texel view of a buffer. Panics for a buffer that cannot be bound as texels.
    fn texel_view(
        &self,
        pipeline: &Pipeline,
        role: &str,
        buffer: &Buffer,
        format: TexelFormat,
    ) -> Result<vk::BufferView> {
        let limits = &self.inner.limits;
        let (kernel, name, offset, bytes) = (pipeline.name, buffer.name(), buffer.offset(), buffer.bytes());
        let texels = bytes / format.bytes();
        assert!(
            texels <= limits.max_texels && texels > 0 && offset.is_multiple_of(limits.texel_alignment),
            "{kernel}: '{name}' bound as '{role}' has {texels} texels at {offset}; at most {} at a multiple of {}",
            limits.max_texels,
            limits.texel_alignment
        );
        let block = buffer.block();
        block.texels.of(&self.inner.device, buffer.raw(), TexelRange { offset, bytes, format })
    }

    fn bind(
        &mut self,
        pipeline: &Pipeline,
        writes: &mut [vk::WriteDescriptorSet<'_>],
        push: &[u8],
    ) -> Result<()> {
        let set = match self.commands.descriptors() {
            Some(sets) if !writes.is_empty() => Some(sets.next(&self.inner, pipeline.handles.set_kind)?),
            _ => None,
        };
        let (raw, device, point) = (self.raw(), &self.inner.device, vk::PipelineBindPoint::COMPUTE);
        // SAFETY: recording state; pipeline, layout and descriptors belong together, and the recorder keeps all of
        // them until the execution is over; a set is written once in a recording, before it is bound. `push` has the
        // size that the layout was made with.
        unsafe {
            if self.bound != pipeline.handles.raw {
                device.cmd_bind_pipeline(raw, point, pipeline.handles.raw);
                self.bound = pipeline.handles.raw;
            }
            match (&self.inner.push_descriptor, set) {
                (Some(extension), _) if !writes.is_empty() => {
                    extension.cmd_push_descriptor_set(raw, point, pipeline.handles.layout, 0, writes);
                }
                (None, Some(set)) => {
                    writes.iter_mut().for_each(|write| write.dst_set = set);
                    device.update_descriptor_sets(writes, &[]);
                    device.cmd_bind_descriptor_sets(raw, point, pipeline.handles.layout, 0, &[set], &[]);
                }
                _ => {}
            }
            if !push.is_empty() {
                device.cmd_push_constants(
                    raw,
                    pipeline.handles.layout,
                    vk::ShaderStageFlags::COMPUTE,
                    0,
                    push,
                );
            }
        }
        Ok(())
    }
}

/// Returns the number of bound bytes.
#[cfg(not(feature = "testing"))]
fn bound_bytes(buffer: &Buffer) -> u64 {
    buffer.bytes()
}

/// Returns the number of bound bytes, including the guard band behind the buffer. Drivers drop writes outside the bound
/// range, so a shorter range would hide breaches.
#[cfg(feature = "testing")]
fn bound_bytes(buffer: &Buffer) -> u64 {
    buffer.bytes() + buffer.guard_behind()
}

// Commands on images: layouts and copies.

impl Recorder {
    /// Makes an image ready for kernels: waits for the use `from`, and changes the layout to [`Image::layout`]. Returns the
    /// kernels' use.
    pub fn acquire_image(&mut self, image: &Image, from: ImageState) -> ImageState {
        let accesses = match image.purpose().kind() {
            ImageKind::Storage => {
                vk::AccessFlags2::SHADER_STORAGE_READ | vk::AccessFlags2::SHADER_STORAGE_WRITE
            }
            ImageKind::Sampled => vk::AccessFlags2::SHADER_SAMPLED_READ,
        };
        let stages = vk::PipelineStageFlags2::COMPUTE_SHADER;
        let to = ImageState { layout: image.layout(), stages, accesses };
        match image.acquisition(from) {
            Some(half) => {
                self.record_image_barrier(image, half.dst_stage_mask(stages).dst_access_mask(accesses));
            }
            None => self.image_barrier(image, from, to),
        }
        to
    }

    /// Copies a buffer of tightly packed texels into an image of our own, and leaves it ready for kernels.
    ///
    /// # Panics
    /// When the buffer is smaller than the image.
    pub fn copy_to_image(&mut self, from: &Buffer, image: &Image) {
        let transfer = ImageState {
            layout: vk::ImageLayout::TRANSFER_DST_OPTIMAL,
            stages: vk::PipelineStageFlags2::ALL_TRANSFER,
            accesses: vk::AccessFlags2::TRANSFER_WRITE,
        };
        self.image_barrier(image, ImageState::UNDEFINED, transfer);
        self.transfer("copy to image", &[(from, "source", Access::Read)]);
        let region = image.copy_region(from);
        // SAFETY: recording state; the layout is as the barrier says, the region is the whole level of the image.
        unsafe {
            let (raw, layout) = (self.raw(), transfer.layout);
            self.inner.device.cmd_copy_buffer_to_image(raw, from.raw(), image.raw(), layout, &[region]);
        }
        self.acquire_image(image, transfer);
    }

    /// Copies an image that kernels have written into a buffer of tightly packed texels.
    ///
    /// # Panics
    /// When the buffer is smaller than the image.
    pub fn copy_from_image(&mut self, image: &Image, to: &Buffer) {
        let stages = vk::PipelineStageFlags2::COMPUTE_SHADER;
        let accesses = vk::AccessFlags2::SHADER_STORAGE_WRITE;
        let written = ImageState { layout: image.layout(), stages, accesses };
        let transfer = ImageState {
            layout: vk::ImageLayout::TRANSFER_SRC_OPTIMAL,
            stages: vk::PipelineStageFlags2::ALL_TRANSFER,
            accesses: vk::AccessFlags2::TRANSFER_READ,
        };
        self.image_barrier(image, written, transfer);
        self.transfer("copy from image", &[(to, "destination", Access::Write)]);
        let region = image.copy_region(to);
        // SAFETY: as in `copy_to_image`.
        unsafe {
            let (raw, layout) = (self.raw(), transfer.layout);
            self.inner.device.cmd_copy_image_to_buffer(raw, image.raw(), layout, to.raw(), &[region]);
        }
    }

    fn image_barrier(&mut self, image: &Image, from: ImageState, to: ImageState) {
        let barrier = vk::ImageMemoryBarrier2::default()
            .src_stage_mask(from.stages)
            .src_access_mask(from.accesses)
            .dst_stage_mask(to.stages)
            .dst_access_mask(to.accesses)
            .old_layout(from.layout)
            .new_layout(to.layout)
            .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .image(image.raw())
            .subresource_range(image.whole_range());
        self.record_image_barrier(image, barrier);
    }

    pub(super) fn record_image_barrier(&mut self, image: &Image, barrier: vk::ImageMemoryBarrier2<'_>) {
        self.keep_image(image);
        let barriers = [barrier];
        let dependency = vk::DependencyInfo::default().image_memory_barriers(&barriers);
        // SAFETY: recording state, outside of a render pass; the view's owner says that the image is alive.
        unsafe { self.inner.device.cmd_pipeline_barrier2(self.raw(), &dependency) }
    }
}
