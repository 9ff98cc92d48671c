//! `forward/compact` against its twin.

use ashsplat::kernels::forward::compact::{Bind, Interface, Push, Spec};

use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::scenes::Random;
use crate::reference::compact::compact;
use crate::reference::scan_spine::scan_spine;

#[test]
pub fn compact_equals_its_twin() {
    let gpu = Gpu::new();
    let (workgroup_size, subgroup_size) = (gpu.workgroup(64), gpu.subgroup());
    let spec = Spec { workgroup_size, subgroup_size, block: workgroup_size };
    let block = spec.block as usize;
    // One in `share` is flagged: all, some, hardly any.
    for (size, share) in sizes(block).into_iter().flat_map(|n| [(n, 1), (n, 3), (n, 500)]) {
        let mut random = Random::new(size as u64);
        let flags: Vec<bool> = (0..size).map(|_| random.below(share) == 0).collect();
        let words: Vec<u32> = flags.iter().map(|&flag| u32::from(flag)).collect();
        let mut offsets: Vec<u32> = words.chunks(block).map(|flags| flags.iter().sum()).collect();
        let total = scan_spine(&mut offsets) as usize;
        let (input, block_offsets) =
            (gpu.buffer("visible_flags", &words), gpu.buffer("block_offsets", &offsets));
        // Capacity for all, and for half.
        for capacity in [total, total / 2] {
            let list = gpu.untouched::<u32>("visible_list", total + 2);
            let places = gpu.untouched::<u32>("visible_index", size + 2);
            let bind = Bind {
                visible_flags: &input,
                block_offsets: &block_offsets,
                visible_list: &list,
                visible_index: &places,
            };
            let push = Push { count: size as u32, capacity: capacity as u32 };
            gpu.dispatch::<Interface>(&spec, &bind, &push, size.div_ceil(block) as u64 + 1);
            let (mut expected_list, mut expected_places) = compact(&flags, capacity);
            expected_list.resize(total + 2, UNTOUCHED);
            expected_places.extend([UNTOUCHED; 2]);
            assert_eq!(gpu.read::<u32>(&list, total + 2), expected_list, "size {size} of {capacity}");
            assert_eq!(gpu.read::<u32>(&places, size + 2), expected_places, "size {size} of {capacity}");
        }
    }
}
