//! `backward/blend_backward_subgroup_per_tile` against the twin of `backward/blend_backward`.

use super::blend_backward::{
    in_passes, of_nothing, of_opaque_layers, of_the_first_scene, on_images_of_all_sizes,
    on_lists_of_all_lengths, with_other_sums,
};
use crate::common::blending::backward_alone;

#[test]
fn blend_backward_alone_equals_its_twin_on_lists_of_all_lengths() {
    on_lists_of_all_lengths(backward_alone);
}

#[test]
fn blend_backward_alone_equals_its_twin_on_images_of_all_sizes() {
    on_images_of_all_sizes(backward_alone);
}

#[test]
fn blend_backward_alone_with_other_sums_equals_its_twin() {
    with_other_sums(backward_alone);
}

#[test]
fn blend_backward_alone_of_the_first_scene_alone() {
    of_the_first_scene(backward_alone);
}

#[test]
fn blend_backward_alone_of_opaque_layers() {
    of_opaque_layers(backward_alone);
}

#[test]
fn blend_backward_alone_in_passes() {
    in_passes(backward_alone);
}

#[test]
fn blend_backward_alone_of_nothing_is_zero() {
    of_nothing(backward_alone);
}
