//! Budgeted growth (Improved-GS, 2026). It splits Gaussians along their long axis, first those that matter most for the edges
//! of the photographs, up to a number that grows along a curve. Opacity resets are mild, and Gaussians that do not recover from
//! them are pruned.

use super::rebuild::{Decisions, check_cap, reset_opacity};
use crate::error::{Error, Result};
use crate::passes::densify::{
    Candidates, Chances, Densify, DensifyForm, DensifySettings, Importance, RESET_OPACITY, UniqueDraw,
    UniqueDrawBuffers, UniqueDrawInputs,
};
use crate::train::population::Population;
use crate::train::schedule::pool_views;
use crate::train::settings::{ImportanceType, SplitType, TrainSettings};
use crate::train::strategy::{Actions, Changes, Densified, StepWork, Strategy, unknown};
use crate::vk::{Buffer, Context};

/// Pruning of Gaussians that are still faint after the start.
const PRUNE_FAINT: Actions = Actions(1 << 2);
/// Pruning of the faintest share after a reset.
const PRUNE_RANKS: Actions = Actions(1 << 3);
/// Pruning below [`TrainSettings::late_min_opacity`].
const PRUNE_LATE: Actions = Actions(1 << 4);
/// Opacity below which [`PRUNE_FAINT`] removes.
const FAINT: f64 = 0.02;
/// Share of the Gaussians that [`PRUNE_RANKS`] removes.
const FAINTEST_SHARE: f64 = 0.2;
/// Largest opacity after a reset, if Gaussians are to recover from it.
const RECOVERABLE_OPACITY: f64 = 0.05;

#[derive(Clone, Copy)]
enum Pruned {
    /// Gaussians fainter than this opacity.
    Below(f64),
    /// The faintest share, between 0 and 1.
    Share(f64),
}

/// Budgeted growth to [`TrainSettings::cap_max`]. Each part has a switch: [`TrainSettings::absgrad`], `split`, `importance`,
/// `growth_curve`, `recovery`, `late_min_opacity`.
pub struct Budget {
    kernels: Densify,
    unique_draw: UniqueDraw,
    /// Built by the first densification with [`ImportanceType::Edges`], because a resumed run may have none left.
    importance: Option<Importance>,
    absolute: bool,
    /// Number of Gaussians before the first change of the set.
    start: Option<u32>,
}

/// Name of [`Budget::start`] in the checkpoint.
const START: &str = "start";

impl Budget {
    /// Builds the kernels for these settings.
    pub fn new(context: &Context, settings: &TrainSettings) -> Result<Self> {
        let form = DensifyForm { long_axis: settings.split == SplitType::LongAxis, selected: true };
        Ok(Self {
            kernels: Densify::new(context, form)?,
            unique_draw: UniqueDraw::new(context)?,
            importance: None,
            absolute: settings.absgrad,
            start: None,
        })
    }
}

impl Strategy for Budget {
    fn name(&self) -> &'static str {
        "budget"
    }

    fn check(&self, settings: &TrainSettings, gaussians: u32) -> Result<()> {
        if settings.cap_max > 0 {
            check_cap(settings.cap_max, gaussians)?;
        } else if settings.cap_ratio < 1.0 {
            let problem = format!(
                "is {}, a cap below the Gaussians of the start; give 1 or more, or start from fewer",
                settings.cap_ratio
            );
            return Err(Error::argument("cap_ratio", problem));
        }
        Ok(())
    }

    fn work(&self, settings: &TrainSettings, iteration: u32) -> StepWork {
        let schedule = GrowthSchedule::of(settings, 0);
        let densifies = settings.densifies_at(iteration);
        let resets = settings.resets_opacity_at(iteration);
        let actions = Actions::DENSIFY
            .when(densifies)
            .and(Actions::RESET_OPACITY.when(resets))
            .and(PRUNE_FAINT.when(schedule.prunes_faint_at(iteration)))
            .and(PRUNE_RANKS.when(schedule.prunes_ranks_at(iteration)))
            .and(PRUNE_LATE.when(schedule.prunes_late_at(iteration)));
        StepWork {
            accumulates: settings.collects_statistics_at(iteration),
            // The step precedes densification, which splits the set that the step made.
            optimizes: true,
            optimizes_opacity: true,
            actions,
        }
    }

    fn absolute_gradients(&self) -> bool {
        self.absolute
    }

    fn between_steps(&mut self, population: &mut Population, action: Actions) -> Result<Changes> {
        let start = *self.start.get_or_insert(population.count());
        let densified = match action {
            Actions::DENSIFY => self.densify(population, start)?,
            PRUNE_FAINT => self.prune(population, Pruned::Below(FAINT))?,
            PRUNE_RANKS => self.prune(population, Pruned::Share(FAINTEST_SHARE))?,
            PRUNE_LATE => self.prune(population, Pruned::Below(population.settings().late_min_opacity))?,
            Actions::RESET_OPACITY => {
                let recovery = population.settings().recovery;
                let max_opacity = if recovery { RECOVERABLE_OPACITY } else { RESET_OPACITY };
                return reset_opacity(population, &self.kernels, max_opacity);
            }
            _ => return Err(unknown(self.name(), action)),
        };
        Ok(Changes { densified: Some(densified), ..Changes::default() })
    }

    fn state(&self) -> Vec<(String, String)> {
        self.start.iter().map(|start| (START.to_owned(), start.to_string())).collect()
    }

    fn restore(&mut self, state: &[(String, String)]) -> Result<()> {
        for (name, value) in state {
            let start = value.parse().ok().filter(|_| name == START);
            self.start = Some(start.ok_or_else(|| {
                let problem = format!("has '{name}' of '{value}', which the strategy budget does not know");
                Error::argument("checkpoint", problem)
            })?);
        }
        Ok(())
    }
}

