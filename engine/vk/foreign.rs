//! Recording into a host's command buffers, and a host's buffers.

use super::context::Context;
use super::debug::vk_error;
use super::lock::lock;
use super::memory::{Block, Buffer, Life, PLACEMENT_ALIGNMENT, pack, padded};
use super::open_device::Device;
use super::pipeline::DescriptorSets;
use super::profile::{MAX_SCOPES, Profiler, ScopeTime};
use super::recorder::{KeepAlive, Recorder, Target};
use super::requirements::Requirements;
use crate::error::{Error, Result};
use ash::vk;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};

impl Context {
    /// Returns the requirements of [`Context::from_foreign`].
    pub fn requirements() -> Requirements {
        Requirements::of_all()
    }

    /// Adopts a host's command buffer, to record into it through a slot.
    ///
    /// # Errors
    /// [`Error::Argument`] for a null handle. Also if the context opened its own device and reads texels
    /// ([`ContextOptions::texels`](super::ContextOptions::texels)).
    ///
    /// # Safety
    /// - `commands` belongs to the context's device and queue family, and is in the recording state, outside a render pass;
    /// - nothing else records into it until the recording that begins with it has ended;
    /// - it is submitted at most once before it is recorded again, to a queue of the context's queue family. If there are
    ///   several queues, the host orders submissions that use the same buffers or images by semaphores;
    /// - before the slot of this recording is recorded through again, released or dropped, the whole command buffer has
    ///   finished. The host knows this by a fence, a timeline semaphore or an idle queue. Or it has ensured that execution
    ///   never begins ([`RecordSlot::discard`]). [`RecordSlot::finished`] is not enough: it covers only the guest's
    ///   commands, not those that the host recorded after them;
    /// - until then the host neither writes nor reads buffers that the recording uses
    ///   ([`Buffer::write`](super::Buffer::write), [`Context::upload`], [`Context::download`]).
    ///
    /// Until then the slot keeps all resources of the recording alive. Resources that are dropped meanwhile
    /// are destroyed with the slot's next recording, or by [`RecordSlot::release`].
    ///
    /// Afterwards the pipeline, descriptors and push constants of the compute bind point are changed.
    pub unsafe fn adopt_commands(&self, commands: vk::CommandBuffer) -> Result<ForeignCommands> {
        if commands == vk::CommandBuffer::null() {
            return Err(Error::argument("commands", "the handle is null"));
        }
        self.device.check_adoption()?;
        Ok(ForeignCommands { inner: self.device.clone(), raw: commands })
    }

    /// True if the instance and the device are a host's.
    pub fn is_foreign(&self) -> bool {
        self.device.is_foreign()
    }

    /// True if two contexts are the same.
    pub fn is(&self, other: &Context) -> bool {
        Arc::ptr_eq(&self.device, &other.device)
    }

    /// Returns the Vulkan objects of the context, for a host that shares a device of ours.
    pub fn handles(&self) -> (ash::Instance, vk::PhysicalDevice, ash::Device, u32) {
        let inner = &self.device;
        (inner.owner.instance().clone(), inner.physical, inner.device.raw.clone(), inner.queue_family)
    }
}

/// A host's command buffer in the recording state: [`Context::adopt_commands`].
pub struct ForeignCommands {
    inner: Arc<Device>,
    raw: vk::CommandBuffer,
}

impl ForeignCommands {
    /// True if it belongs to this context.
    pub fn belongs_to(&self, context: &Context) -> bool {
        Arc::ptr_eq(&self.inner, &context.device)
    }
}

/// Preallocated objects of a recording into a host's command buffer: one slot for each frame in flight. Between
/// [`RecordSlot::begin`] and [`RecordSlot::end`] nothing is created, allocated, mapped, submitted or waited for.
///
/// The device signals an event at the end of the recording, so that the host can query whether it has
/// finished.
///
/// A leaked slot ([`std::mem::forget`]) keeps its context and the resources of its last recording forever. Nothing waits
/// for it. A leaked recorder leaves its slot in flight until [`RecordSlot::discard`].
pub struct RecordSlot {
    inner: Arc<Device>,
    event: vk::Event,
    queries: vk::QueryPool,
    /// None with push descriptors.
    descriptors: Arc<Mutex<Option<DescriptorSets>>>,
    retained: Arc<Mutex<KeepAlive>>,
    profiler: Option<Profiler>,
    /// An idle profiler, whose memory is reused.
    spare: Option<Profiler>,
    /// True if a recording was begun and not discarded.
    recorded: bool,
    /// True if the last discarded recording had been executed.
    discarded_late: bool,
}

