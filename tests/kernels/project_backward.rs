//! `backward/project_backward` and `backward/expand_gradients` against their twins.

use super::blend_backward::from_moments;
use super::optimizer::{CAMERA, GradientRows};
use crate::common::blending::assert_alike;
use crate::common::prelude::*;
use crate::reference::project::{color, project};
use crate::reference::project_backward as twin;
use crate::reference::types::DILATION;
use ashsplat::kernels::backward::{expand_gradients, project_backward};
use ashsplat::kernels::constants::{GRADIENT_PLANES, STATE_OVERFLOW, STATE_VISIBLE};

const TOLERANCE: GradientTolerance = GradientTolerance { relative_l2: 1e-4, max_over_max: 2e-4 };
const QUATS: GradientTolerance = GradientTolerance { relative_l2: 5e-4, max_over_max: 5e-4 };

/// A scene with the blending's sums for each visible Gaussian.
struct Scene {
    view: View,
    gaussians: Vec<Gaussian>,
    visible: Vec<u32>,
    splats: Vec<Splat>,
    /// Sums of the instances of each visible Gaussian.
    sums: Vec<Vec<[f64; 10]>>,
}

impl Scene {
    /// Every `many`-th Gaussian has more instances than one lane sums up.
    fn random(size: usize, view: View, many: usize) -> Scene {
        let mut random = Random::new(size as u64);
        let mut gaussians = mixed_scene(&mut random, size, 16);
        for gaussian in &mut gaussians {
            // Float32 resolves neither needles nor very faint opacities.
            gaussian.opacity_logit = gaussian.opacity_logit.max(-4.0);
        }
        let projected = gaussians.iter().zip(0..).filter_map(|(g, i)| Some((i, project(g, &view)?)));
        let (visible, splats): (Vec<u32>, Vec<Splat>) = projected.unzip();
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
                let sum = std::array::from_fn(|k| self.sums[place].iter().map(|sums| sums[k]).sum());
                let mut d = from_moments(&self.splats[place], sum);
                if self.view.drawn.z_record {
                    // The sum is dL/dz.
                    d.inverse_depth *= -self.splats[place].depth.powi(2);
                }
                (twin::project_backward(&self.gaussians[gaussian as usize], &self.view, &d), d)
            })
            .collect()
    }

    /// True if rounding decides about the colour's clamp at 0.
    fn is_near_clamp(&self, place: usize) -> bool {
        let gaussian = &self.gaussians[self.visible[place] as usize];
        color(gaussian, &self.view).1.iter().any(|c| c.abs() < 1e-4)
    }
}

/// Moments as large as those of pixels within the splat, rounded to float32.
fn random_sums(random: &mut Random, splat: &Splat) -> [f64; 10] {
    let [xx, _, yy] = splat.cov2d;
    let [sx, sy] = [xx.sqrt(), yy.sqrt()];
    let scales = [1.0, sx, sy, xx, sx * sy, yy, 1.0, 1.0, 1.0, 1.0];
    scales.map(|scale| f64::from((scale * 1e-2 * random.signed()) as f32))
}

/// Optional outputs of the kernel.
#[derive(Clone, Copy, Default)]
struct Modes<'a> {
    accumulate: bool,
    overflow: bool,
    pose_gradient: bool,
    absolute: Option<&'a [[f32; 2]]>,
}

const USUAL: Modes<'static> =
    Modes { accumulate: true, overflow: false, pose_gradient: false, absolute: None };

struct Output {
    /// Planes of gradients.
    gradients: Vec<[f32; 4]>,
    statistics: Vec<[f32; 2]>,
    /// Sums for the camera's pose per subgroup.
    pose_sums: Vec<[f32; 6]>,
}

