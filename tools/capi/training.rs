//! Training in C: results, inputs, steps that submit and wait, and steps in a host's command buffer.

use super::scenes::gaussians;
use super::*;
use ashsplat::ash::{vk, vk::Handle};
use ashsplat::passes::loss::DepthPoint;
use ashsplat::scene::{Camera, PointCloud, StoredPhoto};
use ashsplat::train::{Checkpoint, Maintenance, Preset, StepOutcome, StepReservation};
use ashsplat::{StepReport, TrainSettings, TrainView, Trainer};
use ashsplat_files::{CheckpointFile, ply};
use serde_json::{Value, json};
use std::ffi::c_void;

/// Trains Gaussians on photographs.
pub struct AshsplatTrainer(Trainer);

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
    /// Sparse points that the photograph shows, for the setting depth_points; not together with inverse_depth. Three floats
    /// each: where the photograph shows it, pixels, x to the right and y down, the first pixel's centre at 0, 0; and 1 / z
    /// in the camera's frame, 1 / world units. May be NULL.
    pub depth_points: *const f32,
    /// Number of depth points.
    pub depth_point_count: u32,
    /// Id of the camera that took the photograph. Views with the same id share lens effects.
    pub camera_id: u32,
}

/// The report of a training step.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatStep {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// True if the step has finished. The other fields are valid only then.
    pub finished: bool,
    /// True if it changed nothing, because a capacity was too small. ashsplat_trainer_maintain grows it. Then
    /// the iteration is recorded again.
    pub overflow: bool,
    /// Its iteration, from 1.
    pub iteration: u32,
    /// The loss before it; NaN if the iteration was skipped, because its frame exceeds the largest possible
    /// capacity.
    pub loss: f32,
    /// Number of Gaussians.
    pub gaussians: u32,
    /// Gaussians visible in its view.
    pub visible: u32,
    /// (tile, Gaussian) instances that its view needs; after an overflow those of the visible Gaussians that there was room for.
    pub instances: u32,
    /// Index of its view.
    pub view: u32,
}

impl From<&StepReport> for AshsplatStep {
    fn from(r: &StepReport) -> Self {
        same_fields!(r => Self { iteration, loss, gaussians, visible, instances } with {
            finished: true,
            view: r.view as u32,
            ..Self::default()
        })
    }
}

impl From<&StepOutcome> for AshsplatStep {
    fn from(outcome: &StepOutcome) -> Self {
        match outcome {
            StepOutcome::Done(report) => report.into(),
            &StepOutcome::Overflowed {
                iteration,
                visible_needed: visible,
                instances_needed: instances,
                ..
            } => Self { finished: true, overflow: true, iteration, visible, instances, ..Self::default() },
        }
    }
}

/// The report of ashsplat_trainer_maintain.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatMaintenance {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// True if Gaussians were added and removed.
    pub densified: bool,
    /// True if opacities were reset.
    pub opacities_reset: bool,
    /// True if the capacity has grown.
    pub grown: bool,
    /// The iteration that was skipped, because its frame exceeds the largest possible capacity; 0 for none.
    /// The next step is the iteration after it.
    pub skipped: u32,
}

impl From<Maintenance> for AshsplatMaintenance {
    fn from(m: Maintenance) -> Self {
        same_fields!(m => Self { opacities_reset, grown } with {
            densified: m.densified.is_some(),
            skipped: m.skipped.unwrap_or(0),
            ..Self::default()
        })
    }
}

/// Reads the Gaussians back and writes them, in the format that the name's ending says: PLY in the reference implementation's layout,
/// .compressed.ply, .splat, SPZ, SOG or GLB. The sizes of the 3D filter are in PLY only; in other formats they are a part of scales and
/// opacities. ashsplat_last_loss says what the format does not hold. Submits and waits.
///
/// # Safety
/// `trainer` is alive, `path` is a C string.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_save(
    trainer: *const AshsplatTrainer,
    path: *const c_char,
) -> AshsplatStatus {
    guarded!({
        let (trainer, path) = (&borrowed(trainer, "trainer")?.0, text(path, "path")?);
        let options = splats::WriteOptions::marking(&trainer.settings().render_settings());
        let filters = trainer.filters()?;
        let losses = match splats::Format::of_extension(path)? {
            splats::Format::Ply if !filters.is_empty() => {
                ply::write_filtered(path, &trainer.gaussians()?, &filters, &options)?;
                Vec::new()
            }
            format => {
                let gaussians = trainer.baked_gaussians()?;
                splats::write(path, &gaussians, &options)?;
                splats::losses(format, &gaussians, &options)?
            }
        };
        LAST_LOSS.set(c_text(&losses.join("\n")));
        Ok(())
    })
}

