//! All formats of Gaussians: round trips within each format's quantisation, layouts, damage.

use std::path::Path;

use ashsplat::scene::{Bounds, Camera, Cells, Cut, Gaussians, Intrinsics, Similarity, WorldFrame};
use ashsplat_files::splats::{self, ConvertOptions, Format, ReadOptions, Target, WriteOptions};
use glam::{DQuat, DVec3, Vec3};
use serde_json::{Value, json};

use crate::common::splats::{Tolerance, assert_close, in_order_of, scene, tolerance};

use super::files::{for_each_mutation, for_each_truncation, names};

const KEEP: ReadOptions = ReadOptions { drop_invalid: false, max_host_memory: None };
const DROP: ReadOptions = ReadOptions { drop_invalid: true, max_host_memory: None };

#[test]
fn every_format_reads_what_it_writes() {
    let folder = tempfile::tempdir().unwrap();
    for format in Format::ALL {
        for (count, degree) in [(1, 0), (300, 0), (300, 1), (700, 2), (1000, 3)] {
            let degree = degree.min(format.max_sh_degree());
            let antialiased = degree % 2 == 1 && format.keeps_antialiased();
            let path = folder.path().join(format!("scene{}", format.extension()));
            let expected = scene(count, degree);
            splats::write(&path, &expected, &WriteOptions { antialiased, ..Default::default() }).unwrap();
            let read = splats::read(&path, &KEEP).unwrap();
            assert_eq!((read.header.format, read.header.antialiased, read.dropped), (format, antialiased, 0));
            assert!(read.warnings.is_empty(), "{:?}", read.warnings);
            let actual = match format {
                Format::CompressedPly => in_order_of(&expected, &read.gaussians),
                _ => read.gaussians,
            };
            assert_close(&actual, &expected, &tolerance(format));
        }
    }
    // One `.bin` beside the `.gltf`, and no temporary files.
    assert_eq!(names(folder.path()).len(), Format::ALL.len() + 1);
}

/// Reading and writing a quantised file again changes no value.
#[test]
fn a_second_round_trip_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    for format in [Format::Splat, Format::Spz, Format::Glb, Format::Ply] {
        let path = folder.path().join(format!("scene{}", format.extension()));
        let write = |gaussians: &Gaussians| {
            splats::write(&path, gaussians, &WriteOptions::default()).unwrap();
            splats::read(&path, &KEEP).unwrap().gaussians
        };
        let first = write(&scene(400, format.max_sh_degree()));
        let second = write(&first);
        let drift =
            Tolerance { mean: 0.0, log_scale: 1e-6, opacity: 1e-6, rotation: 2e-5, color: 1e-5, sh: 0.0 };
        assert_close(&second, &first, &drift);
    }
}

#[test]
fn empty_scenes_and_blocks_of_every_size() {
    let folder = tempfile::tempdir().unwrap();
    for format in [Format::Ply, Format::CompressedPly, Format::Spz] {
        let path = folder.path().join(format!("none{}", format.extension()));
        splats::write(&path, &Gaussians { sh_degree: 2, ..Default::default() }, &WriteOptions::default())
            .unwrap();
        assert_eq!(splats::read(&path, &KEEP).unwrap().gaussians.len(), 0, "{format}");
    }
    let path = folder.path().join("none.glb");
    let error = splats::write(&path, &Gaussians::default(), &WriteOptions::default()).unwrap_err();
    assert!(error.to_string().contains("cannot hold a scene without"), "{error}");
    for count in [16_383, 16_384, 16_385, 40_000] {
        let expected = scene(count, 0);
        for format in [Format::Ply, Format::Splat, Format::Spz, Format::Gltf] {
            let path = folder.path().join(format!("many{}", format.extension()));
            splats::write(&path, &expected, &WriteOptions::default()).unwrap();
            assert_close(&splats::read(&path, &KEEP).unwrap().gaussians, &expected, &tolerance(format));
        }
    }
}

#[test]
fn conversions_keep_what_both_formats_hold() {
    let folder = tempfile::tempdir().unwrap();
    let file = |format: Format| folder.path().join(format!("scene{}", format.extension()));
    let expected = scene(500, 3);
    let options = WriteOptions { antialiased: true, ..Default::default() };
    for from in Format::ALL {
        let written = expected.with_sh_degree(from.max_sh_degree());
        splats::write(file(from), &written, &options).unwrap();
        let original = splats::read(file(from), &KEEP).unwrap().gaussians;
        for to in Format::ALL {
            let output = folder.path().join(format!("out{}", to.extension()));
            let done = splats::convert(&file(from), &output, &ConvertOptions::default()).unwrap();
            let degree = from.max_sh_degree().min(to.max_sh_degree());
            assert_eq!((done.written, done.sh_degree, done.format), (500, degree, to));
            let lost = from.max_sh_degree() > degree;
            let antialiased = from.keeps_antialiased() && to.keeps_antialiased();
            let warnings = usize::from(lost) + usize::from(from.keeps_antialiased() && !antialiased);
            assert_eq!(done.warnings.len(), warnings, "{from} to {to}: {:?}", done.warnings);
            let read = splats::read(&output, &KEEP).unwrap();
            assert_eq!(read.header.antialiased, antialiased, "{from} to {to}");
            let original = original.with_sh_degree(degree);
            let actual = match to {
                Format::CompressedPly => in_order_of(&original, &read.gaussians),
                _ => read.gaussians,
            };
            assert_close(&actual, &original, &tolerance(to));
        }
    }
}

#[test]
fn changes_on_the_way() {
    let folder = tempfile::tempdir().unwrap();
    let (input, output) = (folder.path().join("in.ply"), folder.path().join("out.ply"));
    let original = scene(3000, 3);
    splats::write(&input, &original, &WriteOptions::default()).unwrap();
    let bounds = Bounds { min: Vec3::new(-5.0, -8.0, -9.0), max: Vec3::new(5.0, 8.0, 1.0) };
    let similarity = Similarity {
        rotation: DQuat::from_rotation_y(0.5),
        scale: 3.0,
        translation: DVec3::new(0.0, 1.0, 2.0),
    };
    let options = ConvertOptions {
        sh_degree: Some(1),
        cut: Cut { min_opacity: 0.5, bounds: Some(bounds), min_density: 0.3 },
        similarity,
        ..Default::default()
    };
    let done = splats::convert(&input, &output, &options).unwrap();
    let mut expected = original.with_sh_degree(1);
    expected.retain(|all, i| {
        let mean = Vec3::from_array(all.means[i]);
        let largest = all.log_scales[i].into_iter().fold(f32::MIN, f32::max).exp();
        let opacity = all.opacity(i);
        let dense = opacity / (1.0 - opacity) / largest >= 0.3;
        opacity >= 0.5 && dense && mean.cmpge(bounds.min).all() && mean.cmple(bounds.max).all()
    });
    expected.transform(&similarity);
    assert!(expected.len() > 100 && expected.len() < 1500);
    assert_eq!(done.written, expected.len() as u64);
    assert!(splats::read(&output, &KEEP).unwrap().gaussians == expected);
    let options = ConvertOptions { decimate: Some(Target::Share(0.25)), ..Default::default() };
    assert_eq!(splats::convert(&input, &output, &options).unwrap().written, 750);
    let nothing =
        ConvertOptions { cut: Cut { min_opacity: 1.0, ..Default::default() }, ..Default::default() };
    let done = splats::convert(&input, &output, &nothing).unwrap();
    assert_eq!((done.written, done.warnings.len()), (0, 1));
}

