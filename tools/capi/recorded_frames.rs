//! Conversion of a C host's frames for recording.

use super::foreign::used;
use super::kept::Kept;
use super::scratch::{List, Scratch, collected};
use super::structs::{read, read_all_in, read_if, within, write_all_if};
use super::{
    AshsplatDepthTarget, AshsplatOccluder, AshsplatPlaced, AshsplatPose, AshsplatRecordedFrame,
    AshsplatRelease, AshsplatRenderer, auxiliary, borrowed, frames, scene_settings, scenes,
};
use ashsplat::ash::{vk, vk::Handle};
use ashsplat::scene::Camera;
use ashsplat::vk::Context;
use ashsplat::{
    DepthTarget, Error, Occluder, Placed, RecordedFrame, Release, RenderSettings, Result, Target, Update,
};
use std::ffi::c_void;

/// A frame with copies of everything that it points to.
struct Copied<'a> {
    frame: &'a AshsplatRecordedFrame,
    placed: List<'a, AshsplatPlaced>,
    pointees: List<'a, scene_settings::Pointees<'a>>,
    updates: List<'a, scenes::Copied<'a>>,
    camera: Camera,
    settings: RenderSettings,
    motion: Option<auxiliary::Motion>,
}

impl<'a> Copied<'a> {
    /// # Safety
    /// The frame is valid with all that it points to.
    unsafe fn of(
        frame: &'a AshsplatRecordedFrame,
        context: &Context,
        (scratch, kept): (&'a Scratch, &'a Kept),
    ) -> Result<Self> {
        // SAFETY: as promised.
        unsafe {
            let placed = read_all_in(scratch, frame.scenes, frame.scene_count, "scenes")?;
            let pointees = scene_settings::pointees(&placed, context, (scratch, kept))?;
            let updates = read_all_in(scratch, frame.updates, frame.update_count, "updates")?;
            let settings = read_if(frame.settings, "settings")?;
            Ok(Self {
                frame,
                placed,
                pointees,
                updates: scenes::copied(&updates, (scratch, kept))?,
                camera: read(frame.camera, "camera")?.known()?,
                settings: settings.map_or(Ok(RenderSettings::default()), |settings| settings.checked())?,
                motion: auxiliary::Motion::read(frame.motion)?,
            })
        }
    }

    /// # Safety
    /// Same as for [`Copied::of`].
    unsafe fn scenes<'b>(&'b self, scratch: &'b Scratch) -> Result<List<'b, Placed<'b>>> {
        let mut scenes = List::with_capacity_in(self.placed.len(), scratch);
        for (place, (placed, own)) in self.placed.iter().zip(&self.pointees).enumerate() {
            // SAFETY: as promised.
            unsafe {
                let scene = borrowed(placed.scene, "scene");
                let scene = &scene.map_err(within(format_args!("scenes[{place}]")))?.scene;
                let previous_pose = read_if(placed.previous_pose, "previous_pose");
                let previous_pose = previous_pose.map_err(within(format_args!("scenes[{place}]")))?;
                scenes.push(Placed {
                    settings: scene_settings::of(own),
                    previous_pose: previous_pose.as_ref().map(AshsplatPose::pose),
                    ..Placed::at(scene, placed.pose())
                });
            }
        }
        Ok(scenes)
    }

    /// # Safety
    /// Same as for [`Copied::of`].
    unsafe fn recorded<'b>(
        &'b self,
        scenes: &'b [Placed<'b>],
        updates: &'b [Update<'b>],
    ) -> Result<RecordedFrame<'b>> {
        let f = self.frame;
        let mut recorded =
            RecordedFrame { updates, ..RecordedFrame::new(scenes, &self.camera, &self.settings) };
        // SAFETY: as promised.
        unsafe {
            if let Some(target) = read_if(f.target, "target")? {
                recorded.target = Target::Image {
                    to: used(&target.to, "target.to.image")?,
                    behind: frames::behind(target.behind, target.background)?,
                    encoding: frames::encoding(target.encoding, target.exposure)?,
                };
            }
            if let Some(AshsplatOccluder { depth, mapping, .. }) = read_if(f.occluder, "occluder")? {
                let depth = used(&depth, "occluder.depth.image")?;
                recorded.occluder = Some(Occluder { depth, mapping: mapping.into() });
            }
            if let Some(AshsplatDepthTarget { to, min_weight, empty, .. }) = read_if(f.depth, "depth")? {
                recorded.depth = Some(DepthTarget { to: used(&to, "depth.to.image")?, min_weight, empty });
            }
            recorded.pick = auxiliary::pick(f.pick)?;
            recorded.motion = self.motion.as_ref().map(|motion| motion.target()).transpose()?;
        }
        Ok(recorded)
    }
}

