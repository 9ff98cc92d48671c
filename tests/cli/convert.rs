//! `ashsplat convert`, and other commands on its outputs.

use super::*;
use ashsplat_files::splats::Format;

#[test]
fn converted_files_are_rendered_and_described() {
    let place = TestFolder::empty();
    let mut gaussians = wall(1);
    gaussians.opacity_logits.fill(3.0);
    place.write_scene("in.ply", &gaussians);
    for format in Format::WRITTEN {
        let out = format!("out{}", format.extension());
        let converted = format!("({format}, 400 Gaussians");
        place.run(format!("convert @in.ply @{out}")).ok().says(&[&converted]);
        let described = format!("format     {format}");
        place.run(format!("info @{out}")).ok().says(&[&described, "Gaussians  400"]);
        let render = format!("render @{out} --orbit 1 --width 64 --height 48 -o @pictures");
        place.run(render).ok().says(&["of 400 Gaussians visible"]);
    }
    // Versions 2 and 3 are packed with gzip, version 4 with zstd and its own header.
    for (version, begins) in [("2", [0x1f, 0x8b]), ("3", [0x1f, 0x8b]), ("4", *b"NG")] {
        place.run(format!("convert @in.ply @version.spz --spz-version {version}")).ok();
        assert!(place.read("version.spz").starts_with(&begins), "version {version}");
        place.run("info @version.spz").ok().says(&["Gaussians  400"]);
    }
    place
        .run(
            "convert @in.ply @moved.spz --crop-box=-0.5,-2,-2,2,2,2 --rotate 0,90,0 --scale 2 \
             --translate=-1,0,0 --sh-degree 0 --decimate 50%",
        )
        .ok();
    let read = place.gaussians("moved.spz");
    assert_eq!((read.len(), read.sh_degree), (150, 0));
    // The wall was at z = 0; now its plane is x = -1, and z runs from -2 to 1.
    assert!(read.means.iter().all(|m| (m[0] + 1.0).abs() < 0.01 && (-2.01..1.1).contains(&m[2])));
}

#[test]
fn formats_are_listed() {
    let place = TestFolder::empty();
    let listed = place.run("convert --list").ok().stdout;
    let lines: Vec<&str> = listed.lines().collect();
    assert_eq!(lines.len(), Format::ALL.len());
    for (line, format) in lines.iter().zip(Format::ALL) {
        assert!(line.starts_with(&format!("{}: read: ", format.extension())), "{line}");
    }
    assert!(listed.contains(
        "written: no; holds Gaussians, spherical harmonics; loses antialiasing, kernel size and order"
    ));
    assert!(lines[0].ends_with(
        "holds Gaussians, spherical harmonics, antialiasing, kernel size and order, the mark of 2DGS; loses nothing"
    ));
    place.run("convert").refused(&["IN... OUT"]);
}

/// A move applies to the input before it, and after the output to everything.
#[test]
fn files_are_joined_each_with_its_move() {
    let place = TestFolder::empty();
    for (file, x) in [("a.ply", 1.0), ("b.ply", 2.0)] {
        let point = PointCloud { positions: vec![[x, 0.0, 0.0]], colors: vec![[90; 3]] };
        place.write_scene(file, &ashsplat_files::initial_gaussians(&point, 0).expect("a Gaussian"));
    }
    for (arguments, expected) in [
        ("@a.ply @b.ply @c.ply", &[1.0, 2.0][..]),
        ("@a.ply @b.ply -o @c.ply", &[1.0, 2.0]),
        ("@a.ply --scale 3 @b.ply --translate=10,0,0 --scale=2 @c.ply", &[3.0, 14.0]),
        ("-o @c.ply @a.ply @b.ply --scale 3", &[1.0, 6.0]),
        ("@a.ply --scale 3 @b.ply @c.ply --translate 10,0,0", &[13.0, 12.0]),
        ("@a.ply @b.ply --scale=2 --out @c.ply --scale=2", &[2.0, 8.0]),
        ("--scale 2 @a.ply @c.ply --translate 1,0,0", &[3.0]),
    ] {
        place.run(format!("convert {arguments}")).ok();
        let x: Vec<f32> = place.gaussians("c.ply").means.iter().map(|mean| mean[0]).collect();
        assert_eq!(x, expected, "{arguments}");
        place.remove("c.ply");
    }
    for (arguments, words) in [
        ("--scale 2 @a.ply @b.ply @c.ply", "after the input that they move"),
        ("@a.ply --scale=2 --scale=3 @b.ply @c.ply", "--scale is given twice"),
        ("@a.ply", "OUT is missing"),
        ("@a.ply @b.ply @a.ply", "is the input itself"),
    ] {
        place.run(format!("convert {arguments}")).refused(&[words]);
    }
}

