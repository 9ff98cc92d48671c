//! A frame to record, its outputs, its recording, and its report.

use super::scenes::{keep, scenes, updates};
use super::*;
use crate::recording_cache::{List, collected};
use ashsplat::ash::{vk, vk::Handle};
use ashsplat::vk::ImageState;
use ashsplat::{
    Background, ColorEncoding, DepthTarget, HostImage, MotionTarget, Occluder, Placed, RecordedFrame,
    Release, SlotReport, SurfaceDepth, SurfaceTarget, Target, Update,
};
use std::ffi::c_void;

/// The background that the splats are composited over.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AshsplatBackground {
    /// A background colour; the result is opaque.
    Color = 0,
    /// Nothing: premultiplied colour and alpha.
    Nothing = 1,
    /// The image's content.
    Image = 2,
}

/// Meaning of the colours that are written into a target.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AshsplatColorEncoding {
    /// The values that the splats were trained in: those of photographs, display-encoded by the curve of sRGB.
    AsTrained = 0,
    /// Linear light with the primaries of sRGB, decoded after blending. Premultiplied colours are decoded before the product
    /// with alpha. A target of an sRGB format encodes them again.
    LinearSrgb = 1,
}

/// The image that a frame's colours are written to.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatTarget {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// The background: an AshsplatBackground.
    pub behind: u32,
    /// Its colour, for AshsplatBackground_Color: display-encoded, as trained.
    pub background: [f32; 3],
    /// Meaning of the target's colours: an AshsplatColorEncoding.
    pub encoding: u32,
    /// Factor of linear light, finite and positive, for AshsplatColorEncoding_LinearSrgb: 1 by default.
    pub exposure: f32,
    /// The image.
    pub to: AshsplatHostImage,
}

/// A host's depth image. It hides the splats that are farther away.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatOccluder {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// The depth image, adopted for AshsplatImageUse_Occluder.
    pub depth: AshsplatHostImage,
    /// How to read it: ashsplat_camera_from_matrices.
    pub mapping: AshsplatDepthMapping,
}

/// An image of expected depth: sum(w z) / sum(w), world units.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatDepthTarget {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// A pixel is empty if the splats' weights sum to less.
    pub min_weight: f32,
    /// The depth of empty pixels.
    pub empty: f32,
    /// The r32f image.
    pub to: AshsplatHostImage,
}

/// A pose in the world: x_world = scale rotation x_object + translation.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatPose {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// A rotation, row by row.
    pub world_from_object: [f32; 9],
    /// World units.
    pub translation: [f32; 3],
    /// World units per unit of the scene, the same in all directions: 1 for no scaling.
    pub scale: f32,
}

/// An image of what is picked at each pixel: the Gaussian with the largest blending weight alpha T, the nearest of equal ones.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct AshsplatPickTarget {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// A storage image of format R32G32B32A32_UINT. A texel is the index of the Gaussian in its scene, the index of the scene in
    /// AshsplatRecordedFrame.scenes, the bits of the float of its depth z (world units), and the bits of the float of its weight.
    /// Where nothing is blended, the first two are UINT32_MAX, the others 0. Its image is never NULL: AshsplatRecordedFrame.pick
    /// is NULL in a frame without picks.
    pub to: AshsplatHostImage,
}

/// An image of motion: for each pixel the mean motion on the screen of the blended Gaussians, from the previous frame to
/// this one, weighted as in blending. A Gaussian moves as its mean does, at most by the picture's width and height. Its
/// motion is 0 if its earlier place is unknown: its mean was not in front of the earlier camera (z above 0.2), or too far
/// away for a float. Motion by updates is not included.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct AshsplatMotionTarget {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// A pixel is empty if the splats' weights sum to less.
    pub min_weight: f32,
    /// The motion of empty pixels, pixels.
    pub empty: [f32; 2],
    /// True if empty pixels keep the image's contents instead of `empty`.
    pub keeps_empty: bool,
    /// The camera of the previous frame, of the same width and height. Motion is measured from its own principal point to
    /// that of the frame's camera. Earlier poses are in AshsplatPlaced.
    pub previous_camera: *const AshsplatCamera,
    /// A storage image of format R16G16_SFLOAT, with MUTABLE_FORMAT (AshsplatForeignImage.flags): the place now minus the
    /// place before, pixels, x right, y down. A point at pixel p was at p - motion. Its image is never NULL:
    /// AshsplatRecordedFrame.motion is NULL in a frame without motion.
    pub to: AshsplatHostImage,
}

