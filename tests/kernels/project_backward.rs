//! `backward/project_backward` against its twin.

use ashsplat::kernels::backward::project_backward::{Bind, Interface, Push, Spec};
use ashsplat::kernels::constants::{GRADIENT_PLANES, STATE_OVERFLOW, STATE_VISIBLE, STATE_WORDS};
use ashsplat::vk::Buffer;

use super::blend_backward::from_moments;
use crate::common::blending::assert_alike;
use crate::common::compare::{GradientTolerance, gradient};
use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::layout::{antialias_word, camera_block, pack_filtered, room};
use crate::common::scenes::{Random, mixed_scene, small_view};
use crate::reference::project::{color, project};
use crate::reference::project_backward::{mean2d_statistic, pose_gradient, project_backward};
use crate::reference::types::{
    DILATION, Drawn, Dropout, Extent, Gaussian, Gradient, Splat, SplatGradient, View,
};

const TOLERANCE: GradientTolerance = GradientTolerance { relative_l2: 1e-4, max_over_max: 2e-4 };
const QUATS: GradientTolerance = GradientTolerance { relative_l2: 5e-4, max_over_max: 5e-4 };

/// A scene with the blending's sums for each visible Gaussian.
pub struct Scene {
    pub view: View,
    pub gaussians: Vec<Gaussian>,
    pub visible: Vec<u32>,
    splats: Vec<Splat>,
    /// Sums of the instances of each visible Gaussian.
    pub sums: Vec<Vec<[f64; 10]>>,
}

impl Scene {
    /// Every `many`-th Gaussian has more instances than one lane sums up.
    pub fn random(size: usize, view: View, many: usize) -> Scene {
        let mut random = Random::new(size as u64);
        let mut gaussians = mixed_scene(&mut random, size, 16);
        for gaussian in &mut gaussians {
            // Float32 resolves neither needles nor very faint opacities.
            gaussian.opacity_logit = gaussian.opacity_logit.max(-4.0);
        }
        let visible: Vec<u32> =
            (0..size as u32).filter(|&i| project(&gaussians[i as usize], &view).is_some()).collect();
        let splats: Vec<Splat> =
            visible.iter().map(|&i| project(&gaussians[i as usize], &view).expect("visible")).collect();
        let sums = splats
            .iter()
            .enumerate()
            .map(|(place, splat)| {
                let instances = if place % many == many - 1 { 64 + place % 200 } else { place % 5 };
                (0..instances).map(|_| random_sums(&mut random, splat)).collect()
            })
            .collect();
        Scene { view, gaussians, visible, splats, sums }
    }

    fn expected(&self) -> Vec<(Gradient, SplatGradient)> {
        self.visible
            .iter()
            .enumerate()
            .map(|(place, &gaussian)| {
                let mut sum = [0.0; 10];
                for instance in &self.sums[place] {
                    for k in 0..10 {
                        sum[k] += instance[k];
                    }
                }
                let mut d = from_moments(&self.splats[place], sum);
                if self.view.drawn.z_record {
                    // The sum is dL/dz.
                    d.inverse_depth *= -self.splats[place].depth.powi(2);
                }
                (project_backward(&self.gaussians[gaussian as usize], &self.view, &d), d)
            })
            .collect()
    }
}

/// Buffers that the kernel reads.
pub struct Inputs {
    pub parameters: Buffer,
    pub state: Buffer,
    pub visible_ranges: Buffer,
    pub visible_list: Buffer,
    pub footprints: Buffer,
    pub first_instances: Buffer,
    pub conic_opacity: Buffer,
    pub instance_gradients_a: Buffer,
    pub instance_gradients_b: Buffer,
    pub instance_gradients_c: Buffer,
}

