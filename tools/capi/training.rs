//! Training in C: steps that submit and wait, and steps in a host's command buffer.

use super::scenes::gaussians;
use super::structs::{check_room, read, read_all, within, write, write_if};
use super::{
    AshsplatCamera, AshsplatContext, AshsplatGaussians, AshsplatRelease, AshsplatScene, AshsplatStatus,
    borrowed, borrowed_mut, give, guarded, slice, take, text,
};
use ashsplat::ash::{vk, vk::Handle};
use ashsplat::loss::DepthPoint;
use ashsplat::scene::{PointCloud, StoredPhoto};
use ashsplat::trainer::{Checkpoint, Maintenance, Preset, StepOutcome, StepReservation};
use ashsplat::{Error, Result, StepReport, TrainSettings, TrainView, Trainer};
use ashsplat_files::{CheckpointFile, Photo};
use serde_json::{Value, json};
use std::ffi::{c_char, c_void};

/// Trains Gaussians on photographs.
pub struct AshsplatTrainer(pub(super) Trainer);

/// A photograph to train on, and its camera.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatTrainView {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// The camera; its size is the photograph's.
    pub camera: *const AshsplatCamera,
    /// Red, green and blue of each pixel, a byte each, row by row.
    pub rgb: *const u8,
    /// A byte per pixel, row by row: those with 0 do not count. NULL: all count.
    pub mask: *const u8,
    /// The inverse depth that pixels should have, row by row, 1 / world units; infinite where it is not known. NULL: none.
    pub inverse_depth: *const f32,
    /// Sparse points that it shows, for the setting depth_points; not beside inverse_depth. Three floats each: where the photograph shows
    /// it, pixels, x to the right and y down, the first pixel's centre at 0, 0; and 1 / z in the camera's frame, 1 / world units. May be
    /// NULL.
    pub depth_points: *const f32,
    /// Their number.
    pub depth_point_count: u32,
    /// Which camera took it, by any number: views with the same one share lens effects.
    pub camera_id: u32,
}

/// The report of a training step.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatStep {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// Whether the step has finished. The other fields are valid only then.
    pub finished: bool,
    /// Whether it changed nothing, because a capacity was too small. ashsplat_trainer_maintain grows it. Then
    /// the iteration is recorded again.
    pub overflow: bool,
    /// Its iteration, from 1.
    pub iteration: u32,
    /// The loss before it; NaN if the iteration was skipped, because its frame exceeds the largest possible
    /// capacity.
    pub loss: f32,
    /// Gaussians in it.
    pub gaussians: u32,
    /// Gaussians visible in its view.
    pub visible: u32,
    /// (tile, Gaussian) instances that its view needs.
    pub instances: u32,
    /// Index of its view.
    pub view: u32,
}

impl From<&StepReport> for AshsplatStep {
    fn from(r: &StepReport) -> Self {
        Self {
            finished: true,
            overflow: false,
            iteration: r.iteration,
            loss: r.loss,
            gaussians: r.gaussians,
            visible: r.visible,
            instances: r.instances,
            view: r.view as u32,
            ..Self::default()
        }
    }
}

impl From<&StepOutcome> for AshsplatStep {
    fn from(outcome: &StepOutcome) -> Self {
        match outcome {
            StepOutcome::Done(report) => report.into(),
            &StepOutcome::Overflowed { iteration, instances_needed: instances, .. } => {
                Self { finished: true, overflow: true, iteration, instances, ..Self::default() }
            }
        }
    }
}

/// The report of ashsplat_trainer_maintain.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatMaintenance {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// Whether Gaussians were added and removed.
    pub densified: bool,
    /// Whether opacities were reset.
    pub opacities_reset: bool,
    /// Whether the capacity has grown.
    pub grown: bool,
    /// The iteration that was skipped, because its frame exceeds the largest possible capacity; 0 for none.
    /// The next step is the iteration after it.
    pub skipped: u32,
}

impl From<Maintenance> for AshsplatMaintenance {
    fn from(m: Maintenance) -> Self {
        Self {
            densified: m.densified.is_some(),
            opacities_reset: m.opacities_reset,
            grown: m.grown,
            skipped: m.skipped.unwrap_or(0),
            ..Self::default()
        }
    }
}

