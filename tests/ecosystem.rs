//! Comparisons with other programs: PlayCanvas' splat-transform and engine, CesiumJS and its 3D Tiles tools,
//! Khronos' glTF validator, and a browser for our page.
//!
//! They come from npm: `ASHSPLAT_NPM=1` installs them below `target`, `ASHSPLAT_NPM=FOLDER` uses those of a
//! `node_modules`. Without it, the trials are listed as skipped.

// In a test, an unwrap is an assertion.
#![allow(clippy::unwrap_used)]

mod cesium;
mod playcanvas;
mod tiles;

use crate::absent;
use crate::common::splats::{Tolerance, assert_close, in_order_of, scene, tolerance};
use ashsplat::scene::{Gaussians, Similarity};
use ashsplat_files::splats::{self, ConvertOptions, Format, ReadOptions, WriteOptions};
use ashsplat_files::{Photo, PhotoFileFormat, metrics};
use glam::{DQuat, DVec3, EulerRot};
use libtest_mimic::{Failed, Trial};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, OnceLock};

const PACKAGES: [&str; 5] = [
    "cesium@1.145.0",
    "@playcanvas/splat-transform@2.7.1",
    "playcanvas@2.23.3",
    "gltf-validator@2.0.0-dev.3.10",
    "playwright-core@1.56.1",
];
/// Installed separately: it needs its optional packages, which the others do without.
const TILES_TOOLS: &str = "3d-tiles-tools@0.5.4";

const KEEP: ReadOptions = ReadOptions { drop_invalid: false, max_host_memory: None };

type Check = fn(&Path, Format);

pub fn trials() -> Vec<Trial> {
    let ending = |format: Format| format.extension().trim_start_matches('.').replace('.', "_");
    let mut cases: Vec<(String, Format, Check)> = Vec::new();
    for format in [Format::Ply, Format::CompressedPly, Format::Splat, Format::Spz, Format::Sog] {
        cases.push((format!("splat_transform_reads_our_{}", ending(format)), format, they_read_ours));
    }
    for format in [Format::Ply, Format::CompressedPly, Format::Spz, Format::Glb] {
        cases.push((format!("splat_transform_writes_{}_for_us", ending(format)), format, we_read_theirs));
    }
    for format in [Format::Ply, Format::CompressedPly, Format::Glb, Format::Sog] {
        let name = format!("playcanvas_shows_our_{}", ending(format));
        cases.push((name, format, playcanvas::shows_the_same));
    }
    for format in [Format::Glb, Format::Gltf] {
        let name = format!("gltf_validator_accepts_our_{}", ending(format));
        cases.push((name, format, the_validator_accepts_ours));
    }
    let others: [(&str, Check); 5] = [
        ("splat_transform_writes_sog_for_us", |modules, _| we_decode_their_sog(modules)),
        ("splat_transform_moves_as_we_do_ply", we_move_alike),
        ("playcanvas_shows_a_trained_scene_ply", |modules, _| {
            playcanvas::shows_a_trained_scene(modules, &trained_scene());
        }),
        ("playcanvas_shows_our_streamed_sog", |modules, _| playcanvas::shows_our_streamed_sog(modules)),
        ("viewer_in_chromium_ply", viewer_works_in_chromium),
    ];
    for (name, check) in others.into_iter().chain(cesium::TRIALS).chain(tiles::TRIALS) {
        cases.push((name.into(), Format::Ply, check));
    }
    // Missing features of other programs.
    let missing = absent(
        "ecosystem_splat_transform_reads_our_glb",
        "splat-transform writes glTF and does not read it: neither 2.7.1 nor 3.7.0 has .glb among its inputs",
    );
    let wanted = std::env::var("ASHSPLAT_NPM").unwrap_or_default();
    let modules = Arc::new(OnceLock::new());
    let trial = |(name, format, check): (String, Format, Check)| {
        let name = format!("ecosystem_{name}");
        let needs_chromium = ["playcanvas", "cesium", "chromium"].iter().any(|page| name.contains(page));
        if wanted.is_empty() {
            return absent(&name, "ASHSPLAT_NPM is not set (1, or a node_modules folder)");
        }
        if needs_chromium && Command::new("chromium").arg("--version").output().is_err() {
            return absent(&name, "there is no chromium to run (Debian: apt-get install chromium)");
        }
        if name.contains("trained") && !trained_scene().is_file() {
            return absent(&name, format!("{} is not there", trained_scene().display()));
        }
        let (wanted, modules) = (wanted.clone(), modules.clone());
        Trial::test(name, move || {
            let modules: &Result<PathBuf, String> = modules.get_or_init(|| install(&wanted));
            check(modules.as_ref().map_err(Failed::from)?, format);
            Ok(())
        })
    };
    cases.into_iter().map(trial).chain([missing]).collect()
}

