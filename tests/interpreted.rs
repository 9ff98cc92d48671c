//! Kernels with subgroups of 32, 64 and 128 lanes, which no software driver has. An interpreter of their SPIR-V
//! (tests/interpreter) runs them with a GPU's workgroups against the twins, and with the device's lanes against the
//! device.

use ashsplat::kernels::scan::scan_reduce;
use ashsplat::kernels::sort::{sort_downsweep, sort_upsweep};
use ashsplat::kernels::visit_all;
use ashsplat::plan::LaunchSizes;
use ashsplat::vk::{BindingKind, KernelInterface, KernelVisitor};
use ashsplat_interpreter::{Dispatch, Fault, Order, Program};

use crate::common::context;
use crate::common::gpu::Gpu;
use crate::common::machine::{Machine, on};
use crate::kernels::{
    blend, blend_backward, classify, compact, count, cull, draw_keys, duplicate_with_tiles, loss_reduce,
    nearest_depths, pose_gradient, project_backward, scan_apply, scan_reduce as reduce, scan_spine,
    sort_downsweep as downsweep, sort_spine, sort_upsweep as upsweep, sum_weights,
};

/// Subgroups of AMD's GPUs, with the elementwise workgroups of all GPUs.
const AMD: Machine = Machine::Interpreter { lanes: 64, workgroup: 256 };

/// Runs tests of kernels at 64 lanes and at the other supported sizes.
fn on_wide_machines(tests: impl Fn()) {
    for lanes in [64, 32, 128] {
        on(Machine::Interpreter { lanes, workgroup: 256 }, &tests);
    }
}

fn scans() {
    reduce::scan_reduce_equals_its_twin();
    scan_apply::scan_apply_equals_its_twin();
    scan_spine::scan_spine_equals_its_twin();
}

fn sorts() {
    upsweep::sort_upsweep_equals_its_twin();
    sort_spine::sort_spine_equals_its_twin();
    downsweep::sort_downsweep_equals_its_twin();
}

// ---- the interpreter by the device ---------------------------------------------------------------------------------

#[test]
fn interpreter_scans_and_sorts_as_the_device_to_the_bit() {
    on(Machine::Both { error: 0.0 }, || {
        scans();
        sorts();
        compact::compact_equals_its_twin();
    });
}

/// Only on llvmpipe: other drivers' exponentials may change decisions, within the twins' tolerances.
#[test]
fn interpreter_culls_and_blends_as_the_device() {
    if !context().device_name().contains("llvmpipe") {
        eprintln!("skipped: the interpreter beside the device: not on {}", context().device_name());
        return;
    }
    on(Machine::Both { error: 0.0 }, cull::cull_equals_its_twin);
    on(Machine::Both { error: 1e-5 }, blend::blend_equals_its_twin_on_images_of_all_sizes);
    // Sums of many terms of both signs.
    on(Machine::Both { error: 2e-4 }, || {
        blend_backward::blend_backward_equals_its_twin_on_images_of_all_sizes();
    });
}

// ---- 64 lanes ------------------------------------------------------------------------------------------------------

#[test]
fn wide_scan() {
    on_wide_machines(|| {
        scans();
        scan_spine::scan_spine_saturates_exactly_beyond_32_bits();
    });
}

#[test]
fn wide_sort() {
    on_wide_machines(|| {
        sorts();
        downsweep::sort_downsweep_of_equal_and_extreme_keys();
    });
    on(AMD, || {
        let gpu = Gpu::new();
        let LaunchSizes { sort_workgroup: workgroup_size, sort_items: items, .. } =
            LaunchSizes::new(gpu.limits());
        upsweep::check_sizes(&gpu, sort_upsweep::Spec { workgroup_size, items });
        let (subgroup_size, identity_values) = (gpu.subgroup(), true);
        let spec = sort_downsweep::Spec { workgroup_size, subgroup_size, items, identity_values };
        downsweep::check_sizes(&gpu, spec);
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
        compact::compact_equals_its_twin();
    });
}

#[test]
fn wide_blend() {
    on_wide_machines(blend::blend_equals_its_twin_on_images_of_all_sizes);
    on(AMD, || {
        blend::blend_equals_its_twin_on_lists_of_all_lengths();
        blend::blend_of_opaque_layers();
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
        blend_backward::blend_backward_of_opaque_layers();
        blend_backward::blend_backward_in_passes();
        blend_backward::blend_backward_of_nothing_is_zero();
        blend_backward::blend_backward_with_other_sums_equals_its_twin();
    });
}

/// The other kernels with subgroup operations that can be dispatched alone.
#[test]
fn wide_expand_and_project_backward() {
    on_wide_machines(|| {
        count::count_equals_its_twin();
        duplicate_with_tiles::expand_equals_its_twin();
        duplicate_with_tiles::expand_of_needles();
        project_backward::project_backward_equals_its_twin();
        project_backward::project_backward_of_the_pose_equals_its_twin();
        pose_gradient::pose_gradient_equals_its_twin();
    });
}

#[test]
fn wide_densify_and_sum() {
    on_wide_machines(|| {
        classify::decide_equals_its_twin();
        draw_keys::draw_keys_equals_its_twin();
        sum_weights::sum_weights_equals_its_twin();
        nearest_depths::nearest_depths_equals_its_twin();
        loss_reduce::loss_reduce_equals_its_twin();
    });
}

