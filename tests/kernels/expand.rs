//! `forward/expand` against its twin.

use ashsplat::kernels::forward::{count, expand};

use crate::common::frame::{Splats, shuffled, state, touched_at_most, widened};
use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::layout::extent_word;
use crate::common::scenes::small_view;
use crate::reference::scan_spine::scan_spine;
use crate::reference::tiles::{exact_box, is_empty, touched, touches_by_pixels};
use crate::reference::types::{Extent, Splat, View};

/// What both kernels write.
struct Expanded {
    counts: Vec<u32>,
    tiles: Vec<u32>,
    visible: Vec<u32>,
    slot_begins: Vec<u32>,
}

/// Counts, scans (by the twin) and expands.
fn expanded(gpu: &Gpu, frame: &Splats, order: &[u32], view: &View) -> Expanded {
    let size = order.len();
    let workgroup_size = gpu.workgroup(64);
    let count_kernel = gpu.kernel::<count::Interface>(&count::Spec { workgroup_size });
    let kernel = gpu.kernel::<expand::Interface>(&expand::Spec { workgroup_size });
    let (count_state, order_buffer) = (state(gpu, size, 0), gpu.buffer("order", order));
    let counts = gpu.zeros::<u32>("tile_counts", size);
    let bind = count::Bind {
        state: &count_state,
        order: &order_buffer,
        mean2d_extent: &frame.mean2d_extent,
        conic_opacity: &frame.conic_opacity,
        footprints: &frame.footprints,
        tile_counts: &counts,
    };
    let push = count::Push { extent: extent_word(view) };
    let workgroups = |n: usize| n as u64 / u64::from(workgroup_size) + 1;
    gpu.run(|recorder| recorder.dispatch(&count_kernel, &bind, &push, workgroups(size)));
    let counts = gpu.read::<u32>(&counts, size);
    let mut offsets = counts.clone();
    let instances = scan_spine(&mut offsets) as usize;

    let (state, offsets) = (state(gpu, size, instances), gpu.buffer("instance_offsets", &offsets));
    let tiles = gpu.untouched::<u32>("instance_tiles", instances + 2);
    let visible = gpu.untouched::<u32>("instance_visible", instances + 2);
    let slot_begins = gpu.untouched::<u32>("slot_begins", size);
    let bind = expand::Bind {
        state: &state,
        order: &order_buffer,
        instance_offsets: &offsets,
        mean2d_extent: &frame.mean2d_extent,
        conic_opacity: &frame.conic_opacity,
        footprints: &frame.footprints,
        instance_tiles: &tiles,
        instance_visible: &visible,
        slot_begins: &slot_begins,
    };
    let push = expand::Push { extent: extent_word(view), tiles_per_row: view.tiles()[0] };
    gpu.run(|recorder| recorder.dispatch(&kernel, &bind, &push, workgroups(instances)));
    let [mut tiles, mut visible] = [tiles, visible].map(|buffer| gpu.read::<u32>(&buffer, instances + 2));
    assert_eq!(
        (tiles.split_off(instances), visible.split_off(instances)),
        (vec![UNTOUCHED; 2], vec![UNTOUCHED; 2])
    );
    Expanded { counts, tiles, visible, slot_begins: gpu.read(&slot_begins, size) }
}

fn check(gpu: &Gpu, frame: &Splats, view: &View) {
    let order = shuffled(frame.splats.len());
    let Expanded { counts, tiles, visible, slot_begins } = expanded(gpu, frame, &order, view);
    let columns = view.tiles()[0];
    let mut begin = 0;
    for (&gaussian, &count) in order.iter().zip(&counts) {
        let slots = begin..begin + count as usize;
        let splat = &frame.splats[gaussian as usize];
        assert!(visible[slots.clone()].iter().all(|&v| v == gaussian), "instances of {gaussian}");
        if count > 0 {
            assert_eq!(slot_begins[gaussian as usize], begin as u32);
        }
        let listed = &tiles[slots];
        assert!(listed.is_sorted_by(|a, b| a < b), "row by row, none twice: {listed:?}");
        let allowed = match view.extent {
            Extent::Exact => touched_at_most(splat, view),
            Extent::Reference => touched(splat, view),
        };
        assert!(listed.iter().all(|tile| allowed.contains(tile)), "{listed:?} not within {allowed:?}");
        match view.extent {
            Extent::Reference => assert_eq!(listed, touched(splat, view)),
            Extent::Exact => {
                let surely = Splat { opacity: splat.opacity * (1.0 - 1e-5), ..splat.clone() };
                let lost = |tile: &u32| {
                    !listed.contains(tile) && touches_by_pixels(&surely, [tile % columns, tile / columns])
                };
                assert_eq!(allowed.iter().find(|tile| lost(tile)), None, "a tile of {splat:?} is lost");
            }
        }
        begin += count as usize;
    }
    assert_eq!(begin, tiles.len());
}

#[test]
fn expand_equals_its_twin() {
    let gpu = Gpu::new();
    for (size, extent) in sizes(64).into_iter().flat_map(|n| [(n, Extent::Exact), (n, Extent::Reference)]) {
        let view = View { extent, ..small_view([150, 90]) };
        check(&gpu, &Splats::random(&gpu, size, &view), &view);
    }
}

/// Long thin ellipses in all directions: where a box and an ellipse differ most.
#[test]
fn expand_of_needles() {
    let gpu = Gpu::new();
    let view = small_view([400, 300]);
    let splats: Vec<Splat> = (0..300)
        .map(|i| {
            let angle = f64::from(i) * 0.0209;
            let (sine, cosine) = angle.sin_cos();
            let (long, short) = (f64::from(1 + i % 40) * 60.0, 0.3 + f64::from(i % 7) * 0.1);
            let xx = long * cosine * cosine + short * sine * sine;
            let yy = long * sine * sine + short * cosine * cosine;
            let xy = (long - short) * sine * cosine;
            let determinant = xx * yy - xy * xy;
            Splat {
                depth: 1.0,
                mean2d_px: [f64::from(i % 23) * 21.0 - 30.0, f64::from(i % 17) * 21.0 - 30.0],
                cov2d: [xx, xy, yy],
                conic: [yy / determinant, -xy / determinant, xx / determinant],
                opacity: [0.9, 0.1, 0.005][i as usize % 3],
                color: [1.0; 3],
                radius_px: 0,
            }
        })
        .collect();
    // Culling leaves those that reach the image.
    let splats = splats.into_iter().filter(|s| !is_empty(exact_box(&widened(s), &view))).collect();
    check(&gpu, &Splats::new(&gpu, splats, &view), &view);
}
