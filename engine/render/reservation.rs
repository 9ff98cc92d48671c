//! Reservation of frame slots, and the report of a finished frame.

use crate::error::{Error, Result};
use crate::frame::{
    FrameCapacity, FrameVariant, LaunchSizes, MIN_SCENES, Outputs, PictureCapacity, ScenePlan, SceneSettings,
    ShStorage, SurfaceDepth, check_grids, initial_instances, may_order_by_distance,
};
use crate::scene::{MAX_CUT_OUTS, Projection};
use crate::vk::{Context, ScopeTime};

/// Memory and kernels to prepare for recording: see [`super::Renderer::reserve`]. Kernels are built for every combination of the
/// features that are set, so each one doubles the kernels that it affects.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reservation {
    /// Frames in flight.
    pub slots: u32,
    /// Queues to which frames are submitted. Scratch memory of a frame exists once for each queue: slots with the same
    /// `slot % queues` share it. Submit their frames to one queue, in any order, or order them by semaphores. With as many
    /// queues as slots nothing is shared.
    pub queues: u32,
    /// Views per recording ([`Renderer::record_views`](super::Renderer::record_views)): they share the memory of one. At
    /// most 255 stages of a recording are timed ([`SlotReport::scopes`]).
    pub views: u32,
    /// True if views with the same depths, such as two eyes side by side, are culled and sorted once: see
    /// [`Renderer::record_views`](super::Renderer::record_views). Costs 256 bytes for each scene and view, and more
    /// kernels.
    pub shared_sort: bool,
    /// Gaussians drawn in all scenes of a frame together ([`DeviceScene::count`](super::DeviceScene::count)).
    pub gaussians: u32,
    /// Scenes per frame.
    pub scenes: u32,
    /// Highest SH degree that frames evaluate. A frame with a higher one is refused.
    pub sh_degree: u32,
    /// (tile, Gaussian) instances of a frame; 0 for an estimate. [`SlotReport`] reports how many a frame needs.
    pub instances: u32,
    /// Width of the largest picture, pixels. Pictures of any shape fit if they have no more pixels and no more tiles of
    /// 16×16 pixels; for example, the same size turned by 90 degrees.
    pub width: u32,
    /// Height of the largest picture, pixels: see [`Reservation::width`].
    pub height: u32,
    /// Passes of blending. 0 for an estimate: 2 if the driver bounds loops and a tile may have more entries than a pass
    /// handles, otherwise 1. [`SlotReport`] reports how many a frame needs.
    pub blend_passes: u32,
    /// True if frames will render the sum of weights / z.
    pub inverse_depth: bool,
    /// True if frames will render expected depth.
    pub expected_depth: bool,
    /// True if frames will read a host's depth image.
    pub occlusion: bool,
    /// True if frames will draw scenes with a 3D filter ([`RenderSettings::filter_3d`](crate::RenderSettings::filter_3d)).
    pub filter_3d: bool,
    /// True if frames will be blended in the order of distances ([`RenderSettings::distance_order`](crate::RenderSettings::distance_order)).
    pub distance_order: bool,
    /// True if scenes of frames will have a tint or an opacity ([`SceneSettings`](crate::SceneSettings)).
    pub tint: bool,
    /// Cut-outs of all scenes of a frame together ([`SceneSettings::cut_outs`](crate::SceneSettings::cut_outs)).
    pub cut_outs: u32,
    /// True if scenes of frames will have a selection ([`SceneSettings::selection`](crate::SceneSettings::selection)).
    pub selection: bool,
    /// True if frames will write picks ([`RecordedFrame::pick`](super::RecordedFrame::pick)), which take 8 bytes per pixel.
    pub pick: bool,
    /// True if frames will write motion ([`RecordedFrame::motion`](super::RecordedFrame::motion)), which takes 8 bytes per
    /// pixel and 8 per Gaussian.
    pub motion: bool,
    /// Depth of the surfaces that frames will write ([`RecordedFrame::surface`](super::RecordedFrame::surface)), which take 16
    /// bytes per pixel and 16 per Gaussian; none without.
    pub surface: Option<SurfaceDepth>,
    /// True if frames will have orthographic cameras
    /// ([`Projection::Orthographic`](crate::scene::Projection::Orthographic)), beside pinholes. Includes previous cameras
    /// ([`MotionTarget::previous_camera`](super::MotionTarget::previous_camera)).
    pub orthographic: bool,
    /// Lens that cameras of frames may have, beside pinholes.
    pub lens: Option<Projection>,
    /// True if frames will have cameras with a rolling shutter ([`Camera::shutter`](crate::Camera::shutter)), beside others.
    pub rolling_shutter: bool,
    /// True if scenes of frames will store SH in halves ([`DeviceScene::upload_stored`](super::DeviceScene::upload_stored)), beside others.
    pub half_sh: bool,
    /// True if scenes of frames will store SH in bytes, beside others.
    pub byte_sh: bool,
    /// True if all frames render into images, and none into its slot ([`Target::Slot`](super::Target::Slot)). Slots then
    /// have no pixels of their own ([`Renderer::slot_pixels`](super::Renderer::slot_pixels), `slot_inverse_depth`).
    pub images_only: bool,
    /// Bytes of staging memory for the [`super::Update`]s of a frame: see [`Reservation::update_bytes`].
    pub staging_bytes: u64,
}

