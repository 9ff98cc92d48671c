//! A renderer that owns its submissions.

use super::device_scene::{DeviceScene, ELSEWHERE};
use super::frame::{Frame, FrameStats, Surface};
use super::frame_store::FrameCounts;
use super::recording_lists::RecordingLists;
use super::runner::{FrameRun, FrameRunner, Request, RunError};
use super::slots::Slots;
use super::updates::StagedUpdates;
use crate::error::{Error, Result};
use crate::frame::{
    Blending, FrameBuffers, RenderSettings, SceneBuffers, SceneSettings, Selection, ShStorage, planes,
};
use crate::passes::backward::Backward;
use crate::passes::compose::Compose;
use crate::passes::filter_3d::Filter3d;
use crate::scene::{Camera, Gaussians};
use crate::vk::{Buffer, Context};
use glam::Vec3;

/// Renders a scene of Gaussians.
///
/// # Examples
/// ```no_run
/// use ashsplat::vk::{Context, ContextOptions};
/// use ashsplat::{Camera, Frame, Gaussians, RenderSettings, Renderer};
///
/// fn picture(gaussians: &Gaussians, camera: &Camera) -> ashsplat::Result<Frame> {
///     let context = Context::new(&ContextOptions::default())?;
///     let mut renderer = Renderer::new(&context)?;
///     renderer.upload(gaussians)?;
///     renderer.render(camera, &RenderSettings::default())
/// }
/// ```
///
/// The [guide](crate::guide::first_frame) has more examples; [`Renderer::record`] is for a host's command buffer.
pub struct Renderer {
    pub(super) context: Context,
    pub(super) runner: FrameRunner,
    pub(super) backward: Backward,
    /// Drawn together, in the same axes. Empty before the first upload.
    pub(super) scenes: Vec<SceneBuffers>,
    /// Built by the first reservation.
    pub(super) compose: Option<Compose>,
    pub(super) slots: Slots,
    /// Reused lists of a recording.
    pub(super) lists: RecordingLists<'static>,
    /// Reused lists of a recording's updates.
    pub(super) staged: StagedUpdates,
}

impl Renderer {
    /// Builds the kernels. No scene is loaded yet.
    ///
    /// # Errors
    /// When the device refuses a pipeline; [`Error::MissingFeature`] if subgroups fail the check of
    /// [`subgroups::check`](crate::frame::subgroups::check).
    pub fn new(context: &Context) -> Result<Self> {
        if context.owns_device() {
            crate::frame::subgroups::check(context)?;
        }
        Ok(Self {
            context: context.clone(),
            runner: FrameRunner::new(context)?,
            backward: Backward::new(context),
            scenes: Vec::new(),
            compose: None,
            slots: Slots::default(),
            lists: RecordingLists::default(),
            staged: StagedUpdates::default(),
        })
    }

    /// Returns the device on which it renders.
    pub fn context(&self) -> &Context {
        &self.context
    }

    /// Loads a scene, which replaces the previous one.
    ///
    /// # Errors
    /// [`Error::Argument`] when the vectors differ in length; allocation failures.
    pub fn upload(&mut self, gaussians: &Gaussians) -> Result<()> {
        self.upload_stored(gaussians, ShStorage::F32)
    }

    /// Same as [`Renderer::upload`], with this storage of SH ([`DeviceScene::upload_stored`]).
    ///
    /// # Errors
    /// Same as [`Renderer::upload`].
    pub fn upload_stored(&mut self, gaussians: &Gaussians, sh_storage: ShStorage) -> Result<()> {
        self.scenes.clear();
        self.scenes.push(DeviceScene::upload_stored(&self.context, gaussians, 0, sh_storage)?.buffers);
        Ok(())
    }

    /// Draws these scenes together, in the same axes, from the next frame on; replaces what was loaded before. A frame is
    /// bit-identical to that of one scene with all their Gaussians in this order. Nothing is copied. With no scenes,
    /// pictures are empty.
    ///
    /// # Errors
    /// [`Error::Argument`] for scenes of another context or with different SH degrees; allocation failures.
    pub fn set_scenes(&mut self, scenes: &[DeviceScene]) -> Result<()> {
        if let Some(index) = scenes.iter().position(|scene| !scene.belongs_to(&self.context)) {
            return Err(Error::argument(format!("scenes[{index}]"), ELSEWHERE));
        }
        let degrees = scenes.iter().map(|scene| scene.plan().sh_degree);
        if let (Some(min), Some(max)) = (degrees.clone().min(), degrees.max())
            && min < max
        {
            let problem = format!("one has SH degree {min}, another {max}: store all with the same");
            return Err(Error::argument("scenes", problem));
        }
        let filled = scenes.iter().filter(|scene| scene.count() > 0);
        self.scenes = filled.map(|scene| scene.buffers.clone()).collect();
        if self.scenes.is_empty() {
            return self.upload(&Gaussians::default());
        }
        Ok(())
    }

    /// Returns the loaded scene, or an error if there are several. `what` names the operation.
    pub(super) fn only_scene(&self, what: &str) -> Result<SceneBuffers> {
        match loaded(&self.scenes)? {
            (scene, []) => Ok(scene.clone()),
            (_, others) => {
                let problem = format!("{what} of one alone, and {} are drawn", others.len() + 1);
                Err(Error::argument("scenes", problem))
            }
        }
    }

