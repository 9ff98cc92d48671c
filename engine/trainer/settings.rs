//! The settings of a training run, under the names of the reference implementation's command line.
//!
//! Each setting is declared once, in [`TrainSettings`]: its type, default, bounds and description. The command
//! line, the TOML file, the checkpoint and the C API follow from the declaration, through
//! [`TrainSettings::OPTIONS`] or serde.

pub use super::choices::{ImportanceType, OptimizerType, SplitType, StrategyType};

use super::options::{Bounds, OptionValue, TrainOption, options};
use crate::scene::Gaussians;
use crate::scene::gaussians::MAX_SH_DEGREE;
use crate::{Error, Result};

options! {
    /// Everything that shapes a training run, apart from the data: the arguments of the reference
    /// implementation (gaussian-splatting, `arguments/__init__.py`) under their own names and with their
    /// defaults, three that it hard-codes, and later work's under the names of their papers' code.
    ///
    /// Iterations are counted from 1. With the feature `serde` the settings can be read from and written to
    /// any of its formats. Missing fields take their defaults, unknown ones are refused.
    pub struct TrainSettings {
        /// Number of iterations, one view each
        iterations: u32 = 30_000, Bounds::AtLeast(1);
        /// Highest degree of the spherical harmonics, 0 to 3
        sh_degree: u32 = 3, Bounds::AtMost(MAX_SH_DEGREE);
        /// Iterations after which the SH degree in use rises by one
        sh_degree_interval: u32 = 1000, Bounds::AtLeast(1);
        /// Learning rate of the means at the start, times the scene's extent
        position_lr_init: f64 = 1.6e-4, Bounds::Positive;
        /// Learning rate of the means at the end, times the scene's extent
        position_lr_final: f64 = 1.6e-6, Bounds::Positive;
        /// Without effect, as in the reference, whose delay lasts 0 steps
        position_lr_delay_mult: f64 = 0.01, Bounds::NotNegative;
        /// Iteration at which position_lr_final is reached
        position_lr_max_steps: u32 = 30_000, Bounds::AtLeast(1);
        /// Learning rate of the SH coefficients of degree 0; the others take a twentieth of it
        feature_lr: f64 = 2.5e-3, Bounds::NotNegative;
        /// Learning rate of the opacity logits (mcmc: 0.05)
        opacity_lr: f64 = 0.025, Bounds::NotNegative;
        /// Learning rate of the log-scales
        scaling_lr: f64 = 5e-3, Bounds::NotNegative;
        /// Learning rate of the quaternions
        rotation_lr: f64 = 1e-3, Bounds::NotNegative;
        /// Larger than this share of the scene's extent: split, else cloned
        percent_dense: f64 = 0.01, Bounds::NotNegative;
        /// Weight of 1 - SSIM in the loss; the L1 term takes the rest
        lambda_dssim: f64 = 0.2, Bounds::Share;
        /// Weight of the mean opacity in the loss (mcmc: 0.01)
        opacity_reg: f64 = 0.0, Bounds::NotNegative;
        /// Weight of the mean scale in the loss (mcmc: 0.01)
        scale_reg: f64 = 0.0, Bounds::NotNegative;
        /// Density control: the reference's, none, 3DGS-MCMC's, or budgeted growth; the last two set other defaults
        strategy: StrategyType = StrategyType::Reference, Bounds::None;
        /// Most Gaussians that the strategies mcmc and budget grow to; budget with 0: ten times those of the start, times the
        /// cube root of iterations / 30000, rounded down (budget: 0)
        cap_max: u32 = 1_000_000, Bounds::None;
        /// Rate of mcmc's noise on the means, times their learning rate
        noise_lr: f64 = 5e5, Bounds::NotNegative;
        /// Opacity of the first Gaussians (mcmc: 0.5)
        initial_opacity: f64 = INITIAL_OPACITY, Bounds::Share;
        /// Scale of the first Gaussians, times the distance of their neighbours (mcmc: 0.1)
        initial_scale: f64 = 1.0, Bounds::Positive;
        /// Iterations between densifications
        densification_interval: u32 = 100, Bounds::AtLeast(1);
        /// Iterations between opacity resets
        opacity_reset_interval: u32 = 3000, Bounds::AtLeast(1);
        /// Count what concerns the whole run in shares of 30,000 iterations: position_lr_max_steps, densify_from_iter,
        /// densify_until_iter and the groups of multi_step are multiplied by iterations / 30000 (budget: true)
        scale_schedule: bool = false, Bounds::None;
        /// Larger learning rates in runs of fewer than 30,000 iterations: position_lr_init times 30000 / iterations, at most
        /// 10; those of scales, opacities and colours times its root, at most 2 (budget: true)
        scale_rates: bool = false, Bounds::None;
        /// Densification starts after this iteration
        densify_from_iter: u32 = 500, Bounds::None;
        /// Densification, and the collection of its statistics, end before this iteration (mcmc: 25000)
        densify_until_iter: u32 = 15_000, Bounds::None;
        /// Mean norm of the 2D mean's gradient (NDC) from which a Gaussian is densified
        densify_grad_threshold: f64 = 2e-4, Bounds::NotNegative;
        /// That norm of sums of absolute values over pixels, so that opposite gradients do not cancel (AbsGS; budget: true)
        absgrad: bool = false, Bounds::None;
        /// Split a Gaussian into two drawn from it, or along its longest axis (budget: long-axis)
        split: SplitType = SplitType::Sample, Bounds::None;
        /// What the chance to be split follows with strategy budget: edges of the photographs, the gradient's statistic, nothing
        importance: ImportanceType = ImportanceType::Edges, Bounds::None;
        /// Grow to cap_max along a square root, not at once (budget: true)
        growth_curve: bool = false, Bounds::None;
        /// Prune what does not recover from opacity resets, which are milder (budget: true)
        recovery: bool = false, Bounds::None;
        /// Add up the gradients of several views before a step in the last third of the run (budget: true)
        multi_step: bool = false, Bounds::None;
        /// Learn the exposure of each photo: a 3x4 matrix that changes the rendered colours before they are compared
        exposure: bool = false, Bounds::None;
        /// Learning rate of the exposures at the start
        exposure_lr_init: f64 = 0.01, Bounds::Positive;
        /// Learning rate of the exposures at the end
        exposure_lr_final: f64 = 0.001, Bounds::Positive;
        /// Iterations over which the exposures' learning rate rises from exposure_lr_delay_mult of it to all of it
        exposure_lr_delay_steps: u32 = 0, Bounds::None;
        /// Share of the exposures' learning rate at the start of that rise
        exposure_lr_delay_mult: f64 = 0.0, Bounds::Share;
        /// Learn vignetting and response of each camera, which change the rendered colours before they are compared
        lens_effects: bool = false, Bounds::None;
        /// Learning rate of the lens effects at the start; a tenth of it at the end
        lens_lr: f64 = 5e-3, Bounds::Positive;
        /// Weight of the squared lens effects in the loss, which pulls them to none
        lens_reg: f64 = 1e-3, Bounds::NotNegative;
        /// Weight of the inverse-depth maps in the loss at the start, for views that have one
        depth_l1_weight_init: f64 = 1.0, Bounds::Positive;
        /// Weight of the inverse-depth maps in the loss at the end
        depth_l1_weight_final: f64 = 0.01, Bounds::Positive;
        /// Gaussians of a smaller opacity are pruned at a densification
        min_opacity: f64 = 0.005, Bounds::Share;
        /// White background instead of black
        white_background: bool = false, Bounds::None;
        /// A new random background colour in every iteration, so that no Gaussian paints the background
        random_background: bool = false, Bounds::None;
        /// Compensate the opacity for the screen-space dilation (Mip-Splatting's 2D filter)
        antialiasing: bool = false, Bounds::None;
        /// Take that compensation as a constant in gradients
        antialiasing_detached: bool = false, Bounds::None;
        /// Low-pass filter of the projection: variance that it adds, square pixels (Mip-Splatting: 0.1)
        kernel_size: f64 = 0.3, Bounds::Positive;
        /// Widen Gaussians to what the nearest camera resolves (Mip-Splatting's 3D filter)
        filter_3d: bool = false, Bounds::None;
        /// Optimise the poses of the training views with the scene; held-out ones are aligned to it before they are measured
        pose_opt: bool = false, Bounds::None;
        /// Learning rate of the poses at the start, world units and radians; a hundredth of it at the end
        pose_lr: f64 = 1e-5, Bounds::NotNegative;
        /// Adam on all Gaussians, or on those seen only
        optimizer_type: OptimizerType = OptimizerType::Default, Bounds::None;
        /// Seed of everything random: order of the views, split positions, random backgrounds
        seed: u32 = 0, Bounds::None;
    }
}

