//! `surface/*` against their twins.

use crate::common::prelude::*;
use crate::reference::linear::apply;
use crate::reference::surface::{Voxel, crossing, integrate as twin};
use ashsplat::kernels::constants::{FIELD_SIDE, FIELD_VOXELS, NO_BLOCK};
use ashsplat::kernels::surface::{
    count_triangles, count_vertices, integrate, place_triangles, place_vertices,
};
use ashsplat::surface::cube_cases;
use half::f16;
use std::collections::HashMap;

const SIDE: i32 = FIELD_SIDE as i32;
const VOXELS: usize = FIELD_VOXELS as usize;

/// Directed edges of triangles without one in the other direction.
pub fn open_edges(triangles: &[[u32; 3]]) -> usize {
    let mut edges: HashMap<[u32; 2], i32> = HashMap::new();
    for [a, b] in triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]) {
        let sign = if a < b { 1 } else { -1 };
        *edges.entry([a.min(b), a.max(b)]).or_default() += sign;
    }
    edges.values().filter(|&&balance| balance != 0).count()
}

/// The lattice's points of some blocks, in the order of their voxels.
fn points_of(blocks: &[[i32; 3]]) -> Vec<[i32; 3]> {
    let inside = (0..SIDE).flat_map(|z| (0..SIDE).flat_map(move |y| (0..SIDE).map(move |x| [x, y, z])));
    let of_block = |block: &[i32; 3]| {
        let block = *block;
        inside.clone().map(move |place| [0, 1, 2].map(|axis| block[axis] * SIDE + place[axis]))
    };
    blocks.iter().flat_map(of_block).collect()
}

