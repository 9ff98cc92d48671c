//! The whole prefix sum.

use crate::common::prelude::*;
use crate::reference::scan::exclusive_scan;
use ashsplat::passes::scan::{Scan, ScanBuffers, Workgroups};

/// Scans on the device. The host or a buffer gives the number of workgroups.
fn check(gpu: &Gpu, scan: &Scan, values: &[u32], indirect: bool) {
    let n = values.len();
    let counts = gpu.buffer("counts", &[5, n as u32, UNTOUCHED]);
    let input = gpu.buffer("values", values);
    let prefix = gpu.untouched::<u32>("prefix", n + 2);
    let block_sums = gpu.untouched::<u32>("block_sums", scan.block_words(n as u64) as usize);
    let buffers = ScanBuffers {
        counts: &counts,
        count_index: 1,
        total_index: 2,
        values: &input,
        prefix: &prefix,
        block_sums: &block_sums,
    };
    let blocks = scan.block_words(n as u64);
    let [x, y, z] = gpu.context.limits().grid(blocks);
    let arguments = gpu.buffer("arguments", &[x, y, z]);
    let workgroups = if indirect { Workgroups::Indirect(&arguments) } else { Workgroups::Elements(n as u64) };
    gpu.run(|recorder| scan.record(recorder, &buffers, workgroups));
    let (mut expected, total) = exclusive_scan(values);
    expected.extend([UNTOUCHED; 2]);
    assert!(gpu.read::<u32>(&prefix, n + 2) == expected, "{n} values, indirect {indirect}");
    assert_eq!(gpu.read::<u32>(&counts, 3), [5, n as u32, total], "{n} values, indirect {indirect}");
}

fn check_sizes(gpu: &Gpu, sizes: &[usize]) {
    let scan = Scan::new(gpu.context).expect("the kernels of the scan");
    for &n in sizes {
        let mut random = Random::new(n as u64);
        let values: Vec<u32> = (0..n).map(|_| random.below(1 << 20)).collect();
        check(gpu, &scan, &values, false);
        check(gpu, &scan, &values, true);
    }
}

#[test]
fn scan_of_many_sizes() {
    check_sizes(&Gpu::new(), &[0, 1, 2, 255, 256, 257, 1023, 1024, 1025, 4095, 4097, 100_000, 1_048_577]);
}

#[test]
fn scan_in_a_narrow_grid() {
    let limits = LimitsOverride { max_workgroups_per_axis: Some(7), ..LimitsOverride::default() };
    let gpu = Gpu::with(&ContextOptions { limits_override: Some(limits), ..options() });
    check_sizes(&gpu, &[1, 7 * 1024, 7 * 1024 + 1, 40 * 1024 + 3]);
}
