//! The records of a sparse model: cameras, registered images, rigs and their frames.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use bytemuck::Pod;
use glam::{DMat3, DQuat, DVec3};

use crate::names::{MAX_PATH_BYTES, ending, plain, stays_inside};
use crate::regular_file::OnFile;
use crate::{atomic, cost, host_memory, regular_file, text};
use ashsplat::scene::{COLMAP_MODELS, Camera, PointCloud, SourcePoints, colmap_parameters};
use ashsplat::{Error, Result};

/// One of COLMAP's camera models.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CameraModel(usize);

impl CameraModel {
    /// Parameters f, cx, cy.
    pub const SIMPLE_PINHOLE: Self = Self(0);
    /// Parameters fx, fy, cx, cy.
    pub const PINHOLE: Self = Self(1);
    /// Parameters fx, fy, cx, cy, k1, k2, p1, p2.
    pub const OPENCV: Self = Self(4);
    /// Parameters fx, fy, cx, cy, k1, k2, k3, k4.
    pub const OPENCV_FISHEYE: Self = Self(5);
    /// Parameters width, height.
    pub const EQUIRECTANGULAR: Self = Self(17);
    /// Parameters fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6.
    pub const FULL_OPENCV: Self = Self(6);

    /// Model with COLMAP's number.
    pub fn from_number(number: i64) -> Option<Self> {
        usize::try_from(number).ok().filter(|&n| n < COLMAP_MODELS.len()).map(Self)
    }

    /// Model with COLMAP's name.
    pub fn from_name(name: &str) -> Option<Self> {
        COLMAP_MODELS.iter().position(|model| *model == name).map(Self)
    }

    /// COLMAP's name.
    pub fn name(self) -> &'static str {
        COLMAP_MODELS[self.0]
    }

    /// COLMAP's number.
    pub fn number(self) -> i32 {
        self.0 as i32
    }

    /// Number of its parameters.
    pub fn parameters(self) -> usize {
        colmap_parameters(self.0 as u32).unwrap_or(0)
    }
}

/// A camera without pose, as in the model.
#[derive(Clone, Debug, PartialEq)]
pub struct ColmapCamera {
    /// COLMAP's id; ids may have gaps.
    pub id: u32,
    /// The camera model.
    pub model: CameraModel,
    /// Width of its images, pixels.
    pub width: u64,
    /// Height of its images, pixels.
    pub height: u64,
    /// Focal lengths, principal point, distortion, in the model's order. FULL_OPENCV's may end with n4 (see
    /// [`Projection::Brown`](ashsplat::scene::Projection::Brown)), which COLMAP's files do not have.
    pub parameters: Vec<f64>,
}

impl ColmapCamera {
    /// The camera with the lens of `camera`.
    ///
    /// # Errors
    /// [`Error::Argument`] for a lens that no model of COLMAP has.
    pub fn of(id: u32, camera: &Camera) -> Result<Self> {
        let lens = camera.photo_lens().to_colmap();
        let none =
            || Error::argument("camera", format!("{} is no model of COLMAP", camera.projection.name()));
        let (model, parameters) = lens.ok_or_else(none)?;
        Ok(Self { model: CameraModel(model as usize), parameters, ..Self::pinhole(id, camera) })
    }

    /// The PINHOLE camera with the intrinsics of `camera`.
    pub fn pinhole(id: u32, camera: &Camera) -> Self {
        Self {
            id,
            model: CameraModel::PINHOLE,
            width: camera.width.into(),
            height: camera.height.into(),
            parameters: [camera.fx, camera.fy, camera.cx, camera.cy].map(f64::from).to_vec(),
        }
    }
}

/// A registered image.
#[derive(Clone, Debug, PartialEq)]
pub struct ColmapImage {
    /// COLMAP's id; ids may have gaps and are in no order.
    pub id: u32,
    /// Id of its camera.
    pub camera_id: u32,
    /// Path below the images folder.
    pub name: String,
    /// Rotation from world to camera as quaternion (w, x, y, z), not necessarily of unit length.
    pub quat: [f64; 4],
    /// Translation from the file's coordinates to the camera.
    pub translation: [f64; 3],
}

impl ColmapImage {
    /// The registered image with the pose of `camera`.
    pub fn posed(id: u32, camera_id: u32, name: impl Into<String>, camera: &Camera) -> Self {
        let quat = DQuat::from_mat3(&camera.camera_from_world.as_dmat3()).normalize();
        let translation = camera.translation.as_dvec3().to_array();
        Self { id, camera_id, name: name.into(), quat: [quat.w, quat.x, quat.y, quat.z], translation }
    }

