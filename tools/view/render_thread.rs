//! The rendering thread: serves the hub's tasks one by one.

use super::appearances::PhotoAppearances;
use super::cut;
use super::draw::{self, ViewedScene, Viewer, ViewerSettings};
use super::edits::GaussianSet;
use super::film::Film;
use super::hub::{CurrentScene, Hub, SceneAnswer, Task};
use super::protocol::{self, ToPage, ViewRequest, ViewSettings};
use super::sizes::Sizes;
use ashsplat::scene::WorldFrame;
use ashsplat::{Error, RenderSettings, Result, Trainer};
use ashsplat_files::splats::WriteOptions;
use serde_json::{Value, json};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Most films that are encoded at once: each takes a processor, descriptors and a frame's memory.
const MAX_ASSEMBLED: usize = 2;

/// Pause before a film checks again for its next frame's tiles: pages are served meanwhile.
const TILE_WAIT: Duration = Duration::from_millis(5);

pub struct RenderThread {
    hub: Arc<Hub>,
    /// Render settings that the scene was trained with.
    base: RenderSettings,
    appearances: PhotoAppearances,
    /// Coordinate frame of the scene within its files' coordinates.
    frame: WorldFrame,
    films: PathBuf,
    film: Option<Film>,
    sizes: Sizes,
    /// Finished films being encoded, each on its own thread: neither frames nor training wait for them.
    assembling: Vec<JoinHandle<()>>,
    /// Tells these threads that no page needs their films any more.
    abandoned: Arc<AtomicBool>,
}

impl RenderThread {
    pub fn new(hub: Arc<Hub>, base: RenderSettings, films: PathBuf) -> RenderThread {
        RenderThread {
            hub,
            base,
            appearances: PhotoAppearances::default(),
            frame: WorldFrame::default(),
            films,
            film: None,
            sizes: Sizes::default(),
            assembling: Vec::new(),
            abandoned: Arc::default(),
        }
    }

    /// Switches to another scene, drawn as it was trained.
    pub fn show(&mut self, base: RenderSettings, appearances: PhotoAppearances, frame: WorldFrame) {
        (self.base, self.appearances, self.frame) = (base, appearances, frame);
    }

    /// Does one task, if one arrives in time.
    ///
    /// # Errors
    /// When the device is lost. Other errors are reported to the page that made the request.
    pub fn serve(&mut self, scene: &mut dyn ViewedScene, longest: Duration) -> Result<()> {
        let Some(task) = self.hub.next(longest) else { return Ok(()) };
        match task {
            Task::Frame { client, request } => {
                self.set_viewer(scene, client, &request.look);
                let answer = self.answer(scene, &request);
                let failed = answer.is_err();
                self.reply(client, answer)?;
                if failed {
                    // No frame was sent, so the page will not confirm one.
                    self.hub.acknowledge(client);
                } else {
                    self.shrink_if_smaller(scene, [request.camera.width, request.camera.height]);
                }
            }
            Task::Pick { client, pick } => {
                self.set_viewer(scene, client, &pick.look);
                let settings = draw::settings(&self.base, &pick.look);
                let report = pick
                    .camera
                    .camera()
                    .and_then(|camera| Ok((camera, scene.inspect(&camera, &settings, pick.pixel)?)));
                if report.is_ok() {
                    self.shrink_if_smaller(scene, [pick.camera.width, pick.camera.height]);
                }
                let answer = report
                    .map(|(camera, r)| ToPage::json(&protocol::picked(pick.id, pick.pixel, &camera, &r)));
                self.reply(client, answer)?;
            }
            Task::Film => self.render_film_frame(scene)?,
            Task::Scene { part, answer } => self.send_scene(scene, part, answer)?,
            Task::Edit { client, edit } => match scene.edit(&edit) {
                Ok(()) => self.hub.renew(),
                Err(error) => self.reply(client, Err(error))?,
            },
        }
        Ok(())
    }

    fn answer(&self, scene: &mut dyn ViewedScene, request: &ViewRequest) -> Result<ToPage> {
        let camera = request.camera.camera()?;
        let appearance =
            request.as_photo.map(|photo| self.appearances.of(photo, scene.trainer())).transpose()?;
        let start = Instant::now();
        let drawn = draw::draw(scene, &camera, &self.base, &request.look, appearance)?;
        let render_ms = start.elapsed().as_secs_f64() * 1e3;
        let start = Instant::now();
        let bytes = draw::encode(&drawn.photo, request.look.quality)?;
        let encode_ms = start.elapsed().as_secs_f64() * 1e3;
        let settings = draw::settings(&self.base, &request.look);
        let s = &drawn.stats;
        let stats = json!({
            "gaussians": s.gaussians, "visible": s.visible, "instances": s.instances, "longest_tile": s.longest_tile,
        });
        let header = json!({
            "seq": request.seq, "width": camera.width, "height": camera.height,
            "format": if request.look.quality == 0 { "image/png" } else { "image/jpeg" },
            "render_ms": render_ms, "encode_ms": encode_ms, "stats": stats, "legend": drawn.legend,
            "iteration": scene.trainer().map(Trainer::iteration), "tree": scene.tree(),
            "edits": scene.edits(),
            // Options and address that make the same cut of the file.
            "convert": cut::options(&settings, &self.frame),
            "export": cut::query(&settings),
        });
        Ok(ToPage::frame(&header, &bytes))
    }