/// All kernels except those that read images or texels.
#[test]
fn interpreter_takes_every_kernel_of_buffers() {
    struct Taken(usize);
    impl KernelVisitor for Taken {
        fn visit<K: KernelInterface>(&mut self) {
            let is_of_buffers = K::BINDINGS.iter().all(|b| !matches!(b.kind, BindingKind::Texels(_)));
            if K::IMAGES.is_empty() && is_of_buffers {
                Program::new(K::NAME, K::SPIRV, &[(0, 256), (1, 64)], 1).expect("a program");
                self.0 += 1;
            }
        }
    }
    let mut taken = Taken(0);
    visit_all(&mut taken);
    assert!(taken.0 > 60, "{}", taken.0);
}

// ---- what the interpreter finds ------------------------------------------------------------------------------------

const OP_CONTROL_BARRIER: u32 = 224;

/// Positions of an opcode in a module.
fn places(module: &[u32], opcode: u32) -> Vec<usize> {
    let (mut at, mut found) = (5, Vec::new());
    while at < module.len() {
        if module[at] & 0xFFFF == opcode {
            found.push(at);
        }
        at += (module[at] >> 16) as usize;
    }
    found
}

/// The module with one instruction replaced by OpNop.
fn without(module: &[u32], at: usize) -> Vec<u32> {
    let mut changed = module.to_vec();
    changed[at..at + (module[at] >> 16) as usize].fill(1 << 16);
    changed
}

/// Sums 900 values with subgroups of 64 in workgroups of 128, into `words` words of output.
fn sums(words: usize) -> Result<Vec<u32>, Fault> {
    let module = scan_reduce::Interface::SPIRV;
    let program = Program::new("scan_reduce", module, &[(0, 128), (1, 64), (2, 4)], 64).expect("a program");
    let mut buffers = vec![(0, vec![900]), (1, (0..900).collect()), (2, vec![7; words])];
    let order = Order::Shuffled(3);
    let dispatch = Dispatch { workgroups: [2, 1, 1], push: &[0; 4], order, accepts_unwritten_shared: false };
    program.run(&dispatch, &mut buffers)?;
    Ok(buffers.remove(2).1)
}

#[test]
fn interpreter_finds_accesses_out_of_bounds() {
    assert_eq!(sums(3).expect("sums"), [(0..512).sum(), (512..900).sum(), 7]);
    let fault = sums(1).expect_err("one word for two sums");
    assert!(fault.problem.contains("writes word 1 of 'block_sums', which has 1"), "{fault}");
    assert_eq!((fault.workgroup, fault.subgroup, fault.lane), ([1, 0, 0], 0, Some(0)), "{fault}");
    assert!(fault.to_string().contains("scan_reduce: ") && fault.opcode == 62, "{fault}");
}

/// The interpreter finds each missing barrier of a kernel that sorts and scans, in every order of subgroups. One
/// barrier is only needed with a single subgroup per workgroup, the scan's only with several.
#[test]
fn interpreter_finds_missing_barriers() {
    let module = sort_downsweep::Interface::SPIRV;
    let barriers = places(module, OP_CONTROL_BARRIER);
    let run = |module: &[u32], subgroups: u32, order, accepts_unwritten_shared| {
        let constants = [(0, 64 * subgroups), (1, 64), (2, 4 / subgroups)];
        let program = Program::new("sort_downsweep", module, &constants, 64).expect("a program");
        // All 16 digits.
        let keys: Vec<u32> = (0..512_u32).map(|k| (k.wrapping_mul(0x9E37_79B9) >> 28) * 17).collect();
        let digits: Vec<u32> = (0..256).map(|d| keys.iter().filter(|k| **k == d).count() as u32).collect();
        let before =
            |digit: u32, block: usize| keys[..256 * block].iter().filter(|k| **k == digit).count() as u32;
        let histogram = (0..256).flat_map(|digit| [before(digit, 0), before(digit, 1)]).collect();
        let mut buffers = vec![
            (0, vec![512]),
            (1, keys.clone()),
            (2, (0..512).collect()),
            (3, histogram),
            (4, digits),
            (5, vec![0; 512]),
            (6, vec![0; 512]),
        ];
        let push: Vec<u8> = [0_u32, 0, 8].iter().flat_map(|word| word.to_le_bytes()).collect();
        let dispatch = Dispatch { workgroups: [2, 1, 1], push: &push, order, accepts_unwritten_shared };
        program.run(&dispatch, &mut buffers)?;
        let mut sorted = keys;
        sorted.sort_unstable();
        assert_eq!(buffers[5].1, sorted);
        Ok::<_, Fault>(())
    };
    for order in [Order::Forward, Order::Reverse, Order::Shuffled(5)] {
        for subgroups in [1, 2] {
            run(module, subgroups, order, false).expect("a sort");
        }
        for (index, barrier) in barriers.iter().enumerate() {
            let changed = without(module, *barrier);
            for accepts in [false, true] {
                let faults = [1, 2].map(|subgroups| run(&changed, subgroups, order, accepts).err());
                assert!(faults.iter().any(Option::is_some), "barrier {index}, {order:?}: not missed");
                for fault in faults.iter().flatten() {
                    let is_of_memory = fault.problem.contains("without a barrier between")
                        || fault.problem.contains("nobody has written");
                    assert!(is_of_memory, "barrier {index}, {order:?}: {fault}");
                }
            }
        }
    }
    assert!(barriers.len() > 5, "{}", barriers.len());
}
