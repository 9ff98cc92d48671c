//! Extracts frames of a video by ffmpeg: the sharpest frame of each of equal intervals.

use super::sharpness::sharpness;
use ashsplat::{Error, Result};
use ashsplat_files::{Photo, atomic};
use ashsplat_program::child::{INSTALL_FFMPEG, Running, not_started};
use ashsplat_program::output;
use std::ffi::{OsStr, OsString};
use std::io::{BufReader, ErrorKind, Read, Seek};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};

/// Number of frames that are compared in each interval, if the video has enough.
const CANDIDATES: usize = 8;
/// JPEG quality, 1 to 100.
const QUALITY: u8 = 95;
/// Largest credible side of a frame, pixels.
const MAX_SIDE: u32 = 16_384;
/// Containers and streams that are read (ffmpeg's names of demuxers), each a single file. Playlists, lists of files and
/// patterns would make ffmpeg open other files.
const FORMATS: &str = "mov,matroska,webm,avi,mpegts,mpeg,mpegvideo,asf,flv,ogg,gif,mxf,nut,ivf,dv,h264,hevc,m4v,mjpeg,\
                       yuv4mpegpipe,wtv,rm,obu,apng";
/// Largest number of frames: names have five digits.
const MAX_FRAMES: usize = 10_000;
/// Default number of frames per second, and its least and largest total.
const PER_SECOND: f64 = 2.0;
const USUAL: [usize; 2] = [40, 150];

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Video {
    pub seconds: f64,
    pub frames: usize,
}

/// Requested number of frames.
#[derive(Clone, Copy, Debug)]
pub struct FrameRequest {
    pub frames: Option<usize>,
    pub every: Option<f64>,
}

impl FrameRequest {
    /// Number of intervals; one frame is taken from each.
    pub fn of(self, video: &Video) -> usize {
        let usual = || intervals(video, 1.0 / PER_SECOND).clamp(USUAL[0], USUAL[1]);
        let count = self.requested(video).unwrap_or_else(usual);
        // More would take a frame twice.
        count.clamp(1, video.frames.clamp(1, MAX_FRAMES))
    }

    pub fn requested(self, video: &Video) -> Option<usize> {
        self.frames.or_else(|| self.every.map(|seconds| intervals(video, seconds)))
    }
}

fn intervals(video: &Video, seconds: f64) -> usize {
    (video.seconds / seconds).ceil().clamp(1.0, 1e6) as usize
}

/// ffmpeg with one video.
pub struct Reader<'a> {
    pub program: &'a OsStr,
    pub path: &'a Path,
    /// Memory budget of frames.
    pub max_bytes: u64,
    pub stop: &'a AtomicBool,
}

