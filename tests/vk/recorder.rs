//! Recording, submission, hazards in recordings, timestamps.

use super::{allocate, run, words};
use crate::common;
use ashsplat::kernels::scan::scan_reduce;
use ashsplat::vk::{Buffer, Context, ContextOptions, Kernel, MemoryKind, Recorder};

/// Sums of blocks of a sequence on the device.
struct BlockSums {
    counts: Buffer,
    values: Buffer,
    block_sums: Buffer,
    arguments: Buffer,
    kernel: Kernel<scan_reduce::Interface>,
    workgroups: u64,
    expected: Vec<u32>,
}

impl BlockSums {
    fn new(context: &Context, count: usize) -> Self {
        let spec = scan_reduce::Spec::for_device(context.limits());
        let block = (spec.workgroup_size * spec.items) as usize;
        let values: Vec<u32> = (0..count as u32).map(|i| i % 97).collect();
        let expected: Vec<u32> = values.chunks(block).map(|c| c.iter().sum()).collect();
        let workgroups = expected.len() as u64;
        let requests =
            [("counts", 4), ("values", 4 * count as u64), ("block_sums", 4 * workgroups), ("arguments", 12)];
        let [counts, step_values, block_sums, arguments] = allocate(context, requests);
        context.upload(&counts, bytemuck::bytes_of(&(count as u32))).expect("upload");
        context.upload(&step_values, bytemuck::cast_slice(&values)).expect("upload");
        let kernel = Kernel::new(context, &spec).expect("a kernel");
        Self { counts, values: step_values, block_sums, arguments, kernel, workgroups, expected }
    }

    fn bind(&self) -> scan_reduce::Bind<'_> {
        scan_reduce::Bind { counts: &self.counts, values: &self.values, block_sums: &self.block_sums }
    }

    fn record(&self, r: &mut Recorder) {
        r.dispatch(&self.kernel, &self.bind(), &PUSH, self.workgroups);
    }

    fn run(&self, context: &Context) {
        run(context, |r| self.record(r));
        self.check(context);
    }

    fn check(&self, context: &Context) {
        assert_eq!(words(context, &self.block_sums), self.expected);
    }
}

const PUSH: scan_reduce::Push = scan_reduce::Push { count_index: 0 };

#[test]
fn an_indirect_dispatch_takes_its_grid_from_a_buffer() {
    let context = common::context();
    let sums = BlockSums::new(context, 5_000);
    let grid = [sums.workgroups as u32, 1, 1];
    // More commands than a recording compares write something between the arguments and their use.
    for others in [0, 3, 100] {
        run(context, |r| {
            r.update(&sums.arguments, bytemuck::cast_slice(&grid));
            r.fill(&sums.block_sums, 0);
            for _ in 0..others {
                r.barrier();
                r.fill(&sums.block_sums, 1);
            }
            r.barrier();
            r.dispatch_indirect(&sums.kernel, &sums.bind(), &PUSH, &sums.arguments);
        });
        sums.check(context);
    }
    common::assert_silent(context);
}

#[test]
fn fill_copy_and_update_touch_their_range_only() {
    let context = common::context();
    let [a, b] = allocate(context, [("a", 64), ("b", 64)]);
    run(context, |r| {
        r.fill(&a, 1);
        r.fill(&b, 2);
        r.barrier();
        r.fill(&a.range(8, 8), 3);
        r.update(&a.range(32, 32), bytemuck::cast_slice(&[4u32, 5]));
        r.barrier();
        r.copy(&a.range(4, 32), &b.range(16, 40));
    });
    assert_eq!(words(context, &a), [1, 1, 3, 3, 1, 1, 1, 1, 4, 5, 1, 1, 1, 1, 1, 1]);
    assert_eq!(words(context, &b), [2, 2, 2, 2, 1, 3, 3, 1, 1, 1, 1, 4, 2, 2, 2, 2]);
    common::assert_silent(context);
}

fn record(recorder: &mut Recorder, sums: &BlockSums) {
    recorder.update(&sums.arguments, bytemuck::cast_slice(&[sums.workgroups as u32, 1, 1]));
    recorder.barrier();
    recorder.dispatch_indirect(&sums.kernel, &sums.bind(), &PUSH, &sums.arguments);
    recorder.barrier();
    recorder.copy(&sums.block_sums.range(0, 4), &sums.arguments);
    recorder.barrier();
    recorder.fill(&sums.block_sums, 0);
}

/// Returns the hazards of a recording, which is never submitted.
fn hazards(context: &Context, record: impl FnOnce(&mut Recorder)) -> Vec<String> {
    let mut recorder = context.begin("never submitted").expect("a recorder");
    recorder.collect_hazards();
    record(&mut recorder);
    recorder.hazards().to_vec()
}

#[test]
fn each_omitted_barrier_is_found_without_submitting() {
    let context = common::context();
    let sums = BlockSums::new(context, 2_000);
    let hazards = |omitted: Option<u32>| {
        hazards(context, |r| {
            omitted.into_iter().for_each(|k| r.omit_barrier(k));
            record(r, &sums);
            assert_eq!(r.barriers(), 3);
        })
    };
    assert_eq!(hazards(None), [""; 0]);
    assert!(hazards(Some(0))[0].contains("'indirect arguments'"), "{:?}", hazards(Some(0)));
    assert!(hazards(Some(1))[0].contains("read after write"), "{:?}", hazards(Some(1)));
    assert!(hazards(Some(2))[0].contains("write after read"), "{:?}", hazards(Some(2)));
}

