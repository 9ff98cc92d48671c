//! Reads and writes cameras.bin, images.bin and points3D.bin.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, BufReader, Read, Write};
use std::path::Path;

use glam::DVec3;

use super::records::{CameraModel, ColmapCamera, ColmapImage, Observed};
use crate::regular_file::{self, OnFile};
use crate::{atomic, cost, host_memory, text};
use ashsplat::scene::{PointCloud, SourcePoints};
use ashsplat::{Error, Result};

/// Smallest records, bytes: a camera without parameters, an image with a one-letter name only, a point without a track.
const MIN_CAMERA_BYTES: u64 = 24;
const MIN_IMAGE_BYTES: u64 = 74;
const POINT_BYTES: u64 = 51;
const OBSERVATION_BYTES: u64 = 24;
const TRACK_ENTRY_BYTES: u64 = 8;
/// Memory per record, bytes: a camera with its parameters, an image with its name, a point.
const CAMERA_ROOM: usize = size_of::<ColmapCamera>() + 16 * size_of::<f64>();
const IMAGE_ROOM: usize = size_of::<ColmapImage>() + 64;
const POINT_ROOM: usize = size_of::<DVec3>() + size_of::<[u8; 3]>();
/// No file system has longer paths.
const MAX_NAME_BYTES: usize = 4096;

pub(super) fn cameras(path: &Path) -> Result<Vec<ColmapCamera>> {
    let mut file = BinaryFile::open(path)?;
    let count = file.count("cameras", MIN_CAMERA_BYTES, CAMERA_ROOM)?;
    let mut cameras = Vec::with_capacity(count);
    for index in 0..count {
        file.record = format!("camera {index} of {count}");
        let id = u32::from_le_bytes(file.take()?);
        let number = i32::from_le_bytes(file.take()?);
        let (width, height) = (u64::from_le_bytes(file.take()?), u64::from_le_bytes(file.take()?));
        let Some(model) = CameraModel::from_number(number.into()) else {
            return Err(file.error(&format!("camera {id} has the unknown camera model {number}")));
        };
        let parameter = |_| Ok(f64::from_le_bytes(file.take()?));
        let parameters = (0..model.parameters()).map(parameter).collect::<Result<_>>()?;
        cameras.push(ColmapCamera { id, model, width, height, parameters });
    }
    Ok(cameras)
}

pub(super) fn images(path: &Path) -> Result<Vec<ColmapImage>> {
    each_image(path, IMAGE_ROOM, |image, file| {
        file.skip_list("observations", OBSERVATION_BYTES)?;
        Ok(image)
    })
}

