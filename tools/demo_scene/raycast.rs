//! A small ray-caster: analytic intersections (sphere tracing for the torus), one jittered sun, Phong highlights.

use crate::scene::{Object, SHININESS, Scene, Shape};
use crate::view::{Ray, View};
use ashsplat::scene::srgb_from_linear;
use ashsplat_files::Photo;
use glam::{Mat3, Vec2, Vec3, vec3};
use image::{Rgba, RgbaImage};
use rayon::prelude::*;

/// Rays per pixel and axis, on a regular grid. Each of the 9 rays has its own point of the sun's disc.
const GRID: u32 = 3;
/// Half-width of the sun, as seen from the scene (radians): soft shadows.
const SUN_RADIUS: f32 = 0.06;
/// Hits nearer than this are on the surface where the ray starts.
const SKIN: f32 = 1e-3;

/// Where a ray first meets the scene.
pub struct Hit<'a> {
    /// Distance from the ray's origin.
    pub distance: f32,
    /// Outward normal, of unit length.
    pub normal: Vec3,
    object: &'a Object,
}

/// Photographs the scene: 8-bit sRGB, row-major.
pub fn photograph(scene: &Scene, view: &View) -> Photo {
    let (width, height) = (view.camera.width, view.camera.height);
    let row = |y: u32| (0..width).flat_map(move |x| encode(pixel_light(scene, view, x, y)));
    let rgb = (0..height).into_par_iter().flat_map_iter(row).collect();
    Photo { width, height, rgb }
}

/// Photographs without the sky: 8-bit sRGB, with the share of each pixel that is not sky as its opacity. Colours are those of
/// that share, as renderers of transparent pictures store them.
pub fn photograph_cutout(scene: &Scene, view: &View) -> RgbaImage {
    let (width, height) = (view.camera.width, view.camera.height);
    let pixels = (0..height).into_par_iter().flat_map_iter(|y| (0..width).map(move |x| (x, y)));
    let rgba = pixels.flat_map_iter(|(x, y)| {
        let (mut sum, mut hits) = (Vec3::ZERO, 0.0);
        for (sample, ray) in rays(view, x, y) {
            if first_hit(scene, &ray).is_some() {
                sum += light(scene, &ray, sun_sample(sample, x, y));
                hits += 1.0;
            }
        }
        let [r, g, b] = encode(sum / f32::max(hits, 1.0));
        [r, g, b, (255.0 * hits / (GRID * GRID) as f32).round() as u8]
    });
    RgbaImage::from_raw(width, height, rgba.collect()).unwrap_or_default()
}

/// A cutout on black, as readers of data sets convert it.
pub fn on_black(cutout: &RgbaImage) -> Photo {
    let shown = |pixel: &Rgba<u8>| {
        let opacity = f32::from(pixel.0[3]) / 255.0;
        [0, 1, 2].map(|channel| (f32::from(pixel.0[channel]) * opacity).round() as u8)
    };
    Photo { width: cutout.width(), height: cutout.height(), rgb: cutout.pixels().flat_map(shown).collect() }
}

/// The mask of a view's photographs: white where the lens shows all of a pixel, black elsewhere. None if it shows all pixels.
pub fn mask(view: &View) -> Option<Photo> {
    let (width, height) = (view.camera.width, view.camera.height);
    let is_shown = |x: u32, y: u32| rays(view, x, y).count() == (GRID * GRID) as usize;
    let row = |y: u32| (0..width).flat_map(move |x| [if is_shown(x, y) { 255 } else { 0 }; 3]);
    let rgb: Vec<u8> = (0..height).into_par_iter().flat_map_iter(row).collect();
    rgb.contains(&0).then_some(Photo { width, height, rgb })
}

/// The rays of a pixel with their indices, as far as the lens shows it.
fn rays(view: &View, x: u32, y: u32) -> impl Iterator<Item = (u32, Ray)> {
    (0..GRID * GRID).filter_map(move |sample| {
        let offset = |index: u32| (index as f32 + 0.5) / GRID as f32;
        let place = (x as f32 + offset(sample % GRID), y as f32 + offset(sample / GRID));
        Some((sample, view.ray(place.0, place.1)?))
    })
}

/// Index of a ray's point on the sun. 7 is coprime to 9, so the order differs from that of the rays.
fn sun_sample(sample: u32, x: u32, y: u32) -> u32 {
    (sample * 7 + x * 3 + y * 5) % (GRID * GRID)
}

/// Light that arrives at a pixel, linear: the mean of a grid of rays.
pub fn pixel_light(scene: &Scene, view: &View, x: u32, y: u32) -> Vec3 {
    let lights = rays(view, x, y).map(|(sample, ray)| light(scene, &ray, sun_sample(sample, x, y)));
    lights.sum::<Vec3>() / (GRID * GRID) as f32
}

