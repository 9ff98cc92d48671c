//! Lenses against the vectors: positions on the host, positions, covariances and gradients of Gaussians and pictures on the device.

use super::Outcome;
use super::rendering::SINGLE;
use super::sets::{gaussians, pixel_gradients};
use crate::common::engine;
use crate::common::prelude::*;
use crate::golden::npz::{Npz, rows};
use ashsplat::kernels::backward::project_backward;
use ashsplat::kernels::blocks::CameraBlock;
use ashsplat::kernels::constants as c;
use ashsplat::kernels::forward::project;
use ashsplat::scene::{JacobianLimit, PhotoLens, Projection, Readout, Shutter};
use glam::{DMat3, DQuat, DVec2, DVec3, Mat3, dmat2};
use std::path::Path;

/// Opacity of Gaussians in sets that have none.
const LOGIT: f64 = 2.0;

fn lens_camera(npz: &Npz) -> Camera {
    let [width, height] = [0, 1].map(|axis| npz.values("size_wh")[axis] as u32);
    let f = |x: f64| x as f32;
    let [x, y, z] = rows(&npz.values("cam_R")[..9]).try_into().expect("3×3");
    let [x, y, z] = [x, y, z].map(|row: [f64; 3]| Vec3::from_array(row.map(f)));
    let rotation = Mat3::from_cols(x, y, z).transpose();
    let translation = Vec3::from_array(npz.rows::<3>("cam_t")[0].map(f));
    let any = Camera::with_pose(rotation, translation, PhotoLens::panorama(width, height).intrinsics());
    let camera = any.with_colmap_lens(npz.scalar("model") as u32, npz.values("params"));
    let mut camera = camera.expect("a model of COLMAP");
    if npz.has("shutter") {
        let pose = |row: usize| {
            let [w, x, y, z] = npz.rows::<4>("shutter_q")[row];
            let rotation = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
            (rotation, -(rotation * DVec3::from(npz.rows::<3>("shutter_c")[row])))
        };
        let readout = Readout::ALL[npz.scalar("shutter") as usize];
        let ((rotation, translation), shutter) = Shutter::between(pose(0), pose(1), readout);
        camera.camera_from_world = rotation.as_mat3();
        camera.translation = translation.as_vec3();
        camera.shutter = Some(shutter);
    }
    camera
}

/// Wraps differences of x around a panorama.
fn wrapped(camera: &Camera, actual: f64, expected: f64) -> f64 {
    let around = f64::from(camera.width);
    match camera.projection {
        Projection::Equirectangular => {
            expected + (actual - expected + 0.5 * around).rem_euclid(around) - 0.5 * around
        }
        _ => actual,
    }
}

pub fn of_host(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let camera = lens_camera(&npz);
    camera.check().expect("a camera");
    let upright = Camera { camera_from_world: Mat3::IDENTITY, translation: Vec3::ZERO, ..camera };
    let ray = upright.photo_lens().rays();
    let valid = npz.flags("valid");
    let (points, expected) = (npz.rows::<3>("points"), npz.rows::<2>("xy"));
    for (index, (point, expected)) in
        points.iter().zip(expected).enumerate().filter(|(index, _)| valid[*index])
    {
        let back = ray(DVec2::from(expected) + 0.5).expect("a direction");
        // The tangential terms of lens_04_opencv fold the picture before point 54, whose place has another direction nearby.
        let off = back.angle_between(DVec3::from(*point));
        if off > 0.05 {
            return Err(format!("the ray of point {index} is off by {off} radians").into());
        }
        for (what, direction) in [("point", DVec3::from(*point)), ("ray of point", back)] {
            let (x, y, _) = upright.project(direction.as_vec3());
            let (x, y) = (wrapped(&camera, f64::from(x) - 0.5, expected[0]), f64::from(y) - 0.5);
            let tolerance = 4e-6 * (50.0 + x.abs().max(y.abs()));
            elementwise(&format!("{what} {index}"), &[x, y], &expected, tolerance, 0.0)?;
        }
    }
    if let Some((limits, _)) =
        camera.lens_words().filter(|_| npz.scalar("r_max") > 0.0 || npz.scalar("r_limit") > 0.0)
    {
        elementwise("r_max", &[limits[0].into()], &[npz.scalar("r_max")], 0.0, 1e-5)?;
        let held = npz.scalar("r_limit");
        if held > 0.0 {
            elementwise("r_limit", &[limits[1].into()], &[held], 0.0, 1e-5)?;
        }
    }
    Ok(())
}

