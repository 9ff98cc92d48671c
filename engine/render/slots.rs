//! Frames in flight. Their memory is planned and allocated in advance.

use super::frame_store::FrameCounts;
use super::reservation::{Reservation, SlotReport, field_name};
use crate::error::{Error, Result};
use crate::frame::{
    Blending, CUT_OUT_BYTES, FrameBuffers, FrameCapacity, FrameInputs, LaunchSizes, PictureCapacity,
    PlacedScene, RenderSettings, packed_bytes,
};
use crate::kernels::constants as c;
use crate::vk::{
    Buffer, Context, ForeignCommands, Life, MemoryKind, PLACEMENT_ALIGNMENT, RecordSlot, Recorder,
};

/// Bytes of a view's counts.
const STATE_BYTES: u64 = c::STATE_WORDS as u64 * 4;

/// One frame in flight.
pub(super) struct Slot {
    pub recording: RecordSlot,
    pub memory: SlotMemory,
    /// Memory reserved since the last recording.
    next: Option<SlotMemory>,
    readback: Buffer,
    /// Views of the last recording.
    views: u32,
    /// Report of the last recording, without what only the device knows.
    pub host_report: SlotReport,
    /// Whole report of the last recording, once it has been requested.
    report: Option<SlotReport>,
}

/// All frames in flight.
#[derive(Default)]
pub(super) struct Slots {
    pub reserved: Option<Reservation>,
    /// Form of blending whose kernels the last reservation has built.
    pub blending: Blending,
    pub slots: Vec<Slot>,
}

impl Slots {
    /// Returns an error while a frame is in flight.
    pub fn check_free(&self) -> Result<()> {
        for slot in &self.slots {
            if !slot.recording.finished()? {
                return Err(Error::argument("frame slots", "one is still in flight: wait for it first"));
            }
        }
        Ok(())
    }

    /// Allocates a reservation, which replaces the current one. No frame may be in flight.
    pub fn reserve(&mut self, layout: &SlotLayout<'_>) -> Result<()> {
        // The old memory is freed first: both at once might not fit.
        self.slots.clear();
        self.reserved = None;
        for memory in layout.allocate()? {
            self.slots.push(Slot::new(layout, memory)?);
        }
        self.reserved = Some(*layout.reservation);
        Ok(())
    }

    /// Returns an error for a reservation to which the current one cannot grow.
    pub fn check_growth(&self, reservation: &Reservation) -> Result<()> {
        let Some(reserved) = self.reserved else {
            let problem = "none are reserved that could grow: call Renderer::reserve";
            return Err(Error::argument("slots", problem));
        };
        let kept =
            [("slots", reservation.slots, reserved.slots), ("views", reservation.views, reserved.views)];
        match kept.into_iter().find(|(_, reservation, reserved)| reservation != reserved) {
            Some((field, reservation, reserved)) => {
                let problem =
                    format!("{field} is {reservation}, {reserved} are reserved: growth keeps their number");
                Err(Error::argument("reservation", problem))
            }
            None => Ok(()),
        }
    }

    /// Allocates another reservation with as many slots. Each slot switches to it with its next recording.
    pub fn grow(&mut self, layout: &SlotLayout<'_>) -> Result<()> {
        let memory = layout.allocate()?;
        for slot in &mut self.slots {
            slot.recording.reserve(layout.dispatches)?;
        }
        for (slot, memory) in self.slots.iter_mut().zip(memory) {
            slot.next = Some(memory);
        }
        self.reserved = Some(*layout.reservation);
        Ok(())
    }

    /// Returns the slot with an index.
    pub fn get(&mut self, index: u32) -> Result<&mut Slot> {
        let count = self.slots.len();
        self.slots.get_mut(index as usize).ok_or_else(|| {
            Error::argument("slot", format!("{index}: {count} are reserved; call Renderer::reserve"))
        })
    }
}

impl Slot {
    fn new(layout: &SlotLayout<'_>, memory: SlotMemory) -> Result<Self> {
        let request = [("state_readback", u64::from(layout.reservation.views) * STATE_BYTES)];
        let mut host = layout.context.allocate("frame slot host", &request, MemoryKind::HostVisible)?;
        let recording = RecordSlot::new(layout.context, layout.dispatches)?;
        let host_report = memory.report(0);
        Ok(Self {
            recording,
            memory,
            next: None,
            readback: host.remove(0),
            views: 0,
            host_report,
            report: None,
        })
    }

