//! A camera path rendered to frames; [`Assembly`] makes the film of them.

use super::draw::{self, Painter};
use super::protocol::{CameraMessage, FilmRequest};
use ashsplat::scene::{Camera, Intrinsics, WorldFrame, tour};
use ashsplat::{Error, RenderSettings, Result};
use ashsplat_files::cameras_json;
use ashsplat_files::{Photo, PhotoFileFormat};
use ashsplat_program::film_file::{self, Container, Frames};
use ashsplat_program::output;
use glam::{Mat3, Vec3};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// Most frames of a film.
const MOST_FRAMES: u32 = 3000;

/// A film whose frames are being rendered.
pub struct Film {
    client: u64,
    name: String,
    folder: PathBuf,
    cameras: Vec<Camera>,
    request: FilmRequest,
    /// Number of frames rendered.
    done: usize,
}

impl Film {
    /// Checks the request and writes the camera path, which `ashsplat render --path` reads.
    pub fn begin(client: u64, request: FilmRequest, (folder, frame): (&Path, &WorldFrame)) -> Result<Film> {
        let cameras = cameras(&request)?;
        // A number is free if no earlier film wrote files of that name.
        let taken = |number: &u32| {
            let name = film_name(*number);
            folder.join(Film::path_name(&name)).exists() || folder.join(name).exists()
        };
        let name = film_name((1..).find(|number| !taken(number)).unwrap_or_default());
        let names: Vec<String> = (0..cameras.len()).map(|index| format!("{index:05}")).collect();
        let named = names.iter().map(String::as_str).zip(&cameras);
        output::in_folder(&folder.join(Film::path_name(&name)), |path| {
            cameras_json::write(path, named, frame)
        })?;
        Ok(Film { client, name, folder: folder.to_owned(), cameras, request, done: 0 })
    }

    /// The file with a film's cameras.
    fn path_name(name: &str) -> String {
        format!("{name}.json")
    }

    /// Page that requested the film.
    pub fn client(&self) -> u64 {
        self.client
    }

    /// Returns the work that remains once all frames are rendered.
    pub fn assembly(&self) -> Option<Assembly> {
        (self.done == self.cameras.len()).then(|| Assembly {
            name: self.name.clone(),
            folder: self.folder.clone(),
            frames: self.done,
            frames_per_second: self.request.frames_per_second,
        })
    }

    /// Width and height of a frame, pixels.
    pub fn size(&self) -> [u32; 2] {
        [self.request.width, self.request.height]
    }

    /// Most Gaussians of a frame of a tree of tiles.
    pub fn budget(&self) -> Option<u64> {
        self.request.look.budget
    }

    /// Renders the next frame and returns the message for the page. None while a part of the scene that the frame needs is not loaded.
    pub fn advance(&mut self, painter: &mut dyn Painter, base: &RenderSettings) -> Result<Option<Value>> {
        if let Some(camera) = self.cameras.get(self.done) {
            if !painter.is_ready(camera)? {
                return Ok(None);
            }
            let photo = draw::draw(painter, camera, base, &self.request.look, None)?.photo;
            let frames = self.folder.join(&self.name);
            output::write_png(&output::numbered(&frames, self.done, "png"), &photo)?;
            self.done += 1;
        }
        Ok(Some(json!({ "type": "film", "done": self.done, "total": self.cameras.len() })))
    }

    /// Removes the files that this film wrote.
    pub fn discard(self) {
        std::fs::remove_dir_all(self.folder.join(&self.name)).ok();
        std::fs::remove_file(self.folder.join(Film::path_name(&self.name))).ok();
    }
}

fn film_name(number: u32) -> String {
    format!("film_{number:03}")
}

/// The cameras of all frames.
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
    if frames > MOST_FRAMES as f32 {
        return bad(&format!("would have {frames} frames; {MOST_FRAMES} are the most"));
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
    let focal = 0.5 * height as f32 / (0.5 * fov_y).tan();
    Intrinsics { fx: focal, fy: focal, cx: 0.5 * width as f32, cy: 0.5 * height as f32, width, height }
}

