//! `mesh`: files, errors, the same bytes.

use super::*;
use crate::common::splats::disks;
use ashsplat_files::cameras_json;

const VIEWS: &str = "--orbit 12 --width 96 --height 96 --fov 40";

#[test]
fn meshes_are_written_whole_and_alike() {
    let place = TestFolder::empty();
    place.write_scene("ball.ply", &disks(Vec3::ZERO));
    let output = place.run(format!("mesh @ball.ply -o @new/ball.obj {VIEWS} --voxel 0.06")).ok().stdout;
    assert_says(&output, &["ball.obj: ", " triangles, ", "voxels of 0.06"]);
    let lines = std::fs::read_to_string(place.at("new/ball.obj")).expect("an OBJ");
    let numbers = |start: &str| -> Vec<Vec<f64>> {
        let lines = lines.lines().filter_map(|line| line.strip_prefix(start));
        lines.map(|line| line.split(' ').map(|word| word.parse().expect("a number")).collect()).collect()
    };
    let (vertices, triangles) = (numbers("v "), numbers("f "));
    assert!(vertices.len() > 1000 && triangles.len() > 2000, "{output}");
    for vertex in &vertices {
        let radius = vertex[..3].iter().map(|x| x * x).sum::<f64>().sqrt();
        assert!((radius - 1.0).abs() < 0.12 && vertex.len() == 6, "{vertex:?}");
    }
    assert!(triangles.iter().flatten().all(|&at| at >= 1.0 && at <= vertices.len() as f64));

    let ply = |name: &str| {
        place.run(format!("mesh @ball.ply -o @{name} {VIEWS} --voxel 0.06 --quiet")).ok();
        std::fs::read(place.at(name)).expect("a file")
    };
    let bytes = ply("ball.ply.ply");
    assert_eq!(bytes, ply("again.ply"), "the same bytes");
    let header = String::from_utf8_lossy(&bytes[..400]).into_owned();
    let counts = [format!("element vertex {}", vertices.len()), format!("element face {}", triangles.len())];
    assert_says(&header, &[&counts[0], &counts[1], "property list uchar int vertex_indices"]);
    let coarse =
        place.run(format!("mesh @ball.ply -o @coarse.ply {VIEWS} --voxel 0.06 --triangles 500")).ok().stdout;
    assert_says(&coarse, &["coarse.ply: 500 triangles, "]);
    let end = header.find("end_header\n").expect("its end") + "end_header\n".len();
    assert_eq!(bytes.len(), end + 15 * vertices.len() + 13 * triangles.len());

    let glb = ply("ball.glb");
    let word = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().expect("four bytes")) as usize;
    assert_eq!((&glb[..4], word(8)), (&b"glTF"[..], glb.len()));
    let document: Value = serde_json::from_slice(&glb[20..20 + word(12)]).expect("JSON");
    assert_eq!(document["accessors"][0]["count"], vertices.len());
    assert_eq!(document["accessors"][2]["count"], 3 * triangles.len());
    assert_eq!(document["buffers"][0]["byteLength"], 20 * vertices.len() + 12 * triangles.len());
    assert!(!place.files("").iter().any(|path| text(path).ends_with(".tmp")));
}

/// A scene far from the origin keeps its precision: positions are relative to the origin that the file names.
#[test]
fn meshes_have_the_scenes_origin() {
    let place = TestFolder::empty();
    place.write_scene("ball.ply", &disks(Vec3::ZERO));
    place.run("convert @ball.ply --translate 500000,4000000,100 -o @far.ply").ok();
    place.run(format!("mesh @far.ply -o @far.obj {VIEWS} --voxel 0.06 --quiet")).ok();
    let text = std::fs::read_to_string(place.at("far.obj")).expect("an OBJ");
    let origin: Vec<f64> = text
        .lines()
        .next()
        .and_then(|line| line.strip_prefix("# origin "))
        .expect("an origin")
        .split(' ')
        .map(|word| word.parse().expect("a number"))
        .collect();
    let first = vertices(&text)[0].as_dvec3().to_array();
    let from_center =
        [500_000.0, 4_000_000.0, 100.0].into_iter().zip(&origin).zip(&first).map(|((c, o), v)| o + v - c);
    let radius = from_center.map(|x| x * x).sum::<f64>().sqrt();
    assert!((radius - 1.0).abs() < 0.06, "{origin:?} {first:?}");
}

