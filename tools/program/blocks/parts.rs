//! Finds the pixels of a photo that show a block, by the depths of a scene that is drawn small.

use crate::output::Depth;
use ashsplat::Frame;
use ashsplat::scene::{Bounds, Camera};
use ashsplat::train::SceneBlock;
use glam::Vec3;
use serde::{Deserialize, Serialize};

/// Least opacity of a pixel that can be excluded; fainter ones may show anything.
const MIN_OPACITY: f32 = 0.5;

/// The part of a photo that shows a block, independent of the photo's size.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Part {
    /// Size of the picture in whose pixels `columns` and `rows` are given.
    pub of: [u32; 2],
    /// First column and end column in that picture.
    pub columns: [u32; 2],
    /// First row and end row in that picture.
    pub rows: [u32; 2],
}

impl Part {
    pub fn is_whole(&self) -> bool {
        self.columns == [0, self.of[0]] && self.rows == [0, self.of[1]]
    }

    /// Number of pixels of the part in a photo of this size.
    pub fn pixels(&self, width: u32, height: u32) -> u64 {
        let sides = [self.columns, self.rows].into_iter().zip(self.of).zip([width, height]);
        sides
            .map(|(([from, to], of), side)| (u64::from(to - from) * u64::from(side)).div_ceil(of.into()))
            .product()
    }

    /// True if the part is not empty and lies in its picture.
    pub fn exists(&self) -> bool {
        [self.columns, self.rows].iter().zip(self.of).all(|([from, to], side)| from < to && *to <= side)
    }
}

/// Content of a small picture's pixels.
pub struct BlockPixels {
    size: [usize; 2],
    /// True for pixels that show the block with its margin; `None` for transparent pixels.
    inside: Vec<Option<bool>>,
}

impl BlockPixels {
    pub fn of(camera: &Camera, frame: &Frame, (core, margin): (Bounds, f32)) -> Self {
        let inside = |place: glam::Vec3| SceneBlock::contains(core, margin, place.to_array());
        let pixels = places(camera, frame).into_iter().zip(&frame.transmittance);
        let inside = pixels
            .map(|(place, transmittance)| place.filter(|_| 1.0 - transmittance >= MIN_OPACITY).map(inside));
        Self { size: [frame.width, frame.height].map(|side| side as usize), inside: inside.collect() }
    }

    /// True for each pixel that counts: it or a neighbour shows the block or is transparent.
    pub fn counting(&self) -> Vec<bool> {
        let [width, height] = self.size;
        let shown: Vec<bool> = self.inside.iter().map(|inside| *inside != Some(false)).collect();
        let around = |at: usize, end: usize| at.saturating_sub(1)..(at + 2).min(end);
        let any = |x: usize, y: usize| {
            around(y, height).any(|row| shown[row * width..][..width][around(x, width)].contains(&true))
        };
        (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| any(x, y)).collect()
    }

    /// The columns and rows of the pixels that show the block, with a border of one pixel. `None` if there are none.
    pub fn part(&self) -> Option<Part> {
        let [width, height] = self.size;
        let shows = |pixel: &usize| self.inside[*pixel] == Some(true);
        let shown = (0..self.inside.len()).filter(shows);
        let grown = |places: &mut dyn Iterator<Item = usize>, end: usize| {
            let (first, last) = places.fold((usize::MAX, 0), |(a, b), place| (a.min(place), b.max(place)));
            (first <= last).then(|| [first.saturating_sub(1), (last + 2).min(end)].map(|end| end as u32))
        };
        let columns = grown(&mut shown.clone().map(|pixel| pixel % width), width)?;
        let rows = grown(&mut shown.map(|pixel| pixel / width), height)?;
        Some(Part { of: self.size.map(|side| side as u32), columns, rows })
    }
}

/// Longer side of pictures that only locate things, pixels.
const SIDE: u32 = 200;

/// The camera scaled to at most [`SIDE`].
pub fn small(camera: &Camera) -> Camera {
    let longest = camera.width.max(camera.height);
    let scaled = |side: u32| match longest {
        ..=SIDE => side,
        _ => ((f64::from(side) * f64::from(SIDE) / f64::from(longest)).round() as u32).max(1),
    };
    camera.scaled_to(scaled(camera.width), scaled(camera.height))
}

/// World position of each pixel of a frame, row by row; `None` for transparent pixels. It uses the frame's harmonic
/// depth, which Gaussians far behind a surface hardly move.
pub fn places(camera: &Camera, frame: &Frame) -> Vec<Option<Vec3>> {
    let points = camera.points();
    let place = |(pixel, z): (usize, f32)| {
        let [x, y] = [pixel % frame.width as usize, pixel / frame.width as usize].map(|p| p as f32 + 0.5);
        z.is_finite().then(|| points([x, y], z))
    };
    Depth::Harmonic.of(frame).into_iter().enumerate().map(place).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ashsplat::scene::Intrinsics;
    use glam::vec3;

    #[test]
    fn a_part_has_its_share_of_a_photos_pixels() {
        let part = Part { of: [40, 20], columns: [10, 30], rows: [0, 5] };
        assert_eq!(part.pixels(400, 200), 200 * 50);
        // Rounded up.
        assert_eq!(part.pixels(41, 21), 21 * 6);
        assert_eq!(Part { of: [40, 20], columns: [0, 40], rows: [0, 20] }.pixels(333, 77), 333 * 77);
    }

    /// A wall at depth 2 whose left half is the block; the last columns show nothing.
    #[test]
    fn pixels_of_the_block_and_next_to_it_count_and_those_of_nothing() {
        let intrinsics = Intrinsics::from_fov_x(1.0, 40, 20);
        let camera = Camera::look_at(vec3(0.0, 0.0, -2.0), Vec3::ZERO, Vec3::NEG_Y, intrinsics);
        let transmittance: Vec<f32> = (0..800).map(|pixel| if pixel % 40 < 35 { 0.0 } else { 0.9 }).collect();
        let inverse_depth = Some(transmittance.iter().map(|t| (1.0 - t) / 2.0).collect());
        let color = vec![[0.0; 3]; 800];
        let frame = Frame { width: 40, height: 20, color, transmittance, inverse_depth, ..Frame::default() };
        let everything = Vec3::splat(f32::INFINITY);
        let core = Bounds { min: -everything, max: everything.with_x(0.0) };
        let shown = |margin: f32| BlockPixels::of(&camera, &frame, (core, margin));
        let counts = shown(0.0).counting();
        for (pixel, counts) in counts.iter().enumerate() {
            assert_eq!(*counts, !(21..34).contains(&(pixel % 40)), "{pixel}");
        }
        // A column is 2 tan(0.5) 2 / 40 = 0.055 wide.
        let wider = shown(0.1).counting();
        assert!(wider[22] && !wider[23]);
        let part = |columns: [u32; 2]| Some(Part { of: [40, 20], columns, rows: [0, 20] });
        assert_eq!((shown(0.0).part(), shown(0.1).part()), (part([0, 21]), part([0, 23])));
        let nothing = Bounds { min: Vec3::splat(9.0), max: everything };
        assert_eq!(BlockPixels::of(&camera, &frame, (nothing, 0.0)).part(), None);
    }
}
