//! The processor's sorts and scan, for scale.

use super::schema::{CpuResult, Spread};
use rdst::{RadixKey, RadixSort};
use std::time::Instant;

/// Runs of each algorithm.
const RUNS: usize = 5;

/// A (key, value) pair as the device sorts it; the value is the key's position.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Pair {
    key: u32,
    value: u32,
}

/// Exclusive prefix sums, wrapping.
pub fn prefix_sums(values: &[u32]) -> Vec<u32> {
    let next = |sum: &mut u32, &value: &u32| Some(std::mem::replace(sum, sum.wrapping_add(value)));
    values.iter().scan(0, next).collect()
}

/// Times the scan on one thread.
pub fn scans(values: &[u32]) -> Vec<CpuResult> {
    let mut prefix = vec![0; values.len()];
    let time = time(
        || {},
        |()| {
            let mut sum = 0u32;
            for (out, value) in prefix.iter_mut().zip(values) {
                *out = sum;
                sum = sum.wrapping_add(*value);
            }
            std::hint::black_box(&mut prefix);
        },
    );
    vec![CpuResult { name: "plain loop".into(), threads: 1, time_ms: time }]
}

/// Times the standard library's sorts and rdst's.
pub fn sorts(keys: &[u32]) -> Vec<CpuResult> {
    let pairs = || -> Vec<Pair> { keys.iter().zip(0..).map(|(&key, value)| Pair { key, value }).collect() };
    let result = |name: &str, threads, sort: &dyn Fn(&mut [Pair])| CpuResult {
        name: name.to_owned(),
        threads,
        time_ms: time(pairs, |mut pairs| {
            sort(&mut pairs);
            std::hint::black_box(pairs);
        }),
    };
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
    vec![
        result("std stable", 1, &|pairs| pairs.sort_by_key(|pair| pair.key)),
        result("std unstable", 1, &|pairs| pairs.sort_unstable_by_key(|pair| pair.key)),
        result("rdst", 1, &|pairs| pairs.radix_sort_builder().with_parallel(false).sort()),
        result("rdst", threads, &|pairs| pairs.radix_sort_unstable()),
    ]
}

/// Measures a task on fresh input.
fn time<T>(input: impl Fn() -> T, mut task: impl FnMut(T)) -> Spread {
    let mut one = || {
        let input = input();
        let start = Instant::now();
        task(input);
        start.elapsed().as_secs_f64() * 1e3
    };
    one();
    Spread::of((0..RUNS).map(|_| one()).collect()).unwrap_or_default()
}

impl RadixKey for Pair {
    const LEVELS: usize = 4;

    fn get_level(&self, level: usize) -> u8 {
        (self.key >> (8 * level)) as u8
    }
}