    /// Rotation from the file's coordinates to the camera's axes.
    pub fn rotation(&self) -> DMat3 {
        Pose::of(self).axes().0
    }

    /// The photo's path below the images folder.
    ///
    /// # Errors
    /// [`Error::Input`] naming `model_file` when the name is absolute or leads out of the folder, or is longer than
    /// paths can be.
    pub fn photo_path(&self, images_folder: &Path, model_file: &Path) -> Result<PathBuf> {
        if self.name.len() > MAX_PATH_BYTES {
            let problem = format!("image {}: the name has {} bytes", self.id, self.name.len());
            return Err(Error::input(model_file, problem, format!("{MAX_PATH_BYTES} are possible")));
        }
        let name = plain(&self.name);
        if stays_inside(&name) {
            return Ok(images_folder.join(name));
        }
        let (id, name) = (self.id, ending(&self.name));
        let problem = format!("image {id}: the name {name:?} leads out of the images folder");
        Err(Error::input(model_file, problem, "names must be paths below the images folder"))
    }
}

/// A rotation as quaternion (w, x, y, z), and a translation.
#[derive(Clone, Copy)]
pub(super) struct Pose {
    pub(super) quat: [f64; 4],
    pub(super) translation: [f64; 3],
}

impl Pose {
    pub(super) const IDENTITY: Self = Self { quat: [1.0, 0.0, 0.0, 0.0], translation: [0.0; 3] };

    pub(super) fn of(image: &ColmapImage) -> Self {
        Self { quat: image.quat, translation: image.translation }
    }

    pub(super) fn axes(self) -> (DMat3, DVec3) {
        let [w, x, y, z] = self.quat;
        let rotation = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        (rotation, DVec3::from_array(self.translation))
    }
}

#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Sensor {
    /// False for an IMU or another sensor without images.
    pub(super) is_camera: bool,
    pub(super) id: u32,
}

/// Pose of each sensor in the rig; `None` if COLMAP does not know it.
type Rig = HashMap<Sensor, Option<Pose>>;

/// Images that the sensors of a rig took at one time.
pub(super) struct RigFrame {
    pub(super) id: u32,
    pub(super) rig: u32,
    /// From the world to the rig.
    pub(super) pose: Pose,
    /// Each sensor with the id of its image.
    pub(super) data: Vec<(Sensor, u64)>,
}

struct RecordKind {
    name: &'static str,
    /// Smallest size of a record in a binary file.
    file_bytes: u64,
    memory_bytes: usize,
}

const fn kind(name: &'static str, file_bytes: u64, memory_bytes: usize) -> RecordKind {
    RecordKind { name, file_bytes, memory_bytes }
}

const CAMERA: RecordKind = kind("camera", 24, size_of::<ColmapCamera>() + 16 * size_of::<f64>());
/// 74 bytes: the fields, a name of one letter with its NUL, and the number of observations.
const IMAGE: RecordKind = kind("image", 74, size_of::<ColmapImage>() + 64);
const RIG: RecordKind = kind("rig", 8, size_of::<(u32, Rig)>() + 4 * size_of::<(Sensor, Option<Pose>)>());
const FRAME: RecordKind = kind("frame", 68, size_of::<RigFrame>() + 2 * size_of::<(Sensor, u64)>());
const POINT: RecordKind = kind("point", 51, 2 * size_of::<(u64, [f64; 3])>());
const OBSERVATION_BYTES: u64 = 24;
const TRACK_ENTRY_BYTES: u64 = 8;
/// No file system has longer paths.
const MAX_NAME_BYTES: usize = 4096;

pub(super) fn cameras(path: &Path) -> Result<Vec<ColmapCamera>> {
    let mut file = Records::open(path, CAMERA)?;
    let mut cameras = Vec::with_capacity(file.count);
    while file.next()? {
        let id = file.number("camera id")?;
        let model = file.camera_model(id)?;
        let (width, height) = (file.number("width")?, file.number("height")?);
        let parameters = (0..model.parameters()).map(|_| file.number("parameter")).collect::<Result<_>>()?;
        if file.is_text && !file.rest().is_empty() {
            return Err(file.error("has more values than its camera model"));
        }
        cameras.push(ColmapCamera { id, model, width, height, parameters });
    }
    Ok(cameras)
}

