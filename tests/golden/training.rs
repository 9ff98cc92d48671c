//! Loss, optimiser, schedule, densification: the twins against the vectors.

use super::Outcome;
use super::sets::{gaussians, pixel_gradients, view};
use crate::common::compare::{GradientTolerance, PixelTolerance, elementwise, equal, gradient, pixels};
use crate::golden::npz::Npz;
use crate::reference::adam::{Parameter, adam as adam_step, adam_sparse};
use crate::reference::classify::{Decision, Statistic, decide};
use crate::reference::pipeline::{Frame, backward, pixels_of, render, tile_of};
use crate::reference::project::intermediate;
use crate::reference::scatter_sources::{Densify, place};
use crate::reference::tiles::alpha_unclamped;
use crate::reference::types::{ALPHA_MAX, Gaussian, Gradient, View};
use crate::reference::{loss_reduce, regularize as regularize_twin, reset_opacity as reset_twin, schedule};
use std::path::Path;

/// The rounding of stored float32.
const ROUNDING: f64 = 1.5e-7;
const GRADIENT: GradientTolerance = GradientTolerance { relative_l2: 1e-6, max_over_max: 1e-6 };

pub fn loss(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let shape = &npz.array("img").shape;
    let (height, width) = (shape[0], shape[1]);
    let result = loss_reduce::loss(npz.values("img"), npz.values("gt"), width, height);
    elementwise("loss", &[result.loss], npz.values("loss"), 0.0, ROUNDING)?;
    elementwise("l1", &[result.l1], npz.values("l1"), 0.0, ROUNDING)?;
    elementwise("ssim", &[result.ssim], npz.values("ssim"), ROUNDING, ROUNDING)?;
    elementwise("ssim map", &result.ssim_map, npz.values("ssim_map"), ROUNDING, ROUNDING)?;
    let skip = vec![false; width * height];
    gradient("d_img", &result.gradient, npz.values("d_img"), &skip, GRADIENT)?;
    Ok(())
}

/// The parameter groups of the vectors.
pub const GROUPS: [&str; 6] = ["xyz", "f_dc", "f_rest", "opacity", "scaling", "rotation"];

pub fn adam(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    for group in GROUPS {
        let field = |name: &str| npz.values(&format!("{group}_{name}"));
        let rate = field("lr")[0];
        let mut parameters: Vec<Parameter> =
            field("p0").iter().map(|&value| Parameter { value, ..Parameter::default() }).collect();
        let count = parameters.len();
        for (step, gradients) in field("g").chunks(count).enumerate() {
            for (parameter, &gradient) in parameters.iter_mut().zip(gradients) {
                adam_step(parameter, gradient, rate, step as u32 + 1);
            }
            let now = step * count..(step + 1) * count;
            compare_adam(
                group,
                &parameters,
                [&field("p")[now.clone()], &field("m")[now.clone()], &field("v")[now]],
            )?;
        }
        // The sparse variant continues with the first gradient again.
        let visible = field("sp_vis");
        let per_gaussian = count / visible.len();
        for (i, parameter) in parameters.iter_mut().enumerate() {
            if visible[i / per_gaussian] != 0.0 {
                adam_sparse(parameter, field("g")[i], rate);
            }
        }
        compare_adam(group, &parameters, [field("sp_p"), field("sp_m"), field("sp_v")])?;
    }
    Ok(())
}

fn compare_adam(group: &str, parameters: &[Parameter], expected: [&[f64]; 3]) -> Outcome {
    let column = |value: fn(&Parameter) -> f64| parameters.iter().map(value).collect::<Vec<f64>>();
    elementwise(&format!("{group} value"), &column(|p| p.value), expected[0], 1e-7, ROUNDING)?;
    elementwise(&format!("{group} first moment"), &column(|p| p.moment1), expected[1], 1e-12, ROUNDING)?;
    elementwise(&format!("{group} second moment"), &column(|p| p.moment2), expected[2], 1e-15, ROUNDING)?;
    Ok(())
}

pub fn rates(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let steps = npz.values("steps");
    let position: Vec<f64> = npz
        .values("extents")
        .iter()
        .flat_map(|&extent| steps.iter().map(move |&step| schedule::position_rate(step, extent)))
        .collect();
    elementwise("position rate", &position, npz.values("lr_xyz"), 0.0, 1e-6)?;
    let exposure: Vec<f64> = steps.iter().map(|&s| schedule::exposure_rate(s)).collect();
    elementwise("exposure rate", &exposure, npz.values("lr_exposure"), 0.0, 1e-6)?;
    let depth: Vec<f64> = steps.iter().map(|&s| schedule::depth_weight(s)).collect();
    elementwise("inverse-depth weight", &depth, npz.values("depth_l1_weight"), 0.0, 1e-6)?;
    Ok(())
}

