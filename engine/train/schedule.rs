//! The plan of each iteration: rates, weights, pictures, and the times of density control. It depends on the settings, the seed,
//! the iteration and the progress before it.

use super::settings::{OptimizerType, TrainSettings};
use crate::frame::{Dropout, RenderSettings};
use crate::passes::adam::{Rates, Step};
use crate::passes::appearance::AppearanceStep;
use crate::passes::poses::PoseStep;
use crate::scene::{Camera, PicturePart};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Divisors of width and height: at the start and at the end of the warm-up.
pub(super) const WARM_UP_FACTORS: [u32; 2] = [4, 2];
/// Minimum width and height of a reduced picture, pixels: four tiles by four.
const MIN_SIDE: u32 = 64;
/// Number of iterations for which the schedules are given.
const SCHEDULE_ITERATIONS: u32 = 30_000;
/// Learning rate of the SH coefficients above degree 0, as a share of `feature_lr`.
const FEATURE_REST_SHARE: f64 = 1.0 / 20.0;
/// Iterations until a scene recovers from an opacity reset: 350 to 900 on photographs, by measurement.
const RESET_RECOVERY: u32 = 1000;
/// Share of the sparse points' depth weight that is left at the end.
const DEPTH_POINTS_END: f64 = 0.01;

/// Log-linear from `first` at iteration 0 to `last` at `steps`; constant after that.
fn log_linear([first, last]: [f64; 2], iteration: u32, steps: u32) -> f64 {
    let progress = (f64::from(iteration) / f64::from(steps)).min(1.0);
    (first.ln() * (1.0 - progress) + last.ln() * progress).exp()
}

impl TrainSettings {
    /// Position of a schedule's iteration in this run: unchanged, or with `scale_schedule` multiplied by `iterations` / 30,000
    /// and rounded. Intervals and the recovery from opacity resets are not scaled, because statistics need as many views in a
    /// short run, and opacities as many steps. The SH degree's interval follows `scale_sh_degree`.
    pub fn scaled(&self, iteration: u32) -> u32 {
        if self.scale_schedule { self.share_of_run(iteration) } else { iteration }
    }

    /// Returns an iteration, or a number of iterations, multiplied by `iterations` / 30,000 and rounded.
    fn share_of_run(&self, iteration: u32) -> u32 {
        let whole = u64::from(SCHEDULE_ITERATIONS);
        let scaled = (u64::from(iteration) * u64::from(self.iterations) + whole / 2) / whole;
        scaled.min(u32::MAX.into()) as u32
    }

    /// Learning rate of the means at an iteration, in units of the scene's extent (multiply by it). Log-linear from
    /// `position_lr_init` times [`Self::position_factor`] at 0 to `position_lr_final` at `position_lr_max_steps`
    /// ([scaled](Self::scaled)), then constant.
    pub fn position_lr(&self, iteration: u32) -> f64 {
        let end = self.scaled(self.position_lr_max_steps).max(1);
        let first = self.position_lr_init * self.position_factor();
        log_linear([first, self.position_lr_final], iteration, end)
    }

    /// Weight of the inverse-depth maps at an iteration: log-linear from `depth_l1_weight_init` at 0 to
    /// `depth_l1_weight_final` at the last iteration.
    pub fn depth_l1_weight(&self, iteration: u32) -> f64 {
        log_linear([self.depth_l1_weight_init, self.depth_l1_weight_final], iteration, self.iterations)
    }

    /// Weight of the depths of sparse points at an iteration, in units of the scene's extent (multiply by it). Log-linear from
    /// `depth_points` at 0 to a hundredth of it at the last iteration.
    pub fn depth_points_weight(&self, iteration: u32) -> f64 {
        self.depth_points * log_linear([1.0, DEPTH_POINTS_END], iteration, self.iterations)
    }

    /// Dropout of an iteration (1-based). The share of omitted Gaussians rises linearly to `dropout` at the last iteration
    /// (DropGaussian, section 3.2).
    pub fn dropout_at(&self, iteration: u32) -> Option<Dropout> {
        let progress = (f64::from(iteration) / f64::from(self.iterations)).min(1.0);
        let (share, seed) = (self.dropout * progress, self.seed);
        (self.dropout > 0.0).then_some(Dropout { share, seed, iteration })
    }

    /// Learning rate of the exposures at an iteration: log-linear from `exposure_lr_init` at 0 to
    /// `exposure_lr_final` at the last iteration, less during the first `exposure_lr_delay_steps` (the
    /// reference's `get_expon_lr_func`).
    pub fn exposure_lr(&self, iteration: u32) -> f64 {
        let rate = log_linear([self.exposure_lr_init, self.exposure_lr_final], iteration, self.iterations);
        let delay = match self.exposure_lr_delay_steps {
            0 => 1.0,
            steps => {
                let risen = (f64::from(iteration) / f64::from(steps)).min(1.0);
                let from = self.exposure_lr_delay_mult;
                from + (1.0 - from) * (risen * std::f64::consts::FRAC_PI_2).sin()
            }
        };
        delay * rate
    }