/// Cuts from memory and from a file give the same bytes.
#[test]
fn a_cut_scene_is_written_as_a_conversion_writes_it() {
    let folder = tempfile::tempdir().unwrap();
    let original = scene(40_000, 3);
    let input = folder.path().join("in.ply");
    splats::write(&input, &original, &WriteOptions { antialiased: true, ..Default::default() }).unwrap();
    let bounds =
        Some(Bounds { min: Vec3::splat(f32::NEG_INFINITY), max: Vec3::new(4.0, f32::INFINITY, 6.0) });
    let cut = Cut { min_opacity: 0.2, bounds, min_density: 0.3 };
    for format in Format::ALL {
        let [converted, written] = ["converted", "written"]
            .map(|name| folder.path().join(name).join(format!("scene{}", format.extension())));
        for path in [&converted, &written] {
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        }
        let options = ConvertOptions { sh_degree: Some(2), cut, ..Default::default() };
        let done = splats::convert(&input, &converted, &options).unwrap();
        let antialiased = WriteOptions { antialiased: true, ..Default::default() };
        let (count, _) = splats::write_cut(&written, &original, (&cut, 2), &antialiased).unwrap();
        assert!(count > 1000 && count < 39_000 && count == done.written, "{format}: {count}");
        assert!(std::fs::read(&converted).unwrap() == std::fs::read(&written).unwrap(), "{format}");
    }
    let odd = Cut { min_opacity: 2.0, ..Default::default() };
    let path = folder.path().join("odd.ply");
    assert!(
        splats::write_cut(&path, &original, (&odd, 3), &WriteOptions::default()).is_err() && !path.exists()
    );
    assert!(splats::convert(&input, &path, &ConvertOptions { cut: odd, ..Default::default() }).is_err());
}

/// Each part has the whole scene; the merge takes its cell of each.
#[test]
fn merged_cells_are_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    let original = scene(40_000, 2);
    let cells = Cells::divide(&original.means, 9_000).unwrap();
    let input = folder.path().join("in.ply");
    let options = WriteOptions { antialiased: true, ..Default::default() };
    splats::write(&input, &original, &options).unwrap();
    let part = |within: &Bounds| splats::Part { path: &input, within: *within };
    let parts: Vec<splats::Part<'_>> = cells.bounds().iter().map(part).collect();
    assert!(parts.len() > 4);
    let cell_of = |index: &usize| cells.at(Vec3::from_array(original.means[*index])).unwrap();
    let mut order: Vec<usize> = (0..original.len()).collect();
    order.sort_by_key(cell_of);
    let expected = original.select(&order);
    for format in Format::ALL {
        let [merged, written] = ["merged", "written"]
            .map(|name| folder.path().join(name).join(format!("scene{}", format.extension())));
        for path in [&merged, &written] {
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        }
        let done = splats::merge(&parts, &merged, &KEEP, &WriteOptions::default()).unwrap();
        assert_eq!((done.format, done.written.iter().sum::<u64>()), (format, 40_000));
        splats::write_cut(&written, &expected, (&Cut::default(), 2), &options).unwrap();
        assert!(std::fs::read(&merged).unwrap() == std::fs::read(&written).unwrap(), "{format}");
    }
    // Many cells need no more memory than one.
    let [few, many] = [40_000, 500].map(|most| {
        let cells = Cells::divide(&original.means, most).unwrap();
        let parts: Vec<splats::Part<'_>> = cells.bounds().iter().map(part).collect();
        let output = folder.path().join("memory.ply");
        let merge = || splats::merge(&parts, &output, &KEEP, &WriteOptions::default()).unwrap();
        (parts.len(), allocation_counter::measure(|| drop(merge())).bytes_max)
    });
    assert!(few.0 == 1 && many.0 > 60 && many.1 < few.1 + few.1 / 10, "{few:?} {many:?}");
    // Parts that do not fit together, and no parts.
    let other = folder.path().join("other.ply");
    splats::write(&other, &original.with_sh_degree(1), &options).unwrap();
    let output = folder.path().join("none.ply");
    let refused = |path: &Path| {
        let parts = [parts[0], splats::Part { path, within: Cells::EVERYTHING }];
        let refused =
            splats::merge(&parts, &output, &KEEP, &WriteOptions::default()).unwrap_err().to_string();
        assert!(refused.starts_with(path.to_str().unwrap()) && !output.exists(), "{refused}");
        refused
    };
    assert!(refused(&other).contains("SH degree 1, with antialiasing"));
    splats::write(&other, &original, &WriteOptions::default()).unwrap();
    assert!(refused(&other).contains("SH degree 2, without antialiasing"));
    let bytes = std::fs::read(&input).unwrap();
    std::fs::write(&other, &bytes[..bytes.len() - 9]).unwrap();
    refused(&other);
    assert!(splats::merge(&[], &output, &KEEP, &WriteOptions::default()).is_err());
    // One Gaussian that is not finite, in the box that holds all.
    let mut broken = original.clone();
    broken.log_scales[7][1] = f32::NAN;
    splats::write(&other, &broken, &options).unwrap();
    assert!(refused(&other).contains("--drop-invalid"));
    let all = [splats::Part { path: &other, within: Cells::EVERYTHING }];
    let drop = ReadOptions { drop_invalid: true, ..KEEP };
    let done = splats::merge(&all, &output, &drop, &WriteOptions::default()).unwrap();
    assert_eq!(done.written, [39_999]);
    assert!(
        done.warnings.len() == 1 && done.warnings[0].ends_with("scale_1 = NaN is not finite"),
        "{:?}",
        done.warnings
    );
}

