//! `ashsplat view --window`: a window on this machine's screen instead of a page, drawn by the same device.
//!
//! The window is a host that shares the engine's device, whose context has the window's extensions. Frames are recorded into
//! the window's command buffers and copied to its images on the device. The modes that the processor colours (ellipsoids,
//! depth, tiles, normals) are drawn as for the page, and uploaded.

mod app;
mod comparison;
mod controls;
mod keys;
mod navigation;
mod pace;
mod picture;
mod present;
mod text;
mod viewer;
mod words;

use super::Arguments;
use super::streamed::SceneRenderer;
use app::App;
use ashsplat::{Error, Renderer, Result};
use ashsplat_program::session::locked;
use picture::Picture;
use present::unfit;
use std::panic;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};
use viewer::WindowViewer;
use winit::event_loop::EventLoop;
use words::no_display;

/// Runs the command until its window is closed, or Ctrl-C.
pub fn run(arguments: &Arguments, out: PathBuf, stop: Arc<AtomicBool>) -> Result<()> {
    // A missing display is reported before anything is loaded.
    let events = open()?;
    let instance_extensions = present::instance_extensions(&events)?;
    let scene = arguments.load_path(&stop)?;
    let opened = arguments.device.context_with(|options| {
        // Frames recorded into a host's command buffers cannot read texels.
        options.texels = false;
        options.instance_extensions = instance_extensions;
        options.device_extensions = present::DEVICE_EXTENSIONS.to_vec();
    });
    let context = opened.map_err(|error| match &error {
        Error::MissingFeature { feature, .. }
            if feature.contains("surface") || feature.contains("swapchain") =>
        {
            present::unfit(&error.to_string())
        }
        _ => error,
    })?;
    let mut scene_renderer = SceneRenderer::new(Renderer::new(&context)?, arguments.look.sh_storage);
    let wake = Mutex::new(events.create_proxy());
    // A loop that has ended needs no waking.
    let on_tile = move |problem: Option<String>| drop(locked(&wake).send_event(problem));
    scene_renderer.show(&scene.gaussians, scene.tree.as_ref(), Arc::new(on_tile))?;
    let picture = Picture::new(scene_renderer, scene.gaussians.sh_degree)?;
    let viewer = WindowViewer::new(scene, picture, context.device_name(), out);
    let mut app = App::new(viewer, context.clone(), stop, !arguments.no_vsync);
    outln!("window on {}; ? lists the keys", context.device_name());
    let ended = events.run_app(&mut app).map_err(|error| present::unfit(&error.to_string()));
    let failed = app.close();
    drop(app);
    // Closing destroys the device and reports what validation says of that.
    let left = || vec!["the window is closed, and something of it still holds the device".to_owned()];
    for message in context.close().unwrap_or_else(left) {
        errln!("validation: {message}");
    }
    failed.map_or(ended, Err)
}

/// Connects to the display of this session.
///
/// # Errors
/// One line, if there is no display.
fn open() -> Result<EventLoop<Option<String>>> {
    // winit panics if a display library or an extension of the server is missing.
    let before = panic::take_hook();
    panic::set_hook(Box::new(|_| {}));
    let opened = panic::catch_unwind(|| EventLoop::with_user_event().build());
    panic::set_hook(before);
    match opened {
        Ok(Ok(events)) => Ok(events),
        Ok(Err(error)) => Err(unfit(&no_display(&error.to_string()))),
        Err(payload) => {
            let text = payload.downcast_ref::<String>().cloned();
            let text = text.or_else(|| payload.downcast_ref::<&str>().map(|text| (*text).to_owned()));
            Err(unfit(&no_display(&text.unwrap_or_default())))
        }
    }
}
