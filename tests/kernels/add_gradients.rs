//! `optimizer/add_gradients` against its twin.

use ashsplat::kernels::constants::{
    GRADIENT_PLANES, PLANE_SH, STATE_NON_FINITE, STATE_OVERFLOW, STATE_WORDS,
};
use ashsplat::kernels::optimizer::add_gradients::{Bind, Interface, Push, Spec};

use crate::common::adam::camera_block;
use crate::common::compare::elementwise;
use crate::common::gpu::{Gpu, sizes};
use crate::common::layout::{pack, planes, room, unpack};
use crate::common::scenes::{Random, mixed_scene};
use crate::reference::add_gradients::add;
use crate::reference::expand_gradients::sh_gradient;
use crate::reference::types::Gaussian;

const CAMERA: [f64; 3] = [0.5, -0.25, -5.0];

/// Output of a view.
struct View {
    /// Visible index of each Gaussian.
    visible: Vec<u32>,
    rows: Vec<[f32; 4]>,
    stride: usize,
}

impl View {
    fn random(random: &mut Random, size: usize) -> View {
        let mut count = 0;
        let visible = (0..size)
            .map(|_| {
                let seen = random.below(3) > 0;
                count += u32::from(seen);
                if seen { count - 1 } else { u32::MAX }
            })
            .collect();
        let stride = count as usize + 2;
        let rows = (0..GRADIENT_PLANES as usize * stride).map(|_| [0; 4].map(|_| random.signed() as f32));
        View { visible, rows: rows.collect(), stride }
    }

    /// The gradient of Gaussian `index` with this mean.
    fn gradient(&self, index: usize, mean: [f64; 3], degree: u32, stored: usize) -> Gaussian {
        let row = |plane: usize| match self.visible[index] {
            u32::MAX => [0.0; 4],
            visible => self.rows[plane * self.stride + visible as usize].map(f64::from),
        };
        let towards = [0, 1, 2].map(|i| mean[i] - CAMERA[i]);
        let distance = towards.iter().map(|x| x * x).sum::<f64>().sqrt();
        let [x, y, z, opacity_logit] = row(0);
        let ([a, b, c, _], [red, green, blue, _]) = (row(2), row(3));
        let sh = sh_gradient(towards.map(|x| x / distance), [red, green, blue], degree, stored);
        Gaussian { mean: [x, y, z], quat: row(1), log_scale: [a, b, c], opacity_logit, sh }
    }
}

/// Two views with different degrees, and one that overflowed.
fn check(gpu: &Gpu, size: usize, degrees: [u32; 2], stored: u32, direct: bool) {
    let coefficients = ((stored + 1) * (stored + 1)) as usize;
    let mut random = Random::new(size as u64 + 7 * u64::from(stored));
    let gaussians = mixed_scene(&mut random, size, coefficients);
    let room = room(size);
    let words = planes(coefficients) * room;
    let parameters = gpu.buffer("parameters", &pack(&gaussians, room));
    let sums = gpu.untouched::<[f32; 4]>("sums", words);
    let direct_gradients = mixed_scene(&mut random, size, coefficients);
    let mut direct_planes = pack(&direct_gradients, room);
    direct_planes.truncate(PLANE_SH as usize * room);
    let direct_buffer = gpu.buffer("parameter_gradients", &direct_planes);
    let mut expected: Vec<Gaussian> = gaussians.clone();
    let views = [(degrees[0], true, 0), (degrees[1], false, 1), (degrees[1], false, 0)];
    for (number, (sh_degree, starts, overflow)) in views.into_iter().enumerate() {
        let mut view = View::random(&mut random, size);
        let mut spoilt = 0;
        if number != 1 && size > 9 && view.visible[9] != u32::MAX {
            view.rows[view.stride + view.visible[9] as usize][2] = f32::NAN;
            spoilt = 1;
        }
        let moved_camera = number == 1 || stored == 2;
        let workgroup_size = gpu.workgroup(64);
        let sh_loops = number == 1;
        let spec = Spec { workgroup_size, sh_degree, parameter_gradients: direct, moved_camera, sh_loops };
        let kernel = gpu.kernel::<Interface>(&spec);
        let (index, gradients) =
            (gpu.buffer("visible_index", &view.visible), gpu.buffer("gradients", &view.rows));
        let mut state = vec![0_u32; STATE_WORDS as usize];
        state[STATE_OVERFLOW as usize] = overflow;
        let state = gpu.buffer("state", &state);
        let bind = Bind {
            sums: &sums,
            parameters: &parameters,
            visible_index: &index,
            gradients: &gradients,
            state: &state,
            old_sums: &sums,
            parameter_gradients: if direct { &direct_buffer } else { &gradients },
            camera_block: &gpu.buffer("camera_block", &[camera_block(CAMERA, moved_camera)]),
        };
        let push = Push {
            camera_position: CAMERA.map(|x| if moved_camera { f32::NAN } else { x as f32 }),
            first: 0,
            count: size as u32,
            chunk_gaussians: room as u32,
            gradient_stride: view.stride as u32,
            planes: planes(coefficients) as u32,
            starts: starts.into(),
        };
        gpu.run(|r| r.dispatch(&kernel, &bind, &push, size as u64 / u64::from(spec.workgroup_size) + 1));
        let skipped = gpu.read::<u32>(&state, STATE_WORDS as usize)[STATE_NON_FINITE as usize];
        assert_eq!(skipped, if overflow == 1 { 0 } else { spoilt }, "view {number}");
        if overflow == 1 {
            continue;
        }
        for (i, sum) in expected.iter_mut().enumerate() {
            let mut gradient = view.gradient(i, gaussians[i].mean, sh_degree, coefficients);
            if direct {
                let own = &direct_gradients[i];
                gradient.mean = [0, 1, 2].map(|k| gradient.mean[k] + own.mean[k]);
                gradient.quat = [0, 1, 2, 3].map(|k| gradient.quat[k] + own.quat[k]);
                gradient.log_scale = [0, 1, 2].map(|k| gradient.log_scale[k] + own.log_scale[k]);
                gradient.opacity_logit += own.opacity_logit;
            }
            *sum = add(sum, &gradient, starts);
        }
    }
    let actual = unpack(&gpu.read::<[f32; 4]>(&sums, words), room, size, coefficients);
    for (i, (actual, expected)) in actual.iter().zip(&expected).enumerate() {
        let flat = |g: &Gaussian| {
            let geometry = [&g.mean[..], &g.quat, &g.log_scale, &[g.opacity_logit]].concat();
            [geometry, g.sh.concat()].concat()
        };
        elementwise("sum", &flat(actual), &flat(expected), 6e-6, 2e-6)
            .unwrap_or_else(|e| panic!("{i} of {size}: {e}"));
    }
}

#[test]
fn add_gradients_equals_its_twin() {
    for gpu in [Gpu::new(), Gpu::without_texels()] {
        for size in sizes(gpu.workgroup(64) as usize).into_iter().filter(|&size| size > 0) {
            check(&gpu, size, [2, 3], 3, size % 2 == 1);
        }
    }
}

#[test]
fn add_gradients_of_every_degree() {
    let gpu = Gpu::new();
    for (degrees, stored) in [([0, 0], 0), ([0, 1], 1), ([1, 1], 2), ([0, 3], 3), ([3, 3], 3)] {
        check(&gpu, 100, degrees, stored, false);
    }
}
