//! A city of many houses, photographed from above: a scene to be trained in blocks.
//!
//! World frame: z up, the ground at z = 0. A square of lots of 1.6 units, eight by eight by default. Houses have individual
//! sizes, colours and textures; about every seventh lot has trees instead. The cameras fly over it in a grid and look
//! obliquely, so each photograph shows a few lots and none shows all of them. Other cities have about as many photographs per lot.

use crate::scene::{Object, Scene, Shape, Texture, lattice_noise};
use ashsplat::scene::{Camera, Intrinsics};
use glam::{Vec3, vec3};

/// Lots along a side of the default city.
const LOTS: u32 = 8;
/// Side of a lot.
const LOT: f32 = 1.6;
/// Camera positions along a side of the default city, with two views each.
const CAMERAS: u32 = 9;
/// Half the side of the square of camera positions, and their height.
const FLIGHT: [f32; 2] = [5.8, 3.0];
/// Radius of the terrace per lot along a side. A smaller city stands on that of the default one.
const TERRACE: f32 = 1.25;
/// Horizontal field of view, radians.
const FOV_X: f32 = 0.96;

/// Size of a city and of its photographs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct City {
    /// Lots along a side.
    pub lots: u32,
    /// Width of the photographs, pixels; their height is three quarters of it.
    pub width: u32,
}

impl Default for City {
    fn default() -> Self {
        Self { lots: LOTS, width: 128 }
    }
}

/// The scene of a city.
pub fn scene(city: City) -> Scene {
    let lots = city.lots as i32;
    let ground = Texture::Tiles {
        colors: [vec3(0.20, 0.20, 0.21), vec3(0.36, 0.35, 0.33)],
        joint: vec3(0.55, 0.54, 0.50),
        size: LOT,
    };
    let mut objects =
        vec![Object::matt(Shape::Terrace { radius: TERRACE * city.lots.max(LOTS) as f32 }, ground)];
    for (i, j) in (0..lots).flat_map(|i| (0..lots).map(move |j| (i, j))) {
        objects.extend(lot(i, j, lots));
    }
    Scene::in_sunlight(objects)
}

fn lot(i: i32, j: i32, lots: i32) -> Vec<Object> {
    let random = |what: i32| lattice_noise(i, j, 100 + what);
    let middle = |index: i32| (index as f32 - 0.5 * (lots - 1) as f32) * LOT;
    let center = vec3(middle(i), middle(j), 0.0);
    if random(0) < 0.15 {
        return trees(center, &random);
    }
    let color = |what: i32| vec3(random(what), random(what + 1), random(what + 2)) * 0.6 + 0.1;
    let half = vec3(0.32 + 0.22 * random(1), 0.32 + 0.22 * random(2), 0.2 + 0.5 * random(3));
    let angle = 0.5 * random(4) - 0.25;
    let walls = match (3.0 * random(5)) as u32 {
        0 => Texture::Checker { colors: [color(10), color(13)], size: 0.12 + 0.12 * random(6) },
        1 => Texture::Stripes {
            colors: [color(10), color(13)],
            width: 0.16 + 0.1 * random(6),
            direction: Vec3::Z,
        },
        _ => Texture::Noise { colors: [color(10), color(13)], size: 0.1 + 0.1 * random(6) },
    };
    let roof = Texture::Noise { colors: [color(16), color(19)], size: 0.15 };
    let flat = half * vec3(0.7, 0.7, 0.0) + vec3(0.0, 0.0, 0.05 + 0.1 * random(7));
    let above = |z: f32| center + z * Vec3::Z;
    vec![
        Object::matt(Shape::turned_box(above(half.z), half, angle), walls),
        Object::glossy(Shape::turned_box(above(2.0 * half.z + flat.z), flat, angle), roof, 0.2, 0.0),
    ]
}

fn trees(center: Vec3, random: &impl Fn(i32) -> f32) -> Vec<Object> {
    let tree = |number: i32| {
        let place = |what: i32| 0.8 * random(30 + 5 * number + what) - 0.4;
        let foot = center + vec3(place(0), place(1), 0.0);
        let (height, radius) = (0.35 + 0.3 * random(33 + 5 * number), 0.15 + 0.12 * random(34 + 5 * number));
        let bark = Texture::Noise { colors: [vec3(0.30, 0.14, 0.05), vec3(0.45, 0.28, 0.14)], size: 0.1 };
        let leaves = Texture::Noise { colors: [vec3(0.05, 0.24, 0.06), vec3(0.35, 0.52, 0.12)], size: 0.12 };
        let top = foot + height * Vec3::Z;
        [
            Object::matt(Shape::Capsule { start: foot, end: top, radius: 0.04 }, bark),
            Object::matt(Shape::Sphere { center: top, radius }, leaves),
        ]
    };
    (0..3).flat_map(tree).collect()
}

/// Cameras of the flight, in alternating rows. Each position has a view ahead and one aside, in directions that turn along the way.
pub fn cameras(city: City) -> Vec<Camera> {
    let intrinsics = Intrinsics::from_fov_x(FOV_X, city.width, city.width * 3 / 4);
    let half = FLIGHT[0] + 0.5 * LOT * (city.lots as f32 - LOTS as f32);
    // The same spacing as over the default city.
    let between = 2.0 * FLIGHT[0] / (CAMERAS - 1) as f32;
    let along = ((2.0 * half / between).round() as u32).max(1) + 1;
    let view = |index: u32| {
        let (place, aside) = (index / 2, index % 2);
        let (row, column) = (place / along, place % along);
        let column = if row.is_multiple_of(2) { column } else { along - 1 - column };
        let at = |step: u32| half * (2.0 * step as f32 / (along - 1) as f32 - 1.0);
        let eye = vec3(at(column), at(row), FLIGHT[1]);
        let azimuth = 2.4 * place as f32 + 1.7 * aside as f32;
        // Turned inward at the rim, since nothing lies outside.
        let inward = -0.12 * (FLIGHT[0] / half) * vec3(eye.x, eye.y, 0.0);
        let look = vec3(azimuth.cos(), azimuth.sin(), 0.0) + inward - 1.3 * Vec3::Z;
        Camera::look_at(eye, eye + look, Vec3::Z, intrinsics)
    };
    (0..2 * along * along).map(view).collect()
}