impl RecordSlot {
    /// Creates a slot for recordings of up to `dispatches` dispatches.
    pub fn new(context: &Context, dispatches: usize) -> Result<Self> {
        let inner = context.device.clone();
        let mut slot = Self {
            event: vk::Event::null(),
            queries: vk::QueryPool::null(),
            descriptors: Arc::new(Mutex::new(DescriptorSets::new(&inner))),
            retained: Arc::default(),
            profiler: None,
            spare: None,
            recorded: false,
            discarded_late: false,
            inner,
        };
        slot.reserve(dispatches)?;
        // SAFETY: a valid create info for this device.
        let event = unsafe { slot.inner.device.create_event(&vk::EventCreateInfo::default(), None) };
        slot.event = event.map_err(vk_error("vkCreateEvent"))?;
        slot.queries = slot.inner.create_queries(2 * MAX_SCOPES, "slot timestamps")?;
        slot.inner.names.name(slot.event, "slot event");
        Ok(slot)
    }

    /// Allocates for recordings of up to `dispatches` dispatches, from the next one on. Allowed while one is in flight.
    pub(crate) fn reserve(&mut self, dispatches: usize) -> Result<()> {
        match &mut *lock(&self.descriptors) {
            Some(sets) => sets.reserve(dispatches),
            None => Ok(()),
        }
    }

    /// True if the commands recorded through the slot have finished. True for a slot that was never used; false while the
    /// command buffer has not been submitted. Commands that the host recorded after them may still run. Never waits.
    pub fn finished(&self) -> Result<bool> {
        if !self.recorded {
            return Ok(true);
        }
        // SAFETY: the event is alive.
        let status = unsafe { self.inner.device.get_event_status(self.event) };
        status.map_err(|error| self.inner.failed("vkGetEventStatus", error))
    }

    /// Fails while the last recording is in flight. Otherwise the rest of its command buffer has finished too, as its
    /// adopter has promised.
    pub(crate) fn check_free(&self) -> Result<()> {
        if self.finished()? {
            return Ok(());
        }
        Err(Error::argument("slot", "its last recording is still in flight: wait for its fence"))
    }

    /// True if a recording was made through the slot and not discarded.
    pub fn is_recorded(&self) -> bool {
        self.recorded
    }

    /// True if the last discarded recording had been executed.
    pub(crate) fn was_discarded_late(&self) -> bool {
        self.discarded_late
    }

    /// Forgets a recording, including one that an error or a panic has left unfinished.
    ///
    /// # Safety
    /// The command buffer was not submitted and never will be, or its execution has finished; the recorder is
    /// dropped.
    pub unsafe fn discard(&mut self) {
        self.discarded_late = self.recorded && self.finished().unwrap_or(true);
        self.recorded = false;
        self.retire_profiler();
        lock(&self.retained).clear();
    }

    /// Releases all resources of the last recording, once its command buffer has finished. Scenes and image views dropped
    /// meanwhile are destroyed now, not by the next recording.
    pub fn release(&mut self) -> Result<()> {
        self.check_free()?;
        lock(&self.retained).clear();
        Ok(())
    }

    fn retire_profiler(&mut self) {
        self.spare = self.profiler.take().or_else(|| self.spare.take());
    }

