//! Records commands: dispatches, fills, copies, and the barriers between them.

use super::audit;
use super::barriers::{Barriers, COMPUTE, TRANSFER};
use super::binding_numbers::BUFFERS;
use super::commands::Commands;
use super::format::{Access, ImageKind, TexelFormat};
use super::hazard::Hazards;
use super::image::{Image, ImageState};
use super::kernel::{Kernel, KernelInterface, KernelSet};
use super::lock::lock;
use super::memory::{Block, Buffer};
use super::open_device::Device;
use super::pipeline::{DescriptorSets, MAX_BINDINGS, Pipeline};
use super::pipeline_cache::{BindingInfo, BindingKind, PipelineHandles};
use super::profile::{BoundBuffer, CommandRecord, Commands as Profiled, Profiler};
use crate::error::{Error, Result};
use ash::vk;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

struct Bindings<'a> {
    buffers: &'a [&'a Buffer],
    images: &'a [&'a Image],
}

pub(super) struct KeepAlive {
    /// Unique id of this recording. Every block stores the id of the last recording that keeps it, which avoids searches.
    id: u64,
    pub(super) blocks: Vec<Arc<Block>>,
    pipelines: Vec<Arc<Pipeline>>,
    images: Vec<Image>,
}

impl Default for KeepAlive {
    fn default() -> Self {
        Self { id: next_id(), blocks: Vec::new(), pipelines: Vec::new(), images: Vec::new() }
    }
}

fn next_id() -> u64 {
    static NEXT: AtomicU64 = AtomicU64::new(1);
    NEXT.fetch_add(1, Ordering::Relaxed)
}

impl KeepAlive {
    fn block(&mut self, block: &Arc<Block>) {
        // If two threads record with the same block, each may keep it more than once.
        if block.retained_by.swap(self.id, Ordering::Relaxed) != self.id {
            self.blocks.push(block.clone());
        }
    }

    fn image(&mut self, image: &Image) {
        if !self.images.iter().rev().any(|i| i.id() == image.id()) {
            self.images.push(image.clone());
        }
    }

    fn pipeline(&mut self, pipeline: &Arc<Pipeline>) {
        if !self.pipelines.iter().rev().any(|p| Arc::ptr_eq(p, pipeline)) {
            self.pipelines.push(pipeline.clone());
        }
    }

    /// Releases all resources, but keeps the lists' memory. Resources without another owner are destroyed.
    pub(super) fn clear(&mut self) {
        self.id = next_id();
        self.blocks.clear();
        self.pipelines.clear();
        self.images.clear();
    }
}

/// Workgroups of a dispatch: a grid, or a buffer that holds it when the command runs.
#[derive(Clone, Copy)]
enum Grid<'a> {
    Of([u32; 3]),
    In(&'a Buffer),
}

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
    commands: Target,
    inner: Arc<Device>,
    profiler: Profiler,
    pub(super) retained: Arc<Mutex<KeepAlive>>,
    bound: vk::Pipeline,
    hazards: Option<Hazards>,
    order: Barriers,
    /// Number of calls of [`Recorder::barrier`].
    barriers: u32,
    #[cfg(feature = "testing")]
    omitted: Vec<u32>,
    audit: Option<audit::Commands>,
    /// Error of the first call that failed. No dispatch is recorded after it, and the recording cannot be submitted.
    failed: Option<Error>,
}

pub(super) enum Target {
    Owned(Box<Commands>),
    /// A command buffer that the host submits, and the sets of its [`super::RecordSlot`]; None with push descriptors.
    Foreign(vk::CommandBuffer, Arc<Mutex<Option<DescriptorSets>>>),
}

impl Recorder {
    pub(super) fn new(
        commands: Commands,
        label: &'static str,
        profiled: Option<Profiled>,
        audit: Option<audit::Commands>,
    ) -> Self {
        // An audited recording may use several command buffers.
        let queries = if audit.is_some() { vk::QueryPool::null() } else { commands.queries() };
        let (inner, profiler) = (commands.inner.clone(), Profiler::new(queries, profiled));
        let target = Target::Owned(Box::new(commands));
        Self { audit, ..Self::begin(target, inner, Arc::default(), profiler, label) }
    }

