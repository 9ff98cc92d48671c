//! The kernels of `scan/` against their twins, alone and together: `scan/scan_reduce`, `scan/scan_spine` and
//! `scan/scan_apply`.

use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::scenes::Random;
use crate::reference::lists::{clamp, workgroups};
use crate::reference::scan as twin;
use ashsplat::kernels::constants::{STATE_OVERFLOW, STATE_WORDS};
use ashsplat::kernels::scan::{scan_apply, scan_reduce, scan_spine};

/// Workgroup size and items of an invocation. A single subgroup needs no barrier.
fn shapes(gpu: &Gpu) -> [(u32, u32); 2] {
    [(gpu.workgroup(64), 4), (gpu.subgroup(), 12)]
}

/// Random words, the same for each count.
pub fn random_words(count: usize) -> Vec<u32> {
    let mut random = Random::new(count as u64);
    (0..count).map(|_| random.bits() as u32).collect()
}

#[test]
pub fn scan_reduce_equals_its_twin() {
    let gpu = Gpu::new();
    for (workgroup_size, items) in shapes(&gpu) {
        let spec = scan_reduce::Spec { workgroup_size, subgroup_size: gpu.subgroup(), items };
        let block = (workgroup_size * items) as usize;
        for size in sizes(block) {
            let values = random_words(size);
            let blocks = size.div_ceil(block);
            let sums = gpu.untouched::<u32>("block_sums", blocks + 2);
            let bind = scan_reduce::Bind {
                counts: &gpu.buffer("counts", &[7, size as u32]),
                values: &gpu.buffer("values", &values),
                block_sums: &sums,
            };
            // One workgroup more than needed: it must write nothing.
            let push = scan_reduce::Push { count_index: 1 };
            gpu.dispatch::<scan_reduce::Interface>(&spec, &bind, &push, blocks as u64 + 1);
            gpu.assert_values(&sums, &twin::scan_reduce(&values, block), &format!("size {size}"));
        }
    }
}

fn spine(gpu: &Gpu, items: u32, arguments: bool) -> scan_spine::Spec {
    scan_spine::Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup(), items, arguments }
}

#[test]
pub fn scan_spine_equals_its_twin() {
    let gpu = Gpu::new();
    for items in [1, 4] {
        let spec = spine(&gpu, items, false);
        let block_size = 24;
        for (size, from_totals) in
            sizes((spec.workgroup_size * items) as usize).into_iter().flat_map(|n| [(n, 0), (n, 1)])
        {
            let mut random = Random::new(size as u64);
            // With few sums the total fits into 32 bits, with many it saturates.
            let mut sums: Vec<u32> = (0..size).map(|_| random.below(1 << 27)).collect();
            // The last block is not full.
            let values = if size == 0 { 0 } else { size as u32 * block_size - 5 };
            // The sums start behind three other words.
            let input =
                gpu.buffer("block_sums", &[&[UNTOUCHED; 3], sums.as_slice(), &[UNTOUCHED; 2]].concat());
            let totals = gpu.buffer("totals", &[1, 2, 3, values]);
            let push = scan_spine::Push {
                count: if from_totals == 1 { 3 } else { values },
                from_totals,
                block_size,
                total_index: 1,
                first_sum: 3,
                ..scan_spine::Push::default()
            };
            let bind = scan_spine::Bind { block_sums: &input, totals: &totals, arguments: &totals };
            gpu.dispatch::<scan_spine::Interface>(&spec, &bind, &push, 1);
            let total = twin::scan_spine(&mut sums);
            let case = format!("size {size}");
            gpu.assert_values(&input, &[&[UNTOUCHED; 3], sums.as_slice()].concat(), &case);
            gpu.assert_values(&totals, &[1, total, 3, values], &case);
        }
    }
}

/// A total that wraps around must not look like a small one, wherever the carry occurs.
#[test]
pub fn scan_spine_saturates_exactly_beyond_32_bits() {
    let gpu = Gpu::new();
    for items in [1, 4] {
        let spec = spine(&gpu, items, false);
        let far = (spec.workgroup_size * items) as usize + 1;
        for (last, place) in [(0, 1), (1, 1), (2, 1), (0, far), (1, far), (2, far), (u32::MAX, far)] {
            let mut sums = vec![0; far + 1];
            sums[0] = u32::MAX - 1;
            sums[place] = last;
            let (input, totals) = (gpu.buffer("block_sums", &sums), gpu.buffer("totals", &[7_u32]));
            let count = sums.len() as u32;
            let push = scan_spine::Push { count, block_size: 1, ..scan_spine::Push::default() };
            let bind = scan_spine::Bind { block_sums: &input, totals: &totals, arguments: &totals };
            gpu.dispatch::<scan_spine::Interface>(&spec, &bind, &push, 1);
            let total = twin::scan_spine(&mut sums);
            assert_eq!(total, (u32::MAX - 1).saturating_add(last));
            assert_eq!(gpu.read::<u32>(&totals, 1), [total], "{last} at {place}");
            assert_eq!(gpu.read::<u32>(&input, far + 1), sums, "{last} at {place}");
        }
    }
}

