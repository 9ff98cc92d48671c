//! A camera path as a film: frames, an animated GIF, and an MP4 where ffmpeg is installed.

use super::draw::{self, Painter};
use super::protocol::{CameraMessage, FilmRequest, PathKey};
use crate::output;
use ashsplat::io::{Photo, atomic, cameras_json};
use ashsplat::scene::{Camera, Intrinsics};
use ashsplat::{Error, RenderSettings, Result};
use glam::{Mat3, Quat, Vec3};
use image::codecs::gif::{GifEncoder, Repeat};
use serde_json::{Value, json};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Most frames of a film.
const MOST_FRAMES: u32 = 3000;
/// Widest GIF; 8 bits of colour are no better at more.
const GIF_WIDTH: u32 = 640;
/// GIFs count in hundredths of a second, and browsers do not go below two.
const GIF_LEAST_DELAY_MS: u32 = 20;
/// 1 to 30, quicker: how carefully a GIF's colours are chosen.
const GIF_SPEED: i32 = 10;

/// A film that is being made, frame by frame.
pub struct Film {
    client: u64,
    name: String,
    folder: PathBuf,
    cameras: Vec<Camera>,
    request: FilmRequest,
    /// Frames done.
    done: usize,
    gif: Vec<Photo>,
}

impl Film {
    /// Checks what is asked for and writes the path, which `ashsplat render --path` reads.
    pub fn begin(client: u64, request: FilmRequest, folder: &Path) -> Result<Film> {
        let cameras = cameras(&request)?;
        let taken = |number: &u32| folder.join(format!("film_{number:03}.json")).exists();
        let number = (1..).find(|number| !taken(number)).unwrap_or_default();
        let name = format!("film_{number:03}");
        let names: Vec<String> = (0..cameras.len()).map(|index| format!("{index:05}")).collect();
        let named = names.iter().map(String::as_str).zip(&cameras);
        output::in_folder(&folder.join(format!("{name}.json")), |path| cameras_json::write(path, named))?;
        Ok(Film { client, name, folder: folder.to_owned(), cameras, request, done: 0, gif: Vec::new() })
    }

    /// Who asked for it.
    pub fn client(&self) -> u64 {
        self.client
    }

    pub fn is_done(&self) -> bool {
        self.done > self.cameras.len()
    }

    /// Renders the next frame, or puts the film together; what to tell the page.
    pub fn advance(&mut self, painter: &mut dyn Painter, base: &RenderSettings) -> Result<Value> {
        let total = self.cameras.len();
        let Some(camera) = self.cameras.get(self.done) else {
            let files = self.finish()?;
            self.done += 1;
            return Ok(json!({ "type": "film", "done": total, "total": total, "files": files }));
        };
        let photo = draw::draw(painter, camera, base, &self.request.look)?.photo;
        output::write_png(&output::numbered(&self.frames(), self.done, "png"), &photo)?;
        let width = photo.width.min(GIF_WIDTH);
        let height = (photo.height * width / photo.width).max(1);
        self.gif.push(photo.scaled_to(width, height)?);
        self.done += 1;
        Ok(json!({ "type": "film", "done": self.done, "total": total }))
    }

    fn frames(&self) -> PathBuf {
        self.folder.join(&self.name)
    }

    /// The films' files, and what became of the MP4.
    fn finish(&mut self) -> Result<Value> {
        let gif = format!("{}.gif", self.name);
        atomic::write(self.folder.join(&gif), |out| self.write_gif(out))?;
        self.gif.clear();
        let (mp4, note) = match self.write_mp4() {
            Ok(name) => (Some(name), None),
            Err(reason) => (None, Some(format!("no MP4: {reason}"))),
        };
        let path = format!("{}.json", self.name);
        Ok(json!({ "gif": gif, "mp4": mp4, "path": path, "frames": self.frames(), "note": note }))
    }

    fn write_gif(&self, out: &mut dyn Write) -> std::io::Result<()> {
        let mut encoder = GifEncoder::new_with_speed(out, GIF_SPEED);
        encoder.set_repeat(Repeat::Infinite).map_err(std::io::Error::other)?;
        let delay = (1000 / self.request.frames_per_second).max(GIF_LEAST_DELAY_MS);
        for photo in &self.gif {
            let rgba = photo.rgb.as_chunks::<3>().0.iter().flat_map(|&[r, g, b]| [r, g, b, 255]).collect();
            let Some(buffer) = image::RgbaImage::from_raw(photo.width, photo.height, rgba) else {
                return Err(std::io::Error::other("a frame without its size"));
            };
            let delay = image::Delay::from_numer_denom_ms(delay, 1);
            let frame = image::Frame::from_parts(buffer, 0, 0, delay);
            encoder.encode_frame(frame).map_err(std::io::Error::other)?;
        }
        Ok(())
    }