impl Scene {
    /// Uploads the scene; `overflow`: the frame overflowed.
    pub fn upload(&self, gpu: &Gpu, overflow: bool) -> Inputs {
        let (size, count) = (self.gaussians.len(), self.visible.len());
        let mut words = vec![0; STATE_WORDS as usize];
        words[STATE_VISIBLE as usize] = count as u32;
        words[STATE_OVERFLOW as usize] = u32::from(overflow);
        let mut begins = Vec::new();
        let mut flat: Vec<[f64; 10]> = Vec::new();
        for sums in &self.sums {
            begins.push(flat.len() as u32);
            flat.extend(sums);
        }
        let footprints: Vec<[u32; 4]> = self.sums.iter().map(|sums| [0, 0, 0, sums.len() as u32]).collect();
        let part = |from: usize| {
            flat.iter().map(|s| std::array::from_fn(|k| s[from + k] as f32)).collect::<Vec<[f32; 4]>>()
        };
        let conic: Vec<[f32; 4]> = self
            .splats
            .iter()
            .map(|s| [s.conic[0], s.conic[1], s.conic[2], s.opacity].map(|x| x as f32))
            .collect();
        let parameters =
            gpu.buffer("parameters", &pack_filtered(&self.gaussians, room(size), self.view.filter_3d));
        let state = gpu.buffer("state", &words);
        let visible_ranges = gpu.buffer("visible_ranges", &[[0; 4], [0, count as u32, 0, 0]]);
        let visible_list = gpu.buffer("visible_list", &self.visible);
        let footprints = gpu.buffer("footprints", &footprints);
        let first_instances = gpu.buffer("first_instances", &begins);
        let conic_opacity = gpu.buffer("conic_opacity", &conic);
        let (instance_gradients_a, instance_gradients_b) =
            (gpu.buffer("instance_gradients_a", &part(0)), gpu.buffer("instance_gradients_b", &part(4)));
        let instance_gradients_c: Vec<[f32; 2]> = flat.iter().map(|s| [s[8] as f32, s[9] as f32]).collect();
        let instance_gradients_c = gpu.buffer("instance_gradients_c", &instance_gradients_c);
        Inputs {
            parameters,
            state,
            visible_ranges,
            visible_list,
            footprints,
            first_instances,
            conic_opacity,
            instance_gradients_a,
            instance_gradients_b,
            instance_gradients_c,
        }
    }
}

/// Moments as large as those of pixels within the splat, rounded to float32.
fn random_sums(random: &mut Random, splat: &Splat) -> [f64; 10] {
    let [xx, xy, yy] = splat.cov2d;
    let [sx, sy] = [xx.sqrt(), yy.sqrt()];
    let _ = xy;
    let scales = [1.0, sx, sy, xx, sx * sy, yy, 1.0, 1.0, 1.0, 1.0];
    scales.map(|scale| f64::from((scale * 1e-2 * random.signed()) as f32))
}

/// Runs the kernel. Returns gradient planes and statistics.
pub fn run(gpu: &Gpu, scene: &Scene, accumulate: bool, overflow: bool) -> (Vec<[f32; 4]>, Vec<[f32; 2]>) {
    let (gradients, statistics, _, sums) = run_with(gpu, scene, [accumulate, overflow, false], None);
    assert!(
        sums.as_flattened().iter().all(|x| x.to_bits() == UNTOUCHED),
        "a pose without being asked for it"
    );
    (gradients, statistics)
}

/// Same as [`run`], but also returns the sums for the camera's pose per subgroup.
#[allow(clippy::type_complexity)]
fn run_variant(gpu: &Gpu, scene: &Scene, modes: [bool; 3]) -> (Vec<[f32; 4]>, Vec<[f32; 2]>, Vec<[f32; 6]>) {
    let (gradients, statistics, _, sums) = run_with(gpu, scene, modes, None);
    (gradients, statistics, sums)
}

