//! Writes the files of commands: whole or not at all, in folders that are created as needed.

use ashsplat::scene::{linear_from_premultiplied, linear_from_srgb};
use ashsplat::{Error, Frame, PixelReport, RenderSettings, Result, Sample, Surface, SurfaceDepth};
use ashsplat_files::{Photo, PhotoFileFormat, atomic, regular_file};
use clap::ValueEnum;
use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, LineOrder, SmallVec, WritableImage,
};
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use serde::Serialize;
use serde_json::{Value, json};
use std::io::{Cursor, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

static STDOUT_FAILURE: OnceLock<std::io::Error> = OnceLock::new();

/// Describes the Gaussians that were blended at a pixel, front to back.
pub fn samples(report: &PixelReport) -> Vec<Value> {
    let sample = |(rank, s): (usize, &Sample)| {
        json!({
            "rank": rank, "id": s.gaussian, "depth": s.depth, "alpha": s.alpha, "weight": s.weight,
            "transmittance_left": s.transmittance_after, "color": s.color,
        })
    };
    report.samples.iter().enumerate().map(sample).collect()
}

/// Writes a line to stdout. A closed pipe is not an error. The work continues after any other failure, and
/// [`check_stdout`] reports it at the end.
pub fn outln(text: std::fmt::Arguments<'_>) {
    note(writeln!(std::io::stdout(), "{text}"));
}

/// Writes a line to stderr, ignoring failures.
pub fn errln(text: std::fmt::Arguments<'_>) {
    writeln!(std::io::stderr(), "{text}").ok();
}

/// Keeps the result of writing to stdout for [`check_stdout`].
pub fn note(written: std::io::Result<()>) {
    match written {
        Err(e) if !is_closed_pipe(&e) => drop(STDOUT_FAILURE.set(e)),
        _ => {}
    }
}

/// True if the reader of a pipe is gone. Windows has a second code for it, which Rust does not recognise.
pub fn is_closed_pipe(error: &std::io::Error) -> bool {
    const PIPE_NOT_CONNECTED: i32 = 233;
    error.kind() == ErrorKind::BrokenPipe || cfg!(windows) && error.raw_os_error() == Some(PIPE_NOT_CONNECTED)
}

/// Returns the first failure of writing to stdout, except a closed pipe.
pub fn check_stdout() -> Result<()> {
    note(std::io::stdout().flush());
    match STDOUT_FAILURE.get() {
        Some(e) => Err(Error::io("standard output", "write", std::io::Error::new(e.kind(), e.to_string()))),
        None => Ok(()),
    }
}

/// Refuses results (option, file) that could not be written, before the work that makes them. Missing folders are
/// created when the file is written.
pub fn check(results: &[(&'static str, Option<&Path>)]) -> Result<()> {
    let mut seen: Vec<(&str, PathBuf)> = Vec::new();
    for (option, path) in results.iter().filter_map(|(option, path)| Some((option, (*path)?))) {
        let file = checked_file(path)?;
        if let Some((other, _)) = seen.iter().find(|(_, known)| *known == file) {
            let problem = format!("both name {}; give each a file of its own", path.display());
            return Err(Error::argument(format!("{other} and {option}"), problem));
        }
        seen.push((option, file));
    }
    Ok(())
}

/// Refuses results that would replace their inputs.
pub fn check_apart(results: &[(&'static str, Option<&Path>)], inputs: &[PathBuf]) -> Result<()> {
    let inputs: Vec<PathBuf> = inputs.iter().filter_map(|path| path.canonicalize().ok()).collect();
    for (option, path) in results.iter().filter_map(|(option, path)| Some((option, (*path)?))) {
        if path.canonicalize().is_ok_and(|path| inputs.contains(&path)) {
            let problem = format!("{} is read; give another file to be written", path.display());
            return Err(Error::argument(*option, problem));
        }
    }
    Ok(())
}

/// The absolute path of a file, for comparison; an error if the file cannot be written.
fn checked_file(path: &Path) -> Result<PathBuf> {
    match path.metadata() {
        Ok(found) if found.is_dir() => return Err(Error::input(path, "is a folder", "give a file's name")),
        // A device or a pipe is written to directly.
        Ok(found) if !found.is_file() => return Ok(path.to_owned()),
        _ => {}
    }
    let names_folder = path.to_string_lossy().ends_with(std::path::is_separator);
    let Some(name) = path.file_name().filter(|_| !names_folder) else {
        return Err(Error::input(path, "names no file", "give a file's name"));
    };
    let target = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let parent = target.parent().unwrap_or(Path::new(""));
    let folder = check_folder(parent)?;
    let missing = parent.strip_prefix(&folder).map_or_else(|_| parent.to_owned(), Path::to_owned);
    let folder = folder.canonicalize().unwrap_or(folder);
    Ok(folder.join(missing).join(target.file_name().unwrap_or(name)))
}

/// Refuses a folder in which nothing can be created. Returns the part of it that exists.
pub fn check_folder(folder: &Path) -> Result<PathBuf> {
    let named = folder.ancestors().find(|above| above.exists());
    let existing = named.filter(|above| !above.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if !existing.is_dir() {
        return Err(Error::input(existing, "is no folder", "give another place for the results"));
    }
    tempfile::tempfile_in(existing).map_err(|e| Error::io(existing, "write into", e))?;
    Ok(existing.to_owned())
}

/// Creates the folders above a file and writes it. If that fails, the new folders are removed.
pub fn in_folder<T>(path: &Path, write: impl FnOnce(&Path) -> Result<T>) -> Result<T> {
    let mut above = path.ancestors().skip(1).filter(|folder| !folder.as_os_str().is_empty()).peekable();
    let folder = above.peek().copied();
    let new: Vec<&Path> = above.take_while(|folder| !folder.exists()).collect();
    let result = folder.map_or(Ok(()), atomic::create_folder).and_then(|()| write(path));
    if result.is_err() {
        // Innermost first. A folder with a file of another program stays.
        new.iter().all(|folder| std::fs::remove_dir(folder).is_ok());
    }
    result
}

/// Writes a file and creates the folders above it.
fn write_whole(path: &Path, fill: impl FnOnce(&mut dyn Write) -> std::io::Result<()>) -> Result<()> {
    in_folder(path, |path| atomic::write(path, fill))
}

/// Reads a short note of this program, if there is one.
pub fn read_note(path: &Path) -> Option<String> {
    String::from_utf8(regular_file::read_at_most(path, 1024).ok()??).ok()
}

/// The absolute path, or the path itself in a folder that is gone.
pub fn absolute(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}

/// The names in a folder; empty if it cannot be read.
pub fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten();
    entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok()).collect()
}

/// Removes the temporary files (`.NAME.XXXXXX.tmp`) of an earlier run that was killed, in a folder and in
/// `levels` levels of folders below it. Files that cannot be removed stay.
pub fn remove_leftovers(folder: &Path, levels: u32) {
    remove_leftovers_named(folder, levels, ".");
}

/// Removes the leftovers of one file only. In a shared folder, other temporary files may be in use.
pub fn remove_leftovers_of(file: &Path) {
    let (Some(folder), Some(name)) = (file.parent(), file.file_name()) else { return };
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    remove_leftovers_named(folder, 0, &format!(".{}.", name.to_string_lossy()));
}

fn remove_leftovers_named(folder: &Path, levels: u32, prefix: &str) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    let is_one = |name: &str| name.starts_with(prefix) && is_leftover(name);
    for entry in entries.flatten() {
        match entry.file_type() {
            Ok(kind) if kind.is_dir() && levels > 0 => {
                remove_leftovers_named(&entry.path(), levels - 1, prefix);
            }
            Ok(kind) if kind.is_file() && entry.file_name().to_str().is_some_and(is_one) => {
                std::fs::remove_file(entry.path()).ok();
            }
            _ => {}
        }
    }
}

/// True for a temporary name of [`atomic::write`].
fn is_leftover(name: &str) -> bool {
    let parts = name.strip_prefix('.').and_then(|n| n.strip_suffix(".tmp")).and_then(|n| n.rsplit_once('.'));
    parts.is_some_and(|(stem, random)| {
        !stem.is_empty() && random.len() == 6 && random.chars().all(|c| c.is_ascii_alphanumeric())
    })
}

/// Writes text, such as a dump of settings.
pub fn write_text(path: &Path, text: &str) -> Result<()> {
    write_whole(path, |out| out.write_all(text.as_bytes()))
}

pub fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    write_whole(path, |out| {
        serde_json::to_writer_pretty(&mut *out, value).map_err(std::io::Error::from)?;
        out.write_all(b"\n")
    })
}

pub fn write_png(path: &Path, picture: &Photo) -> Result<()> {
    in_folder(path, |path| picture.write_png(path))
}

pub fn write_rgba_png(path: &Path, picture: &image::RgbaImage) -> Result<()> {
    write_whole(path, |out| {
        let (encoder, color) = (PngEncoder::new(out), ExtendedColorType::Rgba8);
        encoder.write_image(picture, picture.width(), picture.height(), color).map_err(std::io::Error::other)
    })
}

/// A photo as JPEG of quality 1 to 100.
pub fn to_jpeg(photo: &Photo, quality: u8) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, quality)
        .encode(&photo.rgb, photo.width, photo.height, ExtendedColorType::Rgb8)
        .map_err(|e| Error::argument("picture", format!("cannot be encoded: {e}")))?;
    Ok(bytes)
}

