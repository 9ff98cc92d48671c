//! Lists the Gaussians that are blended at a pixel.

use super::{Frame, FrameRunner, Renderer, no_scene};
use crate::error::{Error, Result};
use crate::forward::{RenderSettings, SceneBuffers};
use crate::kernels::constants as c;
use crate::kernels::constants::TILE_SIZE;
use crate::plan::{first_around, tile_grid};
use crate::scene::Camera;
use crate::vk::Buffer;

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
        let scene = self.scene.as_ref().ok_or_else(no_scene)?;
        self.runner.inspect(scene, camera, settings, pixel)
    }
}

impl FrameRunner {
    /// See [`Renderer::inspect`].
    pub(crate) fn inspect(
        &mut self,
        scene: &SceneBuffers,
        camera: &Camera,
        settings: &RenderSettings,
        pixel: [u32; 2],
    ) -> Result<PixelReport> {
        let [x, y] = pixel;
        if x >= camera.width || y >= camera.height {
            let problem = format!("({x}, {y}) lies outside the image of {}x{}", camera.width, camera.height);
            return Err(Error::argument("pixel", problem));
        }
        self.render(scene, camera, settings)?;
        let f = self.frame()?;
        let (columns, _) = tile_grid(camera.width, camera.height);
        let tile = u64::from(y / c::TILE_SIZE * columns + x / c::TILE_SIZE);
        let range: Vec<u32> = self.read(&f.tile_ranges, tile * 8, 8)?;
        let sorted_visible = f.sorted_visible(&self.forward.sizes, self.capacity().backward, camera);
        let entries: Vec<u32> =
            self.read(sorted_visible, u64::from(range[0]) * 4, u64::from(range[1] - range[0]) * 4)?;
        let splats = f.splats();
        let [means, conics, shades] = [
            self.rows(splats.mean2d_extent)?,
            self.rows(splats.conic_opacity)?,
            self.rows(splats.color_inverse_depth)?,
        ];
        let stride = splats.stride as usize;
        let plane = |plane: u32| if stride == 1 { 0 } else { plane as usize };
        let gaussians: Vec<u32> = self.read(&f.visible_list, 0, f.visible_list.bytes())?;
        let mut report = PixelReport { transmittance: 1.0, ..PixelReport::default() };
        for visible in entries {
            let at = visible as usize;
            let mean = means[at * stride + plane(c::SPLAT_MEAN2D_EXTENT)];
            let conic = conics[at * stride + plane(c::SPLAT_CONIC_OPACITY)];
            let shade = shades[at * stride + plane(c::SPLAT_COLOR_INVERSE_DEPTH)];
            let (dx, dy) = (mean[0] - x as f32, mean[1] - y as f32);
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
                gaussian: self.without_gaps(scene, gaussians[at]),
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

    /// Converts a frame's Gaussian index to an index without the gaps between scenes.
    pub(super) fn without_gaps(&self, scene: &SceneBuffers, gaussian: u32) -> u32 {
        let (mut first, mut end, mut before) = (0, scene.count, 0);
        for next in self.surroundings() {
            if gaussian < end {
                break;
            }
            before += end - first;
            first = first_around(end);
            end = first + next.count;
        }
        before + gaussian - first
    }

    fn rows(&self, buffer: &Buffer) -> Result<Vec<[f32; 4]>> {
        self.read(buffer, 0, buffer.bytes() / 16 * 16)
    }

    pub(super) fn read<T: bytemuck::Pod>(&self, buffer: &Buffer, offset: u64, bytes: u64) -> Result<Vec<T>> {
        if bytes == 0 {
            return Ok(Vec::new());
        }
        Ok(bytemuck::pod_collect_to_vec(&self.context.download(&buffer.range(offset, bytes))?))
    }
}

// Reads back the Gaussians that each tile of a frame blends.

/// A visible Gaussian, as projected for blending.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ProjectedSplat {
    /// Index in the scene. Indices of several scenes continue from one to the next.
    pub gaussian: u32,
    /// 2D mean, pixels.
    pub mean2d_px: [f32; 2],
    /// (A, B, C) of exp(−(A dx² + C dy²) / 2 − B dx dy), 1/px².
    pub conic: [f32; 3],
    /// Opacity.
    pub opacity: f32,
    /// Depth (z in the camera's frame), world units.
    pub depth: f32,
}

/// Lists of Gaussians per tile of a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TileLists {
    /// Tiles per row.
    pub tiles_per_row: u32,
    /// Begin and end in `entries` of each tile, row by row.
    pub ranges: Vec<[u32; 2]>,
    /// Indices into `splats`, tile by tile, each front to back.
    pub entries: Vec<u32>,
    /// Visible Gaussians in the scene's order.
    pub splats: Vec<ProjectedSplat>,
}

