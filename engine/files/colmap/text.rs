//! Reading cameras.txt, images.txt and points3D.txt.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Take};
use std::path::Path;
use std::str::FromStr;

use glam::DVec3;

use super::records::{CameraModel, ColmapCamera, ColmapImage, Observed};
use crate::regular_file::{self, OnFile};
use crate::{cost, host_memory, text};
use ashsplat::scene::SourcePoints;
use ashsplat::{Error, Result};

pub(super) fn cameras(path: &Path) -> Result<Vec<ColmapCamera>> {
    let mut file = TextFile::open(path)?;
    let mut cameras = Vec::new();
    while file.next_row()? {
        let mut words = file.words();
        let id = words.number("camera id")?;
        let name = words.word("camera model")?;
        let Some(model) = CameraModel::from_name(name) else {
            let problem = format!("unknown camera model {name:?}");
            if name.contains("SPHER") || name.contains("EQUIRECT") {
                let remedy = "cut the panoramas into views of pinhole cameras first";
                return Err(Error::input(path, problem, remedy));
            }
            return Err(words.error(&problem));
        };
        let (width, height) = (words.number("width")?, words.number("height")?);
        let parameters = (0..model.parameters()).map(|_| words.number("parameter")).collect::<Result<_>>()?;
        words.end()?;
        cameras.push(ColmapCamera { id, model, width, height, parameters });
    }
    Ok(cameras)
}

pub(super) fn images(path: &Path) -> Result<Vec<ColmapImage>> {
    let mut images = Vec::new();
    each_image(path, |image, _| {
        images.extend(image);
        Ok(())
    })?;
    Ok(images)
}

/// Calls `visit` with each image, or with the words of its observations, in the file's order. Some programs omit the
/// lines of observations or insert blank lines. So a line of numbers after an image is its observations, any other line
/// an image.
fn each_image(
    path: &Path,
    mut visit: impl FnMut(Option<ColmapImage>, Words<'_>) -> Result<()>,
) -> Result<()> {
    let mut file = TextFile::open(path)?;
    let mut after_image = false;
    while file.next_row()? {
        after_image = !(after_image && file.words().are_observations());
        let mut words = file.words();
        let image = after_image.then(|| words.image()).transpose()?;
        visit(image, words)?;
    }
    Ok(())
}

pub(super) fn observations(path: &Path) -> Result<Vec<Observed>> {
    let mut images: Vec<Observed> = Vec::new();
    each_image(path, |image, mut words| {
        images.extend(image.map(|image| (image.id, Vec::new())));
        let Some((_, places)) = images.last_mut() else { return Ok(()) };
        while !words.rest.is_empty() {
            let at = words.numbers("position")?;
            // COLMAP writes -1 for an observation without a point.
            let point: i64 = words.number("point id")?;
            places.push((at, u64::try_from(point).ok()));
        }
        Ok(())
    })?;
    Ok(images)
}

pub(super) fn positions(path: &Path) -> Result<HashMap<u64, [f64; 3]>> {
    let mut file = TextFile::open(path)?;
    let mut positions = HashMap::new();
    while file.next_row()? {
        let mut words = file.words();
        positions.insert(words.number("point id")?, words.numbers("position")?);
    }
    Ok(positions)
}

pub(super) fn points(path: &Path) -> Result<SourcePoints> {
    let mut file = TextFile::open(path)?;
    let mut points = SourcePoints::default();
    while file.next_row()? {
        let mut words = file.words();
        let _id: u64 = words.number("point id")?;
        points.positions.push(DVec3::from_array(words.numbers("position")?));
        points.colors.push(words.numbers("colour")?);
    }
    Ok(points)
}

/// Number of rows that are not comments; 0 when the file cannot be read.
pub(super) fn count_rows(path: &Path) -> u64 {
    let Ok(mut file) = TextFile::open(path) else { return 0 };
    let mut rows = 0;
    while let Ok(true) = file.next_row() {
        rows += 1;
    }
    rows
}

struct TextFile<'a> {
    path: &'a Path,
    reader: BufReader<Take<File>>,
    text: String,
    line: u64,
}

