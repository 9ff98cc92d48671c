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

/// A scene with its pose and draw settings.
#[derive(Clone, Copy)]
pub struct Placed<'a> {
    /// The scene.
    pub scene: &'a DeviceScene,
    /// Pose in the world.
    pub pose: Pose,
    /// Draw settings.
    pub settings: SceneSettings<'a>,
    /// Pose in the previous frame, for [`RecordedFrame::motion`]. `None`: same as now, for scenes that do not move or are
    /// new.
    pub previous_pose: Option<Pose>,
}

impl<'a> Placed<'a> {
    /// Places a scene with default settings.
    pub fn at(scene: &'a DeviceScene, pose: Pose) -> Self {
        Self { scene, pose, settings: SceneSettings::default(), previous_pose: None }
    }

    /// Returns the evaluated SH degree: the stored one, up to the frame's and the scene's own limits.
    #[inline]
    pub(super) fn active_degree(&self, frame: &RenderSettings) -> u32 {
        let stored = self.scene.buffers.active_degree(frame);
        self.settings.sh_degree.map_or(stored, |degree| degree.min(stored))
    }

    /// Returns the number of Gaussians that take part in the frame.
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

/// A host's image, its previous use by the host, and the rectangle of it that receives the frame.
#[derive(Clone, Copy)]
pub struct HostImage<'a> {
    /// The image.
    pub image: &'a Image,
    /// The host's use of it before the frame. The recording waits for that use and changes the layout from its layout. From
    /// [`ImageState::UNDEFINED`] the image's contents are discarded.
    pub from: ImageState,
    /// Texel of the image that receives the frame's pixel (0, 0).
    pub offset: [u32; 2],
}

/// Target of the colours.
#[derive(Clone, Copy)]
pub enum Target<'a> {
    /// The slot's own buffer, [`Renderer::slot_pixels`], unless the reservation has
    /// [`images_only`](super::Reservation::images_only). Per pixel, row by row: premultiplied r, g, b, display-encoded as
    /// trained, and the transmittance, each an f32.
    /// The host may use it after the recording, behind a barrier from [`Release::stages`] and [`Release::accesses`], until
    /// the slot is recorded again. The next recording waits for compute and transfer commands that read the buffer. A host
    /// that reads it in other stages, in a later command buffer than the frame's, must wait for those stages first.
    Slot,
    /// A storage image of a format of [`Compose::COLOR_FORMATS`](crate::compose::Compose::COLOR_FORMATS).
    Image {
        /// The image.
        to: HostImage<'a>,
        /// Background behind the splats.
        behind: Background,
        /// Encoding of the image's colours: see the [guide](crate::guide::colour).
        encoding: ColorEncoding,
    },
}

/// A host's depth image. It hides splats that are farther away.
#[derive(Clone, Copy)]
pub struct Occluder<'a> {
    /// The depth image, for sampling.
    pub depth: HostImage<'a>,
    /// How to read it: [`crate::scene::HostView::camera`].
    pub mapping: DepthMapping,
}

/// Target image of expected depth: sum(w z) / sum(w), world units.
#[derive(Clone, Copy)]
pub struct DepthTarget<'a> {
    /// A storage image of format r32f.
    pub to: HostImage<'a>,
    /// Pixels with a smaller sum of weights are empty.
    pub min_weight: f32,
    /// Depth of empty pixels.
    pub empty: f32,
}

/// Target image of the pick at each pixel: the Gaussian with the largest blending weight alpha T; of equal ones, the
/// nearest.
#[derive(Clone, Copy)]
pub struct PickTarget<'a> {
    /// A storage image of format [`Compose::PICK_FORMAT`](crate::compose::Compose::PICK_FORMAT), rgba32ui. A texel holds:
    /// - the index of the Gaussian in its scene;
    /// - the index of the scene in [`RecordedFrame::scenes`];
    /// - the f32 bits of the Gaussian's depth z in the camera's frame, world units;
    /// - the f32 bits of its weight.
    ///
    /// Where nothing is blended, the first two are [`NOT_PICKED`](crate::kernels::constants::NOT_PICKED), the others 0.
    pub to: HostImage<'a>,
}

