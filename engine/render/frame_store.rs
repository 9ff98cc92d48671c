//! Buffers of a frame, and their growth.

use super::frame::BlendSamples;
use crate::error::{Error, Result};
use crate::frame::{
    FrameBuffers, FrameCapacity, FrameVariant, LaunchSizes, MIN_INSTANCES, MIN_VISIBLE, PictureCapacity,
    check_grids, initial_instances, initial_visible,
};
use crate::kernels::constants as c;
use crate::scene::Camera;
use crate::vk::{Buffer, Context, Life, MemoryKind, Recorder};

/// Buffers of a frame, which grow on demand. Allocations fail when the memory or a limit of the device does not suffice,
/// before any work; the next frame then allocates the previous capacity.
pub struct FrameStore {
    context: Context,
    sizes: LaunchSizes,
    readback: Buffer,
    /// Pictures, absolute gradients and memory between steps that a training's frames need.
    expected: FrameCapacity,
    /// Requests of the scratch of a training's loss.
    loss_scratch: Vec<(&'static str, u64)>,
    /// Capacity that the last frame requested. Earlier frames may have needed more.
    requested: FrameCapacity,
    capacity: FrameCapacity,
    frame: Option<FrameMemory>,
}

/// Buffers in the memory of a frame.
#[derive(Clone)]
pub struct FrameMemory {
    /// Buffers of the frame's passes.
    pub buffers: FrameBuffers,
    /// See [`FrameInputs::loss_scratch`](crate::frame::FrameInputs::loss_scratch).
    pub loss_scratch: Vec<Buffer>,
}

/// Counts that a frame reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameCounts {
    /// Visible Gaussians that the frame stores.
    pub visible: u32,
    /// Visible Gaussians that the frame needs. More than its capacity if it overflowed.
    pub visible_needed: u32,
    /// Instances that the frame needs. More than its capacity if it overflowed. If visible Gaussians overflowed, counts
    /// only the instances of the stored ones.
    pub instances: u32,
    /// Entries of the longest tile.
    pub longest_tile: u32,
    /// Gaussians whose gradient was not finite.
    pub non_finite: u32,
    /// True if a capacity was too small, which makes the frame invalid.
    pub overflow: bool,
    /// Samples of the blending kernels, if counted.
    pub samples: BlendSamples,
}

impl FrameCounts {
    /// Returns the instances of all visible Gaussians. An estimate if visible Gaussians overflowed.
    pub fn all_instances(&self) -> u32 {
        let all = u64::from(self.instances) * u64::from(self.visible_needed.max(self.visible))
            / u64::from(self.visible.max(1));
        all.max(self.instances.into()).min(u32::MAX.into()) as u32
    }

    /// Decodes the device's words.
    pub fn of(bytes: &[u8; c::STATE_WORDS as usize * 4]) -> Self {
        let words: Vec<u32> = bytemuck::pod_collect_to_vec(bytes);
        let word = |index: u32| words[index as usize];
        Self {
            visible: word(c::STATE_VISIBLE),
            visible_needed: word(c::STATE_VISIBLE_NEEDED),
            instances: word(c::STATE_INSTANCES_NEEDED),
            longest_tile: word(c::STATE_LONGEST_TILE),
            non_finite: word(c::STATE_NON_FINITE),
            overflow: word(c::STATE_OVERFLOW) != 0,
            samples: BlendSamples {
                forward: u64::from(word(c::STATE_BLEND_HITS)) * 32,
                backward: u64::from(word(c::STATE_BLEND_BACKWARD_HITS)) * 32,
            },
        }
    }
}

impl FrameStore {
    /// Buffer through which the counts are read back.
    pub const READBACK: [(&str, u64); 1] = [("state_readback", c::STATE_WORDS as u64 * 4)];

    /// Creates a store that has only the readback buffer.
    pub fn new(context: &Context) -> Result<Self> {
        let readback = context.allocate("readback", &Self::READBACK, MemoryKind::HostVisible)?.remove(0);
        Ok(Self {
            context: context.clone(),
            sizes: LaunchSizes::new(context.limits()),
            readback,
            // Any frame of a renderer may get the gradient of its camera.
            expected: FrameCapacity { camera_sums: true, ..FrameCapacity::default() },
            loss_scratch: Vec::new(),
            requested: FrameCapacity::default(),
            capacity: FrameCapacity::default(),
            frame: None,
        })
    }