/// Writes all that ashsplat_trainer_resume needs. Submits and waits.
///
/// # Safety
/// `trainer` is alive, `path` is a C string.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_checkpoint(
    trainer: *const AshsplatTrainer,
    path: *const c_char,
) -> AshsplatStatus {
    guarded!({
        let (trainer, path) = (&borrowed(trainer, "trainer")?.0, text(path, "path")?);
        trainer.checkpoint()?.write(path)
    })
}

/// The cameras of the views in their order, as the setting pose_opt has moved them. `cameras` has room for `count`, which must be the
/// number of views. Submits and waits.
///
/// # Safety
/// `trainer` is alive, `cameras` is valid for `count` structs initialised with ASHSPLAT_INIT.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_cameras(
    trainer: *const AshsplatTrainer,
    cameras: *mut AshsplatCamera,
    count: u32,
) -> AshsplatStatus {
    guarded!({
        let all = borrowed(trainer, "trainer")?.0.cameras()?;
        check_count(count, all.len())?;
        check_pointer(cameras, "cameras")?;
        check_room_of_all(cameras, count, "cameras")?;
        let all: Vec<AshsplatCamera> = all.into_iter().map(Into::into).collect();
        write_if(cameras, "cameras", &all)
    })
}

/// The exposures of the views in their order, with the setting exposure: three rows E of four floats each. A photograph's colour is
/// out_c = sum over k of in_k E[k][c] + E[c][3] of the rendered one. `exposures` has room for 12 `count` floats; `count` must be
/// the number of views. Submits and waits.
///
/// # Safety
/// `trainer` is alive, `exposures` is valid for 12 `count` floats.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_exposures(
    trainer: *const AshsplatTrainer,
    exposures: *mut f32,
    count: u32,
) -> AshsplatStatus {
    guarded!({
        let all = borrowed(trainer, "trainer")?.0.exposures()?.into_iter().map(|exposure| exposure.rows);
        give_rows(all, (exposures, count), ["exposures", "exposure"])
    })
}

/// The lens effects of the views in their order, with the setting lens_effects: for red, green and blue a_1, a_2, a_3 of the vignetting
/// 1 + a_1 r^2 + a_2 r^4 + a_3 r^6 and the logarithm of the response's exponent. `effects` has room for 12 `count` floats; `count` must be
/// the number of views. Submits and waits.
///
/// # Safety
/// `trainer` is alive, `effects` is valid for 12 `count` floats.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_lens_effects(
    trainer: *const AshsplatTrainer,
    effects: *mut f32,
    count: u32,
) -> AshsplatStatus {
    guarded!({
        let all = borrowed(trainer, "trainer")?.0.lens_effects()?.into_iter().map(|effects| effects.rows);
        give_rows(all, (effects, count), ["effects", "lens_effects"])
    })
}

fn check_count(count: u32, views: usize) -> Result<()> {
    match count as usize == views {
        true => Ok(()),
        false => Err(Error::argument("count", format!("is {count}, there are {views} views"))),
    }
}

/// # Safety
/// The pointer is null or valid for `count` rows.
unsafe fn give_rows(
    rows: impl Iterator<Item = [[f32; 4]; 3]>,
    (to, count): (*mut f32, u32),
    [name, setting]: [&str; 2],
) -> Result<()> {
    let rows: Vec<_> = rows.collect();
    if rows.is_empty() {
        return Err(Error::argument(setting, "is not set: nothing of it is learned"));
    }
    check_count(count, rows.len())?;
    check_pointer(to, name)?;
    // SAFETY: as promised.
    unsafe { fill(to, rows.as_flattened().as_flattened()) };
    Ok(())
}

/// Uploads photographs and initial Gaussians, which are taken as they are: the settings initial_opacity and initial_scale are for
/// ashsplat_trainer_new_from_points. The context needs a queue. `scene_extent` is 1.1 times the largest distance of a camera to their
/// mean, or 0 to have it computed. `settings_json`: an object with the names of the reference implementation's settings,
/// `{"iterations": 7000}`. It may have `"preset": "fast"`, `"default"`, `"quality"` or `"reference"`, and `"few_photos": true`,
/// which adapts them to the number of views, if it is below 32. Missing settings are those of the preset; without one, those of the
/// strategy if it is given, else of the preset default. NULL has all settings of the preset default.
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
    guarded!({
        let (context, initial) = (borrowed(context, "context")?, read(initial, "initial")?);
        let shared = (views, view_count, scene_extent, settings_json);
        give_trainer(trainer, shared, |views, settings, extent| {
            Trainer::new(&context.0, views, &gaussians(&initial)?, extent, settings)
        })
    })
}