    /// Returns the memory of the next recording.
    pub fn upcoming(&self) -> &SlotMemory {
        self.next.as_ref().unwrap_or(&self.memory)
    }

    /// Switches to the memory reserved since the last recording, whose command buffer has finished.
    pub fn take_over(&mut self) {
        if let Some(next) = self.next.take() {
            self.memory = next;
        }
    }

    /// Begins a recording of `views` views with up to `gaussians` Gaussians.
    pub fn begin(&mut self, commands: ForeignCommands, gaussians: u32, views: u32) -> Result<Recorder> {
        let recorder = self.recording.begin(commands, "ashsplat")?;
        (self.views, self.host_report, self.report) = (views, self.memory.report(gaussians), None);
        Ok(recorder)
    }

    /// Returns the report of the last recording. None while it is in flight, or without a recording.
    pub fn report(&mut self, sizes: &LaunchSizes) -> Result<Option<SlotReport>> {
        if !self.recording.is_recorded() || !self.recording.finished()? {
            return Ok(None);
        }
        if self.report.is_some() || !self.recording.has_times()? {
            return Ok(self.report.clone());
        }
        self.report = Some(SlotReport { scopes: self.recording.times()?, ..self.counts(sizes, self.views)? });
        Ok(self.report.clone())
    }

    /// Records the copy of a view's counts to host-readable memory.
    pub fn record_counts(&self, recorder: &mut Recorder, view: u32) {
        let to = self.readback.range(u64::from(view) * STATE_BYTES, STATE_BYTES);
        recorder.copy(&self.memory.frame.state, &to);
    }

    /// Returns the counts of `views` finished views, the largest of each count.
    pub fn counts(&self, sizes: &LaunchSizes, views: u32) -> Result<SlotReport> {
        let mut report = SlotReport { entries_per_pass: sizes.entries_per_pass, ..self.host_report.clone() };
        for view in 0..views {
            let mut bytes = [0u8; STATE_BYTES as usize];
            self.readback.read(u64::from(view) * STATE_BYTES, &mut bytes)?;
            let view = FrameCounts::of(&bytes);
            report.visible = report.visible.max(view.visible);
            report.instances_needed = report.instances_needed.max(view.instances);
            report.longest_tile = report.longest_tile.max(view.longest_tile);
            report.overflow |= view.overflow;
        }
        report.blend_passes_needed = report.longest_tile.div_ceil(sizes.entries_per_pass).max(1);
        Ok(report)
    }
}

// Device memory of frames in flight.
//
// A frame begins with a barrier after all earlier commands of its queue. So scratch memory, used only within a frame,
// exists once for each queue, in any order of recording and submission. Memory used before or after the frame exists once
// for each slot: pixels that the host reads, staging memory that it writes, the counts.

type Requests = Vec<(&'static str, u64)>;

/// Memory with which the frames of a slot are recorded.
#[derive(Clone)]
pub(super) struct SlotMemory {
    pub frame: FrameBuffers,
    pub capacity: FrameCapacity,
    /// 1/z per pixel.
    pub depth_limits: Option<Buffer>,
    pub cut_outs: Option<Buffer>,
    pub staging: Option<Buffer>,
    /// True if the pixels of a frame stay until the slot is recorded again.
    pub keeps_pixels: bool,
    /// True if the inverse or expected depth stays too.
    pub keeps_depth: bool,
}

impl SlotMemory {
    /// Returns the inputs of a frame of some scenes in these buffers, without occluder and depth.
    pub fn inputs<'a>(
        &'a self,
        scenes: &'a [PlacedScene<'a>],
        settings: &'a RenderSettings,
    ) -> FrameInputs<'a> {
        let inputs = FrameInputs::new(scenes, &self.frame, &self.capacity, settings);
        FrameInputs { cut_outs: self.cut_outs.as_ref(), ..inputs }
    }

    /// Returns what the host knows about a recording with these buffers.
    fn report(&self, gaussians: u32) -> SlotReport {
        let FrameCapacity { instances: instance_capacity, blend_passes, .. } = self.capacity;
        SlotReport { gaussians, instance_capacity, blend_passes, ..SlotReport::default() }
    }
}