    /// Learning rate of the lens effects at an iteration: log-linear from `lens_lr` at 0 to a tenth of it at the last.
    pub fn lens_lr(&self, iteration: u32) -> f64 {
        log_linear([self.lens_lr, 0.1 * self.lens_lr], iteration, self.iterations)
    }

    /// Factor of the means' first learning rate: with `scale_rates` 30,000 / `iterations`, 1 to 10, so that means can travel as
    /// far in a short run. Their last rate stays, because it determines their final precision.
    pub fn position_factor(&self) -> f64 {
        if self.scale_rates { self.shorter().min(10.0) } else { 1.0 }
    }

    /// Factor of the learning rates of scales, opacities and colours: with `scale_rates` the root of 30,000 /
    /// `iterations`, 1 to 2. By measurement (tools/strategies.md).
    pub fn rate_factor(&self) -> f64 {
        if self.scale_rates { self.shorter().sqrt().min(2.0) } else { 1.0 }
    }

    /// Ratio of 30,000 to the run's iterations, at least 1.
    fn shorter(&self) -> f64 {
        (f64::from(SCHEDULE_ITERATIONS) / f64::from(self.iterations.max(1))).max(1.0)
    }

    /// SH degree in use at an iteration (1-based): rises by one at every `sh_degree_interval`, from at least `sh_degree_start`
    /// to `sh_degree`. With `scale_sh_degree` the interval keeps its share of the run.
    pub fn sh_degree_at(&self, iteration: u32) -> u32 {
        let interval = self.sh_degree_interval;
        let interval = if self.scale_sh_degree { self.share_of_run(interval).max(1) } else { interval };
        (iteration / interval).max(self.sh_degree_start).min(self.sh_degree)
    }

    /// `sh_degree_start` of a run with these settings that resumes after an iteration of a run with the settings `before`. A
    /// longer run, which would raise the degree later, keeps the degree in use.
    pub(super) fn sh_degree_start_after(&self, before: &Self, iteration: u32) -> u32 {
        let start = self.sh_degree_start.max(before.sh_degree_start);
        let other_length = self.iterations != before.iterations;
        if self.scale_sh_degree && other_length { start.max(before.sh_degree_at(iteration)) } else { start }
    }

    /// Replaces values in `there`, a checkpoint's settings, by these where the difference does not matter. The checkpoint is
    /// from this iteration of a run with the settings `before`.
    pub(super) fn excuse_sh_degrees(&self, there: &mut Self, before: &Self, iteration: u32) {
        if self.iterations == SCHEDULE_ITERATIONS && before.iterations == SCHEDULE_ITERATIONS {
            // Unused in runs of this length. Ignored, because later presets set it.
            there.scale_sh_degree = self.scale_sh_degree;
        }
        // `sh_degree_start_after` raised it.
        if self.scale_sh_degree && self.sh_degree_start <= before.sh_degree_at(iteration) {
            there.sh_degree_start = self.sh_degree_start;
        }
    }

    /// True if an iteration (1-based) collects statistics for densification.
    pub fn collects_statistics_at(&self, iteration: u32) -> bool {
        iteration < self.scaled(self.densify_until_iter)
    }

    /// True if an iteration (1-based) ends with a densification.
    pub fn densifies_at(&self, iteration: u32) -> bool {
        iteration > self.scaled(self.densify_from_iter)
            && iteration < self.scaled(self.densify_until_iter)
            && iteration.is_multiple_of(self.densification_interval)
    }

    /// The last iteration (1-based) before the run's last that ends with a densification, if one does.
    pub fn last_densification(&self) -> Option<u32> {
        (1..self.iterations).rev().find(|&iteration| self.densifies_at(iteration))
    }

    /// True if a densification at this iteration (1-based) also prunes Gaussians that are large in the world: only after the
    /// first opacity reset.
    pub fn prunes_large_at(&self, iteration: u32) -> bool {
        iteration > self.opacity_reset_interval
    }

    /// True if the 3D filter's sizes are recomputed after an iteration's step (1-based), besides at the start and after each
    /// densification. That is every hundred iterations after densification has ended, except in the last hundred
    /// (Mip-Splatting's train.py).
    pub fn computes_filters_at(&self, iteration: u32) -> bool {
        const INTERVAL: u32 = 100;
        self.filter_3d
            && iteration > self.scaled(self.densify_until_iter)
            && iteration.is_multiple_of(INTERVAL)
            && iteration < self.iterations.saturating_sub(INTERVAL)
    }

