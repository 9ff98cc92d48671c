//! The kernels of sparse points' depths.

use ashsplat::kernels::constants::TERM_PARTIALS;
use ashsplat::kernels::loss::{sparse_depth, sparse_depth_gather as gather};
use ashsplat::loss::{DepthPoint, DepthPointBuffers};

use super::exposures::{place, values};
use super::gpu::Gpu;
use super::scenes::Random;
use crate::reference::sparse_depth::Point;

/// Depth sums of a picture as the blending writes them.
pub struct Depths {
    pub size: [usize; 2],
    /// Sum of weights z.
    pub sums: Vec<f32>,
    pub transmittances: Vec<f32>,
}

impl Depths {
    /// Random depths; some pixels are empty.
    pub fn random(random: &mut Random, size: [usize; 2]) -> Depths {
        let one = |random: &mut Random| match random.below(6) {
            0 => [0.0, 1.0],
            _ => {
                let transmittance = random.unit() as f32;
                [(1.0 - transmittance) * (1.0 + 5.0 * random.unit() as f32), transmittance]
            }
        };
        let all: Vec<[f32; 2]> = (0..size[0] * size[1]).map(|_| one(random)).collect();
        let column = |k: usize| all.iter().map(|pixel| pixel[k]).collect();
        Depths { size, sums: column(0), transmittances: column(1) }
    }

    /// Expected depths.
    pub fn expected(&self) -> Vec<f64> {
        let pairs = self.sums.iter().zip(&self.transmittances);
        pairs.map(|(&sum, &t)| f64::from(sum) / (1.0 - f64::from(t)).max(1e-10)).collect()
    }
}

/// Points all over a picture, some at its edges and some at integer positions.
pub fn random_points(random: &mut Random, count: usize, size: [usize; 2]) -> Vec<Point> {
    let place = |random: &mut Random, side: usize| {
        let last = (side - 1) as f64;
        match random.below(5) {
            0 => last,
            1 => f64::from(random.below(side as u32)),
            _ => f64::from((last * random.unit()) as f32),
        }
    };
    (0..count)
        .map(|_| Point {
            position_px: [place(random, size[0]), place(random, size[1])],
            inverse_z: random.between(0.1, 1.0),
        })
        .collect()
}

/// Converts points to the engine's type.
pub fn points(all: &[Point]) -> Vec<DepthPoint> {
    let f = |x: f64| x as f32;
    let point = |p: &Point| DepthPoint { position_px: p.position_px.map(f), inverse_z: f(p.inverse_z) };
    all.iter().map(point).collect()
}

/// Returns the weighted loss and dL/dZ at each point.
pub fn sparse_depth(gpu: &Gpu, depths: &Depths, all: &[Point], weight: f64) -> (f64, Vec<f64>) {
    let spec = sparse_depth::Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup() };
    let kernel = gpu.kernel::<sparse_depth::Interface>(&spec);
    let view = upload(gpu, depths, all);
    let accumulated: Vec<[f32; 4]> = depths.transmittances.iter().map(|&t| [9.0, 9.0, 9.0, t]).collect();
    let (accumulated, sums) =
        (gpu.buffer("accumulated", &accumulated), gpu.buffer("depth_sums", &depths.sums));
    let gradients = gpu.untouched::<f32>("sample_gradients", all.len());
    let partials = gpu.untouched::<[f32; 2]>("partials", TERM_PARTIALS as usize);
    let bind = sparse_depth::Bind {
        points: &view.points,
        accumulated: &accumulated,
        depth_sums: &sums,
        sample_gradients: &gradients,
        partials: &partials,
    };
    let push = sparse_depth::Push {
        image_width: depths.size[0] as u32,
        image_height: depths.size[1] as u32,
        count: view.count,
        weight: (weight / all.len() as f64) as f32,
    };
    gpu.run(|r| r.dispatch(&kernel, &bind, &push, TERM_PARTIALS.into()));
    let partials = gpu.read::<[f32; 2]>(&partials, TERM_PARTIALS as usize);
    let loss = partials.iter().map(|sums| f64::from(sums[0])).sum::<f64>() * weight / all.len() as f64;
    (loss, gpu.read::<f32>(&gradients, all.len()).into_iter().map(f64::from).collect())
}

/// Returns the sums added to a depth gradient that was `before` everywhere, and the depths afterwards.
pub fn sparse_depth_gather(
    gpu: &Gpu,
    depths: &Depths,
    (all, of_points): (&[Point], &[f32]),
    (strips, before): (bool, f32),
) -> (Vec<f64>, Vec<f32>) {
    let spec = gather::Spec { workgroup_size: gpu.workgroup(64), strips };
    let kernel = gpu.kernel::<gather::Interface>(&spec);
    let view = upload(gpu, depths, all);
    let accumulated: Vec<[f32; 4]> = depths.transmittances.iter().map(|&t| [9.0, 9.0, 9.0, t]).collect();
    let (accumulated, sums) =
        (gpu.buffer("accumulated", &accumulated), gpu.buffer("depth_sums", &depths.sums));
    let (of_points, size) = (gpu.buffer("sample_gradients", of_points), depths.size);
    let gradient = gpu.buffer("image_gradient", &vec![before; values(size)]);
    let bind = gather::Bind {
        points: &view.points,
        pixels: &view.pixels,
        entries: &view.entries,
        sample_gradients: &of_points,
        accumulated: &accumulated,
        depth_sums: &sums,
        image_gradient: &gradient,
    };
    let [image_width, image_height] = size.map(|side| side as u32);
    let push = gather::Push { image_width, image_height, count: view.pixel_count };
    let workgroups = u64::from(view.pixel_count) / u64::from(spec.workgroup_size) + 1;
    gpu.run(|r| r.dispatch(&kernel, &bind, &push, workgroups));
    let mut after = gpu.read::<f32>(&gradient, values(size));
    let at: Vec<usize> = (0..size[0] * size[1]).map(|pixel| place(size, strips, pixel, 3)).collect();
    let added = at.iter().map(|&at| f64::from(after[at]) - f64::from(before)).collect();
    at.iter().for_each(|&at| after[at] = before);
    assert!(after.iter().all(|value| *value == before), "changed outside of the fourth plane");
    (added, gpu.read::<f32>(&sums, size[0] * size[1]))
}

fn upload(gpu: &Gpu, depths: &Depths, all: &[Point]) -> DepthPointBuffers {
    let size = (depths.size[0] as u32, depths.size[1] as u32);
    DepthPointBuffers::new(gpu.context, &points(all), size).expect("memory")
}