/// Uploads photographs and initial Gaussians, which are taken as they are: the settings initial_opacity and initial_scale are for
/// ashsplat_trainer_new_from_points. The context needs a queue. `scene_extent` is 1.1 times the largest distance of a camera to their
/// mean, or 0 to have it computed. `settings_json`: an object with the names of the reference implementation's settings,
/// `{"iterations": 7000}`. It may have `"preset": "fast"`, `"default"` or `"quality"`, or `"few_photos": true`, whose settings the others
/// change. Missing settings have the defaults of the preset or of the strategy, and NULL keeps all defaults.
///
/// # Safety
/// `context` is alive, `views` has `view_count` elements with arrays as the cameras say, `initial` is valid
/// with arrays as long as it says, `settings_json` is NULL or a C string, `trainer` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_new(
    context: *const AshsplatContext,
    views: *const AshsplatTrainView,
    view_count: u32,
    initial: *const AshsplatGaussians,
    scene_extent: f32,
    settings_json: *const c_char,
    trainer: *mut *mut AshsplatTrainer,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let (context, initial) = (borrowed(context, "context")?, read(initial, "initial")?);
        give(trainer, "trainer", || {
            let Run { views, settings, extent } = Run::of((views, view_count), scene_extent, settings_json)?;
            Trainer::new(&context.0, views, &gaussians(&initial)?, extent, settings).map(AshsplatTrainer)
        })
    })
}

/// As ashsplat_trainer_new, with Gaussians made of points: `positions` has three floats of each, world units, `colors` red, green and
/// blue, a byte each. Their scales follow from the distances of the nearest neighbours, as in the reference implementation; the
/// settings initial_opacity and initial_scale change them.
///
/// # Safety
/// As ashsplat_trainer_new; `positions` and `colors` have three elements for each of `point_count` points.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_new_from_points(
    context: *const AshsplatContext,
    views: *const AshsplatTrainView,
    view_count: u32,
    positions: *const f32,
    colors: *const u8,
    point_count: u32,
    scene_extent: f32,
    settings_json: *const c_char,
    trainer: *mut *mut AshsplatTrainer,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let (context, floats) = (borrowed(context, "context")?, 3 * point_count as usize);
        let positions = slice(positions, floats, "positions")?.as_chunks().0.to_vec();
        let colors = slice(colors, floats, "colors")?.as_chunks().0.to_vec();
        give(trainer, "trainer", || {
            let Run { views, settings, extent } = Run::of((views, view_count), scene_extent, settings_json)?;
            let points = PointCloud { positions, colors };
            let mut initial = ashsplat_files::initial_gaussians(&points, settings.sh_degree)?;
            settings.initialize(&mut initial);
            Trainer::new(&context.0, views, &initial, extent, settings).map(AshsplatTrainer)
        })
    })
}

/// Goes on from a file of ashsplat_trainer_checkpoint or of the program, to the same bits as a training that was never stopped. The
/// other arguments are those of the training that wrote it, except for the number of iterations.
///
/// # Safety
/// As ashsplat_trainer_new; `path` is a C string.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_resume(
    context: *const AshsplatContext,
    views: *const AshsplatTrainView,
    view_count: u32,
    path: *const c_char,
    scene_extent: f32,
    settings_json: *const c_char,
    trainer: *mut *mut AshsplatTrainer,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let (context, path) = (borrowed(context, "context")?, text(path, "path")?);
        give(trainer, "trainer", || {
            let Run { views, settings, extent } = Run::of((views, view_count), scene_extent, settings_json)?;
            let checkpoint = Checkpoint::read(path)?;
            Trainer::resume(&context.0, views, extent, settings, &checkpoint).map(AshsplatTrainer)
        })
    })
}

/// What the ways to make a trainer share.
struct Run {
    views: Vec<TrainView>,
    settings: TrainSettings,
    extent: f32,
}

impl Run {
    /// # Safety
    /// As ashsplat_trainer_new.
    unsafe fn of(
        (views, count): (*const AshsplatTrainView, u32),
        extent: f32,
        settings_json: *const c_char,
    ) -> Result<Self> {
        // SAFETY: as promised.
        unsafe {
            let views = read_all(views, count, "views")?;
            let known = |(place, view): (usize, &AshsplatTrainView)| {
                train_view(view).map_err(within(format_args!("views[{place}]")))
            };
            let views = views.iter().enumerate().map(known).collect::<Result<Vec<_>>>()?;
            let settings = match settings_json.is_null() {
                true => TrainSettings::default(),
                false => settings_of(text(settings_json, "settings_json")?)?,
            };
            let extent = match extent {
                0.0 => ashsplat::scene::scene_extent(views.iter().map(|view| view.camera.position())),
                extent => extent,
            };
            Ok(Self { views, settings, extent })
        }
    }
}

