//! The kernels of the loss that shape surfaces against finite differences of their twins.

use super::pixels::{SIZES, layouts};
use crate::common::prelude::*;
use crate::common::terms::{added_to_fourth_plane, values};
use crate::reference::linear::wide;
use crate::reference::project::project;
use crate::reference::surface_loss::{Surface, planarity, surface_depths};
use ashsplat::kernels::constants::{PLANE_SH, TERM_PARTIALS};
use ashsplat::kernels::loss::{surface_alignment, surface_depth, surface_planarity};
use ashsplat::vk::Buffer;

/// A bent surface with holes: sums of weights / z, and transmittances.
fn picture(random: &mut Random, [width, height]: [usize; 2]) -> [Vec<f32>; 2] {
    let pixel = |index: usize| {
        let [x, y] = [index % width, index / width].map(|at| at as f64);
        let transmittance = if random.below(12) == 0 { 0.75 } else { random.unit() * 0.4 };
        let depth = 0.25 + 0.002 * x - 0.001 * y + 0.004 * random.unit();
        [((1.0 - transmittance) * depth) as f32, transmittance as f32]
    };
    let all: Vec<[f32; 2]> = (0..width * height).map(pixel).collect();
    [0, 1].map(|k| all.iter().map(|pixel| pixel[k]).collect())
}

fn accumulated(gpu: &Gpu, transmittances: &[f32]) -> Buffer {
    let colors: Vec<[f32; 4]> = transmittances.iter().map(|&t| [0.5, 0.25, 0.125, t]).collect();
    gpu.buffer("accumulated", &colors)
}

#[test]
fn surface_planarity_equals_its_twin() {
    let gpu = Gpu::new();
    for (k, ([width, height], strips)) in layouts(SIZES).enumerate() {
        let size = [width as usize, height as usize];
        let (pixels, stride) = (size[0] * size[1], 1 << (k % 3));
        let [sums, transmittances] = picture(&mut Random::new(k as u64), size);
        let accumulated = accumulated(&gpu, &transmittances);
        let depths = gpu.untouched::<f32>("surface_depths", pixels);
        let workgroup_size = gpu.workgroup(64);
        gpu.dispatch_over::<surface_depth::Interface>(
            &surface_depth::Spec { workgroup_size },
            &surface_depth::Bind {
                accumulated: &accumulated,
                depth_sums: &gpu.buffer("depth_sums", &sums),
                surface_depths: &depths,
            },
            &surface_depth::Push { pixels: pixels as u32 },
            pixels,
        );
        let spec = surface_planarity::Spec { workgroup_size, subgroup_size: gpu.subgroup(), strips };
        let kernel = gpu.kernel::<surface_planarity::Interface>(&spec);
        let gradient = gpu.buffer("image_gradient", &vec![0.5_f32; values(size)]);
        let partials = gpu.untouched::<[f32; 2]>("partials", TERM_PARTIALS as usize);
        let bind = surface_planarity::Bind {
            accumulated: &accumulated,
            surface_depths: &depths,
            image_gradient: &gradient,
            partials: &partials,
        };
        let weight = 1.0 / 1024.0;
        let push = surface_planarity::Push {
            image_width: width,
            image_height: height,
            stride_px: stride as i32,
            weight: weight as f32,
        };
        gpu.run(|r| r.dispatch(&kernel, &bind, &push, TERM_PARTIALS.into()));
        let loss: f64 =
            gpu.read::<[f32; 2]>(&partials, TERM_PARTIALS as usize).iter().map(|p| f64::from(p[0])).sum();
        let added = added_to_fourth_plane(&gpu, &gradient, size, (strips, 0.5));

        let coverages: Vec<f64> = transmittances.iter().map(|&t| 1.0 - f64::from(t)).collect();
        let mut sums = wide(&sums);
        let scales = surface_depths(&sums, &coverages);
        let twin = |sums: &[f64]| planarity(&surface_depths(sums, &coverages), &scales, size, stride);
        elementwise("loss", &[loss], &[twin(&sums)], 1e-4, 1e-5).expect("the loss");
        // Few pixels of the large pictures, because each takes a whole loss.
        let every = (pixels / 97).max(1);
        for pixel in (0..pixels).step_by(every) {
            let [low, high] = [-1e-6, 1e-6].map(|change| {
                let before = sums[pixel];
                sums[pixel] += change;
                let loss = twin(&sums);
                sums[pixel] = before;
                loss
            });
            let expected = weight * (high - low) / 2e-6;
            elementwise("gradient", &[added[pixel]], &[expected], 2e-5, 2e-4).expect("the gradient");
        }
    }
}

