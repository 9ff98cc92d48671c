//! Budgeted growth (Improved-GS, 2026). It splits Gaussians along their long axis, first those that matter most for the edges
//! of the photographs, up to a number that grows along a curve. Opacity resets are mild, and Gaussians that do not recover from
//! them are pruned. Late steps add up the gradients of several views.

mod schedule;

pub use schedule::{GrowthSchedule, QuantilePlace};

use super::rebuild::{DecisionMemory, Decisions};
use super::unknown;
use crate::densify::{
    Candidates, Chances, ClassifyInputs, Criterion, Densify, DensifyForm, DensifySettings, Importance,
    Selection, SelectionBuffers, SelectionDraw,
};
use crate::error::{Error, Result};
use crate::trainer::population::{Population, or_none};
use crate::trainer::random::pool_views;
use crate::trainer::settings::{ImportanceType, OptimizerType, SplitType, TrainSettings};
use crate::trainer::strategy::{Hooks, Strategy};
use crate::trainer::work::{ABSOLUTE_STATISTIC, Actions, Changes, Densified, Statistic, Work};
use crate::vk::{Buffer, Context, MemoryKind};

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

/// Gaussians that a pruning removes.
#[derive(Clone, Copy)]
enum Pruned {
    /// Gaussians fainter than this opacity.
    Below(f64),
    /// The faintest share, between 0 and 1.
    Share(f64),
}

/// Budgeted growth to [`TrainSettings::cap_max`]. Each part has a switch: [`TrainSettings::absgrad`], `split`, `importance`,
/// `growth_curve`, `recovery`, `multi_step`, `late_min_opacity`.
pub struct Budget {
    kernels: Densify,
    selection: Selection,
    /// Built by the first densification with [`ImportanceType::Edges`], because a resumed run may have none left.
    importance: Option<Importance>,
    absolute: bool,
    sums: bool,
    /// Number of Gaussians before the first change of the set.
    start: Option<u32>,
}

/// Name of [`Budget::start`] in the checkpoint.
const START: &str = "start";

impl Budget {
    /// Builds the kernels for these settings.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    pub fn new(context: &Context, settings: &TrainSettings) -> Result<Self> {
        let form =
            DensifyForm { long_axis: settings.split == SplitType::LongAxis, criterion: Criterion::Selected };
        Ok(Self {
            kernels: Densify::with_form(context, form)?,
            selection: Selection::new(context)?,
            importance: None,
            absolute: settings.absgrad,
            sums: settings.multi_step,
            start: None,
        })
    }
}

