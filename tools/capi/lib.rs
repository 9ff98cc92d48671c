//! The C interface: thin functions over the public Rust API with the same meaning.
//!
//! `ashsplat.h` is generated from this file; a test compares it. Every function that can fail returns a status, and
//! [`ashsplat_last_error`] has the message; no panic crosses the boundary. Vulkan's handles have the same types as in C on
//! 64-bit machines: dispatchable ones are pointers, the others 64-bit numbers.

#![allow(unsafe_code)]

mod derivatives;
mod foreign;
mod frames;
mod kernels;
mod measures;
mod names;
mod pointers;
mod recording_cache;
mod scenes;
mod slots;
mod structs;
mod training;
mod trees;
mod types;

pub use derivatives::*;
pub use foreign::*;
pub use frames::*;
pub use kernels::*;
pub use measures::*;
pub use scenes::*;
pub use slots::*;
pub use structs::{Defaults, STRUCTS};
pub use training::*;
pub use trees::*;
pub use types::*;

use self::pointers::*;
use self::recording_cache::{RecordingCache, Scratch};
use self::structs::*;
use ashsplat::vk::{Context, ContextOptions};
use ashsplat::{DeviceScene, Error, RenderSettings, Renderer, Result};
use ashsplat_files::{Photo, PhotoFileFormat, splats};
use std::cell::RefCell;
use std::ffi::{CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// A device that everything runs on.
pub struct AshsplatContext(Context);

/// Gaussians on a device.
pub struct AshsplatScene {
    scene: DeviceScene,
    /// Notes of the scene's file.
    notes: FileNotes,
}

#[derive(Default)]
struct FileNotes {
    antialiased: bool,
    /// One per line.
    warnings: CString,
}

impl FileNotes {
    /// Reads the notes of a file.
    fn of(file: &splats::Scene) -> FileNotes {
        let kernel =
            |size: f32| format!("it was trained with the kernel size {size}: AshsplatRenderSettings has it");
        let order = file.header.distance_order.then(|| {
            "it was trained in the order of distances: AshsplatRenderSettings.distance_order".to_owned()
        });
        let [x, y, z] = file.frame.origin.to_array();
        let origin = ([x, y, z] != [0.0; 3]).then(|| format!("positions are relative to {x},{y},{z}"));
        let warnings: Vec<String> = file
            .warnings
            .iter()
            .cloned()
            .chain(file.header.kernel_size.map(kernel))
            .chain(order)
            .chain(origin)
            .collect();
        FileNotes { antialiased: file.header.antialiased, warnings: c_text(&warnings.join("\n")) }
    }

    /// # Safety
    /// The pointers are null or valid for a write.
    unsafe fn write_to(&self, antialiased: *mut bool, warnings: *mut *const c_char) {
        // SAFETY: as promised.
        unsafe {
            put_if(antialiased, self.antialiased);
            put_if(warnings, self.warnings.as_ptr());
        }
    }
}

impl AshsplatScene {
    /// A scene without notes.
    fn of(scene: DeviceScene) -> Self {
        Self { scene, notes: FileNotes::default() }
    }
}

/// Renders scenes.
pub struct AshsplatRenderer(Renderer, Scratch, RecordingCache);

thread_local! {
    static LAST_ERROR: RefCell<CString> = RefCell::default();
    static LAST_LOSS: RefCell<CString> = RefCell::default();
}

/// Runs the body of an exported function and stores its error. The body is unsafe code.
macro_rules! guarded {
    ($body:block) => {
        // SAFETY: the function's `# Safety` says what the host promises.
        $crate::guard(|| unsafe { $body })
    };
}
pub(crate) use guarded;

/// Runs a function and stores its error.
fn guard(f: impl FnOnce() -> Result<()>) -> AshsplatStatus {
    let (status, message) = match catch_unwind(AssertUnwindSafe(f)) {
        Ok(Ok(())) => return AshsplatStatus::Ok,
        Ok(Err(error)) => (status_of(&error), names::message_in_c(error)),
        Err(panic) => {
            let text = panic.downcast_ref::<String>().cloned();
            let text = text.or_else(|| panic.downcast_ref::<&str>().map(|s| (*s).to_owned()));
            (AshsplatStatus::Internal, format!("internal error: {}", text.unwrap_or_default()))
        }
    };
    LAST_ERROR.set(c_text(&message));
    status
}

/// A text that C can read, where a zero ends it.
fn c_text(text: &str) -> CString {
    CString::new(text.replace('\0', " ")).unwrap_or_default()
}

fn status_of(error: &Error) -> AshsplatStatus {
    match error {
        Error::Input { .. } | Error::Io { .. } => AshsplatStatus::File,
        Error::Argument { .. } => AshsplatStatus::Argument,
        Error::NoLoader { .. } | Error::NoDevice { .. } | Error::UnknownDevice { .. } => {
            AshsplatStatus::NoDevice
        }
        Error::MissingFeature { .. } => AshsplatStatus::MissingFeature,
        Error::TooLarge { .. } => AshsplatStatus::TooLarge,
        Error::Vulkan { .. } => AshsplatStatus::Vulkan,
        Error::DeviceLost { .. } => AshsplatStatus::DeviceLost,
        Error::Timeout { .. } => AshsplatStatus::Timeout,
        _ => AshsplatStatus::Internal,
    }
}

/// The message of this thread's last failure: one line, valid until the next.
#[unsafe(no_mangle)]
pub extern "C" fn ashsplat_last_error() -> *const c_char {
    LAST_ERROR.with(|last| last.borrow().as_ptr())
}

/// Lists what the file of this thread's last ashsplat_trainer_save cannot hold, one per line; empty if it holds everything.
/// The text is valid until the next save.
#[unsafe(no_mangle)]
pub extern "C" fn ashsplat_last_loss() -> *const c_char {
    LAST_LOSS.with(|last| last.borrow().as_ptr())
}

/// The version of the library, MAJOR.MINOR.PATCH.
#[unsafe(no_mangle)]
pub extern "C" fn ashsplat_version() -> *const c_char {
    const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), "\0");
    VERSION.as_ptr().cast()
}

