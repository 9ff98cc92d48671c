//! Data sets in map coordinates and other units: they train as at the origin, and outputs have the coordinates of
//! their files.

use super::checkpoints::{Place, assert_trained};
use super::merge::{core, division, job, merge, partition};
use super::*;
use ashsplat::scene::WorldFrame;
use ashsplat::trainer::Checkpoint;
use ashsplat_files::splats::{self, ReadOptions};
use ashsplat_files::{CheckpointFile, cameras_json};
use glam::DVec3;

const UTM: DVec3 = DVec3::new(500_000.0, 5_000_000.0, 120.0);
const OPTIONS: [&str; 3] = ["--iterations", "12", "--eval"];

/// The data set of [`write_dataset`], scaled and then moved.
fn moved(scale: f64, offset: DVec3) -> Place {
    let place = Place::new();
    let sparse = place.model("data/sparse/0");
    let (mut images, mut points) = (String::new(), String::new());
    for id in 1..=VIEWS {
        let image = ColmapImage::posed(id, 1, format!("{id:02}.png"), &view(id - 1));
        // Offset from zero, where single precision is coarser than doubles at the offset.
        let translation = DVec3::from_array(image.translation.map(|v| (v * 1024.0).round() / 1024.0 + 0.01));
        let [x, y, z] = (scale * translation.as_vec3().as_dvec3() - image.rotation() * offset).to_array();
        let [qw, qx, qy, qz] = image.quat;
        images += &format!("{id} {qw} {qx} {qy} {qz} {x} {y} {z} 1 {}\n\n", image.name);
    }
    let PointCloud { positions, colors } = wall_points();
    for (id, (position, [r, g, b])) in positions.iter().zip(colors).enumerate() {
        let [x, y, z] = (scale * Vec3::from_array(*position).as_dvec3() + offset).to_array();
        points += &format!("{id} {x} {y} {z} {r} {g} {b} 0.5\n");
    }
    let Camera { fx, fy, cx, cy, width, height, .. } = view(0);
    let cameras = format!("1 PINHOLE {width} {height} {fx} {fy} {cx} {cy}\n");
    for (part, text) in [("cameras", cameras), ("images", images), ("points3D", points)] {
        std::fs::remove_file(sparse.join(format!("{part}.bin"))).expect("removed");
        std::fs::write(sparse.join(format!("{part}.txt")), text).expect("written");
    }
    place
}

/// Removes the comment with the origin from a PLY.
fn without_origin(ply: Vec<u8>) -> Vec<u8> {
    let comment = b"comment origin 500000 5000000 120\n";
    let at = ply.windows(comment.len()).position(|bytes| bytes == comment).expect("the origin");
    [&ply[..at], &ply[at + comment.len()..]].concat()
}

fn means(place: &Place, model: &str) -> (Vec<[f32; 3]>, Option<f64>) {
    let path = place.model(model).join("point_cloud/iteration_12/point_cloud.ply");
    let scene = splats::read(path, &ReadOptions::default()).expect("a PLY");
    (scene.gaussians.means, scene.header.unit)
}

#[test]
fn a_far_data_set_trains_to_the_bits_of_one_at_the_origin() {
    let (near, far) = (moved(1.0, DVec3::ZERO), moved(1.0, UTM));
    let run = near.train("model", &OPTIONS);
    assert_trained(&run);
    let run_far = far.train("model", &[&OPTIONS[..], &["--checkpoint-iterations", "6"]].concat());
    assert_trained(&run_far);
    assert!(!run.stdout.contains("origin") && run_far.stdout.contains("origin is 500000 5000000 120"));
    assert!(without_origin(far.ply("model", 12)) == near.ply("model", 12), "other bits");
    let input = |place: &Place| std::fs::read(place.model("model/input.ply")).expect("points");
    assert!(without_origin(input(&far)) == input(&near), "other points");
    // Other programs read cameras.json and point_cloud.ply together.
    let frame = WorldFrame { origin: UTM, unit: 1.0 };
    let cameras = |place: &Place, frame: &WorldFrame| {
        cameras_json::read(place.model("model/cameras.json"), frame).expect("cameras")
    };
    assert_eq!(cameras(&far, &frame), cameras(&near, &WorldFrame::default()));
    let measured = |place: &Place| {
        succeed(&["eval", text(&place.model("model")), "--quiet", "--json"]);
        let results = std::fs::read_to_string(place.model("model/results.json")).expect("results");
        serde_json::from_str::<serde_json::Value>(&results).expect("JSON")["ours_12"]["PSNR"].clone()
    };
    assert_eq!(measured(&far), measured(&near));
    // A scene for --init is moved into the data set's frame.
    let begun = |place: &Place| {
        let scene = place.model("model/point_cloud/iteration_12/point_cloud.ply");
        assert_trained(&place.train("init", &[&OPTIONS[..], &["--init", text(&scene)]].concat()));
        place.ply("init", 12)
    };
    assert!(without_origin(begun(&far)) == begun(&near), "other bits");

    // A training resumes in the checkpoint's frame, and not on a data set elsewhere.
    let checkpoint = far.model("model/chkpnt6.safetensors");
    assert_eq!(Checkpoint::read(&checkpoint).expect("a checkpoint").frame, frame);
    let start = [&OPTIONS[..], &["--start-checkpoint", text(&checkpoint)]].concat();
    assert_trained(&far.train("resumed", &start));
    assert!(far.ply("resumed", 12) == far.ply("model", 12), "other bits");
    assert_refused(&near.train("resumed", &start), &["chkpnt6", "other photographs or cameras"]);

    // A block in the data set's coordinates.
    let block = |x: f64| format!("--block=-inf,-inf,-inf,{x},inf,inf");
    assert_trained(&near.train("block", &[&OPTIONS[..], &[&block(-0.2)]].concat()));
    assert_trained(&far.train("block", &[&OPTIONS[..], &[&block(499_999.8)]].concat()));
    assert!(without_origin(far.ply("block", 12)) == near.ply("block", 12), "another block");
}

