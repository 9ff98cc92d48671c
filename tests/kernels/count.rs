//! `forward/count` against its twin.

use ashsplat::kernels::forward::count::{Bind, Interface, Push, Spec};

use crate::common::frame::{Splats, shuffled, state, touched_at_most};
use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::layout::extent_word;
use crate::common::scenes::small_view;
use crate::reference::tiles::{touched, touches_by_pixels};
use crate::reference::types::{Extent, Splat, View};

/// Fewest and most tiles that a splat may be counted with: those with a pixel of α ≥ 1/255, and those that the
/// ellipse meets when it is a little larger.
fn bounds(splat: &Splat, view: &View) -> (u32, u32) {
    if view.extent == Extent::Reference {
        let exactly = touched(splat, view).len() as u32;
        return (exactly, exactly);
    }
    let most = touched_at_most(splat, view).len() as u32;
    let [columns, rows] = view.tiles();
    let tiles = (0..rows).flat_map(|y| (0..columns).map(move |x| [x, y]));
    // A pixel within the rounding of float32 at the threshold may count or not.
    let surely = Splat { opacity: splat.opacity * (1.0 - 1e-5), ..splat.clone() };
    (tiles.filter(|tile| touches_by_pixels(&surely, *tile)).count() as u32, most)
}

#[test]
fn count_equals_its_twin() {
    let gpu = Gpu::new();
    let spec = Spec { workgroup_size: gpu.workgroup(64) };
    let kernel = gpu.kernel::<Interface>(&spec);
    let block = spec.workgroup_size as usize;
    for (size, extent) in sizes(block).into_iter().flat_map(|n| [(n, Extent::Exact), (n, Extent::Reference)])
    {
        let view = View { extent, ..small_view([150, 90]) };
        let frame = Splats::random(&gpu, size, &view);
        let order = shuffled(size);
        let (state, order_buffer) = (state(&gpu, size, 0), gpu.buffer("order", &order));
        let counts = gpu.untouched::<u32>("tile_counts", size + 2);
        let bind = Bind {
            state: &state,
            order: &order_buffer,
            mean2d_extent: &frame.mean2d_extent,
            conic_opacity: &frame.conic_opacity,
            footprints: &frame.footprints,
            tile_counts: &counts,
        };
        let push = Push { extent: extent_word(&view) };
        gpu.run(|recorder| recorder.dispatch(&kernel, &bind, &push, (size / block) as u64 + 1));
        let counts = gpu.read::<u32>(&counts, size + 2);
        let footprints = gpu.read::<[u32; 4]>(&frame.footprints, size);
        let (mut counted, mut exact) = (0, 0);
        for (rank, &visible) in order.iter().enumerate() {
            let splat = &frame.splats[visible as usize];
            let (fewest, most) = bounds(splat, &view);
            let count = counts[rank];
            assert!(
                fewest <= count && count <= most,
                "{extent:?} {size}: {count} not in {fewest}..={most}, {splat:?}"
            );
            assert_eq!(footprints[visible as usize][3], count);
            counted += count;
            exact += touched(splat, &view).len() as u32;
        }
        assert_eq!(counts[size..], [UNTOUCHED; 2]);
        // The margins cost little.
        assert!(f64::from(counted) <= 1.02 * f64::from(exact) + 2.0, "{extent:?} {size}: {counted}, {exact}");
    }
}
