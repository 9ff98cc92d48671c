//! Frames in flight. Their memory is planned and allocated in advance.

use super::frame_store::State;
use super::reservation::Reservation;
use super::slot_memory::{Plan, SlotMemory};
use crate::error::{Error, Result};
use crate::kernels::constants as c;
use crate::plan::{FrameCapacity, LaunchSizes};
use crate::vk::{Buffer, Context, ForeignCommands, MemoryKind, RecordSlot, Recorder, ScopeTime};

/// Bytes of a view's counts.
const STATE_BYTES: u64 = c::STATE_WORDS as u64 * 4;

/// Counts of a recorded frame that has finished. For several views
/// ([`Renderer::record_views`](super::Renderer::record_views)), the largest of each count.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct SlotReport {
    /// Gaussians in the frame's scenes, without hidden scenes.
    pub gaussians: u32,
    /// Visible Gaussians. If views share a sort, those that any of them shows.
    pub visible: u32,
    /// (tile, Gaussian) instances that the picture needs.
    pub instances_needed: u32,
    /// Capacity in instances.
    pub instance_capacity: u32,
    /// Entries of the longest tile.
    pub longest_tile: u32,
    /// Passes of blending that the longest tile needs.
    pub blend_passes_needed: u32,
    /// Passes of blending with which the frame was recorded.
    pub blend_passes: u32,
    /// Entries of a tile that a pass of blending handles.
    pub entries_per_pass: u32,
    /// True if the frame needed more instances or passes of blending than it had. The picture then lacks the farthest
    /// Gaussians, or all of them if `instances_needed` is `u32::MAX`. [`Reservation::grown`] fixes the first case.
    pub overflow: bool,
    /// Number of depth sorts of the recording: one per view, or per run of views that share one
    /// ([`Reservation::shared_sort`]).
    pub sorts: u32,
    /// Scenes, of all views, that are drawn in batches, by shared dispatches (see
    /// [`DeviceScene::upload_all`](super::DeviceScene::upload_all)).
    pub batched_scenes: u32,
    /// Device time per stage, view by view; empty without timestamps. A recording of many views has only its first 255
    /// stages.
    pub scopes: Vec<ScopeTime>,
}

/// One frame in flight.
pub(super) struct Slot {
    pub record: RecordSlot,
    pub memory: SlotMemory,
    /// Memory reserved since the last recording.
    next: Option<SlotMemory>,
    readback: Buffer,
    /// Gaussians of the last recording.
    gaussians: u32,
    /// Views of the last recording.
    views: u32,
    /// Depth sorts of the last recording.
    pub sorts: u32,
    /// Scenes of the last recording drawn in batches.
    pub batched_scenes: u32,
    /// Capacity of the last recording.
    capacity: FrameCapacity,
    /// Report of the last recording, once it has been requested.
    report: Option<SlotReport>,
}

/// All frames in flight.
#[derive(Default)]
pub(super) struct Slots {
    pub reserved: Option<Reservation>,
    pub slots: Vec<Slot>,
}

impl Slots {
    /// Returns an error while a frame is in flight.
    pub fn check_free(&self) -> Result<()> {
        for slot in &self.slots {
            if !slot.record.finished()? {
                return Err(Error::argument("frame slots", "one is still in flight: wait for it first"));
            }
        }
        Ok(())
    }

    /// Allocates a reservation, which replaces the current one. No frame may be in flight.
    pub fn reserve(&mut self, plan: &Plan<'_>) -> Result<()> {
        // The old memory is freed first: both at once might not fit.
        self.slots.clear();
        self.reserved = None;
        let numbers = (plan.dispatches, plan.wanted.views);
        for memory in plan.allocate()? {
            self.slots.push(Slot::new(plan.context, memory, numbers)?);
        }
        self.reserved = Some(*plan.wanted);
        Ok(())
    }

