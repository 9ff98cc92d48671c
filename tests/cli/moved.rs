//! Data sets in map coordinates and other units: they train as at the origin, and outputs have the coordinates of
//! their files.

use super::merge::{core, list, number};
use super::*;
use ashsplat_files::cameras_json;
use glam::DVec3;

const UTM: DVec3 = DVec3::new(500_000.0, 5_000_000.0, 120.0);
const OPTIONS: &str = "--iterations 12 --eval";

/// The data set of [`write_dataset`], scaled and then moved.
fn moved(scale: f64, offset: DVec3) -> TestFolder {
    let place = TestFolder::new();
    let (mut lines, mut points) = (String::new(), String::new());
    for image in images() {
        // Offset from zero, where single precision is coarser than doubles at the offset.
        let translation = DVec3::from_array(image.translation.map(|v| (v * 1024.0).round() / 1024.0 + 0.01));
        let [x, y, z] = (scale * translation.as_vec3().as_dvec3() - image.rotation() * offset).to_array();
        let [qw, qx, qy, qz] = image.quat;
        lines += &format!("{} {qw} {qx} {qy} {qz} {x} {y} {z} 1 {}\n\n", image.id, image.name);
    }
    let PointCloud { positions, colors } = wall_points();
    for (id, (position, [r, g, b])) in positions.iter().zip(colors).enumerate() {
        let [x, y, z] = (scale * Vec3::from_array(*position).as_dvec3() + offset).to_array();
        points += &format!("{id} {x} {y} {z} {r} {g} {b} 0.5\n");
    }
    write_text_model(&place.at("data"), &lines, &points);
    place
}

/// A data set at the origin, and one in map coordinates.
fn near_and_far() -> [TestFolder; 2] {
    [DVec3::ZERO, UTM].map(|offset| moved(1.0, offset))
}

fn without_origin(ply: Vec<u8>) -> Vec<u8> {
    let comment = b"comment origin 500000 5000000 120\n";
    let at = ply.windows(comment.len()).position(|bytes| bytes == comment).expect("the origin");
    [&ply[..at], &ply[at + comment.len()..]].concat()
}

/// Evaluates the model. Returns its PSNR, and what is printed on stderr.
fn measured(place: &TestFolder) -> (Value, String) {
    let run = place.run("eval @model --quiet --json").ok();
    (place.read_json("model/results.json")["ours_12"]["PSNR"].clone(), run.stderr)
}

#[test]
fn a_far_data_set_trains_to_the_bits_of_one_at_the_origin() {
    let [near, far] = near_and_far();
    let run = near.train("model", OPTIONS);
    assert!(!run.stdout.contains("origin"), "{}", run.stdout);
    let with_checkpoint = format!("{OPTIONS} --checkpoint-iterations 6");
    far.train("model", with_checkpoint).says(&["origin is 500000 5000000 120"]);
    assert!(without_origin(far.ply("model", 12)) == near.ply("model", 12), "other bits");
    assert!(without_origin(far.read("model/input.ply")) == near.read("model/input.ply"), "other points");
    // Other programs read cameras.json and point_cloud.ply together.
    let frame = WorldFrame { origin: UTM, unit: 1.0 };
    let cameras = |place: &TestFolder, frame: &WorldFrame| {
        cameras_json::read(place.at("model/cameras.json"), frame).expect("cameras")
    };
    assert_eq!(cameras(&far, &frame), cameras(&near, &WorldFrame::default()));
    assert_eq!(measured(&far).0, measured(&near).0);
    // A scene for --init is moved into the data set's frame.
    let begun = |place: &TestFolder| {
        place.train("init", format!("{OPTIONS} --init @{}", point_cloud("model", 12)));
        place.ply("init", 12)
    };
    assert!(without_origin(begun(&far)) == begun(&near), "other bits");

    // A training resumes in the checkpoint's frame, and not on a data set elsewhere.
    let checkpoint = far.at("model/chkpnt6.safetensors");
    assert_eq!(Checkpoint::read(&checkpoint).expect("a checkpoint").frame, frame);
    let start = format!("{OPTIONS} --start-checkpoint {}", text(&checkpoint));
    far.train("resumed", &start);
    assert!(far.ply("resumed", 12) == far.ply("model", 12), "other bits");
    near.attempt("resumed", &start).refused(&["chkpnt6", "other photographs or cameras"]);

    // A block in the data set's coordinates.
    for (place, x) in [(&near, -0.2), (&far, 499_999.8)] {
        place.train("block", format!("{OPTIONS} --block=-inf,-inf,-inf,{x},inf,inf"));
    }
    assert!(without_origin(far.ply("block", 12)) == near.ply("block", 12), "another block");
}