#[test]
fn convert_refuses_in_one_line() {
    let place = TestFolder::empty();
    place.write("in.spz", "no splats");
    place.write_scene("in.ply", &wall(0));
    let before = place.read("in.ply");
    for (arguments, words) in [
        ("@in.spz @out.ply", &["in.spz", "neither gzip nor an SPZ"][..]),
        ("@none.ply @out.ply", &["none.ply", "(os error 2)"]),
        ("@in.spz @out.xyz", &["out.xyz", "known format"]),
        ("a.ply b.ply --scale 0", &["--scale", "positive"]),
        ("a.ply b.ply --crop-box 1,2", &["six numbers"]),
        // Only the output file may be overwritten.
        ("@in.ply @in.ply --decimate 50%", &["is the input itself"]),
    ] {
        place.run(format!("convert {arguments}")).refused(words);
    }
    assert!(!place.has("out.ply"));
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(place.at("in.ply"), place.at("link.ply")).expect("a link");
        place.run("convert @link.ply @in.ply --decimate 50%").refused(&["is the input itself"]);
    }
    assert!(place.read("in.ply") == before);
    place.write("scene.bin", "another program's");
    for _ in 0..2 {
        place.run("convert @in.ply @scene.gltf").ok();
    }
    assert_eq!(place.read("scene.bin"), b"another program's");
}