/// Target image of motion: per pixel, the mean screen motion of the blended Gaussians since the previous frame, weighted as
/// in blending. A Gaussian moves like its mean, at most by the picture's width and height. Its motion counts as 0 if its
/// mean was not in front of the previous camera (z above 0.2), or too far away for an f32. Motion caused by [`Update`]s is
/// not included.
#[derive(Clone, Copy)]
pub struct MotionTarget<'a> {
    /// A storage image of format [`Compose::MOTION_FORMAT`](crate::compose::Compose::MOTION_FORMAT), rg16f: the current
    /// position minus the previous one, in pixels, x right, y down. The content of pixel p was at p - motion.
    pub to: HostImage<'a>,
    /// Camera of the previous frame, of the same width and height; the frame's own camera if there is no previous frame.
    /// The motion counts from its principal point to that of the frame's camera. For motion without jitter, give it the
    /// `cx` and `cy` of the frame's camera. [`Placed::previous_pose`] holds previous poses.
    pub previous_camera: &'a Camera,
    /// Pixels with a smaller sum of weights are empty.
    pub min_weight: f32,
    /// Motion of empty pixels, px; `None`: they keep the image's contents.
    pub empty: Option<[f32; 2]>,
}

/// A frame to record.
#[derive(Clone, Copy)]
pub struct RecordedFrame<'a> {
    /// At least one scene. Gaussians of all scenes are sorted together.
    pub scenes: &'a [Placed<'a>],
    /// Camera; its width and height are the frame's.
    pub camera: &'a Camera,
    /// Render settings. Their background is ignored: the target has its own.
    pub settings: &'a RenderSettings,
    /// Target of the colours.
    pub target: Target<'a>,
    /// Depth image that hides splats.
    pub occluder: Option<Occluder<'a>>,
    /// Target of the expected depth.
    pub depth: Option<DepthTarget<'a>>,
    /// Parameter updates, applied before the frame.
    pub updates: &'a [Update<'a>],
    /// Target of the picks.
    pub pick: Option<PickTarget<'a>>,
    /// Target of the motion.
    pub motion: Option<MotionTarget<'a>>,
}

impl<'a> RecordedFrame<'a> {
    /// Creates a frame of scenes that renders into the slot's own buffer.
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

/// State after a recording. The next user of its results waits for these stages and accesses, and finds the images in these
/// layouts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Release {
    /// Stages that write results, including those in the slot's own buffers.
    pub stages: vk::PipelineStageFlags2,
    /// Accesses of these writes.
    pub accesses: vk::AccessFlags2,
    /// Last use of the target image.
    pub color: Option<ImageState>,
    /// Last use of the host's depth image.
    pub occluder: Option<ImageState>,
    /// Last use of the image of expected depth.
    pub depth: Option<ImageState>,
    /// Last use of the pick image.
    pub pick: Option<ImageState>,
    /// Last use of the motion image.
    pub motion: Option<ImageState>,
}

impl Renderer {
    /// Records a frame into a host's command buffer.
    ///
    /// It only records: it neither submits nor waits, allocates or maps device memory, or reads anything back. Everything
    /// is checked before the first command is recorded. The slot is then in flight until the device has executed the
    /// recording. It may be recorded again once the whole command buffer has finished, as
    /// [`Context::adopt_commands`](crate::vk::Context::adopt_commands) requires. The slot keeps scenes and image views
    /// alive that are dropped meanwhile. [`Renderer::release_slot`] or the next recording destroys them.
    ///
    /// Updates are applied in order: where two overlap, the later one wins.
    ///
    /// Before its first command the recording waits for earlier compute and transfer commands in the queue,
    /// and for the previous uses in [`HostImage::from`].
    ///
    /// # Errors
    /// [`Error::Argument`](crate::Error::Argument) for:
    /// - a slot that is not reserved or still in flight;
    /// - commands, scenes or images of another context;
    /// - an invalid camera or pose, or numbers that are not finite;
    /// - images with a wrong format, usage, size or layout;
    /// - kernels that [`Renderer::reserve`] has not built.
    ///
    /// [`Error::TooLarge`](crate::Error::TooLarge) for a frame that exceeds the reservation.
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

/// Places scenes one after the other in the frame's index space.
pub(super) struct Placing<'a, 'b> {
    frame: &'b RecordedFrame<'a>,
    /// Every scene begins at a multiple of it.
    alignment: u32,
    /// Begin of the next scene.
    first: u32,
    /// Number of cut-outs so far.
    pub cut_outs: u32,
}

impl<'a, 'b> Placing<'a, 'b> {
    pub fn new(frame: &'b RecordedFrame<'a>, alignment: u32) -> Self {
        Self { frame, alignment, first: 0, cut_outs: 0 }
    }

    /// Places the next scene.
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

/// Returns the begin of the scene after one with this first Gaussian and number of Gaussians. `u32::MAX` for a begin beyond
/// all indices, which exceeds any capacity; the capacity is checked later.
#[inline]
fn behind((first, drawn): (u32, u32), alignment: u32) -> u32 {
    first.saturating_add(drawn).checked_next_multiple_of(alignment).unwrap_or(u32::MAX)
}

/// Returns the inputs of a frame of some scenes in a slot's buffers, without occluder and depth.
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
