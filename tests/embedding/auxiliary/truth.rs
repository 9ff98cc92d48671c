//! Images for picks and motion, and the host's own arithmetic for them.

use crate::scenes::appended;
use crate::stage::*;
use ashsplat::kernels::constants::NOT_PICKED;
use ashsplat_reference::pipeline::{Frame, render, tile_of};
use ashsplat_reference::tiles::alpha_unclamped;
use ashsplat_reference::types::{ALPHA_MAX, ALPHA_MIN, Extent, Gaussian, Style, TRANSMITTANCE_MIN, View};
use glam::{DMat3, DVec3};
use half::f16;

pub const SIZE: [u32; 2] = [96, 70];

pub struct Screens<'a> {
    host: &'a Host,
    pub pictures: [Picture<'a>; 2],
}

pub struct Shot {
    pub pixels: Vec<[f32; 4]>,
    pub picks: Vec<[u32; 4]>,
    pub motions: Vec<[f32; 2]>,
}

impl<'a> Screens<'a> {
    pub fn new(host: &'a Host, context: &Context, size: [u32; 2]) -> Self {
        let new = |purpose, format| Picture::new(host, context, ("beside", purpose), format, size);
        let picks = new(ImageUse::Pick, vk::Format::R32G32B32A32_UINT);
        Self { host, pictures: [picks, new(ImageUse::Motion, vk::Format::R16G16_SFLOAT)] }
    }

    pub fn to(&self, which: usize) -> HostImage<'_> {
        self.pictures[which].unused()
    }

    pub fn pick(&self) -> HostImage<'_> {
        self.to(0)
    }

    pub fn shot(&self, renderer: &mut Renderer, frame: &RecordedFrame<'_>, previous: &Camera) -> Shot {
        let frame = RecordedFrame { pick: Some(self.pick()), motion: Some(self.motion(previous)), ..*frame };
        let pixels = rendered(self.host, renderer, &frame);
        Shot { pixels, picks: self.picks(), motions: self.motions() }
    }

    pub fn motion<'b>(&'b self, previous_camera: &'b Camera) -> MotionTarget<'b> {
        MotionTarget { to: self.to(1), previous_camera, min_weight: 0.0, empty: Some([0.0; 2]) }
    }

    pub fn picks(&self) -> Vec<[u32; 4]> {
        self.pictures[0].texture.read(WRITTEN)
    }

    pub fn motions(&self) -> Vec<[f32; 2]> {
        let halves: Vec<[u16; 2]> = self.pictures[1].texture.read(WRITTEN);
        halves.into_iter().map(|texel| texel.map(|bits| f16::from_bits(bits).to_f32())).collect()
    }
}

pub fn both(wanted: Reservation) -> Reservation {
    Reservation { pick: true, motion: true, ..wanted }
}

/// Round Gaussians without view-dependent colour, so that a pose is easy to apply.
pub fn round(count: usize, seed: u32) -> Gaussians {
    let mut round = cloud(count, seed).with_sh_degree(0);
    for i in 0..count {
        round.quats[i] = [1.0, 0.0, 0.0, 0.0];
        round.log_scales[i] = [round.log_scales[i][0]; 3];
    }
    round
}

/// One round Gaussian at a position in a camera's frame.
pub fn ball(camera: &Camera, at: [f32; 3], [scale, opacity]: [f32; 2]) -> Gaussians {
    let at = camera.camera_from_world.transpose() * (Vec3::from(at) - camera.translation);
    Gaussians {
        sh_degree: 0,
        means: vec![at.to_array()],
        quats: vec![[1.0, 0.0, 0.0, 0.0]],
        log_scales: vec![[scale.ln(); 3]],
        opacity_logits: vec![(opacity / (1.0 - opacity)).ln()],
        sh: vec![[1.0; 3]],
    }
}

/// Round Gaussians, transformed by a pose.
pub fn posed(gaussians: &Gaussians, pose: &Pose) -> Gaussians {
    let mut posed = gaussians.clone();
    for (mean, log_scale) in posed.means.iter_mut().zip(&mut posed.log_scales) {
        *mean = in_world(*mean, pose).as_vec3().to_array();
        *log_scale = log_scale.map(|x| x + pose.scale.ln());
    }
    posed
}

pub fn in_world(mean: [f32; 3], pose: &Pose) -> DVec3 {
    let rotation: DMat3 = pose.world_from_object.as_dmat3();
    rotation * (Vec3::from(mean).as_dvec3() * f64::from(pose.scale)) + pose.translation.as_dvec3()
}

/// Screen position and depth, in float64; pixel centres at the integers.
pub fn seen(point: DVec3, camera: &Camera) -> ([f64; 2], f64) {
    let at = camera.camera_from_world.as_dmat3() * point + camera.translation.as_dvec3();
    let distance = if camera.is_orthographic() { 1.0 } else { at.z };
    let f = |focal: f32, x: f64, center: f32| f64::from(focal) * x / distance + f64::from(center) - 0.5;
    ([f(camera.fx, at.x, camera.cx), f(camera.fy, at.y, camera.cy)], at.z)
}

/// Motion on the screen, in float64: at most the picture's size.
pub fn moved(mean: [f32; 3], [pose, before]: [&Pose; 2], [camera, camera_before]: [&Camera; 2]) -> [f64; 2] {
    let ([x, y], _) = seen(in_world(mean, pose), camera);
    let ([x0, y0], z0) = seen(in_world(mean, before), camera_before);
    let [w, h] = [camera.width, camera.height].map(f64::from);
    if z0 > 0.2 { [(x - x0).clamp(-w, w), (y - y0).clamp(-h, h)] } else { [0.0; 2] }
}