impl Budget {
    /// Draws the Gaussians to split, within budget, memory and device, and gathers the new set. If memory is short, the set
    /// stays.
    fn densify(&mut self, population: &mut Population, start: u32) -> Result<Densified> {
        population.release_pictures();
        let edges = population.settings().importance == ImportanceType::Edges;
        if edges && self.importance.is_none() {
            let drawn = population.settings().render_settings();
            self.importance = Some(Importance::new(population.context(), &drawn)?);
        }
        let before = population.count();
        let unchanged = Densified { before, kept: before, limited: true, ..Densified::default() };
        let schedule = GrowthSchedule::of(population.settings(), start);
        let budget = schedule.budget(population.iteration());
        let settings = pruning_below(schedule.min_opacity(population.iteration()) as f32);
        let limit = population.max_rows();
        let wanted = budget.min(limit).saturating_sub(before);
        let importance = match wanted {
            0 => None,
            _ => match self.importance(population)? {
                Some(importance) => importance,
                None => return Ok(unchanged),
            },
        };
        let Some(buffers) = population.allocate(&UniqueDrawBuffers::requests(&population.sizes(), before))?
        else {
            return Ok(unchanged);
        };
        let selection = UniqueDrawBuffers::from_allocated(buffers);
        // A Gaussian stays and is cloned, or is split into two.
        let max_rows = before.saturating_mul(2);
        let decisions = Decisions::new(population, max_rows, &self.kernels, settings)?;
        let Some(mut decisions) = decisions else { return Ok(unchanged) };
        let drawn = self.select(population, importance.as_ref(), wanted, &selection)?;
        let classify = |decisions: &Decisions, population: &Population| {
            decisions.classify(population, Some(&selection.selected))
        };
        let mut densified = classify(&decisions, population)?;
        let Some(growth) = decisions.reserve_gaussians(population, before + drawn)? else {
            return Ok(unchanged);
        };
        let capacity = population.capacity_with(&growth);
        if densified.rows() > capacity {
            self.select(population, importance.as_ref(), capacity - before, &selection)?;
            densified = Densified { limited: true, ..classify(&decisions, population)? };
        }
        densified.limited |= budget > limit && drawn == wanted && wanted > 0;
        decisions.rebuild(population, densified, growth)?;
        Ok(densified)
    }

    /// Importance by the photographs' edges, if the settings use it. None if memory is short.
    fn importance(&self, population: &mut Population) -> Result<Option<Option<Buffer>>> {
        let Some(kernels) = &self.importance else { return Ok(Some(None)) };
        let (seed, views) = (population.settings().seed, population.cameras().len());
        let (first, count) =
            GrowthSchedule::of(population.settings(), 0).views(population.iteration(), views);
        let drawn = pool_views(seed, views, first..first + count as u64);
        Ok(population.importance(kernels, &drawn)?.map(Some))
    }