/// The header with other comments.
fn with_comments(bytes: &[u8], comments: &[&str]) -> Vec<u8> {
    const FORMAT: &[u8] = b"ply\nformat binary_little_endian 1.0\n";
    let own: Vec<u8> = comments.iter().flat_map(|line| format!("comment {line}\n").into_bytes()).collect();
    [FORMAT, &own, &bytes[FORMAT.len()..]].concat()
}

/// Comments of Brush, gsplat, splat-transform, Postshot and web-splat; the last one counts.
#[test]
fn marks_of_other_programs_are_read_and_kept() {
    let folder = tempfile::tempdir().unwrap();
    for format in [Format::Ply, Format::CompressedPly] {
        let path = folder.path().join(format!("scene{}", format.extension()));
        splats::write(&path, &scene(9, 0), &WriteOptions::default()).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        for (comments, antialiased, kernel_size, word) in [
            (&["Exported from Brush", "SplatRenderMode: mip"][..], true, None, ""),
            (&["  SPLATRENDERMODE:   Mip  "], true, None, ""),
            (&["SplatRenderMode: default"], false, None, ""),
            (&["antialiased 1"], true, None, ""),
            (&["Antialiased 0"], false, None, ""),
            (&["antialiased"], true, None, ""),
            (&["mip=true", "kernel_size=0.1"], true, Some(0.1), ""),
            (&["antialiased 1", "SplatRenderMode: default"], false, None, ""),
            (&["SplatRenderMode: default", "antialiased 1"], true, None, ""),
            (&["SplatRenderMode: 2dgs"], false, None, "2DGS"),
            (&["SplatRenderMode: banana"], false, None, "'banana' is not known"),
            (&["not antialiased at all", "kernel_size=many"], false, None, ""),
        ] {
            std::fs::write(&path, with_comments(&bytes, comments)).unwrap();
            let read = splats::read(&path, &KEEP).unwrap();
            let marks = (read.header.antialiased, read.header.kernel_size);
            assert_eq!(marks, (antialiased, kernel_size), "{comments:?}");
            assert_eq!(
                read.warnings.concat().is_empty(),
                word.is_empty(),
                "{comments:?}: {:?}",
                read.warnings
            );
            assert!(read.warnings.concat().contains(word), "{comments:?}: {:?}", read.warnings);
            for to in Format::ALL {
                let output = folder.path().join(format!("out{}", to.extension()));
                let done = splats::convert(&path, &output, &ConvertOptions::default()).unwrap();
                let keeps_size = !matches!(to, Format::Splat | Format::Spz);
                let header = splats::header(&output, &KEEP).unwrap();
                assert_eq!(header.antialiased, antialiased && to.keeps_antialiased(), "{to}");
                assert_eq!(header.kernel_size, kernel_size.filter(|_| keeps_size), "{to}");
                let is_told = done.warnings.iter().any(|line| line.ends_with("--kernel-size 0.1"));
                assert_eq!(is_told, kernel_size.is_some() && !keeps_size, "{to}: {:?}", done.warnings);
            }
        }
    }
    // The form that Brush and splat-transform read.
    let path = folder.path().join("own.ply");
    let marks = WriteOptions { antialiased: true, kernel_size: Some(0.1), ..Default::default() };
    splats::write(&path, &scene(1, 0), &marks).unwrap();
    let header = String::from_utf8_lossy(&std::fs::read(&path).unwrap()).into_owned();
    assert!(header.contains("\ncomment SplatRenderMode: mip\ncomment kernel_size=0.1\n"), "{header}");
}

/// PLYs keep the mark of 2DGS; a warning names it when another format loses it.
#[test]
fn a_scene_of_2dgs_stays_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("disks.ply");
    let marked = WriteOptions { is_2dgs: true, ..Default::default() };
    splats::write(&path, &scene(9, 0), &marked).unwrap();
    for to in Format::ALL {
        let output = folder.path().join(format!("out{}", to.extension()));
        let done = splats::convert(&path, &output, &ConvertOptions::default()).unwrap();
        let keeps = matches!(to, Format::Ply | Format::CompressedPly);
        assert_eq!(splats::header(&output, &KEEP).unwrap().is_2dgs, keeps, "{to}");
        let is_told = done.warnings.iter().any(|line| line.contains("cannot say that this is a 2DGS scene"));
        assert_eq!(is_told, !keeps, "{:?}", done.warnings);
    }
}

/// A zero quaternion means no rotation, and a move turns it like others.
#[test]
fn quaternions_of_zeros_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let turned = DQuat::from_rotation_x(0.5);
    for format in [Format::Ply, Format::Splat] {
        let [path, output] =
            ["in", "out"].map(|name| folder.path().join(format!("{name}{}", format.extension())));
        let mut gaussians = scene(9, 0);
        gaussians.quats[4] = [0.0; 4];
        splats::write(&path, &gaussians, &WriteOptions::default()).unwrap();
        if format == Format::Splat {
            // The writer of .splat never writes zeros.
            let mut bytes = std::fs::read(&path).unwrap();
            bytes[32 * 4 + 28..32 * 5].fill(128);
            std::fs::write(&path, bytes).unwrap();
        }
        let read = splats::read(&path, &KEEP).unwrap();
        assert_eq!(read.gaussians.quats[4], [1.0, 0.0, 0.0, 0.0]);
        let line = "1 of 9 Gaussians have a quaternion of zeros and are used without rotation";
        assert_eq!(read.warnings, [line], "{format}");
        let similarity = Similarity { rotation: turned, ..Default::default() };
        let options = ConvertOptions { similarity, ..Default::default() };
        let done = splats::convert(&path, &output, &options).unwrap();
        assert!(done.warnings.iter().any(|warning| warning == line), "{:?}", done.warnings);
        let quat = splats::read(&output, &KEEP).unwrap().gaussians.quats[4];
        assert!((f64::from(quat[0]) - turned.w).abs() < 0.01 && (f64::from(quat[1]) - turned.x).abs() < 0.01);
    }
}

