//! A film's frames put together: an animated GIF, and an MP4 where ffmpeg is installed. One frame is in memory at a time.

use super::Film;
use crate::output;
use ashsplat::{Error, Result};
use ashsplat_files::{Photo, PhotoFileFormat, atomic};
use image::codecs::gif::{GifEncoder, Repeat};
use serde_json::{Value, json};
use std::io::{Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Widest GIF; 8 bits of colour are no better at more.
const GIF_WIDTH: u32 = 640;
/// GIFs count in hundredths of a second, and browsers take less than two of them for ten.
const GIF_LEAST_DELAY: usize = 2;
/// 1 to 30, quicker: how carefully a GIF's colours are chosen.
const GIF_SPEED: i32 = 10;
/// Between two looks at ffmpeg.
const POLL: Duration = Duration::from_millis(20);

/// Sides made even and colours halved, as most players want them; BT.709, and said so: without, players guess.
const FILTER: &str =
    "pad=ceil(iw/2)*2:ceil(ih/2)*2,scale=in_range=pc:out_range=tv:out_color_matrix=bt709,format=yuv420p";
const TAGS: [&str; 8] = [
    "-color_primaries",
    "bt709",
    "-color_trc",
    "iec61966-2-1",
    "-colorspace",
    "bt709",
    "-movflags",
    "+faststart",
];

/// Frames that lie in a folder, and what is to become of them.
pub struct Assembly {
    pub(super) name: String,
    pub(super) folder: PathBuf,
    pub(super) frames: usize,
    pub(super) frames_per_second: u32,
}

impl Assembly {
    /// Puts the film together; names of its files, and why there is no MP4. What is `abandoned` ends early.
    pub fn run(&self, abandoned: &AtomicBool) -> Result<Value> {
        let gif = format!("{}.gif", self.name);
        let path = self.folder.join(&gif);
        atomic::write(&path, |out| self.write_gif(out, abandoned))?;
        let (mp4, note) = match self.write_mp4(abandoned) {
            Ok(name) => (Some(name), None),
            Err(reason) => (None, Some(format!("no MP4: {reason}"))),
        };
        let path = Film::path_name(&self.name);
        Ok(
            json!({ "gif": gif, "mp4": mp4, "path": path, "frames": self.folder.join(&self.name), "note": note }),
        )
    }

    fn frame(&self, index: usize) -> PathBuf {
        output::numbered(&self.folder.join(&self.name), index, "png")
    }

    fn write_gif(&self, out: &mut dyn Write, abandoned: &AtomicBool) -> std::io::Result<()> {
        let mut encoder = GifEncoder::new_with_speed(out, GIF_SPEED);
        encoder.set_repeat(Repeat::Infinite).map_err(std::io::Error::other)?;
        for (index, hundredths) in gif_frames(self.frames, self.frames_per_second as usize) {
            if abandoned.load(Ordering::Relaxed) {
                return Err(std::io::Error::other("abandoned"));
            }
            let photo = Photo::read(self.frame(index), [0.0; 3]).map_err(std::io::Error::other)?;
            let width = photo.width.min(GIF_WIDTH);
            let height = (photo.height * width / photo.width).max(1);
            let photo = photo.scaled_to(width, height).map_err(std::io::Error::other)?;
            let rgba = photo.rgb.as_chunks::<3>().0.iter().flat_map(|&[r, g, b]| [r, g, b, 255]).collect();
            let Some(buffer) = image::RgbaImage::from_raw(photo.width, photo.height, rgba) else {
                return Err(std::io::Error::other("a frame without its size"));
            };
            let delay = image::Delay::from_numer_denom_ms(10 * hundredths as u32, 1);
            encoder
                .encode_frame(image::Frame::from_parts(buffer, 0, 0, delay))
                .map_err(std::io::Error::other)?;
        }
        Ok(())
    }

    /// By ffmpeg, if it is there; its name, or why there is none.
    fn write_mp4(&self, abandoned: &AtomicBool) -> Result<String, String> {
        let name = format!("{}.mp4", self.name);
        // Under another name until it is whole.
        let unfinished = self.folder.join(format!("{name}.part"));
        let written = self.run_ffmpeg(&unfinished, abandoned).and_then(|()| {
            std::fs::rename(&unfinished, self.folder.join(&name))
                .map_err(|e| format!("cannot be renamed: {e}"))
        });
        if written.is_err() {
            std::fs::remove_file(&unfinished).ok();
        }
        written.map(|()| name)
    }

    fn run_ffmpeg(&self, path: &Path, abandoned: &AtomicBool) -> Result<(), String> {
        // A file instead of a pipe: no thread would read the pipe while ffmpeg runs.
        let trouble = |e: std::io::Error| format!("ffmpeg cannot be started: {e}");
        let mut said = tempfile::tempfile().map_err(trouble)?;
        let mut command = Command::new("ffmpeg");
        command
            .args(["-hide_banner", "-loglevel", "error", "-y", "-framerate"])
            .arg(self.frames_per_second.to_string())
            .arg("-i")
            .arg(self.folder.join(&self.name).join("%05d.png"))
            .args(["-vf", FILTER])
            .args(TAGS)
            .args(["-f", "mp4"])
            .arg(path)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(said.try_clone().map_err(trouble)?);
        let mut child = command.spawn().map_err(|e| match e.kind() {
            std::io::ErrorKind::NotFound => "ffmpeg is not installed".to_owned(),
            _ => trouble(e),
        })?;
        let status = loop {
            match child.try_wait() {
                Ok(Some(status)) => break status,
                Ok(None) if !abandoned.load(Ordering::Relaxed) => std::thread::sleep(POLL),
                _ => {
                    child.kill().ok();
                    child.wait().ok();
                    return Err("abandoned".into());
                }
            }
        };
        if status.success() {
            return Ok(());
        }
        let mut text = String::new();
        said.rewind().and_then(|()| said.read_to_string(&mut text)).ok();
        Err(format!("ffmpeg: {}", text.lines().next().unwrap_or("failed")))
    }
}

/// The frames of a GIF and how long each is shown, hundredths of a second: what is lost by rounding one is made up by the
/// next, so that the film has its length. Beyond 50 frames per second some are left out.
fn gif_frames(frames: usize, frames_per_second: usize) -> Vec<(usize, usize)> {
    let begins = |frame: usize| (200 * frame + frames_per_second) / (2 * frames_per_second);
    let mut shown: Vec<(usize, usize)> = Vec::new();
    for frame in 0..frames {
        if shown.last().is_none_or(|&(last, _)| begins(frame) >= begins(last) + GIF_LEAST_DELAY) {
            shown.push((frame, 0));
        }
    }
    let ends: Vec<usize> = shown.iter().skip(1).map(|&(next, _)| next).chain([frames]).map(begins).collect();
    for ((frame, hundredths), end) in shown.iter_mut().zip(ends) {
        *hundredths = (end - begins(*frame)).max(GIF_LEAST_DELAY);
    }
    shown
}

/// A film that could not be put together, for people.
pub fn problem(error: &Error) -> String {
    format!("the film's frames are there, but the film is not: {error}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delays_of_a_gif_add_up() {
        for frames_per_second in 1..=60 {
            for seconds in [1, 3, 7] {
                let shown = gif_frames(seconds * frames_per_second, frames_per_second);
                let total: usize = shown.iter().map(|(_, hundredths)| hundredths).sum();
                let tells = format!("{seconds} s at {frames_per_second} per second: {total}");
                assert!(total.abs_diff(100 * seconds) <= 1, "{tells}");
                assert!(shown.iter().all(|(_, hundredths)| *hundredths >= GIF_LEAST_DELAY), "{tells}");
                let all = shown.len() == seconds * frames_per_second;
                assert!(shown.is_sorted() && (all || frames_per_second > 50), "{tells}");
            }
        }
        assert_eq!(gif_frames(4, 30), [(0, 3), (1, 4), (2, 3), (3, 3)]);
        assert_eq!(gif_frames(1, 60), [(0, 2)]);
    }
}
