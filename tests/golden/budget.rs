//! Budgeted growth: splits along the long axis and the schedule, the device and the host against the vectors.

use super::Outcome;
use super::training::{compare_parameters, densified};
use crate::common::prelude::*;
use crate::golden::npz::Npz;
use crate::reference::linear::sigmoid;
use ashsplat::passes::densify::{ClassifyInputs, Densify, DensifyForm, DensifySettings};
use ashsplat::train::{GrowthSchedule, QuantilePlace};
use std::path::Path;

/// Tolerance of every value, absolute and relative.
const DEVICE: f64 = 2e-6;

pub fn split(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let gpu = Gpu::new();
    let form = DensifyForm { long_axis: true, selected: true };
    let densify = Densify::new(gpu.context, form)?;
    let selected: Vec<u32> = npz.values("selected").iter().map(|&x| x as u32).collect();
    let statistics = gpu.zeros::<[f32; 2]>("statistics", selected.len());
    let selected = gpu.buffer("selected", &selected);
    let inputs = ClassifyInputs { statistics: &statistics, selected: Some(&selected) };
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

pub fn schedule(path: &Path) -> Outcome {
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