fn view_of(camera: &Camera) -> View {
    let wide = |row: Vec3| row.to_array().map(f64::from);
    let rows = camera.camera_from_world.transpose();
    View {
        camera_from_world: [rows.x_axis, rows.y_axis, rows.z_axis].map(wide),
        translation: wide(camera.translation),
        focal_px: [camera.fx, camera.fy].map(f64::from),
        center_px: [camera.cx, camera.cy].map(f64::from),
        size_px: [camera.width, camera.height],
        background: [0.0; 3],
        sh_degree: 0,
        antialias: false,
        antialias_detached: false,
        filter_3d: 0.0,
        symmetric_limit: false,
        extent: Extent::Exact,
        drawn: Style { orthographic: camera.is_orthographic(), ..Style::AS_THEY_ARE },
    }
}

fn twins_of(gaussians: &Gaussians) -> Vec<Gaussian> {
    let twin = |i: usize| Gaussian {
        mean: gaussians.means[i].map(f64::from),
        quat: gaussians.quats[i].map(f64::from),
        log_scale: gaussians.log_scales[i].map(f64::from),
        opacity_logit: gaussians.opacity_logits[i].into(),
        sh: vec![gaussians.sh_of(i)[0].map(f64::from)],
    };
    (0..gaussians.len()).map(twin).collect()
}

/// Reference for a frame of round Gaussians: their indices and motions.
pub struct Truth {
    view: View,
    frame: Frame,
    /// Index in its scene, scene and motion of each Gaussian of the frame.
    pub who: Vec<(u32, u32, [f64; 2])>,
    pub limit: f64,
}

impl Truth {
    pub fn new(drawn: &[(u32, &Gaussians, Pose, Pose)], cameras: [&Camera; 2]) -> Self {
        let mut all = Gaussians::default();
        let mut who = Vec::new();
        for (scene, gaussians, pose, before) in drawn {
            all = appended(&all, &posed(gaussians, pose));
            let motion = |&mean: &[f32; 3]| moved(mean, [pose, before], cameras);
            who.extend((0..).zip(&gaussians.means).map(|(i, mean)| (i, *scene, motion(mean))));
        }
        let view = view_of(cameras[0]);
        Self { frame: render(&twins_of(&all), &view), view, who, limit: f64::INFINITY }
    }

    /// Weights blended at a pixel, as (Gaussian, weight, depth); none beyond the depth `limit`.
    fn weights(&self, pixel: [u32; 2]) -> Vec<(usize, f64, f64)> {
        let (mut weights, mut transmittance) = (Vec::new(), 1.0);
        for &gaussian in &self.frame.lists[tile_of(&self.view, pixel)] {
            let splat = self.frame.splats[gaussian as usize].as_ref().expect("listed");
            let alpha = alpha_unclamped(splat, pixel).map_or(0.0, |alpha| alpha.min(ALPHA_MAX));
            let blended = alpha >= ALPHA_MIN;
            if splat.depth > self.limit || blended && transmittance * (1.0 - alpha) < TRANSMITTANCE_MIN {
                break;
            }
            if blended {
                weights.push((gaussian as usize, alpha * transmittance, splat.depth));
                transmittance *= 1.0 - alpha;
            }
        }
        weights
    }

    /// Compares all pixels. Returns the number of covered pixels. At most one of a hundred may differ by rounding.
    pub fn check(&self, shot: &Shot, size: [u32; 2]) -> usize {
        let [covered, odd] = self.compare(shot, size);
        assert!(odd <= shot.picks.len() / 100, "{odd} pixels differ");
        covered
    }

    fn compare(&self, shot: &Shot, [width, height]: [u32; 2]) -> [usize; 2] {
        let (mut covered, mut odd) = (0, 0);
        for index in 0..width * height {
            let weights = self.weights([index % width, index / width]);
            let ([gaussian, scene, depth, weight], motion) =
                (shot.picks[index as usize], shot.motions[index as usize]);
            let largest = weights.iter().map(|(_, weight, _)| *weight).fold(0.0, f64::max);
            let picked = weights.iter().find(|(own, weight, _)| {
                let (index, place, _) = self.who[*own];
                (index, place) == (gaussian, scene) && *weight > largest - 1e-4
            });
            let nothing = [NOT_PICKED, NOT_PICKED, 0, 0] == shot.picks[index as usize];
            let is_picked = match picked {
                Some((_, own, z)) => {
                    let (actual, z_actual) =
                        (f64::from(f32::from_bits(weight)), f64::from(f32::from_bits(depth)));
                    (actual - own).abs() < 1e-4 && (z_actual - z).abs() < 1e-5 * z
                }
                None => nothing && largest < 1e-2,
            };
            let sum: f64 = weights.iter().map(|(_, weight, _)| weight).sum();
            let mean = [0, 1].map(|axis| {
                let weighted = weights.iter().map(|(own, weight, _)| weight * self.who[*own].2[axis]);
                if sum > 0.0 { weighted.sum::<f64>() / sum } else { 0.0 }
            });
            let close =
                |axis: usize| (f64::from(motion[axis]) - mean[axis]).abs() < 2e-3 * (1.0 + mean[axis].abs());
            covered += usize::from(!weights.is_empty());
            odd += usize::from(!(is_picked && close(0) && close(1)));
        }
        [covered, odd]
    }
}

pub fn shifted(camera: &Camera, by: [f32; 3]) -> Camera {
    // Everything lies `by` nearer along the axes of a camera that moved by `by`.
    Camera { translation: camera.translation - Vec3::from(by), ..*camera }
}

pub fn turned(camera: &Camera, angle: f32) -> Camera {
    let turn = Mat3::from_rotation_y(angle);
    Camera {
        camera_from_world: turn * camera.camera_from_world,
        translation: turn * camera.translation,
        ..*camera
    }
}
