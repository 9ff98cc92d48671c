//! The header matches the sources, and C programs that include it work.

#![allow(clippy::disallowed_methods, clippy::expect_used)]

extern crate ashsplat_reference as reference;

mod hosts;
#[allow(dead_code)]
#[path = "../../../tests/common/lpips_files.rs"]
mod lpips_files;
mod measures;

use ashsplat::scene::{Camera, Gaussians, Intrinsics, Similarity};
use ashsplat::vk::{Context, ContextOptions};
use ashsplat::{Frame, RenderSettings, Renderer};
use ashsplat_files::Progress;
use ashsplat_files::splats::{self, Format, ReadOptions, WriteOptions};
use ashsplat_files::tiles::{self, Demand, TileOptions, Tree};
use cbindgen::{Builder, Config, DocumentationStyle, EnumConfig, ExportConfig, Language};
use glam::{DQuat, DVec3, Mat3, Vec3};
use hosts::{MESSAGES, argument, compile, folder, host_in_c, host_output, host_with, library, run};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Generates `ashsplat.h` from the sources and compares it. ASHSPLAT_BLESS writes it.
#[test]
fn the_header_is_what_the_sources_say() {
    let config = Config {
        language: Language::C,
        cpp_compat: true,
        header: Some(
            "/* The C interface of ashsplat. Generated from the sources in tools/capi: do not edit.\n \
             * Structs that have struct_size begin with ASHSPLAT_INIT, which sets it and the defaults:\n \
             *\n \
             *     AshsplatReservation wanted = ASHSPLAT_INIT(AshsplatReservation);\n \
             *     wanted.gaussians = 100000;\n \
             *\n \
             * New fields come at their ends. A host that was compiled with an older header works with this library: the\n \
             * fields that it does not know have their defaults. So does one with a newer header as long as it sets\n \
             * nothing that this library does not know. All other structs and the functions stay as they are. */\n\n\
             #ifndef ASHSPLAT_H\n#define ASHSPLAT_H"
                .into(),
        ),
        documentation_style: DocumentationStyle::C99,
        usize_is_size_t: true,
        sys_includes: vec!["string.h".into()],
        // The include guard also encloses the initialisers, which come last.
        trailer: Some(initialisers() + "\n#endif /* ASHSPLAT_H */"),
        line_length: 110,
        enumeration: EnumConfig { prefix_with_name: true, ..EnumConfig::default() },
        // They are passed as numbers, so no function has them in its signature.
        export: ExportConfig {
            include: ["Background", "ColorEncoding", "Extent", "ImageUse", "JacobianLimit", "Projection", "Readout", "Shape", "ShStorage", "SurfaceDepth", "Volume"]
                .map(|e| format!("Ashsplat{e}"))
                .to_vec(),
            ..ExportConfig::default()
        },
        ..Config::default()
    };
    // cbindgen finds the modules from here.
    let builder = Builder::new().with_config(config).with_src(folder().join("lib.rs"));
    let mut made = Vec::new();
    builder.generate().expect("a header").write(&mut made);
    let made = String::from_utf8(made).expect("text");
    let path = folder().join("ashsplat.h");
    if std::env::var_os("ASHSPLAT_BLESS").is_some() {
        std::fs::write(&path, &made).expect("written");
    }
    let kept = std::fs::read_to_string(&path).expect("tools/capi/ashsplat.h");
    assert!(kept == made, "tools/capi/ashsplat.h is out of date: run with ASHSPLAT_BLESS=1");
    for name in
        ["ashsplat_record", "ashsplat_context_from_foreign", "ashsplat_last_error", "AshsplatStatus_Ok"]
    {
        assert!(made.contains(name), "{name}");
    }
}

/// `ASHSPLAT_INIT`, from the defaults of the library's own structs.
fn initialisers() -> String {
    let mut text = String::from(
        "/* A struct that knows its size, with the defaults of its fields. */\n#define ASHSPLAT_INIT(Type) Type##_init()\n",
    );
    for (name, defaults) in ashsplat_c::STRUCTS {
        text += &format!(
            "\nstatic inline {name} {name}_init(void) {{\n  {name} it;\n  memset(&it, 0, sizeof it);\n"
        );
        text += "  it.struct_size = (uint32_t)sizeof it;\n";
        for (field, value) in *defaults {
            let number =
                |value: &str| if value.contains('.') { format!("{value}f") } else { value.to_owned() };
            let listed = value.strip_prefix('[').and_then(|list| list.strip_suffix(']'));
            match (*value, listed) {
                ("UPRIGHT", _) => {
                    text += &format!("  it.{field}[0] = it.{field}[4] = it.{field}[8] = 1.0f;\n");
                }
                (_, Some(list)) => {
                    for (index, value) in list.split(", ").enumerate() {
                        text += &format!("  it.{field}[{index}] = {};\n", number(value));
                    }
                }
                (value, None) => text += &format!("  it.{field} = {};\n", number(value)),
            }
        }
        text += "  return it;\n}\n";
    }
    text
}