    /// Begins a recording. On the device, it waits for the writes of earlier compute shaders and transfers in the queue.
    /// The slot is in flight from now on, even if the recorder is dropped, because its commands may be executed.
    ///
    /// # Errors
    /// [`Error::Argument`] if the previous recording has not finished, or if the commands belong to another context.
    /// Nothing is recorded then.
    pub fn begin(&mut self, commands: ForeignCommands, label: &'static str) -> Result<Recorder> {
        if !Arc::ptr_eq(&commands.inner, &self.inner) {
            return Err(Error::argument("commands", "it belongs to another context"));
        }
        self.check_free()?;
        let inner = &self.inner;
        // SAFETY: the event is not used by any submission: the last one has signalled it.
        let reset = unsafe { inner.device.reset_event(self.event) };
        reset.map_err(vk_error("vkResetEvent"))?;
        self.recorded = true;
        lock(&self.retained).clear();
        self.retire_profiler();
        let inner = &self.inner;
        let timed = inner.timestamps.load(Ordering::Relaxed);
        let queries = if timed { self.queries } else { vk::QueryPool::null() };
        if queries != vk::QueryPool::null() {
            // SAFETY: recording state outside of a render pass, as the adopter has promised; the pool is idle.
            unsafe { inner.device.cmd_reset_query_pool(commands.raw, queries, 0, 2 * MAX_SCOPES) }
        }
        if let Some(sets) = &mut *lock(&self.descriptors) {
            sets.reset();
        }
        let target = Target::Foreign(commands.raw, self.descriptors.clone());
        let profiler = self.spare.take().unwrap_or_default().again(queries);
        let retained = self.retained.clone();
        let mut recorder = Recorder::begin(target, inner.clone(), retained, profiler, label);
        recorder.barrier();
        Ok(recorder)
    }

    /// Ends a recording: makes all of its writes visible to the host and to later commands, and then signals the event.
    ///
    /// # Errors
    /// [`Error::Vulkan`] if the driver had no memory for more dispatches than the slot was made for. The
    /// command buffer must then be thrown away, and the recording [discarded](RecordSlot::discard).
    ///
    /// # Panics
    /// If the recording was begun in another slot.
    pub fn end(&mut self, mut recorder: Recorder) -> Result<()> {
        assert!(
            Arc::ptr_eq(&recorder.retained, &self.retained),
            "a recording ends in the slot that it was begun in"
        );
        let whole = recorder.check();
        let (commands, profiler) = recorder.finish_foreign();
        type Stage = vk::PipelineStageFlags2;
        type Accesses = vk::AccessFlags2;
        // All stages: the timestamps wait for all commands, including those that the host recorded before.
        let writes = vk::MemoryBarrier2::default()
            .src_stage_mask(Stage::ALL_COMMANDS)
            .src_access_mask(Accesses::SHADER_WRITE | Accesses::TRANSFER_WRITE)
            .dst_stage_mask(Stage::HOST | Stage::ALL_COMMANDS)
            .dst_access_mask(Accesses::HOST_READ | Accesses::MEMORY_READ | Accesses::MEMORY_WRITE);
        self.inner.barrier(commands, &vk::DependencyInfo::default().memory_barriers(&[writes]));
        // Events do not accept the host stage. The barrier before has already made the writes visible.
        let order = [vk::MemoryBarrier2::default()
            .src_stage_mask(Stage::ALL_COMMANDS)
            .dst_stage_mask(Stage::ALL_COMMANDS)];
        let order = vk::DependencyInfo::default().memory_barriers(&order);
        // SAFETY: recording state outside of a render pass; the event is this slot's and was reset.
        unsafe { self.inner.device.cmd_set_event2(commands, self.event, &order) }
        self.profiler = Some(profiler);
        whole
    }

    /// True if [`RecordSlot::times`] is complete. llvmpipe's queries wait for the whole device, so there this call waits
    /// too.
    pub(crate) fn has_times(&self) -> Result<bool> {
        let timed = |profiler: &Profiler| profiler.is_ready(&self.inner);
        Ok(self.finished()? && self.profiler.as_ref().map_or(Ok(true), timed)?)
    }

    /// Returns the time of each scope of the last recording. Empty before it has finished and the device has written the
    /// times, without timestamps, and at a second call.
    pub fn times(&mut self) -> Result<Vec<ScopeTime>> {
        let Some(mut profiler) = self.profiler.take() else { return Ok(Vec::new()) };
        if !(self.finished()? && profiler.is_ready(&self.inner)?) {
            self.profiler = Some(profiler);
            return Ok(Vec::new());
        }
        let collected = profiler.collect(&self.inner);
        self.spare = Some(profiler);
        Ok(collected?.scopes)
    }
}

impl Drop for RecordSlot {
    fn drop(&mut self) {
        // SAFETY: the adopter of the command buffer has promised that its execution has finished; null
        // handles are allowed.
        unsafe {
            self.inner.device.destroy_query_pool(self.queries, None);
            self.inner.device.destroy_event(self.event, None);
        }
    }
}