/// Fields with other names in C.
const FIELDS: [(&str, &str); 5] = [
    ("target.encoding.exposure", "target.exposure"),
    ("target.behind", "target.background"),
    (".selection.mask (buffer 'selection')", ".selection"),
    (".selection.color", ".selection_color"),
    (".selection.share", ".selection_share"),
];

/// Records frames as the views of one recording. Writes the final states of their images to `releases`: NULL, or room for all.
/// Allocates nothing on the heap once the renderer has recorded such frames, with these masks and updates no larger.
///
/// # Safety
/// Same as for ashsplat_record, for each frame.
pub(super) unsafe fn record(
    AshsplatRenderer(renderer, scratch, kept): &mut AshsplatRenderer,
    (commands, slot): (*mut c_void, u32),
    (frames, count): (*const AshsplatRecordedFrame, u32),
    releases: *mut AshsplatRelease,
) -> Result<()> {
    scratch.reset();
    kept.begin();
    let (scratch, kept) = (&*scratch, &*kept);
    let of_view = |index: usize| {
        move |error: Error| if count == 1 { error } else { within(format_args!("frames[{index}]"))(error) }
    };
    // SAFETY: as promised.
    unsafe {
        let frames = read_all_in(scratch, frames, count, "frames")?;
        let context = renderer.context();
        let copied = frames.iter().enumerate();
        let copied =
            copied.map(|(index, frame)| Copied::of(frame, context, (scratch, kept)).map_err(of_view(index)));
        let copied = collected(copied, scratch)?;
        let scenes = copied.iter().enumerate();
        let scenes = scenes.map(|(index, own)| own.scenes(scratch).map_err(of_view(index)));
        let scenes = collected(scenes, scratch)?;
        let updates = copied.iter().map(|own| scenes::updates(&own.updates, scratch));
        let updates = List::from_iter_in(updates, scratch);
        let mut views = List::with_capacity_in(frames.len(), scratch);
        for (index, own) in copied.iter().enumerate() {
            // Views with the same list share it here: the engine recognizes it by its address.
            let list = |f: &AshsplatRecordedFrame| (f.scenes, f.scene_count);
            let first = frames.iter().position(|frame| list(frame) == list(own.frame)).unwrap_or(index);
            views.push(own.recorded(&scenes[first], &updates[index]).map_err(of_view(index))?);
        }
        let commands = context.adopt_commands(vk::CommandBuffer::from_raw(commands as u64))?;
        let mut left = List::from_iter_in(views.iter().map(|_| Release::default()), scratch);
        renderer.record_views(commands, slot, &views, &mut left).map_err(in_c)?;
        let left = List::from_iter_in(left.iter().map(AshsplatRelease::from), scratch);
        write_all_if(releases, "releases", &left)
    }
}

/// Rewrites an error of a frame with the parameters' names in C. Most fields have the same name in both languages. In C a pose
/// is no single field, and a selection has several.
fn in_c(error: Error) -> Error {
    let named = |what: &str| {
        let what = match what.strip_prefix("views") {
            Some(rest) if rest.is_empty() || rest.starts_with('[') => format!("frames{rest}"),
            _ => what.to_owned(),
        };
        let what = what.strip_suffix(".pose").map(str::to_owned).unwrap_or(what);
        FIELDS.iter().fold(what, |what, (rust, c)| what.replace(rust, c))
    };
    match error {
        Error::Argument { what, problem } => {
            let what = match what.strip_suffix(".volume") {
                Some(cut_out) if problem.starts_with("an offset") => format!("{cut_out}.offset"),
                Some(cut_out) if problem.starts_with("a ") => format!("{cut_out}.size"),
                _ => what,
            };
            // The problem may name other views.
            let problem = problem.replace("views[", "frames[");
            let problem = ["adopted for ", ", not for "]
                .into_iter()
                .fold(problem, |said, words| said.replace(words, &format!("{words}AshsplatImageUse_")));
            Error::argument(named(&what), problem)
        }
        Error::TooLarge { what, needed, unit, limit, limit_name } => {
            Error::TooLarge { what: named(&what), needed, unit, limit, limit_name }
        }
        other => other,
    }
}
