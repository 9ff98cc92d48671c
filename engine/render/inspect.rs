//! Reads back what a frame blends: at a pixel, and per tile.

use super::frame::Frame;
use super::renderer::Renderer;
use crate::error::{Error, Result};
use crate::frame::tuning::ELEMENTWISE_WORKGROUP;
use crate::frame::{RenderSettings, SceneSettings, next_scene_begin, tile_grid};
use crate::kernels::constants as c;
use crate::scene::Camera;

/// One Gaussian blended at a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Index in the scene. Indices of several scenes continue from one to the next.
    pub gaussian: u32,
    /// Depth (z in the camera's frame), world units.
    pub depth: f32,
    /// Alpha at the pixel.
    pub alpha: f32,
    /// Transmittance before it.
    pub transmittance_before: f32,
    /// Blending weight: alpha times the transmittance before it.
    pub weight: f32,
    /// Transmittance after it.
    pub transmittance_after: f32,
    /// Its colour towards the camera.
    pub color: [f32; 3],
}

/// The Gaussians blended at a pixel, front to back, and their sum.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PixelReport {
    /// Blended Gaussians, front to back.
    pub samples: Vec<Sample>,
    /// Colour of the pixel on the background.
    pub color: [f32; 3],
    /// Transmittance after the last Gaussian.
    pub transmittance: f32,
}

impl Renderer {
    /// Renders a frame and lists what is blended at one pixel (column, row). Reads the tile's sorted list and the projected
    /// attributes back from the frame. The host blends the pixel from them again; its result equals the device's up to
    /// rounding.
    ///
    /// # Errors
    /// [`Error::Argument`] when the pixel is outside the image; errors of [`Renderer::render`].
    pub fn inspect(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
        pixel: [u32; 2],
    ) -> Result<PixelReport> {
        let [x, y] = pixel;
        if x >= camera.width || y >= camera.height {
            let problem = format!("({x}, {y}) lies outside the image of {}x{}", camera.width, camera.height);
            return Err(Error::argument("pixel", problem));
        }
        let visible = self.draw(camera, settings)?.visible;
        let (columns, _) = tile_grid(camera.width, camera.height);
        let tile = u64::from(y / c::TILE_SIZE * columns + x / c::TILE_SIZE);
        let range: Vec<u32> = self.read(&self.runner.store.current()?.tile_ranges, tile * 8, 8)?;
        let entries = self.entries(range[0], range[1])?;
        let gaussians = self.visible_gaussians(visible)?;
        let [means, conics, shades] = self.attributes(visible)?;
        let mut report = PixelReport { transmittance: 1.0, ..PixelReport::default() };
        for entry in entries {
            let at = entry as usize;
            let (mean, conic, shade) = (means[at], conics[at], shades[at]);
            let (mut dx, dy) = (mean[0] - x as f32, mean[1] - y as f32);
            if camera.projection.has_seam() {
                let around = camera.whole().width as f32;
                dx -= around * (dx / around).round();
            }
            let power = -0.5 * (conic[0] * dx * dx + conic[2] * dy * dy) - conic[1] * dx * dy;
            let alpha = (conic[3] * power.exp()).min(c::ALPHA_MAX);
            if power > 0.0 || alpha < c::ALPHA_MIN {
                continue;
            }
            let before = report.transmittance;
            let after = before * (1.0 - alpha);
            if after < c::TRANSMITTANCE_MIN {
                break;
            }
            let color = [shade[0], shade[1], shade[2]];
            let weight = alpha * before;
            for (sum, channel) in report.color.iter_mut().zip(color) {
                *sum += weight * channel;
            }
            report.transmittance = after;
            report.samples.push(Sample {
                gaussian: gaussians[at],
                depth: shade[3].recip(),
                alpha,
                transmittance_before: before,
                weight,
                transmittance_after: after,
                color,
            });
        }
        for (sum, background) in report.color.iter_mut().zip(settings.background) {
            *sum += report.transmittance * background;
        }
        Ok(report)
    }