fn run(gpu: &Gpu, scene: &Scene, modes: Modes) -> Output {
    let view = &scene.view;
    let spec = project_backward::Spec {
        workgroup_size: gpu.workgroup(64),
        subgroup_size: gpu.subgroup(),
        sh_degree: view.sh_degree,
        filter_3d: view.filter_3d > 0.0,
        own_dilation: view.drawn.dilation_px2 != DILATION,
        dropout: view.drawn.dropout.is_some(),
        z_record: view.drawn.z_record,
        absolute: modes.absolute.is_some(),
        pose_gradient: modes.pose_gradient,
        sh_loops: gpu.limits().tuning.sh_loops,
        ..project_backward::Spec::default()
    };
    let (size, count) = (scene.gaussians.len(), scene.visible.len());
    let gradient_stride = count + 5;
    let flat = scene.sums.concat();
    let first_instances: Vec<u32> = (scene.sums.iter())
        .scan(0, |next, sums| Some(std::mem::replace(next, *next + sums.len() as u32)))
        .collect();
    let footprints: Vec<[u32; 4]> = scene.sums.iter().map(|sums| [0, 0, 0, sums.len() as u32]).collect();
    let part = |from: usize| {
        flat.iter().map(|s| std::array::from_fn(|k| s[from + k] as f32)).collect::<Vec<[f32; 4]>>()
    };
    let last: Vec<[f32; 2]> = flat.iter().map(|s| [s[8] as f32, s[9] as f32]).collect();
    let gradients = gpu.untouched::<[f32; 4]>("gradients", GRADIENT_PLANES as usize * gradient_stride);
    let statistics = gpu.buffer("statistics", &vec![[2.0_f32, 3.0]; size]);
    // One more than needed, to see that it stays untouched.
    let subgroups = count.div_ceil(gpu.subgroup() as usize) + 1;
    let pose_sums = gpu.untouched::<[f32; 6]>("pose_sums", subgroups);
    let bind = project_backward::Bind {
        parameters: &gpu
            .buffer("parameters", &pack_filtered(&scene.gaussians, plane_capacity(size), view.filter_3d)),
        state: &gpu.frame_state(&[(STATE_VISIBLE, count as u32), (STATE_OVERFLOW, modes.overflow.into())]),
        visible_ranges: &gpu.buffer("visible_ranges", &[[0; 4], [0, count as u32, 0, 0]]),
        visible_list: &gpu.buffer("visible_list", &scene.visible),
        footprints: &gpu.buffer("footprints", &footprints),
        first_instances: &gpu.buffer("first_instances", &first_instances),
        conic_opacity: &gpu.buffer("conic_opacity", &pack_splats(&scene.splats).conic_opacity),
        instance_gradients_a: &gpu.buffer("instance_gradients_a", &part(0)),
        instance_gradients_b: &gpu.buffer("instance_gradients_b", &part(4)),
        instance_gradients_c: &gpu.buffer("instance_gradients_c", &last),
        instance_gradients_d: &gpu.buffer("instance_gradients_d", modes.absolute.unwrap_or(&last)),
        gradients: &gradients,
        statistics: &statistics,
        pose_sums: &pose_sums,
        camera_block: &gpu.buffer("camera_block", &[camera_block(view)]),
    };
    let push = project_backward::Push {
        first: 0,
        chunk_gaussians: plane_capacity(size) as u32,
        antialias: antialias_word(view),
        splat_stride: 1,
        gradient_stride: gradient_stride as u32,
        accumulate: modes.accumulate.into(),
        ..project_backward::Push::default()
    };
    gpu.dispatch_over::<project_backward::Interface>(&spec, &bind, &push, count);
    let mut pose_sums = gpu.read::<[f32; 6]>(&pose_sums, subgroups);
    let untouched = pose_sums.split_off(if modes.pose_gradient { subgroups - 1 } else { 0 });
    let is_untouched = |x: &f32| x.to_bits() == UNTOUCHED;
    assert!(untouched.as_flattened().iter().all(is_untouched), "sums for a pose that nobody reads");
    Output {
        gradients: gpu.read(&gradients, GRADIENT_PLANES as usize * gradient_stride),
        statistics: gpu.read(&statistics, size),
        pose_sums,
    }
}

