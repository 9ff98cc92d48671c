//! `densify/mark_drawn` against its twin, and the whole draw.

use ashsplat::densify::{Candidates, Chances, Selection, SelectionBuffers, SelectionDraw};
use ashsplat::kernels::densify::mark_drawn::{Bind, Interface, Push, Spec};
use ashsplat::vk::MemoryKind;

use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::scenes::Random;
use crate::reference::draw_keys::{key, uniform};
use crate::reference::mark_drawn::mark;

#[test]
fn mark_drawn_equals_its_twin() {
    let gpu = Gpu::new();
    let spec = Spec { workgroup_size: gpu.workgroup(64) };
    let kernel = gpu.kernel::<Interface>(&spec);
    for size in sizes(spec.workgroup_size as usize).into_iter().filter(|&size| size > 0) {
        // Keys with ties; a third cannot be drawn.
        let mut random = Random::new(size as u64);
        let mut any = || (random.below(3) > 0).then(|| f64::from(random.below(9)));
        let keys: Vec<Option<f64>> = (0..size).map(|_| any()).collect();
        let mut sorted: Vec<u32> = (0..size as u32).collect();
        sorted.sort_by(|&a, &b| {
            let of = |i: u32| keys[i as usize].unwrap_or(f64::INFINITY);
            of(a).total_cmp(&of(b))
        });
        let candidates = keys.iter().flatten().count();
        for wanted in [0, 1, candidates.saturating_sub(1), candidates, size, usize::MAX >> 32] {
            let totals = gpu.buffer("totals", &[size as u32, candidates as u32, UNTOUCHED, 7]);
            let selected = gpu.zeros::<u32>("selected", size);
            let bind = Bind { sorted: &gpu.buffer("sorted", &sorted), totals: &totals, selected: &selected };
            let push = Push { count: size as u32, wanted: wanted as u32 };
            gpu.run(|r| r.dispatch(&kernel, &bind, &push, size as u64 / u64::from(spec.workgroup_size) + 1));
            assert_eq!(gpu.read::<u32>(&selected, size), mark(&keys, wanted), "{size}, {wanted}");
            let drawn = candidates.min(wanted) as u32;
            assert_eq!(gpu.read::<u32>(&totals, 4), [size as u32, candidates as u32, drawn, 7]);
        }
    }
}

/// Draws with the generator. Every fifth Gaussian has no chance.
fn drawn(gpu: &Gpu, chances: &[f32], wanted: u32, iteration: u32) -> (Vec<u32>, Vec<u32>) {
    let selection = Selection::new(gpu.context).expect("kernels");
    let count = chances.len() as u32;
    let requests = selection.requests(count);
    let buffers = gpu.context.allocate("test", &requests, MemoryKind::Device).expect("memory");
    let buffers = SelectionBuffers::from_allocated(buffers);
    let statistics = gpu.buffer("statistics", &vec![[1.0_f32, 1.0]; chances.len()]);
    let importance = gpu.buffer("importance", chances);
    let draw = SelectionDraw {
        count,
        wanted,
        candidates: Candidates { statistics: &statistics, absolute: None, threshold: 0.5 },
        chances: Chances::Importance(&importance),
        seed: 3,
        iteration,
        explicit: None,
    };
    gpu.run(|r| selection.record(r, &draw, &buffers));
    (gpu.read(&buffers.selected, chances.len()), gpu.read(&buffers.totals, 4))
}

#[test]
fn selection_is_that_of_the_twins() {
    let gpu = Gpu::new();
    for size in [1, 700, 5000] {
        let mut random = Random::new(size as u64);
        let mut any = || if random.below(5) == 0 { 0.0 } else { 0.1 + random.unit() as f32 };
        let chances: Vec<f32> = (0..size).map(|_| any()).collect();
        let candidates = chances.iter().filter(|&&chance| chance > 0.0).count();
        for wanted in [0, size / 3, size] {
            let (selected, totals) = drawn(&gpu, &chances, wanted as u32, 11);
            let keys: Vec<_> =
                chances.iter().zip(0..).map(|(&c, i)| key(c.into(), uniform([3, 11], i))).collect();
            assert!(selected == mark(&keys, wanted), "{size}, {wanted}");
            assert_eq!(totals[..3], [size as u32, candidates as u32, candidates.min(wanted) as u32]);
        }
    }
}

/// Counts how often Gaussians of weights 1, 2 and 3 are drawn in 600 draws of one: within five standard deviations.
#[test]
fn selection_follows_the_chances() {
    let gpu = Gpu::new();
    let selection = Selection::new(gpu.context).expect("kernels");
    let buffers = gpu.context.allocate("test", &selection.requests(3), MemoryKind::Device).expect("memory");
    let buffers = SelectionBuffers::from_allocated(buffers);
    let statistics = gpu.buffer("statistics", &[[1.0_f32, 2.0], [2.0, 2.0], [3.0, 2.0]]);
    const DRAWS: u32 = 600;
    let mut counts = [0; 3];
    for iteration in 0..DRAWS {
        let draw = SelectionDraw {
            count: 3,
            wanted: 1,
            candidates: Candidates { statistics: &statistics, absolute: None, threshold: 0.0 },
            chances: Chances::Statistic,
            seed: 0,
            iteration,
            explicit: None,
        };
        gpu.run(|r| selection.record(r, &draw, &buffers));
        let selected = gpu.read::<u32>(&buffers.selected, 3);
        assert_eq!(selected.iter().sum::<u32>(), 1);
        counts.iter_mut().zip(selected).for_each(|(count, selected)| *count += selected);
    }
    for (count, share) in counts.into_iter().zip([1.0, 2.0, 3.0].map(|weight| weight / 6.0)) {
        let all = f64::from(DRAWS);
        let deviation = (all * share * (1.0 - share)).sqrt();
        assert!((f64::from(count) - all * share).abs() <= 5.0 * deviation, "{counts:?}");
    }
}