pub fn densify(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let before = gaussians(&npz, "in_");
    let statistics: Vec<Statistic> = npz
        .values("in_grad_accum")
        .iter()
        .zip(npz.values("in_denom"))
        .map(|(&gradient, &views)| Statistic { gradient, views })
        .collect();
    let scene_extent = npz.scalar("extent");
    let decisions: Vec<Decision> =
        before.iter().zip(&statistics).map(|(g, s)| decide(g.log_scale, *s, scene_extent)).collect();
    let having = |wanted| decisions.iter().map(|&d| f64::from(u8::from(d == wanted))).collect::<Vec<f64>>();
    equal("clone", &having(Decision::Clone), npz.values("clone"))?;
    equal("split", &having(Decision::Split), npz.values("split"))?;

    let splits = npz.array("noise").shape[1];
    let noise = npz.rows::<3>("noise");
    let settings = Densify { scene_extent, prune_big: npz.scalar("max_screen") != 0.0 };
    let after = place(&before, &statistics, settings, |child, split| noise[child * splits + split]);
    let column = |value: &dyn Fn(&crate::reference::scatter_sources::Placed) -> Vec<f64>| -> Vec<f64> {
        after.iter().flat_map(value).collect()
    };
    equal("parent", &column(&|p| vec![p.parent as f64]), npz.values("out_parent"))?;
    equal("kind", &column(&|p| vec![p.kind as u8 as f64]), npz.values("out_kind"))?;
    for (field, _, values) in FIELDS {
        let name = format!("out_{field}");
        elementwise(&name, &column(&|p| values(&p.gaussian)), npz.values(&name), 1e-7, ROUNDING)?;
    }
    Ok(())
}

pub fn reset_opacity(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let out: Vec<f64> =
        npz.values("logits").iter().map(|&logit| reset_twin::reset_opacity(logit, 1.0)).collect();
    elementwise("logit", &out, npz.values("out"), ROUNDING, ROUNDING)?;
    Ok(())
}

pub fn train(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let view = view(&npz);
    let [width, height] = view.size_px.map(|n| n as usize);
    let mut gaussians = gaussians(&npz, "in_");
    let mut moments = vec![Vec::new(); gaussians.len()];
    for iteration in (1..).take_while(|i| npz.has(&format!("it{i}_image"))) {
        let field = |name: &str| format!("it{iteration}_{name}");
        let frame = render(&gaussians, &view);
        let image: Vec<f64> = frame.pixels.iter().flat_map(|p| p.color).collect();
        let unstable = npz.flags(&field("pix_unstable"));
        let bound = PixelTolerance { max: 1e-6, mean: 1e-7, unstable: 2e-2 };
        pixels("image", &image, npz.values(&field("image")), &unstable, bound)?;
        let loss = loss_reduce::loss(&image, npz.values("gt"), width, height);
        elementwise("loss", &[loss.loss], npz.values(&field("loss")), 0.0, 1e-6)?;
        gradient(
            "d_img",
            &loss.gradient,
            npz.values(&field("d_img")),
            &vec![false; width * height],
            GRADIENT,
        )?;
        let d_pixels = pixel_gradients(loss.gradient.as_chunks().0.iter().copied());
        let gradients = backward(&gaussians, &view, &frame, &d_pixels).parameters;
        let extent = npz.scalar("extent");
        let departing = departing(&gaussians, &view, &frame);
        for ((gaussian, gradient), moments) in gaussians.iter_mut().zip(&gradients).zip(&mut moments) {
            step(gaussian, gradient, moments, iteration, extent);
        }
        compare_iteration(&npz, iteration, (&gaussians, &gradients), &departing)?;
    }
    Ok(())
}

/// Gaussians for which the vectors follow the reference implementation's derivative instead of the exact one: a
/// limit of the Jacobian acts, or α's clamp at a pixel. Adam's first steps are the rate times a sign, so the
/// difference may be a full step.
pub fn departing(gaussians: &[Gaussian], view: &View, frame: &Frame) -> Vec<bool> {
    let mut departing: Vec<bool> = gaussians
        .iter()
        .map(|g| intermediate(g, view).is_some_and(|i| i.limited[0] || i.limited[1]))
        .collect();
    for pixel in pixels_of(view) {
        for &gaussian in &frame.lists[tile_of(view, pixel)] {
            let splat = frame.splats[gaussian as usize].as_ref().expect("only visible Gaussians are listed");
            departing[gaussian as usize] |=
                alpha_unclamped(splat, pixel).is_some_and(|alpha| alpha > ALPHA_MAX);
        }
    }
    departing
}

