//! PLY files: round trips, every layout, damage.

use super::files::{Folder, assert_says, for_each_mutation, for_each_truncation, names, refusal};
use ashsplat::scene::{Gaussians, PointCloud, WorldFrame};
use ashsplat_files::ply;
use ashsplat_files::splats::{self, ReadOptions, WriteOptions};
use proptest::prelude::*;
use std::path::Path;

const KEEP: ReadOptions = ReadOptions { drop_invalid: false, max_host_memory: None };
const DROP: ReadOptions = ReadOptions { drop_invalid: true, max_host_memory: None };

/// Gaussians with distinct values everywhere.
fn numbered(count: usize, sh_degree: u32) -> Gaussians {
    let k = ((sh_degree + 1) * (sh_degree + 1)) as usize;
    let mut next = 0.0f32;
    let mut row = || {
        next += 0.37;
        next - 20.0
    };
    Gaussians {
        sh_degree,
        means: (0..count).map(|_| [row(), row(), row()]).collect(),
        quats: (0..count).map(|_| [row(), row(), row(), row()]).collect(),
        log_scales: (0..count).map(|_| [row() % 50.0, row() % 50.0, row() % 50.0]).collect(),
        opacity_logits: (0..count).map(|_| row()).collect(),
        sh: (0..count * k).map(|_| [row(), row(), row()]).collect(),
    }
}

/// Values of a Gaussian with their property names.
fn named(gaussians: &Gaussians, index: usize) -> Vec<(String, f32)> {
    let sh = gaussians.sh_of(index);
    let mut values = Vec::new();
    let mut put = |name: String, value: f32| values.push((name, value));
    for (axis, name) in ["x", "y", "z"].iter().enumerate() {
        put(name.to_string(), gaussians.means[index][axis]);
    }
    (0..3).for_each(|i| put(format!("f_dc_{i}"), sh[0][i]));
    let rest = sh.len() - 1;
    (0..3 * rest).for_each(|i| put(format!("f_rest_{i}"), sh[1 + i % rest][i / rest]));
    put("opacity".into(), gaussians.opacity_logits[index]);
    (0..3).for_each(|i| put(format!("scale_{i}"), gaussians.log_scales[index][i]));
    (0..4).for_each(|i| put(format!("rot_{i}"), gaussians.quats[index][i]));
    values
}

fn message(path: &Path, options: &ReadOptions) -> String {
    refusal(path, splats::read(path, options))
}

#[test]
fn round_trips_are_bit_exact() {
    let (folder, path) = Folder::with("a.ply");
    for degree in 0..=3 {
        for count in [0, 1, 3000] {
            let mut gaussians = numbered(count, degree);
            if count > 0 {
                gaussians.opacity_logits[0] = f32::INFINITY;
                gaussians.opacity_logits[count - 1] = f32::NEG_INFINITY;
                gaussians.means[0] = [-0.0, f32::MIN_POSITIVE / 8.0, 1e17];
            }
            splats::write(&path, &gaussians, &WriteOptions::default()).unwrap();
            let scene = splats::read(&path, &KEEP).unwrap();
            assert_eq!(scene.dropped, 0);
            assert!(scene.gaussians == gaussians, "degree {degree}, {count} Gaussians");
            assert!(count == 0 || scene.gaussians.means[0][0].is_sign_negative());
        }
    }
    assert_eq!(names(&folder), ["a.ply"]);
}

#[test]
fn the_written_layout_is_that_of_the_reference() {
    let (_folder, path) = Folder::with("a.ply");
    splats::write(&path, &numbered(2, 1), &WriteOptions::default()).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let data = bytes.len() - 2 * 4 * (6 + 3 + 9 + 8);
    let mut expected = "ply\nformat binary_little_endian 1.0\nelement vertex 2\n".to_owned();
    let rest = (0..9).map(|i| format!("f_rest_{i}"));
    let fixed = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"].map(String::from);
    let last =
        ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"].map(String::from);
    for name in fixed.into_iter().chain(rest).chain(last) {
        expected += &format!("property float {name}\n");
    }
    assert_eq!(String::from_utf8_lossy(&bytes[..data]), expected + "end_header\n");
    let row: Vec<f32> = bytes[data..].as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect();
    let gaussians = numbered(2, 1);
    assert_eq!(row[3..6], [0.0; 3]);
    let sh = gaussians.sh_of(0);
    assert_eq!(row[9..12], [sh[1][0], sh[2][0], sh[3][0]]);
    assert_eq!(row[26..29], gaussians.means[1]);
}