/// Opacity of the first Gaussians in the reference.
const INITIAL_OPACITY: f64 = 0.1;
/// Iterations of the run that schedules are given for.
const SCHEDULE_ITERATIONS: u32 = 30_000;
/// The SH coefficients above degree 0 learn at this share of `feature_lr`.
const FEATURE_REST_SHARE: f64 = 1.0 / 20.0;

/// From the first value at iteration 0 to the second one after `steps`, log-linear; constant after that.
fn log_linear([first, last]: [f64; 2], iteration: u32, steps: u32) -> f64 {
    let progress = (f64::from(iteration) / f64::from(steps)).min(1.0);
    (first.ln() * (1.0 - progress) + last.ln() * progress).exp()
}

impl TrainSettings {
    /// The defaults with a strategy. Those of 3DGS-MCMC differ in rates, initial values, regularisers and the end
    /// of densification (its README and `train.py`). Those of budgeted growth differ in the means' rates and in
    /// the threshold (Improved-GS, `arguments/__init__.py`), have all parts of it, and scale its schedule.
    pub fn of_strategy(strategy: StrategyType) -> Self {
        let usual = Self { strategy, ..Self::default() };
        match strategy {
            StrategyType::Reference | StrategyType::Fixed => usual,
            StrategyType::Budget => Self {
                position_lr_init: 4e-5,
                position_lr_final: 2e-6,
                densify_grad_threshold: 3e-4,
                cap_max: 0,
                scale_schedule: true,
                scale_rates: true,
                absgrad: true,
                split: SplitType::LongAxis,
                growth_curve: true,
                recovery: true,
                multi_step: true,
                ..usual
            },
            StrategyType::Mcmc => Self {
                opacity_lr: 0.05,
                opacity_reg: 0.01,
                scale_reg: 0.01,
                densify_until_iter: 25_000,
                initial_opacity: 0.5,
                initial_scale: 0.1,
                ..usual
            },
        }
    }

