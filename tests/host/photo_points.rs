//! Points found in photographs of a wall with a known position.

use super::files::assert_says;
use ashsplat::scene::{Camera, Intrinsics, PointCloud, StoredPhoto};
use ashsplat_files::photo_points::photo_points;
use ashsplat_files::{HostMemory, Photo, Progress, View};
use glam::{Vec3, vec3};
use std::sync::atomic::AtomicBool;

const SIZE: [u32; 2] = [160, 120];

/// Distance from the wall z = 4 + 0.3 x.
fn off_the_wall(point: Vec3) -> f32 {
    (point.z - 4.0 - 0.3 * point.x).abs()
}

/// Texture of the wall: waves of many lengths, which never repeat.
fn paint(x: f32, y: f32) -> [u8; 3] {
    let waves = [[3.1, 1.7], [-7.3, 5.9], [13.7, 11.1], [4.3, -17.9]];
    std::array::from_fn(|channel| {
        let wave = |(n, [a, b]): (usize, &[f32; 2])| (a * x + b * y + (n * channel) as f32).sin();
        let sum: f32 = waves.iter().enumerate().map(wave).sum();
        (128.0 + 28.0 * sum) as u8
    })
}

/// Seven views of the painted wall, along an arc.
fn views(paint: impl Fn(f32, f32) -> [u8; 3], mask: impl Fn(u32) -> Option<Vec<u8>>) -> Vec<View> {
    let [width, height] = SIZE;
    let intrinsics = Intrinsics { fx: 150.0, fy: 150.0, cx: 80.0, cy: 60.0, width, height };
    let view = |index: u32| {
        let eye = vec3(0.5 * (index as f32 - 3.0), 0.1 * (index % 3) as f32, 0.0);
        let camera = Camera::look_at(eye, vec3(0.0, 0.0, 4.0), Vec3::NEG_Y, intrinsics);
        let pixel = |at: u32| {
            let (x, y) = ((at % width) as f32 + 0.5, (at / width) as f32 + 0.5);
            let ray = vec3((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0);
            let ray = camera.camera_from_world.transpose() * ray;
            let steps = (4.0 + 0.3 * eye.x - eye.z) / (ray.z - 0.3 * ray.x);
            let there = eye + steps * ray;
            paint(there.x, there.y)
        };
        let rgb = (0..width * height).flat_map(pixel).collect();
        View {
            name: format!("{index}.png"),
            image_id: index,
            camera_id: 1,
            camera,
            original_camera: camera,
            photo: StoredPhoto::new(Photo { width, height, rgb }, mask(index)),
            inverse_depth: None,
            depth_points: None,
        }
    };
    (0..7).map(view).collect()
}

fn found(views: &[View], count: usize, seed: u64) -> PointCloud {
    photo_points(views, 1.0, count, seed, &HostMemory::default(), Progress::NONE).expect("points")
}

#[test]
fn photo_points_lie_on_the_wall_and_have_its_colours() {
    let points = found(&views(paint, |_| None), usize::MAX, 0);
    assert!(points.len() > 20_000, "{} of {} pixels", points.len(), 7 * 128 * 96);
    let mut off: Vec<f32> = points.positions.iter().map(|&p| off_the_wall(p.into())).collect();
    off.sort_unstable_by(f32::total_cmp);
    // The candidate depths are 0.16 apart here.
    let (median, percentile_95) = (off[off.len() / 2], off[off.len() * 95 / 100]);
    assert!(median < 0.05 && percentile_95 < 0.12, "median {median}, 95 % {percentile_95} off the wall");
    let difference = |(p, color): (&[f32; 3], &[u8; 3])| {
        let wall = paint(p[0], p[1]);
        (0..3).map(|c| f64::from(wall[c].abs_diff(color[c]))).sum::<f64>() / 3.0
    };
    let mean = points.positions.iter().zip(&points.colors).map(difference).sum::<f64>() / points.len() as f64;
    assert!(mean < 12.0, "colours differ by {mean}");
}

#[test]
fn photo_points_are_none_where_nothing_can_be_told() {
    let grey = |_: f32, _: f32| [90; 3];
    assert_eq!(found(&views(grey, |_| None)[..4], 1000, 0).len(), 0, "without texture");
    let all = |_| Some(vec![0; (SIZE[0] * SIZE[1]) as usize]);
    assert_eq!(found(&views(paint, all)[..4], 1000, 0).len(), 0, "all is left out");
    assert_eq!(found(&views(paint, |_| None)[..2], 1000, 0).len(), 0, "two views: nobody confirms");
    assert_eq!(found(&[], 1000, 0).len(), 0);
    let first = views(paint, |_| None).swap_remove(0);
    assert_eq!(found(&vec![first; 5], 1000, 0).len(), 0, "from one place");
}

/// With memory for one photograph, threads take turns and give the same points.
#[test]
fn photo_points_keep_to_the_memory_given() {
    let views = &views(paint, |_| None)[..4];
    let one = 7 * u64::from(SIZE[0] * SIZE[1]);
    let within = |bytes| photo_points(views, 1.0, 500, 0, &HostMemory::new(bytes), Progress::NONE);
    assert!(within(one).expect("points") == found(views, 500, 0));
    assert_says(within(one - 1).expect_err("no room").to_string(), &[".png", "--max-host-memory"]);
}

#[test]
fn photo_points_are_chosen_by_the_seed_and_end_when_asked_to() {
    // The left half of each photograph is masked.
    let half = |_| Some((0..SIZE[0] * SIZE[1]).map(|at| u8::from(at % SIZE[0] >= 80) * 255).collect());
    let views = &views(paint, half)[..4];
    let points = found(views, 500, 3);
    assert_eq!((points.len(), points.colors.len()), (500, 500));
    assert!(points == found(views, 500, 3) && points != found(views, 500, 4));
    let seen_right = |&p: &[f32; 3]| views.iter().any(|view| view.camera.project(p.into()).0 > 79.0);
    assert!(points.positions.iter().all(seen_right));
    // Masked pixels have no influence.
    let hidden_otherwise = |view: &View| {
        let mut photo = view.photo.photo().expect("in memory").as_ref().clone();
        let mask = view.photo.mask().expect("in memory").expect("a mask");
        let pixels = photo.rgb.as_chunks_mut::<3>().0.iter_mut().zip(mask.iter());
        pixels.filter(|(_, seen)| **seen == 0).for_each(|(pixel, _)| *pixel = pixel.map(|c| 255 - c));
        View { photo: StoredPhoto::new(photo, Some(mask.to_vec())), ..view.clone() }
    };
    let others: Vec<View> = views.iter().map(hidden_otherwise).collect();
    assert!(others[0].photo != views[0].photo && points == found(&others, 500, 3));
    let stop = AtomicBool::new(true);
    let progress = Progress { report: None, interrupted: Some(&stop) };
    let error = photo_points(views, 1.0, 500, 3, &HostMemory::default(), progress).expect_err("interrupted");
    assert!(matches!(error, ashsplat::Error::Interrupted), "{error}");
}
