//! Lenses of the training views, optimised with the scene.
//!
//! Views with the same lens share it. Adam works on the host, in units that move the picture by a focal length
//! ([`Camera::lens_units`]). Its result depends on nothing but the gradients, so a resumed run has the same bits. A pinhole becomes
//! a lens without distortion, which learns distortion too.
//!
//! Photographs of a scene from about one distance hardly tell a longer focal length from a larger scene. Adam over both would
//! need thousands of steps to find the small difference. [`DollyZoom`] is one parameter that changes both.

use super::poses::mean_depth;
use super::schedule::IterationPlan;
use super::step::{LensReadback, LossValues};
use crate::error::{Error, Result};
use crate::frame::SceneBuffers;
use crate::passes::adam::{BETA_1, BETA_2};
use crate::passes::lens::SceneScaling;
use crate::passes::poses::{WEIGHT_DECAY, adam_on_host};
use crate::scene::{Camera, Gaussians, LENS_PARAMETERS, Projection};
use crate::vk::Context;
use bytemuck::{Pod, Zeroable};
use glam::{DVec3, Vec3};

/// Values of a lens in a checkpoint: see [`LensState`].
pub const LENS_STATE_VALUES: usize = 3 * LENS_PARAMETERS + 1;

/// Rate of the dolly zoom, times the lenses' rate.
const ZOOM_RATE: f64 = 5.0;

/// Lenses that are optimised.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LensState {
    /// One row per lens, in the order of the first views that have them: the changes of the focal lengths, the principal point and
    /// the coefficients, in the units of the optimiser; Adam's first and second moments of each; the number of steps.
    pub lenses: Vec<[f32; LENS_STATE_VALUES]>,
    /// None in checkpoints older than the zoom.
    pub zoom: Option<ZoomState>,
}

/// The dolly zoom: a factor of all focal lengths together with the opposite scaling of the scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct ZoomState {
    /// Logarithm of the factor.
    pub log_factor: f32,
    /// Adam's first and second moment.
    pub moments: [f32; 2],
    /// Number of steps.
    pub steps: f32,
    /// Logarithm of the factor that was applied to scene and cameras.
    pub applied: f32,
    /// Point about which the scene scales, world.
    pub center: [f32; 3],
}

/// The lenses of a run that optimises them.
pub(super) struct LensOptimizer {
    lenses: Vec<Lens>,
    /// Index of each view's lens.
    of_view: Vec<usize>,
    dolly_zoom: DollyZoom,
    /// Number of steps that were not made.
    pub refused: u32,
}

struct DollyZoom {
    /// None if the scene keeps its size.
    scaling: Option<SceneScaling>,
    state: ZoomState,
}

struct Lens {
    /// A camera with this lens as it was given.
    given: Camera,
    /// See [`Camera::lens_units`].
    units: [[f64; LENS_PARAMETERS]; LENS_PARAMETERS],
    state: [f32; LENS_STATE_VALUES],
}

/// The camera with a lens that can be optimised: a pinhole gets one that does not distort yet.
pub(super) fn with_own_lens(camera: &Camera) -> Camera {
    match camera.projection {
        Projection::Perspective => Camera { projection: Projection::Brown, ..*camera },
        _ => *camera,
    }
}

/// True if two cameras have the same lens and picture size.
fn share_lens(a: &Camera, b: &Camera) -> bool {
    let of = |camera: &Camera| {
        (camera.lens_parameters(), camera.projection, camera.width, camera.height, camera.part)
    };
    of(a) == of(b)
}

/// Centre of a camera, world.
fn center_of(camera: &Camera) -> DVec3 {
    -(camera.camera_from_world.transpose() * camera.translation).as_dvec3()
}

/// Returns a change and Adam's moments of it after a step. A gradient that is not finite, or huge, counts as 0. `count`: number of
/// steps with this one.
fn adam_step([change, first, second]: [f32; 3], gradient: f64, count: f64, rate: f64) -> [f32; 3] {
    let [change, mut first, mut second] = [change, first, second].map(f64::from);
    let g = if gradient.abs() < 1e15 { gradient } else { 0.0 } + WEIGHT_DECAY * change;
    let bias = [BETA_1, BETA_2].map(|beta| 1.0 - beta.powf(count));
    let change = change - adam_on_host([&mut first, &mut second], g, bias, rate);
    [change, first, second].map(|value| value as f32)
}