/// A frame's colours at 8 bits per channel.
pub fn to_photo(frame: &Frame) -> Result<Photo> {
    Photo::from_f32(frame.width, frame.height, &frame.color)
}

/// The picture, scaled down if it is wider.
pub fn narrowed(picture: Photo, widest: u32) -> Result<Photo> {
    if picture.width <= widest {
        return Ok(picture);
    }
    let height = u64::from(picture.height) * u64::from(widest) / u64::from(picture.width);
    picture.scaled_to(widest, height.max(1) as u32)
}

/// The colours and the opacity of a frame on black at 8 bits per channel, not premultiplied, as in PNG.
pub fn to_rgba(frame: &Frame) -> image::RgbaImage {
    let pixel = |x: u32, y: u32| {
        let at = (y * frame.width + x) as usize;
        let alpha = 1.0 - frame.transmittance[at];
        let byte = |value: f32| (value.clamp(0.0, 1.0) * 255.0).round() as u8;
        let [r, g, b] = frame.color[at].map(|c| if alpha > 0.0 { byte(c / alpha) } else { 0 });
        image::Rgba([r, g, b, byte(alpha)])
    };
    image::RgbaImage::from_fn(frame.width, frame.height, pixel)
}

/// Replaces the picture of a frame with a surface by its normals: (1 + n) / 2, in the scene's axes.
pub fn show_normals(frame: &mut Frame) {
    let normals = frame.surface.iter().flat_map(|surface| &surface.normals);
    frame.color.iter_mut().zip(normals).for_each(|(color, normal)| *color = normal.map(|n| 0.5 + 0.5 * n));
}

