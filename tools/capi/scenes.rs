//! Scenes that a host makes, changes and owns, and how a frame draws each, in C.

use super::*;
use crate::recording_cache::{List, collected};
use ashsplat::ash::{vk, vk::Handle};
use ashsplat::scene::{CutOut, Gaussians, Inside, MAX_CUT_OUTS, Volume};
use ashsplat::vk::Buffer;
use ashsplat::{Placed, Reservation, SceneSettings, Selection, ShStorage, Update};
use glam::Vec3;

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

/// A volume that keeps or removes the Gaussians whose means lie inside. A Gaussian is drawn if it lies in some volume that keeps
/// (when there are any) and in none that removes.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatCutOut {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// True if what lies inside is removed, instead of kept.
    pub removes: bool,
    /// An AshsplatVolume.
    pub volume: u32,
    /// Half of the size along each of its axes, positive; of a half-space the normal, out of it, of any length but 0.
    pub size: [f32; 3],
    /// A half-space's plane is normal x = offset. It lies at offset / |normal| along the normal: a distance in units of
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
    /// True if it is drawn. An invisible scene takes no Gaussians of the reservation and no time on the device. It counts
    /// among its scenes, and the others keep their indices.
    pub visible: bool,
    /// Factors of red, green and blue, 0 to 1000 each, of the colours as trained. The product is at most 65504.
    pub tint: [f32; 3],
    /// Factor of the opacities, 0 to 1. 0 hides the scene.
    pub opacity: f32,
    /// Highest evaluated SH degree: 3 for all stored degrees.
    pub sh_degree: u32,
    /// Number of cut-outs, at most 16.
    pub cut_out_count: u32,
    /// Volumes that keep or remove Gaussians.
    pub cut_outs: *const AshsplatCutOut,
    /// Mask of selected Gaussians, or NULL: bit i % 32 of word i / 32 for Gaussian i. The buffer has whole words for all
    /// Gaussians and the usages STORAGE_BUFFER, TRANSFER_SRC and TRANSFER_DST. It is destroyed after ashsplat_slot_release
    /// of every slot that was recorded with it.
    pub selection: *const AshsplatHostBuffer,
    /// Colour of selected Gaussians, as trained, 0 to 65504 each.
    pub selection_color: [f32; 3],
    /// Its share in the drawn colour, 0 to 1.
    pub selection_share: f32,
}

impl AshsplatCutOut {
    fn checked(&self, name: impl std::fmt::Display) -> Result<CutOut> {
        let size = Vec3::from(self.size);
        let volumes = [
            Volume::Box { half_size: size },
            Volume::Ellipsoid { radii: size },
            Volume::HalfSpace { normal: size, offset: self.offset },
        ];
        let pose = pose_of(&self.scene_from_volume, self.translation, self.scale);
        let inside = if self.removes { Inside::Removed } else { Inside::Kept };
        Ok(CutOut { volume: one_of(format_args!("{name}.volume"), self.volume, &volumes)?, pose, inside })
    }
}

/// Takes the masks and the new Gaussians of a frame into the renderer's memory.
///
/// # Safety
/// The frame is valid with all that it points to; masks meet the requirements of [`Buffer::adopt`].
pub(super) unsafe fn keep(
    frame: &AshsplatRecordedFrame,
    context: &Context,
    cache: &mut RecordingCache,
) -> Result<()> {
    // SAFETY: as promised.
    unsafe {
        for (place, placed) in read_all(frame.scenes, frame.scene_count, "scenes")?.enumerate() {
            let settings = settings_of(&placed?, place)?;
            if let Some(mask) = settings.and_then(|settings| settings.selection.as_ref()) {
                let name = format_args!("scenes[{place}].settings.selection");
                cache.adopt(context, *mask).map_err(named(name))?;
            }
        }
        for (place, update) in read_all(frame.updates, frame.update_count, "updates")?.enumerate() {
            let host = read(update?.gaussians, "gaussians");
            let copied =
                host.and_then(|host| copy_into(cache.next_copy(), &host).map_err(within("gaussians")));
            copied.map_err(within(format_args!("updates[{place}]")))?;
        }
    }
    Ok(())
}

/// # Safety
/// The settings are NULL or valid.
unsafe fn settings_of(placed: &AshsplatPlaced, place: usize) -> Result<Option<AshsplatSceneSettings>> {
    // SAFETY: as promised.
    unsafe { read_if(placed.settings, "settings") }.map_err(within(format_args!("scenes[{place}]")))
}

