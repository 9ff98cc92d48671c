//! Recording a frame into a host's command buffer: nothing is submitted, waited for, allocated, mapped or read back.

use super::Renderer;
use super::check::check_capacity;
use super::device_scene::DeviceScene;
use super::slots::{Reservation, Slot, SlotReport};
use super::updates::{Update, record_copies, stage_updates};
use crate::compose::{Background, Compose, Region};
use crate::error::{Error, Result};
use crate::forward::{FrameInputs, PlacedScene, RenderSettings};
use crate::scene::{Camera, DepthMapping, Pose};
use crate::vk::{Buffer, ForeignCommands, Image, ImageState, Recorder};
use ash::vk;

/// A scene and where it stands.
#[derive(Clone, Copy)]
pub struct Placed<'a> {
    /// The scene.
    pub scene: &'a DeviceScene,
    /// Where it stands in the world.
    pub pose: Pose,
}

impl<'a> From<&'a DeviceScene> for Placed<'a> {
    fn from(scene: &'a DeviceScene) -> Self {
        Self { scene, pose: Pose::IDENTITY }
    }
}

/// A host's image, how the host has used it, and which part of it is the frame.
#[derive(Clone, Copy)]
pub struct HostImage<'a> {
    /// The image.
    pub image: &'a Image,
    /// What the host does with it before the frame: waited for, and its layout is changed from this one. From
    /// [`ImageState::UNDEFINED`] nothing that it holds is kept.
    pub from: ImageState,
    /// Its texel that is the frame's pixel (0, 0).
    pub offset: [u32; 2],
}

/// Where the colours go.
#[derive(Clone, Copy)]
pub enum Target<'a> {
    /// Into the slot's own buffer, [`Renderer::slot_pixels`]: per pixel, row by row, premultiplied r, g, b and the
    /// transmittance, each an f32. The host uses it behind the recording, after a barrier from [`Release::stages`] and
    /// [`Release::accesses`], until the slot is recorded again. The recording waits for compute and transfers that have
    /// read it; a host that reads it in other stages, in a command buffer behind the frame's, waits for those before.
    Slot,
    /// Into a storage image of format rgba8, rgba16f or rgba32f.
    Image {
        /// The image.
        to: HostImage<'a>,
        /// What lies behind the splats.
        behind: Background,
    },
}

/// A host's depth image: splats behind it are hidden.
#[derive(Clone, Copy)]
pub struct Occluder<'a> {
    /// The depth image, for sampling.
    pub depth: HostImage<'a>,
    /// How to read it: [`crate::scene::HostView::camera`].
    pub mapping: DepthMapping,
}

/// An image of expected depth: sum(w z) / sum(w), world units.
#[derive(Clone, Copy)]
pub struct DepthTarget<'a> {
    /// A storage image of format r32f.
    pub to: HostImage<'a>,
    /// Where the weights sum to less, the pixel is empty.
    pub min_weight: f32,
    /// The depth of empty pixels.
    pub empty: f32,
}

/// A frame to record.
#[derive(Clone, Copy)]
pub struct RecordedFrame<'a> {
    /// The scenes: one at least, sorted together.
    pub scenes: &'a [Placed<'a>],
    /// The camera; its width and height are the frame's.
    pub camera: &'a Camera,
    /// How to render; the background is the target's.
    pub settings: &'a RenderSettings,
    /// Where the colours go.
    pub target: Target<'a>,
    /// What hides the splats behind it.
    pub occluder: Option<Occluder<'a>>,
    /// Where the expected depth goes.
    pub depth: Option<DepthTarget<'a>>,
    /// What changes before.
    pub updates: &'a [Update<'a>],
}

impl<'a> RecordedFrame<'a> {
    /// A frame of scenes in the slot's own buffer.
    pub fn new(scenes: &'a [Placed<'a>], camera: &'a Camera, settings: &'a RenderSettings) -> Self {
        let target = Target::Slot;
        Self { scenes, camera, settings, target, occluder: None, depth: None, updates: &[] }
    }
}

/// What a recording leaves behind: whoever uses its results next waits for these stages and accesses, and finds the
/// images in these layouts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Release {
    /// The stages that write results: also those in the slot's own buffers.
    pub stages: vk::PipelineStageFlags2,
    /// What they write with.
    pub accesses: vk::AccessFlags2,
    /// How the target image was used last.
    pub color: Option<ImageState>,
    /// How the host's depth image was used last.
    pub occluder: Option<ImageState>,
    /// How the image of expected depth was used last.
    pub depth: Option<ImageState>,
}