impl<'a> TextFile<'a> {
    fn open(path: &'a Path) -> Result<Self> {
        let (file, bytes) = regular_file::open(path)?;
        // Long lines hold observations and tracks, which are not kept.
        host_memory::check_free(path, bytes.saturating_mul(2))?;
        let mut this = Self { path, reader: BufReader::new(file.take(bytes)), text: String::new(), line: 0 };
        let start = this.reader.fill_buf().reading(path)?;
        let one_line = start.contains(&b'\r') && !start.contains(&b'\n');
        let unusual = one_line.then_some(("ends its lines with CR alone", "save it with LF or CR LF"));
        match regular_file::recognise(&start[..start.len().min(512)]).or(unusual) {
            Some((problem, remedy)) => Err(Error::input(path, problem, remedy)),
            None => Ok(this),
        }
    }

    /// Moves to the next line; false at the end.
    fn next_line(&mut self) -> Result<bool> {
        cost::step();
        let mut bytes = std::mem::take(&mut self.text).into_bytes();
        bytes.clear();
        let read = self.reader.read_until(b'\n', &mut bytes);
        let read = read.reading(self.path)?;
        self.line += 1;
        self.text = text::decoded(bytes);
        if self.line == 1 && self.text.starts_with(text::MARK) {
            self.text.remove(0);
        }
        Ok(read > 0)
    }

    /// Moves to the next line that is neither blank nor a comment; false at the end.
    fn next_row(&mut self) -> Result<bool> {
        while self.next_line()? {
            let text = self.text.trim_start();
            if !text.is_empty() && !text.starts_with('#') {
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn words(&self) -> Words<'_> {
        Words { path: self.path, line: self.line, rest: self.text.trim() }
    }
}

/// The unread rest of a line.
struct Words<'a> {
    path: &'a Path,
    line: u64,
    rest: &'a str,
}

impl<'a> Words<'a> {
    fn error(&self, problem: &str) -> Error {
        let problem = format!("line {}: {problem}", self.line);
        Error::input(self.path, problem, "correct the line, or export the model again")
    }

    fn word(&mut self, what: &str) -> Result<&'a str> {
        cost::step();
        let (word, rest) = self.rest.split_once(|c: char| c.is_ascii_whitespace()).unwrap_or((self.rest, ""));
        if word.is_empty() {
            return Err(self.error(&format!("the {what} is missing")));
        }
        self.rest = rest.trim_start();
        Ok(word)
    }

    fn number<T: FromStr>(&mut self, what: &str) -> Result<T> {
        let word = self.word(what)?;
        word.parse().map_err(|_| {
            let start: String = word.chars().take(40).collect();
            self.error(&format!("{start:?} is no valid {what}{}", text::not_a_number(word)))
        })
    }

    fn numbers<T: FromStr + Copy + Default, const N: usize>(&mut self, what: &str) -> Result<[T; N]> {
        let mut numbers = [T::default(); N];
        for number in &mut numbers {
            *number = self.number(what)?;
        }
        Ok(numbers)
    }

    /// True for a line of observations: x, y and the id of a point, any number of times.
    fn are_observations(mut self) -> bool {
        while !self.rest.is_empty() {
            let numbers = (self.number::<f64>(""), self.number::<f64>(""), self.number::<i64>(""));
            if !matches!(numbers, (Ok(_), Ok(_), Ok(_))) {
                return false;
            }
        }
        true
    }

    fn image(&mut self) -> Result<ColmapImage> {
        let id = self.number("image id")?;
        let (quat, translation) = (self.numbers("quaternion")?, self.numbers("translation")?);
        let camera_id = self.number("camera id")?;
        if self.rest.is_empty() {
            return Err(self.error("the image name is missing"));
        }
        // The name may have spaces.
        let name = std::mem::take(&mut self.rest).to_owned();
        Ok(ColmapImage { id, camera_id, name, quat, translation })
    }

    fn end(&self) -> Result<()> {
        if self.rest.is_empty() { Ok(()) } else { Err(self.error("has more values than its camera model")) }
    }
}