fn check(gpu: &Gpu, scene: &Scene) {
    let Output { gradients: planes, statistics, .. } = run(gpu, scene, USUAL);
    let (count, stride) = (scene.visible.len(), scene.visible.len() + 5);
    let expected = scene.expected();
    let skip = vec![false; count];
    // The colour's gradient is that before the clamp at 0.
    let near_clamp: Vec<bool> = (0..count).map(|place| scene.is_near_clamp(place)).collect();
    let d_color = |place: usize| {
        let (_, raw) = color(&scene.gaussians[scene.visible[place] as usize], &scene.view);
        [0, 1, 2].map(|c| if raw[c] < 0.0 { 0.0 } else { expected[place].1.color[c] })
    };
    let row = |plane: usize, place: usize| planes[plane * stride + place].map(f64::from);
    let all = |values: &dyn Fn(usize) -> Vec<f64>| (0..count).flat_map(values).collect::<Vec<f64>>();
    let of_gradient = |field: fn(&Gradient) -> Vec<f64>| all(&|i| field(&expected[i].0));
    let three = |plane| all(&|i| row(plane, i)[..3].to_vec());
    let mean2d = all(&|i| vec![row(2, i)[3], row(3, i)[3]]);
    let expected_mean2d = all(&|i| expected[i].1.mean2d_px.to_vec());
    let compared = [
        ("mean", three(0), of_gradient(|g| g.mean.to_vec()), &near_clamp, TOLERANCE),
        ("opacity", all(&|i| vec![row(0, i)[3]]), of_gradient(|g| vec![g.opacity_logit]), &skip, TOLERANCE),
        ("quaternion", all(&|i| row(1, i).to_vec()), of_gradient(|g| g.quat.to_vec()), &skip, QUATS),
        ("log-scale", three(2), of_gradient(|g| g.log_scale.to_vec()), &skip, TOLERANCE),
        ("colour", three(3), all(&|i| d_color(i).to_vec()), &near_clamp, TOLERANCE),
        ("mean2d", mean2d, expected_mean2d, &skip, TOLERANCE),
    ];
    for (name, actual, expected, skip, tolerance) in compared {
        gradient(name, &actual, &expected, skip, tolerance)
            .unwrap_or_else(|e| panic!("{:?}: {e}", scene.view));
    }
    check_statistics(scene, &statistics, &expected);
}