impl DollyZoom {
    /// Scales about the mean of the points that the cameras look at, at the mean depths of their views.
    fn new(context: &Context, cameras: &[Camera], initial: &Gaussians, may_scale: bool) -> Result<Self> {
        if !may_scale {
            return Ok(Self { scaling: None, state: ZoomState::default() });
        }
        let looked_at = |camera: &Camera| {
            let depth = f64::from(mean_depth(camera, &initial.means));
            center_of(camera) + depth * camera.camera_from_world.transpose().z_axis.as_dvec3()
        };
        let center = cameras.iter().map(looked_at).sum::<DVec3>() / cameras.len() as f64;
        let state = ZoomState { center: center.as_vec3().to_array(), ..ZoomState::default() };
        Ok(Self { scaling: Some(SceneScaling::new(context)?), state })
    }

    /// Factor of the focal lengths that was applied to scene and cameras.
    fn factor(&self) -> f64 {
        f64::from(self.state.applied).exp()
    }

    /// Makes a step with the gradients of the lens of the camera that was drawn and of a displacement of the scene.
    fn step(&mut self, drawn: &Camera, gradient: &LensReadback, rate: f64) {
        if self.scaling.is_none() {
            return;
        }
        let state = &mut self.state;
        let of_lens = drawn.lens_gradient(&gradient.parameters);
        // Scaling the scene about the camera's centre changes no picture. Scaling about the zoom's centre therefore equals a
        // displacement from the camera's centre to it. A rolling shutter, and a pose that is optimised too, count as given.
        let shift = Vec3::from_array(state.center).as_dvec3() - center_of(drawn);
        let moved = shift.dot(DVec3::from_array(gradient.means.map(f64::from)));
        let own = f64::from(drawn.fx) * of_lens[0] + f64::from(drawn.fy) * of_lens[1] + moved;
        state.steps += 1.0;
        let [first, second] = state.moments;
        let values = [state.log_factor, first, second];
        let [log_factor, first, second] = adam_step(values, own, state.steps.into(), ZOOM_RATE * rate);
        (state.log_factor, state.moments) = (log_factor, [first, second]);
    }
}

impl LensOptimizer {
    /// Starts with the lenses of these cameras. `may_scale`: the scene may be scaled with the focal lengths.
    pub fn new(context: &Context, cameras: &[Camera], initial: &Gaussians, may_scale: bool) -> Result<Self> {
        let mut lenses: Vec<Lens> = Vec::new();
        let of_view = cameras.iter().map(|camera| {
            lenses.iter().position(|lens| share_lens(&lens.given, camera)).unwrap_or_else(|| {
                lenses.push(Lens {
                    given: *camera,
                    units: camera.lens_units(),
                    state: [0.0; LENS_STATE_VALUES],
                });
                lenses.len() - 1
            })
        });
        let of_view = of_view.collect();
        // Panoramas have no focal lengths.
        let all_have = cameras.iter().all(|camera| camera.projection != Projection::Equirectangular);
        let dolly_zoom = DollyZoom::new(context, cameras, initial, may_scale && all_have)?;
        Ok(Self { of_view, lenses, dolly_zoom, refused: 0 })
    }

    /// The camera with its lens as it is now, if a training view was given with this lens, or else with the change of all focal
    /// lengths.
    pub fn refined(&self, camera: &Camera) -> Camera {
        let (with_lens, zoom) = (with_own_lens(camera), self.dolly_zoom.factor());
        match self.lenses.iter().find(|lens| share_lens(&lens.given, &with_lens)) {
            Some(lens) => with_lens.with_lens_parameters(&lens.parameters(zoom)),
            None if camera.projection == Projection::Equirectangular => *camera,
            None => {
                let [fx, fy] = [camera.fx, camera.fy].map(|focal| (zoom * f64::from(focal)) as f32);
                Camera { fx, fy, ..*camera }
            }
        }
    }

    /// Makes a step with the lens of a finished iteration's view, and sets it in all cameras of views that have it. A step after which
    /// the lens would fold the picture is not made.
    pub fn step(&mut self, cameras: &mut [Camera], plan: &IterationPlan, losses: &LossValues) {
        let IterationPlan { view, camera: drawn, lens_rate: rate, .. } = plan;
        let Some(gradient) = losses.lens.filter(|_| plan.work.optimizes && *rate > 0.0) else { return };
        self.dolly_zoom.step(drawn, &gradient, *rate);
        let zoom = self.dolly_zoom.factor();
        let of_view = self.of_view[*view];
        let lens = &mut self.lenses[of_view];
        let before = lens.state;
        lens.step(drawn, &gradient.parameters, zoom, *rate);
        let parameters = lens.parameters(zoom);
        if cameras[*view].with_lens_parameters(&parameters).check().is_err() {
            // The moments keep the new values, so that later steps may be smaller.
            lens.state[..LENS_PARAMETERS].copy_from_slice(&before[..LENS_PARAMETERS]);
            self.refused += 1;
            return;
        }
        let others = cameras.iter_mut().zip(&self.of_view).filter(|(_, own)| **own == of_view);
        others.for_each(|(camera, _)| *camera = camera.with_lens_parameters(&parameters));
    }

