//! An instrumented device table: `record` calls nothing that submits, waits, allocates or maps.
//!
//! Each function of the guest's table is passed through, counted or absent. The first kind is `vkCmd*`, and four
//! others that only touch the guest's own descriptors and events. A call of an absent function panics.

use crate::auxiliary::flight::{OutputRequest, Outputs};
use crate::cut_outs::HIDES;
use crate::stage::*;
use ashsplat::ash::vk::Handle;
use ashsplat::train::StepOutcome;
use std::collections::BTreeSet;
use std::sync::Mutex;

mod subgroup_features;

static CALLS: Mutex<Vec<(&str, usize)>> = Mutex::new(Vec::new());

fn count(name: &'static str) {
    let mut calls = CALLS.lock().expect("no panic while held");
    match calls.iter_mut().find(|(n, _)| *n == name) {
        Some((_, calls)) => *calls += 1,
        None => calls.push((name, 1)),
    }
}

fn take_calls() -> Vec<(&'static str, usize)> {
    std::mem::take(&mut CALLS.lock().expect("no panic while held"))
}

type Callbacks = *const c_void;
type Device = vk::Device;

wrappers! {
    count;
    "vkAllocateMemory" allocate_memory(d: Device, i: *const c_void, c: Callbacks, o: *mut u64) -> i32;
    "vkFreeMemory" free_memory(d: Device, m: u64, c: Callbacks) -> ();
    "vkMapMemory" map_memory(d: Device, m: u64, o: u64, s: u64, f: u32, p: *mut *mut c_void) -> i32;
    "vkUnmapMemory" unmap_memory(d: Device, m: u64) -> ();
    "vkCreateBuffer" create_buffer(d: Device, i: *const c_void, c: Callbacks, o: *mut u64) -> i32;
    "vkDestroyBuffer" destroy_buffer(d: Device, b: u64, c: Callbacks) -> ();
    "vkGetBufferMemoryRequirements" buffer_needs(d: Device, b: u64, o: *mut c_void) -> ();
    "vkBindBufferMemory" bind_buffer(d: Device, b: u64, m: u64, o: u64) -> i32;
    "vkCreateBufferView" create_texels(d: Device, i: *const c_void, c: Callbacks, o: *mut u64) -> i32;
    "vkDestroyBufferView" destroy_texels(d: Device, v: u64, c: Callbacks) -> ();
    "vkCreateImageView" create_view(d: Device, i: *const c_void, c: Callbacks, o: *mut u64) -> i32;
    "vkDestroyImageView" destroy_view(d: Device, v: u64, c: Callbacks) -> ();
    "vkCreateShaderModule" create_module(d: Device, i: *const c_void, c: Callbacks, o: *mut u64) -> i32, { subgroup_features::note(i) };
    "vkDestroyShaderModule" destroy_module(d: Device, m: u64, c: Callbacks) -> ();
    "vkCreateDescriptorSetLayout" create_set_layout(d: Device, i: *const c_void, c: Callbacks, o: *mut u64) -> i32;
    "vkDestroyDescriptorSetLayout" destroy_set_layout(d: Device, l: u64, c: Callbacks) -> ();
    "vkCreateDescriptorPool" create_pool(d: Device, i: *const c_void, c: Callbacks, o: *mut u64) -> i32;
    "vkDestroyDescriptorPool" destroy_pool(d: Device, p: u64, c: Callbacks) -> ();
    "vkAllocateDescriptorSets" allocate_sets(d: Device, i: *const c_void, o: *mut u64) -> i32;
    "vkCreatePipelineLayout" create_layout(d: Device, i: *const c_void, c: Callbacks, o: *mut u64) -> i32;
    "vkDestroyPipelineLayout" destroy_layout(d: Device, l: u64, c: Callbacks) -> ();
    "vkCreateComputePipelines" create_pipelines(d: Device, p: u64, n: u32, i: *const c_void, c: Callbacks, o: *mut u64) -> i32, {
        CACHES.lock().expect("no panic while held").insert(p);
    };
    "vkDestroyPipeline" destroy_pipeline(d: Device, p: u64, c: Callbacks) -> ();
    "vkCreateEvent" create_event(d: Device, i: *const c_void, c: Callbacks, o: *mut u64) -> i32;
    "vkDestroyEvent" destroy_event(d: Device, e: u64, c: Callbacks) -> ();
    "vkCreateQueryPool" create_queries(d: Device, i: *const c_void, c: Callbacks, o: *mut u64) -> i32;
    "vkDestroyQueryPool" destroy_queries(d: Device, q: u64, c: Callbacks) -> ();
    "vkGetQueryPoolResults" query_results(d: Device, q: u64, f: u32, n: u32, s: usize, o: *mut c_void, t: u64, l: u32) -> i32;
    "vkCreateFence" create_fence(d: Device, i: *const c_void, c: Callbacks, o: *mut u64) -> i32;
    "vkDestroyFence" destroy_fence(d: Device, f: u64, c: Callbacks) -> ();
    "vkWaitForFences" wait_fences(d: Device, n: u32, f: *const u64, a: u32, t: u64) -> i32;
    "vkResetFences" reset_fences(d: Device, n: u32, f: *const u64) -> i32;
    "vkCreateCommandPool" create_commands(d: Device, i: *const c_void, c: Callbacks, o: *mut u64) -> i32;
    "vkDestroyCommandPool" destroy_commands(d: Device, p: u64, c: Callbacks) -> ();
    "vkResetCommandPool" reset_commands(d: Device, p: u64, f: u32) -> i32;
    "vkAllocateCommandBuffers" allocate_commands(d: Device, i: *const c_void, o: *mut u64) -> i32;
    "vkBeginCommandBuffer" begin_commands(b: vk::CommandBuffer, i: *const c_void) -> i32;
    "vkEndCommandBuffer" end_commands(b: vk::CommandBuffer) -> i32;
    "vkQueueSubmit" submit(q: vk::Queue, n: u32, s: *const c_void, f: u64) -> i32;
    "vkQueueSubmit2" submit2(q: vk::Queue, n: u32, s: *const c_void, f: u64) -> i32;
    "vkQueueWaitIdle" wait_queue(q: vk::Queue) -> i32;
    "vkDeviceWaitIdle" wait_device(d: Device) -> i32;
}