fn run_script(name: &str, arguments: &[&Path]) -> String {
    let script = crate::common::root().join("tests/ecosystem").join(name);
    let result = Command::new("node").arg(script).args(arguments).output().expect("node");
    assert!(result.status.success(), "{}", String::from_utf8_lossy(&result.stderr));
    String::from_utf8_lossy(&result.stdout).into_owned()
}

/// A picture below `target`, kept for inspection.
fn kept(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}.png"))
}

/// PSNR of two pictures, dB. They are kept side by side under a name.
fn compare(name: &str, ours: &Photo, theirs: &Photo) -> f64 {
    let row = 3 * ours.width as usize;
    let rows = ours.rgb.chunks(row).zip(theirs.rgb.chunks(row));
    let rgb = rows.flat_map(|(a, b)| [a, b].concat()).collect();
    Photo { width: 2 * ours.width, height: ours.height, rgb }.write_png(kept(name)).unwrap();
    let psnr = metrics::psnr(&ours.to_f32(), &theirs.to_f32(), None).unwrap();
    println!("{name}: {psnr:.2} dB, {}", kept(name).display());
    psnr
}

/// Same as [`compare`], but an error if the PSNR is too low.
fn compare_at_least(min_psnr: f64, name: &str, ours: &Photo, theirs: &Photo) -> Result<(), String> {
    let psnr = compare(name, ours, theirs);
    if psnr >= min_psnr { Ok(()) } else { Err(format!("{psnr:.2} dB: see {}", kept(name).display())) }
}

/// Checks a picture that a page draws. The page's workers sort, and on a busy machine they may need more frames than
/// the page waits for. A failed check is repeated once with more frames.
fn once_more_with_patience(still_frames: u32, check: impl Fn(u32) -> Result<(), String>) {
    if let Err(first) = check(still_frames) {
        eprintln!("once more with patience: {first}");
        check(20 * still_frames).unwrap();
    }
}

/// 185,761 Gaussians of SH degree 3.
fn trained_scene() -> PathBuf {
    crate::common::shared_folder().join("data/trained/yushimatenjin_186k_sh3.inria.ply")
}

fn install(wanted: &str) -> Result<PathBuf, String> {
    if wanted != "1" {
        return Ok(PathBuf::from(wanted));
    }
    installed("npm", &[&["--omit=optional"], &PACKAGES[..]].concat())
}

fn tiles_tools(modules: &Path) -> Result<PathBuf, String> {
    static INSTALLED: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    if modules.join("3d-tiles-tools").is_dir() {
        return Ok(modules.to_owned());
    }
    if std::env::var_os("ASHSPLAT_NPM").is_none_or(|wanted| wanted != "1") {
        return Err(format!("{} has no 3d-tiles-tools", modules.display()));
    }
    INSTALLED.get_or_init(|| installed("npm_tiles", &["--ignore-scripts", TILES_TOOLS])).clone()
}

