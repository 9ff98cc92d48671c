//! The optimiser's kernel with its state on the device.

use super::engine;
use super::gpu::Gpu;
use super::layout::{pack, plane_capacity, planes as planes_of, unpack};
use crate::reference::types::Gaussian;
use ashsplat::frame::{SceneBuffers, ScenePlan, ShStorage, planes};
use ashsplat::kernels::blocks::CameraBlock;
use ashsplat::kernels::constants::{GRADIENT_PLANES, PLANE_SH, STATE_NON_FINITE, STATE_OVERFLOW};
use ashsplat::kernels::optimizer::adam::{self, Push};
use ashsplat::vk::{Buffer, Kernel, MemoryKind};
use std::cell::Cell;

/// Gradients of a visible Gaussian, as the kernel reads them.
#[derive(Clone, Copy, Debug, Default)]
pub struct VisibleGradient {
    pub mean: [f64; 3],
    pub opacity_logit: f64,
    pub quat: [f64; 4],
    pub log_scale: [f64; 3],
    /// With respect to the colour before its clamp; the kernel derives the SH gradients from it.
    pub color: [f64; 3],
}

#[derive(Clone, Copy, Debug, Default)]
pub struct Rates {
    pub mean: f64,
    pub opacity: f64,
    pub quat: f64,
    pub log_scale: f64,
    pub sh_dc: f64,
    pub sh_rest: f64,
}

#[derive(Clone, Copy, Debug, Default)]
pub struct Step {
    pub rates: Rates,
    /// Counts from 1; 0 switches the bias correction off.
    pub count: i32,
    pub camera_position: [f64; 3],
}

/// Camera at this position, turned by a quarter about y. Without `moved` its translation is NaN, so that a kernel
/// that reads it fails.
pub fn camera_block(position: [f64; 3], moved: bool) -> CameraBlock {
    if !moved {
        return CameraBlock { camera_translation: [f32::NAN; 3], ..CameraBlock::default() };
    }
    let [x, y, z] = position.map(|x| x as f32);
    CameraBlock {
        camera_row_x: [0.0, 0.0, 1.0],
        camera_row_y: [0.0, 1.0, 0.0],
        camera_row_z: [-1.0, 0.0, 0.0],
        camera_translation: [-z, -y, x],
        inverse_scale_squared: 1.0,
        ..CameraBlock::default()
    }
}

pub struct AdamState<'a> {
    gpu: &'a Gpu,
    spec: adam::Spec,
    kernel: Kernel<adam::Interface>,
    count: usize,
    coefficients: usize,
    pub capacity: usize,
    pub parameters: Buffer,
    pub moments: [Buffer; 2],
    /// The parameters as a scene, if SH coefficients are halves.
    halves: Option<SceneBuffers>,
    parameter_gradients: Option<Buffer>,
    steps: Cell<u32>,
}

impl<'a> AdamState<'a> {
    /// Uploads Gaussians with zero moments.
    pub fn new(gpu: &'a Gpu, gaussians: &[Gaussian], sh_degree: u32, sparse: bool) -> AdamState<'a> {
        let (count, coefficients) = (gaussians.len(), gaussians[0].sh.len());
        let capacity = plane_capacity(count);
        let zeros = || gpu.zeros::<[f32; 4]>("moments", planes_of(coefficients) * capacity);
        let spec = adam::Spec {
            workgroup_size: gpu.workgroup(64),
            sh_degree,
            packed: false,
            sparse,
            parameter_gradients: false,
            moved_camera: false,
            sh_loops: gpu.context.limits().tuning.sh_loops,
            ..adam::Spec::default()
        };
        AdamState {
            gpu,
            spec,
            kernel: gpu.kernel(&spec),
            parameter_gradients: None,
            steps: Cell::new(0),
            count,
            coefficients,
            capacity,
            parameters: gpu.buffer("parameters", &pack(gaussians, capacity)),
            moments: [zeros(), zeros()],
            halves: None,
        }
    }

    /// Continues with the same parameters and moments in steps of the visible Gaussians only.
    pub fn sparse(&self) -> AdamState<'a> {
        let (parameters, moments) = (self.parameters.clone(), self.moments.clone());
        let spec = adam::Spec { sparse: true, ..self.spec };
        let kernel = self.gpu.kernel(&spec);
        AdamState {
            spec,
            kernel,
            parameter_gradients: None,
            parameters,
            moments,
            halves: None,
            steps: Cell::new(0),
            ..*self
        }
    }