/// Pipeline caches used to build pipelines.
static CACHES: Mutex<BTreeSet<u64>> = Mutex::new(BTreeSet::new());

/// Functions besides `vkCmd*` that recording may call.
const ALLOWED: [&str; 3] = ["vkGetEventStatus", "vkResetEvent", "vkUpdateDescriptorSets"];

fn instrumented(host: &Host) -> (ash::Device, BTreeSet<String>) {
    let mut absent = BTreeSet::new();
    let replace = |name: &CStr, address: *const c_void| {
        let text = name.to_string_lossy().into_owned();
        if address.is_null() || text.starts_with("vkCmd") || ALLOWED.contains(&text.as_str()) {
            return address;
        }
        wrapped(name, address).unwrap_or_else(|| {
            absent.insert(text);
            std::ptr::null()
        })
    };
    // SAFETY: every address is null, the device's own function, or a wrapper of its type.
    let device = unsafe { device_with(host, replace) };
    (device, absent)
}

fn record_and_count(host_options: &HostOptions) {
    with_host(host_options, |host| {
        let (device, absent) = instrumented(host);
        assert!(absent.contains("vkFlushMappedMemoryRanges") && absent.contains("vkWaitSemaphores"));
        let foreign = ForeignDevice { device: &device, ..host.foreign() };
        let context = guest_of(&foreign, &ContextOptions::default());
        let gaussians = cloud(600, 1);
        let scene = uploaded(&context, &gaussians);
        let mut renderer = Renderer::new(&context).expect("kernels");
        let camera = camera(0.3, 96, 64);
        let reservation = Reservation {
            slots: 2,
            occlusion: true,
            staging_bytes: Reservation::update_bytes(600, 1),
            ..Reservation::new(600, 1, 96, 64)
        };
        renderer.reserve(&reservation).expect("memory");
        let (mut images, wanted) =
            (Outputs::new(host, &context, [96, 64], HIDES.0), OutputRequest::hidden(&camera));
        let placed = [Placed::from(&scene)];
        let updates = [Update { scene: &scene, first: 0, gaussians: &gaussians }];
        assert!(take_calls().iter().any(|(name, _)| *name == "vkAllocateMemory"), "the table counts");

        let in_flight = Commands::new(host);
        for number in 0..4 {
            let slot = number % 2;
            let commands = in_flight.begun(&context);
            let frame = RecordedFrame { updates: &updates, ..frame_of(&placed, &camera) };
            let frame = images.with(frame, &wanted);
            take_calls();
            let release = renderer.record(commands, slot, &frame).expect("a recording");
            assert_eq!(take_calls(), [], "frame {number}: record only records");
            images.note(&release);
            in_flight.finish();
            let report = report_of(&mut renderer, slot);
            assert!(report.visible > 100 && !report.overflow, "{report:?}");
            let asked = take_calls();
            let allowed = |name: &str| name == "vkGetQueryPoolResults";
            assert!(asked.iter().all(|(name, _)| allowed(name)), "asking for statistics: {asked:?}");
        }
        many_scenes(&context, &mut renderer, &in_flight);
        training_steps(&context, &in_flight);
    });
}