/// Same as [`run_variant`], but with the instances' absolute gradients. Returns gradients, statistics, absolute
/// statistics, sums for the pose.
#[allow(clippy::type_complexity)]
fn run_with(
    gpu: &Gpu,
    scene: &Scene,
    [accumulate, overflow, pose_gradient]: [bool; 3],
    absolute: Option<&[[f32; 2]]>,
) -> (Vec<[f32; 4]>, Vec<[f32; 2]>, Vec<f32>, Vec<[f32; 6]>) {
    let spec = Spec {
        workgroup_size: gpu.workgroup(64),
        subgroup_size: gpu.subgroup(),
        sh_degree: scene.view.sh_degree,
        filter_3d: scene.view.filter_3d > 0.0,
        own_dilation: scene.view.drawn.dilation_px2 != DILATION,
        dropout: scene.view.drawn.dropout.is_some(),
        z_record: scene.view.drawn.z_record,
        absolute: absolute.is_some(),
        pose_gradient,
        sh_loops: gpu.limits().tuning.sh_loops,
        ..Spec::default()
    };
    let (size, count) = (scene.gaussians.len(), scene.visible.len());
    let gradient_stride = count + 5;
    let inputs = scene.upload(gpu, overflow);
    let gradients = gpu.untouched::<[f32; 4]>("gradients", GRADIENT_PLANES as usize * gradient_stride);
    let statistics = gpu.buffer("statistics", &vec![[2.0_f32, 3.0]; size]);
    let absolute_statistics = gpu.buffer("absolute_statistics", &vec![5.0_f32; size]);
    let instance_gradients_d = absolute
        .map_or_else(|| inputs.instance_gradients_c.clone(), |d| gpu.buffer("instance_gradients_d", d));
    // One more than needed, to see that it stays untouched.
    let subgroups = count.div_ceil(gpu.subgroup() as usize) + 1;
    let pose_sums = gpu.untouched::<[f32; 6]>("pose_sums", subgroups);
    let bind = Bind {
        parameters: &inputs.parameters,
        state: &inputs.state,
        visible_ranges: &inputs.visible_ranges,
        visible_list: &inputs.visible_list,
        footprints: &inputs.footprints,
        first_instances: &inputs.first_instances,
        conic_opacity: &inputs.conic_opacity,
        instance_gradients_a: &inputs.instance_gradients_a,
        instance_gradients_b: &inputs.instance_gradients_b,
        instance_gradients_c: &inputs.instance_gradients_c,
        instance_gradients_d: &instance_gradients_d,
        gradients: &gradients,
        statistics: &statistics,
        absolute_statistics: &absolute_statistics,
        pose_sums: &pose_sums,
        camera_block: &gpu.buffer("camera_block", &[camera_block(&scene.view)]),
    };
    let push = Push {
        first: 0,
        chunk_gaussians: room(size) as u32,
        antialias: antialias_word(&scene.view),
        splat_stride: 1,
        gradient_stride: gradient_stride as u32,
        accumulate: accumulate.into(),
    };
    gpu.dispatch::<Interface>(&spec, &bind, &push, count as u64 / u64::from(spec.workgroup_size) + 1);
    let gradients = gpu.read(&gradients, GRADIENT_PLANES as usize * gradient_stride);
    let absolute = gpu.read(&absolute_statistics, size);
    (gradients, gpu.read(&statistics, size), absolute, gpu.read(&pose_sums, subgroups))
}

