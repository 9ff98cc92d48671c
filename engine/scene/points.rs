//! Coloured points, and boxes around them.

use glam::{DVec3, Vec3};

use super::world_frame::WorldFrame;

/// A point cloud, structure of arrays: both vectors have `len()` entries.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointCloud {
    /// Positions, world units.
    pub positions: Vec<[f32; 3]>,
    /// Colours (r, g, b), 0 to 255.
    pub colors: Vec<[u8; 3]>,
}

impl PointCloud {
    /// Number of points.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// True if there are no points.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Smallest box around the points; None without points.
    pub fn bounds(&self) -> Option<Bounds> {
        Bounds::of(self.positions.iter().map(|&p| Vec3::from_array(p)))
    }
}

/// A point cloud from a file, in source coordinates: see [`WorldFrame`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SourcePoints {
    /// Positions, source units.
    pub positions: Vec<DVec3>,
    /// Colours (r, g, b), 0 to 255.
    pub colors: Vec<[u8; 3]>,
}

impl SourcePoints {
    /// Number of points.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// True if there are no points.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Keeps the points with true in `kept`, which has one value per point.
    pub fn retain(&mut self, kept: &[bool]) {
        let mut of_position = kept.iter();
        self.positions.retain(|_| of_position.next() == Some(&true));
        let mut of_color = kept.iter();
        self.colors.retain(|_| of_color.next() == Some(&true));
    }

    /// Converts the points to the world coordinates of a frame.
    pub fn in_frame(self, frame: &WorldFrame) -> PointCloud {
        let positions = self.positions.iter().map(|&position| frame.world(position).to_array()).collect();
        PointCloud { positions, colors: self.colors }
    }
}

/// An axis-aligned box in world units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Corner with the smallest coordinates.
    pub min: Vec3,
    /// Corner with the largest coordinates.
    pub max: Vec3,
}

impl Bounds {
    /// Smallest box around the points; None without points.
    pub fn of(points: impl Iterator<Item = Vec3>) -> Option<Self> {
        points.fold(None, |bounds: Option<Self>, p| {
            let Self { min, max } = bounds.unwrap_or(Self { min: p, max: p });
            Some(Self { min: min.min(p), max: max.max(p) })
        })
    }

    /// Box with two opposite corners.
    pub fn between(one: Vec3, other: Vec3) -> Self {
        Self { min: one.min(other), max: one.max(other) }
    }

    /// Half-open box: true on the lower sides, false on the upper ones, so that neighbours share no point. False for NaN.
    pub fn contains(&self, point: Vec3) -> bool {
        point.cmpge(self.min).all() && point.cmplt(self.max).all()
    }

    /// Edge lengths.
    pub fn size(&self) -> Vec3 {
        self.max - self.min
    }

    /// Centre of the box.
    pub fn center(&self) -> Vec3 {
        0.5 * (self.min + self.max)
    }
}