    /// Factor of the Gaussians' learning rates at an iteration (1-based): see [`TrainSettings::decay_last`].
    pub fn final_decay(&self, iteration: u32) -> f64 {
        let left = f64::from(self.iterations.saturating_sub(iteration));
        (left / (f64::from(self.iterations) * self.decay_last)).min(1.0)
    }

    /// True if an iteration (1-based) ends with an opacity reset. Over white, the reference also resets once at
    /// `densify_from_iter`. A reset from which the run cannot [recover](Self::reset_recovery) before its end is omitted.
    pub fn resets_opacity_at(&self, iteration: u32) -> bool {
        self.is_reset_planned_at(iteration) && !self.is_too_late_for_reset(iteration)
    }

    /// Number of iterations after an opacity reset in which a scene is worse than before it: 1000, or half of the interval
    /// between resets if that is shorter.
    pub fn reset_recovery(&self) -> u32 {
        RESET_RECOVERY.min(self.opacity_reset_interval / 2)
    }

    /// True if a run with these settings omitted the reset of an iteration only because it was near its end.
    pub(super) fn left_out_reset_at(&self, iteration: u32) -> bool {
        self.is_reset_planned_at(iteration) && self.is_too_late_for_reset(iteration)
    }

    fn is_reset_planned_at(&self, iteration: u32) -> bool {
        iteration < self.scaled(self.densify_until_iter)
            && (iteration.is_multiple_of(self.opacity_reset_interval)
                || (self.white_background && iteration == self.scaled(self.densify_from_iter)))
    }

    fn is_too_late_for_reset(&self, iteration: u32) -> bool {
        self.iterations.saturating_sub(iteration) < self.reset_recovery()
    }

    /// Last iteration of the warm-up: `warm_up`, but at most half of the iterations.
    pub fn warm_up_end(&self) -> u32 {
        self.warm_up.min(self.iterations / 2)
    }

    /// Camera that draws a view at an iteration (1-based). It has a quarter of the size up to half of
    /// [the warm-up](Self::warm_up_end), and half of the size up to its end. It is reduced less if a side would have fewer than
    /// 64 pixels. The first iteration is whole, because it shows the memory that whole frames take.
    pub fn warm_up_camera(&self, iteration: u32, camera: &Camera) -> Camera {
        let end = self.warm_up_end();
        let wanted = match iteration {
            _ if iteration > end || iteration <= 1 => 1,
            _ if iteration > end / 2 => WARM_UP_FACTORS[1],
            _ => WARM_UP_FACTORS[0],
        };
        let fits = |&factor: &u32| {
            // A panorama must stay whole.
            let whole = camera.whole();
            let divides = [whole.width, whole.height].iter().all(|side| side.is_multiple_of(factor));
            let is_whole = divides || !camera.projection.has_seam();
            factor <= wanted && camera.width.min(camera.height) / factor >= MIN_SIDE && is_whole
        };
        WARM_UP_FACTORS.into_iter().find(fits).map_or(*camera, |factor| reduced(camera, factor))
    }

    /// Camera of a view at all sizes that training draws, its own first.
    pub(super) fn sizes_of_camera(&self, camera: &Camera) -> Vec<Camera> {
        let of = |iteration: u32| self.warm_up_camera(iteration, camera);
        let mut sizes = vec![*camera, of(2), of(self.warm_up_end())];
        sizes.dedup();
        sizes
    }

    /// Render settings of training, without the random background.
    pub fn render_settings(&self) -> RenderSettings {
        RenderSettings {
            antialias: self.antialiasing,
            antialias_detached: self.antialiasing_detached,
            dilation_px2: self.kernel_size as f32,
            distance_order: self.distance_order,
            filter_3d: self.filter_3d,
            background: [f32::from(u8::from(self.white_background)); 3],
            ..RenderSettings::default()
        }
    }
}

/// Camera of a picture with 1 / `factor` of the width and height: its pixels are squares of `factor` pixels. The remainder at
/// the right and at the bottom is cut off.
fn reduced(camera: &Camera, factor: u32) -> Camera {
    let by = factor as f32;
    let part = camera.part.map(|part| PicturePart {
        left: part.left / factor,
        top: part.top / factor,
        whole_width: part.whole_width / factor,
        whole_height: part.whole_height / factor,
    });
    Camera {
        part,
        fx: camera.fx / by,
        fy: camera.fy / by,
        cx: camera.cx / by,
        cy: camera.cy / by,
        width: camera.width / factor,
        height: camera.height / factor,
        ..*camera
    }
}

/// Estimates the instances of a frame at the size of `camera` from a frame of `drawn` with these instances and visible
/// Gaussians. Assumes square footprints of equal size.
pub(super) fn whole_instances(camera: &Camera, drawn: &Camera, instances: u32, visible: u32) -> u32 {
    let factor = f64::from(camera.width / drawn.width);
    let tiles = f64::from(instances) / f64::from(visible.max(1));
    let side = 1.0 + factor * (tiles.max(1.0).sqrt() - 1.0);
    (f64::from(visible) * side * side).max(f64::from(instances)).min(f64::from(u32::MAX)) as u32
}

