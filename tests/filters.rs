//! Mip-Splatting's filters in training, in files and in pictures.

use crate::common::prelude::*;
use ashsplat_files::ply;
use ashsplat_files::splats::{self, WriteOptions};

/// Densifies after 15, 20, ... 35, resets opacities after 20, computes new filter sizes after 100 and 200.
fn settings() -> TrainSettings {
    TrainSettings {
        iterations: 320,
        antialiasing: true,
        kernel_size: 0.1,
        filter_3d: true,
        densification_interval: 5,
        ..crate::common::training::settings()
    }
}

fn cameras() -> Vec<Camera> {
    views(3, 9).iter().map(|view| view.camera).collect()
}

/// Filter sizes that a renderer computes for the trained scene.
fn fresh(gpu: &Gpu, trainer: &Trainer) -> Vec<f32> {
    computed(gpu, &trainer.trained(), &trainer.cameras().expect("cameras"))
}

fn computed(gpu: &Gpu, scene: &Gaussians, cameras: &[Camera]) -> Vec<f32> {
    let mut renderer = loaded(gpu.context, scene);
    renderer.compute_filters(cameras).expect("sizes");
    renderer.filters().expect("sizes")
}

#[test]
fn filters_follow_the_gaussians_when_they_are_due() {
    // The same iterations, as shares of 30,000.
    let scaled = TrainSettings {
        scale_schedule: true,
        densify_from_iter: 938,
        densify_until_iter: 3563,
        ..settings()
    };
    for settings in [settings(), scaled] {
        let gpu = Gpu::unchecked();
        let mut trainer = Run::new(gpu.context, views(3, 9), settings).begin();
        let mut before = trainer.filters().expect("sizes");
        assert!(before == fresh(&gpu, &trainer), "at the start");
        assert!(before.iter().all(|&size| size > 0.0));
        let mut computed = Vec::new();
        for iteration in 1..=320 {
            trainer.steps(1);
            let after = trainer.filters().expect("sizes");
            if after != before {
                computed.push(iteration);
                assert!(iteration < 100 || after == fresh(&gpu, &trainer), "{iteration}");
            }
            before = after;
        }
        // The step after a densification first does the work that is due.
        assert_eq!(computed, [16, 21, 26, 31, 36, 100, 200]);
    }
}

#[test]
fn filters_follow_moved_cameras() {
    let gpu = Gpu::new();
    let settings = TrainSettings { pose_opt: true, pose_lr: 1e-2, ..settings() };
    let mut trainer = Run::new(gpu.context, views(3, 9), settings).begin();
    trainer.steps(100);
    assert!(trainer.cameras().expect("cameras") != cameras());
    let sizes = trainer.filters().expect("sizes");
    assert!(sizes == fresh(&gpu, &trainer));
    assert!(sizes != computed(&gpu, &trainer.trained(), &cameras()), "the cameras as given");
}

#[test]
fn filters_resume_to_the_bit() {
    let run = Run::shared(views(3, 9), settings());
    let whole = run.until(220, &[]);
    assert_eq!(whole.filters.len(), whole.gaussians.len());
    for stops in [[7, 20], [99, 150], [100, 201]] {
        assert!(run.until(220, &stops) == whole, "interrupted after {stops:?}: other bits");
    }
}

#[test]
fn filters_are_within_the_memory() {
    let run = |max_memory: Option<u64>| {
        let context = bounded(max_memory);
        let state = Run::new(&context, views(3, 9), settings()).until(40, &[]);
        (state, context.memory_total().peak_bytes)
    };
    let (_, peak) = run(None);
    let (first, used) = run(Some(peak * 4 / 5));
    assert!(used <= peak * 4 / 5 && first == run(Some(peak * 4 / 5)).0);
}

/// A file keeps the sizes; reading it gives the filtered Gaussians.
#[test]
fn filters_are_baked_when_they_are_read() {
    let gpu = Gpu::new();
    let (_folder, [path]) = new_paths(["a.ply"]);
    let mut gaussians = start();
    let mut renderer = loaded(gpu.context, &gaussians);
    let (camera, plain) = (cameras()[0], RenderSettings { antialias: true, ..RenderSettings::default() });
    let before = renderer.render(&camera, &plain).expect("a frame").color;
    renderer.compute_filters(&cameras()).expect("sizes");
    let sizes = renderer.filters().expect("sizes");
    assert!(renderer.render(&camera, &plain).expect("a frame").color == before, "not asked for");
    let settings = RenderSettings { filter_3d: true, ..plain };
    let filtered = renderer.render(&camera, &settings).expect("a frame").color;
    assert!(filtered != before);
    let antialiased = WriteOptions { antialiased: true, ..Default::default() };
    ply::write_filtered(&path, &gaussians, &sizes, &antialiased).expect("written");
    let text = String::from_utf8_lossy(&std::fs::read(&path).expect("a file")[..2000]).into_owned();
    assert_says(&text, &["property float filter_3D\nend_header", "comment SplatRenderMode: mip"]);
    let read = splats::read(&path, &splats::ReadOptions::default()).expect("a scene").gaussians;
    gaussians.bake_filters(&sizes).expect("one each");
    assert!(read == gaussians);
    renderer.upload(&read).expect("uploaded");
    let baked = renderer.render(&camera, &plain).expect("a frame").color;
    let far = |(a, b): (&[f32; 3], &[f32; 3])| (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, f32::max);
    assert!(baked.iter().zip(&filtered).map(far).fold(0.0, f32::max) < 1e-4);
}

#[test]
fn filters_need_cameras_and_one_size_each() {
    let gpu = Gpu::new();
    let mut renderer = Renderer::new(gpu.context).expect("a renderer");
    assert!(renderer.compute_filters(&cameras()).is_err(), "no scene");
    renderer.upload(&start()).expect("uploaded");
    assert_says(refusal(renderer.compute_filters(&[])), &["cameras"]);
    let path = tempdir().expect("a temporary folder").path().join("a.ply");
    assert!(ply::write_filtered(path, &start(), &[1.0], &WriteOptions::default()).is_err());
    for dilation_px2 in [0.0, -1.0, f32::NAN] {
        let settings = RenderSettings { dilation_px2, ..RenderSettings::default() };
        assert!(renderer.render(&cameras()[0], &settings).is_err(), "{dilation_px2}");
    }
    let settings = TrainSettings { kernel_size: 0.0, ..settings() };
    assert!(settings.check().expect_err("refused").to_string().starts_with("kernel_size"));
}