fn scene_file() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = folder.path().join("scene.ply");
    splats::write(&scene, &cloud(), &Default::default()).expect("a PLY");
    (folder, scene)
}

fn read_ply(path: &Path) -> Gaussians {
    splats::read(path, &Default::default()).expect("a scene").gaussians
}

fn renderer_of(gaussians: &Gaussians) -> Renderer {
    let context = Context::new(&ContextOptions::default()).expect("a device");
    let mut renderer = Renderer::new(&context).expect("kernels");
    renderer.upload(gaussians).expect("uploaded");
    renderer
}

fn camera(width: u32, height: u32) -> Camera {
    let intrinsics = Intrinsics::from_fov_x(0.7, width, height);
    Camera::look_at(Vec3::new(0.0, -1.0, -4.0), Vec3::ZERO, Vec3::NEG_Y, intrinsics)
}

fn picture_of(path: &Path, size: (u32, u32)) -> image::RgbImage {
    let picture = image::open(path).expect("a picture").into_rgb8();
    assert_eq!(picture.dimensions(), size);
    picture
}

/// Largest difference of a pixel's bytes from a colour.
fn difference(pixel: &image::Rgb<u8>, color: &[f32; 3]) -> f32 {
    let off = |(byte, value): (&u8, &f32)| (f32::from(*byte) - 255.0 * value.clamp(0.0, 1.0)).abs();
    pixel.0.iter().zip(color).map(off).fold(0.0, f32::max)
}

fn floats_of(path: &Path) -> Vec<f32> {
    let bytes = std::fs::read(path).expect("floats");
    bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect()
}

fn cloud() -> Gaussians {
    let mut cloud = Gaussians { sh_degree: 1, ..Gaussians::default() };
    for i in 0..500u32 {
        let random = |k: u32| (i.wrapping_mul(2_654_435_761).rotate_left(7 * k) >> 8) as f32 / 16_777_216.0;
        cloud.means.push([1, 2, 3].map(|k| 2.0 * random(k) - 1.0));
        cloud.quats.push([1.0, random(4), random(5), random(6)]);
        cloud.log_scales.push([-2.8, -3.0 - random(1), -2.5]);
        cloud.opacity_logits.push(3.0 * random(2));
        cloud.sh.extend([1, 2, 3, 4].map(|k| [random(k) - 0.3, random(k + 1) - 0.5, random(k + 2) - 0.5]));
    }
    cloud
}

