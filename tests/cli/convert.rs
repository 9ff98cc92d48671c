//! `ashsplat convert`, and other commands on its outputs.

use super::*;
use ashsplat_files::splats::{self, Format};
use tempfile::tempdir;

#[test]
fn converted_files_are_rendered_and_described() {
    let folder = tempdir().expect("a temporary folder");
    let place = |name: &str| folder.path().join(name);
    let mut gaussians = ashsplat_files::initial_gaussians(&wall_points(), 1).expect("Gaussians");
    gaussians.opacity_logits.fill(3.0);
    ashsplat_files::ply::write(place("in.ply"), &gaussians).expect("written");
    for format in Format::ALL {
        let out = place(&format!("out{}", format.extension()));
        let said = succeed(&["convert", text(&place("in.ply")), text(&out)]);
        assert!(said.contains(&format!("({format}, 400 Gaussians")), "{said}");
        let report = succeed(&["info", text(&out)]);
        assert!(
            report.contains(&format!("format     {format}")) && report.contains("Gaussians  400"),
            "{report}"
        );
        let pictures = place("pictures");
        let frames =
            ["render", text(&out), "--orbit", "1", "--width", "64", "--height", "48", "-o", text(&pictures)];
        assert!(succeed(&frames).contains("of 400 Gaussians visible"));
    }
    // Version 2 is packed with gzip, version 4 with zstd and its own header.
    for (version, begins) in [("2", [0x1f, 0x8b]), ("4", *b"NG")] {
        let spz = place("version.spz");
        succeed(&["convert", text(&place("in.ply")), text(&spz), "--spz-version", version]);
        assert!(std::fs::read(&spz).expect("a file").starts_with(&begins), "version {version}");
        assert!(succeed(&["info", text(&spz)]).contains("Gaussians  400"));
    }
    let moved = place("moved.spz");
    let actions =
        ["--rotate", "0,90,0", "--scale", "2", "--translate=-1,0,0", "--sh-degree", "0", "--decimate", "50%"];
    succeed(
        &[&["convert", text(&place("in.ply")), text(&moved), "--crop-box=-0.5,-2,-2,2,2,2"], &actions[..]]
            .concat(),
    );
    let read = splats::read(&moved, &Default::default()).expect("read").gaussians;
    assert_eq!((read.len(), read.sh_degree), (150, 0));
    // The wall was at z = 0; now its plane is x = -1, and z runs from -2 to 1.
    assert!(read.means.iter().all(|m| (m[0] + 1.0).abs() < 0.01 && (-2.01..1.1).contains(&m[2])));
}

/// A move applies to the input before it, and after the output to everything.
#[test]
fn files_are_joined_each_with_its_move() {
    let folder = tempdir().expect("a temporary folder");
    let place = |name: &str| text(&folder.path().join(name)).to_owned();
    let at = |x: f32| {
        let points = PointCloud { positions: vec![[x, 0.0, 0.0]], colors: vec![[90; 3]] };
        ashsplat_files::initial_gaussians(&points, 0).expect("a Gaussian")
    };
    let (a, b, c) = (place("a.ply"), place("b.ply"), place("c.ply"));
    ashsplat_files::ply::write(&a, &at(1.0)).expect("written");
    ashsplat_files::ply::write(&b, &at(2.0)).expect("written");
    for (arguments, expected) in [
        (&[&a[..], &b, &c][..], &[1.0, 2.0][..]),
        (&[&a, &b, "-o", &c], &[1.0, 2.0]),
        (&[&a, "--scale", "3", &b, "--translate=10,0,0", "--scale=2", &c], &[3.0, 14.0]),
        (&["-o", &c, &a, &b, "--scale", "3"], &[1.0, 6.0]),
        (&[&a, "--scale", "3", &b, &c, "--translate", "10,0,0"], &[13.0, 12.0]),
        (&[&a, &b, "--scale=2", "--out", &c, "--scale=2"], &[2.0, 8.0]),
        (&["--scale", "2", &a, &c, "--translate", "1,0,0"], &[3.0]),
    ] {
        succeed(&[&["convert"], arguments].concat());
        let means = splats::read(&c, &Default::default()).expect("read").gaussians.means;
        let x: Vec<f32> = means.iter().map(|mean| mean[0]).collect();
        assert_eq!(x, expected, "{arguments:?}");
        std::fs::remove_file(&c).expect("removed");
    }
    refuse(&["convert", "--scale", "2", &a, &b, &c], &["after the input that they move"]);
    refuse(&["convert", &a, "--scale=2", "--scale=3", &b, &c], &["--scale is given twice"]);
    refuse(&["convert", &a], &["OUT is missing"]);
    refuse(&["convert", &a, &b, &a], &["is the input itself"]);
}

