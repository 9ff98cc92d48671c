//! Device memory of frames in flight.
//!
//! A frame begins with a barrier after all earlier commands of its queue. So scratch memory, used only within a frame,
//! exists once for each queue, in any order of recording and submission. Memory used before or after the frame exists once
//! for each slot: pixels that the host reads, staging memory that it writes, the counts.

use super::reservation::{Reservation, field_name};
use crate::error::{Error, Result};
use crate::forward::{Auxiliary, CUT_OUT_BYTES, MotionBuffers, PickBuffers};
use crate::plan::{FrameBuffers, FrameCapacity, LaunchSizes, PictureCapacity, frame_requests};
use crate::vk::{Buffer, Context, MemoryKind, PLACEMENT_ALIGNMENT, pack};

type Requests = Vec<(&'static str, u64)>;

/// Memory with which the frames of a slot are recorded.
#[derive(Clone)]
pub(super) struct SlotMemory {
    pub frame: FrameBuffers,
    pub capacity: FrameCapacity,
    /// 1/z per pixel.
    pub depth_limits: Option<Buffer>,
    pub cut_outs: Option<Buffer>,
    /// Per pixel, and per scene: see [`PickBuffers`].
    picks: Option<[Buffer; 2]>,
    /// Per visible Gaussian, and per pixel: see [`MotionBuffers`].
    motion: Option<[Buffer; 2]>,
    pub staging: Option<Buffer>,
    /// True if the pixels of a frame stay until the slot is recorded again.
    pub keeps_pixels: bool,
    /// True if the inverse or expected depth stays too.
    pub keeps_depth: bool,
}

impl SlotMemory {
    /// Returns the buffers of picks and of motion, if the frame writes them.
    pub fn auxiliary(&self, [pick, motion]: [bool; 2]) -> Auxiliary<'_> {
        let picks = self.picks.as_ref().filter(|_| pick);
        let motion = self.motion.as_ref().filter(|_| motion);
        Auxiliary {
            picks: picks.map(|[picks, scene_firsts]| PickBuffers { picks, scene_firsts }),
            motion: motion.map(|[motions, sums]| MotionBuffers { motions, sums }),
        }
    }
}

/// Requests of a reservation, in a host's block if there is one.
pub(super) struct Plan<'a> {
    pub context: &'a Context,
    pub wanted: &'a Reservation,
    block: Option<&'a Buffer>,
    /// Most dispatches of a recording.
    pub dispatches: usize,
    capacity: FrameCapacity,
    /// Once for each queue: the frame's requests, then optional ones.
    scratch: Requests,
    /// Number of the optional ones.
    extra: usize,
    /// For each slot except the first of a queue, which keeps its pixels in the scratch.
    pixels: Requests,
    /// True if they include a depth.
    has_depth: bool,
}

impl<'a> Plan<'a> {
    /// Returns the errors of [`Plan::allocate`] in advance, except a lack of memory.
    pub fn new(
        context: &'a Context,
        sizes: &LaunchSizes,
        wanted: &'a Reservation,
        block: Option<&'a Buffer>,
    ) -> Result<Self> {
        wanted.check()?;
        let capacity = wanted.capacity(context, sizes)?;
        let dispatches = wanted.dispatches(context, &capacity)?;
        let scratch = scratch_requests(wanted, &capacity, sizes);
        check_bindings(context, &scratch, (wanted, &capacity), sizes)?;
        let frame = frame_requests(&capacity, sizes).len();
        let pixels = capacity.pictures.pixels;
        let has_depth = !wanted.images_only && (wanted.inverse_depth || wanted.expected_depth);
        let mut own = Vec::new();
        if !wanted.images_only {
            own.push(("accumulated", pixels * 16));
            own.extend(has_depth.then_some(("inverse_depth", pixels * 4)));
        }
        let extra = scratch.len() - frame;
        let plan =
            Self { context, wanted, block, dispatches, capacity, scratch, extra, pixels: own, has_depth };
        block.map_or(Ok(()), |block| check_block(context, block, plan.block_bytes()))?;
        Ok(plan)
    }

    /// Returns the groups to allocate, in order.
    fn groups(&self) -> impl Iterator<Item = &Requests> {
        let wanted = self.wanted;
        let queues = wanted.queues.min(wanted.slots);
        let own = if self.pixels.is_empty() { 0 } else { wanted.slots - queues };
        let scratch = std::iter::repeat_n(&self.scratch, queues as usize);
        scratch.chain(std::iter::repeat_n(&self.pixels, own as usize))
    }

    /// Returns the bytes of a block for all groups.
    pub fn block_bytes(&self) -> u64 {
        self.groups().map(group_bytes).fold(0, u64::saturating_add)
    }

