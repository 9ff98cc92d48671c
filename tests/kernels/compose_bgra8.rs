//! `compose/compose_bgra8` against the twin of `compose/compose_rgba8`.

use ashsplat::ash::vk::Format;

use super::compose_rgba8::equal_their_twins;

#[test]
fn compose_bgra8_equals_its_twin() {
    equal_their_twins([Format::B8G8R8A8_UNORM, Format::B8G8R8A8_SRGB], [2, 1, 0, 3]);
}
