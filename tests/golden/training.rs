//! Loss, optimiser and densification of the device against the vectors.

use super::Outcome;
use super::rendering::SINGLE;
use super::sets::{gaussians, view};
use crate::common::adam::{AdamState, Rates, Step, VisibleGradient};
use crate::common::engine;
use crate::common::prelude::*;
use crate::common::terms::regularize;
use crate::golden::npz::{Npz, rows};
use crate::reference::pipeline::{Frame as TwinFrame, pixels_of, render, tile_of};
use crate::reference::project::intermediate;
use crate::reference::tiles::alpha_unclamped;
use crate::reference::types::ALPHA_MAX;
use crate::reference::{schedule, sh};
use ashsplat::frame::{LaunchSizes, SceneBuffers, Strips, planes};
use ashsplat::kernels::constants::{GATHER_MEAN_OPACITY, PLANE_MEAN_OPACITY};
use ashsplat::kernels::densify::gather;
use ashsplat::passes::adam::Moments;
use ashsplat::passes::densify::{
    ClassifyInputs, Densify, DensifyBuffers, DensifyForm, DensifySettings, Gather, RESET_OPACITY, RandomKey,
};
use ashsplat::passes::loss::{Loss, LossInputs, NativeLayout, PhotoFormat};
use libtest_mimic::Failed;
use std::path::Path;

const ROUNDING: f64 = 1e-6;

/// The parameter groups of the vectors.
const GROUPS: [&str; 6] = ["xyz", "f_dc", "f_rest", "opacity", "scaling", "rotation"];

