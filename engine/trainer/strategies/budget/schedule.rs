//! Schedule of budgeted growth: pure arithmetic of the settings.

use crate::trainer::settings::TrainSettings;

/// Improved-GS ends its growth at 14,500 of the 15,000 iterations with densification.
const CURVE_SHARE: f64 = 14_500.0 / 15_000.0;
/// (first iteration of 30,000, number of views that share a step).
const GROUPS: [(u32, u32); 2] = [(24_000, 20), (20_000, 5)];
/// Iterations after the start and after a reset, until Gaussians that are still faint are pruned.
const RECOVERY: u32 = 300;
/// Number of resets that are followed by a pruning by rank.
const RANKED_RESETS: u32 = 2;
/// Iterations of 30,000 after which [`TrainSettings::late_min_opacity`] prunes. FastGS starts at 15,000. A start at 8,000
/// leaves more Gaussians in the end, with the same or more quality on average (tools/strategies.md).
const LATE_PRUNINGS: [u32; 7] = [8_000, 10_000, 12_000, 14_000, 16_000, 18_000, 21_000];
/// Number of views for an importance.
const VIEWS: usize = 10;

/// Schedule of the strategy `budget` (Improved-GS, `train.py`). At 30,000 iterations it is that of the paper's code.
/// [`TrainSettings::scale_schedule`] changes it for other lengths.
#[derive(Clone, Copy, Debug)]
pub struct GrowthSchedule<'a> {
    settings: &'a TrainSettings,
    /// Maximum number of Gaussians in the run.
    cap: u32,
}

impl<'a> GrowthSchedule<'a> {
    /// Schedule of a run that began with `start` Gaussians.
    pub fn of(settings: &'a TrainSettings, start: u32) -> Self {
        let cap = match settings.cap_max {
            0 => {
                let share = f64::from(settings.iterations) / 30_000.0;
                let cap = f64::from(start) * settings.cap_ratio * share.cbrt();
                (cap.min(f64::from(u32::MAX)) as u32).max(start)
            }
            cap => cap,
        };
        Self { settings, cap }
    }

    /// Maximum number of Gaussians after the densification of an iteration (1-based). With [`TrainSettings::growth_curve`] it
    /// is ⌊√t · cap⌋, at least 1, where t rises linearly from 0 at the start of densification to 1 shortly before its end.
    pub fn budget(&self, iteration: u32) -> u32 {
        let s = self.settings;
        if !s.growth_curve {
            return self.cap;
        }
        let start = f64::from(s.scaled(s.densify_from_iter));
        let end = f64::from(s.scaled(s.densify_until_iter)) * CURVE_SHARE;
        let t = ((f64::from(iteration) - start) / (end - start).max(1.0)).clamp(0.0, 1.0);
        ((t.sqrt() * f64::from(self.cap)).floor() as u32).max(1)
    }

    /// Number of views that share a step at an iteration (1-based): 1 without [`TrainSettings::multi_step`].
    pub fn group(&self, iteration: u32) -> u32 {
        let s = self.settings;
        let late = GROUPS.iter().find(|(from, _)| iteration >= s.scaled(*from));
        match late {
            Some((_, views)) if s.multi_step && !s.collects_statistics_at(iteration) => *views,
            _ => 1,
        }
    }

    /// True if the optimiser makes a step at an iteration (1-based): at the last of each group, never at the last of the run.
    pub fn steps_at(&self, iteration: u32) -> bool {
        iteration < self.settings.iterations && iteration.is_multiple_of(self.group(iteration))
    }

    /// Opacity below which a densification prunes: 0 at the last one.
    pub fn min_opacity(&self, iteration: u32) -> f64 {
        let s = self.settings;
        let last = s.scaled(s.densify_until_iter).saturating_sub(s.densification_interval);
        if iteration < last { s.min_opacity } else { 0.0 }
    }

    /// True if an iteration (1-based) ends with the first pruning, of Gaussians that are still faint after the start.
    pub fn prunes_faint_at(&self, iteration: u32) -> bool {
        self.settings.recovery && iteration == RECOVERY && self.settings.collects_statistics_at(iteration)
    }

