//! Cameras: poses, sizes, checks, orbits.

use super::files::{Folder, assert_says, names, refusal};
use ashsplat::scene::{Camera, Intrinsics, Motion, Orbit, WorldFrame, scene_extent, strays};
use ashsplat_files::cameras_json;
use ashsplat_files::init::seen_box;
use glam::{DVec3, Vec3};

fn intrinsics() -> Intrinsics {
    Intrinsics { fx: 60.0, fy: 61.0, cx: 31.0, cy: 25.0, width: 64, height: 48 }
}

fn oblique() -> Camera {
    Camera::look_at(Vec3::new(3.0, -2.0, 1.0), Vec3::new(0.0, 0.5, 0.2), Vec3::NEG_Y, intrinsics())
}

#[test]
fn look_at_sees_its_target_upright() {
    let camera = oblique();
    camera.check().unwrap();
    let target = Vec3::new(0.0, 0.5, 0.2);
    let (x, y, depth) = camera.project(target);
    assert!((x - 31.0).abs() < 1e-3 && (y - 25.0).abs() < 1e-3);
    assert!((depth - camera.position().distance(target)).abs() < 1e-5);
    assert!(camera.position().abs_diff_eq(Vec3::new(3.0, -2.0, 1.0), 1e-5));
    // Up in the world is up in the picture (smaller y). The frame is right-handed, so nothing is mirrored.
    assert!(camera.project(target + 0.1 * Vec3::NEG_Y).1 < y);
    let to_the_right = camera.forward().cross(Vec3::NEG_Y);
    assert!(camera.project(target + 0.1 * to_the_right).0 > x);
    // Straight along the up axis.
    Camera::look_at(Vec3::ZERO, Vec3::Y, Vec3::NEG_Y, intrinsics()).check().unwrap();
    Camera::look_at(Vec3::ONE, Vec3::ONE, Vec3::Y, intrinsics()).check().unwrap();
}

#[test]
fn unusable_cameras_are_refused() {
    let damages: [fn(&mut Camera); 10] = [
        |c| c.width = 0,
        |c| c.height = 70_000,
        |c| c.fx = 0.0,
        |c| c.fy = -1.0,
        |c| c.fx = f32::NAN,
        |c| c.fy = f32::INFINITY,
        |c| c.cx = f32::NAN,
        |c| c.translation.y = f32::INFINITY,
        |c| c.camera_from_world *= 1.1,
        |c| c.camera_from_world.x_axis = -c.camera_from_world.x_axis,
    ];
    for (index, damage) in damages.iter().enumerate() {
        let mut camera = oblique();
        damage(&mut camera);
        let message = camera.check().expect_err(&index.to_string()).to_string();
        assert!(message.starts_with("camera: "), "{message}");
    }
    assert!(Camera::from_colmap([0.0; 4], [0.0; 3], intrinsics()).check().is_err());
}

/// A single camera far away does not decide the extent. A far block, a corridor and a wall of cameras do.
#[test]
fn strays_decide_nothing() {
    let camera = |eye: Vec3| Camera::look_at(eye, Vec3::ZERO, Vec3::NEG_Y, intrinsics());
    let ring: Vec<Vec3> = (0..40)
        .map(|i| f32::to_radians(9.0 * i as f32))
        .map(|angle| Vec3::new(4.0 * angle.cos(), -1.0, 4.0 * angle.sin()))
        .collect();
    let cameras = |eyes: &[Vec3]| eyes.iter().map(|&eye| camera(eye)).collect::<Vec<_>>();
    for (times, moved) in [(30.0, &[5][..]), (400.0, &[5]), (1e6, &[5, 6]), (50.0, &[0, 20, 21])] {
        let (mut with, mut without) = (ring.clone(), ring.clone());
        for &index in moved.iter().rev() {
            with[index] *= times;
            without.remove(index);
        }
        let found: Vec<usize> = (0..40).filter(|&index| strays(&with)[index].is_some()).collect();
        assert_eq!(found, moved);
        assert_eq!(scene_extent(with.iter().copied()), scene_extent(without.iter().copied()));
        let [with, without] = [with, without].map(|eyes| cameras(&eyes));
        assert_eq!(Orbit::around(&with, 8, intrinsics()), Orbit::around(&without, 8, intrinsics()));
        assert_eq!((Motion::of(&with), seen_box(&with)), (Motion::Orbit, seen_box(&without)));
    }
    let corridor: Vec<Vec3> = (0..60).map(|i| Vec3::new(i as f32, 0.0, 0.0)).collect();
    let wall: Vec<Vec3> = (0..9).map(|i| Vec3::new(0.1 * i as f32, 0.0, -5.0)).collect();
    let block = |at: f32| (0..100).map(move |i| Vec3::new(at + (i % 10) as f32, 0.0, (i / 10) as f32));
    let city: Vec<Vec3> = block(0.0).chain(block(1000.0).take(4)).collect();
    let halves: Vec<Vec3> = block(0.0).chain(block(1e4)).collect();
    let still: Vec<Vec3> = [Vec3::ZERO; 30].into_iter().chain(corridor[1..20].iter().copied()).collect();
    for eyes in [corridor, wall, city, halves, still, ring[..4].to_vec(), vec![Vec3::ZERO, Vec3::ONE]] {
        assert!(strays(&eyes).iter().all(Option::is_none), "{eyes:?}");
        let mean = eyes.iter().map(|eye| eye.as_dvec3()).sum::<DVec3>() / eyes.len() as f64;
        let largest = eyes.iter().map(|eye| eye.as_dvec3().distance(mean)).fold(0.0, f64::max);
        assert_eq!(scene_extent(eyes.iter().copied()), (1.1 * largest) as f32);
    }
    // One camera that looks away does not hide the others' target.
    let mut cameras = cameras(&ring);
    cameras[3] = Camera::look_at(ring[3], 2.0 * ring[3], Vec3::NEG_Y, intrinsics());
    assert!(seen_box(&cameras).is_some());
}