/// Floats at UTM coordinates have steps of 0.5. Doubles and larger Gaussians do not show them.
#[test]
fn positions_that_single_precision_has_rounded_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let mut gaussians = scene(300, 0);
    gaussians.log_scales.as_flattened_mut().fill(-4.0);
    for mean in &mut gaussians.means {
        mean[1] += 5_000_000.0;
    }
    let warnings = |format: Format, gaussians: &Gaussians| {
        let path = folder.path().join(format!("scene{}", format.extension()));
        splats::write(&path, gaussians, &WriteOptions::default()).unwrap();
        splats::read(&path, &KEEP).unwrap().warnings
    };
    for format in [Format::Ply, Format::CompressedPly, Format::Splat, Format::Glb] {
        let said = warnings(format, &gaussians);
        let words = "positions are rounded to steps of about 0.50 (a typical size is 0.018)";
        assert!(said.len() == 1 && said[0].starts_with(words), "{format}: {said:?}");
        let mut large = gaussians.clone();
        large.log_scales.as_flattened_mut().fill(1.0);
        assert_eq!(warnings(format, &large), [""; 0], "{format}");
    }
}

/// SPZ holds -1 to 1, compressed PLY -4 to 4.
#[test]
fn spherical_harmonics_that_are_cut_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let mut gaussians = scene(100, 1);
    for index in 0..30 {
        gaussians.sh[4 * index + 2][1] = if index < 10 { 5.0 } else { -1.5 };
    }
    for (name, words) in [
        ("a.spz", "SH coefficients above degree 0 of 30 of 100 Gaussians are beyond -1 to 1 and are cut"),
        ("a.compressed.ply", "of 10 of 100 Gaussians are beyond -4 to 4 and are cut"),
        ("a.ply", ""),
    ] {
        let loss = splats::write(folder.path().join(name), &gaussians, &WriteOptions::default()).unwrap();
        assert_eq!(loss.is_some(), !words.is_empty(), "{loss:?}");
        assert!(loss.is_none_or(|line| line.contains(words)), "{name}");
    }
    let few = scene(100, 1);
    assert_eq!(splats::write(folder.path().join("a.spz"), &few, &WriteOptions::default()).unwrap(), None);
}

/// An editor dropped the comments of a model folder's PLY; its cameras.json still has the frame.
#[test]
fn a_models_cameras_tell_the_frame_that_a_ply_has_lost() {
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("model");
    let ply = model.join("point_cloud/iteration_7/point_cloud.ply");
    std::fs::create_dir_all(ply.parent().unwrap()).unwrap();
    let frame = WorldFrame { origin: DVec3::new(500_000.0, 5_000_000.0, 120.0), unit: 100.0 };
    let intrinsics = Intrinsics::from_fov_x(0.8, 64, 48);
    let camera = Camera::look_at(Vec3::new(0.0, 0.0, -9.0), Vec3::ZERO, Vec3::NEG_Y, intrinsics);
    let cameras = model.join("cameras.json");
    ashsplat_files::cameras_json::write(&cameras, [("a", &camera)], &frame).unwrap();
    let write = |format: Format, frame: WorldFrame, gaussians: &Gaussians| {
        let options = WriteOptions { format: Some(format), frame, ..Default::default() };
        splats::write(&ply, gaussians, &options).unwrap();
        let read = splats::read(&ply, &KEEP).unwrap();
        ((read.header.origin, read.header.unit), read.warnings)
    };
    let gaussians = scene(300, 0);
    for format in [Format::Ply, Format::CompressedPly] {
        let (whole, said) = write(format, frame, &gaussians);
        assert_eq!((whole, said), ((frame.origin, Some(100.0)), Vec::new()));
        let (restored, said) = write(format, WorldFrame::default(), &gaussians);
        assert_eq!(restored, whole, "{format}");
        let words = ["names no origin 500000,5000000,120 and unit 100: ", "cameras.json"];
        assert!(said.len() == 1 && words.iter().all(|word| said[0].contains(word)), "{said:?}");
        // Absolute positions, with Gaussians so large that single precision suffices.
        let mut absolute = gaussians.clone();
        absolute.log_scales.as_flattened_mut().fill(2.0);
        for mean in &mut absolute.means {
            *mean = [0, 1, 2].map(|axis| mean[axis] + frame.origin[axis] as f32);
        }
        let (kept, said) = write(format, WorldFrame::default(), &absolute);
        assert!(kept.0 == DVec3::ZERO && said.concat().contains("names no unit 100"), "{said:?}");
    }
    // Cameras around zero have no frame.
    ashsplat_files::cameras_json::write(&cameras, [("a", &camera)], &WorldFrame::default()).unwrap();
    let plain = write(Format::Ply, WorldFrame::default(), &gaussians);
    assert_eq!(plain, ((DVec3::ZERO, None), Vec::new()));
}

/// A log-scale of -∞ in PLY, a 0 in .splat and glTF, an infinite range in compressed PLY.
#[test]
fn size_0_is_a_size() {
    let folder = tempfile::tempdir().unwrap();
    let mut flat = scene(5, 0);
    flat.log_scales.iter_mut().for_each(|log_scale| log_scale[2] = f32::NEG_INFINITY);
    for format in [Format::Ply, Format::Splat, Format::Glb, Format::Gltf] {
        let path = folder.path().join(format!("flat{}", format.extension()));
        splats::write(&path, &flat, &WriteOptions::default()).unwrap();
        let read = splats::read(&path, &KEEP).unwrap();
        assert!(read.gaussians.log_scales.iter().all(|s| s[2] == f32::MIN_POSITIVE.ln() && s[0] > -6.0));
        assert_eq!(splats::read(&path, &DROP).unwrap().dropped, 0, "{format}");
    }
    let path = folder.path().join("flat.compressed.ply");
    splats::write(&path, &scene(5, 0), &WriteOptions::default()).unwrap();
    let mut bytes = std::fs::read(&path).unwrap();
    let chunk = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    bytes[chunk + 4 * 8..][..4].copy_from_slice(&f32::NEG_INFINITY.to_le_bytes());
    std::fs::write(&path, bytes).unwrap();
    let read = splats::read(&path, &KEEP).unwrap();
    assert!(read.warnings.concat().contains("sizes are lost in 1 of 1 chunks"), "{:?}", read.warnings);
    assert_eq!(read.gaussians.len(), 5);
}

/// If no Gaussian is usable, dropping invalid ones leaves no scene.
#[test]
fn dropping_every_gaussian_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let mut broken = scene(3, 0);
    broken.log_scales.as_flattened_mut().fill(f32::NAN);
    for format in [Format::Ply, Format::Splat, Format::Glb] {
        let path = folder.path().join(format!("broken{}", format.extension()));
        splats::write(&path, &broken, &WriteOptions::default()).unwrap();
        let error = splats::read(&path, &DROP).unwrap_err().to_string();
        assert!(error.contains("3 of 3 Gaussians have") && error.contains("none is left"), "{error}");
        let output = folder.path().join("out.ply");
        let options = ConvertOptions { read: DROP, ..Default::default() };
        assert!(splats::convert(&path, &output, &options).is_err() && !output.exists(), "{format}");
    }
}

