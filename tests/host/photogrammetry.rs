//! Cameras of Metashape and RealityScan.

use super::files::{Folder, assert_one, assert_says, assert_some, cloud, for_each_mutation, named};
use ashsplat::scene::{Camera, Intrinsics};
use ashsplat_files::{Dataset, DatasetOptions, Gallery, Progress};
use glam::{Mat3, Quat, Vec3};

/// The files below have this camera, in millimetres of a film whose longer side is 36 mm.
const INTRINSICS: Intrinsics = Intrinsics { fx: 20.0, fy: 20.0, cx: 10.5, cy: 5.75, width: 20, height: 12 };

fn cameras() -> Vec<Camera> {
    let camera = |index: u32| {
        let (sin, cos) = (index as f32 * 0.7).sin_cos();
        Camera::look_at(Vec3::new(3.0 * cos, 3.0 * sin, 1.0), Vec3::ZERO, Vec3::Z, INTRINSICS)
    };
    (0..4).map(camera).collect()
}

fn words<T: ToString>(values: impl IntoIterator<Item = T>) -> String {
    values.into_iter().map(|value| value.to_string()).collect::<Vec<_>>().join(" ")
}

fn rows(m: Mat3) -> [f32; 9] {
    m.transpose().to_cols_array()
}

/// Metashape's file of [`cameras`], whose chunk is turned, scaled and moved, and whose last camera has no pose.
fn metashape() -> String {
    let turn = Mat3::from_quat(Quat::from_axis_angle(Vec3::new(1.0, -2.0, 0.5).normalize(), 0.8));
    let (scale, moved) = (2.5, Vec3::new(10.0, -4.0, 3.0));
    let camera = |(index, camera): (usize, &Camera)| {
        let axes = turn.transpose() * camera.camera_from_world.transpose();
        let center = turn.transpose() * (camera.position() - moved) / scale;
        let row = |i: usize| words(axes.row(i).to_array().into_iter().chain([center[i]]));
        let pose = format!("<transform>{} {} {} 0 0 0 1</transform>", row(0), row(1), row(2));
        let pose = if index < 3 { pose } else { String::new() };
        format!("<camera id='{index}' sensor_id='5' component_id='1' label='{index:03}'>{pose}</camera>")
    };
    let cameras: String = cameras().iter().enumerate().map(camera).collect();
    format!(
        "<?xml version='1.0' encoding='UTF-8'?>\n<document version='2.0.0'><chunk label='Chunk 1' enabled='true'><sensors>\n\
         <sensor id='5' label='lens' type='frame'><resolution width='20' height='12'/>\
         <calibration type='frame' class='initial'><f>7</f></calibration>\
         <calibration type='frame' class='adjusted'><f>20</f><cx>0.5</cx><cy>-0.25</cy></calibration></sensor></sensors>\n\
         <components><component id='0'/><component id='1'><transform><rotation locked='true'>{}</rotation>\
         <translation>{}</translation><scale>{scale}</scale></transform></component></components>\n\
         <cameras><group>{cameras}</group></cameras></chunk></document>",
        words(rows(turn)),
        words(moved.to_array())
    )
}

/// A CSV with cameras that look down with the top to the north, down with the top to the east, and to the north.
const CSV: &str = "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2\n\
    000.png,1,2,3,0,0,0,20,0.025,-0.0125,0,0,0,0,0,0\n\
    001.png,4,2,3,90,0,0,20,0.025,-0.0125,0,0,0,0,0,0\n\
    002.png,1,5,3,0,90,0,20,0.025,-0.0125,0,0,0,0,0,0\n";

fn xmp(camera: &Camera) -> String {
    format!(
        "<x:xmpmeta xmlns:x='adobe:ns:meta/'><rdf:RDF xmlns:rdf='http://www.w3.org/1999/02/22-rdf-syntax-ns#'>\
         <rdf:Description xcr:Version='3' xcr:DistortionModel='brown3' xcr:FocalLength35mm='36' xcr:Skew='0' \
         xcr:AspectRatio='1' xcr:PrincipalPointU='0.025' xcr:PrincipalPointV='-0.0125' \
         xmlns:xcr='http://www.capturingreality.com/ns/xcr/1.1#'><xcr:Rotation>{}</xcr:Rotation>\
         <xcr:Position>{}</xcr:Position><xcr:DistortionCoeficients>0 0 0 0 0 0</xcr:DistortionCoeficients>\
         </rdf:Description></rdf:RDF></x:xmpmeta>",
        words(rows(camera.camera_from_world)),
        words(camera.position().to_array())
    )
}