/// The camera's block with the words of its lens.
fn block(camera: &Camera) -> Vec<u32> {
    let rows = camera.camera_from_world.transpose();
    let no_lens = (camera.jacobian_limits(JacobianLimit::Edge), [0.0; 9]);
    let (limits, words) = camera.lens_words().unwrap_or(no_lens);
    let values = CameraBlock {
        camera_row_x: rows.x_axis.to_array(),
        camera_row_y: rows.y_axis.to_array(),
        camera_row_z: rows.z_axis.to_array(),
        camera_translation: camera.translation.to_array(),
        focal_px: [camera.fx, camera.fy],
        center_px: [camera.cx - 0.5, camera.cy - 0.5],
        jacobian_limits: limits,
        image_width: camera.width,
        image_height: camera.height,
        whole_width: camera.width,
        whole_height: camera.height,
        inverse_scale_squared: 1.0,
        shape_scale: 1.0,
        shape_dilation_px2: c::DILATION_PX2,
        ..CameraBlock::default()
    };
    [bytemuck::cast_slice(bytemuck::bytes_of(&values)), bytemuck::cast_slice::<_, u32>(&words)].concat()
}

/// True for a Gaussian that ashsplat projects by the Jacobian, but the vectors by the unscented transform: one of its points
/// lies far outside a planar lens's picture. In training such spreads cover pictures (tools/strategies.md).
fn is_far(camera: &Camera, gaussian: &Gaussian) -> bool {
    let Some(([_, held, far, _], _)) = camera.lens_words() else { return false };
    let lens = PhotoLens { focal_px: DVec2::ONE, center_px: DVec2::ZERO, ..camera.photo_lens() };
    let turn = camera.camera_from_world.as_dmat3();
    let [w, x, y, z] = gaussian.quat;
    let axes = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
    let mean = DVec3::from(gaussian.mean);
    let is_far = |(sign, k): (f64, usize)| {
        let step = sign * 3f64.sqrt() * gaussian.log_scale[k].exp() * axes.col(k);
        let at = turn * (mean + step) + camera.translation.as_dvec3();
        let is_held = at.truncate().length() > f64::from(held) * at.z;
        is_held && lens.position(at).is_some_and(|place| place.length() > f64::from(far))
    };
    !camera.projection.orders_by_distance()
        && far > 0.0
        && [-1.0, 1.0].into_iter().flat_map(|sign| (0..3).map(move |k| (sign, k))).any(is_far)
}

/// Prefix of the method by which this project draws a camera's Gaussians: the Jacobian or the unscented transform.
fn method_of(camera: &Camera) -> &'static str {
    if camera.projection == Projection::Perspective { "j" } else { "u" }
}

/// The gradient of the pose halfway, for a motion that stays the same in the camera's space. With a rolling shutter the vectors
/// have those of the poses at the first and the last row.
fn pose_gradient(npz: &Npz, camera: &Camera) -> Vec<f64> {
    let all = npz.rows::<6>(&format!("{}_d_pose", method_of(camera)));
    let Some(Shutter { turn, shift, .. }) = camera.shutter else { return all[0].to_vec() };
    let (mut moved, mut turned) = (DVec3::ZERO, DVec3::ZERO);
    for ([a, b, c, d, e, f], time) in all.into_iter().zip([-0.5, 0.5]) {
        let back = DQuat::from_scaled_axis(-time * turn.as_dvec3());
        let (nu, omega) = (back * DVec3::new(a, b, c), back * DVec3::new(d, e, f));
        moved += nu;
        turned += omega + (time * shift.as_dvec3()).cross(nu);
    }
    [moved.to_array(), turned.to_array()].concat()
}