/// Requests of a reservation, in a host's block if there is one.
pub(super) struct SlotLayout<'a> {
    pub context: &'a Context,
    pub reservation: &'a Reservation,
    block: Option<&'a Buffer>,
    /// Most dispatches of a recording.
    pub dispatches: usize,
    capacity: FrameCapacity,
    /// Once for each queue: the frame's requests, then optional ones.
    scratch: Requests,
    scratch_lives: Vec<Life>,
    frame_requests: usize,
    /// For each slot but the first of its queue, whose pixels stay in the queue's scratch.
    pixels: Requests,
}

impl<'a> SlotLayout<'a> {
    /// Returns the errors of [`SlotLayout::allocate`] in advance, except a lack of memory.
    pub fn new(
        context: &'a Context,
        sizes: &LaunchSizes,
        reservation: &'a Reservation,
        block: Option<&'a Buffer>,
    ) -> Result<Self> {
        reservation.check()?;
        let capacity = reservation.capacity(context, sizes)?;
        let count = capacity.pictures.pixels;
        let mut pixels = Vec::new();
        if !reservation.images_only {
            pixels.push(("accumulated", count * 16));
            pixels.extend(reservation.keeps_depth().then_some(("depth_sums", count * 4)));
        }
        // Pixels that stay while another slot's frame runs share no memory.
        let stays =
            |name| reservation.slots > reservation.queues && pixels.iter().any(|(pixels, _)| *pixels == name);
        let scratch = scratch_requests(reservation, &capacity, sizes);
        debug_assert!(pixels.iter().all(|(name, _)| scratch.iter().any(|(own, _)| own == name)));
        let lives = scratch.iter().zip(FrameBuffers::LIVES);
        let scratch_lives =
            lives.map(|((name, _), life)| if stays(*name) { Life::ALWAYS } else { *life }).collect();
        let layout = Self {
            context,
            reservation,
            block,
            dispatches: reservation.dispatches(context, &capacity)?,
            capacity,
            scratch,
            scratch_lives,
            frame_requests: FrameBuffers::requests(&capacity, sizes).len(),
            pixels,
        };
        layout.check_bindings(sizes)?;
        block.map_or(Ok(()), |block| check_block(context, block, layout.block_bytes()))?;
        Ok(layout)
    }

    /// Refuses a buffer that kernels cannot bind, and names the field that makes it too large. Runs before any memory is
    /// freed.
    fn check_bindings(&self, sizes: &LaunchSizes) -> Result<()> {
        let Self { reservation, capacity, .. } = self;
        let limit = self.context.limits().max_storage_buffer_range;
        let too_large = |what: String, needed| {
            Err(Error::too_large(what, (needed, "bytes"), (limit, "maxStorageBufferRange")))
        };
        if reservation.staging_bytes > limit {
            return too_large(field_name("staging_bytes"), reservation.staging_bytes);
        }
        let Some(place) = self.scratch.iter().position(|(_, bytes)| *bytes > limit) else { return Ok(()) };
        let (name, needed) = self.scratch[place];
        if name == "cut_outs" {
            return too_large(field_name("cut_outs"), needed);
        }
        // Names the field that would shrink the buffer most at its smallest value.
        let pictures = PictureCapacity::of(1, 1).without_backward();
        let without = [
            ("width, height", FrameCapacity { pictures, ..*capacity }),
            ("instances", FrameCapacity { instances: 1, ..*capacity }),
            ("gaussians", FrameCapacity { gaussians: 1, visible: 1, ..*capacity }),
            ("scenes, views", FrameCapacity { scenes: 1, ..*capacity }),
        ];
        let bytes = |(_, less): &(_, FrameCapacity)| scratch_requests(reservation, less, sizes)[place].1;
        let field = without.iter().min_by_key(|less| bytes(less)).map_or("gaussians", |(field, _)| field);
        too_large(format!("{}: buffer '{name}'", field_name(field)), needed)
    }

    /// Returns the groups to allocate, in order, with the lives of their buffers.
    fn groups(&self) -> impl Iterator<Item = (&Requests, &[Life])> {
        let reservation = self.reservation;
        let queues = reservation.queues.min(reservation.slots);
        let own = if self.pixels.is_empty() { 0 } else { reservation.slots - queues };
        let scratch = std::iter::repeat_n((&self.scratch, &self.scratch_lives[..]), queues as usize);
        scratch.chain(std::iter::repeat_n((&self.pixels, &[][..]), own as usize))
    }

