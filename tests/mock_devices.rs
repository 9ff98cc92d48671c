//! The same results on devices with other memory, queues and limits, which the layer of `tools/mock_layer` simulates
//! on llvmpipe.
//!
//! A layer needs a separate process. The simulated machines claim to be GPUs, so they use the kernels of GPUs; this process
//! uses them as well, for comparison. A training must end with the same bits, wherever memory lies and whichever queue
//! copies. `tools/as_gpu mock:discrete` runs the whole suite on one.

use crate::common::prelude::*;
use crate::common::{child, context, root};
use ashsplat::frame::tuning::Backend;
use ashsplat::vk::Transfers;
use ashsplat_mock_layer::{FORGETTING, VARIABLE};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::LazyLock;

/// Tests that a child runs: the device's claims, trainings and pictures for the parent, and transfers of all kinds.
const SELECTION: [&str; 5] = [
    "mock_device_claims_in_a_child",
    "mock_device_results_in_a_child",
    "vk::memory::transfers_give_back_what_they_got",
    UPLOADS,
    "vk::memory::staging_is_a_ring_that_is_kept_and_given_back",
];

/// Further tests on machines with other limits: kernels whose workgroups and shared memory depend on them.
const SHAPES: [&str; 4] = [
    "kernels::scan::scan_apply_equals_its_twin",
    "kernels::sort::sort_downsweep_equals_its_twin",
    "kernels::blend::blend_shared_equals_blend_on_images_of_all_sizes_and_opaque_layers",
    "hard_cases::hard_case_images_of_odd_sizes",
];

/// Further tests on discrete GPUs: bounded memory, which transfers share, and failing calls.
const BOUNDED: [&str; 6] = [
    "faults::faults_of_other_objects",
    "limits::memory_that_cannot_suffice_is_said_before_any_work",
    "limits::memory_budget_is_trainings_whoever_looks_on",
    "orientations::orientations_need_the_memory_that_is_forecast",
    "visible_memory::a_reserve_gives_way_to_a_frame_in_the_middle_of_a_run",
    "visible_memory::a_view_that_shows_too_much_stops_growth",
];

/// Test of an upload into a buffer that a submission still reads.
const UPLOADS: &str = "vk::memory::uploads_run_after_what_was_submitted";
/// Test of photographs that are uploaded while the main queue computes, where another queue copies them.
const PHOTOS: &str = "photos::photos_from_a_file_give_the_same_bits";

/// Environment variable with the folder for a child's results.
const RESULTS: &str = "ASHSPLAT_MOCK_RESULTS";
const LAYERS: &str = "VK_LAYER_KHRONOS_validation:VK_LAYER_ASHSPLAT_mock";

/// Fingerprint of a training with a densification.
fn trained(context: &Context) -> String {
    let settings = TrainSettings {
        sh_degree_interval: 2,
        densify_from_iter: 3,
        densification_interval: 4,
        densify_grad_threshold: 1e-6,
        ..TrainSettings::reference()
    };
    format!("{:?}", Run::new(context, views(3, 5), settings).until(10, &[]).fingerprint())
}

fn results(context: &Context) -> (Vec<f32>, String) {
    let mut renderer = loaded(context, &gaussians(&mixed_scene(&mut Random::new(17), 1500, 16)));
    let frame = renderer.render(&camera(&small_view([203, 117])), &RenderSettings::default());
    let trained = trained(context);
    assert_silent(context);
    (frame.expect("a picture").color.into_flattened(), trained)
}

/// Expected results of every machine: those of the same kernels without the layer.
static OWN: LazyLock<(Vec<f32>, String)> = LazyLock::new(|| {
    let own = ContextOptions { backend: Some(Backend::Gpu), ..options() };
    results(&Context::new(&own).expect("a device"))
});

/// True if machines can be simulated here; prints the reason otherwise.
fn can_be_claimed() -> bool {
    if !cfg!(target_os = "linux") || !context().device_name().contains("llvmpipe") {
        eprintln!("skipped: machines are claimed over llvmpipe on Linux only");
        return false;
    }
    if std::env::var_os(VARIABLE).is_some() {
        eprintln!("skipped: this device is claimed already");
        return false;
    }
    true
}

fn claim(child: &mut Command, machine: &str) {
    let library = std::env::current_exe().expect("a path");
    let mut libraries = vec![library.parent().expect("deps").to_owned()];
    libraries.extend(std::env::var_os("LD_LIBRARY_PATH").iter().flat_map(std::env::split_paths));
    child
        .args(["--test-threads", "2"])
        .env("LD_LIBRARY_PATH", std::env::join_paths(&libraries).expect("paths"))
        .env("VK_ADD_LAYER_PATH", root().join("tools/mock_layer"))
        .env("VK_INSTANCE_LAYERS", LAYERS)
        .env(VARIABLE, machine)
        .env_remove("ASHSPLAT_BACKEND");
}

