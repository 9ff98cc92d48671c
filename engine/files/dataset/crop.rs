//! The used part of a photo.

use std::ops::Range;

use crate::images::Photo;
use ashsplat::kernels::constants::TILE_SIZE;
use ashsplat::{Error, Result};

/// Reach of a pixel's gradient, pixels: twice the radius of SSIM's window, for the windows that hold the pixel.
const WINDOW: u32 = 10;

/// The used part of a photo, independent of the photo's size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Crop {
    /// Size of the coarse picture.
    coarse: (u32, u32),
    /// Columns of the coarse picture.
    columns: (u32, u32),
    /// Rows of the coarse picture.
    rows: (u32, u32),
}

impl Crop {
    /// A part of these columns and rows of a picture of size `coarse`.
    pub(super) fn of(coarse: (u32, u32), columns: Range<u32>, rows: Range<u32>) -> Result<Self> {
        let lies_in = |range: &Range<u32>, side: u32| !range.is_empty() && range.end <= side;
        if !lies_in(&columns, coarse.0) || !lies_in(&rows, coarse.1) {
            let problem = format!("{columns:?}, {rows:?} is none of {}x{} pixels", coarse.0, coarse.1);
            return Err(Error::argument("part", problem));
        }
        Ok(Self { coarse, columns: (columns.start, columns.end), rows: (rows.start, rows.end) })
    }

    /// Corner and size of the part in a picture of this size, with the border that gradients depend on, in whole tiles.
    pub(super) fn in_picture(self, (width, height): (u32, u32)) -> ([u32; 2], [u32; 2]) {
        let of = |(from, to): (u32, u32), coarse: u32, side: u32| {
            let [from, to, coarse, wide] = [from, to, coarse, side].map(u64::from);
            let (first, end) = ((from * wide / coarse) as u32, (to * wide).div_ceil(coarse) as u32);
            let (first, end) = (first.saturating_sub(WINDOW), (end + WINDOW).min(side));
            let size = (end - first).next_multiple_of(TILE_SIZE).min(side);
            (first.min(side - size), size)
        };
        let (left, width) = of(self.columns, self.coarse.0, width);
        let (top, height) = of(self.rows, self.coarse.1, height);
        ([left, top], [width, height])
    }
}

/// Cuts a part out of a picture that is `whole` pixels wide and has `each` values per pixel.
pub(super) fn cut<T: Copy>(
    values: &[T],
    (whole, each): (u32, usize),
    [left, top]: [u32; 2],
    [width, height]: [u32; 2],
) -> Vec<T> {
    let row = |y: u32| {
        let first = each * (y as usize * whole as usize + left as usize);
        &values[first..first + each * width as usize]
    };
    (top..top + height).flat_map(row).copied().collect()
}

pub(super) fn cut_photo(photo: &Photo, corner: [u32; 2], size: [u32; 2]) -> Photo {
    let rgb = cut(&photo.rgb, (photo.width, 3), corner, size);
    Photo { width: size[0], height: size[1], rgb }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::growth::turn;

    #[test]
    fn a_part_covers_what_is_wanted_in_whole_tiles_and_no_part_is_refused() {
        let _turn = turn();
        let part = Crop::of((200, 150), 100..104, 0..150).expect("a part");
        // From 640 to 666 of 1280 pixels, with 10 more on each side.
        assert_eq!(part.in_picture((1280, 960)), ([630, 0], [48, 960]));
        // Pixels 50 and 51 of 100, from 40 to 62.
        assert_eq!(part.in_picture((100, 75)), ([40, 0], [32, 75]));
        let last = Crop::of((200, 150), 180..200, 149..150).expect("a part");
        assert_eq!(last.in_picture((100, 75)), ([68, 59], [32, 16]));
        let all = Crop::of((7, 5), 0..7, 0..5).expect("a part");
        assert_eq!(all.in_picture((123, 45)), ([0, 0], [123, 45]));
        for (columns, rows) in [(3..3, 0..5), (0..8, 0..5), (0..7, 5..6)] {
            let part = Crop::of((7, 5), columns.clone(), rows.clone());
            assert!(part.is_err(), "{columns:?} {rows:?} is no part");
        }
    }
}