/// Same as ashsplat_trainer_new, with Gaussians made of points: `positions` has three floats of each, world units, `colors` red, green and
/// blue, a byte each. Their scales follow from the distances of the nearest neighbours, as in the reference implementation; the
/// settings initial_opacity and initial_scale change them.
///
/// # Safety
/// Same as for ashsplat_trainer_new; `positions` and `colors` have three elements for each of `point_count` points.
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
    guarded!({
        let (context, floats) = (borrowed(context, "context")?, 3 * point_count as usize);
        let positions = slice(positions, floats, "positions")?.as_chunks().0.to_vec();
        let colors = slice(colors, floats, "colors")?.as_chunks().0.to_vec();
        let shared = (views, view_count, scene_extent, settings_json);
        give_trainer(trainer, shared, |views, settings, extent| {
            let points = PointCloud { positions, colors };
            let mut initial = ashsplat_files::initial_gaussians(&points, settings.sh_degree)?;
            settings.initialize(&mut initial);
            Trainer::new(&context.0, views, &initial, extent, settings)
        })
    })
}

/// Continues from a file of ashsplat_trainer_checkpoint or of the program, to the same bits as a training that was never
/// stopped. The other arguments are those of the training that wrote it, except for the number of iterations. `trainer` is
/// NULL after an error.
///
/// # Safety
/// Same as for ashsplat_trainer_new; `path` is a C string.
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
    guarded!({
        let (context, path) = (borrowed(context, "context")?, text(path, "path")?);
        let shared = (views, view_count, scene_extent, settings_json);
        give_trainer(trainer, shared, |views, settings, extent| {
            Trainer::resume(&context.0, views, extent, settings, &Checkpoint::read(path)?)
        })
    })
}

/// Makes a trainer from the arguments that all ways share. The promise is that of ashsplat_trainer_new.
unsafe fn give_trainer(
    trainer: *mut *mut AshsplatTrainer,
    (views, count, extent, settings_json): (*const AshsplatTrainView, u32, f32, *const c_char),
    make: impl FnOnce(Vec<TrainView>, TrainSettings, f32) -> Result<Trainer>,
) -> Result<()> {
    let made = || {
        // SAFETY: as promised.
        let views = unsafe { read_all(views, count, "views")? }.collect::<Result<Vec<_>>>()?;
        let known = |(place, view): (usize, &AshsplatTrainView)| {
            // SAFETY: as promised.
            unsafe { train_view(view) }.map_err(within(format_args!("views[{place}]")))
        };
        let views = views.iter().enumerate().map(known).collect::<Result<Vec<_>>>()?;
        let extent = match extent {
            0.0 => ashsplat::scene::scene_extent(views.iter().map(|view| view.camera.position())),
            extent => extent,
        };
        let settings = match settings_json.is_null() {
            true => TrainSettings::default(),
            // SAFETY: as promised.
            false => settings_of(unsafe { text(settings_json, "settings_json")? }, views.len())?,
        };
        make(views, settings, extent).map(AshsplatTrainer)
    };
    // SAFETY: as promised.
    unsafe { give(trainer, "trainer", made) }
}

fn settings_of(json: &str, photos: usize) -> Result<TrainSettings> {
    let refused = |problem: String| Error::argument("settings_json", problem);
    let problem = |error: serde_json::Error| refused(error.to_string());
    let given: Value = serde_json::from_str(json).map_err(problem)?;
    let Value::Object(mut given) = given else { return Err(refused("is no object".into())) };
    let mut take = |name: &str| given.remove(name).unwrap_or_default();
    let of = |name: &'static str| move |error: serde_json::Error| refused(format!("{name}: {error}"));
    let preset: Option<Preset> = serde_json::from_value(take("preset")).map_err(of("preset"))?;
    let few: Option<bool> = serde_json::from_value(take("few_photos")).map_err(of("few_photos"))?;
    let photos = if few == Some(true) { photos } else { usize::MAX };
    let strategy =
        serde_json::from_value::<TrainSettings>(Value::Object(given.clone())).map_err(problem)?.strategy;
    let usual = match preset {
        Some(preset) if given.contains_key("strategy") => {
            return Err(refused(format!("preset: {preset:?} has a strategy; leave one of both out")));
        }
        None if given.contains_key("strategy") => TrainSettings::of_strategy(strategy),
        preset => TrainSettings::of_preset(preset.unwrap_or_default()),
    };
    let mut all = json!(usual.for_photos(photos));
    if let Value::Object(all) = &mut all {
        all.extend(given);
    }
    serde_json::from_value(all).map_err(problem)
}

