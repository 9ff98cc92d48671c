//! `forward/blend_auxiliary` against the twin of `forward/blend`, and its picture against that kernel's, to the bit.

use ashsplat::vk::Buffer;

use crate::common::blending::{Beside, CHAINED, How, LOW, SHARED, UNCHAINED, forward, forward_auxiliary};
use crate::common::gpu::{Gpu, UNTOUCHED};
use crate::common::scenes::small_view;
use crate::common::tiles::Lists;
use crate::reference::blend::beside;
use crate::reference::pipeline::pixels_of;
use crate::reference::types::Splat;

/// Motions of splats, px.
pub fn motions(lists: &Lists) -> Vec<[f32; 2]> {
    (0..lists.frame.splats.len()).map(|i| [(i % 17) as f32 - 8.0, (i % 5) as f32 * 0.25]).collect()
}

/// Number of stable pixels that differ from the twin.
fn odd(gpu: &Gpu, lists: &Lists, beside_picture: &Beside, motions: &[[f32; 2]]) -> usize {
    let count = lists.view.pixels();
    let picks = gpu.read::<[u32; 2]>(&beside_picture.picks, count);
    let sums = gpu.read::<[f32; 2]>(&beside_picture.motion_sums, count);
    let unstable = lists.unstable();
    let differs = |&(index, pixel): &(usize, [u32; 2])| {
        let list = &lists.lists[crate::reference::pipeline::tile_of(&lists.view, pixel)];
        let own: Vec<[f64; 2]> = list.iter().map(|&i| motions[i as usize].map(f64::from)).collect();
        let (expected, weights) = beside(&lists.list_of(pixel), &own, pixel);
        let [place, bits] = picks[index];
        let weight = f64::from(f32::from_bits(bits));
        // Any of several almost equal weights may be the largest.
        let picked = match place {
            0 => expected.heaviest == 0.0 && bits == 0,
            _ => (weights[place as usize - 1] - weight).abs() < 2e-5 && weight > expected.heaviest - 2e-5,
        };
        let close = |axis: usize| (f64::from(sums[index][axis]) - expected.motion[axis]).abs() < 1e-3;
        !(picked && close(0) && close(1))
    };
    pixels_of(&lists.view).enumerate().filter(|(index, _)| !unstable[*index]).filter(differs).count()
}

/// Checks both kernels; `shared` is the number of invocations per tile.
pub fn check(gpu: &Gpu, lists: &Lists, how: How, shared: Option<u32>) {
    let (motions, count) = (motions(lists), lists.view.pixels());
    let both = forward_auxiliary(gpu, lists, (how, shared), &motions, [true; 2]);
    assert_eq!(odd(gpu, lists, &both, &motions), 0, "{how:?}, {shared:?}");
    let words = |buffer: &Buffer, words: usize| gpu.read::<u32>(buffer, words);
    // The picture of the kernel without auxiliary outputs, in one pass.
    let alone = match shared {
        None => forward(gpu, lists, How { entries_per_pass: u32::MAX, ..how }),
        Some(invocations) => {
            let at_once = How { entries_per_pass: u32::MAX, ..how };
            crate::common::blending::forward_shared(gpu, lists, invocations, at_once)
        }
    };
    assert!(words(&both.blended.accumulated, 4 * count) == words(&alone.accumulated, 4 * count));
    assert!(words(&both.blended.last_entries, count) == words(&alone.last_entries, count));
    assert!(words(&both.blended.inverse_depth, count) == words(&alone.inverse_depth, count));
}

/// Picks or motion alone equal those of both together, and the other output stays untouched.
pub fn check_apart(gpu: &Gpu, lists: &Lists, how: How, shared: Option<u32>) {
    let (motions, count) = (motions(lists), lists.view.pixels());
    let words = |buffer: &Buffer| gpu.read::<u32>(buffer, 2 * count);
    let both = forward_auxiliary(gpu, lists, (how, shared), &motions, [true; 2]);
    for (pick, motion) in [(true, false), (false, true)] {
        let one = forward_auxiliary(gpu, lists, (how, shared), &motions, [pick, motion]);
        for (on, buffer, other) in
            [(pick, &one.picks, &both.picks), (motion, &one.motion_sums, &both.motion_sums)]
        {
            let own = words(buffer);
            assert!(if on { own == words(other) } else { own.iter().all(|&word| word == UNTOUCHED) });
        }
    }
}

