//! Differentiable rendering: the gradient of any function of the image with respect to all parameters.

use super::renderer::Renderer;
use super::runner::{Request, RunError};
use crate::error::{Error, Result};
use crate::frame::{FrameVariant, LENS_SUM_BYTES, RenderSettings, SceneBuffers, ShStorage, planes};
use crate::passes::backward::{BackwardForm, Statistics};
use crate::passes::lens::LensGradient;
use crate::passes::pixels::LayoutConverter;
use crate::passes::poses::{GRADIENT_BYTES, PARAMETER_BYTES, PoseGradient};
use crate::scene::{Camera, Gaussians, LENS_PARAMETERS};
use crate::vk::MemoryKind;

/// Gradients of a scalar with respect to a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradients {
    /// With respect to the raw parameters, in their shapes.
    pub parameters: Gaussians,
    /// With respect to the 2D means, pixels; 0 for Gaussians that are not visible.
    pub mean2d_px: Vec<[f32; 2]>,
    /// With respect to the camera's pose: dL/dδ at δ = 0 of the pose `exp(δ^) T`, T from world to camera. δ = (ν, ω) is in
    /// the camera's frame (x right, y down, z forward). ν are three displacements in world units, ω three rotations in
    /// radians about the camera's centre. See [`Twist`](crate::scene::Twist). Only from [`Renderer::gradients_with_pose`].
    pub pose: Option<[f32; 6]>,
    /// Gradient with respect to the lens: focal lengths and principal point (fx, fy, cx, cy, pixels), then its
    /// [coefficients](Camera::coefficients). Which points the lens shows, and the limit beyond the picture's corners at which its
    /// Jacobian is held, count as constants. Only from [`Renderer::gradients_with_pose`] of a camera with a lens; zeros for panoramas.
    pub lens: Option<[f64; 16]>,
}

impl Renderer {
    /// Renders the scene and returns the gradient of `sum(image * image_gradient)` (plus `sum(inverse_depth *
    /// inverse_depth_gradient)`). With `image_gradient` = dL/dimage this is the gradient of L. It is the exact derivative
    /// of the forward pass (paper, appendix A).
    ///
    /// # Errors
    /// [`Error::Argument`] when a gradient does not have one entry per pixel, for an inverse-depth gradient without
    /// `settings.inverse_depth`, or for an orthographic camera. Also for settings that are not
    /// [faithful](RenderSettings::is_faithful), and errors of [`Renderer::render`].
    pub fn gradients(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
        image_gradient: &[[f32; 3]],
        inverse_depth_gradient: Option<&[f32]>,
    ) -> Result<Gradients> {
        self.differentiate(camera, settings, image_gradient, inverse_depth_gradient, false)
    }

    /// Same as [`Renderer::gradients`], but also returns the gradients with respect to the camera's pose and lens
    /// ([`Gradients::pose`], [`Gradients::lens`]). The first sums over all visible Gaussians how their means, covariances and view
    /// directions change with the pose. The order of the sum is fixed, so its bits are always the same.
    ///
    /// # Errors
    /// Same as [`Renderer::gradients`].
    pub fn gradients_with_pose(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
        image_gradient: &[[f32; 3]],
        inverse_depth_gradient: Option<&[f32]>,
    ) -> Result<Gradients> {
        self.differentiate(camera, settings, image_gradient, inverse_depth_gradient, true)
    }

