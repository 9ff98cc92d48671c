//! The kernels of `poses/` against their twins: `poses/pose_gradient` and `poses/pose_step`.

use crate::common::poses::{Poses, Step, pose_gradient, pose_step};
use crate::common::prelude::*;
use crate::reference::adam::Parameter;
use crate::reference::pose_gradient::{gradient_of_parameters, total};
use crate::reference::pose_step::{moved, step_about};

fn six(random: &mut Random, scale: f64) -> [f32; 6] {
    [0; 6].map(|_| (scale * random.signed()) as f32)
}

#[test]
pub fn pose_gradient_equals_its_twin() {
    let gpu = Gpu::new();
    let mut random = Random::new(5);
    // No motion, small ones, and turns of more than half a circle.
    for (count, size) in [(0, 0.1), (1, 0.0), (2, 0.01), (63, 0.3), (64, 1.0), (1000, 1.7), (30_001, 0.1)] {
        let sums: Vec<[f32; 6]> = (0..count).map(|_| six(&mut random, 1.0)).collect();
        let parameters: Vec<[f32; 6]> = (0..3).map(|_| six(&mut random, size)).collect();
        let wide: Vec<[f64; 6]> = sums.iter().map(|sum| sum.map(f64::from)).collect();
        let g = total(&wide);
        for image in 0..3 {
            let xi = parameters[image as usize].map(f64::from);
            let expected = gradient_of_parameters(xi, g);
            let [actual, of_parameters] = pose_gradient(&gpu, &sums, &parameters, image);
            let largest = |values: [f64; 6]| values.iter().fold(0.0, |max: f64, x| max.max(x.abs()));
            // The sums have both signs, hence an absolute bound.
            let bound = 1e-5 * f64::from(count).sqrt() + 1e-5 * largest(g);
            elementwise("g", &actual, &g, bound, 0.0).unwrap_or_else(|e| panic!("{count}: {e}"));
            let bound = bound + 2e-6 * largest(expected);
            elementwise("dL/dxi", &of_parameters, &expected, bound, 0.0)
                .unwrap_or_else(|e| panic!("{count}, {xi:?}: {e}"));
            if size == 0.0 {
                assert_eq!(actual, of_parameters);
            }
        }
    }
}

fn poses(random: &mut Random, images: usize, size: f64) -> Poses {
    let start = |random: &mut Random| {
        let rotation = rotation_about_y(3.0 * random.signed()).concat();
        let mut pose = [0.0; 12];
        pose[..9].copy_from_slice(&rotation.iter().map(|&x| x as f32).collect::<Vec<f32>>());
        pose[9..].fill_with(|| (4.0 * random.signed()) as f32);
        pose
    };
    Poses {
        parameters: (0..images).map(|_| six(random, size)).collect(),
        moments: vec![[[0.0; 6]; 2]; images],
        starts: (0..images).map(|_| start(random)).collect(),
        cameras: vec![[1.0; 12]; images],
        // Every third pose has no pivot.
        depths: (0..images).map(|i| if i % 3 == 1 { 0.0 } else { (3.0 + random.signed()) as f32 }).collect(),
    }
}

fn twins_of(poses: &Poses) -> Vec<[Parameter; 6]> {
    let parameter = |x: f32| Parameter { value: f64::from(x), ..Parameter::default() };
    poses.parameters.iter().map(|xi| xi.map(parameter)).collect()
}

fn column(twins: &[[Parameter; 6]], of: fn(&Parameter) -> f64) -> Vec<f64> {
    twins.iter().flatten().map(of).collect()
}

/// Compares parameters, and cameras with those that follow from the parameters.
fn check(poses: &Poses, twins: &[[Parameter; 6]]) {
    let values = widen(&poses.parameters);
    elementwise("xi", &values, &column(twins, |p| p.value), 2e-8, 1e-6).expect("parameters");
    check_cameras(poses);
}

fn check_cameras(poses: &Poses) {
    for (image, camera) in poses.cameras.iter().enumerate() {
        let [a, b, c, d, e, f, g, h, i, x, y, z] = poses.starts[image].map(f64::from);
        let start = [[a, b, c], [d, e, f], [g, h, i]];
        let (rotation, translation) = moved(poses.parameters[image].map(f64::from), (&start, [x, y, z]));
        let expected = [rotation.concat(), translation.to_vec()].concat();
        elementwise("camera", &camera.map(f64::from), &expected, 4e-6, 0.0)
            .unwrap_or_else(|e| panic!("{image} of {:?}: {e}", poses.parameters[image]));
    }
}

#[test]
fn pose_step_equals_its_twin() {
    let gpu = Gpu::new();
    for images in sizes(gpu.workgroup(64) as usize).into_iter().filter(|&images| images > 0) {
        let mut random = Random::new(images as u64);
        let mut device = poses(&mut random, images, 0.1);
        let mut twins = twins_of(&device);
        for count in 1..=5 {
            let seen = random.below(images as u32);
            let mut gradient = six(&mut random, 1e-3);
            // A gradient that is not finite counts as 0: here in the rotation.
            if count == 3 {
                gradient[4] = f32::INFINITY;
            }
            let step: Step = (seen, gradient, 1e-3, count);
            device = pose_step(&gpu, &device, Some(step), 0);
            if count == 3 {
                gradient[3..].fill(0.0);
            }
            for (image, twins) in twins.iter_mut().enumerate() {
                let g = if image as u32 == seen { gradient.map(f64::from) } else { [0.0; 6] };
                step_about(f64::from(device.depths[image]), twins, g, 1e-3, count);
            }
            let moments = |k: usize| widen(&device.moments.iter().map(|m| m[k]).collect::<Vec<[f32; 6]>>());
            check(&device, &twins);
            let [first, second] = [column(&twins, |p| p.moment1), column(&twins, |p| p.moment2)];
            elementwise("first", &moments(0), &first, 1e-12, 1e-5).expect("moments");
            elementwise("second", &moments(1), &second, 1e-17, 2e-5).expect("moments");
        }
    }
}

/// Without a step the parameters stay, and cameras follow from them: the start poses exactly if nothing moved.
#[test]
fn pose_step_makes_cameras() {
    let gpu = Gpu::new();
    let mut random = Random::new(2);
    for size in [0.0, 1e-6, 1e-3, 0.5, 1.5] {
        let before = poses(&mut random, 70, size);
        let after = pose_step(&gpu, &before, None, 0);
        assert_eq!((&after.parameters, &after.moments), (&before.parameters, &before.moments));
        check_cameras(&after);
        if size == 0.0 {
            assert_eq!(after.cameras, after.starts);
        }
    }
}

#[test]
fn pose_step_changes_nothing_after_an_overflow() {
    let gpu = Gpu::new();
    let before = poses(&mut Random::new(3), 20, 0.1);
    assert_eq!(pose_step(&gpu, &before, Some((3, [1.0; 6], 1.0, 1)), 1), before);
}
