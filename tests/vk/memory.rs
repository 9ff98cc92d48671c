//! Allocation, transfers, and lifetime of memory.

use crate::common;
use ash::vk;
use ashsplat::Error;
use ashsplat::vk::{
    Context, ContextOptions, Image, ImageUse, Life, LimitsOverride, MemoryKind, PLACEMENT_ALIGNMENT, pack,
};
use proptest::collection::vec;
use proptest::prelude::*;

/// Requests and the largest block: many small ones, or a few large ones with stagger, some of round sizes.
fn requests() -> impl Strategy<Value = (Vec<u64>, u64)> {
    let large = prop_oneof![0_u64..2_500_000, (0_u64..600).prop_map(|pages| pages * 4096)];
    prop_oneof![(vec(0_u64..5000, 0..40), 5000_u64..20_000), (vec(large, 0..20), 2_500_000_u64..9_000_000)]
}

proptest! {
    #[test]
    fn packing_staggers_large_buffers((sizes, block) in requests()) {
        let packing = pack(&sizes, &[], block).expect("each fits");
        // Large buffers of a block begin in different cache sets.
        let large = packing.places.iter().zip(&sizes).filter(|(_, bytes)| **bytes >= 1 << 20);
        let mut sets: Vec<(usize, u64)> = large.map(|((block, at), _)| (*block, at % 65_536)).collect();
        sets.sort_unstable();
        prop_assert!(sets.windows(2).all(|pair| pair[0] != pair[1]));
        prop_assert_eq!(pack(&[sizes, vec![block + 1]].concat(), &[], block), Err(packing.places.len()));
    }
}

proptest! {
    /// Only buffers that never live at the same time share bytes.
    #[test]
    fn packing_shares_what_lives_apart(
        (sizes, block) in requests(),
        steps in vec((0_u8..12, 0_u8..12), 0..20),
    ) {
        let lives: Vec<Life> =
            steps.iter().map(|&(a, b)| Life { first: a.min(b), last: a.max(b) }).take(sizes.len()).collect();
        let life = |index: usize| lives.get(index).copied().unwrap_or(Life::ALWAYS);
        let packing = pack(&sizes, &lives, block).expect("each fits");
        let taken = |index: usize| {
            let (block, offset) = packing.places[index];
            (block, offset..offset + sizes[index].max(16))
        };
        for (a, b) in (0..sizes.len()).flat_map(|b| (0..b).map(move |a| (a, b))) {
            let ((block_a, a_at), (block_b, b_at)) = (taken(a), taken(b));
            let apart = block_a != block_b || a_at.end <= b_at.start || b_at.end <= a_at.start;
            let lives_apart = life(a).last < life(b).first || life(b).last < life(a).first;
            prop_assert!(apart || lives_apart, "{a} and {b}");
        }
        for (index, _) in sizes.iter().enumerate() {
            let (block, at) = taken(index);
            prop_assert!(at.start % PLACEMENT_ALIGNMENT == 0 && at.end <= packing.blocks[block]);
        }
        prop_assert!(packing.blocks.iter().all(|bytes| *bytes <= block));
    }
}

#[test]
fn what_does_not_fit_is_an_error_with_the_size() {
    let limits = common::context().limits();
    let needed = limits.max_storage_buffer_range + 4;
    let result = common::context().allocate("frame", &[("keys", 4), ("huge", needed)], MemoryKind::Device);
    match result {
        Err(Error::TooLarge { what, needed: n, limit, .. }) => {
            assert!(what.contains("frame.huge"), "{what}");
            assert_eq!((n, limit), (needed, limits.max_storage_buffer_range));
        }
        other => panic!("{other:?}"),
    }
    let override_ = LimitsOverride { max_allocation_bytes: Some(1000), ..LimitsOverride::default() };
    let small = Context::new(&ContextOptions { limits_override: Some(override_), ..common::options() });
    let small = small.expect("a context");
    let result = small.allocate("frame", &[("keys", 1004)], MemoryKind::Device);
    assert!(matches!(result, Err(Error::TooLarge { limit: 1000, .. })), "{result:?}");
    let buffers = small.allocate("frame", &[("a", 600), ("b", 600)], MemoryKind::Device).expect("two blocks");
    assert_eq!(buffers.iter().map(|b| b.bytes()).collect::<Vec<_>>(), [600, 600]);
    common::assert_silent(&small);
}