fn with_photos() -> Folder {
    let folder = Folder::new();
    (0..4).for_each(|index| folder.photo(&format!("images/{index:03}.png"), index));
    folder
}

#[track_caller]
fn assert_cameras(dataset: &Dataset, expected: &[Camera]) {
    assert_eq!(dataset.train.len(), expected.len());
    for (view, camera) in dataset.train.iter().zip(expected) {
        let own = view.camera;
        assert!(own.position().distance(camera.position()) < 1e-4, "{own:?} {camera:?}");
        assert!(own.camera_from_world.abs_diff_eq(camera.camera_from_world, 1e-5), "{own:?} {camera:?}");
        let optics = |c: &Camera| Vec3::new(c.fx, c.cx, c.cy);
        assert!(optics(&own).distance(optics(camera)) < 1e-4, "{own:?} {camera:?}");
    }
}

#[test]
fn metashapes_cameras_are_placed_by_their_component() {
    let folder = with_photos();
    folder.put("project.xml", metashape());
    let points = cloud(&[[0.1, 0.2, 0.0]; 4], [1; 3]);
    folder.points("points3d.ply", &points);
    let report = folder.inspect(&DatasetOptions::default());
    assert!(report.is_sound(), "{report}");
    assert_some(&report.notes, &["project.xml: Metashape's cameras of 3 photos, with 1 sensors (frame)"]);
    assert_some(&report.warnings, &["project.xml: 1 of its 4 cameras have no pose and are not used"]);
    let dataset = folder.load();
    assert_cameras(&dataset, &cameras()[..3]);
    assert_eq!((named(&dataset.train), dataset.points), (vec!["000.png", "001.png", "002.png"], points));
    // Photos of another folder than the labels say are found by their names.
    folder.put("project.xml", metashape().replace("label='", "label='/home/me/images/"));
    assert_cameras(&folder.load(), &cameras()[..3]);
}

#[test]
fn realityscans_cameras_are_read_from_csv_and_xmp() {
    let folder = with_photos();
    folder.put("cameras.csv", CSV);
    let dataset = folder.load();
    assert_some(
        &folder.inspect(&DatasetOptions::default()).notes,
        &["cameras.csv: RealityScan's cameras of 3 photos"],
    );
    // Right, down and forward, and place of each camera.
    let poses = [
        ([Vec3::X, Vec3::NEG_Y, Vec3::NEG_Z], Vec3::new(1.0, 2.0, 3.0)),
        ([Vec3::NEG_Y, Vec3::NEG_X, Vec3::NEG_Z], Vec3::new(4.0, 2.0, 3.0)),
        ([Vec3::X, Vec3::NEG_Z, Vec3::Y], Vec3::new(1.0, 5.0, 3.0)),
    ];
    let camera = |([x, y, z], place): ([Vec3; 3], Vec3)| {
        let rotation = Mat3::from_cols(x, y, z).transpose();
        let focal = 20.0 * 20.0 / 36.0;
        Camera::with_pose(rotation, -(rotation * place), Intrinsics { fx: focal, fy: focal, ..INTRINSICS })
    };
    assert_cameras(&dataset, &poses.map(camera));
    folder.remove("cameras.csv");
    for (index, camera) in cameras().iter().enumerate() {
        folder.put(&format!("images/{index:03}.xmp"), xmp(camera));
    }
    folder.put("images/001.xmp", xmp(&cameras()[1]).replace("Rotation>", "Other>"));
    let report = folder.inspect(&DatasetOptions::default());
    assert_some(&report.notes, &["images: RealityScan's cameras of 3 photos, in XMP files"]);
    assert_some(&report.warnings, &["images: 1 of 4 XMP files have no pose"]);
    let all = cameras();
    assert_cameras(&folder.load(), &[all[0], all[2], all[3]]);
}