    /// Downloads the scene's Gaussians; several scenes are concatenated.
    ///
    /// # Errors
    /// [`Error::Argument`] without a scene; when the device is lost.
    pub fn gaussians(&self) -> Result<Gaussians> {
        let (first, others) = loaded(&self.scenes)?;
        let mut all = planes::download(&self.context, first)?;
        for scene in others {
            all.append(&planes::download(&self.context, scene)?);
        }
        Ok(all)
    }

    /// Returns the scene on the device, for [`Renderer::record`]. None before [`Renderer::upload`], or if there are several
    /// scenes.
    pub fn scene(&self) -> Option<DeviceScene> {
        match &self.scenes[..] {
            [scene] => Some(DeviceScene::new(&self.context, scene.clone())),
            _ => None,
        }
    }

    /// Sets the initial capacity in (tile, Gaussian) instances, instead of an estimate. Frames that need more are run again
    /// with a larger capacity.
    pub fn set_instance_capacity(&mut self, instances: u32) {
        self.runner.store.set_instances(instances);
    }

    /// Frees the buffers of frames. They grow to the needs of the largest frame, and stay. After this, the next frame
    /// allocates only what it needs, and a capacity of [`Renderer::set_instance_capacity`] is forgotten. The same happens
    /// if a frame does not fit beside the needs of earlier ones. The slots of [`Renderer::reserve`] and the scene stay.
    pub fn shrink(&mut self) {
        self.runner.store.forget();
    }

    /// Frees the buffers of frames. The next frame allocates the same capacity again.
    pub(crate) fn release(&mut self) {
        self.runner.store.release();
    }

    /// Returns the bytes of the buffers of frames, without the slots of [`Renderer::reserve`].
    pub fn frame_bytes(&self) -> u64 {
        self.runner.store.bytes()
    }

    /// Returns the form of blending.
    pub fn blending(&self) -> Blending {
        self.runner.forward.blending()
    }

    /// Sets the form of blending. Before frames are recorded into a host's command buffer again, call
    /// [`Renderer::reserve`], once none is in flight: it builds the kernels.
    pub fn set_blending(&mut self, blending: Blending) {
        self.runner.forward.set_blending(blending);
    }

    /// Computes the sizes of Mip-Splatting's 3D filter (Yu et al. 2024, section 5.1) for the scene's Gaussians, from the
    /// training cameras. [`RenderSettings::filter_3d`] draws with them.
    ///
    /// # Errors
    /// [`Error::Argument`] if there is no scene or no camera; memory or device failures.
    pub fn compute_filters(&mut self, cameras: &[Camera]) -> Result<()> {
        let filter = Filter3d::new(&self.context, cameras, None)?;
        loaded(&self.scenes)?;
        self.scenes.iter().try_for_each(|scene| filter.run(&self.context, scene))
    }

    /// Returns the sizes of the 3D filter, world units, one per Gaussian; 0 without a filter.
    ///
    /// # Errors
    /// Same as [`Renderer::gaussians`].
    pub fn filters(&self) -> Result<Vec<f32>> {
        loaded(&self.scenes)?;
        let of_scenes = self.scenes.iter().map(|scene| planes::download_filters(&self.context, scene));
        Ok(of_scenes.collect::<Result<Vec<_>>>()?.concat())
    }

    /// Renders the scene.
    ///
    /// # Errors
    /// [`Error::Argument`] without a scene or with an invalid camera; memory or device failures.
    pub fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Frame> {
        self.render_frame(camera, settings, &SceneSettings::USUAL, false)
    }

    /// Same as [`Renderer::render`], with the selected Gaussians in the selection's colour.
    ///
    /// # Errors
    /// Same as [`Renderer::render`]; [`Error::Argument`] if several scenes are loaded, and for a mask that is too small or of
    /// another context.
    pub fn render_selected(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
        selection: Selection<'_>,
    ) -> Result<Frame> {
        let count = self.only_scene("a selection is")?.count;
        let own = SceneSettings { selection: Some(selection), ..SceneSettings::USUAL };
        own.check()?;
        own.check_mask(count, &self.context)?;
        self.render_frame(camera, settings, &own, false)
    }

    /// [`Renderer::render`]; `own` and `last_entries` as in [`Request`].
    pub(super) fn render_frame(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
        own: &SceneSettings<'_>,
        last_entries: bool,
    ) -> Result<Frame> {
        let stats = self.draw_frame(camera, settings, own, last_entries)?;
        let pixels = u64::from(camera.width) * u64::from(camera.height);
        let frame = self.runner.store.current()?;
        let [r, g, b] = settings.background;
        let mut color = Vec::with_capacity(pixels as usize);
        let mut transmittance = Vec::with_capacity(pixels as usize);
        self.context.download_chunks(&frame.accumulated.range(0, pixels * 16), |bytes| {
            let texels = bytes.chunks_exact(16).map(bytemuck::pod_read_unaligned::<[f32; 4]>);
            color.extend(texels.clone().map(|[x, y, z, t]| [x + t * r, y + t * g, z + t * b]));
            transmittance.extend(texels.map(|[.., t]| t));
        })?;
        let depth = || self.read(&frame.depth_sums, 0, pixels * 4);
        let inverse_depth = settings.inverse_depth.then(depth).transpose()?;
        let surface = settings.surface.map(|_| self.read_surface(camera, pixels)).transpose()?;
        let [width, height] = [camera.width, camera.height];
        Ok(Frame { width, height, color, transmittance, inverse_depth, surface, stats })
    }