#[test]
fn arenas_are_counted() {
    let context = common::bounded(None);
    let arena = |name: &str| context.memory().into_iter().find(|a| a.name == name).expect("registered");
    let first = context.allocate("frame", &[("a", 1024)], MemoryKind::Device).expect("memory");
    let second = context.allocate("frame", &[("b", 512)], MemoryKind::HostVisible).expect("memory");
    assert_eq!((arena("frame").bytes, arena("frame").peak_bytes), (1536, 1536));
    drop(first);
    assert_eq!((arena("frame").bytes, arena("frame").peak_bytes), (512, 1536));
    let part = second[0].range(4, 8);
    drop(second);
    assert_eq!(arena("frame").bytes, 512, "a part keeps the whole alive");
    drop(part);
    assert_eq!(arena("frame").bytes, 0);
    let third = context.allocate("step", &[("c", 256)], MemoryKind::Device).expect("memory");
    context.reset_memory_peaks();
    assert_eq!(context.memory_total().peak_bytes, 256, "peaks begin anew");
    assert_eq!(context.memory().len(), 1, "arenas that hold nothing are forgotten");
    assert_eq!((arena("step").bytes, arena("step").peak_bytes), (256, 256));
    drop(third);
    assert_eq!((arena("step").bytes, arena("step").peak_bytes), (0, 256));
    // The context's own images are counted, too.
    let image = Image::new(&context, "own", vk::Format::R32_SFLOAT, [64, 64], ImageUse::Depth);
    let image = image.expect("an image");
    assert!(arena("images").bytes >= 64 * 64 * 4);
    drop(image);
    assert_eq!(arena("images").bytes, 0);
}

#[test]
fn the_bound_of_all_arenas_may_change() {
    let context = common::bounded(None);
    let allocate = |bytes| context.allocate("frame", &[("a", bytes)], MemoryKind::Device);
    let refused = |bytes| match allocate(bytes) {
        Err(Error::TooLarge { needed, limit, limit_name, .. }) => (needed, limit, limit_name),
        other => panic!("{other:?}"),
    };
    let kept = allocate(1024).expect("without a bound");
    for bound in [1000, 1024, 1279] {
        context.set_max_memory(Some(bound));
        assert_eq!((context.max_memory(), refused(256)), (Some(bound), (1280, bound, "--max-memory")));
        assert_eq!(context.memory_limit().map(|(bytes, _)| bytes), Some(bound));
    }
    context.set_max_memory(Some(1280));
    drop(allocate(256).expect("as much as there may be"));
    assert_eq!(refused(260).0, 1284);
    context.set_max_memory(None);
    assert_eq!(context.max_memory(), None);
    drop((allocate(260).expect("without a bound"), kept));
}

