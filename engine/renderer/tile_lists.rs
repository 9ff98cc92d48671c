//! Reads back the Gaussians that each tile of a frame blends.

use super::{FrameRunner, Renderer, no_scene};
use crate::error::Result;
use crate::forward::{RenderSettings, SceneBuffers};
use crate::kernels::constants as c;
use crate::plan::tile_grid;
use crate::scene::Camera;

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