/// Work between two steps: a set of up to 32 actions. The strategy interprets them. The two named actions also tell the program
/// whether the scene is complete, so a strategy must use them in their sense.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Actions(pub u32);

impl Actions {
    /// Empty set.
    pub const NONE: Self = Self(0);
    /// A densification.
    pub const DENSIFY: Self = Self(1);
    /// An opacity reset.
    pub const RESET_OPACITY: Self = Self(2);

    /// Returns the union of both sets.
    #[must_use]
    pub const fn and(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Returns the set if the condition holds, otherwise the empty set.
    #[must_use]
    pub const fn when(self, condition: bool) -> Self {
        if condition { self } else { Self::NONE }
    }

    /// Returns the set without the actions of another set.
    #[must_use]
    pub const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// True if all actions of another set are in this one.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// True if the set is empty.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Returns the action with the lowest bit, which comes first.
    #[must_use]
    pub const fn first(self) -> Self {
        Self(self.0 & self.0.wrapping_neg())
    }
}

/// Part of an iteration's work that the strategy decides.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepWork {
    /// True if the backward pass adds to the statistics ([`Population::statistics`](super::Population::statistics)).
    pub accumulates: bool,
    /// True if the optimiser makes a step.
    pub optimizes: bool,
    /// True if that step moves the opacities.
    pub optimizes_opacity: bool,
    /// Work before the next iteration.
    pub actions: Actions,
}

/// Inputs of a run, apart from the photographs.
pub(super) struct TrainingRun {
    pub settings: TrainSettings,
    /// World units.
    pub scene_extent: f32,
    /// One per view.
    pub cameras: Vec<Camera>,
    /// Lens index of each view, counted from 0 in the order of the camera ids.
    pub lens_of_view: Vec<u32>,
    pub views_fingerprint: u64,
}

/// Progress of a run between two iterations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Progress {
    /// Number of finished iterations.
    pub iteration: u32,
    /// Number of optimiser steps. Skipped iterations make none, and the strategy can omit some.
    pub steps: u64,
    pub opacity_steps: u64,
    /// Work before the next iteration.
    pub due: Actions,
}

impl Progress {
    pub fn after(&self, plan: &IterationPlan) -> Self {
        let StepWork { optimizes, optimizes_opacity, actions, .. } = plan.work;
        Self {
            iteration: plan.iteration,
            steps: self.steps + u64::from(optimizes),
            opacity_steps: self.opacity_steps + u64::from(optimizes && optimizes_opacity),
            due: actions,
        }
    }
}

/// The work of an iteration.
#[derive(Clone, Copy, Debug)]
pub(super) struct IterationPlan {
    pub iteration: u32,
    pub view: usize,
    /// Camera that draws the view: its own, or one of a smaller picture.
    pub camera: Camera,
    pub work: StepWork,
    pub sh_degree: u32,
    pub settings: RenderSettings,
    pub step: Step,
    /// True if the 3D filter's sizes are recomputed after the step.
    pub computes_filters: bool,
    pub exposure: AppearanceStep,
    /// Step of the lens effects, if they are learned.
    pub lens_effects: AppearanceStep,
    /// Step of the poses, if they are optimised.
    pub pose_step: PoseStep,
    /// Rate of the lenses, if they are optimised.
    pub lens_rate: f64,
}

impl IterationPlan {
    /// Plan with the optimiser's step and the statistics for the given view, for a recording that never executes.
    pub fn rehearsal(self, view: usize, camera: Camera) -> Self {
        let work = StepWork { optimizes: true, accumulates: true, ..self.work };
        Self { view, camera, work, ..self }
    }
}

/// Makes the plans of iterations.
pub(super) struct Schedule {
    order: ViewOrder,
    /// Render settings of training, without the random parts.
    base_settings: RenderSettings,
}

impl Schedule {
    pub fn new(run: &TrainingRun, base_settings: &RenderSettings) -> Self {
        Self { order: ViewOrder::new(run.settings.seed, run.cameras.len()), base_settings: *base_settings }
    }