/// Opens a device by its number or part of its name. For NULL, the environment variable ASHSPLAT_DEVICE
/// selects the device, otherwise the best one is opened. The context and everything made from it may be used
/// by any thread, one at a time.
///
/// # Safety
/// `device` is NULL or a C string; `context` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_context_new(
    device: *const c_char,
    context: *mut *mut AshsplatContext,
) -> AshsplatStatus {
    guarded!({
        give(context, "context", || {
            let device = if device.is_null() { None } else { Some(text(device, "device")?.to_owned()) };
            // Frames of this context can be recorded even on a processor.
            let options = ContextOptions { device, texels: false, ..ContextOptions::default() };
            Context::new(&options).map(AshsplatContext)
        })
    })
}

/// Closes a context. The device stays open until everything made from it is freed as well. A host's device is
/// never closed.
///
/// # Safety
/// `context` is NULL or of this library and not used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_context_free(context: *mut AshsplatContext) {
    // SAFETY: as promised.
    unsafe { take(context) }
}

/// Loads a scene from a file: PLY, compressed PLY, .splat, SPZ, SOG, or glTF and GLB with KHR_gaussian_splatting. Its first bytes or
/// its name's ending select the format. ashsplat_scene_notes gives the file's notes.
///
/// # Safety
/// `context` is alive, `path` is a C string, `scene` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_scene_load(
    context: *const AshsplatContext,
    path: *const c_char,
    scene: *mut *mut AshsplatScene,
) -> AshsplatStatus {
    guarded!({
        let (context, path) = (borrowed(context, "context")?, text(path, "path")?);
        give(scene, "scene", || {
            let file = splats::read(path, &splats::ReadOptions::default())?;
            let notes = FileNotes::of(&file);
            Ok(AshsplatScene { scene: DeviceScene::upload(&context.0, &file.gaussians, 0)?, notes })
        })
    })
}

/// Notes of a scene's file. `antialiased`: whether it was trained with antialiasing, and is to be rendered with it
/// (AshsplatRenderSettings.antialias). `warnings`: one line each, an empty text without; it lives as long as the scene. Either pointer
/// may be NULL.
///
/// # Safety
/// `scene` is alive; the pointers are NULL or valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_scene_notes(
    scene: *const AshsplatScene,
    antialiased: *mut bool,
    warnings: *mut *const c_char,
) -> AshsplatStatus {
    guarded!({
        borrowed(scene, "scene")?.notes.write_to(antialiased, warnings);
        Ok(())
    })
}

/// Number of Gaussians of a scene, and the degree of its spherical harmonics. Either pointer may be NULL.
///
/// # Safety
/// `scene` is alive; the pointers are NULL or valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_scene_size(
    scene: *const AshsplatScene,
    gaussians: *mut u32,
    sh_degree: *mut u32,
) -> AshsplatStatus {
    guarded!({
        let scene = &borrowed(scene, "scene")?.scene;
        put_if(gaussians, scene.count());
        put_if(sh_degree, scene.plan().sh_degree);
        Ok(())
    })
}

/// Frees a scene; slots keep it as long as their recordings use it.
///
/// # Safety
/// `scene` is NULL or of this library and not used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_scene_free(scene: *mut AshsplatScene) {
    // SAFETY: as promised.
    unsafe { take(scene) }
}