fn compare_iteration(
    npz: &Npz,
    iteration: u32,
    (after, gradients): (&[Gaussian], &[Gradient]),
    departing: &[bool],
) -> Outcome {
    for (name, of_gradient, of_gaussian) in FIELDS {
        let d: Vec<f64> = gradients.iter().flat_map(of_gradient).collect();
        let d_name = format!("it{iteration}_d_{name}");
        gradient(&d_name, &d, npz.values(&d_name), departing, GRADIENT)?;
        let value_name = format!("it{iteration}_{name}");
        let width = d.len() / after.len();
        let expected = npz.values(&value_name).chunks(width);
        for ((gaussian, expected), departing) in after.iter().zip(expected).zip(departing) {
            if !departing {
                elementwise(&value_name, &of_gaussian(gaussian), expected, 1e-6, ROUNDING)?;
            }
        }
    }
    Ok(())
}

pub type Field = (&'static str, fn(&Gradient) -> Vec<f64>, fn(&Gaussian) -> Vec<f64>);

/// Fields of the vectors, with their gradients and parameters.
pub const FIELDS: [Field; 5] = [
    ("means", |g| g.mean.to_vec(), |g| g.mean.to_vec()),
    ("quats", |g| g.quat.to_vec(), |g| g.quat.to_vec()),
    ("log_scales", |g| g.log_scale.to_vec(), |g| g.log_scale.to_vec()),
    ("opacity_logits", |g| vec![g.opacity_logit], |g| vec![g.opacity_logit]),
    ("sh", |g| g.sh.concat(), |g| g.sh.concat()),
];

fn step(gaussian: &mut Gaussian, d: &Gradient, moments: &mut Vec<Parameter>, iteration: u32, extent: f64) {
    let mut updates: Vec<(&mut f64, f64, f64)> = Vec::new();
    let position = schedule::position_rate(f64::from(iteration), extent);
    updates.extend(gaussian.mean.iter_mut().zip(d.mean).map(|(p, g)| (p, g, position)));
    updates.extend(gaussian.quat.iter_mut().zip(d.quat).map(|(p, g)| (p, g, 1e-3)));
    updates.extend(gaussian.log_scale.iter_mut().zip(d.log_scale).map(|(p, g)| (p, g, 5e-3)));
    updates.push((&mut gaussian.opacity_logit, d.opacity_logit, 0.025));
    for (k, (coefficient, gradient)) in gaussian.sh.iter_mut().zip(&d.sh).enumerate() {
        let rate = if k == 0 { 2.5e-3 } else { 2.5e-3 / 20.0 };
        updates.extend(coefficient.iter_mut().zip(*gradient).map(|(p, g)| (p, g, rate)));
    }
    moments.resize(updates.len(), Parameter::default());
    for ((value, gradient, rate), parameter) in updates.into_iter().zip(moments) {
        parameter.value = *value;
        adam_step(parameter, gradient, rate, iteration);
        *value = parameter.value;
    }
}

/// Weights of the mean opacity and of the mean scale in the sets.
pub const REGULARIZER_WEIGHTS: [f64; 2] = [0.01, 0.01];

/// Gaussians with opacities and scales only.
pub struct RegularizerSet {
    pub gaussians: Vec<Gaussian>,
}

impl RegularizerSet {
    pub fn read(path: &Path) -> RegularizerSet {
        let npz = Npz::read(path);
        let scales = npz.rows::<3>("log_scales");
        let of = |(&opacity_logit, &log_scale): (&f64, &[f64; 3])| Gaussian {
            mean: [0.0; 3],
            quat: [1.0, 0.0, 0.0, 0.0],
            log_scale,
            opacity_logit,
            sh: vec![[0.0; 3]],
        };
        RegularizerSet { gaussians: npz.values("opacity_logits").iter().zip(&scales).map(of).collect() }
    }

    pub fn check_gradients(&self, npz: &Npz, actual: &[Gaussian], relative: f64) -> Outcome {
        let logits: Vec<f64> = actual.iter().map(|g| g.opacity_logit).collect();
        let scales: Vec<f64> = actual.iter().flat_map(|g| g.log_scale).collect();
        let absolute = |values: &[f64]| relative * values.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
        let (d_logits, d_scales) = (npz.values("reg_d_opacity_logits"), npz.values("reg_d_log_scales"));
        elementwise("d opacity logit", &logits, d_logits, absolute(d_logits), relative)?;
        elementwise("d log-scale", &scales, d_scales, absolute(d_scales), relative)?;
        Ok(())
    }
}

pub fn regularizers(path: &Path) -> Outcome {
    super::mcmc::noise_of_twin(path)?;
    let (set, npz) = (RegularizerSet::read(path), Npz::read(path));
    let sums = regularize_twin::regularize(&set.gaussians, REGULARIZER_WEIGHTS);
    let [loss, ..] = regularize_twin::losses(&sums, set.gaussians.len(), REGULARIZER_WEIGHTS);
    elementwise("loss", &[loss], npz.values("reg_loss"), 0.0, 2e-7)?;
    set.check_gradients(&npz, &sums.gradients, 2e-7)
}