fn check(gpu: &Gpu, scene: &Scene) {
    let (planes, statistics) = run(gpu, scene, true, false);
    let (count, stride) = (scene.visible.len(), scene.visible.len() + 5);
    let expected = scene.expected();
    let plane = |p: usize, components: std::ops::Range<usize>| -> Vec<f64> {
        planes[p * stride..p * stride + count]
            .iter()
            .flat_map(|v| v[components.clone()].iter().map(|&x| f64::from(x)).collect::<Vec<f64>>())
            .collect()
    };
    let skip = vec![false; count];
    // The colour's gradient is that before the clamp at 0. Rounding decides about the clamp for colours near 0.
    let near_clamp: Vec<bool> = scene
        .visible
        .iter()
        .map(|&i| color(&scene.gaussians[i as usize], &scene.view).1.iter().any(|c| c.abs() < 1e-4))
        .collect();
    let d_color = |(place, d): (usize, &SplatGradient)| {
        let (_, raw) = color(&scene.gaussians[scene.visible[place] as usize], &scene.view);
        [0, 1, 2].map(|c| if raw[c] < 0.0 { 0.0 } else { d.color[c] })
    };
    let of_gradient = |field: fn(&Gradient) -> Vec<f64>| -> Vec<f64> {
        expected.iter().flat_map(|(g, _)| field(g)).collect()
    };
    let colors: Vec<f64> = expected.iter().map(|(_, d)| d).enumerate().flat_map(d_color).collect();
    let mean2d: Vec<f64> = expected.iter().flat_map(|(_, d)| d.mean2d_px).collect();
    let interleave =
        |x: Vec<f64>, y: Vec<f64>| x.into_iter().zip(y).flat_map(|(x, y)| [x, y]).collect::<Vec<f64>>();
    let compared = [
        ("mean", plane(0, 0..3), of_gradient(|g| g.mean.to_vec()), &near_clamp, TOLERANCE),
        ("opacity", plane(0, 3..4), of_gradient(|g| vec![g.opacity_logit]), &skip, TOLERANCE),
        ("quaternion", plane(1, 0..4), of_gradient(|g| g.quat.to_vec()), &skip, QUATS),
        ("log-scale", plane(2, 0..3), of_gradient(|g| g.log_scale.to_vec()), &skip, TOLERANCE),
        ("colour", plane(3, 0..3), colors, &near_clamp, TOLERANCE),
        ("mean2d", interleave(plane(2, 3..4), plane(3, 3..4)), mean2d, &skip, TOLERANCE),
    ];
    for (name, actual, expected, skip, tolerance) in compared {
        gradient(name, &actual, &expected, skip, tolerance).expect("gradients of parameters");
    }
    check_statistics(scene, &statistics, &expected);
}

/// Visible Gaussians gain a view and the norm; the others keep their statistics.
fn check_statistics(scene: &Scene, statistics: &[[f32; 2]], expected: &[(Gradient, SplatGradient)]) {
    let mut wanted = vec![[2.0, 3.0]; scene.gaussians.len()];
    let largest =
        expected.iter().map(|(_, d)| mean2d_statistic(&scene.view, d.mean2d_px)).fold(0.0_f64, f64::max);
    for (&gaussian, (_, d)) in scene.visible.iter().zip(expected) {
        wanted[gaussian as usize] = [2.0 + mean2d_statistic(&scene.view, d.mean2d_px), 4.0];
    }
    for (i, (actual, wanted)) in statistics.iter().zip(&wanted).enumerate() {
        let error = (f64::from(actual[0]) - wanted[0]).abs();
        assert!(error <= 1e-6 * wanted[0] + 1e-4 * largest, "statistic of {i}: {actual:?}, {wanted:?}");
        assert_eq!(f64::from(actual[1]), wanted[1], "views of {i}");
    }
}

#[test]
pub fn project_backward_equals_its_twin() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize) {
        check(&gpu, &Scene::random(size, small_view([53, 37]), 7));
    }
}

#[test]
pub fn project_backward_equals_its_twin_in_every_mode() {
    let gpu = Gpu::new();
    for sh_degree in 0..=3 {
        let view = View {
            sh_degree,
            antialias: sh_degree % 2 == 1,
            symmetric_limit: sh_degree >= 2,
            extent: if sh_degree == 0 { Extent::Exact } else { Extent::Reference },
            focal_px: [140.0, 120.0],
            center_px: [31.0, 11.0],
            ..small_view([53, 37])
        };
        check(&gpu, &Scene::random(300, view, 50));
    }
}