    /// True if an iteration (1-based) ends with a pruning of the faintest share: 300 after the first two resets.
    pub fn prunes_ranks_at(&self, iteration: u32) -> bool {
        self.settings.recovery && self.is_after_ranked_reset(iteration, RECOVERY)
    }

    /// True if an iteration (1-based) ends with a pruning below [`TrainSettings::late_min_opacity`]. Gaussians first have the
    /// same time to recover from the start or an opacity reset as before the other prunings.
    pub fn prunes_late_at(&self, iteration: u32) -> bool {
        let s = self.settings;
        s.late_min_opacity > 0.0
            && iteration > RECOVERY
            && LATE_PRUNINGS.iter().any(|&late| s.scaled(late) == iteration)
            && !(iteration - RECOVERY + 1..=iteration).any(|i| s.resets_opacity_at(i))
    }

    /// Index of the iteration's densification, from 0.
    fn densifications_before(&self, iteration: u32) -> u32 {
        let s = self.settings;
        let interval = s.densification_interval;
        (iteration / interval).saturating_sub(s.scaled(s.densify_from_iter) / interval + 1)
    }

    /// Views from whose pool a densification draws the importance: the first place in the pool, and the number of views, of
    /// `all`. The first densification after a pruning of the faintest share takes all views.
    pub fn views(&self, iteration: u32, all: usize) -> (u64, usize) {
        let after_pruning = RECOVERY + self.settings.densification_interval;
        let each = match self.settings.recovery && self.is_after_ranked_reset(iteration, after_pruning) {
            true => all,
            false => VIEWS.min(all),
        };
        (u64::from(self.densifications_before(iteration)) * VIEWS as u64, each)
    }

    fn is_after_ranked_reset(&self, iteration: u32, by: u32) -> bool {
        let s = self.settings;
        let Some(reset) = iteration.checked_sub(by).filter(|&reset| reset > 0) else { return false };
        reset.is_multiple_of(s.opacity_reset_interval)
            && reset / s.opacity_reset_interval <= RANKED_RESETS
            && s.resets_opacity_at(reset)
            && s.collects_statistics_at(iteration)
    }
}

/// Place of a quantile among sorted values, interpolated linearly between ranks like `torch.quantile`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuantilePlace {
    /// Rank below the quantile, from 0.
    pub below: u32,
    /// Next rank, or the last one.
    pub above: u32,
    /// Fraction of the way from `below` to `above`, at least 0 and less than 1.
    pub rest: f64,
}

impl QuantilePlace {
    /// Place among this number of values; `share`: share of the values that lie below, 0 to 1.
    pub fn new(values: u32, share: f64) -> Self {
        let last = values.saturating_sub(1);
        let place = share * f64::from(last);
        let below = place.floor() as u32;
        Self { below, above: (below + 1).min(last), rest: place.fract() }
    }

