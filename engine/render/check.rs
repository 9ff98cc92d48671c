//! Checks of a frame before it is recorded: all errors are reported before the first command.

use super::device_scene::ELSEWHERE;
use super::recorded_frame::{HostImage, MotionTarget, Placed, RecordedFrame, SurfaceTarget, Target};
use super::renderer::Renderer;
use super::reservation::{RESERVATION, Reservation, field_name};
use super::updates::Update;
use crate::error::{Error, Result};
use crate::frame::{FrameCapacity, PictureCapacity, PlacedScene, RenderSettings, next_scene_begin};
use crate::scene::{Camera, DepthMapping};
use crate::vk::{Context, ImageUse};
use ash::vk;

/// Number of scenes that are checked and then placed together, so that they stay in the processor's first cache.
const SCENES_AT_ONCE: usize = 32;

/// Names the frame in messages about all of its scenes.
const THE_FRAME: &str = "scenes: the frame";

impl Renderer {
    /// Checks a frame before anything is recorded, adds its scenes to `all`, and returns how many Gaussians they draw.
    /// `earlier`: earlier views of the recording.
    pub(super) fn check_frame<'a>(
        &self,
        frame: &RecordedFrame<'a>,
        earlier: &[RecordedFrame<'_>],
        reserved: &Reservation,
        all: &mut Vec<PlacedScene<'a>>,
    ) -> Result<u64> {
        frame.camera.check()?;
        // The target has its own background, so the settings' one is not checked.
        let settings = RenderSettings { background: [0.0; 3], ..*frame.settings };
        settings.check().map_err(|error| error.within("settings"))?;
        let context = &self.context;
        if frame.scenes.is_empty() {
            return Err(Error::argument("scenes", "there are none"));
        }
        if frame.scenes.len() > reserved.scenes as usize {
            let problem =
                format!("{} of them, Reservation::scenes is {}", frame.scenes.len(), reserved.scenes);
            return Err(Error::argument("scenes", problem));
        }
        // One pass over the scenes, because there may be thousands.
        let block = self.runner.forward.sizes.elementwise_workgroup;
        let (mut gaussians, mut first, mut cut_outs) = (0, 0, 0);
        for (number, scenes) in frame.scenes.chunks(SCENES_AT_ONCE).enumerate() {
            for (index, placed) in (number * SCENES_AT_ONCE..).zip(scenes) {
                let degree = placed.active_degree(frame.settings);
                check_scene(index, placed, degree, context, reserved)?;
                gaussians += u64::from(placed.drawn_gaussians());
            }
            all.extend(scenes.iter().map(|placed| {
                let in_frame = placed.in_frame(frame, first, cut_outs);
                first = next_scene_begin(first.saturating_add(placed.drawn_gaussians()), block);
                cut_outs += placed.settings.cut_out_count();
                in_frame
            }));
        }
        self.check_images(frame, earlier)?;
        if cut_outs > reserved.cut_outs {
            let limit = (reserved.cut_outs.into(), "Reservation::cut_outs");
            return Err(Error::too_large(THE_FRAME, (cut_outs.into(), "cut-outs"), limit));
        }
        let previous = frame.motion.map(|motion| motion.previous_camera);
        if previous.is_some_and(|previous| previous.has_lens() || frame.camera.has_lens()) {
            let problem = "takes pinholes or orthographic cameras, without a lens or a rolling shutter";
            return Err(Error::argument("motion", problem));
        }
        let unsupported = [
            (
                "settings.dropout",
                frame.settings.dropout.is_some(),
                "is of training, no recorded frame has it",
            ),
            (
                "settings.linear_depth",
                frame.settings.has_z_record(),
                "is of training, no recorded frame has it",
            ),
            (
                "settings.surface",
                frame.settings.surface.is_some(),
                "give RecordedFrame::surface in its place",
            ),
        ];
        if let Some((field, _, problem)) = unsupported.iter().find(|(_, set, _)| *set) {
            return Err(Error::argument(*field, *problem));
        }
        if let (Some(SurfaceTarget { depth, .. }), Some(reserved)) = (frame.surface, reserved.surface)
            && reserved != depth
        {
            let problem = format!("is {depth:?}, and {reserved:?} is reserved (Reservation::surface)");
            return Err(Error::argument("surface.depth", problem));
        }
        let previous = previous.map(|camera| camera.projection);
        if let Some(fields) = reserved.lacks(frame.variant(), previous) {
            return Err(Error::argument(fields, "not reserved, and the frame needs it"));
        }
        if self.slots.blending != self.blending() {
            let problem = "its kernels are not built: call Renderer::reserve after Renderer::set_blending";
            return Err(Error::argument("kind of frame", problem));
        }
        check_updates(frame.updates, context, reserved)?;
        Ok(gaussians)
    }