#[test]
fn shapes_are_checked_before_writing() {
    let folder = Folder::new();
    let mut gaussians = numbered(3, 1);
    gaussians.sh.pop();
    assert!(splats::write(folder.join("a.ply"), &gaussians, &WriteOptions::default()).is_err());
    assert_eq!(names(&folder), [""; 0]);
}

#[derive(Clone, Debug)]
struct Shape {
    order: Vec<usize>,
    types: Vec<usize>,
    encoding: usize,
    crlf: bool,
    extra: bool,
}

const TYPES: [(&str, usize); 8] = [
    ("float", 4),
    ("double", 8),
    ("float32", 4),
    ("float64", 8),
    ("int", 4),
    ("short", 2),
    ("uint8", 1),
    ("int8", 1),
];

fn shape(properties: usize) -> impl Strategy<Value = Shape> {
    let order = Just((0..properties).collect::<Vec<_>>()).prop_shuffle();
    let types = prop::collection::vec(0..TYPES.len(), properties);
    (order, types, 0..3usize, any::<bool>(), any::<bool>())
        .prop_map(|(order, types, encoding, crlf, extra)| Shape { order, types, encoding, crlf, extra })
}

fn encode(out: &mut Vec<u8>, value: f64, kind: &str, encoding: usize) {
    let start = out.len();
    match kind {
        _ if encoding == 0 => return out.extend(format!("{value} ").bytes()),
        "float" | "float32" => out.extend((value as f32).to_le_bytes()),
        "double" | "float64" => out.extend(value.to_le_bytes()),
        "int" => out.extend((value as i32).to_le_bytes()),
        "short" => out.extend((value as i16).to_le_bytes()),
        "uint8" => out.push(value as u8),
        _ => out.push(value as i8 as u8),
    }
    if encoding == 2 {
        out[start..].reverse();
    }
}