    /// Selects up to `wanted` Gaussians and returns their number.
    fn select(
        &self,
        population: &Population,
        importance: Option<&Buffer>,
        wanted: u32,
        buffers: &UniqueDrawBuffers,
    ) -> Result<u32> {
        let (context, settings) = (population.context(), population.settings());
        if wanted == 0 {
            context.run("select none", |r| r.fill(&buffers.selected, 0))?;
            return Ok(0);
        }
        let draw = UniqueDrawInputs {
            count: population.count(),
            wanted,
            candidates: Candidates {
                statistics: population.statistics(),
                threshold: settings.densify_grad_threshold as f32,
            },
            chances: match (importance, settings.importance) {
                (Some(importance), _) => Chances::Importance(importance),
                (None, ImportanceType::Statistic) => Chances::Statistic,
                (None, _) => Chances::Equal,
            },
            seed: settings.seed,
            iteration: population.iteration(),
        };
        context.run("select", |r| self.unique_draw.record(r, &draw, buffers))?;
        let totals: Vec<u32> = bytemuck::pod_collect_to_vec(&context.download(&buffers.totals)?);
        Ok(totals[2])
    }

    /// Removes faint Gaussians. If memory is short, or nothing would be left, the set stays.
    fn prune(&self, population: &mut Population, pruned: Pruned) -> Result<Densified> {
        population.release_pictures();
        let before = population.count();
        let unchanged = Densified { before, kept: before, ..Densified::default() };
        let without_memory = Densified { limited: true, ..unchanged };
        let min_opacity = match pruned {
            Pruned::Below(opacity) => opacity,
            Pruned::Share(share) => match self.opacity_of_share(population, share)? {
                Some(opacity) => opacity,
                None => return Ok(without_memory),
            },
        };
        let settings = pruning_below(not_below(min_opacity));
        let decisions = Decisions::new(population, before, &self.kernels, settings)?;
        let Some(decisions) = decisions else { return Ok(without_memory) };
        let pruned = decisions.classify_kept(population)?;
        if pruned.kept == 0 || pruned.kept == before {
            return Ok(unchanged);
        }
        let growth = population.reserve_gaussians(pruned.rows())?;
        decisions.rebuild(population, pruned, growth)?;
        Ok(pruned)
    }

    /// Opacity below which a share of the Gaussians lies. None if memory for their order is short.
    fn opacity_of_share(&self, population: &Population, share: f64) -> Result<Option<f64>> {
        let context = population.context();
        let buffers =
            population.allocate(&UniqueDrawBuffers::requests(&population.sizes(), population.count()))?;
        let Some(buffers) = buffers.map(UniqueDrawBuffers::from_allocated) else { return Ok(None) };
        let mut sorted = None;
        context.run("order opacities", |r| {
            sorted = Some(self.unique_draw.record_opacities(r, population.scene(), &buffers))
        })?;
        let Some(sorted) = sorted else { unreachable!("recorded") };
        let place = QuantilePlace::new(population.count(), share);
        let opacity = |rank: u32| -> Result<f64> {
            let bytes = context.download(&sorted.range(u64::from(rank) * 4, 4))?;
            Ok(f64::from(bytemuck::pod_read_unaligned::<f32>(&bytes)))
        };
        Ok(Some(place.between(opacity(place.below)?, opacity(place.above)?)))
    }
}

/// Prunes below an opacity. The selection alone decides splits.
fn pruning_below(min_opacity: f32) -> DensifySettings {
    DensifySettings { gradient_threshold: 0.0, clone_scale: 0.0, min_opacity, max_scale: 0.0 }
}

/// Smallest f32 that is not below a number: any f32 is below both, or below neither.
fn not_below(number: f64) -> f32 {
    let nearest = number as f32;
    if f64::from(nearest) < number { nearest.next_up() } else { nearest }
}

/// Improved-GS ends its growth at 14,500 of the 15,000 iterations with densification.
const CURVE_SHARE: f64 = 14_500.0 / 15_000.0;
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
    use crate::train::StrategyType;

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
        let short = settings(2000);
        let schedule = GrowthSchedule::of(&short, 1);
        assert_eq!([33, 967, 1000].map(|i| schedule.budget(i)), [1, 60_000, 60_000]);
        for iterations in 1..20 {
            let settings = settings(iterations);
            let schedule = GrowthSchedule::of(&settings, 1);
            (1..=iterations).for_each(|i| assert!(schedule.budget(i) >= 1));
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
