//! The same integers and tolerances with any subgroup size: llvmpipe supports 4, 8 or 16 lanes.

use crate::common::prelude::*;
use crate::common::{child, context};
use std::path::Path;

/// Tests that the child processes run. Sort and scan equal the twins to the bit. Blending, its backward, the
/// projection's backward, the loss and whole frames with gradients are within tolerances.
const SELECTION: [&str; 19] = [
    "subgroup_size_is_the_one_asked_for_in_a_child",
    "kernels::scan::scan_apply_equals_its_twin",
    "kernels::scan::scan_spine",
    "kernels::lpips::convolve_equals_its_twin",
    "kernels::sort::sort_spine",
    "kernels::sort::sort_downsweep_equals_its_twin",
    "kernels::sort::sort_upsweep_serial",
    "kernels::sort::sort_single_subgroup",
    "kernels::sort::sort_downsweep_serial_equals_its_twin",
    "sort::sort_of_keys_of_few_bits",
    "kernels::blend::blend_equals_its_twin_on_images_of_all_sizes",
    "kernels::blend_backward::blend_backward_equals_its_twin_on_images_of_all_sizes",
    "kernels::blend::blend_shared_equals_blend_on_images_of_all_sizes_and_opaque_layers",
    "kernels::ssim::loss_by_blocks_and_by_sweeps",
    "kernels::project_backward::project_backward_equals_its_twin_in_every_mode",
    "kernels::project_backward::project_backward_of_the_pose_equals_its_twin",
    "kernels::poses::pose_gradient_equals_its_twin",
    "hard_cases::hard_case_images_of_odd_sizes",
    "subgroup_width_picture_in_a_child",
];

/// Environment variable of the child processes: the expected subgroup size.
const EXPECTED: &str = "ASHSPLAT_EXPECTED_SUBGROUP_SIZE";
/// Folder for shader caches by number of lanes, if they are reused, as in `.ci/run`.
const CACHES: &str = "ASHSPLAT_SHADER_CACHES";
/// Environment variable with the file for a child's picture.
const PICTURE: &str = "ASHSPLAT_PICTURE";

fn check_width(bits: u32) {
    if !context().device_name().contains("llvmpipe") {
        eprintln!("skipped: the subgroup size can be chosen on llvmpipe only");
        return;
    }
    let lanes = bits / 32;
    let folder = tempdir().expect("a folder for the picture and the shader cache");
    // The driver's shader cache ignores the width, so each width has a separate folder.
    let kept = std::env::var_os(CACHES).map(|caches| Path::new(&caches).join(lanes.to_string()));
    let cache = kept.as_deref().unwrap_or(folder.path());
    std::fs::create_dir_all(cache).expect("a folder for the shader cache");
    let picture = folder.path().join("picture");
    child::run(&SELECTION, SELECTION.len(), |child| {
        child
            .args(["--test-threads", "2"])
            .env("LP_NATIVE_VECTOR_WIDTH", bits.to_string())
            .env("MESA_SHADER_CACHE_DIR", cache)
            // Compiling takes most of the time, and half of that is LLVM's passes.
            .env("GALLIVM_PERF", "nopt")
            // Parallel workgroups, even if the rest of the suite runs them one after another, as in .ci/run.
            .env("LP_NUM_THREADS", "2")
            .env(EXPECTED, lanes.to_string())
            .env(PICTURE, &picture);
    });
    let bytes = std::fs::read(picture).expect("the child's picture");
    compare(lanes, &bytemuck::pod_collect_to_vec(&bytes));
}

fn picture() -> Vec<f32> {
    let scene = gaussians(&mixed_scene(&mut Random::new(91), 3000, 16));
    let mut renderer = renderer();
    renderer.upload(&scene).expect("upload");
    let frame = renderer.render(&camera(&small_view([320, 200])), &RenderSettings::default());
    frame.expect("a picture").color.into_flattened()
}

/// Pictures of different subgroup sizes may differ, because the driver's code does. This bounds the difference.
fn compare(lanes: u32, other: &[f32]) {
    let own = picture();
    assert_eq!(own.len(), other.len());
    assert!(own.iter().filter(|x| **x > 0.2).count() > own.len() / 10, "there is little to be seen");
    let differences: Vec<f32> = own.iter().zip(other).map(|(a, b)| (a - b).abs()).collect();
    let largest = differences.iter().copied().fold(0.0, f32::max);
    let mean = differences.iter().map(|&d| f64::from(d)).sum::<f64>() / own.len() as f64;
    // Rounding may change a decision at a pixel: a Gaussian of alpha 1/255 more or less.
    assert!(mean < 1e-6 && largest < 1.0 / 128.0, "{lanes} lanes: mean {mean:e}, most {largest:e}");
}

#[test]
#[ignore = "the child's part of subgroup_width_of_…: the picture for the parent"]
fn subgroup_width_picture_in_a_child() {
    let path = std::env::var_os(PICTURE).expect("subgroup_width_of_… sets it");
    std::fs::write(path, bytemuck::cast_slice::<f32, u8>(&picture())).expect("written");
}

#[test]
fn subgroup_width_of_4_lanes() {
    check_width(128);
}

#[test]
fn subgroup_width_of_16_lanes() {
    check_width(512);
}

#[test]
#[ignore = "the child's part of subgroup_width_of_…: the width took effect"]
fn subgroup_size_is_the_one_asked_for_in_a_child() {
    let expected = std::env::var(EXPECTED).expect("subgroup_width_of_… sets it");
    assert_eq!(context().limits().subgroup_size.to_string(), expected);
}