fn file_of(gaussians: &Gaussians, shape: &Shape) -> Vec<u8> {
    let encoding = ["ascii", "binary_little_endian", "binary_big_endian"][shape.encoding];
    let end = if shape.crlf { "\r\n" } else { "\n" };
    let mut header = vec!["ply".to_owned(), format!("format {encoding} 1.0"), "comment by a test".into()];
    if shape.extra {
        header.extend(
            ["element rig 2", "property list uchar short ids", "property double w"].map(String::from),
        );
    }
    header.push(format!("element vertex {}", gaussians.len()));
    let properties = named(gaussians, 0);
    for &place in &shape.order {
        header.push(format!("property {} {}", TYPES[shape.types[place]].0, properties[place].0));
        if shape.extra && place % 5 == 0 {
            header.push(format!("property ushort extra_{place}"));
        }
    }
    header
        .extend(["element face 1", "property list uchar int vertex_indices", "end_header"].map(String::from));
    let mut out = header.iter().flat_map(|line| format!("{line}{end}").into_bytes()).collect::<Vec<u8>>();
    let line_end = |out: &mut Vec<u8>| {
        if shape.encoding == 0 {
            out.extend(end.bytes())
        }
    };
    for length in 0..if shape.extra { 2 } else { 0 } {
        encode(&mut out, length as f64, "uint8", shape.encoding);
        (0..length).for_each(|_| encode(&mut out, 7.0, "short", shape.encoding));
        encode(&mut out, 0.5, "double", shape.encoding);
        line_end(&mut out);
    }
    for index in 0..gaussians.len() {
        let values = named(gaussians, index);
        for &place in &shape.order {
            encode(&mut out, values[place].1.into(), TYPES[shape.types[place]].0, shape.encoding);
            if shape.extra && place % 5 == 0 {
                encode(&mut out, 3.0, "short", shape.encoding);
            }
        }
        line_end(&mut out);
    }
    out
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(60) })]
    #[test]
    fn any_order_type_and_encoding_gives_the_same(
        (degree, shape) in (0..=3u32).prop_flat_map(|d| (Just(d), shape(14 + 3 * ((d + 1) * (d + 1) - 1) as usize))),
    ) {
        let mut gaussians = numbered(5, degree);
        // Integers that every type can hold.
        let whole = |v: &mut f32| *v = (v.abs() * 3.0).round() % 80.0;
        gaussians.quats.as_flattened_mut().iter_mut().for_each(whole);
        for rows in [&mut gaussians.means, &mut gaussians.log_scales, &mut gaussians.sh] {
            rows.as_flattened_mut().iter_mut().for_each(whole);
        }
        gaussians.opacity_logits.iter_mut().for_each(whole);
        let (_folder, path) = Folder::with("a.ply");
        std::fs::write(&path, file_of(&gaussians, &shape)).unwrap();
        prop_assert_eq!(splats::read(&path, &KEEP).unwrap().gaussians, gaussians);
    }

    #[test]
    fn floats_survive_every_encoding(bits in prop::collection::vec(any::<u32>(), 14), encoding in 0..3usize) {
        let value = |i: usize| Some(f32::from_bits(bits[i])).filter(|v| v.abs() < 1e18).unwrap_or(0.25);
        let mut gaussians = numbered(1, 0);
        gaussians.means[0] = [value(0), value(1), value(2)];
        gaussians.quats[0] = [value(3), value(4), value(5), value(6)];
        gaussians.log_scales[0] = [7, 8, 9].map(|i| value(i).clamp(-1e18, 80.0));
        gaussians.opacity_logits[0] = value(10);
        gaussians.sh[0] = [value(11), value(12), value(13)];
        let shape = Shape { order: (0..14).collect(), types: vec![0; 14], encoding, crlf: false, extra: false };
        let (_folder, path) = Folder::with("a.ply");
        std::fs::write(&path, file_of(&gaussians, &shape)).unwrap();
        // A zero quaternion is no rotation.
        if gaussians.quats[0].iter().map(|q| q * q).sum::<f32>().sqrt() <= 1e-12 {
            gaussians.quats[0] = [1.0, 0.0, 0.0, 0.0];
        }
        prop_assert_eq!(splats::read(&path, &KEEP).unwrap().gaussians, gaussians);
    }
}

#[test]
fn no_truncation_gives_a_scene_and_no_mutation_panics() {
    let (_folder, path) = Folder::with("a.ply");
    let check_points = || {
        if let Ok(points) = ply::read_points(&path, &mut Vec::new()) {
            assert_eq!(points.colors.len(), points.len());
        }
    };
    for encoding in 0..3 {
        let shape =
            Shape { order: (0..23).collect(), types: vec![0; 23], encoding, crlf: false, extra: true };
        let bytes = file_of(&numbered(2, 1), &shape);
        for_each_truncation(&path, &bytes, |length| match splats::read(&path, &KEEP) {
            Err(e) => assert!(e.to_string().starts_with(path.to_str().unwrap()), "{e}"),
            // A truncated text may lose digits of its last number unnoticed, or its end of line.
            Ok(scene) => assert!(encoding == 0 && length + 30 > bytes.len() && scene.gaussians.len() == 2),
        });
        for_each_mutation(&path, &bytes, || {
            if let Ok(scene) = splats::read(&path, &DROP) {
                scene.gaussians.check_shapes().unwrap();
                assert!(scene.gaussians.means.as_flattened().iter().all(|v| v.is_finite()));
            }
            check_points();
        });
    }
    let points = PointCloud { positions: vec![[0.0, 1.0, 2.0]; 5], colors: vec![[1, 2, 3]; 5] };
    ply::write_points(&path, &points, &WorldFrame::default()).unwrap();
    for_each_mutation(&path, &std::fs::read(&path).unwrap(), check_points);
}

