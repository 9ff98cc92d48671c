//! Other authors' crates beside ashsplat, in turn on the same machine: rows of the table in tools/measured.md. See README.md.
//!
//!     cargo run --release -- frame SCENE.ply FOLDER | ours SCENE.ply FOLDER | alike A.png B.png | camera

mod frame;
mod measure;

use ashsplat::glam::{Mat3, Quat, Vec3};
use ashsplat::scene::{Camera, Intrinsics};
use measure::Result;
use std::process::ExitCode;

const RUNS: usize = 15;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match run(&arguments.iter().map(String::as_str).collect::<Vec<_>>()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}

fn run(arguments: &[&str]) -> Result<()> {
    match arguments {
        ["frame", scene, folder] => frame::run(scene.as_ref(), &camera(), RUNS, folder.as_ref()),
        ["ours", scene, folder] => frame::ours(scene.as_ref(), &camera(), RUNS, folder.as_ref()),
        ["alike", a, b] => frame::alike(a.as_ref(), b.as_ref()),
        ["camera"] => Ok(println!("{}", for_playcanvas(&camera()))),
        _ => Err("frame SCENE.ply FOLDER, ours SCENE.ply FOLDER, alike A.png B.png, or camera".into()),
    }
}

/// A camera outside the trained scene, the same as in tests/ecosystem.
fn camera() -> Camera {
    let intrinsics = Intrinsics::from_fov_x(60f32.to_radians(), 1280, 720);
    Camera::look_at(Vec3::new(-0.4, -1.0, -4.5), Vec3::new(-0.4, 0.15, 0.2), Vec3::NEG_Y, intrinsics)
}

/// The camera in the form that tests/ecosystem/playcanvas.mjs reads.
fn for_playcanvas(camera: &Camera) -> serde_json::Value {
    let r = camera.camera_from_world;
    // From y up, z backward to the world.
    let world_from_camera = Mat3::from_cols(r.row(0), -r.row(1), -r.row(2));
    serde_json::json!({
        "width": camera.width,
        "height": camera.height,
        "fov_y_degrees": 2.0 * (0.5 * camera.height as f32 / camera.fy).atan().to_degrees(),
        "eye": camera.position().to_array(),
        "quat": Quat::from_mat3(&world_from_camera).to_array(),
        "reference_dilation": true,
        "still_frames": 2,
        "timed_frames": RUNS,
    })
}
