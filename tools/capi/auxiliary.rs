//! What a frame leaves beside the picture, in C.

use super::{AshsplatCamera, AshsplatImage, AshsplatImageState, borrowed};
use ashsplat::scene::{Camera, Pose};
use ashsplat::{HostImage, MotionTarget, PickTarget, Result};
use glam::{Mat3, Vec3};

/// A pose in the world: x_world = scale rotation x_object + translation.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatPose {
    /// A rotation, row by row.
    pub world_from_object: [f32; 9],
    /// World units.
    pub translation: [f32; 3],
    /// World units per unit of the scene, the same in all directions: 1 for no scaling.
    pub scale: f32,
}

impl AshsplatPose {
    /// The same as the library has it.
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
    /// A storage image of format R32G32B32A32_UINT. A texel is the index of the Gaussian in its scene, the index of the scene in
    /// AshsplatFrame.scenes, the bits of the float of its depth z (world units), and the bits of the float of its weight. Where
    /// nothing is blended: UINT32_MAX twice, then 0 twice.
    pub image: *const AshsplatImage,
    /// The host's use of the image before the frame.
    pub from: AshsplatImageState,
    /// Texel that receives the frame's pixel (0, 0).
    pub offset: [u32; 2],
}

/// An image of motion: of what is blended at each pixel, the mean of its motion on the screen from the frame before to this
/// one, by the blending's weights. A Gaussian moves as its mean does. How updates move Gaussians is not known.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct AshsplatMotionTarget {
    /// A storage image of format R16G16_SFLOAT, with MUTABLE_FORMAT (AshsplatHostImage.flags): the place now less the place
    /// before, in pixels, x right, y down. What is at pixel p now was at p - motion.
    pub image: *const AshsplatImage,
    /// The host's use of the image before the frame.
    pub from: AshsplatImageState,
    /// Texel that receives the frame's pixel (0, 0).
    pub offset: [u32; 2],
    /// The camera of the frame before, of the same width and height. Poses before are in AshsplatPlaced. What did not lie in
    /// front of it (depth z above 0.2) has no motion.
    pub previous_camera: AshsplatCamera,
    /// A pixel is empty if the splats' weights sum to less.
    pub min_weight: f32,
    /// The motion of empty pixels, pixels.
    pub empty: [f32; 2],
    /// Whether empty pixels keep what is in the image, in place of `empty`.
    pub keeps_empty: bool,
}

/// # Safety
/// `target` is NULL or alive with its image.
pub(super) unsafe fn pick<'a>(target: *const AshsplatPickTarget) -> Result<Option<PickTarget<'a>>> {
    // SAFETY: as promised.
    let Some(target) = (unsafe { target.as_ref() }) else { return Ok(None) };
    // SAFETY: as promised.
    let image = &unsafe { borrowed(target.image, "pick.image")? }.0;
    Ok(Some(PickTarget { to: HostImage { image, from: target.from.into(), offset: target.offset } }))
}

/// The camera of the frame before, if there is a motion.
///
/// # Safety
/// `target` is NULL or alive.
pub(super) unsafe fn previous_camera(target: *const AshsplatMotionTarget) -> Option<Camera> {
    // SAFETY: as promised.
    unsafe { target.as_ref() }.map(|target| (&target.previous_camera).into())
}

/// # Safety
/// `target` is NULL or alive with its image.
pub(super) unsafe fn motion<'a>(
    target: *const AshsplatMotionTarget,
    previous_camera: Option<&'a Camera>,
) -> Result<Option<MotionTarget<'a>>> {
    // SAFETY: as promised.
    let (Some(target), Some(previous_camera)) = (unsafe { target.as_ref() }, previous_camera) else {
        return Ok(None);
    };
    // SAFETY: as promised.
    let image = &unsafe { borrowed(target.image, "motion.image")? }.0;
    Ok(Some(MotionTarget {
        to: HostImage { image, from: target.from.into(), offset: target.offset },
        previous_camera,
        min_weight: target.min_weight,
        empty: (!target.keeps_empty).then_some(target.empty),
    }))
}