    pub(super) fn begin(
        commands: Target,
        inner: Arc<Device>,
        retained: Arc<Mutex<KeepAlive>>,
        profiler: Profiler,
        label: &'static str,
    ) -> Self {
        let order = match commands {
            // It begins with a full barrier.
            Target::Owned(_) => Barriers::default(),
            // The host's commands.
            Target::Foreign(..) => Barriers::after(COMPUTE | TRANSFER),
        };
        let mut recorder = Self {
            commands,
            profiler,
            retained,
            order,
            bound: vk::Pipeline::null(),
            hazards: inner.hazard_check.then(Hazards::default),
            barriers: 0,
            #[cfg(feature = "testing")]
            omitted: Vec::new(),
            audit: None,
            failed: None,
            inner,
        };
        recorder.profiler.begin(&recorder.inner, recorder.raw(), label);
        recorder
    }

    /// Ends a recording into a host's command buffer.
    pub(super) fn finish_foreign(mut self) -> (vk::CommandBuffer, Profiler) {
        self.profiler.end(&self.inner, self.raw());
        match self.commands {
            Target::Foreign(raw, _) => (raw, self.profiler),
            Target::Owned(_) => panic!("an own command buffer is submitted by the context"),
        }
    }

    pub(super) fn finish(mut self) -> (Commands, Profiler, KeepAlive, Option<audit::Commands>) {
        self.profiler.end(&self.inner, self.raw());
        self.copy_indirect_arguments();
        match self.commands {
            Target::Owned(commands) => {
                let retained = std::mem::take(&mut *lock(&self.retained));
                (*commands, self.profiler, retained, self.audit)
            }
            Target::Foreign(..) => panic!("a foreign command buffer is submitted by its owner"),
        }
    }

    pub(super) fn raw(&self) -> vk::CommandBuffer {
        match &self.commands {
            Target::Owned(commands) => commands.raw(),
            Target::Foreign(raw, _) => *raw,
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
        self.dispatch_grid(kernel, bind, push, Grid::Of([x, y, z]));
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
        self.dispatch_grid(kernel, bind, push, Grid::In(arguments));
    }

    fn dispatch_grid<K: KernelInterface>(
        &mut self,
        kernel: &Kernel<K>,
        bind: &K::Bind<'_>,
        push: &K::Push,
        grid: Grid<'_>,
    ) {
        let (buffers, images) = (K::buffers(bind), K::images(bind));
        let bound = Bindings { buffers: buffers.as_ref(), images: images.as_ref() };
        self.declare(&kernel.pipeline, &bound, &grid);
        if matches!(grid, Grid::Of(grid) if grid.contains(&0)) {
            return;
        }
        let push = &K::push_bytes(push)[..kernel.pipeline.info.push_bytes as usize];
        if !self.prepare(&kernel.pipeline, &bound, push) {
            return;
        }
        let stages = match grid {
            Grid::Of(_) => COMPUTE,
            Grid::In(arguments) => self.order.stages_of_indirect(arguments),
        };
        self.record_due_barrier(stages);
        match grid {
            // SAFETY: the pipeline and everything that it uses are bound, the counts are within the limits.
            Grid::Of([x, y, z]) => unsafe { self.inner.device.cmd_dispatch(self.raw(), x, y, z) },
            Grid::In(arguments) => {
                self.keep(arguments);
                let (buffer, offset) = arguments.handle();
                // SAFETY: as above; the buffer has the INDIRECT usage and twelve bytes at an offset divisible by four.
                unsafe { self.inner.device.cmd_dispatch_indirect(self.raw(), buffer, offset) }
            }
        }
        let info = &kernel.pipeline.info;
        let uses = info.bindings.iter().zip(bound.buffers);
        let workgroups = if let Grid::Of(grid) = grid { Some(grid) } else { None };
        self.observe(info.name, workgroups, uses.map(|(info, buffer)| (*buffer, info.name, info.access)));
        if let (Grid::In(arguments), Some(profiled)) = (grid, &mut self.profiler.commands) {
            profiled.is_indirect(arguments);
        }
    }

    /// Audits and profiles a command that was just recorded, with its uses of buffers.
    fn observe<'a>(
        &mut self,
        name: &'static str,
        workgroups: Option<[u32; 3]>,
        uses: impl Iterator<Item = (&'a Buffer, &'static str, Access)> + Clone,
    ) {
        let written = uses.clone().filter(|(_, _, access)| access.writes());
        written.for_each(|(buffer, _, _)| self.order.note_write(buffer));
        self.audit(name, uses.clone());
        let raw = self.raw();
        self.profiler.command(&self.inner, raw, self.barriers, || {
            let bound = |(buffer, role, access): (&Buffer, _, _)| BoundBuffer {
                role,
                name: buffer.name(),
                access,
                bytes: buffer.bytes(),
            };
            let (scope, buffers) = ("", uses.map(bound).collect());
            CommandRecord { name, scope, workgroups, buffers, barriers: 0, begin_ns: None, nanoseconds: None }
        });
    }