#[test]
fn integrate_equals_its_twin() {
    const VOXEL: f32 = 0.125;
    const TRUNCATION: f32 = 0.5;
    const MAX_DEPTH: f32 = 5.5;
    let gpu = Gpu::new();
    let blocks = [[-1, 0, 0], [0, 0, -1], [0, -1, 2], [40, 0, 0]];
    let size = [37, 21];
    let mut random = Random::new(1);
    let distances = gpu.zeros::<[u32; 2]>("distances", 4 * VOXELS);
    let colors = gpu.zeros::<[u32; 2]>("colors", 4 * VOXELS);
    let visible = [3, 2, 1, 0].map(|index: usize| {
        let [x, y, z]: [i32; 3] = blocks[index];
        [x, y, z, index as i32]
    });
    let visible = gpu.buffer("visible_blocks", &visible);
    let (mut expected, mut unstable) = (vec![Voxel::default(); 4 * VOXELS], vec![false; 4 * VOXELS]);
    for shift in [0.0, 0.25, -0.5] {
        let view = small_view(size);
        let view = View { translation: [shift, 0.125, 4.0], ..view };
        let pixels = view.pixels();
        // Nothing at some pixels, and the surface near the blocks or far behind them at others.
        let depth = |at: usize, random: &mut Random| match at % 7 {
            0 => 0.0,
            1 => 100.0,
            _ => random.between(3.0, 6.0),
        };
        let surfaces: Vec<[f32; 4]> =
            (0..pixels).map(|at| [9.0, 9.0, 9.0, depth(at, &mut random) as f32]).collect();
        let shown: Vec<[f32; 4]> = (0..pixels)
            .map(|_| {
                [random.unit(), random.unit(), 1.5 * random.unit(), 0.5 * random.unit()].map(|x| x as f32)
            })
            .collect();
        let f = |x: f64| x as f32;
        let [row_x, row_y, row_z] = view.camera_from_world.map(|row| row.map(f));
        let spec = integrate::Spec { workgroup_size: gpu.workgroup(64) };
        let bind = integrate::Bind {
            visible_blocks: &visible,
            surfaces: &gpu.buffer("surfaces", &surfaces),
            accumulated: &gpu.buffer("accumulated", &shown),
            distances: &distances,
            colors: &colors,
        };
        let push = integrate::Push {
            row_x,
            row_y,
            row_z,
            translation: view.translation.map(f),
            focal_px: view.focal_px.map(f),
            center_px: view.center_px.map(f),
            image_width: size[0],
            image_height: size[1],
            voxels: (4 * VOXELS) as u32,
            voxel_size: VOXEL,
            truncation: TRUNCATION,
            max_depth: MAX_DEPTH,
        };
        gpu.dispatch_over::<integrate::Interface>(&spec, &bind, &push, 4 * VOXELS);
        for (index, point) in points_of(&blocks).into_iter().enumerate() {
            let rotated = apply(&view.camera_from_world, point.map(|at| f64::from(at) * f64::from(VOXEL)));
            let [x, y, z] = [0, 1, 2].map(|i| rotated[i] + view.translation[i]);
            let pixel = [(0, x), (1, y)].map(|(k, at)| view.focal_px[k] * at / z + view.center_px[k]);
            let inside = (0..2).all(|k| (0.0..f64::from(size[k])).contains(&pixel[k]));
            unstable[index] |=
                pixel.iter().any(|at| (at - at.round()).abs() < 1e-3) || (z - 0.2).abs() < 1e-3;
            if z <= 0.2 || !inside {
                continue;
            }
            let at = pixel[1] as usize * size[0] as usize + pixel[0] as usize;
            let depth = f64::from(surfaces[at][3]);
            let (ahead, truncation) = (depth - z, f64::from(TRUNCATION));
            unstable[index] |= (ahead.abs() - truncation).abs() < 1e-4;
            if depth == 0.0 || depth >= f64::from(MAX_DEPTH) {
                continue;
            }
            let [r, g, b, transmittance] = shown[at].map(f64::from);
            let color = [r, g, b].map(|channel| channel / (1.0 - transmittance));
            let pixels = f64::from(VOXEL) * view.focal_px[0] / z;
            twin(&mut expected[index], ahead, truncation, pixels, color);
        }
    }
    let distances = gpu.read::<[u32; 2]>(&distances, 4 * VOXELS);
    let colors = gpu.read::<[u32; 2]>(&colors, 4 * VOXELS);
    let (mut seen, mut colored) = (0, 0);
    for index in (0..4 * VOXELS).filter(|&index| !unstable[index]) {
        let Voxel { distance, weight, views, color, color_weight } = expected[index];
        let [actual, words] = distances[index];
        let (actual, actual_weight) =
            (f64::from(f32::from_bits(actual)), f16::from_bits(words as u16).to_f64());
        // Sums of weights are half floats.
        let close = (actual - distance).abs() < 2e-3 && (actual_weight - weight).abs() <= 2e-3 * weight;
        assert!(close && words >> 16 == views, "{index}: {actual}, expected {distance}");
        let halves = colors[index]
            .map(|word| [word as u16, (word >> 16) as u16].map(|bits| f16::from_bits(bits).to_f64()));
        let [[r, g], [b, sum]] = halves;
        let off = [r, g, b].into_iter().zip(color).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 3e-3 && (sum - color_weight).abs() <= 2e-3 * color_weight, "{index}: {halves:?}");
        seen += usize::from(weight > 0.0);
        colored += usize::from(color_weight > 0.0);
    }
    assert!(seen > 500 && (200..seen).contains(&colored), "{seen} seen, {colored} coloured");
}

