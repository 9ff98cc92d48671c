//! Rolling shutters: cameras that move while they read the rows or columns of their picture.

use super::camera::Camera;
use super::lens::PhotoLens;
use glam::{DMat3, DQuat, DVec2, DVec3, Vec3};
use std::f32::consts::PI;

/// Order in which a sensor reads its picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Readout {
    /// Row by row, the uppermost first.
    #[default]
    Down,
    /// Row by row, the lowest first.
    Up,
    /// Column by column, the leftmost first.
    Right,
    /// Column by column, the rightmost first.
    Left,
}

impl Readout {
    /// All orders.
    pub const ALL: [Self; 4] = [Self::Down, Self::Up, Self::Right, Self::Left];

    /// Name in files and errors.
    pub fn name(self) -> &'static str {
        ["down", "up", "right", "left"][self as usize]
    }

    /// The order with this name.
    ///
    /// # Errors
    /// A message with all names, for a name that no order has.
    pub fn named(name: &str) -> Result<Self, String> {
        let names = || Self::ALL.map(Self::name).join(", ");
        let known = Self::ALL.into_iter().find(|own| own.name() == name);
        known.ok_or_else(|| format!("no order of rows or columns is named '{name}': {}", names()))
    }
}

/// Motion of a camera while a rolling shutter reads its picture.
///
/// The camera's own pose is that halfway. A row (or column) is read at a time t from -1/2, for the first, to 1/2, for the last.
/// Then a point x in the space of the camera halfway is at `exp(t turn^) (x - t shift)`: the camera turns about one axis, and its
/// centre moves along a line. Both motions are in the camera's own space, so they stay the same when the camera is moved.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shutter {
    /// Order of the rows or columns.
    pub readout: Readout,
    /// Turn of the scene from the first row to the last: axis times angle, radians; at most half a circle.
    pub turn: Vec3,
    /// Displacement of the camera's centre from the first row to the last, world units, in the space of the camera halfway.
    pub shift: Vec3,
}

/// Steps in which the time of a point is found; they are part of the definition (glsl/include/shutter.glsl).
const STEPS: usize = 6;

/// Time of a picture position (first pixel's centre at 0.5).
fn time_at(rows: DVec3, position: DVec2) -> f64 {
    (position - 0.5).extend(1.0).dot(rows).clamp(-0.5, 0.5)
}

impl Shutter {
    /// The motion between the poses at the first and the last row, and the pose halfway. Poses are rotations and translations
    /// from world to camera.
    pub fn between(first: (DMat3, DVec3), last: (DMat3, DVec3), readout: Readout) -> ((DMat3, DVec3), Self) {
        let [from, to] = [first.0, last.0].map(|rotation| DQuat::from_mat3(&rotation).normalize());
        let turn = to * from.inverse();
        let turn = if turn.w < 0.0 { -turn } else { turn }.to_scaled_axis();
        let [start, end] = [first, last].map(|(rotation, translation)| -(rotation.transpose() * translation));
        let rotation = DMat3::from_quat(DQuat::from_scaled_axis(0.5 * turn) * from);
        let shift = rotation * (end - start);
        let own = Self { readout, turn: turn.as_vec3(), shift: shift.as_vec3() };
        ((rotation, -(rotation * (0.5 * (start + end)))), own)
    }

    /// The motion in a world whose unit is `unit` of these.
    #[must_use]
    pub fn in_units(self, unit: f64) -> Self {
        Self { shift: (self.shift.as_dvec3() / unit).as_vec3(), ..self }
    }

    /// Place of a point at a time, in the space of the camera at that time.
    fn read_at(&self, time: f64, halfway: DVec3) -> DVec3 {
        DQuat::from_scaled_axis(time * self.turn.as_dvec3()) * (halfway - time * self.shift.as_dvec3())
    }

    /// Row (a, b, c) of the time a x + b y + c of a position in a picture of this size, pixels, the centre of the first pixel at 0.
    fn rows(&self, width: u32, height: u32) -> DVec3 {
        let [x, y] = [width, height].map(|side| 1.0 / f64::from(side.max(2) - 1));
        match self.readout {
            Readout::Down => DVec3::new(0.0, y, -0.5),
            Readout::Up => DVec3::new(0.0, -y, 0.5),
            Readout::Right => DVec3::new(x, 0.0, -0.5),
            Readout::Left => DVec3::new(-x, 0.0, 0.5),
        }
    }