/// Widest GIF, pixels: 8 bits of colour look no better in a larger one.
const GIF_WIDTH: u32 = 640;

/// Frames in a folder, to be made into a film.
pub struct Assembly {
    name: String,
    folder: PathBuf,
    frames: usize,
    frames_per_second: u32,
}

impl Assembly {
    /// Writes the films. Returns their names, and why there is no MP4. Stops early if `abandoned` is set.
    pub fn run(&self, abandoned: &AtomicBool) -> Result<Value> {
        let gif = self.write(Container::Gif, GIF_WIDTH, abandoned)?;
        let (mp4, note) = match self.write(Container::Mp4, u32::MAX, abandoned) {
            Ok(name) => (Some(name), None),
            Err(reason) => (None, Some(format!("no MP4: {reason}"))),
        };
        let path = Film::path_name(&self.name);
        Ok(
            json!({ "gif": gif, "mp4": mp4, "path": path, "frames": self.folder.join(&self.name), "note": note }),
        )
    }

    /// Returns the file's name.
    fn write(&self, container: Container, widest: u32, abandoned: &AtomicBool) -> Result<String> {
        let name = format!("{}.{}", self.name, if container == Container::Gif { "gif" } else { "mp4" });
        let mut frame = |index: usize| {
            let path = output::numbered(&self.folder.join(&self.name), index, "png");
            let photo = Photo::read(path, [0.0; 3])?;
            let width = photo.width.min(widest);
            if width == photo.width {
                return Ok(photo);
            }
            let height = (photo.height * width / photo.width).max(1);
            photo.scaled_to(width, height)
        };
        let frames =
            Frames { count: self.frames, per_second: self.frames_per_second, frame: &mut frame, abandoned };
        film_file::write(&self.folder.join(&name), container, frames)?;
        Ok(name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::{Look, PathKey};

    fn key(x: f32, angle: f32) -> PathKey {
        let rotation = Mat3::from_rotation_y(angle);
        PathKey { position: [x, 0.0, -3.0], rotation: rotation.transpose().to_cols_array_2d(), fov_y: 0.8 }
    }

    fn request(keys: Vec<PathKey>, closed: bool) -> FilmRequest {
        let look = Look::default();
        FilmRequest { keys, seconds: 1.0, frames_per_second: 9, closed, width: 32, height: 24, look }
    }

    #[test]
    fn paths_pass_through_their_keys() {
        let keys = vec![key(0.0, 0.0), key(1.0, 0.4), key(3.0, 0.2)];
        let open = cameras(&request(keys.clone(), false)).expect("a path");
        let position = |camera: &Camera| camera.position().x;
        let passes = [0, 4, 8].map(|frame| position(&open[frame]));
        passes.iter().zip([0.0, 1.0, 3.0]).for_each(|(x, key)| assert!((x - key).abs() < 1e-4, "{passes:?}"));
        let closed = cameras(&request(keys, true)).expect("a path");
        let passes = [0, 3, 6].map(|frame| position(&closed[frame]));
        passes.iter().zip([0.0, 1.0, 3.0]).for_each(|(x, key)| assert!((x - key).abs() < 1e-4, "{passes:?}"));
        open.iter().chain(&closed).for_each(|camera| camera.check().expect("sound"));
    }

    #[test]
    fn impossible_films_are_refused() {
        let keys = vec![key(0.0, 0.0), key(1.0, 0.4)];
        assert!(cameras(&request(keys[..1].to_vec(), false)).is_err());
        assert!(cameras(&FilmRequest { seconds: 1e9, ..request(keys.clone(), false) }).is_err());
        assert!(cameras(&FilmRequest { frames_per_second: 0, ..request(keys.clone(), false) }).is_err());
        assert!(cameras(&FilmRequest { width: 0, ..request(keys, false) }).is_err());
    }
}