    /// Copies the final arguments of indirect dispatches to the profile's readback buffer.
    fn copy_indirect_arguments(&mut self) {
        let Some(profiled) = self.profiler.commands.take() else { return };
        let copies: Vec<_> = profiled.copies().collect();
        if !copies.is_empty() {
            self.barrier();
            self.record_due_barrier(TRANSFER);
        }
        for (from, to) in copies {
            lock(&self.retained).block(to.block());
            from.record_copy(self.raw(), &to);
        }
        self.profiler.commands = Some(profiled);
    }

    /// Makes the recording fail with this error, unless it has failed already. Nothing is dispatched after it.
    pub(super) fn fail(&mut self, error: Error) {
        self.failed.get_or_insert(error);
    }

    /// The kernel of a set with these constants. If it is not built, the recording fails.
    pub(crate) fn kernel<'k, K: KernelInterface>(
        &mut self,
        set: &'k KernelSet<K>,
        spec: &K::Spec,
    ) -> Option<&'k Kernel<K>> {
        set.get(spec).map_err(|error| self.fail(error)).ok()
    }

    /// Returns the first error of the recording so far: the driver had no memory for descriptors or views, or a kernel was
    /// not built. [`super::Context::submit`] checks this itself.
    pub(crate) fn check(&mut self) -> Result<()> {
        self.failed.take().map_or(Ok(()), Err)
    }

    /// Declares the accesses of a dispatch to the hazard checker.
    fn declare(&mut self, pipeline: &Pipeline, bound: &Bindings<'_>, grid: &Grid<'_>) {
        let Some(hazards) = self.hazards.as_mut().filter(|_| self.failed.is_none()) else { return };
        for (info, buffer) in pipeline.info.bindings.iter().zip(bound.buffers) {
            hazards.add(buffer, info.name, info.access, info.aliased);
        }
        for (info, image) in pipeline.info.images.iter().zip(bound.images) {
            hazards.add_image(image, info.name, info.access);
        }
        if let Grid::In(arguments) = grid {
            // Only the first three words are read.
            hazards.add(&arguments.range(0, 12), "indirect arguments", Access::Read, false);
        }
        hazards.commit(pipeline.info.name);
    }

    /// Sets every word of a buffer.
    ///
    /// # Panics
    /// When the buffer's offset or size is no multiple of 4, or a barrier is missing.
    pub fn fill(&mut self, buffer: &Buffer, value: u32) {
        let uses = [(buffer, "destination", Access::Write)];
        self.transfer("fill", &uses);
        if buffer.bytes() == 0 {
            return;
        }
        let (raw, offset) = buffer.handle();
        // SAFETY: recording state; a range within a buffer that is kept, with TRANSFER_DST usage.
        unsafe { self.inner.device.cmd_fill_buffer(self.raw(), raw, offset, buffer.bytes(), value) }
        self.observe("fill", None, uses.into_iter());
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
        from.record_copy(self.raw(), to);
        self.observe("copy", None, uses.into_iter());
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
        let uses = [(&range, "destination", Access::Write)];
        self.transfer("update", &uses);
        // SAFETY: recording state; a range within a buffer that is kept, sizes checked above.
        unsafe { self.inner.device.cmd_update_buffer(self.raw(), range.raw(), range.offset(), bytes) }
        self.observe("update", None, uses.into_iter());
    }

    fn transfer(&mut self, command: &'static str, uses: &[(&Buffer, &'static str, Access)]) {
        for (buffer, role, access) in uses {
            let aligned = buffer.offset().is_multiple_of(4) && buffer.bytes().is_multiple_of(4);
            assert!(aligned, "{command}: '{}' is no range of whole words", buffer.name());
            self.keep(buffer);
            if let Some(hazards) = &mut self.hazards {
                hazards.add(buffer, role, *access, false);
            }
        }
        if let Some(hazards) = &mut self.hazards {
            hazards.commit(command);
        }
        self.record_due_barrier(TRANSFER);
    }

    /// Orders all earlier commands before all later ones: their writes become visible, also as indirect arguments. The device
    /// gets a barrier between the stages that both use.
    pub fn barrier(&mut self) {
        #[cfg(feature = "testing")]
        if self.omits_barrier() {
            return;
        }
        self.barriers += 1;
        if let Some(hazards) = &mut self.hazards {
            hazards.barrier();
        }
        self.order.add();
    }

    /// Records the barrier before a command of these stages, if one is due.
    fn record_due_barrier(&mut self, stages: vk::PipelineStageFlags2) {
        if let Some(barrier) = self.order.order(stages) {
            self.record_barrier(barrier);
        }
    }

    fn record_barrier(&self, barrier: vk::MemoryBarrier2<'_>) {
        self.inner.barrier(self.raw(), &vk::DependencyInfo::default().memory_barriers(&[barrier]));
    }

    /// Labels and times the commands that `f` records.
    pub fn scope<T>(&mut self, name: &'static str, f: impl FnOnce(&mut Self) -> T) -> T {
        self.profiler.begin(&self.inner, self.raw(), name);
        let result = f(self);
        self.profiler.end(&self.inner, self.raw());
        result
    }

    /// Returns the number of calls of [`Recorder::barrier`].
    pub fn barriers(&self) -> u32 {
        self.barriers
    }
}

