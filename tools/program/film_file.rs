//! Writes films: an animated GIF, or an MP4 or WebM by ffmpeg. One frame is in memory at a time.

use crate::child::{INSTALL_FFMPEG, Running, not_started};
use crate::output;
use ashsplat::{Error, Result};
use ashsplat_files::{Photo, atomic};
use image::codecs::gif::{GifEncoder, Repeat};
use std::io::{Read, Seek, Write};
use std::path::Path;
use std::process::{ChildStdin, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};

/// Least delay of a GIF frame, hundredths of a second; browsers replace shorter ones by ten.
const GIF_MIN_DELAY: usize = 2;
/// Speed of a GIF's choice of colours, from 1 (careful) to 30 (quick).
const GIF_SPEED: i32 = 10;

/// Pads sides to even numbers and halves the colours' resolution, as most players need. BT.709 is declared, or players
/// guess.
const FILTER: &str =
    "pad=ceil(iw/2)*2:ceil(ih/2)*2,scale=in_range=pc:out_range=tv:out_color_matrix=bt709,format=yuv420p";
const TAGS: [&str; 6] = ["-color_primaries", "bt709", "-color_trc", "iec61966-2-1", "-colorspace", "bt709"];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Container {
    Gif,
    Mp4,
    Webm,
}

impl Container {
    /// The container by a file's extension; `None` if it is not a film.
    pub fn of(path: &Path) -> Result<Option<Self>> {
        let ending = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
        match ending.as_str() {
            "gif" => Ok(Some(Self::Gif)),
            "mp4" => Ok(Some(Self::Mp4)),
            "webm" => Ok(Some(Self::Webm)),
            "mov" | "mkv" | "avi" | "m4v" | "mpg" | "mpeg" | "ogv" | "wmv" => Err(Error::input(
                path,
                "is a kind of film that is not written",
                "end it in .mp4, .webm or .gif",
            )),
            _ => Ok(None),
        }
    }

    /// Refuses a film that cannot be made on this machine, before its frames are drawn.
    pub fn check(self, path: &Path) -> Result<()> {
        if self == Self::Gif {
            return Ok(());
        }
        let asked = Command::new("ffmpeg").arg("-version").stdin(Stdio::null()).output();
        asked.map(drop).map_err(|e| self.failure(path, not_started("ffmpeg", &e)))
    }

    fn failure(self, path: &Path, problem: String) -> Error {
        Error::input(
            path,
            problem,
            format!("install ffmpeg with its codecs ({INSTALL_FFMPEG}), or end the name in .gif"),
        )
    }

    fn codec(self) -> &'static [&'static str] {
        match self {
            // Puts the index first, so that a browser need not load the whole file.
            Self::Mp4 => &["-movflags", "+faststart", "-f", "mp4"],
            Self::Webm => &["-c:v", "libvpx-vp9", "-b:v", "0", "-crf", "30", "-row-mt", "1", "-f", "webm"],
            Self::Gif => &[],
        }
    }
}

/// The frames of a film, all of one size.
pub struct Frames<'a> {
    pub count: usize,
    pub per_second: u32,
    /// Called in order; a GIF of more than 50 frames per second skips some.
    pub frame: &'a mut dyn FnMut(usize) -> Result<Photo>,
    /// Ends the work with an error when it becomes true.
    pub abandoned: &'a AtomicBool,
}

impl Frames<'_> {
    fn next(&mut self, index: usize) -> Result<Photo> {
        match self.abandoned.load(Ordering::Relaxed) {
            true => Err(Error::argument("film", "abandoned")),
            false => (self.frame)(index),
        }
    }
}

/// Writes a film, whole or not at all.
pub fn write(path: &Path, container: Container, mut frames: Frames) -> Result<()> {
    output::in_folder(path, |path| match container {
        Container::Gif => write_gif(path, &mut frames),
        Container::Mp4 | Container::Webm => write_by_ffmpeg(path, container, &mut frames),
    })
}

fn write_gif(path: &Path, frames: &mut Frames) -> Result<()> {
    let failed = |e: image::ImageError| match e {
        image::ImageError::IoError(e) => Error::io(path, "write", e),
        other => Error::input(path, format!("cannot encode: {other}"), ""),
    };
    atomic::write_seekable(path, |out| {
        let mut encoder = GifEncoder::new_with_speed(out, GIF_SPEED);
        encoder.set_repeat(Repeat::Infinite).map_err(failed)?;
        for (index, hundredths) in gif_frames(frames.count, frames.per_second as usize) {
            let photo = frames.next(index)?;
            let rgba = photo.rgb.as_chunks::<3>().0.iter().flat_map(|&[r, g, b]| [r, g, b, 255]).collect();
            let Some(buffer) = image::RgbaImage::from_raw(photo.width, photo.height, rgba) else {
                return Err(Error::input(path, "a frame has not its size", ""));
            };
            let delay = image::Delay::from_numer_denom_ms(10 * hundredths as u32, 1);
            encoder.encode_frame(image::Frame::from_parts(buffer, 0, 0, delay)).map_err(failed)?;
        }
        Ok(())
    })
}