impl Reader<'_> {
    /// Reads length and number of frames of the video without decoding it.
    ///
    /// # Errors
    /// [`Error::Argument`] without ffmpeg, with commands to install it; [`Error::Input`] if it is not a video.
    pub fn probe(&self) -> Result<Video> {
        let mut command = self.command(&["-progress", "-"]);
        command.args(["-map", "0:v:0", "-c", "copy", "-f", "null"]);
        // The null muxer opens no file.
        command.arg("-").stdout(Stdio::piped());
        let mut output = String::new();
        self.read(command, |stdout| {
            stdout.read_to_string(&mut output).map_err(|e| Error::io(self.path, "read", e))?;
            Ok(())
        })?;
        let video = Video::of_progress(&output).filter(|video| video.frames > 0);
        video.ok_or_else(|| self.refused("ffmpeg finds no frames in it".into()))
    }

    /// Writes the sharpest frame of each of `count` intervals to `folder`, as `frame_00001.jpg` and so on. `looked_at`
    /// receives the time of each examined frame, seconds. Returns the number of frames.
    ///
    /// # Errors
    /// [`Error::Input`] when the video cannot be decoded, [`Error::Io`], [`Error::Interrupted`].
    pub fn pick(&self, video: &Video, count: usize, folder: &Path, looked_at: &dyn Fn(f64)) -> Result<usize> {
        let rate = Rate::of(video, count);
        let mut command = self.command(&[]);
        command.args(["-map", "0:v:0", "-vf", &rate.filter(), "-f", "image2pipe", "-c:v", "ppm", "-"]);
        let (mut picker, mut written) = (Picker::default(), 0);
        let mut write = |photo: Photo| {
            written += 1;
            let (path, jpeg) =
                (folder.join(format!("frame_{written:05}.jpg")), output::to_jpeg(&photo, QUALITY)?);
            atomic::write(&path, |out| out.write_all(&jpeg))
        };
        self.read(command, |stdout| {
            let mut input = BufReader::with_capacity(1 << 20, stdout);
            let mut index = 0;
            // Three pictures are in memory: the sharpest so far, its rival, and the next.
            let max_bytes = self.max_bytes / 3;
            while let Some(photo) =
                read_ppm(&mut input, max_bytes).map_err(|e| Error::io(self.path, "decode", e))?
            {
                if self.stop.load(Ordering::Relaxed) {
                    return Err(Error::Interrupted);
                }
                picker.take(rate.interval(index, count), photo).map_or(Ok(()), &mut write)?;
                index += 1;
                looked_at(index as f64 / rate.per_second);
            }
            Ok(())
        })?;
        picker.best.map_or(Ok(()), |best| write(best.photo))?;
        if written == 0 {
            return Err(self.refused("ffmpeg decodes no frame of it".into()));
        }
        Ok(written)
    }

    fn command(&self, global: &[&str]) -> Command {
        let mut command = Command::new(self.program);
        command
            .args(["-nostdin", "-hide_banner", "-v", "error"])
            .args(global)
            .args(["-protocol_whitelist", "file", "-format_whitelist", FORMATS])
            .arg("-i")
            .arg(as_file(self.path));
        command
    }

    /// Runs ffmpeg and passes its stdout to `take`.
    fn read(
        &self,
        mut command: Command,
        take: impl FnOnce(&mut std::process::ChildStdout) -> Result<()>,
    ) -> Result<()> {
        let io = |e| Error::io(self.path, "read", e);
        // A file instead of a pipe: no thread would read the pipe.
        let mut errors = tempfile::tempfile().map_err(io)?;
        let stderr = errors.try_clone().map_err(io)?;
        let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(stderr).spawn();
        let name = self.program.to_string_lossy();
        let missing = |e| {
            Error::argument(
                "poses",
                format!("{}: {INSTALL_FFMPEG}; --ffmpeg gives its path", not_started(&name, &e)),
            )
        };
        let mut ffmpeg = Running(child.map_err(missing)?);
        let Some(mut stdout) = ffmpeg.0.stdout.take() else {
            return Err(self.refused("ffmpeg has no output".into()));
        };
        let taken = take(&mut stdout);
        drop(stdout);
        if !matches!(taken, Ok(()) | Err(Error::Io { .. })) {
            return taken;
        }
        let status = ffmpeg.wait(self.stop).map_err(io)?.ok_or(Error::Interrupted)?;
        if !status.success() {
            let mut text = String::new();
            errors.rewind().and_then(|()| errors.read_to_string(&mut text)).map_err(io)?;
            if text.contains("not on whitelist") {
                let problem = "is a playlist, a list of files or no usual video: only files that hold a video themselves are read";
                return Err(Error::input(
                    self.path,
                    problem,
                    "give an MP4, MOV, MKV, WebM or AVI, or a folder of photographs",
                ));
            }
            let line = text.lines().last().unwrap_or("it failed").trim().to_owned();
            return Err(self.refused(format!("ffmpeg: {line}")));
        }
        taken
    }

    fn refused(&self, problem: String) -> Error {
        Error::input(self.path, problem, "give a video that ffmpeg can read, or a folder of photographs")
    }
}

/// A name that ffmpeg takes neither for an option nor for a protocol ("a:b.mp4").
fn as_file(path: &Path) -> OsString {
    let mut name = OsString::from("file:");
    name.push(path);
    name
}