/// Converts the scenes of a frame.
///
/// # Safety
/// The same as for [`keep`], which has already adopted the masks.
pub(super) unsafe fn scenes<'b>(
    frame: &AshsplatRecordedFrame,
    (scratch, cache): (&'b Scratch, &'b RecordingCache),
) -> Result<List<'b, Placed<'b>>> {
    let convert = |(place, placed): (usize, Result<AshsplatPlaced>)| {
        let (placed, in_scene) = (placed?, |error| within(format_args!("scenes[{place}]"))(error));
        // SAFETY: as promised.
        unsafe {
            let scene = &borrowed(placed.scene, "scene").map_err(in_scene)?.scene;
            let previous_pose = read_if(placed.previous_pose, "previous_pose").map_err(in_scene)?;
            let settings = match settings_of(&placed, place)? {
                Some(settings) => converted(&settings, place, (scratch, cache))?,
                None => SceneSettings::default(),
            };
            let previous_pose = previous_pose.map(|p| pose_of(&p.world_from_object, p.translation, p.scale));
            Ok(Placed { settings, previous_pose, ..Placed::at(scene, placed.pose()) })
        }
    };
    // SAFETY: as promised.
    let all = unsafe { read_all(frame.scenes, frame.scene_count, "scenes")? };
    collected(all.enumerate().map(convert), scratch)
}

/// Converts a scene's settings.
///
/// # Safety
/// The same as for [`keep`], which has already adopted the masks.
unsafe fn converted<'b>(
    settings: &AshsplatSceneSettings,
    place: usize,
    (scratch, cache): (&'b Scratch, &'b RecordingCache),
) -> Result<SceneSettings<'b>> {
    let count = settings.cut_out_count as usize;
    // Checked before that many are read.
    if count > MAX_CUT_OUTS {
        let problem = format!("{count} of them, there may be {MAX_CUT_OUTS}");
        return Err(Error::argument(format!("scenes[{place}].settings.cut_outs"), problem));
    }
    let in_settings = |error| within(format_args!("scenes[{place}].settings"))(error);
    let checked = |(index, cut_out): (usize, Result<AshsplatCutOut>)| {
        let name = format_args!("scenes[{place}].settings.cut_outs[{index}]");
        cut_out.map_err(in_settings)?.checked(name)
    };
    // SAFETY: as promised.
    let (cut_outs, mask) = unsafe {
        let cut_outs = read_all(settings.cut_outs, settings.cut_out_count, "cut_outs");
        (cut_outs.map_err(in_settings)?, settings.selection.as_ref().and_then(|mask| cache.mask(mask)))
    };
    let (color, share) = (settings.selection_color, settings.selection_share);
    Ok(SceneSettings {
        visible: settings.visible,
        tint: settings.tint,
        opacity: settings.opacity,
        sh_degree: Some(settings.sh_degree),
        cut_outs: collected(cut_outs.enumerate().map(checked), scratch)?.into_bump_slice(),
        selection: mask.map(|mask| Selection { mask, color, share }),
    })
}

/// Converts the updates of a frame, whose Gaussians [`keep`] has copied. The promise is that of [`keep`].
pub(super) unsafe fn updates<'b>(
    frame: &AshsplatRecordedFrame,
    copies: &mut impl Iterator<Item = &'b Gaussians>,
    scratch: &'b Scratch,
) -> Result<List<'b, Update<'b>>> {
    let convert = |((place, update), gaussians): ((usize, Result<AshsplatUpdate>), &'b Gaussians)| {
        let AshsplatUpdate { scene, first, .. } = update?;
        // SAFETY: as promised.
        let scene = unsafe { borrowed(scene, "scene") }.map_err(within(format_args!("updates[{place}]")))?;
        Ok(Update { scene: &scene.scene, first, gaussians })
    };
    // SAFETY: as promised.
    let all = unsafe { read_all(frame.updates, frame.update_count, "updates")? };
    collected(all.enumerate().zip(copies).map(convert), scratch)
}

/// Converts a cut-out with a pose in the world to the axes of a scene that is placed there: `placed` needs no scene.
///
/// # Safety
/// `cut_out` and `placed` are alive, `in_scene` is valid for a write; it may be `cut_out`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_cut_out_in_scene(
    cut_out: *const AshsplatCutOut,
    placed: *const AshsplatPlaced,
    in_scene: *mut AshsplatCutOut,
) -> AshsplatStatus {
    guarded!({
        let (own, scene) = (read(cut_out, "cut_out")?, read(placed, "placed")?.pose());
        let in_world = own.checked("cut_out")?;
        in_world.pose.check().map_err(within("cut_out"))?;
        scene.check().map_err(within("placed"))?;
        let CutOut { pose, .. } = in_world.in_scene(&scene);
        pose.check().map_err(within("in_scene"))?;
        let moved = AshsplatCutOut {
            scene_from_volume: pose.world_from_object.transpose().to_cols_array(),
            translation: pose.translation.to_array(),
            scale: pose.scale,
            ..own
        };
        write(in_scene, "in_scene", moved)
    })
}