/// Builds a renderer.
///
/// # Safety
/// `context` is alive, `renderer` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_renderer_new(
    context: *const AshsplatContext,
    renderer: *mut *mut AshsplatRenderer,
) -> AshsplatStatus {
    guarded!({
        let context = borrowed(context, "context")?;
        give(renderer, "renderer", || {
            Renderer::new(&context.0)
                .map(|renderer| AshsplatRenderer(renderer, Scratch::new(), RecordingCache::default()))
        })
    })
}

/// Frees a renderer. No recording of it may still be executed.
///
/// # Safety
/// `renderer` is NULL or of this library and not used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_renderer_free(renderer: *mut AshsplatRenderer) {
    // SAFETY: as promised.
    unsafe { take(renderer) }
}

/// A camera at `eye` that looks at `target`, with square pixels and `fov_x` radians from the left to the
/// right edge.
///
/// # Safety
/// The three vectors have three floats each; `camera` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_camera_look_at(
    eye: *const f32,
    target: *const f32,
    up: *const f32,
    fov_x: f32,
    width: u32,
    height: u32,
    camera: *mut AshsplatCamera,
) -> AshsplatStatus {
    guarded!({
        let vector = |v, what| Ok::<_, Error>(glam::Vec3::from_slice(slice(v, 3, what)?));
        let (eye, target, up) = (vector(eye, "eye")?, vector(target, "target")?, vector(up, "up")?);
        if !(fov_x > 0.0 && fov_x < std::f32::consts::PI) {
            return Err(Error::argument("fov_x", format!("is {fov_x}, must be above 0 and below pi")));
        }
        let forward = target - eye;
        if !(forward.is_finite() && up.is_finite() && forward.cross(up).length_squared() > 0.0) {
            let problem = "the camera looks nowhere or along up: give other points or another direction";
            return Err(Error::argument("eye, target, up", problem));
        }
        let intrinsics = ashsplat::scene::Intrinsics::from_fov_x(fov_x, width, height);
        let looking = ashsplat::Camera::look_at(eye, target, up, intrinsics);
        looking.check()?;
        write(camera, "camera", looking.into())
    })
}

/// Reads a picture's camera, and its settings with the background.
///
/// # Safety
/// The pointers are null or valid with what they point to.
unsafe fn frame(
    camera: *const AshsplatCamera,
    settings: *const AshsplatRenderSettings,
    background: *const f32,
) -> Result<(ashsplat::Camera, RenderSettings)> {
    // SAFETY: as promised.
    unsafe {
        let camera = read(camera, "camera")?.checked("camera")?;
        let settings = read_if(settings, "settings")?.map(|settings| settings.checked()).transpose()?;
        let mut settings: RenderSettings = settings.unwrap_or_default();
        settings.background.copy_from_slice(slice(background, 3, "background")?);
        Ok((camera, settings))
    }
}

/// Renders a scene, submits and waits: `rgb` receives red, green and blue of each pixel, row by row, on a
/// background.
///
/// # Safety
/// `renderer`, `scene` and `camera` are alive, `settings` too, or NULL for the defaults; `background` has
/// three floats, `rgb` room for 3 * width * height.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_render(
    renderer: *mut AshsplatRenderer,
    scene: *const AshsplatScene,
    camera: *const AshsplatCamera,
    settings: *const AshsplatRenderSettings,
    background: *const f32,
    rgb: *mut f32,
) -> AshsplatStatus {
    guarded!({
        let (renderer, scene) = (borrowed_mut(renderer, "renderer")?, borrowed(scene, "scene")?);
        let (camera, settings) = frame(camera, settings, background)?;
        check_pointer(rgb, "rgb")?;
        let frame = renderer.0.render_scene(&scene.scene, &camera, &settings)?;
        fill(rgb, frame.color.as_flattened());
        Ok(())
    })
}

/// Frees the memory of pictures, which otherwise stays as large as the largest one needed. The next picture
/// takes what it needs. Reserved slots and scenes stay.
///
/// # Safety
/// `renderer` is alive.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_shrink(renderer: *mut AshsplatRenderer) -> AshsplatStatus {
    guarded!({
        borrowed_mut(renderer, "renderer")?.0.shrink();
        Ok(())
    })
}

/// Writes a picture as PNG: 8 bits per channel, from `rgb` between 0 and 1.
///
/// # Safety
/// `path` is a C string, `rgb` has 3 * width * height floats.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_write_png(
    path: *const c_char,
    width: u32,
    height: u32,
    rgb: *const f32,
) -> AshsplatStatus {
    guarded!({
        let floats = slice(rgb, rgb_floats(width, height)?, "rgb")?;
        let (pixels, _) = floats.as_chunks::<3>();
        Photo::from_f32(width, height, pixels)?.write_png(text(path, "path")?)
    })
}
