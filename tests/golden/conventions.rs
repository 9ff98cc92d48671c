//! Lenses as other programs' files have them, against positions by these programs' formulas.

use super::Outcome;
use crate::common::prelude::*;
use crate::golden::npz::Npz;
use ashsplat_files::photogrammetry::{self, Source};
use ashsplat_files::transforms::Transforms;
use glam::DVec2;
use std::path::Path;

pub fn of_files(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let [width, height] = [0, 1].map(|axis| npz.values("size_wh")[axis] as u32);
    let folder = tempfile::tempdir().expect("a folder");
    for kind in ["frame", "fisheye"] {
        let names = ["f", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2", "b1", "b2"];
        let values = npz.values(&format!("metashape_{kind}_params"));
        let lens: String =
            names.iter().zip(values).map(|(name, v)| format!("<{name}>{v}</{name}>")).collect();
        let file = folder.path().join("cameras.xml");
        let text = format!(
            "<document><chunk><sensors><sensor id='0'><resolution width='{width}' height='{height}'/>\
             <calibration type='{kind}' class='adjusted'>{lens}</calibration></sensor></sensors><cameras>\
             <camera id='0' sensor_id='0' label='a'><transform>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</transform></camera>\
             </cameras></chunk></document>"
        );
        std::fs::write(&file, text).expect("written");
        let model = photogrammetry::read(&Source::Metashape(file), folder.path(), &mut |_| unreachable!())
            .expect("read");
        let camera = &model.cameras[&0];
        let lens = model.lens(camera).expect("a lens");
        check(&npz, &format!("metashape_{kind}"), |at| lens.project(at))?;
    }
    for (kind, model) in [("opencv", "OPENCV"), ("fisheye", "OPENCV_FISHEYE")] {
        let names = ["fl_x", "fl_y", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2"];
        let values = npz.values(&format!("nerfstudio_{kind}_params"));
        let lens: String = names.iter().zip(values).map(|(name, v)| format!("\"{name}\": {v}, ")).collect();
        let file = folder.path().join("transforms.json");
        let text = format!(
            "{{{lens}\"w\": {width}, \"h\": {height}, \"camera_model\": \"{model}\", \"frames\": [{{\"file_path\": \"a.png\", \
             \"transform_matrix\": [[1,0,0,0],[0,1,0,0],[0,0,1,0]]}}]}}"
        );
        std::fs::write(&file, text).expect("written");
        let lens = Transforms::read(&[file]).expect("read").frames[0].optics.lens(width, height);
        check(&npz, &format!("nerfstudio_{kind}"), |at| lens.project(at))?;
    }
    Ok(())
}

/// Compares the positions of all points that `project` shows.
fn check(npz: &Npz, set: &str, project: impl Fn(glam::DVec3) -> Option<DVec2>) -> Outcome {
    let expected = npz.rows::<2>(&format!("{set}_xy"));
    let mut shown = 0;
    for (index, (point, expected)) in npz.rows::<3>("points").iter().zip(expected).enumerate() {
        let Some(at) = project(glam::DVec3::from_array(*point)) else { continue };
        let at = at - 0.5;
        let tolerance = 4e-6 * (50.0 + at.abs().max_element());
        elementwise(&format!("{set}, point {index}"), &at.to_array(), &expected, tolerance, 0.0)?;
        shown += 1;
    }
    if shown < 10 { Err(format!("{set}: only {shown} points are compared").into()) } else { Ok(()) }
}
