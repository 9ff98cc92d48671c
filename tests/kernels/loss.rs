//! The loss's terms beside the photometric one against their twins: `loss/inverse_depth_l1`, `loss/regularize`,
//! `loss/term_reduce`, `loss/sparse_depth` and `loss/sparse_depth_gather`.

use super::pixels::{SIZES, layouts};
use crate::common::prelude::*;
use crate::common::terms::{added_to_fourth_plane, inverse_depth_l1, points, regularize, values};
use crate::reference::inverse_depth_l1::inverse_depth_l1 as inverse_depth_twin;
use crate::reference::regularize::{losses, regularize as regularize_twin};
use crate::reference::sparse_depth::{Point, corners, loss};
use crate::reference::sparse_depth_gather::gather;
use ashsplat::kernels::constants::TERM_PARTIALS;
use ashsplat::kernels::loss::{sparse_depth, sparse_depth_gather};
use ashsplat::passes::loss::DepthPointBuffers;

/// Depth sums of a picture as the blending writes them.
struct Depths {
    size: [usize; 2],
    /// Sum of weights z.
    sums: Vec<f32>,
    transmittances: Vec<f32>,
}

impl Depths {
    fn random(random: &mut Random, size: [usize; 2]) -> Depths {
        let one = |random: &mut Random| match random.below(6) {
            0 => [0.0, 1.0],
            _ => {
                let transmittance = random.unit() as f32;
                [(1.0 - transmittance) * (1.0 + 5.0 * random.unit() as f32), transmittance]
            }
        };
        let all: Vec<[f32; 2]> = (0..size[0] * size[1]).map(|_| one(random)).collect();
        let column = |k: usize| all.iter().map(|pixel| pixel[k]).collect();
        Depths { size, sums: column(0), transmittances: column(1) }
    }

    fn expected(&self) -> Vec<f64> {
        let pairs = self.sums.iter().zip(&self.transmittances);
        pairs.map(|(&sum, &t)| f64::from(sum) / (1.0 - f64::from(t)).max(1e-10)).collect()
    }
}

/// Points all over a picture, some at its edges and some at integer positions.
fn random_points(random: &mut Random, count: usize, size: [usize; 2]) -> Vec<Point> {
    let place = |random: &mut Random, side: usize| {
        let last = (side - 1) as f64;
        match random.below(5) {
            0 => last,
            1 => f64::from(random.below(side as u32)),
            _ => f64::from((last * random.unit()) as f32),
        }
    };
    (0..count)
        .map(|_| Point {
            position_px: [place(random, size[0]), place(random, size[1])],
            inverse_z: random.between(0.1, 1.0),
        })
        .collect()
}

/// Returns the weighted loss and dL/dZ at each point.
fn run_sparse_depth(gpu: &Gpu, depths: &Depths, all: &[Point], weight: f64) -> (f64, Vec<f64>) {
    let spec = sparse_depth::Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup() };
    let kernel = gpu.kernel::<sparse_depth::Interface>(&spec);
    let (view, [accumulated, sums]) = upload(gpu, depths, all);
    let gradients = gpu.untouched::<f32>("sample_gradients", all.len());
    let partials = gpu.untouched::<[f32; 2]>("partials", TERM_PARTIALS as usize);
    let bind = sparse_depth::Bind {
        points: &view.points,
        accumulated: &accumulated,
        depth_sums: &sums,
        sample_gradients: &gradients,
        partials: &partials,
    };
    let push = sparse_depth::Push {
        image_width: depths.size[0] as u32,
        image_height: depths.size[1] as u32,
        count: view.count,
        weight: (weight / all.len() as f64) as f32,
    };
    gpu.run(|r| r.dispatch(&kernel, &bind, &push, TERM_PARTIALS.into()));
    let partials = gpu.read::<[f32; 2]>(&partials, TERM_PARTIALS as usize);
    let loss = partials.iter().map(|sums| f64::from(sums[0])).sum::<f64>() * weight / all.len() as f64;
    (loss, gpu.read::<f32>(&gradients, all.len()).into_iter().map(f64::from).collect())
}

