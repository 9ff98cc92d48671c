//! Moves a camera until the picture of a fixed scene agrees with a photograph.

use super::renderer::Renderer;
use super::runner::{Request, RunError};
use crate::error::{Error, Result};
use crate::frame::{FrameVariant, RenderSettings};
use crate::passes::adam::{BETA_1, BETA_2};
use crate::passes::backward::{BackwardForm, Statistics};
use crate::passes::loss::{Loss, LossInputs, NativeLayout, PhotoFormat, photo_bytes, photo_on_device};
use crate::passes::poses::{GRADIENT_BYTES, PARAMETER_BYTES, PoseGradient, adam_on_host};
use crate::scene::{Camera, StoredPhoto, Twist};
use crate::vk::MemoryKind;
use glam::DVec3;

/// Settings of a camera alignment: photometric optimisation of its pose with the scene fixed. BARF (Lin et al. 2021,
/// section 4.2) and later methods without poses do the same with held-out views.
///
/// Adam (ε 1e-8, no weight decay) optimises the six parameters of a [`Twist`], from 0, with the training loss. The pivot of
/// its rotations is the picture's centre at the mean depth of the visible scene. Rotations about the camera's centre look
/// nearly like displacements, so Adam would need many more steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alignment {
    /// Number of steps; each takes about as long as an iteration of training.
    pub steps: u32,
    /// Initial learning rate: of rotations in radians, of displacements times the mean depth. It falls log-linearly to a
    /// hundredth at the last step.
    pub lr: f64,
    /// Weight of 1 - SSIM in the loss; L1 has the rest.
    pub lambda_dssim: f32,
}

impl Default for Alignment {
    /// 100 steps, which correct about 2.5 degrees.
    fn default() -> Self {
        Self { steps: 100, lr: 2e-3, lambda_dssim: 0.2 }
    }
}

impl Alignment {
    fn check(&self) -> Result<()> {
        if self.lr.is_finite() && self.lr >= 0.0 && (0.0..=1.0).contains(&self.lambda_dssim) {
            return Ok(());
        }
        Err(Error::argument("alignment", "its rate must be finite and not negative, lambda_dssim 0 to 1"))
    }

    /// Takes one step of Adam; `gradient` is about the camera's centre.
    fn step(&self, adam: &mut Adam, gradient: Twist) {
        adam.steps += 1;
        let progress = f64::from(adam.steps) / f64::from(self.steps.max(1));
        let decay = 0.01_f64.powf(progress);
        let pivot = DVec3::new(0.0, 0.0, adam.depth);
        let about_pivot = Twist { omega: gradient.omega - pivot.cross(gradient.nu), ..gradient };
        let gradient = adam.moved.gradient_of(about_pivot);
        let bias = [BETA_1, BETA_2].map(|beta| 1.0 - beta.powi(adam.steps as i32));
        let Adam { moved, first, second, depth, .. } = adam;
        for k in 0..3 {
            let change = |m: &mut DVec3, v: &mut DVec3, g: DVec3, lr: f64| {
                adam_on_host([&mut m[k], &mut v[k]], g[k], bias, lr * decay)
            };
            moved.nu[k] -= change(&mut first.nu, &mut second.nu, gradient.nu, self.lr * *depth);
            moved.omega[k] -= change(&mut first.omega, &mut second.omega, gradient.omega, self.lr);
        }
    }
}

/// State of an alignment.
struct Adam {
    /// Motion about the pivot.
    moved: Twist,
    first: Twist,
    second: Twist,
    steps: u32,
    /// Depth of the pivot, world units.
    depth: f64,
}

impl Adam {
    fn new(depth: f64) -> Self {
        let zero = Twist::default();
        Self { moved: zero, first: zero, second: zero, steps: 0, depth }
    }

    fn applied_to(&self, camera: &Camera) -> Camera {
        let pivot = DVec3::new(0.0, 0.0, self.depth);
        let about = |by: DVec3, camera: &Camera| Twist { nu: by, omega: DVec3::ZERO }.applied_to(camera);
        match self.moved == Twist::default() {
            true => *camera,
            false => about(pivot, &self.moved.applied_to(&about(-pivot, camera))),
        }
    }
}

