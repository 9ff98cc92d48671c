//! Records a frame into a host's command buffer. Never submits, waits, allocates, maps or reads back.

use super::Renderer;
use super::device_scene::DeviceScene;
use super::slot_memory::SlotMemory;
use super::updates::Update;
use crate::compose::{Background, Region};
use crate::error::Result;
use crate::forward::{Auxiliary, Batch, Before, FrameInputs, PlacedScene, RenderSettings, SceneSettings};
use crate::scene::{Camera, ColorEncoding, DepthMapping, Pose};
use crate::vk::{ForeignCommands, Image, ImageState};
use ash::vk;

/// A scene, its pose, and how it is drawn.
#[derive(Clone, Copy)]
pub struct Placed<'a> {
    /// The scene.
    pub scene: &'a DeviceScene,
    /// Its pose in the world.
    pub pose: Pose,
    /// How it is drawn.
    pub settings: SceneSettings<'a>,
    /// Its pose in the frame before, for [`RecordedFrame::motion`]. `None`: the same as now, for scenes that stand still and
    /// for those that were not there.
    pub previous_pose: Option<Pose>,
}

impl<'a> Placed<'a> {
    /// A scene as it is, in some pose.
    pub fn at(scene: &'a DeviceScene, pose: Pose) -> Self {
        Self { scene, pose, settings: SceneSettings::default(), previous_pose: None }
    }

    /// The evaluated SH degree: what is stored, up to the frame's and the scene's own limits.
    #[inline]
    pub(super) fn active_degree(&self, frame: &RenderSettings) -> u32 {
        let stored = self.scene.buffers.active_degree(frame);
        self.settings.sh_degree.map_or(stored, |degree| degree.min(stored))
    }

    /// Gaussians that take part in the frame.
    #[inline]
    pub(super) fn drawn(&self) -> u32 {
        if self.settings.draws() { self.scene.count() } else { 0 }
    }
}

impl<'a> From<&'a DeviceScene> for Placed<'a> {
    fn from(scene: &'a DeviceScene) -> Self {
        Self::at(scene, Pose::IDENTITY)
    }
}

/// A host's image, its previous use by the host, and the part of it that is the frame.
#[derive(Clone, Copy)]
pub struct HostImage<'a> {
    /// The image.
    pub image: &'a Image,
    /// The host's use of it before the frame. The recording waits for that use and changes the layout from
    /// this one. From [`ImageState::UNDEFINED`] the image's contents are discarded.
    pub from: ImageState,
    /// Texel of the image that receives the frame's pixel (0, 0).
    pub offset: [u32; 2],
}

/// The target of the colours.
#[derive(Clone, Copy)]
pub enum Target<'a> {
    /// The slot's own buffer, [`Renderer::slot_pixels`], unless the reservation is for [`images_only`](super::Reservation::images_only): per pixel, row by row, premultiplied r, g, b, display-encoded as
    /// trained, and the transmittance, each an f32. The host may use it after the recording, behind a barrier from
    /// [`Release::stages`] and [`Release::accesses`], until the slot is recorded again. The next recording
    /// waits for compute and transfer commands that read the buffer. A host that reads it in other stages, in
    /// a later command buffer than the frame's, must wait for those stages first.
    Slot,
    /// A storage image of a format of [`Compose::COLOR_FORMATS`](crate::compose::Compose::COLOR_FORMATS).
    Image {
        /// The image.
        to: HostImage<'a>,
        /// What the splats are composited over.
        behind: Background,
        /// What the image's colours are: see the [guide](crate::guide::colour).
        encoding: ColorEncoding,
    },
}

/// A host's depth image. It hides the splats that are farther away.
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
    /// A pixel whose sum of weights is smaller is empty.
    pub min_weight: f32,
    /// The depth of empty pixels.
    pub empty: f32,
}

/// An image of what is picked at each pixel: the Gaussian with the largest blending weight alpha T, the nearest of equal ones.
#[derive(Clone, Copy)]
pub struct PickTarget<'a> {
    /// A storage image of format [`Compose::PICK_FORMAT`](crate::compose::Compose::PICK_FORMAT), rgba32ui. A texel is the index of the Gaussian in its scene, the
    /// index of the scene in [`RecordedFrame::scenes`], the bits of the f32 of the Gaussian's depth z in the camera's frame (world
    /// units), and the bits of the f32 of its weight. Where nothing is blended, the first two are
    /// [`NOT_PICKED`](crate::kernels::constants::NOT_PICKED), the others 0.
    pub to: HostImage<'a>,
}

