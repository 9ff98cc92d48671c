//! A renderer that owns its submissions.

use super::align::{AlignRequest, Aligner, Alignment};
use super::device_scene::{DeviceScene, ELSEWHERE};
use super::frame::{Frame, FrameStats};
use super::recorded_frame::Staged;
use super::runner::FrameRunner;
use super::slots::Slots;
use crate::error::{Error, Result};
use crate::frame::{Blending, PlacedScene, RenderSettings, SceneBuffers, planes};
use crate::passes::backward::Backward;
use crate::passes::compose::Compose;
use crate::passes::filter_3d::Filter3d;
use crate::passes::pixels::PixelBorder;
use crate::scene::{Camera, Gaussians, StoredPhoto};
use crate::vk::Context;

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
    pub(super) scene: Option<SceneBuffers>,
    /// Built by the first reservation.
    pub(super) compose: Option<Compose>,
    /// Built by the first gradients.
    pub(super) border: Option<PixelBorder>,
    /// Built by the first alignment.
    pub(super) aligner: Option<Aligner>,
    pub(super) slots: Slots,
    /// Reused list of a recording's scenes.
    pub(super) placed: Vec<PlacedScene<'static>>,
    /// Reused lists of a recording's updates.
    pub(super) staged: Staged,
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
            scene: None,
            compose: None,
            border: None,
            aligner: None,
            slots: Slots::default(),
            placed: Vec::new(),
            staged: Staged::default(),
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
        self.scene = None;
        self.runner.frozen.clear();
        let count = crate::frame::to_u32(gaussians.len() as u64)?;
        self.scene = Some(planes::upload(&self.context, "scene", gaussians, count, gaussians.sh_degree)?);
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
        if let (Some(least), Some(most)) = (degrees.clone().min(), degrees.max())
            && least < most
        {
            let problem = format!("one has SH degree {least}, another {most}: store all with the same");
            return Err(Error::argument("scenes", problem));
        }
        let filled = scenes.iter().filter(|scene| scene.count() > 0);
        let mut buffers: Vec<SceneBuffers> = filled.map(|scene| scene.buffers.clone()).collect();
        if buffers.is_empty() {
            return self.upload(&Gaussians::default());
        }
        self.scene = Some(buffers.remove(0));
        self.runner.frozen = buffers;
        Ok(())
    }

    /// Returns all scenes that are drawn.
    fn scenes(&self) -> Result<impl Iterator<Item = &SceneBuffers>> {
        let first = self.scene.as_ref().ok_or_else(no_scene)?;
        Ok(std::iter::once(first).chain(&self.runner.frozen))
    }

    /// Downloads the scene's Gaussians; several scenes are concatenated.
    ///
    /// # Errors
    /// [`Error::Argument`] without a scene; when the device is lost.
    pub fn gaussians(&self) -> Result<Gaussians> {
        let mut all: Option<Gaussians> = None;
        for scene in self.scenes()? {
            let own = planes::download(&self.context, scene)?;
            match &mut all {
                Some(all) => all.append(&own),
                None => all = Some(own),
            }
        }
        Ok(all.unwrap_or_default())
    }

    /// Returns the scene on the device, for [`Renderer::record`]. None before [`Renderer::upload`], or if there are several
    /// scenes.
    pub fn scene(&self) -> Option<DeviceScene> {
        let scene = self.scene.as_ref().filter(|_| self.runner.frozen.is_empty())?;
        Some(DeviceScene::new(&self.context, scene.clone()))
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
        let filter = Filter3d::new(&self.context, cameras)?;
        self.scenes()?.try_for_each(|scene| filter.run(&self.context, scene))
    }

    /// Returns the sizes of the 3D filter, world units, one per Gaussian; 0 without a filter.
    ///
    /// # Errors
    /// Same as [`Renderer::gaussians`].
    pub fn filters(&self) -> Result<Vec<f32>> {
        let of_scenes = self.scenes()?.map(|scene| planes::download_filters(&self.context, scene));
        Ok(of_scenes.collect::<Result<Vec<_>>>()?.concat())
    }

    /// Renders the scene.
    ///
    /// # Errors
    /// [`Error::Argument`] without a scene or with an invalid camera; memory or device failures.
    pub fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Frame> {
        let scene = self.scene.as_ref().ok_or_else(no_scene)?;
        self.runner.render(scene, camera, settings)
    }

    /// Same as [`Renderer::render`], but does not read the picture back. For measurements of the device's work.
    ///
    /// # Errors
    /// Same as [`Renderer::render`].
    pub fn draw(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<FrameStats> {
        let scene = self.scene.as_ref().ok_or_else(no_scene)?;
        self.runner.draw(scene, camera, settings)
    }

    /// Aligns a camera to a photograph, so that the scene's picture agrees with it, and returns the moved camera. The scene
    /// does not change.
    ///
    /// # Errors
    /// [`Error::Argument`] without a scene, for a photograph of another size than the camera's, or for rates that are not
    /// finite. Also for settings that are not [faithful](RenderSettings::is_faithful), and errors of [`Renderer::render`].
    pub fn align(
        &mut self,
        camera: &Camera,
        photo: &StoredPhoto,
        settings: &RenderSettings,
        alignment: &Alignment,
    ) -> Result<Camera> {
        check_one(&self.runner, "an alignment is")?;
        let scene = self.scene.clone().ok_or_else(no_scene)?;
        let request = AlignRequest { scene: &scene, camera, photo, settings, alignment };
        let aligner = match &mut self.aligner {
            Some(aligner) => aligner,
            none => none.insert(Aligner::new(&self.context)?),
        };
        aligner.align(&mut self.runner, &request)
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
        let loaded = self.scene.replace(scene.buffers.clone());
        let frozen = std::mem::take(&mut self.runner.frozen);
        let aside = SetAside { renderer: self, loaded, frozen };
        act(aside.renderer)
    }
}

/// Restores the renderer's scenes when dropped.
struct SetAside<'a> {
    renderer: &'a mut Renderer,
    loaded: Option<SceneBuffers>,
    frozen: Vec<SceneBuffers>,
}

impl Drop for SetAside<'_> {
    fn drop(&mut self) {
        self.renderer.scene = self.loaded.take();
        self.renderer.runner.frozen = std::mem::take(&mut self.frozen);
    }
}

/// Returns an error if several scenes are loaded.
pub(super) fn check_one(runner: &FrameRunner, what: &str) -> Result<()> {
    match runner.frozen.len() {
        0 => Ok(()),
        more => Err(Error::argument("scenes", format!("{what} of one alone, and {} are drawn", more + 1))),
    }
}

pub(super) fn no_scene() -> Error {
    Error::argument("scene", "none is loaded; call upload first")
}