    fn check_images(&self, frame: &RecordedFrame<'_>, earlier: &[RecordedFrame<'_>]) -> Result<()> {
        let size = [frame.camera.width, frame.camera.height];
        let is_new = |host: &HostImage<'_>| earlier.iter().all(|view| view.purpose_of(host.image).is_none());
        for (purpose, host) in frame.images() {
            self.check_image(purpose, &host, size)?;
        }
        for (host, contents) in frame.written() {
            let field = contents.purpose().field();
            in_field(field, contents.check(host.image))?;
            if contents.keeps_texels() && is_new(&host) {
                check_is_defined(field, &host)?;
            }
        }
        if let Some(motion) = &frame.motion {
            check_previous_camera(motion, size)?;
        }
        if let Some(occluder) = &frame.occluder {
            if is_new(&occluder.depth) {
                check_is_defined("occluder", &occluder.depth)?;
            }
            let DepthMapping { scale, offset, clear_value, .. } = occluder.mapping;
            if !(scale.is_finite() && offset.is_finite() && clear_value.is_finite()) {
                return Err(Error::argument("occluder.mapping", "holds numbers that are not finite"));
            }
            if scale == 0.0 {
                let problem = "has a scale of 0: all depths would be one; HostView::camera gives the mapping of a projection";
                return Err(Error::argument("occluder.mapping", problem));
            }
        }
        for (index, (purpose, host)) in frame.images().enumerate() {
            let mut before = frame.images().take(index);
            if let Some((other, _)) = before.find(|(_, other)| other.image.is_same_as(host.image)) {
                let problem =
                    format!("is also its {}: a frame takes an image for one purpose", other.field());
                return Err(Error::argument(field_of(purpose.field(), &host), problem));
            }
        }
        Ok(())
    }

    /// Checks an image that receives or hides a frame of this size, px.
    fn check_image(&self, purpose: ImageUse, host: &HostImage<'_>, size: [u32; 2]) -> Result<()> {
        let bad = |problem: String| Err(Error::argument(field_of(purpose.field(), host), problem));
        let ([x, y], [width, height], [w, h]) = (host.offset, host.image.size(), size);
        if !host.image.belongs_to(&self.context) {
            return bad("it belongs to another context".into());
        }
        in_field(purpose.field(), host.image.check_purpose(purpose))?;
        match x.saturating_add(w) > width || y.saturating_add(h) > height {
            true => bad(format!("{w} x {h} pixels at ({x}, {y}) exceed its {width} x {height}")),
            false => Ok(()),
        }
    }
}

/// Names a field of a frame and its image.
fn field_of(field: &str, host: &HostImage<'_>) -> String {
    format!("{field} (image '{}')", host.image.name())
}

/// Prefixes an error with the field, whether it names the image or another field.
fn in_field(field: &str, checked: Result<()>) -> Result<()> {
    checked.map_err(|error| match error {
        Error::Argument { what, problem } if what.starts_with("image '") => {
            Error::Argument { what: format!("{field} ({what})"), problem }
        }
        other => other.within(field),
    })
}