/// Returns the sums added to a depth gradient that was 0.5 everywhere, and the depths afterwards.
fn run_sparse_depth_gather(
    gpu: &Gpu,
    depths: &Depths,
    (all, of_points): (&[Point], &[f32]),
    strips: bool,
) -> (Vec<f64>, Vec<f32>) {
    let spec = sparse_depth_gather::Spec { workgroup_size: gpu.workgroup(64), strips };
    let kernel = gpu.kernel::<sparse_depth_gather::Interface>(&spec);
    let (view, [accumulated, sums]) = upload(gpu, depths, all);
    let (of_points, size) = (gpu.buffer("sample_gradients", of_points), depths.size);
    let gradient = gpu.buffer("image_gradient", &vec![0.5_f32; values(size)]);
    let bind = sparse_depth_gather::Bind {
        points: &view.points,
        pixels: &view.pixels,
        entries: &view.entries,
        sample_gradients: &of_points,
        accumulated: &accumulated,
        depth_sums: &sums,
        image_gradient: &gradient,
    };
    let [image_width, image_height] = size.map(|side| side as u32);
    let push = sparse_depth_gather::Push { image_width, image_height, count: view.pixel_count };
    let workgroups = u64::from(view.pixel_count) / u64::from(spec.workgroup_size) + 1;
    gpu.run(|r| r.dispatch(&kernel, &bind, &push, workgroups));
    let added = added_to_fourth_plane(gpu, &gradient, size, (strips, 0.5));
    (added, gpu.read::<f32>(&sums, size[0] * size[1]))
}

/// Uploads points, transmittances (with an unused colour) and depth sums.
fn upload(gpu: &Gpu, depths: &Depths, all: &[Point]) -> (DepthPointBuffers, [Buffer; 2]) {
    let size = (depths.size[0] as u32, depths.size[1] as u32);
    let accumulated: Vec<[f32; 4]> = depths.transmittances.iter().map(|&t| [9.0, 9.0, 9.0, t]).collect();
    let pictures = [gpu.buffer("accumulated", &accumulated), gpu.buffer("depth_sums", &depths.sums)];
    (DepthPointBuffers::new(gpu.context, &points(all), size).expect("memory"), pictures)
}

#[test]
fn inverse_depth_l1_equals_its_twin() {
    let gpu = Gpu::new();
    // The last has more pixels than invocations.
    for ([width, height], strips) in layouts(SIZES.into_iter().chain([[300, 2 * gpu.workgroup(64) + 40]])) {
        let size = [width as usize, height as usize];
        let pixels = size[0] * size[1];
        let mut random = Random::new(u64::from(width));
        let depth: Vec<f32> = (0..pixels).map(|_| random.unit() as f32).collect();
        let targets: Vec<f32> = (0..pixels)
            .map(|pixel| match random.below(4) {
                0 => f32::INFINITY,
                1 => depth[pixel],
                _ => random.signed() as f32,
            })
            .collect();
        // A power of two, so that the sum with the previous value is exact.
        let weight = 0.25 * pixels as f64;
        let (loss, added) = inverse_depth_l1(&gpu, &depth, &targets, size, (weight, strips, 0.5));
        let wide: Vec<f64> = depth.into_iter().map(f64::from).collect();
        let targets: Vec<Option<f64>> =
            targets.iter().map(|&x| x.is_finite().then_some(f64::from(x))).collect();
        let (expected_loss, expected) = inverse_depth_twin(&wide, &targets, weight);
        elementwise("loss", &[loss], &[expected_loss], 1e-6, 1e-6).expect("the loss");
        elementwise("gradient", &added, &expected, 1e-7, 1e-6).expect("the gradient");
    }
}