    /// Returns an error for a reservation to which the current one cannot grow.
    pub fn check_growth(&self, wanted: &Reservation) -> Result<()> {
        let slots = self.slots.len();
        if slots == 0 {
            return Err(Error::argument(
                "slots",
                "none are reserved that could grow: call Renderer::reserve",
            ));
        }
        if wanted.slots as usize != slots {
            let problem =
                format!("slots is {}, {slots} are reserved: growth keeps their number", wanted.slots);
            return Err(Error::argument("reservation", problem));
        }
        let views = self.reserved.map_or(0, |reserved| reserved.views);
        if wanted.views != views {
            let problem =
                format!("views is {}, {views} are reserved: growth keeps their number", wanted.views);
            return Err(Error::argument("reservation", problem));
        }
        Ok(())
    }

    /// Allocates another reservation with as many slots. Each slot switches to it with its next recording.
    pub fn grow(&mut self, plan: &Plan<'_>) -> Result<()> {
        let memory = plan.allocate()?;
        for slot in &mut self.slots {
            slot.record.reserve(plan.dispatches)?;
        }
        for (slot, memory) in self.slots.iter_mut().zip(memory) {
            slot.next = Some(memory);
        }
        self.reserved = Some(*plan.wanted);
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
    fn new(context: &Context, memory: SlotMemory, (dispatches, views): (usize, u32)) -> Result<Self> {
        let host = [("state_readback", u64::from(views) * STATE_BYTES)];
        let mut host = context.allocate("frame slot host", &host, MemoryKind::HostVisible)?;
        let Some(readback) = host.pop() else { unreachable!("one buffer per request") };
        let record = RecordSlot::new(context, dispatches)?;
        let capacity = memory.capacity;
        Ok(Self {
            record,
            memory,
            next: None,
            readback,
            gaussians: 0,
            views: 0,
            sorts: 0,
            batched_scenes: 0,
            capacity,
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
    pub fn begin(&mut self, commands: ForeignCommands, (gaussians, views): (u32, u32)) -> Result<Recorder> {
        let recorder = self.record.begin(commands, "ashsplat")?;
        (self.gaussians, self.views, self.sorts) = (gaussians, views, 0);
        self.batched_scenes = 0;
        (self.capacity, self.report) = (self.memory.capacity, None);
        Ok(recorder)
    }

    /// Ends the recording.
    pub fn end(&mut self, recorder: Recorder) -> Result<()> {
        self.record.end(recorder)
    }

    /// Returns the report of the last recording. None while it is in flight, or without a recording.
    pub fn report(&mut self, sizes: &LaunchSizes) -> Result<Option<SlotReport>> {
        if !self.record.is_recorded() || !self.record.finished()? {
            return Ok(None);
        }
        if self.report.is_some() || !self.record.has_times()? {
            return Ok(self.report.clone());
        }
        self.report = Some(SlotReport { scopes: self.record.times()?, ..self.counts(sizes, self.views)? });
        Ok(self.report.clone())
    }

    /// Records the copy of a view's counts to host-readable memory.
    pub fn record_counts(&self, recorder: &mut Recorder, view: u32) {
        let to = self.readback.range(u64::from(view) * STATE_BYTES, STATE_BYTES);
        recorder.copy(&self.memory.frame.state, &to);
    }

    /// Returns the counts of `views` finished views, the largest of each count.
    pub fn counts(&self, sizes: &LaunchSizes, views: u32) -> Result<SlotReport> {
        let mut state = State::default();
        for view in 0..views {
            let mut bytes = [0u8; STATE_BYTES as usize];
            self.readback.read(u64::from(view) * STATE_BYTES, &mut bytes)?;
            let own = State::of(&bytes);
            state = State {
                visible: state.visible.max(own.visible),
                instances: state.instances.max(own.instances),
                longest_tile: state.longest_tile.max(own.longest_tile),
                overflow: state.overflow || own.overflow,
                ..state
            };
        }
        Ok(SlotReport {
            gaussians: self.gaussians,
            visible: state.visible,
            instances_needed: state.instances,
            instance_capacity: self.capacity.instances,
            longest_tile: state.longest_tile,
            blend_passes: self.capacity.blend_passes,
            entries_per_pass: sizes.entries_per_pass,
            blend_passes_needed: state.longest_tile.div_ceil(sizes.entries_per_pass).max(1),
            overflow: state.overflow,
            sorts: self.sorts,
            batched_scenes: self.batched_scenes,
            scopes: Vec::new(),
        })
    }
}