/// Calls `rest` for each image, with the file positioned at its observations, and collects the results. `room`: bytes of
/// memory per image.
fn each_image<T>(
    path: &Path,
    room: usize,
    mut rest: impl FnMut(ColmapImage, &mut BinaryFile<'_>) -> Result<T>,
) -> Result<Vec<T>> {
    let mut file = BinaryFile::open(path)?;
    let count = file.count("images", MIN_IMAGE_BYTES, room)?;
    let mut images = Vec::with_capacity(count);
    for index in 0..count {
        file.record = format!("image {index} of {count}");
        let id = u32::from_le_bytes(file.take()?);
        let quat = file.doubles()?;
        let translation = file.doubles()?;
        let camera_id = u32::from_le_bytes(file.take()?);
        let name = file.name()?;
        images.push(rest(ColmapImage { id, camera_id, name, quat, translation }, &mut file)?);
    }
    Ok(images)
}

pub(super) fn observations(path: &Path) -> Result<Vec<Observed>> {
    let (_, length) = regular_file::open(path)?;
    host_memory::check_free(path, length)?;
    each_image(path, size_of::<Observed>(), |image, file| {
        let (places, left) = (u64::from_le_bytes(file.take()?), file.remaining);
        if places > left / OBSERVATION_BYTES {
            return Err(file.error(&format!("says {places} observations, {left} bytes are left")));
        }
        let mut place = |_| {
            let at = file.doubles()?;
            // COLMAP writes all ones for an observation without a point.
            let point = u64::from_le_bytes(file.take()?);
            Ok((at, Some(point).filter(|&point| point != u64::MAX)))
        };
        Ok((image.id, (0..places).map(&mut place).collect::<Result<_>>()?))
    })
}

pub(super) fn positions(path: &Path) -> Result<HashMap<u64, [f64; 3]>> {
    let mut file = BinaryFile::open(path)?;
    let count = file.count("points", POINT_BYTES, 2 * size_of::<(u64, [f64; 3])>())?;
    let mut positions = HashMap::with_capacity(count);
    file.each_point(count, |id, position, _| {
        positions.insert(id, position);
    })?;
    Ok(positions)
}

pub(super) fn points(path: &Path) -> Result<SourcePoints> {
    let mut file = BinaryFile::open(path)?;
    let count = file.count("points", POINT_BYTES, POINT_ROOM)?;
    let mut points = SourcePoints { positions: Vec::with_capacity(count), colors: Vec::with_capacity(count) };
    file.each_point(count, |_, position, color| {
        points.positions.push(DVec3::from_array(position));
        points.colors.push(color);
    })?;
    Ok(points)
}

/// The count that a file starts with; 0 when it cannot be read.
pub(super) fn claimed_count(path: &Path) -> u64 {
    let mut bytes = [0; 8];
    match regular_file::open(path).map(|(mut file, _)| file.read_exact(&mut bytes)) {
        Ok(Ok(())) => u64::from_le_bytes(bytes),
        _ => 0,
    }
}

struct BinaryFile<'a> {
    path: &'a Path,
    reader: BufReader<File>,
    length: u64,
    remaining: u64,
    /// The current record, for error messages.
    record: String,
}

impl<'a> BinaryFile<'a> {
    fn open(path: &'a Path) -> Result<Self> {
        let (file, length) = regular_file::open(path)?;
        let mut this = Self {
            path,
            reader: BufReader::new(file),
            length,
            remaining: length,
            record: "the count".into(),
        };
        let mut start = Vec::new();
        Read::take(&mut this.reader, 512).read_to_end(&mut start).reading(path)?;
        // A count of 0 is valid, although its bytes are all zeros.
        if let Some((problem, remedy)) = regular_file::recognise(&start).filter(|_| start != [0; 8]) {
            return Err(Error::input(path, problem, remedy));
        }
        this.reader.seek_relative(-(start.len() as i64)).reading(path)?;
        Ok(this)
    }

    fn error(&self, problem: &str) -> Error {
        let place = format!("byte {} ({}): {problem}", self.length - self.remaining, self.record);
        Error::input(self.path, place, "the file is damaged or was cut short: copy the model again")
    }

    /// Reads the number of records. Fails if the file, or the machine's free memory, is too small for them.
    fn count(&mut self, what: &str, record_bytes: u64, room: usize) -> Result<usize> {
        let count = u64::from_le_bytes(self.take()?);
        match usize::try_from(count) {
            Ok(fits) if count <= self.remaining / record_bytes => {
                host_memory::check_free(self.path, count.saturating_mul(room as u64))?;
                Ok(fits)
            }
            _ => {
                Err(self.error(&format!("says {count} {what}, {} bytes cannot hold as many", self.remaining)))
            }
        }
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N]> {
        cost::step();
        let mut bytes = [0; N];
        if self.remaining < N as u64 {
            return Err(self.error("the file ends here"));
        }
        self.reader.read_exact(&mut bytes).reading(self.path)?;
        self.remaining -= N as u64;
        Ok(bytes)
    }

