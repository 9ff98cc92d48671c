//! Gives memory back after pictures that are much larger than those that follow.

use super::draw::Painter;
use super::lights::Places;
use crate::light::Light;
use ashsplat::{Camera, Frame, Gaussians, PixelReport, RenderSettings, Result, TileReport};

/// A picture is much smaller than another with less than 1/MUCH of its pixels.
const MUCH: u64 = 4;
/// So many much smaller pictures in a row show that the large one was an exception.
const IN_A_ROW: u32 = 16;

/// The sizes of the last pictures.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sizes {
    /// Pixels of the largest picture since memory was given back.
    largest: u64,
    /// Much smaller pictures in a row.
    small: u32,
    /// Pixels of the largest of these.
    largest_small: u64,
}

impl Sizes {
    /// Notes a picture. Whether memory is to be given back.
    fn note(&mut self, pixels: u64) -> bool {
        if pixels.saturating_mul(MUCH) >= self.largest {
            *self = Self { largest: self.largest.max(pixels), ..Self::default() };
            return false;
        }
        self.small += 1;
        self.largest_small = self.largest_small.max(pixels);
        let exceptional = self.small >= IN_A_ROW;
        if exceptional {
            *self = Self { largest: self.largest_small, ..Self::default() };
        }
        exceptional
    }
}

/// A painter that gives memory back.
pub struct Sparing<'a> {
    pub painter: &'a mut dyn Painter,
    pub sizes: Sizes,
}

impl Sparing<'_> {
    fn draw<T>(&mut self, camera: &Camera, draw: impl FnOnce(&mut dyn Painter) -> Result<T>) -> Result<T> {
        let drawn = draw(self.painter)?;
        if self.sizes.note(u64::from(camera.width) * u64::from(camera.height)) {
            self.painter.shrink();
        }
        Ok(drawn)
    }
}

impl Painter for Sparing<'_> {
    fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Frame> {
        self.draw(camera, |painter| painter.render(camera, settings))
    }

    fn render_with_tiles(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<(Frame, TileReport)> {
        self.draw(camera, |painter| painter.render_with_tiles(camera, settings))
    }

    fn inspect(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
        pixel: [u32; 2],
    ) -> Result<PixelReport> {
        self.draw(camera, |painter| painter.inspect(camera, settings, pixel))
    }

    fn gaussians(&self) -> Result<Gaussians> {
        self.painter.gaussians()
    }

    fn shrink(&mut self) {
        self.painter.shrink();
    }

    fn light(&self, places: Places) -> Result<Light> {
        self.painter.light(places)
    }

    fn iteration(&self) -> Option<u32> {
        self.painter.iteration()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_given_back_after_an_exception_and_not_where_sizes_alternate() {
        let (hd, phone) = (1920 * 1080, 360 * 640);
        let mut sizes = Sizes::default();
        assert!((0..100).all(|_| !sizes.note(hd)), "always the same");
        // Two pages.
        assert!((0..100).all(|i| !sizes.note(if i % 2 == 0 { hd } else { phone })));
        assert!(!sizes.note(8192 * 8192));
        let after = (1..=50).filter(|_| sizes.note(hd)).count();
        assert_eq!((after, sizes.largest), (1, hd));
        let when = (1..=50).find(|_| sizes.note(phone));
        assert_eq!((when, sizes.largest), (Some(IN_A_ROW), phone));
    }
}