    /// Applies the zoom's last step to the scene and to the cameras of all views. A step after which a lens would fold the picture is
    /// not made.
    pub fn apply_zoom(
        &mut self,
        context: &Context,
        scene: &SceneBuffers,
        cameras: &mut [Camera],
    ) -> Result<()> {
        let ZoomState { log_factor, applied, center, .. } = self.dolly_zoom.state;
        let Some(scaling) = self.dolly_zoom.scaling.as_ref().filter(|_| log_factor != applied) else {
            return Ok(());
        };
        let zoom = f64::from(log_factor).exp();
        if self.check(zoom).is_err() {
            // The moments keep the new values, so that later steps may be smaller.
            self.dolly_zoom.state.log_factor = applied;
            self.refused += 1;
            return Ok(());
        }
        scaling.run(context, scene, center, f64::from(applied) - f64::from(log_factor))?;
        self.dolly_zoom.state.applied = log_factor;
        self.set_lenses(cameras);
        Ok(())
    }

    /// Checks all lenses at a factor of the focal lengths.
    fn check(&self, zoom: f64) -> Result<()> {
        let mut lenses = self.lenses.iter();
        lenses.try_for_each(|lens| lens.given.with_lens_parameters(&lens.parameters(zoom)).check())
    }

    fn set_lenses(&self, cameras: &mut [Camera]) {
        let zoom = self.dolly_zoom.factor();
        let parameters: Vec<_> = self.lenses.iter().map(|lens| lens.parameters(zoom)).collect();
        for (camera, &lens) in cameras.iter_mut().zip(&self.of_view) {
            *camera = camera.with_lens_parameters(&parameters[lens]);
        }
    }

    pub fn state(&self) -> LensState {
        let lenses = self.lenses.iter().map(|lens| lens.state).collect();
        LensState { lenses, zoom: Some(self.dolly_zoom.state) }
    }

    pub fn restore(&mut self, cameras: &mut [Camera], from: &LensState) -> Result<()> {
        let (there, here) = (from.lenses.len(), self.lenses.len());
        if there != here {
            return Err(Error::argument("checkpoint", format!("has {there} lenses, here are {here}")));
        }
        self.lenses.iter_mut().zip(&from.lenses).for_each(|(lens, state)| lens.state = *state);
        self.dolly_zoom.state = from.zoom.unwrap_or(self.dolly_zoom.state);
        self.check(self.dolly_zoom.factor())?;
        self.set_lenses(cameras);
        Ok(())
    }
}

impl Lens {
    /// `zoom`: factor of the focal lengths.
    fn parameters(&self, zoom: f64) -> [f32; LENS_PARAMETERS] {
        let mut parameters = self.given.lens_parameters();
        for (k, (parameter, units)) in parameters.iter_mut().zip(&self.units).enumerate() {
            let change: f64 = units.iter().zip(self.state).map(|(unit, by)| unit * f64::from(by)).sum();
            let factor = if k < 2 { zoom } else { 1.0 };
            *parameter = (factor * (f64::from(*parameter) + change)) as f32;
        }
        parameters
    }

    /// `gradient`: of the lens of the camera that was drawn, whose picture may be smaller.
    fn step(&mut self, drawn: &Camera, gradient: &[f32; LENS_PARAMETERS], zoom: f64, rate: f64) {
        let mut gradient = drawn.lens_gradient(gradient);
        let parameters = self.parameters(zoom);
        let reductions = [drawn.fx / parameters[0], drawn.fy / parameters[1]].map(f64::from);
        (0..4).for_each(|k| gradient[k] *= reductions[k % 2]);
        (0..2).for_each(|k| gradient[k] *= zoom);
        let state = &mut self.state;
        let count = f64::from(state[LENS_STATE_VALUES - 1]) + 1.0;
        state[LENS_STATE_VALUES - 1] = count as f32;
        for k in 0..LENS_PARAMETERS {
            let places = [0, 1, 2].map(|set| set * LENS_PARAMETERS + k);
            let own: f64 =
                gradient.iter().zip(&self.units).map(|(gradient, units)| gradient * units[k]).sum();
            let stepped = adam_step(places.map(|place| state[place]), own, count, rate);
            places.into_iter().zip(stepped).for_each(|(place, value)| state[place] = value);
        }
    }
}