#[test]
fn unusable_values_are_counted_and_dropped_on_request() {
    let (_folder, path) = Folder::with("a.ply");
    let mut gaussians = numbered(6, 0);
    gaussians.means[1][2] = f32::NAN;
    gaussians.log_scales[3][1] = 89.0;
    gaussians.quats[5][0] = f32::INFINITY;
    gaussians.opacity_logits = vec![f32::INFINITY, 0.0, f32::NEG_INFINITY, 0.0, 1e30, 0.0];
    splats::write(&path, &gaussians, &WriteOptions::default()).unwrap();
    let text = message(&path, &KEEP);
    assert_says(&text, &["3 of 6 Gaussians", "vertex 1: z = NaN"]);
    assert!(text.ends_with("--drop-invalid leaves them out"));
    let scene = splats::read(&path, &DROP).unwrap();
    assert_eq!((scene.dropped, scene.gaussians.len()), (3, 3));
    assert_eq!(scene.gaussians.opacity_logits, [f32::INFINITY, f32::NEG_INFINITY, 1e30]);
    assert_eq!(scene.gaussians.means[2], gaussians.means[4]);
}

const PLACE: [(&str, &str); 3] = [("float", "x"), ("float", "y"), ("float", "z")];

fn text_ply(comments: &[&str], properties: &[(&str, &str)], rows: &str) -> String {
    let comments: String = comments.iter().map(|comment| format!("comment {comment}\n")).collect();
    let header: String = properties.iter().map(|(kind, name)| format!("property {kind} {name}\n")).collect();
    let count = rows.lines().count();
    format!("ply\nformat ascii 1.0\n{comments}element vertex {count}\n{header}end_header\n{rows}")
}

#[test]
fn points_round_trip_and_are_no_gaussians() {
    let (_folder, path) = Folder::with("input.ply");
    let points = PointCloud { positions: vec![[1.5, -2.0, 3e-8]; 100], colors: vec![[0, 127, 255]; 100] };
    ply::write_points(&path, &points, &WorldFrame::default()).unwrap();
    let read = || ply::read_points(&path, &mut Vec::new()).unwrap().in_frame(&WorldFrame::default());
    assert_eq!(read(), points);
    assert!(message(&path, &KEEP).contains("is a point cloud"));
    let integers = ["x", "y", "z"].map(|name| ("int", name));
    std::fs::write(&path, text_ply(&[], &integers, "1 2 3\n")).unwrap();
    assert_eq!(read(), PointCloud { positions: vec![[1.0, 2.0, 3.0]], colors: vec![[255; 3]] });
}

/// Points without finite positions are left out. A file with no other is refused, as is one with a byte-order mark.
#[test]
fn points_without_a_place_are_left_out() {
    let (_folder, path) = Folder::with("a.ply");
    let columns = [PLACE, ["red", "green", "blue"].map(|name| ("uchar", name))].concat();
    let write = |mark: &str, rows: &str| {
        std::fs::write(&path, mark.to_owned() + &text_ply(&[], &columns, rows)).unwrap();
    };
    write("", "nan 0 0 1 2 3\n4 5 6 7 8 9\n");
    let points = ply::read_points(&path, &mut Vec::new()).unwrap().in_frame(&WorldFrame::default());
    assert_eq!(points, PointCloud { positions: vec![[4.0, 5.0, 6.0]], colors: vec![[7, 8, 9]] });
    write("", "nan 0 0 1 2 3\n4 5 inf 7 8 9\n");
    let refused = || refusal(&path, ply::read_points(&path, &mut Vec::new()));
    assert_says(refused(), &["none of its 2 points has a finite position"]);
    write("\u{feff}", "1 2 3 1 2 3\n4 5 6 7 8 9\n");
    assert_says(refused(), &["begins with a byte-order mark"]);
}