impl Renderer {
    /// Allocates frame slots and builds all kernels that frames of this kind need, in place of those before, whose command
    /// buffers have to be over ([`Context::adopt_commands`](crate::vk::Context::adopt_commands)). Submits nothing and waits
    /// for nothing.
    ///
    /// # Errors
    /// [`Error::Argument`] for a reservation that makes no sense or while a slot is in flight, [`Error::TooLarge`] for
    /// what the device cannot hold; memory or device failures. When memory fails, nothing is reserved any more.
    pub fn reserve(&mut self, wanted: &Reservation) -> Result<()> {
        if self.compose.is_none() {
            self.compose = Some(Compose::new(&self.context)?);
        }
        let forward = &mut self.runner.forward;
        for variant in wanted.variants() {
            for sh_degree in 0..=wanted.sh_degree.min(3) {
                forward.prepare_variant(sh_degree, variant)?;
            }
        }
        self.slots.reserve(&self.context, &forward.sizes, wanted)
    }

    /// Records a frame into a host's command buffer.
    ///
    /// It only records: it neither submits nor waits, allocates or maps device memory, or reads anything back.
    /// Everything is checked before the first command is recorded. Afterwards the slot is in flight until the device
    /// has executed the recording; it may be recorded again once the whole command buffer is over, as
    /// [`Context::adopt_commands`](crate::vk::Context::adopt_commands) has it. The slot keeps scenes and views of images
    /// alive that are dropped meanwhile; the next recording destroys them, if [`Renderer::release_slot`] has not.
    ///
    /// Updates are made in their order: of two that overlap, the later one counts.
    ///
    /// Before its first command the recording waits for compute and transfers that come earlier in the queue, and for
    /// what each [`HostImage::from`] says.
    ///
    /// # Errors
    /// [`Error::Argument`] for a slot that is not reserved or still in flight, commands, scenes or images of another
    /// device, a camera or a pose that makes no sense, images of the wrong format, use, size or layout, numbers that are
    /// not finite, and kernels that [`Renderer::reserve`] has not built;
    /// [`Error::TooLarge`] for what the reservation has no room for.
    pub fn record(
        &mut self,
        commands: ForeignCommands,
        slot: u32,
        frame: &RecordedFrame<'_>,
    ) -> Result<Release> {
        let Some(reserved) = self.slots.reserved else {
            return Err(Error::argument("frame slot", "none is reserved: call Renderer::reserve"));
        };
        if !commands.belongs_to(&self.context) {
            return Err(Error::argument("command buffer", "it belongs to another device"));
        }
        self.check_frame(frame, &reserved)?;
        let forward = &self.runner.forward;
        let slot = self.slots.get(slot)?;
        slot.record.check_free()?;
        check_capacity(frame, &slot.capacity, forward.sizes.elementwise_workgroup)?;
        let Some(compose) = &self.compose else { unreachable!("built by reserve") };
        let [main, others] = place(frame, forward.sizes.elementwise_workgroup);
        let Some(first) = main.first() else { unreachable!("checked") };
        let settings = RenderSettings {
            inverse_depth: frame.settings.inverse_depth || frame.depth.is_some(),
            ..*frame.settings
        };
        let copies = stage_updates(slot.staging.as_ref(), frame.updates)?;
        let gaussians = frame.scenes.iter().map(|s| s.scene.count()).sum();
        let mut recorder = slot.begin(commands, gaussians)?;
        let r = &mut recorder;
        record_copies(r, &copies);
        let size = [frame.camera.width, frame.camera.height];
        let mut occluder = None;
        if let (Some(o), Some(limits)) = (&frame.occluder, &slot.depth_limits) {
            occluder = Some(r.acquire_image(o.depth.image, o.depth.from));
            r.scope("depth limits", |r| {
                compose.record_depth_limits(r, o.depth.region(), o.mapping, size, limits);
            });
        }
        let inputs = FrameInputs {
            scene: first.scene,
            frame: &slot.frame,
            capacity: &slot.capacity,
            camera: &first.camera,
            settings: &settings,
            scale: first.scale,
            sh_degree: first.sh_degree,
            others: &others,
            depth_limits: frame.occluder.as_ref().and(slot.depth_limits.as_ref()),
            linear_depth: frame.depth.is_some(),
            backward: false,
            keeps_overflow: false,
        };
        forward.record(r, &inputs);
        r.barrier();
        let mut release = record_targets(r, compose, slot, frame);
        release.occluder = occluder;
        slot.end(recorder)?;
        Ok(release)
    }