#[test]
fn a_c_program_renders_what_rust_renders() {
    let (folder, scene) = scene_file();
    let picture = folder.path().join("picture.png");
    let settings = RenderSettings { background: [0.1, 0.2, 0.3], ..RenderSettings::default() };
    let expected = renderer_of(&read_ply(&scene)).render(&camera(320, 240), &settings).expect("a frame");

    let system = ["-lpthread", "-ldl", "-lm", "-lgcc_s"].map(String::from);
    let links =
        [vec![argument(&library(".so"))], [argument(&library(".a"))].into_iter().chain(system).collect()];
    for (number, link) in links.iter().enumerate() {
        let program = folder.path().join(format!("example{number}"));
        compile(&hosts::folder().join("example.c"), &program, link);
        let output = run(&program, &[&scene, &picture]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert!(String::from_utf8_lossy(&output.stdout).contains("500 Gaussians of degree 1"));
        for (pixel, color) in picture_of(&picture, (320, 240)).pixels().zip(&expected.color) {
            assert!(difference(pixel, color) <= 0.51, "{pixel:?} {color:?}");
        }
        std::fs::remove_file(&picture).expect("removed");

        let missing = run(&program, &[Path::new("/no/such.ply"), &picture]);
        let said = String::from_utf8_lossy(&missing.stderr);
        assert_eq!(missing.status.code(), Some(2));
        assert!(said.starts_with("error 2: loading the scene: /no/such.ply"), "{said}");
        assert_eq!(said.lines().count(), 1);
    }
}

#[test]
fn a_host_in_c_records_into_its_own_command_buffer() {
    let (_folder, scene) = scene_file();
    let said = host_in_c("record", "plain", &[&scene]);
    let visible: u32 = said.split(' ').next().and_then(|n| n.parse().ok()).expect("a number");
    assert!(visible > 100 && said.contains("of 500 Gaussians visible, scale 10.0, offset 0.0"), "{said}");
}

/// Compiles the guide's guest from the guide's text.
#[test]
fn the_guides_guest_in_c_draws() {
    let (_folder, scene) = scene_file();
    let guide = include_str!("../../../engine/guide/embedding.md");
    let (_, guest) = guide.split_once("```c\n/* guest.c").expect("the guest in the guide");
    let (guest, _) = guest.split_once("```").expect("its end");
    let guest = format!("/* guest.c{guest}");
    let said = host_with("guide", &guest, &[&scene]);
    assert!(said.contains("of 500 Gaussians visible"), "{said}");
    // Validation reports a mistake of the engine.
    let is_required = std::env::var_os("ASHSPLAT_REQUIRE_VALIDATION").is_some();
    let said = host_output("guide", &guest, &[&scene, Path::new("wrong")]);
    assert!(said.contains(MESSAGES[0]) || !is_required, "no validation layer: {said}");
}

/// Reads, chooses and draws the same of a tree as Rust.
#[test]
fn a_host_in_c_streams_tiles() {
    let (folder, scene) = scene_file();
    let tiles = folder.path().join("tiles");
    let mut measure = |_: &Gaussians, _: &Gaussians| Ok(0.1);
    let options = TileOptions { max_gaussians: 20, packed: false };
    tiles::write(&scene, &tiles, &options, &ReadOptions::default(), &mut measure, &Progress::NONE)
        .expect("tiles");
    let said = host_in_c("scenes", "tiles", &[&tiles]);
    let numbers: Vec<usize> = said.split_whitespace().filter_map(|word| word.parse().ok()).collect();
    let (&[frames, visible, instances], told) = numbers.split_first_chunk().expect("three numbers");
    let told = told.as_chunks::<2>().0;
    let drawn: Vec<usize> = told.iter().map(|[tile, _]| *tile).collect();

    let tree = Tree::open(&tiles).expect("a tree");
    let eye = Vec3::new(0.0, 0.0, 0.2);
    let camera = Camera::look_at(eye, Vec3::NEG_Z, Vec3::NEG_Y, Intrinsics::from_fov_x(1.2, 110, 70));
    assert_eq!(drawn, tree.cut(&camera, 200));
    assert_eq!(frames, tree.wanted(&Demand::of(&camera, 200)).len() + 1);
    assert!(drawn.len() > 3 && drawn.len() < tree.tiles().len(), "{drawn:?}");
    let mut all = Gaussians { sh_degree: 1, ..Gaussians::default() };
    for &[tile, print] in told {
        let own = tree.read(tile, &ReadOptions::default()).expect("a tile").gaussians;
        let geometry = [own.means.as_flattened(), own.quats.as_flattened(), own.log_scales.as_flattened()];
        let numbers = [&geometry[..], &[&own.opacity_logits, own.sh.as_flattened()]].concat().concat();
        let bytes = numbers.iter().flat_map(|number| number.to_ne_bytes());
        let expected =
            bytes.fold(2_166_136_261_u32, |print, byte| (print ^ u32::from(byte)).wrapping_mul(16_777_619));
        assert_eq!(print, expected as usize, "the numbers of tile {tile}");
        all.append(&own);
    }
    let stats = renderer_of(&all).render(&camera, &RenderSettings::default()).expect("a frame").stats;
    assert_eq!((visible, instances), (stats.visible as usize, stats.instances as usize));
    assert!(visible > 50, "{said}");
}

#[test]
fn a_host_in_c_records_two_eyes_at_once() {
    let (_folder, scene) = scene_file();
    let said = host_in_c("record", "views", &[&scene]);
    let numbers: Vec<u32> = said.split(' ').filter_map(|word| word.parse().ok()).collect();
    let &[visible, lit, differ, locks] = &numbers[..] else { panic!("{said}") };
    assert!(visible > 100 && lit > 500 && differ > 500 && locks > 0, "{said}");
}

/// The grid of scenes.c, with spherical harmonics of degree 1 that are zero.
fn grid(z: f32) -> Gaussians {
    let mut grid = Gaussians { sh_degree: 1, ..Gaussians::default() };
    for i in 0..64 {
        let (x, y) = ((i % 8) as f32 / 4.0 - 0.875, (i / 8) as f32 / 4.0 - 0.875);
        grid.means.push([x, y, z]);
        grid.quats.push([1.0, 0.0, 0.0, 0.0]);
        grid.log_scales.push([-2.5; 3]);
        grid.opacity_logits.push(2.0);
        let (red, blue) = if y < 0.0 { (1.5, -1.5) } else { (-1.5, 1.5) };
        grid.sh.extend([[red, -1.0, blue], [0.0; 3], [0.0; 3], [0.0; 3]]);
    }
    grid
}

/// The expected picture of scenes.c, from one combined scene.
fn expected_of_scenes(mut file: Gaussians) -> (Frame, Camera) {
    let update = grid(-0.4);
    file.means[10..74].copy_from_slice(&update.means);
    file.quats[10..74].copy_from_slice(&update.quats);
    file.log_scales[10..74].copy_from_slice(&update.log_scales);
    file.opacity_logits[10..74].copy_from_slice(&update.opacity_logits);
    file.sh[40..296].copy_from_slice(&update.sh);
    let mut all = file.clone();
    let moved = |mut gaussians: Gaussians, rotation, scale, translation| {
        gaussians.transform(&Similarity { rotation, scale, translation });
        gaussians
    };
    let quarter = DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2);
    all.append(&moved(file, quarter, 0.25, DVec3::new(-0.8, 0.4, -0.5)));
    let mut tinted = grid(0.15);
    for (sh, logit) in tinted.sh.chunks_mut(4).zip(&mut tinted.opacity_logits) {
        let c0 = 0.282_094_79;
        sh[0][0] = ((sh[0][0] * c0 + 0.5) * 0.5 - 0.5) / c0;
        let opacity = 0.75 / (1.0 + (-*logit).exp());
        *logit = (opacity / (1.0 - opacity)).ln();
    }
    all.append(&tinted);
    let mut half = grid(-0.9).select(&(0..32).collect::<Vec<_>>());
    for sh in half.sh.chunks_mut(4).take(16) {
        let c0 = 0.282_094_79;
        let mixed = |k: usize| 0.25 * (sh[0][k] * c0 + 0.5) + 0.75 * [0.0, 1.0, 0.25][k];
        sh[0] = [0, 1, 2].map(|k| (mixed(k) - 0.5) / c0);
    }
    // A half-space in the scene's units.
    half.retain(|half, i| half.means[i][0] < 0.5);
    all.append(&moved(half, DQuat::IDENTITY, 0.5, DVec3::new(0.3, 0.0, 0.0)));
    // Splats behind the wall are hidden.
    all.retain(|all, i| all.means[i][2] + 4.0 < 4.2);
    let intrinsics = Intrinsics { fx: 160.0, fy: 160.0, cx: 80.0, cy: 60.0, width: 160, height: 120 };
    let camera = Camera::with_pose(Mat3::IDENTITY, Vec3::new(0.0, 0.0, 4.0), intrinsics);
    let settings = RenderSettings { background: [0.1, 0.2, 0.3], ..RenderSettings::default() };
    (renderer_of(&all).render(&camera, &settings).expect("a frame"), camera)
}

