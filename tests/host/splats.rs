//! All formats of Gaussians: round trips within each format's quantisation, layouts, damage.

use super::files::{Folder, assert_one, assert_says, for_each_mutation, for_each_truncation, names, refusal};
use crate::common::splats::{Tolerance, assert_close, in_order_of, scene, tolerance};
use ashsplat::scene::{Bounds, Camera, Cells, Cut, Gaussians, Intrinsics, Similarity, WorldFrame};
use ashsplat_files::splats::{
    self, ConvertOptions, Converted, Format, Input, ReadOptions, Scene, Target, WriteOptions,
};
use glam::{DQuat, DVec3, Vec3};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

const KEEP: ReadOptions = ReadOptions { drop_invalid: false, max_host_memory: None };
const DROP: ReadOptions = ReadOptions { drop_invalid: true, max_host_memory: None };

impl Folder {
    fn write(&self, name: &str, gaussians: &Gaussians) -> Option<String> {
        self.write_with(name, gaussians, &WriteOptions::default())
    }

    fn write_with(&self, name: &str, gaussians: &Gaussians, options: &WriteOptions) -> Option<String> {
        splats::write(self.join(name), gaussians, options).unwrap()
    }

    fn read(&self, name: &str) -> Scene {
        splats::read(self.join(name), &KEEP).unwrap()
    }

    fn through(&self, format: Format, gaussians: &Gaussians) -> Scene {
        let name = named("scene", format);
        self.write(&name, gaussians);
        self.read(&name)
    }

    fn refused(&self, name: &str) -> String {
        let path = self.join(name);
        refusal(&path, splats::read(&path, &KEEP))
    }

    fn convert(&self, from: &str, to: &str) -> Converted {
        self.convert_with(from, to, &ConvertOptions::default()).unwrap()
    }

    fn convert_with(&self, from: &str, to: &str, options: &ConvertOptions) -> Result<Converted, String> {
        splats::convert(&self.join(from), &self.join(to), options).map_err(|error| error.to_string())
    }

    /// Two files of the same name, each in a folder of its own.
    fn alike(&self, format: Format) -> [PathBuf; 2] {
        ["a", "b"].map(|folder| {
            std::fs::create_dir_all(self.join(folder)).unwrap();
            self.join(folder).join(named("scene", format))
        })
    }
}

fn named(stem: &str, format: Format) -> String {
    format!("{stem}{}", format.extension())
}

fn antialiased() -> WriteOptions {
    WriteOptions { antialiased: true, ..Default::default() }
}

fn moved(similarity: Similarity) -> ConvertOptions {
    ConvertOptions { similarity, ..Default::default() }
}

/// Gaussians of a file in the order of their originals.
fn in_order(format: Format, expected: &Gaussians, read: Gaussians) -> Gaussians {
    if matches!(format, Format::CompressedPly | Format::Sog) { in_order_of(expected, &read) } else { read }
}

#[test]
fn every_format_reads_what_it_writes() {
    let folder = Folder::new();
    for format in Format::WRITTEN {
        for (count, degree) in [(1, 0), (300, 0), (300, 1), (700, 2), (1000, 3)] {
            let degree = degree.min(format.max_sh_degree());
            let antialiased = degree % 2 == 1 && format.keeps_antialiased();
            let (name, expected) = (named("scene", format), scene(count, degree));
            folder.write_with(&name, &expected, &WriteOptions { antialiased, ..Default::default() });
            let read = folder.read(&name);
            assert_eq!((read.header.format, read.header.antialiased, read.dropped), (format, antialiased, 0));
            assert_eq!(read.warnings, [""; 0]);
            assert_close(&in_order(format, &expected, read.gaussians), &expected, &tolerance(format));
        }
    }
    // One `.bin` beside the `.gltf`, and no temporary files.
    assert_eq!(names(&folder).len(), Format::WRITTEN.len() + 1);
}

#[test]
fn a_second_round_trip_changes_nothing() {
    let folder = Folder::new();
    for format in [Format::Splat, Format::Spz, Format::Glb, Format::Ply] {
        let first = folder.through(format, &scene(400, format.max_sh_degree())).gaussians;
        let drift =
            Tolerance { mean: 0.0, log_scale: 1e-6, opacity: 1e-6, rotation: 2e-5, color: 1e-5, sh: 0.0 };
        assert_close(&folder.through(format, &first).gaussians, &first, &drift);
    }
}

#[test]
fn empty_scenes_and_blocks_of_every_size() {
    let folder = Folder::new();
    for format in [Format::Ply, Format::CompressedPly, Format::Spz] {
        let none = Gaussians { sh_degree: 2, ..Default::default() };
        assert_eq!(folder.through(format, &none).gaussians.len(), 0, "{format}");
    }
    let none = folder.join("none.glb");
    let error = splats::write(none, &Gaussians::default(), &WriteOptions::default()).unwrap_err();
    assert_says(error.to_string(), &["cannot hold a scene without"]);
    for count in [16_383, 16_384, 16_385, 40_000] {
        let expected = scene(count, 0);
        for format in [Format::Ply, Format::Splat, Format::Spz, Format::Gltf] {
            assert_close(&folder.through(format, &expected).gaussians, &expected, &tolerance(format));
        }
    }
}

#[test]
fn conversions_keep_what_both_formats_hold() {
    let folder = Folder::new();
    let expected = scene(500, 3);
    for from in Format::WRITTEN {
        let (input, written) = (named("scene", from), expected.with_sh_degree(from.max_sh_degree()));
        folder.write_with(&input, &written, &antialiased());
        let original = folder.read(&input).gaussians;
        for to in Format::WRITTEN {
            let output = named("out", to);
            let done = folder.convert(&input, &output);
            let degree = from.max_sh_degree().min(to.max_sh_degree());
            assert_eq!((done.written, done.sh_degree, done.format), (500, degree, to));
            let lost = from.max_sh_degree() > degree;
            let antialiased = from.keeps_antialiased() && to.keeps_antialiased();
            let warnings = usize::from(lost) + usize::from(from.keeps_antialiased() && !antialiased);
            assert_eq!(done.warnings.len(), warnings, "{from} to {to}: {:?}", done.warnings);
            let read = folder.read(&output);
            assert_eq!(read.header.antialiased, antialiased, "{from} to {to}");
            let original = original.with_sh_degree(degree);
            assert_close(&in_order(to, &original, read.gaussians), &original, &tolerance(to));
        }
    }
}

