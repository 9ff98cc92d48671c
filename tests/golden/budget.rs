//! Budgeted growth: splits along the long axis and the schedule, twins and device against the vectors.

use super::Outcome;
use super::gpu_training::{compare_parameters, densified};
use super::sets::gaussians;
use crate::common::prelude::*;
use crate::golden::npz::Npz;
use crate::reference::gather::long_axis_child;
use crate::reference::linear::sigmoid;
use crate::reference::schedule;
use ashsplat::passes::densify::{ClassifyInputs, Criterion, Densify, DensifyForm, DensifySettings};
use ashsplat::train::{GrowthSchedule, QuantilePlace};
use std::path::Path;

/// Tolerance of every value, absolute and relative.
const DEVICE: f64 = 2e-6;
const TWIN: f64 = 1.5e-7;

pub fn split_of_twin(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let before = gaussians(&npz, "in_");
    let selected = npz.flags("selected");
    let selected = &selected;
    let rows = |wanted: bool| (0..before.len()).filter(move |&row| selected[row] == wanted);
    let kept = rows(false).map(|row| (row, before[row].clone(), 0.0));
    let children = (0..2).flat_map(|child| {
        let before = &before;
        rows(true).map(move |row| (row, long_axis_child(&before[row], child), 2.0)).collect::<Vec<_>>()
    });
    let after: Vec<(usize, Gaussian, f64)> = kept.chain(children).collect();
    equal("parent", &after.iter().map(|row| row.0 as f64).collect::<Vec<_>>(), npz.values("out_parent"))?;
    equal("kind", &after.iter().map(|row| row.2).collect::<Vec<_>>(), npz.values("out_kind"))?;
    compare_parameters(&npz, &after.into_iter().map(|row| row.1).collect::<Vec<_>>(), TWIN)
}

pub fn split_of_device(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let gpu = Gpu::new();
    let form = DensifyForm { long_axis: true, criterion: Criterion::Selected };
    let densify = Densify::new(gpu.context, form)?;
    let selected: Vec<u32> = npz.values("selected").iter().map(|&x| x as u32).collect();
    let statistics = gpu.zeros::<[f32; 2]>("statistics", selected.len());
    let selected = gpu.buffer("selected", &selected);
    let inputs = ClassifyInputs { statistics: &statistics, criteria: Some(&selected) };
    // Nothing is pruned.
    let settings =
        DensifySettings { gradient_threshold: 0.0, clone_scale: 0.0, min_opacity: 0.0, max_scale: 0.0 };
    let after = densified(&gpu, &npz, &densify, (inputs, &settings), None)?;
    compare_parameters(&npz, &after, DEVICE)
}

fn compare_schedule(
    npz: &Npz,
    budget: impl Fn(u32) -> f64,
    quantile: impl Fn(&[f64], f64) -> f64,
) -> Outcome {
    let budgets: Vec<f64> = npz.values("budget_iteration").iter().map(|&i| budget(i as u32)).collect();
    equal("budget", &budgets, npz.values("budget"))?;
    let opacities: Vec<f64> = npz.values("opacity_logits").iter().map(|&logit| sigmoid(logit)).collect();
    let threshold = quantile(&opacities, npz.scalar("quantile"));
    elementwise("threshold", &[threshold], npz.values("threshold"), 1e-6, 0.0)?;
    let keep: Vec<f64> = opacities.iter().map(|&opacity| f64::from(u8::from(opacity >= threshold))).collect();
    Ok(equal("keep", &keep, npz.values("keep"))?)
}

pub fn schedule_of_twin(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let last = npz.scalar("budget_final");
    let budget = |i: u32| schedule::growth_budget(i.into(), last);
    compare_schedule(&npz, budget, schedule::quantile)
}

pub fn schedule_of_engine(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let cap_max = npz.scalar("budget_final") as u32;
    let mut settings = TrainSettings { cap_max, ..TrainSettings::of_strategy(StrategyType::Budget) };
    let of_engine = |values: &[f64], share: f64| {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let place = QuantilePlace::new(sorted.len() as u32, share);
        place.between(sorted[place.below as usize], sorted[place.above as usize])
    };
    for scale_schedule in [true, false] {
        settings.scale_schedule = scale_schedule;
        let schedule = GrowthSchedule::of(&settings, 1);
        let budget = |i: u32| f64::from(schedule.budget(i));
        compare_schedule(&npz, budget, of_engine)?;
    }
    Ok(())
}