// Binds the resources of a dispatch, by push descriptors or by a preallocated set.

const MAX_IMAGES: usize = 2;

impl Recorder {
    /// Binds the pipeline, its buffers, images and push constants. Returns false if this call or an earlier
    /// one has failed. Nothing may be dispatched then, and the end of the recording reports the error
    /// ([`Recorder::check`]).
    fn prepare(&mut self, pipeline: &Arc<Pipeline>, bound: &Bindings<'_>, push: &[u8]) -> bool {
        if self.failed.is_none() {
            self.failed = self.try_prepare(pipeline, bound, push).err();
        }
        self.failed.is_none()
    }

    fn try_prepare(&mut self, pipeline: &Arc<Pipeline>, bound: &Bindings<'_>, push: &[u8]) -> Result<()> {
        let info = &pipeline.info;
        assert!(pipeline.is_of(&self.inner), "kernel {} is of another context", info.name);
        let mut buffers = [vk::DescriptorBufferInfo::default(); MAX_BINDINGS];
        let mut views = [vk::BufferView::null(); MAX_BINDINGS];
        let descriptors = buffers.iter_mut().zip(&mut views).zip(info.bindings);
        for (((descriptor, view), binding), buffer) in descriptors.zip(bound.buffers) {
            self.check_binding(info.name, binding, buffer);
            if let BindingKind::Texels(format) = binding.kind {
                *view = self.texel_view(info.name, binding.name, buffer, format)?;
            }
            self.keep(buffer);
            let bytes = match binding.kind {
                BindingKind::Uniform { bytes } => bytes.into(),
                // With the guard band: drivers drop writes outside the bound range, so a shorter one would hide breaches.
                _ => buffer.bytes() + buffer.guard_behind(),
            };
            let (raw, offset) = buffer.handle();
            *descriptor = vk::DescriptorBufferInfo::default().buffer(raw).offset(offset).range(bytes);
        }
        let mut images = [vk::DescriptorImageInfo::default(); MAX_IMAGES];
        for ((descriptor, binding), image) in images.iter_mut().zip(info.images).zip(bound.images) {
            let (kernel, name) = (info.name, image.name());
            assert!(
                image.purpose().kind() == binding.kind,
                "{kernel}: image '{name}' is no {:?}",
                binding.kind
            );
            self.keep_image(image);
            *descriptor = image.descriptor();
        }
        let write =
            |binding, kind| vk::WriteDescriptorSet::default().dst_binding(binding).descriptor_type(kind);
        let mut writes = [vk::WriteDescriptorSet::default(); MAX_BINDINGS + MAX_IMAGES];
        let mut count = 0;
        let mut add = |write| {
            writes[count] = write;
            count += 1;
        };
        for ((binding, descriptor), view) in info.bindings.iter().zip(&buffers).zip(&views) {
            let write = write(binding.binding, binding.kind.descriptor_type());
            add(match binding.kind {
                BindingKind::Texels(_) => write.texel_buffer_view(std::slice::from_ref(view)),
                _ => write.buffer_info(std::slice::from_ref(descriptor)),
            });
        }
        for (binding, descriptor) in info.images.iter().zip(&images) {
            let write = write(binding.binding, binding.kind.descriptor_type());
            add(write.image_info(std::slice::from_ref(descriptor)));
        }
        let storage = info.bindings.iter().position(|binding| binding.kind == BindingKind::Storage);
        if let (Some(_), Some(any)) = (&self.inner.shared_layouts, storage) {
            // No descriptor of an earlier use may remain in the set: see the module `pipeline`.
            let missing = |number: &u32| info.bindings.iter().all(|binding| binding.binding != *number);
            for number in (0..BUFFERS).filter(missing) {
                add(write(number, vk::DescriptorType::STORAGE_BUFFER).buffer_info(&buffers[any..=any]));
            }
        }
        lock(&self.retained).pipeline(pipeline);
        self.bind(pipeline, &mut writes[..count], push)
    }