/// Checks the previous camera of motion, for a frame of this size.
fn check_previous_camera(motion: &MotionTarget<'_>, [w, h]: [u32; 2]) -> Result<()> {
    let camera = motion.previous_camera;
    camera.check().map_err(|error| error.of("motion.previous_camera"))?;
    if [camera.width, camera.height] == [w, h] {
        return Ok(());
    }
    let problem = format!("is of {} x {} pixels, the frame of {w} x {h}", camera.width, camera.height);
    Err(Error::argument("motion.previous_camera", problem))
}

/// Returns an error if the frame needs the image's contents but the layout UNDEFINED discards them.
fn check_is_defined(field: &str, host: &HostImage<'_>) -> Result<()> {
    if host.from.layout != vk::ImageLayout::UNDEFINED {
        return Ok(());
    }
    let problem = "the frame needs its contents, and from the layout UNDEFINED they are lost";
    Err(Error::argument(field_of(field, host), problem))
}

/// Checks a scene of a frame that evaluates it with this SH degree.
#[inline]
fn check_scene(
    index: usize,
    placed: &Placed<'_>,
    degree: u32,
    context: &Context,
    reserved: &Reservation,
) -> Result<()> {
    if !placed.scene.belongs_to(context) {
        return Err(Error::argument(format!("scenes[{index}].scene"), ELSEWHERE));
    }
    placed.pose.check().map_err(|error| error.within(format_args!("scenes[{index}]")))?;
    if let Some(pose) = &placed.previous_pose {
        pose.check().map_err(|error| error.of(format!("scenes[{index}].previous_pose")))?;
    }
    let named = |error: Error| error.within(format_args!("scenes[{index}].settings"));
    placed.settings.check().map_err(named)?;
    placed.settings.check_mask(placed.scene.count(), context).map_err(named)?;
    if placed.settings.draws() && degree > reserved.sh_degree {
        let problem = format!("is {}, and scenes[{index}] is drawn with degree {degree}", reserved.sh_degree);
        return Err(Error::argument(field_name("sh_degree"), problem));
    }
    reserved.check_scene(index, placed.scene.plan().sh_storage, &placed.settings)
}

