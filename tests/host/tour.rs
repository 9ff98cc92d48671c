//! Camera paths that stay where other cameras have been.

use ashsplat::scene::{Camera, Intrinsics, Motion, tour};
use glam::{Vec3, vec3};
use std::f32::consts::{PI, TAU};

fn intrinsics() -> Intrinsics {
    Intrinsics::from_fov_x(0.9, 64, 48)
}

fn look(eye: Vec3, target: Vec3) -> Camera {
    Camera::look_at(eye, target, Vec3::NEG_Y, intrinsics())
}

/// Target of the cameras of [`ring`].
const MIDDLE: Vec3 = vec3(3.0, -2.0, 5.0);

/// Cameras around [`MIDDLE`] at these azimuths (radians), 4 units away and 1 above.
fn ring(azimuths: impl Iterator<Item = f32>) -> Vec<Camera> {
    let camera = |azimuth: f32| {
        let (sine, cosine) = azimuth.sin_cos();
        let eye = MIDDLE + vec3(4.0 * cosine, -1.0, 4.0 * sine);
        look(eye, MIDDLE)
    };
    azimuths.map(camera).collect()
}

/// Angle between two cameras' positions as seen from the middle.
fn apart(a: &Camera, b: &Camera) -> f32 {
    (a.position() - MIDDLE).with_y(0.0).angle_between((b.position() - MIDDLE).with_y(0.0))
}

#[test]
fn a_motion_suits_the_cameras() {
    let around = ring((0..24).map(|i| TAU * i as f32 / 24.0));
    assert_eq!(Motion::of(&around), Motion::Orbit);
    // A gap in front of a wall: it is still an orbit.
    let nearly = ring((0..20).map(|i| TAU * i as f32 / 24.0));
    assert_eq!(Motion::of(&nearly), Motion::Orbit);
    // The azimuths wrap around inside the arc.
    let facade = ring((0..11).map(|i| PI - 0.5 + 0.1 * i as f32));
    assert_eq!(Motion::of(&facade), Motion::Arc);
    let stack: Vec<Camera> = (0..5).map(|i| look(vec3(0.0, i as f32, -4.0), Vec3::ZERO)).collect();
    assert_eq!(Motion::of(&stack), Motion::Arc);
    let corridor: Vec<Camera> = (0..30)
        .map(|i| vec3(0.1 * i as f32, 0.0, i as f32))
        .map(|eye| Camera::look_at(eye, eye + vec3(0.3 * eye.z.sin(), 0.0, 1.0), Vec3::NEG_Y, intrinsics()))
        .collect();
    assert_eq!(Motion::of(&corridor), Motion::Path);
    let outward: Vec<Camera> =
        around.iter().map(|c| look(c.position(), 2.0 * c.position() - MIDDLE)).collect();
    assert_eq!(Motion::of(&outward), Motion::Path);
    assert_eq!(Motion::of(&around[..2]), Motion::Path);
}

/// The cameras look down, and one side has none: the mean of their up vectors leans.
#[test]
fn an_orbit_is_level() {
    let cameras: Vec<Camera> = (0..20)
        .map(|i| TAU * i as f32 / 25.0)
        .map(|azimuth| MIDDLE + vec3(4.0 * azimuth.cos(), -4.0, 4.0 * azimuth.sin()))
        .map(|eye| look(eye, MIDDLE))
        .collect();
    assert_eq!(Motion::of(&cameras), Motion::Orbit);
    for camera in Motion::Orbit.cameras(&cameras, 12, true, intrinsics()) {
        let height = MIDDLE.y - camera.position().y;
        assert!((height - 4.0).abs() < 0.01, "{height}");
    }
}

#[test]
fn an_arc_stays_between_its_ends() {
    let facade = ring((0..11).map(|i| PI - 0.5 + 0.1 * i as f32));
    for (looped, count) in [(false, 1), (false, 9), (true, 40)] {
        let way = Motion::Arc.cameras(&facade, count, looped, intrinsics());
        assert_eq!(way.len(), count as usize);
        for camera in &way {
            camera.check().expect("sound");
            let distance = camera.position().distance(MIDDLE);
            assert!((distance - 17f32.sqrt()).abs() < 1e-3, "{distance}");
            let (x, y, _) = camera.project(MIDDLE);
            assert!((x - 32.0).abs() < 1e-2 && (y - 24.0).abs() < 1e-2, "{x} {y}");
            let ends = [&facade[0], &facade[10]].map(|end| apart(camera, end));
            assert!((ends[0] + ends[1] - 1.0).abs() < 1e-3, "outside of the arc: {ends:?}");
            assert!(ends.iter().all(|end| *end > 0.099), "beyond what two cameras saw: {ends:?}");
        }
    }
    let once = Motion::Arc.cameras(&facade, 9, false, intrinsics());
    assert!((apart(&once[0], &once[8]) - 0.8).abs() < 1e-3, "it does not reach both ends");
    let looped = Motion::Arc.cameras(&facade, 40, true, intrinsics());
    assert!(apart(&looped[0], &facade[5]) < 1e-3, "it does not begin in the middle");
    assert!(apart(&looped[0], &looped[39]) < 0.07 && (apart(&looped[10], &looped[30]) - 0.8).abs() < 1e-3);
    // With three cameras, at most an eighth at each end is left out.
    let three = ring([0.0, 0.5, 1.0].into_iter());
    let once = Motion::Arc.cameras(&three, 2, false, intrinsics());
    assert!((apart(&once[0], &once[1]) - 0.75).abs() < 1e-3);
}