fn settings_of(json: &str) -> Result<TrainSettings> {
    let problem = |error: serde_json::Error| Error::argument("settings_json", error.to_string());
    let refused = |problem: String| Error::argument("settings_json", problem);
    let given: Value = serde_json::from_str(json).map_err(problem)?;
    let Value::Object(mut given) = given else { return Err(refused("is no object".into())) };
    let preset = match given.remove("preset") {
        None => None,
        Some(Value::String(name)) => match name.as_str() {
            "fast" => Some(Preset::Fast),
            "default" => Some(Preset::Default),
            "quality" => Some(Preset::Quality),
            other => return Err(refused(format!("preset: '{other}' is none of fast, default, quality"))),
        },
        Some(other) => return Err(refused(format!("preset: {other} is no text"))),
    };
    let few = match given.remove("few_photos") {
        None => false,
        Some(Value::Bool(few)) => few,
        Some(other) => return Err(refused(format!("few_photos: {other} is neither true nor false"))),
    };
    // What is not given has the default of the preset, or of the strategy.
    let strategy =
        serde_json::from_value::<TrainSettings>(Value::Object(given.clone())).map_err(problem)?.strategy;
    let usual = match (preset, few) {
        (Some(preset), _) if given.contains_key("strategy") => {
            return Err(refused(format!("preset: {preset:?} has a strategy; leave one of both out")));
        }
        (Some(preset), false) => TrainSettings::of_preset(preset),
        (Some(_), true) => return Err(refused("preset and few_photos: leave one of both out".into())),
        (None, true) => TrainSettings::of_few_photos(strategy),
        (None, false) => TrainSettings::of_strategy(strategy),
    };
    let mut all = json!(usual);
    if let Value::Object(all) = &mut all {
        all.extend(given);
    }
    serde_json::from_value(all).map_err(problem)
}

/// # Safety
/// The arrays have as many elements as the camera and the count say.
unsafe fn train_view(view: &AshsplatTrainView) -> Result<TrainView> {
    // SAFETY: as promised.
    let camera = unsafe { read(view.camera, "camera")? }.known()?;
    camera.check()?;
    let (width, height) = (camera.width, camera.height);
    let pixels = width as usize * height as usize;
    // SAFETY: as promised.
    unsafe {
        let rgb = slice(view.rgb, 3 * pixels, "rgb")?.to_vec();
        let mask = slice_if(view.mask, pixels, "mask")?.map(<[u8]>::to_vec);
        let photo = StoredPhoto::new(Photo { width, height, rgb }, mask);
        let points = slice_if(view.depth_points, 3 * view.depth_point_count as usize, "depth_points")?;
        let known = |&[x, y, inverse_z]: &[f32; 3]| DepthPoint { position_px: [x, y], inverse_z };
        Ok(TrainView::new(camera, photo)
            .taken_by(view.camera_id)
            .with_inverse_depth(slice_if(view.inverse_depth, pixels, "inverse_depth")?.map(Into::into))
            .with_depth_points(points.map(|points| points.as_chunks().0.iter().map(known).collect())))
    }
}

/// An array that may be NULL.
///
/// # Safety
/// As [`slice`].
unsafe fn slice_if<'a, T>(pointer: *const T, count: usize, what: &str) -> Result<Option<&'a [T]>> {
    // SAFETY: as promised.
    if pointer.is_null() { Ok(None) } else { unsafe { slice(pointer, count, what) }.map(Some) }
}

/// Frees a trainer. No recorded step of it may still be executed.
///
/// # Safety
/// `trainer` is NULL or of this library and not used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_free(trainer: *mut AshsplatTrainer) {
    // SAFETY: as promised.
    unsafe { take(trainer) }
}

/// Runs one iteration: submits and waits.
///
/// # Safety
/// `trainer` is alive, `step` is NULL or valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_step(
    trainer: *mut AshsplatTrainer,
    step: *mut AshsplatStep,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        check_room(step, "step")?;
        let report = borrowed_mut(trainer, "trainer")?.0.step()?;
        write_if(step, "step", (&report).into())
    })
}