#[test]
fn changes_on_the_way() {
    let folder = Folder::new();
    let original = scene(3000, 3);
    folder.write("in.ply", &original);
    let bounds = Bounds { min: Vec3::new(-5.0, -8.0, -9.0), max: Vec3::new(5.0, 8.0, 1.0) };
    let (rotation, translation) = (DQuat::from_rotation_y(0.5), DVec3::new(0.0, 1.0, 2.0));
    let similarity = Similarity { rotation, scale: 3.0, translation };
    let cut = Cut { min_opacity: 0.5, bounds: Some(bounds), min_density: 0.3 };
    let options = ConvertOptions { sh_degree: Some(1), cut, similarity, ..Default::default() };
    let done = folder.convert_with("in.ply", "out.ply", &options).unwrap();
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
    assert!(folder.read("out.ply").gaussians == expected);
    let fewer = ConvertOptions { decimate: Some(Target::Share(0.25)), ..Default::default() };
    assert_eq!(folder.convert_with("in.ply", "out.ply", &fewer).unwrap().written, 750);
    let cut = Cut { min_opacity: 1.0, ..Default::default() };
    let nothing = ConvertOptions { cut, ..Default::default() };
    let done = folder.convert_with("in.ply", "out.ply", &nothing).unwrap();
    assert_eq!((done.written, done.warnings.len()), (0, 1));
}

#[test]
fn a_cut_scene_is_written_as_a_conversion_writes_it() {
    let folder = Folder::new();
    let original = scene(40_000, 3);
    let input = folder.join("in.ply");
    folder.write_with("in.ply", &original, &antialiased());
    let (min, max) = (Vec3::splat(f32::NEG_INFINITY), Vec3::new(4.0, f32::INFINITY, 6.0));
    let cut = Cut { min_opacity: 0.2, bounds: Some(Bounds { min, max }), min_density: 0.3 };
    let limits = cut.limits();
    let mut kept = original.clone().with_sh_degree(2);
    kept.retain(|all, index| limits.keeps(all, index));
    assert!(kept.len() > 1000 && kept.len() < 39_000);
    for format in Format::WRITTEN {
        let [converted, written] = folder.alike(format);
        let options = ConvertOptions { sh_degree: Some(2), cut, ..Default::default() };
        let done = splats::convert(&input, &converted, &options).unwrap();
        splats::write_changed(&written, &kept, &antialiased()).unwrap();
        assert_eq!(done.written, kept.len() as u64, "{format}");
        assert!(std::fs::read(&converted).unwrap() == std::fs::read(&written).unwrap(), "{format}");
    }
    let (odd, path) = (Cut { min_opacity: 2.0, ..Default::default() }, folder.join("odd.ply"));
    assert!(splats::convert(&input, &path, &ConvertOptions { cut: odd, ..Default::default() }).is_err());
    assert!(!path.exists());
}

/// Each part has the whole scene; the merge takes its cell of each.
#[test]
fn merged_cells_are_the_scene() {
    let folder = Folder::new();
    let original = scene(10_000, 2);
    let cells = Cells::divide(&original.means, 2_200).unwrap();
    let input = folder.join("in.ply");
    folder.write_with("in.ply", &original, &antialiased());
    let part = |within: &Bounds| Input { within: Some(*within), ..Input::new(&input) };
    let parts: Vec<Input<'_>> = cells.bounds().iter().map(part).collect();
    assert!(parts.len() > 4);
    let merge = |parts: &[Input<'_>], output: &Path, read: &ReadOptions| {
        let options = ConvertOptions { read: *read, ..Default::default() };
        splats::join(parts, output, &options).map_err(|error| error.to_string())
    };
    let cell_of = |index: &usize| cells.at(Vec3::from_array(original.means[*index])).unwrap();
    let mut order: Vec<usize> = (0..original.len()).collect();
    order.sort_by_key(cell_of);
    let expected = original.select(&order);
    for format in Format::WRITTEN {
        let [merged, written] = folder.alike(format);
        let done = merge(&parts, &merged, &KEEP).unwrap();
        assert_eq!((done.format, done.written), (format, 10_000));
        splats::write_changed(&written, &expected, &antialiased()).unwrap();
        assert!(std::fs::read(&merged).unwrap() == std::fs::read(&written).unwrap(), "{format}");
    }
    // Many cells need no more memory than one.
    let [few, many] = [10_000, 130].map(|max_gaussians| {
        let cells = Cells::divide(&original.means, max_gaussians).unwrap();
        let parts: Vec<Input<'_>> = cells.bounds().iter().map(part).collect();
        let work = || drop(merge(&parts, &folder.join("memory.ply"), &KEEP).unwrap());
        (parts.len(), allocation_counter::measure(work).bytes_max)
    });
    assert!(few.0 == 1 && many.0 > 60 && many.1 < few.1 + few.1 / 10, "{few:?} {many:?}");
    // Parts that do not fit together, and no parts.
    let (other, output) = (folder.join("other.ply"), folder.join("none.ply"));
    let refused = |words: &str| {
        let parts = [parts[0], Input { within: Some(Cells::EVERYTHING), ..Input::new(&other) }];
        let refused = merge(&parts, &output, &KEEP).unwrap_err();
        assert!(refused.starts_with(other.to_str().unwrap()) && !output.exists(), "{refused}");
        assert_says(refused, &[words]);
    };
    folder.write_with("other.ply", &original.with_sh_degree(1), &antialiased());
    refused("SH degree 1, with antialiasing");
    folder.write("other.ply", &original);
    refused("SH degree 2, without antialiasing");
    let bytes = folder.bytes("in.ply");
    folder.put("other.ply", &bytes[..bytes.len() - 9]);
    refused("");
    assert!(merge(&[], &output, &KEEP).is_err());
    // One Gaussian that is not finite, in the box that holds all.
    let mut broken = original.clone();
    broken.log_scales[7][1] = f32::NAN;
    folder.write_with("other.ply", &broken, &antialiased());
    refused("--drop-invalid");
    let all = [Input { within: Some(Cells::EVERYTHING), ..Input::new(&other) }];
    let done = merge(&all, &output, &DROP).unwrap();
    assert_eq!(done.taken, [9_999]);
    assert_one(&done.warnings, &["scale_1 = NaN is not finite"]);
}