    /// Keeps the moments packed.
    pub fn packed(self) -> AdamState<'a> {
        let spec = adam::Spec { packed: true, ..self.spec };
        AdamState { spec, kernel: self.gpu.kernel(&spec), ..self }
    }

    /// Keeps SH coefficients in halves, rounded to the nearest at first.
    pub fn halves(self) -> AdamState<'a> {
        let (context, gaussians) = (&self.gpu.context, engine::gaussians(&self.gaussians()));
        let plan =
            ScenePlan::new(context.limits(), self.capacity as u32, gaussians.sh_degree, ShStorage::Half);
        let scene =
            planes::upload_planned(context, "scene", MemoryKind::Device, &gaussians, plan.expect("a plan"))
                .expect("a scene");
        let spec = adam::Spec { half_sh: true, ..self.spec };
        AdamState {
            spec,
            kernel: self.gpu.kernel(&spec),
            parameters: scene.chunks[0].clone(),
            halves: Some(scene),
            ..self
        }
    }

    /// Adds gradients with respect to the parameters themselves: `direct`'s means, quaternions, scales and
    /// opacities.
    pub fn with_parameter_gradients(self, direct: &[Gaussian]) -> AdamState<'a> {
        let mut planes = pack(direct, self.capacity);
        planes.truncate(PLANE_SH as usize * self.capacity);
        let spec = adam::Spec { parameter_gradients: true, ..self.spec };
        let parameter_gradients = Some(self.gpu.buffer("parameter_gradients", &planes));
        AdamState { spec, kernel: self.gpu.kernel(&spec), parameter_gradients, ..self }
    }

    /// Reads the camera's position from the camera block only.
    pub fn with_moved_camera(self) -> AdamState<'a> {
        let spec = adam::Spec { moved_camera: true, ..self.spec };
        AdamState { spec, kernel: self.gpu.kernel(&spec), ..self }
    }

    /// Makes one step. `gradients` has `None` for Gaussians that are not visible. Returns the number of Gaussians
    /// skipped as not finite.
    pub fn step(&self, gradients: &[Option<VisibleGradient>], step: &Step, overflow: bool) -> u32 {
        let (visible_index, rows) = self.gradient_planes(gradients);
        let state = self.gpu.frame_state(&[(STATE_OVERFLOW, overflow.into())]);
        let (index, rows) =
            (self.gpu.buffer("visible_index", &visible_index), self.gpu.buffer("gradients", &rows));
        let (parameters, [moments_1, moments_2]) = (&self.parameters, &self.moments);
        let (visible_index, gradients, state) = (&index, &rows, &state);
        let workgroups = (self.count as u64).div_ceil(self.spec.workgroup_size.into());
        let push = self.push(step);
        let bind = adam::Bind {
            parameters,
            moments_1,
            moments_2,
            visible_index,
            gradients,
            state,
            old_parameters: parameters,
            old_moments_1: moments_1,
            old_moments_2: moments_2,
            parameter_gradients: self.parameter_gradients.as_ref().unwrap_or(gradients),
            camera_block: &self
                .gpu
                .buffer("camera_block", &[camera_block(step.camera_position, self.spec.moved_camera)]),
        };
        self.gpu.run(|recorder| recorder.dispatch(&self.kernel, &bind, &push, workgroups));
        self.gpu.read_state(state, STATE_NON_FINITE)
    }

    pub fn push(&self, step: &Step) -> Push {
        let (beta_1, beta_2) = (0.9, 0.999);
        let correction = |beta: f64| if step.count == 0 { 1.0 } else { 1.0 - f64::powi(beta, step.count) };
        let rate = |rate: f64| (rate / correction(beta_1)) as f32;
        let inverse_bias_2 = correction(beta_2).sqrt().recip() as f32;
        Push {
            camera_position: match self.spec.moved_camera {
                true => [f32::NAN; 3],
                false => step.camera_position.map(|x| x as f32),
            },
            first: 0,
            count: self.count as u32,
            chunk_gaussians: self.capacity as u32,
            gradient_stride: self.count as u32 + 1,
            beta_1: beta_1 as f32,
            beta_2: beta_2 as f32,
            one_minus_beta_1: (1.0 - beta_1) as f32,
            one_minus_beta_2: (1.0 - beta_2) as f32,
            epsilon: 1e-15,
            rate_mean: rate(step.rates.mean),
            rate_opacity: rate(step.rates.opacity),
            rate_quat: rate(step.rates.quat),
            rate_log_scale: rate(step.rates.log_scale),
            rate_sh_dc: rate(step.rates.sh_dc),
            rate_sh_rest: rate(step.rates.sh_rest),
            inverse_bias_2,
            inverse_bias_2_opacity: inverse_bias_2,
            seed: 5,
            iteration: self.steps.replace(self.steps.get() + 1),
            ..Push::default()
        }
    }

    fn gradient_planes(&self, gradients: &[Option<VisibleGradient>]) -> (Vec<u32>, Vec<[f32; 4]>) {
        let stride = self.count + 1;
        let mut rows = vec![[f32::NAN; 4]; GRADIENT_PLANES as usize * stride];
        let mut index = Vec::new();
        let mut place = 0;
        for gradient in gradients {
            let Some(g) = gradient else {
                index.push(u32::MAX);
                continue;
            };
            index.push(place as u32);
            let f = |x: f64| x as f32;
            let three = |v: [f64; 3], w: f64| [f(v[0]), f(v[1]), f(v[2]), f(w)];
            rows[place] = three(g.mean, g.opacity_logit);
            rows[stride + place] = g.quat.map(f);
            // Other kernels use the fourth components: the optimiser must ignore their values.
            rows[2 * stride + place] = three(g.log_scale, f64::NAN);
            rows[3 * stride + place] = three(g.color, f64::INFINITY);
            place += 1;
        }
        (index, rows)
    }

    pub fn gaussians(&self) -> Vec<Gaussian> {
        match &self.halves {
            Some(scene) => engine::twins(&planes::download(self.gpu.context, scene).expect("the parameters")),
            None => self.download()[0].clone(),
        }
    }

    /// Parameters, first and second moments.
    pub fn download(&self) -> [Vec<Gaussian>; 3] {
        [&self.parameters, &self.moments[0], &self.moments[1]].map(|buffer| {
            let words = self.gpu.read::<[f32; 4]>(buffer, planes_of(self.coefficients) * self.capacity);
            unpack(&words, self.capacity, self.count, self.coefficients)
        })
    }
}
