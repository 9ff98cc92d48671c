//! Gradients of camera poses and their optimiser: the device against the vectors.

use super::Outcome;
use super::sets::{self, EXTENTS, gaussians};
use crate::common::engine::{self, settings};
use crate::common::poses::{Poses, pose_gradient, pose_step};
use crate::common::prelude::*;
use crate::golden::npz::{Npz, rows};
use std::path::Path;

/// Tolerance relative to the largest entry of a gradient.
const DEVICE: f64 = 1e-4;

fn views(npz: &Npz, extent: Extent) -> Vec<[View; 2]> {
    let (rotations, translations) = (npz.rows::<9>("R_xi"), npz.rows::<3>("t_xi"));
    let both = |(index, view): (usize, View)| {
        let given = View { extent, ..view };
        let camera_from_world = rows(&rotations[index]).try_into().expect("3×3");
        let moved = View { camera_from_world, translation: translations[index], ..given.clone() };
        [given, moved]
    };
    sets::views(npz).into_iter().enumerate().map(both).collect()
}

const FIELDS: [&str; 2] = ["d_pose", "d_pose_xi"];

pub fn check(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    gradients_of_device(&npz)?;
    let gpu = Gpu::new();
    let views = views(&npz, Extent::Exact);
    let xi: Vec<[f32; 6]> = npz.rows::<6>("xi").iter().map(|xi| xi.map(|x| x as f32)).collect();
    for (_, prefix) in EXTENTS {
        let [g, expected] = ["d_pose_xi", "d_xi"].map(|field| npz.rows::<6>(&format!("{prefix}{field}")));
        for image in 0..views.len() {
            let [_, of_parameters] = pose_gradient(&gpu, &[g[image].map(|x| x as f32)], &xi, image as u32);
            relative("d_xi", &of_parameters, &expected[image], 1e-6)?;
        }
    }
    let start = |view: &View| {
        let all = [view.camera_from_world.concat(), view.translation.to_vec()].concat();
        let all: [f64; 12] = all.try_into().expect("twelve");
        all.map(|x| x as f32)
    };
    let poses = Poses {
        parameters: xi,
        moments: vec![[[0.0; 6]; 2]; views.len()],
        starts: views.iter().map(|pair| start(&pair[0])).collect(),
        cameras: vec![[0.0; 12]; views.len()],
        // The vectors have no pivot.
        depths: vec![0.0; views.len()],
    };
    let cameras = pose_step(&gpu, &poses, None, 0).cameras;
    for (camera, pair) in cameras.iter().zip(&views) {
        let expected = [pair[1].camera_from_world.concat(), pair[1].translation.to_vec()].concat();
        elementwise("camera", &camera.map(f64::from), &expected, 1e-6, 0.0)?;
    }
    let mut poses = Poses { parameters: vec![[0.0; 6]; views.len()], ..poses };
    for (step, (gradient, rate)) in npz.rows::<6>("adam_g").iter().zip(npz.values("adam_rate")).enumerate() {
        let gradient = gradient.map(|g| g as f32);
        poses = pose_step(&gpu, &poses, Some((0, gradient, *rate, step as u32 + 1)), 0);
        let actual = poses.parameters[0].map(f64::from);
        relative("adam", &actual, &npz.rows::<6>("adam_xi")[step], 1e-5)?;
    }
    Ok(())
}

fn gradients_of_device(npz: &Npz) -> Outcome {
    let scene = gaussians(npz, "");
    let weights = npz.rows::<3>("G");
    let mut renderer = renderer();
    renderer.upload(&engine::gaussians(&scene))?;
    for (extent, prefix) in EXTENTS {
        let mut weights = weights.iter();
        for (index, pair) in views(npz, extent).iter().enumerate() {
            let own: Vec<[f32; 3]> =
                weights.by_ref().take(pair[0].pixels()).map(|color| color.map(|x| x as f32)).collect();
            for (view, field) in pair.iter().zip(FIELDS) {
                let name = format!("{prefix}{field}");
                let gradients = renderer.gradients_with_pose(&camera(view), &settings(view), &own, None)?;
                let pose = gradients.pose.ok_or("no gradient of the pose")?.map(f64::from);
                relative(&name, &pose, &npz.rows::<6>(&name)[index], DEVICE)?;
            }
        }
    }
    drop(renderer);
    assert_silent(context());
    Ok(())
}