    fn doubles<const N: usize>(&mut self) -> Result<[f64; N]> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = f64::from_le_bytes(self.take()?);
        }
        Ok(numbers)
    }

    fn each_point(&mut self, count: usize, mut visit: impl FnMut(u64, [f64; 3], [u8; 3])) -> Result<()> {
        self.record = format!("the {count} points");
        for _ in 0..count {
            visit(u64::from_le_bytes(self.take()?), self.doubles()?, self.take()?);
            let [_reprojection_error] = self.doubles()?;
            self.skip_list("track entries", TRACK_ENTRY_BYTES)?;
        }
        Ok(())
    }

    /// Reads text up to a zero byte.
    fn name(&mut self) -> Result<String> {
        let mut bytes = Vec::new();
        loop {
            match self.take()? {
                [0] => break,
                [byte] => bytes.push(byte),
            }
            if bytes.len() > MAX_NAME_BYTES {
                return Err(self.error("an image name has no end"));
            }
        }
        Ok(text::decoded(bytes))
    }

    fn skip_list(&mut self, what: &str, entry_bytes: u64) -> Result<()> {
        let count = u64::from_le_bytes(self.take()?);
        let bytes = count.checked_mul(entry_bytes).filter(|&bytes| bytes <= self.remaining);
        let Some(offset) = bytes.and_then(|bytes| i64::try_from(bytes).ok()) else {
            return Err(self.error(&format!("says {count} {what}, {} bytes are left", self.remaining)));
        };
        self.reader.seek_relative(offset).reading(self.path)?;
        self.remaining -= offset as u64;
        Ok(())
    }
}

/// Writes cameras.bin, images.bin and points3D.bin into a folder, which it creates. It writes no observations and
/// no tracks; points get the ids 1, 2, ….
pub fn write(
    folder: impl AsRef<Path>,
    cameras: &[ColmapCamera],
    images: &[ColmapImage],
    points: &PointCloud,
) -> Result<()> {
    let folder = folder.as_ref();
    check(cameras, images)?;
    atomic::create_folder(folder)?;
    atomic::write(folder.join("cameras.bin"), |w| write_cameras(w, cameras))?;
    atomic::write(folder.join("images.bin"), |w| write_images(w, images))?;
    atomic::write(folder.join("points3D.bin"), |w| write_points(w, points))
}

fn check(cameras: &[ColmapCamera], images: &[ColmapImage]) -> Result<()> {
    if let Some(c) = cameras.iter().find(|c| c.parameters.len() != c.model.parameters()) {
        let (name, needs, has) = (c.model.name(), c.model.parameters(), c.parameters.len());
        let problem = format!("{name} needs {needs} parameters, not {has}");
        return Err(Error::argument(format!("camera {}", c.id), problem));
    }
    if let Some(image) = images.iter().find(|image| image.name.is_empty() || image.name.contains('\0')) {
        return Err(Error::argument(format!("image {}", image.id), "its name is empty or has a zero byte"));
    }
    Ok(())
}

fn write_cameras(w: &mut dyn Write, cameras: &[ColmapCamera]) -> io::Result<()> {
    w.write_all(&(cameras.len() as u64).to_le_bytes())?;
    for ColmapCamera { id, model, width, height, parameters } in cameras {
        w.write_all(&id.to_le_bytes())?;
        w.write_all(&model.number().to_le_bytes())?;
        w.write_all(&width.to_le_bytes())?;
        w.write_all(&height.to_le_bytes())?;
        doubles(w, parameters)?;
    }
    Ok(())
}

fn write_images(w: &mut dyn Write, images: &[ColmapImage]) -> io::Result<()> {
    w.write_all(&(images.len() as u64).to_le_bytes())?;
    for ColmapImage { id, camera_id, name, quat, translation } in images {
        w.write_all(&id.to_le_bytes())?;
        doubles(w, quat)?;
        doubles(w, translation)?;
        w.write_all(&camera_id.to_le_bytes())?;
        w.write_all(name.as_bytes())?;
        // The name's end, and no observations.
        w.write_all(&[0; 9])?;
    }
    Ok(())
}

fn write_points(w: &mut dyn Write, points: &PointCloud) -> io::Result<()> {
    w.write_all(&(points.len() as u64).to_le_bytes())?;
    for (id, (position, color)) in (1u64..).zip(points.positions.iter().zip(&points.colors)) {
        w.write_all(&id.to_le_bytes())?;
        doubles(w, &position.map(f64::from))?;
        w.write_all(color)?;
        // No error, and no track.
        w.write_all(&[0; 16])?;
    }
    Ok(())
}

fn doubles(w: &mut dyn Write, values: &[f64]) -> io::Result<()> {
    values.iter().try_for_each(|value| w.write_all(&value.to_le_bytes()))
}
