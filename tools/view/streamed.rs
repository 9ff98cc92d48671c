//! The scene that a page or a window draws: loaded whole, or a tree of tiles within a budget of Gaussians.

mod loader;
mod residency;

use super::draw::{NOT_EDITED, ViewedScene, Viewer, ViewerSettings};
use super::edits::{Edits, GaussianSet};
use super::loaded_scene::{ScenePart, Streamed};
use super::protocol::Edit;
use ashsplat::scene::Gaussians;
use ashsplat::vk::{Buffer, MemoryKind};
use ashsplat::{
    Camera, DeviceScene, Error, Frame, PixelReport, RenderSettings, Renderer, Result, Selection, ShStorage,
    TileReport,
};
use ashsplat_files::tiles::{Demand, Tree};
use ashsplat_program::look;
use loader::Loader;
use residency::{Residency, is_memory};
use serde_json::{Value, json};
use std::sync::Arc;

/// Draws a scene that is loaded whole, or a tree whose visible tiles are loaded.
pub struct SceneRenderer {
    pub renderer: Renderer,
    streaming: Option<Streaming>,
    /// Created by the first edit.
    edits: Option<Edits>,
    /// Mask of the selection, a bit per drawn Gaussian.
    mask: Option<Buffer>,
    shows_selection: bool,
    /// Storage of SH; none for the smallest that is exact.
    sh_storage: Option<ShStorage>,
    /// Storage of the scene that is shown, or of the tree's coarsest tile: its other tiles have the same, or floats.
    pub stored: ShStorage,
}

/// Colour of the selection, and its share of a Gaussian's colour.
const SELECTION: ([f32; 3], f32) = ([1.0, 0.45, 0.0], 0.65);

/// Called on any thread: with a message for people, or with none when a tile was loaded or has failed, so that the picture is drawn again.
pub type OnTile = Arc<dyn Fn(Option<String>) + Send + Sync>;

struct Streaming {
    tree: Arc<Tree>,
    residency: Residency<DeviceScene>,
    loader: Loader,
    on_tile: OnTile,
    /// The program's budget, Gaussians.
    budget: usize,
    /// The current viewer and its budget.
    current: (Viewer, usize),
    /// Most Gaussians that the device has had memory for; caps every viewer's budget.
    limit: usize,
    /// Figures of the last picture.
    shown: Value,
}

fn upload(renderer: &mut Renderer, gaussians: &Gaussians, requested: Option<ShStorage>) -> Result<()> {
    renderer.upload_stored(gaussians, look::stored(requested, gaussians))
}

impl SceneRenderer {
    /// Shows the renderer's scene.
    pub fn new(renderer: Renderer, sh_storage: Option<ShStorage>) -> SceneRenderer {
        SceneRenderer {
            renderer,
            streaming: None,
            edits: None,
            mask: None,
            shows_selection: false,
            sh_storage,
            stored: ShStorage::F32,
        }
    }

    /// Shows a scene, or the tree whose coarsest tile it is.
    pub fn show(&mut self, gaussians: &Gaussians, tree: Option<&Streamed>, on_tile: OnTile) -> Result<()> {
        (self.streaming, self.edits, self.mask) = (None, None, None);
        if !gaussians.is_empty() {
            upload(&mut self.renderer, gaussians, self.sh_storage)?;
        }
        let scene = self.renderer.scene();
        self.stored = scene.as_ref().map_or(ShStorage::F32, |scene| scene.plan().sh_storage);
        let (Some(streamed), Some(coarsest)) = (tree, scene) else { return Ok(()) };
        let context = self.renderer.context().clone();
        let on_loaded = on_tile.clone();
        // Kernels of recorded frames are built for the storage of the coarsest tile, and for floats.
        let (coarse, requested) = (self.stored, self.sh_storage);
        let stored = move |tile: &Gaussians| match coarse {
            ShStorage::F32 => ShStorage::F32,
            coarse if look::stored(requested, tile) == coarse => coarse,
            _ => ShStorage::F32,
        };
        self.streaming = Some(Streaming {
            tree: streamed.tree.clone(),
            residency: Residency::new(streamed.tree.clone(), coarsest),
            loader: Loader::start(context, streamed.clone(), gaussians.sh_degree, stored, move || {
                on_loaded(None)
            })?,
            on_tile,
            budget: streamed.budget,
            current: (Viewer::default(), streamed.budget),
            limit: usize::MAX,
            shown: Value::Null,
        });
        Ok(())
    }

