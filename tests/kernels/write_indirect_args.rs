//! `forward/write_indirect_args` against its twin.

use ashsplat::kernels::constants::{STATE_OVERFLOW, STATE_WORDS};
use ashsplat::kernels::forward::write_indirect_args::{Bind, Interface, Push, Spec};

use crate::common::gpu::{Gpu, UNTOUCHED};
use crate::reference::write_indirect_args::{clamp, workgroups};

#[test]
fn prepare_equals_its_twin() {
    let gpu = Gpu::new();
    let kernel = gpu.kernel::<Interface>(&Spec::default());
    let limit = 65_535;
    let needed =
        [0, 1, 63, 64, 65, 1000, 64 * limit - 1, 64 * limit, 64 * limit + 1, 64 * limit * 3 + 5, u32::MAX];
    for (needed, capacity) in needed.into_iter().flat_map(|n| [(n, u32::MAX), (n, 1000), (n, 0)]) {
        let mut words = vec![0; STATE_WORDS as usize];
        words[2] = needed;
        let state = gpu.buffer("state", &words);
        let arguments = gpu.untouched::<[u32; 4]>("arguments", 6);
        let bind = Bind { state: &state, arguments: &arguments };
        let push = Push {
            count_index: 2,
            capacity,
            first_argument: 1,
            block_elementwise: 64,
            block_sort: 1024,
            block_third: 256,
            max_workgroups_per_axis: limit,
        };
        gpu.run(|recorder| recorder.dispatch(&kernel, &bind, &push, 1));
        let (elements, overflow) = clamp(needed, capacity);
        words[3] = elements;
        words[STATE_OVERFLOW as usize] = u32::from(overflow);
        assert_eq!(gpu.read::<u32>(&state, words.len()), words, "{needed} of {capacity}");
        let arguments = gpu.read::<[u32; 4]>(&arguments, 6);
        for (argument, block) in arguments[1..4].iter().zip([64, 1024, 256]) {
            assert_eq!(argument[..3], workgroups(elements, block, limit), "{needed} of {capacity}, {block}");
        }
        assert_eq!(arguments[0], [UNTOUCHED; 4]);
        assert_eq!(arguments[4..], [[UNTOUCHED; 4]; 2]);
    }
}