/// Depth at which a pixel's surface lies.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AshsplatSurfaceDepth {
    /// The transmittance falls below a half.
    Median = 0,
    /// The transmittance falls below 0.7, which is nearer to the surfaces of scenes that were trained on colours alone.
    Front = 1,
}

/// The engine's depths in the order of AshsplatSurfaceDepth.
pub(super) fn surface_depths() -> [SurfaceDepth; 2] {
    [SurfaceDepth::Median, SurfaceDepth::Front]
}

/// An image of surfaces: for each pixel the normal and the depth of the surface.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct AshsplatSurfaceTarget {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// Kind of the surface's depth, an AshsplatSurfaceDepth: the same as AshsplatReservation.surface.
    pub depth: u32,
    /// A storage image of format R16G16B16A16_SFLOAT or R32G32B32A32_SFLOAT. A texel is the mean of the Gaussians' normals, weighted
    /// as in blending, of unit length in the camera's frame (x right, y down, z forward), and the surface's depth z there, world
    /// units. All are 0 without a surface, and the normal is 0 where normals cancel out. A Gaussian's normal is its shortest
    /// axis, turned towards the camera. Halves store depths below 65504, to 1 in 2000. Fisheyes and panoramas have the
    /// distance from the camera instead of z, all lenses that of the Gaussian's mean. Rolling shutters have the normals of
    /// the pose halfway. Its image is never NULL: AshsplatRecordedFrame.surface is NULL in a frame without surfaces.
    pub to: AshsplatHostImage,
}

/// A frame to record.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct AshsplatRecordedFrame {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// Number of scenes, at least one.
    pub scene_count: u32,
    /// Number of updates.
    pub update_count: u32,
    /// The scenes, whose Gaussians are sorted together.
    pub scenes: *const AshsplatPlaced,
    /// The camera; its width and height are the frame's.
    pub camera: *const AshsplatCamera,
    /// How to render, or NULL for the defaults.
    pub settings: *const AshsplatRenderSettings,
    /// The image that receives the colours, or NULL for the slot's own buffer (ashsplat_slot_pixels).
    pub target: *const AshsplatTarget,
    /// The host's depth image, which hides splats that are farther away, or NULL.
    pub occluder: *const AshsplatOccluder,
    /// The image that receives expected depth, or NULL.
    pub depth: *const AshsplatDepthTarget,
    /// Parameter updates before the frame.
    pub updates: *const AshsplatUpdate,
    /// The image that receives picks, or NULL: none are computed then.
    pub pick: *const AshsplatPickTarget,
    /// The image that receives motion, or NULL: none is computed then.
    pub motion: *const AshsplatMotionTarget,
    /// The image that receives normals and depths of the surface, or NULL: none are computed then.
    pub surface: *const AshsplatSurfaceTarget,
}

/// The state after a recording. The next user of its results waits for these stages and accesses, and finds
/// the images in these layouts.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatRelease {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// VkPipelineStageFlags2 that write results.
    pub stages: u64,
    /// VkAccessFlags2 that they write with.
    pub accesses: u64,
    /// Last use of the target.
    pub color: AshsplatImageState,
    /// Last use of the host's depth image.
    pub occluder: AshsplatImageState,
    /// Last use of the image of expected depth.
    pub depth: AshsplatImageState,
    /// Last use of the image of what is picked.
    pub pick: AshsplatImageState,
    /// Last use of the image of motion.
    pub motion: AshsplatImageState,
    /// Last use of the image of surfaces.
    pub surface: AshsplatImageState,
}

impl From<&Release> for AshsplatRelease {
    fn from(r: &Release) -> Self {
        let state = |s: Option<ImageState>| s.map(AshsplatImageState::from).unwrap_or_default();
        Self {
            stages: r.stages.as_raw(),
            accesses: r.accesses.as_raw(),
            color: state(r.color),
            occluder: state(r.occluder),
            depth: state(r.depth),
            pick: state(r.pick),
            motion: state(r.motion),
            surface: state(r.surface),
            ..Self::default()
        }
    }
}