fn with_comments(bytes: &[u8], comments: &[&str]) -> Vec<u8> {
    const FORMAT: &[u8] = b"ply\nformat binary_little_endian 1.0\n";
    let own: Vec<u8> = comments.iter().flat_map(|line| format!("comment {line}\n").into_bytes()).collect();
    [FORMAT, &own, &bytes[FORMAT.len()..]].concat()
}

/// Comments of Brush, gsplat, splat-transform, Postshot and web-splat; the last one counts.
#[test]
fn marks_of_other_programs_are_read_and_kept() {
    let folder = Folder::new();
    for format in [Format::Ply, Format::CompressedPly] {
        let name = named("scene", format);
        folder.write(&name, &scene(9, 0));
        let bytes = folder.bytes(&name);
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
            folder.put(&name, with_comments(&bytes, comments));
            let read = folder.read(&name);
            let marks = (read.header.antialiased, read.header.kernel_size);
            assert_eq!(marks, (antialiased, kernel_size), "{comments:?}");
            let said = read.warnings.concat();
            assert!(said.is_empty() == word.is_empty() && said.contains(word), "{comments:?}: {said}");
            for to in Format::WRITTEN {
                let output = named("out", to);
                let done = folder.convert(&name, &output);
                let keeps_size = !matches!(to, Format::Splat | Format::Spz | Format::Sog | Format::Usda);
                let header = splats::header(folder.join(&output), &KEEP).unwrap();
                assert_eq!(header.antialiased, antialiased && to.keeps_antialiased(), "{to}");
                assert_eq!(header.kernel_size, kernel_size.filter(|_| keeps_size), "{to}");
                let is_told = done.warnings.iter().any(|line| line.ends_with("--kernel-size 0.1"));
                assert_eq!(is_told, kernel_size.is_some() && !keeps_size, "{to}: {:?}", done.warnings);
            }
        }
    }
    // The form that Brush and splat-transform read.
    folder.write_with("own.ply", &scene(1, 0), &WriteOptions { kernel_size: Some(0.1), ..antialiased() });
    let header = String::from_utf8_lossy(&folder.bytes("own.ply")).into_owned();
    assert_says(header, &["\ncomment SplatRenderMode: mip\ncomment kernel_size=0.1\n"]);
}

/// PLYs keep the mark of 2DGS; a warning names it when another format loses it.
#[test]
fn a_scene_of_2dgs_stays_one() {
    let folder = Folder::new();
    let marked = WriteOptions { is_2dgs: true, ..Default::default() };
    folder.write_with("disks.ply", &scene(9, 0), &marked);
    for to in Format::WRITTEN {
        let output = named("out", to);
        let done = folder.convert("disks.ply", &output);
        let keeps = matches!(to, Format::Ply | Format::CompressedPly);
        assert_eq!(splats::header(folder.join(output), &KEEP).unwrap().is_2dgs, keeps, "{to}");
        let is_told = done.warnings.iter().any(|line| line.contains("cannot say that this is a 2DGS scene"));
        assert_eq!(is_told, !keeps, "{:?}", done.warnings);
    }
}

/// A zero quaternion means no rotation, and a move turns it like others.
#[test]
fn quaternions_of_zeros_are_counted() {
    let folder = Folder::new();
    let rotation = DQuat::from_rotation_x(0.5);
    for format in [Format::Ply, Format::Splat] {
        let [input, output] = ["in", "out"].map(|stem| named(stem, format));
        let mut gaussians = scene(9, 0);
        gaussians.quats[4] = [0.0; 4];
        folder.write(&input, &gaussians);
        if format == Format::Splat {
            // The writer of .splat never writes zeros.
            let mut bytes = folder.bytes(&input);
            bytes[32 * 4 + 28..32 * 5].fill(128);
            folder.put(&input, bytes);
        }
        let read = folder.read(&input);
        assert_eq!(read.gaussians.quats[4], [1.0, 0.0, 0.0, 0.0]);
        let line = "1 of 9 Gaussians have a quaternion of zeros and are used without rotation";
        assert_eq!(read.warnings, [line], "{format}");
        let turned = moved(Similarity { rotation, ..Default::default() });
        let done = folder.convert_with(&input, &output, &turned).unwrap();
        assert!(done.warnings.iter().any(|warning| warning == line), "{:?}", done.warnings);
        let [w, x, ..] = folder.read(&output).gaussians.quats[4].map(f64::from);
        assert!((w - rotation.w).abs() < 0.01 && (x - rotation.x).abs() < 0.01);
    }
}

/// Floats at UTM coordinates have steps of 0.5. Doubles and larger Gaussians do not show them.
#[test]
fn positions_that_single_precision_has_rounded_are_named() {
    let folder = Folder::new();
    let mut gaussians = scene(300, 0);
    gaussians.log_scales.as_flattened_mut().fill(-4.0);
    gaussians.means.iter_mut().for_each(|mean| mean[1] += 5_000_000.0);
    let mut large = gaussians.clone();
    large.log_scales.as_flattened_mut().fill(1.0);
    for format in [Format::Ply, Format::CompressedPly, Format::Splat, Format::Glb] {
        let warnings = |gaussians: &Gaussians| folder.through(format, gaussians).warnings;
        let words = "positions are rounded to steps of about 0.50 (a typical size is 0.018)";
        assert_one(&warnings(&gaussians), &[words]);
        assert_eq!(warnings(&large), [""; 0], "{format}");
    }
}

/// SPZ holds -1 to 1, compressed PLY -4 to 4.
#[test]
fn spherical_harmonics_that_are_cut_are_counted() {
    let folder = Folder::new();
    let mut gaussians = scene(100, 1);
    for index in 0..30 {
        gaussians.sh[4 * index + 2][1] = if index < 10 { 5.0 } else { -1.5 };
    }
    for (name, words) in [
        ("a.spz", "SH coefficients above degree 0 of 30 of 100 Gaussians are beyond -1 to 1 and are cut"),
        ("a.compressed.ply", "of 10 of 100 Gaussians are beyond -4 to 4 and are cut"),
        ("a.ply", ""),
    ] {
        let loss = folder.write(name, &gaussians);
        assert_eq!(loss.is_some(), !words.is_empty(), "{loss:?}");
        assert!(loss.is_none_or(|line| line.contains(words)), "{name}");
    }
    assert_eq!(folder.write("a.spz", &scene(100, 1)), None);
}