/// The gradients of `loss/regularize`, and its sums by `loss/term_reduce`.
#[test]
fn regularize_equals_its_twin() {
    let gpu = Gpu::new();
    let workgroup = gpu.workgroup(64) as usize;
    // The last of the usual sizes has more Gaussians than invocations.
    let usual = sizes(workgroup).into_iter().filter(|&size| size > 0).chain([700 * workgroup + 1]);
    let cases = [(1, [0.01, 0.01]), (333, [0.5, 0.0]), (100_000, [0.0, 2.0]), (70_001, [0.01, 0.02])];
    for (size, weights) in usual.map(|size| (size, [0.01, 0.3])).chain(cases) {
        let mut gaussians = mixed_scene(&mut Random::new(size as u64), size, 1);
        if size > 2 {
            gaussians[0].opacity_logit = 80.0;
            gaussians[2].opacity_logit = -80.0;
        }
        let (sums, actual) = regularize(&gpu, &gaussians, weights);
        let expected = regularize_twin(&gaussians, weights);
        let values = |all: &[Gaussian]| -> Vec<f64> {
            all.iter().flat_map(|g| g.log_scale.into_iter().chain([g.opacity_logit])).collect()
        };
        let (gradients, tolerance) = (values(&expected.gradients), 1e-7 / size as f64);
        elementwise("gradient", &values(&actual), &gradients, tolerance, 2e-6).expect("gradients");
        let untouched = |g: &Gaussian| g.mean == [0.0; 3] && g.quat == [0.0; 4];
        assert!(actual.iter().all(untouched), "gradients that the regularisers do not have");
        elementwise("losses", &sums, &losses(&expected, size, weights), 1e-7, 3e-6).expect("losses");
    }
}

#[test]
fn sparse_depth_equals_its_twin() {
    let gpu = Gpu::new();
    // The last has more points than invocations.
    let many = 256 * gpu.workgroup(64) as usize + 40;
    for (size, count) in [([1, 1], 1), ([17, 9], 3), ([40, 30], 700), ([33, 70], many)] {
        let mut random = Random::new(count as u64);
        let depths = Depths::random(&mut random, size);
        let points = random_points(&mut random, count, size);
        let weight = 0.5 * count as f64;
        let (actual, gradients) = run_sparse_depth(&gpu, &depths, &points, weight);
        let (expected, each) = loss(&depths.expected(), size, &points, weight);
        elementwise("loss", &[actual], &[expected], 1e-6, 2e-6).expect("the loss");
        let expected: Vec<f64> = each.iter().map(|[_, gradient]| *gradient).collect();
        elementwise("gradient", &gradients, &expected, 1e-6, 2e-5).expect("the gradient");
        assert!(count < 100 || expected.iter().any(|&gradient| gradient > 0.0));
        assert!(count < 100 || expected.iter().any(|&gradient| gradient < 0.0));
    }
}

#[test]
fn sparse_depth_gather_equals_its_twin() {
    let gpu = Gpu::new();
    for (size, count) in [([1, 1], 1), ([17, 9], 3), ([40, 30], 700), ([33, 70], 9000)] {
        let mut random = Random::new(count as u64);
        let depths = Depths::random(&mut random, size);
        let points = random_points(&mut random, count, size);
        let of_points: Vec<f32> = (0..count).map(|_| random.signed() as f32).collect();
        let wide: Vec<f64> = of_points.iter().map(|&x| f64::from(x)).collect();
        let mut expected = gather(&points, &wide, size);
        for (gradient, transmittance) in expected.iter_mut().zip(&depths.transmittances) {
            let coverage = 1.0 - f64::from(*transmittance);
            *gradient = if coverage > 1e-10 { *gradient / coverage } else { 0.0 };
        }
        let mut sampled = vec![false; size[0] * size[1]];
        for point in &points {
            corners(point.position_px, size).into_iter().for_each(|(at, _)| sampled[at] = true);
        }
        for strips in [false, true] {
            let (added, sums) = run_sparse_depth_gather(&gpu, &depths, (&points, &of_points), strips);
            let largest = expected.iter().fold(1.0_f64, |max, x| max.max(x.abs()));
            elementwise("gradient", &added, &expected, 2e-6 * largest, 2e-5).expect("the gradient");
            let after = depths.expected();
            for (pixel, &sum) in sums.iter().enumerate() {
                match sampled[pixel] {
                    true => assert!((f64::from(sum) - after[pixel]).abs() <= 1e-5 * after[pixel], "{pixel}"),
                    false => assert_eq!(sum.to_bits(), depths.sums[pixel].to_bits(), "{pixel}"),
                }
            }
        }
    }
}