impl Renderer {
    /// Renders a frame and reads back what each tile blends, for studies of a frame's work and its kernels' memory
    /// accesses. Takes about 40 bytes of host memory per visible Gaussian and 4 per instance.
    ///
    /// # Errors
    /// Same as [`Renderer::render`].
    pub fn tile_lists(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<TileLists> {
        let scene = self.scene.as_ref().ok_or_else(no_scene)?;
        self.runner.tile_lists(scene, camera, settings)
    }
}

impl FrameRunner {
    fn tile_lists(
        &mut self,
        scene: &SceneBuffers,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<TileLists> {
        let stats = self.render(scene, camera, settings)?.stats;
        let f = self.frame()?;
        let (tiles_per_row, rows) = tile_grid(camera.width, camera.height);
        let ranges = self.read(&f.tile_ranges, 0, u64::from(tiles_per_row * rows) * 8)?;
        let sorted = f.sorted_visible(&self.forward.sizes, self.capacity().backward, camera);
        let entries = self.read(sorted, 0, u64::from(stats.instances) * 4)?;
        let gaussians: Vec<u32> = self.read(&f.visible_list, 0, u64::from(stats.visible) * 4)?;
        let attributes = f.splats();
        let stride = attributes.stride as usize;
        let read = |buffer, plane: u32| -> Result<Vec<[f32; 4]>> {
            let plane = if stride == 1 { 0 } else { plane as usize };
            let all: Vec<[f32; 4]> = self.read(buffer, 0, u64::from(stats.visible) * stride as u64 * 16)?;
            Ok(all.into_iter().skip(plane).step_by(stride).collect())
        };
        let means = read(attributes.mean2d_extent, c::SPLAT_MEAN2D_EXTENT)?;
        let conics = read(attributes.conic_opacity, c::SPLAT_CONIC_OPACITY)?;
        let shades = read(attributes.color_inverse_depth, c::SPLAT_COLOR_INVERSE_DEPTH)?;
        let splat = |(at, &gaussian): (usize, &u32)| {
            let ([x, y, ..], [a, b, c, opacity]) = (means[at], conics[at]);
            ProjectedSplat {
                gaussian: self.without_gaps(scene, gaussian),
                mean2d_px: [x, y],
                conic: [a, b, c],
                opacity,
                depth: shades[at][3].recip(),
            }
        };
        Ok(TileLists {
            tiles_per_row,
            ranges,
            entries,
            splats: gaussians.iter().enumerate().map(splat).collect(),
        })
    }
}

// Reads back the number of Gaussians per tile of a frame.

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
    /// Renders a frame and reads back the number of Gaussians in its tiles.
    ///
    /// # Errors
    /// Same as [`Renderer::render`].
    pub fn tiles(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<TileReport> {
        Ok(self.render_with_tiles(camera, settings)?.1)
    }

    /// Same as [`Renderer::render`] and [`Renderer::tiles`], for the same frame.
    ///
    /// # Errors
    /// Same as [`Renderer::render`].
    pub fn render_with_tiles(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<(Frame, TileReport)> {
        let scene = self.scene.as_ref().ok_or_else(no_scene)?;
        self.runner.render_with_tiles(scene, camera, settings)
    }
}

impl FrameRunner {
    /// Renders a frame and reads back the report of its tiles.
    pub(crate) fn render_with_tiles(
        &mut self,
        scene: &SceneBuffers,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<(Frame, TileReport)> {
        let frame = self.render(scene, camera, settings)?;
        Ok((frame, self.tiles(camera)?))
    }

    /// Returns the report of the last frame's tiles. The frame must have been rendered with this camera.
    fn tiles(&self, camera: &Camera) -> Result<TileReport> {
        let frame = self.frame()?;
        let (columns, rows) = tile_grid(camera.width, camera.height);
        let tiles = u64::from(columns) * u64::from(rows);
        let pixels = u64::from(camera.width) * u64::from(camera.height);
        let ranges: Vec<[u32; 2]> = self.read(&frame.tile_ranges, 0, tiles * 8)?;
        let last: Vec<u32> = self.read(&frame.last_entries, 0, pixels * 4)?;
        let mut blended = vec![0; tiles as usize];
        for (pixel, &entry) in last.iter().enumerate() {
            let (x, y) = (pixel as u32 % camera.width, pixel as u32 / camera.width);
            let tile = &mut blended[(y / TILE_SIZE * columns + x / TILE_SIZE) as usize];
            *tile = entry.max(*tile);
        }
        let entries = ranges.iter().map(|[begin, end]| end - begin).collect();
        Ok(TileReport { columns, rows, entries, blended })
    }
}