/// Installs these packages below `target`. Returns their `node_modules`.
fn installed(name: &str, packages: &[&str]) -> Result<PathBuf, String> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::create_dir_all(&folder).map_err(|e| e.to_string())?;
    let mut npm = Command::new("npm");
    npm.args(["install", "--no-save", "--no-audit", "--no-fund", "--prefix"]).arg(&folder).args(packages);
    let output = npm.output().map_err(|e| format!("npm: {e}"))?;
    if !output.status.success() {
        return Err(format!("npm install: {}", String::from_utf8_lossy(&output.stderr)));
    }
    Ok(folder.join("node_modules"))
}

/// Runs splat-transform. The arguments are an input file, actions, and an output file.
fn splat_transform(modules: &Path, arguments: &[&str]) {
    let program = modules.join("@playcanvas/splat-transform/bin/cli.mjs");
    let output = Command::new("node").arg(program).args(["-q", "-w"]).args(arguments).output().expect("node");
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
}

fn read(path: &Path) -> Gaussians {
    splats::read(path, &KEEP).unwrap().gaussians
}

fn text(path: &Path) -> &str {
    path.to_str().expect("temporary paths are UTF-8")
}

/// Tolerance for another decoder: rounding, and the meaning of 128 in a quaternion of .splat.
fn small(format: Format) -> Tolerance {
    let rotation = if format == Format::Splat { 3e-4 } else { 1e-5 };
    Tolerance { mean: 1e-5, log_scale: 1e-5, opacity: 1e-5, rotation, color: 1e-4, sh: 1e-5 }
}

fn they_read_ours(modules: &Path, format: Format) {
    let folder = tempfile::tempdir().unwrap();
    let ours = folder.path().join(format!("ours{}", format.extension()));
    let theirs = folder.path().join("theirs.ply");
    // More would share vectors of a SOG's palette.
    let expected = scene(if format == Format::Sog { 1000 } else { 1500 }, format.max_sh_degree());
    splats::write(&ours, &expected, &WriteOptions::default()).unwrap();
    splat_transform(modules, &[text(&ours), text(&theirs)]);
    let (by_us, by_them) = (read(&ours), read(&theirs));
    assert_close(&by_them, &by_us, &small(format));
    let sorted = in_order_of(&expected, &by_them);
    let margin = tolerance(format);
    assert_close(&sorted, &expected, &Tolerance { rotation: 2.0 * margin.rotation, ..margin });
}

fn we_read_theirs(modules: &Path, format: Format) {
    let folder = tempfile::tempdir().unwrap();
    let ours = folder.path().join("ours.ply");
    let expected = scene(1500, 3);
    splats::write(&ours, &expected, &WriteOptions::default()).unwrap();
    let versions: &[&[&str]] =
        if format == Format::Spz { &[&["--spz-version", "3"], &["--spz-version", "4"]] } else { &[&[]] };
    for options in versions {
        let theirs = folder.path().join(format!("theirs{}", format.extension()));
        splat_transform(modules, &[&[text(&ours), text(&theirs)], *options].concat());
        assert_eq!(Format::of_file(&theirs).unwrap(), format);
        let margin = tolerance(format);
        let margin = Tolerance { mean: margin.mean + 2e-6, sh: margin.sh + 2e-6, ..margin };
        assert_close(&in_order_of(&expected, &read(&theirs)), &expected, &margin);
    }
}

/// Their palette has few vectors for random spherical harmonics, so the judge is their own decoder.
fn we_decode_their_sog(modules: &Path) {
    let folder = tempfile::tempdir().unwrap();
    let [ours, theirs, decoded] =
        ["ours.ply", "theirs.sog", "decoded.ply"].map(|name| folder.path().join(name));
    splats::write(&ours, &scene(1500, 3), &WriteOptions::default()).unwrap();
    splat_transform(modules, &["-g", "cpu", text(&ours), text(&theirs)]);
    splat_transform(modules, &[text(&theirs), text(&decoded)]);
    assert_close(&read(&theirs), &read(&decoded), &small(Format::Sog));
}