/// The total of a frame is clamped to a capacity, and the dispatches over it have enough workgroups.
#[test]
pub fn scan_spine_writes_the_arguments_of_its_total() {
    let gpu = Gpu::new();
    let limit = 65_535;
    let needed =
        [0, 1, 63, 64, 65, 1000, 64 * limit - 1, 64 * limit, 64 * limit + 1, 64 * limit * 3 + 5, u32::MAX];
    for (needed, capacity) in needed.into_iter().flat_map(|n| [(n, u32::MAX), (n, 1000), (n, 0)]) {
        let state = gpu.frame_state(&[]);
        let arguments = gpu.untouched::<[u32; 4]>("arguments", 6);
        let block_sums = gpu.buffer("block_sums", &[needed / 2, needed - needed / 2]);
        let bind = scan_spine::Bind { block_sums: &block_sums, totals: &state, arguments: &arguments };
        let push = scan_spine::Push {
            count: 2,
            from_totals: 0,
            block_size: 1,
            total_index: 2,
            first_sum: 0,
            capacity,
            first_argument: 1,
            block_elementwise: 64,
            block_sort: 1024,
            caller_block: 256,
            max_workgroups_per_axis: limit,
            keeps_overflow: 0,
        };
        gpu.dispatch::<scan_spine::Interface>(&spine(&gpu, 1, true), &bind, &push, 1);
        let (elements, overflow) = clamp(needed, capacity);
        let mut words = vec![0; STATE_WORDS as usize];
        (words[2], words[3], words[STATE_OVERFLOW as usize]) = (needed, elements, u32::from(overflow));
        assert_eq!(gpu.read::<u32>(&state, words.len()), words, "{needed} of {capacity}");
        let arguments = gpu.read::<[u32; 4]>(&arguments, 6);
        for (argument, block) in arguments[1..4].iter().zip([64, 1024, 256]) {
            let expected = workgroups(elements, block, limit);
            assert_eq!(argument[..3], expected, "{needed} of {capacity}, {block}");
        }
        assert_eq!([arguments[0], arguments[4], arguments[5]], [[UNTOUCHED; 4]; 3]);
    }
}

/// The first count of a frame clears what the last frame has counted.
#[test]
fn scan_spine_clears_the_state() {
    let gpu = Gpu::new();
    for (keeps_overflow, capacity) in [(0, 9), (1, 9), (0, 1)] {
        let state = gpu.buffer("state", &[8; STATE_WORDS as usize]);
        let bind = scan_spine::Bind {
            block_sums: &gpu.buffer("block_sums", &[2, 3]),
            totals: &state,
            arguments: &gpu.untouched::<[u32; 4]>("arguments", 3),
        };
        let push = scan_spine::Push {
            count: 2,
            block_size: 1,
            capacity,
            block_elementwise: 64,
            block_sort: 64,
            caller_block: 64,
            max_workgroups_per_axis: 9,
            keeps_overflow,
            ..scan_spine::Push::default()
        };
        gpu.dispatch::<scan_spine::Interface>(&spine(&gpu, 1, true), &bind, &push, 1);
        let mut words = [0; STATE_WORDS as usize];
        (words[0], words[1]) = (5, 5.min(capacity));
        words[STATE_OVERFLOW as usize] = if capacity < 5 { 1 } else { 8 * keeps_overflow };
        assert_eq!(gpu.read::<u32>(&state, words.len()), words, "{keeps_overflow}, {capacity}");
    }
}

#[test]
pub fn scan_apply_equals_its_twin() {
    let gpu = Gpu::new();
    for (workgroup_size, items) in shapes(&gpu) {
        let spec = scan_apply::Spec { workgroup_size, subgroup_size: gpu.subgroup(), items };
        let block = (workgroup_size * items) as usize;
        for size in sizes(block) {
            let blocks = size.div_ceil(block);
            let mut words = random_words(size + blocks);
            let offsets = words.split_off(size);
            let prefix = gpu.untouched::<u32>("prefix", size + 2);
            let bind = scan_apply::Bind {
                counts: &gpu.buffer("counts", &[size as u32]),
                values: &gpu.buffer("values", &words),
                block_offsets: &gpu.buffer("block_offsets", &offsets),
                prefix: &prefix,
            };
            let push = scan_apply::Push { count_index: 0 };
            gpu.dispatch::<scan_apply::Interface>(&spec, &bind, &push, blocks as u64 + 1);
            gpu.assert_values(&prefix, &twin::scan_apply(&words, &offsets, block), &format!("size {size}"));
        }
    }
}