/// An image of motion: for each pixel the mean motion on the screen of what is blended there, from the frame before to this one,
/// weighted as in blending. A Gaussian moves as its mean does, at most by the picture's width and height. It counts with a motion of
/// 0 where its earlier place is unknown: where its mean did not lie in front of the earlier camera (z above 0.2), or lay too far
/// away for an f32. How [`Update`]s move Gaussians is not known.
#[derive(Clone, Copy)]
pub struct MotionTarget<'a> {
    /// A storage image of format [`Compose::MOTION_FORMAT`](crate::compose::Compose::MOTION_FORMAT), rg16f: the place now less the place before, in pixels, x right, y
    /// down. What is at pixel p now was at p - motion.
    pub to: HostImage<'a>,
    /// The camera of the frame before, of the same width and height; the frame's own camera where there is none before. The motion counts
    /// from its own principal point to that of the frame's camera. For motion without jitter, give it the `cx` and `cy` of the frame's
    /// camera. Poses before are in [`Placed::previous_pose`].
    pub previous_camera: &'a Camera,
    /// A pixel whose sum of weights is smaller is empty.
    pub min_weight: f32,
    /// The motion of empty pixels, px; `None`: they keep what is in the image.
    pub empty: Option<[f32; 2]>,
}

/// A frame to record.
#[derive(Clone, Copy)]
pub struct RecordedFrame<'a> {
    /// The scenes: at least one. Their Gaussians are sorted together.
    pub scenes: &'a [Placed<'a>],
    /// The camera; its width and height are the frame's.
    pub camera: &'a Camera,
    /// Render settings. Their background is ignored: the target has its own.
    pub settings: &'a RenderSettings,
    /// The target of the colours.
    pub target: Target<'a>,
    /// The depth image that hides splats.
    pub occluder: Option<Occluder<'a>>,
    /// The target of the expected depth.
    pub depth: Option<DepthTarget<'a>>,
    /// Parameter updates before the frame.
    pub updates: &'a [Update<'a>],
    /// The target of what is picked.
    pub pick: Option<PickTarget<'a>>,
    /// The target of the motion.
    pub motion: Option<MotionTarget<'a>>,
}

impl<'a> RecordedFrame<'a> {
    /// A frame of scenes that is rendered into the slot's own buffer.
    pub fn new(scenes: &'a [Placed<'a>], camera: &'a Camera, settings: &'a RenderSettings) -> Self {
        let target = Target::Slot;
        Self {
            scenes,
            camera,
            settings,
            target,
            occluder: None,
            depth: None,
            updates: &[],
            pick: None,
            motion: None,
        }
    }
}

/// The state after a recording. The next user of its results waits for these stages and accesses, and finds
/// the images in these layouts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Release {
    /// The stages that write results, including those in the slot's own buffers.
    pub stages: vk::PipelineStageFlags2,
    /// The accesses of these writes.
    pub accesses: vk::AccessFlags2,
    /// Last use of the target image.
    pub color: Option<ImageState>,
    /// Last use of the host's depth image.
    pub occluder: Option<ImageState>,
    /// Last use of the image of expected depth.
    pub depth: Option<ImageState>,
    /// Last use of the image of what is picked.
    pub pick: Option<ImageState>,
    /// Last use of the image of motion.
    pub motion: Option<ImageState>,
}