#[test]
fn convert_refuses_in_one_line() {
    let folder = tempdir().expect("a temporary folder");
    let place = |name: &str| folder.path().join(name);
    std::fs::write(place("in.spz"), "no splats").expect("written");
    refuse(
        &["convert", text(&place("in.spz")), text(&place("out.ply"))],
        &["in.spz", "neither gzip nor an SPZ"],
    );
    refuse(&["convert", text(&place("none.ply")), text(&place("out.ply"))], &["none.ply", "No such file"]);
    refuse(&["convert", text(&place("in.spz")), text(&place("out.xyz"))], &["out.xyz", "known format"]);
    refuse(&["convert", "a.ply", "b.ply", "--scale", "0"], &["--scale", "positive"]);
    refuse(&["convert", "a.ply", "b.ply", "--crop-box", "1,2"], &["six numbers"]);
    assert!(!place("out.ply").exists());
    // Only the output file may be overwritten.
    let gaussians = ashsplat_files::initial_gaussians(&wall_points(), 0).expect("Gaussians");
    ashsplat_files::ply::write(place("in.ply"), &gaussians).expect("written");
    let before = std::fs::read(place("in.ply")).expect("a file");
    refuse(
        &["convert", text(&place("in.ply")), text(&place("in.ply")), "--decimate", "50%"],
        &["is the input itself"],
    );
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(place("in.ply"), place("link.ply")).expect("a link");
        refuse(
            &["convert", text(&place("link.ply")), text(&place("in.ply")), "--decimate", "50%"],
            &["is the input itself"],
        );
    }
    assert!(std::fs::read(place("in.ply")).expect("a file") == before);
    std::fs::write(place("scene.bin"), "another program's").expect("written");
    let (ply, gltf) = (place("in.ply"), place("scene.gltf"));
    let run = ["convert", text(&ply), text(&gltf)];
    succeed(&run);
    succeed(&run);
    assert_eq!(std::fs::read(place("scene.bin")).expect("a file"), b"another program's");
}