    /// Returns the visible Gaussians from `begin` to `end` in the sorted list of the last frame's instances.
    fn entries(&self, begin: u32, end: u32) -> Result<Vec<u32>> {
        let store = &self.runner.store;
        let sorted = store.current()?.sorted_visible(store.capacity().backward);
        self.read(sorted, u64::from(begin) * 4, u64::from(end - begin) * 4)
    }

    /// Returns the index in its scene of each visible Gaussian of the last frame, without the gaps between scenes.
    fn visible_gaussians(&self, visible: u32) -> Result<Vec<u32>> {
        let list = &self.runner.store.current()?.visible_list;
        let of_frame: Vec<u32> = self.read(list, 0, u64::from(visible) * 4)?;
        Ok(of_frame.into_iter().map(|gaussian| self.without_gaps(gaussian)).collect())
    }

    /// Converts a frame's Gaussian index to an index without the gaps between scenes.
    fn without_gaps(&self, gaussian: u32) -> u32 {
        let (mut gaps, mut end) = (0, 0);
        for scene in &self.scenes {
            let first = next_scene_begin(end, ELEMENTWISE_WORKGROUP);
            if gaussian < first {
                break;
            }
            gaps += first - end;
            end = first + scene.count;
        }
        gaussian - gaps
    }

    /// Returns per visible Gaussian of the last frame: mean and extent, conic and opacity, colour and 1/z.
    fn attributes(&self, visible: u32) -> Result<[Vec<[f32; 4]>; 3]> {
        let splats = self.runner.store.current()?.splats();
        let stride = splats.stride as usize;
        let read = |buffer, plane: u32| -> Result<Vec<[f32; 4]>> {
            let plane = if stride == 1 { 0 } else { plane as usize };
            let all: Vec<[f32; 4]> = self.read(buffer, 0, u64::from(visible) * stride as u64 * 16)?;
            Ok(all.into_iter().skip(plane).step_by(stride).collect())
        };
        Ok([
            read(splats.mean2d_extent, c::SPLAT_MEAN2D_EXTENT)?,
            read(splats.conic_opacity, c::SPLAT_CONIC_OPACITY)?,
            read(splats.color_inverse_depth, c::SPLAT_COLOR_INVERSE_DEPTH)?,
        ])
    }
}

/// Work of each tile of a frame, row-major.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TileReport {
    /// Tiles per row.
    pub columns: u32,
    /// Rows of tiles.
    pub rows: u32,
    /// (tile, Gaussian) instances of each tile.
    pub entries: Vec<u32>,
    /// Per tile: the last list entry that any of its pixels blended.
    pub blended: Vec<u32>,
}

impl Renderer {
    /// Renders a frame, and also reads back the number of Gaussians in its tiles.
    ///
    /// # Errors
    /// Same as [`Renderer::render`].
    pub fn render_with_tiles(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<(Frame, TileReport)> {
        let picture = self.render_frame(camera, settings, &SceneSettings::USUAL, true)?;
        let frame = self.runner.store.current()?;
        let (columns, rows) = tile_grid(camera.width, camera.height);
        let tiles = u64::from(columns) * u64::from(rows);
        let pixels = u64::from(camera.width) * u64::from(camera.height);
        let ranges: Vec<[u32; 2]> = self.read(&frame.tile_ranges, 0, tiles * 8)?;
        let last: Vec<u32> = self.read(&frame.last_entries, 0, pixels * 4)?;
        let mut blended = vec![0; tiles as usize];
        for (pixel, &entry) in last.iter().enumerate() {
            let (x, y) = (pixel as u32 % camera.width, pixel as u32 / camera.width);
            let tile = &mut blended[(y / c::TILE_SIZE * columns + x / c::TILE_SIZE) as usize];
            *tile = entry.max(*tile);
        }
        let entries = ranges.iter().map(|[begin, end]| end - begin).collect();
        Ok((picture, TileReport { columns, rows, entries, blended }))
    }
}