    /// Frees memory if earlier pictures were much larger than this one and those before it.
    fn shrink_if_smaller(&mut self, scene: &mut dyn ViewedScene, [width, height]: [u32; 2]) {
        if self.sizes.note(u64::from(width) * u64::from(height)) {
            scene.shrink();
        }
    }

    fn set_viewer(&self, scene: &mut dyn ViewedScene, page: u64, look: &ViewSettings) {
        scene.set_viewer(&ViewerSettings {
            viewer: Viewer { page, films: false },
            budget: look.budget,
            selection: look.selection,
            is_connected: &|viewer| match viewer.films {
                true => self.film.is_some(),
                false => self.hub.has_page(viewer.page),
            },
        });
    }

    fn reply(&self, client: u64, answer: Result<ToPage>) -> Result<()> {
        match answer {
            Ok(message) => self.hub.send(client, message),
            Err(error) => {
                self.hub.send(client, ToPage::problem(&error.to_string()));
                fatal(error)?;
            }
        }
        Ok(())
    }

    /// Sends the scene to the thread that writes it to a file.
    fn send_scene(&self, scene: &dyn ViewedScene, part: GaussianSet, answer: SceneAnswer) -> Result<()> {
        // The requester may have gone.
        if answer.is_closed() {
            return Ok(());
        }
        let marks = WriteOptions { frame: self.frame, ..WriteOptions::marking(&self.base) };
        match scene.gaussians(part) {
            Ok(gaussians) => drop(answer.send(Ok(CurrentScene { gaussians, marks }))),
            Err(error) => {
                drop(answer.send(Err(error.to_string())));
                fatal(error)?;
            }
        }
        Ok(())
    }

    /// Renders one frame of the film in progress, or begins the next film.
    fn render_film_frame(&mut self, scene: &mut dyn ViewedScene) -> Result<()> {
        let Some(mut film) = self.film.take() else {
            self.begin_film();
            return Ok(());
        };
        if self.hub.film_is_cancelled() {
            self.cancel(&film);
            return Ok(());
        }
        let viewer = Viewer { page: film.client, films: true };
        let budget = film.request.look.budget;
        scene.set_viewer(&ViewerSettings { viewer, budget, selection: false, is_connected: &|_| true });
        match film.advance(scene, &self.base) {
            Err(error) => {
                self.cancel(&film);
                self.reply(film.client, Err(error))?;
            }
            // The tiles of its next frame are still being read.
            Ok(None) => {
                std::thread::sleep(TILE_WAIT);
                self.film = Some(film);
            }
            Ok(Some(progress)) => {
                self.shrink_if_smaller(scene, [film.request.width, film.request.height]);
                if film.is_rendered() {
                    self.end_film(film.client, ToPage::json(&progress));
                    self.assemble(film, progress);
                } else {
                    self.hub.send(film.client, ToPage::json(&progress));
                    self.film = Some(film);
                }
            }
        }
        Ok(())
    }

    fn begin_film(&mut self) {
        let Some((client, request)) = self.hub.take_film() else { return };
        self.assembling.retain(|thread| !thread.is_finished());
        let begun = match self.assembling.len() < MAX_ASSEMBLED {
            true => Film::begin(client, request, (&self.films, &self.frame)),
            false => Err(Error::argument("film", "others are being put together: ask again in a while")),
        };
        match begun {
            Ok(film) => self.film = Some(film),
            Err(error) => {
                self.end_film(client, ToPage::film_is_cancelled());
                self.hub.send(client, ToPage::problem(&error.to_string()));
            }
        }
    }

    fn cancel(&self, film: &Film) {
        film.discard();
        self.end_film(film.client, ToPage::film_is_cancelled());
    }

    /// Notifies the page and lets the next film begin.
    fn end_film(&self, client: u64, message: ToPage) {
        self.hub.film_ended();
        self.hub.send(client, message);
    }

    /// Encodes a film on its own thread, then notifies the page.
    fn assemble(&mut self, film: Film, mut progress: Value) {
        let (client, hub, abandoned) = (film.client, self.hub.clone(), self.abandoned.clone());
        let work = move || match film.assemble(&abandoned) {
            Ok(files) => {
                let names = ["gif", "mp4", "path"].iter().filter_map(|kind| files[kind].as_str());
                hub.publish_film(names.map(str::to_owned));
                progress["files"] = files;
                hub.send(client, ToPage::json(&progress));
            }
            Err(error) => {
                let problem = format!("the film's frames are there, but the film is not: {error}");
                hub.send(client, ToPage::problem(&problem));
                hub.send(client, ToPage::film_is_cancelled());
            }
        };
        match std::thread::Builder::new().name("film".into()).spawn(work) {
            Ok(thread) => self.assembling.push(thread),
            Err(error) => self.hub.send(client, ToPage::problem(&format!("no film: {error}"))),
        }
    }

    /// Waits for the films that are being encoded.
    pub fn finish(&mut self) {
        // A panic has been reported already.
        self.assembling.drain(..).for_each(|thread| drop(thread.join()));
    }
}

impl Drop for RenderThread {
    /// Leaves no half-made files.
    fn drop(&mut self) {
        self.abandoned.store(true, Ordering::Relaxed);
        self.finish();
        if let Some(film) = self.film.take() {
            film.discard();
        }
    }
}

/// Returns errors that must end the program.
pub fn fatal(error: Error) -> Result<()> {
    match error {
        Error::DeviceLost { .. } | Error::Timeout { .. } => Err(error),
        _ => Ok(()),
    }
}
