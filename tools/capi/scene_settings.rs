//! Settings of one scene of a frame, in C.

use super::kept::Kept;
use super::scratch::{List, Scratch, collected};
use super::settings::one_of;
use super::structs::{named, read, read_all_in, read_if, within, write};
use super::{AshsplatHostBuffer, AshsplatPlaced, AshsplatStatus, guarded};
use ashsplat::scene::{CutOut, Inside, MAX_CUT_OUTS, Pose, Volume};
use ashsplat::vk::{Buffer, Context};
use ashsplat::{Error, Result, SceneSettings, Selection};
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
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// Whether what lies inside is removed, instead of kept.
    pub removes: bool,
    /// An AshsplatVolume.
    pub volume: u32,
    /// Half of the size along each of its axes, positive; of a half-space the normal, out of it, of any length but 0.
    pub size: [f32; 3],
    /// Of a half-space: the plane is normal x = offset. It lies at offset / |normal| along the normal: a distance in units of
    /// the volume if the normal has length 1.
    pub offset: f32,
    /// From its axes to the scene's own, before the scene's pose: a rotation, row by row.
    pub scene_from_volume: [f32; 9],
    /// Its origin, units of the scene.
    pub translation: [f32; 3],
    /// Units of the scene per unit of the volume: 1 for no scaling.
    pub scale: f32,
}

/// How one scene of a frame is drawn; by default as it is.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatSceneSettings {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// Whether it is drawn. A scene that is not takes no Gaussians of the reservation and no time on the device. It counts
    /// among its scenes, and the others keep their places.
    pub visible: bool,
    /// Factors of red, green and blue, 0 to 1000 each, of the colours as trained. The product is at most 65504.
    pub tint: [f32; 3],
    /// Factor of the opacities, 0 to 1; 0 is as not visible.
    pub opacity: f32,
    /// Highest evaluated SH degree: 3 for all stored degrees.
    pub sh_degree: u32,
    /// How many cut-outs, at most 16.
    pub cut_out_count: u32,
    /// Volumes that keep or remove Gaussians.
    pub cut_outs: *const AshsplatCutOut,
    /// A bit per Gaussian of the scene, set where it has another colour: bit i % 32 of the word i / 32. A buffer with the usages
    /// STORAGE_BUFFER, TRANSFER_SRC and TRANSFER_DST, of whole words for all Gaussians; or NULL. It is destroyed after
    /// ashsplat_slot_release of every slot that was recorded with it.
    pub selection: *const AshsplatHostBuffer,
    /// The other colour, as trained, 0 to 65504 each.
    pub selection_color: [f32; 3],
    /// Its share in the drawn colour, 0 to 1.
    pub selection_share: f32,
}

/// A scene's settings and the converted objects that they point to.
pub(super) struct Pointees<'b> {
    settings: Option<AshsplatSceneSettings>,
    cut_outs: List<'b, CutOut>,
    mask: Option<Buffer>,
}

impl AshsplatCutOut {
    fn checked(&self, name: impl std::fmt::Display) -> Result<CutOut> {
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
        Ok(CutOut { volume: one_of(format_args!("{name}.volume"), self.volume, &volumes)?, pose, inside })
    }
}

/// Converts the objects that each scene's settings point to.
///
/// # Safety
/// The settings are NULL or valid with all that they point to; masks meet the requirements of [`Buffer::adopt`].
pub(super) unsafe fn pointees<'b>(
    placed: &[AshsplatPlaced],
    context: &Context,
    (scratch, kept): (&'b Scratch, &Kept),
) -> Result<List<'b, Pointees<'b>>> {
    let of = |(place, placed): (usize, &AshsplatPlaced)| {
        // SAFETY: as promised.
        let settings = unsafe { read_if(placed.settings, "settings") };
        let Some(settings) = settings.map_err(within(format_args!("scenes[{place}]")))? else {
            return Ok(Pointees { settings: None, cut_outs: List::new_in(scratch), mask: None });
        };
        let field = || format!("scenes[{place}].settings.cut_outs");
        let count = settings.cut_out_count as usize;
        // Checked before that many are read.
        if count > MAX_CUT_OUTS {
            return Err(Error::argument(field(), format!("{count} of them, there may be {MAX_CUT_OUTS}")));
        }
        // SAFETY: as promised.
        let own = unsafe { read_all_in(scratch, settings.cut_outs, settings.cut_out_count, "cut_outs") };
        let own = own.map_err(within(format_args!("scenes[{place}].settings")))?;
        let checked = |(index, cut_out): (usize, &AshsplatCutOut)| {
            cut_out.checked(format_args!("scenes[{place}].settings.cut_outs[{index}]"))
        };
        let cut_outs = collected(own.iter().enumerate().map(checked), scratch)?;
        // SAFETY: as promised.
        let mask = unsafe { settings.selection.as_ref() }.map(|mask| {
            // SAFETY: as promised.
            let mask = unsafe { kept.mask(context, *mask) };
            mask.map_err(named(format_args!("scenes[{place}].settings.selection")))
        });
        Ok(Pointees { settings: Some(settings), cut_outs, mask: mask.transpose()? })
    };
    collected(placed.iter().enumerate().map(of), scratch)
}

/// Checks a pose within a larger argument.
fn check_pose(pose: &Pose, of: &str) -> Result<()> {
    pose.check().map_err(within(of))
}

/// Converts a scene's settings.
pub(super) fn of<'a>(own: &'a Pointees<'_>) -> SceneSettings<'a> {
    own.settings.as_ref().map_or_else(SceneSettings::default, |settings| SceneSettings {
        visible: settings.visible,
        tint: settings.tint,
        opacity: settings.opacity,
        sh_degree: Some(settings.sh_degree),
        cut_outs: &own.cut_outs,
        selection: own.mask.as_ref().map(|mask| {
            let (color, share) = (settings.selection_color, settings.selection_share);
            Selection { mask, color, share }
        }),
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
        let (own, scene) = (read(cut_out, "cut_out")?, read(placed, "placed")?.pose());
        let in_world = own.checked("cut_out")?;
        check_pose(&in_world.pose, "cut_out")?;
        check_pose(&scene, "placed")?;
        let CutOut { pose, .. } = in_world.in_scene(&scene);
        check_pose(&pose, "in_scene")?;
        let moved = AshsplatCutOut {
            scene_from_volume: pose.world_from_object.transpose().to_cols_array(),
            translation: pose.translation.to_array(),
            scale: pose.scale,
            ..own
        };
        write(in_scene, "in_scene", moved)
    })
}
