//! How one scene of a frame is drawn, in C.

use super::settings::one_of;
use super::{AshsplatPlaced, AshsplatStatus, borrowed, borrowed_mut, guarded, slice};
use ashsplat::scene::{CutOut, Inside, Pose, Volume};
use ashsplat::{Result, SceneSettings};
use glam::{Mat3, Vec3};

/// The shape of a volume.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AshsplatVolume {
    /// A box around the origin of its own axes.
    Box = 0,
    /// An ellipsoid around the origin.
    Ellipsoid = 1,
    /// The points x with normal x <= offset.
    HalfSpace = 2,
}

/// A volume that keeps or removes the Gaussians whose means lie inside. Of several, a Gaussian is drawn that lies in at least
/// one of those that keep, if there are any, and in none of those that remove.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatCutOut {
    /// An AshsplatVolume.
    pub volume: u32,
    /// Half of the size along each of its axes, positive; of a half-space the normal, out of it, of any length but 0.
    pub size: [f32; 3],
    /// Of a half-space: where its plane lies along the normal, in units of the normal's length.
    pub offset: f32,
    /// From its axes to the scene's own, before the scene's pose: a rotation, row by row.
    pub scene_from_volume: [f32; 9],
    /// Its origin, units of the scene.
    pub translation: [f32; 3],
    /// Units of the scene per unit of the volume: 1 for no scaling.
    pub scale: f32,
    /// Whether what lies inside is removed, instead of kept.
    pub removes: bool,
}

/// How one scene of a frame is drawn; ashsplat_scene_settings fills in the defaults.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatSceneSettings {
    /// Whether it is drawn. A scene that is not takes no work and no room; the others keep their places among the frame's.
    pub visible: bool,
    /// Factors of red, green and blue, 0 to 1000 each, of the colours as trained. The product is at most 65504.
    pub tint: [f32; 3],
    /// Factor of the opacities, 0 to 1; 0 is as not visible.
    pub opacity: f32,
    /// Highest evaluated SH degree: 3 for all stored degrees.
    pub sh_degree: u32,
    /// Volumes that keep or remove Gaussians.
    pub cut_outs: *const AshsplatCutOut,
    /// How many, at most 16.
    pub cut_out_count: u32,
}

impl AshsplatCutOut {
    fn checked(&self, name: impl Fn() -> String) -> Result<CutOut> {
        let size = Vec3::from(self.size);
        let volumes = [
            Volume::Box { half_size: size },
            Volume::Ellipsoid { radii: size },
            Volume::HalfSpace { normal: size, offset: self.offset },
        ];
        let pose = Pose {
            world_from_object: Mat3::from_cols_array(&self.scene_from_volume).transpose(),
            translation: Vec3::from(self.translation),
            scale: self.scale,
        };
        let inside = if self.removes { Inside::Removed } else { Inside::Kept };
        Ok(CutOut { volume: one_of(&format!("{}.volume", name()), self.volume, &volumes)?, pose, inside })
    }
}

/// The cut-outs of each scene.
///
/// # Safety
/// The settings are NULL or valid with all that they point to.
pub(super) unsafe fn cut_outs(placed: &[AshsplatPlaced]) -> Result<Vec<Vec<CutOut>>> {
    let of = |(place, placed): (usize, &AshsplatPlaced)| {
        // SAFETY: as promised.
        let Some(settings) = (unsafe { placed.settings.as_ref() }) else { return Ok(Vec::new()) };
        let name = |index: usize| format!("scenes[{place}].settings.cut_outs[{index}]");
        // SAFETY: as promised.
        let own = unsafe { slice(settings.cut_outs, settings.cut_out_count as usize, "cut_outs")? };
        own.iter().enumerate().map(|(index, cut_out)| cut_out.checked(|| name(index))).collect()
    };
    placed.iter().enumerate().map(of).collect()
}

/// The settings of a scene with these cut-outs.
///
/// # Safety
/// The settings are NULL or valid.
pub(super) unsafe fn of<'a>(placed: &AshsplatPlaced, cut_outs: &'a [CutOut]) -> SceneSettings<'a> {
    // SAFETY: as promised.
    unsafe { placed.settings.as_ref() }.map_or_else(SceneSettings::default, |own| SceneSettings {
        visible: own.visible,
        tint: own.tint,
        opacity: own.opacity,
        sh_degree: Some(own.sh_degree),
        cut_outs,
    })
}

/// The default settings, with which a scene is drawn as it is.
///
/// # Safety
/// `settings` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_scene_settings(settings: *mut AshsplatSceneSettings) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        *borrowed_mut(settings, "settings")? = AshsplatSceneSettings {
            visible: true,
            tint: [1.0; 3],
            opacity: 1.0,
            sh_degree: 3,
            cut_outs: std::ptr::null(),
            cut_out_count: 0,
        };
        Ok(())
    })
}

/// A cut-out whose pose is one in the world, for a scene that is placed there: `placed` needs no scene.
///
/// # Safety
/// `cut_out` and `placed` are alive, `in_scene` is valid for a write; it may be `cut_out`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_cut_out_in_scene(
    cut_out: *const AshsplatCutOut,
    placed: *const AshsplatPlaced,
    in_scene: *mut AshsplatCutOut,
) -> AshsplatStatus {
    // SAFETY: as promised.
    guarded(|| unsafe {
        let (own, pose) = (*borrowed(cut_out, "cut_out")?, borrowed(placed, "placed")?.pose());
        let CutOut { pose, .. } = own.checked(|| "cut_out".to_owned())?.in_scene(&pose);
        *borrowed_mut(in_scene, "in_scene")? = AshsplatCutOut {
            scene_from_volume: pose.world_from_object.transpose().to_cols_array(),
            translation: pose.translation.to_array(),
            scale: pose.scale,
            ..own
        };
        Ok(())
    })
}