/// Two rounds at two heights: the path runs between them and does not jump.
#[test]
fn an_arc_is_smooth() {
    let cameras: Vec<Camera> = (0..40)
        .map(|i| (0.04 * i as f32, if i % 2 == 0 { -1.5 } else { 1.5 }))
        .map(|(azimuth, y)| MIDDLE + vec3(4.0 * azimuth.cos(), y, 4.0 * azimuth.sin()))
        .map(|eye| look(eye, MIDDLE))
        .collect();
    assert_eq!(Motion::of(&cameras), Motion::Arc);
    for camera in Motion::Arc.cameras(&cameras, 60, true, intrinsics()) {
        assert!((camera.position().y - MIDDLE.y).abs() < 0.3, "{}", camera.position());
    }
}

#[test]
fn a_path_passes_along_the_cameras() {
    let eye = |z: f32| vec3((0.3 * z).sin(), 0.0, z);
    let mut cameras: Vec<Camera> = (0..30).map(|i| look(eye(i as f32), eye(i as f32) + Vec3::Z)).collect();
    let near_the_corridor = |way: &[Camera]| {
        let (mut last, mut longest) = (way[0].position(), 0f32);
        for camera in way {
            camera.check().expect("sound");
            let position = camera.position();
            assert!(position.distance(eye(position.z)) < 0.15, "{position} is off the way");
            assert!(camera.forward().dot(Vec3::Z) > 0.999);
            longest = longest.max(position.distance(last));
            last = position;
        }
        assert!(longest < 1.0, "a jump of {longest}");
    };
    near_the_corridor(&Motion::Path.cameras(&cameras, 60, false, intrinsics()));
    // Unordered photographs: the path goes from neighbour to neighbour. The first camera stays.
    let shuffled: Vec<usize> = (0..30).map(|i| i * 7 % 30).collect();
    cameras = shuffled.iter().map(|&i| cameras[i]).collect();
    near_the_corridor(&Motion::Path.cameras(&cameras, 60, false, intrinsics()));
    let still = Motion::Path.cameras(&cameras[..1], 3, false, intrinsics());
    assert!(still.iter().all(|camera| camera.position().abs_diff_eq(cameras[0].position(), 1e-5)));
    for motion in [Motion::Orbit, Motion::Arc, Motion::Path] {
        assert!(motion.cameras(&[], 5, true, intrinsics()).is_empty());
        assert!(motion.cameras(&cameras, 0, true, intrinsics()).is_empty());
    }
}

/// All pairwise distances of these would take hours.
#[test]
fn a_path_along_many_cameras_ends() {
    let count = 200_000_u32;
    // Unordered: an odd multiplier visits each position once.
    let place = |i: u32| (u64::from(i) * 77_773 % u64::from(count)) as f32 * 1e-3;
    let cameras: Vec<Camera> =
        (0..count).map(|i| vec3(0.0, 0.0, place(i))).map(|eye| look(eye, eye + Vec3::Z)).collect();
    for motion in [Motion::Path, Motion::Arc] {
        let way = motion.cameras(&cameras, 100, false, intrinsics());
        for pair in way.windows(2) {
            assert!(pair[0].position().distance(pair[1].position()) < 10.0, "a jump");
        }
        let ends = [way[0], way[99]].map(|camera| camera.position().z);
        assert!((ends[1] - ends[0]).abs() > 100.0, "{ends:?}");
    }
    assert_eq!(Motion::of(&cameras), Motion::Path);
    let ring = ring((0..count).map(|i| TAU * place(i) / 200.0));
    assert_eq!(Motion::of(&ring), Motion::Orbit);
    assert_eq!(Motion::Arc.cameras(&ring, 1000, false, intrinsics()).len(), 1000);
}

#[test]
fn curves_pass_through_their_keys() {
    let keys = ring([0.1, 0.9, 1.4].into_iter());
    let open = tour::through_keys(&keys, 9, false);
    assert_eq!([open[0], open[4], open[8]], [keys[0], keys[1], keys[2]]);
    let closed = tour::through_keys(&keys, 9, true);
    assert_eq!([closed[0], closed[3], closed[6]], [keys[0], keys[1], keys[2]]);
    for pair in open.windows(2) {
        pair[0].check().expect("sound");
        assert!(pair[0].position().distance(pair[1].position()) < 1.0);
    }
    assert_eq!(tour::through_keys(&keys[..1], 2, false), [keys[0]; 2]);
    assert_eq!(tour::through_keys(&keys, 1, false), [keys[0]]);
    assert!(tour::through_keys(&[], 4, true).is_empty());
}
