//! `densify/edge_response` against its twin.

use ashsplat::kernels::densify::edge_response::{Bind, Interface, Push, Spec};

use super::picture_to_rows::SIZES;
use crate::common::gpu::Gpu;
use crate::common::scenes::Random;
use crate::reference::edge_response::{gray, responses};

/// Random colours, flat ones, and ones whose gray is a half; random ones again, for parts.
fn photos(pixels: usize) -> Vec<Vec<[u8; 4]>> {
    let mut random = Random::new(pixels as u64);
    let mut any = || [0; 3].map(|_| (random.unit() * 256.0) as u8);
    let colors: Vec<[u8; 3]> = (0..pixels).map(|_| any()).collect();
    let with_mask = |mask: fn(usize) -> u8, of: &dyn Fn(usize) -> [u8; 3]| {
        (0..pixels)
            .map(|i| {
                let [r, g, b] = of(i);
                [r, g, b, mask(i)]
            })
            .collect::<Vec<_>>()
    };
    // 299 r + 587 g + 114 b = 500 modulo 1000.
    let halves: Vec<[u8; 3]> = (0..=255_u8)
        .flat_map(|r| (0..=255_u8).map(move |g| [r, g, 11]))
        .filter(|[r, g, b]| (299 * u32::from(*r) + 587 * u32::from(*g) + 114 * u32::from(*b)) % 1000 == 500)
        .collect();
    assert!(halves.len() > 20);
    vec![
        with_mask(|_| 255, &|i| colors[i]),
        with_mask(|i| if i % 3 == 0 { 0 } else { 200 }, &|i| colors[i]),
        with_mask(|_| 255, &|_| [7; 3]),
        with_mask(|_| 255, &|i| halves[i % halves.len()]),
        with_mask(|i| if i % 5 == 0 { 0 } else { 200 }, &|i| colors[i]),
        with_mask(|_| 255, &|i| colors[i]),
    ]
}

#[test]
fn edge_response_equals_its_twin() {
    let gpu = Gpu::new();
    let spec = Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup() };
    let kernel = gpu.kernel::<Interface>(&spec);
    for [width, height] in SIZES {
        let pixels = (width * height) as usize;
        let kinds = [(false, 0), (true, 0), (false, 0), (false, 0), (true, 0b0001), (false, 0b1110)];
        for (rgbm, (masked, cut_sides)) in photos(pixels).into_iter().zip(kinds) {
            let rows = gpu.buffer("rows", &rgbm);
            let out = gpu.untouched::<u32>("responses", pixels + 1);
            let ranges = gpu.zeros::<u32>("ranges", 4);
            let bind = Bind { rows: &rows, responses: &out, ranges: &ranges };
            let push = Push { image_width: width, image_height: height, masked: masked.into(), cut_sides };
            let workgroups = pixels as u64 / u64::from(spec.workgroup_size) + 1;
            gpu.run(|r| r.dispatch(&kernel, &bind, &push, workgroups));
            let grays: Vec<i64> = rgbm.iter().map(|&[r, g, b, _]| gray([r, g, b])).collect();
            let mut expected = responses(&grays, [width as usize, height as usize]);
            let masks = rgbm.iter().filter(|_| masked).map(|pixel| pixel[3]);
            expected.iter_mut().zip(masks).filter(|(_, mask)| *mask == 0).for_each(|(value, _)| *value = 0);
            for (pixel, value) in expected.iter_mut().enumerate() {
                let (x, y) = (pixel as u32 % width, pixel as u32 / width);
                let at_side = [x == 0, y == 0, x + 1 == width, y + 1 == height];
                if (0..4).any(|side| at_side[side] && cut_sides >> side & 1 == 1) {
                    *value = 0;
                }
            }
            let actual: Vec<i64> = gpu.read::<u32>(&out, pixels).into_iter().map(i64::from).collect();
            assert_eq!(actual, expected);
            let [low, high, ..] = gpu.read::<u32>(&ranges, 4)[..] else { unreachable!("four words") };
            let range = (expected.iter().min().copied(), expected.iter().max().copied());
            assert_eq!((Some(i64::from(!low)), Some(i64::from(high))), range);
        }
    }
}