fn write_by_ffmpeg(path: &Path, container: Container, frames: &mut Frames) -> Result<()> {
    let io = |e: std::io::Error| Error::io(path, "write", e);
    if path.is_dir() {
        return Err(Error::input(path, "is a folder", "give a file's name"));
    }
    // Written under a temporary name, which is removed unless the film is complete.
    let unfinished = atomic::unfinished(path)?;
    // A file instead of a pipe: no thread would read the pipe while ffmpeg runs.
    let mut stderr = tempfile::tempfile().map_err(io)?;
    let first = frames.next(0)?;
    let mut command = Command::new("ffmpeg");
    command
        .args(["-hide_banner", "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"])
        .args(["-video_size", &format!("{}x{}", first.width, first.height)])
        .args(["-framerate", &frames.per_second.to_string(), "-i", "-", "-vf", FILTER])
        .args(TAGS)
        .args(container.codec())
        .arg(unfinished.path())
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(stderr.try_clone().map_err(io)?);
    let child = command.spawn().map_err(|e| container.failure(path, not_started("ffmpeg", &e)))?;
    let mut ffmpeg = Running(child);
    let Some(mut input) = ffmpeg.0.stdin.take() else {
        return Err(container.failure(path, "ffmpeg takes no frames".to_owned()));
    };
    feed(&mut input, first, frames, io)?;
    drop(input);
    let status = ffmpeg.wait(frames.abandoned).map_err(io)?;
    if !status.is_some_and(|status| status.success()) {
        let mut text = String::new();
        stderr.rewind().and_then(|()| stderr.read_to_string(&mut text)).map_err(io)?;
        let line = text.lines().next().unwrap_or("failed").to_owned();
        return Err(container.failure(path, format!("ffmpeg: {line}")));
    }
    unfinished.persist()
}

/// Passes all frames to ffmpeg until it closes the pipe; its messages then give the reason.
fn feed(
    input: &mut ChildStdin,
    first: Photo,
    frames: &mut Frames,
    io: impl Fn(std::io::Error) -> Error,
) -> Result<()> {
    let size = (first.width, first.height);
    let mut photo = first;
    for index in 1..=frames.count {
        if (photo.width, photo.height) != size {
            return Err(Error::argument("film", "its frames differ in size"));
        }
        match input.write_all(&photo.rgb) {
            Err(error) if output::is_closed_pipe(&error) => return Ok(()),
            written => written.map_err(&io)?,
        }
        if index < frames.count {
            photo = frames.next(index)?;
        }
    }
    input.flush().map_err(io)
}

/// The frames of a GIF and their delays, hundredths of a second. The next delay makes up for the rounding of the
/// previous one, so the film keeps its length. Beyond 50 frames per second some frames are skipped.
fn gif_frames(frames: usize, frames_per_second: usize) -> Vec<(usize, usize)> {
    let begins = |frame: usize| (200 * frame + frames_per_second) / (2 * frames_per_second);
    let mut shown: Vec<(usize, usize)> = Vec::new();
    for frame in 0..frames {
        if shown.last().is_none_or(|&(last, _)| begins(frame) >= begins(last) + GIF_MIN_DELAY) {
            shown.push((frame, 0));
        }
    }
    let ends: Vec<usize> = shown.iter().skip(1).map(|&(next, _)| next).chain([frames]).map(begins).collect();
    for ((frame, hundredths), end) in shown.iter_mut().zip(ends) {
        *hundredths = (end - begins(*frame)).max(GIF_MIN_DELAY);
    }
    shown
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
                assert!(shown.iter().all(|(_, hundredths)| *hundredths >= GIF_MIN_DELAY), "{tells}");
                let all = shown.len() == seconds * frames_per_second;
                assert!(shown.is_sorted() && (all || frames_per_second > 50), "{tells}");
            }
        }
        assert_eq!(gif_frames(4, 30), [(0, 3), (1, 4), (2, 3), (3, 3)]);
        assert_eq!(gif_frames(1, 60), [(0, 2)]);
    }
}
