//! `densify/zorder` against its twin, and rows in the order of the curve.

use ashsplat::densify::{Curve, Densify, DensifyBuffers, OrderBuffers};
use ashsplat::kernels::densify::zorder::{Bind, Interface, Push, Spec};
use ashsplat::plan::LaunchSizes;
use ashsplat::planes;
use ashsplat::vk::{Context, ContextOptions, LimitsOverride, MemoryKind};
use glam::Vec3;

use crate::common::engine::gaussians;
use crate::common::gpu::{Gpu, sizes};
use crate::common::layout::{pack, room};
use crate::common::options;
use crate::common::scenes::{Random, small_scene};
use crate::reference::types::Gaussian;
use crate::reference::zorder::{cell, zorder};

const CENTER: [f64; 3] = [0.5, -1.25, 2.0];
const EXTENT: f64 = 3.0;

/// Gaussians all over space, some without a position on the curve.
fn scattered(count: usize) -> Vec<Gaussian> {
    let mut random = Random::new(count as u64);
    let mut scene = small_scene(&mut Random::new(7), count, 1);
    for gaussian in &mut scene {
        let far = 10f64.powf(4.0 * random.unit() - 2.0);
        gaussian.mean = gaussian.mean.map(|_| f64::from((far * random.normal()) as f32));
    }
    let odd = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e38, -1e38, 0.0, -0.0];
    for (gaussian, odd) in scene.iter_mut().zip(odd) {
        gaussian.mean[1] = f64::from(odd as f32);
    }
    scene
}

/// Same as [`scattered`], but at least a hundredth of a cell from borders, where rounding decides.
fn inside_cells(count: usize) -> Vec<Gaussian> {
    let mut scene = scattered(count);
    for gaussian in &mut scene {
        for (mean, center) in gaussian.mean.iter_mut().zip(CENTER) {
            while mean.abs() < 1e30 && !(0.01..0.99).contains(&cell(*mean, center, EXTENT).fract()) {
                *mean = f64::from((*mean + 1e-4 * (1.0 + mean.abs())) as f32);
            }
        }
    }
    scene
}

#[test]
fn zorder_equals_its_twin() {
    let gpu = Gpu::new();
    let spec = Spec { workgroup_size: gpu.workgroup(64) };
    let kernel = gpu.kernel::<Interface>(&spec);
    for size in sizes(spec.workgroup_size as usize) {
        let scene = inside_cells(size.max(8));
        let mut random = Random::new(3);
        let sources: Vec<u32> =
            (0..size).map(|_| random.below(scene.len() as u32) | random.below(4) << 30).collect();
        // Two ranges of Gaussians, as with parameters in two buffers.
        let half = scene.len() / 2;
        let keys = gpu.buffer("keys", &vec![u32::MAX; size + 1]);
        for (first, range) in [(0, &scene[..half]), (half, &scene[half..])] {
            let parameters = gpu.buffer("parameters", &pack(range, room(range.len())));
            let bind =
                Bind { sources: &gpu.buffer("sources", &sources), parameters: &parameters, keys: &keys };
            let push = Push {
                first: first as u32,
                count: range.len() as u32,
                rows: size as u32,
                center: CENTER.map(|x| x as f32),
                extent: EXTENT as f32,
            };
            let groups = size as u64 / u64::from(spec.workgroup_size) + 1;
            gpu.run(|recorder| recorder.dispatch(&kernel, &bind, &push, groups));
        }
        let keys = gpu.read::<u32>(&keys, size + 1);
        assert_eq!(keys[size], u32::MAX, "written behind the rows");
        for (source, key) in sources.iter().zip(&keys) {
            let mean = scene[(source & 0x3FFF_FFFF) as usize].mean;
            assert_eq!(*key, zorder(mean, CENTER, EXTENT), "{mean:?}");
        }
    }
}

#[test]
fn zorder_keys_are_the_bits_of_cells_in_turn() {
    let corner = |x: f64, y: f64, z: f64| zorder([x, y, z], [0.0; 3], 1.0);
    // The middle of space is the first cell of the upper half.
    assert_eq!(corner(0.0, -1e9, -1e9), 1 << 27);
    assert_eq!(corner(-1e9, 0.0, -1e9), 1 << 28);
    assert_eq!(corner(-1e9, -1e9, 0.0), 1 << 29);
    assert_eq!(corner(1e9, 1e9, 1e9), (1 << 30) - 1);
    assert_eq!(corner(f64::NAN, -1e9, -1e9), 0);
    assert_eq!(corner(1.0, -1e9, -1e9), 1 << 27 | 1 << 24);
}

/// Rows are sorted by their keys, and rows of one key keep their order. There are more rows than one workgroup sorts
/// alone, and parameters in several buffers.
#[test]
fn zorder_puts_rows_into_the_curves_order() {
    let gpu = Gpu::new();
    let limits = LimitsOverride { max_storage_buffer_range: Some(1 << 20), ..LimitsOverride::default() };
    let options = ContextOptions { limits_override: Some(limits), ..options() };
    let in_chunks = Context::new(&options).expect("a device");
    for (context, count, rows) in [
        (gpu.context, 8, 0),
        (gpu.context, 8, 1),
        (gpu.context, 8, 2),
        (gpu.context, 77, 77),
        (gpu.context, 3000, 200_000),
        (&in_chunks, 20_000, 30_000),
    ] {
        let scene = inside_cells(count);
        let count = scene.len() as u32;
        let stored = gaussians(&scene);
        let uploaded = planes::upload(context, "scene", &stored, count, stored.sh_degree).expect("a scene");
        assert_eq!(uploaded.plan.chunks > 1, context.limits().max_storage_buffer_range == 1 << 20);
        let densify = Densify::new(context).expect("kernels");
        let sizes = LaunchSizes::new(context.limits());
        let allocate = |requests: &[(&'static str, u64)]| {
            context.allocate("densify", requests, MemoryKind::Device).expect("memory")
        };
        let buffers =
            DensifyBuffers::from_allocated(allocate(&DensifyBuffers::requests(&sizes, count, rows)));
        let order = OrderBuffers::from_allocated(allocate(&OrderBuffers::requests(&sizes, rows)));
        let mut random = Random::new(rows.into());
        let listed: Vec<u32> = (0..rows).map(|_| random.below(count) | random.below(4) << 30).collect();
        context.upload(&buffers.sources, bytemuck::cast_slice(&listed)).expect("uploaded");
        let curve = Curve { center: Vec3::from_array(CENTER.map(|x| x as f32)), extent: EXTENT as f32 };
        let mut sorted = None;
        let recorded = context.run("order", |recorder| {
            let rows = (&uploaded, rows);
            sorted = Some(densify.record_order(recorder, rows, &buffers, &order, &curve).clone());
            Ok(())
        });
        recorded.expect("sorted");
        let mut expected = listed;
        let keys: Vec<u32> = scene.iter().map(|g| zorder(g.mean, CENTER, EXTENT)).collect();
        expected.sort_by_key(|source| keys[(source & 0x3FFF_FFFF) as usize]);
        let bytes = context.download(&sorted.expect("recorded")).expect("read");
        let actual: Vec<u32> = bytemuck::pod_collect_to_vec(&bytes);
        assert!(actual[..rows as usize] == expected, "{count} Gaussians, {rows} rows");
    }
}
