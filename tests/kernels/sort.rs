//! `sort/sort_upsweep`, `sort/sort_spine` and `sort/sort_downsweep` against their twins, which do the other steps of a
//! pass. Tests of the whole sort cover the kernels of single subgroups.

use super::scan::random_words;
use crate::common::prelude::*;
use crate::reference::sort as twin;
use ashsplat::kernels::constants::{SORT_GROUP_BLOCKS, SORT_GROUPS};
use ashsplat::kernels::sort::{sort_downsweep, sort_spine, sort_upsweep};

/// All keys equal; two keys alternating; two keys in halves.
fn equal_and_extreme(size: usize) -> Vec<Vec<u32>> {
    let mut lists: Vec<Vec<u32>> = [0, 0x0101_0101, u32::MAX].map(|key| vec![key; size]).into();
    lists.push((0..size).map(|i| if i % 2 == 0 { 255 } else { 0 }).collect());
    lists.push((0..size).map(|i| if i < size / 2 { 255 } else { 0 }).collect());
    lists
}

/// Shift and bits of the digits to sort by.
const DIGITS: [[u32; 2]; 4] = [[0, 8], [24, 8], [8, 5], [31, 1]];
#[test]
pub fn sort_upsweep_equals_its_twin() {
    let gpu = Gpu::new();
    check_upsweep(&gpu, sort_upsweep::Spec { workgroup_size: gpu.workgroup(64), items: 4 });
}

/// Key counts around multiples of a block, random keys, all digits.
pub fn check_upsweep(gpu: &Gpu, spec: sort_upsweep::Spec) {
    let sizes = sizes((spec.workgroup_size * spec.items) as usize);
    sizes
        .into_iter()
        .for_each(|size| DIGITS.into_iter().for_each(|digit| check_rows(gpu, spec, size, digit)));
}

fn check_rows(gpu: &Gpu, spec: sort_upsweep::Spec, size: usize, [shift, bits]: [u32; 2]) {
    let block = (spec.workgroup_size * spec.items) as usize;
    let (keys, blocks) = (random_words(size), size.div_ceil(block));
    let expected = twin::sort_upsweep(&keys, shift, bits, block, per_group(blocks));
    let histogram = gpu.untouched::<u32>("histogram", expected.len() + 2);
    let zeros = [0; SORT_GROUPS as usize + 1];
    let arrivals = gpu.buffer("arrivals", &zeros);
    let bind = sort_upsweep::Bind {
        counts: &gpu.buffer("counts", &[0, size as u32]),
        keys: &gpu.buffer("keys", &keys),
        histogram: &histogram,
        arrivals: &arrivals,
    };
    let push = sort_upsweep::Push { count_index: 1, shift, bits };
    gpu.dispatch::<sort_upsweep::Interface>(&spec, &bind, &push, blocks as u64 + 1);
    gpu.assert_values(&histogram, &expected, &format!("size {size}, {bits} bits at {shift}"));
    assert_eq!(gpu.read::<u32>(&arrivals, zeros.len()), zeros);
}

/// Blocks of a group (sort_rows.glsl).
fn per_group(blocks: usize) -> usize {
    blocks.div_ceil(SORT_GROUPS as usize).max(SORT_GROUP_BLOCKS as usize)
}

/// A few groups, and more blocks than all groups hold at their smallest size, so that groups grow.
#[test]
fn sort_upsweep_of_many_groups() {
    let gpu = Gpu::new();
    let spec = sort_upsweep::Spec { workgroup_size: gpu.workgroup(64), items: 1 };
    for blocks in [16, 17, 40, 1024, 1025, 1500] {
        check_rows(&gpu, spec, (blocks * spec.workgroup_size) as usize - 3, [3, 4]);
    }
}

#[test]
pub fn sort_spine_equals_its_twin() {
    let gpu = Gpu::new();
    let spec = sort_spine::Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup() };
    let block_size = 8;
    // The last workgroup has more rows than there are digits.
    let digits = 21;
    let rows = spec.workgroup_size / spec.subgroup_size;
    let workgroups = u64::from(digits as u32 / rows + 1);
    for blocks in sizes(spec.subgroup_size as usize) {
        let mut random = Random::new(blocks as u64);
        let mut rows: Vec<u32> = (0..blocks * digits).map(|_| random.below(1000)).collect();
        let keys = if blocks == 0 { 0 } else { blocks as u32 * block_size - 3 };
        let histogram = gpu.buffer("histogram", &[rows.as_slice(), &[UNTOUCHED; 4]].concat());
        let totals = gpu.untouched::<u32>("digit_totals", digits + 1);
        let bind = sort_spine::Bind {
            counts: &gpu.buffer("counts", &[keys]),
            histogram: &histogram,
            digit_totals: &totals,
        };
        let push = sort_spine::Push { count_index: 0, block_size, digits: digits as u32 };
        gpu.dispatch::<sort_spine::Interface>(&spec, &bind, &push, workgroups);
        let expected_totals = twin::sort_spine(&mut rows, blocks, digits);
        gpu.assert_values(&histogram, &rows, &format!("{blocks} blocks"));
        gpu.assert_values(&totals, &expected_totals, &format!("{blocks} blocks"));
    }
}