/// The nearer of two splats with equal weights wins: 1/4 in front; behind it 3/4 of a third, which rounds to 1/4.
/// With a third plus one step, the farther one wins. The splats are so wide that alpha is their opacity at each
/// pixel.
pub fn check_ties(gpu: &Gpu, how: How, shared: Option<u32>) {
    let view = small_view([37, 21]);
    let third = 1.0f32 / 3.0;
    let more = f32::from_bits(third.to_bits() + 1);
    assert!(0.75 * third == 0.25 && 0.75 * more > 0.25);
    for (behind, place) in [(third, 2), (more, 3)] {
        let splat = |opacity: f32| Splat {
            depth: 2.0,
            mean2d_px: [18.0, 10.0],
            cov2d: [1e8, 0.0, 1e8],
            conic: [0.0; 3],
            opacity: f64::from(opacity),
            color: [0.5; 3],
            radius_px: 0,
        };
        // The first is too faint to be blended, the last too faint to win.
        let splats = [0.001, 0.25, behind, 0.125].map(splat).to_vec();
        let lists = vec![(0..4).collect(); (view.tiles()[0] * view.tiles()[1]) as usize];
        let lists = Lists::new(gpu, splats, lists, &view);
        let beside = forward_auxiliary(gpu, &lists, (how, shared), &motions(&lists), [true, false]);
        for [picked, weight] in gpu.read::<[u32; 2]>(&beside.picks, view.pixels()) {
            assert_eq!((picked, f32::from_bits(weight) >= 0.25), (place, true), "{how:?}, {shared:?}");
        }
    }
}

#[test]
fn blend_auxiliary_picks_the_nearest_of_equal_weights() {
    let gpu = Gpu::new();
    for how in [CHAINED, UNCHAINED, LOW, SHARED, How { entries_per_pass: 2, ..CHAINED }] {
        check_ties(&gpu, how, None);
    }
}

#[test]
fn blend_auxiliary_equals_its_twin() {
    let gpu = Gpu::new();
    for how in [CHAINED, UNCHAINED, LOW, SHARED] {
        for entries in [0, 33, 300] {
            check(&gpu, &Lists::long(&gpu, entries, [0.02, 0.6], &small_view([37, 21])), how, None);
        }
        check(&gpu, &Lists::long(&gpu, 40, [0.5, 1.0], &small_view([64, 48])), how, None);
    }
}

#[test]
fn blend_auxiliary_equals_its_twin_in_passes_and_regions() {
    let gpu = Gpu::new();
    let lists = Lists::long(&gpu, 301, [0.005, 0.3], &small_view([37, 21]));
    check_apart(&gpu, &lists, How { entries_per_pass: 64, ..CHAINED }, None);
    for entries_per_pass in [100, 301] {
        check(&gpu, &lists, How { entries_per_pass, ..CHAINED }, None);
    }
    let regions = if gpu.subgroup() <= 64 { 4 } else { 2 };
    for parts in [2, 4].into_iter().filter(|&parts| parts <= regions) {
        check(&gpu, &lists, How { parts, entries_per_pass: 128, ..CHAINED }, None);
    }
}

/// The comparison detects motions of other splats, and lists in another order.
#[test]
fn blend_auxiliary_is_told_from_a_mutated_twin() {
    let gpu = Gpu::new();
    let lists = Lists::long(&gpu, 40, [0.1, 0.6], &small_view([37, 21]));
    let own = motions(&lists);
    let beside = forward_auxiliary(&gpu, &lists, (CHAINED, None), &own, [true; 2]);
    let mut others = own.clone();
    others.rotate_left(1);
    assert!(odd(&gpu, &lists, &beside, &others) > lists.view.pixels() / 2);
    let reversed = lists.lists.iter().map(|list| list.iter().rev().copied().collect()).collect();
    let reversed = Lists::new(&gpu, lists.frame.splats.clone(), reversed, &lists.view);
    assert!(odd(&gpu, &reversed, &beside, &own) > lists.view.pixels() / 2);
}