/// An editor dropped the comments of a model folder's PLY; its cameras.json still has the frame.
#[test]
fn a_models_cameras_tell_the_frame_that_a_ply_has_lost() {
    let folder = Folder::new();
    let ply = "model/point_cloud/iteration_7/point_cloud.ply";
    folder.put(ply, "");
    let frame = WorldFrame { origin: DVec3::new(500_000.0, 5_000_000.0, 120.0), unit: 100.0 };
    let intrinsics = Intrinsics::from_fov_x(0.8, 64, 48);
    let camera = Camera::look_at(Vec3::new(0.0, 0.0, -9.0), Vec3::ZERO, Vec3::NEG_Y, intrinsics);
    let write_cameras = |frame: &WorldFrame| {
        let path = folder.join("model/cameras.json");
        ashsplat_files::cameras_json::write(path, [("a", &camera)], frame).unwrap();
    };
    write_cameras(&frame);
    let write = |format: Format, frame: WorldFrame, gaussians: &Gaussians| {
        let options = WriteOptions { format: Some(format), frame, ..Default::default() };
        folder.write_with(ply, gaussians, &options);
        let read = folder.read(ply);
        ((read.header.origin, read.header.unit), read.warnings)
    };
    let gaussians = scene(300, 0);
    for format in [Format::Ply, Format::CompressedPly] {
        let (whole, said) = write(format, frame, &gaussians);
        assert_eq!((whole, said), ((frame.origin, Some(100.0)), Vec::new()));
        let (restored, said) = write(format, WorldFrame::default(), &gaussians);
        assert_eq!(restored, whole, "{format}");
        assert_one(&said, &["names no origin 500000,5000000,120 and unit 100: ", "cameras.json"]);
        // Absolute positions, with Gaussians so large that single precision suffices.
        let mut absolute = gaussians.clone();
        absolute.log_scales.as_flattened_mut().fill(2.0);
        for mean in &mut absolute.means {
            *mean = [0, 1, 2].map(|axis| mean[axis] + frame.origin[axis] as f32);
        }
        let (kept, said) = write(format, WorldFrame::default(), &absolute);
        assert_eq!(kept.0, DVec3::ZERO);
        assert_says(said.concat(), &["names no unit 100"]);
    }
    // cameras.json has no origin and no unit if the frame is the default.
    write_cameras(&WorldFrame::default());
    let plain = write(Format::Ply, WorldFrame::default(), &gaussians);
    assert_eq!(plain, ((DVec3::ZERO, None), Vec::new()));
}

/// A log-scale of -∞ in PLY, a 0 in .splat and glTF, an infinite range in compressed PLY.
#[test]
fn size_0_is_a_size() {
    let folder = Folder::new();
    let mut flat = scene(5, 0);
    flat.log_scales.iter_mut().for_each(|log_scale| log_scale[2] = f32::NEG_INFINITY);
    for format in [Format::Ply, Format::Splat, Format::Glb, Format::Gltf] {
        let name = named("flat", format);
        folder.write(&name, &flat);
        let read = folder.read(&name).gaussians;
        assert!(read.log_scales.iter().all(|s| s[2] == f32::MIN_POSITIVE.ln() && s[0] > -6.0));
        assert_eq!(splats::read(folder.join(name), &DROP).unwrap().dropped, 0, "{format}");
    }
    let name = "flat.compressed.ply";
    folder.write(name, &scene(5, 0));
    let mut bytes = folder.bytes(name);
    let chunk = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    bytes[chunk + 4 * 8..][..4].copy_from_slice(&f32::NEG_INFINITY.to_le_bytes());
    folder.put(name, bytes);
    let read = folder.read(name);
    assert_says(read.warnings.concat(), &["sizes are lost in 1 of 1 chunks"]);
    assert_eq!(read.gaussians.len(), 5);
}

/// If no Gaussian is usable, dropping invalid ones leaves no scene.
#[test]
fn dropping_every_gaussian_is_an_error() {
    let folder = Folder::new();
    let mut broken = scene(3, 0);
    broken.log_scales.as_flattened_mut().fill(f32::NAN);
    for format in [Format::Ply, Format::Splat, Format::Glb] {
        let name = named("broken", format);
        folder.write(&name, &broken);
        let error = splats::read(folder.join(&name), &DROP).unwrap_err().to_string();
        assert_says(error, &["3 of 3 Gaussians have", "none is left"]);
        let options = ConvertOptions { read: DROP, ..Default::default() };
        assert!(folder.convert_with(&name, "out.ply", &options).is_err(), "{format}");
        assert!(!folder.join("out.ply").exists(), "{format}");
    }
}

/// The `.gltf` cannot be written, because the name of its temporary file is too long. The previous scene stays
/// intact.
#[cfg(unix)]
#[test]
fn a_gltf_keeps_its_scene_until_the_new_one_is_there() {
    let (folder, path) = Folder::with("scene.gltf");
    let (old, new) = (scene(20, 0), scene(30, 1));
    for (gaussians, binary) in [(&old, "scene.bin"), (&new, "scene.1.bin"), (&old, "scene.bin")] {
        folder.write("scene.gltf", gaussians);
        assert_eq!(names(&folder), [binary, "scene.gltf"]);
        assert_eq!(folder.read("scene.gltf").gaussians.len(), gaussians.len());
    }
    let target = "x".repeat(250);
    std::fs::rename(&path, folder.join(&target)).unwrap();
    std::os::unix::fs::symlink(folder.join(&target), &path).unwrap();
    assert_says(refusal(&path, splats::write(&path, &new, &WriteOptions::default())), &["cannot write"]);
    assert_eq!(names(&folder), ["scene.bin", "scene.gltf", &target]);
    assert_eq!(folder.read("scene.gltf").gaussians.len(), 20);
}

