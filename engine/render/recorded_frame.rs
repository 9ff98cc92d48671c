//! Description of a recorded frame, and the state of its images afterwards.

use super::device_scene::DeviceScene;
use super::updates::Update;
use crate::frame::{FrameVariant, PlacedScene, PreviousView, RenderSettings, SceneSettings, SurfaceDepth};
use crate::kernels::constants::NO_BATCH;
use crate::passes::compose::{Background, Contents, Region};
use crate::scene::{Camera, ColorEncoding, DepthMapping, Pose};
use crate::vk::{Image, ImageState, ImageUse};
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

    /// Returns the scene in a frame, with the indices of its first Gaussian and of its first cut-out there.
    #[inline]
    pub(super) fn in_frame(
        &'a self,
        frame: &RecordedFrame<'a>,
        first: u32,
        first_cut_out: u32,
    ) -> PlacedScene<'a> {
        PlacedScene {
            scene: &self.scene.buffers,
            camera: self.pose.camera_in_object(frame.camera),
            scale: self.pose.scale,
            sh_degree: self.active_degree(frame.settings),
            settings: &self.settings,
            first,
            first_cut_out,
            previous: frame.motion.map(|motion| {
                let pose = self.previous_pose.as_ref().unwrap_or(&self.pose);
                PreviousView { camera: motion.previous_camera, pose }
            }),
            parameters: self.scene.parameters,
            batch: NO_BATCH,
        }
    }

    /// Returns the number of Gaussians that take part in the frame.
    #[inline]
    pub(super) fn drawn_gaussians(&self) -> u32 {
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
    /// The slot's own buffer, [`Renderer::slot_pixels`](super::Renderer::slot_pixels), unless the reservation has
    /// [`images_only`](super::Reservation::images_only). Per pixel, row by row: premultiplied r, g, b, display-encoded as
    /// trained, and the transmittance, each an f32.
    /// The host may use it after the recording, behind a barrier from [`Release::stages`] and [`Release::accesses`], until
    /// the slot is recorded again. The next recording waits for compute and transfer commands that read the buffer. A host
    /// that reads it in other stages, in a later command buffer than the frame's, must wait for those stages first.
    Slot,
    /// A storage image of a format of [`COLOR_FORMATS`](crate::vk::COLOR_FORMATS).
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

/// Target image of motion: per pixel, the mean screen motion of the blended Gaussians since the previous frame, weighted as
/// in blending. A Gaussian moves like its mean, at most by the picture's width and height. Its motion counts as 0 if its
/// mean was not in front of the previous camera (z above 0.2), or too far away for an f32. Motion caused by [`Update`]s is
/// not included.
#[derive(Clone, Copy)]
pub struct MotionTarget<'a> {
    /// A storage image of format [`MOTION_FORMAT`](crate::vk::MOTION_FORMAT), rg16f: the current
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

/// Target image of the surface of each pixel: its normal and its depth.
#[derive(Clone, Copy)]
pub struct SurfaceTarget<'a> {
    /// A storage image of a format of [`SURFACE_FORMATS`](crate::vk::SURFACE_FORMATS), rgba16f or rgba32f. A texel holds the mean
    /// of the Gaussians' normals, weighted as in blending, of unit length in the camera's frame (x right, y down, z forward), and
    /// the surface's depth z there, world units. All are 0 where there is no surface, and the normal where normals cancel out. A
    /// Gaussian's normal is its shortest axis, turned towards the camera. Halves have depths to 1 in 2000, below 65504. Fisheyes and
    /// panoramas have the distance from the camera in place of z, all lenses at the Gaussian's mean, and rolling shutters the
    /// normals of the pose halfway.
    pub to: HostImage<'a>,
    /// Depth at which the surface lies; the reserved one ([`Reservation::surface`](super::Reservation::surface)).
    pub depth: SurfaceDepth,
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
    /// Target of the pick at each pixel: the Gaussian with the largest blending weight alpha T; of equal ones, the nearest. A storage
    /// image of format [`PICK_FORMAT`](crate::vk::PICK_FORMAT), rgba32ui. A texel holds:
    /// - the index of the Gaussian in its scene;
    /// - the index of the scene in [`RecordedFrame::scenes`];
    /// - the f32 bits of the Gaussian's depth z in the camera's frame, world units;
    /// - the f32 bits of its weight.
    ///
    /// The first two are [`NOT_PICKED`](crate::kernels::constants::NOT_PICKED) and the others 0 where nothing is blended.
    pub pick: Option<HostImage<'a>>,
    /// Target of the motion.
    pub motion: Option<MotionTarget<'a>>,
    /// Target of normals and depths of the surface.
    pub surface: Option<SurfaceTarget<'a>>,
}