/// Writes a 32-bit float EXR with the channels R G B (linear light: the sRGB curve of the photographs is undone), A
/// (1 − transmittance) and Z (depth along the view axis, world units). The colours are on the
/// frame's background; those of a frame on black may also be premultiplied by alpha, as EXR requires for pictures
/// without a background.
/// `normals`: also the channels N.X, N.Y and N.Z, in the scene's axes.
pub fn write_exr(path: &Path, frame: &Frame, premultiplied: bool, depth: Depth, normals: bool) -> Result<()> {
    let channel = |name: &str, samples: Vec<f32>| AnyChannel::new(name, FlatSamples::F32(samples));
    let pixels = frame.color.iter().zip(&frame.transmittance);
    let linear: Vec<[f32; 3]> = match premultiplied {
        true => pixels.map(|(&rgb, t)| linear_from_premultiplied(rgb, 1.0 - t)).collect(),
        false => pixels.map(|(rgb, _)| rgb.map(linear_from_srgb)).collect(),
    };
    let color = |c: usize| linear.iter().map(|rgb| rgb[c]).collect();
    let mut channels: SmallVec<_> = [
        channel("R", color(0)),
        channel("G", color(1)),
        channel("B", color(2)),
        channel("A", frame.transmittance.iter().map(|t| 1.0 - t).collect()),
        channel("Z", depth.of(frame)),
    ]
    .into_iter()
    .collect();
    if let (true, Some(surface)) = (normals, &frame.surface) {
        let axis = |axis: usize| surface.normals.iter().map(|normal| normal[axis]).collect();
        channels.extend([channel("N.X", axis(0)), channel("N.Y", axis(1)), channel("N.Z", axis(2))]);
    }
    let size = (frame.width as usize, frame.height as usize);
    // In order, whichever tile is compressed first, so that the same picture gives the same file.
    let encoding = Encoding { line_order: LineOrder::Increasing, ..Encoding::FAST_LOSSLESS };
    let image = Image::from_encoded_channels(size, encoding, AnyChannels::sort(channels));
    let mut bytes = Cursor::new(Vec::new());
    image
        .write()
        .to_buffered(&mut bytes)
        .map_err(|e| Error::input(path, format!("cannot encode: {e}"), ""))?;
    write_whole(path, |out| out.write_all(bytes.get_ref()))
}