pub fn of_device(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let camera = lens_camera(&npz);
    if !camera.has_lens() {
        return Ok(());
    }
    let [means, log_scales] = ["means", "log_scales"].map(|name| npz.rows::<3>(name));
    let quats = npz.rows::<4>("quats");
    let shown: Vec<usize> = (0..means.len()).filter(|&i| npz.flags("visible")[i]).collect();
    let gaussian = |&i: &usize| Gaussian {
        mean: means[i],
        quat: quats[i],
        log_scale: log_scales[i],
        opacity_logit: LOGIT,
        sh: vec![[0.0; 3]],
    };
    let scene: Vec<Gaussian> = shown.iter().map(gaussian).collect();
    let gpu = Gpu::new();
    let (count, capacity) = (scene.len(), plane_capacity(scene.len()));
    let parameters = gpu.buffer("parameters", &pack(&scene, capacity));
    let list: Vec<u32> = (0..count as u32).collect();
    let [visible_list, visible_ranges] = [
        gpu.buffer("visible_list", &list),
        gpu.buffer("visible_ranges", &[[0_u32; 4], [0, count as u32, 0, 0]]),
    ];
    let camera_block = gpu.buffer("camera_block", &block(&camera));
    let outputs = ["mean2d_extent", "conic_opacity", "color_inverse_depth", "footprints"]
        .map(|name| gpu.untouched::<[f32; 4]>(name, count));
    let [mean2d_extent, conic_opacity, color_inverse_depth, footprints] = &outputs;
    let depth_keys = gpu.untouched::<u32>("depth_keys", count);
    let spec = project::Spec {
        workgroup_size: gpu.workgroup(64),
        sh_degree: 0,
        projection: camera.projection as u32,
        lenses: true,
        shutter: camera.shutter.is_some(),
        ..project::Spec::default()
    };
    let bind = project::Bind {
        parameters: &parameters,
        visible_ranges: &visible_ranges,
        visible_list: &visible_list,
        mean2d_extent,
        conic_opacity,
        color_inverse_depth,
        depth_keys: &depth_keys,
        footprints,
        tile_lists: &gpu.untouched::<[u32; 2]>("tile_lists", count),
        selection: &visible_list,
        camera_block: &camera_block,
    };
    let [shutter_turn, shutter_shift, shutter_rows] = camera.shutter_words();
    let push = project::Push {
        first: 0,
        chunk_gaussians: capacity as u32,
        extent: c::EXTENT_EXACT,
        antialias: 0,
        splat_stride: 1,
        first_of_scene: 0,
        shutter_turn,
        shutter_shift,
        shutter_rows,
    };
    gpu.dispatch_over::<project::Interface>(&spec, &bind, &push, count);
    let (places, conics) =
        (gpu.read::<[f32; 4]>(mean2d_extent, count), gpu.read::<[f32; 4]>(conic_opacity, count));
    let depth_keys = gpu.read::<u32>(&depth_keys, count);
    let of = |name: &str| npz.rows::<3>(name);
    let far: Vec<bool> = (0..means.len()).map(|i| is_far(&camera, &gaussian(&i))).collect();
    let own = method_of(&camera);
    let method = |i: usize, name: &str| format!("{}_{name}", if far[i] { "j" } else { own });
    if camera.shutter.is_some() {
        for &i in &shown {
            let expected = npz.rows::<2>("j_xy")[i];
            let (x, y, _) = camera.project(Vec3::from_array(means[i].map(|x| x as f32)));
            let actual = [wrapped(&camera, f64::from(x) - 0.5, expected[0]), f64::from(y) - 0.5];
            let tolerance = 2e-4 * (1.0 + expected[0].abs().max(expected[1].abs()) / 100.0);
            elementwise(&format!("host's position {i}"), &actual, &expected, tolerance, 0.0)?;
        }
    }
    for (place, &i) in shown.iter().enumerate() {
        let [x, y, ..] = places[place].map(f64::from);
        let expected = npz.rows::<2>(&method(i, "xy"))[i];
        let tolerance = 2e-4 * (1.0 + expected[0].abs().max(expected[1].abs()) / 100.0);
        let actual = [wrapped(&camera, x, expected[0]), y];
        elementwise(&format!("position {i}"), &actual, &expected, tolerance, 0.0)?;
        let [a, b, c, _] = conics[place].map(f64::from);
        let determinant = a * c - b * b;
        let covariance = [c, -b, a].map(|x| x / determinant);
        relative(&format!("covariance {i}"), &covariance, &of(&method(i, "cov2d"))[i], 1e-4)?;
        elementwise(
            &format!("depth {i}"),
            &[f64::from(depth_of_key(depth_keys[place]))],
            &[npz.values("depth")[i]],
            0.0,
            1e-6,
        )?;
    }

    // Sums of instances whose gradients are those of the set's weights of positions and covariances.
    let mut sums = [vec![], vec![]];
    for (place, &i) in shown.iter().enumerate() {
        let [xx, xy, yy] = of(&method(i, "cov2d"))[i];
        let ([wx, wy], [wa, wb, wc]) = (npz.rows::<2>("w_xy")[i], of("w_cov")[i]);
        let covariance = dmat2(glam::dvec2(xx, xy), glam::dvec2(xy, yy));
        let weights = dmat2(glam::dvec2(wa, 0.5 * wb), glam::dvec2(0.5 * wb, wc));
        let d_conic = -(covariance * weights * covariance);
        let [a, b, c, _] = conics[place].map(f64::from);
        let determinant = a * c - b * b;
        let moments = [-(c * wx - b * wy) / determinant, -(a * wy - b * wx) / determinant];
        let single = |x: f64| x as f32;
        sums[0].push([0.0, moments[0], moments[1], -2.0 * d_conic.x_axis.x].map(single));
        sums[1].push([-2.0 * d_conic.x_axis.y, -2.0 * d_conic.y_axis.y, 0.0, 0.0].map(single));
    }
    let one: Vec<[u32; 4]> = vec![[0, 0, 0, 1]; count];
    let last = gpu.buffer("instance_gradients_c", &vec![[0.0_f32; 2]; count]);
    let gradients = gpu.untouched::<[f32; 4]>("gradients", c::GRADIENT_PLANES as usize * count);
    let statistics = gpu.buffer("statistics", &vec![[0.0_f32; 2]; count]);
    let (first_lens_sum, workgroups) = (2 * (count + 1), count.div_ceil(gpu.workgroup(64) as usize));
    let pose_sums = gpu.zeros::<[f32; 3]>("pose_sums", first_lens_sum + 6 * workgroups);
    let spec = project_backward::Spec {
        workgroup_size: gpu.workgroup(64),
        subgroup_size: gpu.subgroup(),
        sh_degree: 0,
        pose_gradient: true,
        lens_gradient: true,
        projection: camera.projection as u32,
        lenses: true,
        shutter: camera.shutter.is_some(),
        ..project_backward::Spec::default()
    };
    let bind = project_backward::Bind {
        parameters: &parameters,
        state: &gpu.frame_state(&[(c::STATE_VISIBLE, count as u32)]),
        visible_ranges: &visible_ranges,
        visible_list: &visible_list,
        footprints: &gpu.buffer("footprints", &one),
        first_instances: &gpu.buffer("first_instances", &list),
        conic_opacity,
        instance_gradients_a: &gpu.buffer("instance_gradients_a", &sums[0]),
        instance_gradients_b: &gpu.buffer("instance_gradients_b", &sums[1]),
        instance_gradients_c: &last,
        instance_gradients_d: &last,
        gradients: &gradients,
        statistics: &statistics,
        pose_sums: &pose_sums,
        camera_block: &camera_block,
    };
    let push = project_backward::Push {
        first: 0,
        chunk_gaussians: capacity as u32,
        antialias: 0,
        splat_stride: 1,
        gradient_stride: count as u32,
        accumulate: 0,
        first_lens_sum: first_lens_sum as u32,
        shutter_turn,
        shutter_shift,
        shutter_rows,
    };
    gpu.dispatch_over::<project_backward::Interface>(&spec, &bind, &push, count);
    let planes = gpu.read::<[f32; 4]>(&gradients, c::GRADIENT_PLANES as usize * count);
    let plane = |number: u32, words: usize| {
        let own = &planes[number as usize * count..][..count];
        own.iter().flat_map(|row| row[..words].iter().map(|&x| f64::from(x))).collect::<Vec<f64>>()
    };
    let expected = |name: &str, words: usize| {
        let own = |&i: &usize| npz.values(&method(i, name))[words * i..][..words].to_vec();
        shown.iter().flat_map(own).collect::<Vec<f64>>()
    };
    let compared = [
        ("dx_means", c::GRADIENT_MEAN_OPACITY, 3, SINGLE.gradient),
        ("dx_quats", c::GRADIENT_QUAT, 4, SINGLE.quats),
        ("dx_log_scales", c::GRADIENT_LOG_SCALE, 3, SINGLE.gradient),
    ];
    for (name, number, words, tolerance) in compared {
        gradient(name, &plane(number, words), &expected(name, words), &vec![false; count], tolerance)?;
    }
    let sums = gpu.read::<[f32; 3]>(&pose_sums, first_lens_sum + 6 * workgroups);
    let added = |rows: &[f32], width: usize| -> Vec<f64> {
        (0..width).map(|k| rows.iter().skip(k).step_by(width).map(|&x| f64::from(x)).sum()).collect()
    };
    let (poses, lenses) = sums.as_flattened().split_at(3 * first_lens_sum);
    if !far.contains(&true) {
        relative("pose", &added(poses, 6), &pose_gradient(&npz, &camera), 2e-4)?;
        compare_lens(&npz, &camera, &added(lenses, 18))?;
    }
    Ok(())
}

