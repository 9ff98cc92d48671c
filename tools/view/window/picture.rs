//! One frame of the window: splats or a finished picture, with text over it, all in the frame's command buffer.

use super::super::draw::ViewedScene;
use super::super::streamed::SceneRenderer;
use super::present::{BegunFrame, CANVAS, FRAMES_IN_FLIGHT, Present};
use super::text::{Overlay, Text};
use ashsplat::ash::vk;
use ashsplat::passes::compose::{Compose, Region};
use ashsplat::scene::Camera;
use ashsplat::vk::{Buffer, Context, Image, ImageState, ImageUse, MemoryKind, RecordSlot};
use ashsplat::{
    Background, ColorEncoding, DeviceScene, Error, HostImage, Placed, RecordedFrame, RenderSettings,
    Reservation, Result, ShStorage, SlotReport, Target,
};
use ashsplat_files::Photo;
use std::time::Instant;

/// Most dispatches of a recording by the window.
const DISPATCHES: usize = 8;
/// An image of the previous frame: its contents are not needed, but that frame's commands must have finished.
const USED: ImageState = ImageState {
    layout: vk::ImageLayout::UNDEFINED,
    stages: vk::PipelineStageFlags2::from_raw(
        vk::PipelineStageFlags2::ALL_TRANSFER.as_raw() | vk::PipelineStageFlags2::COMPUTE_SHADER.as_raw(),
    ),
    accesses: vk::AccessFlags2::NONE,
};
/// An image that the window's kernels or copies have left ready for kernels.
const READY: ImageState = ImageState {
    layout: vk::ImageLayout::GENERAL,
    stages: vk::PipelineStageFlags2::COMPUTE_SHADER,
    accesses: vk::AccessFlags2::from_raw(
        vk::AccessFlags2::SHADER_STORAGE_READ.as_raw() | vk::AccessFlags2::SHADER_STORAGE_WRITE.as_raw(),
    ),
};