/// Rotation (with spherical harmonics), scale and translation. Its x and y axes are reversed.
fn we_move_alike(modules: &Path, _: Format) {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    splats::write(path("in.ply"), &scene(800, 3), &WriteOptions::default()).unwrap();
    let actions = ["-r", "-20,-130,50", "-s", "1.75", "-t", "-3,4.5,2"];
    let [before, after] = ["in.ply", "theirs.ply"].map(path);
    splat_transform(modules, &[&[text(&before)], &actions[..], &[text(&after)]].concat());
    let [x, y, z] = [20f64, 130.0, 50.0].map(f64::to_radians);
    let similarity = Similarity {
        rotation: DQuat::from_euler(EulerRot::ZYX, z, y, x),
        scale: 1.75,
        translation: DVec3::new(3.0, -4.5, 2.0),
    };
    let options = ConvertOptions { similarity, ..Default::default() };
    splats::convert(&path("in.ply"), &path("ours.ply"), &options).unwrap();
    let float =
        Tolerance { mean: 1e-4, log_scale: 1e-5, opacity: 1e-6, rotation: 1e-6, color: 0.0, sh: 1e-5 };
    assert_close(&read(&path("ours.ply")), &read(&path("theirs.ply")), &float);
}

fn the_validator_accepts_ours(modules: &Path, format: Format) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(format!("scene{}", format.extension()));
    splats::write(&path, &scene(300, 3), &WriteOptions { antialiased: true, ..Default::default() }).unwrap();
    validate(modules, &[path], false);
}

/// Fails if Khronos' validator finds more than unknown extensions in these files. `packed`: they contain SPZ.
fn validate(modules: &Path, files: &[PathBuf], packed: bool) {
    const SCRIPT: &str = "const v = require(process.argv[1] + '/gltf-validator'), fs = require('fs'), path = require('path');
        const check = (file) => { const read = (uri) => Promise.resolve(new Uint8Array(fs.readFileSync(path.join(path.dirname(file), decodeURIComponent(uri)))));
            return v.validateBytes(new Uint8Array(fs.readFileSync(file)), { externalResourceFunction: read, ignoredIssues: ['UNSUPPORTED_EXTENSION'] }); };
        Promise.all(process.argv.slice(2).map(check))
            .then((reports) => console.log(JSON.stringify(reports.map((report) => report.issues))), (error) => { console.error(error); process.exit(1); });";
    let modules = std::path::absolute(modules).unwrap();
    let output = Command::new("node").args(["-e", SCRIPT]).arg(modules).args(files).output().expect("node");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let reports: Vec<serde_json::Value> = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(reports.len(), files.len());
    // The validator does not know the extensions: names of attributes, and SPZ data in an otherwise unused view.
    let unknown = |issue: &&serde_json::Value| {
        let place = issue["pointer"].as_str().unwrap_or_default();
        issue["code"] == "MESH_PRIMITIVE_INVALID_ATTRIBUTE"
            && place.contains("/attributes/KHR_gaussian_splatting:")
            || packed && issue["code"] == "UNUSED_OBJECT" && place == "/bufferViews/0"
    };
    for (issues, file) in reports.iter().zip(files) {
        let messages = issues["messages"].as_array().unwrap();
        let others: Vec<_> = messages.iter().filter(|issue| !unknown(issue)).collect();
        assert!(others.is_empty(), "{}: {others:#?}", file.display());
    }
}

/// Uses the viewer's page with a model and a training as a user would. The screenshots stay below `target`.
fn viewer_works_in_chromium(modules: &Path, _: Format) {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("viewer");
    std::fs::remove_dir_all(&folder).ok();
    let program = env!("CARGO_BIN_EXE_ashsplat");
    let demo =
        Command::new(program).args(["demo", "--quiet", "--iterations", "150", "--out"]).arg(&folder).output();
    assert!(demo.expect("the program").status.success());
    run_script("viewer.mjs", &[modules, Path::new(program), &folder]);
}
