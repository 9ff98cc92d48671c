//! `densify/relocate` against its twin.

use ashsplat::kernels::densify::relocate::{Bind, Interface, Push, Spec};

use crate::common::compare::elementwise;
use crate::common::gpu::{Gpu, sizes};
use crate::common::layout::{pack, planes, room, unpack};
use crate::common::scenes::{Random, mixed_scene};
use crate::reference::relocate::relocate;
use crate::reference::types::Gaussian;

#[test]
fn relocate_equals_its_twin() {
    let gpu = Gpu::new();
    let spec = Spec { workgroup_size: gpu.workgroup(64) };
    let kernel = gpu.kernel::<Interface>(&spec);
    const FIRST: usize = 3;
    for size in sizes(spec.workgroup_size as usize) {
        let mut random = Random::new(size as u64);
        let mut gaussians = mixed_scene(&mut random, size, 4);
        for (gaussian, logit) in gaussians.iter_mut().zip([-5.29, -5.3, 12.0, 20.0, 0.0]) {
            gaussian.opacity_logit = logit;
        }
        let draws: Vec<u32> =
            [1, 60, 1, 60, 50, 49].into_iter().chain((0..20).map(|_| random.below(6))).collect();
        let sources: Vec<u32> = (0..FIRST + size)
            .map(|row| {
                if row < FIRST + 6 { (row.saturating_sub(FIRST)) as u32 } else { random.below(26) | 1 << 30 }
            })
            .collect();
        let room = room(size);
        let [parameters, moments_1, moments_2] =
            ["parameters", "moments_1", "moments_2"].map(|name| gpu.buffer(name, &pack(&gaussians, room)));
        let (sources_buffer, draws_buffer) = (gpu.buffer("sources", &sources), gpu.buffer("draws", &draws));
        let bind = Bind {
            sources: &sources_buffer,
            draws: &draws_buffer,
            parameters: &parameters,
            moments_1: &moments_1,
            moments_2: &moments_2,
        };
        let push = Push {
            first: FIRST as u32,
            count: size as u32,
            chunk_gaussians: room as u32,
            planes: planes(4) as u32,
        };
        gpu.run(|r| r.dispatch(&kernel, &bind, &push, size as u64 / u64::from(spec.workgroup_size) + 1));
        let [after, moments_1, moments_2] = [parameters, moments_1, moments_2]
            .map(|buffer| unpack(&gpu.read::<[f32; 4]>(&buffer, planes(4) * room), room, size, 4));
        for (i, before) in gaussians.iter().enumerate() {
            let drawn = draws[(sources[FIRST + i] & 0x3FFF_FFFF) as usize];
            if drawn == 0 {
                assert_eq!([&after[i], &moments_1[i], &moments_2[i]], [before; 3], "{i}");
                continue;
            }
            let (logit, log_scale) = relocate(before.opacity_logit, before.log_scale, drawn);
            // 1 - o has few digits for an opacity near 1.
            let digits = 1e-7 * (1.0 + logit.exp());
            elementwise("logit", &[after[i].opacity_logit], &[logit], 1e-5 + digits, 1e-6)
                .unwrap_or_else(|e| panic!("{i}, drawn {drawn}: {e}"));
            elementwise("log-scale", &after[i].log_scale, &log_scale, 1e-5, 1e-6)
                .unwrap_or_else(|e| panic!("{i}, drawn {drawn}: {e}"));
            let rest = |g: &Gaussian| (g.mean, g.quat, g.sh.clone());
            assert_eq!(rest(&after[i]), rest(before), "{i}");
            let zero = Gaussian {
                mean: [0.0; 3],
                quat: [0.0; 4],
                log_scale: [0.0; 3],
                opacity_logit: 0.0,
                sh: vec![[0.0; 3]; 4],
            };
            assert_eq!([&moments_1[i], &moments_2[i]], [&zero; 2], "{i}");
        }
    }
}