/// Writers refuse the same values as readers.
#[test]
fn what_cannot_be_read_again_is_not_written() {
    let folder = Folder::new();
    let mut edge = scene(300, 1);
    edge.log_scales.as_flattened_mut().fill(87.9);
    folder.write("in.ply", &edge);
    let moved = |scale: f64, x: f64| {
        moved(Similarity { scale, translation: DVec3::new(x, 0.0, 0.0), ..Default::default() })
    };
    let merged = ConvertOptions { decimate: Some(Target::Share(0.1)), ..Default::default() };
    for format in Format::WRITTEN {
        for options in [&moved(1e38, 0.0), &moved(1e30, 0.0), &moved(2.0, 0.0), &moved(1.0, 3e38), &merged] {
            let error = folder.convert_with("in.ply", &named("out", format), options).unwrap_err();
            let is_said = error.contains("is not written: a Gaussian would have");
            assert!(is_said || error.contains("too far out for SPZ"), "{error}");
        }
        assert_eq!(names(&folder), ["in.ply"], "{format}");
    }
    // A valid scene moves to another origin, which has a limit, too.
    folder.write("near.ply", &scene(20, 0));
    for format in Format::WRITTEN {
        let error = folder.convert_with("near.ply", &named("out", format), &moved(1.0, 3e38)).unwrap_err();
        assert_says(error, &["is not written: its positions would lie 3e38 from zero"]);
    }
    assert_eq!(names(&folder), ["in.ply", "near.ply"]);
    folder.convert_with("in.ply", "out.ply", &moved(1.0, 1e17)).unwrap();
    folder.read("out.ply");
}

#[test]
fn scenes_are_joined() {
    let folder = Folder::new();
    let (mut first, mut second) = (scene(20_000, 0), scene(300, 2));
    // After the turn, the values stay within the range of SPZ.
    second.sh.as_flattened_mut().iter_mut().for_each(|value| *value *= 0.5);
    folder.write("a.ply", &first);
    folder.write("b.glb", &second);
    let (rotation, translation) = (DQuat::from_rotation_z(1.0), DVec3::new(5.0, 0.0, 0.0));
    let moved = Similarity { rotation, scale: 2.0, translation };
    let everything = Similarity { scale: 0.5, ..Default::default() };
    let [a, b] = ["a.ply", "b.glb"].map(|name| folder.join(name));
    let inputs = [Input::new(&a), Input { similarity: moved, ..Input::new(&b) }];
    first = first.with_sh_degree(2);
    first.transform(&everything);
    second.transform(&moved);
    second.transform(&everything);
    first.append(&second);
    let options = self::moved(everything);
    for format in Format::WRITTEN {
        let output = named("out", format);
        let done = splats::join(&inputs, &folder.join(&output), &options).unwrap();
        let degree = 2.min(format.max_sh_degree());
        assert_eq!((done.written, done.sh_degree), (20_300, degree), "{format}");
        if !matches!(format, Format::CompressedPly | Format::Sog) {
            let own = tolerance(format);
            let tolerance = Tolerance {
                mean: own.mean.max(1e-5),
                log_scale: own.log_scale.max(1e-5),
                opacity: own.opacity.max(1e-5),
                rotation: own.rotation.max(1e-5),
                color: own.color.max(1e-4),
                sh: own.sh.max(1e-4),
            };
            assert_close(&folder.read(&output).gaussians, &first.with_sh_degree(degree), &tolerance);
        }
    }
    let fewer = ConvertOptions { decimate: Some(Target::Count(200)), ..Default::default() };
    let small = [Input { similarity: moved, ..Input::new(&b) }; 2];
    assert_eq!(splats::join(&small, &folder.join("few.ply"), &fewer).unwrap().written, 200);
    // The files have marks that one file cannot have for both.
    folder.write_with("b.glb", &scene(300, 2), &antialiased());
    let output = folder.join("none.ply");
    let error = splats::join(&inputs, &output, &options).unwrap_err().to_string();
    assert!(error.contains("b.glb: was trained with antialiasing, ") && !output.exists(), "{error}");
    assert!(splats::join(&[], &output, &options).is_err());
}

#[test]
fn refused_input_leaves_the_output_alone() {
    let folder = Folder::new();
    let mut bad = scene(10, 0);
    bad.means[4][1] = f32::NAN;
    folder.write("in.ply", &bad);
    folder.put("out.spz", "old");
    let error = folder.convert_with("in.ply", "out.spz", &ConvertOptions::default()).unwrap_err();
    assert_says(error, &["1 of 10 Gaussian has", "vertex 4: y = NaN"]);
    assert_eq!(folder.bytes("out.spz"), b"old");
    assert_eq!(names(&folder), ["in.ply", "out.spz"]);
    let dropped = ConvertOptions { read: DROP, ..Default::default() };
    assert_eq!(folder.convert_with("in.ply", "out.spz", &dropped).unwrap().written, 9);
    let far = Similarity { scale: 1e7, ..Default::default() };
    let options = ConvertOptions { read: DROP, similarity: far, ..Default::default() };
    let error = folder.convert_with("in.ply", "out.spz", &options).unwrap_err();
    assert_says(error, &["too far out for SPZ"]);
    let unknown = folder.convert_with("in.ply", "out.xyz", &dropped).unwrap_err();
    assert_says(unknown, &["out.xyz: has no extension of a known format; give it one of .ply"]);
}

/// Outliers in position and colour have separate chunks: the others keep their precision, and the file keeps its
/// count.
#[test]
fn outliers_do_not_coarsen_compressed_ply() {
    let folder = Folder::new();
    let name = "scene.compressed.ply";
    let plain = scene(700, 1);
    folder.write(name, &plain);
    let bytes = folder.bytes(name).len();
    let mut odd = plain.clone();
    odd.means[3] = [2e5, 1.0, 0.0];
    odd.means[4] = [-3e3, 0.0, 7.0];
    odd.sh[350 * 4] = [800.0, 0.0, 0.0];
    folder.write(name, &odd);
    assert!(folder.bytes(name).len() > bytes, "padded");
    let read = folder.read(name);
    assert_eq!((read.header.count, read.gaussians.len()), (700, 700));
    let actual = in_order_of(&odd, &read.gaussians);
    let others: Vec<usize> = (0..odd.len()).filter(|index| ![3, 4, 350].contains(index)).collect();
    assert_close(&actual.select(&others), &odd.select(&others), &tolerance(Format::CompressedPly));
    assert!((actual.means[3][0] - 2e5).abs() < 1.0 && (actual.means[4][0] + 3e3).abs() < 1.0);
    // Without the outliers, a conversion needs no padding.
    assert_eq!(folder.convert(name, "scene.ply").written, 700);
}