/// The report of a recorded frame.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatSlotReport {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// True if the frame has finished. The other fields are valid only then.
    pub finished: bool,
    /// True if more instances (`instances_needed` for `instance_capacity`) or passes (`blend_passes_needed` for
    /// `blend_passes`) are needed than there were. The picture then lacks the Gaussians farthest away, or all of them if
    /// `instances_needed` is `UINT32_MAX`. ashsplat_reservation_grown enlarges the reservation, except in the last case.
    pub overflow: bool,
    /// Gaussians in the frame's scenes, without those of scenes that are not drawn.
    pub gaussians: u32,
    /// Visible Gaussians.
    pub visible: u32,
    /// (tile, Gaussian) instances that the picture needs.
    pub instances_needed: u32,
    /// The frame's capacity in instances.
    pub instance_capacity: u32,
    /// Entries of the longest tile.
    pub longest_tile: u32,
    /// Passes of blending that the longest tile needs.
    pub blend_passes_needed: u32,
    /// Time on the device, nanoseconds; 0 without timestamps. With many views, only the recording's first 255 stages count.
    pub nanoseconds: f64,
    /// How often the recording sorts by depth: once for each view, or for each run of views that share it
    /// (AshsplatReservation.shared_sort).
    pub sorts: u32,
    /// Scenes that were drawn together with others by one dispatch, in all views: scenes of ashsplat_scenes_new, or one scene that
    /// is placed many times.
    pub batched_scenes: u32,
    /// Passes of blending that the frame was recorded with.
    pub blend_passes: u32,
    /// Entries of a tile that a pass takes.
    pub entries_per_pass: u32,
}

impl From<&AshsplatSlotReport> for SlotReport {
    fn from(r: &AshsplatSlotReport) -> Self {
        let mut report = Self::default();
        (report.instances_needed, report.instance_capacity) = (r.instances_needed, r.instance_capacity);
        (report.blend_passes_needed, report.blend_passes) = (r.blend_passes_needed, r.blend_passes);
        report
    }
}

impl From<SlotReport> for AshsplatSlotReport {
    fn from(r: SlotReport) -> Self {
        same_fields!(r => Self {
            overflow, gaussians, visible, instances_needed, instance_capacity, longest_tile, blend_passes_needed, sorts,
            batched_scenes, blend_passes, entries_per_pass,
        } with {
            finished: true,
            nanoseconds: r.scopes.iter().filter(|s| s.depth == 0).map(|s| s.nanoseconds).sum(),
            ..Self::default()
        })
    }
}

/// Converts a frame.
///
/// # Safety
/// The frame is valid with all that it points to.
unsafe fn recorded<'b>(
    f: &AshsplatRecordedFrame,
    scenes: &'b [Placed<'b>],
    updates: &'b [Update<'b>],
    scratch: &'b Scratch,
) -> Result<RecordedFrame<'b>> {
    // SAFETY: as promised.
    unsafe {
        let camera = scratch.alloc(read(f.camera, "camera")?.known("camera")?);
        let settings = read_if(f.settings, "settings")?.map(|settings| settings.checked()).transpose()?;
        let settings = scratch.alloc(settings.unwrap_or_default());
        let mut recorded = RecordedFrame { updates, ..RecordedFrame::new(scenes, camera, settings) };
        if let Some(AshsplatTarget { to, behind, background, encoding, exposure, .. }) =
            read_if(f.target, "target")?
        {
            let to = used(&to, "target.to.image")?;
            let all = [Background::Color(background), Background::Nothing, Background::Image];
            let behind = one_of("target.behind", behind, &all)?;
            let all = [ColorEncoding::AsTrained, ColorEncoding::LinearSrgb { exposure }];
            let encoding = one_of("target.encoding", encoding, &all)?;
            recorded.target = Target::Image { to, behind, encoding };
        }
        if let Some(AshsplatOccluder { depth, mapping, .. }) = read_if(f.occluder, "occluder")? {
            let depth = used(&depth, "occluder.depth.image")?;
            recorded.occluder = Some(Occluder { depth, mapping: mapping.into() });
        }
        if let Some(AshsplatDepthTarget { to, min_weight, empty, .. }) = read_if(f.depth, "depth")? {
            recorded.depth = Some(DepthTarget { to: used(&to, "depth.to.image")?, min_weight, empty });
        }
        if let Some(AshsplatPickTarget { to, .. }) = read_if(f.pick, "pick")? {
            recorded.pick = Some(used(&to, "pick.to.image")?);
        }
        if let Some(motion) = read_if(f.motion, "motion")? {
            let AshsplatMotionTarget { to, min_weight, empty, keeps_empty, previous_camera, .. } = motion;
            let name = "motion.previous_camera";
            let previous_camera = scratch.alloc(read(previous_camera, name)?.known(name)?);
            let (to, empty) = (used(&to, "motion.to.image")?, (!keeps_empty).then_some(empty));
            recorded.motion = Some(MotionTarget { to, previous_camera, min_weight, empty });
        }
        if let Some(AshsplatSurfaceTarget { to, depth, .. }) = read_if(f.surface, "surface")? {
            let depth = one_of("surface.depth", depth, &surface_depths())?;
            recorded.surface = Some(SurfaceTarget { to: used(&to, "surface.to.image")?, depth });
        }
        Ok(recorded)
    }
}