    /// Interpolates the quantile from the values of both ranks.
    pub fn between(&self, below: f64, above: f64) -> f64 {
        below + self.rest * (above - below)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trainer::StrategyType;

    fn settings(iterations: u32) -> TrainSettings {
        TrainSettings { iterations, cap_max: 60_000, ..TrainSettings::of_strategy(StrategyType::Budget) }
    }

    fn all(iterations: u32, holds: impl Fn(&GrowthSchedule, u32) -> bool) -> Vec<u32> {
        let settings = settings(iterations);
        let schedule = GrowthSchedule::of(&settings, 1);
        (1..=iterations).filter(|&i| holds(&schedule, i)).collect()
    }

    #[test]
    fn schedule_of_the_paper() {
        let settings = settings(30_000);
        let schedule = GrowthSchedule::of(&settings, 1);
        assert_eq!(
            [100, 600, 14_400, 14_500, 14_900].map(|i| schedule.budget(i)),
            [1, 5070, 59_785, 60_000, 60_000]
        );
        assert_eq!([19_999, 20_000, 23_999, 24_000].map(|i| schedule.group(i)), [1, 5, 5, 20]);
        assert_eq!([14_800, 14_900].map(|i| schedule.min_opacity(i)), [0.005, 0.0]);
        assert_eq!(all(30_000, |s, i| s.prunes_faint_at(i)), [300]);
        assert_eq!(all(30_000, |s, i| s.prunes_ranks_at(i)), [3300, 6300]);
        assert_eq!(all(30_000, |s, i| s.settings.densifies_at(i) && s.views(i, 99).1 == 99), [3400, 6400]);
        assert_eq!([600, 700, 14_900].map(|i| schedule.views(i, 99).0), [0, 10, 1430]);
        assert_eq!(schedule.views(600, 3).1, 3);
    }

    #[test]
    fn late_prunings_wait_for_recovery() {
        let late = |settings: TrainSettings| -> Vec<u32> {
            let schedule = GrowthSchedule::of(&settings, 1);
            (1..=settings.iterations).filter(|&i| schedule.prunes_late_at(i)).collect()
        };
        let with = |iterations: u32| TrainSettings { late_min_opacity: 0.1, ..settings(iterations) };
        assert_eq!(late(settings(30_000)), [0; 0]);
        // The reset at 12,000 displaces one of them.
        assert_eq!(late(with(30_000)), [8_000, 10_000, 14_000, 16_000, 18_000, 21_000]);
        assert_eq!(late(with(2000)), [533, 667, 800, 933, 1067, 1200, 1400]);
        // 3267 is 267 after a reset.
        assert_eq!(late(with(7000)), [1867, 2333, 2800, 3733, 4200, 4900]);
        assert_eq!(late(with(600)), [320, 360, 420]);
        let early = TrainSettings { opacity_reset_interval: 500, ..with(2000) };
        // 300 after a reset.
        assert_eq!(late(early), [800, 933, 1067, 1200, 1400]);
    }

    #[test]
    fn schedule_of_short_runs() {
        assert_eq!(all(2000, |s, i| s.prunes_ranks_at(i)), [0; 0]);
        assert_eq!(all(7000, |s, i| s.prunes_ranks_at(i)), [3300]);
        // A step at the end of every group, and none at the last iteration.
        let late = all(2000, |s, i| s.steps_at(i) && i > 1320);
        assert_eq!(
            (&late[..14], late.last()),
            (&[&(1321..=1332).collect::<Vec<_>>()[..], &[1335, 1340]].concat()[..], Some(&1980))
        );
        let short = settings(2000);
        let schedule = GrowthSchedule::of(&short, 1);
        assert_eq!([33, 967, 1000].map(|i| schedule.budget(i)), [1, 60_000, 60_000]);
        for iterations in 1..20 {
            let settings = settings(iterations);
            let schedule = GrowthSchedule::of(&settings, 1);
            (1..=iterations).for_each(|i| assert!(schedule.budget(i) >= 1 && schedule.group(i) >= 1));
        }
    }

    #[test]
    fn without_a_cap_it_follows_from_the_start() {
        let cap = |iterations, start| {
            let settings = TrainSettings { cap_max: 0, growth_curve: false, ..settings(iterations) };
            GrowthSchedule::of(&settings, start).budget(1)
        };
        assert_eq!([cap(30_000, 100), cap(240_000, 100), cap(3750, 100)], [1000, 2000, 500]);
        let fewer = TrainSettings { cap_max: 0, cap_ratio: 3.5, growth_curve: false, ..settings(30_000) };
        assert_eq!(GrowthSchedule::of(&fewer, 100).budget(1), 350);
        assert_eq!([cap(1, 100), cap(30_000, u32::MAX), cap(30_000, 0)], [100, u32::MAX, 0]);
    }

    #[test]
    fn quantiles_lie_between_ranks() {
        let place = |below, above, rest| QuantilePlace { below, above, rest };
        for (values, share, expected) in [
            (3, 0.5, place(1, 2, 0.0)),
            (2, 0.25, place(0, 1, 0.25)),
            (1, 0.2, place(0, 0, 0.0)),
            (2, 1.0, place(1, 1, 0.0)),
        ] {
            assert_eq!(QuantilePlace::new(values, share), expected);
        }
        assert_eq!(place(0, 1, 0.25).between(4.0, 0.0), 3.0);
    }
}