#[test]
fn meshes_that_cannot_be_made() {
    let place = TestFolder::empty();
    place.write_scene("ball.ply", &disks(Vec3::ZERO));
    place.write_scene("none.ply", &Gaussians::default());
    let refuses = |line: &str, words: &[&str]| {
        place.run(line).refused(words);
        assert!(!place.has("out"), "{line}");
    };
    refuses("mesh @ball.ply -o @out/a.stl --orbit 4", &["a.stl", ".ply, .obj or .glb"]);
    refuses("mesh @ball.ply -o @out/a.ply", &["ball.ply: has no cameras", "--orbit N"]);
    refuses(&format!("mesh @none.ply -o @out/a.ply {VIEWS}"), &["none.ply", "no surface"]);
    refuses(&format!("mesh @ball.ply -o @out/a.ply {VIEWS} --voxel 0"), &["--voxel", "positive"]);
    refuses(&format!("mesh @ball.ply -o @out/a.ply {VIEWS} --triangles 0"), &["--triangles", "not in 1"]);
    refuses(
        &format!("mesh @ball.ply -o @out/a.ply {VIEWS} --max-depth 0.5"),
        &["--max-depth", "lies beyond"],
    );
    let tight = format!("mesh @ball.ply -o @out/a.ply {VIEWS} --max-memory 100M --voxel 0.001");
    refuses(&tight, &["--voxel: 0.00100 makes more than ", "(--max-memory)", "try 0.00200"]);
    refuses(&format!("mesh @ball.ply -o @out/a.ply {VIEWS} --voxel 9"), &["ball.ply", "larger than a voxel"]);
    refuses("mesh @ball.ply -o @out/a.ply --orbit 2 --width 96", &["2 views are too few"]);
    place.run(format!("mesh @ball.ply -o @ball.ply {VIEWS}")).refused(&["--out", "ball.ply is read"]);
    let parallel = r#"[{"id": 0, "img_name": "a", "width": 96, "height": 96, "position": [0, 0, -4], "fx": 40, "fy": 40,
        "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "projection": "orthographic"}]"#;
    place.write("parallel.json", parallel);
    refuses("mesh @ball.ply -o @out/a.ply --path @parallel.json", &["only views with parallel rays"]);
}

/// Vertices of an OBJ.
fn vertices(text: &str) -> Vec<Vec3> {
    let vertex = |line: &str| {
        let mut numbers = line.split(' ').map(|word| word.parse().expect("a number"));
        Vec3::from_array(std::array::from_fn(|_| numbers.next().expect("a coordinate")))
    };
    text.lines().filter_map(|line| line.strip_prefix("v ")).map(vertex).collect()
}

/// A panorama orders Gaussians by distance, and so do the pinholes in its place.
#[test]
fn panoramas_are_meshed() {
    let place = TestFolder::empty();
    place.write_scene("ball.ply", &disks(Vec3::ZERO));
    let views = "--orbit 12 --width 512 --camera-model EQUIRECTANGULAR --voxel 0.06 --max-depth 10";
    let mesh = |name: &str, order: &str| {
        place.run(format!("mesh @ball.ply -o @{name} {views} {order} --quiet")).ok();
        place.read_text(name)
    };
    let ball = mesh("ball.obj", "");
    assert!(ball == mesh("ordered.obj", "--distance-order"), "the order of distances");
    let vertices = vertices(&ball);
    assert!(vertices.len() > 1000 && vertices.iter().all(|at| (at.length() - 1.0).abs() < 0.15));
}