    /// Counts the Gaussians of each scene that are drawn, before `added` joins them. A scene that has lost some is no longer that of
    /// its file.
    ///
    /// # Errors
    /// [`Error::Argument`] if Gaussians are hidden: they would be lost.
    pub fn keep_drawn(&self, added: &str, parts: &mut [ScenePart]) -> Result<()> {
        let Some(edits) = &self.edits else { return Ok(()) };
        if edits.hidden() > 0 {
            let problem =
                "is not added while Gaussians of the open scene are hidden: show or delete them first";
            return Err(Error::argument(added, problem));
        }
        let mut first = 0;
        for part in parts {
            let end = first + part.count;
            let count = edits.drawn().filter(|index| (first..end).contains(index)).count();
            part.file.take_if(|_| count < part.count);
            part.count = count;
            first = end;
        }
        Ok(())
    }

    /// Draws the loaded parts. If the device has no memory for the picture, tiles are removed: first those that nobody wants,
    /// then the finest wanted ones.
    fn draw<T>(&mut self, camera: &Camera, draw: impl Fn(&mut Renderer) -> Result<T>) -> Result<T> {
        loop {
            self.prepare(camera)?;
            let drawn = draw(&mut self.renderer);
            let more = drawn.as_ref().err().is_some_and(|error| self.free_memory(error));
            if !more {
                return drawn;
            }
        }
    }

    /// Same as [`SceneRenderer::scenes`], but returns true if nothing is missing.
    fn prepare(&mut self, camera: &Camera) -> Result<bool> {
        if self.streaming.is_some() {
            self.scenes(camera)?;
        }
        Ok(self.streaming.as_ref().is_none_or(|streaming| streaming.shown["missing"] == 0))
    }

    /// Takes loaded tiles, requests missing ones, and makes the renderer draw those that are there. Returns these scenes.
    pub fn scenes(&mut self, camera: &Camera) -> Result<Vec<DeviceScene>> {
        let Some(streaming) = &mut self.streaming else {
            return Ok(self.renderer.scene().into_iter().collect());
        };
        camera.check()?;
        let scenes = streaming.scenes(camera);
        self.renderer.set_scenes(&scenes)?;
        Ok(scenes)
    }

    /// Frees memory after a failed allocation for a picture. True if anything was freed.
    pub fn free_memory(&mut self, error: &Error) -> bool {
        is_memory(error) && self.streaming.as_mut().is_some_and(|streaming| streaming.free_memory(error))
    }

    /// Most Gaussians and tiles of a picture of the tree; none for a scene that is loaded whole.
    #[cfg(feature = "window")]
    pub fn capacity(&self) -> Option<[usize; 2]> {
        let streaming = self.streaming.as_ref()?;
        let tiles = streaming.tree.tiles();
        let gaussians =
            streaming.budget.min(streaming.limit).min(streaming.tree.gaussians()).max(tiles[0].gaussians);
        // No tile of a picture is an ancestor of another, so count the smallest tiles that fit.
        let mut smallest: Vec<usize> = tiles.iter().map(|tile| tile.gaussians).collect();
        smallest.sort_unstable();
        let mut rest = gaussians;
        let fits = |gaussians: &usize| {
            let left = rest.checked_sub(*gaussians);
            rest = left.unwrap_or(rest);
            left.is_some()
        };
        Some([gaussians, smallest.into_iter().take_while(fits).count().max(1)])
    }
}

impl Streaming {
    /// Prints a message, and shows it to the viewers.
    fn say(&self, problem: String) {
        errln!("{problem}");
        (self.on_tile)(Some(problem));
    }

    /// Frees memory for a picture whose allocation failed. True if anything was freed.
    fn free_memory(&mut self, error: &Error) -> bool {
        if self.residency.evict_unwanted() {
            return true;
        }
        let coarsest = self.tree.tiles()[0].gaussians;
        let budget = self.current.1.min(self.limit).min(self.tree.gaussians());
        if budget <= coarsest {
            return false;
        }
        self.limit = (budget / 2).max(coarsest);
        let limit = self.limit;
        self.say(format!("no memory for {budget} Gaussians, at most {limit} are drawn from now on: {error}"));
        true
    }