/// A context without the validation layer, which would report mistakes of recordings as well.
fn without_validation() -> Context {
    Context::new(&ContextOptions { validation: false, ..common::options() }).expect("a context")
}

#[test]
fn hazards_are_bytes_in_common_since_the_last_barrier() {
    let context = &without_validation();
    let [a, b, c] = allocate(context, [("a", 128), ("b", 64), ("c", 64)]);
    let apart = hazards(context, |r| {
        r.fill(&a.range(0, 64), 1);
        r.fill(&a.range(64, 64), 2);
        r.fill(&b, 3);
        r.barrier();
        r.copy(&a.range(0, 64), &b);
        r.copy(&a.range(0, 32), &c);
    });
    assert_eq!(apart, [""; 0], "neighbours, and common reads");
    let common = hazards(context, |r| {
        r.fill(&a.range(0, 64), 1);
        r.copy(&a.range(60, 4), &b);
    });
    assert!(common.len() == 1 && common[0].contains("(4 bytes in common)"), "{common:?}");
    let read_since = hazards(context, |r| {
        r.fill(&a, 1);
        r.barrier();
        r.copy(&a.range(0, 64), &b);
        r.copy(&a.range(32, 32), &c);
        r.fill(&a.range(48, 4), 2);
    });
    let both = "'fill' writes buffer 'a' as 'destination' after 'copy' reads buffer 'a' as 'source'";
    assert!(read_since.len() == 1 && read_since[0].contains(both), "{read_since:?}");
}

/// Compilers assume that two buffers of a shader are different memory.
#[test]
fn one_memory_by_two_bindings_is_declared_in_the_shader() {
    let context = &without_validation();
    let sums = BlockSums::new(context, 2_000);
    let bind = scan_reduce::Bind { block_sums: &sums.values, ..sums.bind() };
    let found = hazards(context, |r| r.dispatch(&sums.kernel, &bind, &PUSH, sums.workgroups));
    assert!(found.len() == 1 && found[0].contains("declare both ALIASED"), "{found:?}");
}

#[test]
fn what_a_submission_uses_may_be_dropped_and_is_not_accessible_before_it_is_done() {
    let context = common::context();
    let sums = BlockSums::new(context, 100_000);
    let host = context.allocate("result", &[("sums", 4 * sums.workgroups)], MemoryKind::HostVisible);
    let host = host.expect("memory").swap_remove(0);
    let mut recorder = context.begin("kept").expect("a recorder");
    sums.record(&mut recorder);
    recorder.barrier();
    recorder.copy(&sums.block_sums.range(0, 4 * sums.workgroups), &host);
    let pending = context.submit(recorder).expect("a submission");
    let expected = sums.expected.clone();
    drop(sums);
    let mut bytes = vec![0; 4 * expected.len()];
    assert!(host.read(0, &mut bytes).is_err(), "the submission is under way");
    pending.wait().expect("done");
    host.read(0, &mut bytes).expect("done");
    assert_eq!(bytemuck::pod_collect_to_vec::<u8, u32>(&bytes), expected);
    common::assert_silent(context);
}

#[test]
fn submissions_follow_each_other_without_waiting() {
    let context = common::context();
    let [a, b] = allocate(context, [("a", 4096), ("b", 4096)]);
    let mut pending = Vec::new();
    for step in 0..20 {
        let mut recorder = context.begin("chain").expect("a recorder");
        recorder.copy(&a, &b);
        recorder.barrier();
        recorder.fill(&a, step);
        pending.push(context.submit(recorder).expect("a submission"));
    }
    drop(pending);
    assert!(words(context, &b).iter().all(|&word| word == 18));
    common::assert_silent(context);
}

#[test]
fn a_context_serves_several_threads() {
    let context = common::context();
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                let sums = BlockSums::new(context, 20_000);
                (0..5).for_each(|_| sums.run(context));
            });
        }
    });
    common::assert_silent(context);
}

#[test]
fn more_scopes_than_timestamps_are_fine() {
    let context = common::context();
    let report = run(context, |r| (0..300).for_each(|_| r.scope("many", |_| ())));
    assert!(report.scopes.len() < 300);
    common::assert_silent(context);
}

/// Push constants claim more elements than a kernel's buffer holds: neighbouring buffers stay intact, and nothing
/// crashes.
#[test]
fn counts_beyond_a_buffer_touch_nothing_else() {
    use ashsplat::kernels::arithmetic::multiply_add::{Bind, Interface, Push, Spec};
    let context = common::context();
    // The largest grid here, where each invocation writes a float, exceeds the allocation by far.
    let spec = Spec { workgroup_size: 64.min(context.limits().max_workgroup_invocations), rounds: 1 };
    let kernel = Kernel::<Interface>::new(context, &spec).expect("a kernel");
    let [before, results, after] = allocate(context, [("before", 4096), ("results", 64), ("after", 4096)]);
    for neighbour in [&before, &after] {
        context.upload(neighbour, &[0xA5; 4096]).expect("upload");
    }
    context.upload(&results, &[0; 64]).expect("upload");
    let push = Push { count: u32::MAX, factor: 1.0, term: 1.0 };
    run(context, |r| r.dispatch(&kernel, &Bind { results: &results }, &push, 1 << 16));
    for neighbour in [&before, &after] {
        assert_eq!(context.download(neighbour).expect("download"), [0xA5; 4096], "{}", neighbour.name());
    }
    let results = words(context, &results).into_iter().map(f32::from_bits).collect::<Vec<f32>>();
    assert!(results.iter().all(|&sum| sum > 0.0), "{results:?}");
    common::assert_silent(context);
}