/// SPZ uses the bits that fit the scene, and a warning names values that a format cannot hold.
#[test]
fn formats_go_by_the_size_of_the_scene() {
    let folder = Folder::new();
    let warnings = |scene: &Gaussians, format: Format| {
        folder.write("scene.ply", scene);
        let done = folder.convert("scene.ply", &named("scene", format));
        let losses = splats::losses(format, scene, &WriteOptions::default()).unwrap();
        assert_eq!(done.warnings, losses);
        losses
    };
    let mut small = scene(300, 0);
    small.transform(&Similarity { scale: 1e-3, ..Default::default() });
    assert_one(&warnings(&small, Format::Spz), &["are beyond 0.000045 to 379 and are cut"]);
    let actual = folder.read("scene.spz").gaussians;
    for (mean, expected) in actual.means.iter().zip(&small.means) {
        assert!((0..3).all(|axis| (mean[axis] - expected[axis]).abs() < 1e-6), "{mean:?}, not {expected:?}");
    }
    let mut far = scene(300, 0);
    assert_eq!(warnings(&far, Format::Spz), [""; 0]);
    far.means[7] = [0.0, 6e6, 0.0];
    assert_one(&warnings(&far, Format::Spz), &["because one lies at 6000000: crop"]);
    far.log_scales[7] = [21.0; 3];
    assert_one(&warnings(&far, Format::CompressedPly), &["sizes of 1 of 300 Gaussians"]);
    assert_eq!(warnings(&far, Format::Glb), [""; 0]);
    // Far away, SPZ has fewer fractional bits, and does not wrap around.
    let mut distant = scene(20, 0);
    distant.means[3] = [-250_000.0, 7.5, 2.25];
    folder.write("far.spz", &distant);
    let coarse = Tolerance { mean: 0.5 / 32.0, ..tolerance(Format::Spz) };
    assert_close(&folder.read("far.spz").gaussians, &distant, &coarse);
    // A road: long, flat, and fine.
    let mut road = scene(5000, 0);
    road.log_scales.fill([0.02_f32.ln(); 3]);
    for (k, mean) in (0..).zip(&mut road.means) {
        *mean = [k as f32, 0.3 * (k % 40) as f32, 0.1 * (k % 7) as f32];
    }
    assert_one(&warnings(&road, Format::CompressedPly), &["steps of 0.1", "256 Gaussians"]);
    road.log_scales.fill([0.0; 3]);
    assert_eq!(warnings(&road, Format::CompressedPly), [""; 0]);
    let mut bright = scene(300, 0);
    bright.sh[..20].fill([4.0; 3]);
    for format in [Format::Spz, Format::Splat] {
        assert_one(&warnings(&bright, format), &["colours of 20 of 300 Gaussians are cut"]);
    }
    bright.sh.fill([-2.0; 3]);
    assert_eq!(warnings(&bright, Format::Splat), [""; 0], "black either way");
}