/// Converts a host's image.
///
/// # Safety
/// Its view is null or alive.
unsafe fn used<'a>(host: &AshsplatHostImage, what: &str) -> Result<HostImage<'a>> {
    // SAFETY: as promised.
    let image = unsafe { borrowed(host.image, what)? };
    Ok(HostImage { image: &image.0, from: host.from.into(), offset: host.offset })
}

/// Records frames as the views of one recording. Writes the final states of their images to `releases`: NULL, or room for all.
/// Allocates nothing on the heap once the renderer has recorded such frames, with these masks and updates no larger.
///
/// # Safety
/// Same as for ashsplat_record, for each frame.
pub(super) unsafe fn record(
    AshsplatRenderer(renderer, scratch, cache): &mut AshsplatRenderer,
    (commands, slot): (*mut c_void, u32),
    (frames, count): (*const AshsplatRecordedFrame, u32),
    releases: *mut AshsplatRelease,
) -> Result<()> {
    scratch.reset();
    cache.begin();
    let scratch = &*scratch;
    let of_view = |index: usize| {
        move |error: Error| if count == 1 { error } else { within(format_args!("frames[{index}]"))(error) }
    };
    // SAFETY: as promised.
    unsafe {
        let frames = collected(read_all(frames, count, "frames")?, scratch)?;
        let context = renderer.context();
        for (index, frame) in frames.iter().enumerate() {
            keep(frame, context, cache).map_err(of_view(index))?;
        }
        let cache = &*cache;
        let mut copies = cache.copies();
        let all = frames.iter().enumerate();
        let convert = |(index, frame)| {
            let both = scenes(frame, (scratch, cache))
                .and_then(|scenes| Ok((scenes, updates(frame, &mut copies, scratch)?)));
            both.map_err(of_view(index))
        };
        let lists = collected(all.clone().map(convert), scratch)?;
        let view = |(index, frame): (usize, &AshsplatRecordedFrame)| {
            // Views with the same list share it here: the engine recognizes it by its address.
            let list = |f: &AshsplatRecordedFrame| (f.scenes, f.scene_count);
            let first = frames.iter().position(|other| list(other) == list(frame)).unwrap_or(index);
            recorded(frame, &lists[first].0, &lists[index].1, scratch).map_err(of_view(index))
        };
        let views = collected(all.map(view), scratch)?;
        let commands = context.adopt_commands(vk::CommandBuffer::from_raw(commands as u64))?;
        let mut left = List::from_iter_in(views.iter().map(|_| Release::default()), scratch);
        renderer.record_views(commands, slot, &views, &mut left).map_err(names::frame_in_c)?;
        let left = List::from_iter_in(left.iter().map(AshsplatRelease::from), scratch);
        write_if(releases, "releases", &left)
    }
}