    /// Returns the bytes of a block for all groups.
    pub fn block_bytes(&self) -> u64 {
        self.groups().map(|(requests, lives)| group_bytes(requests, lives)).fold(0, u64::saturating_add)
    }

    /// Allocates the memory of all slots.
    pub fn allocate(&self) -> Result<Vec<SlotMemory>> {
        let Self { context, reservation, block, .. } = *self;
        let mut at = 0;
        let mut groups = Vec::new();
        for (requests, lives) in self.groups() {
            groups.push(match block {
                None => {
                    context.allocate_shared("frame slot", requests, lives, MemoryKind::Device)?.into_iter()
                }
                Some(block) => {
                    let bytes = group_bytes(requests, lives);
                    let group = block.range(at, bytes).split(requests, lives);
                    at += bytes;
                    group.into_iter()
                }
            });
        }
        let mut groups = groups.into_iter();
        let queues = reservation.queues.min(reservation.slots) as usize;
        let mut memory: Vec<SlotMemory> = Vec::new();
        for slot in 0..reservation.slots as usize {
            let mut own = if slot < queues {
                self.scratch_of(groups.next().unwrap_or_default())
            } else {
                let mut own = memory[slot % queues].clone();
                if !self.pixels.is_empty() {
                    let mut pixels = groups.next().unwrap_or_default();
                    own.frame.accumulated = pixels.next().unwrap_or(own.frame.accumulated);
                    own.frame.depth_sums = pixels.next().unwrap_or(own.frame.depth_sums);
                }
                own
            };
            if reservation.staging_bytes > 0 {
                let request = [("scene_updates", reservation.staging_bytes)];
                own.staging = context.allocate("frame slot host", &request, MemoryKind::HostVisible)?.pop();
            }
            memory.push(own);
        }
        Ok(memory)
    }

    /// Assigns the buffers of [`SlotLayout::scratch`].
    fn scratch_of(&self, mut buffers: std::vec::IntoIter<Buffer>) -> SlotMemory {
        let reservation = self.reservation;
        let frame = FrameBuffers::from_allocated(buffers.by_ref().take(self.frame_requests).collect());
        let mut next = |reserved: bool| reserved.then(|| buffers.next()).flatten();
        SlotMemory {
            frame,
            capacity: self.capacity,
            depth_limits: next(reservation.occlusion),
            cut_outs: next(reservation.cut_outs > 0),
            staging: None,
            keeps_pixels: !reservation.images_only,
            keeps_depth: reservation.keeps_depth(),
        }
    }
}

/// Returns the scratch requests of a frame of this capacity; those of [`FrameBuffers::requests`] come first.
fn scratch_requests(reservation: &Reservation, capacity: &FrameCapacity, sizes: &LaunchSizes) -> Requests {
    let pixels = capacity.pictures.pixels;
    let mut scratch = FrameBuffers::requests(capacity, sizes);
    scratch.extend(reservation.occlusion.then_some(("depth_limits", pixels * 4)));
    scratch.extend(
        (reservation.cut_outs > 0).then_some(("cut_outs", u64::from(reservation.cut_outs) * CUT_OUT_BYTES)),
    );
    scratch
}

/// Returns the bytes of a group in one block.
fn group_bytes(requests: &Requests, lives: &[Life]) -> u64 {
    packed_bytes(requests, lives).checked_next_multiple_of(PLACEMENT_ALIGNMENT).unwrap_or(u64::MAX)
}

fn check_block(context: &Context, block: &Buffer, needed: u64) -> Result<()> {
    let what = || format!("block '{}' for frame slots", block.name());
    if !block.belongs_to(context) {
        return Err(Error::argument(what(), "it belongs to another context"));
    }
    if !block.handle().1.is_multiple_of(PLACEMENT_ALIGNMENT) {
        let problem = format!("begins at byte {}, no multiple of {PLACEMENT_ALIGNMENT}", block.handle().1);
        return Err(Error::argument(what(), problem));
    }
    if block.bytes() < needed {
        return Err(Error::too_large(what(), (needed, "bytes"), (block.bytes(), "its size")));
    }
    Ok(())
}
