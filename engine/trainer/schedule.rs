//! Values of the settings at an iteration: rates, weights, and the times of density control.

use super::settings::TrainSettings;
use crate::forward::Dropout;

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

    /// Learning rate of the SH coefficients of degree 1 and above.
    pub fn feature_rest_lr(&self) -> f64 {
        self.feature_lr * FEATURE_REST_SHARE
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
            // Without effect here. Ignored, because later presets set it.
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

    /// True if the parameters after an iteration (1-based) belong to the mean of [`TrainSettings::average_last`]. The last
    /// iteration makes no step; after it the parameters are the mean.
    pub fn averages_at(&self, iteration: u32) -> bool {
        let averaged = (f64::from(self.iterations) * self.average_last).round() as u32;
        iteration >= self.iterations - averaged && iteration < self.iterations
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
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sh_degree_rises_from_where_it_starts() {
        let settings = |sh_degree_start, sh_degree| TrainSettings {
            sh_degree_start,
            sh_degree,
            sh_degree_interval: 10,
            ..TrainSettings::default()
        };
        let degrees = |settings: TrainSettings| [1, 9, 10, 20, 29, 30, 99].map(|i| settings.sh_degree_at(i));
        assert_eq!(degrees(settings(0, 3)), [0, 0, 1, 2, 2, 3, 3]);
        assert_eq!(degrees(settings(2, 3)), [2, 2, 2, 2, 2, 3, 3]);
        assert_eq!(degrees(settings(3, 1)), [1; 7]);
    }

    #[test]
    fn the_sh_degree_rises_at_the_same_shares_of_a_run() {
        let scaled =
            |iterations| TrainSettings { iterations, scale_sh_degree: true, ..TrainSettings::default() };
        let degrees = |iterations: u32, at: [u32; 5]| at.map(|i| scaled(iterations).sh_degree_at(i));
        assert_eq!(degrees(30_000, [999, 1000, 2000, 3000, 30_000]), [0, 1, 2, 3, 3]);
        // 1000 of 30,000 correspond to 66.7 of 2000.
        assert_eq!(degrees(2000, [66, 67, 134, 200, 201]), [0, 1, 2, 2, 3]);
        assert_eq!(degrees(60_000, [1999, 2000, 4000, 5999, 6000]), [0, 1, 2, 2, 3]);
        // A run of one iteration must not divide by zero.
        assert_eq!(degrees(1, [0, 1, 2, 3, 4]), [0, 1, 2, 3, 3]);
    }

    /// 2000 iterations with degree 3, then 30,000, which reach degree 3 at iteration 3000.
    #[test]
    fn a_longer_run_keeps_the_sh_degree_in_use() {
        let of = |iterations, sh_degree_start| TrainSettings {
            iterations,
            sh_degree_start,
            scale_sh_degree: true,
            ..TrainSettings::default()
        };
        let (short, longer) = (of(2000, 0), of(30_000, 0));
        assert_eq!((longer.sh_degree_start_after(&short, 2000), longer.sh_degree_at(2001)), (3, 2));
        assert_eq!(
            [longer.sh_degree_start_after(&short, 100), short.sh_degree_start_after(&short, 2000)],
            [1, 0]
        );
        // The run resumes once more, with the settings as given.
        let raised = of(30_000, 3);
        assert_eq!(longer.sh_degree_start_after(&raised, 2500), 3);
        let mut there = raised.clone();
        longer.excuse_sh_degrees(&mut there, &raised, 2500);
        assert_eq!(there, longer);
        // If the degree is not in use yet, another start is another training.
        let mut there = short.clone();
        of(2000, 3).excuse_sh_degrees(&mut there, &short, 100);
        assert_eq!(there, short);
        // Checkpoints older than the setting.
        let before = TrainSettings { scale_sh_degree: false, ..longer.clone() };
        let mut there = before.clone();
        longer.excuse_sh_degrees(&mut there, &before, 7);
        assert_eq!(there, longer);
    }

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
        // Scaled densification ends at 1000 of 2000 iterations.
        let short = TrainSettings { iterations: 2000, scale_schedule: true, ..settings };
        let computed: Vec<u32> = (1..=2000).filter(|&i| short.computes_filters_at(i)).collect();
        assert_eq!(computed, [1100, 1200, 1300, 1400, 1500, 1600, 1700, 1800]);
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
        // A run of one iteration must not divide by zero.
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
    fn a_run_ends_without_a_reset_that_it_does_not_recover_from() {
        let resets = |iterations, opacity_reset_interval| -> Vec<u32> {
            let settings = TrainSettings { iterations, opacity_reset_interval, ..Default::default() };
            (1..=iterations).filter(|&i| settings.resets_opacity_at(i)).collect()
        };
        assert_eq!([resets(3030, 3000), resets(3999, 3000)], [[], []]);
        assert_eq!([resets(4000, 3000), resets(6500, 3000)], [[3000], [3000]]);
        assert_eq!(resets(7000, 3000), [3000, 6000]);
        // Short intervals shorten the recovery.
        assert_eq!(resets(650, 200), [200, 400]);
        let white = |iterations| TrainSettings { iterations, white_background: true, ..Default::default() };
        assert!(!white(1499).resets_opacity_at(500) && white(1500).resets_opacity_at(500));
    }

    #[test]
    fn white_background_resets_at_the_start_of_densification() {
        let settings = TrainSettings { white_background: true, ..Default::default() };
        assert!(settings.resets_opacity_at(500));
        assert!(!TrainSettings::default().resets_opacity_at(500));
    }

    #[test]
    fn dropout_rises_to_its_share_at_the_end() {
        let settings = TrainSettings { iterations: 400, dropout: 0.2, seed: 5, ..TrainSettings::default() };
        for (iteration, share) in [(0, 0.0), (100, 0.05), (400, 0.2), (500, 0.2)] {
            let dropout = settings.dropout_at(iteration).expect("some");
            assert!((dropout.share - share).abs() < 1e-15);
            assert_eq!((dropout.seed, dropout.iteration), (5, iteration));
        }
        assert_eq!(TrainSettings::default().dropout_at(9), None);
        let message = TrainSettings { dropout: 0.95, ..settings }.check().expect_err("refused").to_string();
        assert!(message.starts_with("dropout: is 0.95"), "{message}");
    }

    #[test]
    fn the_weights_of_depths_fall_to_a_hundredth() {
        let settings = TrainSettings { iterations: 400, depth_points: 0.5, ..TrainSettings::default() };
        for (iteration, share) in [(0, 1.0), (200, 0.1), (400, 0.01)] {
            assert!((settings.depth_points_weight(iteration) / (0.5 * share) - 1.0).abs() < 1e-12);
            assert!((settings.depth_l1_weight(iteration) / share - 1.0).abs() < 1e-12);
        }
    }
}