impl Strategy for Budget {
    fn name(&self) -> &'static str {
        "budget"
    }

    fn check(&self, settings: &TrainSettings, gaussians: u32) -> Result<()> {
        let cap = settings.cap_max;
        if cap > 0 && gaussians > cap {
            let problem = format!(
                "{cap} is less than the {gaussians} Gaussians of the start; raise it, or start from fewer"
            );
            return Err(Error::argument("cap_max", problem));
        }
        if cap == 0 && settings.cap_ratio < 1.0 {
            let problem = format!(
                "is {}, a cap below the Gaussians of the start; give 1 or more, or start from fewer",
                settings.cap_ratio
            );
            return Err(Error::argument("cap_ratio", problem));
        }
        if settings.multi_step && settings.optimizer_type == OptimizerType::SparseAdam {
            let problem =
                "adds up views, and sparse_adam steps for what one view has seen; leave one of them out";
            return Err(Error::argument("multi_step", problem));
        }
        Ok(())
    }

    fn work(&self, settings: &TrainSettings, iteration: u32) -> Work {
        let schedule = GrowthSchedule::of(settings, 0);
        let densifies = settings.densifies_at(iteration);
        let resets = settings.resets_opacity_at(iteration);
        let actions = Actions::DENSIFY
            .when(densifies)
            .and(Actions::RESET_OPACITY.when(resets))
            .and(PRUNE_FAINT.when(schedule.prunes_faint_at(iteration)))
            .and(PRUNE_RANKS.when(schedule.prunes_ranks_at(iteration)))
            .and(PRUNE_LATE.when(schedule.prunes_late_at(iteration)));
        Work {
            accumulates: settings.collects_statistics_at(iteration),
            // The step precedes densification, which splits the set that the step made.
            optimizes: schedule.steps_at(iteration),
            sums_gradients: schedule.group(iteration) > 1,
            optimizes_opacity: true,
            actions,
        }
    }

    fn statistics(&self) -> Vec<Statistic> {
        if self.absolute { vec![ABSOLUTE_STATISTIC] } else { Vec::new() }
    }

    fn records(&self) -> Hooks {
        Hooks { sums: self.sums, ..Hooks::default() }
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
                let most = if recovery { RECOVERABLE_OPACITY } else { crate::densify::RESET_OPACITY };
                population.context().run("reset opacity", |r| {
                    self.kernels.record_reset_to(r, population.scene(), population.moments(), most);
                    Ok(())
                })?;
                return Ok(Changes { opacities_reset: true, ..Changes::default() });
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
        let most = population.most_rows();
        let wanted = budget.min(most).saturating_sub(before);
        let importance = match wanted {
            0 => None,
            _ => match self.importance(population)? {
                Some(importance) => importance,
                None => return Ok(unchanged),
            },
        };
        let requests = self.selection.requests(before);
        let buffers = population.context().allocate("densify", &requests, MemoryKind::Device);
        let Some(buffers) = or_none(buffers)? else { return Ok(unchanged) };
        let selection = SelectionBuffers::from_allocated(buffers);
        let mut decisions = Decisions {
            kernels: &self.kernels,
            memory: match DecisionMemory::for_growth(population)? {
                Some(memory) => memory,
                None => return Ok(unchanged),
            },
            settings,
        };
        let drawn = self.select(population, (importance.as_ref(), wanted), &selection)?;
        let classify = |decisions: &Decisions, population: &Population| {
            let inputs = ClassifyInputs {
                statistics: &population.statistics()[0],
                criteria: Some(&selection.selected),
            };
            decisions.classify(population, inputs)
        };
        let mut densified = classify(&decisions, population)?;
        let Some(growth) = decisions.make_room(population, before + drawn)? else { return Ok(unchanged) };
        let room = population.capacity_with(&growth);
        if densified.rows() > room {
            self.select(population, (importance.as_ref(), room - before), &selection)?;
            densified = Densified { limited: true, ..classify(&decisions, population)? };
        }
        densified.limited |= budget > most && drawn == wanted && wanted > 0;
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
        (importance, wanted): (Option<&Buffer>, u32),
        buffers: &SelectionBuffers,
    ) -> Result<u32> {
        let (context, settings) = (population.context(), population.settings());
        if wanted == 0 {
            context.run("select none", |r| {
                r.fill(&buffers.selected, 0);
                Ok(())
            })?;
            return Ok(0);
        }
        let draw = SelectionDraw {
            count: population.count(),
            wanted,
            candidates: Candidates {
                statistics: &population.statistics()[0],
                absolute: self.absolute.then(|| &population.statistics()[1]),
                threshold: settings.densify_grad_threshold as f32,
            },
            chances: match (importance, settings.importance) {
                (Some(importance), _) => Chances::Importance(importance),
                (None, ImportanceType::Statistic) => Chances::Statistic,
                (None, _) => Chances::Equal,
            },
            seed: settings.seed,
            iteration: population.iteration(),
            explicit: None,
        };
        context.run("select", |r| {
            self.selection.record(r, &draw, buffers);
            Ok(())
        })?;
        let totals: Vec<u32> = bytemuck::pod_collect_to_vec(&context.download(&buffers.totals)?);
        Ok(totals[2])
    }

    /// Removes faint Gaussians. If memory is short, or nothing would be left, the set stays.
    fn prune(&self, population: &mut Population, pruned: Pruned) -> Result<Densified> {
        population.release_pictures();
        let before = population.count();
        let unchanged = Densified { before, kept: before, ..Densified::default() };
        let without_memory = Densified { limited: true, ..unchanged };
        let least = match pruned {
            Pruned::Below(opacity) => opacity,
            Pruned::Share(share) => match self.opacity_of_share(population, share)? {
                Some(opacity) => opacity,
                None => return Ok(without_memory),
            },
        };
        let decisions = Decisions {
            kernels: &self.kernels,
            memory: match DecisionMemory::for_pruning(population)? {
                Some(memory) => memory,
                None => return Ok(without_memory),
            },
            settings: pruning_below(not_below(least)),
        };
        let pruned = decisions.classify_kept(population)?;
        if pruned.kept == 0 || pruned.kept == before {
            return Ok(unchanged);
        }
        decisions.prune(population, pruned)?;
        Ok(pruned)
    }

    /// Opacity below which a share of the Gaussians lies. None if memory for their order is short.
    fn opacity_of_share(&self, population: &Population, share: f64) -> Result<Option<f64>> {
        let context = population.context();
        let requests = self.selection.requests(population.count());
        let buffers = or_none(context.allocate("densify", &requests, MemoryKind::Device))?;
        let Some(buffers) = buffers.map(SelectionBuffers::from_allocated) else { return Ok(None) };
        let mut sorted = None;
        context.run("order opacities", |r| {
            sorted = Some(self.selection.record_opacities(r, population.scene(), &buffers));
            Ok(())
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
