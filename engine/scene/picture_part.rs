//! A picture that is a part of a larger one.

use super::Camera;
use crate::{Error, Result};

/// Place of a camera's picture in a larger one.
///
/// A part has the whole picture's pixels. The whole picture's edges bound the linearisation, the lens effects and the 3D
/// filter. Sums of training (loss, statistics of densification) are the part's share of the whole's. So a photograph can be
/// trained where it shows a block of a scene. A picture that exceeds the device's memory can be rendered part by part.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PicturePart {
    /// Number of the whole picture's columns to the left of the part.
    pub left: u32,
    /// Number of the whole picture's rows above the part.
    pub top: u32,
    /// Width of the whole picture, pixels.
    pub whole_width: u32,
    /// Height of the whole picture, pixels.
    pub whole_height: u32,
}

impl PicturePart {
    /// True if a picture of this size fits there.
    pub(super) fn holds(&self, width: u32, height: u32) -> bool {
        let fits = |from: u32, side: u32, whole: u32| from.checked_add(side).is_some_and(|end| end <= whole);
        fits(self.left, width, self.whole_width) && fits(self.top, height, self.whole_height)
    }
}

impl Camera {
    /// Camera of a part of this picture: `width` by `height` pixels from the column `left` and the row `top`. If both are
    /// multiples of 16, the part has the same tiles.
    ///
    /// # Errors
    /// [`Error::Argument`] for a part that is empty or exceeds the picture.
    pub fn part(&self, [left, top]: [u32; 2], [width, height]: [u32; 2]) -> Result<Self> {
        let here = PicturePart { left, top, whole_width: self.width, whole_height: self.height };
        if width == 0 || height == 0 || !here.holds(width, height) {
            let problem = format!(
                "{width}x{height} pixels from ({left}, {top}) are no part of {}x{}",
                self.width, self.height
            );
            return Err(Error::argument("part", problem));
        }
        let part = match self.part {
            Some(own) => PicturePart { left: own.left + left, top: own.top + top, ..own },
            None => here,
        };
        let (cx, cy) = (self.cx - left as f32, self.cy - top as f32);
        let is_whole = !part.is_smaller(width, height);
        Ok(Self { cx, cy, width, height, part: (!is_whole).then_some(part), ..*self })
    }

    /// Camera of the whole picture; itself if it is whole.
    pub fn whole(&self) -> Self {
        let Some(PicturePart { left, top, whole_width, whole_height }) = self.part else { return *self };
        let (cx, cy) = (self.cx + left as f32, self.cy + top as f32);
        Self { cx, cy, width: whole_width, height: whole_height, part: None, ..*self }
    }

    /// True for sides where the picture is cut from a larger one: left, top, right, bottom.
    pub(crate) fn cut_sides(&self) -> [bool; 4] {
        self.part.map_or([false; 4], |PicturePart { left, top, whole_width, whole_height }| {
            [left > 0, top > 0, left + self.width < whole_width, top + self.height < whole_height]
        })
    }

    /// Number of pixels as a share of the whole picture's; 1 if it is whole.
    pub fn share_of_whole(&self) -> f64 {
        let pixels = |camera: &Self| f64::from(camera.width) * f64::from(camera.height);
        pixels(self) / pixels(&self.whole())
    }
}

impl PicturePart {
    fn is_smaller(&self, width: u32, height: u32) -> bool {
        width < self.whole_width || height < self.whole_height
    }

    /// Part at another scale of its picture, whose size becomes (width, height).
    pub(super) fn scaled_by(&self, [sx, sy]: [f64; 2], (width, height): (u32, u32)) -> Self {
        let scaled = |length: u32, by: f64| (f64::from(length) * by).round() as u32;
        let (left, top) = (scaled(self.left, sx), scaled(self.top, sy));
        // The part must fit despite rounding.
        let whole_width = scaled(self.whole_width, sx).max(left + width);
        Self { left, top, whole_width, whole_height: scaled(self.whole_height, sy).max(top + height) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Intrinsics;
    use glam::{Vec3, vec3};

    fn camera() -> Camera {
        let intrinsics = Intrinsics { cx: 70.25, ..Intrinsics::from_fov_x(0.8, 128, 96) };
        Camera::look_at(vec3(0.0, 0.0, -3.0), Vec3::ZERO, Vec3::NEG_Y, intrinsics)
    }

    #[test]
    fn a_part_has_the_wholes_pixels() {
        let whole = camera();
        let part = whole.part([32, 16], [48, 40]).expect("a part");
        let point = vec3(0.3, -0.2, 0.4);
        let (x, y, z) = whole.project(point);
        let (px, py, pz) = part.project(point);
        assert!((px - (x - 32.0)).abs() < 1e-4 && (py - (y - 16.0)).abs() < 1e-4 && pz == z);
        assert_eq!((part.width, part.height), (48, 40));
        assert_eq!(part.whole(), whole);
        assert_eq!(part.share_of_whole(), 48.0 * 40.0 / (128.0 * 96.0));
        let smaller = part.part([16, 0], [16, 16]).expect("a part of it");
        assert_eq!(smaller, whole.part([48, 16], [16, 16]).expect("the same"));
        assert!(part.check().is_ok() && smaller.check().is_ok());
        let corner = whole.part([80, 0], [48, 40]).expect("a part");
        let cut = [whole, part, corner].map(|camera| camera.cut_sides());
        assert_eq!(cut, [[false; 4], [true; 4], [true, false, false, true]]);
    }

    #[test]
    fn the_whole_is_no_part() {
        let whole = camera();
        assert_eq!(whole.part([0, 0], [128, 96]).expect("all of it"), whole);
        assert_eq!((whole.whole(), whole.share_of_whole()), (whole, 1.0));
    }

    #[test]
    fn what_is_no_part_is_refused() {
        for (corner, size) in
            [([0, 0], [129, 96]), ([64, 0], [65, 9]), ([0, 0], [0, 9]), ([0, u32::MAX], [9, 9])]
        {
            assert!(camera().part(corner, size).is_err(), "{corner:?} {size:?}");
        }
        let part = camera().part([64, 64], [32, 32]).expect("a part");
        let shifted = PicturePart { left: 100, ..part.part.expect("one") };
        assert!(Camera { part: Some(shifted), ..part }.check().is_err());
    }

    #[test]
    fn a_part_is_scaled_with_its_whole() {
        let part = camera().part([32, 16], [48, 40]).expect("a part");
        let half = part.scaled_to(24, 20);
        assert_eq!(half, camera().scaled_to(64, 48).part([16, 8], [24, 20]).expect("a part"));
    }
}