/// The `.gltf` cannot be written, because the name of its temporary file is too long. The previous scene stays
/// intact.
#[cfg(unix)]
#[test]
fn a_gltf_keeps_its_scene_until_the_new_one_is_there() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.gltf");
    let (old, new) = (scene(20, 0), scene(30, 1));
    for (gaussians, binary) in [(&old, "scene.bin"), (&new, "scene.1.bin"), (&old, "scene.bin")] {
        splats::write(&path, gaussians, &WriteOptions::default()).unwrap();
        assert_eq!(names(folder.path()), [binary, "scene.gltf"]);
        assert_eq!(splats::read(&path, &KEEP).unwrap().gaussians.len(), gaussians.len());
    }
    let target = "x".repeat(250);
    std::fs::rename(&path, folder.path().join(&target)).unwrap();
    std::os::unix::fs::symlink(folder.path().join(&target), &path).unwrap();
    let error = splats::write(&path, &new, &WriteOptions::default()).unwrap_err().to_string();
    assert!(error.starts_with(path.to_str().unwrap()) && error.contains("cannot write"), "{error}");
    assert_eq!(names(folder.path()), ["scene.bin", "scene.gltf", &target]);
    assert_eq!(splats::read(&path, &KEEP).unwrap().gaussians.len(), 20);
}

/// Writers refuse the same values as readers.
#[test]
fn what_cannot_be_read_again_is_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let mut edge = scene(300, 1);
    edge.log_scales.as_flattened_mut().fill(87.9);
    let input = folder.path().join("in.ply");
    splats::write(&input, &edge, &WriteOptions::default()).unwrap();
    let moved = |scale: f64, x: f64| ConvertOptions {
        similarity: Similarity { scale, translation: DVec3::new(x, 0.0, 0.0), ..Default::default() },
        ..Default::default()
    };
    let merged = ConvertOptions { decimate: Some(Target::Share(0.1)), ..Default::default() };
    for format in Format::ALL {
        let output = folder.path().join(format!("out{}", format.extension()));
        for options in [&moved(1e38, 0.0), &moved(1e30, 0.0), &moved(2.0, 0.0), &moved(1.0, 3e38), &merged] {
            let error = splats::convert(&input, &output, options).unwrap_err().to_string();
            let is_said = error.contains("is not written: a Gaussian would have");
            assert!(is_said || error.contains("too far out for SPZ"), "{error}");
        }
        assert_eq!(names(folder.path()), ["in.ply"], "{format}");
    }
    // A valid scene moves to another origin, which has a limit, too.
    let near = folder.path().join("near.ply");
    splats::write(&near, &scene(20, 0), &WriteOptions::default()).unwrap();
    for format in Format::ALL {
        let output = folder.path().join(format!("out{}", format.extension()));
        let error = splats::convert(&near, &output, &moved(1.0, 3e38)).unwrap_err().to_string();
        assert!(
            error.contains("is not written: its positions would lie 3e38 from zero"),
            "{format}: {error}"
        );
    }
    assert_eq!(names(folder.path()), ["in.ply", "near.ply"]);
    splats::convert(&input, &folder.path().join("out.ply"), &moved(1.0, 1e17)).unwrap();
    splats::read(folder.path().join("out.ply"), &KEEP).unwrap();
}

#[test]
fn scenes_are_joined() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    let (mut first, mut second) = (scene(20_000, 0), scene(300, 2));
    // After the turn, the values stay within the range of SPZ.
    second.sh.as_flattened_mut().iter_mut().for_each(|value| *value *= 0.5);
    splats::write(file("a.ply"), &first, &WriteOptions::default()).unwrap();
    splats::write(file("b.glb"), &second, &WriteOptions::default()).unwrap();
    let moved = Similarity {
        rotation: DQuat::from_rotation_z(1.0),
        scale: 2.0,
        translation: DVec3::new(5.0, 0.0, 0.0),
    };
    let everything = Similarity { scale: 0.5, ..Default::default() };
    let [a, b] = [file("a.ply"), file("b.glb")];
    let inputs = [
        splats::Input { path: &a, similarity: Similarity::default() },
        splats::Input { path: &b, similarity: moved },
    ];
    first = first.with_sh_degree(2);
    first.transform(&everything);
    second.transform(&moved);
    second.transform(&everything);
    first.append(&second);
    let options = ConvertOptions { similarity: everything, ..Default::default() };
    for format in Format::ALL {
        let output = file(&format!("out{}", format.extension()));
        let done = splats::join(&inputs, &output, &options).unwrap();
        let degree = 2.min(format.max_sh_degree());
        assert_eq!((done.written, done.sh_degree), (20_300, degree), "{format}");
        let read = splats::read(&output, &KEEP).unwrap().gaussians;
        let expected = first.with_sh_degree(degree);
        if format != Format::CompressedPly {
            let least = Tolerance {
                mean: 1e-5,
                log_scale: 1e-5,
                opacity: 1e-5,
                rotation: 1e-5,
                color: 1e-4,
                sh: 1e-4,
            };
            let own = tolerance(format);
            let tolerance = Tolerance {
                mean: own.mean.max(least.mean),
                log_scale: own.log_scale.max(least.log_scale),
                opacity: own.opacity.max(least.opacity),
                rotation: own.rotation.max(least.rotation),
                color: own.color.max(least.color),
                sh: own.sh.max(least.sh),
            };
            assert_close(&read, &expected, &tolerance);
        }
    }
    let fewer = ConvertOptions { decimate: Some(Target::Count(200)), ..Default::default() };
    let small = [splats::Input { path: &b, similarity: moved }; 2];
    assert_eq!(splats::join(&small, &file("few.ply"), &fewer).unwrap().written, 200);
    // The files have marks that one file cannot have for both.
    let antialiased = WriteOptions { antialiased: true, ..Default::default() };
    splats::write(&b, &scene(300, 2), &antialiased).unwrap();
    let output = file("none.ply");
    let error = splats::join(&inputs, &output, &options).unwrap_err().to_string();
    assert!(error.contains("b.glb: was trained with antialiasing, ") && !output.exists(), "{error}");
    assert!(splats::join(&[], &output, &options).is_err());
}

