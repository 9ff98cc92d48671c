//! Exposures of the device against the vectors.

use super::Outcome;
use super::rendering::SINGLE;
use super::training::device_loss;
use crate::common::compare::{elementwise, gradient};
use crate::common::gpu::Gpu;
use crate::common::terms::{colors, place, values};
use crate::golden::npz::{Npz, rows};
use crate::reference::exposure::{Exposures, Matrix};
use ashsplat::kernels::constants::{STATE_WORDS, TERM_PARTIALS};
use ashsplat::kernels::exposure::{expose, expose_backward, exposure_step};
use ashsplat::passes::loss::NativeLayout;
use std::path::Path;

struct Computed {
    out: Vec<[f64; 3]>,
    loss: f64,
    of_out: Vec<f64>,
    of_picture: Vec<[f64; 3]>,
    of_matrix: Matrix,
}

fn matrix(values: &[f64]) -> Matrix {
    rows::<4>(values).try_into().expect("three rows")
}

fn judge(npz: &Npz, computed: &Computed) -> Outcome {
    let Computed { out, loss, of_out, of_picture, of_matrix } = computed;
    elementwise("out", out.as_flattened(), npz.values("out"), 1e-6, 1e-6)?;
    elementwise("loss", &[*loss], npz.values("loss"), 0.0, 2e-6)?;
    let skip = vec![false; out.len()];
    gradient("d_out", of_out, npz.values("d_out"), &skip, SINGLE.gradient)?;
    gradient("d_img", of_picture.as_flattened(), npz.values("d_img"), &skip, SINGLE.gradient)?;
    gradient("d_E", of_matrix.as_flattened(), npz.values("d_E"), &[false; 3], SINGLE.gradient)?;
    Ok(())
}

/// Steps of a set: photograph, gradient, rate, and all matrices afterwards.
fn steps(npz: &Npz) -> Vec<(usize, Matrix, f64, Vec<Matrix>)> {
    let photographs = npz.array("adam_E").shape[1];
    let after: Vec<Matrix> = npz.values("adam_E").chunks(12).map(matrix).collect();
    let gradients = npz.values("adam_g").chunks(12).map(matrix);
    let seen = npz.values("adam_image").iter().zip(gradients).zip(npz.values("adam_rate"));
    seen.zip(after.chunks(photographs))
        .map(|(((&view, gradient), &rate), after)| (view as usize, gradient, rate, after.to_vec()))
        .collect()
}

fn judge_steps(actual: &[Matrix], expected: &[Matrix]) -> Outcome {
    let flat = |all: &[Matrix]| all.iter().flat_map(|m| m.as_flattened().to_vec()).collect::<Vec<f64>>();
    elementwise("E after a step", &flat(actual), &flat(expected), 1e-6, 1e-6)?;
    Ok(())
}

pub fn check(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let gpu = Gpu::new();
    for layout in gpu.layouts() {
        judge(&npz, &compute(&gpu, &npz, layout))?;
    }
    adam_of_device(&gpu, &npz)
}

