//! Capacities of a frame for its pictures.

use super::{Strips, tile_grid};
use crate::kernels::constants::TILE_SIZE;
use crate::scene::Camera;

/// Sizes of the pictures that a frame's buffers hold. Each field is the largest over the pictures, so that no memory is
/// planned for a picture that is both wide and high.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PictureCapacity {
    /// Pixels.
    pub pixels: u64,
    /// Tiles.
    pub tiles: u64,
    /// Values per plane in [`Strips`], for any picture with the same grid of tiles. Only frames with backward use them.
    pub strip_values: u64,
    /// Tiles along the longer side. Only the loss of backward frames has a grid of workgroups with these sides.
    pub side_tiles: u32,
}

impl PictureCapacity {
    /// Capacity for no picture.
    pub const NONE: Self = Self { pixels: 0, tiles: 0, strip_values: 0, side_tiles: 0 };

    /// Returns the capacity for pictures of one size, px.
    pub fn of(width: u32, height: u32) -> Self {
        let (columns, rows) = tile_grid(width, height);
        let strips =
            Strips { width: columns.saturating_mul(TILE_SIZE), height: rows.saturating_mul(TILE_SIZE) };
        Self {
            pixels: u64::from(width) * u64::from(height),
            tiles: u64::from(columns) * u64::from(rows),
            strip_values: strips.values(),
            side_tiles: columns.max(rows),
        }
    }

    /// Returns the capacity for the picture of each camera.
    pub fn of_cameras<'a>(cameras: impl IntoIterator<Item = &'a Camera>) -> Self {
        cameras.into_iter().map(|camera| Self::of(camera.width, camera.height)).fold(Self::NONE, Self::and)
    }

    /// Same capacity, without the sizes that only frames with backward need.
    #[must_use]
    pub fn without_backward(self) -> Self {
        Self { strip_values: 0, side_tiles: 0, ..self }
    }

    /// Returns the capacity for the pictures of both.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self {
            pixels: self.pixels.max(other.pixels),
            tiles: self.tiles.max(other.tiles),
            strip_values: self.strip_values.max(other.strip_values),
            side_tiles: self.side_tiles.max(other.side_tiles),
        }
    }

    /// True if the pictures of `other` fit.
    pub fn holds(&self, other: &Self) -> bool {
        self.and(*other) == *self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wide_and_high_pictures_need_the_larger_of_both() {
        let (wide, high) = (PictureCapacity::of(6000, 600), PictureCapacity::of(600, 6000));
        let both = wide.and(high);
        assert_eq!((both.pixels, both.tiles, both.side_tiles), (3_600_000, 375 * 38, 375));
        assert_eq!(both.strip_values, wide.strip_values.max(high.strip_values));
        assert!(both.holds(&wide) && both.holds(&high) && !wide.holds(&PictureCapacity::of(601, 6000)));
        // Fewer pixels may need more tiles.
        let line = PictureCapacity::of(65_535, 1);
        assert!(line.pixels < wide.pixels && !wide.and(high).holds(&line) && line.tiles == 4096);
    }
}
