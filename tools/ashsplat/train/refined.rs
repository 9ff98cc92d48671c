//! The folder `refined`: optimised cameras as data sets that this and other programs read, without photographs and points.

use ashsplat::Result;
use ashsplat::scene::{Camera, PointCloud, WorldFrame};
use ashsplat_files::cameras_json::NamedCamera;
use ashsplat_files::colmap::{self, ColmapCamera, ColmapImage};
use ashsplat_files::transforms::{lens_keys, opengl_rows};
use ashsplat_program::output;
use glam::DVec3;
use serde_json::{Value, json};
use std::path::Path;

/// Writes `sparse/0` and `transforms.json`. Returns those that are left out, because they cannot hold one of the lenses, or a rolling
/// shutter. `dataset` has the photographs.
pub fn write(
    folder: &Path,
    dataset: &Path,
    cameras: &[NamedCamera],
    frame: &WorldFrame,
) -> Result<Vec<&'static str>> {
    let mut left_out = Vec::new();
    let mut lenses: Vec<ColmapCamera> = Vec::new();
    let images = (1..).zip(cameras).map(|(id, NamedCamera { name, camera })| {
        let own = ColmapCamera::of(0, camera).ok().filter(|_| camera.shutter.is_none())?;
        let is_same = |lens: &ColmapCamera| ColmapCamera { id: 0, ..lens.clone() } == own;
        let place = lenses.iter().position(is_same).unwrap_or_else(|| {
            lenses.push(ColmapCamera { id: lenses.len() as u32 + 1, ..own });
            lenses.len() - 1
        });
        let mut image = ColmapImage::posed(id, lenses[place].id, name.clone(), camera);
        image.translation = (-(image.rotation() * source_of(frame, camera))).to_array();
        Some(image)
    });
    let images: Option<Vec<ColmapImage>> = images.collect();
    match images {
        Some(images) => {
            colmap::write(folder.join("sparse").join("0"), &lenses, &images, &PointCloud::default())?;
        }
        None => left_out.push("sparse/0"),
    }
    let frames = cameras.iter().map(|NamedCamera { name, camera }| {
        // Names of COLMAP's models are paths below the photographs' folder, others below the data set's.
        let is_whole = dataset.join(name).is_file();
        frame_of(&if is_whole { name.clone() } else { format!("images/{name}") }, camera, frame)
    });
    let frames: Option<Vec<Value>> = frames.collect();
    match frames {
        Some(frames) => output::write_json(&folder.join("transforms.json"), &json!({ "frames": frames }))?,
        None => left_out.push("transforms.json"),
    }
    Ok(left_out)
}

fn source_of(frame: &WorldFrame, camera: &Camera) -> DVec3 {
    frame.origin + frame.unit * camera.exact_position()
}

/// A frame of nerfstudio's `transforms.json`; None for lenses that it does not know.
fn frame_of(path: &str, camera: &Camera, world: &WorldFrame) -> Option<Value> {
    let (model, k, p) = lens_keys(camera)?;
    let pose = |time: f64| {
        let at = camera.at_time(time);
        json!(opengl_rows(at.camera_from_world.as_dmat3(), source_of(world, &at)))
    };
    let mut frame = json!({
        "file_path": path, "camera_model": model,
        "w": camera.width, "h": camera.height,
        "fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy,
        "k1": k[0], "k2": k[1], "k3": k[2], "k4": k[3], "p1": p[0], "p2": p[1],
        "transform_matrix": pose(-0.5),
    });
    if let Some(shutter) = camera.shutter {
        frame["transform_matrix_end"] = pose(0.5);
        frame["shutter"] = json!(shutter.readout.name());
    }
    Some(frame)
}