#[test]
fn a_host_in_c_has_scenes_of_its_own() {
    let (folder, scene) = scene_file();
    let [picture, depth] = ["picture.png", "depth.bin"].map(|name| folder.path().join(name));
    let said = host_in_c("scenes", "own", &[&scene, &picture, &depth]);
    assert!(said.contains("of 1096 Gaussians visible"), "{said}");
    if let Some(kept) = std::env::var_os("ASHSPLAT_KEEP") {
        std::fs::copy(&picture, Path::new(&kept).join("c_scenes.png")).expect("copied");
    }
    let (expected, camera) = expected_of_scenes(read_ply(&scene));
    let picture = picture_of(&picture, (camera.width, camera.height));
    let pixels = picture.pixels().zip(&expected.color);
    let different = pixels.filter(|(pixel, color)| difference(pixel, color) > 1.0).count();
    assert!(different < 20, "{different} of {} pixels differ", expected.color.len());
    // Something is hidden, but not everything, and everything drawn is in front of the wall.
    let (mut seen, mut empty) = (0, 0);
    for (z, transmittance) in floats_of(&depth).into_iter().zip(&expected.transmittance) {
        let clearly = (transmittance - 0.5).abs() > 0.01;
        assert!(
            !clearly || (z == -1.0) == (*transmittance > 0.5),
            "{z} at a transmittance of {transmittance}"
        );
        assert!(z == -1.0 || (2.0..4.2).contains(&z), "{z}");
        seen += u32::from(z != -1.0);
        empty += u32::from(z == -1.0);
    }
    assert!(seen > 1000 && empty > 1000, "{seen} pixels with depth, {empty} without");
}