    /// Allocates the memory of all slots.
    pub fn allocate(&self) -> Result<Vec<SlotMemory>> {
        let Self { context, wanted, block, .. } = *self;
        let mut at = 0;
        let mut groups = Vec::new();
        for requests in self.groups() {
            groups.push(match block {
                None => context.allocate("frame slot", requests, MemoryKind::Device)?.into_iter(),
                Some(block) => {
                    let bytes = group_bytes(requests);
                    let group = block.range(at, bytes).split(requests);
                    at += bytes;
                    group.into_iter()
                }
            });
        }
        let mut groups = groups.into_iter();
        let queues = wanted.queues.min(wanted.slots) as usize;
        let mut memory: Vec<SlotMemory> = Vec::new();
        for slot in 0..wanted.slots as usize {
            let mut own = match memory.get(slot % queues) {
                Some(shared) if slot >= queues => shared.clone(),
                _ => {
                    let mut scratch = groups.next().unwrap_or_default();
                    let own = scratch.len() - self.extra;
                    let frame = FrameBuffers::from_allocated(scratch.by_ref().take(own).collect());
                    let mut next = |reserved: bool| reserved.then(|| scratch.next()).flatten();
                    let (depth_limits, cut_outs) = (next(wanted.occlusion), next(wanted.cut_outs > 0));
                    let picks = next(wanted.pick).zip(next(wanted.pick)).map(<[_; 2]>::from);
                    let motion = next(wanted.motion).zip(next(wanted.motion)).map(<[_; 2]>::from);
                    let capacity = self.capacity;
                    let keeps_pixels = !wanted.images_only;
                    let keeps_depth = self.has_depth;
                    SlotMemory {
                        frame,
                        capacity,
                        depth_limits,
                        cut_outs,
                        picks,
                        motion,
                        staging: None,
                        keeps_pixels,
                        keeps_depth,
                    }
                }
            };
            if slot >= queues && !self.pixels.is_empty() {
                let mut pixels = groups.next().unwrap_or_default();
                if let Some(accumulated) = pixels.next() {
                    own.frame.accumulated = accumulated;
                }
                if let Some(inverse_depth) = pixels.next() {
                    own.frame.inverse_depth = inverse_depth;
                }
            }
            if wanted.staging_bytes > 0 {
                let request = [("scene_updates", wanted.staging_bytes)];
                own.staging = context.allocate("frame slot host", &request, MemoryKind::HostVisible)?.pop();
            }
            memory.push(own);
        }
        Ok(memory)
    }
}

/// Returns the scratch requests of a frame of this capacity; those of [`frame_requests`] come first.
fn scratch_requests(wanted: &Reservation, capacity: &FrameCapacity, sizes: &LaunchSizes) -> Requests {
    let pixels = capacity.pictures.pixels;
    let mut scratch = frame_requests(capacity, sizes);
    scratch.extend(wanted.occlusion.then_some(("depth_limits", pixels * 4)));
    scratch.extend((wanted.cut_outs > 0).then_some(("cut_outs", u64::from(wanted.cut_outs) * CUT_OUT_BYTES)));
    if wanted.pick {
        scratch.extend([("picks", pixels * 8), ("scene_firsts", u64::from(capacity.scenes) * 4)]);
    }
    if wanted.motion {
        scratch.extend([("motions", u64::from(capacity.visible) * 8), ("motion_sums", pixels * 8)]);
    }
    scratch
}

/// Refuses a buffer that kernels cannot bind, and names the field that makes it too large. Runs before any memory is freed.
fn check_bindings(
    context: &Context,
    requests: &Requests,
    (wanted, capacity): (&Reservation, &FrameCapacity),
    sizes: &LaunchSizes,
) -> Result<()> {
    let limit = context.limits().max_storage_buffer_range;
    let too_large = |field: String, needed| {
        Err(Error::TooLarge {
            what: field,
            needed,
            unit: "bytes",
            limit,
            limit_name: "maxStorageBufferRange",
        })
    };
    if wanted.staging_bytes > limit {
        return too_large(field_name("staging_bytes"), wanted.staging_bytes);
    }
    let Some(place) = requests.iter().position(|(_, bytes)| *bytes > limit) else { return Ok(()) };
    let (name, needed) = requests[place];
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
    let bytes = |(_, less): &(_, FrameCapacity)| scratch_requests(wanted, less, sizes)[place].1;
    let field = without.iter().min_by_key(|less| bytes(less)).map_or("gaussians", |(field, _)| field);
    too_large(format!("{}: buffer '{name}'", field_name(field)), needed)
}

/// Returns the bytes of a group in one block.
fn group_bytes(requests: &Requests) -> u64 {
    let sizes: Vec<u64> = requests.iter().map(|(_, bytes)| *bytes).collect();
    let bytes: u64 = pack(&sizes, u64::MAX).map_or(u64::MAX, |packing| packing.blocks.iter().sum());
    bytes.checked_next_multiple_of(PLACEMENT_ALIGNMENT).unwrap_or(u64::MAX)
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
        let (limit, limit_name) = (block.bytes(), "its size");
        return Err(Error::TooLarge { what: what(), needed, unit: "bytes", limit, limit_name });
    }
    Ok(())
}
