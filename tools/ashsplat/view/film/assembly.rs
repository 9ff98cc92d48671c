//! A film's frames put together: an animated GIF, and an MP4 where ffmpeg is installed.

use super::Film;
use crate::film_file::{self, Container, Frames};
use crate::output;
use ashsplat::{Error, Result};
use ashsplat_files::{Photo, PhotoFileFormat};
use serde_json::{Value, json};
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

/// Widest GIF, pixels: 8 bits of colour look no better in a larger one.
const GIF_WIDTH: u32 = 640;

/// Frames in a folder, to be made into a film.
pub struct Assembly {
    pub(super) name: String,
    pub(super) folder: PathBuf,
    pub(super) frames: usize,
    pub(super) frames_per_second: u32,
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

/// Message for people about a film that could not be written.
pub fn problem(error: &Error) -> String {
    format!("the film's frames are there, but the film is not: {error}")
}
