//! The same integers and the same tolerances whatever the subgroup size: llvmpipe gives 4, 8 or 16 lanes on demand.

use std::path::Path;
use std::process::{Command, Stdio};

use crate::common::context;

/// What the child processes run: sort and scan (integers, equal to the twins to the bit), blending, its backward, the
/// projection's backward (floats, within the tolerances), the loss, and whole frames with gradients.
const SELECTION: [&str; 9] = [
    "subgroup_size_is_the_one_asked_for",
    "kernels::scan_apply::scan_apply_equals_its_twin",
    "kernels::scan_spine",
    "kernels::sort_scan",
    "kernels::sort_scatter::sort_scatter_equals_its_twin",
    "kernels::blend::blend_equals_its_twin_on_images_of_all_sizes",
    "kernels::blend_backward::blend_backward_equals_its_twin_on_images_of_all_sizes",
    "kernels::project_backward::project_backward_equals_its_twin_in_every_mode",
    "hard_cases::hard_case_images_of_odd_sizes",
];

/// Set in the child processes.
const EXPECTED: &str = "ASHSPLAT_EXPECTED_SUBGROUP_SIZE";

/// The driver's shader cache ignores the width, so each width has a folder of its own.
fn run_with_width(bits: u32, cache: &Path) {
    let executable = std::env::current_exe().expect("the test binary");
    let output = Command::new(executable)
        .args(SELECTION)
        .args(["--test-threads", "2"])
        .env("LP_NATIVE_VECTOR_WIDTH", bits.to_string())
        .env("MESA_SHADER_CACHE_DIR", cache)
        .env(EXPECTED, (bits / 32).to_string())
        .stdin(Stdio::null())
        .output()
        .expect("the test binary runs");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{} lanes:\n{text}", bits / 32);
    assert!(text.contains("subgroup_size_is_the_one_asked_for ... ok"), "the child ran nothing:\n{text}");
}

fn check_width(bits: u32) {
    let in_child = std::env::var_os(EXPECTED).is_some();
    if in_child || !context().device_name().contains("llvmpipe") {
        eprintln!("skipped: the subgroup size can be chosen on llvmpipe only");
        return;
    }
    let cache = tempfile::tempdir().expect("a folder for the shader cache");
    run_with_width(bits, cache.path());
}

#[test]
fn subgroup_width_of_4_lanes() {
    check_width(128);
}

#[test]
fn subgroup_width_of_16_lanes() {
    check_width(512);
}

/// In a child process: the width took effect.
#[test]
fn subgroup_size_is_the_one_asked_for() {
    if let Ok(expected) = std::env::var(EXPECTED) {
        assert_eq!(context().limits().subgroup_size.to_string(), expected);
    }
}