#[test]
fn refused_input_leaves_the_output_alone() {
    let folder = tempfile::tempdir().unwrap();
    let (input, output) = (folder.path().join("in.ply"), folder.path().join("out.spz"));
    let mut bad = scene(10, 0);
    bad.means[4][1] = f32::NAN;
    splats::write(&input, &bad, &WriteOptions::default()).unwrap();
    std::fs::write(&output, "old").unwrap();
    let error = splats::convert(&input, &output, &ConvertOptions::default()).unwrap_err().to_string();
    assert!(error.contains("1 of 10 Gaussian has") && error.contains("vertex 4: y = NaN"), "{error}");
    assert_eq!(std::fs::read(&output).unwrap(), b"old");
    assert_eq!(names(folder.path()), ["in.ply", "out.spz"]);
    let dropped = ConvertOptions { read: DROP, ..Default::default() };
    assert_eq!(splats::convert(&input, &output, &dropped).unwrap().written, 9);
    let far = Similarity { scale: 1e7, ..Default::default() };
    let options = ConvertOptions { read: DROP, similarity: far, ..Default::default() };
    let error = splats::convert(&input, &output, &options).unwrap_err().to_string();
    assert!(error.contains("too far out for SPZ"), "{error}");
    let unknown = splats::convert(&input, &folder.path().join("out.xyz"), &dropped).unwrap_err().to_string();
    assert!(
        unknown.contains("out.xyz: has no extension of a known format; give it one of .ply"),
        "{unknown}"
    );
}

/// A large scene gets fewer fractional bits, and does not wrap around.
#[test]
fn spz_holds_far_away_gaussians() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("far.spz");
    let mut expected = scene(20, 0);
    expected.means[3] = [-250_000.0, 7.5, 2.25];
    splats::write(&path, &expected, &WriteOptions::default()).unwrap();
    let actual = splats::read(&path, &KEEP).unwrap().gaussians;
    assert_close(&actual, &expected, &Tolerance { mean: 0.5 / 32.0, ..tolerance(Format::Spz) });
}

/// Outliers in position and colour have separate chunks: the others keep their precision, and the file keeps its
/// count.
#[test]
fn outliers_do_not_coarsen_compressed_ply() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.compressed.ply");
    let plain = scene(700, 1);
    splats::write(&path, &plain, &WriteOptions::default()).unwrap();
    let bytes = std::fs::metadata(&path).unwrap().len();
    let mut odd = plain.clone();
    odd.means[3] = [2e5, 1.0, 0.0];
    odd.means[4] = [-3e3, 0.0, 7.0];
    odd.sh[350 * 4] = [800.0, 0.0, 0.0];
    splats::write(&path, &odd, &WriteOptions::default()).unwrap();
    assert!(std::fs::metadata(&path).unwrap().len() > bytes, "padded");
    let read = splats::read(&path, &KEEP).unwrap();
    assert_eq!((read.header.count, read.gaussians.len()), (700, 700));
    let actual = in_order_of(&odd, &read.gaussians);
    let others: Vec<usize> = (0..odd.len()).filter(|&index| odd.means[index] == plain.means[index]).collect();
    assert_eq!(others.len(), 698);
    let others: Vec<usize> = others.into_iter().filter(|&index| odd.sh_of(index)[0][0] < 100.0).collect();
    assert_close(&actual.select(&others), &odd.select(&others), &tolerance(Format::CompressedPly));
    assert!((actual.means[3][0] - 2e5).abs() < 1.0 && (actual.means[4][0] + 3e3).abs() < 1.0);
    // Without the outliers, a conversion needs no padding.
    let converted = folder.path().join("scene.ply");
    assert_eq!(splats::convert(&path, &converted, &ConvertOptions::default()).unwrap().written, 700);
}

/// SPZ uses the bits that fit the scene, and a warning names values that it cannot hold.
#[test]
fn spz_goes_by_the_size_of_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let lines = |scene: &Gaussians, format: Format| {
        splats::write(place("scene.ply"), scene, &WriteOptions::default()).unwrap();
        let output = place(&format!("scene{}", format.extension()));
        let done = splats::convert(&place("scene.ply"), &output, &ConvertOptions::default()).unwrap();
        let every = (&Cut::default(), 3);
        let losses = splats::cut_losses(format, scene, every, &WriteOptions::default()).unwrap();
        assert_eq!(done.warnings, losses);
        losses
    };
    let mut small = scene(300, 0);
    small.transform(&Similarity { scale: 1e-3, ..Default::default() });
    let told = lines(&small, Format::Spz);
    assert!(told.len() == 1 && told[0].contains("are beyond 0.000045 to 379 and are cut"), "{told:?}");
    let actual = splats::read(place("scene.spz"), &KEEP).unwrap().gaussians;
    for (mean, expected) in actual.means.iter().zip(&small.means) {
        assert!((0..3).all(|axis| (mean[axis] - expected[axis]).abs() < 1e-6), "{mean:?}, not {expected:?}");
    }
    let mut far = scene(300, 0);
    assert_eq!(lines(&far, Format::Spz), [""; 0]);
    far.means[7] = [0.0, 6e6, 0.0];
    let told = lines(&far, Format::Spz);
    assert!(told.len() == 1 && told[0].contains("because one lies at 6000000: crop"), "{told:?}");
    far.log_scales[7] = [21.0; 3];
    let told = lines(&far, Format::CompressedPly);
    assert!(told.len() == 1 && told[0].contains("sizes of 1 of 300 Gaussians"), "{told:?}");
    assert_eq!(lines(&far, Format::Glb), [""; 0]);
    // A road: long, flat, and fine.
    let mut road = scene(5000, 0);
    road.log_scales.fill([0.02_f32.ln(); 3]);
    for (k, mean) in (0..).zip(&mut road.means) {
        *mean = [k as f32, 0.3 * (k % 40) as f32, 0.1 * (k % 7) as f32];
    }
    let told = lines(&road, Format::CompressedPly);
    assert!(
        told.len() == 1 && told[0].contains("steps of 0.1") && told[0].contains("256 Gaussians"),
        "{told:?}"
    );
    road.log_scales.fill([0.0; 3]);
    assert_eq!(lines(&road, Format::CompressedPly), [""; 0]);
    let mut bright = scene(300, 0);
    bright.sh[..20].fill([4.0; 3]);
    for format in [Format::Spz, Format::Splat] {
        let told = lines(&bright, format);
        assert!(told.len() == 1 && told[0].contains("colours of 20 of 300 Gaussians are cut"), "{told:?}");
    }
    bright.sh.fill([-2.0; 3]);
    assert_eq!(lines(&bright, Format::Splat), [""; 0], "black either way");
}