#[test]
fn points_have_the_colours_that_their_file_means() {
    let (_folder, path) = Folder::with("a.ply");
    let colors = |names: [&str; 3], kind: &str, rows: &str| {
        let columns = [PLACE, names.map(|name| (kind, name))].concat();
        std::fs::write(&path, text_ply(&[], &columns, rows)).unwrap();
        ply::read_points(&path, &mut Vec::new()).unwrap().colors
    };
    let rgb = ["red", "green", "blue"];
    assert_eq!(colors(rgb, "float", "0 0 0 0 0.2 1\n0 0 0 1 0.5 0\n"), [[0, 51, 255], [255, 128, 0]]);
    assert_eq!(colors(rgb, "double", "0 0 0 0 0.2 1\n0 0 0 1 200 0\n"), [[0, 0, 1], [1, 200, 0]]);
    assert_eq!(colors(rgb, "uchar", "0 0 0 0 1 1\n0 0 0 1 0 0\n"), [[0, 1, 1], [1, 0, 0]]);
    assert_eq!(colors(rgb, "ushort", "0 0 0 0 257 65535\n0 0 0 514 0 0\n"), [[0, 1, 255], [2, 0, 0]]);
    assert_eq!(colors(["r", "g", "b"], "uchar", "0 0 0 3 4 5\n0 0 0 6 7 8\n"), [[3, 4, 5], [6, 7, 8]]);
    let dc = colors(["f_dc_0", "f_dc_1", "f_dc_2"], "float", "0 0 0 0 9 -9\n0 0 0 0.7089816 0 0\n");
    assert_eq!(dc, [[128, 255, 0], [179, 128, 128]]);
}

#[test]
fn files_that_are_something_else_are_named() {
    let (folder, path) = Folder::with("a.ply");
    for (bytes, words) in [
        (&b"version https://git-lfs.github.com/spec/v1\noid sha256:1\n"[..], "is a Git LFS pointer"),
        (b"\n<!DOCTYPE html><html>", "is a web page"),
        (b"<HTML>", "is a web page"),
        (b"\x1f\x8b\x08\0", "is compressed with gzip"),
        (b"PK\x03\x04", "is a ZIP archive"),
        (b"", "is empty"),
        (&[0; 700], "nothing but zeros"),
        (b"hello", "is not a PLY file"),
    ] {
        std::fs::write(&path, bytes).unwrap();
        assert_says(message(&path, &KEEP), &[words]);
    }
    assert!(message(&folder, &KEEP).contains("is not a file"));
    assert!(message(&folder.join("none.ply"), &KEEP).contains("(os error 2)"));
}

fn ascii(comments: &[&str], properties: &[(&str, &str, f64)]) -> String {
    let names: Vec<_> = properties.iter().map(|(kind, name, _)| (*kind, *name)).collect();
    let values: Vec<String> = properties.iter().map(|(.., value)| value.to_string()).collect();
    text_ply(comments, &names, &(values.join(" ") + "\n"))
}

/// All properties of a Gaussian except its colour.
const WITHOUT_COLOUR: [(&str, &str, f64); 11] = [
    ("float", "x", 1.0),
    ("float", "y", 2.0),
    ("float", "z", 3.0),
    ("float", "opacity", 0.5),
    ("float", "scale_0", -2.0),
    ("float", "scale_1", -3.0),
    ("float", "scale_2", -4.0),
    ("float", "rot_0", 1.0),
    ("float", "rot_1", 0.0),
    ("float", "rot_2", 0.0),
    ("float", "rot_3", 0.0),
];

