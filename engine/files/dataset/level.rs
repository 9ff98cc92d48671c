//! Turns a data set upright.

use std::fmt;
use std::str::FromStr;

use glam::{DMat3, DQuat, DVec3};

use super::plan::{Plan, centers};
use super::planned_view::PlannedView;
use crate::text;
use ashsplat::scene::{Camera, SourcePoints, level_up, median_ball};
use ashsplat::{Error, Result};

/// Direction that viewers show above: -y, as in pictures.
const UP: DVec3 = DVec3::NEG_Y;

/// Rotation that turns a data set upright, so that its up direction becomes -y. All that is read, trained and written is in the
/// turned coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Level {
    /// The files' coordinates.
    #[default]
    Off,
    /// Up is the direction across the cameras' horizontal axes.
    On,
    /// The turn of an earlier reading.
    Turn {
        /// Up direction in the files' coordinates, of unit length.
        up: DVec3,
        /// Point that stays in its place, the files' coordinates.
        pivot: DVec3,
    },
}

impl Level {
    fn rotation(self) -> DMat3 {
        match self {
            Self::Turn { up, .. } => DMat3::from_quat(DQuat::from_rotation_arc(up, UP)),
            Self::Off | Self::On => DMat3::IDENTITY,
        }
    }

    /// Turned coordinates of a point in the files' coordinates.
    pub(super) fn turned(self, point: DVec3) -> DVec3 {
        match self {
            Self::Turn { pivot, .. } => pivot + self.rotation() * (point - pivot),
            Self::Off | Self::On => point,
        }
    }
}

impl FromStr for Level {
    type Err = Error;

    /// `off`, `on`, or the six numbers of up direction and pivot.
    fn from_str(text: &str) -> Result<Self> {
        let wrong =
            || Error::argument("level", format!("'{text}' is not off, on, or up direction and pivot"));
        match text {
            "off" => return Ok(Self::Off),
            "on" => return Ok(Self::On),
            _ => {}
        }
        let [a, b, c, x, y, z] = text::numbers(text).ok_or_else(wrong)?;
        let (up, pivot) = (DVec3::new(a, b, c), DVec3::new(x, y, z));
        let up = up.try_normalize().filter(|_| pivot.is_finite()).ok_or_else(wrong)?;
        Ok(Self::Turn { up, pivot })
    }
}

impl fmt::Display for Level {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Off => f.write_str("off"),
            Self::On => f.write_str("on"),
            Self::Turn { up, pivot } => {
                write!(f, "{},{},{},{},{},{}", up.x, up.y, up.z, pivot.x, pivot.y, pivot.z)
            }
        }
    }
}

impl Plan {
    /// Turns views and points, and notes the angle. [`Level::On`] turns them about the middle of the cameras.
    pub(super) fn turn_upright(&mut self, level: Level, points: &mut SourcePoints) {
        let views: Vec<&PlannedView> = self.views.iter().flatten().collect();
        let by_cameras = || {
            let cameras: Vec<Camera> = views.iter().map(|view| view.camera()).collect();
            let (pivot, _) = median_ball(&centers(&views))?;
            Some(Level::Turn { up: level_up(&cameras)?.normalize(), pivot })
        };
        self.level = match level {
            Level::On => by_cameras().unwrap_or_default(),
            level => level,
        };
        let Level::Turn { up, pivot } = self.level else {
            if level == Level::On && !views.is_empty() {
                self.warn("its cameras have no common up direction, so that --level does not turn it");
            }
            return;
        };
        let (level, back) = (self.level, self.level.rotation().transpose());
        for view in self.views.iter_mut().flatten() {
            view.translation += view.camera_from_source * (pivot - back * pivot);
            view.camera_from_source *= back;
        }
        points.positions.iter_mut().for_each(|point| *point = level.turned(*point));
        let (list, angle) = (self.list.display(), up.angle_between(UP).to_degrees());
        self.notes
            .push(format!("{list}: the scene is turned by {angle:.1} degrees, so that up is -y (--level)"));
    }
}
