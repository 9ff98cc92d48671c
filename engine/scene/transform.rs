//! Moves, turns, scales and thins out sets of Gaussians.

use glam::{DQuat, DVec3, EulerRot};

use super::gaussians::{Gaussians, sh_coefficients};
use super::points::Bounds;
use super::sh::{ShRotation, mirror_signs};
use super::world_frame::WorldFrame;

/// A similarity: `x_new = scale * (rotation * x) + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// Rotation of unit length; applied first.
    pub rotation: DQuat,
    /// Factor of all lengths, positive.
    pub scale: f64,
    /// Translation, world units; applied last.
    pub translation: DVec3,
}

impl Default for Similarity {
    fn default() -> Self {
        Self { rotation: DQuat::IDENTITY, scale: 1.0, translation: DVec3::ZERO }
    }
}

impl Similarity {
    /// Rotates about the x, then the y, then the z axis by angles in degrees, then scales, then translates.
    pub fn of_angles(degrees: DVec3, scale: f64, translation: DVec3) -> Self {
        let [x, y, z] = degrees.to_array().map(f64::to_radians);
        // The last rotation is applied first.
        Self { rotation: DQuat::from_euler(EulerRot::ZYX, z, y, x), scale, translation }
    }

    /// Converts the world coordinates of one frame to those of another.
    pub fn between(from: &WorldFrame, to: &WorldFrame) -> Self {
        Self {
            rotation: DQuat::IDENTITY,
            scale: from.unit / to.unit,
            translation: (from.origin - to.origin) / to.unit,
        }
    }

    /// Returns the transformed point.
    pub fn apply(&self, point: DVec3) -> DVec3 {
        self.scale * (self.rotation * point) + self.translation
    }

    /// Returns the composition: first `first`, then `self`.
    pub fn after(&self, first: &Self) -> Self {
        Self {
            rotation: (self.rotation * first.rotation).normalize(),
            scale: self.scale * first.scale,
            translation: self.apply(first.translation),
        }
    }
}

impl Gaussians {
    /// Transforms means, shapes and SH coefficients.
    pub fn transform(&mut self, similarity: &Similarity) {
        if *similarity == Similarity::default() {
            return;
        }
        for mean in &mut self.means {
            *mean = similarity.apply(DVec3::from_array(mean.map(f64::from))).as_vec3().to_array();
        }
        if similarity.scale != 1.0 {
            let log_scale = similarity.scale.ln() as f32;
            self.log_scales.as_flattened_mut().iter_mut().for_each(|s| *s += log_scale);
        }
        if similarity.rotation == DQuat::IDENTITY {
            return;
        }
        for quat in &mut self.quats {
            let [w, x, y, z] = quat.map(f64::from);
            let turned = similarity.rotation * DQuat::from_xyzw(x, y, z, w);
            *quat = [turned.w, turned.x, turned.y, turned.z].map(|v| v as f32);
        }
        if self.sh_degree > 0 {
            let rotation = ShRotation::new(glam::DMat3::from_quat(similarity.rotation));
            let coefficients = sh_coefficients(self.sh_degree);
            self.sh.chunks_exact_mut(coefficients).for_each(|sh| rotation.apply(sh));
        }
    }

    /// Mirrors the axes with `true`. Only signs change, so a second call restores the same bits.
    pub fn mirror(&mut self, axes: [bool; 3]) {
        if axes == [false; 3] {
            return;
        }
        let signs = axes.map(|mirrored| if mirrored { -1.0 } else { 1.0f32 });
        for mean in &mut self.means {
            *mean = std::array::from_fn(|axis| signs[axis] * mean[axis]);
        }
        // M R M, with M the mirror, is the rotation of this quaternion.
        let quat_signs = [1.0, signs[1] * signs[2], signs[0] * signs[2], signs[0] * signs[1]];
        for quat in &mut self.quats {
            *quat = std::array::from_fn(|i| quat_signs[i] * quat[i]);
        }
        let sh_signs = mirror_signs(signs.map(f64::from));
        for sh in self.sh.chunks_exact_mut(sh_coefficients(self.sh_degree)) {
            for (coefficient, sign) in sh.iter_mut().zip(sh_signs) {
                *coefficient = coefficient.map(|v| v * sign);
            }
        }
    }

    /// Keeps the Gaussians for which `keep` is true, in their order.
    pub fn retain(&mut self, keep: impl Fn(&Self, usize) -> bool) {
        let kept: Vec<usize> = (0..self.len()).filter(|&index| keep(self, index)).collect();
        if kept.len() < self.len() {
            *self = self.select(&kept);
        }
    }

    /// Returns the Gaussians with these indices, in this order.
    pub fn select(&self, indices: &[usize]) -> Self {
        let mut selected = Self::with_capacity(self.sh_degree, indices.len());
        indices.iter().for_each(|&index| selected.push_from(self, index));
        selected
    }

    /// Appends one Gaussian of another set of the same SH degree.
    pub fn push_from(&mut self, other: &Self, index: usize) {
        self.means.push(other.means[index]);
        self.quats.push(other.quats[index]);
        self.log_scales.push(other.log_scales[index]);
        self.opacity_logits.push(other.opacity_logits[index]);
        self.sh.extend_from_slice(other.sh_of(index));
    }

    /// Appends another set of the same SH degree.
    pub fn append(&mut self, other: &Self) {
        debug_assert_eq!(self.sh_degree, other.sh_degree);
        self.means.extend_from_slice(&other.means);
        self.quats.extend_from_slice(&other.quats);
        self.log_scales.extend_from_slice(&other.log_scales);
        self.opacity_logits.extend_from_slice(&other.opacity_logits);
        self.sh.extend_from_slice(&other.sh);
    }

    /// Opacity after the sigmoid, 0 to 1.
    pub fn opacity(&self, index: usize) -> f32 {
        1.0 / (1.0 + libm::expf(-self.opacity_logits[index]))
    }

    /// Smallest box around the means; None without Gaussians.
    pub fn bounds(&self) -> Option<Bounds> {
        Bounds::of(self.means.iter().map(|&mean| glam::Vec3::from_array(mean)))
    }
}
