//! `compose/picks` against its twin.

use ashsplat::compose::Compose;
use ashsplat::kernels::compose::picks::{Bind, Interface, Push, Spec};
use ashsplat::kernels::constants::NOT_PICKED;
use ashsplat::vk::{Image, ImageUse};

use crate::common::compose::{IMAGE, OFFSET, SIZE};
use crate::common::gpu::Gpu;
use crate::reference::picks::scene_of;

/// Scenes without Gaussians at the front, in the middle and at the end, and a scene of one Gaussian.
#[test]
fn picks_equal_their_twin() {
    let gpu = Gpu::new();
    for counts in [vec![64], vec![0, 0, 10, 0, 1, 0, 0, 53, 0], vec![1; 64]] {
        let firsts: Vec<u32> = counts
            .iter()
            .scan(0, |next, count| {
                let first = *next;
                *next += count;
                Some(first)
            })
            .collect();
        let texels = (IMAGE[0] * IMAGE[1]) as usize;
        let image = Image::new(gpu.context, "picks", Compose::PICK_FORMAT, IMAGE, ImageUse::Pick);
        let image = image.expect("an image");
        let (columns, rows) = (SIZE[0].div_ceil(16), SIZE[1].div_ceil(16));
        let tiles = columns * rows;
        // Each tile lists the visible Gaussians in another order; every second Gaussian is visible.
        let (visible, entries) = (32, 32);
        let list: Vec<u32> = (0..visible).map(|i| 2 * i).collect();
        let ranges: Vec<[u32; 2]> = (0..tiles).map(|tile| [tile * entries, (tile + 1) * entries]).collect();
        let sorted: Vec<u32> =
            (0..tiles).flat_map(|tile| (0..entries).map(move |i| (i * 5 + tile) % visible)).collect();
        let depth = |visible: u32| 0.5 + visible as f32;
        let shades: Vec<[f32; 4]> = (0..visible).map(|i| [0.0, 0.0, 0.0, 1.0 / depth(i)]).collect();
        let pixels = SIZE[0] * SIZE[1];
        let picks: Vec<[u32; 2]> = (0..pixels)
            .map(|i| if i % 7 == 0 { [0, 0] } else { [1 + i % entries, (i as f32).to_bits()] })
            .collect();
        let spec = Spec { workgroup_size: gpu.workgroup(64) };
        let kernel = gpu.kernel::<Interface>(&spec);
        let bind = Bind {
            picks: &gpu.buffer("picks", &picks),
            tile_ranges: &gpu.buffer("tile_ranges", &ranges),
            sorted_visible: &gpu.buffer("sorted_visible", &sorted),
            visible_list: &gpu.buffer("visible_list", &list),
            color_inverse_depth: &gpu.buffer("color_inverse_depth", &shades),
            scene_firsts: &gpu.buffer("scene_firsts", &firsts),
            target: &image,
        };
        let push = Push {
            image_width: SIZE[0],
            image_height: SIZE[1],
            offset_x: OFFSET[0],
            offset_y: OFFSET[1],
            tiles_per_row: columns,
            splat_stride: 1,
            scenes: counts.len() as u32,
        };
        let from = gpu.buffer("texels", &vec![[7u32; 4]; texels]);
        let to = gpu.untouched::<[u32; 4]>("texels", texels);
        gpu.run(|r| {
            r.copy_to_image(&from.range(0, 16 * texels as u64), &image);
            r.dispatch(&kernel, &bind, &push, u64::from(pixels).div_ceil(u64::from(spec.workgroup_size)));
            r.copy_from_image(&image, &to.range(0, 16 * texels as u64));
        });
        for (index, actual) in gpu.read::<[u32; 4]>(&to, texels).into_iter().enumerate() {
            let at = [index as u32 % IMAGE[0], index as u32 / IMAGE[0]];
            let inside = |k: usize| (OFFSET[k]..OFFSET[k] + SIZE[k]).contains(&at[k]);
            if !(inside(0) && inside(1)) {
                assert_eq!(actual, [7; 4], "{at:?} lies outside");
                continue;
            }
            let [x, y] = [at[0] - OFFSET[0], at[1] - OFFSET[1]];
            let [place, weight] = picks[(y * SIZE[0] + x) as usize];
            let expected = match place {
                0 => [NOT_PICKED, NOT_PICKED, 0, 0],
                _ => {
                    let tile = y / 16 * columns + x / 16;
                    let visible = ((place - 1) * 5 + tile) % visible;
                    let [gaussian, scene] = scene_of(2 * visible, &counts);
                    let z = f32::from_bits(actual[2]);
                    assert!((z - depth(visible)).abs() < 1e-5 * z, "{z}");
                    [gaussian, scene, actual[2], weight]
                }
            };
            assert_eq!(actual, expected, "{at:?}");
        }
    }
}