#[test]
fn unusable_files_have_one_clear_line() {
    let folder = with_photos();
    let adjusted = "<f>20</f>";
    let calibrated = |more: &str| metashape().replace(adjusted, &format!("{adjusted}{more}"));
    let of_kind = |kind: &str| {
        metashape().replace("type='frame' class='adjusted'", &format!("type='{kind}' class='adjusted'"))
    };
    let chunk = metashape()
        .split("<chunk")
        .nth(1)
        .map(|chunk| format!("<chunk{chunk}").replace("</document>", ""))
        .unwrap();
    let unposed = metashape().replace("transform", "other");
    for (text, words) in [
        (
            metashape().replace("</document>", &format!("{chunk}</document>")),
            "has 2 chunks, each in its own coordinates",
        ),
        ("<document/>".into(), "has no chunk"),
        (metashape().replace("</cameras>", ""), "is not XML"),
        (unposed.clone(), "4 of its 4 cameras have no pose"),
        (unposed.replace("component_id", "master_id"), "(4 are of rigs, placed by a master)"),
        (calibrated("<b2>0.5</b2>"), "sensor \"lens\" has b2"),
        (calibrated("<k1>much</k1>"), "sensor \"lens\" has a k1 that is not a number"),
        (calibrated("<k1>-3</k1>"), "folds the picture"),
        (of_kind("equisolid_fisheye"), "sensor \"lens\" is of type equisolid_fisheye"),
        (of_kind("spherical"), "is a panorama of 20x12 pixels, which is not 2:1"),
        (metashape().replace("sensor_id='5'", "sensor_id='6'"), "camera \"000\" has no sensor"),
        (metashape().replace(" 0 0 0 1</transform>", " 0 0 0</transform>"), "not of 16 numbers"),
        (metashape().replace("<transform>", "<transform>9"), "is no rotation"),
        (metashape().replace("<scale>", "<scale>-"), "transform of its component has a wrong scale"),
        (metashape().replace("label='001'", "label='000'"), "two photos are called \"000\""),
    ] {
        folder.put("cameras.xml", text);
        let message = folder.refusal();
        assert_says(&message, &["cameras.xml", words]);
        assert!(!message.contains('\n'), "{message}");
        assert_one(&folder.inspect(&DatasetOptions::default()).problems, &[words]);
    }
    folder.put("cameras.xml", metashape());
    folder.put("more.csv", CSV);
    assert_says(folder.refusal(), &["several files have cameras", "cameras.xml", "more.csv"]);
    folder.remove("cameras.xml");
    for (from, to, words) in [
        ("0,0,0,20,", "0,0,0,x,", "line 2: f is not a number"),
        ("000.png", "9.png", "has no photo \"9.png\""),
        (",0,0\n", ",0,0.1\n", "line 2: has tangential distortion"),
        ("001.png", "", "line 3: names no photo"),
        ("002.png", "001.png", "two photos are called \"001.png\""),
    ] {
        folder.put("more.csv", CSV.replace(from, to));
        assert_says(folder.refusal(), &[words]);
    }
    folder.remove("more.csv");
    for (from, to, words) in [
        ("brown3", "division", "has the distortion model \"division\""),
        ("Skew='0'", "Skew='1'", "has a skew"),
        ("<xcr:Position>", "<xcr:Position>x", "Position is not of 3 numbers"),
        ("Rotation>", "Other>", "1 XMP files beside the photos have no pose"),
    ] {
        folder.put("images/000.xmp", xmp(&cameras()[0]).replace(from, to));
        assert_says(folder.refusal(), &[words]);
    }
}

#[test]
fn no_mutation_of_their_files_panics() {
    for (name, text) in [
        ("cameras.xml", metashape()),
        ("cameras.csv", CSV.to_owned()),
        ("images/000.xmp", xmp(&cameras()[0])),
    ] {
        let folder = with_photos();
        let path = folder.put(name, &text);
        for_each_mutation(&path, text.as_bytes(), || {
            let opened = Gallery::open(&*folder, &DatasetOptions::default(), Progress::NONE);
            let message = opened.err().map_or_else(String::new, |error| error.to_string());
            assert!(!message.contains('\n'), "{message}");
        });
    }
}