impl<'a> RecordedFrame<'a> {
    /// Creates a frame of scenes that renders into the slot's own buffer.
    pub fn new(scenes: &'a [Placed<'a>], camera: &'a Camera, settings: &'a RenderSettings) -> Self {
        Self {
            scenes,
            camera,
            settings,
            target: Target::Slot,
            occluder: None,
            depth: None,
            updates: &[],
            pick: None,
            motion: None,
            surface: None,
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
    /// Last use of the surface image.
    pub surface: Option<ImageState>,
}

impl<'a> HostImage<'a> {
    /// Returns the part of the image that receives a frame of this size.
    pub(super) fn region(&self, size: [u32; 2]) -> Region<'a> {
        Region { image: self.image, offset: self.offset, size }
    }
}

impl<'a> RecordedFrame<'a> {
    /// Returns the variant of the frame's kernels, without what only its scenes and a shared order have.
    pub(super) fn variant(&self) -> FrameVariant {
        let mut variant = FrameVariant::of(self.settings, self.camera, false);
        variant.depth_limit = self.occluder.is_some();
        self.written().for_each(|(_, contents)| contents.require(&mut variant));
        variant
    }

    /// Returns the images that the frame writes, in this order.
    pub(super) fn written(&self) -> impl Iterator<Item = (HostImage<'a>, Contents)> + use<'a> {
        let color = match self.target {
            Target::Image { to, behind, encoding } => Some((to, Contents::Color { behind, encoding })),
            Target::Slot => None,
        };
        let depth = self
            .depth
            .map(|DepthTarget { to, min_weight, empty }| (to, Contents::ExpectedDepth { min_weight, empty }));
        let motion = self.motion.map(|MotionTarget { to, min_weight, empty, .. }| {
            (to, Contents::MeanMotion { min_weight, empty })
        });
        let pick = self.pick.map(|to| (to, Contents::Picks));
        let surface = self.surface.map(|SurfaceTarget { to, depth }| (to, Contents::Surface(depth)));
        [color, depth, pick, motion, surface].into_iter().flatten()
    }

    /// Returns the image with a purpose.
    fn image(&self, purpose: ImageUse) -> Option<HostImage<'a>> {
        match purpose {
            ImageUse::Occluder => self.occluder.map(|occluder| occluder.depth),
            _ => self.written().find(|(_, contents)| contents.purpose() == purpose).map(|(to, _)| to),
        }
    }

    /// Returns all images that the frame uses.
    pub(super) fn images(&self) -> impl Iterator<Item = (ImageUse, HostImage<'a>)> {
        ImageUse::ALL.into_iter().filter_map(|purpose| Some((purpose, self.image(purpose)?)))
    }

    /// Returns the purpose of an image in the frame, if it is one of [`RecordedFrame::images`].
    pub(super) fn purpose_of(&self, image: &Image) -> Option<ImageUse> {
        self.images().find(|(_, host)| host.image.is_same_as(image)).map(|(purpose, _)| purpose)
    }
}

impl Release {
    /// Returns the last use of the image with a purpose.
    pub(super) fn last_use(&mut self, purpose: ImageUse) -> &mut Option<ImageState> {
        match purpose {
            ImageUse::Target => &mut self.color,
            ImageUse::Occluder => &mut self.occluder,
            ImageUse::Depth => &mut self.depth,
            ImageUse::Pick => &mut self.pick,
            ImageUse::Motion => &mut self.motion,
            ImageUse::Surface => &mut self.surface,
        }
    }
}