impl Reservation {
    /// Largest value of [`Reservation::scenes`].
    pub const MAX_SCENES: u32 = 65_536;

    /// A reservation for one frame in flight of one scene, for one queue, with all options off.
    pub fn new(gaussians: u32, sh_degree: u32, width: u32, height: u32) -> Self {
        let one = Self { slots: 1, queues: 1, views: 1, scenes: 1, ..Self::default() };
        Self { gaussians, sh_degree, width, height, ..one }
    }

    /// Returns the staging bytes of an update of `gaussians` Gaussians of a scene with this SH degree.
    pub fn update_bytes(gaussians: u32, sh_degree: u32) -> u64 {
        u64::from(gaussians) * u64::from(crate::frame::parameter_planes(sh_degree)) * 16
    }

    /// Returns a copy that fits the needs of a frame. Unchanged if the frame fitted, or if it needs more than can be
    /// counted (`instances_needed` is `u32::MAX`). Keep the copy only after [`super::Renderer::grow`] has succeeded;
    /// otherwise continue with the old one.
    pub fn grown(&self, report: &SlotReport) -> Self {
        let mut grown = *self;
        // The frame may have been recorded before the reservation grew.
        let counted = report.instances_needed != u32::MAX;
        if counted && report.instances_needed > report.instance_capacity.max(self.instances) {
            // Adds a reserve of half, because later frames will need other numbers.
            grown.instances = report.instances_needed.saturating_add(report.instances_needed / 2);
        }
        if report.blend_passes_needed > report.blend_passes.max(self.blend_passes) {
            grown.blend_passes = report.blend_passes_needed;
        }
        grown
    }

    /// Outputs of frames besides the picture and its depth.
    pub(super) fn outputs(&self) -> Outputs {
        Outputs { pick: self.pick, motion: self.motion, surface: self.surface.is_some() }
    }

    /// True if slots keep a depth beside their pixels.
    pub(super) fn keeps_depth(&self) -> bool {
        !self.images_only && (self.inverse_depth || self.expected_depth)
    }

    /// True if frames may have enough scenes for batches, which one dispatch draws.
    pub(super) fn has_batches(&self) -> bool {
        self.scenes >= MIN_SCENES
    }

    pub(super) fn check(&self) -> Result<()> {
        let sides = 1..=crate::scene::camera::MAX_IMAGE_SIDE;
        if !sides.contains(&self.width) || !sides.contains(&self.height) {
            let (width, height, max) = (self.width, self.height, sides.end());
            let problem = format!("width and height are {width} x {height}, each may be 1 to {max}");
            return Err(Error::argument("reservation", problem));
        }
        // The upper bounds exceed what any device can hold.
        let counts = [
            ("slots", self.slots, 1..=1024),
            ("queues", self.queues, 1..=1024),
            ("views", self.views, 1..=1024),
            ("scenes", self.scenes, 1..=Self::MAX_SCENES),
            ("blend_passes", self.blend_passes, 0..=65_536),
            ("sh_degree", self.sh_degree, 0..=3),
            ("cut_outs", self.cut_outs, 0..=Self::MAX_SCENES * MAX_CUT_OUTS as u32),
        ];
        match counts.into_iter().find(|(_, count, range)| !range.contains(count)) {
            Some((field, count, range)) => {
                let problem = format!("{field} is {count}, it may be {} to {}", range.start(), range.end());
                Err(Error::argument("reservation", problem))
            }
            None => Ok(()),
        }
    }