/// Linear light to an 8-bit sRGB triple.
pub fn encode(light: Vec3) -> [u8; 3] {
    light.to_array().map(|v| (srgb_from_linear(v.clamp(0.0, 1.0)) * 255.0 + 0.5) as u8)
}

/// The first surface on a ray, if any.
pub fn first_hit<'a>(scene: &'a Scene, ray: &Ray) -> Option<Hit<'a>> {
    let hits = scene.objects.iter().filter_map(|object| {
        intersect(&object.shape, ray).map(|(distance, normal)| Hit { distance, normal, object })
    });
    hits.min_by(|a, b| a.distance.total_cmp(&b.distance))
}

impl Scene {
    /// Distance of a point from the nearest surface.
    pub fn distance(&self, point: Vec3) -> f32 {
        let distances = self.objects.iter().map(|object| distance(&object.shape, point));
        distances.fold(f32::INFINITY, f32::min)
    }
}

/// Distance of a point from a shape's surface.
fn distance(shape: &Shape, point: Vec3) -> f32 {
    let at = local_position(shape, point);
    let signed = match shape {
        Shape::Sphere { radius, .. } => at.length() - radius,
        Shape::Box { half, .. } => {
            let beyond = at.abs() - *half;
            beyond.max(Vec3::ZERO).length() + beyond.max_element().min(0.0)
        }
        Shape::Capsule { start, end, radius } => {
            let axis = end - start;
            at.distance(axis * (at.dot(axis) / axis.length_squared()).clamp(0.0, 1.0)) - radius
        }
        Shape::Torus { major, minor, .. } => torus_distance(at, *major, *minor),
        Shape::Terrace { radius } => Vec2::new((at.truncate().length() - radius).max(0.0), at.z).length(),
    };
    signed.abs()
}

/// Distance from a torus around the z axis at the origin, negative inside.
fn torus_distance(at: Vec3, major: f32, minor: f32) -> f32 {
    Vec2::new(at.truncate().length() - major, at.z).length() - minor
}

/// Light that returns along a ray; `sun_sample` in 0..9 chooses the point of the sun's disc for the shadow.
fn light(scene: &Scene, ray: &Ray, sun_sample: u32) -> Vec3 {
    let Some(hit) = first_hit(scene, ray) else { return scene.sky(ray.direction) };
    let point = ray.at(hit.distance);
    let Object { shape, texture, gloss, mirror } = hit.object;
    let color = texture.color(local_position(shape, point));
    let to_sun = sun_point(scene.to_sun, sun_sample);
    let shadow_ray = Ray { origin: point + hit.normal * SKIN, direction: to_sun };
    let facing = hit.normal.dot(to_sun).max(0.0);
    let is_free = || scene.objects.iter().all(|object| intersect(&object.shape, &shadow_ray).is_none());
    let sun = if facing > 0.0 && is_free() { scene.sun } else { Vec3::ZERO };
    // The sky as a hemisphere: bluish from above, the terrace's reflected light from below.
    let ambient = vec3(0.25, 0.24, 0.22).lerp(vec3(0.40, 0.46, 0.55), 0.5 + 0.5 * hit.normal.z);
    let mirrored = ray.direction - 2.0 * ray.direction.dot(hit.normal) * hit.normal;
    let highlight = gloss * mirrored.dot(to_sun).max(0.0).powf(SHININESS);
    let diffuse = color * (ambient + sun * facing);
    diffuse * (1.0 - mirror) + scene.sky(mirrored) * *mirror + sun * highlight
}

/// A direction to one of 9 points spread evenly over the sun's disc (a golden-angle spiral).
fn sun_point(to_sun: Vec3, sample: u32) -> Vec3 {
    let radius = SUN_RADIUS * ((sample as f32 + 0.5) / (GRID * GRID) as f32).sqrt();
    let angle = sample as f32 * 2.399_963;
    let (u, v) = to_sun.any_orthonormal_pair();
    (to_sun + radius * (angle.cos() * u + angle.sin() * v)).normalize()
}

/// A world position in the frame in which the shape's texture is defined.
fn local_position(shape: &Shape, point: Vec3) -> Vec3 {
    match shape {
        Shape::Sphere { center, .. } => point - *center,
        Shape::Box { center, local_from_world, .. } | Shape::Torus { center, local_from_world, .. } => {
            *local_from_world * (point - *center)
        }
        Shape::Capsule { start, .. } => point - *start,
        Shape::Terrace { .. } => point,
    }
}