    /// What the last frame of a slot was made of: None while it is in flight, and where there is none. Never waits, but on
    /// llvmpipe, where asking for timestamps waits for the whole device
    /// ([`ContextOptions::timestamps`](crate::vk::ContextOptions::timestamps)).
    ///
    /// # Errors
    /// [`Error::Argument`] for a slot that is not reserved; when the device is lost.
    pub fn slot_report(&mut self, slot: u32) -> Result<Option<SlotReport>> {
        let sizes = self.runner.forward.sizes;
        self.slots.get(slot)?.report(&sizes)
    }

    /// Whether the last frame of a slot is done. Never waits. What the host has recorded behind the frame may still run: see
    /// [`Context::adopt_commands`](crate::vk::Context::adopt_commands).
    ///
    /// # Errors
    /// As [`Renderer::slot_report`].
    pub fn slot_finished(&mut self, slot: u32) -> Result<bool> {
        self.slots.get(slot)?.record.finished()
    }

    /// Lets go of what the last frame of a slot used, once its command buffer is over: scenes and views of images that were
    /// dropped meanwhile are destroyed now, and not when the slot is recorded again.
    ///
    /// # Errors
    /// [`Error::Argument`] for a slot that is not reserved or still in flight.
    pub fn release_slot(&mut self, slot: u32) -> Result<()> {
        self.slots.get(slot)?.record.release()
    }

    /// The buffer that [`Target::Slot`] fills: premultiplied r, g, b and transmittance per pixel, row by row, f32. A storage
    /// buffer and a source of transfers; another one after [`Renderer::reserve`].
    ///
    /// # Errors
    /// [`Error::Argument`] for a slot that is not reserved.
    pub fn slot_pixels(&mut self, slot: u32) -> Result<Buffer> {
        Ok(self.slots.get(slot)?.frame.accumulated.clone())
    }

    /// The buffer of [`RenderSettings::inverse_depth`]: the sum of weights / z per pixel, row by row, f32. As
    /// [`Renderer::slot_pixels`]. With an expected depth ([`RecordedFrame::depth`]) it holds the sum of weights * z.
    ///
    /// # Errors
    /// [`Error::Argument`] for a slot that is not reserved.
    pub fn slot_inverse_depth(&mut self, slot: u32) -> Result<Buffer> {
        Ok(self.slots.get(slot)?.frame.inverse_depth.clone())
    }

    /// The slot's own recording state, for a host that has thrown its command buffer away or caught a panic: see
    /// [`RecordSlot::discard`](crate::vk::RecordSlot::discard).
    ///
    /// # Errors
    /// [`Error::Argument`] for a slot that is not reserved.
    pub fn slot_recording(&mut self, slot: u32) -> Result<&mut crate::vk::RecordSlot> {
        Ok(&mut self.slots.get(slot)?.record)
    }
}

/// The first scene, and the others behind it in the frame's index space.
fn place<'a>(frame: &RecordedFrame<'a>, alignment: u32) -> [Vec<PlacedScene<'a>>; 2] {
    let mut first = 0;
    let mut all = frame.scenes.iter().map(|placed| {
        let scene = &placed.scene.buffers;
        let begin = first;
        first = (begin + scene.count).next_multiple_of(alignment);
        let (camera, sh_degree) =
            (placed.pose.camera_in_object(frame.camera), scene.active_degree(frame.settings));
        PlacedScene { scene, camera, scale: placed.pose.scale, sh_degree, first: begin }
    });
    [all.next().into_iter().collect(), all.collect()]
}

fn record_targets(r: &mut Recorder, compose: &Compose, slot: &Slot, frame: &RecordedFrame<'_>) -> Release {
    let size = [frame.camera.width, frame.camera.height];
    let f = &slot.frame;
    let mut release = Release {
        stages: vk::PipelineStageFlags2::COMPUTE_SHADER,
        accesses: vk::AccessFlags2::SHADER_STORAGE_WRITE,
        color: None,
        occluder: None,
        depth: None,
    };
    r.scope("compose", |r| {
        if let Target::Image { to, behind } = &frame.target {
            release.color = Some(r.acquire_image(to.image, to.from));
            compose.record_color(r, &f.accumulated, size, to.region(), *behind);
        }
        if let Some(depth) = &frame.depth {
            release.depth = Some(r.acquire_image(depth.to.image, depth.to.from));
            let limits = [depth.min_weight, depth.empty];
            compose.record_expected_depth(
                r,
                [&f.accumulated, &f.inverse_depth],
                size,
                depth.to.region(),
                limits,
            );
        }
    });
    release
}

impl<'a> HostImage<'a> {
    fn region(&self) -> Region<'a> {
        Region { image: self.image, offset: self.offset }
    }
}
