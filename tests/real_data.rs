//! Real photographs with COLMAP models, and trained scenes: one trial each.

// In a test, an unwrap is an assertion.
#![allow(clippy::unwrap_used)]

use crate::absent_data;
use ashsplat_files::colmap::{Model, find};
use ashsplat_files::dataset::{Dataset, DatasetOptions};
use ashsplat_files::{Progress, splats};
use glam::Vec3;
use libtest_mimic::Trial;
use std::path::{Path, PathBuf};

pub fn trials(shared: &Path) -> Vec<Trial> {
    let data = shared.join("data");
    let mut trials = Vec::new();
    let mut add = |name: &str, path: &str, check: fn(&Path)| {
        let path: PathBuf = data.join(path);
        trials.push(match path.exists() {
            true => Trial::test(name, move || {
                check(&path);
                Ok(())
            }),
            false => absent_data(name, format!("no {}", path.display())),
        });
    };
    add("data_fox_half", "fox/half", |path| fox(path, 266, 474));
    add("data_fox_quarter_txt", "fox/quarter_txt", fox_text);
    add("data_trained_quantised_sh3", "trained/yushimatenjin_186k_sh3.inria.ply", |p| trained(p, 185_761, 3));
    add("data_trained_reordered_sh2", "trained/playbot_lod3_31k_sh2.ply", |p| trained(p, 31_000, 2));
    add("data_trained_by_the_reference", "trained/kacytran_iter7000.ply", |p| trained(p, 9_080, 3));
    add("data_trained_three", "trained/test-splat.3-points-from-train.ply", |p| trained(p, 3, 3));
    add("data_trained_compressed", "trained/biker.compressed.ply", |p| other_format(p, 152_746, false));
    add("data_trained_spz_v4", "trained/biker.spz", |p| other_format(p, 152_746, false));
    add("data_trained_spz_v2", "trained/tabletop_scene.spz", |p| other_format(p, 213_944, true));
    add("data_trained_splat", "trained/kacytran_model.splat", |p| other_format(p, 22_764, false));
    trials
}

fn fox(path: &Path, width: u32, height: u32) {
    let options = DatasetOptions { eval: true, ..DatasetOptions::default() };
    let dataset = Dataset::load(path, &options, Progress::NONE).unwrap();
    assert_eq!((dataset.train.len(), dataset.test.len(), dataset.points.len()), (43, 7, 12_079));
    assert_eq!(dataset.warnings, [""; 0]);
    let names = |views: &[ashsplat_files::View]| views.iter().map(|v| v.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&dataset.test)[..3], ["0001.jpg", "0012.jpg", "0027.jpg"]);
    assert!(names(&dataset.train).is_sorted());
    for view in dataset.views() {
        view.camera.check().unwrap();
        assert_eq!((view.photo.width, view.photo.height), (width, height));
    }
    assert!(dataset.scene_extent > 1.0 && dataset.scene_extent < 20.0, "{}", dataset.scene_extent);
    assert_points_are_seen(&dataset);
    let gaussians = ashsplat_files::initial_gaussians(&dataset.initial_points(0), 3).unwrap();
    gaussians.check_shapes().unwrap();
    assert!(Dataset::inspect(path, &options, Progress::NONE).is_sound());
}

/// Fails unless a model's points lie in front of its cameras, many of them in each picture, and match its colours
/// better than those of the mirrored picture.
fn assert_points_are_seen(dataset: &Dataset) {
    let (mut difference, mut mirrored) = (0, 0);
    for view in dataset.views() {
        let (width, height) = (view.photo.width as usize, view.photo.height as usize);
        let photo = view.photo.photo().unwrap();
        let pixel = |x: usize, y: usize| &photo.rgb[3 * (y * width + x)..][..3];
        let distance =
            |a: &[u8], b: &[u8]| a.iter().zip(b).map(|(&a, &b)| u64::from(a.abs_diff(b))).sum::<u64>();
        let mut seen = 0;
        for (&position, color) in dataset.points.positions.iter().zip(&dataset.points.colors) {
            let (x, y, depth) = view.camera.project(Vec3::from_array(position));
            if depth > 0.0 && x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32 {
                seen += 1;
                let (x, y) = (x as usize, y as usize);
                difference += distance(pixel(x, y), color);
                mirrored += distance(pixel(width - 1 - x, y), color);
            }
        }
        assert!(seen > 500, "{}: {seen} points", view.name);
    }
    assert!(3 * difference < 2 * mirrored, "colours differ by {difference}, mirrored by {mirrored}");
}

fn fox_text(path: &Path) {
    let text = Model::read(&find(path).unwrap()).unwrap();
    assert!(text.source.text);
    let binary = Model::of_dataset(path.with_file_name("quarter")).unwrap();
    assert!(!binary.source.text);
    assert_eq!(text.cameras, binary.cameras);
    let sorted = |model: &Model| {
        let mut images = model.images.clone();
        images.sort_by_key(|image| image.id);
        images
    };
    assert_eq!(sorted(&text), sorted(&binary));
    let mut points = [&text, &binary].map(|model| {
        let rows = model.points.positions.iter().zip(&model.points.colors);
        rows.map(|(p, c)| (p.as_vec3().to_array().map(f32::to_bits), *c)).collect::<Vec<_>>()
    });
    points.iter_mut().for_each(|p| p.sort());
    assert!(points[0] == points[1], "points differ");
}

fn trained(path: &Path, count: usize, sh_degree: u32) {
    let options = splats::ReadOptions::default();
    let scene = splats::read(path, &options).unwrap();
    let gaussians = &scene.gaussians;
    assert_eq!((gaussians.len(), gaussians.sh_degree), (count, sh_degree));
    gaussians.check_shapes().unwrap();
    assert_eq!(scene.dropped, 0);
    let folder = tempfile::tempdir().unwrap();
    let copy = folder.path().join("copy.ply");
    splats::write(&copy, gaussians, &splats::WriteOptions::default()).unwrap();
    // Not assert_eq, which would print a million numbers.
    assert!(splats::read(&copy, &options).unwrap().gaussians == *gaussians, "the copy differs");
    let statistics = gaussians.statistics();
    let bounds = statistics.central_bounds.unwrap();
    assert!(bounds.size().min_element() > 0.0 && bounds.size().is_finite(), "{statistics:?}");
}

/// Checks a scene of SH degree 0 in another format than PLY, and its copy in that format.
fn other_format(path: &Path, count: usize, antialiased: bool) {
    let read = |path: &Path| splats::read(path, &splats::ReadOptions::default()).unwrap();
    let scene = read(path);
    assert_eq!((scene.gaussians.len(), scene.gaussians.sh_degree), (count, 0));
    assert_eq!((scene.header.antialiased, scene.dropped), (antialiased, 0));
    let folder = tempfile::tempdir().unwrap();
    let copy = folder.path().join(format!("copy{}", scene.header.format.extension()));
    splats::write(&copy, &scene.gaussians, &splats::WriteOptions { antialiased, ..Default::default() })
        .unwrap();
    let again = read(&copy);
    assert_eq!((again.gaussians.len(), again.header.antialiased), (count, antialiased));
    let (a, b) = (scene.gaussians.statistics(), again.gaussians.statistics());
    let (a, b) = (a.central_bounds.unwrap(), b.central_bounds.unwrap());
    assert!(a.min.abs_diff_eq(b.min, 2e-3) && a.max.abs_diff_eq(b.max, 2e-3), "{a:?} {b:?}");
}