pub(super) fn images(path: &Path) -> Result<Vec<ColmapImage>> {
    let mut file = Records::open(path, IMAGE)?;
    let mut images = Vec::with_capacity(file.count);
    while file.next()? {
        images.push(file.image()?);
        match file.is_text {
            true => drop(file.next_is_observations()?),
            false => file.skip_list("observations", OBSERVATION_BYTES)?,
        }
    }
    Ok(images)
}

pub(super) fn rigs(path: &Path) -> Result<HashMap<u32, Rig>> {
    let mut file = Records::open(path, RIG)?;
    let mut rigs = HashMap::with_capacity(file.count);
    while file.next()? {
        let (id, sensors) = (file.number("rig id")?, file.number::<u32>("number of sensors")?);
        let mut rig = Rig::new();
        for index in 0..sensors {
            let sensor = file.sensor()?;
            // The first one is the rig's own frame.
            let pose = match index == 0 || file.number::<u8>("pose flag")? == 0 {
                true => (index == 0).then_some(Pose::IDENTITY),
                false => Some(file.pose()?),
            };
            rig.insert(sensor, pose);
        }
        rigs.insert(id, rig);
    }
    Ok(rigs)
}

pub(super) fn frames(path: &Path) -> Result<Vec<RigFrame>> {
    let mut file = Records::open(path, FRAME)?;
    let mut frames = Vec::with_capacity(file.count);
    while file.next()? {
        let (id, rig) = (file.number("frame id")?, file.number("rig id")?);
        let (pose, count) = (file.pose()?, file.number::<u32>("number of images")?);
        let data = (0..count).map(|_| Ok((file.sensor()?, file.number("image id")?)));
        frames.push(RigFrame { id, rig, pose, data: data.collect::<Result<_>>()? });
    }
    Ok(frames)
}

/// An image's id, and its observations: the place in the photo, and the id of the point there if there is one.
pub(super) type Observed = (u32, Vec<([f64; 2], Option<u64>)>);

pub(super) fn observations(path: &Path) -> Result<Vec<Observed>> {
    let mut file = Records::open(path, IMAGE)?;
    host_memory::check_free(path, file.length)?;
    let mut images = Vec::with_capacity(file.count);
    while file.next()? {
        let (id, mut places) = (file.image()?.id, Vec::new());
        if file.is_text {
            let has_places = file.next_is_observations()?;
            while has_places && !file.rest().is_empty() {
                // -1 for an observation without a point.
                let (at, point) = (file.numbers("position")?, file.number::<i64>("point id")?);
                places.push((at, u64::try_from(point).ok()));
            }
        } else {
            for _ in 0..file.list_length("observations", OBSERVATION_BYTES)? {
                // All ones for an observation without a point.
                let (at, point) = (file.numbers("position")?, file.number("point id")?);
                places.push((at, Some(point).filter(|&point| point != u64::MAX)));
            }
        }
        images.push((id, places));
    }
    Ok(images)
}

pub(super) fn positions(path: &Path) -> Result<HashMap<u64, [f64; 3]>> {
    let mut file = Records::open(path, POINT)?;
    let mut positions = HashMap::with_capacity(file.count);
    while file.next()? {
        let (id, position, _) = file.point()?;
        positions.insert(id, position);
    }
    Ok(positions)
}

pub(super) fn points(path: &Path) -> Result<SourcePoints> {
    let mut file = Records::open(path, POINT)?;
    let (positions, colors) = (Vec::with_capacity(file.count), Vec::with_capacity(file.count));
    let mut points = SourcePoints { positions, colors };
    while file.next()? {
        let (_, position, color) = file.point()?;
        points.positions.push(DVec3::from_array(position));
        points.colors.push(color);
    }
    Ok(points)
}

/// Number of records that a file claims to hold, or of lines in a text file; 0 when it cannot be read.
pub(super) fn claimed_count(path: &Path) -> u64 {
    let Ok(mut file) = Records::open(path, kind("record", 0, 0)) else { return 0 };
    let mut lines = 0;
    while file.is_text && matches!(file.next(), Ok(true)) {
        lines += 1;
    }
    lines.max(file.count as u64)
}

/// A file of records, read field by field. A record of a text file is a line that is neither blank nor a comment.
struct Records<'a> {
    path: &'a Path,
    reader: BufReader<File>,
    is_text: bool,
    /// Bytes of the file, and those that are unread.
    length: u64,
    remaining: u64,
    name: &'static str,
    /// Number of records of a binary file, and of those that were begun.
    count: usize,
    begun: usize,
    /// The current line of a text file, its number, and where its unread fields begin.
    text: String,
    line: u64,
    at: usize,
    /// True if the current line belongs to the next record.
    is_ahead: bool,
}