/// Builds all kernels and allocates everything that recorded steps need. `slots` steps may be in flight, with
/// a capacity of at least `instances` (tile, Gaussian) pairs, or 0 for an estimate. Submits and waits.
///
/// # Safety
/// `trainer` is alive; the whole command buffers of all recorded steps have finished: their fences were
/// waited for. A result of ashsplat_trainer_outcome is not enough.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_reserve(
    trainer: *mut AshsplatTrainer,
    slots: u32,
    instances: u32,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        borrowed_mut(trainer, "trainer")?.0.reserve_steps(&StepReservation { slots, instances })
    })
}

/// Records the next iteration into a VkCommandBuffer. It never submits, waits, allocates, maps or reads back.
/// Errors are reported before anything is recorded, including that maintenance is due. The slot is in flight
/// until the device has executed the step.
///
/// # Safety
/// - `commands` is of the context's device and queue family, in the recording state, outside of a render
///   pass; it is submitted at most once before it is recorded again, and steps in the order in which they
///   were recorded;
/// - the trainer lives until the execution has finished, and the slot is recorded again only then: its fence
///   was waited for;
/// - the host assumes afterwards that the command buffer's compute pipeline, descriptor sets and push
///   constants have changed;
/// - `release` is NULL or valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_record(
    trainer: *mut AshsplatTrainer,
    commands: *mut c_void,
    slot: u32,
    release: *mut AshsplatRelease,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let trainer = &mut borrowed_mut(trainer, "trainer")?.0;
        let commands = trainer.context().adopt_commands(vk::CommandBuffer::from_raw(commands as u64))?;
        check_room(release, "release")?;
        let step = trainer.record_step(commands, slot)?;
        write_if(release, "release", (&step.release).into())
    })
}

/// Forgets the last recorded step of a slot, whose command buffer was discarded. The command buffers of all
/// steps recorded after it must then be discarded as well.
///
/// # Safety
/// `trainer` is alive; the command buffer was not submitted and is not going to be.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_discard(
    trainer: *mut AshsplatTrainer,
    slot: u32,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        borrowed_mut(trainer, "trainer")?.0.step_recording(slot)?.discard();
        Ok(())
    })
}

/// The outcome of the last recorded step of a slot. Never waits, except on llvmpipe, where reading the time
/// waits.
///
/// # Safety
/// `trainer` is alive, `step` valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_outcome(
    trainer: *mut AshsplatTrainer,
    slot: u32,
    step: *mut AshsplatStep,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let outcome = borrowed_mut(trainer, "trainer")?.0.step_outcome(slot)?;
        write(step, "step", outcome.as_ref().map(AshsplatStep::from).unwrap_or_default())
    })
}

/// Whether ashsplat_trainer_maintain must be called before another step can be recorded. Never waits.
///
/// # Safety
/// `trainer` is alive, `is_due` valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_maintenance_is_due(
    trainer: *mut AshsplatTrainer,
    is_due: *mut bool,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        *borrowed_mut(is_due, "is_due")? = borrowed_mut(trainer, "trainer")?.0.maintenance_is_due()?;
        Ok(())
    })
}

/// Does what recorded steps cannot: densifies and resets opacities if that is due, and grows the capacity
/// after a step that overflowed. Submits, waits and allocates; no recorded step may be in flight. Scenes of
/// ashsplat_trainer_scene are out of date afterwards.
///
/// # Safety
/// `trainer` is alive, `done` is NULL or valid for a write; the whole command buffers of all recorded steps
/// have finished: their fences were waited for. A result of ashsplat_trainer_outcome is not enough.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_maintain(
    trainer: *mut AshsplatTrainer,
    done: *mut AshsplatMaintenance,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        check_room(done, "done")?;
        let maintenance = borrowed_mut(trainer, "trainer")?.0.maintain()?;
        write_if(done, "done", maintenance.into())
    })
}

/// The Gaussians on the device, for ashsplat_record after recorded steps. Valid until the next
/// ashsplat_trainer_maintain or ashsplat_trainer_step.
///
/// # Safety
/// `trainer` is alive, `scene` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_scene(
    trainer: *const AshsplatTrainer,
    scene: *mut *mut AshsplatScene,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let trainer = borrowed(trainer, "trainer")?;
        give(scene, "scene", || Ok(AshsplatScene::of(trainer.0.scene())))
    })
}