    /// Refuses options that the strategy does not have, where they differ from their defaults.
    pub(super) fn refuse(&self, strategy: &str, names: &[&str]) -> Result<()> {
        let usual = Self::default();
        for option in Self::OPTIONS.iter().filter(|option| names.contains(&option.name)) {
            let value = (option.value)(self);
            if value != (option.value)(&usual) {
                let problem = format!(
                    "is {value}, but the strategy {strategy} has no such part; leave it out, or take strategy budget"
                );
                return Err(Error::argument(option.name, problem));
            }
        }
        Ok(())
    }

    /// Gives Gaussians of the reference's opacity and scale those of the settings.
    pub fn initialize(&self, gaussians: &mut Gaussians) {
        // The usual ones keep their bits.
        if self.initial_opacity != INITIAL_OPACITY {
            let logit = (self.initial_opacity / (1.0 - self.initial_opacity)).ln() as f32;
            gaussians.opacity_logits.fill(logit);
        }
        if self.initial_scale != 1.0 {
            let change = self.initial_scale.ln() as f32;
            gaussians.log_scales.iter_mut().flatten().for_each(|log_scale| *log_scale += change);
        }
    }

    /// Checks that every value is within its bounds; the trainer calls this before any work.
    ///
    /// # Errors
    /// [`Error::Argument`] with the setting's name, its value and what would be right.
    pub fn check(&self) -> Result<()> {
        Self::OPTIONS.iter().try_for_each(|option: &TrainOption| option.check(self))?;
        match self.initial_opacity > 0.0 && self.initial_opacity < 1.0 {
            true => Ok(()),
            false => {
                let problem =
                    format!("is {}, must be between 0 and 1, and neither of them", self.initial_opacity);
                Err(Error::argument("initial_opacity", problem))
            }
        }
    }

    /// An iteration of the schedule in this run: the same, or with `scale_schedule` multiplied by `iterations`
    /// / 30,000 and rounded, so that it keeps its share of the run. Intervals and what follows an opacity reset
    /// are not scaled: statistics need as many views, and opacities as many steps, in a short run.
    pub fn scaled(&self, iteration: u32) -> u32 {
        if !self.scale_schedule {
            return iteration;
        }
        let whole = u64::from(SCHEDULE_ITERATIONS);
        let scaled = (u64::from(iteration) * u64::from(self.iterations) + whole / 2) / whole;
        scaled.min(u32::MAX.into()) as u32
    }

    /// Learning rate of the means at an iteration, in units of the scene's extent (multiply by it): log-linear
    /// from `position_lr_init`, times [`Self::position_factor`], at 0 to
    /// `position_lr_final` at `position_lr_max_steps` ([scaled](Self::scaled)), constant after that.
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