/// Mip-Splatting's filters, with the compensation differentiated and constant.
#[test]
pub fn project_backward_equals_its_twin_with_filters() {
    let gpu = Gpu::new();
    for (filter_3d, antialias_detached) in [(0.0, true), (0.0078125, false), (0.125, true)] {
        let drawn = Drawn { dilation_px2: f64::from(0.1_f32), ..Drawn::AS_THEY_ARE };
        let view = View { filter_3d, antialias: true, antialias_detached, drawn, ..small_view([53, 37]) };
        check(&gpu, &Scene::random(300, view, 50));
    }
}

/// Opacities raised by dropout; and z as the blended depth.
#[test]
pub fn project_backward_equals_its_twin_under_dropout() {
    let gpu = Gpu::new();
    let dropout = Some(Dropout { below: 1 << 22, seed: 3, iteration: 9 });
    for (antialias, filter_3d, z_record) in [(false, 0.0, true), (true, 0.0, false), (true, 0.0078125, true)]
    {
        let drawn = Drawn { dropout, z_record, ..Drawn::AS_THEY_ARE };
        let view = View { antialias, filter_3d, drawn, ..small_view([53, 37]) };
        check(&gpu, &Scene::random(300, view, 50));
    }
}

/// Checks each subgroup's sums for the pose, and that the other outputs stay the same.
fn check_pose(gpu: &Gpu, scene: &Scene) {
    let (planes, statistics, sums) = run_variant(gpu, scene, [true, false, true]);
    let (plain, plain_statistics) = run(gpu, scene, true, false);
    let within = ("gradients beside a pose's", 1e-5);
    assert_alike(gpu.context, planes.as_flattened(), plain.as_flattened(), within);
    assert_alike(gpu.context, statistics.as_flattened(), plain_statistics.as_flattened(), within);
    let (wide, lanes) = (|x: f32| f64::from(x), gpu.subgroup() as usize);
    let (left_alone, sums) = sums.split_last().expect("one more");
    assert!(left_alone.iter().all(|x| x.to_bits() == UNTOUCHED));
    let gradients = scene.expected();
    let contributions: Vec<[f64; 6]> = (scene.visible.iter().zip(&gradients))
        .map(|(&i, (_, d))| pose_gradient(&scene.gaussians[i as usize], &scene.view, d))
        .collect();
    let near_clamp = |place: &usize| {
        let gaussian = &scene.gaussians[scene.visible[*place] as usize];
        color(gaussian, &scene.view).1.iter().any(|c| c.abs() < 1e-4)
    };
    let (mut expected, mut skip) = (Vec::new(), Vec::new());
    for (first, group) in contributions.chunks(lanes).enumerate() {
        let first = first * lanes;
        skip.push((first..first + group.len()).any(|place| near_clamp(&place)));
        expected.extend((0..6).map(|i| group.iter().map(|c| c[i]).sum::<f64>()));
    }
    let actual: Vec<f64> = sums.as_flattened().iter().copied().map(wide).collect();
    gradient("pose", &actual, &expected, &skip, TOLERANCE).expect("sums for the pose");
    let (compared, all) = (skip.iter().filter(|skipped| !**skipped).count(), skip.len());
    assert!(2 * compared >= all, "{compared} of {all} subgroups are compared");
}

#[test]
pub fn project_backward_of_the_pose_equals_its_twin() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize) {
        check_pose(&gpu, &Scene::random(size, small_view([53, 37]), 7));
    }
    for sh_degree in 0..=3 {
        let view = View {
            sh_degree,
            antialias: sh_degree % 2 == 0,
            symmetric_limit: sh_degree >= 2,
            focal_px: [140.0, 120.0],
            center_px: [31.0, 11.0],
            ..small_view([53, 37])
        };
        check_pose(&gpu, &Scene::random(300, view, 50));
    }
}

