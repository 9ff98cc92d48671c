//! The depths of sparse points: the loss and its gradients; the device against the vectors.

use super::Outcome;
use super::sets::{gaussians, view};
use super::stages::Stages;
use crate::common::engine::twins;
use crate::common::prelude::*;
use crate::common::terms::points as engine_points;
use crate::golden::npz::Npz;
use crate::reference::sparse_depth::{Point, corners};
use ashsplat::frame::{SceneBuffers, planes};
use ashsplat::passes::backward::{BackwardForm, Statistics};
use ashsplat::passes::loss::{DepthPointBuffers, LossTerm, TermInputs};
use ashsplat::passes::pixels::LayoutConverter;
use ashsplat::train::SparseDepth;
use std::path::Path;

struct Computed {
    /// Expected depth and sum of the weights, per pixel.
    expected_depth: Vec<f64>,
    coverage: Vec<f64>,
    loss: f64,
    gradients: Vec<Gradient>,
}

/// Wide, because small coverages divide.
const DEPTH: f64 = 1e-4;
const LOSS: f64 = 1e-5;
const GRADIENT: GradientTolerance = GradientTolerance { relative_l2: 1e-3, max_over_max: 1e-3 };

fn judge(npz: &Npz, computed: &Computed) -> Outcome {
    let unstable = npz.flags("pix_unstable");
    let wanted = npz.values("expected_depth");
    let counts = |pixel: &usize| computed.coverage[*pixel] > 0.01 && !unstable[*pixel];
    let places: Vec<usize> = (0..wanted.len()).filter(counts).collect();
    if 2 * places.len() < wanted.len() {
        return Err(format!("only {} pixels are compared", places.len()).into());
    }
    let of = |values: &[f64]| places.iter().map(|&pixel| values[pixel]).collect::<Vec<f64>>();
    elementwise("depth", &of(&computed.expected_depth), &of(wanted), 0.0, DEPTH)?;
    let size = view(npz).size_px.map(|side| side as usize);
    let sampled: Vec<f64> = points(npz)
        .iter()
        .map(|point| {
            let all = corners(point.position_px, size).into_iter();
            all.map(|(at, share)| share * computed.expected_depth[at]).sum()
        })
        .collect();
    elementwise("sampled", &sampled, npz.values("sampled"), 0.0, DEPTH)?;
    elementwise("loss", &[computed.loss], npz.values("loss"), 0.0, LOSS)?;
    let column = |of: fn(&Gradient) -> Vec<f64>| computed.gradients.iter().flat_map(of).collect::<Vec<f64>>();
    let skip = vec![false; computed.gradients.len()];
    for (name, values) in [
        ("dx_means", column(|g| g.mean.to_vec())),
        ("dx_quats", column(|g| g.quat.to_vec())),
        ("dx_log_scales", column(|g| g.log_scale.to_vec())),
        ("dx_opacity_logits", column(|g| vec![g.opacity_logit])),
    ] {
        gradient(name, &values, npz.values(name), &skip, GRADIENT)?;
    }
    Ok(())
}

fn points(npz: &Npz) -> Vec<Point> {
    let pairs = npz.rows::<2>("points_xy").into_iter().zip(npz.values("points_z"));
    pairs.map(|(position_px, z)| Point { position_px, inverse_z: 1.0 / z }).collect()
}

pub fn check(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let gpu = Gpu::new();
    let (context, set) = (gpu.context, gaussians(&npz, ""));
    let view = View { extent: Extent::Exact, ..view(&npz) };
    let stages = Stages::with_depth(&gpu, &set, std::slice::from_ref(&view), true);
    let size = (view.size_px[0], view.size_px[1]);
    let all = engine_points(&points(&npz));
    let points = DepthPointBuffers::new(context, &all, size)?;
    // The weight is the first iteration's.
    let settings = TrainSettings { depth_points: npz.scalar("weight"), ..TrainSettings::reference() };
    let extent = npz.scalar("scene_scale") as f32;
    let term = SparseDepth::new(context, &settings, extent, all.len() as u32)?;
    let scratch: Vec<_> = term
        .scratch_requests(&[size])
        .into_iter()
        .map(|(name, bytes)| gpu.zeros::<u32>(name, bytes as usize / 4))
        .collect();
    let losses = gpu.zeros::<[f32; 4]>("losses", 1);
    let gradient =
        gpu.zeros::<u8>("image_gradient", LayoutConverter::gradient_bytes(size.0, size.1) as usize);
    let statistics = gpu.zeros::<[f32; 2]>("statistics", set.len());
    let mean2d = gpu.zeros::<[f32; 2]>("mean2d_gradients", set.len());
    let chunks = planes::allocate(context, "gradients", MemoryKind::Device, &stages.scene.plan)?;
    let pixels = view.pixels();
    let [mut sums, mut transmittances] = [Vec::new(), Vec::new()];
    for records in [false, true] {
        let mut drawn = None;
        stages.run(&view, |r, inputs, backward| {
            drawn = Some((inputs.buffers.depth_sums.clone(), inputs.buffers.accumulated.clone()));
            if !records {
                return;
            }
            term.record(
                r,
                &TermInputs {
                    frame: inputs,
                    picture: &gradient,
                    photo: &gradient,
                    image_gradient: &gradient,
                    photo_is_masked: false,
                    inverse_depth_map: None,
                    depth_points: Some(&points),
                    iteration: 0,
                    parameter_gradients: &[],
                    scratch: &scratch,
                    losses: &losses,
                    row: 0,
                },
            );
            r.barrier();
            let statistics = Statistics { buffer: &statistics, accumulate: false };
            backward.record(r, inputs, &gradient, statistics, BackwardForm::default());
            r.barrier();
            backward.record_expand_gradients(r, inputs, &chunks, &mean2d);
        });
        if let (false, Some((depth, accumulated))) = (records, drawn) {
            sums = gpu.read::<f32>(&depth, pixels);
            transmittances = gpu.read::<[f32; 4]>(&accumulated, pixels).into_iter().map(|p| p[3]).collect();
        }
    }
    let planes_of = SceneBuffers { chunks, ..stages.scene.clone() };
    let all: Gaussians = planes::download(context, &planes_of)?;
    let gradients = twins(&all).into_iter().map(|g| Gradient {
        mean: g.mean,
        quat: g.quat,
        log_scale: g.log_scale,
        opacity_logit: g.opacity_logit,
        sh: g.sh,
    });
    let coverage: Vec<f64> = transmittances.iter().map(|&t| 1.0 - f64::from(t)).collect();
    let depths = sums.iter().zip(&coverage).map(|(&sum, coverage)| f64::from(sum) / coverage.max(1e-10));
    let computed = Computed {
        expected_depth: depths.collect(),
        loss: f64::from(gpu.read::<[f32; 4]>(&losses, 1)[0][0]),
        coverage,
        gradients: gradients.collect(),
    };
    judge(&npz, &computed)
}