/// Random distances, positive ones at the border, and some unseen voxels. Every vertex equals the twin's, and the mesh
/// around the seen voxels is closed.
#[test]
fn count_and_place_equal_their_twins() {
    let gpu = Gpu::new();
    let blocks: Vec<[i32; 3]> =
        (0..8).map(|i| [i & 1, i >> 1 & 1, i >> 2]).map(|offset: [i32; 3]| offset.map(|at| at - 1)).collect();
    let beside = |[x, y, z]: [i32; 3], corner: i32| {
        let other = [x + (corner & 1), y + (corner >> 1 & 1), z + (corner >> 2)];
        blocks.iter().position(|block| *block == other).map_or(NO_BLOCK, |at| at as u32)
    };
    let neighbours: Vec<[u32; 8]> =
        blocks.iter().map(|&block| std::array::from_fn(|corner| beside(block, corner as i32))).collect();
    let points = points_of(&blocks);
    let mut random = Random::new(2);
    let is_inner = |point: &[i32; 3]| point.iter().all(|at| (1 - SIDE..SIDE - 1).contains(at));
    let distances: Vec<f32> =
        points.iter().map(|point| if is_inner(point) { random.signed() as f32 } else { 0.75 }).collect();
    // Three views have seen each.
    let words: Vec<[u32; 2]> = distances.iter().map(|distance| [distance.to_bits(), 3 << 16]).collect();
    let gray = |at: usize| 0.5 * ((at % 3) as f64);
    // Half floats of 0, 0.5 and 1, with a weight of 1.
    let half = |at: usize| [0, 0x3800, 0x3C00][at % 3];
    let colors: Vec<[u32; 2]> =
        (0..points.len()).map(|at| [half(at) * 0x1_0001, half(at) | 0x3C00 << 16]).collect();
    let index_of = |point: [i32; 3]| points.iter().position(|other| *other == point);
    let places: Vec<[i32; 4]> = blocks.iter().map(|&[x, y, z]| [x, y, z, 0]).collect();
    let [blocks, neighbours] = [gpu.buffer("field_blocks", &places), gpu.buffer("neighbours", &neighbours)];
    let (distances_buffer, colors_buffer) = (gpu.buffer("distances", &words), gpu.buffer("colors", &colors));
    let cubes = gpu.buffer("cubes", &cube_cases());
    let workgroup_size = gpu.workgroup(64);
    let voxels = points.len() as u32;
    macro_rules! run {
        ($kernel:ident { $($own:ident: $buffer:expr),* $(,)? }) => {{
            let bind = $kernel::Bind { neighbours: &neighbours, distances: &distances_buffer, $($own: $buffer,)* };
            let push = $kernel::Push { voxels, voxel_size: 0.5, least_views: 2 };
            gpu.dispatch_over::<$kernel::Interface>(&$kernel::Spec { workgroup_size }, &bind, &push, points.len());
        }};
    }
    let firsts = |counts: &[u32]| {
        let (mut sum, mut firsts) = (0, Vec::new());
        for count in counts {
            firsts.push(sum);
            sum += count;
        }
        (firsts, sum as usize)
    };

    let mut expected = Vec::new();
    let mut vertex_counts = Vec::new();
    for (index, point) in points.iter().enumerate() {
        let before = expected.len();
        for axis in 0..3 {
            let mut beside = *point;
            beside[axis] += 1;
            let Some(other) = index_of(beside) else { continue };
            let [own, next] = [index, other].map(|at| f64::from(distances[at]));
            if let Some(share) = crossing(own, next) {
                let mut at = point.map(|at| 0.5 * f64::from(at));
                at[axis] += 0.5 * share;
                expected.push((at, (1.0 - share) * gray(index) + share * gray(other)));
            }
        }
        vertex_counts.push((expected.len() - before) as u32);
    }
    let counts = gpu.untouched::<u32>("counts", points.len() + 3);
    run!(count_vertices { counts: &counts });
    gpu.assert_values(&counts, &vertex_counts, "vertices");
    let (vertex_firsts, vertices) = firsts(&vertex_counts);
    let vertex_firsts = gpu.buffer("vertex_firsts", &vertex_firsts);
    let positions = gpu.untouched::<[f32; 3]>("positions", vertices + 1);
    let vertex_colors = gpu.untouched::<u32>("vertex_colors", vertices + 4);
    run!(place_vertices {
        blocks: &blocks,
        colors: &colors_buffer,
        firsts: &vertex_firsts,
        positions: &positions,
        vertex_colors: &vertex_colors,
    });
    let colors = gpu.read::<[u8; 4]>(&vertex_colors, vertices);
    for ((actual, color), (at, gray)) in
        gpu.read::<[f32; 3]>(&positions, vertices).iter().zip(colors).zip(expected)
    {
        assert!((0..3).all(|k| (f64::from(actual[k]) - at[k]).abs() < 1e-5), "{actual:?}, expected {at:?}");
        assert!(
            (f64::from(color[0]) - 255.0 * gray).abs() < 1.0 && color[3] == 255,
            "{color:?}, expected {gray}"
        );
    }

    run!(count_triangles { cubes: &cubes, counts: &counts });
    let (triangle_firsts, count) = firsts(&gpu.read::<u32>(&counts, points.len()));
    let triangles = gpu.untouched::<[u32; 3]>("triangles", count + 2);
    run!(place_triangles {
        cubes: &cubes,
        vertex_firsts: &vertex_firsts,
        triangle_firsts: &gpu.buffer("triangle_firsts", &triangle_firsts),
        triangles: &triangles,
    });
    let triangles = gpu.read::<[u32; 3]>(&triangles, count);
    assert!(count > 5000 && triangles.iter().flatten().all(|&vertex| (vertex as usize) < vertices));
    assert_eq!(open_edges(&triangles), 0, "the mesh has a border");
}