    /// Place of a point in the space of the camera that reads it, from that in the space of the camera halfway. None if the lens
    /// does not show it at one of the steps that find its time.
    pub fn reading_of(&self, lens: &PhotoLens, halfway: DVec3) -> Option<DVec3> {
        let rows = self.rows(lens.width, lens.height);
        (0..STEPS).try_fold(halfway, |at, _| Some(self.read_at(time_at(rows, lens.project(at)?), halfway)))
    }
}

impl Camera {
    /// True without a lens, a rolling shutter and parallel rays.
    pub fn is_pinhole(&self) -> bool {
        !(self.has_lens() || self.is_orthographic())
    }

    /// True with a lens or a rolling shutter: kernels have a form for them.
    pub fn has_lens(&self) -> bool {
        self.projection.is_lens() || self.shutter.is_some()
    }

    /// The camera that moves from the pose of `first` to that of `last`, and is `first` otherwise.
    #[must_use]
    pub fn rolling(first: &Self, last: &Self, readout: Readout) -> Self {
        let pose = |camera: &Self| (camera.camera_from_world.as_dmat3(), camera.translation.as_dvec3());
        let ((rotation, translation), shutter) = Shutter::between(pose(first), pose(last), readout);
        let (camera_from_world, translation) = (rotation.as_mat3(), translation.as_vec3());
        Self { camera_from_world, translation, shutter: Some(shutter), ..*first }
    }

    /// The camera at a time t of its shutter, from -1/2 to 1/2, as one without a shutter.
    #[must_use]
    pub fn at_time(&self, time: f64) -> Self {
        let Some(shutter) = self.shutter else { return *self };
        let turn = DQuat::from_scaled_axis(time * shutter.turn.as_dvec3());
        let rotation = DMat3::from_quat(turn) * self.camera_from_world.as_dmat3();
        let translation = shutter.read_at(time, self.translation.as_dvec3());
        let (camera_from_world, translation) = (rotation.as_mat3(), translation.as_vec3());
        Self { camera_from_world, translation, shutter: None, ..*self }
    }

    /// Row of the time of a position in this picture, which may be a part.
    fn shutter_rows(&self, shutter: &Shutter) -> DVec3 {
        let whole = self.whole();
        let rows = shutter.rows(whole.width, whole.height);
        let [left, top] = self.part.map_or([0; 2], |part| [part.left, part.top]).map(f64::from);
        DVec3::new(rows.x, rows.y, rows.dot(DVec3::new(left, top, 1.0)))
    }

    /// Time at which the shutter reads a picture position (first pixel's centre at 0.5).
    pub fn time_of(&self, position: DVec2) -> f64 {
        self.shutter.map_or(0.0, |shutter| time_at(self.shutter_rows(&shutter), position))
    }

    /// Same as [`Shutter::reading_of`]; the point itself without a shutter.
    pub(super) fn reading_of(&self, halfway: DVec3) -> Option<DVec3> {
        let Some(shutter) = self.shutter else { return Some(halfway) };
        shutter.reading_of(&self.whole().photo_lens(), halfway)
    }

    /// Push constants of the kernels (glsl/include/shutter_push.glsl): turn, shift, row of the time; zeros without a shutter.
    pub fn shutter_words(&self) -> [[f32; 3]; 3] {
        self.shutter.map_or([[0.0; 3]; 3], |shutter| {
            [shutter.turn, shutter.shift, self.shutter_rows(&shutter).as_vec3()].map(|words| words.to_array())
        })
    }

    /// Describes what is wrong with the shutter, if anything.
    pub(super) fn shutter_problem(&self) -> Option<&'static str> {
        let Shutter { turn, shift, .. } = self.shutter?;
        if self.is_orthographic() {
            return Some("an orthographic camera has no rolling shutter");
        }
        if !(turn.is_finite() && shift.is_finite()) {
            return Some("a motion of the shutter that is not finite");
        }
        (turn.length() > 1.001 * PI).then_some("a turn of the shutter beyond half a circle")
    }
}
