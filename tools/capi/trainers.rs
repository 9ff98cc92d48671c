//! Inputs of a training in C: photographs, Gaussians or points or a checkpoint, settings.

use super::scenes::gaussians;
use super::structs::{read, read_all, within};
use super::{
    AshsplatCamera, AshsplatContext, AshsplatGaussians, AshsplatStatus, AshsplatTrainer, borrowed, give,
    guarded, slice, text,
};
use ashsplat::loss::DepthPoint;
use ashsplat::scene::{Camera, PointCloud, StoredPhoto};
use ashsplat::trainer::{Checkpoint, Preset};
use ashsplat::{Error, Result, TrainSettings, TrainView, Trainer};
use ashsplat_files::{CheckpointFile, Photo};
use serde_json::{Value, json};
use std::ffi::c_char;

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

/// Uploads photographs and initial Gaussians, which are taken as they are: the settings initial_opacity and initial_scale are for
/// ashsplat_trainer_new_from_points. The context needs a queue. `scene_extent` is 1.1 times the largest distance of a camera to their
/// mean, or 0 to have it computed. `settings_json`: an object with the names of the reference implementation's settings,
/// `{"iterations": 7000}`. It may have `"preset": "fast"`, `"default"` or `"quality"`, and `"few_photos": true`, whose settings the others
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
/// other arguments are those of the training that wrote it, except for the number of iterations. `trainer` is NULL after an error.
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

/// Arguments shared by all ways to make a trainer.
struct Run {
    views: Vec<TrainView>,
    settings: TrainSettings,
    extent: f32,
}

impl Run {
    /// # Safety
    /// Same as for ashsplat_trainer_new.
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
            let extent = match extent {
                0.0 => ashsplat::scene::scene_extent(views.iter().map(|view| view.camera.position())),
                extent => extent,
            };
            let settings = match settings_json.is_null() {
                true => TrainSettings::default(),
                false => settings_of(text(settings_json, "settings_json")?, extent)?,
            };
            Ok(Self { views, settings, extent })
        }
    }
}

fn settings_of(json: &str, extent: f32) -> Result<TrainSettings> {
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
    // Missing values get the defaults of the preset, or of the strategy.
    let strategy =
        serde_json::from_value::<TrainSettings>(Value::Object(given.clone())).map_err(problem)?.strategy;
    let usual = match (preset, few) {
        (Some(preset), _) if given.contains_key("strategy") => {
            return Err(refused(format!("preset: {preset:?} has a strategy; leave one of both out")));
        }
        (Some(preset), false) => TrainSettings::of_preset(preset),
        (Some(preset), true) => TrainSettings::of_preset_for_few_photos(preset, extent),
        (None, true) => TrainSettings::of_few_photos(strategy, extent),
        (None, false) => TrainSettings::of_strategy(strategy),
    };
    let mut all = json!(usual);
    if let Value::Object(all) = &mut all {
        all.extend(given);
    }
    serde_json::from_value(all).map_err(problem)
}

/// # Safety
/// The arrays have as many elements as the camera and the count require.
unsafe fn train_view(view: &AshsplatTrainView) -> Result<TrainView> {
    // SAFETY: as promised.
    let camera = unsafe { read(view.camera, "camera")? }.known()?;
    camera.check()?;
    let pixels = camera.width as usize * camera.height as usize;
    // SAFETY: as promised.
    unsafe {
        let photo = photo(&camera, view.rgb, view.mask)?;
        let points = slice_if(view.depth_points, 3 * view.depth_point_count as usize, "depth_points")?;
        let known = |&[x, y, inverse_z]: &[f32; 3]| DepthPoint { position_px: [x, y], inverse_z };
        Ok(TrainView::new(camera, photo)
            .taken_by(view.camera_id)
            .with_inverse_depth(slice_if(view.inverse_depth, pixels, "inverse_depth")?.map(Into::into))
            .with_depth_points(points.map(|points| points.as_chunks().0.iter().map(known).collect())))
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

/// Reads an array that may be NULL.
///
/// # Safety
/// Same as for [`slice`].
pub(super) unsafe fn slice_if<'a, T>(pointer: *const T, count: usize, what: &str) -> Result<Option<&'a [T]>> {
    // SAFETY: as promised.
    if pointer.is_null() { Ok(None) } else { unsafe { slice(pointer, count, what) }.map(Some) }
}