    /// By ffmpeg, if it is there; its name, or why there is none.
    fn write_mp4(&self) -> Result<String, String> {
        let name = format!("{}.mp4", self.name);
        let path = self.folder.join(&name);
        let output = Command::new("ffmpeg")
            .args(["-hide_banner", "-loglevel", "error", "-y", "-framerate"])
            .arg(self.request.frames_per_second.to_string())
            .arg("-i")
            .arg(self.frames().join("%05d.png"))
            // Most players want even sizes and 4:2:0.
            .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p", "-movflags", "+faststart"])
            .arg(&path)
            .stdin(Stdio::null())
            .output();
        match output {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Err("ffmpeg is not installed".into()),
            Err(e) => Err(format!("ffmpeg cannot be started: {e}")),
            Ok(done) if done.status.success() => Ok(name),
            Ok(done) => {
                std::fs::remove_file(&path).ok();
                let said = String::from_utf8_lossy(&done.stderr);
                Err(format!("ffmpeg: {}", said.lines().next().unwrap_or("failed")))
            }
        }
    }
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
    let frames = frames as u32;
    let rotations = keys.iter().map(|key| {
        let rotation = Mat3::from_cols_array_2d(&key.rotation).transpose();
        let position = Vec3::from_array(key.position);
        let intrinsics = from_fov_y(key.fov_y, *width, *height);
        let camera = Camera::with_pose(rotation, -(rotation * position), intrinsics);
        CameraMessage::of(&camera).camera()?;
        Ok(Quat::from_mat3(&rotation))
    });
    let rotations = rotations.collect::<Result<Vec<Quat>>>()?;
    let spans = if *closed { keys.len() } else { keys.len() - 1 };
    // An open path ends at its last key; a closed one a step before its first.
    let steps = if *closed { frames } else { frames.max(2) - 1 };
    let camera = |frame: u32| {
        let at = spans as f32 * frame as f32 / steps as f32;
        let span = (at as usize).min(spans - 1);
        let key = interpolate(keys, &rotations, span, at - span as f32, *closed);
        let rotation = Mat3::from_cols_array_2d(&key.rotation).transpose();
        let position = Vec3::from_array(key.position);
        Camera::with_pose(rotation, -(rotation * position), from_fov_y(key.fov_y, *width, *height))
    };
    Ok((0..frames).map(camera).collect())
}

fn from_fov_y(fov_y: f32, width: u32, height: u32) -> Intrinsics {
    let focal = 0.5 * height as f32 / (0.5 * fov_y).tan();
    Intrinsics { fx: focal, fy: focal, cx: 0.5 * width as f32, cy: 0.5 * height as f32, width, height }
}

/// Between two keys: positions on a Catmull-Rom curve, rotations the shortest way, both eased by nothing.
fn interpolate(keys: &[PathKey], rotations: &[Quat], span: usize, t: f32, closed: bool) -> PathKey {
    let count = keys.len() as i64;
    let index = |offset: i64| {
        let wanted = span as i64 + offset;
        if closed { wanted.rem_euclid(count) as usize } else { wanted.clamp(0, count - 1) as usize }
    };
    let p = [-1, 0, 1, 2].map(|offset| Vec3::from_array(keys[index(offset)].position));
    let position = 0.5
        * (2.0 * p[1]
            + (p[2] - p[0]) * t
            + (2.0 * p[0] - 5.0 * p[1] + 4.0 * p[2] - p[3]) * t * t
            + (3.0 * p[1] - p[0] - 3.0 * p[2] + p[3]) * t * t * t);
    let rotation = Mat3::from_quat(rotations[index(0)].slerp(rotations[index(1)], t));
    let (from, to) = (keys[index(0)].fov_y, keys[index(1)].fov_y);
    PathKey {
        position: position.to_array(),
        rotation: rotation.transpose().to_cols_array_2d(),
        fov_y: from + t * (to - from),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::protocol::Look;

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