fn check(machine: &str) {
    if !can_be_claimed() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder for results");
    let more = match machine {
        "small-limits" => &SHAPES[..],
        "discrete" => &BOUNDED,
        "discrete-rebar" => &[BOUNDED[0], PHOTOS],
        "transfer-queue" | "transfer-queue-main-late" => &[PHOTOS],
        _ => &[],
    };
    let selection = [&SELECTION[..], more].concat();
    child::run(&selection, selection.len(), |child| {
        claim(child, machine);
        child.env(RESULTS, folder.path());
    });
    let read = |name: &str| std::fs::read(folder.path().join(name)).expect("the child's results");
    let (picture, trained) = &*OWN;
    let theirs: Vec<f32> = bytemuck::pod_collect_to_vec(&read("picture"));
    assert!(picture.iter().filter(|x| **x > 0.1).count() > picture.len() / 10, "there is little to be seen");
    assert_eq!(picture.len(), theirs.len());
    let largest = picture.iter().zip(&theirs).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    // Other workgroups add in another order.
    if machine == "small-limits" {
        assert!(largest < 1.0 / 128.0, "{machine}: pictures differ by {largest:e}");
    } else {
        assert!(largest == 0.0, "{machine}: pictures differ by {largest:e}");
        assert_eq!(String::from_utf8_lossy(&read("trained")), *trained, "{machine}: other bits");
    }
}

/// Generates one trial per machine, so that they run in parallel.
macro_rules! machines {
    ($($trial:ident: $machine:literal;)*) => {
        $(#[test] fn $trial() { check($machine); })*

    };
}

machines! {
    mock_device_discrete: "discrete";
    mock_device_discrete_window: "discrete-window";
    mock_device_discrete_rebar: "discrete-rebar";
    mock_device_unified: "unified";
    mock_device_unified_uncached: "unified-uncached";
    mock_device_transfer_queue: "transfer-queue";
    mock_device_transfer_queue_main_late: "transfer-queue-main-late";
    mock_device_small_limits: "small-limits";
}

/// Tests fail if either queue ignores its waits, as if the engine missed one. They pass if that queue runs late.
#[test]
fn mock_device_finds_missing_waits() {
    if !can_be_claimed() {
        return;
    }
    let fails = |machine, forgetting: &str, trial: &str| {
        let mut child = Command::new(std::env::current_exe().expect("the test binary"));
        claim(child.args([trial, "--exact"]).stdin(Stdio::null()), machine);
        let output = child.env(FORGETTING, forgetting).output().expect("the test binary runs");
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(text.contains("running 1 test\n"), "{text}{}", String::from_utf8_lossy(&output.stderr));
        !output.status.success()
    };
    assert!(fails("transfer-queue", "others", PHOTOS));
    // On this machine, too, photographs use the copy queue.
    assert!(fails("discrete-rebar", "others", PHOTOS));
    assert!(fails("transfer-queue-main-late", "copies", UPLOADS));
    assert!(!fails("transfer-queue", "copies", UPLOADS));
}

#[test]
#[ignore = "the child's part of mock_device_…: results for the parent"]
fn mock_device_results_in_a_child() {
    let folder = PathBuf::from(std::env::var_os(RESULTS).expect("mock_device_… sets it"));
    let (picture, trained) = results(context());
    // With parameters and moments in this machine's host memory.
    context().set_offload(Some(1 << 30));
    assert_eq!(self::trained(context()), trained);
    context().set_offload(None);
    assert!(context().memory_offloaded().peak_bytes > 0);
    assert_silent(context());
    let picture: &[u8] = bytemuck::cast_slice(&picture);
    std::fs::write(folder.join("picture"), picture).expect("written");
    std::fs::write(folder.join("trained"), trained).expect("written");
}

#[test]
#[ignore = "the child's part of mock_device_…: the layer is there, and memory is as a card's"]
fn mock_device_claims_in_a_child() {
    let machine = std::env::var(VARIABLE).expect("mock_device_… sets it");
    let context = context();
    assert!(context.device_name().starts_with(&format!("{machine} mock of ")), "{}", context.device_name());
    let kind = if machine.starts_with("unified") { "integrated GPU" } else { "discrete GPU" };
    assert_eq!((context.description().kind, context.limits().tuning.backend), (kind, Backend::Gpu));
    // The machine's budget is smaller than its heap.
    let (budget, name) = context.memory_limit().expect("a bound");
    assert!(name == "VK_EXT_memory_budget" && budget < context.limits().heap_bytes, "{budget} by {name}");
    if machine == "small-limits" {
        let limits = context.limits();
        assert_eq!(limits.max_workgroup_invocations, 256);
        assert_eq!((limits.shared_memory_bytes, limits.push_constant_bytes), (16 << 10, 128));
    }
    let (writes_directly, reads_directly, copy_queue) = match machine.as_str() {
        "discrete" | "discrete-window" | "small-limits" => (false, false, false),
        "discrete-rebar" => (true, false, true),
        "unified" => (true, true, false),
        "unified-uncached" => (true, false, false),
        "transfer-queue" | "transfer-queue-main-late" => (false, false, true),
        other => panic!("how does {other} transfer?"),
    };
    assert_eq!(context.transfers(), Transfers { writes_directly, reads_directly, copy_queue }, "{machine}");
    // New memory holds garbage, not zeros.
    let buffers = context.allocate("new", &[("words", 64)], MemoryKind::Device).expect("memory");
    assert_eq!(context.download(&buffers[0]).expect("download"), [0xFF; 64]);
    assert_silent(context);
}