/// A mask hides the right half of the ball, and counts in the views of a model as in those of the data set.
#[test]
fn masks_hide_what_is_not_meshed() {
    let place = TestFolder::new();
    place.write_scene("model/point_cloud/iteration_1/point_cloud.ply", &disks(Vec3::ZERO));
    place.write("model/cfg_args", format!("Namespace(source_path='{}')", place.at("data").display()));
    let named: Vec<(String, Camera)> =
        (0..super::VIEWS).map(|index| (photo_name(index), view(index))).collect();
    let named = named.iter().map(|(name, camera)| (name.as_str(), camera));
    cameras_json::write(place.at("model/cameras.json"), named, &WorldFrame::default()).expect("written");
    let mesh = |name: &str, views: &str| {
        let line = format!("mesh @model -o @{name} {views} --voxel 0.05");
        let finished = place.run(line).ok();
        let right = vertices(&place.read_text(name)).iter().map(|at| at.x).fold(f32::NEG_INFINITY, f32::max);
        (finished, right)
    };
    let (plain, right) = mesh("plain.obj", "");
    assert!(
        right > 0.45 && !plain.stdout.contains("mask") && plain.stderr.is_empty(),
        "{right}: {}",
        plain.stdout
    );
    for index in 0..super::VIEWS {
        let rgb = (0..SIZE[0] * SIZE[1]).flat_map(|at| [if at % SIZE[0] < SIZE[0] / 2 { 255 } else { 0 }; 3]);
        let mask = Photo { width: SIZE[0], height: SIZE[1], rgb: rgb.collect() };
        place.create_folder("data/masks");
        mask.write_png(place.at("data/masks").join(photo_name(index))).expect("a mask");
    }
    let (masked, right) = mesh("masked.obj", "");
    assert_says(&masked.stdout, &["masks of 9 photographs are applied"]);
    assert!(right < 0.25, "{right}");
    mesh("named.obj", "-s @data");
    assert_eq!(place.read("masked.obj"), place.read("named.obj"), "the same bytes");
    let cameras = place.read_text("model/cameras.json");
    place.write("model/cameras.json", cameras.replace(&photo_name(0), "unknown.png"));
    let (partly, _) = mesh("partly.obj", "-s @data");
    assert_says(&partly.stderr, &["no photograph for 1 of 9 views", "unknown.png"]);
    place.write("model/cameras.json", cameras);
    std::fs::rename(place.at("data"), place.at("gone")).expect("renamed");
    let (warned, right) = mesh("unmasked.obj", "");
    assert!(right > 0.45, "{right}");
    assert_says(&warned.stderr, &["data", "no mask is applied: name the data set with -s"]);
    place.create_folder("data");
    place.run("mesh @model -o @unread.obj").refused(&["data"]);
    assert!(!place.has("unread.obj"));
}

#[test]
fn normals_and_median_depths_are_rendered() {
    let place = TestFolder::empty();
    place.write_scene("ball.ply", &disks(Vec3::ZERO));
    place.run(format!("render @ball.ply -o @one {VIEWS} --normals --depth median --format exr --quiet")).ok();
    let exr = std::fs::read(place.at("one/00000.exr")).expect("an EXR");
    let header = String::from_utf8_lossy(&exr[..600]).into_owned();
    assert_says(&header, &["N.X", "N.Y", "N.Z"]);
    place
        .run("render @ball.ply -o @normals.png --orbit 1 --width 96 --height 96 --fov 40 --normals --quiet")
        .ok();
    let picture = place.picture("normals.png");
    // The middle of the ball faces the camera, which stands above it and looks down by 20 degrees: up is -y.
    let facing = picture.get_pixel(48, 48).0.map(|channel| f64::from(channel) / 127.5 - 1.0);
    let length = facing.iter().map(|x| x * x).sum::<f64>().sqrt();
    assert!((length - 1.0).abs() < 0.03 && (facing[1] + 20f64.to_radians().sin()).abs() < 0.1, "{facing:?}");
}
