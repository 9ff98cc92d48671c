//! Edge-weighted blending importance and the draw with it: the device against the vectors.

use super::Outcome;
use super::sets::{EXTENTS, gaussians};
use super::stages::{Stages, field, views};
use crate::common::prelude::*;
use crate::golden::npz::{Npz, rows};
use ashsplat::kernels::constants::{CHANCE_IMPORTANCE, NOT_DRAWN};
use ashsplat::kernels::densify::draw_keys;
use ashsplat::passes::densify::{EdgePhoto, Importance, ImportanceBuffers};
use ashsplat::passes::loss::{NativeLayout, photo_on_device};
use ashsplat::passes::pixels::LayoutConverter;
use std::path::Path;

/// Tolerance relative to the largest value.
const DEVICE: f64 = 1e-5;

/// The values of each view.
fn by_view<'a>(npz: &'a Npz, name: &str, views: &[View]) -> Vec<&'a [f64]> {
    let values = npz.values(name);
    values.chunks(values.len() / views.len()).collect()
}

pub fn check(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let gpu = Gpu::new();
    let set = gaussians(&npz, "");
    let kernels = Importance::new(gpu.context, &RenderSettings::default()).expect("kernels");
    let layout = LayoutConverter::new(gpu.context).expect("kernels");
    for (extent, _) in EXTENTS {
        let views = views(&npz, extent);
        let stages = Stages::new(&gpu, &set, &views);
        let pixels = views.iter().map(|view| view.pixels() as u64).max().expect("a view");
        let requests = ImportanceBuffers::requests(set.len() as u32, pixels);
        let buffers = gpu.context.allocate("test", &requests, MemoryKind::Device).expect("memory");
        let buffers = ImportanceBuffers::from_allocated(buffers);
        let sum = gpu.zeros::<f32>("importance", set.len());
        for (i, view) in views.iter().enumerate() {
            let of = |name: &str| by_view(&npz, name, &views)[i];
            edges_of_device(&gpu, &kernels, &buffers, view, &of)?;
            // The set's weights omit pixels whose blending depends on rounding.
            let used: Vec<[f32; 4]> = of("edge_used").iter().map(|&e| [e as f32, 0.0, 0.0, 0.0]).collect();
            let used = gpu.buffer("rows", &used);
            let [width, height] = view.size_px;
            let native = gpu.zeros::<u8>("native", LayoutConverter::gradient_bytes(width, height) as usize);
            stages.run(view, |r, inputs, _| {
                r.fill(&buffers.ranges, 0);
                layout.record_gradient(r, inputs, &used, &native, false);
                r.barrier();
                kernels.record_view(r, inputs, &native, &buffers, &sum, 1.0 / views.len() as f32);
            });
            let weights = gpu.read::<f32>(&buffers.weights, set.len());
            let weights: Vec<f64> = weights.into_iter().map(f64::from).collect();
            relative("weights", &weights, by_view(&npz, &field(extent, "weights"), &views)[i], DEVICE)?;
        }
        let sum: Vec<f64> = gpu.read_f64::<f32>(&sum, set.len());
        relative("importance", &sum, npz.values(&field(extent, "importance")), DEVICE)?;
    }
    selection_of_device(&gpu, &npz)
}

/// Edges of a photograph in the device's layout, as the gradient that blending reads.
fn edges_of_device<'a>(
    gpu: &Gpu,
    kernels: &Importance,
    buffers: &ImportanceBuffers,
    view: &View,
    of: &dyn Fn(&str) -> &'a [f64],
) -> Outcome {
    let [width, height] = view.size_px;
    let rgbm = rows::<3>(of("photo")).into_iter().flat_map(|[r, g, b]| [r, g, b, 255.0].map(|x| x as u8));
    let layout = NativeLayout::of(gpu.context.limits());
    let texels = photo_on_device(layout, width, height, false, rgbm.collect());
    let texels = &gpu.buffer("photo", &texels);
    let photo = EdgePhoto { texels, size: (width, height), masked: false, cut_sides: [false; 4] };
    let native = gpu.zeros::<u8>("native", LayoutConverter::gradient_bytes(width, height) as usize);
    gpu.run(|r| kernels.record_edges(r, &photo, buffers, &native));
    let raw: Vec<f64> = gpu.read_f64::<u32>(&buffers.responses, view.pixels());
    equal("edge_raw", &raw, of("edge_raw"))?;
    let native = gpu.read::<f32>(&native, native.bytes() as usize / 4);
    let strips = ashsplat::frame::Strips { width, height };
    let place = |i: u32| match layout {
        NativeLayout::Rows => 4 * i as usize,
        NativeLayout::Strips => strips.index(0, i % width, i / width),
    };
    let edges: Vec<f64> = (0..width * height).map(|i| native[place(i)].into()).collect();
    elementwise("edge", &edges, of("edge"), 1e-6, 0.0)?;
    Ok(())
}

fn selection_of_device(gpu: &Gpu, npz: &Npz) -> Outcome {
    let single = |name: &str| npz.values(name).iter().map(|&x| x as f32).collect::<Vec<f32>>();
    let count = npz.values("u").len();
    let statistics: Vec<[f32; 2]> =
        single("candidate").into_iter().map(|candidate| [candidate, 1.0]).collect();
    let [keys, selected] = ["keys", "selected"].map(|name| gpu.untouched::<u32>(name, count));
    let (workgroup_size, subgroup_size) = (gpu.workgroup(64), gpu.subgroup());
    let spec = draw_keys::Spec { workgroup_size, subgroup_size, explicit_uniforms: true };
    let statistics = gpu.buffer("statistics", &statistics);
    let bind = draw_keys::Bind {
        statistics: &statistics,
        importance: &gpu.buffer("importance", &single("importance")),
        uniforms: &gpu.buffer("uniforms", &single("u")),
        keys: &keys,
        selected: &selected,
        totals: &gpu.zeros::<u32>("totals", 4),
    };
    let push = draw_keys::Push {
        count: count as u32,
        threshold: 0.5,
        chances: CHANCE_IMPORTANCE,
        ..draw_keys::Push::default()
    };
    gpu.dispatch_over::<draw_keys::Interface>(&spec, &bind, &push, count);
    let keys = gpu.read::<u32>(&keys, count);
    let mut sorted: Vec<usize> = (0..count).filter(|&i| keys[i] != NOT_DRAWN).collect();
    sorted.sort_by_key(|&i| keys[i]);
    let mut selected = vec![0.0; count];
    sorted.iter().take(npz.scalar("count") as usize).for_each(|&i| selected[i] = 1.0);
    Ok(equal("selected", &selected, npz.values("selected"))?)
}