/// Converts a host's Gaussians.
///
/// # Safety
/// The arrays have as many elements as the count and the degree require.
pub(super) unsafe fn gaussians(host: &AshsplatGaussians) -> Result<Gaussians> {
    let mut own = Gaussians::default();
    // SAFETY: as promised.
    unsafe { copy_into(&mut own, host) }.map(|()| own)
}

/// Copies a host's Gaussians over `own`, in its memory. The promise is that of [`gaussians`].
unsafe fn copy_into(own: &mut Gaussians, host: &AshsplatGaussians) -> Result<()> {
    if host.sh_degree > 3 {
        return Err(Error::argument("sh_degree", format!("{} is above 3", host.sh_degree)));
    }
    let (count, coefficients) = (host.count as usize, (host.sh_degree as usize + 1).pow(2));
    own.sh_degree = host.sh_degree;
    // SAFETY: as promised.
    unsafe {
        let floats = |pointer, per_gaussian: usize, what| slice(pointer, per_gaussian * count, what);
        replace(&mut own.means, floats(host.means, 3, "means")?.as_chunks().0);
        replace(&mut own.quats, floats(host.quats, 4, "quats")?.as_chunks().0);
        replace(&mut own.log_scales, floats(host.log_scales, 3, "log_scales")?.as_chunks().0);
        replace(&mut own.opacity_logits, floats(host.opacity_logits, 1, "opacity_logits")?);
        replace(&mut own.sh, floats(host.sh, 3 * coefficients, "sh")?.as_chunks().0);
    }
    Ok(())
}

fn replace<T: Clone>(own: &mut Vec<T>, values: &[T]) {
    own.clear();
    own.extend_from_slice(values);
}

/// Uploads a scene from a host's arrays, with a capacity of at least `capacity` Gaussians: AshsplatUpdate and
/// ashsplat_scene_set_count change it later. Without Gaussians the scene is empty, and nothing is submitted. Values are not
/// checked:
/// Gaussians with a NaN, or an infinite position, size or quaternion, are not drawn. Quaternions are normalised.
///
/// # Safety
/// `context` is alive, `gaussians` is valid with arrays as long as it says, `scene` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_scene_new(
    context: *const AshsplatContext,
    gaussians: *const AshsplatGaussians,
    capacity: u32,
    scene: *mut *mut AshsplatScene,
) -> AshsplatStatus {
    // SAFETY: as promised.
    unsafe { ashsplat_scene_stored(context, gaussians, capacity, AshsplatShStorage::F32 as u32, scene) }
}

/// Storage of a scene's SH coefficients on the device.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AshsplatShStorage {
    /// Floats: a Gaussian of SH degree 3 takes 240 bytes with its other parameters.
    F32 = 0,
    /// Halves, each rounded to the nearest: 144 bytes. Frames that are recorded need AshsplatReservation.half_sh.
    Half = 1,
    /// Bytes, but floats for the base colour: 112 bytes. Exact where all other coefficients of a Gaussian are multiples of 1/128 from -1
    /// to below 1, or from above -1 to 1, as in SPZ files, otherwise rounded to steps of the largest / 127. Frames that are recorded need
    /// AshsplatReservation.byte_sh.
    Bytes = 2,
}

/// Same as ashsplat_scene_new, with an AshsplatShStorage. Only a scene of floats can be differentiated.
///
/// # Safety
/// As ashsplat_scene_new.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_scene_stored(
    context: *const AshsplatContext,
    gaussians: *const AshsplatGaussians,
    capacity: u32,
    sh_storage: u32,
    scene: *mut *mut AshsplatScene,
) -> AshsplatStatus {
    guarded!({
        let all = [ShStorage::F32, ShStorage::Half, ShStorage::Bytes];
        let Some(stored) = all.get(sh_storage as usize) else {
            return Err(Error::argument("sh_storage", format!("{sh_storage} is none of AshsplatShStorage")));
        };
        let (context, host) = (borrowed(context, "context")?, read(gaussians, "gaussians")?);
        let upload = || DeviceScene::upload_stored(&context.0, &self::gaussians(&host)?, capacity, *stored);
        give(scene, "scene", || upload().map(AshsplatScene::of))
    })
}