    /// Keeps a buffer's memory alive for the recording. The buffer must belong to the recording's device.
    fn keep(&mut self, buffer: &Buffer) {
        let block = buffer.block();
        assert!(block.is_of(&self.inner), "buffer '{}' is of another context", buffer.name());
        lock(&self.retained).block(block);
    }

    fn keep_image(&mut self, image: &Image) {
        assert!(image.is_of(&self.inner), "image '{}' is of another context", image.name());
        lock(&self.retained).image(image);
    }

    /// Panics for a buffer that cannot be bound.
    fn check_binding(&self, kernel: &str, info: &BindingInfo, buffer: &Buffer) {
        let limits = &self.inner.limits;
        let (role, name, bytes) = (info.name, buffer.name(), buffer.bytes());
        let (min, max, alignment) = match info.kind {
            BindingKind::Uniform { bytes } => (u64::from(bytes), u64::MAX, limits.uniform_alignment),
            _ => (1, limits.max_storage_buffer_range, limits.storage_alignment),
        };
        assert!(
            (min..=max).contains(&bytes),
            "{kernel}: '{name}' bound as '{role}' has {bytes} bytes, the limits are {min} and {max}"
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
        kernel: &str,
        role: &str,
        buffer: &Buffer,
        format: TexelFormat,
    ) -> Result<vk::BufferView> {
        let limits = &self.inner.limits;
        let (name, offset, bytes) = (buffer.name(), buffer.offset(), buffer.bytes());
        let texels = bytes / format.bytes();
        assert!(
            texels <= limits.max_texels && texels > 0 && offset.is_multiple_of(limits.texel_alignment),
            "{kernel}: '{name}' bound as '{role}' has {texels} texels at {offset}; at most {} at a multiple of {}",
            limits.max_texels,
            limits.texel_alignment
        );
        buffer.block().texel_view(offset, bytes, format)
    }

    fn bind(
        &mut self,
        pipeline: &Pipeline,
        writes: &mut [vk::WriteDescriptorSet<'_>],
        push: &[u8],
    ) -> Result<()> {
        let next = |sets: &mut DescriptorSets| sets.next(pipeline.handles.set_kind);
        let set = match &mut self.commands {
            _ if writes.is_empty() => None,
            Target::Owned(commands) => commands.descriptors.as_mut().map(next).transpose()?,
            Target::Foreign(_, descriptors) => lock(descriptors).as_mut().map(next).transpose()?,
        };
        let (raw, device, point) = (self.raw(), &self.inner.device, vk::PipelineBindPoint::COMPUTE);
        let PipelineHandles { raw: handle, layout, .. } = pipeline.handles;
        // SAFETY: recording state; pipeline, layout and descriptors belong together, and the recorder keeps all of
        // them until the execution is over; a set is written once in a recording, before it is bound. `push` has the
        // size that the layout was made with.
        unsafe {
            if self.bound != handle {
                device.cmd_bind_pipeline(raw, point, handle);
                self.bound = handle;
            }
            match (&self.inner.push_descriptor, set) {
                (Some(extension), _) if !writes.is_empty() => {
                    extension.cmd_push_descriptor_set(raw, point, layout, 0, writes);
                }
                (None, Some(set)) => {
                    writes.iter_mut().for_each(|write| write.dst_set = set);
                    device.update_descriptor_sets(writes, &[]);
                    device.cmd_bind_descriptor_sets(raw, point, layout, 0, &[set], &[]);
                }
                _ => {}
            }
            if !push.is_empty() {
                device.cmd_push_constants(raw, layout, vk::ShaderStageFlags::COMPUTE, 0, push);
            }
        }
        Ok(())
    }
}

// Commands on images: layouts and copies.

impl Recorder {
    /// Makes an image ready for kernels: waits for the use `from`, and changes the layout to [`Image::layout`]. Returns the
    /// kernels' use.
    pub fn acquire_image(&mut self, image: &Image, from: ImageState) -> ImageState {
        type Flags = vk::AccessFlags2;
        let accesses = match image.purpose().kind() {
            ImageKind::Storage => Flags::SHADER_STORAGE_READ | Flags::SHADER_STORAGE_WRITE,
            ImageKind::Sampled => Flags::SHADER_SAMPLED_READ,
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
        let (layout, accesses) = (vk::ImageLayout::TRANSFER_DST_OPTIMAL, vk::AccessFlags2::TRANSFER_WRITE);
        let transfer = ImageState { layout, stages: vk::PipelineStageFlags2::ALL_TRANSFER, accesses };
        self.image_barrier(image, ImageState::UNDEFINED, transfer);
        self.transfer("copy to image", &[(from, "source", Access::Read)]);
        let (raw, device, region) = (self.raw(), &self.inner.device, image.copy_region(from));
        // SAFETY: recording state; the layout is as the barrier says, the region is the whole level of the image.
        unsafe { device.cmd_copy_buffer_to_image(raw, from.raw(), image.handle(), layout, &[region]) }
        self.acquire_image(image, transfer);
    }

    /// Copies an image that kernels have written into a buffer of tightly packed texels.
    ///
    /// # Panics
    /// When the buffer is smaller than the image.
    pub fn copy_from_image(&mut self, image: &Image, to: &Buffer) {
        let (stages, accesses) =
            (vk::PipelineStageFlags2::COMPUTE_SHADER, vk::AccessFlags2::SHADER_STORAGE_WRITE);
        let written = ImageState { layout: image.layout(), stages, accesses };
        let (layout, accesses) = (vk::ImageLayout::TRANSFER_SRC_OPTIMAL, vk::AccessFlags2::TRANSFER_READ);
        let transfer = ImageState { layout, stages: vk::PipelineStageFlags2::ALL_TRANSFER, accesses };
        self.image_barrier(image, written, transfer);
        self.transfer("copy from image", &[(to, "destination", Access::Write)]);
        let (raw, device, region) = (self.raw(), &self.inner.device, image.copy_region(to));
        // SAFETY: as in `copy_to_image`.
        unsafe { device.cmd_copy_image_to_buffer(raw, image.handle(), layout, to.raw(), &[region]) }
    }

    fn image_barrier(&mut self, image: &Image, from: ImageState, to: ImageState) {
        let barrier = image
            .barrier(from.layout, [vk::QUEUE_FAMILY_IGNORED; 2])
            .new_layout(to.layout)
            .src_stage_mask(from.stages)
            .src_access_mask(from.accesses)
            .dst_stage_mask(to.stages)
            .dst_access_mask(to.accesses);
        self.record_image_barrier(image, barrier);
    }

    /// Releases an image that kernels have used to the family that owns it.
    pub(crate) fn release_image(&mut self, image: &Image, used: ImageState) {
        if image.other_family().is_some() {
            let barrier = image.take_back().src_stage_mask(used.stages).src_access_mask(used.accesses);
            let nothing = (vk::PipelineStageFlags2::NONE, vk::AccessFlags2::NONE);
            self.record_image_barrier(image, barrier.dst_stage_mask(nothing.0).dst_access_mask(nothing.1));
        }
    }

    fn record_image_barrier(&mut self, image: &Image, barrier: vk::ImageMemoryBarrier2<'_>) {
        self.keep_image(image);
        self.inner.barrier(self.raw(), &vk::DependencyInfo::default().image_memory_barriers(&[barrier]));
    }
}

// Audit of a recording: copies the output of every command.

impl Recorder {
    fn audit<'a>(
        &mut self,
        command: &'static str,
        uses: impl Iterator<Item = (&'a Buffer, &'static str, Access)>,
    ) {
        let Some(mut audit) = self.audit.take() else { return };
        let written = uses.filter(|(_, _, access)| access.writes()).map(|(buffer, _, _)| buffer);
        let copies = audit.snapshot(&self.inner, command, written);
        let everything = vk::MemoryBarrier2::default()
            .src_stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
            .src_access_mask(vk::AccessFlags2::MEMORY_WRITE)
            .dst_stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
            .dst_access_mask(vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE);
        self.record_barrier(everything);
        for (from, to) in copies {
            // The audit keeps the copy until it is hashed.
            from.record_copy(self.raw(), &to);
        }
        self.record_barrier(everything);
        let is_full = audit.is_full();
        self.audit = Some(audit);
        if is_full && let Err(error) = self.submit_snapshots() {
            self.fail(error);
        }
    }

    /// Submits the recording, hashes its snapshots, and continues the recording.
    fn submit_snapshots(&mut self) -> Result<()> {
        let (Target::Owned(commands), Some(audit)) = (&mut self.commands, &mut self.audit) else {
            return Ok(());
        };
        let pools = commands.pools.clone();
        commands.submit(None)?;
        commands.wait(self.inner.timeout)?;
        audit.log()?;
        self.commands = Target::Owned(Box::new(Commands::begin(&pools, None, audit.submission, 0)?));
        self.bound = vk::Pipeline::null();
        Ok(())
    }
}

/// For tests of barriers: omits some, and collects hazards.
#[cfg(feature = "testing")]
impl Recorder {
    /// True if the test omits the next barrier; counts it. While collecting hazards, still records it on the device.
    fn omits_barrier(&mut self) -> bool {
        if !self.omitted.contains(&self.barriers) {
            return false;
        }
        self.barriers += 1;
        if self.hazards.as_ref().is_some_and(|hazards| hazards.collected.is_some()) {
            self.order.add();
        }
        true
    }

    /// Omits the `index`-th call of [`Recorder::barrier`], counted from 0. A recording that collects hazards keeps the
    /// barrier on the device and hides it from the checker only.
    pub fn omit_barrier(&mut self, index: u32) {
        self.omitted.push(index);
    }

    /// Collects hazards from the next command on, without panics; see [`Recorder::hazards`]. Works even if the context does
    /// not check.
    pub fn collect_hazards(&mut self) {
        self.hazards = Some(Hazards::collecting());
    }

    /// Returns the hazards found since [`Recorder::collect_hazards`].
    pub fn hazards(&self) -> &[String] {
        self.hazards.as_ref().and_then(|h| h.collected.as_deref()).unwrap_or_default()
    }
}