fn compute(gpu: &Gpu, npz: &Npz, layout: NativeLayout) -> Computed {
    let strips = layout == NativeLayout::Strips;
    let shape = &npz.array("img").shape;
    let size = [shape[1], shape[0]];
    let (width, height) = (shape[1] as u32, shape[0] as u32);
    let native = |pixels: &[f64]| {
        let mut native = vec![0.0_f32; values(size)];
        for (i, x) in pixels.iter().enumerate() {
            native[place(size, strips, i / 3, i % 3)] = *x as f32;
        }
        native
    };
    let workgroup_size = gpu.workgroup(64);
    let picture = gpu.buffer("rendered", &native(npz.values("img")));
    let e: Vec<f32> = npz.values("E").iter().map(|&x| x as f32).collect();
    let exposures = gpu.buffer("exposures", &e);
    let exposed = gpu.untouched::<f32>("exposed", values(size));
    let kernel = gpu.kernel::<expose::Interface>(&expose::Spec { workgroup_size, strips, lens: false });
    let bind = expose::Bind { rendered: &picture, matrices: &exposures, exposed: &exposed };
    let push = expose::Push { image_width: width, image_height: height, ..Default::default() };
    let pixels = u64::from(width) * u64::from(height.next_multiple_of(8));
    gpu.run(|r| r.dispatch(&kernel, &bind, &push, pixels.div_ceil(workgroup_size.into())));
    let out = colors(&gpu.read::<f32>(&exposed, values(size)), size, strips);
    let pictures = [out.as_flattened(), npz.values("gt")];
    let ([loss, ..], of_out) = device_loss(gpu, layout, pictures, [width, height]);
    let g = gpu.buffer("image_gradient", &native(&of_out));
    let partials = gpu.untouched::<[[f32; 4]; 3]>("partials", TERM_PARTIALS as usize);
    let spec = expose_backward::Spec { workgroup_size, subgroup_size: gpu.subgroup(), strips, lens: false };
    let kernel = gpu.kernel::<expose_backward::Interface>(&spec);
    let bind = expose_backward::Bind {
        rendered: &picture,
        matrices: &exposures,
        image_gradient: &g,
        partials: &partials,
    };
    let push = expose_backward::Push { image_width: width, image_height: height, ..Default::default() };
    gpu.run(|r| r.dispatch(&kernel, &bind, &push, TERM_PARTIALS.into()));
    let of_picture = colors(&gpu.read::<f32>(&g, values(size)), size, strips);
    let mut of_matrix = [[0.0; 4]; 3];
    for part in gpu.read::<[[f32; 4]; 3]>(&partials, TERM_PARTIALS as usize) {
        let sums = of_matrix.as_flattened_mut().iter_mut().zip(part.as_flattened());
        sums.for_each(|(sum, x)| *sum += f64::from(*x));
    }
    Computed { out, loss, of_out, of_picture, of_matrix }
}

fn adam_of_device(gpu: &Gpu, npz: &Npz) -> Outcome {
    let steps = steps(npz);
    let photographs = steps[0].3.len();
    let narrow = |matrix: &Matrix| matrix.map(|row| row.map(|x| x as f32));
    let start: Vec<[[f32; 4]; 3]> = Exposures::new(photographs).values.iter().map(narrow).collect();
    let exposures = gpu.buffer("exposures", &start);
    let moments = ["moments_1", "moments_2"].map(|name| gpu.zeros::<[[f32; 4]; 3]>(name, photographs));
    let state = gpu.zeros::<u32>("state", STATE_WORDS as usize);
    let (workgroup_size, subgroup_size) = (gpu.workgroup(64), gpu.subgroup());
    let spec =
        exposure_step::Spec { workgroup_size, subgroup_size, center: false, shares: false, sparse: false };
    let kernel = gpu.kernel::<exposure_step::Interface>(&spec);
    for (step, (view, gradient, rate, after)) in steps.iter().enumerate() {
        let mut parts = vec![[[0.0; 4]; 3]; TERM_PARTIALS as usize];
        parts[5] = narrow(gradient);
        let partials = gpu.buffer("partials", &parts);
        let count = step as i32 + 1;
        let bind = exposure_step::Bind {
            partials: &partials,
            state: &state,
            exposures: &exposures,
            moments_1: &moments[0],
            moments_2: &moments[1],
        };
        let push = exposure_step::Push {
            photographs: photographs as u32,
            view: *view as u32,
            rate: (rate / (1.0 - 0.9f64.powi(count))) as f32,
            inverse_bias_2: (1.0 - 0.999f64.powi(count)).sqrt().recip() as f32,
            decay: 0.0,
            sparsity: 0.0,
        };
        gpu.run(|r| r.dispatch(&kernel, &bind, &push, 1));
        let actual: Vec<Matrix> = gpu
            .read::<[[f32; 4]; 3]>(&exposures, photographs)
            .iter()
            .map(|rows| rows.map(|row| row.map(f64::from)))
            .collect();
        judge_steps(&actual, after)?;
    }
    Ok(())
}