/// Uploads `count` scenes from a host's arrays into as few buffers as kernels can bind, each with room for its own Gaussians: frames
/// draw small scenes of one buffer by one dispatch in place of one each (AshsplatSlotReport.batched_scenes). `scenes` has room for
/// `count` pointers; all are NULL after an error. Each scene is freed by itself, and the memory with the last one.
///
/// # Safety
/// `context` is alive, `gaussians` is valid for `count` structs of one size with arrays as long as they say, `scenes` is valid for
/// `count` writes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_scenes_new(
    context: *const AshsplatContext,
    gaussians: *const AshsplatGaussians,
    count: u32,
    scenes: *mut *mut AshsplatScene,
) -> AshsplatStatus {
    guarded!({
        if count > 0 && scenes.is_null() {
            return Err(Error::argument("scenes", "the pointer is null"));
        }
        for place in 0..count as usize {
            scenes.add(place).write(std::ptr::null_mut());
        }
        let context = borrowed(context, "context")?;
        let hosts = read_all(gaussians, count, "gaussians")?.collect::<Result<Vec<_>>>()?;
        let copy = |(place, host): (usize, &AshsplatGaussians)| {
            self::gaussians(host).map_err(within(format_args!("gaussians[{place}]")))
        };
        let all = hosts.iter().enumerate().map(copy).collect::<Result<Vec<_>>>()?;
        let made = DeviceScene::upload_all(&context.0, &all.iter().collect::<Vec<_>>())?;
        for (place, scene) in made.into_iter().enumerate() {
            scenes.add(place).write(Box::into_raw(Box::new(AshsplatScene::of(scene))));
        }
        Ok(())
    })
}

/// The same scene in another context on the same VkDevice, with the same Gaussians in memory. It keeps the memory alive. Uses in both
/// contexts are uses of the same buffers, which the host orders.
///
/// # Safety
/// `scene` and `context` are alive, `shared` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_scene_in_context(
    scene: *const AshsplatScene,
    context: *const AshsplatContext,
    shared: *mut *mut AshsplatScene,
) -> AshsplatStatus {
    guarded!({
        let (scene, context) = (borrowed(scene, "scene")?, borrowed(context, "context")?);
        give(shared, "shared", || scene.scene.in_context(&context.0).map(AshsplatScene::of))
    })
}

/// The layout of the parameters of `capacity` Gaussians in a host's own buffers.
///
/// # Safety
/// `context` is alive, `plan` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_scene_plan(
    context: *const AshsplatContext,
    capacity: u32,
    sh_degree: u32,
    plan: *mut AshsplatScenePlan,
) -> AshsplatStatus {
    guarded!({
        let made =
            DeviceScene::plan_for(&borrowed(context, "context")?.0, capacity, sh_degree, ShStorage::F32)?;
        let measures = same_fields!(made => AshsplatScenePlan { chunks, planes, chunk_gaussians } with {
            chunk_bytes: made.chunk_bytes(),
            ..AshsplatScenePlan::default()
        });
        write(plan, "plan", measures)
    })
}

/// A scene of `count` Gaussians in the host's own buffers, one for each chunk of ashsplat_scene_plan for the
/// same capacity and degree. A host that writes them synchronises the writes as for any buffer that compute
/// shaders read.
///
/// # Safety
/// - `context` is alive, `buffers` has `buffer_count` elements, `scene` is valid for a write;
/// - each buffer is of the context's device, bound to memory, of the given size, and has the usages
///   STORAGE_BUFFER, TRANSFER_SRC and TRANSFER_DST; it lives until the scene is freed and the last recording
///   that uses it has been executed; no two overlap.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_scene_from_buffers(
    context: *const AshsplatContext,
    capacity: u32,
    sh_degree: u32,
    count: u32,
    buffers: *const AshsplatHostBuffer,
    buffer_count: u32,
    scene: *mut *mut AshsplatScene,
) -> AshsplatStatus {
    guarded!({
        let context = &borrowed(context, "context")?.0;
        let buffers = slice(buffers, buffer_count as usize, "buffers")?;
        give(scene, "scene", || {
            let adopt = |b: &AshsplatHostBuffer| {
                Buffer::adopt(context, "host's planes", vk::Buffer::from_raw(b.buffer), b.offset, b.bytes)
            };
            let adopt = |(place, b)| adopt(b).map_err(named(format_args!("buffers[{place}]")));
            let chunks: Result<Vec<Buffer>> = buffers.iter().enumerate().map(adopt).collect();
            let plan = DeviceScene::plan_for(context, capacity, sh_degree, ShStorage::F32)?;
            let scene = DeviceScene::from_buffers(context, plan, chunks?, count)?;
            Ok(AshsplatScene::of(scene))
        })
    })
}

/// Renders only the first `count` Gaussians of a scene from the next recording on.
///
/// # Safety
/// `scene` is alive.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ashsplat_scene_set_count(scene: *mut AshsplatScene, count: u32) -> AshsplatStatus {
    guarded!({ borrowed_mut(scene, "scene")?.scene.set_count(count) })
}

/// Staging bytes of an update of `gaussians` Gaussians of a scene of this degree, for AshsplatReservation.
#[unsafe(no_mangle)]
pub extern "C" fn ashsplat_update_bytes(gaussians: u32, sh_degree: u32) -> u64 {
    Reservation::update_bytes(gaussians, sh_degree.min(3))
}