/// Records a frame of many scenes. Each has its own dispatches, which a reservation must count.
fn many_scenes(context: &Context, renderer: &mut Renderer, in_flight: &Commands<'_>) {
    const SCENES: u32 = 100;
    let gaussians = cloud(6, 1);
    let scenes: Vec<_> = (0..SCENES).map(|_| uploaded(context, &gaussians)).collect();
    let placed: Vec<Placed> = scenes.iter().map(Placed::from).collect();
    let reservation = Reservation { scenes: SCENES, ..Reservation::new(SCENES * 6, 1, 96, 64) };
    renderer.reserve(&reservation).expect("memory");
    let commands = in_flight.begun(context);
    let camera = camera(0.3, 96, 64);
    take_calls();
    renderer.record(commands, 0, &frame_of(&placed, &camera)).expect("a recording");
    assert_eq!(take_calls(), [], "record only records");
    in_flight.finish();
}

/// Records training steps, before and after a densification and an opacity reset.
fn training_steps(context: &Context, in_flight: &Commands<'_>) {
    let settings = TrainSettings {
        iterations: 20,
        densify_from_iter: 0,
        densification_interval: 3,
        opacity_reset_interval: 5,
        densify_grad_threshold: 1e-6,
        sh_degree_interval: 4,
        ..TrainSettings::reference()
    };
    let mut trainer = crate::training::trainer(context, settings);
    trainer.reserve_steps(&ONE_SLOT).expect("memory");
    let mut maintained = 0;
    for iteration in 1..=12 {
        take_calls();
        let is_due = trainer.maintenance_is_due().expect("an answer");
        assert_eq!(take_calls(), [], "iteration {iteration}: noting what has finished waits for nothing");
        if is_due {
            trainer.maintain().expect("maintained");
            maintained += 1;
            assert!(!take_calls().is_empty(), "maintenance submits");
        }
        let commands = in_flight.begun(context);
        take_calls();
        trainer.record_step(commands, 0).expect("a recording");
        assert_eq!(take_calls(), [], "iteration {iteration}: record_step only records");
        in_flight.finish();
        if iteration % 2 == 0 {
            continue;
        }
        let outcome = trainer.step_outcome(0).expect("an outcome").expect("finished");
        assert!(matches!(&outcome, StepOutcome::Done(r) if r.iteration == iteration), "{outcome:?}");
        let asked = take_calls();
        assert!(asked.iter().all(|(name, _)| *name == "vkGetQueryPoolResults"), "asking: {asked:?}");
    }
    assert_eq!(maintained, 5, "densified after 3, 6, 9, reset after 5 and 10");
}

/// Both kinds of descriptors in one test, because the counters are shared.
#[test]
fn record_calls_nothing_that_submits_waits_allocates_or_maps() {
    record_and_count(&options());
    record_and_count(&HostOptions { push_descriptors: false, ..options() });
    kernels_of_threads(&options());
    subgroup_features::that_a_host_has_enabled();
}

/// Kernels that the host's threads have built into its own cache are not built again.
fn kernels_of_threads(host_options: &HostOptions) {
    with_host(host_options, |host| {
        let (device, _) = instrumented(host);
        let info = vk::PipelineCacheCreateInfo::default();
        // SAFETY: a valid create info.
        let pipeline_cache = unsafe { host.device.create_pipeline_cache(&info, None) }.expect("a cache");
        let foreign = ForeignDevice { device: &device, pipeline_cache, ..host.foreign() };
        let context = guest_of(&foreign, &ContextOptions::default());
        let wanted = Reservation {
            occlusion: true,
            expected_depth: true,
            filter_3d: true,
            pick: true,
            motion: true,
            orthographic: true,
            ..Reservation::new(100, 2, 96, 64)
        };
        take_calls();
        let jobs = Renderer::kernel_jobs(&context, &wanted).expect("a list");
        let pipelines = |calls: &[(&str, usize)]| {
            calls.iter().find(|(name, _)| *name == "vkCreateComputePipelines").map_or(0, |(_, count)| *count)
        };
        assert_eq!(pipelines(&take_calls()), 0, "nothing is built yet");
        assert!(jobs.iter().any(|job| job.name() == "forward/blend") && jobs.len() > 40, "{}", jobs.len());
        let count = jobs.len();
        let queue = Mutex::new(jobs);
        CACHES.lock().expect("no panic while held").clear();
        std::thread::scope(|threads| {
            for _ in 0..3 {
                threads.spawn(|| {
                    loop {
                        let job = queue.lock().expect("no panic while held").pop();
                        let Some(job) = job else { return };
                        job.build().expect("built");
                    }
                });
            }
        });
        assert_eq!(pipelines(&take_calls()), count);
        let caches = std::mem::take(&mut *CACHES.lock().expect("no panic while held"));
        assert_eq!(caches, [pipeline_cache.as_raw()].into());
        let renderer = reserved(&context, &wanted);
        assert_eq!(pipelines(&take_calls()), 0, "all are there");
        drop((renderer, context));
        // SAFETY: nothing is built with it any more.
        unsafe { host.device.destroy_pipeline_cache(pipeline_cache, None) };
    });
}