fn message(path: &Path) -> String {
    let message = splats::read(path, &KEEP).unwrap_err().to_string();
    assert!(message.starts_with(path.to_str().unwrap()) && !message.contains('\n'), "{message}");
    message
}

#[test]
fn no_truncation_gives_a_scene_and_no_mutation_panics() {
    let folder = tempfile::tempdir().unwrap();
    for format in Format::ALL {
        let path = folder.path().join(format!("scene{}", format.extension()));
        splats::write(&path, &scene(3, 1.min(format.max_sh_degree())), &WriteOptions::default()).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        for_each_truncation(&path, &bytes, |length| {
            // In a format without a header, any whole number of rows is a file.
            if format != Format::Splat || length % 32 != 0 || length == 0 {
                message(&path);
            }
        });
        for_each_mutation(&path, &bytes, |_| match splats::read(&path, &DROP) {
            Ok(read) => {
                read.gaussians.check_shapes().unwrap();
                assert!(read.gaussians.means.as_flattened().iter().all(|v| v.is_finite()));
            }
            Err(e) => assert!(!e.to_string().contains('\n'), "{e}"),
        });
    }
}

#[test]
fn formats_are_known_by_content_before_name() {
    let folder = tempfile::tempdir().unwrap();
    let expected = scene(5, 0);
    for format in [Format::Ply, Format::CompressedPly, Format::Spz, Format::Glb] {
        for name in ["scene", "scene.splat", "point_cloud.ply"] {
            let path = folder.path().join(name);
            let options = WriteOptions { format: Some(format), ..Default::default() };
            splats::write(&path, &expected, &options).unwrap();
            assert_eq!(splats::read(&path, &KEEP).unwrap().header.format, format, "{name}");
        }
    }
    let path = folder.path().join("scene.obj");
    std::fs::write(&path, "v 1 2 3").unwrap();
    assert!(message(&path).contains("is no file of Gaussians that is known; known are .ply .compressed.ply"));
    assert!(message(folder.path()).contains("is not a file"));
}

/// A glTF may place a mesh at many nodes, but a small file must not claim a scene that fills the memory.
#[test]
fn gltf_places_its_gaussians_a_limited_number_of_times() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("copies.gltf");
    let placed = |count: usize, nodes: usize, primitives: usize| {
        splats::write(&path, &scene(count, 0), &WriteOptions::default()).unwrap();
        let mut document: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        let mesh = &mut document["meshes"][0]["primitives"];
        *mesh = vec![mesh[0].clone(); primitives].into();
        document["nodes"] = vec![json!({ "mesh": 0 }); nodes].into();
        document["scenes"][0]["nodes"] = (0..nodes).collect();
        std::fs::write(&path, document.to_string()).unwrap();
    };
    placed(5, 300, 2);
    assert_eq!(splats::read(&path, &KEEP).unwrap().gaussians.len(), 3000);
    // 10^9 Gaussians from 560 kB; more and more of them at each node; only placements.
    for (count, nodes, primitives) in [(10_000, 100_000, 1), (10_000, 300, 300), (1, 1000, 1000)] {
        placed(count, nodes, primitives);
        let message = message(&path);
        assert!(message.contains("again and again") && message.contains("16 times"), "{message}");
    }
}

#[test]
fn a_gltf_of_other_programs_is_read_as_it_says_or_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.gltf");
    let written = |change: &dyn Fn(&mut Value)| {
        splats::write(&path, &scene(5, 0), &WriteOptions::default()).unwrap();
        let mut document: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        change(&mut document);
        std::fs::write(&path, document.to_string()).unwrap();
    };
    let said = |change: &dyn Fn(&mut Value)| {
        written(change);
        splats::header(&path, &ReadOptions::default()).unwrap().warnings.join("\n")
    };
    let extension = |document: &mut Value, key: &str, value: &str| {
        document["meshes"][0]["primitives"][0]["extensions"]["KHR_gaussian_splatting"][key] = value.into();
    };
    assert_eq!(said(&|_| {}), "");
    let instances = said(&|document| document["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]));
    assert!(instances.contains("requires EXT_mesh_gpu_instancing, which is not read"), "{instances}");
    assert!(
        said(&|document| extension(document, "kernel", "student"))
            .contains("\"student\" is drawn as an ellipse")
    );
    assert!(
        said(&|document| extension(document, "colorSpace", "wide")).contains("\"wide\" are used as sRGB")
    );

    let with_a_mesh = said(&|document| {
        let primitives = document["meshes"][0]["primitives"].as_array_mut().unwrap();
        primitives.push(json!({ "attributes": {} }));
    });
    assert!(with_a_mesh.ends_with("1 primitives that are no Gaussians are not used"), "{with_a_mesh}");

    // Logarithms instead of sizes, and logits instead of opacities: some values are negative and far from 0.
    written(&|document| {
        let attributes = &mut document["meshes"][0]["primitives"][0]["attributes"];
        attributes["KHR_gaussian_splatting:SCALE"] = attributes["POSITION"].clone();
    });
    assert!(message(&path).contains("SCALE has values below 0"), "{}", message(&path));
    written(&|document| {
        let attributes = &document["meshes"][0]["primitives"][0]["attributes"];
        let position = attributes["POSITION"].as_u64().unwrap() as usize;
        let accessors = document["accessors"].as_array_mut().unwrap();
        let mut first = accessors[position].clone();
        first["type"] = json!("SCALAR");
        accessors.push(first);
        let last = accessors.len() - 1;
        document["meshes"][0]["primitives"][0]["attributes"]["KHR_gaussian_splatting:OPACITY"] = json!(last);
    });
    let message = message(&path);
    assert!(message.contains("OPACITY has values outside of 0 to 1"), "{message}");
}

/// A corner of a UTM zone. Single precision has steps of 0.5 there.
const UTM: DVec3 = DVec3::new(500_000.3, 4_600_000.7, 120.0);

/// A PLY with double positions, as survey programs write it.
fn ply_of_doubles(path: &Path, gaussians: &Gaussians, offset: DVec3) {
    let names = "f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    let mut bytes = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", gaussians.len());
    ["x", "y", "z"].iter().for_each(|name| bytes += &format!("property double {name}\n"));
    names.split(' ').for_each(|name| bytes += &format!("property float {name}\n"));
    let mut bytes = (bytes + "end_header\n").into_bytes();
    for index in 0..gaussians.len() {
        let position = offset + DVec3::from_array(gaussians.means[index].map(f64::from));
        bytes.extend(position.to_array().map(f64::to_le_bytes).as_flattened());
        let rest = [
            &gaussians.sh_of(index)[0][..],
            &[gaussians.opacity_logits[index]],
            &gaussians.log_scales[index],
            &gaussians.quats[index],
        ];
        rest.concat().iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    }
    std::fs::write(path, bytes).unwrap();
}