/// Pairs of keys and values. The values identify their positions, to check the order of equal keys.
struct Pairs<'a> {
    keys: &'a [u32],
    values: Vec<u32>,
    /// True if the kernel takes positions for values.
    identity_values: bool,
}

impl<'a> Pairs<'a> {
    fn new(keys: &'a [u32], identity_values: bool) -> Pairs<'a> {
        let scale = if identity_values { 1 } else { 3 };
        Pairs { keys, values: (0..keys.len() as u32).map(|place| place * scale).collect(), identity_values }
    }

    /// Uploads keys and values with [`UNTOUCHED`] words behind them; values that are positions stay untouched.
    fn upload(&self, gpu: &Gpu, names: [&'static str; 2]) -> [Buffer; 2] {
        let padded = |words: &[u32]| [words, &[UNTOUCHED; 4]].concat();
        let values = match self.identity_values {
            true => vec![UNTOUCHED; self.keys.len() + 4],
            false => padded(&self.values),
        };
        [gpu.buffer(names[0], &padded(self.keys)), gpu.buffer(names[1], &values)]
    }

    /// Histogram before the keys are scattered.
    fn histogram(&self, gpu: &Gpu, [shift, bits]: [u32; 2], block: usize) -> Buffer {
        let per_group = per_group(self.keys.len().div_ceil(block));
        let rows = twin::sort_upsweep(self.keys, shift, bits, block, per_group);
        gpu.buffer("histogram", if rows.is_empty() { &[UNTOUCHED] } else { &rows })
    }

    fn check_scattered(&self, gpu: &Gpu, [keys, values]: [&Buffer; 2], digit: [u32; 2], case: &str) {
        let (expected_keys, expected_values) =
            twin::sort_downsweep(self.keys, &self.values, digit[0], digit[1]);
        gpu.assert_values(keys, &expected_keys, case);
        gpu.assert_values(values, &expected_values, case);
    }
}

fn downsweep_spec(gpu: &Gpu, identity_values: bool) -> sort_downsweep::Spec {
    sort_downsweep::Spec {
        workgroup_size: gpu.workgroup(8 * gpu.subgroup()).min(256),
        subgroup_size: gpu.subgroup(),
        items: 4,
        identity_values,
    }
}

fn check_downsweep(gpu: &Gpu, spec: sort_downsweep::Spec, keys: &[u32], [shift, bits]: [u32; 2]) {
    let size = keys.len();
    let block = (spec.workgroup_size * spec.items) as usize;
    let blocks = size.div_ceil(block);
    let pairs = Pairs::new(keys, spec.identity_values);
    let histogram = pairs.histogram(gpu, [shift, bits], block);
    let [input, values] = pairs.upload(gpu, ["keys", "values"]);
    let [sorted_keys, sorted_values] =
        ["sorted_keys", "sorted_values"].map(|name| gpu.untouched::<u32>(name, size + 2));
    let bind = sort_downsweep::Bind {
        counts: &gpu.buffer("counts", &[size as u32]),
        keys: &input,
        values: &values,
        histogram: &histogram,
        sorted_keys: &sorted_keys,
        sorted_values: &sorted_values,
    };
    let push = sort_downsweep::Push { count_index: 0, shift, bits };
    gpu.dispatch::<sort_downsweep::Interface>(&spec, &bind, &push, blocks as u64 + 1);
    let case = format!("size {size}, {bits} bits at {shift}, {spec:?}");
    pairs.check_scattered(gpu, [&sorted_keys, &sorted_values], [shift, bits], &case);
}

#[test]
pub fn sort_downsweep_equals_its_twin() {
    let gpu = Gpu::new();
    for identity_values in [false, true] {
        check_downsweep_sizes(&gpu, downsweep_spec(&gpu, identity_values));
    }
    // A block of more pairs than its subgroups have digit counts.
    let (spec, lanes) = (downsweep_spec(&gpu, false), gpu.subgroup());
    let items = 256 / lanes + 1;
    check_downsweep_sizes(&gpu, sort_downsweep::Spec { workgroup_size: lanes, items, ..spec });
}

/// Key counts around multiples of a block, random keys, all digits.
pub fn check_downsweep_sizes(gpu: &Gpu, spec: sort_downsweep::Spec) {
    for size in sizes((spec.workgroup_size * spec.items) as usize) {
        let keys = random_words(size);
        DIGITS.into_iter().for_each(|digit| check_downsweep(gpu, spec, &keys, digit));
    }
}

#[test]
pub fn sort_downsweep_of_equal_and_extreme_keys() {
    let gpu = Gpu::new();
    let spec = downsweep_spec(&gpu, false);
    for keys in equal_and_extreme((3 * spec.workgroup_size * spec.items + 5) as usize) {
        check_downsweep(&gpu, spec, &keys, [0, 8]);
    }
}