fn has_parameters(camera: &Camera) -> bool {
    camera.projection.is_lens() && camera.projection != Projection::Equirectangular
}

/// Compares a gradient of the lens with that of the model's parameters. `words`: see [`Camera::lens_gradient`].
fn compare_lens(npz: &Npz, camera: &Camera, words: &[f64]) -> Outcome {
    if !has_parameters(camera) {
        return Ok(());
    }
    let gradient = camera.lens_gradient(&std::array::from_fn(|k| words[k] as f32));
    compare_lens_gradient(npz, camera, &gradient)
}

fn compare_lens_gradient(npz: &Npz, camera: &Camera, gradient: &[f64; 16]) -> Outcome {
    let parameters = npz.values("params");
    let all =
        |camera: &Camera| [&[camera.fx, camera.fy, camera.cx, camera.cy][..], &camera.coefficients].concat();
    // The camera's parameters depend linearly on the model's.
    let by_parameter = |index: usize| -> f64 {
        let mut moved = parameters.to_vec();
        moved[index] += 1.0;
        let moved = camera.with_colmap_lens(npz.scalar("model") as u32, &moved).expect("a model of COLMAP");
        let change =
            all(&moved).into_iter().zip(all(camera)).map(|(a, b)| (f64::from(a) - f64::from(b)).round());
        change.zip(gradient).map(|(change, gradient)| change * gradient).sum()
    };
    let own: Vec<f64> = (0..parameters.len()).map(by_parameter).collect();
    relative("u_d_lens", &own, npz.values("u_d_lens"), 2e-4)?;
    Ok(())
}

