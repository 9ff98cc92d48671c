//! `backward/expand_gradients` against its twin.

use ashsplat::kernels::backward::expand_gradients::{Bind, Interface, Push, Spec};
use ashsplat::kernels::constants::GRADIENT_PLANES;

use crate::common::compare::elementwise;
use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::layout::{pack, planes, room, unpack};
use crate::common::scenes::{Random, mixed_scene, small_view};
use crate::reference::expand_gradients::sh_gradient;
use crate::reference::project::{camera_position, view_direction};
use crate::reference::types::View;

fn check(gpu: &Gpu, size: usize, sh_degree: u32, coefficients: usize, sh_loops: bool) {
    let view = View { sh_degree, ..small_view([53, 37]) };
    let spec = Spec { workgroup_size: gpu.workgroup(64), sh_degree, sh_loops };
    let kernel = gpu.kernel::<Interface>(&spec);
    let mut random = Random::new(size as u64);
    let gaussians = mixed_scene(&mut random, size, coefficients);
    // Two of three are visible.
    let mut count = 0;
    let visible_index: Vec<u32> = (0..size)
        .map(|i| {
            count += u32::from(i % 3 != 0);
            if i % 3 == 0 { u32::MAX } else { count - 1 }
        })
        .collect();
    let (room, gradient_stride) = (room(size), count as usize + 2);
    let rows: Vec<[f32; 4]> = (0..GRADIENT_PLANES as usize * gradient_stride)
        .map(|_| [0; 4].map(|_| random.signed() as f32))
        .collect();
    let parameters = gpu.buffer("parameters", &pack(&gaussians, room));
    let (index, gradients) = (gpu.buffer("visible_index", &visible_index), gpu.buffer("gradients", &rows));
    let words = planes(coefficients) * room;
    let parameter_gradients = gpu.untouched::<[f32; 4]>("parameter_gradients", words);
    let mean2d = gpu.untouched::<[f32; 2]>("mean2d_gradients", size + 1);
    let bind = Bind {
        parameters: &parameters,
        visible_index: &index,
        gradients: &gradients,
        parameter_gradients: &parameter_gradients,
        mean2d_gradients: &mean2d,
    };
    let push = Push {
        camera_position: camera_position(&view).map(|x| x as f32),
        first: 0,
        count: size as u32,
        gradient_stride: gradient_stride as u32,
        chunk_gaussians: room as u32,
        planes: planes(coefficients) as u32,
    };
    gpu.run(|recorder| {
        recorder.dispatch(&kernel, &bind, &push, size as u64 / u64::from(spec.workgroup_size) + 1)
    });
    let actual = unpack(&gpu.read::<[f32; 4]>(&parameter_gradients, words), room, size, coefficients);
    let mean2d = gpu.read::<[u32; 2]>(&mean2d, size + 1);
    for (i, (gaussian, actual)) in gaussians.iter().zip(&actual).enumerate() {
        let row = |plane: usize| match visible_index[i] {
            u32::MAX => [0.0; 4],
            visible => rows[plane * gradient_stride + visible as usize],
        };
        let wide = |plane: usize| row(plane).map(f64::from);
        let [x, y, z, opacity_logit] = wide(0);
        assert_eq!((actual.mean, actual.opacity_logit), ([x, y, z], opacity_logit), "{i}");
        assert_eq!(actual.quat, wide(1), "{i}");
        let [x, y, z, pixel_x] = wide(2);
        assert_eq!(actual.log_scale, [x, y, z], "{i}");
        let [r, g, b, pixel_y] = wide(3);
        assert_eq!(mean2d[i].map(f32::from_bits), [pixel_x as f32, pixel_y as f32], "{i}");
        let expected = sh_gradient(view_direction(gaussian, &view).0, [r, g, b], sh_degree, coefficients);
        elementwise("SH", actual.sh.as_flattened(), expected.as_flattened(), 3e-6, 1e-6)
            .expect("SH gradients");
    }
    assert_eq!(mean2d[size], [UNTOUCHED; 2]);
}

#[test]
fn expand_gradients_equals_its_twin() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize) {
        check(&gpu, size, 3, 16, size % 2 == 1);
    }
}

#[test]
fn expand_gradients_of_every_degree() {
    let gpu = Gpu::new();
    for (active, stored) in [(0, 0), (0, 1), (1, 1), (1, 2), (2, 2), (0, 3), (1, 3), (2, 3)] {
        for sh_loops in [false, true] {
            check(&gpu, 100, active, ((stored + 1) * (stored + 1)) as usize, sh_loops);
        }
    }
}