/// # Safety
/// The arrays have as many elements as the camera and the count require.
unsafe fn train_view(view: &AshsplatTrainView) -> Result<TrainView> {
    // SAFETY: as promised.
    let camera = unsafe { read(view.camera, "camera")? }.checked("camera")?;
    let pixels = camera.width as usize * camera.height as usize;
    // SAFETY: as promised.
    unsafe {
        let photo = photo(&camera, view.rgb, view.mask)?;
        let points = slice_if(view.depth_points, 3 * view.depth_point_count as usize, "depth_points")?;
        let known = |&[x, y, inverse_z]: &[f32; 3]| DepthPoint { position_px: [x, y], inverse_z };
        Ok(TrainView {
            camera,
            photo,
            camera_id: view.camera_id,
            inverse_depth: slice_if(view.inverse_depth, pixels, "inverse_depth")?.map(Into::into),
            depth_points: points.map(|points| points.as_chunks().0.iter().map(known).collect()),
        })
    }
}

/// Copies a photograph of a camera's size, and its mask if there is one.
///
/// # Safety
/// The pointers are null or valid for the camera's pixels.
pub(super) unsafe fn photo(camera: &Camera, rgb: *const u8, mask: *const u8) -> Result<StoredPhoto> {
    let (width, height) = (camera.width, camera.height);
    let pixels = width as usize * height as usize;
    // SAFETY: as promised.
    unsafe {
        let rgb = slice(rgb, 3 * pixels, "rgb")?.to_vec();
        let mask = slice_if(mask, pixels, "mask")?.map(<[u8]>::to_vec);
        Ok(StoredPhoto::new(Photo { width, height, rgb }, mask))
    }
}

/// Frees a trainer. None of its recorded steps may be pending or running.
///
/// # Safety
/// `trainer` is NULL or of this library and not used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_free(trainer: *mut AshsplatTrainer) {
    // SAFETY: as promised.
    unsafe { take(trainer) }
}

/// Runs one iteration: submits and waits. Iterations after the last of the settings change nothing.
///
/// # Safety
/// `trainer` is alive, `step` is NULL or valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_step(
    trainer: *mut AshsplatTrainer,
    step: *mut AshsplatStep,
) -> AshsplatStatus {
    guarded!({
        check_room(step, "step")?;
        let report = borrowed_mut(trainer, "trainer")?.0.step()?;
        write_if(step, "step", &[(&report).into()])
    })
}

/// Builds all kernels and allocates everything that recorded steps need. `slots` steps may be in flight, with
/// a capacity of at least `instances` (tile, Gaussian) pairs and `visible` Gaussians that a view shows, or 0 for estimates. Submits
/// and waits.
///
/// # Safety
/// `trainer` is alive; the whole command buffers of all recorded steps have finished: their fences were
/// waited for. A result of ashsplat_trainer_outcome is not enough.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_reserve(
    trainer: *mut AshsplatTrainer,
    slots: u32,
    instances: u32,
    visible: u32,
) -> AshsplatStatus {
    guarded!({
        let wanted = StepReservation { slots, instances, visible };
        borrowed_mut(trainer, "trainer")?.0.reserve_steps(&wanted)
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
    guarded!({
        let trainer = &mut borrowed_mut(trainer, "trainer")?.0;
        let commands = trainer.context().adopt_commands(vk::CommandBuffer::from_raw(commands as u64))?;
        check_room(release, "release")?;
        let step = trainer.record_step(commands, slot)?;
        write_if(release, "release", &[(&step.release).into()])
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
    guarded!({
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
    guarded!({
        let outcome = borrowed_mut(trainer, "trainer")?.0.step_outcome(slot)?;
        write(step, "step", outcome.as_ref().map(AshsplatStep::from).unwrap_or_default())
    })
}

/// Says whether ashsplat_trainer_maintain must be called before another step can be recorded. Never waits.
///
/// # Safety
/// `trainer` is alive, `is_due` valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_maintenance_is_due(
    trainer: *mut AshsplatTrainer,
    is_due: *mut bool,
) -> AshsplatStatus {
    guarded!({ put(is_due, "is_due", borrowed_mut(trainer, "trainer")?.0.maintenance_is_due()?) })
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
    guarded!({
        check_room(done, "done")?;
        let maintenance = borrowed_mut(trainer, "trainer")?.0.maintain()?;
        write_if(done, "done", &[maintenance.into()])
    })
}

/// The Gaussians on the device, for ashsplat_record after recorded steps. Each call makes a scene that the host frees
/// (ashsplat_scene_free), before or after the trainer: it keeps the memory alive. It shows the trainer's Gaussians until the next
/// ashsplat_trainer_maintain or ashsplat_trainer_step: ask again then. With the setting sh_storage "half" frames that are recorded
/// need AshsplatReservation.half_sh.
///
/// # Safety
/// `trainer` is alive, `scene` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_trainer_scene(
    trainer: *const AshsplatTrainer,
    scene: *mut *mut AshsplatScene,
) -> AshsplatStatus {
    guarded!({
        let trainer = borrowed(trainer, "trainer")?;
        give(scene, "scene", || Ok(AshsplatScene::of(trainer.0.scene())))
    })
}