/// Visible Gaussians gain a view and the norm; the others keep their statistics.
fn check_statistics(scene: &Scene, statistics: &[[f32; 2]], expected: &[(Gradient, SplatGradient)]) {
    let mut wanted = vec![[2.0, 3.0]; scene.gaussians.len()];
    let mut largest = 0.0_f64;
    for (&gaussian, (_, d)) in scene.visible.iter().zip(expected) {
        let norm = twin::mean2d_statistic(&scene.view, d.mean2d_px);
        wanted[gaussian as usize] = [2.0 + norm, 4.0];
        largest = largest.max(norm);
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

fn view_of_mode(sh_degree: u32, antialias: bool) -> View {
    View {
        sh_degree,
        antialias,
        symmetric_limit: sh_degree >= 2,
        focal_px: [140.0, 120.0],
        center_px: [31.0, 11.0],
        ..small_view([53, 37])
    }
}

#[test]
pub fn project_backward_equals_its_twin_in_every_mode() {
    let mut views = Vec::new();
    for sh_degree in 0..=3 {
        let extent = if sh_degree == 0 { Extent::Exact } else { Extent::Reference };
        views.push(View { extent, ..view_of_mode(sh_degree, sh_degree % 2 == 1) });
    }
    // Mip-Splatting's filters, with the compensation differentiated and constant.
    for (filter_3d, antialias_detached) in [(0.0, true), (0.0078125, false), (0.125, true)] {
        let drawn = Style { dilation_px2: f64::from(0.1_f32), ..Style::AS_THEY_ARE };
        views.push(View { filter_3d, antialias: true, antialias_detached, drawn, ..small_view([53, 37]) });
    }
    // Opacities raised by dropout; and z as the blended depth.
    let dropout = Some(Dropout { below: 1 << 22, seed: 3, iteration: 9 });
    for (antialias, filter_3d, z_record) in [(false, 0.0, true), (true, 0.0, false), (true, 0.0078125, true)]
    {
        let drawn = Style { dropout, z_record, ..Style::AS_THEY_ARE };
        views.push(View { antialias, filter_3d, drawn, ..small_view([53, 37]) });
    }
    let gpu = Gpu::new();
    views.into_iter().for_each(|view| check(&gpu, &Scene::random(300, view, 50)));
}

/// Checks each subgroup's sums for the pose, and that the other outputs stay the same.
fn check_pose(gpu: &Gpu, scene: &Scene) {
    let Output { gradients, statistics, pose_sums, .. } =
        run(gpu, scene, Modes { pose_gradient: true, ..USUAL });
    let usual = run(gpu, scene, USUAL);
    let within = ("gradients beside a pose's", 1e-5);
    assert_alike(gpu.context, gradients.as_flattened(), usual.gradients.as_flattened(), within);
    assert_alike(gpu.context, statistics.as_flattened(), usual.statistics.as_flattened(), within);
    let lanes = gpu.subgroup() as usize;
    let contributions: Vec<[f64; 6]> = (scene.visible.iter().zip(&scene.expected()))
        .map(|(&i, (_, d))| twin::pose_gradient(&scene.gaussians[i as usize], &scene.view, d))
        .collect();
    let (mut expected, mut skip) = (Vec::new(), Vec::new());
    for (first, group) in contributions.chunks(lanes).enumerate() {
        let first = first * lanes;
        skip.push((first..first + group.len()).any(|place| scene.is_near_clamp(place)));
        expected.extend((0..6).map(|i| group.iter().map(|c| c[i]).sum::<f64>()));
    }
    let actual: Vec<f64> = pose_sums.as_flattened().iter().copied().map(f64::from).collect();
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
        check_pose(&gpu, &Scene::random(300, view_of_mode(sh_degree, sh_degree % 2 == 0), 50));
    }
}

/// A value that is not finite would spoil the pose for good.
#[test]
pub fn project_backward_leaves_out_of_the_pose_what_is_not_finite() {
    let gpu = Gpu::new();
    let mut scene = Scene::random(200, small_view([53, 37]), 9);
    let modes = Modes { pose_gradient: true, ..USUAL };
    let before = run(&gpu, &scene, modes).pose_sums;
    let place = (0..scene.sums.len()).find(|&place| !scene.sums[place].is_empty()).expect("a visible one");
    scene.sums[place][0][1] = f64::INFINITY;
    let after = run(&gpu, &scene, modes).pose_sums;
    let subgroup = place / gpu.subgroup() as usize;
    for (at, (before, after)) in before.iter().zip(&after).enumerate() {
        assert!(after.iter().all(|x| x.is_finite()), "{at}");
        assert_eq!(before == after, at != subgroup, "{at}");
    }
}

#[test]
pub fn project_backward_leaves_statistics_alone_unless_told() {
    let gpu = Gpu::new();
    let scene = Scene::random(200, small_view([53, 37]), 9);
    for (accumulate, overflow) in [(false, false), (true, true)] {
        let Output { statistics, .. } = run(&gpu, &scene, Modes { accumulate, overflow, ..USUAL });
        assert!(statistics.iter().all(|&s| s == [2.0, 3.0]), "accumulate {accumulate}, overflow {overflow}");
    }
}

/// Statistics of absolute gradients change no bit of the gradients.
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
    let modes = Modes { absolute: Some(&absolute), ..USUAL };
    let [actual, usual] = [modes, USUAL].map(|modes| run(&gpu, &scene, modes));
    let bits = |planes: &[[f32; 4]]| planes.as_flattened().iter().map(|x| x.to_bits()).collect::<Vec<u32>>();
    assert!(bits(&actual.gradients) == bits(&usual.gradients));
    let mut wanted = vec![2.0; scene.gaussians.len()];
    let mut begin = 0;
    for (place, (&gaussian, own)) in scene.visible.iter().zip(&scene.sums).enumerate() {
        let own = &absolute[begin..begin + own.len()];
        begin += own.len();
        let at = gaussian as usize;
        if place == infinite || place == signed {
            assert_eq!(actual.statistics[at], [2.0, 3.0]);
            continue;
        }
        let sum = [0, 1].map(|axis| own.iter().map(|d| f64::from(d[axis])).sum::<f64>());
        wanted[at] += twin::mean2d_statistic(&scene.view, sum);
        assert_eq!(actual.statistics[at][1], usual.statistics[at][1]);
    }
    for (i, (&[sum, _], wanted)) in actual.statistics.iter().zip(&wanted).enumerate() {
        assert!((f64::from(sum) - wanted).abs() <= 3e-6 * wanted, "{i}: {sum}, {wanted}");
    }
    let overflowed = run(&gpu, &scene, Modes { overflow: true, ..modes });
    assert!(overflowed.statistics.iter().all(|&s| s == [2.0, 3.0]));
}

