//! What share of each photo a cell covers, by the depths of a coarse model.
//!
//! A picture is drawn small, each of its pixels is put where its expected depth says, and the pixel counts for the cell there by
//! its opacity. That is one picture per photo however many cells there are; what each cell's Gaussians contribute would need
//! one per photo and cell.

use crate::blocks::places::{places, small};
use crate::progress::counting;
use crate::session;
use ashsplat::scene::{Camera, Cells};
use ashsplat::{Frame, RenderSettings, Renderer, Result};
use ashsplat_files::cameras_json::NamedCamera;
use std::sync::atomic::AtomicBool;

/// Shares of the photos' pictures, by photo, then by cell, 0 to 1.
pub struct Shares(Vec<Vec<f64>>);

impl Shares {
    pub fn of(
        renderer: &mut Renderer,
        cameras: &[NamedCamera],
        cells: &Cells,
        look: &RenderSettings,
        (quiet, stop): (bool, &AtomicBool),
    ) -> Result<Shares> {
        let bar = counting("views", cameras.len() as u64, quiet);
        let mut shares = Vec::with_capacity(cameras.len());
        for NamedCamera { camera, .. } in cameras {
            session::check(stop)?;
            let camera = small(camera);
            shares.push(covered(&camera, &renderer.render(&camera, look)?, cells));
            bar.inc(1);
        }
        bar.finish_and_clear();
        Ok(Shares(shares))
    }

    /// Whether a photo is used for a cell.
    pub fn is_of(&self, photo: usize, cell: usize, least: f64) -> bool {
        let own = self.0[photo][cell];
        own >= least || own > 0.0 && self.main_cell(photo) == Some(cell)
    }

    /// The cell that a photo shows most of: the first of several. None where it shows nothing.
    pub fn main_cell(&self, photo: usize) -> Option<usize> {
        let cells = self.0[photo].iter().enumerate().filter(|(_, share)| **share > 0.0);
        cells.rev().max_by(|a, b| a.1.total_cmp(b.1)).map(|(cell, _)| cell)
    }

    /// The largest share of a cell in some of the photos.
    pub fn most(&self, cell: usize, counts: impl Fn(usize) -> bool) -> f64 {
        let photos = self.0.iter().enumerate().filter(|(photo, _)| counts(*photo));
        photos.map(|(_, shares)| shares[cell]).fold(0.0, f64::max)
    }

    /// What cells cover of the pictures in the mean, all together.
    pub fn covered(&self) -> f64 {
        self.0.iter().flatten().sum::<f64>() / self.0.len() as f64
    }
}

fn covered(camera: &Camera, frame: &Frame, cells: &Cells) -> Vec<f64> {
    let mut sums = vec![0.0; cells.bounds().len()];
    for (place, transmittance) in places(camera, frame).into_iter().zip(&frame.transmittance) {
        if let Some(cell) = place.and_then(|place| cells.at(place)) {
            sums[cell] += f64::from(1.0 - transmittance);
        }
    }
    let pixels = frame.transmittance.len() as f64;
    sums.iter().map(|sum| sum / pixels).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ashsplat::scene::Intrinsics;
    use glam::{Vec3, vec3};

    /// A wall at depth 2, the left half of which is half transparent.
    #[test]
    fn pixels_count_where_they_are_and_as_far_as_they_are_opaque() {
        let eye = vec3(0.5, 0.0, -2.0);
        let intrinsics = Intrinsics::from_fov_x(1.0, 40, 20);
        let camera = Camera::look_at(eye, vec3(0.5, 0.0, 0.0), Vec3::NEG_Y, intrinsics);
        let transmittance: Vec<f32> = (0..800).map(|pixel| if pixel % 40 < 20 { 0.5 } else { 0.0 }).collect();
        let inverse_depth = Some(transmittance.iter().map(|t| (1.0 - t) / 2.0).collect());
        let color = vec![[0.0; 3]; 800];
        let frame = Frame { width: 40, height: 20, color, transmittance, inverse_depth, ..Frame::default() };
        for (pixel, place) in places(&camera, &frame).into_iter().enumerate() {
            let (x, y, z) = camera.project(place.expect("a place"));
            let expected = [pixel % 40, pixel / 40].map(|p| p as f32 + 0.5);
            assert!(
                (x - expected[0]).abs() < 1e-3 && (y - expected[1]).abs() < 1e-3 && (z - 2.0).abs() < 1e-5
            );
        }
        // Halved where the camera looks.
        let cells = Cells::divide(&[[0.0; 3], [0.5, 0.0, 0.0]], 1).expect("cells");
        let shares = Shares(vec![covered(&camera, &frame, &cells)]);
        assert_eq!(shares.0[0], [0.25, 0.5]);
        assert_eq!((shares.main_cell(0), shares.covered()), (Some(1), 0.75));
        assert!(shares.is_of(0, 0, 0.25) && !shares.is_of(0, 0, 0.26) && shares.is_of(0, 1, 0.9));
        assert_eq!(Shares(vec![vec![0.0, 0.0], vec![0.3, 0.3]]).main_cell(0), None);
        assert_eq!(Shares(vec![vec![0.3, 0.3]]).main_cell(0), Some(0));
        let tall = Camera { width: 100, height: 1000, ..camera };
        assert_eq!((small(&tall).width, small(&tall).height), (20, 200));
    }
}
