//! Popping of a trained demo scene while a camera turns about its own centre, in both orders of blending:
//! `cargo run --release -p ashsplat-demo-scene --example popping -- SCENE.ply`.
//!
//! Each sample is three frames of a small turn. With f for frames and g for the ray caster's photographs of the same cameras, the
//! first figures are the mean and the 99th percentile of |(f' - f) - (g' - g)|, in levels of 255. They include errors of the scene,
//! which move with it. What moves changes alike in both steps of a sample, so |f'' - 2 f' + f| shows what jumps in one of them. The
//! last figure counts pixels where that is above two levels.

use ashsplat::scene::{Camera, Intrinsics, srgb_from_linear};
use ashsplat::vk::{Context, ContextOptions};
use ashsplat::{RenderSettings, Renderer};
use ashsplat_demo_scene::{Scene, View, raycast};
use ashsplat_files::splats::{self, ReadOptions};
use glam::{Mat3, Vec3, vec3};
use rayon::prelude::*;
use std::error::Error;
use std::path::Path;

const SIZE: [u32; 2] = [256, 192];
const SAMPLES: u32 = 120;
const APART_DEGREES: f32 = 0.25;
/// Turn from frame to frame: a tenth of a pixel, so that what moves hardly bends.
const STEP_DEGREES: f32 = 0.02;

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).ok_or("give the scene's file")?;
    let scene = splats::read(Path::new(&path), &ReadOptions::default())?;
    let mut renderer = Renderer::new(&Context::new(&ContextOptions::default())?)?;
    renderer.upload(&scene.gaussians)?;
    let samples: Vec<[Camera; 3]> = (0..SAMPLES)
        .map(|sample| {
            [0, 1, 2].map(|frame| turned(sample as f32 * APART_DEGREES + frame as f32 * STEP_DEGREES))
        })
        .collect();
    let photographs: Vec<_> = samples.iter().map(|[first, next, _]| [first, next].map(photograph)).collect();
    for distance_order in [false, true] {
        let antialias = scene.header.antialiased;
        let settings = RenderSettings { distance_order, antialias, ..RenderSettings::default() };
        let (mut mean, mut percentile, mut jumps) = (0.0, 0.0, 0);
        for (cameras, [g0, g1]) in samples.iter().zip(&photographs) {
            let mut frames = Vec::new();
            for camera in cameras {
                frames.push(renderer.render(camera, &settings)?.color.into_flattened());
            }
            let mut errors = levels(|i| (frames[1][i] - frames[0][i]) - (g1[i] - g0[i]));
            errors.sort_by(f32::total_cmp);
            mean += errors.iter().sum::<f32>() / errors.len() as f32;
            percentile += errors[errors.len() * 99 / 100];
            let bends = levels(|i| frames[2][i] - 2.0 * frames[1][i] + frames[0][i]);
            jumps += bends.iter().filter(|bend| **bend > 2.0).count();
        }
        println!(
            "by {}: mean {:.4}, 99th percentile {:.4}; {:.0} pixels jump in a degree",
            if distance_order { "distance" } else { "z" },
            mean / SAMPLES as f32,
            percentile / SAMPLES as f32,
            jumps as f32 / (SAMPLES as f32 * 2.0 * STEP_DEGREES)
        );
    }
    Ok(())
}

/// A camera between the demo's two circles, turned by an angle that shows its target halfway through the samples.
fn turned(degrees: f32) -> Camera {
    let (target, outward) = (vec3(0.0, 0.0, 0.45), vec3(0.57, 0.72, 0.39));
    let turn = Mat3::from_rotation_z((degrees - 0.5 * SAMPLES as f32 * APART_DEGREES).to_radians());
    let eye = target + 4.0 * outward;
    Camera::look_at(eye, eye - turn * outward, Vec3::Z, Intrinsics::from_fov_x(0.96, SIZE[0], SIZE[1]))
}

fn photograph(camera: &Camera) -> Vec<f32> {
    let (scene, view) = (Scene::demo(), View::new(*camera));
    let light = |place: u32| raycast::pixel_light(&scene, &view, place % SIZE[0], place / SIZE[0]);
    let encoded = |light: Vec3| light.to_array().map(|v| srgb_from_linear(v.clamp(0.0, 1.0)));
    (0..SIZE[0] * SIZE[1]).into_par_iter().flat_map_iter(|place| encoded(light(place))).collect()
}

/// Size of each pixel's values, the mean over its channels, in levels of 255.
fn levels(of: impl Fn(usize) -> f32) -> Vec<f32> {
    let pixel = |pixel: u32| {
        [0, 1, 2].map(|channel| of(3 * pixel as usize + channel).abs()).iter().sum::<f32>() * 85.0
    };
    (0..SIZE[0] * SIZE[1]).map(pixel).collect()
}
