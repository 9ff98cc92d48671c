//! Share of each photo that a cell covers, by the depths of a coarse model.
//!
//! A picture is drawn small. Each pixel is located by its harmonic depth, and its opacity counts for the cell there.
//! That takes one picture per photo for any number of cells. Measuring the contribution of each cell's Gaussians would
//! take one per photo and cell.

use ashsplat::scene::{Bounds, Camera, Cells};
use ashsplat::train::SceneBlock;
use ashsplat::{Frame, RenderSettings, Renderer, Result};
use ashsplat_files::cameras_json::NamedCamera;
use ashsplat_program::blocks::parts::{BlockPixels, Part, places, small};
use ashsplat_program::progress::counting;
use ashsplat_program::session;
use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;

/// Shares and parts of the photos that show cells.
pub struct Shares {
    /// Share of each picture, by photo, then by cell, 0 to 1.
    shares: Vec<Vec<f64>>,
    /// Parts that show a cell and its margin, by photo, then by the cells that it is used for.
    parts: Vec<BTreeMap<usize, Part>>,
    /// Least share of a picture that a cell must cover to use the photo.
    min_share: f64,
}

impl Shares {
    pub fn of(
        renderer: &mut Renderer,
        cameras: &[NamedCamera],
        cells: (&Cells, f32, f64),
        look: &RenderSettings,
        (quiet, stop): (bool, &AtomicBool),
    ) -> Result<Shares> {
        let (cells, margin, min_share) = cells;
        let bar = counting("views", cameras.len() as u64, quiet);
        let mut found = Shares { shares: Vec::new(), parts: Vec::new(), min_share };
        for NamedCamera { camera, .. } in cameras {
            session::check(stop)?;
            let camera = small(camera);
            found.add(&camera, &renderer.render(&camera, look)?, (cells, margin));
            bar.inc(1);
        }
        bar.finish_and_clear();
        Ok(found)
    }

    /// Adds the next photo, with its small camera and frame.
    fn add(&mut self, camera: &Camera, frame: &Frame, (cells, margin): (&Cells, f32)) {
        let photo = self.shares.len();
        self.shares.push(covered(camera, frame, cells));
        let own = cells.bounds().iter().enumerate().filter(|(cell, _)| self.is_of(photo, *cell));
        // A block that is the whole scene is trained on transparent pixels too, like the scene.
        let own = own.filter(|(_, core)| !SceneBlock::is_everything(**core));
        let part = |(cell, &core): (usize, &Bounds)| {
            let part = BlockPixels::of(camera, frame, (core, margin)).part();
            part.filter(|part| !part.is_whole()).map(|part| (cell, part))
        };
        let parts = own.filter_map(part).collect();
        self.parts.push(parts);
    }

    pub fn is_of(&self, photo: usize, cell: usize) -> bool {
        let own = self.shares[photo][cell];
        own >= self.min_share || own > 0.0 && self.main_cell(photo) == Some(cell)
    }

    /// The part of a photo that shows a cell and its margin. `None` uses the whole photo: the part is the whole, or
    /// nothing opaque shows the cell.
    pub fn part(&self, photo: usize, cell: usize) -> Option<Part> {
        self.parts[photo].get(&cell).copied()
    }

    /// The cell with the largest share of a photo, the first of equal ones. `None` if it shows no cell.
    pub fn main_cell(&self, photo: usize) -> Option<usize> {
        let cells = self.shares[photo].iter().enumerate().filter(|(_, share)| **share > 0.0);
        cells.rev().max_by(|a, b| a.1.total_cmp(b.1)).map(|(cell, _)| cell)
    }

    /// Largest share of a cell in the photos for which `counts` is true.
    pub fn max_share(&self, cell: usize, counts: impl Fn(usize) -> bool) -> f64 {
        let photos = self.shares.iter().enumerate().filter(|(photo, _)| counts(*photo));
        photos.map(|(_, shares)| shares[cell]).fold(0.0, f64::max)
    }

    /// Mean share of the cells, besides its main one, that a photo is used for: 0 to 1.
    pub fn spread(&self) -> f64 {
        let (photos, cells) = (self.shares.len(), self.shares.first().map_or(0, Vec::len));
        let others =
            |photo: usize| (0..cells).filter(|&cell| self.is_of(photo, cell)).count().saturating_sub(1);
        let pairs = photos * cells.saturating_sub(1);
        (0..photos).map(others).sum::<usize>() as f64 / pairs.max(1) as f64
    }

    pub fn use_whole(&mut self) {
        self.parts.iter_mut().for_each(BTreeMap::clear);
    }

    /// Mean share of the pictures that all cells cover together.
    pub fn covered(&self) -> f64 {
        self.shares.iter().flatten().sum::<f64>() / self.shares.len() as f64
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
        // Two cells, divided where the camera looks.
        let cells = Cells::divide(&[[0.0; 3], [0.5, 0.0, 0.0]], 1).expect("cells");
        let found = |min_share: f64| {
            let mut found = Shares { shares: Vec::new(), parts: Vec::new(), min_share };
            found.add(&camera, &frame, (&cells, 0.1));
            found
        };
        let shares = found(0.25);
        assert_eq!(shares.shares[0], [0.25, 0.5]);
        assert_eq!((shares.main_cell(0), shares.covered()), (Some(1), 0.75));
        assert!(shares.is_of(0, 0) && !found(0.26).is_of(0, 0) && found(0.9).is_of(0, 1));
        // A column is 2 tan(0.5) 2 / 40 = 0.055 wide: two columns of the margin, and one more.
        let part = |columns: [u32; 2]| Some(Part { of: [40, 20], columns, rows: [0, 20] });
        assert_eq!([0, 1].map(|cell| shares.part(0, cell)), [part([0, 23]), part([17, 40])]);
        assert_eq!([0.25, 0.26].map(|min_share| found(min_share).spread()), [1.0, 0.0]);
        let mut whole = found(0.25);
        whole.use_whole();
        assert_eq!([0, 1].map(|cell| whole.part(0, cell)), [None, None]);
        // Half of the photos show both cells.
        let shares = vec![vec![0.2, 0.2], vec![0.0, 0.4], vec![0.05, 0.1], vec![0.1, 0.3]];
        assert_eq!(Shares { shares, parts: Vec::new(), min_share: 0.1 }.spread(), 0.5);
        let others = |own: Vec<f64>| Shares { shares: vec![own], parts: Vec::new(), min_share: 0.1 };
        assert_eq!(others(vec![0.0, 0.0]).main_cell(0), None);
        assert_eq!(others(vec![0.3, 0.3]).main_cell(0), Some(0));
        let tall = Camera { width: 100, height: 1000, ..camera };
        assert_eq!((small(&tall).width, small(&tall).height), (20, 200));
    }
}
