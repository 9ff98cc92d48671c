//! Reads back the number of Gaussians per tile of a frame.

use super::{Frame, FrameRunner, Renderer, no_scene};
use crate::error::Result;
use crate::forward::{RenderSettings, SceneBuffers};
use crate::kernels::constants::TILE_SIZE;
use crate::plan::tile_grid;
use crate::scene::Camera;

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