/// A host's own allocator, settings, a part of a picture, the sum of weights / z, discarded recordings.
#[test]
fn a_host_in_c_has_all_there_is() {
    let (folder, scene) = scene_file();
    let [picture, sums] = ["picture.png", "sums.bin"].map(|name| folder.path().join(name));
    let said = host_in_c("record", "memory", &[&scene, &picture, &sums]);
    assert!(said.contains("of 500 Gaussians visible"), "{said}");
    let settings = RenderSettings {
        scale_modifier: 0.5,
        sh_degree: Some(0),
        antialias: true,
        inverse_depth: true,
        background: [0.0, 0.5, 0.0],
        ..RenderSettings::default()
    };
    let expected = renderer_of(&read_ply(&scene)).render(&camera(96, 64), &settings).expect("a frame");
    assert_eq!(Some(floats_of(&sums)), expected.inverse_depth);
    for (x, y, pixel) in picture_of(&picture, (128, 80)).enumerate_pixels() {
        let inside = (20..116).contains(&x) && (8..72).contains(&y);
        let color = if inside { expected.color[((y - 8) * 96 + x - 20) as usize] } else { [0.0; 3] };
        assert!(difference(pixel, &color) <= 0.51, "({x}, {y}): {pixel:?}, {color:?}");
    }
}

/// Structs smaller and larger than today's.
#[test]
fn a_host_in_c_may_have_another_header() {
    let (_folder, scene) = scene_file();
    let said = host_in_c("record", "structs", &[&scene]);
    assert!(said.contains("of 1500 Gaussians visible"), "{said}");
}

/// Each file loads the same as in the crate of file formats.
#[test]
fn a_c_program_loads_every_format() {
    let folder = tempfile::tempdir().expect("a folder");
    let paths = Format::WRITTEN.map(|format| folder.path().join(format!("scene{}", format.extension())));
    for path in &paths {
        splats::write(path, &cloud(), &WriteOptions::default()).expect("written");
    }
    let said = host_in_c("scenes", "formats", &paths.each_ref().map(PathBuf::as_path));
    let mut renderer = renderer_of(&cloud());
    assert_eq!(said.lines().count(), Format::WRITTEN.len());
    for (path, line) in paths.iter().zip(said.lines()) {
        let read = splats::read(path, &ReadOptions::default()).expect("a scene").gaussians;
        renderer.upload(&read).expect("uploaded");
        let frame = renderer.render(&camera(64, 48), &RenderSettings::default()).expect("a frame");
        let expected: f64 = frame.color.as_flattened().iter().map(|x| f64::from(*x)).sum();
        let said: Vec<f64> = line.split(' ').map(|number| number.parse().expect("a number")).collect();
        assert_eq!(said[..2], [500.0, f64::from(read.sh_degree)], "{}", path.display());
        assert!(
            expected > 100.0 && (said[2] - expected).abs() < 1e-4,
            "{}: {line}, {expected}",
            path.display()
        );
    }
}

#[test]
fn a_host_in_c_trains() {
    let folder = tempfile::tempdir().expect("a folder");
    let result = folder.path().join("result.ply");
    let said = host_in_c("train", "steps", &[&result]);
    assert!(said.contains("30 iterations"), "{said}");
    let trained = read_ply(&result);
    assert!(trained.len() > 10 && said.contains(&format!("{} Gaussians", trained.len())), "{said}");
    // The file contains the 3D filter's part, and says so.
    let filtered = std::fs::read(folder.path().join("result.ply.filtered.ply")).expect("a PLY");
    let header = String::from_utf8_lossy(&filtered[..2000.min(filtered.len())]).into_owned();
    assert!(
        header.contains("property float filter_3D") && header.contains("comment SplatRenderMode: mip"),
        "{header}"
    );
}