type Field = (&'static str, fn(&Gradient) -> Vec<f64>, fn(&Gaussian) -> Vec<f64>);

/// Fields of the vectors, with their gradients and parameters.
const FIELDS: [Field; 5] = [
    ("means", |g| g.mean.to_vec(), |g| g.mean.to_vec()),
    ("quats", |g| g.quat.to_vec(), |g| g.quat.to_vec()),
    ("log_scales", |g| g.log_scale.to_vec(), |g| g.log_scale.to_vec()),
    ("opacity_logits", |g| vec![g.opacity_logit], |g| vec![g.opacity_logit]),
    ("sh", |g| g.sh.concat(), |g| g.sh.concat()),
];

/// Weights of the mean opacity and of the mean scale in the sets.
const REGULARIZER_WEIGHTS: [f64; 2] = [0.01, 0.01];

/// Gaussians with opacities and scales only.
struct RegularizerSet {
    gaussians: Vec<Gaussian>,
}

impl RegularizerSet {
    fn read(path: &Path) -> RegularizerSet {
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

    fn check_gradients(&self, npz: &Npz, actual: &[Gaussian], relative: f64) -> Outcome {
        let logits: Vec<f64> = actual.iter().map(|g| g.opacity_logit).collect();
        let scales: Vec<f64> = actual.iter().flat_map(|g| g.log_scale).collect();
        let absolute = |values: &[f64]| relative * values.iter().fold(0.0, |max: f64, x| max.max(x.abs()));
        let (d_logits, d_scales) = (npz.values("reg_d_opacity_logits"), npz.values("reg_d_log_scales"));
        elementwise("d opacity logit", &logits, d_logits, absolute(d_logits), relative)?;
        elementwise("d log-scale", &scales, d_scales, absolute(d_scales), relative)?;
        Ok(())
    }
}

/// Gaussians for which the vectors follow the reference implementation's derivative instead of the exact one: a
/// limit of the Jacobian acts, or α's clamp at a pixel. Adam's first steps are the rate times a sign, so the
/// difference may be a full step.
fn departing(gaussians: &[Gaussian], view: &View, frame: &TwinFrame) -> Vec<bool> {
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

/// Loss, L1, SSIM and gradient of a picture against float ground truth.
pub(super) fn device_loss(
    gpu: &Gpu,
    layout: NativeLayout,
    [image, truth]: [&[f64]; 2],
    [width, height]: [u32; 2],
) -> ([f64; 3], Vec<f64>) {
    let loss = Loss::with_layout(gpu.context, PhotoFormat::Float, layout).expect("kernels");
    let strips = Strips { width, height };
    let [image, truth] = [image, truth].map(|x| {
        let pixels: Vec<[f32; 3]> = rows::<3>(x).iter().map(|pixel| pixel.map(|x| x as f32)).collect();
        pixels
    });
    let (rendered, photo) = match layout {
        // The transmittance is 0, so no background shows.
        NativeLayout::Rows => {
            let texels: Vec<[f32; 4]> = image.iter().map(|&[r, g, b]| [r, g, b, 0.0]).collect();
            (texels.into_flattened(), truth.into_flattened())
        }
        NativeLayout::Strips => (strips.planes(image), strips.planes(truth)),
    };
    let (rendered, photo) = (gpu.buffer("rendered", &rendered), gpu.buffer("photo", &photo));
    let scratch: Vec<_> = (loss.scratch_requests([(width, height)]).into_iter())
        .map(|(name, bytes)| gpu.untouched::<u8>(name, bytes as usize))
        .collect();
    let losses = gpu.untouched::<[f32; 4]>("losses", 2);
    let words = 4 * strips.values() as usize;
    let image_gradient = gpu.untouched::<f32>("image_gradient", words);
    gpu.run(|recorder| {
        loss.record(
            recorder,
            &LossInputs {
                rendered: &rendered,
                photo: &photo,
                scratch: &scratch,
                losses: &losses,
                row: 1,
                image_gradient: &image_gradient,
                width,
                height,
                background: [0.0; 3],
                lambda_dssim: 0.2,
                weight: 1.0,
            },
        );
    });
    let [value, l1, ssim, _] = gpu.read::<[f32; 4]>(&losses, 2)[1];
    let gradient = gpu.read::<f32>(&image_gradient, words);
    let place = |i: u32, channel: u32| match layout {
        NativeLayout::Rows => 4 * i as usize + channel as usize,
        NativeLayout::Strips => strips.index(channel, i % width, i / width),
    };
    let gradient = (0..width * height).flat_map(|i| [0, 1, 2].map(|c| f64::from(gradient[place(i, c)])));
    let gradient = gradient.collect();
    ([value, l1, ssim].map(f64::from), gradient)
}

pub fn loss(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let shape = &npz.array("img").shape;
    let size = [shape[1] as u32, shape[0] as u32];
    let gpu = Gpu::new();
    for layout in gpu.layouts() {
        let ([loss, l1, ssim], d_img) =
            device_loss(&gpu, layout, [npz.values("img"), npz.values("gt")], size);
        elementwise("loss", &[loss], npz.values("loss"), 0.0, ROUNDING)?;
        elementwise("l1", &[l1], npz.values("l1"), 0.0, ROUNDING)?;
        elementwise("ssim", &[ssim], npz.values("ssim"), ROUNDING, ROUNDING)?;
        let skip = vec![false; d_img.len() / 3];
        gradient("d_img", &d_img, npz.values("d_img"), &skip, SINGLE.gradient)?;
    }
    Ok(())
}

/// Values of a group as Gaussians: three values each; one for the opacity. The camera is at the origin and the means
/// on its axis. The gradient of SH coefficient 2 is then a known multiple of the colour's.
fn as_gaussians(group: &str, values: &[f64]) -> Vec<Gaussian> {
    let neutral = Gaussian {
        mean: [0.0, 0.0, 1.0],
        quat: [1.0, 0.0, 0.0, 0.0],
        log_scale: [0.0; 3],
        opacity_logit: 0.0,
        sh: vec![[0.0; 3]; 4],
    };
    if group == "opacity" {
        return values.iter().map(|&opacity_logit| Gaussian { opacity_logit, ..neutral.clone() }).collect();
    }
    rows::<3>(values)
        .into_iter()
        .map(|v| {
            let mut gaussian = neutral.clone();
            match group {
                "xyz" => gaussian.mean = v,
                "f_dc" => gaussian.sh[0] = v,
                "f_rest" => gaussian.sh[2] = v,
                "scaling" => gaussian.log_scale = v,
                _ => gaussian.quat[..3].copy_from_slice(&v),
            }
            gaussian
        })
        .collect()
}

/// The inverse of [`as_gaussians`].
fn of_gaussians(group: &str, gaussians: &[Gaussian]) -> Vec<f64> {
    let of = |g: &Gaussian| match group {
        "opacity" => vec![g.opacity_logit],
        "xyz" => g.mean.to_vec(),
        "f_dc" => g.sh[0].to_vec(),
        "f_rest" => g.sh[2].to_vec(),
        "scaling" => g.log_scale.to_vec(),
        _ => g.quat[..3].to_vec(),
    };
    gaussians.iter().flat_map(of).collect()
}

fn as_gradients(group: &str, values: &[f64]) -> Vec<VisibleGradient> {
    let along = sh::basis([0.0, 0.0, 1.0]);
    as_gaussians(group, values)
        .into_iter()
        .map(|g| VisibleGradient {
            mean: if group == "xyz" { g.mean } else { [0.0; 3] },
            opacity_logit: g.opacity_logit,
            quat: if group == "rotation" { [g.quat[0], g.quat[1], g.quat[2], 0.0] } else { [0.0; 4] },
            log_scale: g.log_scale,
            color: match group {
                "f_rest" => g.sh[2].map(|x| x / along[2]),
                _ => g.sh[0].map(|x| x / along[0]),
            },
        })
        .collect()
}

fn rates_of(group: &str, rate: f64) -> Rates {
    let mut rates = Rates::default();
    match group {
        "xyz" => rates.mean = rate,
        "opacity" => rates.opacity = rate,
        "f_dc" => rates.sh_dc = rate,
        "f_rest" => rates.sh_rest = rate,
        "scaling" => rates.log_scale = rate,
        _ => rates.quat = rate,
    }
    rates
}

pub fn adam(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let gpu = Gpu::new();
    for group in GROUPS {
        let field = |name: &str| npz.values(&format!("{group}_{name}"));
        let rates = rates_of(group, field("lr")[0]);
        let count = field("p0").len();
        let dense = AdamState::new(&gpu, &as_gaussians(group, field("p0")), 1, false);
        for (place, values) in field("g").chunks(count).enumerate() {
            let gradients: Vec<_> = as_gradients(group, values).into_iter().map(Some).collect();
            let step = Step { rates, count: place as i32 + 1, ..Step::default() };
            dense.step(&gradients, &step, false);
            let now = place * count..(place + 1) * count;
            let expected = [&field("p")[now.clone()], &field("m")[now.clone()], &field("v")[now]];
            compare_adam(group, &dense, expected)?;
        }
        let visible = field("sp_vis");
        let sparse = dense.sparse();
        let gradients = as_gradients(group, &field("g")[..count]);
        let per_flag = gradients.len() / visible.len();
        let gradients: Vec<_> = gradients
            .into_iter()
            .enumerate()
            .map(|(i, g)| (visible[i / per_flag] != 0.0).then_some(g))
            .collect();
        sparse.step(&gradients, &Step { rates, ..Step::default() }, false);
        compare_adam(group, &sparse, [field("sp_p"), field("sp_m"), field("sp_v")])?;
    }
    Ok(())
}

fn compare_adam(group: &str, state: &AdamState, expected: [&[f64]; 3]) -> Outcome {
    let actual = state.download().map(|gaussians| of_gaussians(group, &gaussians));
    elementwise(&format!("{group} value"), &actual[0], expected[0], 1e-6, ROUNDING)?;
    // Gradients of both signs cancel in the first moment.
    let largest = expected[1].iter().fold(0.0_f64, |largest, m| largest.max(m.abs()));
    elementwise(&format!("{group} first moment"), &actual[1], expected[1], 3e-7 * largest, ROUNDING)?;
    elementwise(&format!("{group} second moment"), &actual[2], expected[2], 1e-12, 2.0 * ROUNDING)?;
    Ok(())
}

pub fn rates(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let settings = TrainSettings::reference();
    let steps = npz.values("steps");
    let position: Vec<f64> = npz
        .values("extents")
        .iter()
        .flat_map(|&extent| steps.iter().map(move |&step| (step, extent)))
        .map(|(step, extent)| settings.position_lr(step as u32) * extent)
        .collect();
    elementwise("position rate", &position, npz.values("lr_xyz"), 0.0, ROUNDING)?;
    Ok(())
}

pub fn densify(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let gpu = Gpu::new();
    let scene_extent = npz.scalar("extent");
    let prune_big = npz.scalar("max_screen") != 0.0;
    let settings = DensifySettings {
        gradient_threshold: 2e-4,
        clone_scale: (0.01 * scene_extent) as f32,
        min_opacity: 0.005,
        max_scale: if prune_big { (0.1 * scene_extent) as f32 } else { 0.0 },
    };
    let sums = npz.values("in_grad_accum").iter().zip(npz.values("in_denom"));
    let statistics: Vec<[f32; 2]> = sums.map(|(&sum, &views)| [sum as f32, views as f32]).collect();
    let statistics = gpu.buffer("statistics", &statistics);
    let inputs = ClassifyInputs { statistics: &statistics, selected: None };
    let densify = Densify::new(gpu.context, DensifyForm::default()).expect("the kernels of densification");
    let noise = noise_of_gaussians(&npz);
    let after = densified(&gpu, &npz, &densify, (inputs, &settings), Some(&noise))?;
    compare_parameters(&npz, &after, 2.0 * ROUNDING)
}

pub(super) fn compare_parameters(npz: &Npz, after: &[Gaussian], tolerance: f64) -> Outcome {
    for (field, _, values) in FIELDS {
        let name = format!("out_{field}");
        let actual: Vec<f64> = after.iter().flat_map(values).collect();
        elementwise(&name, &actual, npz.values(&name), tolerance, tolerance)?;
    }
    Ok(())
}

/// Reorders the noise from child and split to child and Gaussian.
fn noise_of_gaussians(npz: &Npz) -> Vec<[f32; 3]> {
    let noise = npz.rows::<3>("noise");
    let (splits, split) = (npz.array("noise").shape[1], npz.flags("split"));
    let mut by_gaussian = vec![[f32::NAN; 3]; 2 * split.len()];
    let parents = split.iter().enumerate().filter(|(_, split)| **split).map(|(gaussian, _)| gaussian);
    for (place, gaussian) in parents.enumerate() {
        for child in 0..2 {
            by_gaussian[child * split.len() + gaussian] = noise[child * splits + place].map(|x| x as f32);
        }
    }
    by_gaussian
}

/// Replaces the means of split Gaussians, whose noise is random, by means with the golden vectors' noise.
fn gather_means(gpu: &Gpu, scene: &SceneBuffers, target: &SceneBuffers, sources: &Buffer, noise: &Buffer) {
    let spec =
        gather::Spec { workgroup_size: gpu.workgroup(64), explicit_noise: true, ..gather::Spec::default() };
    let bind = gather::Bind { sources, from: &scene.chunks[0], to: &target.chunks[0], noise };
    let push = gather::Push {
        from_count: scene.count,
        to_count: target.count,
        from_place: plane_place(PLANE_MEAN_OPACITY, scene.plan.chunk_gaussians as usize),
        to_place: plane_place(PLANE_MEAN_OPACITY, target.plan.chunk_gaussians as usize),
        form: GATHER_MEAN_OPACITY,
        noise_stride: scene.count,
        ..gather::Push::default()
    };
    gpu.dispatch_over::<gather::Interface>(&spec, &bind, &push, target.count as usize);
}

/// Densifies a set's Gaussians, compares their sources and returns them.
pub(super) fn densified(
    gpu: &Gpu,
    npz: &Npz,
    densify: &Densify,
    (inputs, settings): (ClassifyInputs, &DensifySettings),
    noise: Option<&[[f32; 3]]>,
) -> Result<Vec<Gaussian>, Failed> {
    let input = engine::gaussians(&gaussians(npz, "in_"));
    let count = input.len() as u32;
    let scene = planes::upload(gpu.context, "test", &input, count, input.sh_degree)?;
    let requests = DensifyBuffers::requests(&LaunchSizes::new(gpu.context.limits()), count, 2 * count);
    let buffers = requests.into_iter().map(|(name, bytes)| gpu.untouched::<u8>(name, bytes as usize));
    let buffers = DensifyBuffers::from_allocated(buffers.collect());
    gpu.run(|r| densify.record_classify(r, &scene, inputs, &buffers, settings));
    let totals = gpu.read::<u32>(&buffers.totals, 3);
    let rows = totals[0] + totals[1] + 2 * totals[2];
    let target = planes::upload(gpu.context, "test", &ashsplat::Gaussians::default(), rows, input.sh_degree)?;
    let target = SceneBuffers { count: rows, ..target };
    gpu.run(|r| {
        densify.record_scatter_sources(r, count, rows, &buffers);
        r.barrier();
        let gather = Gather { from: &scene, to: &target, sources: &buffers.sources, scratch: &[] };
        densify.record_gather_parameters(r, &gather, &RandomKey { seed: 0, iteration: 0 });
    });
    if let Some(noise) = noise {
        gather_means(gpu, &scene, &target, &buffers.sources, &gpu.buffer("noise", noise));
    }
    let sources = gpu.read::<u32>(&buffers.sources, rows as usize);
    let parents: Vec<f64> = sources.iter().map(|source| f64::from(source & 0x3FFF_FFFF)).collect();
    equal("parent", &parents, npz.values("out_parent"))?;
    let kinds: Vec<f64> = sources.iter().map(|source| f64::from((source >> 30).min(2))).collect();
    equal("kind", &kinds, npz.values("out_kind"))?;
    Ok(engine::twins(&planes::download(gpu.context, &target)?))
}

pub fn reset_opacity(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let gpu = Gpu::new();
    let before = as_gaussians("opacity", npz.values("logits"));
    let input = engine::gaussians(&before);
    let upload = || planes::upload(gpu.context, "test", &input, 0, 1).expect("upload");
    // Moments are planes as well; copies of the scene take their place.
    let (scene, first, second) = (upload(), upload(), upload());
    let moments = Moments {
        packed: false,
        plan: first.plan,
        sets: [&first, &second].map(|set| set.chunks.clone()).into(),
    };
    let densify = Densify::new(gpu.context, DensifyForm::default()).expect("the kernels of densification");
    gpu.run(|recorder| densify.record_reset(recorder, &scene, &moments, RESET_OPACITY));
    let [after, first, second] = [&scene, &first, &second]
        .map(|s| engine::twins(&planes::download(gpu.context, s).expect("download")));
    elementwise("logit", &of_gaussians("opacity", &after), npz.values("out"), ROUNDING, ROUNDING)?;
    for ((after, moments), before) in after.iter().zip(first.iter().zip(&second)).zip(&before) {
        let unchanged = |g: &Gaussian| (g.mean, g.quat, g.log_scale, g.sh.clone());
        let zeroed = [moments.0, moments.1]
            .iter()
            .all(|m| m.opacity_logit == 0.0 && unchanged(m) == unchanged(before));
        if unchanged(after) != unchanged(before) || !zeroed {
            return Err(format!("more than the opacity has changed: {after:?}, {moments:?}").into());
        }
    }
    Ok(())
}

pub fn regularizers(path: &Path) -> Outcome {
    super::mcmc::noise(path)?;
    let (set, npz) = (RegularizerSet::read(path), Npz::read(path));
    let gpu = Gpu::new();
    let ([loss, ..], gradients) = regularize(&gpu, &set.gaussians, REGULARIZER_WEIGHTS);
    elementwise("loss", &[loss], npz.values("reg_loss"), 0.0, ROUNDING)?;
    set.check_gradients(&npz, &gradients, ROUNDING)
}

/// Full iterations on the device: picture, loss, gradients and step.
pub fn train(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let view = view(&npz);
    let gpu = Gpu::new();
    let start = gaussians(&npz, "in_");
    let (camera, settings) = (engine::camera(&view), engine::settings(&view));
    let adam = AdamState::new(&gpu, &start, 0, false);
    for iteration in (1..).take_while(|i| npz.has(&format!("it{i}_image"))) {
        let field = |name: &str| format!("it{iteration}_{name}");
        let [before, ..] = adam.download();
        let mut renderer = engine::renderer();
        renderer.upload(&engine::gaussians(&before))?;
        let image = engine::widen(&renderer.render(&camera, &settings)?.color);
        let unstable = npz.flags(&field("pix_unstable"));
        pixels("image", &image, npz.values(&field("image")), &unstable, SINGLE.image)?;
        let ([loss, ..], d_img) = device_loss(
            &gpu,
            NativeLayout::of(gpu.context.limits()),
            [&image, npz.values("gt")],
            view.size_px,
        );
        elementwise("loss", &[loss], npz.values(&field("loss")), 0.0, ROUNDING)?;
        let bound = PixelTolerance { max: 1e-7, mean: 1e-9, unstable: 1e-3 };
        pixels("d_img", &d_img, npz.values(&field("d_img")), &unstable, bound)?;
        let target: Vec<[f32; 3]> = rows::<3>(&d_img).into_iter().map(|d| d.map(|x| x as f32)).collect();
        let gradients = renderer.gradients(&camera, &settings, &target, None)?;
        drop(renderer);
        let gradients = engine::twins(&gradients.parameters);
        let step = Step {
            rates: Rates {
                mean: schedule::position_rate(f64::from(iteration), npz.scalar("extent")),
                opacity: 0.025,
                quat: 1e-3,
                log_scale: 5e-3,
                sh_dc: 2.5e-3,
                sh_rest: 2.5e-3 / 20.0,
            },
            count: iteration,
            camera_position: [0.0; 3],
        };
        let visible: Vec<_> = gradients.iter().map(|g| Some(visible_gradient(g))).collect();
        adam.step(&visible, &step, false);
        let departing = departing(&before, &view, &render(&before, &view));
        let [after, ..] = adam.download();
        compare_iteration(&npz, iteration, (&after, &gradients), &departing)?;
    }
    Ok(())
}

/// Only the SH coefficient of degree 0 is active.
fn visible_gradient(g: &Gaussian) -> VisibleGradient {
    VisibleGradient {
        mean: g.mean,
        opacity_logit: g.opacity_logit,
        quat: g.quat,
        log_scale: g.log_scale,
        color: g.sh[0].map(|d| d / sh::basis([0.0, 0.0, 1.0])[0]),
    }
}

fn compare_iteration(
    npz: &Npz,
    iteration: i32,
    (after, gradients): (&[Gaussian], &[Gaussian]),
    departing: &[bool],
) -> Outcome {
    for (name, _, of_gaussian) in FIELDS {
        let d: Vec<f64> = gradients.iter().flat_map(of_gaussian).collect();
        let d_name = format!("it{iteration}_d_{name}");
        let bound = if name == "quats" { SINGLE.quats } else { SINGLE.gradient };
        let expected_gradient = npz.values(&d_name);
        gradient(&d_name, &d, expected_gradient, departing, bound)?;
        let value_name = format!("it{iteration}_{name}");
        let width = d.len() / after.len();
        let largest = expected_gradient.iter().fold(0.0_f64, |largest, x| largest.max(x.abs()));
        let values: Vec<f64> = after.iter().flat_map(of_gaussian).collect();
        for (place, (actual, expected)) in values.iter().zip(npz.values(&value_name)).enumerate() {
            // Adam's first steps are the rate times a sign, which is undefined for a gradient within rounding of
            // zero.
            let certain = expected_gradient[place].abs() > 1e-4 * largest && !departing[place / width];
            if certain {
                elementwise(&value_name, &[*actual], &[*expected], 5e-5, 1e-6)?;
            }
        }
    }
    Ok(())
}