/// Bytes that differ at every position.
fn pattern(bytes: usize) -> Vec<u8> {
    // Not a power of two, so that parts of a transfer differ.
    let block: Vec<u8> = (0..65_537_u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let mut pattern = block.repeat(bytes.div_ceil(block.len()));
    pattern.truncate(bytes);
    pattern
}

#[test]
fn transfers_give_back_what_they_got() {
    // Mapped memory, as on a discrete GPU, and mapped without a cache, which is read by copies.
    for (force_staging, force_uncached) in [(false, false), (true, false), (false, true)] {
        let options = ContextOptions { force_staging, force_uncached, ..common::options() };
        let context = Context::new(&options).expect("a context");
        for bytes in [1, 3, 4, 17, 65_536, 65_540, (16 << 20) + 5] {
            let requests = [("before", 16), ("data", bytes as u64), ("after", 16)];
            let buffers = context.allocate("transfer", &requests, MemoryKind::Device).expect("memory");
            context.upload(&buffers[2], &[7; 16]).expect("upload");
            context.upload(&buffers[1], &pattern(bytes)).expect("upload");
            let back = context.download(&buffers[1]).expect("download");
            assert!(back[..bytes] == pattern(bytes), "{bytes} bytes, staging {force_staging}");
            assert_eq!(context.download(&buffers[2]).expect("download"), [7; 16]);
        }
        common::assert_silent(&context);
    }
}

/// A device whose memory the host does not see.
fn staged() -> Context {
    let options = ContextOptions { force_staging: true, ..common::options() };
    Context::new(&options).expect("a context")
}

/// Also if uploads have a separate queue.
#[test]
fn uploads_run_after_what_was_submitted() {
    const BYTES: usize = 300_004;
    let context = staged();
    let requests = [("source", BYTES as u64), ("target", BYTES as u64)];
    let buffers = context.allocate("transfers", &requests, MemoryKind::Device).expect("memory");
    let (earlier, later) = (vec![1; BYTES], vec![2; BYTES]);
    context.upload(&buffers[0], &earlier).expect("upload");
    let mut recorder = context.begin("copy").expect("a recorder");
    recorder.copy(&buffers[0], &buffers[1]);
    let copy = context.submit(recorder).expect("submitted");
    context.upload(&buffers[0], &later).expect("upload");
    copy.wait().expect("copied");
    for (buffer, content) in buffers.iter().zip([later, earlier]) {
        assert!(context.download(buffer).expect("download") == content, "an upload overtook a copy");
    }
    common::assert_silent(&context);
}

/// Many uploads of any size and order share a ring that holds four of their pieces. Its memory is freed on request,
/// or when another allocation needs it.
#[test]
fn staging_is_a_ring_that_is_kept_and_given_back() {
    let context = staged();
    let staging =
        || context.memory().iter().find(|arena| arena.name == "staging").map_or(0, |arena| arena.bytes);
    let sizes = [70_000, 300_004, 65_541, 9 << 20, 100_000, 33 << 20, 70_000];
    let requests: Vec<_> = sizes.iter().map(|&bytes| ("data", bytes as u64)).collect();
    let buffers = context.allocate("transfers", &requests, MemoryKind::Device).expect("memory");
    let mut kept = 0;
    for round in 0..2 {
        for (buffer, bytes) in buffers.iter().zip(sizes) {
            let mut content = pattern(bytes);
            content[0] = round;
            context.upload(buffer, &content).expect("upload");
            assert!(staging() >= kept && staging() <= 32 << 20, "{} bytes of staging", staging());
            kept = staging();
        }
        for (buffer, bytes) in buffers.iter().zip(sizes) {
            let back = context.download(buffer).expect("download");
            assert!(back[0] == round && back[1..bytes] == pattern(bytes)[1..], "{bytes} bytes");
        }
    }
    assert_eq!(kept, 32 << 20);
    assert!(context.free_staging() && !context.free_staging());
    assert_eq!(staging(), 0);
    // A bound that leaves less than the ring's preferred size, and then nothing.
    context.upload(&buffers[3], &pattern(9 << 20)).expect("upload");
    let used = context.memory_total().bytes;
    context.set_max_memory(Some(used));
    drop(context.allocate("more", &[("a", 16 << 20)], MemoryKind::Device).expect("in the ring's place"));
    let left = context.memory_total().bytes + (1 << 20);
    context.set_max_memory(Some(left));
    context.upload(&buffers[3], &pattern(9 << 20)).expect("by a smaller ring");
    assert!(staging() > 0 && staging() <= 1 << 20, "{}", staging());
    assert!(context.download(&buffers[3]).expect("download")[..9 << 20] == pattern(9 << 20));
    common::assert_silent(&context);
}

#[test]
fn every_memory_type_that_the_host_sees_is_measured() {
    let context = common::context();
    let all = context.measure_memory(1 << 20).expect("rates");
    assert!(!all.is_empty() && all.iter().all(|of| of.heap_bytes > 0));
    let rates = all.iter().flat_map(|of| [of.write, of.read, of.to_device, of.from_device]);
    assert!(rates.into_iter().all(|rate| rate.is_finite() && rate > 0.0), "{all:?}");
    assert!(context.measure_memory(0).is_err());
    common::assert_silent(context);
}

#[test]
fn host_access_outside_or_to_device_memory_is_refused() {
    let context = common::context();
    let host =
        context.allocate("host", &[("h", 16)], MemoryKind::HostVisible).expect("memory").swap_remove(0);
    let device = context.allocate("device", &[("d", 16)], MemoryKind::Device).expect("memory").swap_remove(0);
    host.write(4, &[1, 2, 3, 4]).expect("inside");
    let mut back = [0; 3];
    host.read(5, &mut back).expect("inside");
    assert_eq!(back, [2, 3, 4]);
    assert!(host.write(13, &[0; 4]).is_err() && host.read(u64::MAX, &mut back).is_err());
    assert!(device.write(0, &[0; 4]).is_err(), "even where it is mapped");
    assert!(context.upload(&device, &[0; 17]).is_err());
}

#[test]
#[should_panic(expected = "outside of 'h'")]
fn a_range_outside_panics() {
    let buffers = common::context().allocate("host", &[("h", 64)], MemoryKind::HostVisible).expect("memory");
    let _ = buffers[0].range(60, 8);
}