pub enum Content<'a> {
    /// One colour.
    Nothing([f32; 3]),
    /// The scene, drawn on the device.
    Splats(&'a RenderSettings),
    Photo(&'a Photo),
}

struct SlotObjects {
    /// Recordings of a finished picture, and of the overlays.
    records: [RecordSlot; 2],
    photo: Option<Buffer>,
    overlays: Vec<Option<Buffer>>,
}

pub struct Picture {
    pub scene: SceneRenderer,
    context: Context,
    /// Scenes that the next frame draws.
    scenes: Vec<DeviceScene>,
    sh_degree: u32,
    reserved: Option<Reservation>,
    compose: Compose,
    /// Image of the window's size.
    canvas: Option<Image>,
    coarse: Option<Image>,
    slot_objects: Vec<SlotObjects>,
}

impl Picture {
    /// Draws the scene that is shown, if any.
    pub fn new(scene: SceneRenderer, sh_degree: u32) -> Result<Picture> {
        let context = scene.renderer.context().clone();
        let mut slot_objects = Vec::new();
        for _ in 0..FRAMES_IN_FLIGHT {
            let records = [RecordSlot::new(&context, DISPATCHES)?, RecordSlot::new(&context, DISPATCHES)?];
            slot_objects.push(SlotObjects { records, photo: None, overlays: Vec::new() });
        }
        Ok(Picture {
            compose: Compose::new(&context)?,
            scenes: scene.renderer.scene().into_iter().collect(),
            sh_degree,
            reserved: None,
            canvas: None,
            coarse: None,
            slot_objects,
            context,
            scene,
        })
    }

    /// True if there is a scene or a tree of tiles, in view or not.
    pub fn has_scene(&self) -> bool {
        self.scene.tree().is_some() || !self.scenes.is_empty()
    }

    /// True if splats may be in view. False if no tile of a tree is.
    pub fn is_in_view(&self) -> bool {
        !self.scenes.is_empty()
    }

    /// Takes the loaded tiles, and allocates what a frame of splats needs. The camera's size is the
    /// window's.
    pub fn prepare(&mut self, present: &Present, camera: &Camera, settings: &RenderSettings) -> Result<()> {
        loop {
            if self.scene.tree().is_some() {
                self.scenes = self.scene.scenes(camera)?;
            }
            match self.reserve(present, camera, settings) {
                Err(error) if self.scene.free_memory(&error) => {}
                done => return done,
            }
        }
    }

    fn reserve(&mut self, present: &Present, camera: &Camera, settings: &RenderSettings) -> Result<()> {
        let size = [camera.width, camera.height];
        let Some(scene) = self.scenes.first() else { return Ok(()) };
        let before = self.reserved.as_ref();
        if before.is_some_and(|old| [old.width, old.height] == size) {
            return Ok(());
        }
        // For a tree, reserves the whole budget: later tiles fit, and no frame waits for memory.
        let [gaussians, scenes] = match self.scene.capacity() {
            Some(capacity) => capacity.map(|max| u32::try_from(max).unwrap_or(u32::MAX)),
            None => [scene.count(), 1],
        };
        let requested = Reservation {
            slots: FRAMES_IN_FLIGHT,
            // A tree may have more tiles than a frame can draw.
            scenes: scenes.min(Reservation::MAX_SCENES),
            images_only: true,
            half_sh: self.scene.stored == ShStorage::Half,
            byte_sh: self.scene.stored == ShStorage::Bytes,
            blend_passes: before.map_or(1, |old| old.blend_passes),
            ..Reservation::new(gaussians, self.sh_degree, size[0], size[1])
        };
        present.idle()?;
        self.reserved = None;
        let placed = [Placed::from(scene)];
        let frame = RecordedFrame::new(&placed, camera, settings);
        self.reserved = Some(self.scene.renderer.reserve_for(&requested, &frame)?);
        Ok(())
    }

    /// Reads the report of a finished frame's splats. If they did not fit, the next frame gets more memory.
    pub fn report(&mut self, present: &Present, slot: u32) -> Result<Option<SlotReport>> {
        let Some(reserved) = self.reserved else { return Ok(None) };
        let report = self.scene.renderer.slot_report(slot)?;
        let grown = report.as_ref().filter(|report| report.overflow).map(|report| reserved.grown(report));
        if let Some(grown) = grown.filter(|grown| *grown != reserved) {
            // Frames in flight keep their memory.
            if let Err(error) = self.scene.renderer.grow(&grown) {
                if !matches!(error, Error::TooLarge { .. } | Error::Vulkan { .. }) {
                    return Err(error);
                }
                // Old and new memory do not fit at the same time.
                present.idle()?;
                self.reserved = None;
                if let Err(error) = self.scene.renderer.reserve(&grown) {
                    // The next frame draws fewer tiles.
                    return if self.scene.free_memory(&error) { Ok(report) } else { Err(error) };
                }
            }
            self.reserved = Some(grown);
        }
        Ok(report)
    }

    /// Draws and shows a frame. The camera's size is the picture's; the window may be larger. Returns the frame's slot and its
    /// start time, or none if the window is not ready.
    pub fn draw(
        &mut self,
        present: &mut Present,
        size: [u32; 2],
        camera: &Camera,
        content: &Content<'_>,
        overlays: &[Overlay<'_>],
    ) -> Result<Option<(u32, Instant)>> {
        let small = [camera.width, camera.height];
        let canvas = image(&self.context, "canvas", &mut self.canvas, size)?;
        let coarse = match small == size || matches!(content, Content::Nothing(_)) {
            true => None,
            false => Some(image(&self.context, "coarse canvas", &mut self.coarse, small)?),
        };
        let Some(begun) = present.begin()? else { return Ok(None) };
        let start = Instant::now();
        let target = coarse.as_ref().unwrap_or(&canvas);
        let drawn = self.record(present, &begun, target, camera, content)?;
        let drawn = match &coarse {
            Some(coarse) => present.images(&begun).scale([coarse, &canvas], [drawn, USED]),
            None => drawn,
        };
        let drawn = self.record_overlays(present, &begun, &canvas, drawn, overlays)?;
        let slot = begun.slot;
        present.finish(begun, &canvas, drawn)?;
        Ok(Some((slot, start)))
    }

    fn record(
        &mut self,
        present: &Present,
        begun: &BegunFrame,
        target: &Image,
        camera: &Camera,
        content: &Content<'_>,
    ) -> Result<ImageState> {
        match content {
            Content::Photo(photo) => self.record_photo(present, begun, target, photo),
            Content::Splats(settings) if self.is_in_view() => {
                let scenes: Vec<Placed<'_>> = self.scenes.iter().map(Placed::from).collect();
                let to = HostImage { image: target, from: USED, offset: [0; 2] };
                let frame = RecordedFrame {
                    target: Target::Image {
                        to,
                        behind: Background::Color(settings.background),
                        encoding: ColorEncoding::AsTrained,
                    },
                    ..RecordedFrame::new(&scenes, camera, settings)
                };
                let release = self.scene.renderer.record(present.commands(begun)?, begun.slot, &frame)?;
                Ok(release.color.unwrap_or(USED))
            }
            Content::Splats(RenderSettings { background, .. }) | Content::Nothing(background) => {
                Ok(present.images(begun).clear(target, USED, *background))
            }
        }
    }

    fn record_photo(
        &mut self,
        present: &Present,
        begun: &BegunFrame,
        target: &Image,
        photo: &Photo,
    ) -> Result<ImageState> {
        let objects = &mut self.slot_objects[begun.slot as usize];
        let texels: Vec<[u8; 4]> =
            photo.rgb.chunks_exact(3).map(|rgb| [rgb[0], rgb[1], rgb[2], u8::MAX]).collect();
        let buffer = filled(&self.context, &mut objects.photo, bytemuck::cast_slice(&texels))?;
        let record = &mut objects.records[0];
        let mut recorder = record.begin(present.commands(begun)?, "finished picture")?;
        recorder.copy_to_image(&buffer, target);
        record.end(recorder)?;
        Ok(READY)
    }

    fn record_overlays(
        &mut self,
        present: &Present,
        begun: &BegunFrame,
        canvas: &Image,
        from: ImageState,
        overlays: &[Overlay<'_>],
    ) -> Result<ImageState> {
        let SlotObjects { records, overlays: buffers, .. } = &mut self.slot_objects[begun.slot as usize];
        let fits = |overlay: &&Overlay<'_>| {
            let Text { width, height, .. } = *overlay.picture;
            let ends = [overlay.corner[0] + width, overlay.corner[1] + height];
            width > 0 && height > 0 && ends[0] <= canvas.size()[0] && ends[1] <= canvas.size()[1]
        };
        let shown: Vec<_> = overlays.iter().filter(fits).collect();
        if shown.is_empty() {
            return Ok(from);
        }
        let mut recorder = records[1].begin(present.commands(begun)?, "text")?;
        let mut state = from;
        buffers.resize(shown.len(), None);
        for (overlay, buffer) in shown.iter().zip(buffers) {
            let Text { width, height, texels } = overlay.picture;
            let buffer = filled(&self.context, buffer, bytemuck::cast_slice(texels))?;
            state = recorder.acquire_image(canvas, state);
            let region = Region { image: canvas, offset: overlay.corner, size: [*width, *height] };
            let (behind, encoding) = (Background::Image, ColorEncoding::AsTrained);
            self.compose.record_color(&mut recorder, &buffer, region, behind, encoding);
        }
        records[1].end(recorder)?;
        Ok(state)
    }
}

/// Returns the image if it has this size, or makes a new one. Frames in flight keep the old one alive.
fn image(context: &Context, name: &'static str, kept: &mut Option<Image>, size: [u32; 2]) -> Result<Image> {
    if let Some(image) = kept.as_ref().filter(|image| image.size() == size) {
        return Ok(image.clone());
    }
    let image = Image::new(context, name, CANVAS, size, ImageUse::Target)?;
    *kept = Some(image.clone());
    Ok(image)
}

/// Writes bytes to the buffer if it is large enough, or to a new one.
fn filled(context: &Context, kept: &mut Option<Buffer>, bytes: &[u8]) -> Result<Buffer> {
    let needed = bytes.len() as u64;
    let buffer = match kept.as_ref().filter(|buffer| buffer.bytes() >= needed) {
        Some(buffer) => buffer.clone(),
        None => {
            // Allocates a reserve: numbers in the text change their widths.
            let request = [("window", needed + needed / 4)];
            let mut made = context.allocate("window", &request, MemoryKind::HostVisible)?;
            let Some(buffer) = made.pop() else { unreachable!("one buffer per request") };
            buffer
        }
    };
    buffer.write(0, bytes)?;
    *kept = Some(buffer.clone());
    Ok(buffer)
}
