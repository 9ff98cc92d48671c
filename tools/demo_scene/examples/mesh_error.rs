//! Error of a mesh of one of the demo's scenes, which `ashsplat mesh MODEL -o MESH.obj` makes of a model:
//! `cargo run --release -p ashsplat-demo-scene --example mesh_error -- MESH.obj MODEL/cameras.json [LOTS]`, with LOTS for a city.
//!
//! Counts what lies in a ball around the scene's middle; its width is the extent. Accuracy is the share of the mesh's area whose
//! distance from the true surfaces is below a limit. Completeness is the share of what the cameras' pixels show that is as near to
//! the mesh. The F-score is their harmonic mean.

use ashsplat::scene::WorldFrame;
use ashsplat_demo_scene::city::{self, City};
use ashsplat_demo_scene::{Scene, View, raycast};
use ashsplat_files::{cameras_json, regular_file};
use glam::Vec3;
use rayon::prelude::*;
use std::collections::HashMap;
use std::error::Error;

/// Limits, shares of the extent.
const LIMITS: [f32; 2] = [0.005, 0.0025];
/// Distance between points on the mesh, of the smallest limit.
const SPACING: f32 = 0.2;
/// Radius of the ball of the terrace, and per lot along a side of a city, of which the cameras' flight covers nine tenths.
const RADIUS: f32 = 3.0;
const LOT_RADIUS: f32 = 0.72;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [mesh, cameras, lots @ ..] = &arguments[..] else {
        return Err("give MESH.obj and cameras.json".into());
    };
    let (scene, radius) = match lots.first() {
        Some(lots) => {
            let lots = lots.parse()?;
            (city::scene(City { lots, ..City::default() }), LOT_RADIUS * lots as f32)
        }
        None => (Scene::demo(), RADIUS),
    };
    let limits = LIMITS.map(|share| 2.0 * radius * share);
    let counts = |point: &Vec3| point.length() < radius;
    let mut points = points_of(&String::from_utf8(regular_file::read(mesh, 1)?)?, SPACING * limits[1])?;
    points.retain(counts);
    let off: Vec<f32> = points.par_iter().map(|&point| scene.distance(point)).collect();
    // Cells of the largest limit: what is nearer lies in one of 27.
    let cell = |point: Vec3| (point / limits[0]).to_array().map(|at| at.floor() as i32);
    let mut cells: HashMap<[i32; 3], Vec<Vec3>> = HashMap::new();
    points.iter().for_each(|&point| cells.entry(cell(point)).or_default().push(point));
    let nearest = |point: Vec3| {
        let [x, y, z] = cell(point);
        let cube = (0..27).map(|i| [x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1]);
        let near = cube.filter_map(|cell| cells.get(&cell)).flatten();
        near.map(|other| other.distance(point)).fold(f32::INFINITY, f32::min)
    };
    let views = cameras_json::read(cameras, &WorldFrame::default())?;
    let shown = views.par_iter().flat_map_iter(|named| {
        let view = View::new(named.camera);
        let (width, height) = (named.camera.width, named.camera.height);
        let pixels = (0..height).flat_map(move |y| (0..width).map(move |x| [x, y].map(|at| at as f32 + 0.5)));
        let rays = pixels.filter_map(move |[x, y]| view.ray(x, y));
        rays.filter_map(|ray| raycast::first_hit(&scene, &ray).map(|hit| ray.at(hit.distance)))
    });
    let missing: Vec<f32> = shown.filter(counts).map(nearest).collect();
    for (share, limit) in LIMITS.into_iter().zip(limits) {
        let within = |errors: &[f32]| {
            errors.iter().filter(|&&error| error < limit).count() as f32 / errors.len().max(1) as f32
        };
        let (accuracy, completeness) = (within(&off), within(&missing));
        let score = 2.0 * accuracy * completeness / (accuracy + completeness).max(f32::MIN_POSITIVE);
        println!(
            "within {} %: F-score {score:.4}, accuracy {accuracy:.4}, completeness {completeness:.4}",
            100.0 * share
        );
    }
    Ok(())
}

/// Points on the triangles of an OBJ, evenly spread: one for each square of this side.
fn points_of(text: &str, spacing: f32) -> Result<Vec<Vec3>, Box<dyn Error>> {
    let (mut vertices, mut points, mut owed) = (Vec::new(), Vec::new(), 0.0_f64);
    for line in text.lines() {
        let mut words = line.split_ascii_whitespace();
        match words.next() {
            Some("v") => {
                let mut next = || words.next().unwrap_or("").parse::<f32>();
                vertices.push(Vec3::new(next()?, next()?, next()?));
            }
            Some("f") => {
                let corner = |word: &str| {
                    let index = word.split('/').next()?.parse::<usize>().ok()?;
                    vertices.get(index.checked_sub(1)?).copied()
                };
                let corners: Option<Vec<Vec3>> = words.map(corner).collect();
                let Some(&[a, b, c]) = corners.as_deref() else {
                    return Err(
                        format!("`{line}` is no triangle of {} vertices before it", vertices.len()).into()
                    );
                };
                owed += f64::from(0.5 * (b - a).cross(c - a).length() / (spacing * spacing));
                while owed >= 1.0 {
                    owed -= 1.0;
                    // Additive recurrence of the plastic number, folded into the triangle.
                    let place = points.len() as f64;
                    let [u, v] =
                        [0.754_877_666, 0.569_840_291].map(|step: f64| (place * step).fract() as f32);
                    let [u, v] = if u + v > 1.0 { [1.0 - u, 1.0 - v] } else { [u, v] };
                    points.push(a + u * (b - a) + v * (c - a));
                }
            }
            _ => {}
        }
    }
    Ok(points)
}