/// All commands give the same error, with the command that helps.
#[test]
fn scenes_of_other_programs_are_named() {
    let place = TestFolder::empty();
    place.write_scene("in.ply", &wall(0));
    let ply = place.read("in.ply");
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    std::io::Write::write_all(&mut gzip, &ply).expect("packed");
    let gzip = gzip.finish().expect("packed");
    let meta = br#"{"version":2,"means":{"files":["means_l.webp","means_u.webp"]}}"#;
    let pack = |name: &str, files: &[(&str, &[u8])]| {
        data_sets::pack(&place.at(name), files.iter().map(|(name, bytes)| ((*name).to_owned(), *bytes)));
    };
    pack("capture.zip", &[("notes.txt", b""), ("a/point_cloud.ply", &ply)]);
    pack("model.ckpt", &[("archive/data.pkl", b"")]);
    pack("set.zip", &[("points.ply", &ply), ("images/a.jpg", b"")]);
    place.write("sog/scene.json", meta);
    place.write("foreign/tileset.json", br#"{"asset":{"version":"1.1"},"geometricError":9,"root":{}}"#);
    place.write("scene.ply.gz", &gzip);
    place.write("packed.ply", &gzip);
    place.write("scene.ply.zst", b"\x28\xb5\x2f\xfd....");
    place.write("scene.spx", b"spx\x01....");
    let named = |name: &str| text(&place.at(name)).to_owned();
    let unpack = format!("`gzip -dc {} > {}`", named("scene.ply.gz"), named("scene.ply"));
    for (name, words) in [
        ("sog/scene.json", &["describes a SOG under another name", "name it meta.json"][..]),
        ("foreign", &["is no tree of Gaussians", "one .glb of it"]),
        ("foreign/tileset.json", &["is no tree of Gaussians", "one .glb of it"]),
        ("capture.zip", &["is a ZIP with a scene, a/point_cloud.ply", "`unzip "]),
        ("model.ckpt", &["is a checkpoint of PyTorch", "export a PLY"]),
        ("scene.ply.gz", &["packed with gzip", &unpack]),
        ("packed.ply", &["packed with gzip", "unpacked.ply`"]),
        ("scene.ply.zst", &["packed with zstd", "`zstd -dc "]),
        ("scene.spx", &["is an SPX scene", "`gsbox spx2ply -i "]),
    ] {
        place.run(format!("info @{name}")).refused(words);
    }
    let lines = ["info SCENE", "convert SCENE @out.ply", "render SCENE -o @pictures", "view SCENE --port 0"]
        .map(|line| place.run(line.replace("SCENE", "@scene.spx")).refused(&["is an SPX scene"]).stderr);
    assert!(lines.iter().all(|line| *line == lines[0]), "{lines:?}");
    // A data set with points is no such scene.
    assert!(!place.run("info @set.zip").stderr.contains("ZIP with a scene"));
}

/// Limits of the system and of the command line are ordinary errors that name the file.
#[test]
#[cfg(unix)]
fn limits_of_files_and_memory_are_told() {
    let place = TestFolder::empty();
    place.write_scene("in.ply", &wall(3));
    // At most eight blocks of 512 or 1024 bytes.
    let mut shell = Command::new("sh");
    shell.args(["-c", "ulimit -f 8; exec \"$0\" \"$@\""]).arg(program().get_program());
    shell.args(place.words("convert @in.ply @out.ply"));
    finish(&mut shell).refused(&["out.ply: cannot write: File too large"]);
    assert_eq!(std::fs::read_dir(place.at("")).expect("a folder").count(), 1);
    place.run("info @in.ply --max-host-memory 1K").refused(&["needs 94400 bytes"]);
    for command in [
        "info @in.ply",
        "render @in.ply -o @out",
        "inspect @in.ply --pixel 0,0",
        "eval @in.ply -s @data",
        "view @in.ply --port 0",
        "convert @in.ply @out.splat --decimate 50%",
        "profile --scene @in.ply",
        "bench render --scene @in.ply",
    ] {
        let words =
            ["in.ply: reading it needs ", " bytes of host memory, more than 1024 (--max-host-memory)"];
        place.run(format!("{command} --max-host-memory 1K")).refused(&words);
    }
    let point = PointCloud { positions: vec![[0.0; 3]], colors: vec![[9; 3]] };
    place.write_scene("one.ply", &ashsplat_files::initial_gaussians(&point, 0).expect("one"));
    for (command, folder, name) in [
        ("info @frames", "frames/", "transforms.json"),
        ("info @tileset.json", "", "tileset.json"),
        ("blocks @blocks.json", "", "blocks.json"),
        ("render @one.ply --path @cameras.json -o out", "", "cameras.json"),
    ] {
        place.write(format!("{folder}{name}"), " ".repeat(2000));
        let needed = format!("{name}: reading it needs 2000 bytes of host memory, more than 1024 (--max");
        place.run(format!("{command} --max-host-memory 1K")).refused(&[&needed]);
    }
    write_dataset(&place.at("data"));
    for (command, word) in [
        ("info @data", "01.png: reading it"),
        ("bench train --dataset @data", "keeping its 9 photos in memory"),
        ("profile train-step --dataset @data", "keeping its 9 photos in memory"),
    ] {
        let words = [word, "more than 26624 (--max-host-memory)"];
        place.run(format!("{command} --max-host-memory 26K")).refused(&words);
    }
    // Training keeps photographs in a file: half of the memory holds those that are read ahead.
    place.run("train -s @data -m @model --max-host-memory 26K").refused(&[
        "reading ahead (4 of",
        "more than 13312 (--photo-memory, or half of --max-memory or --max-host-memory)",
    ]);
    assert!(!place.has("model"));
}

/// Single precision holds these positions exactly, at the origin and in UTM coordinates. Only the camera's transform
/// can differ.
#[test]
fn distant_and_tiny_scenes_look_as_others() {
    let place = TestFolder::empty();
    let mut near = wall(0);
    near.opacity_logits.fill(2.0);
    for mean in &mut near.means {
        *mean = mean.map(|v| (v * 8.0).round() / 2.0);
    }
    near.log_scales.as_flattened_mut().fill(-1.0);
    let offset = [500_000.0, 5_000_000.0, 120.0];
    let mut far = near.clone();
    for mean in &mut far.means {
        *mean = [0, 1, 2].map(|axis| (f64::from(mean[axis]) + offset[axis]) as f32);
    }
    for (name, scene, offset) in [("near", &near, [0.0; 3]), ("far", &far, offset)] {
        place.write_scene(format!("{name}.ply"), scene);
        let position = [0.5 + offset[0], -0.25 + offset[1], -9.0 + offset[2]];
        let cameras = serde_json::json!([{
            "id": 0, "img_name": "a", "width": 64, "height": 48, "position": position, "fx": 60.0, "fy": 60.0,
            "rotation": [[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]],
        }]);
        place.write(format!("{name}.json"), cameras.to_string());
    }
    let picture = |scene: &str, views: &str| {
        let size = "--width 64 --height 48";
        place.run(format!("render @{scene} -o @picture.png --quiet {views} {size}")).ok();
        place.picture("picture.png").into_raw()
    };
    let around = picture("near.ply", "--orbit 1");
    let from_near = picture("near.ply", "--path @near.json");
    let alike = |a: &[u8], b: &[u8]| a.iter().zip(b).all(|(a, b)| a.abs_diff(*b) <= 1);
    assert!(from_near.iter().any(|v| *v > 99) && around.iter().any(|v| *v > 99));
    assert!(alike(&from_near, &picture("far.ply", "--path @far.json")));
    assert!(alike(&around, &picture("far.ply", "--orbit 1")));
    for scale in ["0.01", "0.0001", "10000"] {
        place.run(format!("convert @near.ply @scaled.ply --scale {scale}")).ok();
        assert!(alike(&around, &picture("scaled.ply", "--orbit 1")), "{scale}");
    }
}