/// Positions relative to an offset; x in ascending order, since compressed PLY is sorted.
fn positions(path: &Path, offset: DVec3) -> Vec<DVec3> {
    let scene = splats::read(path, &KEEP).unwrap();
    let mut all: Vec<DVec3> = scene
        .gaussians
        .means
        .iter()
        .map(|&mean| scene.frame.source(Vec3::from_array(mean)) - offset)
        .collect();
    all.sort_by(|a, b| a.x.total_cmp(&b.x));
    all
}

#[test]
fn scenes_far_from_the_origin_keep_their_positions_in_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let gaussians = scene(300, 0);
    ply_of_doubles(&place("utm.ply"), &gaussians, UTM);
    splats::write(place("near.ply"), &gaussians, &WriteOptions::default()).unwrap();
    let expected = positions(&place("near.ply"), DVec3::ZERO);
    for format in Format::ALL {
        let (there, back) = (place(&format!("far{}", format.extension())), place("back.ply"));
        let done = splats::convert(&place("utm.ply"), &there, &ConvertOptions::default()).unwrap();
        splats::convert(&there, &back, &ConvertOptions::default()).unwrap();
        for path in [&there, &back] {
            let far = positions(path, UTM);
            let off = far.iter().zip(&expected).map(|(a, b)| (a.x - b.x).abs()).fold(0.0, f64::max);
            let most = f64::from(tolerance(format).mean.max(1e-5));
            assert!(far.len() == 300 && off <= most, "{}: {off}", path.display());
        }
        // If other programs would place it elsewhere, a warning says so.
        let known = matches!(format, Format::Ply | Format::Glb | Format::Gltf);
        assert_eq!(done.warnings.len(), usize::from(!known), "{:?}", done.warnings);
        assert!(known || done.warnings[0].contains("relative to 500000,4600000,"), "{:?}", done.warnings);
    }
    let text = String::from_utf8_lossy(&std::fs::read(place("far.ply")).unwrap()[..200]).into_owned();
    assert!(text.contains("property double x") && !text.contains("comment origin"), "{text}");
    // A new scene of the same name has no origin file any more.
    splats::convert(&place("near.ply"), &place("far.spz"), &ConvertOptions::default()).unwrap();
    assert!(!place("far.spz.origin.json").exists() && place("far.splat.origin.json").exists());
    std::fs::write(place("far.splat.origin.json"), r#"{"origin": [1, 2]}"#).unwrap();
    let error = splats::read(place("far.splat"), &KEEP).unwrap_err().to_string();
    assert!(error.contains("far.splat.origin.json: is no origin"), "{error}");
}

#[test]
fn changes_of_distant_scenes_are_made_in_their_own_coordinates() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let gaussians = scene(500, 0);
    splats::write(place("near.ply"), &gaussians, &WriteOptions::default()).unwrap();
    let moved = |translation| Similarity { translation, ..Similarity::default() };
    let there = ConvertOptions { similarity: moved(UTM), ..Default::default() };
    splats::convert(&place("near.ply"), &place("far.ply"), &there).unwrap();
    let expected = positions(&place("near.ply"), DVec3::ZERO);
    let off = |path: &Path, offset: DVec3| {
        let far = positions(path, offset);
        far.iter().zip(&expected).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
    };
    assert!(off(&place("far.ply"), UTM) < 1e-5);
    // Back at the origin, the file needs no offset.
    let back = ConvertOptions { similarity: moved(-UTM), ..Default::default() };
    splats::convert(&place("far.ply"), &place("back.ply"), &back).unwrap();
    assert!(off(&place("back.ply"), DVec3::ZERO) < 1e-5);
    assert_eq!(splats::header(place("back.ply"), &KEEP).unwrap().origin, DVec3::ZERO);
    let corners = [UTM, UTM + DVec3::splat(20.0)];
    let crop = ConvertOptions { crop_box: Some(corners), ..Default::default() };
    let cropped = splats::convert(&place("far.ply"), &place("cropped.ply"), &crop).unwrap().written;
    let inside = expected.iter().filter(|mean| mean.min_element() >= 0.0).count();
    assert_eq!(cropped, inside as u64);
    // Positions that are exact in single precision keep their bits.
    let mut exact = gaussians;
    for mean in &mut exact.means {
        *mean = [0, 1, 2].map(|axis| (2.0 * mean[axis]).round() / 2.0 + UTM[axis].floor() as f32);
    }
    splats::write(place("exact.ply"), &exact, &WriteOptions::default()).unwrap();
    splats::convert(&place("exact.ply"), &place("copy.ply"), &ConvertOptions::default()).unwrap();
    assert!(std::fs::read(place("exact.ply")).unwrap() == std::fs::read(place("copy.ply")).unwrap());
}

/// Training writes its scene in the coordinates of the data set.
#[test]
fn scenes_are_written_in_source_units_and_drawn_in_their_frame() {
    let folder = tempfile::tempdir().unwrap();
    let gaussians = scene(200, 1);
    let frame = WorldFrame { origin: DVec3::new(500_000.0, 0.0, 0.0), unit: 0.01 };
    for format in [Format::Ply, Format::Glb, Format::Splat] {
        let path = folder.path().join(format!("scene{}", format.extension()));
        splats::write(&path, &gaussians, &WriteOptions { frame, ..Default::default() }).unwrap();
        let read = splats::read(&path, &KEEP).unwrap();
        let largest = read.gaussians.means.as_flattened().iter().fold(0.0, |most: f32, v| most.max(v.abs()));
        assert!(largest <= 0.1, "{format}: {largest}");
        assert_eq!(read.header.unit, (format == Format::Ply).then_some(0.01));
        let drawn = read.in_world_frame();
        // Other formats do not store the training's unit.
        assert!(drawn.frame.unit <= if format == Format::Ply { 0.01 } else { 0.1 }, "{:?}", drawn.frame);
        let expected = if format == Format::Splat { gaussians.with_sh_degree(0) } else { gaussians.clone() };
        let mut moved = expected;
        moved.transform(&Similarity::between(&frame, &drawn.frame));
        assert_close(
            &drawn.gaussians,
            &moved,
            &Tolerance { mean: 1e-4, log_scale: 1e-4, ..tolerance(format) },
        );
    }
}