pub fn picture_of_device(path: &Path) -> Outcome {
    let npz = Npz::read(path);
    let camera = lens_camera(&npz);
    let of = |name: &str| npz.values(&format!("{}_{name}", method_of(&camera)));
    let settings = RenderSettings {
        sh_degree: Some(npz.scalar("deg") as u32),
        background: npz.rows::<3>("bg")[0].map(|x| x as f32),
        antialias: npz.scalar("antialias") != 0.0,
        ..RenderSettings::default()
    };
    let mut renderer = renderer();
    renderer.upload(&engine::gaussians(&gaussians(&npz, "")))?;
    let frame = renderer.render(&camera, &settings)?;
    let unstable = npz.flags("pix_unstable");
    let transmittance: Vec<f64> = frame.transmittance.iter().map(|&t| t.into()).collect();
    pixels("image", &widen(&frame.color), of("image"), &unstable, SINGLE.image)?;
    pixels("transmittance", &transmittance, of("final_T"), &unstable, SINGLE.transmittance)?;
    let weights: Vec<[f32; 3]> =
        pixel_gradients(npz.rows::<3>("G")).iter().map(|pixel| pixel.color.map(|x| x as f32)).collect();
    let derivatives = renderer.gradients_with_pose(&camera, &settings, &weights, None)?;
    drop(renderer);
    let none = vec![false; derivatives.mean2d_px.len()];
    let fields = ["means", "quats", "log_scales", "opacity_logits", "sh", "xy_pix"];
    for (name, own) in fields.iter().zip(engine::derivatives(&derivatives)) {
        let own: Vec<f64> = own.iter().map(|&x| x.into()).collect();
        let tolerance = if *name == "quats" { SINGLE.quats } else { SINGLE.gradient };
        gradient(name, &own, of(&format!("dx_{name}")), &none, tolerance)?;
    }
    let pose = derivatives.pose.expect("the pose's gradient").map(f64::from);
    relative("pose", &pose, &pose_gradient(&npz, &camera), 2e-4)?;
    if has_parameters(&camera) {
        compare_lens_gradient(&npz, &camera, &derivatives.lens.expect("the lens's gradient"))?;
    }
    assert_silent(context());
    Ok(())
}