/// All commands give the same error, with the command that helps.
#[test]
fn scenes_of_other_programs_are_named() {
    let folder = tempdir().expect("a temporary folder");
    let place = |name: &str| folder.path().join(name);
    let write = |name: &str, bytes: &[u8]| {
        std::fs::create_dir_all(place(name).parent().expect("a folder")).expect("created");
        std::fs::write(place(name), bytes).expect("written");
    };
    let gaussians = ashsplat_files::initial_gaussians(&wall_points(), 0).expect("Gaussians");
    ashsplat_files::ply::write(place("in.ply"), &gaussians).expect("written");
    let ply = std::fs::read(place("in.ply")).expect("a file");
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    std::io::Write::write_all(&mut gzip, &ply).expect("packed");
    let gzip = gzip.finish().expect("packed");
    let meta = br#"{"version":2,"means":{"files":["means_l.webp","means_u.webp"]}}"#;
    archives::pack(&place("scene.sog"), [("meta.json".into(), &meta[..]), ("means_l.webp".into(), b"RIFF")]);
    archives::pack(
        &place("capture.zip"),
        [("notes.txt".into(), &b""[..]), ("a/point_cloud.ply".into(), &ply)],
    );
    archives::pack(&place("model.ckpt"), [("archive/data.pkl".into(), &b""[..])]);
    write("sog/meta.json", meta);
    write("streamed/lod-meta.json", br#"{"lodLevels":4}"#);
    write("foreign/tileset.json", br#"{"asset":{"version":"1.1"},"geometricError":9,"root":{}}"#);
    write("scene.ply.gz", &gzip);
    write("packed.ply", &gzip);
    write("scene.ply.zst", b"\x28\xb5\x2f\xfd....");
    write("scene.ksplat", &[0; 4096]);
    write("scene.spx", b"spx\x01....");
    let named = |name: &str| text(&place(name)).to_owned();
    for (name, words) in [
        (
            "scene.sog",
            &["is a SOG", &format!("`splat-transform {} {}`", named("scene.sog"), named("scene.ply"))][..],
        ),
        ("sog", &["is a SOG", "sog/meta.json", "splat-transform"]),
        ("sog/meta.json", &["is a SOG", "sog/meta.json", "splat-transform"]),
        ("streamed", &["is a streamed SOG", "splat-transform --select-lod 0"]),
        ("foreign", &["is no tree of Gaussians", "one .glb of it"]),
        ("foreign/tileset.json", &["is no tree of Gaussians", "one .glb of it"]),
        ("capture.zip", &["is a ZIP with a scene, a/point_cloud.ply", "`unzip "]),
        ("model.ckpt", &["is a checkpoint of PyTorch", "export a PLY"]),
        (
            "scene.ply.gz",
            &["packed with gzip", &format!("`gzip -dc {} > {}`", named("scene.ply.gz"), named("scene.ply"))],
        ),
        ("packed.ply", &["packed with gzip", "unpacked.ply`"]),
        ("scene.ply.zst", &["packed with zstd", "`zstd -dc "]),
        ("scene.ksplat", &["is a .ksplat", "`splat-transform "]),
        ("scene.spx", &["is an SPX scene", "`gsbox spx2ply -i "]),
    ] {
        let (path, out) = (named(name), named("out.ply"));
        let mut answers = Vec::new();
        for command in [
            &["info", &path][..],
            &["convert", &path, &out],
            &["render", &path, "-o", &named("pictures")],
            &["view", &path, "--port", "0"],
        ] {
            let run = finish(program().args(command));
            assert_refused(&run, words);
            answers.push(run.stderr);
        }
        answers.dedup();
        assert_eq!(answers.len(), 1, "{answers:?}");
    }
    // A data set with points is no such scene.
    archives::pack(&place("set.zip"), [("points.ply".into(), &ply[..]), ("images/a.jpg".into(), b"")]);
    assert!(!finish(program().args(["info", &named("set.zip")])).stderr.contains("ZIP with a scene"));
}

/// Limits of the system and of the command line are ordinary errors that name the file.
#[cfg(unix)]
#[test]
fn limits_of_files_and_memory_are_told() {
    let folder = tempdir().expect("a temporary folder");
    let place = |name: &str| folder.path().join(name);
    let gaussians = ashsplat_files::initial_gaussians(&wall_points(), 3).expect("Gaussians");
    ashsplat_files::ply::write(place("in.ply"), &gaussians).expect("written");
    // At most eight blocks of 512 or 1024 bytes.
    let mut shell = Command::new("sh");
    shell.args(["-c", "ulimit -f 8; exec \"$0\" \"$@\""]).arg(program().get_program());
    shell.args(["convert", text(&place("in.ply")), text(&place("out.ply"))]);
    assert_refused(&finish(&mut shell), &["out.ply: cannot write: File too large"]);
    assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 1);
    let words = ["in.ply: reading it needs ", " bytes of host memory, more than 1024 (--max-host-memory)"];
    refuse(&["info", text(&place("in.ply")), "--max-host-memory", "1K"], &["needs 94400 bytes"]);
    let (ply, data) = (place("in.ply"), place("data"));
    for command in [
        &["info", text(&ply)][..],
        &["render", text(&ply), "-o", text(&place("out"))],
        &["inspect", text(&ply), "--pixel", "0,0"],
        &["eval", text(&ply), "-s", text(&data)],
        &["view", text(&ply), "--port", "0"],
        &["convert", text(&ply), text(&place("out.splat")), "--decimate", "50%"],
        &["profile", "--scene", text(&ply)],
        &["bench", "render", "--scene", text(&ply)],
    ] {
        refuse(&[command, &["--max-host-memory", "1K"]].concat(), &words);
    }
    let (frames, one) = (place("frames"), place("one.ply"));
    std::fs::create_dir(&frames).expect("a folder");
    let point = PointCloud { positions: vec![[0.0; 3]], colors: vec![[9; 3]] };
    ashsplat_files::ply::write(&one, &ashsplat_files::initial_gaussians(&point, 0).expect("one"))
        .expect("written");
    for name in ["frames/transforms.json", "tileset.json", "blocks.json", "cameras.json"] {
        std::fs::write(place(name), " ".repeat(2000)).expect("written");
    }
    for (command, name) in [
        (&["info", text(&frames)][..], "transforms.json"),
        (&["info", text(&place("tileset.json"))], "tileset.json"),
        (&["blocks", text(&place("blocks.json"))], "blocks.json"),
        (&["render", text(&one), "--path", text(&place("cameras.json")), "-o", "out"], "cameras.json"),
    ] {
        let needed = format!("{name}: reading it needs 2000 bytes of host memory, more than 1024 (--max");
        refuse(&[command, &["--max-host-memory", "1K"]].concat(), &[&needed]);
    }
    super::write_dataset(&data);
    let model = place("model");
    for (command, word) in [
        (&["info", text(&data)][..], "01.png: reading it"),
        (&["train", "-s", text(&data), "-m", text(&model)], "keeping its 9 photos in memory"),
        (&["bench", "train", "--dataset", text(&data)], "keeping its 9 photos in memory"),
        (&["profile", "train-step", "--dataset", text(&data)], "keeping its 9 photos in memory"),
    ] {
        let run = finish(program().args(command).args(["--max-host-memory", "24K"]));
        // A discrete GPU trains on photographs in a file: half of the memory holds those that are read ahead.
        let read_ahead = &[
            "reading ahead (5 of",
            "more than 12288 (--photo-memory, or half of --max-memory or --max-host-memory)",
        ];
        let kept = &[word, "more than 24576 (--max-host-memory)"];
        let is_card = crate::common::context().description().kind != "CPU";
        assert_refused(&run, if is_card { read_ahead } else { kept });
    }
    assert!(!model.exists());
}

/// Single precision holds these positions exactly, at the origin and in UTM coordinates. Only the camera's transform
/// can differ.
#[test]
fn distant_and_tiny_scenes_look_as_others() {
    let folder = tempdir().expect("a temporary folder");
    let place = |name: &str| folder.path().join(name);
    let mut gaussians = ashsplat_files::initial_gaussians(&wall_points(), 0).expect("Gaussians");
    gaussians.opacity_logits.fill(2.0);
    for mean in &mut gaussians.means {
        *mean = mean.map(|v| (v * 8.0).round() / 2.0);
    }
    gaussians.log_scales.as_flattened_mut().fill(-1.0);
    let offset = [500_000.0, 5_000_000.0, 120.0];
    let picture = |name: &str, views: &[&str]| {
        let out = place("picture.png");
        let size = ["--width", "64", "--height", "48"];
        succeed(&[&["render", text(&place(name)), "-o", text(&out), "--quiet"], views, &size].concat());
        image::open(&out).expect("a picture").to_rgb8().into_raw()
    };
    let path = |name: &str, offset: [f64; 3]| {
        let position = [0.5 + offset[0], -0.25 + offset[1], -9.0 + offset[2]];
        let cameras = serde_json::json!([{
            "id": 0, "img_name": "a", "width": 64, "height": 48, "position": position, "fx": 60.0, "fy": 60.0,
            "rotation": [[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]],
        }]);
        std::fs::write(place(name), cameras.to_string()).expect("a path");
        text(&place(name)).to_owned()
    };
    ashsplat_files::ply::write(place("near.ply"), &gaussians).expect("written");
    let near = picture("near.ply", &["--path", &path("near.json", [0.0; 3])]);
    let orbit = ["--orbit", "1"];
    let around = picture("near.ply", &orbit);
    let alike = |a: &[u8], b: &[u8]| a.iter().zip(b).all(|(a, b)| a.abs_diff(*b) <= 1);
    assert!(near.iter().any(|v| *v > 99) && around.iter().any(|v| *v > 99));
    let mut far = gaussians.clone();
    for mean in &mut far.means {
        *mean = [0, 1, 2].map(|axis| (f64::from(mean[axis]) + offset[axis]) as f32);
    }
    ashsplat_files::ply::write(place("far.ply"), &far).expect("written");
    assert!(alike(&near, &picture("far.ply", &["--path", &path("far.json", offset)])));
    assert!(alike(&around, &picture("far.ply", &orbit)));
    for scale in ["0.01", "0.0001", "10000"] {
        succeed(&["convert", text(&place("near.ply")), text(&place("scaled.ply")), "--scale", scale]);
        assert!(alike(&around, &picture("scaled.ply", &orbit)), "{scale}");
    }
}