/// A scene that an editor saved without the origin would be out of view of all cameras. The model's cameras.json
/// restores the origin.
#[test]
fn an_origin_that_a_scene_has_lost_is_found_or_told() {
    let place = moved(1.0, UTM);
    place.train("model", OPTIONS);
    let (whole, said) = measured(&place);
    assert!(!said.contains("origin"), "{said}");
    let lost = without_origin(place.ply("model", 12));
    place.write(point_cloud("model", 12), &lost);
    let (restored, said) = measured(&place);
    assert_eq!(restored, whole);
    assert_says(&said, &["names no origin 500000,5000000,120: ", "cameras.json"]);
    // Outside the model folder the origin is lost.
    place.write("lost.ply", &lost);
    let begin = |scene: &str| {
        let run = place.train("begun", format!("{OPTIONS} --init @{scene}"));
        run.stderr.contains("no photograph shows a Gaussian of it")
    };
    assert!(begin("lost.ply") && !begin(&point_cloud("model", 12)));
}

#[test]
fn a_data_set_in_other_units_trains_alike() {
    let scene = |place: &TestFolder, model: &str| {
        let path = place.at(point_cloud(model, 12));
        let scene = splats::read(path, &ReadOptions::default()).expect("a PLY");
        (scene.gaussians.means, scene.header.unit)
    };
    let near = moved(1.0, DVec3::ZERO);
    near.train("model", OPTIONS);
    let (expected, unit) = scene(&near, "model");
    assert_eq!(unit, None);
    let trained = |place: &TestFolder, scale: f64| {
        let block = format!("--block=-inf,-inf,-inf,{},inf,inf --margin {}", -0.5 * scale, 0.3 * scale);
        place.train("block", format!("{OPTIONS} {block}"));
        scene(place, "block").0.len()
    };
    let expected_block = trained(&near, 1.0);
    for scale in [1e-4, 1e4] {
        let place = moved(scale, DVec3::ZERO);
        place.train("model", OPTIONS);
        let (means, unit) = scene(&place, "model");
        assert_eq!((means.len(), unit), (expected.len(), Some(scale)));
        // Distances in the units of the data set.
        let off = |(mean, expected): (&[f32; 3], &[f32; 3])| {
            Vec3::from_array(*mean).distance(scale as f32 * Vec3::from_array(*expected)) / scale as f32
        };
        assert!(means.iter().zip(&expected).map(off).fold(0.0, f32::max) < 1e-5);
        assert_eq!(trained(&place, scale), expected_block);
    }
}

#[test]
fn blocks_of_a_far_data_set_share_its_origin() {
    let [near, far] = near_and_far();
    for place in [&near, &far] {
        place.train("coarse", OPTIONS);
        place.partition("blocks.json", "--max-gaussians 300").ok();
    }
    let (there, here) = (near.division(), far.division());
    assert_eq!(there["origin"], serde_json::json!(DVec3::ZERO.to_array()));
    assert_eq!(here["origin"], serde_json::json!(UTM.to_array()));
    for (there, here) in list(&there, "blocks").iter().zip(list(&here, "blocks")) {
        assert_eq!((&there["photos"], &there["trained"]), (&here["photos"], &here["trained"]));
        for axis in 0..3 {
            let sides = [there, here].map(|block| block["core"]["max"][axis].as_f64());
            let moved = sides[0].map(|side| side + UTM[axis]);
            assert!(moved.zip(sides[1]).is_none_or(|(a, b)| (a - b).abs() < 1e-6), "{sides:?}");
            assert_eq!(moved.is_some(), sides[1].is_some());
        }
        assert!(core(there) != core(here));
        for place in [&near, &far] {
            place.job(number(here, "number"), "").ok();
        }
    }
    for place in [&near, &far] {
        place.merge("merged.ply").ok();
    }
    assert!(without_origin(far.read("merged.ply")) == near.read("merged.ply"), "other bits");
}

#[test]
fn blocks_in_other_units_go_on_after_an_exchange() {
    let place = moved(1e4, DVec3::ZERO);
    place.train("coarse", OPTIONS);
    place.partition("blocks.json", "--max-gaussians 300 --rounds 2").ok();
    let division = place.division();
    assert_eq!(division["unit"], 1e4);
    for block in list(&division, "blocks") {
        place.job(number(block, "number"), "").ok();
    }
    place.run("exchange @blocks.json").ok();
    // The frozen neighbours equal the exchange's scene, to the bit.
    place.job(1, "--start-checkpoint auto").ok();
}