    /// Returns the variants of culling and projection that scenes may need.
    pub(super) fn scene_variants(&self) -> Vec<FrameVariant> {
        // Kernels of motion and of surfaces belong to the projection, and depend on nothing but the cameras.
        let outputs = self.outputs();
        let plain = |projection| FrameVariant { projection, outputs, ..FrameVariant::default() };
        let features: [Feature; 7] = [
            (self.rolling_shutter, |v| v.shutter = v.projection != Projection::Orthographic),
            (self.filter_3d, |v| v.filter_3d = true),
            (self.tint, |v| v.tinted = true),
            (self.cut_outs > 0, |v| v.cut_outs = true),
            (self.selection, |v| v.selection = true),
            (self.shared_sort, |v| v.shared_order = true),
            (self.distance_order, |v| v.distance_order = may_order_by_distance(v.projection)),
        ];
        let stored = |variant: FrameVariant| {
            let storages =
                [(true, ShStorage::F32), (self.half_sh, ShStorage::Half), (self.byte_sh, ShStorage::Bytes)];
            let reserved = storages.into_iter().filter(|(reserved, _)| *reserved);
            reserved.map(move |(_, sh_storage)| FrameVariant { sh_storage, ..variant })
        };
        combined(self.projections().map(plain).flat_map(stored).collect(), &features)
    }

    /// Returns the projections of the frames' cameras.
    fn projections(&self) -> impl Iterator<Item = Projection> {
        Projection::ALL.into_iter().filter(|projection| match projection {
            Projection::Perspective => true,
            Projection::Orthographic => self.orthographic,
            lens => self.lens == Some(*lens),
        })
    }

    /// Returns the variants of blending that frames may need.
    pub(super) fn blend_variants(&self) -> Vec<FrameVariant> {
        let plain =
            FrameVariant { surface_depth: self.surface.unwrap_or_default(), ..FrameVariant::default() };
        let inverse = FrameVariant { inverse_depth: true, ..plain };
        let expected = FrameVariant { expected_depth: true, ..inverse };
        let depths = [(true, plain), (self.inverse_depth, inverse), (self.expected_depth, expected)];
        let depths = depths.into_iter().filter(|(reserved, _)| *reserved).map(|(_, variant)| variant);
        let with_outputs =
            |variant| self.outputs().subsets().map(move |outputs| FrameVariant { outputs, ..variant });
        let features: [Feature; 4] = [
            (self.lens.is_some_and(Projection::has_seam), |v| v.projection = Projection::Equirectangular),
            (self.occlusion, |v| v.depth_limit = true),
            (self.distance_order, |v| v.distance_order = v.depth_limit),
            // Any frame may draw ellipsoids.
            (true, |v| v.steep = true),
        ];
        combined(depths.flat_map(with_outputs).collect(), &features)
    }

    /// Returns the fields that a frame of this variant needs and that are not set, with commas; None if there are none.
    /// `previous`: projection of the previous camera, for motion.
    pub(super) fn lacks(&self, frame: FrameVariant, previous: Option<Projection>) -> Option<String> {
        let has = |projection| frame.projection == projection || previous == Some(projection);
        let needs = [
            ("occlusion", frame.depth_limit, self.occlusion),
            ("expected_depth", frame.expected_depth, self.expected_depth),
            ("inverse_depth", frame.inverse_depth && !frame.expected_depth, self.inverse_depth),
            ("filter_3d", frame.filter_3d, self.filter_3d),
            ("distance_order", frame.distance_order, self.distance_order),
            ("orthographic", has(Projection::Orthographic), self.orthographic),
            ("lens", frame.projection.is_lens(), self.lens == Some(frame.projection)),
            ("rolling_shutter", frame.shutter, self.rolling_shutter),
        ];
        let outputs = frame.outputs.named().into_iter().zip(self.outputs().named());
        let needs = needs.into_iter().chain(outputs.map(|((field, needed), (_, set))| (field, needed, set)));
        let lacking = needs.filter(|(_, needed, set)| *needed && !set).map(|(field, ..)| field);
        // Allocates no list, so that the usual case costs nothing.
        lacking.map(field_name).reduce(|all, field| all + ", " + &field)
    }

