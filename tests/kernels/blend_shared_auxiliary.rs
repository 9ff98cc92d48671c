//! `forward/blend_shared_auxiliary` against the twin of `forward/blend`, and its picture against that of
//! `forward/blend_shared`, to the bit.

use super::blend_auxiliary::{check, check_apart, check_ties};
use crate::common::blending::{CHAINED, How, UNCHAINED};
use crate::common::gpu::Gpu;
use crate::common::scenes::small_view;
use crate::common::tiles::Lists;

#[test]
fn blend_shared_auxiliary_picks_the_nearest_of_equal_weights() {
    let gpu = Gpu::new();
    for how in [CHAINED, UNCHAINED, How { entries_per_pass: 2, ..CHAINED }] {
        check_ties(&gpu, how, Some(32));
    }
}

#[test]
fn blend_shared_auxiliary_equals_its_twin() {
    let gpu = Gpu::new();
    let largest = gpu.context.limits().workgroup_size(256);
    for entries in [0, 33, 300] {
        let lists = Lists::long(&gpu, entries, [0.02, 0.6], &small_view([37, 21]));
        check(&gpu, &lists, CHAINED, Some(32));
        check(&gpu, &lists, UNCHAINED, Some(largest));
        check(&gpu, &lists, How { entries_per_pass: 100, ..UNCHAINED }, Some(64));
    }
    let lists = Lists::long(&gpu, 301, [0.005, 0.3], &small_view([37, 21]));
    check_apart(&gpu, &lists, How { entries_per_pass: 64, ..CHAINED }, Some(32));
}
