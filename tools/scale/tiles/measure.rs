//! Measures how much a tree's pictures resemble those of the whole scene, for budgets of Gaussians.

use ashsplat::scene::{Camera, Gaussians};
use ashsplat::{Frame, RenderSettings, Renderer, Result};
use ashsplat_files::metrics;
use ashsplat_files::splats::ReadOptions;
use ashsplat_files::tiles::Tree;
use ashsplat_program::look::Drawn;
use ashsplat_program::progress::thousands;
use std::time::Instant;

/// Budgets as shares of the scene's Gaussians, percent.
const BUDGETS: [usize; 5] = [5, 10, 25, 50, 100];

/// A tree of a scene, and cameras for the measurement.
pub struct Measurement<'a> {
    pub tree: &'a Tree,
    pub whole: &'a Gaussians,
    pub cameras: &'a [Camera],
    pub settings: RenderSettings,
    pub read: ReadOptions,
}

/// Results of one budget over the cameras.
#[derive(Default)]
struct Row {
    psnr: Vec<f64>,
    gaussians: usize,
    tiles: usize,
    seconds: f64,
}

impl Measurement<'_> {
    /// One line per budget. The whole scene and the budgets are drawn in turn, camera by camera.
    pub fn table(&self, renderer: &mut Renderer, stop: &dyn Fn() -> Result<()>) -> Result<String> {
        let mut rows: Vec<Row> = BUDGETS.iter().map(|_| Row::default()).collect();
        let mut seconds = 0.0;
        for camera in self.cameras {
            let (expected, whole_seconds) = self.drawn(renderer, self.whole, camera)?;
            seconds += whole_seconds;
            for (percent, row) in BUDGETS.into_iter().zip(&mut rows) {
                stop()?;
                let mut drawn = Drawn::new(self.tree.clone(), self.whole.len() * percent / 100, self.read);
                let gaussians = drawn.wanted(camera)?.unwrap_or_default();
                let (frame, budget_seconds) = self.drawn(renderer, &gaussians, camera)?;
                row.psnr.push(metrics::psnr(&frame.color, &expected.color, None)?);
                row.gaussians += gaussians.len();
                row.tiles += drawn.tiles();
                row.seconds += budget_seconds;
            }
        }
        let mut table = format!(
            "{} views; PSNR against the whole scene; time of a frame against its {:.1} ms, in turn\n\
             budget   Gaussians   tiles   mean dB   worst dB   time\n",
            self.cameras.len(),
            1e3 * seconds / self.cameras.len() as f64
        );
        for (percent, row) in BUDGETS.into_iter().zip(rows) {
            let mean = row.psnr.iter().sum::<f64>() / row.psnr.len() as f64;
            let worst = row.psnr.iter().copied().fold(f64::INFINITY, f64::min);
            let views = self.cameras.len();
            let (gaussians, tiles) = (thousands((row.gaussians / views) as u64), row.tiles / views);
            let ratio = row.seconds / seconds;
            table += &format!("{percent:5}% {gaussians:>11} {tiles:7} {mean:9.2} {worst:10.2} {ratio:6.2}\n");
        }
        Ok(table)
    }

    /// A picture, and the seconds of drawing it a second time.
    fn drawn(&self, renderer: &mut Renderer, gaussians: &Gaussians, camera: &Camera) -> Result<(Frame, f64)> {
        renderer.upload(gaussians)?;
        renderer.render(camera, &self.settings)?;
        let start = Instant::now();
        let frame = renderer.render(camera, &self.settings)?;
        Ok((frame, start.elapsed().as_secs_f64()))
    }
}