/// A value that is not finite would spoil the pose for good.
#[test]
pub fn project_backward_leaves_out_of_the_pose_what_is_not_finite() {
    let gpu = Gpu::new();
    let mut scene = Scene::random(200, small_view([53, 37]), 9);
    let (_, _, before) = run_variant(&gpu, &scene, [true, false, true]);
    let place = (0..scene.sums.len()).find(|&place| !scene.sums[place].is_empty()).expect("a visible one");
    scene.sums[place][0][1] = f64::INFINITY;
    let (_, _, after) = run_variant(&gpu, &scene, [true, false, true]);
    let subgroup = place / gpu.subgroup() as usize;
    for (at, (before, after)) in before[..before.len() - 1].iter().zip(&after).enumerate() {
        assert!(after.iter().all(|x| x.is_finite()), "{at}");
        assert_eq!(before == after, at != subgroup, "{at}");
    }
}

#[test]
pub fn project_backward_leaves_statistics_alone_unless_told() {
    let gpu = Gpu::new();
    let scene = Scene::random(200, small_view([53, 37]), 9);
    for (accumulate, overflow) in [(false, false), (true, true)] {
        let (_, statistics) = run(&gpu, &scene, accumulate, overflow);
        assert!(statistics.iter().all(|&s| s == [2.0, 3.0]), "accumulate {accumulate}, overflow {overflow}");
    }
}

/// Absolute statistics leave the bits of the usual gradients and statistics.
#[test]
pub fn project_backward_adds_up_absolute_statistics() {
    let gpu = Gpu::new();
    let mut scene = Scene::random(300, small_view([53, 37]), 9);
    let instances = scene.sums.iter().map(Vec::len).sum();
    let mut random = Random::new(5);
    let mut absolute: Vec<[f32; 2]> =
        (0..instances).map(|_| [0; 2].map(|_| 1e-3 * random.signed().abs() as f32)).collect();
    // One Gaussian whose sums are not finite, and one whose signed sums are not.
    let first_of = |place: usize| scene.sums[..place].iter().map(Vec::len).sum::<usize>();
    let with_instances: Vec<usize> = (0..scene.sums.len()).filter(|&i| !scene.sums[i].is_empty()).collect();
    let [infinite, signed] = [with_instances[3], with_instances[7]];
    absolute[first_of(infinite)] = [f32::INFINITY, 0.0];
    scene.sums[signed][0][1] = f64::INFINITY;
    let (planes, statistics, sums, _) = run_with(&gpu, &scene, [true, false, false], Some(&absolute));
    let (usual, usual_statistics) = run(&gpu, &scene, true, false);
    let bits = |planes: &[[f32; 4]]| planes.as_flattened().iter().map(|x| x.to_bits()).collect::<Vec<u32>>();
    assert!(bits(&planes) == bits(&usual));
    let mut wanted = vec![5.0; scene.gaussians.len()];
    let mut begin = 0;
    for (place, (&gaussian, own)) in scene.visible.iter().zip(&scene.sums).enumerate() {
        let own = &absolute[begin..begin + own.len()];
        begin += own.len();
        let at = gaussian as usize;
        if place == infinite || place == signed {
            assert_eq!(statistics[at], [2.0, 3.0]);
            continue;
        }
        let sum = [0, 1].map(|axis| own.iter().map(|d| f64::from(d[axis])).sum::<f64>());
        wanted[at] += mean2d_statistic(&scene.view, sum);
        assert_eq!(statistics[at], usual_statistics[at]);
    }
    for (i, (&actual, wanted)) in sums.iter().zip(&wanted).enumerate() {
        assert!((f64::from(actual) - wanted).abs() <= 3e-6 * wanted, "{i}: {actual}, {wanted}");
    }
    let (_, _, sums, _) = run_with(&gpu, &scene, [true, true, false], Some(&absolute));
    assert!(sums.iter().all(|&sum| sum == 5.0));
}