fn check_expanded(gpu: &Gpu, size: usize, sh_degree: u32, coefficients: usize, sh_loops: bool) {
    let spec = expand_gradients::Spec {
        workgroup_size: gpu.workgroup(64),
        sh_degree,
        sh_loops,
        ..expand_gradients::Spec::default()
    };
    let mut random = Random::new(size as u64);
    let gaussians = mixed_scene(&mut random, size, coefficients);
    let rows = GradientRows::random(&mut random, size);
    let (capacity, planes) = (plane_capacity(size), planes(coefficients));
    let parameter_gradients = gpu.untouched::<[f32; 4]>("parameter_gradients", planes * capacity);
    let mean2d = gpu.untouched::<[f32; 2]>("mean2d_gradients", size + 1);
    let bind = expand_gradients::Bind {
        parameters: &gpu.gaussians("parameters", &gaussians),
        visible_index: &gpu.buffer("visible_index", &rows.visible),
        gradients: &gpu.buffer("gradients", &rows.rows),
        parameter_gradients: &parameter_gradients,
        mean2d_gradients: &mean2d,
        // Only read with a rolling shutter.
        camera_block: &mean2d,
    };
    let push = expand_gradients::Push {
        camera_position: CAMERA.map(|x| x as f32),
        first: 0,
        count: size as u32,
        gradient_stride: rows.stride as u32,
        chunk_gaussians: capacity as u32,
        planes: planes as u32,
        ..expand_gradients::Push::default()
    };
    gpu.dispatch_over::<expand_gradients::Interface>(&spec, &bind, &push, size);
    for (i, actual) in gpu.read_gaussians(&parameter_gradients, size, coefficients).iter().enumerate() {
        let expected = rows.gradient(i, gaussians[i].mean, sh_degree, coefficients);
        let geometry = |g: &Gaussian| Gaussian { sh: vec![], ..g.clone() };
        assert_eq!(geometry(actual), geometry(&expected), "{i}");
        elementwise("SH", actual.sh.as_flattened(), expected.sh.as_flattened(), 3e-6, 1e-6)
            .expect("SH gradients");
    }
    let pixels: Vec<[f32; 2]> = (0..size).map(|i| [2, 3].map(|plane| rows.row(i, plane)[3])).collect();
    gpu.assert_values(&mean2d, &pixels, "2D means");
}

#[test]
fn expand_gradients_equals_its_twin() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize) {
        check_expanded(&gpu, size, 3, 16, size % 2 == 1);
    }
}

#[test]
fn expand_gradients_of_every_degree() {
    let gpu = Gpu::new();
    for (active, stored) in [(0, 0), (0, 1), (1, 1), (1, 2), (2, 2), (0, 3), (1, 3), (2, 3)] {
        for sh_loops in [false, true] {
            check_expanded(&gpu, 100, active, ((stored + 1) * (stored + 1)) as usize, sh_loops);
        }
    }
}