/// Distance and outward normal of the nearest intersection in front of the ray's origin.
fn intersect(shape: &Shape, ray: &Ray) -> Option<(f32, Vec3)> {
    match shape {
        Shape::Sphere { center, radius } => {
            let (t, _) = sphere_roots(ray, *center, *radius)?;
            (t > SKIN).then(|| (t, (ray.at(t) - *center) / *radius))
        }
        Shape::Box { center, half, local_from_world } if may_meet(ray, *center, half.length_squared()) => {
            hit_box(ray, *center, *half, local_from_world)
        }
        Shape::Capsule { start, end, radius }
            if may_meet(ray, start.midpoint(*end), (0.5 * start.distance(*end) + radius).powi(2)) =>
        {
            hit_capsule(ray, *start, *end, *radius)
        }
        Shape::Box { .. } | Shape::Capsule { .. } => None,
        Shape::Torus { center, local_from_world, major, minor } => {
            let origin = *local_from_world * (ray.origin - *center);
            let local = Ray { origin, direction: *local_from_world * ray.direction };
            let (t, normal) = hit_torus(&local, *major, *minor)?;
            Some((t, local_from_world.transpose() * normal))
        }
        Shape::Terrace { radius } => {
            let t = -ray.origin.z / ray.direction.z;
            let inside = t > SKIN && ray.at(t).truncate().length_squared() < radius * radius;
            inside.then_some((t, Vec3::Z))
        }
    }
}

/// True if a ray may meet a ball: rejects most of a city's houses, without a root.
fn may_meet(ray: &Ray, center: Vec3, squared_radius: f32) -> bool {
    let to_center = center - ray.origin;
    let (along, far) = (to_center.dot(ray.direction), to_center.length_squared());
    let within = 1.001 * squared_radius + 1e-4;
    far - along * along <= within && (along > 0.0 || far <= within)
}

/// Both distances at which a line meets a sphere.
fn sphere_roots(ray: &Ray, center: Vec3, radius: f32) -> Option<(f32, f32)> {
    let from_center = ray.origin - center;
    let b = from_center.dot(ray.direction);
    let discriminant = b * b - from_center.length_squared() + radius * radius;
    (discriminant > 0.0).then(|| (-b - discriminant.sqrt(), -b + discriminant.sqrt()))
}

/// Intersects a box, by its three slabs.
fn hit_box(ray: &Ray, center: Vec3, half: Vec3, local_from_world: &Mat3) -> Option<(f32, Vec3)> {
    let origin = *local_from_world * (ray.origin - center);
    let direction = *local_from_world * ray.direction;
    let (a, b) = ((-half - origin) / direction, (half - origin) / direction);
    let (near, far) = (a.min(b), a.max(b));
    let enter = near.max_element();
    if enter <= SKIN || enter >= far.min_element() {
        return None;
    }
    let axis = if enter == near.x {
        Vec3::X
    } else if enter == near.y {
        Vec3::Y
    } else {
        Vec3::Z
    };
    let normal = -axis * direction.dot(axis).signum();
    Some((enter, local_from_world.transpose() * normal))
}

/// Intersects a capsule: a cylinder's side between two spheres.
fn hit_capsule(ray: &Ray, start: Vec3, end: Vec3, radius: f32) -> Option<(f32, Vec3)> {
    let axis = end - start;
    let from_start = ray.origin - start;
    let (aa, ad, ao) = (axis.length_squared(), axis.dot(ray.direction), axis.dot(from_start));
    let a = aa - ad * ad;
    let b = aa * from_start.dot(ray.direction) - ao * ad;
    let c = aa * from_start.length_squared() - ao * ao - radius * radius * aa;
    let discriminant = b * b - a * c;
    if discriminant < 0.0 {
        return None;
    }
    let side = (-b - discriminant.sqrt()) / a;
    let along = (ao + side * ad) / aa;
    if side > SKIN && (0.0..=1.0).contains(&along) {
        return Some((side, (ray.at(side) - start - axis * along) / radius));
    }
    let cap = if along < 0.0 { start } else { end };
    let (t, _) = sphere_roots(ray, cap, radius)?;
    (t > SKIN).then(|| (t, (ray.at(t) - cap) / radius))
}

/// Intersects a torus around the z axis at the origin, by sphere tracing within its bounding sphere.
fn hit_torus(ray: &Ray, major: f32, minor: f32) -> Option<(f32, Vec3)> {
    let (enter, leave) = sphere_roots(ray, Vec3::ZERO, major + minor)?;
    let mut t = enter.max(SKIN);
    for _ in 0..64 {
        let distance = torus_distance(ray.at(t), major, minor);
        if distance < 1e-4 {
            let p = ray.at(t);
            let ring = p.truncate().normalize_or_zero() * major;
            return Some((t, (p - ring.extend(0.0)).normalize_or_zero()));
        }
        t += distance;
        if t > leave {
            return None;
        }
    }
    None
}
