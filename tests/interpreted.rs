//! Kernels with subgroups of 32, 64 and 128 lanes, which no software driver has. An interpreter of their SPIR-V
//! (tests/interpreter) runs them with a GPU's workgroups against the twins.

use crate::common::gpu::Gpu;
use crate::common::machine::{Machine, on};
use crate::kernels::{
    blend, blend_backward, cull, densify, draws, filter_3d, lists, poses, project_backward, scan, sort,
};
use ashsplat::frame::LaunchSizes;
use ashsplat::kernels::sort::{sort_downsweep, sort_upsweep};

/// Subgroups of AMD's GPUs, with the elementwise workgroups of all GPUs.
const AMD: Machine = Machine::Interpreter { lanes: 64, workgroup: 256 };

/// Runs tests of kernels at 64 lanes and at the other supported sizes.
fn on_wide_machines(tests: impl Fn()) {
    for lanes in [64, 32, 128] {
        on(Machine::Interpreter { lanes, workgroup: 256 }, &tests);
    }
}

fn scans() {
    scan::scan_reduce_equals_its_twin();
    scan::scan_apply_equals_its_twin();
    scan::scan_spine_equals_its_twin();
}

fn sorts() {
    sort::sort_upsweep_equals_its_twin();
    sort::sort_spine_equals_its_twin();
    sort::sort_downsweep_equals_its_twin();
}

#[test]
fn wide_scan() {
    on_wide_machines(|| {
        scans();
        scan::scan_spine_saturates_exactly_beyond_32_bits();
    });
}

#[test]
fn wide_sort() {
    on_wide_machines(|| {
        sorts();
        sort::sort_downsweep_of_equal_and_extreme_keys();
    });
    on(AMD, || {
        let gpu = Gpu::new();
        let LaunchSizes { sort_workgroup: workgroup_size, sort_items: items, .. } =
            LaunchSizes::new(gpu.limits());
        sort::check_upsweep(&gpu, sort_upsweep::Spec { workgroup_size, items });
        let (subgroup_size, identity_values) = (gpu.subgroup(), true);
        let spec = sort_downsweep::Spec { workgroup_size, subgroup_size, items, identity_values };
        sort::check_downsweep_sizes(&gpu, spec);
    });
}

#[test]
fn wide_cull_and_compact() {
    on_wide_machines(|| {
        cull::cull_equals_its_twin();
        cull::cull_equals_its_twin_under_dropout();
        cull::cull_equals_its_twin_under_a_scenes_opacity();
        cull::cull_equals_its_twin_with_cut_outs();
        cull::cull_of_non_finite_parameters();
        lists::compact_equals_its_twin();
    });
}

#[test]
fn wide_blend() {
    on_wide_machines(blend::blend_equals_its_twin_on_images_of_all_sizes);
    on(AMD, || {
        blend::blend_equals_its_twin_on_lists_of_all_lengths();
        blend::blend_in_passes_equals_blend_at_once();
        blend::blend_reports_tiles_that_no_pass_finishes();
        blend::blend_stops_at_the_depth_limit();
        blend::blend_of_several_regions_per_subgroup_is_the_same();
    });
}

#[test]
fn wide_blend_backward() {
    on_wide_machines(|| {
        blend_backward::blend_backward_equals_its_twin_on_images_of_all_sizes();
        blend_backward::blend_backward_of_the_first_scene_alone();
    });
    on(AMD, || {
        blend_backward::blend_backward_equals_its_twin_on_lists_of_all_lengths();
        blend_backward::blend_backward_in_passes();
        blend_backward::blend_backward_of_nothing_is_zero();
        blend_backward::blend_backward_with_other_sums_equals_its_twin();
    });
}

/// The other kernels with subgroup operations that can be dispatched alone.
#[test]
fn wide_expand_and_project_backward() {
    on_wide_machines(|| {
        lists::count_equals_its_twin();
        lists::duplicate_with_tiles_equals_its_twin();
        lists::duplicate_with_tiles_of_needles();
        project_backward::project_backward_equals_its_twin();
        project_backward::project_backward_of_the_pose_equals_its_twin();
        poses::pose_gradient_equals_its_twin();
    });
}

#[test]
fn wide_densify_and_sum() {
    on_wide_machines(|| {
        densify::classify_equals_its_twin();
        draws::draw_keys_equals_its_twin();
        draws::sum_weights_equals_its_twin();
        filter_3d::nearest_depths_equals_its_twin();
    });
}
