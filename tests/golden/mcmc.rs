//! Relocation, growth and noise of 3DGS-MCMC: the device against the vectors.

use super::Outcome;
use super::sets::gaussians;
use crate::common::engine;
use crate::common::prelude::*;
use crate::golden::npz::Npz;
use ashsplat::frame::{LaunchSizes, SceneBuffers, planes};
use ashsplat::kernels::constants::STATE_WORDS;
use ashsplat::kernels::densify::draw_sources;
use ashsplat::kernels::optimizer::add_noise;
use ashsplat::passes::adam::Moments;
use ashsplat::passes::densify::{Densify, DensifyForm, Draw, DrawBuffers, Gather, RandomKey, Relocation};
use std::path::Path;

/// Tolerance of logits and log-scales.
const DEVICE: f64 = 1e-4;

/// One draw of a set: the uniform numbers by row, and the result.
struct Step {
    rows: usize,
    uniforms: Vec<f32>,
    sources: Vec<f64>,
    draws: Vec<f64>,
}

fn steps(npz: &Npz) -> [Step; 2] {
    let dead = npz.flags("dead");
    let count = dead.len();
    let rows = npz.values("out_opacity_logits").len();
    let mut drawn = npz.values("u_relocate").iter();
    let relocation =
        dead.iter().map(|&dead| if dead { *drawn.next().expect("a number") as f32 } else { 0.0 });
    let mut drawn = npz.values("source").iter();
    let own = |row: usize| row as f64;
    let sources =
        dead.iter().enumerate().map(|(row, &dead)| if dead { *drawn.next().expect("one") } else { own(row) });
    let added = npz.values("u_add").iter().map(|&u| u as f32);
    [
        Step {
            rows: count,
            uniforms: relocation.collect(),
            sources: sources.collect(),
            draws: npz.values("count").to_vec(),
        },
        Step {
            rows,
            uniforms: vec![0.0; count].into_iter().chain(added).collect(),
            sources: (0..count).map(own).chain(npz.values("add_source").iter().copied()).collect(),
            draws: npz.values("add_count").to_vec(),
        },
    ]
}

fn compare(npz: &Npz, prefix: &str, actual: &[Gaussian]) -> Outcome {
    let field = |name: &str| npz.values(&format!("{prefix}_{name}"));
    let column = |of: fn(&Gaussian) -> Vec<f64>| actual.iter().flat_map(of).collect::<Vec<f64>>();
    let logits = column(|g| vec![g.opacity_logit]);
    elementwise(&format!("{prefix} logit"), &logits, field("opacity_logits"), DEVICE, DEVICE)?;
    let scales = column(|g| g.log_scale.to_vec());
    elementwise(&format!("{prefix} log-scale"), &scales, field("log_scales"), DEVICE, DEVICE)?;
    equal(&format!("{prefix} mean"), &column(|g| g.mean.to_vec()), field("means"))?;
    if prefix == "mid" {
        return Ok(());
    }
    // Growth copies them.
    equal("out quaternion", &column(|g| g.quat.to_vec()), field("quats"))?;
    Ok(equal("out SH", &column(|g| g.sh.as_flattened().to_vec()), field("sh"))?)
}

/// Draws again by the weights of a draw, with the vectors' uniform numbers, one per row.
fn draw_again(gpu: &Gpu, draw: &Draw, count: u32, buffers: &DrawBuffers, uniforms: &Buffer) {
    gpu.run(|r| r.fill(&buffers.draws, 0));
    let spec = draw_sources::Spec { workgroup_size: gpu.workgroup(64), explicit_uniforms: true };
    let bind = draw_sources::Bind {
        weights: &buffers.weights,
        prefix: &buffers.prefix,
        totals: &buffers.totals,
        uniforms,
        sources: &buffers.sources,
        draws: &buffers.draws,
    };
    let push = draw_sources::Push { count, rows: draw.rows, ..draw_sources::Push::default() };
    gpu.dispatch_over::<draw_sources::Interface>(&spec, &bind, &push, draw.rows as usize);
}