/// The depth of a pixel where Gaussians of depths z were blended with weights w.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Depth {
    /// Σ w z / Σ w, the expected depth, as in gsplat and in images of a `DepthTarget`
    Mean,
    /// Σ w / Σ (w / z), whose reciprocal training compares with depth maps; Gaussians far behind a surface hardly change it
    Harmonic,
    /// z of the Gaussian at which transmittance falls below one half; infinite if it never does
    Median,
}

impl Depth {
    pub fn requested(self, settings: RenderSettings) -> RenderSettings {
        let surface = settings.surface.or((self == Self::Median).then_some(SurfaceDepth::Median));
        RenderSettings { inverse_depth: true, linear_depth: self == Self::Mean, surface, ..settings }
    }

    /// Scales the depths of a frame from world to source units.
    pub fn scale(self, frame: &mut Frame, factor: f32) {
        let own = if self == Self::Mean { factor } else { factor.recip() };
        frame.inverse_depth.iter_mut().flatten().for_each(|sum| *sum *= own);
        frame.surface.iter_mut().flat_map(|own| &mut own.depth).for_each(|depth| *depth *= factor);
    }

    /// Depth of each pixel of such a frame: infinite for transparent pixels.
    pub fn of(self, frame: &Frame) -> Vec<f32> {
        if let (Self::Median, Some(Surface { depth, .. })) = (self, &frame.surface) {
            return depth.iter().map(|&z| if z > 0.0 { z } else { f32::INFINITY }).collect();
        }
        let Some(sums) = &frame.inverse_depth else { return vec![f32::INFINITY; frame.color.len()] };
        let depth = |(&sum, &transmittance): (&f32, &f32)| match (sum > 0.0, self) {
            (false, _) => f32::INFINITY,
            (true, Self::Mean) => sum / (1.0 - transmittance),
            (true, _) => (1.0 - transmittance) / sum,
        };
        sums.iter().zip(&frame.transmittance).map(depth).collect()
    }
}

/// `folder/00012.png`.
pub fn numbered(folder: &Path, index: usize, extension: &str) -> PathBuf {
    folder.join(format!("{index:05}.{extension}"))
}