fn with_colour(
    kind: &'static str,
    names: [&'static str; 3],
    values: [f64; 3],
) -> Vec<(&'static str, &'static str, f64)> {
    WITHOUT_COLOUR.into_iter().chain((0..3).map(|i| (kind, names[i], values[i]))).collect()
}

fn whole() -> Vec<(&'static str, &'static str, f64)> {
    with_colour("float", ["f_dc_0", "f_dc_1", "f_dc_2"], [0.0; 3])
}

#[test]
fn colours_are_read_in_place_of_f_dc() {
    let (_folder, path) = Folder::with("rgb.ply");
    for (kind, names, values, white) in [
        ("uchar", ["red", "green", "blue"], [255.0, 51.0, 0.0], 255),
        ("ushort", ["red", "green", "blue"], [65535.0, 13107.0, 0.0], 65535),
        ("float", ["red", "green", "blue"], [1.0, 0.2, 0.0], 1),
        ("double", ["r", "g", "b"], [255.0, 51.0, 0.0], 255),
    ] {
        std::fs::write(&path, ascii(&[], &with_colour(kind, names, values))).unwrap();
        let scene = splats::read(&path, &KEEP).unwrap();
        let colour = scene.gaussians.sh[0].map(ashsplat::scene::sh::sh_dc_to_rgb);
        assert!((0..3).all(|i| (colour[i] - [1.0, 0.2, 0.0][i]).abs() < 1e-5), "{kind}: {colour:?}");
        let line = format!("has no f_dc: its {} (0 to {white}) are used as colours", names.join(" "));
        assert_eq!(scene.warnings.first(), Some(&line));
    }
    // With f_dc, colours are only an addition for other programs.
    let both: Vec<_> = with_colour("float", ["f_dc_0", "f_dc_1", "f_dc_2"], [0.1, 0.2, 0.3])
        .into_iter()
        .chain([("uchar", "red", 9.0), ("uchar", "green", 9.0), ("uchar", "blue", 9.0)])
        .collect();
    std::fs::write(&path, ascii(&[], &both)).unwrap();
    let scene = splats::read(&path, &KEEP).unwrap();
    assert_eq!((scene.gaussians.sh[0], scene.warnings.len()), ([0.1, 0.2, 0.3], 0));
}

#[test]
fn parts_that_are_missing_are_all_named() {
    let (_folder, path) = Folder::with("part.ply");
    for (missing, words) in [
        (&["rot_3"][..], "property rot_3 of element vertex is missing"),
        (&["scale_1", "scale_2"], "properties scale_1, scale_2 of element vertex are missing"),
        (
            &["opacity", "scale_2", "f_dc_1"],
            "properties opacity, scale_2, f_dc_1 of element vertex are missing",
        ),
    ] {
        let left: Vec<_> = whole().into_iter().filter(|(_, name, _)| !missing.contains(name)).collect();
        std::fs::write(&path, ascii(&[], &left)).unwrap();
        assert_says(message(&path, &KEEP), &[words]);
    }
}

/// Warnings about opacities after the sigmoid, colours, sizes, and properties that are not read.
#[test]
fn what_is_taken_otherwise_than_it_may_be_meant_is_named() {
    let (_folder, path) = Folder::with("scene.ply");
    let said_of = |name: &str, values: [f64; 2], count: usize, property: &str| {
        let mut properties = whole();
        if !property.is_empty() {
            properties.push(("float", property, 0.0));
        }
        let row = |row: usize| {
            let value = |(_, own, usual): &(&str, &str, f64)| {
                (if own.starts_with(name) { values[row % 2] } else { *usual }).to_string()
            };
            properties.iter().map(value).collect::<Vec<_>>().join(" ") + "\n"
        };
        let names: Vec<_> = properties.iter().map(|(kind, name, _)| (*kind, *name)).collect();
        std::fs::write(&path, text_ply(&[], &names, &(0..count).map(row).collect::<String>())).unwrap();
        splats::read(&path, &KEEP).unwrap().warnings.first().cloned().unwrap_or_default()
    };
    let said = |opacities, count, property| said_of("opacity", opacities, count, property);
    assert!(said([0.1, 0.9], 20, "").contains("opacities all lie between 0 and 1, but are taken as logits"));
    for (opacities, count) in [([0.1, 0.9], 4), ([-0.1, 0.9], 20), ([0.1, 1.9], 20), ([0.4, 0.5], 20)] {
        assert_eq!(said(opacities, count, ""), "", "{opacities:?}, {count} rows");
    }
    for property in ["trbf_center", "motion_0", "omega_2", "rot_r_0", "scale_t", "scale_3"] {
        let words = format!("property {property} is not used: Gaussians that move or have another shape");
        assert_says(said([-2.0, 2.0], 9, property), &[&words]);
    }
    assert_eq!(said([-2.0, 2.0], 9, "nx"), "");
    assert!(said([-2.0, 2.0], 9, "nu_degree").contains("nu_degree: such properties are not used"));
    let colors =
        "f_dc looks like colours, but is taken as SH coefficients: if that is wrong, export raw values";
    for (name, values, line) in [
        ("f_dc", [0.1, 0.9], colors),
        ("f_dc", [12.0, 240.0], colors),
        ("scale", [0.01, 0.2], "scales look like sizes, but are taken as their logarithms"),
    ] {
        assert_says(said_of(name, values, 20, ""), &[line]);
    }
    let others = [("f_dc", [-0.1, 0.9]), ("f_dc", [0.5, 3.0]), ("scale", [-1.0, 2.0]), ("scale", [1.5, 6.0])];
    for (name, values) in others {
        assert_eq!(said_of(name, values, 20, ""), "", "{name} {values:?}");
    }
}

#[test]
fn bytes_behind_the_gaussians_are_told() {
    let (_folder, path) = Folder::with("two.ply");
    let scene = numbered(5, 0);
    splats::write(&path, &scene, &WriteOptions::default()).unwrap();
    let one = std::fs::read(&path).unwrap();
    std::fs::write(&path, [&one[..], &one].concat()).unwrap();
    let read = splats::read(&path, &KEEP).unwrap();
    let line = format!("{} bytes behind the 5 Gaussians of its header are not read", one.len());
    assert!(read.warnings[0].contains(&line));
}

/// Names and comments of other programs: each gives a warning.
#[test]
fn names_and_comments_of_other_programs_are_used_or_named() {
    let (_folder, path) = Folder::with("a.ply");
    let line = |comments: &[&str], properties: &[_]| {
        std::fs::write(&path, ascii(comments, properties)).unwrap();
        splats::read(&path, &KEEP).unwrap().warnings.first().cloned().unwrap_or_default()
    };
    let filtered = [&whole()[..], &[("float", "filter_3D", 0.1)]].concat();
    assert!(line(&[], &filtered).contains("needs `--antialiasing --kernel-size 0.1`"));
    assert_eq!(line(&["SplatRenderMode: mip"], &filtered), "");
    assert!(line(&["Vertical Axis: z"], &whole()).contains("`--up 0,0,1`"));
    let of_cloud_compare = ascii(&[], &whole()).replace("float opacity", "float scalar_opacity");
    std::fs::write(&path, of_cloud_compare.replace("float scale_", "float scalar_scale_")).unwrap();
    assert_eq!(splats::read(&path, &KEEP).unwrap().gaussians.log_scales[0], [-2.0, -3.0, -4.0]);
}

/// Two scales mean the disks of 2DGS.
#[test]
fn a_scene_of_2dgs_is_read_flat_and_named() {
    let (_folder, path) = Folder::with("2dgs.ply");
    let flat: Vec<_> = whole().into_iter().filter(|(_, name, _)| *name != "scale_2").collect();
    for (comments, properties) in
        [(&[][..], &flat), (&["SplatRenderMode: mip"][..], &flat), (&["SplatRenderMode: 2dgs"], &whole())]
    {
        std::fs::write(&path, ascii(comments, properties)).unwrap();
        let scene = splats::read(&path, &KEEP).unwrap();
        assert!(scene.warnings[0].contains("2DGS"));
        let thickness = if properties.len() == flat.len() { f32::MIN_POSITIVE.ln() } else { -4.0 };
        assert_eq!(scene.gaussians.log_scales[0], [-2.0, -3.0, thickness]);
        assert_eq!(scene.gaussians.quats[0], [1.0, 0.0, 0.0, 0.0]);
    }
}