    /// Plan of the next iteration. `work` is the strategy's choice for it.
    pub fn plan_after(
        &mut self,
        progress: &Progress,
        run: &TrainingRun,
        mut work: StepWork,
    ) -> IterationPlan {
        let iteration = progress.iteration + 1;
        let s = &run.settings;
        // The reference's last iteration only saves.
        work.optimizes &= iteration < s.iterations;
        let view = self.order.view(iteration);
        let exposure = AppearanceStep {
            rate: s.exposure_lr(iteration),
            count: progress.steps + 1,
            decay: 2.0 * s.exposure_reg,
            sparsity: s.exposure_sparsity,
        };
        IterationPlan {
            iteration,
            view,
            camera: s.warm_up_camera(iteration, &run.cameras[view]),
            work,
            sh_degree: s.sh_degree_at(iteration),
            settings: RenderSettings {
                background: background(s, iteration),
                dropout: s.dropout_at(iteration),
                ..self.base_settings
            },
            step: optimizer_step(run, iteration, progress, &work),
            computes_filters: s.computes_filters_at(iteration),
            exposure,
            lens_effects: AppearanceStep {
                rate: s.lens_lr(iteration),
                decay: 2.0 * s.lens_reg,
                sparsity: 0.0,
                ..exposure
            },
            // Poses make a step whenever the Gaussians do.
            pose_step: PoseStep { rate: falling(s.pose_lr, s, iteration), count: progress.steps + 1 },
            lens_rate: lens_rate(s, iteration),
        }
    }
}

/// Rate of the lenses: 0 in the first third of the run, then constant, and from seven tenths on log-linear to a hundredth. Early
/// scenes leave parts of photographs empty, which would distort the lenses.
fn lens_rate(s: &TrainSettings, iteration: u32) -> f64 {
    let share = f64::from(iteration) / f64::from(s.iterations);
    let falls = ((share - 0.7) / 0.3).max(0.0);
    if share < 1.0 / 3.0 { 0.0 } else { s.lens_opt_lr * 0.01_f64.powf(falls) }
}

/// Log-linear from a rate at 0 to a hundredth of it at the last iteration.
fn falling(rate: f64, s: &TrainSettings, iteration: u32) -> f64 {
    rate * 0.01_f64.powf(f64::from(iteration) / f64::from(s.iterations))
}

fn optimizer_step(run: &TrainingRun, iteration: u32, progress: &Progress, work: &StepWork) -> Step {
    let s = &run.settings;
    let decay = s.final_decay(iteration);
    let others = s.rate_factor() * decay;
    let rates = Rates {
        mean: s.position_lr(iteration) * f64::from(run.scene_extent) * decay,
        opacity: if work.optimizes_opacity { s.opacity_lr * others } else { 0.0 },
        quat: s.rotation_lr * decay,
        log_scale: s.scaling_lr * others,
        sh_dc: s.feature_lr * others,
        sh_rest: s.feature_lr * FEATURE_REST_SHARE * others,
    };
    let (count, opacity_count) = match s.optimizer_type {
        OptimizerType::SparseAdam => (0, 0),
        OptimizerType::Default => (progress.steps + 1, progress.opacity_steps + 1),
    };
    Step { rates, count, opacity_count, seed: s.seed, iteration }
}

/// Random streams of a run; the seed determines them all.
const STREAM_VIEWS: u64 = 1;
const STREAM_BACKGROUND: u64 = 2;
const STREAM_POOL: u64 = 3;

fn generator(seed: u32, stream: u64, counter: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(u64::from(seed));
    rng.set_stream(stream);
    // Each counter has 2^20 words of its own, far more than an iteration draws.
    rng.set_word_pos(u128::from(counter) << 20);
    rng
}

/// Endless sequence of views: each view once per epoch, in random order.
#[derive(Clone)]
pub(super) struct ViewOrder {
    seed: u32,
    stream: u64,
    pub views: usize,
    epoch: u64,
    order: Vec<usize>,
}

impl ViewOrder {
    /// Order of the iterations' views.
    pub fn new(seed: u32, views: usize) -> Self {
        Self { seed, stream: STREAM_VIEWS, views, epoch: u64::MAX, order: Vec::new() }
    }

    /// View of an iteration, counted from 1. It depends only on the seed and the iteration.
    pub fn view(&mut self, iteration: u32) -> usize {
        self.at(u64::from(iteration) - 1)
    }

    fn at(&mut self, place: u64) -> usize {
        let views = self.views as u64;
        let epoch = place / views;
        if epoch != self.epoch {
            self.order = (0..self.views).collect();
            self.order.shuffle(&mut generator(self.seed, self.stream, epoch));
            self.epoch = epoch;
        }
        self.order[(place % views) as usize]
    }
}

/// Returns the views at these places of an endless sequence. Each epoch of it has all views, in a new random order.
pub(super) fn pool_views(seed: u32, views: usize, places: std::ops::Range<u64>) -> Vec<usize> {
    let mut order = ViewOrder { stream: STREAM_POOL, ..ViewOrder::new(seed, views) };
    places.map(|place| order.at(place)).collect()
}