impl<'a> Records<'a> {
    /// Opens a file. Fails if it, or the machine's free memory, is too small for the records that it claims.
    fn open(path: &'a Path, kind: RecordKind) -> Result<Self> {
        let RecordKind { name, file_bytes, memory_bytes } = kind;
        let (file, length) = regular_file::open(path)?;
        let is_text = path.extension().is_some_and(|ending| ending == "txt");
        if is_text {
            // Long lines hold observations and tracks, which are not kept.
            host_memory::check_free(path, length.saturating_mul(2))?;
        }
        let mut reader = BufReader::new(file);
        let start = reader.fill_buf().reading(path)?;
        let one_line = is_text && start.contains(&b'\r') && !start.contains(&b'\n');
        let unusual = one_line.then_some(("ends its lines with CR alone", "save it with LF or CR LF"));
        // A count of 0 is valid, although its bytes are all zeros.
        let foreign = regular_file::recognise(&start[..start.len().min(512)]);
        let foreign = foreign.filter(|_| is_text || start != [0; 8]);
        if let Some((problem, remedy)) = foreign.or(unusual) {
            return Err(Error::input(path, problem, remedy));
        }
        let (text, remaining) = (String::new(), length);
        let (count, begun, line, at, is_ahead) = (0, 0, 0, 0, false);
        let mut this =
            Self { path, reader, is_text, length, remaining, name, count, begun, text, line, at, is_ahead };
        if !is_text {
            let count: u64 = this.number("count")?;
            if count.saturating_mul(file_bytes) > this.remaining {
                let problem = format!("says {count} {name}s, {} bytes cannot hold as many", this.remaining);
                return Err(this.error(&problem));
            }
            host_memory::check_free(path, count.saturating_mul(memory_bytes as u64))?;
            this.count = usize::try_from(count).unwrap_or(usize::MAX);
        }
        Ok(this)
    }

    fn error(&self, problem: &str) -> Error {
        if self.is_text {
            let problem = format!("line {}: {problem}", self.line);
            return Error::input(self.path, problem, "correct the line, or export the model again");
        }
        let record = match self.begun {
            0 => "the count".to_owned(),
            begun => format!("{} {} of {}", self.name, begun - 1, self.count),
        };
        let problem = format!("byte {} ({record}): {problem}", self.length - self.remaining);
        Error::input(self.path, problem, "the file is damaged or was cut short: copy the model again")
    }

    /// Moves to the next record; false at the end.
    fn next(&mut self) -> Result<bool> {
        if !self.is_text {
            self.begun += 1;
            return Ok(self.begun <= self.count);
        }
        if std::mem::take(&mut self.is_ahead) {
            return Ok(true);
        }
        loop {
            cost::step();
            let mut bytes = std::mem::take(&mut self.text).into_bytes();
            bytes.clear();
            let read = self.read_until(b'\n', self.remaining, &mut bytes)?;
            self.line += 1;
            self.text = text::decoded(bytes);
            if self.line == 1 && self.text.starts_with(text::MARK) {
                self.text.remove(0);
            }
            self.text.truncate(self.text.trim_end().len());
            self.at = self.text.len() - self.text.trim_start().len();
            if read == 0 || !self.rest().is_empty() && !self.rest().starts_with('#') {
                return Ok(read > 0);
            }
        }
    }

    /// The unread fields of the current line.
    fn rest(&self) -> &str {
        &self.text[self.at..]
    }

    /// Moves to the next line if it holds the observations of the image before: x, y and the id of a point, any number
    /// of times. Some programs omit these lines, or insert blank ones.
    fn next_is_observations(&mut self) -> Result<bool> {
        if !self.next()? {
            return Ok(false);
        }
        let mut words = 0;
        let fits = self.rest().split_ascii_whitespace().all(|word| {
            cost::step();
            words += 1;
            if words % 3 == 0 { word.parse::<i64>().is_ok() } else { word.parse::<f64>().is_ok() }
        });
        self.is_ahead = !fits || words % 3 != 0;
        Ok(!self.is_ahead)
    }

    /// Reads bytes up to this one, at most `max_bytes`. Returns their number.
    fn read_until(&mut self, end: u8, max_bytes: u64, bytes: &mut Vec<u8>) -> Result<usize> {
        let max_bytes = max_bytes.min(self.remaining);
        let read = Read::take(&mut self.reader, max_bytes).read_until(end, bytes).reading(self.path)?;
        self.remaining -= read as u64;
        Ok(read)
    }

