//! Frees memory after pictures that are much larger than the next ones.

use super::draw::{Audience, Painter};
use super::lights::Places;
use ashsplat::{Camera, Frame, Gaussians, PixelReport, RenderSettings, Result, TileReport};
use ashsplat_program::light::Light;
use serde_json::Value;

/// A picture is much smaller than another with less than 1/MUCH of its pixels.
const MUCH: u64 = 4;
/// After this many much smaller pictures in a row, the large one counts as an exception.
const IN_A_ROW: u32 = 16;

#[derive(Clone, Copy, Debug, Default)]
pub struct Sizes {
    /// Pixels of the largest picture since memory was freed.
    largest: u64,
    /// Number of much smaller pictures in a row.
    small: u32,
    /// Pixels of the largest of these.
    largest_small: u64,
}

impl Sizes {
    /// Records a picture. True if memory should be freed.
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

/// A painter that frees memory.
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

    fn attend(&mut self, audience: &Audience<'_>) {
        self.painter.attend(audience);
    }

    fn is_ready(&mut self, camera: &Camera) -> Result<bool> {
        self.painter.is_ready(camera)
    }

    fn tree(&self) -> Option<&Value> {
        self.painter.tree()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ashsplat::Error;
    use ashsplat::scene::Intrinsics;

    /// Draws nothing, and counts how often it frees memory.
    struct Counter(u32);

    impl Painter for Counter {
        fn render(&mut self, _: &Camera, _: &RenderSettings) -> Result<Frame> {
            Ok(Frame::default())
        }
        fn render_with_tiles(&mut self, _: &Camera, _: &RenderSettings) -> Result<(Frame, TileReport)> {
            Err(Error::argument("tiles", "there are none"))
        }
        fn inspect(&mut self, _: &Camera, _: &RenderSettings, _: [u32; 2]) -> Result<PixelReport> {
            Err(Error::argument("pixel", "there is none"))
        }
        fn gaussians(&self) -> Result<Gaussians> {
            Ok(Gaussians::default())
        }
        fn shrink(&mut self) {
            self.0 += 1;
        }
    }

    /// One very large picture, then usual ones: the painter frees memory once.
    #[test]
    fn a_painter_is_told_to_give_memory_back() {
        let mut counter = Counter(0);
        let mut sparing = Sparing { painter: &mut counter, sizes: Sizes::default() };
        let picture = |width: u32, height: u32| {
            let lens = Intrinsics::from_fov_x(1.0, width, height);
            Camera::with_pose(Default::default(), Default::default(), lens)
        };
        let settings = RenderSettings::default();
        sparing.render(&picture(8192, 8192), &settings).expect("drawn");
        for _ in 0..2 * IN_A_ROW {
            sparing.render(&picture(640, 480), &settings).expect("drawn");
        }
        assert_eq!(counter.0, 1);
    }

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