// Adopts buffers of a host.

impl Buffer {
    /// Adopts a range of a host's buffer.
    ///
    /// # Errors
    /// [`Error::Argument`] for a null handle, no bytes, an offset that is no multiple of 256 or a size that is no multiple
    /// of 4. Also if the context opened its own device and reads texels
    /// ([`ContextOptions::texels`](super::ContextOptions::texels)).
    ///
    /// # Safety
    /// - `raw` belongs to the context's device, is bound to memory and has at least `offset + bytes` bytes;
    /// - it has the usages STORAGE_BUFFER, TRANSFER_SRC and TRANSFER_DST, and UNIFORM_BUFFER if a kernel reads it as a
    ///   uniform block;
    /// - it lives until the last recording that uses it has finished, and the buffer and its clones are dropped;
    /// - no two adopted buffers overlap.
    pub unsafe fn adopt(
        context: &Context,
        name: &'static str,
        raw: vk::Buffer,
        offset: u64,
        bytes: u64,
    ) -> Result<Self> {
        context.device.check_adoption()?;
        let bad = |problem: String| Err(Error::argument(format!("buffer '{name}'"), problem));
        if raw == vk::Buffer::null() {
            return bad("the handle is null".into());
        }
        if bytes == 0 || !bytes.is_multiple_of(4) || !offset.is_multiple_of(PLACEMENT_ALIGNMENT) {
            return bad(format!("{bytes} bytes at {offset} are no range of words at a multiple of 256"));
        }
        let end = offset.saturating_add(bytes);
        Ok(Self::new(Arc::new(Block::foreign(&context.device, raw, end)), offset, bytes, name))
    }

    /// Returns the same range for another context on the same VkDevice; it keeps the memory alive. Both contexts then use
    /// one buffer, and the host orders the uses: within one queue they are in order, across queues by semaphores.
    ///
    /// # Errors
    /// [`Error::Argument`] for a context on another device, or whose queues are of another family than the one that owns
    /// the buffer. Also the errors of [`Buffer::adopt`].
    pub fn in_context(&self, context: &Context) -> Result<Self> {
        if self.belongs_to(context) {
            return Ok(self.clone());
        }
        let (own, other) = (&self.block().inner, &context.device);
        if own.device.handle() != other.device.handle() {
            return Err(self.refused("it belongs to another device"));
        }
        if own.queue_family != other.queue_family {
            return Err(self.refused(format!(
                "queue family {} owns it, the context's queues are of family {}: a context of that family needs one of its own",
                own.queue_family, other.queue_family
            )));
        }
        other.check_adoption()?;
        let block = Arc::new(Block::lent(other, self.block()));
        Ok(Self::new(block, self.offset(), self.bytes(), self.name()))
    }

    /// Splits the buffer into buffers of these names, sizes (bytes) and lives, placed by [`pack`].
    pub(crate) fn split(&self, requests: &[(&'static str, u64)], lives: &[Life]) -> Vec<Self> {
        let sizes: Vec<u64> = requests.iter().map(|(_, bytes)| *bytes).collect();
        let Ok(packing) = pack(&sizes, lives, u64::MAX) else { unreachable!("no size is above the largest") };
        let places = requests.iter().zip(packing.places);
        let parts = places.map(|(&(name, bytes), (_, offset))| {
            let part = self.range(offset, padded(bytes));
            Self::new(part.block().clone(), part.offset(), part.bytes(), name)
        });
        parts.collect()
    }

    /// True if it belongs to this context's device.
    pub fn belongs_to(&self, context: &Context) -> bool {
        self.block().is_of(&context.device)
    }
}

/// Recording state of a slot that belongs to a renderer or a trainer. It is not a `&mut RecordSlot`: a caller could swap
/// that for another slot, which does not track the frame in flight.
pub struct SlotRecording<'a>(&'a mut RecordSlot);

impl<'a> SlotRecording<'a> {
    pub(crate) fn new(slot: &'a mut RecordSlot) -> Self {
        Self(slot)
    }

    /// See [`RecordSlot::discard`].
    ///
    /// # Safety
    /// Same as [`RecordSlot::discard`].
    pub unsafe fn discard(&mut self) {
        // SAFETY: as promised.
        unsafe { self.0.discard() }
    }
}