    /// Factor of the means' first learning rate: with `scale_rates` 30,000 / `iterations`, 1 to 10, so that means
    /// can travel as far in a short run. Their last rate stays: it is the precision that they end with.
    pub fn position_factor(&self) -> f64 {
        if self.scale_rates { self.shorter().min(10.0) } else { 1.0 }
    }

    /// Factor of the learning rates of scales, opacities and colours: with `scale_rates` the root of 30,000 /
    /// `iterations`, 1 to 2. By measurement (tools/strategies.md).
    pub fn rate_factor(&self) -> f64 {
        if self.scale_rates { self.shorter().sqrt().min(2.0) } else { 1.0 }
    }

    /// How many times shorter than 30,000 iterations the run is, at least 1.
    fn shorter(&self) -> f64 {
        (f64::from(SCHEDULE_ITERATIONS) / f64::from(self.iterations.max(1))).max(1.0)
    }

    /// Learning rate of the SH coefficients of degree 1 and above.
    pub fn feature_rest_lr(&self) -> f64 {
        self.feature_lr * FEATURE_REST_SHARE
    }

    /// The SH degree in use at an iteration (1-based): one more at every `sh_degree_interval`, up to `sh_degree`.
    pub fn sh_degree_at(&self, iteration: u32) -> u32 {
        (iteration / self.sh_degree_interval).min(self.sh_degree)
    }

    /// Whether statistics for densification are collected at an iteration (1-based).
    pub fn collects_statistics_at(&self, iteration: u32) -> bool {
        iteration < self.scaled(self.densify_until_iter)
    }

    /// Whether an iteration (1-based) ends with a densification.
    pub fn densifies_at(&self, iteration: u32) -> bool {
        iteration > self.scaled(self.densify_from_iter)
            && iteration < self.scaled(self.densify_until_iter)
            && iteration.is_multiple_of(self.densification_interval)
    }

    /// Whether a densification at this iteration (1-based) also prunes Gaussians that are large in the world:
    /// only after the first opacity reset.
    pub fn prunes_large_at(&self, iteration: u32) -> bool {
        iteration > self.opacity_reset_interval
    }

    /// Whether the sizes of the 3D filter are computed anew after an iteration's step (1-based), besides at the start and
    /// after each densification: every hundred iterations once densification has ended, but not in the last hundred
    /// (Mip-Splatting's train.py).
    pub fn computes_filters_at(&self, iteration: u32) -> bool {
        const INTERVAL: u32 = 100;
        self.filter_3d
            && iteration > self.densify_until_iter
            && iteration.is_multiple_of(INTERVAL)
            && iteration < self.iterations.saturating_sub(INTERVAL)
    }

