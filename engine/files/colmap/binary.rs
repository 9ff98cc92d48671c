//! Reading cameras.bin, images.bin and points3D.bin.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use glam::DVec3;

use super::types::{CameraModel, ColmapCamera, ColmapImage, Observed};
use crate::{cost, host_memory, regular_file, sniff, text};
use ashsplat::scene::SourcePoints;
use ashsplat::{Error, Result};

/// Smallest records, bytes: a camera without parameters, an image with a one-letter name and no observations, a point
/// without a track.
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
        let parameters = (0..model.parameters()).map(|_| file.double()).collect::<Result<_>>()?;
        cameras.push(ColmapCamera { id, model, width, height, parameters });
    }
    Ok(cameras)
}

pub(super) fn images(path: &Path) -> Result<Vec<ColmapImage>> {
    let mut file = BinaryFile::open(path)?;
    let count = file.count("images", MIN_IMAGE_BYTES, IMAGE_ROOM)?;
    let mut images = Vec::with_capacity(count);
    for index in 0..count {
        file.record = format!("image {index} of {count}");
        let id = u32::from_le_bytes(file.take()?);
        let quat = [file.double()?, file.double()?, file.double()?, file.double()?];
        let translation = [file.double()?, file.double()?, file.double()?];
        let camera_id = u32::from_le_bytes(file.take()?);
        let name = file.name()?;
        file.skip_list("observations", OBSERVATION_BYTES)?;
        images.push(ColmapImage { id, camera_id, name, quat, translation });
    }
    Ok(images)
}

/// Reads the observations of each image.
pub(super) fn observations(path: &Path) -> Result<Vec<Observed>> {
    let mut file = BinaryFile::open(path)?;
    let count = file.count("images", MIN_IMAGE_BYTES, size_of::<Observed>())?;
    host_memory::check_free(path, file.length)?;
    let mut images = Vec::with_capacity(count);
    for index in 0..count {
        file.record = format!("image {index} of {count}");
        let id = u32::from_le_bytes(file.take()?);
        for _ in 0..7 {
            file.double()?;
        }
        let _camera: [u8; 4] = file.take()?;
        file.name()?;
        let places = u64::from_le_bytes(file.take()?);
        if places > file.remaining / OBSERVATION_BYTES {
            return Err(file.error(&format!("says {places} observations, {} bytes are left", file.remaining)));
        }
        let place = |file: &mut BinaryFile| {
            let at = [file.double()?, file.double()?];
            // COLMAP writes all ones for an observation without a point.
            let point = u64::from_le_bytes(file.take()?);
            Ok((at, Some(point).filter(|&point| point != u64::MAX)))
        };
        let places: Vec<_> = (0..places).map(|_| place(&mut file)).collect::<Result<_>>()?;
        images.push((id, places));
    }
    Ok(images)
}

/// Reads the points' positions by id.
pub(super) fn positions(path: &Path) -> Result<HashMap<u64, [f64; 3]>> {
    let mut file = BinaryFile::open(path)?;
    let count = file.count("points", POINT_BYTES, 2 * size_of::<(u64, [f64; 3])>())?;
    file.record = format!("the {count} points");
    let mut positions = HashMap::with_capacity(count);
    for _ in 0..count {
        let id = u64::from_le_bytes(file.take()?);
        positions.insert(id, [file.double()?, file.double()?, file.double()?]);
        let _color: [u8; 3] = file.take()?;
        let _reprojection_error = file.double()?;
        file.skip_list("track entries", TRACK_ENTRY_BYTES)?;
    }
    Ok(positions)
}

pub(super) fn points(path: &Path) -> Result<SourcePoints> {
    let mut file = BinaryFile::open(path)?;
    let count = file.count("points", POINT_BYTES, POINT_ROOM)?;
    let mut points = SourcePoints { positions: Vec::with_capacity(count), colors: Vec::with_capacity(count) };
    file.record = format!("the {count} points");
    for _ in 0..count {
        let _id: [u8; 8] = file.take()?;
        points.positions.push(DVec3::new(file.double()?, file.double()?, file.double()?));
        points.colors.push(file.take()?);
        let _reprojection_error = file.double()?;
        file.skip_list("track entries", TRACK_ENTRY_BYTES)?;
    }
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

/// A file with a count of its remaining bytes.
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
        let io = |source| Error::io(path, "read", source);
        let (file, length) = regular_file::open(path)?;
        let mut this = Self {
            path,
            reader: BufReader::new(file),
            length,
            remaining: length,
            record: "the count".into(),
        };
        let mut start = Vec::new();
        Read::take(&mut this.reader, 512).read_to_end(&mut start).map_err(io)?;
        // A count of 0 is valid, although its bytes are all zeros.
        if let Some((problem, remedy)) = sniff::recognise(&start).filter(|_| start != [0; 8]) {
            return Err(Error::input(path, problem, remedy));
        }
        this.reader.seek_relative(-(start.len() as i64)).map_err(io)?;
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
        self.reader.read_exact(&mut bytes).map_err(|source| Error::io(self.path, "read", source))?;
        self.remaining -= N as u64;
        Ok(bytes)
    }

    fn double(&mut self) -> Result<f64> {
        Ok(f64::from_le_bytes(self.take()?))
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
        self.reader.seek_relative(offset).map_err(|source| Error::io(self.path, "read", source))?;
        self.remaining -= offset as u64;
        Ok(())
    }
}
