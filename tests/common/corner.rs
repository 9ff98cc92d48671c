//! A corner of a room with patterned walls, whose photographs COLMAP can align.

use ashsplat::scene::{Camera, Intrinsics, Photo};
use glam::{Vec3, vec3};

pub const SIZE: [u32; 2] = [480, 360];

/// Camera on a walk along the corner, at `share` (0 to 1) of its length.
pub fn camera(share: f32) -> Camera {
    let eye = vec3(1.6 * share - 1.6, 0.25 * (9.0 * share).sin(), 0.7 * share - 1.0);
    let intrinsics = Intrinsics::from_fov_x(0.85, SIZE[0], SIZE[1]);
    Camera::look_at(eye, vec3(0.9, 0.5, 3.0), Vec3::NEG_Y, intrinsics)
}

pub fn photograph(camera: &Camera) -> Photo {
    let world_from_camera = camera.camera_from_world.transpose();
    let eye = camera.position();
    let mut rgb = Vec::new();
    for (y, x) in (0..camera.height).flat_map(|y| (0..camera.width).map(move |x| (y, x))) {
        let (x, y) = (x as f32 + 0.5 - camera.cx, y as f32 + 0.5 - camera.cy);
        let ray = world_from_camera * vec3(x / camera.fx, y / camera.fy, 1.0);
        rgb.extend(color(eye, ray));
    }
    Photo { width: camera.width, height: camera.height, rgb }
}

/// Colour of the nearest of two walls and the floor along the ray.
fn color(eye: Vec3, ray: Vec3) -> [u8; 3] {
    let walls = [(0, 2.0, 1, 2), (1, 1.4, 0, 2), (2, 4.0, 0, 1)];
    let hits = walls.into_iter().filter_map(|(axis, at, u, v)| {
        let distance = (at - eye[axis]) / ray[axis];
        let place = eye + ray * distance;
        (distance > 0.0 && distance.is_finite()).then_some((distance, [place[u], place[v]], axis as u32))
    });
    let Some((_, place, wall)) = hits.min_by(|a, b| a.0.total_cmp(&b.0)) else { return [40; 3] };
    [0, 1, 2].map(|channel| pattern(place, 3 * wall + channel))
}

/// Random squares of several sizes, none of which repeats.
fn pattern(place: [f32; 2], seed: u32) -> u8 {
    let level = |size: f32| {
        let [x, y] = place.map(|along| (along / size).floor() as i32 as u32);
        let mixed =
            x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca6b) ^ seed.wrapping_mul(0xc2b2_ae35);
        let mixed = (mixed ^ (mixed >> 15)).wrapping_mul(0x2c1b_3c6d);
        f32::from(((mixed ^ (mixed >> 13)) & 255) as u8)
    };
    (0.5 * level(0.4) + 0.3 * level(0.13) + 0.2 * level(0.05)) as u8
}
