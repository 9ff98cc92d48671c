//! Errors of pixels inside blocks and along their seams.

use ashsplat::Frame;
use ashsplat::scene::{Camera, Cells, Seam};
use ashsplat_program::blocks::parts::places;
use glam::Vec3;

/// Least number of visible pixels of a seam that is compared.
const MIN_PIXELS: u64 = 100;

/// Sum of squared errors of colours, 0 to 1.
#[derive(Clone, Copy, Default)]
pub struct Errors {
    pub squared: f64,
    pub pixels: u64,
}

impl Errors {
    fn add(&mut self, squared: f64) {
        self.squared += squared;
        self.pixels += 1;
    }

    /// PSNR over all pixels together, dB; `None` without pixels.
    pub fn psnr(&self) -> Option<f64> {
        let mean = self.squared / (3 * self.pixels) as f64;
        (self.pixels > 0).then(|| -10.0 * mean.log10())
    }
}

#[derive(Default)]
pub struct SceneErrors {
    pub views: Vec<Errors>,
    pub inside: Errors,
    pub band: Errors,
    pub seams: Vec<Errors>,
}

impl SceneErrors {
    /// Adds a view's frame and photo. `regions` has each pixel's seam, `counts` is false for pixels to skip.
    pub fn add(
        &mut self,
        frame: &Frame,
        photo: &[[f32; 3]],
        regions: &[Option<usize>],
        counts: impl Fn(usize) -> bool,
    ) {
        let mut view = Errors::default();
        for (pixel, ((color, expected), region)) in frame.color.iter().zip(photo).zip(regions).enumerate() {
            if !counts(pixel) {
                continue;
            }
            let difference = |(&a, &b): (&f32, &f32)| f64::from(a.clamp(0.0, 1.0) - b).powi(2);
            let squared = color.iter().zip(expected).map(difference).sum();
            view.add(squared);
            match region {
                None => self.inside.add(squared),
                Some(seam) => {
                    self.band.add(squared);
                    self.seams[*seam].add(squared);
                }
            }
        }
        self.views.push(view);
    }

    /// Errors over all pixels of all views.
    pub fn whole(&self) -> Errors {
        let [a, b] = [self.inside, self.band];
        Errors { squared: a.squared + b.squared, pixels: a.pixels + b.pixels }
    }

    /// Mean over the views, dB.
    pub fn mean_psnr(&self) -> f64 {
        let views: Vec<f64> = self.views.iter().filter_map(Errors::psnr).collect();
        views.iter().sum::<f64>() / views.len() as f64
    }

    /// Seams with enough visible pixels, the worst first.
    pub fn worst_seams(&self) -> Vec<usize> {
        let seen = |&seam: &usize| self.seams[seam].pixels >= MIN_PIXELS;
        let mut seams: Vec<usize> = (0..self.seams.len()).filter(seen).collect();
        let psnr = |seam: usize| self.seams[seam].psnr().unwrap_or(f64::INFINITY);
        seams.sort_by(|&a, &b| psnr(a).total_cmp(&psnr(b)));
        seams
    }
}

pub struct Seams<'a> {
    cells: &'a Cells,
    pub all: Vec<Seam>,
    of_cells: Vec<Vec<usize>>,
    /// Largest distance along a seam, world units.
    band: f32,
}

impl Seams<'_> {
    pub fn of(cells: &Cells, band: f32) -> Seams<'_> {
        let all = cells.seams();
        let mut of_cells = vec![Vec::new(); cells.bounds().len()];
        for (index, seam) in all.iter().enumerate() {
            seam.cells.iter().for_each(|&cell| of_cells[cell].push(index));
        }
        Seams { cells, all, of_cells, band }
    }

    pub fn nothing(&self) -> SceneErrors {
        SceneErrors { seams: vec![Errors::default(); self.all.len()], ..SceneErrors::default() }
    }

    /// The nearest seam of a position's cell, if it is within the band.
    fn near(&self, place: Vec3) -> Option<usize> {
        let seams = self.of_cells[self.cells.at(place)?].iter();
        let distances = seams.map(|&seam| (self.all[seam].distance(place), seam));
        let (distance, seam) = distances.min_by(|a, b| a.0.total_cmp(&b.0))?;
        (distance <= self.band).then_some(seam)
    }

    /// The seam along which each pixel lies, if any.
    pub fn regions(&self, camera: &Camera, frame: &Frame) -> Vec<Option<usize>> {
        places(camera, frame).into_iter().map(|place| place.and_then(|place| self.near(place))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_counted_where_they_are() {
        let cells = Cells::divide(&[[0.0; 3], [2.0, 0.0, 0.0], [0.0, 4.0, 0.0]], 1).expect("cells");
        let seams = Seams::of(&cells, 0.5);
        let found = |x: f32, y: f32| seams.near(Vec3::new(x, y, 7.0));
        // Halved at y = 4, then the lower part at x = 2.
        assert_eq!((seams.all.len(), found(0.0, 0.0), found(9.0, 9.0)), (3, None, None));
        let x = found(1.6, 0.0).expect("along x = 2");
        assert_eq!((seams.all[x].axis, found(2.4, 3.0)), (0, Some(x)));
        assert_eq!(found(0.0, 3.5).map(|seam| seams.all[seam].axis), Some(1));
        assert_eq!(found(0.0, 4.5), found(0.0, 3.5));
        assert_eq!(seams.near(Vec3::splat(f32::NAN)), None);

        let mut measured = seams.nothing();
        let color = vec![[0.5; 3], [2.0; 3], [0.9; 3]];
        let frame = Frame { width: 3, height: 1, color, ..Frame::default() };
        let photo = [[0.4; 3], [1.0; 3], [0.0; 3]];
        measured.add(&frame, &photo, &[Some(x), None, None], |pixel| pixel != 2);
        let near = |psnr: Option<f64>, expected: f64| psnr.is_some_and(|psnr| (psnr - expected).abs() < 1e-4);
        // An error of a hundredth in one pixel, none in the other, and a third that does not count.
        assert!(near(measured.band.psnr(), 20.0) && near(measured.seams[x].psnr(), 20.0));
        assert!(near(measured.whole().psnr(), 23.0103) && near(Some(measured.mean_psnr()), 23.0103));
        assert_eq!((measured.inside.pixels, measured.inside.psnr()), (1, Some(f64::INFINITY)));
        assert_eq!(Errors::default().psnr(), None);
        assert!(measured.worst_seams().is_empty(), "one pixel is not enough");
    }
}
