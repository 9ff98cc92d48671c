//! `poses/pose_step` against its twin.

use crate::common::compare::elementwise;
use crate::common::gpu::{Gpu, sizes};
use crate::common::poses::{Poses, Step, pose_step};
use crate::common::scenes::{Random, rotation_about_y};
use crate::reference::adam::Parameter;
use crate::reference::pose_step::{moved, pose_step as twin};

fn poses(random: &mut Random, images: usize, size: f64) -> Poses {
    let start = |random: &mut Random| {
        let rotation = rotation_about_y(3.0 * random.signed()).concat();
        let mut pose = [0.0; 12];
        pose[..9].copy_from_slice(&rotation.iter().map(|&x| x as f32).collect::<Vec<f32>>());
        pose[9..].fill_with(|| (4.0 * random.signed()) as f32);
        pose
    };
    Poses {
        parameters: (0..images).map(|_| [0; 6].map(|_| (size * random.signed()) as f32)).collect(),
        moments: vec![[[0.0; 6]; 2]; images],
        starts: (0..images).map(|_| start(random)).collect(),
        cameras: vec![[f32::NAN; 12]; images],
    }
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
        let mut twins: Vec<[Parameter; 6]> = (device.parameters.iter())
            .map(|xi| xi.map(|x| Parameter { value: f64::from(x), ..Parameter::default() }))
            .collect();
        for count in 1..=5 {
            let seen = random.below(images as u32);
            let mut gradient = [0; 6].map(|_| (1e-3 * random.signed()) as f32);
            // What is not finite counts as 0: here of the turn.
            if count == 3 {
                gradient[4] = f32::INFINITY;
            }
            let step: Step = (seen, gradient, 1e-3, count);
            device = pose_step(&gpu, &device, Some(step), 0);
            if count == 3 {
                gradient[3..].fill(0.0);
            }
            for (image, twins) in twins.iter_mut().enumerate() {
                for (parameter, g) in twins.iter_mut().zip(gradient) {
                    let g = if image as u32 == seen { f64::from(g) } else { 0.0 };
                    twin(parameter, g, 1e-3, count);
                }
            }
            let column = |of: fn(&Parameter) -> f64| twins.iter().flatten().map(of).collect::<Vec<f64>>();
            let flat = |values: &[f32]| values.iter().map(|&x| f64::from(x)).collect::<Vec<f64>>();
            let moments = |k: usize| {
                let rows: Vec<f32> = device.moments.iter().flat_map(|m| m[k]).collect();
                flat(&rows)
            };
            let values = flat(device.parameters.as_flattened());
            elementwise("xi", &values, &column(|p| p.value), 2e-8, 1e-6).expect("parameters");
            elementwise("first", &moments(0), &column(|p| p.moment1), 1e-12, 1e-5).expect("moments");
            elementwise("second", &moments(1), &column(|p| p.moment2), 1e-17, 2e-5).expect("moments");
            check_cameras(&device);
        }
    }
}

/// Without a step the parameters stay, and the cameras are theirs: exactly the given ones where nothing is moved.
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
    let before = Poses { cameras: vec![[1.0; 12]; 20], ..poses(&mut Random::new(3), 20, 0.1) };
    assert_eq!(pose_step(&gpu, &before, Some((3, [1.0; 6], 1.0, 1)), 1), before);
}
