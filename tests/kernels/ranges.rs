//! `forward/ranges` against its twin.

use ashsplat::kernels::forward::ranges::{Bind, Interface, Push, Spec};

use crate::common::frame::{shuffled, state};
use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::scenes::Random;
use crate::reference::ranges::ranges;

#[test]
fn ranges_equal_their_twin() {
    let gpu = Gpu::new();
    let spec = Spec { workgroup_size: gpu.workgroup(64), for_backward: true };
    let kernel = gpu.kernel::<Interface>(&spec);
    let alone = gpu.kernel::<Interface>(&Spec { for_backward: false, ..spec });
    let block = spec.workgroup_size as usize;
    // All in one tile, a few per tile, most tiles empty.
    for (size, tile_count) in sizes(block).into_iter().flat_map(|n| [(n, 1), (n, 20), (n, 5000)]) {
        let mut random = Random::new(size as u64);
        let mut tiles: Vec<u32> = (0..size).map(|_| random.below(tile_count)).collect();
        tiles.sort_unstable();
        let instances = shuffled(size);
        let visible: Vec<u32> = (0..size).map(|_| random.bits() as u32).collect();
        let state = state(&gpu, 0, size);
        let sorted_tiles = gpu.buffer("sorted_tiles", &tiles);
        let sorted_instances = gpu.buffer("sorted_instances", &instances);
        let instance_visible = gpu.buffer("instance_visible", &visible);
        let tile_ranges = gpu.zeros::<[u32; 2]>("tile_ranges", tile_count as usize);
        let sorted_visible = gpu.untouched::<u32>("sorted_visible", size + 2);
        let bind = Bind {
            state: &state,
            sorted_tiles: &sorted_tiles,
            sorted_instances: &sorted_instances,
            instance_visible: &instance_visible,
            tile_ranges: &tile_ranges,
            sorted_visible: &sorted_visible,
        };
        gpu.run(|recorder| recorder.dispatch(&kernel, &bind, &Push::default(), (size / block) as u64 + 1));
        let expected = ranges(&tiles, tile_count);
        assert_eq!(gpu.read::<[u32; 2]>(&tile_ranges, tile_count as usize), expected, "size {size}");
        let (tile_ranges, others) =
            (gpu.zeros::<[u32; 2]>("tile_ranges", tile_count as usize), &sorted_instances);
        let bind = Bind { tile_ranges: &tile_ranges, instance_visible: others, ..bind };
        gpu.run(|recorder| recorder.dispatch(&alone, &bind, &Push::default(), (size / block) as u64 + 1));
        assert_eq!(gpu.read::<[u32; 2]>(&tile_ranges, tile_count as usize), expected, "size {size}");
        let mut expected: Vec<u32> = instances.iter().map(|&instance| visible[instance as usize]).collect();
        expected.extend([UNTOUCHED; 2]);
        assert_eq!(gpu.read::<u32>(&sorted_visible, size + 2), expected, "size {size}");
    }
}