    /// Checks that the features of a frame's scene are reserved.
    #[inline]
    pub(super) fn check_scene(&self, index: usize, stored: ShStorage, own: &SceneSettings) -> Result<()> {
        let lacks = |field: &str, what: &str| {
            Err(Error::argument(field_name(field), format!("not reserved, and scenes[{index}] has {what}")))
        };
        if own.is_tinted() && !self.tint {
            return lacks("tint", "a tint or an opacity");
        }
        if own.mask().is_some() && !self.selection {
            return lacks("selection", "a selection");
        }
        if stored == ShStorage::Half && !self.half_sh {
            return lacks("half_sh", "SH in halves");
        }
        if stored == ShStorage::Bytes && !self.byte_sh {
            return lacks("byte_sh", "SH in bytes");
        }
        Ok(())
    }

    /// Returns the passes of blending of each frame. A tile has no more entries than there are Gaussians.
    fn passes(&self, sizes: &LaunchSizes) -> u32 {
        match self.blend_passes {
            0 => self.gaussians.div_ceil(sizes.entries_per_pass).clamp(1, 2),
            passes => passes,
        }
    }

    /// Returns the most dispatches of a recording of frames of this capacity.
    pub(super) fn dispatches(&self, context: &Context, capacity: &FrameCapacity) -> Result<usize> {
        const PER_FRAME: u32 = 48;
        // Scenes may be stored with a higher degree than the evaluated one, in more chunks.
        let plan = ScenePlan::new(context.limits(), self.gaussians, 3, ShStorage::F32)
            .or_else(|_| ScenePlan::new(context.limits(), self.gaussians, self.sh_degree, ShStorage::F32))
            .map_err(|error| error.of_field(field_name("gaussians")))?;
        // Per chunk of parameters: culling, projection, motion and surfaces. A scene's chunks may be half as large as others'.
        // Per scene: the ranges of its chunks.
        let of_chunk = 2 + u32::from(self.motion) + u32::from(self.surface.is_some());
        let projection = of_chunk * (2 * plan.chunks + self.scenes) + self.scenes;
        let sizes = LaunchSizes::new(context.limits());
        let blending = sizes.blend_ranges(capacity.instances).saturating_mul(capacity.blend_passes);
        Ok((PER_FRAME + blending + projection) as usize * self.views as usize)
    }

    /// Returns the capacity of each frame, if it fits the device's grids.
    pub(super) fn capacity(&self, context: &Context, sizes: &LaunchSizes) -> Result<FrameCapacity> {
        // Gaps between scenes are smaller than a block.
        let gaps = (self.scenes - 1).saturating_mul(sizes.elementwise_workgroup);
        let gaussians = self.gaussians.saturating_add(gaps);
        let pictures = PictureCapacity::of(self.width, self.height).without_backward();
        let capacity = FrameCapacity {
            gaussians,
            // A recorded frame cannot be run again.
            visible: gaussians,
            instances: match self.instances {
                0 => initial_instances(context.limits(), gaussians, &pictures),
                instances => instances,
            },
            scenes: self.scenes * if self.shared_sort { self.views } else { 1 },
            pictures,
            blend_passes: self.passes(sizes),
            depth: self.inverse_depth || self.expected_depth,
            outputs: self.outputs(),
            ..FrameCapacity::default()
        };
        check_grids(context.limits(), &capacity, sizes)
            .map_err(|error| error.of_field(field_name("width, height, gaussians, instances")))?;
        Ok(capacity)
    }
}

/// True if a feature is reserved, and how a variant gets it.
type Feature = (bool, fn(&mut FrameVariant));

/// Returns the variants with every combination of the reserved features.
fn combined(mut variants: Vec<FrameVariant>, features: &[Feature]) -> Vec<FrameVariant> {
    for (_, set) in features.iter().filter(|(reserved, _)| *reserved) {
        let mut with = variants.clone();
        with.iter_mut().for_each(set);
        variants.extend(with);
    }
    variants
}

/// Names a field in messages about frames.
pub(super) fn field_name(field: &str) -> String {
    format!("{RESERVATION}{field}")
}

pub(super) const RESERVATION: &str = "Reservation::";

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