/// A scene that an editor saved without the origin would be out of view of all cameras. The model's cameras.json
/// restores the origin.
#[test]
fn an_origin_that_a_scene_has_lost_is_found_or_told() {
    let place = moved(1.0, UTM);
    assert_trained(&place.train("model", &OPTIONS));
    let ply = place.model("model/point_cloud/iteration_12/point_cloud.ply");
    let measured = || {
        let run = finish(program().args(["eval", text(&place.model("model")), "--quiet", "--json"]));
        assert_trained(&run);
        let results = std::fs::read_to_string(place.model("model/results.json")).expect("results");
        let results: serde_json::Value = serde_json::from_str(&results).expect("JSON");
        (results["ours_12"]["PSNR"].clone(), run.stderr)
    };
    let (whole, said) = measured();
    assert!(!said.contains("origin"), "{said}");
    let lost = without_origin(place.ply("model", 12));
    std::fs::write(&ply, &lost).expect("written");
    let (restored, said) = measured();
    assert_eq!(restored, whole);
    assert!(said.contains("names no origin 500000,5000000,120: ") && said.contains("cameras.json"), "{said}");
    // Outside the model folder the origin is lost.
    let scene = place.model("lost.ply");
    std::fs::write(&scene, &lost).expect("written");
    let begin = |scene: &Path| {
        let run = place.train("begun", &[&OPTIONS[..], &["--init", text(scene)]].concat());
        assert_trained(&run);
        run.stderr.contains("no photograph shows a Gaussian of it")
    };
    assert!(begin(&scene) && !begin(&ply));
}

#[test]
fn a_data_set_in_other_units_trains_alike() {
    let near = moved(1.0, DVec3::ZERO);
    assert_trained(&near.train("model", &OPTIONS));
    let (expected, unit) = means(&near, "model");
    assert_eq!(unit, None);
    for scale in [1e-4, 1e4] {
        let place = moved(scale, DVec3::ZERO);
        let margin = (0.3 * scale).to_string();
        assert_trained(&place.train("model", &OPTIONS));
        let (means, unit) = means(&place, "model");
        assert_eq!((means.len(), unit), (expected.len(), Some(scale)));
        // Distances in the units of the data set.
        let off = |(mean, expected): (&[f32; 3], &[f32; 3])| {
            Vec3::from_array(*mean).distance(scale as f32 * Vec3::from_array(*expected)) / scale as f32
        };
        assert!(means.iter().zip(&expected).map(off).fold(0.0, f32::max) < 1e-5);
        let block = |scale: f64| format!("--block=-inf,-inf,-inf,{},inf,inf", -0.5 * scale);
        let trained = |place: &Place, options: &[&str]| {
            assert_trained(&place.train("block", &[&OPTIONS[..], options].concat()));
            self::means(place, "block").0.len()
        };
        let there = trained(&place, &[&block(scale), "--margin", &margin]);
        assert_eq!(there, trained(&near, &[&block(1.0), "--margin", "0.3"]));
    }
}

#[test]
fn blocks_of_a_far_data_set_share_its_origin() {
    let (near, far) = (moved(1.0, DVec3::ZERO), moved(1.0, UTM));
    for place in [&near, &far] {
        assert_trained(&place.train("coarse", &["--iterations", "12", "--eval"]));
        assert_trained(&partition(place, "blocks.json", &["--max-gaussians", "300"]));
    }
    let (there, here) = (division(&near), division(&far));
    assert!(there["origin"].is_null());
    assert_eq!(here["origin"], serde_json::json!(UTM.to_array()));
    for (there, here) in
        there["blocks"].as_array().expect("blocks").iter().zip(here["blocks"].as_array().expect("blocks"))
    {
        let number = here["number"].as_u64().expect("a number") as u32;
        assert_eq!((&there["photos"], &there["trained"]), (&here["photos"], &here["trained"]));
        for axis in 0..3 {
            let sides = [there, here].map(|block| block["core"]["max"][axis].as_f64());
            let moved = sides[0].map(|side| side + UTM[axis]);
            assert!(moved.zip(sides[1]).is_none_or(|(a, b)| (a - b).abs() < 1e-6), "{sides:?}");
            assert_eq!(moved.is_some(), sides[1].is_some());
        }
        assert!(core(there) != core(here));
        [&near, &far].iter().for_each(|place| assert_trained(&job(place, number, &[])));
    }
    [&near, &far].iter().for_each(|place| assert_trained(&merge(place, "merged.ply")));
    let merged = |place: &Place| std::fs::read(place.model("merged.ply")).expect("a PLY");
    assert!(without_origin(merged(&far)) == merged(&near), "other bits");
}

#[test]
fn blocks_in_other_units_go_on_after_an_exchange() {
    let place = moved(1e4, DVec3::ZERO);
    assert_trained(&place.train("coarse", &["--iterations", "12", "--eval"]));
    assert_trained(&partition(&place, "blocks.json", &["--max-gaussians", "300", "--rounds", "2"]));
    let division = division(&place);
    assert_eq!(division["unit"], 1e4);
    let blocks = division["blocks"].as_array().expect("blocks").len() as u32;
    (1..=blocks).for_each(|number| assert_trained(&job(&place, number, &[])));
    assert_trained(&finish(program().args(["exchange", text(&place.model("blocks.json"))])));
    // The frozen neighbours equal the exchange's scene, to the bit.
    assert_trained(&job(&place, 1, &["--start-checkpoint", "auto"]));
}
