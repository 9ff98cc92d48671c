//! `cameras.json`, the list of cameras that the reference implementation writes next to a model.

use std::path::Path;

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use super::splats::FARTHEST;
use super::{atomic, text};
use ashsplat::scene::{Camera, Coefficients, Intrinsics, Projection, Readout, Shutter, WorldFrame};
use ashsplat::{Error, Result};

/// One camera with the name of its picture.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedCamera {
    /// Name of the picture.
    pub name: String,
    /// The camera.
    pub camera: Camera,
}

/// An entry of the file: position in source units from `origin`, and the rows of the rotation from camera to world.
#[derive(Serialize, Deserialize)]
struct Entry {
    id: usize,
    img_name: String,
    width: u32,
    height: u32,
    position: [f64; 3],
    rotation: [[f64; 3]; 3],
    fy: f32,
    fx: f32,
    /// Missing in the reference implementation's file, which supports centred cameras only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    cx: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    cy: Option<f32>,
    /// Absent for pinholes. An orthographic camera's fx and fy are pixels per unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    projection: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    coefficients: Option<Coefficients>,
    /// Rolling shutter; the pose above is then that halfway.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    shutter: Option<ShutterEntry>,
    /// Origin of the position, source coordinates; absent if zero.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    origin: Option<[f64; 3]>,
    /// World unit of the training, source units; absent if 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    unit: Option<f64>,
}

/// [`Shutter`], with the shift in source units.
#[derive(Serialize, Deserialize)]
struct ShutterEntry {
    readout: String,
    turn: [f32; 3],
    shift: [f32; 3],
}

impl ShutterEntry {
    fn new(shutter: Shutter, unit: f64) -> Self {
        let Shutter { readout, turn, shift } = shutter.in_units(1.0 / unit);
        Self { readout: readout.name().to_owned(), turn: turn.to_array(), shift: shift.to_array() }
    }

    fn shutter(&self, unit: f64) -> Result<Shutter, String> {
        let readout = Readout::named(&self.readout)?;
        Ok(Shutter { readout, turn: self.turn.into(), shift: self.shift.into() }.in_units(unit))
    }
}

impl Entry {
    fn new(id: usize, name: &str, camera: &Camera, frame: &WorldFrame) -> Self {
        // An orthographic camera's focal lengths are pixels per unit.
        let per_unit = if camera.is_orthographic() { (1.0 / frame.unit) as f32 } else { 1.0 };
        let world_from_camera = camera.camera_from_world.transpose();
        Self {
            id,
            img_name: name.to_owned(),
            width: camera.width,
            height: camera.height,
            position: (frame.unit * camera.exact_position()).to_array(),
            rotation: [0, 1, 2].map(|row| world_from_camera.row(row).as_dvec3().to_array()),
            fy: per_unit * camera.fy,
            fx: per_unit * camera.fx,
            cx: Some(camera.cx),
            cy: Some(camera.cy),
            projection: (camera.projection != Projection::Perspective)
                .then(|| camera.projection.name().to_owned()),
            coefficients: camera.projection.is_lens().then_some(camera.coefficients),
            shutter: camera.shutter.map(|shutter| ShutterEntry::new(shutter, frame.unit)),
            origin: (frame.origin != DVec3::ZERO).then(|| frame.origin.to_array()),
            unit: (frame.unit != 1.0).then_some(frame.unit),
        }
    }

    /// Returns the camera, or what is wrong with its projection.
    fn camera(&self, frame: &WorldFrame) -> Result<Camera, String> {
        let camera_from_world = DMat3::from_cols_array_2d(&self.rotation);
        let name = self.projection.as_deref().unwrap_or(Projection::Perspective.name());
        let Some(projection) = Projection::ALL.into_iter().find(|projection| projection.name() == name)
        else {
            let names = Projection::ALL.map(Projection::name).join(", ");
            return Err(format!("no projection is named '{name}': {names}"));
        };
        let per_unit = if projection == Projection::Orthographic { frame.unit as f32 } else { 1.0 };
        let intrinsics = Intrinsics {
            fx: per_unit * self.fx,
            fy: per_unit * self.fy,
            cx: self.cx.unwrap_or(0.5 * self.width as f32),
            cy: self.cy.unwrap_or(0.5 * self.height as f32),
            width: self.width,
            height: self.height,
        };
        // Subtracts the origins first, so that positions near the frame's origin keep their bits.
        let from_frame = DVec3::from_array(self.origin.unwrap_or_default()) - frame.origin;
        let position = (DVec3::from_array(self.position) + from_frame) / frame.unit;
        let coefficients = self.coefficients.unwrap_or_default();
        let shutter = self.shutter.as_ref().map(|own| own.shutter(frame.unit)).transpose()?;
        Ok(Camera {
            projection,
            coefficients,
            shutter,
            ..Camera::at(position, camera_from_world, intrinsics)
        })
    }
}

/// Writes cameras, which are in the world coordinates of `frame`, in the reference implementation's form: id, img_name,
/// width, height, position and rotation (camera to world, rows), fy, fx. Positions are in source units from the frame's
/// origin, as in the PLY beside.
///
/// The reference's readers ignore the other keys: cx and cy; `"projection"` ([`Projection::name`]) of cameras that are no
/// pinholes; `"coefficients"` of a lens; `"shutter"` ([`Shutter`]); `"origin"` and `"unit"` of a frame other than the default.
pub fn write<'a>(
    path: impl AsRef<Path>,
    cameras: impl IntoIterator<Item = (&'a str, &'a Camera)>,
    frame: &WorldFrame,
) -> Result<()> {
    let cameras = cameras.into_iter().enumerate();
    let entries: Vec<Entry> =
        cameras.map(|(id, (name, camera))| Entry::new(id, name, camera, frame)).collect();
    atomic::write(path, |writer| Ok(serde_json::to_writer(writer, &entries)?))
}

/// Reads cameras that [`write()`] or the reference implementation wrote. Without cx and cy, the principal point is
/// the image's centre. The cameras are returned in the world coordinates of `frame`.
pub fn read(path: impl AsRef<Path>, frame: &WorldFrame) -> Result<Vec<NamedCamera>> {
    let path = path.as_ref();
    let remedy = "expected [{id, img_name, width, height, position, rotation, fx, fy}, …]";
    let entries: Vec<Entry> = text::json(path, "a list of cameras", remedy)?;
    let named = |entry: &Entry| {
        let camera = entry.camera(frame).and_then(|camera| camera.problem().map_or(Ok(camera), Err));
        let camera = camera.map_err(|problem| {
            Error::input(path, format!("camera {}: {problem}", entry.id), "correct it in the file")
        })?;
        Ok(NamedCamera { name: entry.img_name.clone(), camera })
    };
    entries.iter().map(named).collect()
}

/// Reads the frame from a list's first camera. `None` if it names none, or if the file is no list of cameras.
pub(crate) fn frame_of(path: &Path) -> Option<WorldFrame> {
    let entries: Vec<Entry> = serde_json::from_str(&text::read(path).ok()?).ok()?;
    let &Entry { origin, unit, .. } = entries.first()?;
    let frame = WorldFrame { origin: origin.unwrap_or_default().into(), unit: unit.unwrap_or(1.0) };
    let is_sound =
        frame.origin.abs().max_element() <= FARTHEST && (FARTHEST.recip()..=FARTHEST).contains(&frame.unit);
    (is_sound && !frame.is_identity()).then_some(frame)
}