#[test]
fn an_orbit_is_a_circle_around_its_centre() {
    let orbit = Orbit {
        center: Vec3::new(1.0, 2.0, 3.0),
        up: Vec3::new(0.0, -2.0, 0.5),
        radius: 4.0,
        elevation: 0.4,
        count: 12,
        intrinsics: intrinsics(),
    };
    let cameras = orbit.cameras();
    assert_eq!(cameras.len(), 12);
    let up = orbit.up.normalize();
    for (camera, next) in cameras.iter().zip(cameras.iter().cycle().skip(1)) {
        camera.check().unwrap();
        let outward = camera.position() - orbit.center;
        assert!((outward.length() - 4.0).abs() < 1e-4);
        assert!((outward.dot(up) - 4.0 * 0.4f32.sin()).abs() < 1e-4);
        let (x, y, _) = camera.project(orbit.center);
        assert!((x - 31.0).abs() < 1e-2 && (y - 25.0).abs() < 1e-2);
        let step = 2.0 * 4.0 * 0.4f32.cos() * (std::f32::consts::PI / 12.0).sin();
        assert!((camera.position().distance(next.position()) - step).abs() < 1e-3);
    }
    let found = Orbit::around(&cameras, 5, intrinsics()).unwrap();
    assert!(found.center.abs_diff_eq(orbit.center, 1e-3), "{found:?}");
    assert!((found.radius - 4.0).abs() < 1e-3 && (found.elevation - 0.4).abs() < 1e-3);
    assert_eq!(Orbit::around(&[], 5, intrinsics()), None);
    let one = Orbit::around(&cameras[..1], 3, intrinsics()).unwrap();
    one.cameras().iter().for_each(|camera| camera.check().unwrap());
}

#[test]
fn cameras_json_has_the_names_of_the_reference_and_reads_back() {
    let (folder, path) = Folder::with("cameras.json");
    let camera = oblique();
    cameras_json::write(&path, [("a.png", &camera), ("b.png", &camera)], &WorldFrame::default()).unwrap();
    assert_eq!(names(&folder), ["cameras.json"]);
    let mut json: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    let entry = &json[1];
    assert_eq!((entry["id"].as_u64(), entry["img_name"].as_str()), (Some(1), Some("b.png")));
    assert_eq!((entry["width"].as_u64(), entry["height"].as_u64()), (Some(64), Some(48)));
    // Rows of the rotation from camera to world; the third column is the viewing direction.
    for axis in 0..3 {
        assert!((entry["rotation"][axis][2].as_f64().unwrap() as f32 - camera.forward()[axis]).abs() < 1e-6);
        assert!((entry["position"][axis].as_f64().unwrap() as f32 - camera.position()[axis]).abs() < 1e-6);
    }
    let read = || cameras_json::read(&path, &WorldFrame::default());
    let refused = || refusal(&path, read());
    let list = read().unwrap();
    assert_eq!(list[1].name, "b.png");
    assert!(list[1].camera.translation.abs_diff_eq(camera.translation, 1e-5));
    assert_eq!(list[1].camera.intrinsics(), camera.intrinsics());
    assert!(list[1].camera.camera_from_world.abs_diff_eq(camera.camera_from_world, 1e-6));

    // The reference's files have no principal point.
    json[0].as_object_mut().unwrap().retain(|key, _| key != "cx" && key != "cy");
    json[1]["fx"] = 0.into();
    let first = serde_json::Value::Array(vec![json[0].clone()]);
    std::fs::write(&path, first.to_string()).unwrap();
    assert_eq!(read().unwrap()[0].camera.cx, 32.0);
    std::fs::write(&path, json.to_string()).unwrap();
    assert_says(refused(), &["camera 1: focal length (0, 61)"]);
    std::fs::write(&path, "{}").unwrap();
    assert_says(refused(), &["is not a list of cameras"]);
}

/// Positions are those of the PLY beside the file: in source units from the named origin.
#[test]
fn cameras_json_keeps_the_origin() {
    let (_folder, path) = Folder::with("cameras.json");
    let parallel = oblique().orthographic();
    let origin = DVec3::new(500_000.0, 5_000_000.0, 120.0);
    let frame = WorldFrame { origin, unit: 0.01 };
    cameras_json::write(&path, [("a", &oblique()), ("b", &parallel)], &frame).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    assert_eq!(json[0]["origin"], serde_json::json!(origin.to_array()));
    let x = json[0]["position"][0].as_f64().unwrap();
    assert!((x - 0.01 * oblique().exact_position().x).abs() < 1e-9);
    let read = |frame: &WorldFrame| -> Vec<Camera> {
        cameras_json::read(&path, frame).unwrap().iter().map(|named| named.camera).collect()
    };
    let [pinhole, orthographic] = read(&frame)[..] else { panic!("two cameras") };
    assert!(pinhole.translation.abs_diff_eq(oblique().translation, 1e-6));
    assert!((orthographic.fx / parallel.fx - 1.0).abs() < 1e-6);
    // In another frame the camera has the same source position.
    let other = WorldFrame { origin: origin + DVec3::X, unit: 0.1 };
    let [pinhole, orthographic] = read(&other)[..] else { panic!("two cameras") };
    let expected = other.world(frame.source(oblique().position()));
    assert!(pinhole.position().abs_diff_eq(expected, 1e-5), "{} {expected}", pinhole.position());
    assert!((orthographic.fx / parallel.fx - 10.0).abs() < 1e-4);
}