impl Renderer {
    /// Records a frame into a host's command buffer.
    ///
    /// It only records: it neither submits nor waits, allocates or maps device memory, or reads anything
    /// back. Everything is checked before the first command is recorded. The slot is then in flight until the
    /// device has executed the recording. It may be recorded again once the whole command buffer has
    /// finished, as [`Context::adopt_commands`](crate::vk::Context::adopt_commands) requires. The slot keeps
    /// scenes and image views alive that are dropped meanwhile. [`Renderer::release_slot`] or the next
    /// recording destroys them.
    ///
    /// Updates are applied in order: where two overlap, the later one wins.
    ///
    /// Before its first command the recording waits for earlier compute and transfer commands in the queue,
    /// and for the previous uses in [`HostImage::from`].
    ///
    /// # Errors
    /// [`Error::Argument`](crate::Error::Argument) for a slot that is not reserved or still in flight; for commands,
    /// scenes or images of another context; for an invalid camera or pose; for images with a wrong format, usage, size
    /// or layout; for numbers that are not finite; and for kernels that [`Renderer::reserve`] has not built.
    /// [`Error::TooLarge`](crate::Error::TooLarge) for what exceeds the reservation;
    /// [`Error::DeviceLost`](crate::Error::DeviceLost) after a loss that the context has noticed.
    pub fn record(
        &mut self,
        commands: ForeignCommands,
        slot: u32,
        frame: &RecordedFrame<'_>,
    ) -> Result<Release> {
        let mut release = [Release::default()];
        self.record_frames(commands, slot, (std::slice::from_ref(frame), &mut release))?;
        let [release] = release;
        Ok(release)
    }
}

/// Places scenes, each after the one before it in the frame's index space.
pub(super) struct Placing<'a, 'b> {
    frame: &'b RecordedFrame<'a>,
    /// Each begins at a multiple of it.
    alignment: u32,
    /// Where the next one begins.
    first: u32,
    /// Cut-outs so far.
    pub cut_outs: u32,
}

impl<'a, 'b> Placing<'a, 'b> {
    pub fn new(frame: &'b RecordedFrame<'a>, alignment: u32) -> Self {
        Self { frame, alignment, first: 0, cut_outs: 0 }
    }

    /// The next scene.
    #[inline]
    pub fn place(&mut self, placed: &'a Placed<'a>) -> PlacedScene<'a> {
        let (frame, first, first_cut_out) = (self.frame, self.first, self.cut_outs);
        self.first = behind((first, placed.drawn()), self.alignment);
        self.cut_outs += placed.settings.cut_out_count();
        PlacedScene {
            scene: &placed.scene.buffers,
            camera: placed.pose.camera_in_object(frame.camera),
            scale: placed.pose.scale,
            sh_degree: placed.active_degree(frame.settings),
            settings: &placed.settings,
            first,
            first_cut_out,
            previous: frame.motion.map(|motion| {
                let pose = placed.previous_pose.as_ref().unwrap_or(&placed.pose);
                Before { camera: motion.previous_camera, pose }
            }),
            batch: Batch::none_yet(placed.scene.parameters),
        }
    }
}

/// Where a scene begins behind one with its first Gaussian and their number; `u32::MAX` beyond what can be indexed, which is beyond any
/// capacity. Nothing is checked yet.
#[inline]
fn behind((first, drawn): (u32, u32), alignment: u32) -> u32 {
    first.saturating_add(drawn).checked_next_multiple_of(alignment).unwrap_or(u32::MAX)
}

/// A frame of some scenes in the buffers of a slot, without occluder and depth.
pub(super) fn inputs_of<'a>(
    scenes: &'a [PlacedScene<'a>],
    memory: &'a SlotMemory,
    settings: &'a RenderSettings,
) -> FrameInputs<'a> {
    FrameInputs {
        scenes,
        frame: &memory.frame,
        capacity: &memory.capacity,
        camera: &scenes[0].camera,
        pose: None,
        settings,
        depth_limits: None,
        cut_outs: memory.cut_outs.as_ref(),
        linear_depth: false,
        backward: false,
        keeps_overflow: false,
        auxiliary: Auxiliary::default(),
        view: None,
    }
}

impl<'a> HostImage<'a> {
    pub(super) fn region(&self) -> Region<'a> {
        Region { image: self.image, offset: self.offset }
    }
}

#[cfg(test)]
mod tests {
    use super::behind;

    #[test]
    fn places_beyond_all_indices_do_not_begin_anew() {
        assert_eq!([(0, 0), (0, 5), (256, 256)].map(|scene| behind(scene, 256)), [0, 256, 512]);
        let far = [(u32::MAX - 300, 5), (u32::MAX - 10, 5), (1 << 31, 1 << 31), (u32::MAX, 0), (u32::MAX, 7)];
        let expected = [u32::MAX - 255, u32::MAX, u32::MAX, u32::MAX, u32::MAX];
        assert_eq!(far.map(|scene| behind(scene, 256)), expected);
    }
}