pub fn relocation(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let gpu = Gpu::new();
    let context = gpu.context;
    let start = gaussians(&npz, "in_");
    let degree = start[0].sh.len().isqrt() as u32 - 1;
    let (densify, relocation) = (
        Densify::new(context, DensifyForm::default()).expect("kernels"),
        Relocation::new(context).expect("kernels"),
    );
    let rows = npz.values("out_means").len() / 3;
    let ones: Vec<Gaussian> = start
        .iter()
        .map(|g| Gaussian {
            mean: [1.0; 3],
            quat: [1.0; 4],
            log_scale: [1.0; 3],
            opacity_logit: 1.0,
            sh: vec![[1.0; 3]; g.sh.len()],
        })
        .collect();
    let upload = |set: &[Gaussian]| {
        planes::upload(context, "test", &engine::gaussians(set), rows as u32, degree).expect("upload")
    };
    // Parameters and both moments.
    let mut sets = [upload(&start), upload(&ones), upload(&ones)];
    let key = RandomKey { seed: 0, iteration: 0 };
    for (step, prefix) in steps(&npz).iter().zip(["mid", "out"]) {
        let count = sets[0].count;
        let requests = DrawBuffers::requests(&LaunchSizes::new(context.limits()), count, step.rows as u32);
        let buffers = context.allocate("test", &requests, MemoryKind::Device).expect("memory");
        let buffers = DrawBuffers::from_allocated(buffers);
        let draw = Draw { rows: step.rows as u32, replaces_dead: prefix == "mid", seed: 0, iteration: 0 };
        let after: [SceneBuffers; 3] =
            [0; 3].map(|_| SceneBuffers { count: step.rows as u32, ..upload(&ones) });
        gpu.run(|r| relocation.record_draw(r, &sets[0], &draw, &buffers));
        draw_again(&gpu, &draw, count, &buffers, &gpu.buffer("uniforms", &step.uniforms));
        gpu.run(|r| {
            for (set, (from, to)) in sets.iter().zip(&after).enumerate() {
                let gather = Gather { from, to, sources: &buffers.sources, scratch: &[] };
                match set {
                    0 => densify.record_gather_parameters(r, &gather, &key),
                    _ => densify.record_gather_moments(r, &gather),
                }
            }
            let moments = Moments {
                packed: false,
                plan: after[1].plan,
                sets: after[1..].iter().map(|set| set.chunks.clone()).collect(),
            };
            relocation.record_relocate(r, &after[0], &moments, &buffers.sources, &buffers.draws);
        });
        let sources = gpu.read::<u32>(&buffers.sources, step.rows).into_iter();
        let sources: Vec<f64> = sources.map(|source| f64::from(source & 0x3FFF_FFFF)).collect();
        equal("source", &sources, &step.sources)?;
        let draws: Vec<f64> = gpu.read_f64::<u32>(&buffers.draws, count as usize);
        equal("draws", &draws, &step.draws)?;
        sets = after;
        let set = engine::twins(&planes::download(context, &sets[0]).expect("download"));
        compare(&npz, prefix, &set)?;
    }
    for moments in &sets[1..] {
        let rows = engine::twins(&planes::download(context, moments).expect("download"));
        let zero: Vec<f64> = rows.iter().map(|m| f64::from(u8::from(m.mean == [0.0; 3]))).collect();
        equal("moments that are zero", &zero, npz.values("moments_zero"))?;
    }
    Ok(())
}

/// The set of the noise, without the means, whose rounding would hide it.
fn noise_set(npz: &Npz) -> (Vec<Gaussian>, Vec<[f64; 3]>, f64) {
    let normals = npz.rows::<3>("normals");
    let (quats, scales) = (npz.rows::<4>("quats"), npz.rows::<3>("log_scales"));
    let of = |(i, &opacity_logit): (usize, &f64)| Gaussian {
        mean: [0.0; 3],
        quat: quats[i],
        log_scale: scales[i],
        opacity_logit,
        sh: vec![[0.0; 3]],
    };
    let set = npz.values("opacity_logits").iter().enumerate().map(of).collect();
    (set, normals, npz.scalar("rate") * npz.scalar("noise_lr"))
}

fn compare_noise(npz: &Npz, deltas: &[[f64; 3]]) -> Outcome {
    for (i, (actual, expected)) in deltas.iter().zip(npz.rows::<3>("delta")).enumerate() {
        let largest = expected.iter().fold(0.0, |max: f64, x| max.max(x.abs()));
        // If the gate is closed to 24 digits, its rounding is larger than the noise.
        elementwise(&format!("noise of {i}"), actual, &expected, 1e-5 * largest + 1e-12, 0.0)?;
    }
    Ok(())
}

pub fn noise(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let gpu = Gpu::new();
    let (set, normals, rate) = noise_set(&npz);
    let scene = planes::upload(gpu.context, "test", &engine::gaussians(&set), 0, 0).expect("upload");
    let normals: Vec<[f32; 3]> = normals.iter().map(|normal| normal.map(|x| x as f32)).collect();
    let (normals, state) = (gpu.buffer("noise", &normals), gpu.zeros::<u32>("state", STATE_WORDS as usize));
    let spec = add_noise::Spec { workgroup_size: gpu.workgroup(64), explicit_noise: true };
    let bind = add_noise::Bind { parameters: &scene.chunks[0], state: &state, noise: &normals };
    let push = add_noise::Push { count: scene.count, rate: rate as f32, ..add_noise::Push::default() };
    gpu.dispatch_over::<add_noise::Interface>(&spec, &bind, &push, scene.count as usize);
    let after = engine::twins(&planes::download(gpu.context, &scene).expect("download"));
    compare_noise(&npz, &after.iter().map(|g| g.mean).collect::<Vec<_>>())
}