    /// Renders a surface, and returns the frame's buffers, which hold it until the next frame.
    pub(crate) fn draw_surface(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<FrameBuffers> {
        let surface = Some(settings.surface.unwrap_or_default());
        self.draw(camera, &RenderSettings { surface, ..*settings })?;
        self.runner.store.current().cloned()
    }

    fn read_surface(&self, camera: &Camera, pixels: u64) -> Result<Surface> {
        let world_from_camera = camera.camera_from_world.transpose();
        let words: Vec<[f32; 4]> = self.read(&self.runner.store.current()?.surfaces, 0, pixels * 16)?;
        let normal = |sum: Vec3| (world_from_camera * sum).normalize_or_zero().to_array();
        Ok(Surface {
            depth: words.iter().map(|[.., depth]| *depth).collect(),
            normals: words.iter().map(|&[x, y, z, _]| normal(Vec3::new(x, y, z))).collect(),
        })
    }

    pub(super) fn read<T: bytemuck::Pod>(&self, buffer: &Buffer, offset: u64, bytes: u64) -> Result<Vec<T>> {
        if bytes == 0 {
            return Ok(Vec::new());
        }
        Ok(bytemuck::pod_collect_to_vec(&self.context.download(&buffer.range(offset, bytes))?))
    }

    /// Same as [`Renderer::render`], but does not read the picture back. For measurements of the device's work.
    ///
    /// # Errors
    /// Same as [`Renderer::render`].
    pub fn draw(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<FrameStats> {
        self.draw_frame(camera, settings, &SceneSettings::USUAL, false)
    }

    fn draw_frame(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
        own: &SceneSettings<'_>,
        last_entries: bool,
    ) -> Result<FrameStats> {
        let (scene, other_scenes) = loaded(&self.scenes)?;
        let alone = Request::new(scene, camera, settings, false);
        let request = Request { other_scenes, of_scenes: own, last_entries, ..alone };
        let ran = self.runner.run(&request, |_, _| {}).map_err(RunError::error)?;
        let FrameRun { counts, report, retries } = ran;
        let FrameCounts { visible, instances, longest_tile, samples, .. } = counts;
        let gaussians = self.scenes.iter().map(|scene| scene.count).sum();
        let scopes = report.scopes;
        Ok(FrameStats { gaussians, visible, instances, longest_tile, samples, scopes, retries })
    }

    /// Renders this scene on the device, instead of the loaded ones.
    ///
    /// # Errors
    /// [`Error::Argument`] for a scene of another context or an invalid camera; memory or device failures.
    pub fn render_scene(
        &mut self,
        scene: &DeviceScene,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<Frame> {
        self.with_scene(scene, |renderer| renderer.render(camera, settings))
    }

    /// Calls `act` with this scene on the device in place of the loaded scenes, which are restored afterwards, even after a
    /// panic. For operations on one scene: [`Renderer::gradients`], [`Renderer::align`], [`Renderer::compute_filters`].
    /// Nothing is copied. Scenes that `act` loads are dropped at its end.
    ///
    /// # Errors
    /// [`Error::Argument`] for a scene of another context; errors of `act`.
    pub fn with_scene<T>(
        &mut self,
        scene: &DeviceScene,
        act: impl FnOnce(&mut Self) -> Result<T>,
    ) -> Result<T> {
        if !scene.belongs_to(&self.context) {
            return Err(Error::argument("scene", ELSEWHERE));
        }
        self.with_scenes(vec![scene.buffers.clone()], act)
    }

    /// Calls `act` with these scenes in place of the loaded ones, which are restored afterwards, even after a panic.
    pub(crate) fn with_scenes<T>(
        &mut self,
        scenes: Vec<SceneBuffers>,
        act: impl FnOnce(&mut Self) -> Result<T>,
    ) -> Result<T> {
        let loaded = std::mem::replace(&mut self.scenes, scenes);
        let aside = SetAside { renderer: self, loaded };
        act(aside.renderer)
    }
}

/// Restores the renderer's scenes when dropped.
struct SetAside<'a> {
    renderer: &'a mut Renderer,
    loaded: Vec<SceneBuffers>,
}

impl Drop for SetAside<'_> {
    fn drop(&mut self) {
        self.renderer.scenes = std::mem::take(&mut self.loaded);
    }
}

/// Returns the first scene and the others.
fn loaded(scenes: &[SceneBuffers]) -> Result<(&SceneBuffers, &[SceneBuffers])> {
    scenes.split_first().ok_or_else(|| Error::argument("scene", "none is loaded; call upload first"))
}