/// Background of an iteration: r, g, b.
fn background(settings: &TrainSettings, iteration: u32) -> [f32; 3] {
    if !settings.random_background {
        return settings.render_settings().background;
    }
    let mut rng = generator(settings.seed, STREAM_BACKGROUND, iteration.into());
    [rng.random(), rng.random(), rng.random()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Intrinsics;
    use glam::{Mat3, Vec3};

    fn run_of(iterations: u32) -> TrainSettings {
        TrainSettings { iterations, ..TrainSettings::reference() }
    }

    /// Iterations of a run for which this holds.
    fn all(settings: &TrainSettings, holds: fn(&TrainSettings, u32) -> bool) -> Vec<u32> {
        (1..=settings.iterations).filter(|&iteration| holds(settings, iteration)).collect()
    }

    #[test]
    fn the_sh_degree_rises() {
        let from = |sh_degree_start, sh_degree| TrainSettings {
            sh_degree_start,
            sh_degree,
            sh_degree_interval: 10,
            ..TrainSettings::reference()
        };
        let scaled = |iterations| TrainSettings { scale_sh_degree: true, ..run_of(iterations) };
        let cases: [(&str, TrainSettings, &[u32], &[u32]); 8] = [
            ("reference", run_of(30_000), &[1, 999, 1000, 2999, 3000, 30_000], &[0, 0, 1, 2, 3, 3]),
            ("from degree 0", from(0, 3), &[1, 9, 10, 20, 29, 30, 99], &[0, 0, 1, 2, 2, 3, 3]),
            ("from degree 2", from(2, 3), &[1, 9, 10, 20, 29, 30, 99], &[2, 2, 2, 2, 2, 3, 3]),
            ("to degree 1", from(3, 1), &[1, 9, 10, 20, 29, 30, 99], &[1; 7]),
            ("30,000 scaled", scaled(30_000), &[999, 1000, 2000, 3000, 30_000], &[0, 1, 2, 3, 3]),
            // 1000 of 30,000 correspond to 66.7 of 2000.
            ("2000 scaled", scaled(2000), &[66, 67, 134, 200, 201], &[0, 1, 2, 2, 3]),
            ("60,000 scaled", scaled(60_000), &[1999, 2000, 4000, 5999, 6000], &[0, 1, 2, 2, 3]),
            // A run of one iteration must not divide by zero.
            ("1 scaled", scaled(1), &[0, 1, 2, 3, 4], &[0, 1, 2, 3, 3]),
        ];
        for (name, settings, iterations, degrees) in cases {
            let found: Vec<u32> = iterations.iter().map(|&i| settings.sh_degree_at(i)).collect();
            assert_eq!(found, degrees, "{name}");
        }
    }

    /// 2000 iterations with degree 3, then 30,000, which reach degree 3 at iteration 3000.
    #[test]
    fn a_longer_run_keeps_the_sh_degree_in_use() {
        let of = |iterations, sh_degree_start| TrainSettings {
            sh_degree_start,
            scale_sh_degree: true,
            ..run_of(iterations)
        };
        let (short, longer) = (of(2000, 0), of(30_000, 0));
        assert_eq!((longer.sh_degree_start_after(&short, 2000), longer.sh_degree_at(2001)), (3, 2));
        assert_eq!(longer.sh_degree_start_after(&short, 100), 1);
        assert_eq!(short.sh_degree_start_after(&short, 2000), 0);
        // The run resumes once more, with the settings as given.
        let raised = of(30_000, 3);
        assert_eq!(longer.sh_degree_start_after(&raised, 2500), 3);
        let excused = |here: &TrainSettings, before: &TrainSettings, iteration| {
            let mut there = before.clone();
            here.excuse_sh_degrees(&mut there, before, iteration);
            there
        };
        assert_eq!(excused(&longer, &raised, 2500), longer);
        // If the degree is not in use yet, another start is another training.
        assert_eq!(excused(&of(2000, 3), &short, 100), short);
    }

    #[test]
    fn rates_and_weights_are_log_linear() {
        type Value = fn(&TrainSettings, u32) -> f64;
        let position: Value = TrainSettings::position_lr;
        let exposure: Value = TrainSettings::exposure_lr;
        let (run, short) = (run_of(30_000), run_of(100));
        let late =
            TrainSettings { exposure_lr_delay_steps: 10, exposure_lr_delay_mult: 0.2, ..short.clone() };
        let scaled = TrainSettings { scale_schedule: true, ..run_of(2000) };
        let faster = TrainSettings { scale_schedule: true, scale_rates: true, ..run_of(6000) };
        let depths = TrainSettings { depth_points: 0.5, ..run_of(400) };
        let points: Value = TrainSettings::depth_points_weight;
        let maps: Value = TrainSettings::depth_l1_weight;
        let risen = 0.2 + 0.8 * 0.5_f64.sqrt();
        for (name, settings, value, iteration, expected, tolerance) in [
            ("means", &run, position, 0, 1.6e-4, 1e-18),
            ("means", &run, position, 15_000, 1.6e-5, 1e-16),
            ("means", &run, position, 30_000, 1.6e-6, 1e-18),
            ("means", &run, position, 30_001, run.position_lr(30_000), 0.0),
            ("means of a scaled run", &scaled, position, 2000, 1.6e-6, 1e-18),
            ("means with larger rates", &faster, position, 0, 8e-4, 1e-15),
            ("means with larger rates", &faster, position, 6000, 1.6e-6, 1e-15),
            ("exposures", &short, exposure, 0, 0.01, 1e-14),
            ("exposures", &short, exposure, 50, 0.01 / 10_f64.sqrt(), 3e-15),
            ("exposures", &short, exposure, 100, 0.001, 1e-15),
            ("exposures", &short, exposure, 200, 0.001, 1e-15),
            ("exposures with a delay", &late, exposure, 0, 0.002, 1e-15),
            ("exposures with a delay", &late, exposure, 5, risen * short.exposure_lr(5), 1e-15),
            ("exposures with a delay", &late, exposure, 10, short.exposure_lr(10), 0.0),
            ("points", &depths, points, 0, 0.5, 5e-13),
            ("points", &depths, points, 200, 0.05, 5e-14),
            ("points", &depths, points, 400, 0.005, 5e-15),
            ("maps", &depths, maps, 0, 1.0, 1e-12),
            ("maps", &depths, maps, 200, 0.1, 1e-13),
            ("maps", &depths, maps, 400, 0.01, 1e-14),
        ] {
            let found = value(settings, iteration);
            assert!((found - expected).abs() <= tolerance, "{name} at {iteration}: {found}, not {expected}");
        }
    }

    #[test]
    fn rates_fall_to_zero_at_the_end() {
        let settings = TrainSettings { decay_last: 0.1, ..run_of(1000) };
        let found = [1, 900, 950, 999, 1000].map(|iteration| settings.final_decay(iteration));
        assert_eq!(found, [1.0, 1.0, 0.5, 0.01, 0.0]);
        assert_eq!(TrainSettings::reference().final_decay(29_999), 1.0);
    }

    #[test]
    fn schedule_of_the_reference() {
        let settings = TrainSettings::reference();
        let densified = all(&settings, TrainSettings::densifies_at);
        assert_eq!((densified.first(), densified.last()), (Some(&600), Some(&14_900)));
        assert_eq!(all(&settings, TrainSettings::resets_opacity_at), [3000, 6000, 9000, 12_000]);
        assert!(!settings.prunes_large_at(3000) && settings.prunes_large_at(3100));
    }

    #[test]
    fn schedule_of_the_3d_filter() {
        let settings = TrainSettings { filter_3d: true, ..Default::default() };
        let computed = all(&settings, TrainSettings::computes_filters_at);
        assert_eq!((computed.first(), computed.last(), computed.len()), (Some(&15_100), Some(&29_800), 148));
        assert_eq!(all(&TrainSettings::reference(), TrainSettings::computes_filters_at), [0; 0]);
        // Scaled densification ends at 1000 of 2000 iterations.
        let short = TrainSettings { iterations: 2000, scale_schedule: true, ..settings };
        let computed = all(&short, TrainSettings::computes_filters_at);
        assert_eq!(computed, [1100, 1200, 1300, 1400, 1500, 1600, 1700, 1800]);
    }

    #[test]
    fn a_scaled_schedule_keeps_its_shares_of_the_run() {
        let scaled = |iterations| TrainSettings { scale_schedule: true, ..run_of(iterations) };
        let (whole, short) = (scaled(30_000), scaled(2000));
        for iteration in [0, 1, 499, 15_000, 29_999] {
            assert_eq!(whole.scaled(iteration), iteration);
            assert_eq!(whole.position_lr(iteration), TrainSettings::reference().position_lr(iteration));
        }
        assert_eq!([500, 15_000, 30_000].map(|i| short.scaled(i)), [33, 1000, 2000]);
        let densified = all(&short, TrainSettings::densifies_at);
        assert_eq!(densified, [100, 200, 300, 400, 500, 600, 700, 800, 900]);
        // A run of one iteration must not divide by zero.
        assert!(scaled(1).position_lr(1).is_finite());
        assert_eq!(run_of(2000).scaled(500), 500);
    }

    #[test]
    fn shorter_runs_take_larger_steps() {
        let factors = |iterations, scale_rates| {
            let settings = TrainSettings { scale_rates, scale_schedule: true, ..run_of(iterations) };
            [settings.position_factor(), settings.rate_factor()]
        };
        for (iterations, scales, expected) in [
            (30_000, true, [1.0, 1.0]),
            (60_000, true, [1.0, 1.0]),
            (2000, false, [1.0, 1.0]),
            (15_000, true, [2.0, 2.0_f64.sqrt()]),
            (6000, true, [5.0, 2.0]),
            (1, true, [10.0, 2.0]),
        ] {
            assert_eq!(factors(iterations, scales), expected, "{iterations} {scales}");
        }
    }

    #[test]
    fn a_run_ends_without_a_reset_that_it_does_not_recover_from() {
        for (iterations, opacity_reset_interval, expected) in [
            (3030, 3000, &[][..]),
            (3999, 3000, &[]),
            (4000, 3000, &[3000]),
            (6500, 3000, &[3000]),
            (7000, 3000, &[3000, 6000]),
            // Short intervals shorten the recovery.
            (650, 200, &[200, 400]),
        ] {
            let settings = TrainSettings { opacity_reset_interval, ..run_of(iterations) };
            assert_eq!(all(&settings, TrainSettings::resets_opacity_at), expected, "{iterations}");
        }
        // Over white there is a reset where densification starts.
        let resets = |iterations, white_background| {
            TrainSettings { white_background, ..run_of(iterations) }.resets_opacity_at(500)
        };
        assert_eq!([resets(1499, true), resets(1500, true), resets(30_000, true)], [false, true, true]);
        assert!(!resets(30_000, false));
    }

    #[test]
    fn dropout_rises_to_its_share_at_the_end() {
        let settings = TrainSettings { dropout: 0.2, seed: 5, ..run_of(400) };
        for (iteration, share) in [(0, 0.0), (100, 0.05), (400, 0.2), (500, 0.2)] {
            let dropout = settings.dropout_at(iteration).expect("some");
            assert!((dropout.share - share).abs() < 1e-15);
            assert_eq!((dropout.seed, dropout.iteration), (5, iteration));
        }
        assert_eq!(TrainSettings::reference().dropout_at(9), None);
        let message = TrainSettings { dropout: 0.95, ..settings }.check().expect_err("refused").to_string();
        assert!(message.starts_with("dropout: is 0.95"), "{message}");
    }

    #[test]
    fn a_pool_is_used_up_before_it_is_refilled() {
        let drawn = pool_views(7, 6, 0..18);
        for epoch in drawn.chunks(6) {
            let mut sorted = epoch.to_vec();
            sorted.sort_unstable();
            assert_eq!(sorted, [0, 1, 2, 3, 4, 5]);
        }
        assert!(drawn[..6] != drawn[6..12] || drawn[..6] != drawn[12..]);
        assert_eq!(pool_views(7, 6, 4..9), drawn[4..9]);
        assert!(pool_views(8, 6, 0..18) != drawn);
        assert_eq!(pool_views(7, 1, 3..5), [0, 0]);
    }

    fn camera(width: u32, height: u32) -> Camera {
        Camera::with_pose(Mat3::IDENTITY, Vec3::ZERO, Intrinsics::from_fov_x(1.0, width, height))
    }

    #[test]
    fn pictures_are_a_quarter_then_half_then_whole() {
        let settings = TrainSettings { warm_up: 500, ..TrainSettings::reference() };
        let of =
            |width, height| Camera { fx: 300.0, fy: 310.0, cx: 151.0, cy: 99.0, ..camera(width, height) };
        // Small photographs are reduced less, or not at all.
        for (iteration, whole, expected) in [
            (1, (303, 259), (303, 259)),
            (2, (303, 259), (75, 64)),
            (250, (303, 259), (75, 64)),
            (251, (303, 259), (151, 129)),
            (500, (303, 259), (151, 129)),
            (501, (303, 259), (303, 259)),
            (9999, (303, 259), (303, 259)),
            (2, (303, 255), (151, 127)),
            (2, (400, 127), (400, 127)),
        ] {
            let drawn = settings.warm_up_camera(iteration, &of(whole.0, whole.1));
            assert_eq!((drawn.width, drawn.height), expected, "{iteration} {whole:?}");
        }
        let drawn = settings.warm_up_camera(2, &of(303, 259));
        assert_eq!([drawn.fx, drawn.fy, drawn.cx, drawn.cy], [75.0, 77.5, 37.75, 24.75]);
        let part = of(800, 640).part([160, 80], [400, 320]).expect("a part");
        let whole = settings.warm_up_camera(2, &of(800, 640));
        assert_eq!(settings.warm_up_camera(2, &part), whole.part([40, 20], [100, 80]).expect("its part"));
        assert_eq!(TrainSettings::reference().warm_up_camera(2, &part), part);
    }

    #[test]
    fn short_runs_have_a_warm_up_of_their_half() {
        let end = |iterations| TrainSettings { warm_up: 500, ..run_of(iterations) }.warm_up_end();
        assert_eq!([0, 1, 2, 600, 1000, 2000].map(end), [0, 0, 1, 300, 500, 500]);
    }
}