    fn scenes(&mut self, camera: &Camera) -> Vec<DeviceScene> {
        for (tile, scene) in self.loader.arrivals() {
            match scene {
                Ok(scene) => self.residency.add(tile, scene),
                Err(error) => {
                    if let Some(problem) = self.residency.fail(tile, &error) {
                        self.say(problem);
                    }
                }
            }
        }
        let (viewer, requested) = self.current;
        let budget = requested.min(self.limit);
        let cut = self.residency.cut(viewer, &Demand::of(camera, budget));
        self.loader.request(cut.missing.iter().copied());
        let (resident, resident_gaussians) = self.residency.resident();
        self.shown = json!({
            "of": self.tree.gaussians(), "budget": budget, "drawn": cut.drawn.len(), "wanted": cut.wanted,
            "missing": cut.missing.len(), "resident": resident, "resident_gaussians": resident_gaussians,
            "problems": self.residency.problems().count(), "problem": self.residency.problems().next(),
        });
        cut.drawn.iter().filter_map(|&tile| self.residency.get(tile).cloned()).collect()
    }
}

impl ViewedScene for SceneRenderer {
    fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Frame> {
        let (color, share) = SELECTION;
        let mask = self.mask.clone().filter(|_| self.shows_selection);
        self.draw(camera, |renderer| match &mask {
            Some(mask) => renderer.render_selected(camera, settings, Selection { mask, color, share }),
            None => renderer.render(camera, settings),
        })
    }

    fn render_with_tiles(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<(Frame, TileReport)> {
        self.draw(camera, |renderer| renderer.render_with_tiles(camera, settings))
    }

    fn inspect(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
        pixel: [u32; 2],
    ) -> Result<PixelReport> {
        let mut report = self.draw(camera, |renderer| renderer.inspect(camera, settings, pixel))?;
        // The device has only the Gaussians that are drawn.
        if let Some(edits) = &self.edits {
            let drawn: Vec<usize> = edits.drawn().collect();
            for sample in &mut report.samples {
                sample.gaussian = drawn[sample.gaussian as usize] as u32;
            }
        }
        Ok(report)
    }

    fn gaussians(&self, part: GaussianSet) -> Result<Gaussians> {
        if self.streaming.is_some() {
            let problem = "is not saved from here: it is not whole; `ashsplat convert` reads the scene that it was made of";
            return Err(Error::argument("a tree of tiles", problem));
        }
        match (&self.edits, part) {
            (Some(edits), _) => edits.part(part),
            (None, GaussianSet::Visible) => self.renderer.gaussians(),
            (None, GaussianSet::Selection) => Err(Error::argument("part", "nothing is selected")),
        }
    }

    fn edit(&mut self, edit: &Edit) -> Result<()> {
        if self.streaming.is_some() {
            return Err(Error::argument("edit", NOT_EDITED));
        }
        let mut edits = match self.edits.take() {
            Some(edits) => edits,
            None => Edits::of(self.renderer.gaussians()?),
        };
        let applied = edits.apply(edit);
        let edits = self.edits.insert(edits);
        let mut show = |seen: Gaussians| upload(&mut self.renderer, &seen, self.sh_storage);
        if applied? && let Err(error) = show(edits.part(GaussianSet::Visible)?) {
            edits.take_back(edit)?;
            show(edits.part(GaussianSet::Visible)?)?;
            return Err(error);
        }
        self.mask = None;
        if let Some(mask) = edits.mask() {
            let (context, bytes) = (self.renderer.context(), bytemuck::cast_slice(&mask));
            let buffers =
                context.allocate("selection", &[("mask", bytes.len() as u64)], MemoryKind::Device)?;
            context.upload(&buffers[0], bytes)?;
            self.mask = buffers.into_iter().next();
        }
        Ok(())
    }

    fn edits(&self) -> Option<&Value> {
        self.edits.as_ref().map(|edits| &edits.figures)
    }

    fn shrink(&mut self) {
        self.renderer.shrink();
    }

    fn set_viewer(&mut self, settings: &ViewerSettings<'_>) {
        self.shows_selection = settings.selection;
        let Some(streaming) = &mut self.streaming else { return };
        let requested = settings.budget.map(|budget| usize::try_from(budget).unwrap_or(usize::MAX));
        streaming.current = (settings.viewer, requested.unwrap_or(streaming.budget));
        streaming.residency.keep_viewers(settings.is_connected);
    }

    fn is_ready(&mut self, camera: &Camera) -> Result<bool> {
        self.prepare(camera)
    }

    fn tree(&self) -> Option<&Value> {
        self.streaming.as_ref().map(|streaming| &streaming.shown)
    }
}