    fn differentiate(
        &mut self,
        camera: &Camera,
        settings: &RenderSettings,
        image_gradient: &[[f32; 3]],
        inverse_depth_gradient: Option<&[f32]>,
        with_pose: bool,
    ) -> Result<Gradients> {
        let pixels = camera.width as usize * camera.height as usize;
        if image_gradient.len() != pixels || inverse_depth_gradient.is_some_and(|g| g.len() != pixels) {
            let problem = format!("needs one entry for each of {}x{} pixels", camera.width, camera.height);
            return Err(Error::argument("image gradient", problem));
        }
        if inverse_depth_gradient.is_some() && !settings.inverse_depth {
            return Err(Error::argument("inverse-depth gradient", "needs settings.inverse_depth"));
        }
        if !settings.is_faithful() {
            let problem =
                "gradients are those of the Gaussians as they are: no other shape, no scale modifier";
            return Err(Error::argument("settings", problem));
        }
        let scene = self.only_scene("gradients are")?;
        if scene.plan.sh_storage != ShStorage::F32 {
            return Err(Error::argument(
                "scene",
                "its SH are not floats: gradients are of a scene that has floats",
            ));
        }
        let sh_degree = scene.active_degree(settings);
        let variant = FrameVariant::of(settings, camera, true);
        let lens = with_pose && camera.projection.is_lens();
        let form = BackwardForm { pose: with_pose, lens, absolute: false };
        let lens_gradient = lens.then(|| LensGradient::new(&self.context)).transpose()?;
        self.backward.prepare(sh_degree, variant, form)?;
        let pose_gradient = with_pose.then(|| PoseGradient::new(&self.context)).transpose()?;
        self.backward.prepare_expand(sh_degree, variant)?;
        let layout = LayoutConverter::new(&self.context)?;
        let count = u64::from(scene.count);
        let planes = planes::allocate(&self.context, "gradients", MemoryKind::Device, &scene.plan)?;
        let target = (0..pixels).map(|i| {
            let [r, g, b] = image_gradient[i];
            [r, g, b, inverse_depth_gradient.map_or(0.0, |d| d[i])]
        });
        let target: Vec<[f32; 4]> = target.collect();
        let target: &[u8] = bytemuck::cast_slice(&target);
        let native_bytes = LayoutConverter::gradient_bytes(camera.width, camera.height);
        let mut requests = vec![
            ("mean2d_gradients", count * 8),
            ("statistics", count * 8),
            ("target_rows", target.len() as u64),
            ("target", native_bytes),
        ];
        if with_pose {
            requests.extend([("pose_parameters", PARAMETER_BYTES), ("pose_gradient", GRADIENT_BYTES)]);
        }
        if lens {
            requests.push(("lens_gradient", LENS_SUM_BYTES));
        }
        let extra = self.context.allocate("gradients", &requests, MemoryKind::Device)?;
        let [mean2d, statistics, target_rows, native, of_camera @ ..] = &extra[..] else {
            unreachable!("one buffer per request")
        };
        let (pose_buffers, lens_buffer) = match of_camera {
            [parameters, gradient, lens @ ..] => (Some((parameters, gradient)), lens.first()),
            _ => (None, None),
        };
        self.context.upload(target_rows, target)?;
        let backward = &self.backward;
        let ran = self.runner.run(&Request::new(&scene, camera, settings, true), |r, inputs| {
            r.barrier();
            layout.record_gradient(r, inputs, target_rows, native, false);
            r.barrier();
            let statistics = Statistics { buffer: statistics, accumulate: false };
            pose_buffers.iter().for_each(|(parameters, _)| r.fill(parameters, 0));
            backward.record(r, inputs, native, statistics, form);
            if let Some((kernel, (parameters, gradient))) = pose_gradient.as_ref().zip(pose_buffers) {
                r.barrier();
                kernel.record(r, inputs, parameters, 0, gradient);
            }
            if let Some((kernel, gradient)) = lens_gradient.as_ref().zip(lens_buffer) {
                kernel.record(r, inputs, gradient);
            }
            r.barrier();
            backward.record_expand_gradients(r, inputs, &planes, mean2d);
        });
        ran.map_err(RunError::error)?;
        let parameters = planes::download(&self.context, &SceneBuffers { chunks: planes, ..scene })?;
        let bytes = self.context.download(mean2d)?;
        let mut mean2d_px: Vec<[f32; 2]> = bytemuck::pod_collect_to_vec(&bytes);
        mean2d_px.truncate(parameters.len());
        let pose = pose_buffers.map(|(_, gradient)| -> Result<[f32; 6]> {
            let bytes = self.context.download(&gradient.range(0, GRADIENT_BYTES / 2))?;
            Ok(bytemuck::pod_read_unaligned(&bytes))
        });
        let lens = lens_buffer.map(|gradient| -> Result<[f64; 16]> {
            let bytes = self.context.download(&gradient.range(0, LENS_SUM_BYTES))?;
            Ok(camera.lens_gradient(&bytemuck::pod_read_unaligned(&bytes[..4 * LENS_PARAMETERS])))
        });
        Ok(Gradients { parameters, mean2d_px, pose: pose.transpose()?, lens: lens.transpose()? })
    }
}
