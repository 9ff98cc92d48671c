//! A frame's outputs besides the picture, in C.

use super::foreign::used;
use super::structs::{read, read_if};
use super::{AshsplatCamera, AshsplatHostImage};
use ashsplat::scene::{Camera, Pose};
use ashsplat::{MotionTarget, PickTarget, Result};
use glam::{Mat3, Vec3};

/// A pose in the world: x_world = scale rotation x_object + translation.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatPose {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// A rotation, row by row.
    pub world_from_object: [f32; 9],
    /// World units.
    pub translation: [f32; 3],
    /// World units per unit of the scene, the same in all directions: 1 for no scaling.
    pub scale: f32,
}

impl AshsplatPose {
    pub(super) fn pose(&self) -> Pose {
        Pose {
            world_from_object: Mat3::from_cols_array(&self.world_from_object).transpose(),
            translation: Vec3::from(self.translation),
            scale: self.scale,
        }
    }
}

/// An image of what is picked at each pixel: the Gaussian with the largest blending weight alpha T, the nearest of equal ones.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct AshsplatPickTarget {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// A storage image of format R32G32B32A32_UINT. A texel is the index of the Gaussian in its scene, the index of the scene in
    /// AshsplatRecordedFrame.scenes, the bits of the float of its depth z (world units), and the bits of the float of its weight.
    /// Where nothing is blended, the first two are UINT32_MAX, the others 0. Its image is never NULL: AshsplatRecordedFrame.pick
    /// is NULL in a frame without picks.
    pub to: AshsplatHostImage,
}

/// An image of motion: for each pixel the mean motion on the screen of what is blended there, from the frame before to this one,
/// weighted as in blending. A Gaussian moves as its mean does, at most by the picture's width and height. It counts with a motion of
/// 0 where its earlier place is unknown: where its mean did not lie in front of the earlier camera (z above 0.2), or lay too far
/// away for a float. How updates move Gaussians is not known.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct AshsplatMotionTarget {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// A pixel is empty if the splats' weights sum to less.
    pub min_weight: f32,
    /// The motion of empty pixels, pixels.
    pub empty: [f32; 2],
    /// Whether empty pixels keep what is in the image, in place of `empty`.
    pub keeps_empty: bool,
    /// The camera of the frame before, of the same width and height. The motion counts from its own principal point to that of
    /// the frame's camera. Poses before are in AshsplatPlaced.
    pub previous_camera: *const AshsplatCamera,
    /// A storage image of format R16G16_SFLOAT, with MUTABLE_FORMAT (AshsplatForeignImage.flags): the place now less the place
    /// before, in pixels, x right, y down. What is at pixel p now was at p - motion. Its image is never NULL:
    /// AshsplatRecordedFrame.motion is NULL in a frame without motion.
    pub to: AshsplatHostImage,
}

/// Target of picking, if the host gives one.
///
/// # Safety
/// `target` is NULL or alive with its image.
pub(super) unsafe fn pick<'a>(target: *const AshsplatPickTarget) -> Result<Option<PickTarget<'a>>> {
    // SAFETY: as promised.
    let Some(target) = (unsafe { read_if(target, "pick")? }) else { return Ok(None) };
    // SAFETY: as promised.
    Ok(Some(PickTarget { to: unsafe { used(&target.to, "pick.to.image")? } }))
}

/// A target of motion, and the previous frame's camera.
pub(super) struct Motion {
    target: AshsplatMotionTarget,
    previous_camera: Camera,
}

impl Motion {
    /// Reads the motion target, if the host gives one.
    ///
    /// # Safety
    /// `target` is NULL or alive with its camera.
    pub unsafe fn read(target: *const AshsplatMotionTarget) -> Result<Option<Self>> {
        // SAFETY: as promised.
        let Some(target) = (unsafe { read_if(target, "motion")? }) else { return Ok(None) };
        let name = "motion.previous_camera";
        // SAFETY: as promised.
        let previous_camera = unsafe { read(target.previous_camera, name)? }.known_as(name)?;
        Ok(Some(Self { target, previous_camera }))
    }

    /// Converts to the engine's target.
    ///
    /// # Safety
    /// Its image is NULL or alive.
    pub unsafe fn target(&self) -> Result<MotionTarget<'_>> {
        let AshsplatMotionTarget { to, min_weight, empty, keeps_empty, .. } = self.target;
        // SAFETY: as promised.
        let to = unsafe { used(&to, "motion.to.image")? };
        let empty = (!keeps_empty).then_some(empty);
        Ok(MotionTarget { to, previous_camera: &self.previous_camera, min_weight, empty })
    }
}
