//! The statistics of signed and of absolute gradients of 2D means: the device against the vectors.

use super::Outcome;
use super::rendering::SINGLE;
use super::sets::{EXTENTS, gaussians};
use super::stages::{Stages, field, views};
use crate::common::prelude::*;
use crate::golden::npz::Npz;
use ashsplat::passes::backward::{BackwardForm, Statistics};
use ashsplat::passes::pixels::LayoutConverter;
use std::path::Path;

/// Norms of the signed and of the absolute gradients, and true if visible, per Gaussian.
type Norms = Vec<(f64, f64, bool)>;

/// dL/dpixel of each view.
fn image_gradients(npz: &Npz, views: &[View]) -> Vec<Vec<[f64; 3]>> {
    let all = npz.rows::<3>("G");
    all.chunks(all.len() / views.len()).map(<[_]>::to_vec).collect()
}

fn judge(npz: &Npz, set: &[Gaussian], extent: Extent, views: &[Norms], part: f64) -> Outcome {
    let of = |name: &str| npz.values(&field(extent, name));
    let signed: Vec<f64> = views.iter().flatten().map(|norms| norms.0).collect();
    let absolute: Vec<f64> = views.iter().flatten().map(|norms| norms.1).collect();
    relative("signed norm", &signed, of("signed_norm"), part)?;
    relative("absolute norm", &absolute, of("abs_norm"), part)?;
    let visible: Vec<bool> = views.iter().flatten().map(|norms| norms.2).collect();
    let expected = npz.flags(&field(extent, "visible"));
    match extent {
        Extent::Reference => equal("visible", &visible, &expected)?,
        // By tiles, more Gaussians may be visible.
        Extent::Exact if visible.iter().zip(&expected).any(|(own, expected)| *expected && !own) => {
            return Err("visible: some are missing".into());
        }
        Extent::Exact => {}
    }
    let sum = |of: fn(&(f64, f64, bool)) -> f64| -> Vec<f64> {
        (0..set.len()).map(|i| views.iter().map(|norms| of(&norms[i])).sum()).collect()
    };
    let (signed, absolute) = (sum(|norms| norms.0), sum(|norms| norms.1));
    relative("sum of signed norms", &signed, of("acc_signed"), part)?;
    relative("sum of absolute norms", &absolute, of("acc_abs"), part)?;
    if extent == Extent::Reference {
        let seen = sum(|norms| f64::from(u8::from(norms.2)));
        equal("views", &seen, of("acc_views"))?;
        decisions(npz, set, [&signed, &absolute, &seen])?;
    }
    Ok(())
}

fn decisions(npz: &Npz, set: &[Gaussian], [signed, absolute, views]: [&[f64]; 3]) -> Outcome {
    let max = npz.scalar("percent_dense") * npz.scalar("extent");
    let decide = |sum: &[f64], threshold: &str, large: bool| -> Vec<f64> {
        let of = |(i, g): (usize, &Gaussian)| {
            let grows = views[i] > 0.0 && sum[i] / views[i] >= npz.scalar(threshold);
            let scale = g.log_scale.iter().fold(0.0, |max: f64, s| max.max(s.exp()));
            f64::from(u8::from(grows && (scale > max) == large))
        };
        set.iter().enumerate().map(of).collect()
    };
    equal("clone", &decide(signed, "thr_signed", false), npz.values("clone"))?;
    equal("split", &decide(absolute, "thr_abs", true), npz.values("split"))?;
    equal("only_clone", &decide(absolute, "thr_abs_only", false), npz.values("only_clone"))?;
    Ok(equal("only_split", &decide(absolute, "thr_abs_only", true), npz.values("only_split"))?)
}

pub fn check(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let gpu = Gpu::new();
    let set = gaussians(&npz, "");
    let layout = LayoutConverter::new(gpu.context).expect("kernels");
    for (extent, _) in EXTENTS {
        let views = views(&npz, extent);
        let stages = Stages::new(&gpu, &set, &views);
        // Sums over all views, of signed and of absolute gradients.
        let sums = [(); 2].map(|()| gpu.zeros::<[f32; 2]>("statistics", set.len()));
        let mut all: Vec<Norms> = Vec::new();
        for (view, colors) in views.iter().zip(image_gradients(&npz, &views)) {
            let rows: Vec<[f32; 4]> = colors
                .iter()
                .map(|color| {
                    let [r, g, b] = color.map(|x| x as f32);
                    [r, g, b, 0.0]
                })
                .collect();
            let rows = gpu.buffer("rows", &rows);
            let [width, height] = view.size_px;
            let native = gpu.zeros::<u8>("native", LayoutConverter::gradient_bytes(width, height) as usize);
            let own = [(); 2].map(|()| gpu.zeros::<[f32; 2]>("statistics", set.len()));
            for (all, own, absolute) in [(&sums[0], &own[0], false), (&sums[1], &own[1], true)] {
                for buffer in [all, own] {
                    stages.run(view, |r, inputs, backward| {
                        layout.record_gradient(r, inputs, &rows, &native, false);
                        r.barrier();
                        let statistics = Statistics { buffer, accumulate: true };
                        let form = BackwardForm { absolute, ..BackwardForm::default() };
                        backward.record(r, inputs, &native, statistics, form);
                    });
                }
            }
            let [signed, absolute] = own.map(|own| gpu.read::<[f32; 2]>(&own, set.len()));
            let norms = signed.iter().zip(absolute);
            all.push(norms.map(|(&[s, seen], [a, _])| (s.into(), a.into(), seen == 1.0)).collect());
        }
        let part = SINGLE.gradient.relative_l2;
        judge(&npz, &set, extent, &all, part)?;
        let sums = sums.map(|sums| gpu.read::<[f32; 2]>(&sums, set.len()));
        let [signed, absolute] =
            sums.each_ref().map(|sums| sums.iter().map(|sum| sum[0].into()).collect::<Vec<f64>>());
        relative("sums of signed norms", &signed, npz.values(&field(extent, "acc_signed")), part)?;
        relative("sums of absolute norms", &absolute, npz.values(&field(extent, "acc_abs")), part)?;
        if extent == Extent::Reference {
            for sums in &sums {
                let views: Vec<f64> = sums.iter().map(|sum| sum[1].into()).collect();
                equal("views", &views, npz.values(&field(extent, "acc_views")))?;
            }
        }
    }
    Ok(())
}