impl Renderer {
    /// Aligns a camera to a photograph, so that the scene's picture agrees with it, and returns the moved camera. The scene
    /// does not change. Ignores a step whose gradient is not finite.
    ///
    /// # Errors
    /// [`Error::Argument`] without a scene or with several, for a photograph of another size than the camera's, or for rates
    /// that are not finite. Also for settings that are not [faithful](RenderSettings::is_faithful), and errors of
    /// [`Renderer::render`].
    pub fn align(
        &mut self,
        camera: &Camera,
        photo: &StoredPhoto,
        settings: &RenderSettings,
        alignment: &Alignment,
    ) -> Result<Camera> {
        let scene = &self.only_scene("an alignment is")?;
        check(camera, photo, settings, alignment)?;
        let sh_degree = scene.active_degree(settings);
        let mut adam = Adam::new(self.mean_depth(camera, settings)?);
        let settings = &RenderSettings { inverse_depth: false, ..*settings };
        let form = BackwardForm { pose: true, ..BackwardForm::default() };
        let variant = FrameVariant::of(settings, camera, true);
        self.backward.prepare(
            sh_degree,
            FrameVariant { sh_storage: scene.plan.sh_storage, ..variant },
            form,
        )?;
        let pose_gradient = PoseGradient::new(&self.context)?;
        let masked = photo.is_masked();
        let format = if masked { PhotoFormat::MaskedRgba8 } else { PhotoFormat::Rgba8 };
        let loss = Loss::new(&self.context, format)?;
        let (width, height) = (camera.width, camera.height);
        let layout = NativeLayout::of(self.context.limits());
        let mut requests = vec![
            ("photo", photo_bytes(layout, width, height, masked)),
            ("losses", 16),
            ("statistics", u64::from(scene.count.max(1)) * 8),
            ("pose_parameters", PARAMETER_BYTES),
            ("pose_gradient", GRADIENT_BYTES),
        ];
        requests.extend(loss.scratch_requests([(width, height)]));
        let buffers = self.context.allocate("alignment", &requests, MemoryKind::Device)?;
        let [target, losses, statistics, parameters, gradient, scratch @ ..] = &buffers[..] else {
            unreachable!("one buffer per request")
        };
        let texels = photo_on_device(layout, width, height, masked, photo.texels()?);
        self.context.upload(target, &texels)?;
        let (sizes, backward) = (self.runner.forward.sizes, &self.backward);
        let (start, mut moved) = (camera, *camera);
        for _ in 0..alignment.steps {
            let ran = self.runner.run(&Request::new(scene, &moved, settings, true), |r, inputs| {
                let loss_inputs = LossInputs {
                    rendered: inputs.buffers.rendered(&sizes),
                    photo: target,
                    scratch,
                    losses,
                    row: 0,
                    image_gradient: &inputs.buffers.image_gradient,
                    width,
                    height,
                    background: settings.background,
                    lambda_dssim: alignment.lambda_dssim,
                    weight: 1.0,
                };
                r.barrier();
                r.fill(parameters, 0);
                loss.record(r, &loss_inputs);
                r.barrier();
                let statistics = Statistics { buffer: statistics, accumulate: false };
                backward.record(r, inputs, &inputs.buffers.image_gradient, statistics, form);
                r.barrier();
                pose_gradient.record(r, inputs, parameters, 0, gradient);
            });
            ran.map_err(RunError::error)?;
            let bytes = self.context.download(&gradient.range(0, GRADIENT_BYTES / 2))?;
            let g: [f32; 6] = bytemuck::pod_read_unaligned(&bytes);
            if g.iter().all(|x| x.is_finite()) {
                alignment.step(&mut adam, Twist::from_array(g.map(f64::from)));
                moved = adam.applied_to(start);
            }
        }
        Ok(moved)
    }

    /// Returns the harmonic mean of the visible scene's depth, world units; 1 if nothing is visible.
    fn mean_depth(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<f64> {
        let frame = self.render(camera, &RenderSettings { inverse_depth: true, ..*settings })?;
        let weight: f64 = frame.transmittance.iter().map(|&t| 1.0 - f64::from(t)).sum();
        let inverse: f64 = frame.inverse_depth.iter().flatten().map(|&x| f64::from(x)).sum();
        let depth = weight / inverse;
        Ok(if depth.is_finite() && depth > 0.0 { depth } else { 1.0 })
    }
}

fn check(
    camera: &Camera,
    photo: &StoredPhoto,
    settings: &RenderSettings,
    alignment: &Alignment,
) -> Result<()> {
    alignment.check()?;
    if (photo.width, photo.height) != (camera.width, camera.height) {
        let problem = format!(
            "has {}x{} pixels, its camera {}x{}; they must agree",
            photo.width, photo.height, camera.width, camera.height
        );
        return Err(Error::argument("photo", problem));
    }
    photo.check().map_err(|problem| Error::argument("photo", problem))?;
    if !settings.is_faithful() {
        let problem = "cameras are aligned to the Gaussians as they are: no other shape, no scale modifier";
        return Err(Error::argument("settings", problem));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Adam finds the minimum of a quadratic function, within the reach of the rates.
    #[test]
    fn adam_finds_a_minimum() {
        let alignment = Alignment { steps: 300, ..Alignment::default() };
        let wanted = Twist { nu: DVec3::new(0.02, -0.01, 0.03), omega: DVec3::new(0.01, 0.015, -0.005) };
        let mut adam = Adam::new(3.0);
        for _ in 0..300 {
            let (nu, omega) = (adam.moved.nu - wanted.nu, adam.moved.omega - wanted.omega);
            // Converts it to the camera's centre.
            let omega = omega + DVec3::new(0.0, 0.0, 3.0).cross(nu);
            alignment.step(&mut adam, Twist { nu, omega });
        }
        let far = (adam.moved.nu - wanted.nu).length() + (adam.moved.omega - wanted.omega).length();
        assert!(far < 2e-3, "{far}");
        let refused = Alignment { lr: f64::NAN, ..alignment }.check().expect_err("refused");
        assert!(refused.to_string().starts_with("alignment: "), "{refused}");
    }
}
