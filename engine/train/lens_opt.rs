//! Lenses of the training views, optimised with the scene.
//!
//! Views with the same lens share it. Adam works on the host, in units that move the picture by a focal length
//! ([`Camera::lens_units`]). Its result depends on nothing but the gradients, so a resumed run has the same bits. A pinhole becomes
//! a lens without distortion, which learns distortion too.

use super::schedule::IterationPlan;
use super::step::LossValues;
use crate::error::{Error, Result};
use crate::passes::adam::{BETA_1, BETA_2};
use crate::passes::poses::{WEIGHT_DECAY, adam_on_host};
use crate::scene::{Camera, LENS_PARAMETERS, Projection};

/// Values of a lens in a checkpoint: see [`LensState`].
pub const LENS_STATE_VALUES: usize = 3 * LENS_PARAMETERS + 1;

/// Lenses that are optimised, one row each, in the order of the first views that have them: the changes of the focal lengths, the
/// principal point and the coefficients, in the units of the optimiser; Adam's first and second moments of each; the number of steps.
pub type LensState = Vec<[f32; LENS_STATE_VALUES]>;

/// The lenses of a run that optimises them.
pub(super) struct LensOptimizer {
    lenses: Vec<Lens>,
    /// Index of each view's lens.
    of_view: Vec<usize>,
    /// Number of steps that were not made.
    pub refused: u32,
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

impl LensOptimizer {
    /// Starts with the lenses of these cameras.
    pub fn new(cameras: &[Camera]) -> Self {
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
        Self { of_view: of_view.collect(), lenses, refused: 0 }
    }

    /// The camera with its lens as it is now, if a training view was given with this lens.
    pub fn refined(&self, camera: &Camera) -> Camera {
        let with_lens = with_own_lens(camera);
        let lens = self.lenses.iter().find(|lens| share_lens(&lens.given, &with_lens));
        lens.map_or(*camera, |lens| with_lens.with_lens_parameters(&lens.parameters()))
    }

    /// Makes a step with the lens of a finished iteration's view, and sets it in all cameras of views that have it. A step after which
    /// the lens would fold the picture is not made.
    pub fn step(&mut self, cameras: &mut [Camera], plan: &IterationPlan, losses: &LossValues) {
        let IterationPlan { view, camera: drawn, lens_rate: rate, .. } = plan;
        let Some(gradient) = losses.lens.filter(|_| plan.work.optimizes) else { return };
        let of_view = self.of_view[*view];
        let lens = &mut self.lenses[of_view];
        let before = lens.state;
        lens.step(drawn, &gradient, *rate);
        let parameters = lens.parameters();
        if cameras[*view].with_lens_parameters(&parameters).check().is_err() {
            // The moments keep the new values, so that later steps may be smaller.
            lens.state[..LENS_PARAMETERS].copy_from_slice(&before[..LENS_PARAMETERS]);
            self.refused += 1;
            return;
        }
        let others = cameras.iter_mut().zip(&self.of_view).filter(|(_, own)| **own == of_view);
        others.for_each(|(camera, _)| *camera = camera.with_lens_parameters(&parameters));
    }

    pub fn state(&self) -> LensState {
        self.lenses.iter().map(|lens| lens.state).collect()
    }

    pub fn restore(&mut self, cameras: &mut [Camera], from: &LensState) -> Result<()> {
        if from.len() != self.lenses.len() {
            let (there, here) = (from.len(), self.lenses.len());
            return Err(Error::argument("checkpoint", format!("has {there} lenses, here are {here}")));
        }
        self.lenses.iter_mut().zip(from).for_each(|(lens, state)| lens.state = *state);
        for (camera, &lens) in cameras.iter_mut().zip(&self.of_view) {
            *camera = camera.with_lens_parameters(&self.lenses[lens].parameters());
        }
        Ok(())
    }
}

impl Lens {
    fn parameters(&self) -> [f32; LENS_PARAMETERS] {
        let mut parameters = self.given.lens_parameters();
        for (parameter, units) in parameters.iter_mut().zip(&self.units) {
            let change: f64 = units.iter().zip(self.state).map(|(unit, by)| unit * f64::from(by)).sum();
            *parameter = (f64::from(*parameter) + change) as f32;
        }
        parameters
    }

    /// `gradient`: of the lens of the camera that was drawn, whose picture may be smaller.
    fn step(&mut self, drawn: &Camera, gradient: &[f32; LENS_PARAMETERS], rate: f64) {
        let mut gradient = drawn.lens_gradient(gradient);
        let parameters = self.parameters();
        let shares = [drawn.fx / parameters[0], drawn.fy / parameters[1]].map(f64::from);
        (0..4).for_each(|k| gradient[k] *= shares[k % 2]);
        let state = &mut self.state;
        let count = f64::from(state[LENS_STATE_VALUES - 1]) + 1.0;
        state[LENS_STATE_VALUES - 1] = count as f32;
        let bias = [BETA_1, BETA_2].map(|beta| 1.0 - beta.powf(count));
        for k in 0..LENS_PARAMETERS {
            let [change, mut first, mut second] =
                [0, 1, 2].map(|set| f64::from(state[set * LENS_PARAMETERS + k]));
            let own: f64 =
                gradient.iter().zip(&self.units).map(|(gradient, units)| gradient * units[k]).sum();
            let g = if own.abs() < 1e15 { own } else { 0.0 } + WEIGHT_DECAY * change;
            let change = change - adam_on_host([&mut first, &mut second], g, bias, rate);
            for (set, value) in [change, first, second].into_iter().enumerate() {
                state[set * LENS_PARAMETERS + k] = value as f32;
            }
        }
    }
}