fn check_updates(updates: &[Update<'_>], context: &Context, reserved: &Reservation) -> Result<()> {
    let mut bytes = 0;
    for (index, update) in updates.iter().enumerate() {
        let plan = update.scene.plan();
        let shapes = update.gaussians.check_shapes();
        shapes.map_err(|error| error.within(format_args!("updates[{index}].gaussians")))?;
        if !update.scene.belongs_to(context) {
            return Err(Error::argument(format!("updates[{index}].scene"), ELSEWHERE));
        }
        let count = update.gaussians.len() as u64;
        if u64::from(update.first) + count > u64::from(plan.capacity) {
            let problem =
                format!("{count} Gaussians at {} exceed the scene's {}", update.first, plan.capacity);
            return Err(Error::argument(format!("updates[{index}].first"), problem));
        }
        bytes += count * u64::from(plan.planes) * 16;
    }
    if bytes > reserved.staging_bytes {
        let limit = (reserved.staging_bytes, "Reservation::staging_bytes");
        return Err(Error::too_large("updates: the frame", (bytes, "bytes"), limit));
    }
    Ok(())
}

/// Checks that the capacity suffices for a frame and its placed scenes.
pub(super) fn check_capacity(
    frame: &RecordedFrame<'_>,
    placed: &[PlacedScene<'_>],
    capacity: &FrameCapacity,
    reserved: &Reservation,
) -> Result<()> {
    let (needed, pictures) = (PictureCapacity::of_cameras([frame.camera]), capacity.pictures);
    let bounds = [("pixels", needed.pixels, pictures.pixels), ("tiles", needed.tiles, pictures.tiles)];
    for (unit, needed, limit) in bounds {
        if needed > limit {
            let (Camera { width: w, height: h, .. }, Reservation { width, height, .. }) =
                (frame.camera, reserved);
            let what = format!("camera: a picture of {w} x {h}, where {width} x {height} are reserved,");
            return Err(Error::too_large(what, (needed, unit), (limit, "Reservation::width, height")));
        }
    }
    // If the last scene ends within the reserved Gaussians, the gaps between scenes fit too.
    let end = placed.last().map_or(0, |last| u64::from(last.first) + u64::from(last.drawn_gaussians()));
    if end > u64::from(capacity.gaussians) {
        let needed = frame.scenes.iter().map(|s| u64::from(s.drawn_gaussians())).sum();
        let limit = (reserved.gaussians.into(), "Reservation::gaussians");
        return Err(Error::too_large(THE_FRAME, (needed, "Gaussians"), limit));
    }
    Ok(())
}

/// Checks views against each other, before each is checked alone.
pub(super) fn check_views(
    views: &[RecordedFrame<'_>],
    releases: usize,
    reserved: &Reservation,
) -> Result<()> {
    if views.is_empty() {
        return Err(Error::argument("views", "there are none"));
    }
    if views.len() > reserved.views as usize {
        let problem = format!("{} of them, Reservation::views is {}", views.len(), reserved.views);
        return Err(Error::argument("views", problem));
    }
    if releases != views.len() {
        let problem = format!("{releases} of them, there are {} views", views.len());
        return Err(Error::argument("releases", problem));
    }
    (0..views.len()).try_for_each(|index| {
        let checked = check_beside(views, index, reserved);
        checked.map_err(|error| in_view(error, index, views))
    })
}

/// Checks the view at `index` against the earlier ones.
fn check_beside(views: &[RecordedFrame<'_>], index: usize, reserved: &Reservation) -> Result<()> {
    let (frame, earlier) = (&views[index], &views[..index]);
    if matches!(frame.target, Target::Slot) {
        if reserved.images_only {
            let problem = "is reserved, and the frame has no image as its target";
            return Err(Error::argument(field_name("images_only"), problem));
        }
        if views.len() > 1 {
            let problem = "is the slot's own buffer, which holds one view: give an image";
            return Err(Error::argument("target", problem));
        }
    }
    if !earlier.is_empty() && !frame.updates.is_empty() {
        return Err(Error::argument("updates", "belong into views[0]: all views see them"));
    }
    for (purpose, host) in frame.images() {
        let others = earlier.iter().map(RecordedFrame::images).enumerate();
        let others =
            others.flat_map(|(view, images)| images.map(move |(other, theirs)| (view, other, theirs)));
        for (view, other, theirs) in others.filter(|(.., theirs)| theirs.image.is_same_as(host.image)) {
            let differs = if theirs.image.purpose() != host.image.purpose() {
                "the views take it for different purposes"
            } else if theirs.image.other_family() != host.image.other_family() {
                "they say that other queue families own it"
            } else {
                continue;
            };
            let problem = format!("is also views[{view}].{}: {differs}", other.field());
            return Err(Error::argument(field_of(purpose.field(), &host), problem));
        }
    }
    Ok(())
}

/// Names the view of an error, if there are several views.
pub(super) fn in_view(error: Error, index: usize, views: &[RecordedFrame<'_>]) -> Error {
    if views.len() == 1 {
        return error;
    }
    let view = format!("views[{index}]");
    match error {
        // The field belongs to the reservation; the frame and its scenes belong to the view.
        Error::Argument { what, problem } if what.starts_with(RESERVATION) => {
            Error::argument(what, format!("{problem}, in {view}"))
        }
        Error::TooLarge { what, needed, unit, limit, limit_name } => {
            Error::too_large(format!("{view}.{what}"), (needed, unit), (limit, limit_name))
        }
        other => other.within(&view),
    }
}