    /// Place of the next word of a line.
    fn word(&mut self, what: &str) -> Result<Range<usize>> {
        cost::step();
        let rest = self.rest();
        let length = rest.find(|c: char| c.is_ascii_whitespace()).unwrap_or(rest.len());
        if length == 0 {
            return Err(self.error(&format!("the {what} is missing")));
        }
        let (start, end) = (self.at, self.at + length);
        self.at = self.text.len() - self.text[end..].trim_start().len();
        Ok(start..end)
    }

    fn number<T: FromStr + Pod>(&mut self, what: &str) -> Result<T> {
        if self.is_text {
            let place = self.word(what)?;
            let word = &self.text[place];
            return word.parse().map_err(|_| {
                let start: String = word.chars().take(40).collect();
                let hint = text::not_a_number(word);
                self.error(&format!("{start:?} is no valid {what}{hint}"))
            });
        }
        cost::step();
        let mut number = T::zeroed();
        if self.remaining < size_of::<T>() as u64 {
            return Err(self.error("the file ends here"));
        }
        self.reader.read_exact(bytemuck::bytes_of_mut(&mut number)).reading(self.path)?;
        self.remaining -= size_of::<T>() as u64;
        Ok(number)
    }

    fn numbers<T: FromStr + Pod, const N: usize>(&mut self, what: &str) -> Result<[T; N]> {
        let mut numbers = [T::zeroed(); N];
        for number in &mut numbers {
            *number = self.number(what)?;
        }
        Ok(numbers)
    }

    fn pose(&mut self) -> Result<Pose> {
        Ok(Pose { quat: self.numbers("quaternion")?, translation: self.numbers("translation")? })
    }

    fn sensor(&mut self) -> Result<Sensor> {
        let is_camera = match self.is_text {
            true => {
                let kind = self.word("kind of sensor")?;
                &self.text[kind] == "CAMERA"
            }
            false => self.number::<i32>("kind of sensor")? == 0,
        };
        Ok(Sensor { is_camera, id: self.number("sensor id")? })
    }

    fn camera_model(&mut self, id: u32) -> Result<CameraModel> {
        if !self.is_text {
            let number: i32 = self.number("camera model")?;
            let problem = || self.error(&format!("camera {id} has the unknown camera model {number}"));
            return CameraModel::from_number(number.into()).ok_or_else(problem);
        }
        let place = self.word("camera model")?;
        let name = &self.text[place];
        CameraModel::from_name(name).ok_or_else(|| {
            let problem = format!("unknown camera model {name:?}");
            if name.contains("SPHER") {
                return Error::input(self.path, problem, "COLMAP calls panoramas EQUIRECTANGULAR");
            }
            self.error(&problem)
        })
    }

    fn image(&mut self) -> Result<ColmapImage> {
        let id = self.number("image id")?;
        let (quat, translation) = (self.numbers("quaternion")?, self.numbers("translation")?);
        let camera_id = self.number("camera id")?;
        let mut name = Vec::new();
        if self.is_text {
            // The name may have spaces.
            name.extend(self.rest().bytes());
        } else {
            self.read_until(0, MAX_NAME_BYTES as u64 + 1, &mut name)?;
            if name.pop_if(|last| *last == 0).is_none() {
                return Err(self.error("an image name has no end"));
            }
        }
        if self.is_text && name.is_empty() {
            return Err(self.error("the image name is missing"));
        }
        Ok(ColmapImage { id, camera_id, name: text::decoded(name), quat, translation })
    }

    /// The id, position and colour of a point.
    fn point(&mut self) -> Result<(u64, [f64; 3], [u8; 3])> {
        let point = (self.number("point id")?, self.numbers("position")?, self.numbers("colour")?);
        if !self.is_text {
            let _reprojection_error: f64 = self.number("error")?;
            self.skip_list("track entries", TRACK_ENTRY_BYTES)?;
        }
        Ok(point)
    }

    /// Length of a list in a binary file, which the file is large enough for.
    fn list_length(&mut self, what: &str, entry_bytes: u64) -> Result<u64> {
        let count = self.number("length")?;
        if count > self.remaining / entry_bytes {
            return Err(self.error(&format!("says {count} {what}, {} bytes are left", self.remaining)));
        }
        Ok(count)
    }

    fn skip_list(&mut self, what: &str, entry_bytes: u64) -> Result<()> {
        let bytes = self.list_length(what, entry_bytes)? * entry_bytes;
        self.reader.seek_relative(bytes as i64).reading(self.path)?;
        self.remaining -= bytes;
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
        // NUL after the name, and 0 observations as u64.
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
