//! A camera path rendered to frames, and the film made of them.

use super::draw::{self, ViewedScene};
use super::protocol::{CameraMessage, FilmRequest};
use ashsplat::scene::{Camera, Intrinsics, WorldFrame, tour};
use ashsplat::{Error, RenderSettings, Result};
use ashsplat_files::{Photo, PhotoFileFormat, cameras_json};
use ashsplat_program::film_file::{self, Container, Frames};
use ashsplat_program::output;
use glam::{Mat3, Vec3};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// Most frames of a film.
const MAX_FRAMES: u32 = 3000;
/// Widest GIF, pixels: 8 bits of colour look no better in a larger one.
const GIF_WIDTH: u32 = 640;

pub struct Film {
    pub client: u64,
    pub request: FilmRequest,
    /// Folder of the frames. The film's other files lie beside it, with endings.
    frames: PathBuf,
    cameras: Vec<Camera>,
    done: usize,
}

impl Film {
    /// Checks the request and writes the camera path, which `ashsplat render --path` reads.
    pub fn begin(client: u64, request: FilmRequest, (folder, frame): (&Path, &WorldFrame)) -> Result<Film> {
        let cameras = cameras(&request)?;
        // A number is free if no earlier film wrote files of that name.
        let is_free = |frames: &PathBuf| !frames.exists() && !frames.with_extension("json").exists();
        let frames = (1_u32..).map(|number| folder.join(format!("film_{number:03}"))).find(is_free);
        let frames = frames.unwrap_or_default();
        let names: Vec<String> = (0..cameras.len()).map(|index| format!("{index:05}")).collect();
        let named = names.iter().map(String::as_str).zip(&cameras);
        output::in_folder(&frames.with_extension("json"), |path| cameras_json::write(path, named, frame))?;
        Ok(Film { client, request, frames, cameras, done: 0 })
    }

    pub fn is_rendered(&self) -> bool {
        self.done == self.cameras.len()
    }

    /// Renders the next frame and returns the message for the page. None while a part of the scene that the frame needs is not loaded.
    pub fn advance(&mut self, scene: &mut dyn ViewedScene, base: &RenderSettings) -> Result<Option<Value>> {
        if let Some(camera) = self.cameras.get(self.done) {
            if !scene.is_ready(camera)? {
                return Ok(None);
            }
            let photo = draw::draw(scene, camera, base, &self.request.look, None)?.photo;
            output::write_png(&output::numbered(&self.frames, self.done, "png"), &photo)?;
            self.done += 1;
        }
        Ok(Some(json!({ "type": "film", "done": self.done, "total": self.cameras.len() })))
    }

    pub fn discard(&self) {
        std::fs::remove_dir_all(&self.frames).ok();
        std::fs::remove_file(self.frames.with_extension("json")).ok();
    }

    /// Makes films of the frames. Returns their names, and why there is no MP4. Stops early if `abandoned` is set.
    pub fn assemble(&self, abandoned: &AtomicBool) -> Result<Value> {
        let gif = self.write(Container::Gif, GIF_WIDTH, abandoned)?;
        let (mp4, note) = match self.write(Container::Mp4, u32::MAX, abandoned) {
            Ok(name) => (Some(name), None),
            Err(reason) => (None, Some(format!("no MP4: {reason}"))),
        };
        let path = self.name("json");
        Ok(json!({ "gif": gif, "mp4": mp4, "path": path, "frames": self.frames, "note": note }))
    }

    fn name(&self, ending: &str) -> String {
        self.frames.with_extension(ending).file_name().unwrap_or_default().to_string_lossy().into_owned()
    }

    /// Returns the file's name.
    fn write(&self, container: Container, widest: u32, abandoned: &AtomicBool) -> Result<String> {
        let ending = if container == Container::Gif { "gif" } else { "mp4" };
        let mut frame = |index: usize| {
            let path = output::numbered(&self.frames, index, "png");
            output::narrowed(Photo::read(path, [0.0; 3])?, widest)
        };
        let per_second = self.request.frames_per_second;
        let frames = Frames { count: self.done, per_second, frame: &mut frame, abandoned };
        film_file::write(&self.frames.with_extension(ending), container, frames)?;
        Ok(self.name(ending))
    }
}

fn cameras(request: &FilmRequest) -> Result<Vec<Camera>> {
    let bad = |problem: &str| Err(Error::argument("film", problem));
    let FilmRequest { keys, seconds, frames_per_second, closed, width, height, .. } = request;
    if keys.len() < 2 {
        return bad("needs two keys at least: look around and add some");
    }
    if !((1..=60).contains(frames_per_second) && seconds.is_finite() && *seconds > 0.0) {
        return bad("needs 1 to 60 frames per second and a positive length");
    }
    let frames = (seconds * *frames_per_second as f32).round().max(1.0);
    if frames > MAX_FRAMES as f32 {
        return bad(&format!("would have {frames} frames; {MAX_FRAMES} are the most"));
    }
    let keys = keys.iter().map(|key| {
        let rotation = Mat3::from_cols_array_2d(&key.rotation).transpose();
        let position = Vec3::from_array(key.position).as_dvec3();
        let camera = Camera::at(position, rotation.as_dmat3(), from_fov_y(key.fov_y, *width, *height));
        CameraMessage::of(&camera).camera()?;
        Ok(camera)
    });
    Ok(tour::through_keys(&keys.collect::<Result<Vec<_>>>()?, frames as u32, *closed))
}

fn from_fov_y(fov_y: f32, width: u32, height: u32) -> Intrinsics {
    let focal = Intrinsics::from_fov_x(fov_y, height, width).fy;
    Intrinsics { fx: focal, fy: focal, cx: 0.5 * width as f32, cy: 0.5 * height as f32, width, height }
}