    /// Whether an iteration (1-based) ends with an opacity reset. Over white, the reference also resets once
    /// at `densify_from_iter`.
    pub fn resets_opacity_at(&self, iteration: u32) -> bool {
        iteration < self.scaled(self.densify_until_iter)
            && (iteration.is_multiple_of(self.opacity_reset_interval)
                || (self.white_background && iteration == self.scaled(self.densify_from_iter)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn position_lr_is_log_linear_then_constant() {
        let settings = TrainSettings::default();
        assert!((settings.position_lr(0) - 1.6e-4).abs() < 1e-18);
        assert!((settings.position_lr(15_000) - 1.6e-5).abs() < 1e-16);
        assert!((settings.position_lr(30_000) - 1.6e-6).abs() < 1e-18);
        assert_eq!(settings.position_lr(30_001), settings.position_lr(30_000));
    }

    #[test]
    fn exposure_lr_is_log_linear_behind_its_delay() {
        let settings = TrainSettings { iterations: 100, ..Default::default() };
        for (iteration, rate) in [(0, 0.01), (50, 0.01 / 10f64.sqrt()), (100, 0.001), (200, 0.001)] {
            assert!((settings.exposure_lr(iteration) / rate - 1.0).abs() < 1e-12, "{iteration}");
        }
        let late =
            TrainSettings { exposure_lr_delay_steps: 10, exposure_lr_delay_mult: 0.2, ..settings.clone() };
        assert!((late.exposure_lr(0) - 0.002).abs() < 1e-15);
        let share = 0.2 + 0.8 * 0.5f64.sqrt();
        assert!((late.exposure_lr(5) - share * settings.exposure_lr(5)).abs() < 1e-15);
        assert_eq!(late.exposure_lr(10), settings.exposure_lr(10));
    }

    #[test]
    fn schedule_of_the_reference() {
        let settings = TrainSettings::default();
        let densified: Vec<u32> = (1..=30_000).filter(|&i| settings.densifies_at(i)).collect();
        assert_eq!((densified.first(), densified.last()), (Some(&600), Some(&14_900)));
        let resets: Vec<u32> = (1..=30_000).filter(|&i| settings.resets_opacity_at(i)).collect();
        assert_eq!(resets, [3000, 6000, 9000, 12_000]);
        assert_eq!([1, 999, 1000, 2999, 3000, 30_000].map(|i| settings.sh_degree_at(i)), [0, 0, 1, 2, 3, 3]);
        assert!(!settings.prunes_large_at(3000) && settings.prunes_large_at(3100));
    }

    #[test]
    fn schedule_of_the_3d_filter() {
        let settings = TrainSettings { filter_3d: true, ..Default::default() };
        let computed: Vec<u32> = (1..=30_000).filter(|&i| settings.computes_filters_at(i)).collect();
        assert_eq!((computed.first(), computed.last(), computed.len()), (Some(&15_100), Some(&29_800), 148));
        assert!((1..=30_000).all(|i| !TrainSettings::default().computes_filters_at(i)));
    }

    #[test]
    fn a_scaled_schedule_keeps_its_shares_of_the_run() {
        let scaled = |iterations| TrainSettings { iterations, scale_schedule: true, ..Default::default() };
        let (whole, short) = (scaled(30_000), scaled(2000));
        for iteration in [0, 1, 499, 15_000, 29_999] {
            assert_eq!(whole.scaled(iteration), iteration);
            assert_eq!(whole.position_lr(iteration), TrainSettings::default().position_lr(iteration));
        }
        assert_eq!([500, 15_000, 30_000].map(|i| short.scaled(i)), [33, 1000, 2000]);
        assert!((short.position_lr(2000) - 1.6e-6).abs() < 1e-18);
        let densified: Vec<u32> = (1..=2000).filter(|&i| short.densifies_at(i)).collect();
        assert_eq!(densified, [100, 200, 300, 400, 500, 600, 700, 800, 900]);
        // Not even a run of one iteration divides by zero.
        assert!(scaled(1).position_lr(1).is_finite());
        assert_eq!(TrainSettings { iterations: 2000, ..Default::default() }.scaled(500), 500);
    }

    #[test]
    fn shorter_runs_take_larger_steps() {
        let of = |iterations, scale_rates| TrainSettings {
            iterations,
            scale_rates,
            scale_schedule: true,
            ..Default::default()
        };
        for settings in [of(30_000, true), of(60_000, true), of(2000, false)] {
            assert_eq!(settings.position_factor(), 1.0);
            assert_eq!(settings.rate_factor(), 1.0);
        }
        let short = of(6000, true);
        assert_eq!([short.position_factor(), of(1, true).position_factor()], [5.0, 10.0]);
        assert!((short.position_lr(0) - 8e-4).abs() < 1e-15);
        assert!((short.position_lr(6000) - 1.6e-6).abs() < 1e-15);
        assert_eq!([short.rate_factor(), of(15_000, true).rate_factor()], [2.0, 2.0_f64.sqrt()]);
    }

    #[test]
    fn white_background_resets_at_the_start_of_densification() {
        let settings = TrainSettings { white_background: true, ..Default::default() };
        assert!(settings.resets_opacity_at(500));
        assert!(!TrainSettings::default().resets_opacity_at(500));
    }

    #[test]
    fn check_names_the_setting() {
        type Spoil = fn(&mut TrainSettings);
        let cases: [(&str, Spoil); 6] = [
            ("iterations", |s| s.iterations = 0),
            ("sh_degree", |s| s.sh_degree = 4),
            ("position_lr_init", |s| s.position_lr_init = 0.0),
            ("feature_lr", |s| s.feature_lr = f64::NAN),
            ("lambda_dssim", |s| s.lambda_dssim = 1.5),
            ("densification_interval", |s| s.densification_interval = 0),
        ];
        assert!(TrainSettings::default().check().is_ok());
        for (name, spoil) in cases {
            let mut settings = TrainSettings::default();
            spoil(&mut settings);
            let message = settings.check().expect_err(name).to_string();
            assert!(message.starts_with(&format!("{name}: is ")), "{message}");
        }
    }
}
