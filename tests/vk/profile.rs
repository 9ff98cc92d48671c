//! The opt-in profile: its records, and that it is off by default.

use crate::common::gpu::Gpu;
use ashsplat::passes::scan::{Scan, ScanBuffers, Workgroups};
use ashsplat::vk::{Access, Context, ContextOptions, Submission};

const COUNT: u32 = 5000;

fn run_scans(gpu: &Gpu) {
    let scan = Scan::new(gpu.context).expect("kernels");
    let grid = scan.block_words(COUNT.into()) as u32;
    let counts = gpu.buffer("counts", &[COUNT, 0, 0, 0]);
    let values = gpu.buffer("values", &vec![1u32; COUNT as usize]);
    let prefix = gpu.untouched::<u32>("prefix", COUNT as usize);
    let sums = gpu.untouched::<u32>("sums", grid as usize);
    let arguments = gpu.buffer("arguments", &[grid, 1, 1, 0]);
    let buffers = ScanBuffers {
        counts: &counts,
        count_index: 0,
        total_index: 1,
        values: &values,
        prefix: &prefix,
        block_sums: &sums,
    };
    gpu.run(|r| {
        r.fill(&prefix, 0);
        r.barrier();
        r.scope("direct", |r| scan.record(r, &buffers, Workgroups::Elements(COUNT.into())));
        r.barrier();
        r.scope("indirect", |r| scan.record(r, &buffers, Workgroups::Indirect(&arguments)));
    });
    let expected: Vec<u32> = (0..COUNT).collect();
    assert_eq!(gpu.read::<u32>(&prefix, COUNT as usize), expected);
}

/// Other tests use the shared device at the same time: finds the recording by its commands.
fn of_scans(submissions: Vec<Submission>) -> Submission {
    let mut own = submissions.into_iter().filter(|s| s.scopes.iter().any(|scope| scope.name == "indirect"));
    own.next().expect("the recording was logged")
}

fn own_gpu(options: ContextOptions) -> Gpu {
    let context = Context::new(&options).expect("a device");
    Gpu::of(Box::leak(Box::new(context)))
}

#[test]
fn profile_names_every_command_with_its_grid_and_time() {
    let gpu = own_gpu(crate::common::options());
    let profile = gpu.context.profile();
    run_scans(&gpu);
    let submission = of_scans(profile.take());
    let names: Vec<(&str, &str)> = submission.commands.iter().map(|c| (c.scope, c.name)).collect();
    let kernels = ["scan/scan_reduce", "scan/scan_spine", "scan/scan_apply"];
    let expected: Vec<(&str, &str)> = std::iter::once(("", "fill"))
        .chain(kernels.map(|name| ("direct", name)))
        .chain(kernels.map(|name| ("indirect", name)))
        .collect();
    assert_eq!(names, expected);
    // Each kernel waits for the previous one.
    let barriers: Vec<u32> = submission.commands.iter().map(|c| c.barriers).collect();
    assert_eq!(barriers, [0, 1, 1, 1, 1, 1, 1]);
    assert_eq!(submission.commands[0].workgroups, None);
    // The grid of an indirect dispatch is read back.
    assert_eq!(submission.commands[1].workgroups, submission.commands[4].workgroups);
    assert!(submission.commands[4].workgroups.is_some_and(|[x, y, z]| x > 1 && y == 1 && z == 1));
    let apply = &submission.commands[3];
    let roles: Vec<_> = apply.buffers.iter().map(|b| (b.role, b.name, b.access)).collect();
    assert!(roles.contains(&("values", "values", Access::Read)), "{roles:?}");
    assert!(roles.contains(&("prefix", "prefix", Access::Write)), "{roles:?}");
    assert!(apply.buffers.iter().any(|b| b.name == "values" && b.bytes == u64::from(COUNT) * 4));
    check_times(&gpu, &submission);
    assert!(profile.take().is_empty(), "taken once");
}

/// Checks that commands follow one another without gaps, within the recording and the host's times.
fn check_times(gpu: &Gpu, submission: &Submission) {
    if !gpu.context.has_timestamps() {
        return;
    }
    let whole = submission.nanoseconds.expect("timestamps");
    let mut end = 0.0;
    for command in &submission.commands {
        let (begin, duration) = (command.begin_ns.expect("begin"), command.nanoseconds.expect("duration"));
        assert!((begin - end).abs() < 1.0 && duration >= 0.0, "{command:?}");
        end = begin + duration;
    }
    assert!(end <= whole, "{end} > {whole}");
    assert!(submission.begun <= submission.submitting && submission.submitting <= submission.submitted);
    assert!(submission.submitted <= submission.done);
    let ended = submission.device_begun.expect("timestamps") + std::time::Duration::from_nanos(whole as u64);
    assert!(ended == submission.done);
}

#[test]
fn profile_is_off_before_and_after() {
    let gpu = own_gpu(crate::common::options());
    let profile = gpu.context.profile();
    let newer = gpu.context.profile();
    run_scans(&gpu);
    assert!(profile.take().is_empty(), "the newer profile has taken over");
    of_scans(newer.take());
    gpu.context.set_profile(None);
    run_scans(&gpu);
    assert!(newer.take().is_empty(), "it rests");
    gpu.context.set_profile(Some(&newer));
    run_scans(&gpu);
    of_scans(newer.take());
    drop(newer);
    run_scans(&gpu);
    assert!(gpu.context.profile().take().is_empty());
}

#[test]
fn capture_passes_on_what_its_work_returns() {
    let gpu = own_gpu(crate::common::options());
    assert_eq!(gpu.context.capture(|| Ok(7)).expect("VK_EXT_debug_utils"), 7);
    let failed = gpu.context.capture(|| Err::<(), _>(ashsplat::Error::argument("work", "failed")));
    assert!(failed.expect_err("an error").to_string().contains("failed"));
    assert!(gpu.context.validation_messages().is_empty());
}