impl Video {
    /// Parses ffmpeg's `-progress`; the last values count.
    fn of_progress(text: &str) -> Option<Self> {
        let last =
            |key: &str| text.lines().rev().find_map(|line| line.trim().strip_prefix(key)?.strip_prefix('='));
        let mut seconds = 0.0;
        for part in last("out_time")?.split(':') {
            seconds = 60.0 * seconds + part.parse::<f64>().ok()?;
        }
        let frames = last("frame")?.trim().parse().ok()?;
        Some(Self { seconds: seconds.max(0.0), frames })
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Rate {
    per_second: f64,
    /// Length of the video, seconds, at which the last interval ends.
    seconds: f64,
}

impl Rate {
    fn of(video: &Video, count: usize) -> Self {
        // A video of one frame has no length.
        let seconds = if video.seconds > 0.0 { video.seconds } else { 0.04 * video.frames as f64 };
        let max_per_second = video.frames as f64 / seconds;
        Self { per_second: ((CANDIDATES * count) as f64 / seconds).min(max_per_second), seconds }
    }

    /// Filter for a fixed rate, and for the colours that the video's tags declare.
    fn filter(&self) -> String {
        format!("fps={:.6},scale=in_color_matrix=auto,format=rgb24", self.per_second)
    }

    fn interval(&self, index: usize, count: usize) -> usize {
        let share = index as f64 / (self.per_second * self.seconds);
        ((share * count as f64 + 1e-6) as usize).min(count - 1)
    }
}

/// Keeps the sharpest frame of an interval.
#[derive(Default)]
struct Picker {
    best: Option<Best>,
}

struct Best {
    interval: usize,
    sharpness: f64,
    photo: Photo,
}

impl Picker {
    /// Takes the next frame. Returns the best of the previous interval if this frame begins another.
    fn take(&mut self, interval: usize, photo: Photo) -> Option<Photo> {
        let sharpness = sharpness(&photo);
        let next = Best { interval, sharpness, photo };
        match &mut self.best {
            Some(best) if best.interval == interval => {
                if sharpness > best.sharpness {
                    *best = next;
                }
                None
            }
            best => best.replace(next).map(|done| done.photo),
        }
    }
}

/// Reads the next picture of a stream of PPMs (P6, 8 bits); `None` at its end.
fn read_ppm(input: &mut impl Read, max_bytes: u64) -> std::io::Result<Option<Photo>> {
    let bad = || std::io::Error::new(ErrorKind::InvalidData, "ffmpeg's output is no PPM");
    let mut words: Vec<String> = vec![String::new()];
    let mut byte = [0];
    while words.len() < 5 {
        match input.read(&mut byte)? {
            0 if words.len() == 1 && words[0].is_empty() => return Ok(None),
            0 => return Err(ErrorKind::UnexpectedEof.into()),
            _ if byte[0].is_ascii_whitespace() => words.push(String::new()),
            _ => words.last_mut().filter(|word| word.len() < 10).ok_or_else(bad)?.push(char::from(byte[0])),
        }
    }
    let [magic, width, height, max_value] = [0, 1, 2, 3].map(|at| words[at].as_str());
    let side = |text: &str| text.parse().ok().filter(|side| (1..=MAX_SIDE).contains(side)).ok_or_else(bad);
    let (width, height) = (side(width)?, side(height)?);
    if magic != "P6" || max_value != "255" {
        return Err(bad());
    }
    let bytes = 3 * u64::from(width) * u64::from(height);
    if bytes > max_bytes {
        let text = format!("a frame of {width}x{height} pixels needs more than --max-host-memory leaves");
        return Err(std::io::Error::new(ErrorKind::OutOfMemory, text));
    }
    let mut rgb = vec![0; bytes as usize];
    input.read_exact(&mut rgb)?;
    Ok(Some(Photo { width, height, rgb }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_follow_the_options_and_the_video() {
        let video = Video { seconds: 30.0, frames: 900 };
        let count = |frames, every, video: &Video| FrameRequest { frames, every }.of(video);
        assert_eq!(count(None, None, &video), 60);
        assert_eq!(count(Some(25), None, &video), 25);
        assert_eq!(count(None, Some(0.4), &video), 75);
        assert_eq!(count(None, None, &Video { seconds: 4.0, frames: 100 }), 40);
        assert_eq!(count(None, None, &Video { seconds: 600.0, frames: 18_000 }), 150);
        assert_eq!(count(None, Some(0.001), &Video { seconds: 600.0, frames: 18_000 }), MAX_FRAMES);
        // Not more than the video has.
        assert_eq!(count(Some(500), None, &Video { seconds: 4.0, frames: 100 }), 100);
        for (video, count) in [(video, 60), (video, 900), (Video { seconds: 0.0, frames: 1 }, 1)] {
            let rate = Rate::of(&video, count);
            let looked = (rate.per_second * rate.seconds).round() as usize;
            let intervals: Vec<usize> = (0..looked).map(|index| rate.interval(index, count)).collect();
            assert_eq!((intervals[0], intervals[looked - 1]), (0, count - 1), "{video:?}");
            let max = intervals.chunk_by(|a, b| a == b).map(<[usize]>::len).max().expect("some");
            assert!(intervals.is_sorted() && max <= CANDIDATES, "{video:?}: {max}");
        }
        assert_eq!(Rate::of(&video, 60).filter(), "fps=16.000000,scale=in_color_matrix=auto,format=rgb24");
    }

    #[test]
    fn progress_of_ffmpeg_is_read() {
        let text = "frame=10\nfps=0.0\nout_time=00:00:00.400000\nprogress=continue\nframe=2700\nout_time_us=90000000\n\
                    out_time=00:01:30.500000\nprogress=end\n";
        assert_eq!(Video::of_progress(text), Some(Video { seconds: 90.5, frames: 2700 }));
        for other in ["", "frame=3\nout_time=N/A\n", "out_time=00:00:01.0\n"] {
            assert_eq!(Video::of_progress(other), None, "{other}");
        }
    }
}
