//! Errors of depths and normals of the demo's trained terrace, in the pictures of the named cameras (those held out, say):
//! `cargo run --release -p ashsplat-demo-scene --example depth_error -- SCENE.ply MODEL/cameras.json NAME...`.
//!
//! Counts pixels that show a surface both in the frame and in the truth. An error of depth is relative to the true depth along the
//! view axis, an error of a normal is the angle to the true one.

use ashsplat::scene::WorldFrame;
use ashsplat::vk::{Context, ContextOptions};
use ashsplat::{RenderSettings, Renderer, SurfaceDepth};
use ashsplat_demo_scene::{Scene, View, raycast};
use ashsplat_files::cameras_json;
use ashsplat_files::splats::{self, ReadOptions};
use glam::Vec3;
use rayon::prelude::*;
use std::error::Error;
use std::path::Path;

const USAGE: &str = "give SCENE.ply, cameras.json and names of cameras";
const NORMAL_DEGREES: f32 = 10.0;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [scene, cameras, names @ ..] = &arguments[..] else { return Err(USAGE.into()) };
    if names.is_empty() {
        return Err(USAGE.into());
    }
    let (trained, truth) = (splats::read(Path::new(scene), &ReadOptions::default())?, Scene::demo());
    let known = cameras_json::read(cameras, &WorldFrame::default())?;
    let view = |name: &String| {
        known.iter().find(|view| view.name == *name).ok_or(format!("{cameras} has no {name}"))
    };
    let views = names.iter().map(view).collect::<Result<Vec<_>, _>>()?;
    let mut renderer = Renderer::new(&Context::new(&ContextOptions::default())?)?;
    renderer.upload(&trained.gaussians)?;
    for (name, depth) in [("median", SurfaceDepth::Median), ("front", SurfaceDepth::Front)] {
        let antialias = trained.header.antialiased;
        let settings = RenderSettings { surface: Some(depth), antialias, ..RenderSettings::default() };
        let (mut depths, mut normals) = (Vec::new(), Vec::new());
        for named in &views {
            let (camera, view) = (named.camera, View::new(named.camera));
            let drawn = renderer.render(&camera, &settings)?.surface.unwrap_or_default();
            let error = |pixel: usize| {
                let [x, y] = [pixel as u32 % camera.width, pixel as u32 / camera.width];
                let ray = view.ray(x as f32 + 0.5, y as f32 + 0.5)?;
                let hit = raycast::first_hit(&truth, &ray).filter(|_| drawn.depth[pixel] > 0.0)?;
                let (point, normal) = (ray.at(hit.distance), Vec3::from(drawn.normals[pixel]));
                let z = camera.camera_from_world.transpose().z_axis.dot(point) + camera.translation.z;
                Some((((drawn.depth[pixel] - z) / z).abs(), normal.angle_between(hit.normal).to_degrees()))
            };
            let errors: Vec<(f32, f32)> = (0..drawn.depth.len()).into_par_iter().filter_map(error).collect();
            depths.extend(errors.iter().map(|error| error.0));
            normals.extend(errors.iter().map(|error| error.1));
        }
        depths.sort_by(f32::total_cmp);
        let count = depths.len().max(1) as f32;
        println!(
            "{name} depth of {} views: error {:.3} % in the median, {:.3} % in the mean; {:.1} % of normals within {NORMAL_DEGREES}°",
            views.len(),
            100.0 * depths.get(depths.len() / 2).unwrap_or(&f32::NAN),
            100.0 * depths.iter().sum::<f32>() / count,
            100.0 * normals.iter().filter(|angle| **angle < NORMAL_DEGREES).count() as f32 / count
        );
    }
    Ok(())
}