    /// Makes later allocations large enough for a training's frames, before they come: their pictures, sums of gradients,
    /// scratch of the loss, and memory between steps.
    pub fn expect(&mut self, shape: FrameCapacity, loss_scratch: Vec<(&'static str, u64)>) {
        (self.expected, self.loss_scratch) = (shape, loss_scratch);
    }

    /// Returns buffers for these numbers of Gaussians and scenes, a camera and a variant. Reallocates them if the current ones are
    /// too small. If they then do not fit beside the needs of earlier frames, drops those needs. The first buffers have
    /// estimated numbers of visible Gaussians and instances, or a part of them if memory is short.
    pub fn ensure(
        &mut self,
        gaussians: u32,
        scenes: u32,
        camera: &Camera,
        variant: FrameVariant,
    ) -> Result<(FrameMemory, FrameCapacity)> {
        let FrameVariant { backward, outputs, inverse_depth: depth, last_entries, .. } = variant;
        let picture = PictureCapacity::of_cameras([camera]);
        let all_pictures = picture.and(self.expected.pictures);
        let pictures = if backward { all_pictures } else { all_pictures.without_backward() };
        let visible = initial_visible(gaussians);
        let requested = FrameCapacity {
            gaussians,
            visible,
            scenes,
            instances: initial_instances(self.context.limits(), visible, &pictures),
            pictures,
            backward,
            absolute: backward && self.expected.absolute,
            camera_sums: backward && self.expected.camera_sums,
            depth,
            last_entries,
            trained: self.expected.trained,
            outputs,
            ..FrameCapacity::default()
        };
        self.requested = requested;
        let current = self.capacity;
        // Counts of earlier frames replace the estimates.
        let count = |counted: u32, estimate: u32| if counted > 0 { counted } else { estimate };
        let gaussians = gaussians.max(current.gaussians);
        let capacity = FrameCapacity {
            gaussians,
            visible: count(current.visible.min(gaussians), visible),
            instances: count(current.instances, requested.instances),
            scenes: scenes.max(current.scenes),
            pictures: pictures.and(current.pictures),
            blend_passes: current.blend_passes,
            backward: backward || current.backward,
            absolute: requested.absolute || current.absolute,
            camera_sums: requested.camera_sums || current.camera_sums,
            depth: depth || current.depth,
            last_entries: last_entries || current.last_entries,
            trained: requested.trained,
            outputs: outputs.and(current.outputs),
        };
        if let Some(frame) = self.frame.as_ref().filter(|_| capacity == current) {
            return Ok((frame.clone(), current));
        }
        // The estimates may be what does not fit, and the frame may need less. If it needs more, it overflows.
        let smaller = |capacity: &FrameCapacity| {
            let FrameCapacity { visible, instances, .. } = *capacity;
            (visible > MIN_VISIBLE || instances > MIN_INSTANCES).then(|| FrameCapacity {
                visible: (visible / 4).max(visible.min(MIN_VISIBLE)),
                instances: (instances / 4).max(MIN_INSTANCES),
                ..*capacity
            })
        };
        let others = std::iter::successors(Some(requested), smaller).skip((capacity == requested).into());
        let allocated = self.allocate_first(capacity, others).map_err(|error| {
            let others =
                if all_pictures == picture { "" } else { ", and those larger ones that will follow" };
            error.of_field(format!("an image of {}x{} pixels{others}", camera.width, camera.height))
        });
        Ok((allocated?, self.capacity))
    }

    /// Returns the capacities of the frame's buffers.
    pub fn capacity(&self) -> FrameCapacity {
        self.capacity
    }

    /// Allocates the first of some capacities for which the memory suffices.
    fn allocate_first(
        &mut self,
        first: FrameCapacity,
        others: impl IntoIterator<Item = FrameCapacity>,
    ) -> Result<FrameMemory> {
        let mut allocated = self.allocate(first);
        for capacity in others {
            match &allocated {
                Err(error) if is_memory(error) => allocated = self.allocate(capacity),
                _ => break,
            }
        }
        allocated
    }

    /// Requests of the buffers for a capacity, and their lives.
    fn requests(&self, capacity: &FrameCapacity) -> (Vec<(&'static str, u64)>, Vec<Life>) {
        FrameBuffers::requests_with(capacity, &self.sizes, &self.loss_scratch)
    }

    fn allocate(&mut self, capacity: FrameCapacity) -> Result<FrameMemory> {
        check_grids(self.context.limits(), &capacity, &self.sizes)?;
        // The old buffers are freed first: both sets at once might not fit.
        self.frame = None;
        let (requests, lives) = self.requests(&capacity);
        let mut buffers = self.context.allocate_shared("frame", &requests, &lives, MemoryKind::Device)?;
        let loss_scratch = buffers.split_off(buffers.len() - self.loss_scratch.len());
        let frame = FrameMemory { buffers: FrameBuffers::from_allocated(buffers), loss_scratch };
        self.capacity = capacity;
        self.frame = Some(frame.clone());
        Ok(frame)
    }

    /// Grows the capacity for more Gaussians, ahead of the frames that will need it.
    pub fn reserve_gaussians(&mut self, gaussians: u32) -> Result<()> {
        if self.frame.is_none() || gaussians <= self.capacity.gaussians {
            return Ok(());
        }
        self.allocate(FrameCapacity { gaussians, ..self.capacity }).map(drop)
    }

    /// Allocates the capacity of an earlier run.
    pub fn restore(&mut self, capacity: FrameCapacity) -> Result<()> {
        self.requested = capacity;
        self.allocate(capacity).map(drop)
    }

    /// Allocates the expected capacity. If the memory or the device's limits do not suffice, the next frame allocates only
    /// what it needs.
    pub fn restore_if_it_fits(&mut self, capacity: FrameCapacity) -> Result<()> {
        match self.restore(capacity) {
            Err(error) if is_memory(&error) => {
                self.forget();
                Ok(())
            }
            restored => restored,
        }
    }

    /// Frees the buffers. The next frame allocates the same capacity again.
    pub fn release(&mut self) {
        self.frame = None;
    }

    /// Frees the buffers and resets the capacity. The next frame allocates only what it needs.
    pub fn forget(&mut self) {
        self.frame = None;
        self.capacity = FrameCapacity::default();
    }

    /// Bytes of the frame's buffers with the current capacity.
    pub fn bytes(&self) -> u64 {
        self.frame.as_ref().map_or(0, |_| self.bytes_of(&self.capacity))
    }

    /// Bytes of the buffers of a frame with this capacity.
    pub fn bytes_of(&self, capacity: &FrameCapacity) -> u64 {
        let (requests, lives) = self.requests(capacity);
        self.context.shared_bytes(&requests, &lives)
    }

    /// Sets the capacity in instances, and forces a new allocation at the next frame.
    pub fn set_instances(&mut self, instances: u32) {
        self.capacity.instances = instances.max(1);
        self.frame = None;
    }

    /// Raises the capacity to at least these numbers of visible Gaussians and of instances.
    pub fn set_at_least(&mut self, visible: u32, instances: u32) {
        let minimum = FrameCapacity {
            visible: visible.max(self.capacity.visible),
            instances: instances.max(self.capacity.instances),
            ..self.capacity
        };
        if minimum != self.capacity {
            self.capacity = minimum;
            self.frame = None;
        }
    }

    /// Returns the buffers of the last frame.
    pub fn current(&self) -> Result<&FrameBuffers> {
        Ok(&self.memory()?.buffers)
    }

    /// Same as [`FrameStore::current`], with the scratch of the loss.
    pub fn memory(&self) -> Result<&FrameMemory> {
        self.frame.as_ref().ok_or_else(|| Error::argument("frame", "none was rendered yet"))
    }

    /// Records the copy of the frame's counts to host-readable memory.
    pub fn record_readback(&self, r: &mut Recorder, frame: &FrameBuffers) {
        r.barrier();
        r.copy(&frame.state, &self.readback);
    }

    /// Returns the counts, after the frame has finished.
    pub fn counts(&self) -> Result<FrameCounts> {
        let mut bytes = [0u8; c::STATE_WORDS as usize * 4];
        self.readback.read(0, &mut bytes)?;
        Ok(FrameCounts::of(&bytes))
    }

    /// Grows the capacity if the frame overflowed. Returns true if the frame has to be run again.
    pub fn grow(&mut self, counts: &FrameCounts) -> Result<bool> {
        let (FrameCounts { visible_needed, instances, .. }, current) = (*counts, self.capacity);
        let blend_passes = counts.longest_tile.div_ceil(self.sizes.entries_per_pass).max(1);
        let exact = FrameCapacity {
            visible: visible_needed.max(current.visible),
            instances: instances.max(current.instances),
            blend_passes: blend_passes.max(current.blend_passes),
            ..current
        };
        if exact == current {
            return Ok(false);
        }
        let (more_visible, more_instances) =
            (visible_needed > current.visible, instances > current.instances);
        // Reserves, because later frames will need other numbers. They may be what does not fit.
        let mut ample = exact;
        if more_visible {
            let reserve = visible_needed.saturating_add(visible_needed / 4);
            ample.visible = reserve.min(current.gaussians).max(visible_needed);
        }
        if more_instances {
            ample.instances = instances.saturating_add(instances / 2);
        }
        // Needs of this frame without those of earlier ones.
        let (visible, instances) = (visible_needed.max(1), instances.max(1));
        let this_frame = FrameCapacity { visible, instances, blend_passes, ..self.requested };
        let others = [exact, this_frame].into_iter().filter(|other| *other != ample);
        let allocated = self.allocate_first(ample, others);
        let instances = format!("{instances} (tile, Gaussian) instances (a smaller image has fewer)");
        let visible = format!("a frame of {visible_needed} visible Gaussians");
        let named = match (more_visible, more_instances) {
            (true, true) => Some(format!("{visible} and more than {instances}")),
            (true, false) => Some(visible),
            (false, true) => Some(format!("a frame of {instances}")),
            (false, false) => None,
        };
        allocated.map(|_| true).map_err(|error| named.into_iter().fold(error, Error::of_field))
    }
}

/// True if an allocation failed for lack of memory.
fn is_memory(error: &Error) -> bool {
    matches!(error, Error::TooLarge { .. } | Error::Vulkan { call: "vkAllocateMemory", .. })
}