/// Gaussians near the surface turn, those far behind it and at the picture's border do not.
#[test]
fn surface_alignment_equals_its_twin() {
    let gpu = Gpu::new();
    let view = small_view([53, 37]);
    let size = view.size_px.map(|side| side as usize);
    for (seed, stride) in [(1, 1), (2, 2)] {
        let mut random = Random::new(seed);
        let gaussians = mixed_scene(&mut random, 80, 1);
        let projected = gaussians.iter().zip(0..).filter_map(|(g, i)| Some((i, project(g, &view)?)));
        let (visible, splats): (Vec<u32>, Vec<Splat>) = projected.unzip();
        // The surface lies near the last Gaussian of each pixel.
        let mut depths = vec![0.25_f32; size[0] * size[1]];
        for splat in &splats {
            let near = 1.0 + random.between(-0.05, 0.05);
            let [x, y] = splat.mean2d_px.map(|x| (x + 0.5).floor() as isize);
            for (dx, dy) in (-2..=2).flat_map(|dy| (-2..=2).map(move |dx| (dx, dy))) {
                let [x, y] = [x + dx, y + dy];
                if (0..size[0] as isize).contains(&x) && (0..size[1] as isize).contains(&y) {
                    let bend = 1.0 + random.between(-0.02, 0.02);
                    let hole = random.below(150) == 0;
                    depths[y as usize * size[0] + x as usize] =
                        if hole { 0.0 } else { (near * bend / splat.depth) as f32 };
                }
            }
        }
        let (count, capacity) = (visible.len() as u32, plane_capacity(gaussians.len()));
        let planes = pack_splats(&splats);
        let gradients = gpu.zeros::<[f32; 4]>("parameter_gradients", PLANE_SH as usize * capacity);
        let weights = [0.5, 0.25];
        let [turn, flatten] = weights.map(|weight| weight as f32);
        gpu.dispatch_over::<surface_alignment::Interface>(
            &surface_alignment::Spec { workgroup_size: gpu.workgroup(64) },
            &surface_alignment::Bind {
                parameters: &gpu.buffer("parameters", &pack(&gaussians, capacity)),
                visible_ranges: &gpu.buffer("visible_ranges", &[[0; 4], [0, count, 0, 0]]),
                visible_list: &gpu.buffer("visible_list", &visible),
                mean2d_extent: &gpu.buffer("mean2d_extent", &planes.mean2d_extent),
                conic_opacity: &gpu.buffer("conic_opacity", &planes.conic_opacity),
                surface_depths: &gpu.buffer("surface_depths", &depths),
                parameter_gradients: &gradients,
                camera_block: &gpu.buffer("camera_block", &[camera_block(&view)]),
            },
            &surface_alignment::Push { first: 0, splat_stride: 1, stride_px: stride, turn, flatten },
            visible.len(),
        );
        let mut words = gpu.read::<[f32; 4]>(&gradients, PLANE_SH as usize * capacity);
        words.resize(words.len() + capacity, [0.0; 4]);
        let actual = unpack(&words, capacity, gaussians.len(), 1);

        let depths: Vec<Option<f64>> = depths.iter().map(|&d| (d > 0.0).then_some(f64::from(d))).collect();
        let single = |x: f64| f64::from(x as f32);
        let (mut turned, mut stayed) = (0, 0);
        for (&i, splat) in visible.iter().zip(&splats) {
            let place = (splat.mean2d_px.map(single), splat.conic.map(single), single(splat.opacity));
            let before = &gaussians[i as usize];
            let surface = Surface::at(before, &view, place, &depths, stride as usize);
            let slope = |change: &dyn Fn(&mut Gaussian, f64)| {
                let Some(surface) = &surface else { return 0.0 };
                let [low, high] = [-1e-6, 1e-6].map(|by| {
                    let mut gaussian = before.clone();
                    change(&mut gaussian, by);
                    surface.loss(&gaussian, weights)
                });
                (high - low) / 2e-6
            };
            let own = &actual[i as usize];
            let expected: Vec<f64> = (0..4)
                .map(|k| slope(&|g, by| g.quat[k] += by))
                .chain((0..3).map(|k| slope(&|g, by| g.log_scale[k] += by)))
                .collect();
            let found = [&own.quat[..], &own.log_scale].concat();
            let largest = expected.iter().fold(0.0, |max: f64, x| max.max(x.abs()));
            elementwise(&format!("gradient of {i}"), &found, &expected, 1e-4 * largest.max(1e-4), 2e-3)
                .expect("the gradient");
            assert_eq!((own.mean, own.opacity_logit), ([0.0; 3], 0.0));
            *if largest > 1e-3 { &mut turned } else { &mut stayed } += 1;
        }
        assert!(turned > 10 && stayed > 3, "{turned} turned, {stayed} stayed");
    }
}