#[test]
fn no_truncation_gives_a_scene_and_no_mutation_panics() {
    let folder = Folder::new();
    for format in Format::WRITTEN {
        let name = named("scene", format);
        let path = folder.join(&name);
        folder.write(&name, &scene(3, 1.min(format.max_sh_degree())));
        let bytes = folder.bytes(&name);
        for_each_truncation(&path, &bytes, |length| {
            let is_whole = match format {
                // In a format without a header, any whole number of rows is a file.
                Format::Splat => length > 0 && length % 32 == 0,
                // The end of the last line says nothing.
                Format::Usda => length + 1 == bytes.len(),
                _ => false,
            };
            if !is_whole {
                folder.refused(&name);
            }
        });
        for_each_mutation(&path, &bytes, || match splats::read(&path, &DROP) {
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
    let folder = Folder::new();
    for format in [Format::Ply, Format::CompressedPly, Format::Spz, Format::Glb] {
        for name in ["scene", "scene.splat", "point_cloud.ply"] {
            let options = WriteOptions { format: Some(format), ..Default::default() };
            folder.write_with(name, &scene(5, 0), &options);
            assert_eq!(folder.read(name).header.format, format, "{name}");
        }
    }
    folder.put("scene.obj", "v 1 2 3");
    let words = "is no file of Gaussians that is known; known are .ply .compressed.ply";
    assert_says(folder.refused("scene.obj"), &[words]);
    assert_says(refusal(&folder, splats::read(&folder, &KEEP)), &["is not a file"]);
}

fn changed_gltf(folder: &Folder, count: usize, change: impl FnOnce(&mut Value)) {
    folder.write("scene.gltf", &scene(count, 0));
    let mut document: Value = serde_json::from_slice(&folder.bytes("scene.gltf")).unwrap();
    change(&mut document);
    folder.put("scene.gltf", document.to_string());
}

/// A glTF may place a mesh at many nodes, but a small file must not claim a scene that fills the memory.
#[test]
fn gltf_places_its_gaussians_a_limited_number_of_times() {
    let folder = Folder::new();
    let placed = |count: usize, nodes: usize, primitives: usize| {
        changed_gltf(&folder, count, |document| {
            let mesh = &mut document["meshes"][0]["primitives"];
            *mesh = vec![mesh[0].clone(); primitives].into();
            document["nodes"] = vec![json!({ "mesh": 0 }); nodes].into();
            document["scenes"][0]["nodes"] = (0..nodes).collect();
        });
    };
    placed(5, 300, 2);
    assert_eq!(folder.read("scene.gltf").gaussians.len(), 3000);
    // 10^9 Gaussians from 560 kB; more and more of them at each node; only placements.
    for (count, nodes, primitives) in [(10_000, 100_000, 1), (10_000, 300, 300), (1, 1000, 1000)] {
        placed(count, nodes, primitives);
        assert_says(folder.refused("scene.gltf"), &["again and again", "16 times"]);
    }
}

#[test]
fn a_gltf_of_other_programs_is_read_as_it_says_or_named() {
    let folder = Folder::new();
    let warns = |words: &str, change: &dyn Fn(&mut Value, &mut Value)| {
        changed_gltf(&folder, 5, |document| {
            let mut primitives = document["meshes"][0]["primitives"].take();
            change(document, &mut primitives);
            document["meshes"][0]["primitives"] = primitives;
        });
        let header = splats::header(folder.join("scene.gltf"), &ReadOptions::default());
        let warnings = header.unwrap().warnings.join("\n");
        assert_eq!(warnings.is_empty(), words.is_empty(), "{warnings}");
        assert_says(warnings, &[words]);
    };
    warns("", &|_, _| {});
    warns("requires EXT_mesh_gpu_instancing, which is not read", &|document, _| {
        document["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
    });
    for (key, value, words) in [
        ("kernel", "student", "\"student\" is drawn as an ellipse"),
        ("colorSpace", "wide", "\"wide\" are used as sRGB"),
    ] {
        warns(words, &|_, primitives| {
            primitives[0]["extensions"]["KHR_gaussian_splatting"][key] = value.into();
        });
    }
    warns("1 primitives that are no Gaussians are not used", &|_, primitives| {
        primitives.as_array_mut().unwrap().push(json!({ "attributes": {} }));
    });
    // Logarithms instead of sizes, and logits instead of opacities: some values are negative and far from 0.
    changed_gltf(&folder, 5, |document| {
        let attributes = &mut document["meshes"][0]["primitives"][0]["attributes"];
        attributes["KHR_gaussian_splatting:SCALE"] = attributes["POSITION"].clone();
    });
    assert_says(folder.refused("scene.gltf"), &["SCALE has values below 0"]);
    changed_gltf(&folder, 5, |document| {
        let attributes = &document["meshes"][0]["primitives"][0]["attributes"];
        let position = attributes["POSITION"].as_u64().unwrap() as usize;
        let accessors = document["accessors"].as_array_mut().unwrap();
        let mut first = accessors[position].clone();
        first["type"] = json!("SCALAR");
        accessors.push(first);
        let last = accessors.len() - 1;
        document["meshes"][0]["primitives"][0]["attributes"]["KHR_gaussian_splatting:OPACITY"] = json!(last);
    });
    assert_says(folder.refused("scene.gltf"), &["OPACITY has values outside of 0 to 1"]);
}

/// A corner of a UTM zone. Single precision has steps of 0.5 there.
const UTM: DVec3 = DVec3::new(500_000.3, 4_600_000.7, 120.0);

/// A PLY with double positions, as survey programs write it.
fn ply_of_doubles(gaussians: &Gaussians, offset: DVec3) -> Vec<u8> {
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
    bytes
}

/// Positions relative to an offset; x in ascending order, since compressed PLY is sorted.
fn positions(scene: &Scene, offset: DVec3) -> Vec<DVec3> {
    let means = scene.gaussians.means.iter();
    let mut all: Vec<DVec3> =
        means.map(|&mean| scene.frame.source(Vec3::from_array(mean)) - offset).collect();
    all.sort_by(|a, b| a.x.total_cmp(&b.x));
    all
}

#[test]
fn scenes_far_from_the_origin_keep_their_positions_in_every_format() {
    let folder = Folder::new();
    let gaussians = scene(300, 0);
    folder.put("utm.ply", ply_of_doubles(&gaussians, UTM));
    folder.write("near.ply", &gaussians);
    let expected = positions(&folder.read("near.ply"), DVec3::ZERO);
    for format in Format::WRITTEN {
        let there = named("far", format);
        let done = folder.convert("utm.ply", &there);
        folder.convert(&there, "back.ply");
        for name in [&there, "back.ply"] {
            let far = positions(&folder.read(name), UTM);
            let off = far.iter().zip(&expected).map(|(a, b)| (a.x - b.x).abs()).fold(0.0, f64::max);
            let bound = f64::from(tolerance(format).mean.max(1e-5));
            assert!(far.len() == 300 && off <= bound, "{there}, {name}: {off}");
        }
        // If other programs would place it elsewhere, a warning says so.
        match format {
            Format::Ply | Format::Glb | Format::Gltf | Format::Usda => assert_eq!(done.warnings, [""; 0]),
            _ => assert_one(&done.warnings, &["relative to 500000,4600000,"]),
        }
    }
    let text = String::from_utf8_lossy(&folder.bytes("far.ply")[..200]).into_owned();
    assert!(text.contains("property double x") && !text.contains("comment origin"), "{text}");
    // A new scene of the same name has no origin file any more.
    folder.convert("near.ply", "far.spz");
    assert!(!folder.join("far.spz.origin.json").exists() && folder.join("far.splat.origin.json").exists());
    folder.put("far.splat.origin.json", r#"{"origin": [1, 2]}"#);
    let error = splats::read(folder.join("far.splat"), &KEEP).unwrap_err().to_string();
    assert_says(error, &["far.splat.origin.json: is no origin"]);
}

#[test]
fn changes_of_distant_scenes_are_made_in_their_own_coordinates() {
    let folder = Folder::new();
    let gaussians = scene(500, 0);
    folder.write("near.ply", &gaussians);
    let moved = |translation| moved(Similarity { translation, ..Default::default() });
    folder.convert_with("near.ply", "far.ply", &moved(UTM)).unwrap();
    let expected = positions(&folder.read("near.ply"), DVec3::ZERO);
    let off = |scene: &Scene, offset: DVec3| {
        let far = positions(scene, offset);
        far.iter().zip(&expected).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
    };
    assert!(off(&folder.read("far.ply"), UTM) < 1e-5);
    // Back at the origin, the file needs no offset.
    folder.convert_with("far.ply", "back.ply", &moved(-UTM)).unwrap();
    let back = folder.read("back.ply");
    assert!(off(&back, DVec3::ZERO) < 1e-5);
    assert_eq!(back.header.origin, DVec3::ZERO);
    let crop = ConvertOptions { crop_box: Some([UTM, UTM + DVec3::splat(20.0)]), ..Default::default() };
    let cropped = folder.convert_with("far.ply", "cropped.ply", &crop).unwrap().written;
    let inside = expected.iter().filter(|mean| mean.min_element() >= 0.0).count();
    assert_eq!(cropped, inside as u64);
    // Positions that are exact in single precision keep their bits.
    let mut exact = gaussians;
    for mean in &mut exact.means {
        *mean = [0, 1, 2].map(|axis| (2.0 * mean[axis]).round() / 2.0 + UTM[axis].floor() as f32);
    }
    folder.write("exact.ply", &exact);
    folder.convert("exact.ply", "copy.ply");
    assert!(folder.bytes("exact.ply") == folder.bytes("copy.ply"));
}

/// Training writes its scene in the coordinates of the data set.
#[test]
fn scenes_are_written_in_source_units_and_drawn_in_their_frame() {
    let folder = Folder::new();
    let gaussians = scene(200, 1);
    let frame = WorldFrame { origin: DVec3::new(500_000.0, 0.0, 0.0), unit: 0.01 };
    for format in [Format::Ply, Format::Glb, Format::Splat] {
        let name = named("scene", format);
        folder.write_with(&name, &gaussians, &WriteOptions { frame, ..Default::default() });
        let read = folder.read(&name);
        let largest = read.gaussians.means.as_flattened().iter().fold(0.0, |max: f32, v| max.max(v.abs()));
        assert!(largest <= 0.1, "{format}: {largest}");
        assert_eq!(read.header.unit, (format == Format::Ply).then_some(0.01));
        let drawn = read.in_world_frame();
        // Other formats do not store the training's unit.
        assert!(drawn.frame.unit <= if format == Format::Ply { 0.01 } else { 0.1 }, "{:?}", drawn.frame);
        let mut moved = gaussians.with_sh_degree(1.min(format.max_sh_degree()));
        moved.transform(&Similarity::between(&frame, &drawn.frame));
        let tolerance = Tolerance { mean: 1e-4, log_scale: 1e-4, ..tolerance(format) };
        assert_close(&drawn.gaussians, &moved, &tolerance);
    }
}

/// The files of a SOG in a folder, its description as JSON.
fn unpacked_sog(folder: &Folder, gaussians: &Gaussians) -> Value {
    folder.write("scene.sog", gaussians);
    let file = std::fs::File::open(folder.join("scene.sog")).unwrap();
    zip::ZipArchive::new(file).unwrap().extract(folder.join("sog")).unwrap();
    serde_json::from_slice(&folder.bytes("sog/meta.json")).unwrap()
}

#[test]
fn a_folder_of_sog_is_read_and_version_1_by_its_ranges() {
    let folder = Folder::new();
    let mut meta = unpacked_sog(&folder, &scene(900, 2));
    assert!(folder.read("sog").gaussians == folder.read("scene.sog").gaussians);
    assert!(folder.read("sog/meta.json").gaussians == folder.read("scene.sog").gaussians);
    // Codebooks of equal steps are version 1's ranges.
    let book: Vec<f32> = (0..256).map(|i| i as f32 / 100.0).collect();
    for name in ["scales", "sh0", "shN"] {
        meta[name]["codebook"] = json!(book);
    }
    folder.put("sog/meta.json", meta.to_string());
    let second = folder.read("sog").gaussians;
    let ends = |min: f32, max: f32| (json!([0.0, 0.0, 0.0, min]), json!([2.55, 2.55, 2.55, max]));
    let mut first = json!({"means": meta["means"], "quats": meta["quats"]});
    first["means"]["shape"] = json!([900, 3]);
    for name in ["scales", "sh0"] {
        let (mins, maxs) = ends(-5.0, 5.0);
        first[name] = json!({"mins": mins, "maxs": maxs, "files": meta[name]["files"]});
    }
    first["shN"] = json!({"mins": 0.0, "maxs": 2.55, "files": meta["shN"]["files"]});
    folder.put("sog/meta.json", first.to_string());
    let mut first = folder.read("sog").gaussians;
    // Opacities of version 1 are logits.
    for (logit, index) in first.opacity_logits.iter_mut().zip(0..) {
        let opacity = (f64::from(*logit) + 5.0) / 10.0;
        assert!((opacity - f64::from(second.opacity(index))).abs() < 1e-5, "{index}: {opacity}");
        *logit = second.opacity_logits[index];
    }
    let float = Tolerance { mean: 0.0, log_scale: 1e-6, opacity: 0.0, rotation: 0.0, color: 1e-6, sh: 1e-6 };
    assert_close(&first, &second, &Tolerance { rotation: 1e-6, ..float });
}

#[test]
fn what_a_sog_leaves_out_or_contradicts_is_named() {
    let folder = Folder::new();
    let whole = unpacked_sog(&folder, &scene(900, 1));
    let expected = folder.read("sog").gaussians;
    let with = |change: &dyn Fn(&mut Value)| {
        let mut meta = whole.clone();
        change(&mut meta);
        folder.put("sog/meta.json", meta.to_string());
    };
    // Some writers left the first value out; PlayCanvas' reader extrapolates it.
    with(&|meta| meta["scales"]["codebook"][0] = Value::Null);
    let repaired = folder.read("sog").gaussians;
    assert_close(&repaired, &expected, &Tolerance { log_scale: 0.1, ..tolerance(Format::Ply) });
    type Change<'a> = (&'a dyn Fn(&mut Value), &'a str);
    let changes: [Change<'_>; 8] = [
        (&|meta| meta["count"] = Value::Null, "number of Gaussians is missing"),
        (&|meta| meta["count"] = json!(1_u64 << 40), "number of Gaussians is missing or above"),
        (&|meta| meta["count"] = json!(1 << 20), "pixels, where 1048576 are needed"),
        (&|meta| meta["scales"]["codebook"][9] = Value::Null, "scales has no whole codebook"),
        (&|meta| meta["shN"]["bands"] = json!(4), "shN has no SH degree"),
        (&|meta| meta["shN"]["bands"] = json!(2), "192x15 pixels, where 7680 are needed"),
        (&|meta| meta["shN"]["count"] = json!(70_000), "more than 65536 vectors"),
        (&|meta| meta["quats"]["files"] = json!(["sh0.webp"]), "does not say what it omits"),
    ];
    for (change, words) in changes {
        with(change);
        assert_says(folder.refused("sog"), &[words]);
    }
}
